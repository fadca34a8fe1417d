"""Functions of time through samples: splines and steps by themselves, and runs cut at their knots."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from mechanisms import CART, carts, mass_on_rail
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from simulations import SIMULATIONS

import mjcf
import newton_euler
import urdf
from crosscheck.compare.coverage import covered_by
from crosscheck.engines.energy import energy_balance
from crosscheck.library import load
from crosscheck.library.scene_file import content, write_scene
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.errors import MechanismError, NewtonEulerError
from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.digital_control import Digital, Sampled
from newton_euler.model.motions import PrescribedMotion, Sum, scaled
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Spline, Steps

QUICK = [name for name in SIMULATIONS if name != "relative in floats"]
"""Splines are the same to floats whether they are held between knots or not."""

MASS, STIFFNESS, DAMPING = 2.0, 50.0, 4.0
"""kg of `mass_on_rail`, N/m, N s/m of the law."""

RNG = np.random.default_rng(17)
TIMES = np.cumsum(RNG.uniform(0.05, 0.2, 20)) - 0.2
"""s, neither even nor on outputs, from before 0 on to 2 s and more."""

PULL, WANTED = RNG.normal(size=(2, 20)) * np.array([[5.0], [0.1]])
"""N and m at these times."""

JUMPS = Steps((-1.0, 0.333, 1.0), (0.05, 0.1, -0.1))


def rail(*control: PD, **changes) -> Scene:
    return replace(mass_on_rail(duration=1.8, control=control), output_period=0.05, **changes)


def sampled(frequency: float, period: float) -> Spline:
    times = period * np.arange(round(20.0 / period))
    return Spline(times, np.sin(frequency * times))


def test_a_spline_is_as_near_to_a_sine_as_it_says():
    """Distances that the docstring states, a fifth of them below."""
    w, h = 2.0, 0.05
    spline = sampled(w, h)
    inside, ends = np.linspace(5.0, 15.0, 2001), np.linspace(0.0, 3.0 * h, 2001)
    for times, value, acceleration in ((inside, 13_000.0, 700.0), (ends, 100.0, 2.0)):
        off = max(abs(spline.value(t) - np.sin(w * t)) for t in times) / (w * h) ** 6
        assert off < 1.0 / value
        off = max(abs(spline.acceleration(t) / w**2 + np.sin(w * t)) for t in times) / (w * h) ** 4
        assert 0.2 < off * acceleration < 1.0 or value == 100.0


def test_a_spline_is_the_one_of_scipy_and_smooth_at_its_knots():
    spline, expected = Spline(TIMES, PULL), make_interp_spline(TIMES, PULL, 5)
    for t in np.linspace(0.0, 1.8, 301):
        assert spline.value(t) == pytest.approx(expected(t), rel=1e-11, abs=1e-11)
        assert spline.rate(t) == pytest.approx(expected(t, 1), rel=1e-10, abs=1e-9)
        assert spline.acceleration(t) == pytest.approx(expected(t, 2), rel=1e-9, abs=1e-7)
    for knot in spline.knots:
        sides = [spline.on_piece(spline.piece(knot + shift)) for shift in (-1e-6, 1e-6)]
        for of in ("value", "rate", "acceleration"):
            before, after = (getattr(side, of)(knot) for side in sides)
            assert after == pytest.approx(before, rel=1e-11, abs=1e-9)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6, 7])
def test_few_samples_lie_on_one_polynomial(count):
    """Of the degree that they allow: a cubic through four samples or more."""
    cubic = Polynomial((1.0, -2.0, 0.5, 0.3)[: min(count, 4)])
    times = np.linspace(0.0, 2.0, count)
    spline = Spline(times, [cubic.value(t) for t in times])
    assert spline.value(1.3) == pytest.approx(cubic.value(1.3), rel=1e-12)
    assert spline.acceleration(1.3) == pytest.approx(cubic.acceleration(1.3), rel=1e-10, abs=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Spline((0.0,), (1.0,)), "times is .*needed: 2 finite numbers or more"),
        (lambda: Spline((0.0, 1.0), (1.0, np.nan)), "values is .*nan.*needed: 2 finite"),
        (lambda: Spline("abc", (1.0, 2.0)), "times is 'abc'"),
        (lambda: Spline((0.0, 1.0, 2.0), (1.0, 2.0)), "3 times and 2 values"),
        (lambda: Spline((0.0, 1.0, 1.0), (1.0, 2.0, 3.0)), r"times\[2\] is 1 s, after 1 s"),
        (lambda: Steps((), ()), "steps: times is .*needed: 1 finite number"),
        (lambda: PrescribedMotion("rail", Sum((JUMPS, Sine(1.0, 2.0)))), "'rail': function jumps at 0.333 s"),
        (lambda: rail(PD("rail", 1.0, 1.0, Spline((0.0, 1.0), (0.0, 1.0)))), "target is known from 0 to 1 s"),
        (lambda: rail(Digital(PD("rail", 1.0, 1.0, Spline((0.0, 1.0), (0.0, 1.0))), 0.1)), "target is known"),
        (
            lambda: rail(motions=(PrescribedMotion("rail", Spline((0.5, 9.0), (0.0, 1.0))),)),
            "function is known from 0.5 to 9 s; needed: samples from 0 to 1.8 s, the end of the run",
        ),
    ],
)
def test_refusals(make, words):
    with pytest.raises(MechanismError, match=words):
        make()


def followed(scene: Scene) -> np.ndarray:
    """m, the position at the output times by scipy, from one knot to the next."""
    pull, wanted = make_interp_spline(TIMES, PULL, 5), make_interp_spline(TIMES, WANTED, 5)

    def rates(t, y):
        force = pull(t) - STIFFNESS * (y[0] - wanted(t)) - DAMPING * (y[1] - wanted(t, 1))
        return [y[1], float(force) / MASS]

    y, found = np.zeros(2), [0.0]
    edges = np.union1d(scene.times, TIMES[TIMES > 0.0])
    for begin, end in pairwise(edges[edges <= scene.duration]):
        y = solve_ivp(rates, (begin, end), y, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
        if end in scene.times:
            found.append(y[0])
    return np.array(found)


@pytest.mark.parametrize("engine", QUICK)
def test_laws_follow_splines(engine):
    """1e-9 m: newton_euler's and Pinocchio's tolerances of 1e-10 a step, and MuJoCo's RK4 at 1 ms."""
    scene = rail(PD("rail", STIFFNESS, DAMPING, Spline(TIMES, WANTED), feedforward=Spline(TIMES, PULL)))
    found = SIMULATIONS[engine](scene)
    assert np.abs(found.position[:, 1, 2] - followed(scene)).max() < 1e-9


