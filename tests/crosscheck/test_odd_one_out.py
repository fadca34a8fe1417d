"""Disagreements made on purpose: what `crosscheck run` prints names the odd one out and the cause."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from wrong_engines import taking

import mjcf
import urdf
from crosscheck.engines.registry import ENGINES
from crosscheck.library.scene_file import write_scene
from crosscheck.studies.faults import injection
from newton_euler.model.forces import JointSpring

SIX_BAR = """<mujoco model="six_bar">
  <default>
    <joint axis="0 1 0" damping="0.01"/>
    <geom type="capsule" size="0.02" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="crank">
      <joint name="motor" stiffness="2"/><geom fromto="0 0 0 0.1 0 0.4"/>
      <body name="coupler" pos="0.1 0 0.4">
        <joint name="elbow"/><geom fromto="0 0 0 0.8 0 0.3"/><site name="c" pos="0.8 0 0.3"/>
        <body name="link" pos="0.4 0 0.4">
          <joint name="wrist"/><geom fromto="0 0 0 0.8 0 0.4"/><site name="e" pos="0.8 0 0.4"/>
        </body>
      </body>
    </body>
    <body name="rocker" pos="1 0 0">
      <joint name="pivot" damping="0"/><geom fromto="0 0 0 -0.1 0 0.7"/><site name="d" pos="-0.1 0 0.7"/>
    </body>
    <body name="arm" pos="1.5 0 0.1">
      <joint name="anchor"/><geom fromto="0 0 0 -0.2 0 1.1"/><site name="f" pos="-0.2 0 1.1"/>
    </body>
  </worldbody>
  <equality><connect name="cd" site1="c" site2="d"/><connect name="ef" site1="e" site2="f"/></equality>
</mujoco>"""
"""Two loops."""

DURATION = 0.2
"""s."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the linkage as MJCF, scene file and URDF, for `DURATION`."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "six_bar.xml").write_text(SIX_BAR)
    found = mjcf.read(folder / "six_bar.xml", duration=DURATION, excitation=True).scene
    write_scene(found, folder / "six_bar.yaml")
    urdf.write(found, folder / "six_bar.urdf")
    return folder


def with_runs(name, simulate):
    """An engine with other runs of the same model, whose finer ones are no finer."""
    return replace(ENGINES[name], simulate=simulate, refined=simulate)


def heavier_pull(scene):
    return replace(scene, gravity=1.01 * scene.gravity)


def oblique(scene):
    return injection.tilted_axes(scene.mechanism.joint("wrist"), 1e-3)["about u"](scene)


def more_damping(scene):
    at_elbow = next(k for k, force in enumerate(scene.forces) if force.joint == "elbow")
    return injection.entry_values("forces", at_elbow, damping=0.015)(scene)


def more_dampers(scene):
    others = [force for force in scene.forces if force.joint != "pivot"]
    return replace(scene, forces=(*others, JointSpring("pivot", damping=0.02)))


def diverging(scene):
    return mjcf.simulate(replace(scene, gravity=1e4 * scene.gravity), timestep=0.01)


def endless(scene):
    while True:
        pass


def breaking(scene):
    raise np.linalg.LinAlgError("SVD did not converge")


MODELS = {
    "mass": (
        taking(ENGINES["mujoco"], injection.mass("coupler", 1e-3)),
        "mass, rel: 0.001 > 1e-12, worst at coupler: newton_euler 1.107, mujoco 1.108 kg",
    ),
    "inertia": (
        taking(ENGINES["pinocchio"], injection.inertia_entry("link", 1, 1, 0.01)),
        "inertia, rel: 0.01 > 1e-12, worst at link: newton_euler 0 0.08198 0, pinocchio 0 0.0828 0 kg m^2",
    ),
    "gravity": (
        taking(ENGINES["newton_euler"], heavier_pull),
        "worst at gravity: 0 0 -9.908 instead of 0 0 -9.81 m/s^2; newton_euler's model",
    ),
    "axis": (
        taking(ENGINES["pinocchio"], oblique),
        "joint axes, rad: 0.001 > 1e-12, worst at wrist: newton_euler 0 1 0, pinocchio 0 1 0.001",
    ),
    "damping": (taking(ENGINES["mujoco"], more_damping), "worst at elbow: damping 0.015 instead of 0.01"),
    "a damper of its own": (
        taking(ENGINES["pinocchio"], more_dampers),
        "worst at pivot: damping 0.02 instead of 0",
    ),
}
"""Engines whose model is wrong, and what is said of it."""

