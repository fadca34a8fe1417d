"""Scenes from model files of other tools: MJCF (.xml, .mjcf) and URDF (.urdf) with a loop file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import choices, listed, plain_number, quoted
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import LARGEST
from newton_euler.reading.import_report import ACTING, FATES, ImportedElement, ImportReport

if TYPE_CHECKING:
    from mjcf.reader import MujocoModel
    from urdf.reading.given import PinocchioModel

SUFFIXES = (".xml", ".mjcf", ".urdf")

TO_CONVERT = {
    ".sdf": "sdf2mjcf, of the package sdformat-mjcf, makes an MJCF of it",
    ".world": "sdf2mjcf, of the package sdformat-mjcf, makes an MJCF of it",
    ".xacro": "run xacro first: xacro FILE -o robot.urdf",
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "export a URDF from the tool that it is of"),
}
"""Formats that are not read, by suffix, and what to do."""


class Option(NamedTuple):
    """One option of model files.

    Attributes:
        values: what people give.
        default: what it is by default.
        read: takes a value as given; raises `ValueError` for one that cannot be.
        needed: of a value.
    """

    values: str
    default: str
    read: Callable[[str], Any] = str
    needed: str = ""


def _vector(value: str) -> tuple[float, float, float]:
    """Three numbers, between commas, or 0 for all of them."""
    x, y, z = map(plain_number, ["0", "0", "0"] if value == "0" else value.split(","))
    if not max(abs(x), abs(y), abs(z)) <= LARGEST:
        raise ValueError(value)
    return x, y, z


def _numbers(value: str) -> list[float]:
    """Any numbers, between commas."""
    return [plain_number(each) for each in value.split(",")]


def _names(value: str) -> list[str]:
    """Any names, between commas."""
    return [name.strip() for name in value.split(",") if name.strip()]


def _switch(value: str) -> bool:
    return bool(("off", "on").index(value))


_SECONDS = plain_number, "a positive number of seconds"
_GRAVITY = _vector, f"X,Y,Z in m/s^2, at most {LARGEST:g}, or 0"

COMMON = {
    "duration": Option("SECONDS", "1", *_SECONDS),
    "output_period": Option("SECONDS", "0.01", *_SECONDS),
    "redundancy_tolerance": Option(
        "NUMBER, 0 takes all constraints literally", "1e-4", plain_number, "a number"
    ),
    "excitation": Option(
        "on|off, moving joints and driven actuators; on in run, regress, sweep, bench",
        "off",
        _switch,
        "on or off",
    ),
}
"""Options of all model files."""

MJCF_OPTIONS = COMMON | {
    "key": Option("KEYFRAME to start from, or qpos0", "the first keyframe if there is one"),
    "root": Option("FOLDER that holds all files that it refers to", "its own folder"),
}
MUJOCO_OPTIONS = {name: option for name, option in MJCF_OPTIONS.items() if name != "root"}
"""Options of an `MjModel` in memory, which refers to no files."""

PINOCCHIO_OPTIONS = COMMON | {
    "gravity": Option("X,Y,Z in m/s^2, or 0", "the model's own", *_GRAVITY),
    "q": Option("NUMBERS, Pinocchio's configuration to start from", "neutral", _numbers, "finite numbers"),
}
"""Options of Pinocchio's models in memory."""

URDF_OPTIONS = COMMON | {
    "loops": Option("FILE, its loop file", "none"),
    "base": Option("fixed|free", "fixed"),
    "gravity": Option("X,Y,Z in m/s^2, or 0", "0,0,-9.81", *_GRAVITY),
    "ignore": Option("ELEMENTS to leave out, tags or names, between commas", "none", _names),
}

LONGEST_NAMES = 150
"""Characters of a list of names in one line of a report."""


def is_model(name: str) -> bool:
    """True if a name is that of a model file."""
    return Path(name).suffix.lower() in SUFFIXES


def is_urdf(name: str) -> bool:
    """True if it is that of a URDF, which may have a loop file."""
    return Path(name).suffix.lower() == ".urdf"


