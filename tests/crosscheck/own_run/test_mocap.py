"""Runs of files whose keyframe moves mocap bodies, against MuJoCo alone."""

from __future__ import annotations

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest

from crosscheck.loading.load import load_scene
from crosscheck.own_run.judge import judge
from crosscheck.studies.own_run_table import own_run_result

SCRIPT = Path(__file__).parents[3] / "docs" / "results" / "own_runs" / "engine_alone.py"

BOX = """<mujoco><option timestep="0.002"><flag contact="disable"/></option><worldbody>
  <body name="hand" mocap="true" pos="0 0 1"/>
  <body name="box" pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.2 0.3" mass="1"/>
    <body name="lid" pos="0.1 0 0.3"><joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.2 0 0" size="0.02" mass="0.2"/></body></body></worldbody>
  <equality><{equality} name="grasp" body1="hand" body2="box" {more}/></equality>
  <keyframe><key name="aside" mpos="0.3 0 1" mquat="0.8 0.6 0 0" qpos="0.3 0 1 0.8 0.6 0 0 0.2"
    qvel="0 0 0 {qvel}"/></keyframe></mujoco>"""
CONNECTED = BOX.format(equality="connect", more='anchor="0 0 0"', qvel="1 2 3 0")
WELDED = BOX.format(equality="weld", more="", qvel="0 0 0 0")


def simulation_of(folder: Path, text: str):
    path = folder / "box.xml"
    path.write_text(text)
    _, report = load_scene(str(path), {"duration": "0.5", "excitation": "off"})
    assert report is not None
    assert report.simulation is not None
    return path, report.simulation


def at_keyframe(path: Path):
    """Return the compiled model, and its data at the keyframe, by MuJoCo alone."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    return model, data


@pytest.mark.parametrize("text", [CONNECTED, WELDED])
def test_the_run_is_that_of_the_keyframe(tmp_path, text):
    path, simulation = simulation_of(tmp_path, text)
    found = judge(simulation)
    model, data = at_keyframe(path)
    outputs = np.round(found.run.time / model.opt.timestep).astype(int)
    box = found.run.body_names.index("box")
    positions, gaps = [], []
    for step in range(outputs[-1] + 1):
        if step in outputs:
            mujoco.mj_kinematics(model, data)
            positions.append(data.body("box").xipos.copy())
            gaps.append(np.linalg.norm(data.body("box").xpos - data.body("hand").xpos))
        mujoco.mj_step(model, data)
    # the same steps of the same engine; the start differs by round-off of the velocities
    np.testing.assert_allclose(found.run.position[:, box], positions, rtol=0.0, atol=1e-9)
    assert found.loop_error.opening == pytest.approx(max(gaps), abs=1e-9)
    # the soft grasp gives way by a few mm; the mocap body of the model without keyframe is 300 mm away
    assert found.error.largest_position < 0.01


def test_small_motions_are_those_about_the_keyframe(tmp_path):
    path, simulation = simulation_of(tmp_path, WELDED)
    motions = simulation.small_motions(simulation.run(simulation.settings, 1, 1, True), [0])
    model, data = at_keyframe(path)
    model.opt.tolerance = 0.0
    size = 2 * model.nv
    by_mujoco = np.zeros((size, size))
    mujoco.mjd_transitionFD(model, data, 1e-6, 1, by_mujoco, None, None, None)
    # central differences of both with steps of 1e-6: round-off of 1e-10 and a truncation far below
    np.testing.assert_allclose(motions.step(0, simulation.settings), by_mujoco, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("text", [CONNECTED, WELDED])
def test_mujoco_alone_repeats_the_run(tmp_path, text):
    path, simulation = simulation_of(tmp_path, text)
    summary = tmp_path / "summary.json"
    summary.write_text(json.dumps({"own_run": judge(simulation).summary()}))
    row = own_run_result(path, summary, SCRIPT)
    assert row is not None
    assert row.repeats, row.repeated
