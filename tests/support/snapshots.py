"""Snapshots of what commands print and write; `make snapshots` updates the files of `tests/snapshots`.

A snapshot holds everything a user reads: the terminal of 80 columns, Markdown, JUnit XML, the names of JSON
fields and the text of the HTML page. A change of a heading or a sentence shows up there, and nowhere else.
Numbers with a fraction, an exponent or a unit of time depend on the processor and are masked by `#`.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout
from html import unescape
from pathlib import Path
from typing import Any
from unittest.mock import patch

import one_thread  # noqa: F401  # before NumPy
import pytest
from wrong_engines import taking

from crosscheck.cli import main
from crosscheck.cli.shared import cli
from crosscheck.engines.registry import ENGINES
from crosscheck.report.page import PAGE
from crosscheck.studies.faults import injection

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "tests" / "snapshots"


def masked(text: str) -> str:
    """Return a text without the numbers, widths and places that depend on the processor."""
    text = re.sub(r"(\d+ ok|\d+/\d+ FAIL)\b.*(\n {12,}.*)*", r"\1 #", text)  # worst values and their places
    text = re.sub(r"[-+]?\b\d+(\.\d+)?e[-+]?\d+", "#", text)
    text = re.sub(r"(?<![\w.])[-+]?\d+(\.\w+)+(\+\w+)?", "#", text)  # fractions and versions
    text = re.sub(r"[-+<]*(\b\d+|#)(?= ([mµ]?s|[mu]?m|deg|%|x)\b)", "#", text)
    text = re.sub(r"# [mµ]s\b", "# s", text)
    text = re.sub(r"\b(\w+_time|steps|rejected|evaluations) [\d#]+", r"\1 #", text)
    text = re.sub(r"─+", "─", text)
    # versions depend on what is installed, so this line is in some snapshots and not in others
    text = re.sub(
        r"^[ -]*versions that changed since the baseline:.*\n( {4,}.*\n)*", "", text, flags=re.MULTILINE
    )
    lines = (re.sub(r"(?<=\S) {2,}", "  ", line).rstrip() for line in text.splitlines())
    return "\n".join(lines) + "\n"


def printed(*arguments: str, status: int = 0) -> str:
    """Return what a command prints on 80 columns, below the command."""
    stream, errors = io.StringIO(), io.StringIO()
    with (
        patch.dict(os.environ, COLUMNS="80"),
        redirect_stdout(stream),
        redirect_stderr(errors),
        pytest.raises(SystemExit) as ended,
    ):
        main(list(arguments))
    assert (ended.value.code or 0) == status, stream.getvalue() + errors.getvalue()
    return f"$ crosscheck {' '.join(arguments)}\n{stream.getvalue()}"


def fields(content: Any, path: str = "") -> Iterator[str]:
    """Yield the path of each field of a JSON document once. Names of engines stand for all of them."""
    if isinstance(content, dict):
        for name, value in content.items():
            yield from fields(value, f"{path}.{'ENGINE' if name in ENGINES else name}")
    elif isinstance(content, list):
        for value in content:
            yield from fields(value, f"{path}[]")
    else:
        yield path.removeprefix(".")


def json_fields(path: Path, only: str = "") -> str:
    """Return the fields of a JSON file, a line each: all but the report, or those below one field."""
    content = {
        name: value
        for name, value in json.loads(path.read_text()).items()
        if (name == only if only else name != "report")
    }
    return f"# {path}\n" + "\n".join(sorted(set(fields(content)))) + "\n"


def page_text(folder: str) -> str:
    """Return the text of the page of a folder of results, without pictures."""
    without_viewer = patch(
        "crosscheck.recording.screenshot.screenshots", lambda _, moments, __: [b""] * len(moments)
    )
    with without_viewer:
        printed("report", folder)
    html = (Path(folder) / PAGE).read_text()
    html = re.sub(r"(?s)<(style|script)\b.*?</\1>", "", html)
    html = re.sub(r'(?<="number holds">)(?:&lt;)?[\d.]+ %(?=</td>)', "# %", html)  # bars of checks
    html = re.sub(r"</t[dh]>\s*", "  ", html)
    html = re.sub(r"(?s)<(?=figcaption|br)[^>]*>", "\n", html)
    text = unescape(re.sub(r"(?s)<[^>]*>", " ", html))
    return f"# {folder}/{PAGE}\n" + "\n".join(line.strip() for line in text.splitlines() if line.strip())


def with_heavier_body(engine: str, body: str, fraction: float) -> dict[str, Any]:
    """Return the engines, with a body in the model of one of them heavier by a fraction."""
    return {engine: taking(ENGINES[engine], injection.mass(body, fraction))}


def help_of_all() -> str:
    """Return the help of `crosscheck` and of each command."""
    return "\n".join(printed(*name, "--help") for name in ([], *([name] for name in sorted(cli.commands))))


def agree() -> str:
    """A run whose engines agree, its page and the fields of its results."""
    folder = "output/pendulum"
    return "\n".join(
        [printed("run", "pendulum"), page_text(folder), json_fields(Path(folder) / "summary.json")]
    )


def disagree() -> str:
    """A run with a wrong body mass in MuJoCo."""
    with patch.dict(ENGINES, with_heavier_body("mujoco", "rod", 0.05)):
        found = printed("run", "slider_crank", "--output", "wrong", status=1)
    return f"{found}\n{json_fields(Path('wrong/summary.json'), 'diagnosis')}"


def model_file() -> str:
    """A run of a model file, the comparison with another version of it, and its conversion."""
    shutil.copy(ROOT / "examples" / "linkage.xml", "linkage.xml")
    text = Path("linkage.xml").read_text()
    assert 'density="2700"' in text
    Path("heavier.xml").write_text(text.replace('density="2700"', 'density="2800"'))
    return "\n".join(
        [
            printed("run", "linkage.xml", "--set", "duration=0.2"),
            printed("diff", "linkage.xml", "heavier.xml", status=1),
            printed("convert", "linkage.xml", "linkage.yaml"),
        ]
    )


def regress() -> str:
    """A comparison with the baseline of a scene in every format; of lists of checks the beginning."""
    found, in_full = printed("regress", "pendulum"), printed("regress", "pendulum", "-v")
    folder = Path("output/regress/pendulum")
    junit, markdown = ((folder / name).read_text() for name in ("junit.xml", "summary.md"))
    beginnings = ["".join(text.splitlines(keepends=True)[:10]) for text in (in_full, junit)]
    return "\n".join([found, *beginnings, markdown, json_fields(folder / "regress.json")])


def analyses() -> str:
    """Modal analysis, workspace, loads and parameters of scenes."""
    return "\n".join(
        [
            printed("modes", "pendulum"),
            printed("workspace", "slider_crank", "--vary", "pivot=-1:1:3"),
            printed("loads", "slider_crank"),
            printed("list", "pendulum"),
        ]
    )


SNAPSHOTS: dict[str, Callable[[], str]] = {
    "help": help_of_all,
    "agree": agree,
    "disagree": disagree,
    "model_file": model_file,
    "regress": regress,
    "analyses": analyses,
}
"""Functions by name of snapshot: each runs commands in the current folder and returns their output."""


def snapshot(name: str) -> str:
    """Return the masked text of a snapshot, made in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        return masked(SNAPSHOTS[name]())


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or SNAPSHOTS:
        (FOLDER / f"{name}.txt").write_text(snapshot(name))
