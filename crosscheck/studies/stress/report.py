"""The report of a stress run: tables for the terminal and the docs, JSON, and what is written."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_writable
from crosscheck.studies.stress.plot import plots, png, recording
from crosscheck.studies.stress.topics import PROCESSES, TOPICS, Row
from newton_euler.model.trajectory import atomic_file

STYLES = {"survives": "green", "degrades": "yellow", "fails": "bold red", "refuses": "magenta"}

OWN, ALL = "newton_euler", "all"
"""The first column, and the last: what all engines share."""

PACKAGES = ("numpy", "scipy", "mujoco", "pin")


def tables(rows: Sequence[Row]) -> Iterator[Table]:
    """A table for each topic, then how many cases each engine passes; reasons are cut to one line."""
    for letter, topic in TOPICS.items():
        found = [row for row in rows if row.topic == letter]
        if not found:
            continue
        table = Table(title=Text(f"({letter}) {topic}", style="bold"), title_justify="left", box=SIMPLE_HEAD)
        table.add_column("case: measured", width=36)
        table.add_column("engine: setting", width=30)
        for name in ("figure", "bound"):
            table.add_column(name, justify="right", width=8)
        table.add_column("verdict", width=8)
        table.add_column("", no_wrap=True, overflow="ellipsis", width=24)
        last = ""
        for row in found:
            case = f"{row.name}: {_measured(row)}"
            cells = (case if case != last else "", f"{row.engine}: {row.setting}", _figure(row), row.bound)
            verdict = Text(row.verdict, style="green" if row.passes else STYLES[row.verdict])
            table.add_row(*map(Text, cells), verdict, Text(row.reason))
            last = case
        yield table
    yield _summary(rows)


def _measured(row: Row) -> str:
    return f"{row.quantity}, {row.unit}" if row.unit else row.quantity


def _figure(row: Row) -> str:
    return "" if row.figure is None else f"{row.figure:.1e}"


def counts(rows: Sequence[Row]) -> dict[str, dict[str, str]]:
    """By topic and engine, how many of the cases pass: "3 of 4"."""
    engines = sorted({row.engine for row in rows}, key=lambda name: (name == ALL, name != OWN, name))
    table = {}
    for letter, topic in TOPICS.items():
        cells = {}
        for engine in engines:
            passes = [row.passes for row in rows if (row.topic, row.engine) == (letter, engine)]
            cells[engine] = f"{sum(passes)} of {len(passes)}" if passes else ""
        if any(cells.values()):
            table[f"({letter}) {topic}"] = cells
    return table


def _summary(rows: Sequence[Row]) -> Table:
    table = Table(title=Text("cases passed", style="bold"), title_justify="left", box=SIMPLE_HEAD)
    found = counts(rows)
    table.add_column("")
    for engine in next(iter(found.values()), {}):
        table.add_column(engine, justify="right")
    for topic, cells in found.items():
        table.add_row(Text(topic), *cells.values())
    return table


def markdown(rows: Sequence[Row], full: bool, wall_time: float, pictures: Sequence[str] = ()) -> str:
    """The whole report; the pictures are files beside it."""
    form = "full" if full else "CI"
    found = counts(rows)
    engines = list(next(iter(found.values()), {}))
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    lines = [
        "# Stress",
        "",
        f"Made by `crosscheck stress --{'full' if full else 'ci'}` in {wall_time / 60.0:.1f} minutes on "
        f"{PROCESSES} processes ({platform.machine()}; {versions}). The {form} form has {len(rows)} cases. "
        "Each case measures one figure of one engine at one setting: within its bound the engine *survives*, "
        "up to a second and laxer one it *degrades*, beyond that it *fails*. It *refuses* when it stops with "
        "a stated reason, which is right where there is no answer and a shortcoming where there is one. "
        "What fails is listed like what passes.",
        "",
        "Cases that survive, and refusals where they are right:",
        "",
        "| | " + " | ".join(engines) + " |",
        "|---" * (len(engines) + 1) + "|",
        *("| " + " | ".join([topic, *cells.values()]) + " |" for topic, cells in found.items()),
    ]
    for letter, topic in TOPICS.items():
        of_topic = [row for row in rows if row.topic == letter]
        if of_topic:
            lines += ["", f"## ({letter}) {topic}", "", *advice(letter, rows), *_bounds(of_topic), ""]
            lines += _markdown_table(of_topic)
    if pictures:
        lines += ["", "## Plots", "", *(f"![{Path(name).stem}]({name})\n" for name in pictures)]
    return "\n".join(lines).rstrip() + "\n"


def _bounds(rows: Sequence[Row]) -> Iterator[str]:
    """The bounds of a topic with their reasons."""
    reasons = dict.fromkeys((row.quantity, row.bound, row.bound_reason) for row in rows)
    for quantity, bound, reason in reasons:
        what = "cases without an answer" if bound == "refusal" else f"{quantity} {bound}"
        yield f"- {what}: {reason}"


def _markdown_table(rows: Sequence[Row]) -> Iterator[str]:
    yield "| case | engine | setting | measured | figure | bound | verdict | |"
    yield "|---|---|---|---|---:|---:|---|---|"
    for row in rows:
        mark = row.verdict if row.passes else f"**{row.verdict}**"
        cells = (
            row.name, row.engine, row.setting, _measured(row), _figure(row), row.bound, mark, row.reason
        )  # fmt: skip
        yield "| " + " | ".join(_plain(cell) for cell in cells) + " |"


def _plain(text: str) -> str:
    """Text without what markdown would take for its own."""
    for mark in ("|", "<", "_"):
        text = text.replace(mark, "\\" + mark)
    return text


def advice(letter: str, rows: Sequence[Row]) -> list[str]:
    """What to recommend from the figures of a topic; only MuJoCo's softness has a choice to make."""
    if letter != "d":
        return []
    from crosscheck.studies.stress.soft import recommendation

    found = recommendation(rows)
    return [found, ""] if found else []


