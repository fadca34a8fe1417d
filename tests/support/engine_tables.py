"""Tables of `docs/results/engines.md`: which engine can express what, errors, run times and faults.

    python tests/support/engine_tables.py TABLE [FOLDER]

writes one of the tables into the page:

    expressed   needs no runs: it comes from `Engine.limits`, for `elements.py` and the library
    library     FOLDER has the results of `crosscheck run --all --engines all`
    references  FOLDER is that of `library`
    times       FOLDER/SCENE has the results of `crosscheck bench SCENE --engines all`
    faults      FOLDER/NAME has the results of `crosscheck faults four_bar --engines NAME`
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import median
from typing import Any

from elements import COUPLED, ELEMENTS
from page_tables import RESULTS, replaced

from crosscheck.compare.outcome import Outcome
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import choose
from crosscheck.library import SCENES, load
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Column, Rows, Table, number_columns, text_columns
from crosscheck.studies.benchmark.timing import rounded
from crosscheck.studies.faults.find import SMALLEST_REQUIRED
from newton_euler.model.scene import Scene

ERRORS = (1e-3, 1e-5, 1e-7, 1e-9)
"""Errors, m and rad, of the rows of the table of run times."""

PAGE = RESULTS / "engines.md"


def scenes() -> dict[str, Scene]:
    """Scenes of the library, and small ones with each kind of joint, coupling, motion and force."""
    return {name: load(name) for name in SCENES} | ELEMENTS | COUPLED


def expressed(engines: Iterable[Engine]) -> list[str]:
    """Lines of the table of scenes that an engine cannot express: a row for each engine and reason."""
    engines = list(engines)
    every = scenes()
    scenes_of: dict[tuple[str, str], list[str]] = {}
    for name, scene in every.items():
        for engine in engines:
            for reason in dict.fromkeys(each.reason for each in engine.limits(scene)):
                scenes_of.setdefault((engine.label or engine.name, reason), []).append(name)
    others = {name for names in scenes_of.values() for name in names}
    if not others:
        return [f"Every engine expresses all {len(every)} scenes."]
    count = f"{len(every) - len(others)} of {len(every)}"
    rows: Rows = [[engine, reason, "; ".join(names)] for (engine, reason), names in scenes_of.items()]
    table = Table("", text_columns("engine", "reason", "scenes"), rows)
    return [f"Every engine expresses {count} scenes. These are the others:", "", *markdown_table(table)]


def library(folder: Path, engines: Iterable[Engine]) -> list[str]:
    """Lines of the table of the library: verdicts other than AGREE, and the error of each engine."""
    engines = list(engines)
    rows: Rows = []
    verdicts: dict[str, list[str]] = {}
    for name in SCENES:
        found = json.loads((folder / name / "summary.json").read_text())
        verdicts.setdefault(found["outcome"], []).append(name)
        judged = sum(check["judged"] for check in found["checks"])
        rows.append([name, str(judged), *(_error(found, engine) for engine in engines)])
    columns: list[Column] = [*text_columns("scene"), *number_columns("checks")]
    columns += number_columns(*(engine.label or engine.name for engine in engines))
    agreeing = len(verdicts.pop(Outcome.AGREE, []))
    others = " The others:" if verdicts else ""
    lines = [f"{agreeing} of {len(SCENES)} scenes have the verdict AGREE.{others}", ""]
    for outcome, names in verdicts.items():
        lines.append(f"- {outcome}: {', '.join(f'`{name}`' for name in names)}")
    if verdicts:
        lines.append("")
    return [*lines, *markdown_table(Table("", columns, rows))]


def _error(found: Mapping[str, Any], engine: Engine) -> str:
    """Error of an engine, or why it has none."""
    if engine.name in found["left_out"]:
        return "cannot express it"
    run = found["engines"].get(engine.name)
    if run is None or run.get("wall_time") is None:
        return "stopped"
    return "" if run.get("error") is None else _one_digit(run["error"])


def _one_digit(error: float) -> str:
    """An error with one digit, such as 3e-7."""
    return f"{error:.0e}".replace("e-0", "e-")


def references(folder: Path, engines: Iterable[Engine]) -> list[str]:
    """Lines of the table of scenes with reference values: the largest error of each engine.

    An error is relative to the largest reference value of its quantity.
    """
    engines = list(engines)
    rows: Rows = []
    for name in SCENES:
        found = json.loads((folder / name / "summary.json").read_text())["known_values"]
        if not found:
            continue
        scale: dict[str, float] = {}
        for value in found:
            scale[value["quantity"]] = max(scale.get(value["quantity"], 0.0), abs(value["reference"]))
        errors = [
            [each["difference"] / scale[each["quantity"]] for each in found if each["engine"] == engine.name]
            for engine in engines
        ]
        count = max(len(each) for each in errors)
        rows.append([name, str(count), *(_one_digit(max(each)) if each else "" for each in errors)])
    columns: list[Column] = [*text_columns("scene"), *number_columns("values")]
    columns += number_columns(*(engine.label or engine.name for engine in engines))
    return list(markdown_table(Table("", columns, rows)))


def times(folder: Path, engines: Iterable[Engine]) -> list[str]:
    """Lines of the table of run times, ms: the fastest setting of each engine whose error is small enough."""
    engines = list(engines)
    rows: Rows = []
    for path in sorted(folder.glob("*/bench.json")):
        found = json.loads(path.read_text())
        uncertainty = found["reference"]["uncertainty"]
        for error in ERRORS:
            row = [found["scene"], _one_digit(error)]
            for engine in engines:
                accurate = [
                    1e3 * median(each["times"])
                    for each in found["measurements"]
                    if each["engine"] == engine.name
                    and max(each["error_position"], each["error_angle"], uncertainty) <= error
                ]
                row.append(rounded(min(accurate)) if accurate else "-")
            rows.append([*row])
    columns: list[Column] = [*text_columns("scene"), *number_columns("error")]
    columns += number_columns(*(engine.label or engine.name for engine in engines))
    return list(markdown_table(Table("", columns, rows)))


def faults(folder: Path, engines: Iterable[Engine]) -> list[str]:
    """Lines of the table of faults that are injected into one engine: how many are detected and located."""
    rows: Rows = []
    for engine in engines:
        found = json.loads((folder / engine.name / "faults.json").read_text())["faults"]
        assert {fault["engine"] for fault in found} == {engine.name}
        large = [fault for fault in found if fault["size"] is None or fault["size"] >= SMALLEST_REQUIRED]
        observable = [fault for fault in large if fault["observable"]]
        counts = (
            sum(fault["observable"] or fault["seen"] is not None for fault in large),
            sum(fault["seen"] is not None for fault in large),
            sum(fault["located"] for fault in large),
            len(observable),
            sum(fault["by_motion"] is not None for fault in observable),
            sum(fault["located_by_motion"] for fault in observable),
        )
        rows.append([engine.label or engine.name, *map(str, counts)])
    names = ("faults", "detected", "located", "of motion", "detected by motion", "located by motion")
    return list(markdown_table(Table("", [*text_columns("engine"), *number_columns(*names)], rows)))


TABLES = {
    "expressed": expressed,
    "library": library,
    "references": references,
    "times": times,
    "faults": faults,
}


def main(table: str, *folder: str) -> None:
    """Write one of the tables into the page."""
    lines = TABLES[table]
    PAGE.write_text(replaced(PAGE.read_text(), table, lines(*map(Path, folder), choose(["all"]))))


if __name__ == "__main__":
    main(*sys.argv[1:])