def stepped(times: np.ndarray) -> np.ndarray:
    """m, the position under a law whose target `JUMPS`, in closed form."""
    decay = DAMPING / (2.0 * MASS)
    w = np.sqrt(STIFFNESS / MASS - decay**2)
    found, x, rate = np.zeros_like(times), 0.0, 0.0
    edges = [0.0, *JUMPS.knots, np.inf]
    for begin, end, target in zip(edges[:-1], edges[1:], JUMPS.values, strict=True):

        def motion(t, away=x - target, rate=rate, target=target, begin=begin):
            c, s, fade = np.cos(w * (t - begin)), np.sin(w * (t - begin)), np.exp(-decay * (t - begin))
            sine = (rate + decay * away) / w
            value = away * c + sine * s
            return target + fade * value, fade * (w * (sine * c - away * s) - decay * value)

        inside = (times >= begin) & (times < end)
        found[inside] = motion(times[inside])[0]
        if end < np.inf:
            x, rate = motion(end)
    return found


@pytest.mark.parametrize("engine", SIMULATIONS)
def test_targets_jump(engine):
    """As above; forces at the jump on an output time, 1 s, are those after it."""
    scene = rail(PD("rail", STIFFNESS, DAMPING, JUMPS))
    found = SIMULATIONS[engine](scene)
    assert np.abs(found.position[:, 1, 2] - stepped(scene.times)).max() < 1e-9
    k = np.flatnonzero(found.time == 1.0)[0]
    x, rate = found.position[k, 1, 2], found.linear_velocity[k, 1, 2]
    assert found.actuator_force[k, 0] == pytest.approx(-STIFFNESS * (x + 0.1) - DAMPING * rate, abs=1e-9)


def test_fixed_steps_keep_their_order_across_jumps():
    scene = rail(PD("rail", STIFFNESS, DAMPING, JUMPS))
    exact = stepped(scene.times)
    for simulate in (newton_euler.simulate, urdf.simulate):
        gaps = [
            np.abs(simulate(scene, integrator="RK4", step=h).position[:, 1, 2] - exact).max()
            for h in (0.025, 0.0125)
        ]
        assert gaps[0] / gaps[1] > 12.0  # order 4


