"""Read models of other tools as scenes, and report how each element was imported.

Models are MJCF files (.xml, .mjcf), URDF files (.urdf) with an optional file of loop closures, and models of
MuJoCo or Pinocchio in memory. This module parses their options; the packages `mjcf` and `urdf` read them.
The fate of an element is the result of its import: "exactly", "approximated" (by a similar force), "inactive"
(not simulated, and without effect in the run) or "left out".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import choices, listed, plain_number, quoted
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import MAX_MODEL_NUMBER
from newton_euler.reading.import_report import ALWAYS_ACTING, FATES, ImportedElement, ImportReport

if TYPE_CHECKING:
    from mjcf.reader import MjcfInMemory
    from urdf.reading.given import UrdfInMemory

SUFFIXES = (".xml", ".mjcf", ".urdf")
"""Suffixes of model files."""

CONVERSION_ADVICE = {
    ".sdf": "sdf2mjcf, of the package sdformat-mjcf, makes an MJCF of it",
    ".world": "sdf2mjcf, of the package sdformat-mjcf, makes an MJCF of it",
    ".xacro": "run xacro first: xacro FILE -o robot.urdf",
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "export a URDF from the tool that it is of"),
}
"""Instructions by suffix: the conversion of files of other formats to MJCF or URDF."""


class Option(NamedTuple):
    """One option of model files, as given by `--set NAME=VALUE`.

    Attributes:
        values: description of the allowed values, for `crosscheck list`.
        default: description of the default, for `crosscheck list`.
        read: converts a text to a value; raises `ValueError` for an invalid text.
        needed: description of valid texts, for the error message.
    """

    values: str
    default: str
    read: Callable[[str], Any] = str
    needed: str = ""


def _vector(value: str) -> tuple[float, float, float]:
    """Read the text `X,Y,Z` as three numbers; `0` means the zero vector."""
    x, y, z = map(plain_number, ["0", "0", "0"] if value == "0" else value.split(","))
    if not max(abs(x), abs(y), abs(z)) <= MAX_MODEL_NUMBER:
        raise ValueError(value)
    return x, y, z


def _numbers(value: str) -> list[float]:
    """Read numbers that are separated by commas."""
    return [plain_number(each) for each in value.split(",")]


def _names(value: str) -> list[str]:
    """Read names that are separated by commas."""
    return [name.strip() for name in value.split(",") if name.strip()]


def _switch(value: str) -> bool:
    """Read `on` as True and `off` as False."""
    return bool(("off", "on").index(value))


# Arguments `read` and `needed` of `Option`, and an option, that several tables share. The file of `own_run`
# has the time step, integrator and constraint gains of the user's program loop around Pinocchio. crosscheck
# measures the error of this loop
_SECONDS = plain_number, "a positive number of seconds"
_OWN_RUN = Option("FILE with the settings of your simulation loop", "those of the engine's examples")
_GRAVITY = _vector, f"X,Y,Z in m/s^2, at most {MAX_MODEL_NUMBER:g}, or 0"

COMMON = {
    "duration": Option("SECONDS", "1", *_SECONDS),
    "output_period": Option("SECONDS", "0.01", *_SECONDS),
    "redundancy_tolerance": Option(
        "NUMBER, 0 takes all constraints literally", "1e-4", plain_number, "a number"
    ),
    "excitation": Option(
        "on|off, moving joints and driven actuators; on in run, tune, regress, sweep, bench and tests",
        "off",
        _switch,
        "on or off",
    ),
    "friction": Option("off|regularized, dry friction of joints as a force", "off"),
    "limits": Option("off|compliant, limits of joints as springs with damping", "off"),
}
"""Options of all models of other tools, by name."""

MJCF_OPTIONS = COMMON | {
    "key": Option("KEYFRAME to start from, or qpos0", "the first keyframe if there is one"),
    "root": Option("FOLDER that holds all files that it refers to", "its own folder"),
}
"""Options of MJCF files."""

MJCF_IN_MEMORY_OPTIONS = {name: option for name, option in MJCF_OPTIONS.items() if name != "root"}
"""Options of a MuJoCo model in memory, which refers to no files."""

URDF_IN_MEMORY_OPTIONS = COMMON | {
    "gravity": Option("X,Y,Z in m/s^2, or 0", "the model's own", *_GRAVITY),
    "q": Option("NUMBERS, the configuration q to start from", "neutral", _numbers, "finite numbers"),
    "own_run": _OWN_RUN,
}
"""Options of a Pinocchio model in memory."""

URDF_OPTIONS = COMMON | {
    "loops": Option("FILE, its loop file", "none"),
    "base": Option("fixed|free", "fixed"),
    "gravity": Option("X,Y,Z in m/s^2, or 0", "0,0,-9.81", *_GRAVITY),
    "ignore": Option("ELEMENTS to leave out, tags or names, between commas", "none", _names),
    "own_run": _OWN_RUN,
}
"""Options of URDF files."""

MAX_NAMES_LENGTH = 150
"""Largest number of characters of a list of names in one line of an import report."""


def is_model_file(name: str) -> bool:
    """Return True if a name has the suffix of an MJCF or a URDF file."""
    return Path(name).suffix.lower() in SUFFIXES


def is_urdf_file(name: str) -> bool:
    """Return True if a name has the suffix of a URDF file."""
    return Path(name).suffix.lower() == ".urdf"


def read_model(
    model: str | MjcfInMemory | UrdfInMemory, options: Mapping[str, str | float], verified: bool = True
) -> tuple[Scene, ImportReport]:
    """Read a model file, or a model that MuJoCo or Pinocchio has in memory.

    Args:
        model: a path that ends in one of `SUFFIXES`, an `MjSpec` or `MjModel`, or a `pinocchio.Model`, alone
            or paired with its constraints.
        options: values by the names of `MJCF_OPTIONS`, `URDF_OPTIONS` and so on.
        verified: True to raise an error if the scene differs from the model as MuJoCo or Pinocchio compiles
            it.

    Returns:
        The scene, and the import report with the fate of every element.

    Raises:
        CrosscheckError: for an unknown option or an invalid value.
        newton_euler.NewtonEulerError: for an invalid model; the message names the file and the element.
    """
    path, known = name_and_options(model)
    given: dict[str, Any] = {}
    for name, value in options.items():
        if name not in known:
            raise CrosscheckError(f"{path} has no option {name!r}; {choices(name, known)}")
        text = str(value)
        try:
            given[name] = known[name].read(text)
        except ValueError as error:
            raise CrosscheckError(f"{name} is {text!r}; needed: {known[name].needed}") from error
    if known in (URDF_OPTIONS, URDF_IN_MEMORY_OPTIONS):
        from urdf import read as read_urdf

        found = read_urdf(model, **given, verified=verified)
        return found.scene, found.report
    from mjcf import read as read_mjcf

    reading = read_mjcf(model, **given, verified=verified)
    return reading.scene, reading.report


def name_and_options(model: object) -> tuple[str, dict[str, Option]]:
    """Return a model file's path, or the class name of a model in memory, and the options of such models.

    Raises:
        CrosscheckError: for an object that is no model.
    """
    if isinstance(model, str):
        return model, URDF_OPTIONS if is_urdf_file(model) else MJCF_OPTIONS
    model_class = type(model[0] if isinstance(model, tuple) and model else model)
    import mjcf.errors
    import urdf.errors

    options_of_package = {
        mjcf.errors.MODEL_PACKAGE: MJCF_IN_MEMORY_OPTIONS,
        urdf.errors.MODEL_PACKAGE: URDF_IN_MEMORY_OPTIONS,
    }
    package = model_class.__module__.partition(".")[0]
    if package not in options_of_package:
        needed = f"a name, a path, a Scene, {mjcf.errors.MODELS_IN_MEMORY}, or {urdf.errors.MODELS_IN_MEMORY}"
        raise CrosscheckError(f"{quoted(model)} cannot be read; needed: {needed}")
    return model_class.__name__, options_of_package[package]


def fates_line(report: ImportReport) -> str:
    """Count the elements of a file by their fate, in one line.

    Elements that are not imported exactly are also counted by kind, for example "2 left out (2 tendons)".
    Elements that are not exact and move nothing are not counted, except those that the file switches off.
    """
    rigid = {entry.element for entry in report.of("exactly") if entry.is_soft_in_file}
    exact = len({entry.element for entry in report.of("exactly")} - rigid)
    found = [f"{exact} element{'' if exact == 1 else 's'} read exactly"]
    if rigid:
        found.append(f"{len(rigid)} rigid here and soft in the file ({_count_by_kind(rigid)})")
    for fate in FATES[1:]:
        names = {entry.element for entry in report.of(fate) if not entry.moves_nothing}
        if names:
            found.append(f"{len(names)} {fate} ({_count_by_kind(names)})")
    switched_off = {entry.element for entry in report.entries if entry.is_off}
    if switched_off:
        found.append(f"{len(switched_off)} switched off by the file itself ({_count_by_kind(switched_off)})")
    if unknown := sorted({entry.element for entry in report.entries if not entry.is_understood}):
        found.append(f"not understood, and not simulated: {listed(unknown)}")
    return ", ".join(found)


def _count_by_kind(names: set[str]) -> str:
    """Count elements by kind, such as "2 tendons, 1 equality".

    Args:
        names: kinds and names of elements, such as "tendon 'left'". An element without a name, such as
            "option density", is listed instead of counted.
    """
    kinds = Counter(name.partition(" '")[0] for name in sorted(names))
    plurals = dict(ALWAYS_ACTING)  # by singular; all irregular plurals are among them
    found = []
    for kind, count in kinds.items():
        if kind in names:  # the whole text: an element without a name
            found.append(kind)
        else:
            found.append(f"{count} {kind if count == 1 else plurals.get(kind, f'{kind}s')}")
    return ", ".join(found)


def report_lines(report: ImportReport, exact: bool = True) -> Iterator[str]:
    """Yield the lines of an import report: counts, elements by fate, and changes of the initial state.

    Elements of one kind with the same account (text on how they were imported) share a line. An element of
    which one part is exact and another part is left out appears under both fates.

    Args:
        report: import report of a model file.
        exact: True to list the elements that are imported exactly, too.
    """
    yield f"elements of the file: {fates_line(report)}"

    def kind_and_account(entry: ImportedElement) -> tuple[str, str]:
        """Return what the elements of a line have in common."""
        return entry.element.split(" ")[0], entry.account

    for fate in FATES if exact else FATES[1:]:
        entries = report.of(fate)
        if entries:
            yield f"{fate}:"
        for (_, text), group in groupby(sorted(entries, key=kind_and_account), key=kind_and_account):
            names = ", ".join(entry.element for entry in group)
            if len(names) > MAX_NAMES_LENGTH:
                names = names[:MAX_NAMES_LENGTH].rsplit(", ", 1)[0] + ", ..."
            yield f"  {names}: {text}"
    yield from report.start
