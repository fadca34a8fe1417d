"""Exudyn as an engine: equations and runs against newton_euler's and closed forms, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from elements import COUPLED, ELEMENTS
from engine_equations import checks_of, failures
from mechanisms import GRAVITY, bar, pendulum, spinning_top
from overconstrained import centers, linkage

pytest.importorskip("exudyn")

import exudyn

from crosscheck.engines.applied import coordinate_load
from crosscheck.engines.exudyn import ENGINE, MAX_HALVINGS
from crosscheck.engines.exudyn import model as adapter
from crosscheck.engines.exudyn.equations import ExudynSystem
from crosscheck.engines.exudyn.run import Run, integrals
from crosscheck.engines.exudyn.running import IndependentRows, RunningSystem
from crosscheck.engines.exudyn.simulate import simulate
from crosscheck.engines.limits import CannotExpressError
from crosscheck.engines.registry import choose
from crosscheck.library import SCENES, load
from crosscheck.studies.conformance_tests import EngineConformance
from crosscheck.studies.random_scenes import random_scene
from crosscheck.studies.stress.noise import MECHANISMS, NOISE_SENSITIVITY
from newton_euler import simulate as reference
from newton_euler.equations.redundancy import constraint_rank, rows_left_out
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.errors import OptionError, SingularityError, UnknownNameError
from newton_euler.model.armatures import Armature, BallArmature
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.digital_control import Digital, Sampled
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Prismatic, Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.splines import Steps
from newton_euler.model.trajectory import IntegrationError, distance
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state

FAST_SCENES = (
    *("bricard", "four_bar", "heavy_top", "stewart"),
    *("tracker", "tracker_computed_torque", "tracker_on_boat"),
)
"""Scenes of the library whose equations are compared in the fast tests."""

FAST_ELEMENTS = ("planar", "rods", "screw", "gear, cut", "motions of a tree", "friction and stops")
"""Elements whose equations are compared in the fast tests."""


@pytest.mark.slow  # CI runs `crosscheck engine-check` with this engine, too
class TestContract(EngineConformance):
    engine = ENGINE


def apart(scene, **settings):
    """Return how far a run is from newton_euler's, m or rad, and both runs."""
    run, exact = simulate(scene, **settings), reference(scene, rtol=1e-11, atol=1e-13)
    return distance(run, exact), run, exact


def errors_at(scene, *steps):
    """Return how far runs at some steps, s, are from newton_euler's, m or rad."""
    exact = reference(scene, rtol=1e-11, atol=1e-13)
    return [distance(simulate(scene, step=step), exact) for step in steps]


@pytest.mark.parametrize("name", FAST_SCENES)
def test_equations(name):
    scene = load(name)
    assert failures(scene, ExudynSystem(scene)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SCENES.keys() - set(FAST_SCENES)))
def test_equations_of_the_other_scenes(name):
    scene = load(name)
    assert failures(scene, ExudynSystem(scene)) == []


@pytest.mark.parametrize("name", FAST_ELEMENTS)
def test_equations_of_elements(name):
    scene = ELEMENTS[name]
    assert failures(scene, ExudynSystem(scene)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [*ELEMENTS, *COUPLED])
def test_equations_of_the_other_elements(name):
    scene = (ELEMENTS | COUPLED)[name]
    if ENGINE.limits(scene):
        with pytest.raises(CannotExpressError):
            ExudynSystem(scene)
    else:
        assert failures(scene, ExudynSystem(scene)) == []


def test_a_state_that_is_not_finite_is_attributed_to_no_joint():
    system = ExudynSystem(pendulum())
    q, _ = system.coordinates(initial_state(system.scene))
    with pytest.raises(SingularityError) as caught:
        system.acceleration(q, np.full(system.nv, np.nan))
    assert caught.value.joint is None


