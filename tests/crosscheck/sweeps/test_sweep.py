"""Sweeps from the first call to the results: equal wherever they run."""

from __future__ import annotations

import multiprocessing
import pickle
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import xarray
from command_line import run
from small_sweep import ARGUMENTS, assert_equal

import crosscheck.sweeps.execute
import crosscheck.sweeps.results
from crosscheck import sweep
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.studies.stress.noise import flat_four_bar
from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.execute import probed
from crosscheck.sweeps.plan import make_runs
from newton_euler import simulate_batch
from newton_euler.codegen.compile import NativeModule
from newton_euler.errors import NearlyRedundantWarning, NewtonEulerError
from newton_euler.model.geometry import Mesh
from newton_euler.model.mechanism import Mechanism

pytestmark = pytest.mark.usefixtures("short_tasks")


def test_a_sweep_has_what_batches_have(reference):
    found = reference.dataset
    batch = simulate_batch(load("pendulum"), parameters={"dumbbell.mass": found["dumbbell.mass"].values})
    forces = np.linalg.norm(batch.stacked("reaction_force"), axis=3).max(axis=1)
    assert found["peak:reaction_force"].values == pytest.approx(forces, rel=1e-12)
    at = found["at(1;2):dumbbell.position"]
    # steps of the integrator end at other times where other outputs are asked for
    assert at.values == pytest.approx(batch.stacked("position")[:, [100, 200], 1], abs=1e-9)
    assert at.dims == ("run", "time", "axis")
    assert (at.units, found["dumbbell.mass"].units, found["time"].units) == ("m", "kg", "s")
    assert found["time"].values.tolist() == [1.0, 2.0]
    assert found["axis"].values.tolist() == ["x", "y", "z"]
    assert found["peak:reaction_force"].sel(joint="pivot").dims == ("run",)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("on_disk", [False, True])
def test_results_depend_on_no_thread_chunk_or_disk(reference, tmp_path, threads, on_disk):
    found = sweep(*ARGUMENTS, threads=threads, output=tmp_path if on_disk else None)
    assert found.results.plan.chunk == 7
    assert_equal(found, reference)


def test_what_else_is_kept_changes_no_steps_of_fixed_size():
    steps = {"integrator": "Euler", "step": 7e-3}
    alone, beside = (
        sweep(*ARGUMENTS[:2], 3, keep, **steps).dataset["final:dumbbell.position"].values
        for keep in ("final:dumbbell.position", "final:dumbbell.position,peak:reaction_force")
    )
    assert np.array_equal(alone, beside)


def test_code_is_made_once_for_all_threads_and_chunks(monkeypatch):
    made, prepare = [], NativeModule.__init__

    def noted(module, identity, *others):
        made.append(identity)
        prepare(module, identity, *others)

    monkeypatch.setattr(NativeModule, "__init__", noted)
    sweep(replace(load("pendulum"), duration=2.0), *ARGUMENTS[1:], threads=4)
    assert 0 < len(made) == len(set(made))


@pytest.mark.parametrize(
    ("of_a_run", "compiled_at", "counts"),
    [
        (10.0, None, [1]),
        (0.02, None, [1, 4, 4]),
        (0.02, 1, [1, 1, 4, 4]),
        (0.01, 4, [1, 4, 4, 16, 16]),
        (1e-9, None, [1, 4, 16, 50]),
    ],
)
def test_runs_are_probed_by_few_and_without_what_is_compiled(monkeypatch, of_a_run, compiled_at, counts):
    now, made = [0.0], []
    monkeypatch.setattr(crosscheck.sweeps.execute.time, "perf_counter", lambda: now[0])

    def make(count):
        now[0] += count * of_a_run + 0.9 * (count == compiled_at and count not in made)
        made.append(count)

    rate = probed(make, 50)
    assert made == counts
    assert rate == pytest.approx(1.0 / max(of_a_run, 1e-3 / 50))


@pytest.mark.slow
def test_executors_give_the_same(reference, tmp_path):
    with ThreadPoolExecutor(2) as threads:
        assert_equal(sweep(*ARGUMENTS, executor=threads), reference)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as processes:
        assert_equal(sweep(*ARGUMENTS, executor=processes), reference)
        assert_equal(sweep(*ARGUMENTS, executor=processes, output=tmp_path), reference)


@pytest.mark.slow
def test_a_sweep_warns_of_nearly_redundant_constraints_once_where_it_is_called(capfd):
    """However many chunks, and in other processes not at all; nor do its checks."""
    scene = replace(flat_four_bar(3e-9), duration=0.05)
    arguments = scene, {"crank.mass": "uniform(1, 2)"}, 20, "peak:kinetic_energy"
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as processes:
        for options in ({"threads": 2}, {"executor": processes}):
            with pytest.warns(NearlyRedundantWarning) as heard:
                sweep(*arguments, **options).check(1)
            assert [each.filename for each in heard] == [__file__]
    assert "NearlyRedundantWarning" not in capfd.readouterr().err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("solver", "another version of newton_euler"),
        ("processor", "another kind"),
        ("samples", "other samples"),
    ],
)
def test_a_worker_that_would_make_other_runs_is_refused(reference, name, words):
    plan = pickle.loads(pickle.dumps(reference.results.plan))
    masses = reference.dataset["dumbbell.mass"].values
    assert np.array_equal(make_runs(plan, (3, 5)).values["dumbbell.mass"], masses[3:5])
    other = replace(plan, needed=plan.needed | {name: "other"})
    with pytest.raises(CrosscheckError, match=f"a worker on .* has {words}"):
        make_runs(other, (3, 5))


