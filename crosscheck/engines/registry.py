"""Registry of the engines: those that comparisons run unless others are named, and how the others are found.

Other engines run if they are named, or with the name `ALL`: the optional ones of this project, whose adapters
need a package that an extra installs, and those that other packages register by the entry point
`crosscheck.engines`, whose object is an `Engine`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points
from typing import Final, Never

from crosscheck.engines import mujoco, newton_euler, pinocchio
from crosscheck.engines.engine import Engine
from crosscheck.support.errors import CrosscheckError, reason_of
from newton_euler.errors import DISTRIBUTION, UnusablePackageError, choices
from newton_euler.optional_packages import version_of

SOLVER = newton_euler.ENGINE
"""This project's own solver, whose runs are references for settings of the others."""

ENGINES: dict[str, Engine] = {engine.name: engine for engine in (SOLVER, mujoco.ENGINE, pinocchio.ENGINE)}
"""Engines by name that run unless others are named."""

OPTIONAL: Mapping[str, str] = {"drake": "drake>=1.51,<2", "exudyn": "exudyn>=1.13,<2"}
"""Requirement, such as "drake>=1.51,<2", of each optional engine of this project, by name.

The extra of the same name installs it. The module of the same name is imported if the installed version
fulfills the requirement."""

ENTRY_POINTS: Final = "crosscheck.engines"
"""Group of the entry points by which packages register engines."""

ALL: Final = "all"
"""Name that stands for every engine that is installed."""


NAME: Final = re.compile("[a-z][a-z0-9_]*")
"""Form of the names of engines, which are names of files, too."""

RESERVED: Final = frozenset(
    {
        ALL,
        "crosscheck",
        "relative",
        "cartesian",
        "model",
        "integrators",
        "own_run",
        "reference",
        "baseline",
        "file",
    }
)
"""Names that stand for something else in results and baselines."""


class EngineError(CrosscheckError):
    """An engine that cannot be used: not installed, too old, or broken."""


class NotInstalledError(EngineError):
    """An engine whose package is not installed."""


def names() -> tuple[str, ...]:
    """Return the names of all engines, the default ones first; those that are not installed are included."""
    return tuple(dict.fromkeys([*ENGINES, *OPTIONAL, *sorted(point.name for point in _points())]))


def choose(wanted: Iterable[str]) -> list[Engine]:
    """Return engines by name, in the given order.

    Args:
        wanted: names of engines; `ALL` stands for every engine that is installed. Engines that are installed
            and cannot be used are among these, too: their functions raise an `EngineError`.

    Raises:
        EngineError: for an engine that is not installed, is too old or cannot be loaded.
        CrosscheckError: for unknown or repeated names, or none.
    """
    asked = list(wanted)
    if not asked:
        raise CrosscheckError(f"no engine named; choose from: {', '.join((*names(), ALL))}")
    found: dict[str, Engine] = {}
    for name in asked:
        if asked.count(name) > 1:
            raise CrosscheckError(f"engine {name!r} is named {asked.count(name)} times")
        # entry points are read for names of other packages only
        if name == ALL:
            engines = [*ENGINES.values(), *_installed(names())]
        else:
            engines = [ENGINES[name] if name in ENGINES else _load(name)]
        found |= {engine.name: engine for engine in engines if engine.name not in found}
    return list(found.values())


def may_import_files() -> list[Engine]:
    """Return the installed engines that may have an importer, also unusable ones.

    The optional engines of this project have none, and are not loaded.
    """
    return [*ENGINES.values(), *_installed(name for name in names() if name not in OPTIONAL)]


def find(name: str) -> Engine | None:
    """Return the engine of a name; None if there is no such engine, or if it cannot be used."""
    if name in ENGINES:
        return ENGINES[name]
    if name in RESERVED or not NAME.fullmatch(name):  # without a look at the installed packages
        return None
    try:
        return _load(name)
    except CrosscheckError:
        return None


def _points() -> list[EntryPoint]:
    """Return the entry points of all engines of other packages."""
    ours = {*ENGINES, *OPTIONAL}
    return [point for point in entry_points(group=ENTRY_POINTS) if point.name not in ours]


def _load(name: str) -> Engine:
    """Load an engine that is not among the default ones.

    Raises:
        CrosscheckError: for an unknown name; `EngineError` for an engine that cannot be used.
    """
    if name in OPTIONAL:
        _require(name, OPTIONAL[name])
        points = [EntryPoint(name, f"{__package__}.{name}:ENGINE", ENTRY_POINTS)]
    else:
        points = [point for point in _points() if point.name == name]
    values = {point.value: point for point in points}
    if not values:
        known = (*names(), ALL)
        raise CrosscheckError(f"unknown engine {name!r}; {choices(name, known)}")
    if len(values) > 1:
        raise EngineError(f"engine {name!r} is registered more than once: {', '.join(values)}")
    if not NAME.fullmatch(name) or name in RESERVED:
        needed = f"lower case, digits and _, and none of {', '.join(sorted(RESERVED))}"
        raise EngineError(f"engine {name!r}: no name of an engine; needed: {needed}")
    ((where, point),) = values.items()
    try:
        loaded = point.load()
    except ModuleNotFoundError as error:
        reason = f"module {error.name} is not installed"
        raise EngineError(f"engine {name!r} cannot be loaded from {where}: {reason}") from error
    except (Exception, SystemExit) as error:  # code of another package
        reason = reason_of(error) if isinstance(error, Exception) else f"it exits with {error.code}"
        raise EngineError(f"engine {name!r} cannot be loaded from {where}: {reason}") from error
    engine = _checked(loaded, name, where)
    if point.dist and engine.package == DISTRIBUTION:
        return replace(engine, package=point.dist.name)
    return engine


def _checked(engine: object, name: str, where: str) -> Engine:
    """Return what an entry point names, if it is an engine of this name whose package is new enough."""
    if not isinstance(engine, Engine) or engine.name != name:
        raise EngineError(f"engine {name!r}: {where} is {engine!r}; needed: an Engine of this name")
    _require(name, f"{engine.package}>={engine.min_version}")
    return engine


def _require(name: str, requirement: str) -> None:
    """Require an installed version of the package of an engine.

    Args:
        name: name of the engine.
        requirement: package and versions, such as "numpy>=2.0".
    """
    try:
        version_of(requirement)
    except PackageNotFoundError as error:
        how = f"needed: {requirement}, as by: python -m pip install '{requirement}'"
        raise NotInstalledError(f"engine {name!r}: package {error.name} is not installed; {how}") from error
    except UnusablePackageError as error:
        raise EngineError(f"engine {name!r}: {error}") from error


def _installed(wanted: Iterable[str]) -> list[Engine]:
    """Return engines, besides the default ones, whose packages are installed, also unusable ones."""
    found = []
    for name in wanted:
        if name in ENGINES:
            continue
        try:
            found.append(_load(name))
        except NotInstalledError:
            continue
        except EngineError as error:
            found.append(_unusable(name, error))
    return found


def _unusable(name: str, error: EngineError) -> Engine:
    """Return an engine whose functions raise an error."""

    def refuse(*_: object) -> Never:
        raise error

    return Engine(
        name, refuse, refuse, refuse, package=DISTRIBUTION, benchmarks=refuse, stress_settings=refuse
    )
