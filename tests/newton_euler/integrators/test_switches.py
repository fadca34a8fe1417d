"""Dry friction and stops: closed forms, steps that end where a force switches, lanes and sensitivities."""

from dataclasses import replace

import numpy as np
import pytest

import mjcf
import newton_euler
from newton_euler import (
    PD,
    Body,
    JointFriction,
    JointStop,
    Mechanism,
    Polynomial,
    Prismatic,
    Revolute,
    Scene,
    State,
    Trajectory,
)
from newton_euler.compiled import records
from newton_euler.compiled.run import Integrator
from newton_euler.equations.parameters import parameter_values
from newton_euler.errors import MechanismError
from newton_euler.integrators.options import Options
from newton_euler.integrators.switches import no_switches
from newton_euler.runs.simulate import CompiledScene

MASS, GRAVITY = 2.0, 9.81
ADAPTIVE = ["DOP853", "Radau"]


def block(angle: float = 0.0, speed: float = 0.0, **fields) -> Scene:
    """A block on a rail that rises by an angle, started with a speed up the rail; gravity acts on slopes."""
    along = np.array([np.cos(angle), 0.0, np.sin(angle)])
    body = Body("block", MASS, np.zeros(3), np.eye(3))
    rail = Prismatic("rail", "ground", "block", np.zeros(3), axis=along, actuated=True)
    mechanism = Mechanism([Body.ground(), body], [rail])
    at_rest = State.initial(mechanism)
    start = replace(at_rest, linear_velocity=np.array([np.zeros(3), speed * along]))
    settings = {"duration": 1.0, "output_period": 0.01, "gravity": [0.0, 0.0, -GRAVITY if angle else 0.0]}
    return Scene("block", mechanism, **(settings | {"initial_state": start} | fields))


def rail(run: Trajectory) -> np.ndarray:
    """Coordinates (n,) of the rail, m."""
    return run.joint("rail").coordinates[:, 0]


