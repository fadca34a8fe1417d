"""Sweeps from the first call to the results: equal wherever they run, resumed where they were ended."""

from __future__ import annotations

import errno
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest
import xarray
import zarr

import crosscheck.sweeps.execute
import crosscheck.sweeps.results
from crosscheck import Sweep, sweep
from crosscheck.errors import CrosscheckError
from crosscheck.scenes import load
from crosscheck.sweeps.execute import probed
from crosscheck.sweeps.plan import make_runs
from crosscheck.sweeps.results import _tasks
from crosscheck.sweeps.sampling import _latin_hypercube
from crosscheck.sweeps.store import NAME, Store
from newton_euler import simulate_batch
from newton_euler.codegen.compile import NativeModule, llvm_binding
from newton_euler.errors import NewtonEulerError
from newton_euler.model.geometry import Mesh
from newton_euler.model.mechanism import Mechanism

ARGUMENTS = (
    "pendulum",
    {"dumbbell.mass": "uniform(1, 2)"},
    60,
    "peak:reaction_force,at(1;2):dumbbell.position",
)

KEPT = ("peak:reaction_force", "at(1;2):dumbbell.position", "dumbbell.mass", "status")


@pytest.fixture(autouse=True)
def short_tasks(monkeypatch):
    """Tasks of few runs, so that a small sweep has several of them."""
    monkeypatch.setattr(crosscheck.sweeps.results, "TASK", 1e-6)
    monkeypatch.setattr(crosscheck.sweeps.results, "replace", lambda plan, chunk: replace(plan, chunk=7))


@pytest.fixture(scope="module")
def reference():
    """The same sweep in one task."""
    return sweep(*ARGUMENTS, threads=1)


def assert_equal(found: Sweep, reference: Sweep):
    """All that is kept is equal to the last bit."""
    for name in KEPT:
        assert np.array_equal(found.dataset[name].values, reference.dataset[name].values), name


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


def test_executors_give_the_same(reference, tmp_path):
    with ThreadPoolExecutor(2) as threads:
        assert_equal(sweep(*ARGUMENTS, executor=threads), reference)
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as processes:
        assert_equal(sweep(*ARGUMENTS, executor=processes), reference)
        assert_equal(sweep(*ARGUMENTS, executor=processes, output=tmp_path), reference)


def test_an_interrupted_sweep_goes_on(reference, tmp_path):
    told = []

    def interrupt(stage):
        told.append(stage)
        if len(told) == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(*ARGUMENTS, output=tmp_path, progress=interrupt)
    store = Store.at(tmp_path / NAME)
    there = int(np.sum(store.group["status"][:] > 0))
    assert 0 < there < 60
    told.clear()
    found = sweep(*ARGUMENTS, output=tmp_path, progress=told.append)
    assert found.results.made == 60 - there
    assert f"{there} of 60 runs were there" in told
    assert f"; {there} were there" in found.report.title
    assert_equal(found, reference)
    assert sweep(*ARGUMENTS, output=tmp_path).results.made == 0


@pytest.mark.parametrize("sampling", ["random", "sobol", "saltelli"])
def test_a_sweep_goes_on_with_more_runs(tmp_path, monkeypatch, sampling):
    scene, vary, _, keep = ARGUMENTS
    sweep(scene, vary, 24, keep, sampling=sampling, output=tmp_path)
    resized, resize = [], zarr.Array.resize

    def killed(array, shape):
        resized.append(array)
        if len(resized) == 2:
            raise KeyboardInterrupt
        resize(array, shape)

    with monkeypatch.context() as patch:
        patch.setattr(zarr.Array, "resize", killed)
        with pytest.raises(KeyboardInterrupt):
            sweep(scene, vary, 96, keep, sampling=sampling, output=tmp_path)
    found = sweep(scene, vary, 96, keep, sampling=sampling, output=tmp_path)
    assert found.results.made == 96 - 21  # the fourth task of 7 had 3 runs
    assert_equal(found, sweep(scene, vary, 96, keep, sampling=sampling))
    assert sweep(scene, vary, 96, keep, sampling=sampling, output=tmp_path).results.made == 0


@pytest.mark.parametrize(
    ("sampling", "vary", "runs", "words"),
    [
        (
            "latin_hypercube",
            ["uniform(1, 2)"] * 2,
            [8, 16],
            "runs was 8, is 16 (a Latin hypercube of more runs",
        ),
        ("grid", [[1.0, 2.0], [1.0, 2.0, 3.0]], [None, None], "is values(1, 2, 3) (a grid of other values"),
    ],
)
def test_why_a_sweep_cannot_go_on_with_more_runs_is_said(tmp_path, sampling, vary, runs, words):
    scene, _, _, keep = ARGUMENTS
    first, more = ({"dumbbell.mass": each} for each in vary)
    sweep(scene, first, runs[0], keep, sampling=sampling, output=tmp_path)
    with pytest.raises(CrosscheckError) as caught:
        sweep(scene, more, runs[1], keep, sampling=sampling, output=tmp_path)
    assert words in str(caught.value)