@pytest.mark.parametrize("engine", QUICK)
def test_joints_follow_splines(engine):
    """A spring softer than MuJoCo's constraint by 1e-6 of it leaves the rail where the spline is, and the
    work of the motion closes the balance of energy."""
    scene = rail(motions=(PrescribedMotion("rail", Spline(TIMES, WANTED)),))
    found = SIMULATIONS[engine](scene)
    wanted = make_interp_spline(TIMES, WANTED, 5)
    assert np.abs(found.position[:, 1, 2] - wanted(scene.times)).max() < (
        1e-5 if engine == "mujoco" else 1e-11
    )
    if engine != "mujoco_rigid":  # which has no work
        balance = energy_balance(scene, found)
        assert np.abs(balance.residual).max() < (1e-6 if engine == "mujoco" else 1e-9) * balance.scale


@pytest.mark.parametrize("engine", QUICK)
def test_targets_of_state_feedback_jump(engine):
    """Of another cart, which stays where it is: a feedforward that jumps does the same."""
    gains = {"rail_0": (STIFFNESS, DAMPING), "rail_1": (20.0, 0.0)}
    feedback = StateFeedback("rail_0", gains, 0.1, targets={"rail_1": JUMPS})
    law = PD("rail_0", STIFFNESS, DAMPING, 0.1, feedforward=scaled(JUMPS, 20.0))
    found, expected = (
        SIMULATIONS[engine](carts(each, duration=1.8, output_period=0.05)) for each in (feedback, law)
    )
    assert np.abs(found.position - expected.position).max() < 1e-12


def test_sampled_controllers_act_between_knots():
    """A controller and a spline on one rail, knots that almost meet sampling instants."""
    law = Sampled("rail", lambda t, x, rate: -STIFFNESS * x[0] + 3.0, 0.1)
    times = 0.1 * np.arange(30) + 1e-13
    driven = rail(PD("rail", 0.0, 0.0, 0.0, feedforward=Steps(times, np.resize([1.0, -2.0], 30))))
    for simulate in (newton_euler.simulate, urdf.simulate, mjcf.simulate):
        alone = simulate(replace(driven, control=(law,)))
        assert np.all(np.isfinite(alone.position))
        assert simulate(driven).settings["steps"] < 10_000


def test_other_samples_have_the_same_code(tmp_path, monkeypatch):
    """More of them, elsewhere, in a scene that starts at the same pose."""

    def scene(times, values):
        law = PD("rail", STIFFNESS, DAMPING, Spline(times, values), feedforward=Steps(times, values))
        return rail(law)

    traced, own = [], CompiledEquations._trace

    def watched(self, name):
        traced.append(name)
        return own(self, name)

    monkeypatch.setenv("NEWTON_EULER_CACHE", str(tmp_path))
    monkeypatch.setattr(CompiledEquations, "_trace", watched)
    newton_euler.simulate(scene(TIMES, WANTED))
    first = list(traced)
    newton_euler.simulate(scene(np.linspace(0.0, 3.0, 50), np.linspace(0.0, 1.0, 50)))
    assert first
    assert traced == first


def test_samples_of_a_law_are_parameters_of_batches():
    scene = rail(PD("rail", STIFFNESS, DAMPING, Spline(TIMES, WANTED)))
    values = [WANTED, 2.0 * WANTED, -WANTED]
    batch = newton_euler.simulate_batch(scene, parameters={"rail.target": values}, threads=2)
    assert not any(name.endswith("in lanes") for name in batch._compiled.functions)  # nothing is made in vain
    for run_, value in zip(batch, values, strict=True):
        alone = newton_euler.simulate(rail(PD("rail", STIFFNESS, DAMPING, Spline(TIMES, value))))
        assert np.array_equal(run_.position, alone.position)


def samples_and_more(count: int) -> Sum:
    times = np.linspace(0.0, 2.0, count)
    return Sum((Spline(times, np.sin(3.0 * times)), Polynomial((0.1, 0.2))))


def laws(count: int) -> Scene:
    return carts(PD("rail_0", STIFFNESS, DAMPING, samples_and_more(count)))