def tight(scene: Scene, integrator: str = "DOP853") -> Trajectory:
    return newton_euler.simulate(scene, integrator=integrator, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
@pytest.mark.parametrize("dissipation", [0.0, 0.5])
@pytest.mark.parametrize("integrator", ADAPTIVE)
def test_a_mass_leaves_a_stop_with_the_restitution_of_hunt_and_crossley(integrator, dissipation, formulation):
    """v - ln(1 + c v) / c = -w - ln(1 - c w) / c, for any mass and stiffness; w = v without dissipation."""
    stop = JointStop("rail", "high", 0.1, stiffness=1e5, dissipation=dissipation)
    scene = block(speed=1.0, forces=(stop,), duration=0.2)
    run = newton_euler.simulate(scene, formulation, integrator=integrator, rtol=1e-10, atol=1e-12)
    w = -run.linear_velocity[-1, 1, 0]
    if not dissipation:
        assert w == pytest.approx(1.0, abs=1e-9)
        return
    before, after = 1.0 - np.log1p(dissipation) / dissipation, -w - np.log1p(-dissipation * w) / dissipation
    assert after == pytest.approx(before, abs=1e-9)  # rtol 1e-10 over some ten steps
    # what the stop has dissipated is the kinetic energy that is lost
    assert run.work[-1] == pytest.approx(0.5 * MASS * (w**2 - 1.0), abs=1e-9)


@pytest.mark.parametrize("integrator", ADAPTIVE)
@pytest.mark.parametrize("depth", [1e-3, 1e-7, 1e-11])
def test_a_short_touch_within_a_long_step_is_found(depth, integrator):
    """A block thrown up against a stop just below its apex: exact parabolas and half a wave in contact.

    Without the stop the parabola is integrated exactly by a single step.
    """
    speed, stiffness, end = 2.0, 1e6, 0.4
    apex = 0.5 * speed**2 / GRAVITY
    stop = JointStop("rail", "high", apex - depth, stiffness)
    scene = block(0.5 * np.pi, speed, forces=(stop,), duration=end, output_period=end)
    found = rail(tight(scene, integrator))[-1]
    touch, w = np.sqrt(2.0 * GRAVITY * depth), np.sqrt(stiffness / MASS)
    contact = 2.0 / w * np.arctan(touch * w / GRAVITY)  # from and back to the limit, weight included
    fall = end - (speed - touch) / GRAVITY - contact
    exact = apex - depth - touch * fall - 0.5 * GRAVITY * fall**2
    missed = speed * end - 0.5 * GRAVITY * end**2
    assert abs(found - exact) < 1e-12 < abs(missed - exact)


def test_a_block_slides_up_an_incline_and_creeps_back():
    """Deceleration g sin + F / m up; then it sticks, and creeps with v_t m g sin / F: closed forms."""
    angle, speed, friction, transition = 0.2, 1.5, 6.0, 1e-5
    weight = MASS * GRAVITY * np.sin(angle)
    assert weight < friction
    element = JointFriction("rail", friction, transition_speed=transition)
    run = tight(block(angle, speed, forces=(element,)))
    top = 0.5 * speed**2 / (GRAVITY * np.sin(angle) + friction / MASS)
    creep = -transition * weight / friction
    assert run.linear_velocity[-1, 1] @ [np.cos(angle), 0.0, np.sin(angle)] == pytest.approx(creep, rel=1e-9)
    # the rest of the difference: the friction falls below the transition speed, some v_t^2 m / F
    stopped = speed / (GRAVITY * np.sin(angle) + friction / MASS)
    assert rail(run)[-1] == pytest.approx(top + creep * (1.0 - stopped), abs=10.0 * transition**2)


def test_a_steep_incline_slides_down_again():
    """g sin - F / m down, without sticking."""
    angle, friction = 0.8, 6.0
    run = tight(block(angle, forces=(JointFriction("rail", friction, transition_speed=1e-6),)))
    exact = -0.5 * (GRAVITY * np.sin(angle) - friction / MASS) * run.time**2
    # the start below the transition speed takes v_t / a more, 1e-6 / 4 s, at speeds up to 4 m/s
    assert np.abs(rail(run) - exact).max() < 2e-6


SPRING, BELT = 100.0, 0.05
"""N/m of the spring that pulls the block of `slip_scene`, m/s of the spring's other end."""


def slip_scene(element: JointFriction) -> Scene:
    """A block that a spring pulls along at a constant speed: it sticks and slips."""
    pull = PD("rail", SPRING, 0.0, target=Polynomial((0.0, BELT)))
    return block(control=(pull,), forces=(element,), duration=6.0, output_period=0.0015)


def periods(run: Trajectory, speed: float) -> np.ndarray:
    """Times between two passages of the block's speed upwards through a value, interpolated, s."""
    found = run.linear_velocity[:, 1, 0] - speed
    before = np.flatnonzero((found[:-1] < 0.0) & (found[1:] >= 0.0))
    step = run.time[before + 1] - run.time[before]
    return np.diff(run.time[before] - step * found[before] / (found[before + 1] - found[before]))


def test_stick_slip_has_the_period_of_its_limit_cycle():
    """A block that sticks until the spring's force exceeds the Coulomb friction by dF, and then slips.

    It sticks for 2 dF / (k V) and slips for 2 (pi - atan(dF w / (k V))) / w, w^2 = k / m, if the friction
    falls at once (equations that are linear piece by piece). The speeds of the regularization lengthen the
    period; the error falls by a third and more where they are halved, to 0.13 % here. The largest friction,
    at the transition speed, is that of the Stribeck curve there.
    """
    coulomb, more = 2.0, 1.0
    w, peak = np.sqrt(SPRING / MASS), more / (1.0 + 0.1**2)
    ratio = peak / (SPRING * BELT)
    exact = 2.0 * ratio + 2.0 / w * (np.pi - np.arctan(ratio * w))
    errors = []
    for transition in (1e-5, 5e-6, 2.5e-6):
        element = JointFriction("rail", coulomb, more, 10.0 * transition, transition)
        run = newton_euler.simulate(slip_scene(element), integrator="Radau", rtol=1e-8, atol=1e-11)
        found = periods(run, 0.5 * BELT)
        assert len(found) == 5
        assert np.ptp(found) < 1e-6  # a limit cycle from the first slip on; outputs every 1.5 ms
        errors.append(found.mean() - exact)
    assert errors[1] < 0.65 * errors[0]
    assert errors[2] < 0.65 * errors[1]
    assert 0.0 < errors[2] < 1.3e-3 * exact


def test_integrators_agree_on_stick_slip():
    """DOP853 and Radau place the switches by different interpolations."""
    scene = slip_scene(JointFriction("rail", 2.0, 1.0, 0.02, 1e-3))
    one, other = (rail(tight(scene, integrator)) for integrator in ADAPTIVE)
    assert np.abs(one - other).max() < 1e-8  # both at rtol 1e-10; the slips magnify errors


def test_steps_end_at_the_switches():
    """The touch at 0.1 s, and the end of half a wave in contact; flags are those of the branch behind it."""
    stiffness, touch = 1e5, 0.1
    scene = block(speed=1.0, forces=(JointStop("rail", "high", touch, stiffness),), duration=0.2)
    code = CompiledScene(scene)
    integrator = Integrator(code, scene.times, Options(rtol=1e-10, atol=1e-12), room=100)
    integrator(code.start)
    steps = integrator.steps[: int(integrator.counts[0])]
    time, flags = steps[:, code.size], steps[:, code.branch_flags]
    leaves = touch + np.pi * np.sqrt(MASS / stiffness)
    assert np.abs(time - touch).min() < 1e-14
    assert np.abs(time - leaves).min() < 1e-11  # errors of the steps in contact
    in_contact = (time > touch - 1e-12) & (time < leaves - 1e-9)
    assert np.array_equal(flags[:, 0], in_contact.astype(float))


@pytest.mark.parametrize("rtol", [1e-6, 1e-10])
def test_switches_save_evaluations(monkeypatch, rtol):
    """Against the same run whose branches the state decides, as in an integrator that knows no switches."""
    stop = JointStop("rail", "high", 0.1, 1e5, dissipation=0.5)
    scene = block(speed=1.0, forces=(stop,), duration=0.2)
    exact = 0.7484349315974165  # of the first test's equation
    found = newton_euler.simulate(scene, rtol=rtol, atol=1e-2 * rtol)
    monkeypatch.setattr(CompiledScene, "branches_at", lambda self, x: {})
    monkeypatch.setattr(CompiledScene, "_identity_of", lambda self, name: None)
    monkeypatch.setattr(records, "switches_of", lambda code, in_lanes: no_switches())
    other = CompiledScene(scene).simulate(rtol=rtol, atol=1e-2 * rtol)
    evaluations = [run.settings["evaluations"] for run in (found, other)]
    errors = [abs(run.linear_velocity[-1, 1, 0] + exact) for run in (found, other)]
    assert evaluations[0] < 0.5 * evaluations[1]
    assert errors[0] < 0.1 * errors[1]


@pytest.mark.parametrize("integrator", ["RK4", "Euler"])
def test_fixed_steps_choose_branches_at_each_evaluation(integrator):
    """The error falls with the square of the step, in which the slope of the force jumps."""
    stop = JointStop("rail", "high", 0.1, 1e4)
    scene = block(speed=1.0, forces=(stop,), duration=0.2)
    errors = [
        abs(newton_euler.simulate(scene, integrator=integrator, step=step).linear_velocity[-1, 1, 0] + 1.0)
        for step in (1e-3, 1e-5)
    ]
    # twice the square of 0.01: the error depends on where the touch falls within a step, too
    assert errors[1] < 2e-4 * errors[0]
    assert errors[1] < 1e-7


def test_lanes_are_bitwise_equal():
    """Runs that touch the stop at other times, or not at all, beside each other."""
    elements = (JointFriction("rail", 1.0, 0.5, 0.05, 1e-3), JointStop("rail", "high", 0.1, 1e5, 0.5))
    scene = block(speed=1.0, forces=elements, duration=0.5, outputs=frozenset({"velocities"}))
    speeds = np.linspace(0.1, 2.0, 11)
    states = [block(speed=float(speed)).initial_state for speed in speeds]
    batch = newton_euler.simulate_batch(scene, states=states)
    for k, state in enumerate(states):
        alone = newton_euler.simulate(replace(scene, initial_state=state))
        assert np.array_equal(batch[k].position, alone.position)
        assert np.array_equal(batch[k].linear_velocity, alone.linear_velocity)


@pytest.mark.parametrize("name", ["stop.limit", "stop.stiffness", "stop.dissipation", "friction.coulomb"])
def test_sensitivities_pass_switches(name):
    """Of the speed behind a stop and friction, beside central differences of runs at rtol 1e-13."""
    elements = (JointFriction("rail", 1.0, 0.5, 0.05, 1e-3), JointStop("rail", "high", 0.1, 1e5, 0.5))
    scene = block(speed=1.0, forces=elements, duration=0.2, outputs=frozenset({"velocities"}))
    parameter = f"rail.{name}".replace(".stop", ".high_stop")
    by = newton_euler.sensitivities(scene, [parameter], rtol=1e-11, atol=1e-13)
    assert by.linear_velocity is not None
    value = float(parameter_values(scene, [parameter])[parameter])
    step = 1e-4 * value
    ends = [
        newton_euler.simulate(
            newton_euler.with_parameters(scene, {parameter: value + sign * step}), rtol=1e-13, atol=1e-15
        ).linear_velocity[-1, 1, 0]
        for sign in (1.0, -1.0)
    ]
    difference = (ends[0] - ends[1]) / (2.0 * step)
    assert by.linear_velocity[-1, 1, 0, 0] == pytest.approx(difference, rel=1e-6)  # step^2 of differences


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: JointFriction("rail", -1.0), "coulomb"),
        (lambda: JointFriction("rail", 1.0, transition_speed=0.0), "transition_speed"),
        (lambda: JointFriction("rail", 1.0, stribeck_speed=-1.0), "stribeck_speed"),
        (lambda: JointStop("rail", "up", 0.0, 1.0), "side"),
        (lambda: JointStop("rail", "low", np.nan, 1.0), "limit"),
        (lambda: JointStop("rail", "low", 0.0, -1.0), "stiffness"),
    ],
)
def test_impossible_elements_are_refused(make, field):
    with pytest.raises(MechanismError) as caught:
        make()
    assert "rail" in str(caught.value)
    assert f"{field} is" in str(caught.value)