def test_meshes_are_not_sent():
    scene, mesh = load("pendulum"), Mesh(np.random.default_rng(1).normal(size=(10_000, 3)), [[0, 1, 2]])
    bodies = (scene.mechanism.bodies[0], replace(scene.mechanism.bodies[1], meshes=(mesh,)))
    meshed = replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints))
    plan = sweep(meshed, *ARGUMENTS[1:2], 2, "peak:reaction_force").results.plan
    assert len(pickle.dumps(plan)) < mesh.vertices.nbytes


def test_reasons_are_read_of_runs_that_stopped_alone_and_not_all_at_once(monkeypatch):
    read = []

    class Reasons:
        def __getitem__(self, runs):
            read.append(runs.tolist())
            return SimpleNamespace(values=np.array([f"reason {run}" for run in runs]))

    monkeypatch.setattr(crosscheck.sweeps.results, "STATUS_RUNS", 2)
    status = xarray.DataArray([1, 1, 1, 1, 1, 2, 2, 1, 1, 2], dims="run")
    dataset = {"status": status, "error": Reasons()}
    plan = SimpleNamespace(samples=SimpleNamespace(runs=10))
    found = crosscheck.sweeps.results.SweepResults(plan, dataset, SimpleNamespace(path=None), 0, 0.0)
    reasons = found.reasons()
    assert next(reasons) == (5, "reason 5")
    assert read == [[5, 6]]
    assert list(reasons) == [(6, "reason 6"), (9, "reason 9")]


def test_a_sweep_whose_first_runs_make_no_sense_is_made(monkeypatch):
    monkeypatch.setattr(crosscheck.sweeps.results, "START_CHECK_RUNS", 4)
    values = [-2.0] * 9 + [1.0]
    found = sweep("pendulum", {"dumbbell.mass": values}, None, "final:dumbbell.position", sampling="grid")
    assert list(found.errors) == list(range(9))


def test_runs_that_cannot_go_on_keep_their_error():
    found = sweep(
        "pendulum",
        {"dumbbell.mass": [1.0, 2.0]},
        None,
        "final:dumbbell.position",
        sampling="grid",
        most_steps=3,
    )
    assert set(found.errors) == {0, 1}
    assert "3 steps" in found.errors[0]
    assert np.all(np.isnan(found.dataset["final:dumbbell.position"].values))
    assert found.dataset["status"].values.tolist() == [2, 2]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"vary": {"dumbell.mass": "uniform(1, 2)"}}, "unknown parameter 'dumbell.mass'"),
        ({"vary": {"gravity": "uniform(1, 2)"}}, "--vary gravity: it has 3 numbers; name one, gravity.x"),
        (
            {"vary": {"dumbbell.mass": "normal(-14, 0.1)"}},
            "--vary dumbbell.mass=normal(-14, 0.1): no run of 60 can start: parameter 'dumbbell.mass': is -1",
        ),
        (
            {
                "scene": "four_bar",
                "vary": {"ball_0.point_on_first.x": "uniform(5, 6)"},
                "keep": "final:position",
            },
            "no run of 60 can start: ",
        ),
        ({"keep": "final:nothing"}, "unknown output 'nothing'"),
        ({"foo": 1}, "unknown option 'foo'"),
        ({"parameters": {}}, "unknown option 'parameters'"),
        ({"formulation": "cartesian"}, "unknown option 'formulation'"),
        ({"states": None}, "unknown option 'states'"),
        ({"projection": False}, "unknown option 'projection'"),
        ({"keep": "at(1):position, at(2):position, time1=peak:position"}, "'time1'"),
        ({"keep": "status=peak:reaction_force"}, "'status'"),
        ({"keep": ()}, "nothing is kept"),
        ({"threads": 0}, "threads is 0"),
        ({"threads": 1, "cluster": "tcp://127.0.0.1:1"}, "choose one"),
        ({"rtol": 2.0}, "rtol is 2.0"),
        ({"output": "/dev/null/folder"}, "cannot write /dev/null/folder/sweep.zarr: Not a directory"),
        ({"executor": 3}, "executor is 3"),
        ({"scene": "tracker_moon"}, "unknown"),
    ],
)
def test_bad_input_is_one_line(changed, words):
    arguments = dict(zip(("scene", "vary", "runs", "keep"), ARGUMENTS, strict=True))
    with pytest.raises((CrosscheckError, NewtonEulerError)) as caught:
        sweep(**arguments | changed)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_numbers_of_numpy_are_numbers(tmp_path):
    scene, vary, _, keep = ARGUMENTS
    options = {"rtol": np.float32(1e-6), "most_steps": np.int64(10**6), "output": tmp_path}
    found = sweep(scene, vary, np.int64(8), keep, seed=np.int32(3), **options)
    assert sweep(scene, vary, 8, keep, seed=3, **options).results.executed == 0
    assert found.results.executed == 8


@pytest.mark.parametrize("runs", [-1, 1.5, "2", 0])
def test_impossible_numbers_of_checks_are_refused(reference, runs):
    with pytest.raises(NewtonEulerError, match="runs is"):
        reference.check(runs)


def test_runs_are_cross_checked_in_the_engines_that_are_named(with_engines, capsys, tmp_path):
    with_engines(replace(ENGINES["newton_euler"], name="toy"))
    arguments = ("--vary", "dumbbell.mass=normal(1, 0.1)", "--runs", 4, "--keep", "peak:reaction_force")
    checks = ("--check", 1, "--engines", "newton_euler,toy", "--output", tmp_path / "sweep")
    status, out, _ = run(capsys, "sweep", "pendulum", *arguments, *checks)
    assert status == 0
    assert "newton_euler, toy agree in all checks" in " ".join(out.split())
