"""Hostile values in every argument and option of every command: refused in one line, or carried out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hostile_commands import command_lines
from hostile_files import TEXTS, WEDGE
from hostile_process import Server

from crosscheck.compare.outcome import ExitStatus

LINES = list(command_lines())

MOTION = "time,coordinate.motor\n0,0\n0.02,0.001\n0.04,0.002\n"

CATALOG = "name,rated_torque,rated_speed\nsmall,1,100\n"

LONGEST = 600
"""Characters of a line."""

NUMBER = re.compile(r"(?<![a-z])nan(?![a-z])", re.IGNORECASE)

GROUPS = 30
"""Tests that share the command lines."""

SAMPLED = 149
"""One of so many command lines is tried by default, from every command."""


def check(arguments: tuple[str, ...], server: Server, folder: Path) -> None:
    (folder / "parts").mkdir(parents=True)
    files = {**TEXTS, "motion.csv": MOTION, "catalog.csv": CATALOG, "parts/wedge.obj": WEDGE}
    for name, text in files.items():
        (folder / name).write_text(text)
    before = set(folder.rglob("*"))
    outcome = server.run(folder, list(arguments))
    out, err = (folder.with_suffix(f".{stream}").read_text() for stream in ("stdout", "stderr"))
    assert not outcome["hangs"]
    assert outcome["status"] in set(ExitStatus), err
    assert "Traceback" not in out + err
    assert not NUMBER.search(out)
    written = {path for path in set(folder.rglob("*")) - before if path.is_file()}
    assert not {path for path in written if path.name.startswith(".") and path.suffix != ".lock"}
    if outcome["status"] == ExitStatus.BAD_INPUT:
        *others, line = err.splitlines()
        assert line.startswith("crosscheck: error: ")
        assert not [other for other in others if other.startswith("crosscheck: error")]
        assert line.isprintable()
        assert "internal error" not in line
        assert len(line) < LONGEST + len("".join(arguments[:1]))
        assert {path.name for path in written} <= {".sweep.lock"}


@pytest.mark.parametrize("number", range(SAMPLED // 2, len(LINES), SAMPLED))
def test_a_hostile_value_of_an_option(number: int, server: Server, tmp_path: Path) -> None:
    check(LINES[number], server, tmp_path / "case")


@pytest.mark.slow
@pytest.mark.parametrize("group", range(GROUPS))
def test_every_hostile_value_of_every_option(group: int, server: Server, tmp_path: Path) -> None:
    for number in range(group, len(LINES), GROUPS):
        check(LINES[number], server, tmp_path / str(number) / "case")
    print(f"command lines: {len(LINES[group::GROUPS])}")
