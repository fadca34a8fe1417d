"""Scenes from model files of other tools: MJCF (.xml, .mjcf) and URDF (.urdf) with a loop file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path

from crosscheck.errors import CrosscheckError
from newton_euler.mapping import Mapped
from newton_euler.mapping import Mapping as MappingReport
from newton_euler.scene import Scene

SUFFIXES = (".xml", ".mjcf", ".urdf")

NUMBERS = ("duration", "output_period")
"""Options of all model files."""

MJCF_TEXTS, URDF_TEXTS = ("key", "root"), ("loops", "base")
"""Options of one kind of them."""

LONGEST_NAMES = 150
"""Characters of a list of names in one line of a report."""


def is_model(name: str) -> bool:
    """Whether a name is that of a model file."""
    return Path(name).suffix.lower() in SUFFIXES


def is_urdf(name: str) -> bool:
    """Whether it is that of a URDF, which may have a loop file."""
    return Path(name).suffix.lower() == ".urdf"


def read_model(path: str, options: Mapping[str, str | int]) -> tuple[Scene, MappingReport]:
    """Read a model file.

    Args:
        path: ends in one of `SUFFIXES`.
        options: `duration` and `output_period` in s; of MJCF also `key`, the keyframe to start
            from, and `root`, the folder that holds all files that it refers to; of a URDF `loops`, the
            path of its loop file, and `base`, "fixed" or "free", what its root link is.

    Raises:
        CrosscheckError: for an unknown option or one that is no number.
        newton_euler.NewtonEulerError: naming the file and the element at fault.
    """
    numbers, texts = _options(path, options)
    if is_urdf(path):
        from urdf.read import read as read_urdf

        found = read_urdf(path, texts.get("loops"), base=texts.get("base", "fixed"), **numbers)
        return found.scene, found.report
    from mjcf.read import read as read_mjcf

    reading = read_mjcf(path, texts.get("key"), root=texts.get("root"), **numbers)
    return reading.scene, reading.report


def _options(path: str, options: Mapping[str, str | int]) -> tuple[dict[str, float], dict[str, str]]:
    """Those that are numbers, and those that are texts."""
    names = URDF_TEXTS if is_urdf(path) else MJCF_TEXTS
    numbers, texts = {}, {}
    for name, value in options.items():
        if name in names:
            texts[name] = str(value)
        elif name not in NUMBERS:
            known = ", ".join((*NUMBERS, *names))
            raise CrosscheckError(f"{path} has no option {name!r}; choose from: {known}")
        else:
            try:
                numbers[name] = float(value)
            except ValueError as error:
                raise CrosscheckError(f"{name} is {value!r}; needed: a number of seconds") from error
    return numbers, texts


def report_lines(report: MappingReport) -> Iterator[str]:
    """A mapping report as text; elements that became the same are one line."""
    counts = ", ".join(f"{len(report.of(fate))} {fate}" for fate in ("exactly", "approximated", "left out"))
    yield f"carried over: {counts}"

    def how(entry: Mapped) -> tuple[str, str]:
        return entry.element.split(" ")[0], entry.how

    for fate in ("exactly", "approximated", "left out"):
        entries = report.of(fate)
        if entries:
            yield f"{fate}:"
        for (_, text), group in groupby(sorted(entries, key=how), key=how):
            names = ", ".join(entry.element for entry in group)
            if len(names) > LONGEST_NAMES:
                names = names[:LONGEST_NAMES].rsplit(", ", 1)[0] + ", ..."
            yield f"  {names}: {text}"
    yield from report.start