def moved(count: int) -> Scene:
    return replace(carts(), motions=(PrescribedMotion("rail_0", samples_and_more(count)),))


@pytest.mark.parametrize(
    ("scene", "name", "value"),
    [
        (laws, "rail_0.target", 0.1 * np.cos(np.arange(12.0))),
        (laws, "rail_0.target.9", 0.3),
        (moved, "rail_0.motion.function", 0.1 * np.cos(np.arange(12.0))),
    ],
)
def test_code_for_other_numbers_of_samples_is_no_code_for_these(scene, name, value, tmp_path, monkeypatch):
    """The tenth number is a sample of 10, and of 8 a coefficient of the other term; more inputs follow."""
    monkeypatch.setenv("NEWTON_EULER_CACHE", str(tmp_path))
    for count in (8, 10):
        samples = value[: count + 2] if np.ndim(value) else value
        given = {name: samples, "cart_1.center_of_mass": np.array([0.1, 1.0, 0.0])}
        batch = newton_euler.simulate_batch(
            scene(count), None, {each: [own] for each, own in given.items()}, formulation="cartesian"
        )
        alone = newton_euler.simulate(newton_euler.with_parameters(scene(count), given), "cartesian")
        # both are integrated to 1e-10 from starts that differ by round-off
        assert np.abs(batch[0].position - alone.position).max() < 1e-9


def test_linear_models_take_the_number_of_samples_into_account(tmp_path, monkeypatch):
    """The tenth number of the target is the rate of what is added to 8 samples, the constant beside 9."""
    monkeypatch.setenv("NEWTON_EULER_CACHE", str(tmp_path))
    for count, gain in ((8, DAMPING), (9, STIFFNESS)):
        model = newton_euler.linearize(laws(count), inputs=["rail_0.target.9"])
        assert model.B[2, 0] == pytest.approx(gain / CART, rel=1e-12)  # round-off


def test_coverage_sees_samples():
    scene = rail(PD("rail", 0.0, 0.0, 0.0, feedforward=Spline(TIMES, PULL)))
    assert {each.element for each in covered_by(scene, 1e-8, 1e-8).untested} == {"inertia of body 'mass'"}


def test_scene_files_hold_samples(tmp_path):
    law = PD("rail", 1.0, 1.0, JUMPS, feedforward=Sum((Spline(TIMES, PULL), Sine(1.0, 2.0))))
    for ending in ("yaml", "json"):
        path = tmp_path / f"sampled.{ending}"
        write_scene(rail(law), path)
        (read,) = load(str(path)).control
        assert content(read) == content(law)


@pytest.mark.parametrize(
    ("time", "words"),
    [
        (9.0, "samples from 9 to 9 s, the time asked for"),
        (-1.0, "samples from -1 to -1 s, the time asked for"),
        ("x", "time is 'x'"),
        (np.nan, "time is nan"),
    ],
)
def test_analyses_are_asked_for_times_that_functions_cover(time, words):
    scene = rail(PD("rail", STIFFNESS, DAMPING, Spline(TIMES, WANTED)))
    with pytest.raises(NewtonEulerError, match=words):
        newton_euler.linearize(scene, time=time)


@pytest.mark.parametrize("time", [9.0, -1.0])
def test_inverse_dynamics_extrapolates_no_spline(time):
    scene = mass_on_rail(duration=1.8, motions=(PrescribedMotion("rail", Spline(TIMES, WANTED - WANTED[0])),))
    state = newton_euler.initial_state(scene)
    with pytest.raises(NewtonEulerError, match=f"samples from {time:g} to {time:g} s, the times asked for"):
        newton_euler.inverse_dynamics(scene, state, {}, time=time)


def test_knots_that_differ_by_round_off_are_one():
    """0.1 k of two ways to make it: neither an interval of 1e-17 s nor a set-point a period late."""
    near, exact = np.arange(10) * 0.1, [0.1 * k for k in range(3)] + [0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]
    values = np.arange(10.0)
    scene = load("tracker")
    laws = tuple(
        replace(law, target=Steps(near, 0.001 * values), feedforward=Steps(exact, 0.01 * values))
        for law in scene.control
    )
    scene = replace(scene, control=laws, duration=1.0, output_period=0.1)
    assert len(scene.knots) == 9
    assert len(newton_euler.simulate(scene).time) == 11
    assert Steps(near, values).value(0.3) == Steps(exact, values).value(0.3) == 3.0
