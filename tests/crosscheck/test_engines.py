"""Settings that engines choose by themselves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import mjcf
import urdf
from crosscheck.compare.check import MAX_RELATIVE_ERROR
from crosscheck.compare.runs import compare_runs
from crosscheck.engines.adaptive import LOOSER_TOLERANCE_FACTOR, REFINED_RTOL
from crosscheck.engines.energy import energy_balance
from crosscheck.engines.registry import ENGINES
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


CLAW = """
<mujoco model="claw">
  <worldbody>
    <body name="crank">
      <joint name="crank" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.05" size="0.005" mass="0.05" contype="0" conaffinity="0"/>
      <body name="coupler" pos="0 0 0.05">
        <joint name="coupler" axis="0 1 0" damping="0.001"/>
        <geom type="capsule" fromto="0 0 0 0.12 0 0.02" size="0.005" mass="0.05" contype="0" conaffinity="0"/>
      </body>
    </body>
    <body name="rocker" pos="0.12 0 0">
      <joint name="rocker" axis="0 1 0" damping="0.001"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.07" size="0.005" mass="0.08" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <equality><connect name="loop" body1="coupler" body2="rocker" anchor="0.12 0 0.02"/></equality>
  <actuator><position name="servo" joint="crank" kp="20" kv="0.2" ctrlrange="-1 1"/></actuator>
  <keyframe><key name="close" qpos="0 0 0" ctrl="0.5"/></keyframe>
</mujoco>
"""
"""A servo that a keyframe commands to close at once: in RK4 at 1 ms, poses are within 1e-6, but 5 % of the
energy is missing after the first milliseconds."""


def test_mujoco_halves_its_step_until_the_energy_is_resolved(tmp_path: Path) -> None:
    file = tmp_path / "claw.xml"
    file.write_text(CLAW)
    scene = load(str(file), key="close", excitation="off", duration="0.05")
    coarse = energy_balance(scene, mjcf.simulate(scene, timestep=1e-3))
    run = ENGINES["mujoco"].simulate(scene)
    fine = energy_balance(scene, run)
    assert coarse is not None
    assert fine is not None
    assert abs(coarse.residual).max() > 2 * MAX_RELATIVE_ERROR * coarse.scale
    assert abs(fine.residual).max() < MAX_RELATIVE_ERROR * fine.scale
    assert run.settings["timestep"] < 1e-3


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