def test_the_potential_energy_is_that_of_exudyns_masses_and_gravity():
    system = ExudynSystem(pendulum(angle=0.3))
    mbs, (_, rod), (load,) = system.model.mbs, system.model.bodies, system.model.weights
    at_start = system.coordinates(initial_state(system.scene))
    right = system.observe(*at_start).potential_energy
    assert right == pytest.approx(-1.0 * 9.81 * 0.5 * np.cos(0.3))  # -m g h of a rod of 1 kg and 1 m
    mbs.SetObjectParameter(rod, "mass", 3.0)
    assert system.observe(*at_start).potential_energy == pytest.approx(3.0 * right)
    mbs.SetLoadParameter(load, "loadVector", [0.0, 0.0, -1.62])
    assert system.observe(*at_start).potential_energy == pytest.approx(3.0 * right * 1.62 / 9.81)


def compound(**motions) -> Scene:
    """A bar with several motions relative to the ground in one joint."""
    joint = Compound("joint", "ground", "bar", np.zeros(3), **motions)
    mechanism = Mechanism([Body.ground(), bar("bar", [0.0, 0.1, 0.0], [0.4, 0.2, 0.1])], [joint])
    return Scene("compound", mechanism, 0.1, 0.05, GRAVITY)


@pytest.mark.parametrize(
    "motions",
    [
        {"slides": [[1, 0, 0.2]], "hinges": [[0, 1, 0], [0.6, 0, 0.8]]},
        {"slides": [[1, 0, 0.2], [0.3, 1, 0]], "hinges": [[0, 0.6, 0.8]]},
        {"slides": np.eye(3), "hinges": [[0, 1, 0], [1, 0.3, 0], [0, 0.2, 1]]},
        {"hinges": [[0, 1, 0], [1, 0.3, 0], [0, 0.2, 1]]},
        {"slides": [[1, 0, 0.2]], "ball": True},
    ],
)
def test_compound_joints_are_two_generic_joints(motions):
    scene = compound(**motions)
    assert failures(scene, ExudynSystem(scene)) == []


def with_rotors() -> Scene:
    """The tree of slides with a rotor on a slide and one on a hinge."""
    scene = ELEMENTS["screw"]
    labels = scene.mechanism.coordinate_labels
    slide = next(key for key in labels if scene.mechanism.is_slide(*key))
    hinge = next(key for key in labels if not scene.mechanism.is_slide(*key))
    rotors = (Armature(slide[0], 0.7, slide[1]), Armature(hinge[0], 0.02, hinge[1]))
    return replace(scene, armatures=rotors)


def test_rotors():
    scene = with_rotors()
    assert failures(scene, ExudynSystem(scene)) == []
    coarse, fine = errors_at(scene, 4e-3, 2e-3)
    assert fine < 5e-5
    assert coarse / fine == pytest.approx(4.0, abs=0.4)


def oscillator() -> Scene:
    """A mass of 2 kg on a slide with a spring of 50 N/m: x = 0.1 cos(5 t)."""
    slide = Prismatic("slide", "ground", "mass", np.zeros(3), axis=[1.0, 0.0, 0.0])
    mass = Body("mass", 2.0, np.zeros(3), 0.01 * np.eye(3))
    mechanism = Mechanism([Body.ground(), mass], [slide])
    return Scene("oscillator", mechanism, 2.0, 0.1, forces=(JointSpring("slide", 50.0, rest=0.1),))


@pytest.mark.parametrize("integrator", ["generalized_alpha", "trapezoidal"])
def test_runs_are_of_order_two(integrator):
    scene = oscillator()
    errors = []
    for step in (0.02, 0.01, 0.005):
        run = simulate(scene, integrator, step)
        errors.append(np.max(np.abs(run.position[:, 1, 0] - 0.1 * (1.0 - np.cos(5.0 * run.time)))))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.1)


