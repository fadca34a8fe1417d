"""Singular configurations that runs start in or pass are found and reported."""

from __future__ import annotations

from dataclasses import replace

import mechanisms
import numpy as np
import pytest
from command_line import run

from crosscheck.compare.singularity import find_singular_configurations
from crosscheck.library import load
from newton_euler.equations.redundancy import constraint_rank
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.runs.simulate import simulate
from newton_euler.runs.variation import start

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

ENGINES = ("--engines", "newton_euler")
"""The search of singular configurations needs no other engine."""


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
    found = find_singular_configurations(scene, motion)
    expected = crossings(motion.time, motion.joint("pivot_0").coordinates[:, 0])
    assert found.times == pytest.approx(expected, abs=1e-3)
    assert found.freedoms == windows
    assert found.distance < 1e-5
    assert "bar_1" in found.bodies


def near_miss(gap, duration, period):
    """A parallelogram with a coupler longer than its base of 1 m: it turns beside the flat configuration."""
    coupler, tip = 1.0 + gap, np.array([0.0, 0.0, 0.5])
    pivot = np.array([1.0, 0.0, 0.0])
    across = np.linalg.norm(pivot - tip)
    along = (coupler**2 - 0.25 + across**2) / (2.0 * across)
    e = (pivot - tip) / across
    end = tip + along * e + np.sqrt(coupler**2 - along**2) * np.array([-e[2], 0.0, e[0]])
    points = {"A": np.zeros(3), "B": tip, "C": end, "D": pivot}
    bodies = [
        Body.ground(),
        *(mechanisms.bar(pair, *(points[x] for x in pair)) for pair in ("AB", "BC", "DC")),
    ]
    pairs = {"A": ("ground", "AB"), "B": ("AB", "BC"), "C": ("BC", "DC"), "D": ("ground", "DC")}
    axis = np.array([0.0, 1.0, 0.0])
    joints = [Revolute(name, *pair, points[name], axis=axis) for name, pair in pairs.items()]
    scene = Scene("near_miss", Mechanism(bodies, joints), duration, period, np.zeros(3))
    return start(scene, A=(0.0, 3.0))


def margins(scene, outputs=slice(None)):
    """Smallest singular values of the independent constraints along a run."""
    motion, system = simulate(scene), Relative(scene)
    chosen = range(len(motion.time))[outputs]
    found = [dimensionless_jacobian(system, system.coordinates(motion.state(k))[0]) for k in chosen]
    return np.linalg.svd(np.array(found), compute_uv=False)[:, constraint_rank(system) - 1]


def test_the_distance_of_a_near_miss_is_that_of_the_run():
    """Against the same run with outputs that are 1e-5 s apart, near 0.5235 s."""
    scene = near_miss(1e-7, 2.0, 0.02)
    found = find_singular_configurations(scene, simulate(scene))
    closer = margins(replace(scene, duration=0.53, output_period=1e-5), slice(52_200, 52_500))
    assert found.distance == pytest.approx(np.min(closer) / np.max(margins(scene)), rel=0.02)
    further = near_miss(1e-6, 2.0, 0.02)
    assert find_singular_configurations(further, simulate(further)) is None


def test_coarse_outputs_alone_invent_no_passage(monkeypatch):
    """The smallest singular value there is beyond the threshold. A parabola through squares passes 0."""
    scene = near_miss(1e-3, 3.64, 0.13)
    motion = simulate(scene)
    monkeypatch.setattr(
        "crosscheck.compare.singularity._repeat_with_closer_outputs", lambda *_: motion.first(1)
    )  # it stops at once
    assert find_singular_configurations(scene, motion) is None


def test_a_run_that_ends_before_passes_none():
    scene = replace(load("four_bar", N=1), duration=0.6)
    assert find_singular_configurations(scene, simulate(scene)) is None


@pytest.mark.parametrize("name", ["pendulum", "tracker", "bricard"])
def test_other_runs_pass_none(name):
    scene = load(name)
    assert find_singular_configurations(scene, simulate(scene)) is None


@pytest.mark.slow
def test_a_start_in_one_is_in_the_default_output(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flat.xml").write_text(FLAT.format(length=0.1))
    status, out, _ = run(capsys, "run", "flat.xml", *ENGINES, "--set", "key=go", "--set", "duration=0.5")
    assert "starts in a singular configuration" in out, (status, out)


def test_a_mechanism_that_is_too_large_to_search_is_named_as_such(tmp_path, monkeypatch, capsys):
    """Two independent constraints of three velocities."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("crosscheck.compare.singularity.MAX_JACOBIAN_ELEMENTS", 5)
    (tmp_path / "flat.xml").write_text(FLAT.format(length=0.1))
    status, out, _ = run(capsys, "run", "flat.xml", *ENGINES, "--set", "duration=0.1", "--set", "key=qpos0")
    (line,) = (each for each in " ".join(out.split()).split("searching singular configurations: ")[1:])
    assert line.startswith("left out, as 2 independent constraints of 3 velocities are 6 elements")
    assert status == 0, out
