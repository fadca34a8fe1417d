"""Reactions in runs of an engine without equations of motion, which no level of equations compares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import pendulum

from crosscheck.compare.check import REACTIONS
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.runs import compare_runs
from crosscheck.engines.engine import FORCE_OUTPUTS, no_systems
from crosscheck.engines.mujoco import FORCE_ERROR
from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.library import load
from newton_euler import simulate
from newton_euler.equations.undetermined import undetermined

SWING = replace(pendulum(), duration=0.5)


def bare(change=lambda run: run, **settings):
    """Return an engine without equations of motion: newton_euler's runs with settings, changed."""

    def run(scene, **more):
        return replace(change(simulate(scene, **settings | more)), engine="bare")

    return replace(
        SOLVER,
        name="bare",
        systems=no_systems,
        simulate=run,
        refined=lambda scene: run(scene, rtol=0.01 * settings.get("rtol", 1e-10)),
    )


def reaction_checks(scene, *engines):
    """Return the checks of reactions of an engine "bare" and others, in the order of `REACTIONS`."""
    runs = {engine.name: engine.simulate(scene) for engine in engines}
    checks = compare_runs(scene, engines, runs, 1.0, without_equations=["bare"])
    return [check for check in checks if check.quantity in REACTIONS]


def test_reactions_of_right_runs_agree():
    force, torque = reaction_checks(SWING, SOLVER, bare())
    assert (force.quantity, torque.quantity) == REACTIONS
    assert force.agrees
    assert torque.agrees
    assert {force.level, torque.level} == {"trajectories"}
    # the errors of energies of both
    assert force.tolerance == torque.tolerance == SOLVER.energy_error * 2


def test_reactions_of_engines_with_equations_are_compared_there():
    runs = {engine.name: engine.simulate(SWING) for engine in (SOLVER, ENGINES["pinocchio"])}
    checks = list(compare_runs(SWING, [SOLVER, ENGINES["pinocchio"]], runs, 1.0))
    assert checks
    assert not [check for check in checks if check.quantity in REACTIONS]


def about_center(run):
    """Return the run with reaction torques about the center of mass instead of the joint point."""
    arm = -run.position[:, 1:2]  # the pivot is at the origin
    return replace(run, reaction_torque=run.reaction_torque + np.cross(arm, run.reaction_force))


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (lambda run: replace(run, reaction_force=1.001 * run.reaction_force), REACTIONS[0]),
        (lambda run: replace(run, reaction_force=-run.reaction_force), REACTIONS[0]),
        (about_center, REACTIONS[1]),
    ],
)
def test_wrong_reactions_of_a_right_motion_are_found(change, wrong):
    checks = reaction_checks(SWING, SOLVER, bare(change))
    assert [check.quantity for check in checks if not check.agrees] == [wrong]
    assert all("pivot at" in check.where for check in checks)


def test_the_verdict_names_the_engine_with_wrong_reactions():
    wrong = bare(lambda run: replace(run, reaction_force=-run.reaction_force))
    found = crosscheck(SWING, [SOLVER, wrong, ENGINES["pinocchio"]], lambda _: None, "", {})
    assert found.outcome is Outcome.DISAGREE
    (diagnosis,) = found.diagnosis
    assert (diagnosis.outlier, diagnosis.level, diagnosis.quantity, diagnosis.fault) == (
        "bare",
        "trajectories",
        REACTIONS[0],
        "reactions",
    )
    # the kinetic energies of the pairs that differ are not compared
    assert {check.between for check in found.checks if check.quantity == "kinetic energy, rel"} >= {
        (SOLVER.name, "pinocchio")
    }
    assert not [c for c in found.checks if c.level == "energy" and "bare" in c.between and len(c.between) > 1]


def test_a_wrong_motion_without_equations_may_come_from_the_model_or_the_integration():
    wrong = bare(lambda run: replace(run, position=run.position + 1e-3))
    found = crosscheck(SWING, [SOLVER, wrong, ENGINES["pinocchio"]], lambda _: None, "", {})
    (diagnosis,) = found.diagnosis
    assert (diagnosis.outlier, diagnosis.fault) == ("bare", "model or integration")


def test_reactions_of_a_coarse_run_are_held_to_its_own_error():
    """Beyond the fixed tolerance the change in a finer run counts."""
    force, _ = reaction_checks(SWING, SOLVER, bare(rtol=1e-4, atol=1e-6))
    assert force.agrees
    assert force.judged
    assert 2.0 * SOLVER.energy_error < force.value < force.tolerance < 1e-2


def along_undetermined(scene, size):
    """Return a change of a run: reactions plus forces that balance each other on every body, N."""

    def change(run):
        wrenches = [undetermined(scene, run.state(n)) @ [size] for n in range(len(run.time))]
        force, torque = np.split(np.reshape(wrenches, (len(run.time), -1, 6)), 2, axis=2)
        torque = scene.mechanism.size * torque
        return replace(
            run, reaction_force=run.reaction_force + force, reaction_torque=run.reaction_torque + torque
        )

    return change


def test_what_redundant_constraints_leave_open_is_not_compared():
    scene = replace(load("four_bar", N=1), duration=0.2)
    _, width = undetermined(scene, simulate(scene).state(0)).shape
    assert width == 1
    checks = reaction_checks(scene, SOLVER, bare(along_undetermined(scene, 100.0)))
    assert all(check.agrees for check in checks)
    wrong = bare(lambda run: replace(run, reaction_force=1.01 * run.reaction_force))
    assert not all(check.agrees for check in reaction_checks(scene, SOLVER, wrong))


def test_soft_constraints_have_an_error_of_their_own():
    scene, mujoco = replace(load("slider_crank"), duration=0.1), ENGINES["mujoco"]
    force, torque = reaction_checks(scene, bare(), mujoco)
    assert force.tolerance == torque.tolerance == pytest.approx(FORCE_ERROR, rel=1e-5)
    assert 1e-6 < force.value < FORCE_ERROR
    assert torque.agrees


def test_reactions_that_do_not_converge_are_not_judged():
    """As beside a singular configuration, where forces follow from small errors of the motion."""
    rng = np.random.default_rng(0)
    noisy = bare(lambda run: replace(run, reaction_force=run.reaction_force * rng.uniform(0.0, 2.0)))
    checks = reaction_checks(SWING, SOLVER, noisy)
    assert [check.unconverged for check in checks] == ["bare", ""]
    assert all(check.agrees for check in checks)
    assert checks[0].value > 0.01


def test_a_finer_run_needs_reactions():
    """`refined` may omit them; then `refined_in_full` has them."""
    coarse = bare(rtol=1e-4, atol=1e-6)
    lacking = replace(
        coarse, refined=lambda scene: coarse.refined(replace(scene, outputs=scene.outputs - FORCE_OUTPUTS))
    )
    found = crosscheck(SWING, [SOLVER, lacking], lambda _: None, "", {})
    assert found.outcome is Outcome.UNFINISHED
    assert "refined_in_full" in found.verdict
    full = replace(lacking, refined_in_full=coarse.refined)
    assert crosscheck(SWING, [SOLVER, full], lambda _: None, "", {}).outcome is Outcome.AGREE