def test_runs_that_are_not_in_the_store_are_one_line(tmp_path, monkeypatch):
    write = Store.write
    monkeypatch.setattr(Store, "write", lambda store, first, chunk: first and write(store, first, chunk))
    with pytest.raises(
        CrosscheckError, match=r"1 of 9 chunks of runs are not in .*; needed: a folder that all"
    ):
        sweep(*ARGUMENTS, output=tmp_path)


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


def test_tasks_are_chunks_in_a_row():
    plan = SimpleNamespace(chunk=7, bounds=lambda k: (7 * k, min(7 * k + 7, 60)))
    assert list(_tasks(plan, [0, 1, 2, 4, 8], 16)) == [(0, 14), (14, 21), (28, 35), (56, 60)]
    assert list(_tasks(plan, [0, 1], 1)) == [(0, 7), (7, 14)]


def test_attributes_are_those_of_netcdf(tmp_path):
    short = replace(load("pendulum"), duration=0.1)
    sweep(short, *ARGUMENTS[1:3], "peak:reaction_force", output=tmp_path).check(1, ["newton_euler"])
    found = xarray.open_zarr(tmp_path / NAME, consolidated=False)
    values = [*found.attrs.values(), *(value for each in found.values() for value in each.attrs.values())]
    assert all(isinstance(value, str | int | float) for value in values)
    found.to_netcdf(tmp_path / "sweep.nc", engine="scipy")


def test_a_full_disk_is_one_line_and_loses_nothing(reference, tmp_path, monkeypatch):
    written, into_place = [], Path.replace

    def full(path, target):
        if "dumbbell" in str(target):
            written.append(path)
            if len(written) > 9:
                raise OSError(errno.ENOSPC, "No space left on device")
        return into_place(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", full)
        with pytest.raises(
            CrosscheckError, match=r"cannot write .*: No space left on device; what is stored is kept"
        ):
            sweep(*ARGUMENTS, output=tmp_path)
    found = sweep(*ARGUMENTS, output=tmp_path)
    assert 0 < found.results.made < 60
    assert_equal(found, reference)


def test_folders_of_starts_that_were_killed_are_removed(tmp_path):
    old, new = tmp_path / ".sweep-0123abcd.zarr", tmp_path / ".sweep-4567abcd.zarr"
    for folder in (old, new):
        (folder / "status").mkdir(parents=True)
    os.utime(old, (0.0, 0.0))
    sweep(*ARGUMENTS, output=tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {NAME, new.name}


def test_reasons_are_read_of_runs_that_stopped_alone(monkeypatch):
    read = []

    class Reasons:
        def __getitem__(self, runs):
            read.append(runs.tolist())
            return SimpleNamespace(values=np.array([f"reason {run}" for run in runs]))

    monkeypatch.setattr(crosscheck.sweeps.results, "BLOCK", 4)
    status = xarray.DataArray([1, 1, 1, 1, 1, 2, 2, 1, 1, 1], dims="run")
    dataset = {"status": status, "error": Reasons()}
    plan = SimpleNamespace(samples=SimpleNamespace(runs=10))
    found = crosscheck.sweeps.results.Results(plan, dataset, None, 0, 0.0)
    assert found.errors == {5: "reason 5", 6: "reason 6"}
    assert read == [[5, 6]]


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
        ({"seed": 1}, "another plan: seed was 0, is 1;"),
        ({"runs": 59}, "another plan: runs was 60, is 59;"),
        (
            {"vary": {"dumbbell.mass": "uniform(1, 3)", "gravity.y": "uniform(-10, -9)"}},
            "another plan: vary dumbbell.mass was uniform(1, 2), is uniform(1, 3);",
        ),
        # whose columns of random numbers would change places
        (
            {"vary": {"gravity.y": "uniform(-10, -9)", "dumbbell.mass": "uniform(1, 2)"}},
            "another plan: order of vary was dumbbell.mass, gravity.y, is gravity.y, dumbbell.mass;",
        ),
        ({"keep": "peak:reaction_force"}, "another plan: keep was at(1;2):dumbbell.position, is without it;"),
        ({"rtol": 1e-6}, "another plan: rtol was 1e-10, is 1e-06;"),
        ({"scene": replace(load("pendulum"), duration=9.0)}, "another scene"),
    ],
)
def test_another_plan_or_scene_is_refused(tmp_path, changed, words):
    arguments = dict(zip(("scene", "vary", "runs", "keep"), ARGUMENTS, strict=True))
    arguments["vary"] = {**arguments["vary"], "gravity.y": "uniform(-10, -9)"}
    sweep(**arguments, output=tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    with pytest.raises(CrosscheckError) as caught:
        sweep(**arguments | changed, output=tmp_path)
    assert words in str(caught.value)
    assert "name another folder" in str(caught.value)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("crosscheck.sweeps.sampling.qmc.LatinHypercube", "other samples"),
        ("crosscheck.sweeps.plan.llvm_binding", "another kind of processor"),
    ],
)
def test_another_package_or_processor_is_refused(tmp_path, monkeypatch, place, words):
    def other(size=0, seed=0):
        features = {"fma": not llvm_binding().get_host_cpu_features().get("fma", False)}
        return SimpleNamespace(
            random=lambda runs: np.full((runs, size), 0.5), get_host_cpu_features=lambda: features
        )

    sweep(*ARGUMENTS, sampling="latin_hypercube", output=tmp_path)
    _latin_hypercube.cache_clear()
    monkeypatch.setattr(place, other)
    with pytest.raises(CrosscheckError, match=f"holds a sweep of {words}"):
        sweep(*ARGUMENTS, sampling="latin_hypercube", output=tmp_path)
    _latin_hypercube.cache_clear()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"vary": {"dumbell.mass": "uniform(1, 2)"}}, "unknown parameter 'dumbell.mass'"),
        ({"vary": {"gravity": "uniform(1, 2)"}}, "--vary gravity: it has 3 numbers; name one, gravity.x"),
        ({"keep": "final:nothing"}, "unknown output 'nothing'"),
        ({"foo": 1}, "unknown option 'foo'"),
        ({"parameters": {}}, "unknown option 'parameters'"),
        ({"formulation": "cartesian"}, "unknown option 'formulation'"),
        ({"states": None}, "unknown option 'states'"),
        ({"projection": False}, "unknown option 'projection'"),
        ({"keep": "at(1):position, at(2):position, time1=peak:position"}, "'time1' is the name of something"),
        ({"keep": "status=peak:reaction_force"}, "'status' is the name of something else"),
        ({"keep": ()}, "nothing is kept"),
        ({"threads": 0}, "threads is 0"),
        ({"threads": 1, "cluster": "tcp://127.0.0.1:1"}, "choose one"),
        ({"rtol": 2.0}, "rtol is 2.0"),
        ({"output": "/dev/null/folder"}, "cannot write"),
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
    assert sweep(scene, vary, 8, keep, seed=3, **options).results.made == 0
    assert found.results.made == 8