OVERCONSTRAINED = {
    **{name: build(0.0) for name, build in MECHANISMS.items()},
    **{name: linkage(name) for name in ("bennett", "goldberg", "myard", "schatz")},
    "four_bar": load("four_bar"),
}
"""Loops with redundant constraints, exact in their dimensions."""


def constraint_rows(system, state) -> np.ndarray:
    """Dimensionless constraint rows of a system at a state."""
    return dimensionless_jacobian(system, system.coordinates(state)[0])


@pytest.mark.parametrize("name", OVERCONSTRAINED)
def test_rows_in_use_are_independent_and_imply_all(name):
    """At the start and at moved states, for which models are made as a run makes them."""
    scene = OVERCONSTRAINED[name]
    whole, chosen = ExudynSystem(scene), IndependentRows(scene)
    for state in (initial_state(scene), *random_states(scene, 2)):
        chosen.exchange(whole.coordinates(state)[0])
        rows = constraint_rows(RunningSystem(scene, chosen.left_out), state)
        assert len(rows) == constraint_rank(whole) < len(whole.row_numbers)
        assert np.linalg.svd(rows, compute_uv=False)[-1] > 0.01
        # the part of all rows that those in use do not span
        every = constraint_rows(whole, state)
        span = np.linalg.svd(rows, full_matrices=False)[2]
        assert np.max(np.abs(every - every @ span.T @ span)) < 1e-9


@pytest.mark.parametrize("name", ["planar", "point on line", "screw", "slide of two points, fixed post"])
def test_joints_of_one_equation_allow_the_motions_of_the_whole_joint(name):
    scene = (ELEMENTS | COUPLED)[name]
    whole, divided = ExudynSystem(scene), ExudynSystem(scene, divided=True)
    assert len(whole.row_numbers) == len(divided.row_numbers)
    for state in random_states(scene, 2):
        rows = constraint_rows(divided, state)
        both = np.vstack([constraint_rows(whole, state), rows])
        assert np.linalg.matrix_rank(both, 1e-9) == np.linalg.matrix_rank(rows, 1e-9) == len(rows)


@pytest.mark.parametrize("noise", [0.0, 1e-6])
@pytest.mark.parametrize(("name", "error"), [("flat_four_bar", 1e-5), ("sarrus", 1e-5), ("bricard", 1e-6)])
@pytest.mark.filterwarnings("ignore::newton_euler.errors.NearlyRedundantWarning")
def test_runs_of_overconstrained_loops(name, error, noise):
    run = simulate(MECHANISMS[name](noise))
    design = reference(MECHANISMS[name](0.0), rtol=1e-11, atol=1e-13)
    assert distance(run, design) < error + NOISE_SENSITIVITY * noise
    assert np.max(run.constraint_violation) < 1e-9 + 10.0 * noise


@pytest.mark.parametrize(
    ("name", "duration"), [("goldberg", 0.6), pytest.param("bennett", 1.2, marks=pytest.mark.slow)]
)
def test_large_motions_exchange_the_rows_in_use(name, duration):
    """Loops that stop with the rows of the start, against centers of mass from exponentials of screws."""
    scene = replace(linkage(name), duration=duration)
    exact = centers(name)[: len(scene.times)]
    coarse, fine = (
        np.max(np.abs(simulate(scene, step=step).position[:, 1:] - exact)) for step in (1e-3, 5e-4)
    )
    assert fine < 1e-4
    assert coarse / fine == pytest.approx(4.0, abs=0.5)


def test_a_model_without_redundant_rows_leaves_out_no_more():
    scene = MECHANISMS["flat_four_bar"](1e-6)
    whole = ExudynSystem(scene)
    assert len(rows_left_out(whole)) == len(whole.row_numbers) - constraint_rank(whole)
    assert rows_left_out(RunningSystem(scene, IndependentRows(scene).left_out)) == []


