"""Results of one model are not overwritten by those of another unless the folder is named."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from command_line import run, scene_file, short_example

from crosscheck.report.output import MODEL_RECORDS


@pytest.mark.slow
def test_results_of_other_models_are_not_overwritten_unasked(capsys, monkeypatch, tmp_path):
    """Models of one name, and scenes of the library beside files of their names."""
    monkeypatch.chdir(tmp_path)
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        scene_file(tmp_path / folder, short_example() | {"name": "mine"}, "pendulum.yaml")
    quick = ("--engines", "newton_euler")
    assert run(capsys, "run", "one/pendulum.yaml", *quick)[0] == 0
    folder = Path("output", "pendulum")
    files = {path: path.read_bytes() for path in folder.iterdir()}
    assert {path.name for path in files} == {"newton_euler.npz", "summary.json", "junit.xml", "pendulum.rrd"}
    for source in ("other/pendulum.yaml", "pendulum"):
        status, out, err = run(capsys, "run", source, *quick)
        assert (status, out) == (2, "")
        assert f"{folder} holds a crosscheck of one/pendulum.yaml, not of {source}; name another fo" in err
    assert "crosscheck of one/pendulum.yaml, not of pendulum" in run(capsys, "run", "--all")[2]
    assert {path: path.read_bytes() for path in folder.iterdir()} == files
    assert run(capsys, "run", tmp_path / "one" / "pendulum.yaml", *quick)[0] == 0
    assert run(capsys, "run", "other/pendulum.yaml", *quick, "--output", folder)[0] == 0
    assert json.loads((folder / "summary.json").read_text())["source"] == "other/pendulum.yaml"


def test_runs_of_other_models_that_were_not_ended_are_not_overwritten_unasked(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        scene_file(tmp_path / folder, short_example(), "pendulum.yaml")
    quick, folder = ("--engines", "newton_euler"), Path("output", "pendulum")
    with monkeypatch.context() as broken:
        broken.setattr("crosscheck.compare.crosscheck.stages", lambda *_: {"comparing": lambda _: 1 / 0})
        for _ in range(2):
            status, out, _ = run(capsys, "run", "one/pendulum.yaml", *quick)
            assert (status, "crosscheck report output/pendulum" in out) == (3, True)
    refused = (
        f"crosscheck: error: {folder} holds {{}}; name another folder (--output), or this one to overwrite"
    )
    status, _, err = run(capsys, "run", "other/pendulum.yaml", *quick)
    told = "a crosscheck of one/pendulum.yaml, not of other/pendulum.yaml"
    assert (status, err) == (2, refused.format(told) + " it\n")
    (folder / "summary.json").unlink()
    status, _, err = run(capsys, "run", "one/pendulum.yaml", *quick)
    assert (status, err) == (2, refused.format("trajectories of an unknown model") + " it\n")
    assert run(capsys, "run", "other/pendulum.yaml", *quick, "--output", folder)[0] == 0
    assert run(capsys, "run", "other/pendulum.yaml", *quick)[0] == 0


@pytest.mark.parametrize("earlier", ["bench.json", "rhs.json", "batch.json", "sensitivities.json"])
def test_benchmarks_of_other_models_are_not_overwritten_unasked(capsys, monkeypatch, tmp_path, earlier):
    monkeypatch.chdir(tmp_path)
    scene_file(tmp_path, short_example() | {"name": "mine"}, "scene.yaml")
    folder = Path("output", "bench", "scene")
    folder.mkdir(parents=True)
    (folder / earlier).write_text('{"source": "other.yaml"}')
    refused = (
        f"{folder} holds a benchmark of other.yaml, not of scene.yaml; name another folder (--output), or"
    )
    for arguments in ((), ("--rhs",), ("--batch", 2)):
        status, _, err = run(capsys, "bench", "scene.yaml", *arguments)
        assert status == 2
        assert err.startswith(f"crosscheck: error: {refused}")


QUICK = {
    "drives": (("--catalog", "drives.csv"), "drive table"),
    "loads": (("--at-rest",), "load table"),
    "modes": ((), "modal analysis"),
    "controllers": (("--engines", "newton_euler"), "comparison of controllers"),
    "workspace": (("--vary", "pivot=-1:1:2"), "workspace"),
    "faults": (("--engines", "newton_euler"), "fault search"),
    "regress": ((), "regression test"),
    "identify": (("measured.csv", "--fit", "bob.mass"), "fit"),
    "sun": (("--axis", "crank=0,0,1", "--latitude", "10", "--date", "2026-03-21"), "solar day"),
    "year": (("--axis", "crank=0,0,1", "--latitude", "10", "--year", "2026"), "solar year"),
}
"""Arguments for each command whose folder is named by the model, and the kind of its results."""


@pytest.mark.parametrize("command", QUICK)
def test_results_of_every_command_are_those_of_one_file(capsys, monkeypatch, tmp_path, command):
    """Folders are named by the file, not by the name of the model in it; one of another file is refused."""
    monkeypatch.chdir(tmp_path)
    arguments, results = QUICK[command]
    home = Path("output", command, "one")
    record = home / MODEL_RECORDS[results][0]
    for path in ("one.yaml", "other/one.yaml"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        scene_file((tmp_path / path).parent, short_example() | {"name": "mine"}, "one.yaml")
    if command in ("drives", "faults", "identify", "regress", "sun", "year"):  # which take long
        home.mkdir(parents=True)
        record.write_text('{"source": "one.yaml"}')
    else:
        assert run(capsys, command, "one.yaml", *arguments)[0] == 0
        assert run(capsys, command, "one.yaml", *arguments)[0] == 0
    assert [path.name for path in home.parent.iterdir()] == ["one"]
    assert json.loads(record.read_text())["source"] == "one.yaml"
    files = {path: path.read_bytes() for path in home.iterdir()}
    (tmp_path / "measured.csv").write_text("time\n0\n")
    status, out, err = run(capsys, command, "other/one.yaml", *arguments)
    assert (status, out) == (2, "")
    assert f"{home} holds a {results} of one.yaml, not of other/one.yaml; name another folder" in err
    assert {path: path.read_bytes() for path in home.iterdir()} == files


def test_a_pipe_is_not_replaced_by_a_file(capsys, tmp_path):
    pipe = tmp_path / "tracker.yaml"
    os.mkfifo(pipe)
    status, _, err = run(capsys, "convert", "tracker", pipe)
    assert (status, pipe.is_fifo()) == (2, True)
    assert f"{pipe}: not a regular file" in " ".join(err.split())
