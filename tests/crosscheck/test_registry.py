"""Engines that other packages register: how they are found, and what is said of those that cannot be used."""

from __future__ import annotations

import sys
import tomllib
from dataclasses import replace
from importlib.metadata import EntryPoint, version
from pathlib import Path
from types import SimpleNamespace

import pytest
from command_line import run, scene_file, short_example

from crosscheck.cli.shared import DEFAULT_ENGINES
from crosscheck.engines import registry
from crosscheck.engines.limits import Limit
from crosscheck.engines.registry import (
    ENGINES,
    ENTRY_POINTS,
    SOLVER,
    EngineError,
    NotInstalledError,
    choose,
    may_import_files,
)
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import DISTRIBUTION

TOY = replace(SOLVER, name="toy", package="numpy", min_version="1.2")
TWIN = replace(TOY)
PLAIN = replace(SOLVER, name="toy")
OLD = replace(TOY, name="old", min_version="9999.10")
ABSENT = replace(TOY, name="absent", package="absent-package")
NO_ENGINE = "no engine"


def _raise(scene):
    raise ImportError("a library is missing")


LIMITED = replace(TOY, limits=lambda scene: [Limit("joint 'hinge'", "no hinges")])
RAISING = replace(TOY, name="raising", systems=_raise)


@pytest.fixture
def registered(monkeypatch):
    """A function that registers names of this module as engines."""

    def register(**objects):
        points = [EntryPoint(name, f"{__name__}:{value}", ENTRY_POINTS) for name, value in objects.items()]
        monkeypatch.setattr(registry, "entry_points", lambda group: points)
        monkeypatch.setattr(registry, "OPTIONAL", {})
        return points

    return register


def test_a_registered_engine_is_found_by_name(registered):
    registered(toy="TOY")
    assert registry.names() == (*ENGINES, "toy")
    assert choose(["toy", "mujoco"]) == [TOY, ENGINES["mujoco"]]


def test_all_are_those_that_are_installed(registered):
    registered(toy="TOY", absent="ABSENT")
    assert [each.name for each in choose(["all"])] == [*ENGINES, "toy"]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("absent", "ABSENT", "package absent-package is not installed"),
        ("old", "OLD", f"package numpy has version {version('numpy')}; needed: numpy>=9999.10"),
        ("broken", "NOTHING_OF_THIS_NAME", "cannot be loaded from"),
        ("wrong", "NO_ENGINE", "is 'no engine'; needed: an Engine of this name"),
        ("other", "TOY", "needed: an Engine of this name"),
    ],
)
def test_an_engine_that_cannot_be_used_says_why(registered, name, value, reason):
    registered(**{name: value})
    with pytest.raises(EngineError) as caught:
        choose([name])
    assert repr(name) in str(caught.value)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.fixture
def optional(monkeypatch):
    """A function that makes "toy" an optional engine of this project, with a requirement and a module."""

    def offer(requirement, module=None):
        monkeypatch.setattr(registry, "OPTIONAL", {"toy": requirement})
        monkeypatch.setitem(sys.modules, "crosscheck.engines.toy", module)

    return offer


def test_an_optional_engine_is_imported_if_its_requirement_is_fulfilled(optional):
    optional("numpy>=1.2,<99", SimpleNamespace(ENGINE=TOY))
    assert registry.names() == (*ENGINES, "toy")
    assert choose(["all"])[-1] is TOY


@pytest.mark.parametrize(
    ("requirement", "reason", "error"),
    [
        (
            "absent-package>=2",
            "package absent-package is not installed; needed: absent-package>=2",
            NotInstalledError,
        ),
        (
            "numpy>=99,<100",
            f"package numpy has version {version('numpy')}; needed: numpy>=99,<100",
            EngineError,
        ),
        ("numpy>=1,<2", f"package numpy has version {version('numpy')}; needed: numpy>=1,<2", EngineError),
    ],
)
def test_optional_engines_that_cannot_be_used(optional, requirement, reason, error):
    optional(requirement)  # importing the module would fail
    with pytest.raises(error) as caught:
        choose(["toy"])
    assert reason in str(caught.value)
    assert len(choose(["all"])) == len(ENGINES) + (error is EngineError)


def test_engines_are_asked_for_importers_without_loading_the_optional_ones(optional):
    optional("numpy>=1.2", SimpleNamespace())  # loading it would give an unusable engine
    assert may_import_files() == list(ENGINES.values())
    assert len(choose(["all"])) == len(ENGINES) + 1


