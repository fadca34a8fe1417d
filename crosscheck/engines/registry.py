"""Registry of the engines: those that comparisons run unless others are named, and how the others are found.

An engine that is not among the default ones is registered by the entry point `crosscheck.engines` of an
installed package, whose object is an `Engine`. It runs if it is named, or with the name `ALL`.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from typing import Final, Never

from packaging.version import Version

from crosscheck.engines import mujoco, newton_euler, pinocchio
from crosscheck.engines.engine import Engine
from crosscheck.support.errors import CrosscheckError, reason_of
from newton_euler.errors import DISTRIBUTION, choices
from newton_euler.model.scene import Scene

SOLVER = newton_euler.ENGINE
"""This project's own solver, whose runs are references for settings of the others."""

ENGINES: dict[str, Engine] = {engine.name: engine for engine in (SOLVER, mujoco.ENGINE, pinocchio.ENGINE)}
"""Engines by name that run unless others are named."""

ENTRY_POINTS: Final = "crosscheck.engines"
"""Group of the entry points by which packages register engines."""

ALL: Final = "all"
"""Name that stands for every engine that is installed."""


class EngineError(CrosscheckError):
    """An engine that cannot be used: not installed, too old, or broken."""


class MissingPackageError(EngineError):
    """An engine whose package is not installed."""


def names() -> tuple[str, ...]:
    """Return the names of all engines, the default ones first; those that are not installed are included."""
    return tuple(dict.fromkeys([*ENGINES, *sorted(point.name for point in _points())]))


def choose(wanted: Iterable[str]) -> list[Engine]:
    """Return engines by name, in the given order.

    Args:
        wanted: names of engines; `ALL` stands for every engine that is installed. Engines that are installed
            and cannot be used are among these, too: their runs raise the reason.

    Raises:
        EngineError: for an engine that is not installed, is too old or cannot be loaded.
        CrosscheckError: for unknown or repeated names, or none.
    """
    asked, known = list(wanted), (*names(), ALL)
    if not asked:
        raise CrosscheckError(f"no engine named; choose from: {', '.join(known)}")
    for name in asked:
        if name not in known:
            raise CrosscheckError(f"unknown engine {name!r}; {choices(name, known)}")
        if asked.count(name) > 1:
            raise CrosscheckError(f"engine {name!r} is named {asked.count(name)} times")
    found: dict[str, Engine] = {}
    for name in asked:
        engines = [*ENGINES.values(), *_installed()] if name == ALL else [ENGINES.get(name) or _load(name)]
        found |= {engine.name: engine for engine in engines if engine.name not in found}
    return list(found.values())


def _points() -> list[EntryPoint]:
    """Return the entry points of all engines that are not among the default ones."""
    return [point for point in entry_points(group=ENTRY_POINTS) if point.name not in ENGINES]


def _load(name: str) -> Engine:
    """Load an engine by its entry point; raises `EngineError` if that is not possible."""
    points = [point for point in _points() if point.name == name]
    if len({point.value for point in points}) > 1:
        registered = ", ".join(point.value for point in points)
        raise EngineError(f"engine {name!r} is registered more than once: {registered}")
    try:
        engine = points[0].load()
    except Exception as error:  # code of another package
        where, reason = points[0].value, reason_of(error)
        raise EngineError(f"engine {name!r} cannot be loaded from {where}: {reason}") from error
    if not isinstance(engine, Engine) or engine.name != name:
        raise EngineError(f"engine {name!r}: {points[0].value} is {engine!r}; needed: an Engine of this name")
    oldest = engine.min_version
    needed = f"needed: {oldest} or newer, as by: pip install '{engine.package}>={oldest}'"
    try:
        found = version(engine.package)
    except PackageNotFoundError as error:
        reason = f"package {engine.package} is not installed; {needed}"
        raise MissingPackageError(f"engine {name!r}: {reason}") from error
    if Version(found) < Version(oldest):
        raise EngineError(f"engine {name!r}: package {engine.package} has version {found}; {needed}")
    return engine


def _installed() -> list[Engine]:
    """Return the engines besides the default ones whose packages are installed.

    One that cannot be used raises the reason from each of its functions, so that the others run.
    """
    found = []
    for name in sorted({point.name for point in _points()}):
        try:
            found.append(_load(name))
        except MissingPackageError:
            continue
        except EngineError as error:
            found.append(_unusable(name, error))
    return found


def _unusable(name: str, error: EngineError) -> Engine:
    """Return an engine whose functions raise an error."""

    def refuse(scene: Scene) -> Never:
        raise error

    return Engine(name, refuse, refuse, refuse, package=DISTRIBUTION)
