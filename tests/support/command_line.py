"""Running the command line and making scene files, for the tests that do."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from crosscheck.cli import main

EXAMPLE = Path(__file__).parents[2] / "examples" / "four_bar.yaml"


def short_example():
    """The example's content, cut to a short run."""
    content = yaml.safe_load(EXAMPLE.read_text())
    content["duration"] = 0.05
    return content


def run(capsys, *arguments):
    """Exit status, standard output and standard error of a command line."""
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return caught.value.code or 0, captured.out, captured.err


class NoAliases(yaml.SafeDumper):
    """Scene files may not hold aliases, which PyYAML writes for a list that is there twice."""

    def ignore_aliases(self, data):
        return True


def scene_file(folder, content, name="scene.yaml"):
    path = folder / name
    path.write_text(content if isinstance(content, str) else yaml.dump(content, Dumper=NoAliases))
    return path


def csv_rows(path):
    """Rows of a CSV file, cells by the name of their column."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def check_refused(capsys, tmp_path, *arguments, message):
    """One line on standard error, status 2, nothing written."""
    before = set(tmp_path.rglob("*"))
    status, out, err = run(capsys, "run", *arguments, "--output", tmp_path / "results" / "out")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("crosscheck: error: ")
    assert message in err
    assert not [p for p in set(tmp_path.rglob("*")) - before if p.is_file()]


def command(folder, *arguments, **options):
    """`python -m crosscheck` run in a folder, its standard output captured unless told otherwise."""
    return subprocess.run(
        [sys.executable, "-m", "crosscheck", *map(str, arguments)],
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "timeout": 120} | options,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
    )


def verdict_of(out: str) -> str:
    """The verdict that `run` printed, below the title of its summary."""
    return out.splitlines()[1]
