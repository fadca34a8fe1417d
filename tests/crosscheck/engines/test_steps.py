"""Choice of a fixed step by halving: which errors of a run count, and what is kept if a finer run fails."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import pendulum

from crosscheck.engines.steps import halve_until_accurate
from newton_euler import simulate
from newton_euler.errors import NewtonEulerError, SingularityError
from newton_euler.model.forces import JointSpring
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError, Trajectory
from newton_euler.runs.variation import start

FIRST_STEP = 1e-2  # s


def swinging(damping: float = 0.0) -> tuple[Scene, Trajectory]:
    """A pendulum in motion with a damper in its hinge, and its run."""
    scene = replace(pendulum(), duration=0.5, output_period=0.1)
    (joint,) = scene.mechanism.joint_names
    scene = start(replace(scene, forces=(JointSpring(joint, damping=damping),)), **{joint: (0.0, 20.0)})
    return scene, simulate(scene)


def chosen_step(scene: Scene, exact: Trajectory, run_at) -> float:
    """Step, s, of the run that is chosen from runs at the steps."""
    steps = {FIRST_STEP: run_at(FIRST_STEP)}

    def at(step: float) -> Trajectory:
        steps[step] = run_at(step)
        return steps[step]

    run = halve_until_accurate(scene, steps[FIRST_STEP], exact, FIRST_STEP, 1000, at)
    return next(step for step, each in steps.items() if each is run)


@pytest.mark.parametrize("error", [SingularityError("hinge", "planted"), IntegrationError(0.1, "planted")])
def test_a_complete_run_is_kept_if_the_finer_one_fails(error: NewtonEulerError):
    scene, exact = swinging()
    far = replace(exact, position=exact.position + 0.5)

    def fails(step: float) -> Trajectory:
        raise error

    assert halve_until_accurate(scene, far, exact, FIRST_STEP, 1000, fails) is far


def test_the_energy_lost_in_a_damper_is_as_accurate_as_the_motion():
    """Errors of order 2 that are 3 % of the loss at first, but 1e-4 or less of the kinetic energy."""
    scene, exact = swinging(damping=3e-5)
    assert exact.kinetic_energy is not None
    assert exact.work is not None
    lost = np.max(np.abs(exact.work))
    assert 1e-5 < lost / np.max(exact.kinetic_energy) < 1e-3

    def with_error(step: float) -> Trajectory:
        error = 0.03 * lost * (step / FIRST_STEP) ** 2
        return replace(exact, kinetic_energy=exact.kinetic_energy + error * (exact.time > 0.0))

    assert chosen_step(scene, exact, with_error) == FIRST_STEP / 2.0


def test_energy_need_not_be_so_accurate_if_no_work_changes_it():
    scene, exact = swinging(damping=1e-12)
    assert exact.kinetic_energy is not None

    def with_error(step: float) -> Trajectory:
        error = 1e-3 * np.max(exact.kinetic_energy) * (exact.time > 0.0)
        return replace(exact, kinetic_energy=exact.kinetic_energy + error)

    assert chosen_step(scene, exact, with_error) == FIRST_STEP