def read_model(
    model: str | MujocoModel | PinocchioModel, options: Mapping[str, str | float], verified: bool = True
) -> tuple[Scene, ImportReport]:
    """Read a model file, or a model of MuJoCo's or Pinocchio's.

    Args:
        model: a path that ends in one of `SUFFIXES`, an `MjSpec` or `MjModel`, or a `pinocchio.Model`, alone
            or paired with its constraints.
        options: those of `MJCF_OPTIONS`, `URDF_OPTIONS` and so on, as people give them.
        verified: whether to refuse a scene that is not what the file says.

    Raises:
        CrosscheckError: for an unknown option or one that cannot be read.
        newton_euler.NewtonEulerError: naming the file and the element at fault.
    """
    path, known = _kind(model)
    given: dict[str, Any] = {}
    for name, value in options.items():
        if name not in known:
            raise CrosscheckError(f"{path} has no option {name!r}; {choices(name, known)}")
        text = str(value)
        try:
            given[name] = known[name].read(text)
        except ValueError as error:
            raise CrosscheckError(f"{name} is {text!r}; needed: {known[name].needed}") from error
    if known in (URDF_OPTIONS, PINOCCHIO_OPTIONS):
        from urdf import read as read_urdf

        found = read_urdf(model, **given, verified=verified)
        return found.scene, found.report
    from mjcf import read as read_mjcf

    reading = read_mjcf(model, **given, verified=verified)
    return reading.scene, reading.report


def _kind(model: object) -> tuple[str, dict[str, Option]]:
    """Return the path or the class of a model, and the options that such models have."""
    if isinstance(model, str):
        return model, URDF_OPTIONS if is_urdf(model) else MJCF_OPTIONS
    kind = type(model[0] if isinstance(model, tuple) and model else model)
    of_package = {"mujoco": MUJOCO_OPTIONS, "pinocchio": PINOCCHIO_OPTIONS}
    package = kind.__module__.partition(".")[0]
    if package not in of_package:
        needed = "a name, a path, a Scene, a mujoco.MjSpec or mujoco.MjModel, or a pinocchio.Model, alone or"
        raise CrosscheckError(f"{quoted(model)} cannot be read; needed: {needed} paired with its constraints")
    return kind.__name__, of_package[package]


def fates_line(report: ImportReport) -> str:
    """Count the elements of a file by what became of them, those that are not exact by what they are."""
    exact = len({entry.element for entry in report.of("exactly")})
    found = [f"{exact} element{'' if exact == 1 else 's'} read exactly"]
    for fate in FATES[1:]:
        names = {entry.element for entry in report.of(fate) if not entry.inert}
        if names:
            found.append(f"{len(names)} {fate} ({_counted(names)})")
    off = {entry.element for entry in report.entries if entry.is_off}
    if off:
        found.append(f"{len(off)} switched off by the file itself ({_counted(off)})")
    if unknown := sorted({entry.element for entry in report.entries if not entry.is_understood}):
        found.append(f"not understood, and not simulated: {listed(unknown)}")
    return ", ".join(found)


def _counted(names: set[str]) -> str:
    """Word elements: those with names by the number of their kind, others as they are."""
    kinds, plurals = Counter(name.partition(" '")[0] for name in sorted(names)), dict(ACTING)
    return ", ".join(
        kind if kind in names else f"{n} {kind if n == 1 else plurals.get(kind, f'{kind}s')}"
        for kind, n in kinds.items()
    )


def report_lines(report: ImportReport, exact: bool = True) -> Iterator[str]:
    """An import report as text; elements that became the same are one line.

    An element of which one part is exact and another left out counts as both.

    Args:
        exact: whether to name the elements that became what they were.
    """
    yield f"elements of the file: {fates_line(report)}"

    def how(entry: ImportedElement) -> tuple[str, str]:
        return entry.element.split(" ")[0], entry.account

    for fate in FATES if exact else FATES[1:]:
        entries = report.of(fate)
        if entries:
            yield f"{fate}:"
        for (_, text), group in groupby(sorted(entries, key=how), key=how):
            names = ", ".join(entry.element for entry in group)
            if len(names) > LONGEST_NAMES:
                names = names[:LONGEST_NAMES].rsplit(", ", 1)[0] + ", ..."
            yield f"  {names}: {text}"
    yield from report.start