def test_one_friction_and_one_stop_a_side():
    stop = JointStop("rail", "low", 0.0, 1.0)
    block(forces=(stop, JointStop("rail", "high", 0.0, 1.0), JointFriction("rail", 1.0)))
    with pytest.raises(MechanismError, match="low stop"):
        block(forces=(stop, JointStop("rail", "low", 1.0, 1.0)))


def test_hundreds_of_runs_that_begin_at_a_stop():
    """Each begins with a switch that makes no progress; such switches of different runs do not add up."""
    stop = JointStop("rail", "low", 0.0, 1e5, 2.0)
    scene = block(0.5 * np.pi, forces=(stop,), outputs=frozenset({"velocities"}), output_period=1.0)
    batch = newton_euler.simulate_batch(
        scene, parameters={"block.mass": np.linspace(1.9, 2.1, 240)}, threads=1
    )
    ends = np.array([rail(run)[-1] for run in batch])
    # they rest on the stop, m g / k deep
    assert np.abs(ends + np.linspace(1.9, 2.1, 240) * GRAVITY / 1e5).max() < 1e-6


@pytest.mark.parametrize("integrator", ["RK4", "Euler"])
def test_mujoco_counts_the_work_of_stops(integrator):
    """The energy lost in a stop, at the order of the integrator."""
    stop = JointStop("rail", "high", 0.05, 2e4, dissipation=0.5)
    scene = block(speed=1.0, forces=(stop,), duration=0.2)
    run = mjcf.simulate(scene, timestep=1e-3, integrator=integrator)
    lost = run.kinetic_energy[-1] - run.kinetic_energy[0]
    assert run.work[-1] == pytest.approx(lost, abs=5e-3 * abs(lost))


