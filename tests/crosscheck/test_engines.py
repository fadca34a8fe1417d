"""Settings that engines choose by themselves."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import mjcf
import urdf
from crosscheck.compare.check import MAX_RELATIVE_ERROR
from crosscheck.compare.runs import compare_runs
from crosscheck.engines.engine import ENGINES, LOOSER_TOLERANCE_FACTOR, REFINED_RTOL
from crosscheck.library import load
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError, Trajectory, distance
from newton_euler.runs.assemble import initial_state

COARSE = 2e-4
"""s, MuJoCo's step for a run of 0.1 s."""


@pytest.fixture(scope="module")
def fast_linkage() -> Scene:
    """A four-bar linkage at 200 rad/s: in RK4 at `COARSE` it is off by 0.1, at half of that by 3e-4."""
    scene = load("four_bar", N="1")
    start = initial_state(scene)
    linear, angular = 200.0 * start.linear_velocity, 200.0 * start.angular_velocity
    state = replace(start, linear_velocity=linear, angular_velocity=angular)
    return replace(scene, duration=0.1, output_period=0.01, initial_state=state)


def test_mujoco_halves_its_step_until_the_run_is_resolved(fast_linkage: Scene) -> None:
    own = ENGINES["newton_euler"].simulate(fast_linkage)
    assert distance(mjcf.simulate(fast_linkage, timestep=COARSE), own) > MAX_RELATIVE_ERROR
    run = ENGINES["mujoco"].simulate(fast_linkage)
    assert distance(run, own) < MAX_RELATIVE_ERROR
    assert run.settings["timestep"] == pytest.approx(0.5 * COARSE)


def test_a_run_that_is_too_coarse_is_named(fast_linkage: Scene) -> None:
    coarse = replace(
        ENGINES["mujoco"],
        simulate=lambda scene: mjcf.simulate(scene, timestep=COARSE),
        refined=lambda scene: mjcf.simulate(scene, timestep=0.5 * COARSE),
    )
    engines = [ENGINES["newton_euler"], coarse]
    runs = {engine.name: engine.simulate(fast_linkage) for engine in engines}
    rows = [row for row in compare_runs(fast_linkage, engines, runs, 1.0) if len(row.between) == 2]
    assert not all(row.agrees for row in rows)
    assert all(row.detail.startswith("mujoco's own run changes by ") for row in rows if not row.agrees)


def test_a_finer_run_that_stops_is_repeated_with_looser_tolerances(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = replace(load("pendulum"), duration=0.1)
    simulate, tried = urdf.simulate, list[float]()

    def stopping(scene: Scene, *, rtol: float, **control: Any) -> Trajectory:
        tried.append(rtol)
        if len(tried) == 1:
            raise IntegrationError(0.01, "more than 10000 steps of DOP853")
        return simulate(scene, rtol=rtol, **control)

    monkeypatch.setattr(urdf, "simulate", stopping)
    run = ENGINES["pinocchio"].refined(scene)
    assert tried == [REFINED_RTOL, LOOSER_TOLERANCE_FACTOR * REFINED_RTOL]
    assert distance(run, ENGINES["newton_euler"].simulate(scene)) < 1e-9  # of the coarser run