@pytest.mark.parametrize("name", registry.OPTIONAL)
def test_optional_engines_have_no_importer(name):
    pytest.importorskip({"drake": "pydrake"}.get(name, name))
    assert choose([name])[0].importer is None


def test_requirements_of_optional_engines_are_those_of_their_extras():
    project = tomllib.loads(Path(__file__).parents[2].joinpath("pyproject.toml").read_text())["project"]
    extras = {
        name: needed for name, needed in project["optional-dependencies"].items() if name in registry.OPTIONAL
    }
    assert extras == {name: [requirement] for name, requirement in registry.OPTIONAL.items()}


def test_what_an_engine_cannot_express_leaves_it_out(registered, capsys, tmp_path):
    registered(toy="LIMITED")
    status, out, _ = run(
        capsys, "run", "pendulum", "--engines", "toy,newton_euler,mujoco", "--output", tmp_path
    )
    assert status == 3
    assert "toy cannot express joint 'hinge': no hinges" in out


@pytest.mark.parametrize("name", ["all", "relative", "own_run", "../x", "a,b", "Toy", ""])
def test_names_that_no_engine_can_have(registered, name):
    registered(**{name: "TOY"})
    with pytest.raises(EngineError, match="no name of an engine"):
        registry._load(name)


@pytest.mark.parametrize(
    ("code", "reason", "error"),
    [
        ("import no_such_package", "module no_such_package is not installed", EngineError),
        ("raise RuntimeError('no license')", "no license", EngineError),
        ("raise SystemExit(3)", "it exits with 3", EngineError),
    ],
)
def test_modules_that_cannot_be_imported(monkeypatch, tmp_path, code, reason, error):
    (tmp_path / "bad_engine.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    point = EntryPoint("bad", "bad_engine:ENGINE", ENTRY_POINTS)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    with pytest.raises(error, match=reason):
        choose(["bad"])
    with pytest.raises(error, match=reason):  # installed, but unusable: not left out silently
        choose(["all"])[-1].systems(None)
    monkeypatch.delitem(sys.modules, "bad_engine", raising=False)


def test_unusable_engines_leave_the_others_untouched(registered, capsys, tmp_path):
    registered(old="OLD", raising="RAISING")
    status, out, _ = run(capsys, "run", "pendulum", "--engines", "all", "--output", tmp_path)
    assert status == 3
    assert "AGREE (3 of 5 engines): newton_euler, mujoco, pinocchio agree" in out
    assert "numpy>=9999.10" in out
    assert "a library is missing" in out


def test_all_engines_are_asked_for_and_the_missing_ones_are_named(registered, capsys, tmp_path):
    registered(absent="ABSENT")
    path = scene_file(tmp_path, short_example())
    _, out, err = run(capsys, "run", path, "--engines", "all", "--output", tmp_path / "out")
    assert "absent" not in out
    assert "engines that are not installed: absent;" in err


def test_the_help_names_the_default_engines():
    assert DEFAULT_ENGINES.split(",") == list(ENGINES)


def test_the_package_of_an_engine_is_that_of_its_entry_point(registered):
    (point,) = registered(toy="PLAIN")
    vars(point)["dist"] = SimpleNamespace(name="numpy")
    (engine,) = choose(["toy"])
    assert (PLAIN.package, engine.package) == (DISTRIBUTION, "numpy")


def test_two_packages_with_one_name(registered, monkeypatch):
    points = [*registered(toy="TOY"), EntryPoint("toy", f"{__name__}:TWIN", ENTRY_POINTS)]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)
    with pytest.raises(EngineError, match=r"more than once: .*TOY, .*TWIN"):
        choose(["toy"])


def test_a_registered_engine_does_not_take_the_name_of_a_default_one(registered):
    registered(mujoco="TOY")
    assert choose(["mujoco"]) == [ENGINES["mujoco"]]


@pytest.mark.parametrize(
    ("wanted", "reason"),
    [([], "no engine named"), (["bullet"], "unknown engine 'bullet'"), (["mujoco"] * 2, "named 2 times")],
)
def test_names_that_are_refused(wanted, reason):
    with pytest.raises(CrosscheckError, match=reason):
        choose(wanted)


def test_a_run_with_a_registered_engine(registered, capsys, tmp_path):
    registered(toy="TOY", old="OLD")
    arguments = ("run", "pendulum", "--output", tmp_path / "toy")
    status, out, _ = run(capsys, *arguments, "--engines", "toy,mujoco")
    assert status == 0
    assert (tmp_path / "toy" / "toy.npz").exists()
    status, out, err = run(capsys, *arguments, "--engines", "toy,old")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert "numpy>=9999.10" in err