def as_json(rows: Sequence[Row], full: bool, wall_time: float) -> str:
    """All rows with their curves."""
    content = {
        "form": "full" if full else "ci",
        "wall_time": wall_time,
        "versions": {name: version(name) for name in PACKAGES},
        "passed": counts(rows),
        "rows": [asdict(row) for row in rows],
    }
    return json.dumps(_without_nan(content), indent=1, allow_nan=False) + "\n"


def _without_nan(value: object) -> object:
    """JSON has no numbers that are not finite; such a figure is its text."""
    if isinstance(value, float):
        return value if abs(value) < float("inf") else repr(value)
    if isinstance(value, dict):
        return {name: _without_nan(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(entry) for entry in value]
    return value


def check_folder(folder: Path) -> None:
    """Raise `CrosscheckError` before a run whose report could not be written after it."""
    check_writable(folder / "stress.json", folder / "stress.md", folder / "stress.rrd")


def write(rows: Sequence[Row], full: bool, wall_time: float, folder: Path) -> list[Path]:
    """Write stress.json, stress.md, stress.rrd and a picture of each plot into a folder.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    drawn = plots(rows)
    pictures = {f"stress_{plot.slug}.png": plot for plot in drawn}
    text = markdown(rows, full, wall_time, tuple(pictures))
    files: dict[str, Callable[[], bytes]] = {
        "stress.json": lambda: as_json(rows, full, wall_time).encode(),
        "stress.md": text.encode,
        "stress.rrd": lambda: recording(drawn, text),
        **{name: (lambda plot=plot: png(plot)) for name, plot in pictures.items()},  # type: ignore[misc]
    }
    for name, content in files.items():
        made = content()
        try:
            with atomic_file(folder / name) as temporary:
                temporary.write_bytes(made)
        except OSError as error:
            raise CrosscheckError(f"cannot write {folder / name}: {error.strerror}") from error
    return [folder / name for name in files]