def test_reactions_are_the_multipliers_of_the_run():
    _, run, exact = apart(replace(load("tracker"), duration=0.3), step=2e-3)
    for name in ("reaction_force", "reaction_torque", "actuator_force", "work"):
        found, needed = getattr(run, name), getattr(exact, name)
        assert np.max(np.abs(found - needed)) < 2e-3 * np.max(np.abs(needed)), name


def test_angles_of_springs_count_revolutions():
    hinge = Revolute("hinge", "ground", "disc", np.zeros(3), axis=[0.0, 0.3, 1.0], actuated=True)
    mechanism = Mechanism([Body.ground(), Body("disc", 1.0, np.zeros(3), 0.1 * np.eye(3))], [hinge])
    wound = Scene("wound", mechanism, 3.0, 0.1, forces=(JointSpring("hinge", 0.1, 0.005, rest=20.0),))
    driven = replace(wound, forces=(), control=(PD("hinge", 0.1, 0.005, Sine(15.0, 0.8)),))
    for scene in (wound, driven):
        error, run, exact = apart(scene)
        assert np.ptp(exact.joint_angle) > 4.0 * np.pi
        np.testing.assert_allclose(run.joint_angle, exact.joint_angle, atol=1e-3)
        np.testing.assert_allclose(run.potential_energy, exact.potential_energy, atol=1e-3)
        assert error < 1e-3


def driven_swing(law) -> Scene:
    """A bar on a hinge with a control law."""
    hinge = Revolute("hinge", "ground", "bar", np.zeros(3), axis=[0.0, 1.0, 0.2], actuated=True)
    mechanism = Mechanism([Body.ground(), bar("bar", [0.0, 0.0, 0.0], [0.4, 0.1, 0.0])], [hinge])
    return Scene("driven_swing", mechanism, 0.5, 0.1, GRAVITY, control=(law,))


@pytest.mark.parametrize(
    "law",
    [
        Digital(PD("hinge", 8.0, 0.5, 0.6), period=0.03, delay=1),
        Sampled("hinge", lambda time, x, rate: 3.0 * np.cos(7.0 * time) - x[0] - 0.2 * rate[0], period=0.025),
        PD("hinge", 8.0, 0.5, Steps((0.0, 0.17, 0.33), (0.3, -0.4, 0.5))),
    ],
)
def test_controllers_in_discrete_time_and_jumps(law):
    scene = driven_swing(law)
    coarse, fine = errors_at(scene, 2e-3, 1e-3)
    assert fine < 5e-5
    assert coarse / fine == pytest.approx(4.0, abs=0.5)
    _, run, exact = apart(scene)
    for name in ("actuator_force", "reaction_torque", "work"):
        found, needed = getattr(run, name), getattr(exact, name)
        assert np.max(np.abs(found - needed)) < 5e-3 * np.max(np.abs(needed)), name


@pytest.mark.parametrize(
    "law",
    [
        PD("hinge", 8.0, 0.5, Sine(0.3, 5.0), gravity_compensation=True),
        pytest.param(
            ComputedTorque("hinge", 60.0, 15.0, Sine(0.3, 5.0), model={"bar.mass": 0.8}),
            marks=pytest.mark.slow,
        ),
        StateFeedback("hinge", {"hinge": (8.0, 0.5)}, target=Sine(0.3, 5.0)),
    ],
)
def test_laws_that_exudyn_does_not_have(law):
    scene = driven_swing(law)
    assert failures(scene, ExudynSystem(scene)) == []
    coarse, fine = errors_at(scene, 1e-2, 5e-3)
    assert fine < 1e-3
    assert coarse / fine == pytest.approx(4.0, abs=0.6)


def test_work_of_prescribed_motions():
    scene = ELEMENTS["motions of a tree"]
    _, run, exact = apart(scene, step=4e-3)
    np.testing.assert_allclose(run.work, exact.work, atol=1e-3 * np.max(np.abs(exact.work)))


