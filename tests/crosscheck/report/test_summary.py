"""The summary that `crosscheck run` prints: 25 lines of 80 columns, and what stands in them."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

from command_line import run
from support.results import crosscheck_of

from crosscheck.compare.check import FILE, REFERENCE, Check
from crosscheck.compare.reference_values import ReferenceCheck
from crosscheck.engines.engine_runs import Stop
from crosscheck.library.references import ReferenceValue
from crosscheck.report.render import terminal
from crosscheck.report.summary import (
    MAX_NOTES,
    MAX_NOTES_IF_FAILING,
    brief_settings,
    engines_table,
    levels_table,
    summary,
)

LINKAGE = Path(__file__).parents[3] / "examples" / "linkage.xml"


def figure(level, between, value, tolerance=1e-6, quantity="mass, rel", where="rod"):
    return Check(level, quantity, between, value, tolerance, where)


def cells(table):
    return {row[0].text: [cell.text for cell in row[1:]] for _, row in table.sections()}


def test_levels_have_the_worst_of_each_engine_and_the_one_nearest_its_tolerance():
    rows = [
        figure("model", ("newton_euler", "mujoco"), 1e-9, quantity="inertia, rel", where="crank"),
        figure("model", ("newton_euler", "mujoco"), 2e-8),
        figure("model", ("newton_euler", "pinocchio"), 3e-9),
        figure("model", ("mujoco", "pinocchio"), 5e-7, where="rocker"),
        figure("model", ("relative", "cartesian"), 4e-9),
        figure("drift", ("newton_euler",), 1e-7),
        figure("drift", ("mujoco",), 4e-3, quantity="constraint violation, m or rad", where="pin at 1 s"),
    ]
    assert cells(levels_table(crosscheck_of(rows))) == {
        "model": ["5 ok", "2.0e-08", "3.0e-09", "50 % rocker, mass"],
        "drift": ["1/2 FAIL", "4.0e-03", "-", "4000 x pin, 1 s"],
    }


def test_what_is_not_judged_is_not_counted_and_files_and_reference_values_are():
    informs = Check("kinematics", "condition", ("newton_euler", "mujoco"), 1e3, 1.0, "", judged=False)
    known = ReferenceValue(2.0, "angle", "rad", 0.25, 1e-9)
    reference_checks = [ReferenceCheck.of("mujoco", known, 0.25 + 2e-9, 1e-8)]
    checks = [informs, figure("reading", ("mujoco", FILE), 0.0)]
    found = cells(levels_table(crosscheck_of(checks, reference_checks=reference_checks)))
    assert found["reading"] == ["1 ok", "0.0e+00", "-", "<1 % rod, mass"]
    assert found[REFERENCE][:2] == ["1 ok", "2.0e-09"]
    assert found.keys() == {"reading", REFERENCE}


def test_engines_have_their_time_their_error_and_when_they_stopped():
    settings = {"timestep": 1e-3, "integrator": "RK4", "solref": [0.002, 1.0], "steps": 5000}
    adaptive = {
        "formulation": "relative",
        "stabilization": "projection",
        "integrator": "DOP853",
        "rtol": 1e-10,
    }
    runs = {
        "newton_euler": SimpleNamespace(settings=adaptive, wall_time=2.5e-3),
        "mujoco": SimpleNamespace(settings=settings, wall_time=1.5),
    }
    stopped = (Stop("pinocchio", "integration stopped", 0.25),)
    table = engines_table(crosscheck_of(trajectories=runs, unfinished=stopped, run_errors={"mujoco": 7e-8}))
    assert cells(table) == {
        "newton_euler": ["2.5 ms", "", "DOP853 rtol 1e-10, projection, relative"],
        "mujoco": ["1.5 s", "7.0e-08", "RK4 1 ms, solref 0.002 s"],
        "pinocchio": ["", "", "STOPPED at 0.25 s"],
    }
    assert brief_settings({}) == ""


def test_few_notes_are_shown_each_whole(monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    notes = [f"{letter * 40} {letter * 30}" for letter in "abcdef"]
    rows = [figure("model", ("newton_euler", "mujoco"), 0.0)]
    shown = terminal(summary(crosscheck_of(rows), [], notes)).splitlines()
    lines = [line for letter in "abcdef"[:MAX_NOTES] for line in (letter * 40, f"  {letter * 30}")]
    assert shown[-2 * MAX_NOTES :] == lines
    failing = terminal(summary(crosscheck_of([figure("model", ("newton_euler", "mujoco"), 1.0)]), [], notes))
    assert failing.count("a" * 40) == MAX_NOTES_IF_FAILING == 1
    assert "b" * 40 not in failing


def test_what_limits_the_verdict_is_never_cut():
    limits, notes = [letter * 40 for letter in "abcde"], ["f" * 40, "g" * 40]
    agreeing = crosscheck_of([figure("model", ("newton_euler", "mujoco"), 0.0)])
    shown = terminal(summary(agreeing, limits, notes))
    assert all(line in shown for line in limits)
    assert not any(line in shown for line in notes)
    few = terminal(summary(agreeing, limits[:2], notes))
    assert [line in few for line in notes] == [True, False]


def test_a_run_of_a_file_takes_40_lines_of_80_columns(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.chdir(tmp_path)
    shutil.copy(LINKAGE, tmp_path)  # whose path the last line repeats
    status, out, _ = run(capsys, "run", LINKAGE.name, "--set", "key=go")
    lines = out.splitlines()
    assert (status, len(lines) <= 40, max(map(len, lines)) <= 80) == (0, True, True), out
