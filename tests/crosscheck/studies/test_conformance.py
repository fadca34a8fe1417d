"""The contract of an engine: default engines follow it, and a wrong one is found at the point it breaks."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from command_line import run
from contract_points import PAGE, sections, sections_of_page

from crosscheck.engines.engine import NO_SETTINGS, Engine
from crosscheck.engines.limits import CannotExpressError, Limit
from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.studies.conformance import element_scenes, scenes
from crosscheck.studies.conformance.candidate import Candidate
from crosscheck.studies.conformance.check import (
    POINTS,
    REQUIRED,
    Result,
    check_engine,
    check_point,
    exit_status,
    explained,
)
from crosscheck.studies.conformance.closed_forms import (
    braked_motion,
    flight,
    guided_motion,
    jump_response,
    rotor_slide,
    sampled_motion,
    slide,
    spring_response,
    steady_turn,
)
from crosscheck.studies.conformance.differences import first_difference
from crosscheck.studies.conformance_tests import EngineConformance
from crosscheck.studies.faults import injection
from newton_euler.equations.system import System
from newton_euler.errors import NewtonEulerError
from newton_euler.limits import changed as limits_changed
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Sampled
from newton_euler.model.euler_parameters import conjugate, product, rotation, rotations
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import ELEMENT_KINDS
from newton_euler.model.splines import Steps
from newton_euler.model.trajectory import IntegrationError, StoppedError, Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate


class TestMujoco(EngineConformance):
    engine = ENGINES["mujoco"]


class TestPinocchio(EngineConformance):
    engine = ENGINES["pinocchio"]


class TestNewtonEuler(EngineConformance):
    engine = SOLVER


@pytest.mark.parametrize(
    ("scene", "closed_form"),
    [
        (scenes.sliding, slide),
        (scenes.backward_slide, slide),
        (scenes.conical, steady_turn),
        (scenes.floating, flight),
        (scenes.jumping, jump_response),
        (scenes.sampled, sampled_motion),
        (element_scenes.sprung_slide, spring_response),
        (element_scenes.braked_slide, braked_motion),
        (element_scenes.guided_slide, guided_motion),
        (element_scenes.armed_slide, rotor_slide),
    ],
)
def test_closed_forms_are_exact(scene, closed_form):
    # DOP853 at a relative tolerance of 1e-12 per step, some tens of steps
    assert first_difference(simulate(scene(), rtol=1e-12, atol=1e-14), closed_form(scene()), 1e-11) == ""


def test_scenes_have_names_of_their_own():
    names = [construct().name for construct in (*element_scenes.SCENES, scenes.stopping)]
    assert len(set(names)) == len(names)


def test_each_kind_of_force_motion_and_rotor_is_in_a_scene():
    found = [construct() for construct in element_scenes.SCENES]
    elements = {type(each) for scene in found for each in (*scene.forces, *scene.motions, *scene.armatures)}
    kinds = {kind for name in ("forces", "motions", "armatures") for kind in ELEMENT_KINDS[name]}
    assert elements == kinds


@cache
def right(scene) -> Trajectory:
    """Newton_euler's run of a scene, which the tests share: scenes are constants."""
    return SOLVER.simulate(scene)


@cache
def equations(scene) -> tuple[System, ...]:
    """Newton_euler's equations of a scene in one formulation, which the tests share."""
    return SOLVER.systems(scene)[:1]


def simulating(function: Callable, with_settings: Callable = SOLVER.simulate) -> Engine:
    """Newton_euler with another function for runs without settings, and for those with settings."""

    def simulated(scene, settings=NO_SETTINGS):
        return with_settings(scene, settings) if settings else function(scene)

    return replace(SOLVER, name="wrong", simulate=simulated, systems=equations)


BASE = simulating(right)
"""Newton_euler with runs that the tests share."""


def changing(change: Callable[[Trajectory], Trajectory], *names: str) -> Engine:
    """Newton_euler with changed runs of the scenes with some names, or of all scenes with all outputs."""

    def changed(scene):
        found = right(scene)
        return change(found) if scene.name in names or (not names and scene.outputs) else found

    return simulating(changed)