RUNS = {
    "softness": (
        with_runs("mujoco", partial(mjcf.simulate, timestep=1e-3, solref=(0.1, 1.0))),
        "mujoco differs; newton_euler and pinocchio agree",
        "mujoco's constraints are too soft: ",
    ),
    "divergence": (
        with_runs("mujoco", diverging),
        "UNFINISHED: mujoco: MuJoCo diverged at t = 0.",
        "as far as compared mujoco differs; newton_euler and pinocchio agree within ",
    ),
    "crash": (
        with_runs("pinocchio", breaking),
        "UNFINISHED: pinocchio: internal error: LinAlgError: SVD did not converge; ",
        "; newton_euler and mujoco ran to the end; ",
    ),
}
"""Engines whose run is wrong, and what is said of it."""


def printed(capsys, monkeypatch, files, *arguments):
    """Status and output of `crosscheck run` in a terminal, in one line."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(files)
    status, out, _ = run(capsys, "run", *arguments, "--output", "out")
    lines = out.splitlines()
    most = 41 if "your settings" in out else 27  # a file's own run takes up to fourteen lines
    assert (len(lines) <= most, max(map(len, lines)) <= 80) == (True, True), out
    return status, " ".join(out.split())


@pytest.mark.parametrize(
    ("name", "cause"),
    [
        # 2 to 4 s each; the slow ones have their cause in the other kind of file
        *(
            pytest.param("six_bar.yaml", cause, marks=pytest.mark.slow)
            if "damp" in cause
            else ("six_bar.yaml", cause)
            for cause in MODELS
        ),
        pytest.param("six_bar.xml", "axis", marks=pytest.mark.slow),
        ("six_bar.xml", "damping"),
    ],
)
def test_the_engine_with_a_wrong_model_and_what_is_wrong_in_it_are_named(
    capsys, monkeypatch, files, name, cause
):
    engine, said = MODELS[cause]
    options = ("--set", f"duration={DURATION}") if name.endswith(".xml") else ()
    monkeypatch.setitem(ENGINES, engine.name, engine)
    others = [name for name in ENGINES if name != engine.name]
    status, out = printed(capsys, monkeypatch, files, name, *options)
    assert status == 1
    assert f"DISAGREE: {engine.name} differs; {others[0]}" in out
    assert said in out
    assert f"; {engine.name}'s model is wrong (" in out


@pytest.mark.parametrize("cause", RUNS)
def test_the_engine_with_a_wrong_run_and_why_are_named_and_all_is_there(capsys, monkeypatch, files, cause):
    engine, *said = RUNS[cause]
    monkeypatch.setitem(ENGINES, engine.name, engine)
    status, out = printed(capsys, monkeypatch, files, "six_bar.yaml")
    assert status == (3 if "UNFINISHED" in out else 1)
    assert [words for words in said if words not in out] == [], out
    assert run(capsys, "report", "out")[0] == 0
    written = {path.name for path in Path("out").iterdir() if path.stat().st_size}
    assert written >= {"six_bar.rrd", "summary.json", "report.html", "newton_euler.npz"}


@pytest.mark.slow
def test_an_engine_that_does_not_end_is_named_with_its_time(capsys, monkeypatch, files):
    """Five seconds, within which all else ends on any machine."""
    monkeypatch.setitem(ENGINES, "pinocchio", with_runs("pinocchio", endless))
    status, out = printed(capsys, monkeypatch, files, "six_bar.yaml", "--set", "time=5")
    assert status == 3
    assert f"UNFINISHED: pinocchio: {DURATION:g} s of six_bar: given up after 5 s of processor time; " in out
    assert "; newton_euler and mujoco ran to the end; " in out
