"""Engines that other packages register: how they are found, and what is said of those that cannot be used."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint, version

import pytest
from command_line import run
from mechanisms import pendulum

from crosscheck.engines import registry
from crosscheck.engines.registry import ENGINES, ENTRY_POINTS, SOLVER, EngineError, choose
from crosscheck.support.errors import CrosscheckError

TOY = replace(SOLVER, name="toy", package="numpy", min_version="1.2")
TWIN = replace(TOY)
OLD = replace(TOY, name="old", min_version="9999.10")
ABSENT = replace(TOY, name="absent", package="absent-package")
NO_ENGINE = "no engine"


@pytest.fixture
def registered(monkeypatch):
    """A function that registers names of this module as engines."""

    def register(**objects):
        points = [EntryPoint(name, f"{__name__}:{value}", ENTRY_POINTS) for name, value in objects.items()]
        monkeypatch.setattr(registry, "entry_points", lambda group: points)
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
        ("old", "OLD", f"package numpy has version {version('numpy')}; needed: 9999.10 or newer"),
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


def test_a_broken_engine_among_all_leaves_the_others_untouched(registered):
    registered(old="OLD")
    *others, old = choose(["all"])
    assert others == list(ENGINES.values())
    with pytest.raises(EngineError, match=r"9999\.10 or newer"):
        old.simulate(pendulum())


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
    assert "9999.10 or newer" in err
