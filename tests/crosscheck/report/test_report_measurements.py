"""Pages about what was measured: planted faults and baselines."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from command_line import EXAMPLE, run
from test_report import report

from crosscheck.errors import CrosscheckError
from crosscheck.scenes import load
from crosscheck.scenes.scene_file import write_scene
from crosscheck.studies.faults.catalog import catalog


def test_planted_faults(tmp_path, capsys, monkeypatch):
    """What the command says, as a page."""
    few = catalog(load(str(EXAMPLE)), (1e-1, 1e-3))[::15]
    monkeypatch.setattr("crosscheck.studies.faults.find.catalog", lambda scene, sizes: few)
    status, out, _ = run(capsys, "faults", EXAMPLE, "--engine", "pinocchio", "--output", tmp_path)
    assert status == 0
    found, content = report(tmp_path), json.loads((tmp_path / "faults.json").read_text())
    verdict, wall_time = (content["report"][name] for name in ("verdict", "wall_time"))
    assert f"{verdict} ({wall_time:.3g} s)" in found.words
    for fault in few:
        assert fault.name in found.words
    hidden = [line for line in out.splitlines() if line.startswith("unobservable")]
    assert hidden
    assert all(line in found.words for line in hidden)
    assert {"pinocchio", "by 0.1", "without a size"} <= set(found.text)


def test_what_regress_writes(tmp_path, capsys, monkeypatch):
    """A page of scenes that are quiet; of one that moved also its figures and its recording."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("crosscheck.recording.screenshot.screenshot", lambda *_: b"\x89PNG")
    swing, model = replace(load("pendulum"), duration=0.5), tmp_path / "pendulum.yaml"
    write_scene(swing, model)
    assert run(capsys, "regress", model, "--update", "as delivered")[0] == 0
    status, text, _ = run(capsys, "regress", model, "--output", "out")
    assert status == 0
    assert "wrote out/regress.json" in text
    quiet = report(tmp_path / "out")
    assert "QUIET: all " in quiet.words
    assert "(as delivered)" in quiet.words
    assert quiet.images == {}
    write_scene(replace(swing, gravity=1.1 * swing.gravity), model)
    assert run(capsys, "regress", model, "--output", "out")[0] == 1
    moved = report(tmp_path / "out")
    assert "MOVED: 1 of 1 scenes: pendulum" in moved.words
    assert list(moved.images) == ["pendulum: the recording at 0 s"]
    (tmp_path / "out" / "pendulum.rrd").unlink()
    with pytest.raises(CrosscheckError, match=r"pendulum\.rrd: missing, regress\.json beside it"):
        report(tmp_path / "out")