def test_a_run_that_stops_has_its_outputs():
    def controller(time, x, rate):
        if time > 0.25:
            raise ValueError("no more")
        return 0.0

    with pytest.raises(IntegrationError, match="no more") as caught:
        simulate(driven_swing(Sampled("hinge", controller, period=0.05)))
    assert caught.value.partial is not None
    np.testing.assert_allclose(caught.value.partial.time, [0.0, 0.1, 0.2])


@pytest.mark.parametrize("time", [0.0, 0.25])
def test_singular_equations_at_a_sample_stop_the_run_there(time, monkeypatch):
    solve, starts = RunningSystem.solve, []

    def singular(system, q, v):
        starts.extend([0.0] * (system.time == 0.0))
        if system.time >= time:
            raise SingularityError("hinge", "planted")
        return solve(system, q, v)

    monkeypatch.setattr(RunningSystem, "solve", singular)
    law = Sampled("hinge", lambda time, x, rate: 0.0, period=0.05)
    with pytest.raises(IntegrationError) as caught:
        ENGINE.simulate(driven_swing(law))
    assert len(starts) == (MAX_HALVINGS + 1 if time else 1)  # no step mends a start
    assert caught.value.time == pytest.approx(time)
    assert "planted" in caught.value.reason
    if time:
        assert caught.value.partial is not None
        np.testing.assert_allclose(caught.value.partial.time, [0.0, 0.1, 0.2])
    else:
        assert caught.value.partial is None


def test_newton_iterations_that_do_not_converge(capfd):
    with pytest.raises(IntegrationError) as caught:
        simulate(load("andrews"), step=5e-3)
    assert "\n" not in str(caught.value)
    assert 0.01 < caught.value.time < 0.05
    # the step, which is that of the outputs; what Exudyn reported; and a remedy
    for part in ("a step of 0.001 s", "reduction of step size", "use a step shorter than 0.001 s"):
        assert part in caught.value.reason
    assert caught.value.partial is not None
    assert caught.value.partial.time[-1] <= caught.value.time
    assert capfd.readouterr() == ("", "")


def test_singular_equations_of_the_solver_are_reported(monkeypatch):
    """A run with all rows of an overconstrained suspension, which Exudyn's solver cannot have."""
    monkeypatch.setattr(IndependentRows, "__init__", lambda rows, scene: setattr(rows, "left_out", []))
    scene = MECHANISMS["double_wishbone"](0.0)
    with pytest.raises(IntegrationError) as caught:
        simulate(scene)
    assert caught.value.time == 0.0
    for part in ("a step of 0.001 s", "Jacobian singular", "use a step shorter than 0.001 s"):
        assert part in caught.value.reason


def follower() -> Scene:
    """A bar whose control law is evaluated in Python, because its set-point is a function of time."""
    return driven_swing(PD("hinge", 8.0, 0.5, Sine(0.6, 1.0)))


def raise_in_forces(monkeypatch, error, after=0.0) -> None:
    """Raise an error in the Python functions of forces that Exudyn calls from a time, s, on."""

    def load(element, motions, time, given):
        if time >= after:
            raise error
        return coordinate_load(element, motions, time, given)

    monkeypatch.setattr(adapter, "coordinate_load", load)


@pytest.fixture
def runs(monkeypatch) -> list[Run]:
    """Collect the runs of Exudyn's solver."""
    found, start = [], Run.__init__

    def recorded(run, *arguments):
        found.append(run)
        start(run, *arguments)

    monkeypatch.setattr(Run, "__init__", recorded)
    return found


def test_other_errors_of_forces_stop_the_run(monkeypatch, runs):
    raise_in_forces(monkeypatch, ValueError("no power"), after=0.2005)
    with pytest.raises(IntegrationError) as caught:
        ENGINE.simulate(follower())
    assert caught.value.time == pytest.approx(0.2)
    for part in ("ValueError: no power", "an error of Exudyn or of its adapter"):
        assert part in caught.value.reason
    assert caught.value.partial is not None
    np.testing.assert_allclose(caught.value.partial.time, [0.0, 0.1, 0.2])
    assert len(runs) == 1  # a shorter step cannot help


