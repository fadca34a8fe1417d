"""Pages about baselines."""

from __future__ import annotations

from dataclasses import replace

import pytest
from command_line import run
from test_report import report

from crosscheck.library import load
from crosscheck.library.scene_file import write_scene
from crosscheck.support.errors import CrosscheckError


def test_what_regress_writes(tmp_path, capsys, monkeypatch):
    """A page of scenes that are quiet; of one that moved also its figures and its recording."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "crosscheck.recording.screenshot.screenshots", lambda _, moments, __: [b"\x89PNG"] * len(moments)
    )
    swing, model = replace(load("pendulum"), duration=0.5), tmp_path / "pendulum.yaml"
    write_scene(swing, model)
    assert run(capsys, "regress", model, "--update", "as delivered")[0] == 0
    status, text, _ = run(capsys, "regress", model, "--output", "out")
    assert status == 0
    assert "wrote out/regress.json" in text
    quiet = report(tmp_path / "out")
    assert "QUIET\nall " in quiet.words
    assert quiet.images == {}
    write_scene(replace(swing, gravity=1.1 * swing.gravity), model)
    assert run(capsys, "regress", model, "--output", "out")[0] == 1
    moved = report(tmp_path / "out")
    assert "MOVED\n1 of 1 scenes: pendulum" in moved.words
    assert "(as delivered)" in moved.words
    assert list(moved.images) == ["pendulum at 0 s"]
    (tmp_path / "out" / "pendulum.rrd").unlink()
    with pytest.raises(CrosscheckError, match=r"pendulum\.rrd: missing, regress\.json beside it"):
        report(tmp_path / "out")