@pytest.mark.parametrize("runs", [-1, 1.5, "2", 0])
def test_impossible_numbers_of_checks_are_refused(reference, runs):
    with pytest.raises(NewtonEulerError, match="runs is"):
        reference.check(runs)


def test_a_folder_with_something_else_is_refused(tmp_path):
    (tmp_path / NAME).mkdir()
    with pytest.raises(CrosscheckError, match="holds no sweep"):
        sweep(*ARGUMENTS, output=tmp_path)


def test_a_damaged_folder_is_one_line(tmp_path):
    sweep(*ARGUMENTS, output=tmp_path)
    chunk = tmp_path / NAME / "status" / "c" / "3"
    chunk.write_bytes(chunk.read_bytes()[:-4])
    with pytest.raises(CrosscheckError, match="is damaged: status"):
        sweep(*ARGUMENTS, output=tmp_path)


KILLED = """
import sys
import crosscheck.sweeps.results
from crosscheck.sweeps.sweep import sweep
crosscheck.sweeps.results.TASK = 0.1  # many tasks, so that some are left
arguments = "tracker", {"panel_7.mass": "normal(0.89, 0.05)"}, 5000, "peak:reaction_force"
sweep(*arguments, rtol=1e-6, output=sys.argv[1])
"""


def stored(folder):
    """The number of runs that a sweep on disk has; none before it is there."""
    path = folder / NAME
    return int(np.count_nonzero(Store.at(path).group["status"][:])) if path.exists() else 0


@pytest.mark.slow  # a sweep of seconds, begun ten times
def test_a_sweep_killed_ten_times_is_the_one_that_was_not(tmp_path, monkeypatch):
    monkeypatch.undo()
    runs, random, folder, counts = 5000, Random(1), tmp_path / "killed", [0]
    for _ in range(10):
        process = subprocess.Popen([sys.executable, "-c", KILLED, folder])
        while process.poll() is None and stored(folder) == counts[-1]:
            time.sleep(0.001)
        time.sleep(random.uniform(0.0, 0.05))
        process.send_signal(signal.SIGKILL)
        process.wait()
        counts.append(stored(folder))
    # a busy machine may come too late for some of them
    assert sum(before < after < runs for before, after in pairwise(counts)) >= 3
    arguments = ("tracker", {"panel_7.mass": "normal(0.89, 0.05)"}, runs, "peak:reaction_force")
    found = sweep(*arguments, rtol=1e-6, output=folder).dataset
    other = sweep(*arguments, rtol=1e-6, output=tmp_path / "other").dataset
    for name in ("panel_7.mass", "peak:reaction_force", "status"):
        assert np.array_equal(found[name].values, other[name].values)
    assert np.all(found["status"].values == 1)
    assert len(np.unique(found["panel_7.mass"].values)) == runs
