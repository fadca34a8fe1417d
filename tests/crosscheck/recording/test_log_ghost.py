"""Logs in a recording: a ghost at the poses of the log beside its reference, and its error over time."""

from __future__ import annotations

import struct
from pathlib import Path

import mujoco
import numpy as np
import pytest
from recordings import Recording, read_recording
from test_rerun_log import layout

import crosscheck
from crosscheck.own_run.errors import errors_over_time
from crosscheck.recording.entities import MIN_VISIBLE_DISTANCE
from crosscheck.recording.screenshot import MECHANISM, screenshots
from crosscheck.verdict import Verdict
from newton_euler.scalars import Array

PENDULUM = """<mujoco model="swing"><option timestep="{step}" integrator="Euler"/><worldbody>
  <body name="bar" euler="0 40 0"><joint name="hinge" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.4" contype="0"/>
    <body name="tip" pos="0 0 -0.3"><joint name="end" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.1" contype="0"/></body></body>
  </worldbody></mujoco>"""

START, SPEED, DURATION = 0.3, 2.0, 0.4
"""Start of the logs, which is not that of the file: angle of the hinge, rad, its rate, rad/s; and end, s."""


def logged(step: float) -> tuple[dict[str, Array], Array]:
    """The poses of the bar alone by plain MuJoCo, as the columns of a log, and its centers of mass (n, 3)."""
    model = mujoco.MjModel.from_xml_string(PENDULUM.format(step=step))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = START, SPEED
    rows, every = [], round(0.02 / step)
    for k in range(round(DURATION / step) + 1):
        if k % every == 0:
            mujoco.mj_forward(model, data)
            rows.append([data.time, *data.qpos, *data.qvel, *data.xipos[1]])
        mujoco.mj_step(model, data)
    table = np.array(rows)
    names = ["time", "hinge", "end", "hinge_vel", "end_vel"]
    return dict(zip(names, table.T[:5], strict=True)), table[:, 5:]


def checked(folder: Path, **logs: dict[str, Array]) -> tuple[Verdict, Path]:
    """Check the pendulum with logs, and save the results; the path is that of the recording."""
    path = folder / "swing.xml"
    path.write_text(PENDULUM.format(step=0.002))
    verdict = crosscheck.check(path, ["newton_euler"], runs=logs, excitation="off", duration=1.0)
    *_, recording = verdict.save(folder / "out")
    return verdict, recording


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> tuple[Verdict, Path]:
    """Logs of a step that is too long, and of a step whose error nobody can see."""
    coarse, fine = logged(0.02)[0], logged(1e-5)[0]
    return checked(tmp_path_factory.mktemp("swing"), isaac=coarse, fine=fine)


def drawn(recording: Recording, entity: str) -> Array:
    return np.array(recording.columns[entity, "Transform3D:translation"])[:, 0]


@pytest.mark.slow
def test_the_ghost_is_where_the_log_is(saved: tuple[Verdict, Path]) -> None:
    verdict, path = saved
    recording, (table, centers) = read_recording(path), logged(0.02)
    # poses are stored in single precision
    np.testing.assert_allclose(drawn(recording, "/logs/isaac/log/bar"), centers, atol=1e-6)
    times = recording.times["/logs/isaac/log/bar"]
    np.testing.assert_allclose(np.array(times), 1e9 * table["time"], atol=1.0)
    # the solid reference starts with the log, and is the motion of plain MuJoCo at a small step
    exact = logged(1e-5)[1]
    np.testing.assert_allclose(drawn(recording, "/logs/isaac/reference/bar"), exact, atol=1e-4)
    assert times == recording.times["/logs/isaac/reference/tip"]
    # the distance of both is the error of the judgement
    apart = drawn(recording, "/logs/isaac/log/tip") - drawn(recording, "/logs/isaac/reference/tip")
    error = verdict.logs["isaac"].error
    assert error.position_at[0] == "tip"
    assert np.max(np.linalg.norm(apart, axis=1)) == pytest.approx(error.position, abs=1e-6)


def test_the_recording_has_the_error_of_the_log_over_time(saved: tuple[Verdict, Path]) -> None:
    verdict, path = saved
    recording, judgement = read_recording(path), verdict.logs["isaac"]
    errors = errors_over_time(judgement.run, judgement.reference)
    for name, values in zip(("position", "rotation"), errors, strict=True):
        line = f"/plots/logs/isaac/{name}/isaac"
        np.testing.assert_array_equal(recording.scalars(line), values.max(axis=1))
        np.testing.assert_allclose(np.array(recording.times[line]), 1e9 * judgement.run.time, atol=1.0)


def test_each_log_has_a_view_and_a_ghost_that_cannot_be_told_apart_is_hidden(
    saved: tuple[Verdict, Path],
) -> None:
    verdict, path = saved
    found = layout(path)
    visible = MIN_VISIBLE_DISTANCE * verdict.crosscheck.scene.mechanism.size
    assert verdict.logs["isaac"].error.position > visible > verdict.logs["fine"].error.position
    names = found["ViewBlueprint:display_name"]
    assert any(name.startswith("isaac: newton_euler solid; isaac ghost, up to ") for name in names)
    assert any(name.startswith("fine: newton_euler solid; fine hidden, within ") for name in names)
    assert "logs/fine/log" in found["hidden"]
    assert "logs/isaac/log" not in found["hidden"]


@pytest.mark.slow
def test_bodies_that_a_log_does_not_determine_have_no_ghost(tmp_path: Path) -> None:
    path = "examples/linkage.xml"
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("go").id)
    rows = []
    for _ in range(50):
        rows.append([data.time, data.joint("motor").qpos[0], data.joint("motor").qvel[0]])
        mujoco.mj_step(model, data)
    log = dict(zip(("time", "motor", "motor_vel"), np.array(rows).T, strict=True))
    verdict = crosscheck.check(path, ["newton_euler"], runs={"motor": log}, duration=0.2)
    assert verdict.logs["motor"].compared == ("crank",)
    *_, recording = verdict.save(tmp_path)
    entities = {entity for entity in read_recording(recording).entities if entity.startswith("/logs/motor/")}
    bodies = ("coupler", "crank", "rocker")
    assert entities == {"/logs/motor/log/crank", *(f"/logs/motor/reference/{body}" for body in bodies)}


@pytest.mark.skipif(not list(Path("/usr/share/vulkan/icd.d").glob("*.json")), reason="needs a Vulkan driver")
def test_pictures_are_of_the_view_of_the_first_log(saved: tuple[Verdict, Path]) -> None:
    """The viewer makes no picture of the views in the tabs behind it."""
    (window,) = screenshots(saved[1], [0.3])
    first, last = screenshots(saved[1], [0.0, 0.3], MECHANISM)
    assert first != last
    size, of_window = (struct.unpack(">II", png[16:24]) for png in (first, window))  # width and height
    assert all(view < whole for view, whole in zip(size, of_window, strict=True))


@pytest.mark.slow
def test_recordings_without_logs_have_none(tmp_path: Path) -> None:
    _, path = checked(tmp_path)
    assert not [entity for entity in read_recording(path).entities if entity.startswith("/logs")]
