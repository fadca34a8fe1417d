"""Several states at once, and several runs: each as it is alone, to the last bit."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from crosscheck.library import load
from newton_euler.codegen.compile import lane_count
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.codegen.trigonometry import REGISTER_DOUBLES
from newton_euler.compiled.lanes import Runs, SideBySide, load_lanes
from newton_euler.compiled.records import equations
from newton_euler.compiled.run import Fallback, Integrator, Projection
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.dense_projection import RESIDUAL_ROUND_OFF
from newton_euler.integrators.options import Options
from newton_euler.integrators.projection import project_rows
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS, Count, Table, reported_counts
from newton_euler.model.trajectory import IntegrationError
from newton_euler.reading.excitation import random_states
from newton_euler.runs.simulate import CompiledScene


def recorded(code, times, table):
    """The rows after the first, and what came of it."""
    assert code.function("position").lanes == code.function("velocity").lanes == REGISTER_DOUBLES > 1
    counts, table = np.zeros(COUNTS), table.copy()
    system = equations(code, Fallback(code, counts), code.function("derivative"), np.zeros(code.size))
    x = code.start.copy()
    target = Table(len(table), code.size, 1, 1, np.zeros(1), times, x, table, counts)
    status = NativeFunctions([project_rows])(project_rows, system, target, table, 1, len(table), 0, x)
    return status, table, int(counts[Count.ROWS_WRITTEN])


@pytest.mark.parametrize("far", [(), (3,), (1, 6)])
@pytest.mark.parametrize("scene", ["tracker", "four_bar", "slider_crank"])
def test_rows_are_what_each_is_alone(scene, far):
    """A group of as many as there are lanes and one of fewer, with and without rows that need more steps."""
    code, rng = CompiledScene(load(scene)), np.random.default_rng(0)
    rows, start = 1 + REGISTER_DOUBLES + 2, code.start
    times, table = np.linspace(0.0, 1.0, rows), np.tile(start[: code.size], (rows, 1))
    table[1:] += 1e-6 * rng.standard_normal((rows - 1, code.size))
    for row in far:
        table[row] += 3e-2 * rng.standard_normal(code.size)
    status, found, written = recorded(code, times, table)
    assert (status, written) == (Status.DONE, rows)
    assert np.array_equal(found[0], table[0])
    for row in range(1, rows):
        alone = start.copy()
        alone[: code.size], alone[code.size] = table[row], times[row]
        assert Projection(code)(alone)
        assert np.array_equal(found[row], alone[: code.size])
        q = found[row, : code.system.nq]
        assert (
            np.abs(code.system.phi(q)).max() < 10.0 * RESIDUAL_ROUND_OFF
        )  # in m and rad, of mechanisms of some meters


def test_a_row_that_cannot_be_closed_ends_it_and_those_before_it_are_kept():
    code = CompiledScene(load("four_bar"))
    rows = 1 + 2 * REGISTER_DOUBLES
    times, table = np.linspace(0.0, 1.0, rows), np.tile(code.start[: code.size], (rows, 1))
    table[1 + REGISTER_DOUBLES + 1] = np.nan
    status, found, written = recorded(code, times, table)
    assert status != Status.DONE
    assert written == 1 + REGISTER_DOUBLES + 1
    assert np.isfinite(found[:written]).all()


def test_states_without_constraints_are_left_as_they_are() -> None:
    """A scene that has nothing to project onto has no code for it either."""
    code = CompiledScene(load("pendulum"))
    x = code.start + 0.1
    before = x.copy()
    assert Projection(code)(x)
    assert np.array_equal(x, before)


# Runs


LANES = lane_count()

RUNS = LANES + 3
"""So that some lanes make a second one."""

FIXED = {"integrator": "RK4", "step": 5e-3}


@pytest.fixture(scope="module")
def starts():
    """Compiled scenes, and states of runs of each."""
    known = {}

    def of(name, formulation, parameters=()):
        if (name, formulation) not in known:
            scene = replace(load(name), duration=1.5, output_period=0.1)
            code = CompiledScene(scene, formulation, parameters=parameters)
            x = np.tile(code.start, (RUNS, 1))
            for k, state in enumerate(random_states(scene, RUNS)):
                x[k, : code.size] = np.concatenate(code.system.coordinates(state))
            known[name, formulation] = code, x
        return known[name, formulation]

    return of


def one_by_one(code, x, options):
    """Results of runs, counts and errors."""
    integrator = Integrator(code, code.scene.times, options)
    results, counts, errors = np.empty((len(x), *integrator.outputs.shape)), [], {}
    for k, start in enumerate(x):
        try:
            integrator(start)
            integrator.outputs(results[k])
        except IntegrationError as error:
            results[k] = np.nan
            errors[k] = str(error)
        counts.append(reported_counts(integrator.counts))
    return results, counts, errors


def in_groups(code, x, options, groups):
    """The same, of runs in groups."""
    make = SideBySide(code, code.scene.times, options)
    runs = Runs(
        x,
        np.empty((len(x), len(code.scene.times), code.function("output").outputs)),
        np.zeros((len(x), COUNTS)),
        {},
    )
    for group in groups:
        make(runs, np.array(group))
    errors = {k: str(error) for k, error in sorted(runs.errors.items())}
    return runs.results, [reported_counts(counts) for counts in runs.counts], errors


@pytest.mark.parametrize(
    "groups", [[[*range(RUNS)]], [[6, 0], [3], [5, 4, 2, 1, *range(7, RUNS)]]], ids=["one", "three"]
)
@pytest.mark.parametrize(
    ("name", "formulation", "control"),
    [
        ("tracker", "relative", {"rtol": 1e-6, "atol": 1e-8}),
        ("tracker", "relative", FIXED),
        ("tracker", "relative", FIXED | {"integrator": "Euler"}),
        ("four_bar", "relative", {"rtol": 1e-6, "atol": 1e-8}),  # past singular configurations
        ("four_bar", "cartesian", {"rtol": 1e-6, "atol": 1e-8}),
        ("four_bar", "cartesian", FIXED),
        ("heavy_top", "cartesian", {"rtol": 1e-9, "atol": 1e-9}),
        ("pendulum", "relative", {"rest": 1e-3}),
    ],
)
def test_runs_are_what_each_is_alone(starts, name, formulation, control, groups):
    code, x = starts(name, formulation)
    load_lanes(code, control.get("integrator", "DOP853"))
    options = Options(**control)
    results, counts, errors = one_by_one(code, x, options)
    found = in_groups(code, x, options, groups)
    assert found[0].tobytes() == results.tobytes()
    assert found[1:] == (counts, errors)
    assert options.step or any(each["rejected"] for each in counts)  # in some lanes before others


def test_lanes_pass_singular_configurations(starts, monkeypatch):
    """Without help from scalar code, by functions that are compiled when they are needed."""
    known, x = starts("four_bar", "relative")
    code, needed = CompiledScene(known.scene, "relative"), {"retract in lanes", "surface in lanes"}
    load_lanes(code, "DOP853")
    assert not needed & code.functions.keys()
    monkeypatch.setattr(Integrator, "__call__", None)
    in_groups(code, x, Options(rtol=1e-6, atol=1e-8), [[*range(7)]])
    assert needed < code.functions.keys()


@pytest.mark.parametrize(
    "make", [one_by_one, partial(in_groups, groups=[[*range(7)]])], ids=["alone", "lanes"]
)
def test_code_that_cannot_be_made_ends_the_runs_that_need_it(starts, monkeypatch, make):
    known, x = starts("four_bar", "relative")
    options, x = Options(rtol=1e-6, atol=1e-8), x[:7]
    right, _, _ = one_by_one(known, x, options)
    code = CompiledScene(known.scene, "relative")
    load_lanes(code, "DOP853")
    function = code.function

    def refused(name, in_lanes=False):
        if name == "surface":
            raise NewtonEulerError("no room for code")
        return function(name, in_lanes)

    monkeypatch.setattr(code, "function", refused)
    results, _, errors = make(code, x, options)
    assert errors
    assert all("no room for code" in error for error in errors.values())
    others = [k for k in range(len(x)) if k not in errors]
    assert results[others].tobytes() == right[others].tobytes()


def test_a_run_that_fails_leaves_the_others_as_they_are(starts):
    code, x = starts("slider_crank", "relative", ("gravity",))
    x, options = x.copy(), Options(rtol=1e-6, atol=1e-8)
    load_lanes(code, "DOP853")
    x[[2, 5], code.place("gravity")] = 1e200
    results, counts, errors = one_by_one(code, x, options)
    assert list(errors) == [2, 5]
    found = in_groups(code, x, options, [[*range(RUNS)]])
    assert found[0].tobytes() == results.tobytes()
    assert found[1:] == (counts, errors)


@pytest.mark.parametrize("very_large", [1, 10**9], ids=["rolled", "written out"])
def test_large_programs_run_in_lanes(starts, monkeypatch, very_large):
    """One by one they are rolled up into loops."""
    monkeypatch.setattr("newton_euler.codegen.compile.MIN_ROLLED_SIZE", 1)
    for module in ("codegen.compile", "compiled.equations"):
        monkeypatch.setattr(f"newton_euler.{module}.MIN_ROLLED_SIZE_IN_LANES", very_large)
    first, x = starts("chain", "relative")
    code = CompiledScene(first.scene)
    load_lanes(code, "DOP853")
    options = Options(rtol=1e-6, atol=1e-8)
    assert code.function("derivative", in_lanes=True).lanes == LANES
    assert (
        in_groups(code, x, options, [[*range(RUNS)]])[0].tobytes()
        == one_by_one(code, x, options)[0].tobytes()
    )