@pytest.mark.parametrize("after", [0.0, 0.2])
def test_an_interrupt_within_a_force_stays_an_interrupt(after, monkeypatch, runs):
    raise_in_forces(monkeypatch, KeyboardInterrupt(), after)
    with pytest.raises(KeyboardInterrupt):
        ENGINE.simulate(follower())
    assert len(runs) == 1


def test_an_interrupt_after_a_step_stays_an_interrupt(monkeypatch):
    def interrupted(system, multipliers):
        if system.time > 0.2:
            raise KeyboardInterrupt
        return 0.0

    monkeypatch.setattr(RunningSystem, "power", interrupted)
    with pytest.raises(KeyboardInterrupt):
        simulate(driven_swing(PD("hinge", 8.0, 0.5, 0.6)))


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SingularityError("hinge", "planted")])
def test_errors_of_forces_in_the_equations_stay_themselves(error, monkeypatch):
    raise_in_forces(monkeypatch, error)
    system = ExudynSystem(follower())
    with pytest.raises(type(error)) as caught:
        system.acceleration(*system.coordinates(initial_state(system.scene)))
    assert caught.value is error
    chain = list[BaseException | None]([error])
    while chain[-1] is not None:  # as `short_of_memory` follows causes
        chain.append(chain[-1].__cause__ or chain[-1].__context__)
        assert len(chain) < 10


@pytest.mark.parametrize("error", [SingularityError("hinge", "planted"), OverflowError("planted")])
def test_iterates_without_forces_are_avoided_by_shorter_steps(error, monkeypatch, runs):
    """A force that has no value at the iterates of the first run only."""

    def load(element, motions, time, given):
        if time > 0.2 and len(runs) == 1:
            raise error
        return coordinate_load(element, motions, time, given)

    monkeypatch.setattr(adapter, "coordinate_load", load)
    run = ENGINE.simulate(follower())
    assert run.settings["step"] <= 0.5e-3
    assert len(run.time) == len(follower().times)
    assert len(runs) >= 2


def test_a_controller_that_fails_is_not_called_in_further_runs(runs):
    calls = []

    def controller(time, x, rate):
        calls.append(time)
        raise ValueError("no more")

    with pytest.raises(IntegrationError, match="no more"):
        ENGINE.simulate(driven_swing(Sampled("hinge", controller, period=0.05)))
    assert calls == [0.0]
    assert len(runs) == 1


