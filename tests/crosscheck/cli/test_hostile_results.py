"""Broken results, impossible options, what is too large: refused in one line, soon, and nothing is lost."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from command_line import scene_file, short_example
from hostile_options import option_cases
from hostile_process import LONGEST_LINE, MEMORY, PROCESSOR_TIME, Server
from hostile_results import (
    Refused,
    archive_cases,
    array_cases,
    baseline_cases,
    json_cases,
    size_cases,
)

ENGINES = "newton_euler,pinocchio"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run of two engines."""
    from crosscheck.cli import main

    folder = tmp_path_factory.mktemp("finished")
    path = scene_file(folder, short_example())
    with pytest.raises(SystemExit) as ended:
        main(["run", str(path), "--engines", ENGINES, "--output", str(folder / "out")])
    assert not ended.value.code
    return folder / "out"


def contents(folder: Path) -> dict[Path, bytes | None]:
    """All files below a folder; None in place of the content of what is none."""
    paths = [path for path in folder.rglob("*") if not path.is_dir()]
    return {path: path.read_bytes() if path.is_file() else None for path in paths}


def check(case: Refused, server: Server, tmp_path: Path) -> None:
    folder = tmp_path / "case"
    arguments = case.make(folder)
    before = contents(folder)
    outcome = server.run(folder, arguments)
    err = (tmp_path / "case.stderr").read_text()
    assert not outcome["hangs"]
    assert outcome["processor_time"] < PROCESSOR_TIME
    assert outcome["memory"] < MEMORY
    assert outcome["status"] == 2, err
    line = err.removesuffix("\n")
    assert line.isprintable()
    assert line.startswith("crosscheck: error: ")
    assert "internal error" not in line
    assert re.search(case.message if "*" in case.message else re.escape(case.message), line), line
    assert len(line) < LONGEST_LINE + 2 * max(map(len, arguments))
    assert contents(folder) == before


KINDS = (json_cases, baseline_cases, size_cases, option_cases)
CASES = {case.name: case for kind in KINDS for case in kind()}
LEVELS_OF_RUNS = (array_cases, archive_cases)
RUN_CASES = [case.name for kind in LEVELS_OF_RUNS for case in kind(Path())]
FAST, FAST_RUN = list(CASES)[::15], [*RUN_CASES[1::15], "archives exchanged"]


@pytest.mark.parametrize("name", FAST)
def test_what_cannot_be_used_is_refused_in_one_line(name: str, server: Server, tmp_path: Path) -> None:
    check(CASES[name], server, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CASES if name not in FAST])
def test_more_that_cannot_be_used(name: str, server: Server, tmp_path: Path) -> None:
    check(CASES[name], server, tmp_path)


@pytest.mark.parametrize("name", FAST_RUN)
def test_a_damaged_run_is_refused(name: str, server: Server, finished: Path, tmp_path: Path) -> None:
    (case,) = (case for kind in LEVELS_OF_RUNS for case in kind(finished) if case.name == name)
    check(case, server, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in RUN_CASES if name not in FAST_RUN])
def test_more_damaged_runs(name: str, server: Server, finished: Path, tmp_path: Path) -> None:
    (case,) = (case for kind in LEVELS_OF_RUNS for case in kind(finished) if case.name == name)
    check(case, server, tmp_path)
