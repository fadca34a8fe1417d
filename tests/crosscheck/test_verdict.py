"""`crosscheck.check`: models from Python, and what it returns."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio
import pytest
from rerun.chunk import RrdReader

import crosscheck
import urdf
from crosscheck.library import load
from crosscheck.report.output import to_record
from crosscheck.support.errors import CrosscheckError

LINKAGE = Path(__file__).parents[2] / "examples" / "linkage.xml"


@pytest.fixture(scope="module")
def verdict():
    return crosscheck.check(replace(load("pendulum"), duration=0.1), ["newton_euler", "pinocchio"])


def test_a_scene_is_checked(verdict):
    assert verdict.agrees
    assert verdict.diagnosis == ()
    assert set(verdict.trajectories) == {"newton_euler", "pinocchio"}
    assert all(figure.agrees for figure in verdict.checks)
    verdict.assert_agrees()


def test_representations_are_short(verdict):
    assert repr(verdict).startswith("<AGREE: newton_euler, pinocchio ")
    assert "\n" not in repr(verdict)
    assert str(verdict).splitlines()[1] == repr(verdict)[1:-1]
    page = verdict._repr_html_()
    assert '<div class="answer holds"><b>AGREE</b><span>newton_euler, pinocchio ' in page
    assert page.count("<table") == 2


def test_results_are_saved(verdict, tmp_path):
    files = {path.name for path in verdict.save(tmp_path / "out")}
    assert files == {path.name for path in (tmp_path / "out").iterdir()}
    assert files == {"newton_euler.npz", "pinocchio.npz", "summary.json", "junit.xml", "pendulum.rrd"}


def test_a_file_is_checked_with_its_options():
    found = crosscheck.check(LINKAGE, ["newton_euler"], key="go", duration=0.05)
    assert found.crosscheck.options == {"excitation": "on", "key": "go", "duration": "0.05"}  # as it was run
    assert found.trajectories["newton_euler"].time[-1] == 0.05
    with pytest.raises(CrosscheckError, match="has no option 'duratoin'; did you mean 'duration'"):
        crosscheck.check(LINKAGE, duratoin=1)


@pytest.mark.slow
def test_models_of_mujoco_are_checked_as_they_are_in_memory():
    spec = mujoco.MjSpec.from_file(str(LINKAGE))
    options = {"key": "go", "duration": 0.05}
    first, second = (
        crosscheck.check(each, ["newton_euler"], **options) for each in (LINKAGE, spec.compile())
    )
    assert second.crosscheck.source == ""
    assert second.crosscheck.mapping is not None
    runs = [found.trajectories["newton_euler"].position for found in (first, second)]
    np.testing.assert_array_equal(*runs)
    with pytest.raises(CrosscheckError, match="MjSpec has no option 'root'"):
        crosscheck.check(spec, root=".")
    with pytest.raises(
        CrosscheckError, match=r"^3 cannot be read; needed: a name, a path, a Scene, a mujoco"
    ):
        crosscheck.check(3)


def test_models_of_pinocchio_are_checked_with_their_constraints():
    model = pinocchio.buildModelFromXML(urdf.to_urdf(load("pendulum")))
    tip = pinocchio.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    held = pinocchio.RigidConstraintModel(pinocchio.ContactType.CONTACT_3D, model, 1, tip)
    free, stuck = (
        crosscheck.check((model, several), ["newton_euler"], q=[0.25], gravity=(0, 0, -1.0), duration=0.05)
        for several in ([], [held])
    )
    given = {"q": "0.25", "gravity": "0.0,0.0,-1.0", "duration": "0.05"}
    assert free.crosscheck.options == {"excitation": "on"} | given
    assert np.ptp(free.trajectories["newton_euler"].position, axis=0).max() > 1e-3
    assert np.ptp(stuck.trajectories["newton_euler"].position, axis=0).max() < 1e-12
    with pytest.raises(CrosscheckError, match="Model has no option 'key'"):
        crosscheck.check(model, key="home")


def test_options_are_not_of_scenes():
    with pytest.raises(CrosscheckError, match="options are of names and files, not of a Scene: N"):
        crosscheck.check(load("pendulum"), N=3)


def test_a_disagreement_is_an_assertion(verdict):
    wrong = [
        replace(row, value=1.0) if (row.quantity, row.between[0]) == ("mass, rel", "newton_euler") else row
        for row in verdict.checks
    ]
    found = crosscheck.Verdict(replace(verdict.crosscheck, checks=tuple(wrong)))
    assert not found.agrees
    level = r"(?s)DISAGREE: .* level 'model': mass, rel: 1 > .*\nmodel +1/\d+ FAIL"
    with pytest.raises(AssertionError, match=level):
        found.assert_agrees()


def test_its_recording_names_the_verdict_and_leads_to_what_is_worst(verdict):
    _, _, text, title, _, moments, *_ = to_record(verdict.crosscheck, verdict.report)
    assert title == "pendulum"
    assert text.startswith("# AGREE\n\n**newton_euler, pinocchio agree")
    assert "[dumbbell](recording://mechanism/newton_euler/dumbbell)" in text
    times = verdict.trajectories["newton_euler"].time
    assert [line.partition(":")[0] for _, line in moments][:2] == ["trajectories", "drift"]
    assert all(times[0] <= time <= times[-1] for time, _ in moments)


def test_it_opens_a_viewer_and_leaves_no_thread(verdict, monkeypatch, tmp_path):
    import rerun as rr

    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    if sys.platform == "linux":
        with pytest.raises(CrosscheckError, match="no display"):
            verdict.show()
    monkeypatch.setenv("DISPLAY", ":0")
    files = (tmp_path / f"{number}.rrd" for number in range(9))
    monkeypatch.setattr(rr.RecordingStream, "spawn", lambda stream: stream.save(next(files)))
    verdict.show()  # starts the threads that all recordings share
    before = len(os.listdir("/proc/self/task"))
    for _ in range(4):
        verdict.show()
    assert (
        len(os.listdir("/proc/self/task")) <= before + 2
    )  # of the last recording, which may still be ending
    for path in tmp_path.iterdir():
        assert any(chunk.entity_path == "/verdict" for chunk in RrdReader(path).stream())
    assert len(list(tmp_path.iterdir())) == 5