def test_work_is_integrated_with_order_four():
    errors = []
    for count in (50, 100):
        times = np.linspace(0.0, 2.0, count + 1)
        errors.append(np.max(np.abs(integrals(times, np.cos(3.0 * times)) - np.sin(3.0 * times) / 3.0)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.2)
    np.testing.assert_allclose(integrals(np.array([0.0, 0.5]), np.array([1.0, 3.0])), [0.0, 1.0])
    np.testing.assert_allclose(integrals(np.zeros(1), np.ones(1)), [0.0])


def test_runs_print_nothing_and_leave_the_settings_of_messages(capfd):
    ENGINE.simulate(replace(load("four_bar"), duration=0.1))
    with pytest.raises(IntegrationError):
        simulate(load("andrews"), step=5e-3)
    assert capfd.readouterr() == ("", "")
    # Exudyn's defaults, on which models depend that the user builds in Exudyn
    assert exudyn.config.printToConsole
    assert not exudyn.config.suppressWarnings


def test_an_unequal_last_interval():
    scene = replace(pendulum(), duration=0.53, output_period=0.1)
    error, run, _ = apart(scene)
    assert run.time[-1] == 0.53
    assert error < 2e-5


@pytest.mark.parametrize("step", [0.0, -1.0, np.inf, np.nan, 1e-12])
def test_impossible_steps(step):
    with pytest.raises(OptionError):
        simulate(pendulum(), step=step)


def test_unknown_integrator():
    with pytest.raises(UnknownNameError):
        simulate(pendulum(), "RK4")


@pytest.mark.parametrize(
    ("scene", "element"),
    [
        (ELEMENTS["parallel hinges"], "parallel_hinges joint 'root'"),
        (ELEMENTS["friction of loaded joints"], "friction of joint 'spindle'"),
        (compound(hinges=[[0, 1, 0], [1, 1, 0]]), "compound joint 'joint'"),
        (compound(hinges=np.eye(3)[:2], offsets=[[0, 0, 0.1]]), "compound joint 'joint'"),
        (
            replace(spinning_top(), armatures=(BallArmature("tip", 0.1),)),
            "armature of the ball of joint 'tip'",
        ),
    ],
)
def test_limits_are_what_is_refused(scene, element):
    assert element in [limit.element for limit in ENGINE.limits(scene)]
    for use in (ENGINE.simulate, ENGINE.systems):
        with pytest.raises(CannotExpressError) as caught:
            use(scene)
        assert caught.value.limits == tuple(ENGINE.limits(scene))


def test_a_moved_anchor_is_found():
    scene = load("four_bar")
    closing = scene.mechanism.joint_names[-1]
    system = ENGINE.with_moved_anchor(scene, closing, np.array([0.0, 0.0, 1e-3]))
    assert ("model", "joint points, m") in failures(scene, system)


def test_the_default_step_is_halved_for_fast_machines():
    run = ENGINE.simulate(replace(load("heavy_top"), duration=0.5))
    refined = ENGINE.refined(replace(load("heavy_top"), duration=0.5))
    assert run.settings["step"] <= 1e-3
    assert refined.settings["step"] == pytest.approx(0.5 * run.settings["step"])


def test_the_registry_has_the_engine():
    assert choose(["exudyn"]) == [ENGINE]


def test_benchmarks():
    scene = replace(load("pendulum"), duration=0.2)
    (load_scene,) = ENGINE.benchmarks().models(scene).values()
    model = load_scene()
    exact = reference(scene)
    for ladder in model.ladders:
        assert 6 <= len(ladder.numbers) <= 10
        errors = []
        for number in (1, 10):
            _, options = ladder.setting(number)
            run = model.run(options)
            position, quaternion = run.poses()
            assert quaternion.shape == exact.quaternion.shape
            assert run.evaluations == 20 * number
            errors.append(np.max(np.abs(position - exact.position)))
        assert errors[1] < 1e-5
        assert errors[0] / errors[1] == pytest.approx(100.0, rel=0.2)  # order 2


def test_a_benchmark_of_a_run_that_stops_is_an_error():
    (load_scene,) = ENGINE.benchmarks().models(load("andrews")).values()
    with pytest.raises(IntegrationError):
        load_scene().run({"step": 1e-3, "integrator": "generalized_alpha"})


def test_settings_of_stress_tests():
    stress, scene = ENGINE.stress(), replace(pendulum(), duration=0.1)
    of_long_runs = [
        each for by_duration in stress.long_runs.values() for of in by_duration.values() for each in of
    ]
    settings = [*stress.typical, *sum(stress.topics.values(), ()), *stress.stepped, *of_long_runs]
    for options in settings:
        assert ENGINE.simulate(scene, options).settings["integrator"] == options["integrator"]


@pytest.mark.parametrize("number", [102, 246])
def test_accelerations_of_short_rods(number):
    """Rods of 0.13 to 0.33 of the mechanism's size, whose directions change fast, against newton_euler's."""
    scene = random_scene(4711, number)
    checks = checks_of(scene, ExudynSystem(scene), others=0)
    worst = max(check.value for check in checks if "acceleration, rel" in check.quantity)
    assert worst < 1e-10  # it was 5e-6 and 2.6e-5 with ten times the step
