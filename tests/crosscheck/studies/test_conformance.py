"""The contract of an engine: default engines follow it, and a wrong one is found at the point it breaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from command_line import run

from crosscheck.engines.limits import CannotExpressError, Limit
from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.studies.conformance import POINTS, Result, check_engine, check_point
from crosscheck.studies.conformance_tests import EngineConformance
from crosscheck.studies.faults import injection
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import conjugate, product, rotation
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate


class TestMujoco(EngineConformance):
    engine = ENGINES["mujoco"]


class TestPinocchio(EngineConformance):
    engine = ENGINES["pinocchio"]


class TestNewtonEuler(EngineConformance):
    engine = SOLVER


def changing(change: Callable[[Trajectory], Trajectory]):
    """newton_euler with changed runs."""

    def changed(scene):
        found = SOLVER.simulate(scene)
        return change(found) if found.reaction_force is not None else found

    return replace(SOLVER, name="wrong", simulate=changed)


def at_rest(scene):
    """A run that starts at rest."""
    state = initial_state(scene)
    still = {name: np.zeros_like(getattr(state, name)) for name in ("linear_velocity", "angular_velocity")}
    return simulate(replace(scene, initial_state=replace(state, **still)))


def scalar_last(found):
    return replace(found, quaternion=np.roll(found.quaternion, -1, axis=2))


def in_body_frame(found):
    force = [[rotation(q[1]).T @ f[0]] for q, f in zip(found.quaternion, found.reaction_force, strict=True)]
    return replace(found, reaction_force=np.array(force))


def about_center(found):
    arm = np.zeros_like(found.reaction_torque)
    arm[:, 0] = np.array([0.1, 0.0, 0.1]) - found.position[:, 1]
    return replace(found, reaction_torque=found.reaction_torque + np.cross(arm, found.reaction_force))


def with_drives(found):
    torque = found.reaction_torque.copy()
    if found.actuator_force.size:
        torque[:, 0] += found.actuator_force
    return replace(found, reaction_torque=torque)


def with_parts(scene, joints, couplings):
    return replace(scene, mechanism=Mechanism(scene.mechanism.bodies, joints, couplings))


def open_loops(scene):
    """A run without the joint that closes a loop."""
    tree = scene.mechanism.joints[: len(scene.mechanism.bodies) - 1]
    return simulate(with_parts(scene, tree, scene.mechanism.couplings))


WRONG = {
    "start": replace(SOLVER, simulate=at_rest),
    "quaternion_order": changing(
        lambda found: replace(found, quaternion=np.roll(found.quaternion, -1, axis=2))
    ),
    "motion": replace(SOLVER, simulate=lambda scene: simulate(replace(scene, gravity=-scene.gravity))),
    "outputs": changing(lambda found: replace(found, kinetic_energy=None)),
    "reaction_sign": changing(
        lambda found: replace(
            found, reaction_force=-found.reaction_force, reaction_torque=-found.reaction_torque
        )
    ),
    "reaction_frame": changing(in_body_frame),
    "reaction_point": changing(about_center),
    "drive_force": changing(with_drives),
    "energy": changing(
        lambda found: replace(found, potential_energy=found.potential_energy - found.potential_energy[0])
    ),
    "chain": replace(
        SOLVER,
        simulate=lambda scene: simulate(
            injection.mass("lower", 0.05)(scene) if scene.name == "double" else scene
        ),
    ),
    "loops": replace(SOLVER, simulate=open_loops),
    "couplings": replace(
        SOLVER, simulate=lambda scene: simulate(with_parts(scene, scene.mechanism.joints, ()))
    ),
    "refinement": replace(SOLVER, refined=lambda scene: simulate(scene, integrator="Euler", step=1e-3)),
    "equations": replace(SOLVER, systems=lambda scene: SOLVER.systems(injection.mass("bar", 0.01)(scene))),
    "limits": replace(SOLVER, limits=lambda scene: [Limit("body 'bar'", "bars are not expressed")]),
    "settings": replace(SOLVER, simulate=lambda scene, settings=None: simulate(scene)),
}
"""A wrong engine by the point that finds it."""


def test_there_is_a_wrong_engine_for_each_point():
    assert WRONG.keys() == POINTS.keys()


@pytest.mark.parametrize("point", WRONG)
def test_a_wrong_engine_fails_at_its_point(point):
    found = check_point(WRONG[point], point)
    assert (found.result, bool(found.why)) == (Result.FAILS, True)


ALONE = ("drive_force", "energy", "chain", "loops", "couplings", "equations")
"""Points whose wrong engines are right in all others."""


@pytest.mark.parametrize("point", ALONE)
def test_a_wrong_engine_fails_at_no_other_point(point):
    found = check_engine(WRONG[point], lambda _: None)
    assert [each.point for each in found if each.result is not Result.HOLDS] == [point]


def turned_in_the_world(found):
    """Orientations with the factors of the rotation since the start and the initial rotation exchanged."""
    turned = found.quaternion.copy()
    for row in turned:
        for body, start in enumerate(found.quaternion[0]):
            row[body] = product(start, product(row[body], conjugate(start)))
    return replace(found, quaternion=turned)


def test_a_rotation_in_the_wrong_frame_is_found():
    found = check_point(changing(turned_in_the_world), "motion")
    assert (found.result, "orientations differ" in found.why) == (Result.FAILS, True)


def test_a_refusal_is_listed():
    def refuse(scene, settings=None):
        raise error

    limit = Limit("joint 'hinge'", "hinges are not expressed")
    for error in (NewtonEulerError("no hinges"), CannotExpressError("wrong", [limit])):
        found = check_point(replace(SOLVER, simulate=refuse), "limits")
        assert (found.result, str(error) in found.why) == (Result.FAILS, True)
    listed = replace(SOLVER, simulate=refuse, limits=lambda scene: [limit])
    assert check_point(listed, "limits").result is Result.HOLDS


def test_refusals_have_a_reason_and_errors_are_failures():
    def raising(error):
        def refuse(scene):
            raise error

        return check_point(replace(SOLVER, simulate=refuse), "motion")

    found = raising(NewtonEulerError("no hinges"))
    assert (found.result, found.why) == (Result.REFUSED, "no hinges")
    found = raising(IndexError("list index out of range"))
    assert (found.result, found.why) == (Result.FAILS, "internal error: IndexError: list index out of range")


def test_the_command_prints_each_point(capsys, tmp_path, monkeypatch):
    status, out, _ = run(capsys, "engine-check", "newton_euler", "--output", tmp_path)
    assert status == 0
    assert all(point in out for point in POINTS)
    monkeypatch.setitem(ENGINES, "newton_euler", WRONG["energy"])
    status, out, _ = run(capsys, "engine-check", "newton_euler", "--output", tmp_path)
    assert status == 1
    assert "potential_energy differs by" in out
    assert (tmp_path / "engine_check.json").exists()
