"""Pages about what was measured: benchmarks, planted faults, baselines, what engines survive."""

from __future__ import annotations

import json

from command_line import EXAMPLE, run
from test_report import EVIL, MEASURED, PNG, report

from crosscheck.scenes import load
from crosscheck.studies.faults.catalogue import catalogue


def test_benchmarks(tmp_path):
    content = {
        "scene": "tracker",
        "source": "tracker",
        "options": {},
        "duration": 5.0,
        "outputs": 51,
        "reference": {},
        "loadings": [],
        "machine": {"processor": EVIL},
        "answer": "newton_euler needs 0.68 ms\n  mujoco needs 30 ms",
        "table": [{"error": 1e-6, "cheapest": {"mujoco": None}, "notes": ["a", "b"]}],
        "settings": [],
    }
    (tmp_path / "bench.json").write_text(json.dumps(content))
    rhs = MEASURED | {
        "words": ["0.4 us a call"],
        "right_hand_sides": [{"times": [4e-7, *[3e-7] * 6, *[2e-7] * 6]}],
    }
    (tmp_path / "rhs.json").write_text(json.dumps(rhs))
    batch = MEASURED | {
        "words": ["41 runs a second"],
        "sides": [],
        "duration": 1.0,
        "outputs": 3,
        "error": 1e-6,
    }
    (tmp_path / "batch.json").write_text(json.dumps(batch))
    (tmp_path / "scaling.json").write_text(
        json.dumps(MEASURED | {"words": [], "sizes": {"10": [{"way": "lcaba"}]}})
    )
    (tmp_path / "work_precision.png").write_bytes(PNG)
    (tmp_path / "scaling.png").write_bytes(PNG + b"2")
    found = report(tmp_path)
    assert found.images == {"work precision": PNG, "scaling": PNG + b"2"}
    for text in (
        "newton_euler needs 0.68 ms",
        "  mujoco needs 30 ms",
        "0.4 us a call",
        "41 runs a second",
        "lcaba",
        "1e-06",
        "a, b",
        "3e-07, the median of 13 from 2e-07 to 4e-07",
        EVIL,
    ):
        assert text in found.words


def test_planted_faults(tmp_path, capsys, monkeypatch):
    """What the command says, as a page."""
    few = catalogue(load(str(EXAMPLE)), (1e-1, 1e-3))[::15]
    monkeypatch.setattr("crosscheck.studies.faults.find.catalogue", lambda scene, sizes: few)
    status, out, _ = run(capsys, "faults", EXAMPLE, "--engine", "pinocchio", "--output", tmp_path)
    assert status == 0
    found, content = report(tmp_path), json.loads((tmp_path / "faults.json").read_text())
    assert f"{content['verdict']} ({content['wall_time']:.3g} s)" in found.words
    for fault in few:
        assert fault.kind in found.words
    hidden = [line for line in out.splitlines() if line.startswith("unobservable")]
    assert hidden
    assert all(line in found.words for line in hidden)
    assert {"pinocchio", "0.1", "no size", "100%, 100%"} <= set(found.text)


def test_what_regress_writes(tmp_path, capsys):
    """Whether a scene moved or not, its folder is one that the page knows."""
    out = tmp_path / "out"
    status, text, _ = run(capsys, "regress", "pendulum", "--output", out)
    assert status == 0
    assert f"wrote {out / 'regress.json'}" in text
    assert [path.name for path in out.iterdir()] == ["regress.json"]
    assert "QUIET: all " in report(out).words
    elsewhere = tmp_path / "elsewhere.json"
    assert run(capsys, "regress", "pendulum", "--output", tmp_path / "none", "--json", elsewhere)[0] == 0
    assert elsewhere.is_file()
    assert not (tmp_path / "none").exists()


def test_what_engines_survive(tmp_path):
    row = {"topic": "a", "name": EVIL, "engine": "mujoco", "setting": "RK4", "quantity": "drift", "unit": "m"}
    row |= {"figure": 2e-9, "bound": "<= 1e-06", "verdict": "survives", "reason": "", "passes": True}
    row |= {"bound_reason": "round-off", "wall_time": 0.1, "curves": []}
    failed = row | {"figure": "inf", "verdict": "fails", "reason": "blown up", "passes": False}
    refused = row | {"topic": "b", "figure": None, "verdict": "refuses", "reason": "singular"}
    passed = {"(a) long runs": {"mujoco": "1 of 2", "all": ""}, "(b) dead centres": {"mujoco": "1 of 1"}}
    content = {"form": "ci", "wall_time": 9.5, "versions": {"numpy": "2.4"}, "passed": passed}
    (tmp_path / "stress.json").write_text(json.dumps(content | {"rows": [row, failed, refused]}))
    (tmp_path / "stress_long_runs.png").write_bytes(PNG)
    found = report(tmp_path)
    assert found.images == {"stress long runs": PNG}
    for text in (
        "2 of 3 cases pass (9.5 s)",
        "(a) long runs: 2 cases",
        "(b) dead centres: 1 cases",
        "1 of 2",
    ):
        assert text in found.words
    for text in ("2.0e-09", "inf", "blown up", "singular", "drift, m", "<= 1e-06", EVIL):
        assert text in found.words