def replacing(name: str, change: Callable) -> Engine:
    """Newton_euler with the run of another scene in place of a scene with a name."""
    return simulating(lambda scene: right(change(scene) if scene.name == name else scene))


def arrays(**changes: Callable[[np.ndarray], np.ndarray]) -> Callable[[Trajectory], Trajectory]:
    """A change of arrays of a run by name."""
    return lambda found: replace(
        found, **{name: change(getattr(found, name)) for name, change in changes.items()}
    )


def at_first_row(values):
    changed = values.copy()
    changed[0] = 0.0
    return changed


def in_body_frame(found):
    force = [[rotation(q[1]).T @ f[0]] for q, f in zip(found.quaternion, found.reaction_force, strict=True)]
    return replace(found, reaction_force=np.array(force))


def about_center(found):
    arm = np.zeros_like(found.reaction_torque)
    arm[:, 0] = np.array([0.1, 0.0, 0.1]) - found.position[:, 1]
    return replace(found, reaction_torque=found.reaction_torque + np.cross(arm, found.reaction_force))


def with_drives(found):
    torque = found.reaction_torque.copy()
    torque[:, 0] += found.actuator_force
    return replace(found, reaction_torque=torque)


def about_first_point(found):
    """Torques about the point of the ground, from which the point of the sliding body parts."""
    way = np.zeros_like(found.reaction_torque)
    way[:, 0] = found.position[:, 1] - found.position[0, 1]
    return replace(found, reaction_torque=found.reaction_torque + np.cross(way, found.reaction_force))


def in_body(name: str) -> Callable[[Trajectory], Trajectory]:
    """A change of velocities from the world frame to the frames of the bodies."""

    def turned(found):
        velocity = np.einsum("nbji,nbj->nbi", rotations(found.quaternion), getattr(found, name))
        return replace(found, **{name: velocity})

    return turned


def turned_in_the_world(found):
    """Orientations with the factors of the rotation since the start and the initial rotation exchanged."""
    turned = found.quaternion.copy()
    for row in turned:
        for body, start in enumerate(found.quaternion[0]):
            row[body] = product(start, product(row[body], conjugate(start)))
    return replace(found, quaternion=turned)


def with_parts(scene, joints, couplings):
    return replace(scene, mechanism=Mechanism(scene.mechanism.bodies, joints, couplings))


def without_loops(scene):
    tree = scene.mechanism.joints[: len(scene.mechanism.bodies) - 1]
    return with_parts(scene, tree, scene.mechanism.couplings)


def with_set_points(*steps):
    """A change of the set-points of the jumping law."""

    def changed(scene):
        law = PD("slide", scenes.SLIDE_STIFFNESS, scenes.SLIDE_DAMPING, Steps(*steps))
        return replace(scene, control=(law,))

    return changed


def a_period_late(scene):
    """A change of a sampled controller: its force acts one period late."""
    forces = [0.0]

    def late(time, x, x_rate):
        if time == 0.0:
            forces[:] = [0.0]
        forces.append(scenes.sampled_force(time, x[0], x_rate[0]))
        return forces[-2]

    return replace(scene, control=(Sampled("slide", late, scenes.SAMPLING_PERIOD),))


def stopping(change: Callable[[StoppedError], Exception]) -> Engine:
    """Newton_euler with other errors of runs that stop."""

    def simulated(scene):
        try:
            return right(scene)
        except StoppedError as error:
            raise change(error) from error

    return simulating(simulated)


def with_partial(partial: Callable[[Trajectory], Trajectory | None], time: float = scenes.FAILURE_TIME):
    """A change of the partial run, and of the time, of an error of a run that stops."""

    def changed(error):
        other = IntegrationError(time, error.reason)
        other.partial = partial(error.partial)
        return other

    return stopping(changed)


def going_on(scene):
    """A run whose controller does not stop it."""
    return right(replace(scene, control=scenes.sampled().control) if scene.name == "stopping" else scene)


noise = itertools.count()


