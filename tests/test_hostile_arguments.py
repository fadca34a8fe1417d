"""Wrong arguments of the public API: refused in one line by errors of the packages, soon, or taken."""

from __future__ import annotations

import inspect
import time
import warnings
from collections.abc import Collection, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hostile_arguments import FEW, SWING, VALUES, Target, constructors, fault_of, functions, methods

import crosscheck
import mjcf
import newton_euler as ne
import urdf
from crosscheck.library import load
from newton_euler.arguments import caller_level, checked
from newton_euler.errors import ArgumentError, OptionError

PUBLIC = [
    *(getattr(ne, name) for name in ne.__all__),
    *(mjcf.read, mjcf.simulate, mjcf.to_xml, mjcf.write),
    *(urdf.read, urdf.simulate, urdf.to_loops, urdf.to_urdf, urdf.write),
    *(crosscheck.check, crosscheck.sweep, crosscheck.tune, load),
]

FUNCTIONS = [each for each in PUBLIC if inspect.isfunction(each)]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that files are written into, also by relative paths."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def faults_of(targets: Collection[Target], values: Collection[str]) -> list[str]:
    """Call targets with hostile values; return the answers that are not those of the packages."""
    faults = []
    for target in targets:
        assert fault_of(target.with_value(*next(iter(target.arguments.items())))) == ""
        faults += [f"{name}: {fault}" for name, call in target.cases(values) if (fault := fault_of(call))]
    return faults


@pytest.mark.filterwarnings("ignore::UserWarning")
class TestHostile:
    def test_all_functions_are_walked(self, folder: Path):
        assert {each.call for each in functions(folder)} == set(FUNCTIONS)
        assert [each for each in FUNCTIONS if not hasattr(each, "__wrapped__")] == []

    def test_constructors(self):
        assert faults_of(constructors(), FEW) == []

    @pytest.mark.slow
    def test_functions(self, folder: Path):
        assert faults_of([each for each in functions(folder) if not each.is_long], FEW) == []

    def test_methods(self, folder: Path):
        assert faults_of([each for each in methods(folder) if not each.is_long], FEW) == []

    @pytest.mark.slow
    def test_constructors_with_all_values(self):
        assert faults_of(constructors(), VALUES) == []

    @pytest.mark.slow
    def test_functions_and_methods_with_all_values(self, folder: Path):
        assert faults_of([*functions(folder), *methods(folder)], VALUES) == []


@checked
def example(
    scene: ne.Scene, count: int = 1, *, names: Sequence[str] = (), **others: float
) -> tuple[Any, ...]:
    """Return the arguments."""
    return scene, count, names, others


def test_valid_arguments_arrive_as_they_are():
    names = ["a"]
    found = example(SWING, np.int64(2), names=names, x=Fraction(1, 2))
    assert found == (SWING, 2, names, {"x": Fraction(1, 2)})
    assert found[2] is names
    assert inspect.signature(example).parameters["count"].default == 1


@pytest.mark.parametrize(
    ("arguments", "option", "value"),
    [
        ({"scene": "swing"}, "scene", "swing"),
        ({"count": 1.0}, "count", 1.0),
        ({"count": True}, "count", True),
        ({"names": "a"}, "names", "a"),
        ({"names": ["a", 1]}, "names", 1),
        ({"x": float("inf")}, "x", float("inf")),
    ],
)
def test_errors_name_function_argument_and_value(arguments, option, value):
    with pytest.raises(ArgumentError) as caught:
        example(**{"scene": SWING, **arguments})
    error = caught.value
    assert error.function.endswith(".example")
    assert (error.option, error.value) == (option, value)
    assert all(part in str(error) for part in (error.function, option, repr(value), error.needed))


def test_the_error_of_a_missing_state_names_how_to_get_one():
    with pytest.raises(ArgumentError) as caught:
        ne.inverse_dynamics(SWING, SWING.initial_state)
    assert caught.value.value is None
    assert "State (initial_state(scene))" in caught.value.needed


@pytest.mark.parametrize(
    "call",
    [
        lambda: ne.simulate(),
        lambda: ne.simulate(SWING, scene=SWING),
        lambda: ne.statics(SWING, None, None, None),
        lambda: ne.statics(SWING, state=None),
    ],
)
def test_wrong_signatures_are_type_errors(call):
    with pytest.raises(TypeError):
        call()


@pytest.mark.parametrize(
    ("call", "option"),
    [
        (lambda: ne.simulate_batch(SWING, parameters={"arm.mass": [1.0]}, threads=4097), "threads"),
        (lambda: ne.singular_poses(SWING, ["pivot"], 1_000_001), "count"),
        (lambda: ne.workspace(SWING, {"pivot": np.zeros(1_000_001)}), "grid"),
    ],
)
def test_work_is_limited(call, option):
    with pytest.raises(OptionError) as caught:
        call()
    assert caught.value.option == option


def test_warnings_point_to_the_line_that_calls():
    @checked
    def warn() -> None:
        warnings.warn("here", stacklevel=caller_level())

    with pytest.warns(UserWarning, match="here") as heard:
        warn()
    assert Path(heard[0].filename) == Path(__file__)


def test_numbers_of_an_array_are_checked_at_once():
    @checked
    def total(values: Sequence[float], counts: Mapping[str, Sequence[int]]) -> float:
        return len(values) + len(counts)

    many = np.linspace(0.0, 1.0, 1_000_000)
    start = time.process_time()
    assert total(many, {"a": np.arange(1_000_000)}) == 1_000_001
    assert time.process_time() - start < 0.1  # s; one by one 2.9, on a machine of 2024
    many[70] = np.nan
    with pytest.raises(ArgumentError, match=r"values\[70\] is nan"):
        total(many, {})
    with pytest.raises(ArgumentError, match=r"counts\['a'\]\[0\] is 0.5; needed: a whole number"):
        total([], {"a": np.full(3, 0.5)})


def test_a_call_costs_microseconds():
    calls = 2000
    bare = example.__wrapped__
    costs = []
    for _ in range(5):
        times = []
        for function in (example, bare):
            start = time.process_time()
            for _ in range(calls):
                function(SWING, 2, names=("a", "b"), x=0.5)
            times.append(time.process_time() - start)
        costs.append((times[0] - times[1]) / calls)
    assert min(costs) < 50e-6  # s; 4e-6 on a machine of 2024 without other work
