"""Imports: which package and room may import which, no circle, and what an import costs."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest
from slow_variants import slow_variants

from crosscheck.engines.registry import ENGINES

ROOT = Path(__file__).parents[1]

ALLOWED = {
    "newton_euler": {"newton_euler"},
    "mjcf": {"newton_euler", "mjcf", "mujoco"},
    "urdf": {"newton_euler", "urdf", "pinocchio"},
    "crosscheck": {"newton_euler", "mjcf", "urdf", "crosscheck", "rerun", "exudyn", "pydrake"},
}
WATCHED = {"newton_euler", "mjcf", "urdf", "crosscheck", "mujoco", "pinocchio", "rerun", "exudyn", "pydrake"}

OF_ONE_ENGINE = {"exudyn": "crosscheck.engines.exudyn", "pydrake": "crosscheck.engines.drake"}
"""Packages of optional engines, and the package that alone imports each of them."""


ROOMS: dict[str, set[str]] = {
    "model": set(),
    "equations": {"model"},
    "codegen": set(),
    "integrators": {"model", "equations", "codegen"},
    "compiled": {"model", "equations", "codegen", "integrators"},
    "runs": {"model", "equations", "codegen", "integrators", "compiled"},
    "analysis": {"model", "equations", "codegen", "integrators", "compiled", "runs"},
    "reading": {"model", "equations", "codegen", "integrators", "compiled", "runs"},
}
"""Rooms of newton_euler, and the rooms that each may import."""

CORE: dict[str, set[str]] = {
    "support": set(),
    "library": {"support"},
    "loading": {"support", "library", "engines"},
    "engines": {"support", "library"},
    "own_run": {"support", "engines"},
    "logs": {"support", "engines", "own_run"},
    "compare": {"support", "library", "loading", "engines", "own_run", "logs"},
    "differences": {"support", "library", "loading", "engines", "compare"},
    "recording": {"support", "engines", "own_run", "logs", "compare"},
    "report": {
        *("support", "library", "loading", "engines", "own_run"),
        *("logs", "compare", "differences", "recording"),
    },
    "regress": {"support", "library", "loading", "engines", "own_run", "compare", "report", "recording"},
}
"""Rooms of crosscheck that `crosscheck run` and `regress` need, and the rooms that each may import."""

OPTIONAL = {"design", "solar", "studies", "sweeps"}
"""Rooms of crosscheck that may import each room of the core and themselves."""

LOADING_OPTIONAL = ("crosscheck.cli.", "crosscheck.library.tracker_sun")
"""Modules that import optional rooms, inside functions only, so that other commands do not load them."""

GROUND = {
    "newton_euler.arguments",
    "newton_euler.errors",
    "newton_euler.folders",
    "newton_euler.limits",
    "newton_euler.optional_packages",
    "newton_euler.scalars",
}
"""Modules below all rooms."""

HEAVY = {
    *("coal", "control", "dask", "jax", "llvmlite", "matplotlib"),
    *("mujoco", "packaging", "pinocchio", "rerun", "scipy"),
}
"""Packages that are loaded when they are needed."""

LIMITED = {"numpy", "resource"}
"""Imported by functions that run in processes of their own, whose memory they limit first."""


class Import(NamedTuple):
    """An import of a module.

    Attributes:
        module: its name; of a name that is imported from a package's module, that module.
        inside: whether it stands in a function.
    """

    module: str
    inside: bool


@cache
def modules(package: str) -> dict[str, Path]:
    """The source of each module of a package, by the module's name."""
    found = {}
    for source in sorted((ROOT / package).rglob("*.py")):
        parts = source.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = source
    return found


@cache
def imports_of(source: Path) -> tuple[Import, ...]:
    """All imports of a module, those for type checkers included."""
    known = {name for package in ALLOWED for name in modules(package)}
    return tuple(_imports(ast.parse(source.read_text()), known, inside=False))


def _imports(node: ast.AST, known: set[str], inside: bool) -> Iterator[Import]:
    inside = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import):
            yield from (Import(alias.name, inside) for alias in child.names)
        elif isinstance(child, ast.ImportFrom):
            for alias in child.names:
                full = f"{child.module}.{alias.name}"
                yield Import(full if full in known else str(child.module), inside)
        else:
            yield from _imports(child, known, inside)


@pytest.mark.parametrize("package", ALLOWED)
def test_modules_do_not_import_each_other_in_a_circle(package):
    graph = {
        name: {each.module for each in imports_of(source)} - {name}
        for name, source in modules(package).items()
    }
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" imports ".join(reversed(error.args[1])))


@pytest.mark.parametrize(
    ("package", "rooms"), [("newton_euler", set(ROOMS)), ("crosscheck", {*CORE, *OPTIONAL, "cli"})]
)
def test_every_folder_is_a_room(package, rooms):
    assert {path.parent.name for path in (ROOT / package).glob("*/__init__.py")} == rooms


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_one_way(room):
    allowed = tuple(f"newton_euler.{other}." for other in (room, *ROOMS[room]))
    for name, source in modules("newton_euler").items():
        if name.startswith(f"newton_euler.{room}."):
            for module, _ in imports_of(source):
                own = module.startswith("newton_euler")
                assert not own or module in GROUND or module.startswith(allowed), f"{name} imports {module}"


