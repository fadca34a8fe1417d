"""Singular configurations that runs start in or pass are found and reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from command_line import run

from crosscheck.scenes import load
from crosscheck.singularity import passage
from newton_euler.simulate import simulate

FLAT = """<mujoco model="flat"><option gravity="0 0 0"/>
<default><joint axis="0 1 0"/><geom type="capsule" size="0.01" contype="0" conaffinity="0"/></default>
<worldbody>
<body name="crank"><joint name="motor"/><geom fromto="0 0 0 0.1 0 0"/>
<body name="coupler" pos="0.1 0 0"><joint name="elbow"/><geom fromto="0 0 0 0.3 0 0"/>
<site name="tip" pos="0.3 0 0"/></body></body>
<body name="rocker" pos="0.3 0 0"><joint name="pivot"/><geom fromto="0 0 0 {length} 0 0"/>
<site name="end" pos="{length} 0 0"/></body>
</worldbody><equality><connect name="loop" site1="tip" site2="end"/></equality>
<keyframe><key name="go" qvel="1 -1 1"/></keyframe></mujoco>"""
"""A parallelogram whose bars lie on one line at the start, and turn."""


def crossings(times, angles, period=np.pi):
    """Times at which angles pass a quarter turn, or one that is whole periods away from it."""
    whole = np.floor((angles - 0.5 * np.pi) / period)
    before = np.flatnonzero(np.diff(whole))
    edges = np.maximum(whole[before], whole[before + 1]) * period + 0.5 * np.pi
    share = (edges - angles[before]) / (angles[before + 1] - angles[before])
    return times[before] + share * (times[before + 1] - times[before])


@pytest.mark.parametrize("windows", [1, 2])
def test_flat_parallelograms_are_passed_where_their_bars_lie(windows):
    scene = load("four_bar", N=windows)
    motion = simulate(scene)
    found = passage(scene, motion)
    expected = crossings(motion.time, motion.joint("pivot_0").coordinates[:, 0])
    assert found.times == pytest.approx(expected, abs=1e-3)
    assert found.freedoms == windows
    assert found.distance < 1e-5
    assert "bar_1" in found.bodies


def test_a_run_that_ends_before_passes_none():
    scene = replace(load("four_bar", N=1), duration=0.6)
    assert passage(scene, simulate(scene)) is None


@pytest.mark.parametrize("name", ["pendulum", "tracker", "bricard"])
def test_other_runs_pass_none(name):
    scene = load(name)
    assert passage(scene, simulate(scene)) is None


def test_a_start_in_one_is_in_the_default_output(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flat.xml").write_text(FLAT.format(length=0.1))
    status, out, _ = run(capsys, "run", "flat.xml", "--set", "key=go", "--set", "duration=0.5")
    assert "starts in a singular configuration" in out, (status, out)
