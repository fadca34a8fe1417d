"""Limits on the size of models, runs and files, in one table.

Limits prevent that a broken or hostile file takes all memory or hours of time. Each limit is checked where
its quantity is first known, before work begins. The command `crosscheck list -v` shows all limits, and the
option `--set NAME=VALUE` changes one limit. Changes are stored in an environment variable, so that child
processes inherit them.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from newton_euler.errors import OptionError, UnknownNameError, plain_number
from newton_euler.free_memory import free_memory

ENVIRONMENT_VARIABLE = "NEWTON_EULER_LIMITS"
"""Name of the environment variable that holds changed limits, as `NAME=VALUE NAME=VALUE`."""


@dataclass(frozen=True)
class Limit:
    """One limit of the table `LIMITS`.

    Attributes:
        default: value of the limit unless it is changed; None for `memory_limit()`, which depends on the free
            memory.
        unit: unit of the value, or the kind of things that are counted.
        meaning: explanation for `crosscheck list -v`.
    """

    default: float | None
    unit: str
    meaning: str

    def __str__(self) -> str:
        return "half of what is free" if self.default is None else f"{self.default:g}"


LIMITS = {
    "velocities": Limit(300, "velocities", "degrees of freedom without loops; the comparison is dense"),
    "closures": Limit(100, "closures", "of loops: joints, equalities, gears, mimics; they are dense"),
    "bodies": Limit(2000, "bodies", "of a file, fixed ones included"),
    "mass_ratio": Limit(1e12, "kg per kg", "of the heaviest body to the lightest; round-off hides more"),
    "forces": Limit(1000, "force elements", "actuators, control laws, springs, dampers, wrenches and rotors"),
    "terms": Limit(1000, "terms", "sines and coefficients of all prescribed motions"),
    "knots": Limit(100_000, "knots", "of all splines and steps; a run begins anew at each"),
    "cycles": Limit(1000, "cycles", "revolutions and periods of a prescribed motion or control law in a run"),
    "steps": Limit(1_000_000, "steps", "of 1 ms in a run at a fixed step"),
    "states": Limit(300_000, "states", "of bodies that a run keeps: outputs times bodies"),
    "iterations": Limit(1000, "iterations", "of the constraint solver in a step of the file's own run"),
    "elements": Limit(200_000, "elements", "of one XML file"),
    "files": Limit(100, "files", "of XML that one model consists of"),
    "file_size": Limit(10, "MB", "of the XML of a model"),
    "scene_size": Limit(1, "MB", "of a scene file or a loop file"),
    "asset_size": Limit(100, "MB", "of a mesh, texture or height field"),
    "csv_size": Limit(20, "MB", "of a CSV of poses or measurements"),
    "log_size": Limit(50, "MB", "of a log of another simulator, CSV or Parquet"),
    "result_size": Limit(20, "MB", "of a JSON file of results, baselines included"),
    "recording_size": Limit(50, "MB", "of the meshes in a recording; bars are drawn instead of others"),
    "array_size": Limit(200, "MB", "of the arrays of a run when unpacked"),
    "memory": Limit(None, "MB", "for a process that compiles a file or reads its meshes"),
    "compile_time": Limit(2, "s", "to compile an MJCF, beside 0.2 s for each MB of its assets"),
    "coverage_time": Limit(60, "s", "of processor time to work out what the motion covers"),
    "time": Limit(600, "s", "of processor time for the run of one engine, and for one comparison"),
}
"""All limits by name.

A loop file lists the constraints that close the loops of a URDF. A file's own run is a run with the settings
of the file. A recording shows the bodies of several engines; those without meshes are drawn as bars.
The coverage of a motion is the part of the masses, joints and forces whose changes would change the motion.
"""

MB = 1_000_000
"""Bytes per megabyte."""

MAX_BYTES = 2**62
"""Largest byte count that operating systems accept as a limit and that Python reads at once."""

MAX_MEMORY_MB = 4000
"""Upper bound, MB, of the default memory limit of a process that reads an untrusted file. The largest known
public models compile in 1400 MB."""


def limit(name: str) -> float:
    """Return the present value of a limit by its name."""
    changes = _changes(os.environ.get(ENVIRONMENT_VARIABLE, ""))
    if name in changes:
        return changes[name]
    default = LIMITS[name].default
    return memory_limit() if default is None else default


def memory_limit() -> float:
    """Compute the memory, MB, that a process may use while it reads a file from an untrusted source.

    The limit is half of the free memory, and at most `MAX_MEMORY_MB`.
    """
    return float(min(MAX_MEMORY_MB, free_memory() // (2 * MB)))


def exceeded(name: str, value: float) -> str:
    """Return an error message for a value above a limit, or an empty string for an allowed value.

    The message contains the option `--set` with which the value would be allowed.

    Args:
        name: name of the limit.
        value: value of the limited quantity, in the unit of the limit.
    """
    maximum = limit(name)
    if value <= maximum:
        return ""
    unit = LIMITS[name].unit
    if not math.isfinite(value):
        return f"more {unit} than a number can hold, at most {maximum:.7g}"
    return f"{value:.9g} {unit}, at most {maximum:.7g}; to allow it: --set {name}={math.ceil(value):d}"


def too_small(name: str) -> str:
    """Return advice to set a limit to four times its value, for a quantity that exceeds it by an unknown
    amount."""
    return f"to allow more: --set {name}={number_text(4 * limit(name))}"


def number_text(number: float) -> str:
    """Format a number with six digits, or as `repr` does if that is shorter: 1e-320, not 9.99989e-321."""
    return min(f"{number:g}", repr(number), key=len)


def size_in_bytes(name: str) -> int:
    """Convert a limit from MB to bytes, at most `MAX_BYTES`."""
    return int(min(limit(name) * MB, MAX_BYTES))


@contextmanager
def changed(changes: Mapping[str, str | float]) -> Iterator[None]:
    """Change limits within a `with` block, also for processes that are started in the block.

    Args:
        changes: new values by the name of the limit, as numbers or text.

    Raises:
        UnknownNameError: for an unknown limit.
        OptionError: for a value that is not a positive number.
    """
    before = os.environ.get(ENVIRONMENT_VARIABLE)
    for name, value in changes.items():
        _checked(name, value)
    text = " ".join(f"{name}={value}" for name, value in (_changes(before or "") | dict(changes)).items())
    os.environ[ENVIRONMENT_VARIABLE] = text
    try:
        yield
    finally:
        if before is None:
            del os.environ[ENVIRONMENT_VARIABLE]
        else:
            os.environ[ENVIRONMENT_VARIABLE] = before


def _changes(text: str) -> dict[str, float]:
    """Parse text of the form `NAME=VALUE NAME=VALUE` to values by limit name; raises the errors of
    `changed`."""
    pairs = (pair.partition("=") for pair in text.split())
    return {name: _checked(name, value) for name, _, value in pairs}


def _checked(name: str, value: str | float) -> float:
    """Convert the value of a limit to a float.

    Raises:
        UnknownNameError: for an unknown limit.
        OptionError: for a value that is not a positive finite number.
    """
    if name not in LIMITS:
        raise UnknownNameError("limit", name, tuple(LIMITS))
    try:
        number = plain_number(value) if isinstance(value, str) else float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not 0.0 < number < math.inf:
        raise OptionError(name, value, f"a positive number, {LIMITS[name].unit}")
    return number