def test_a_stop_acts_beside_a_singular_configuration():
    """A slider-crank of equal bars is singular with the crank upright; the stop begins 0.01 rad before it."""
    crank_angle = np.pi / 3.0
    tip = np.array([np.cos(crank_angle), 0.0, np.sin(crank_angle)])
    foot = np.array([2.0 * tip[0], 0.0, 0.0])
    centers = {"crank": 0.5 * tip, "coupler": 0.5 * (tip + foot), "slider": foot}
    bodies = [Body(name, 1.0, center, 0.1 * np.eye(3)) for name, center in centers.items()]
    hinge = {"axis": [0.0, -1.0, 0.0]}
    joints = [
        Revolute("a", "ground", "crank", np.zeros(3), **hinge),
        Revolute("b", "crank", "coupler", tip, **hinge),
        Revolute("c", "coupler", "slider", foot, **hinge),
        Prismatic("d", "ground", "slider", foot, axis=[1.0, 0.0, 0.0]),
    ]
    stop = JointStop("a", "high", 0.5 * np.pi - crank_angle - 0.01, 1e5)
    scene = Scene("upright", Mechanism([Body.ground(), *bodies], joints), 1.2, 0.05, forces=(stop,))
    scene = newton_euler.start(scene, a=(0.0, 1.0))
    runs = [newton_euler.simulate(scene, integrator=integrator) for integrator in ADAPTIVE]
    energy = [run.kinetic_energy + run.potential_energy for run in runs]
    for each in energy:
        assert np.ptp(each) < 1e-6 * each[0]  # steps near a singular configuration have wider tolerances
    assert np.abs(runs[0].position[-1] - runs[1].position[-1]).max() < 1e-6
    assert runs[0].joint("a").rates[-1, 0] == pytest.approx(-1.0306535, abs=1e-5)  # RK4 at 0.1 ms