@pytest.mark.parametrize("room", [*CORE, *sorted(OPTIONAL), "cli"])
def test_rooms_of_crosscheck_import_one_way(room):
    allowed = {room, *CORE.get(room, CORE)}
    for name, source in modules("crosscheck").items():
        if f"{name}.".startswith(f"crosscheck.{room}."):
            for module, inside in imports_of(source):
                other = f"{module}..".split(".")[1]
                lazy = other in OPTIONAL and inside and name.startswith(LOADING_OPTIONAL)
                foreign = not module.startswith("crosscheck.")
                assert foreign or other in allowed or lazy, f"{name} imports {module}"


@cache
def is_heavy(module: str) -> bool:
    """Find out whether importing a module loads a heavy package."""
    if module.split(".")[0] in HEAVY:
        return True
    source = modules(module.split(".")[0]).get(module)
    return source is not None and any(is_heavy(each.module) for each in imports_of(source) if not each.inside)


@pytest.mark.parametrize("package", ["newton_euler", "mjcf", "urdf"])
def test_imports_inside_functions_are_of_heavy_packages(package):
    for name, source in modules(package).items():
        for module, inside in imports_of(source):
            allowed = not inside or is_heavy(module) or module in LIMITED
            assert allowed, f"{name} imports {module} inside a function"


@pytest.mark.parametrize("package", ALLOWED)
def test_imports_point_one_way(package):
    sources = sorted((ROOT / package).rglob("*.py"))
    assert sources
    for source in sources:
        found = set()
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{source}: relative import"
                found.add(str(node.module).split(".")[0])
        assert found & WATCHED <= ALLOWED[package], source


@pytest.mark.parametrize("package", OF_ONE_ENGINE)
def test_packages_of_optional_engines_are_imported_by_their_engine_only(package):
    users = {
        name
        for name, source in modules("crosscheck").items()
        if any(each.module.split(".")[0] == package for each in imports_of(source))
    }
    assert users
    assert {name for name in users if not name.startswith(OF_ONE_ENGINE[package])} == set()


@pytest.mark.parametrize("package", ["newton_euler", "mjcf", "urdf", "crosscheck.library", "crosscheck.cli"])
def test_importing_a_package_loads_nothing_heavy(package):
    heavy = "{'scipy', 'mujoco', 'pinocchio', 'rerun', 'matplotlib', 'pydantic', 'numba', 'llvmlite'}"
    code = f"import sys, {package}; print(*sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.strip() == ""


def test_docstrings_open_with_a_verb_or_a_noun_phrase():
    found = []
    for package in ALLOWED:
        for name, path in modules(package).items():
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                    words = (ast.get_docstring(node) or "").split(maxsplit=1)
                    if words and words[0] in {"What", "Which", "How", "Where", "When", "Whether"}:
                        found.append(f"{name}: {getattr(node, 'name', 'module')}")
    assert found == []


ENGINE_NAMES = re.compile(r"mujoco|pinocchio|drake|exudyn", re.IGNORECASE)
"""Names of engines, in names and texts of code."""


def named_engines(source: str) -> list[tuple[int, str]]:
    """Names of engines in code, with their lines: in identifiers and texts, not in docstrings."""
    tree = ast.parse(source)
    docstrings = {id(each.value) for each in ast.walk(tree) if isinstance(each, ast.Expr)}
    found = []
    for node in ast.walk(tree):
        match node:
            case ast.Constant(value=str(text)) if id(node) not in docstrings:
                is_solver = re.search(r"\bnewton_euler\b(?!\.)", text) is not None
            case ast.Name(id=text) | ast.Attribute(attr=text) | ast.arg(arg=text) | ast.alias(name=text):
                is_solver = False
            case ast.keyword(arg=str(text)) | ast.alias(asname=str(text)) | ast.AsyncFunctionDef(name=text):
                is_solver = False
            case ast.FunctionDef(name=text) | ast.ClassDef(name=text) | ast.ImportFrom(module=str(text)):
                is_solver = False
            case _:
                continue
        if is_solver or ENGINE_NAMES.search(text):
            found.append((getattr(node, "lineno", 0), text))
    return found


def test_only_engines_name_engines():
    """Everything else takes them from the registry; the help of `--engines` has the default ones."""
    found = [
        (name, text)
        for package in ("crosscheck", "newton_euler")
        for name, source in modules(package).items()
        if not name.startswith("crosscheck.engines")
        for _, text in named_engines(source.read_text())
        if package == "crosscheck" or ENGINE_NAMES.search(text)  # the package may name itself
    ]
    assert found == [("crosscheck.cli.shared", ",".join(ENGINES))]


def test_names_of_engines_are_found_in_code_and_not_in_docstrings():
    source = (
        '"""MuJoCo."""\nfrom mujoco import x\ndef of_drake(a="exudyn"): return a.pinocchio, "newton_euler"'
    )
    found = {text for _, text in named_engines(source)}
    assert found == {"mujoco", "of_drake", "exudyn", "newton_euler", "pinocchio"}


@pytest.mark.slow  # collects all tests
def test_slow_variants_are_variants():
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-m", "slow"]
    collected = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert slow_variants() <= set(collected.splitlines())