def drifting(scene, settings):
    """A run at fixed steps that changes from call to call by the last bits."""
    found = SOLVER.simulate(scene, settings)
    return replace(found, position=found.position * (1.0 + 1e-15 * next(noise)))


def of_one_step(scene, settings):
    """A run whose fixed step is not that of the settings."""
    return SOLVER.simulate(scene, settings | {"step": 1e-4} if "step" in settings else settings)


def ignoring(scene, settings):
    """A run without the settings that do not exist."""
    known = {name: settings[name] for name in settings if name != "no_such_setting"}
    return SOLVER.simulate(scene, known) if known else right(scene)


def later_rows(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    """A change of an array: all rows after the first one are multiplied."""

    def changed(values):
        later = factor * values
        later[0] = values[0]
        return later

    return changed


def without_measured_drift(found):
    """A run whose bodies drift apart by 0.01 mm, and that reports no violation."""
    drift = np.zeros_like(found.position)
    drift[1:, -1] = 1e-5
    return replace(
        found,
        position=found.position + drift,
        constraint_violation=np.zeros_like(found.constraint_violation),
    )


def with_forces(**values) -> Callable:
    """A change of a scene: other values of attributes of its forces."""
    return lambda scene: replace(scene, forces=[replace(force, **values) for force in scene.forces])


def without(*names: str) -> Callable:
    """A change of a scene: none of its elements of some kinds, by the names of the scene's fields."""
    return lambda scene: replace(scene, **dict.fromkeys(names, ()))


def with_rotor_in_body(scene):
    """The rotor's inertia as mass of the body, which has weight."""
    bar = scene.mechanism.bodies[1]
    heavier = replace(bar, mass=bar.mass + element_scenes.SLIDE_ROTOR)
    mechanism = Mechanism([scene.mechanism.bodies[0], heavier], scene.mechanism.joints)
    return replace(scene, mechanism=mechanism, armatures=())


def with_exchanged_axes(scene):
    """The axes of a universal joint are exchanged; the initial state is the same."""
    (joint,) = scene.mechanism.joints
    axes = {"axis_on_first": joint.axis_on_second, "axis_on_second": joint.axis_on_first}
    return with_parts(scene, [replace(joint, **axes)], ())


def with_pitch_per_revolution(scene):
    """The pitch of a screw is per revolution; the body starts to turn at the same rate."""
    (joint,) = scene.mechanism.joints
    state, pitch = deepcopy(initial_state(scene)), joint.pitch / (2.0 * np.pi)
    state.linear_velocity[1] += (pitch - joint.pitch) * state.angular_velocity[1]
    return replace(with_parts(scene, [replace(joint, pitch=pitch)], ()), initial_state=state)


def with_error(name: str, scene_name: str, error: float) -> Engine:
    """Newton_euler with a relative error of an array in the default run and the refined run of a scene."""

    def wrong(found):
        return replace(found, **{name: (1.0 + error) * getattr(found, name)})

    def refined(scene):
        return wrong(SOLVER.refined(scene)) if scene.name == scene_name else SOLVER.refined(scene)

    return replace(changing(wrong, scene_name), refined=refined, refined_in_full=None)


def with_equations(scene_name: str, change: Callable) -> Engine:
    """Newton_euler with the equations of another scene in place of a scene with a name."""
    return replace(
        BASE, systems=lambda scene: equations(change(scene) if scene.name == scene_name else scene)
    )


def with_ratio(ratio: float) -> Callable:
    """A change of a scene: another ratio of its gear."""
    return lambda scene: with_parts(
        scene, scene.mechanism.joints, [replace(gear, ratio=ratio) for gear in scene.mechanism.couplings]
    )


LIMIT = Limit("body 'bar'", "bars are not expressed")


class Wrong(NamedTuple):
    """A wrong engine.

    Attributes:
        point: the point that finds the engine.
        engine: the engine.
        others: further points that find the engine, because its mistake is in their runs, too.
    """

    point: str
    engine: Engine
    others: frozenset[str] = frozenset()


WRONG = {
    "starts at rest": Wrong(
        "start", changing(arrays(linear_velocity=at_first_row), "swing"), frozenset({"motion"})
    ),
    "quaternions of norm 2": Wrong(
        "quaternion_order", changing(arrays(quaternion=lambda q: 2.0 * q), "swing")
    ),
    "scalar last": Wrong(
        "quaternion_order",
        changing(arrays(quaternion=lambda q: np.roll(q, -1, axis=2)), "swing"),
        frozenset({"motion"}),
    ),
    "no violation": Wrong(
        "outputs", changing(arrays(constraint_violation=lambda _: None)), frozenset({"loops"})
    ),
    "names in another order": Wrong("outputs", changing(arrays(body_names=lambda names: names[::-1]))),
    "outputs nobody asked for": Wrong(
        "outputs",
        simulating(lambda scene: right(scenes.swing() if scene.name == "bare_swing" else scene)),
    ),
    "heavier bar": Wrong("motion", changing(arrays(position=lambda x: x + 0.01 * (x - x[0])), "swing")),
    "turns in the world": Wrong("motion", changing(turned_in_the_world, "swing")),
    "late velocities": Wrong("motion", changing(arrays(angular_velocity=later_rows(1.01)), "swing")),
    "acts on the moving body": Wrong(
        "reaction_sign",
        changing(arrays(reaction_force=np.negative, reaction_torque=np.negative), "backward_swing"),
    ),
    "torque on the first body": Wrong(
        "reaction_sign", changing(arrays(reaction_torque=np.negative), "backward_swing")
    ),
    "force in the body frame": Wrong("reaction_frame", changing(in_body_frame, "swing")),
    "torque about the center": Wrong("reaction_point", changing(about_center, "swing")),
    "drive in the reaction": Wrong("drive_force", changing(with_drives, "driven_swing")),
    "energy since the start": Wrong("energy", changing(arrays(potential_energy=lambda e: e - e[0]), "swing")),
    "work on the drive": Wrong("work", changing(arrays(work=np.negative), "driven_swing")),
    "torque about the ground": Wrong("slides", changing(about_first_point, "sliding")),
    "spin in the body frame": Wrong("balls", changing(in_body("angular_velocity"), "conical")),
    "velocity in the body frame": Wrong("free_bodies", changing(in_body("linear_velocity"), "floating")),
    "torque of the exchanged bodies": Wrong(
        "ground_second", changing(arrays(actuator_force=np.negative), "backward_drive")
    ),
    "heavier lower bar": Wrong("chain", replacing("double", injection.mass("lower", 0.05))),
    "late velocities of a chain": Wrong(
        "chain", changing(arrays(linear_velocity=later_rows(0.99)), "double")
    ),
    "open loop": Wrong("loops", replacing("linkage", without_loops), frozenset({"errors"})),
    "late velocities of a loop": Wrong(
        "loops", changing(arrays(linear_velocity=later_rows(0.99)), "linkage")
    ),
    "drift without violation": Wrong("loops", changing(without_measured_drift, "linkage")),
    "axes exchanged": Wrong("universals", replacing("cardan", with_exchanged_axes)),
    "pitch per revolution": Wrong("screws", replacing("screwed", with_pitch_per_revolution)),
    "no rod": Wrong("rods", replacing("rodded", without_loops)),
    "rod pushes the first body": Wrong("rods", changing(arrays(reaction_force=np.negative), "rodded")),
    "no gear": Wrong(
        "couplings", replacing("geared", lambda scene: with_parts(scene, scene.mechanism.joints, ()))
    ),
    "no jump": Wrong("jumps", replacing("jumping", with_set_points((0.0,), scenes.SET_POINTS[:1]))),
    "jump 1 ms late": Wrong(
        "jumps",
        replacing("jumping", with_set_points((0.0, scenes.JUMP_TIME + 1e-3), scenes.SET_POINTS)),
    ),
    "force a period late": Wrong("sampled_control", replacing("sampled", a_period_late)),
    "no springs": Wrong("joint_springs", replacing("sprung_slide", without("forces"))),
    "springs at rest at 0": Wrong("joint_springs", replacing("sprung_swing", with_forces(rest=0.0))),
    "no work of dampers": Wrong("joint_springs", changing(arrays(work=np.zeros_like), "sprung_swing")),
    "balls at rest at the start": Wrong(
        "ball_springs", replacing("sprung_ball", with_forces(rest=np.zeros(3)))
    ),
    "no dampers of balls": Wrong("ball_springs", replacing("sprung_ball", with_forces(damping=0.0))),
    "springs of balls in the reaction": Wrong(
        "ball_springs", changing(arrays(reaction_torque=lambda torque: torque + 1.0), "sprung_ball")
    ),
    "no rest length": Wrong("point_springs", replacing("tied_double", with_forces(rest_length=0.0))),
    "no dampers": Wrong("point_springs", replacing("tied_double", with_forces(damping=0.0))),
    "no wrenches": Wrong("wrenches", replacing("pushed_swing", without("forces"))),
    "wrenches in the world": Wrong("wrenches", replacing("pushed_swing", with_forces(frame="world"))),
    "wrenches at the center": Wrong(
        "wrenches", replacing("pushed_swing", with_forces(point=np.array([0.5, 0.2, -0.1])))
    ),
    "no wind": Wrong("winds", replacing("windy_swing", without("forces"))),
    "steady wind": Wrong("winds", replacing("windy_swing", with_forces(speed=6.0))),
    "no friction": Wrong("frictions", replacing("braked_slide", without("forces"))),
    "no work of friction": Wrong("frictions", changing(arrays(work=np.zeros_like), "braked_slide")),
    "no stop": Wrong("stops", replacing("stopped_slide", without("forces"))),
    "no dissipation": Wrong("stops", replacing("stopped_slide", with_forces(dissipation=0.0))),
    "no belt": Wrong("elastic_gears", replacing("belted", without("forces"))),
    "no play": Wrong("elastic_gears", replacing("belted", with_forces(play=0.0))),
    "no loss": Wrong(
        "elastic_gears",
        replacing("belted", with_forces(forward_efficiency=1.0, backward_efficiency=1.0)),
    ),
    "no motions": Wrong("prescribed_motions", replacing("guided_slide", without("motions"))),
    "no work of motions": Wrong("prescribed_motions", changing(arrays(work=np.zeros_like), "guided_slide")),
    "free shoulder": Wrong("prescribed_motions", replacing("guided_double", without("motions"))),
    "no rotors": Wrong("rotors", replacing("armed_double", without("armatures"))),
    "rotor in the body": Wrong("rotors", replacing("armed_slide", with_rotor_in_body)),
    "no rotors of balls": Wrong("ball_rotors", replacing("armed_ball", without("armatures"))),
    "default run as refined": Wrong("refinement", replace(BASE, refined=right)),
    "coarse refined run": Wrong(
        "refinement", replace(BASE, refined=lambda scene: simulate(scene, integrator="Euler", step=1e-4))
    ),
    "short refined run": Wrong(
        "refinement", replace(BASE, refined=lambda scene: SOLVER.refined(scene).first(3))
    ),
    "refined run without reactions": Wrong(
        "refinement",
        replace(SOLVER, refined_in_full=lambda scene: replace(SOLVER.refined(scene), reaction_force=None)),
    ),
    "larger error than declared": Wrong("errors", with_error("kinetic_energy", "fast_swing", 1e-5)),
    "larger error of a loop": Wrong("errors", with_error("kinetic_energy", "linkage", 1e-5)),
    "other last bits": Wrong("fixed_steps", simulating(right, drifting)),
    "another step": Wrong("fixed_steps", simulating(right, of_one_step)),
    "failure ignored": Wrong("stop", simulating(going_on)),
    "another error": Wrong("stop", stopping(lambda _: NewtonEulerError("stopped"))),
    "no partial run": Wrong("stop", with_partial(lambda _: None)),
    "last output lost": Wrong("stop", with_partial(lambda partial: partial.first(2))),
    "other partial run": Wrong("stop", with_partial(arrays(position=lambda x: 1.01 * x))),
    "time of the end": Wrong("stop", with_partial(lambda partial: partial, time=scenes.stopping().duration)),
    "heavier equations": Wrong("equations", with_equations("swing", injection.mass("bar", 0.01))),
    "heavier equations of a chain": Wrong(
        "equations", with_equations("double", injection.mass("lower", 0.01))
    ),
    "heavier equations of a loop": Wrong(
        "equations", with_equations("linkage", injection.mass("coupler", 0.01))
    ),
    "another gear in equations": Wrong("equations", with_equations("geared", with_ratio(-2.02))),
    "limits that do not hold": Wrong("limits", replace(BASE, limits=lambda scene: [LIMIT])),
    "unknown settings ignored": Wrong("settings", simulating(right, ignoring)),
}
"""Wrong engines by their mistake."""


def test_there_is_a_wrong_engine_for_each_point():
    assert {each.point for each in WRONG.values()} == POINTS.keys()


@pytest.mark.parametrize("mistake", WRONG)
def test_a_wrong_engine_fails_at_its_point_and_no_other(mistake):
    wrong = WRONG[mistake]
    found = check_engine(wrong.engine, lambda _: None)
    failed = {each.point: each for each in found if each.result is not Result.HOLDS}
    assert failed.keys() == {wrong.point, *wrong.others}
    assert {(each.result, bool(each.why)) for each in failed.values()} == {(Result.FAILS, True)}
    assert exit_status(found) == 1


def refusing(error: Exception, **parts) -> Engine:
    """Newton_euler that raises an error instead of each run."""

    def refuse(scene, settings=NO_SETTINGS):
        raise error

    return replace(SOLVER, name="wrong", simulate=refuse, refined=refuse, systems=refuse, **parts)


REFUSAL = CannotExpressError("wrong", [LIMIT])


def test_an_engine_that_refuses_everything_has_shown_nothing(capsys, tmp_path, monkeypatch):
    engine = refusing(REFUSAL, limits=lambda scene: [LIMIT])
    found = check_engine(engine, lambda _: None)
    assert [each.point for each in found if each.result is not Result.REFUSED] == ["limits"]
    assert exit_status(found) == 3
    monkeypatch.setitem(ENGINES, "mujoco", replace(engine, name="mujoco"))
    status, out, _ = run(capsys, "engine-check", "mujoco", "--output", tmp_path)
    assert (status, "NOT SHOWN" in out, "CONFORMS" in out) == (3, True, False)


def test_a_test_class_skips_refused_points_except_the_required_ones():
    class OfRefusing(EngineConformance):
        engine = refusing(REFUSAL, limits=lambda scene: [LIMIT])

    for point in REQUIRED:
        with pytest.raises(AssertionError, match="bars are not expressed"):
            OfRefusing().test_point(point)
    with pytest.raises(pytest.skip.Exception):
        OfRefusing().test_point("motion")


def test_required_points_take_any_scene_of_one_body():
    def simulated(scene, settings=NO_SETTINGS):
        if scene.mechanism.joints[0].kind != "free":
            raise REFUSAL
        return SOLVER.simulate(scene, settings)

    found = check_engine(replace(SOLVER, simulate=simulated, limits=lambda _: ()), lambda _: None)
    results = {each.point: each.result for each in found}
    assert {results[point] for point in (*REQUIRED, "free_bodies")} == {Result.HOLDS}
    assert results["motion"] is Result.REFUSED
    assert results["limits"] is Result.FAILS  # lists nothing


def test_points_about_optional_parts_are_refused_without_them():
    candidate = Candidate(replace(BASE, systems=lambda scene: (), fixed_steps=None))
    found = [check_point(candidate, point) for point in ("equations", "fixed_steps", "motion")]
    assert [each.result for each in found] == [Result.REFUSED, Result.REFUSED, Result.HOLDS]


@pytest.mark.parametrize(
    "error", [NewtonEulerError("no hinges"), IndexError("list index out of range"), MemoryError()]
)
def test_any_other_error_than_a_refusal_is_a_failure_with_its_scene_and_place(error):
    found = check_engine(refusing(error), lambda _: None)
    assert {each.result for each in found} == {Result.FAILS}
    by_point = {each.point: each for each in found}
    assert by_point["loops"].scene == "linkage"
    assert by_point["balls"].scene == "conical"
    file, _, line = by_point["loops"].place.rpartition(":")
    assert (file.endswith("tests/crosscheck/studies/test_conformance.py"), line.isdecimal()) == (True, True)
    assert str(error) in by_point["loops"].why
    assert "\n" not in str(by_point["loops"])


def test_the_place_of_an_error_in_a_library_is_the_line_of_the_engine():
    def failing(scene, settings=NO_SETTINGS):
        return np.linalg.inv(np.zeros((2, 2)))  # raises inside of NumPy

    found = check_point(Candidate(replace(SOLVER, simulate=failing)), "motion")
    line = failing.__code__.co_firstlineno + 1
    assert found.place.endswith(f"test_conformance.py:{line}")


def test_a_scene_that_takes_too_long_is_a_failure():
    def endless(scene, settings=NO_SETTINGS):
        while True:
            pass

    candidate = Candidate(replace(SOLVER, simulate=endless))
    with limits_changed({"time": 0.1}):
        found = [check_point(candidate, point) for point in ("motion", "settings")]
    assert [(each.result, each.scene) for each in found] == [(Result.FAILS, "swing")] * 2
    assert "given up after 0.1 s" in found[0].why
    assert found[0].place.endswith(f"test_conformance.py:{endless.__code__.co_firstlineno}")


def test_an_unknown_setting_that_takes_too_long_is_not_refused():
    def endless(scene, settings=NO_SETTINGS):
        while settings:
            pass
        return right(scene)

    with limits_changed({"time": 0.1}):
        found = check_point(Candidate(replace(SOLVER, simulate=endless)), "settings")
    assert found.result is Result.FAILS


def nothing(scene, settings=NO_SETTINGS):
    """No run."""


def leaving(scene, settings=NO_SETTINGS):
    raise SystemExit(0)


@pytest.mark.parametrize("function", [nothing, leaving, lambda scene: right(scene), print])
def test_results_of_another_class_are_failures(function):
    found = check_engine(replace(SOLVER, simulate=function, refined=nothing), lambda _: None)
    failed = {each.point: each for each in found if each.result is Result.FAILS}
    assert {"settings", "refinement"} <= failed.keys()
    assert exit_status(found) == 1


def test_arrays_of_another_shape_are_failures():
    for name in ("position", "quaternion", "reaction_force"):
        engine = changing(arrays(**{name: lambda values: values[:, :, :2]}))
        failed = {each.point for each in check_engine(engine, lambda _: None) if each.result is Result.FAILS}
        assert "outputs" in failed


def test_the_page_explains_every_point():
    for point in POINTS:
        assert all(text.endswith(".") for text in explained(point)), point
    assert sections_of_page() == sections(), "python tests/support/contract_points.py writes the page"
    listed = re.findall(r"\[(\w+)\]\(#\1\)", PAGE.read_text())  # the table of points by group
    assert sorted(listed) == sorted(POINTS)


def test_the_command_prints_each_point(capsys, tmp_path, monkeypatch):
    status, out, _ = run(capsys, "engine-check", "newton_euler", "--output", tmp_path)
    assert status == 0
    assert all(point in out for point in POINTS)
    monkeypatch.setitem(ENGINES, "newton_euler", WRONG["energy since the start"].engine)
    status, out, _ = run(capsys, "engine-check", "newton_euler", "--output", tmp_path, "-v")
    assert status == 1
    words = " ".join(out.split())
    assert "potential_energy differs by" in words
    stored = json.loads((tmp_path / "engine_check.json").read_text())
    assert [each["point"] for each in stored["points"] if each["result"] == "FAILS"] == ["energy"]


def test_the_command_checks_one_engine(capsys):
    status, _, errors = run(capsys, "engine-check", "all")
    assert (status, "internal" in errors) == (2, False)
