"""The run with the settings of a file in a recording: a ghost at its poses, and its error over time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import read_recording
from test_rerun_log import layout

import crosscheck
from crosscheck.own_run.errors import errors_over_time
from crosscheck.own_run.judge import Judgement
from crosscheck.recording.entities import MIN_VISIBLE_DISTANCE
from crosscheck.recording.own_run import YOUR_SETTINGS, displaced
from crosscheck.verdict import Verdict
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector

PENDULUM = """<mujoco model="swing"><option timestep="{step}" integrator="Euler"/><worldbody>
  <body name="bar" euler="0 40 0"><joint name="hinge" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.4" contype="0"/></body>
  </worldbody></mujoco>"""

GHOST = f"/mechanism/{YOUR_SETTINGS}/bar"


def checked(folder: Path, step: float) -> Verdict:
    path = folder / "swing.xml"
    path.write_text(PENDULUM.format(step=step))
    return crosscheck.check(path, ["newton_euler", "mujoco"])


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Verdict:
    """A pendulum with a step that is too long."""
    return checked(tmp_path_factory.mktemp("swing"), 0.02)


def judged(verdict: Verdict) -> Judgement:
    assert verdict.own_run is not None
    return verdict.own_run


def test_the_ghost_stands_where_the_run_of_the_file_is(swing: Verdict) -> None:
    own, first = judged(swing), swing.trajectories["newton_euler"]
    ghost = displaced(first, own)
    both = np.isin(np.round(first.time, 9), np.round(own.run.time, 9))[: len(ghost.time)]
    at = np.isin(np.round(own.run.time, 9), np.round(ghost.time, 9))
    assert both.sum() == at.sum() > 10
    # the reference and the engine's run differ by their integration errors only
    np.testing.assert_allclose(ghost.position[both], own.run.position[at], atol=1e-8)
    assert np.max(angle_between(ghost.quaternion[both], own.run.quaternion[at])) < 1e-7
    assert np.max(np.abs(ghost.position - first.position[: len(ghost.time)])) == pytest.approx(
        own.error.position, rel=0.1
    )


def test_errors_between_outputs_are_interpolated(swing: Verdict) -> None:
    """A constant error is the same at all times, also beside the outputs, in a run that ends early."""
    first = swing.trajectories["newton_euler"]
    reference = first.first(len(first.time) // 2)
    turn = from_rotation_vector(np.array([0.0, 0.3, 0.0]))
    shift = np.array([0.1, 0.0, 0.02])
    turned = np.broadcast_to(turn, reference.quaternion.shape)
    run = replace(reference, position=reference.position + shift, quaternion=turned)
    still = replace(reference, quaternion=np.broadcast_to([1.0, 0.0, 0.0, 0.0], turned.shape))
    coarse = slice(None, None, 7)
    sampled = [
        replace(
            each, time=each.time[coarse], position=each.position[coarse], quaternion=each.quaternion[coarse]
        )
        for each in (run, still)
    ]
    ghost = displaced(first, replace(judged(swing), run=sampled[0], reference=sampled[1]))
    assert ghost.time[-1] == sampled[0].time[-1]
    moved = ghost.position - first.position[: len(ghost.time)]
    np.testing.assert_allclose(moved, np.broadcast_to(shift, moved.shape), atol=1e-12)
    turned_by = angle_between(ghost.quaternion, first.quaternion[: len(ghost.time)])
    np.testing.assert_allclose(turned_by, 0.3, atol=1e-12)


def test_the_recording_has_the_ghost_and_its_error(swing: Verdict, tmp_path: Path) -> None:
    *_, path = swing.save(tmp_path)
    found, own = read_recording(path), judged(swing)
    ghost = displaced(swing.trajectories["newton_euler"], own)
    drawn = np.array(found.columns[GHOST, "Transform3D:translation"])[:, 0]
    np.testing.assert_allclose(drawn, ghost.position[:, 1], atol=1e-6)
    for name, values in zip(("position", "rotation"), errors_over_time(own.run, own.reference), strict=True):
        curve = found.scalars(f"/plots/{YOUR_SETTINGS}/{name}/{YOUR_SETTINGS}")
        np.testing.assert_array_equal(curve, values.max(axis=1))
        times = found.times[f"/plots/{YOUR_SETTINGS}/{name}/{YOUR_SETTINGS}"]
        np.testing.assert_allclose(np.array(times), 1e9 * own.run.time, atol=1.0)
    text = found.static["/verdict", "TextDocument:text"][0]
    assert text.index("your settings") < text.index("worst of")


@pytest.mark.parametrize(("step", "seen"), [(0.02, True), (0.00005, False)])
def test_a_ghost_that_cannot_be_told_apart_is_hidden(tmp_path: Path, step: float, seen: bool) -> None:
    verdict = checked(tmp_path, step)
    *_, path = verdict.save(tmp_path / "out")
    visible = MIN_VISIBLE_DISTANCE * verdict.crosscheck.scene.mechanism.size
    assert (judged(verdict).error.position > visible) is seen
    found = layout(path)
    assert (f"mechanism/{YOUR_SETTINGS}" in found["hidden"]) is not seen
    assert (
        any(f"{YOUR_SETTINGS} ghost, up to " in name for name in found["ViewBlueprint:display_name"]) is seen
    )


def test_scenes_without_a_file_have_no_ghost(tmp_path: Path) -> None:
    *_, path = crosscheck.check("pendulum", ["newton_euler"]).save(tmp_path)
    assert not [entity for entity in read_recording(path).entities if YOUR_SETTINGS in entity]
