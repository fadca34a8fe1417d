"""Sweeps on disk: taken up where they were ended, other plans refused, nothing lost."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from random import Random
from types import SimpleNamespace

import numpy as np
import pytest
import xarray
import zarr
from command_line import run
from hostile_stores import damaged
from small_sweep import ARGUMENTS, assert_equal

import crosscheck.sweeps.results
from crosscheck import sweep
from crosscheck.library import load
from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.execute import Pace
from crosscheck.sweeps.sampling import _latin_hypercube
from crosscheck.sweeps.store import REPEAT_COMMAND, STORE_NAME, Store
from newton_euler import with_parameters
from newton_euler.codegen.compile import llvm_binding

pytestmark = pytest.mark.usefixtures("short_tasks")


def test_an_interrupted_sweep_goes_on(reference, tmp_path):
    told = []

    def interrupt(stage):
        told.append(stage)
        if len(told) == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        sweep(*ARGUMENTS, output=tmp_path, progress=interrupt)
    store = Store.at(tmp_path / STORE_NAME)
    there = int(np.sum(store.group["status"][:] > 0))
    assert 0 < there < 60
    told.clear()
    found = sweep(*ARGUMENTS, output=tmp_path, progress=told.append)
    assert found.results.executed == 60 - there
    assert any(line.startswith(f"{there} of 60 runs") for line in told)
    assert f"; {there} from earlier commands" in found.report.title
    assert_equal(found, reference)
    assert sweep(*ARGUMENTS, output=tmp_path).results.executed == 0


def test_an_interrupted_command_says_what_is_stored(tmp_path, capsys, monkeypatch):
    class Interrupted(Pace):
        def add(self, runs):
            raise KeyboardInterrupt

    monkeypatch.setattr(crosscheck.sweeps.results, "Pace", Interrupted)
    arguments = ("--vary", "dumbbell.mass=uniform(1, 2)", "--runs", "60", "--keep", "final:kinetic_energy")
    status, _, err = run(capsys, "sweep", "pendulum", *arguments, "--output", tmp_path)
    stored = Store.at(tmp_path / STORE_NAME).progress()
    assert (status, stored.partition(" ")[2]) == (130, "of 60 runs")
    said = f"crosscheck: error: interrupted: {stored} are stored, {REPEAT_COMMAND}"
    assert " ".join(err.split()) == said
    status, _, err = run(capsys, "report", tmp_path)
    assert status == 2
    assert f"holds an unfinished sweep, {stored}" in " ".join(err.split())


@pytest.mark.slow
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
    assert found.results.executed == 96 - 24
    assert_equal(found, sweep(scene, vary, 96, keep, sampling=sampling))
    assert sweep(scene, vary, 96, keep, sampling=sampling, output=tmp_path).results.executed == 0


def test_a_small_sweep_that_goes_on_has_as_few_files_as_a_large_one(tmp_path, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setattr(crosscheck.sweeps.results, "probed", lambda make, runs: 1000.0)
    short, told = replace(load("pendulum"), duration=0.1), list[str]()
    arguments = short, {"dumbbell.mass": "uniform(1, 2)"}
    sweep(*arguments, 10, "peak:reaction_force", output=tmp_path)
    found = sweep(*arguments, 6000, "peak:reaction_force", output=tmp_path, progress=told.append)
    assert found.results.executed == 5990
    assert any(line.startswith("10 of 6,000 runs") for line in told)
    assert "5,990 simulated" in found.report.title
    # 512 runs, a power of 2, take a second
    for name in ("status", "dumbbell.mass", "peak:reaction_force"):
        chunks = [path for path in (tmp_path / STORE_NAME / name / "c").rglob("*") if path.is_file()]
        assert len(chunks) == 12
    assert_equal(found, sweep(*arguments, 6000, "peak:reaction_force"))


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


@pytest.mark.parametrize("more", [False, True])
def test_a_task_that_outlives_its_sweep_writes_nothing_into_another(tmp_path, monkeypatch, more):
    """A worker of a cluster goes on when its client was killed."""
    late = []

    def killed(task, items, *others):
        late.append(lambda: task(items[-1]))
        raise KeyboardInterrupt

    scene, vary, runs, keep = ARGUMENTS
    other = {"dumbbell.mass": "uniform(3, 4)"}
    with monkeypatch.context() as patch:
        patch.setattr(crosscheck.sweeps.results, "run_tasks", killed)
        with pytest.raises(KeyboardInterrupt):
            sweep(scene, vary if more else other, 24 if more else runs, keep, output=tmp_path)
    if not more:
        (tmp_path / STORE_NAME).rename(tmp_path / "removed")
    sweep(*ARGUMENTS, output=tmp_path)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / STORE_NAME).rglob("*")}
    late[0]()
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / STORE_NAME).rglob("*")} == before


def test_runs_that_are_not_in_the_store_are_one_line(tmp_path, monkeypatch):
    write = Store.write
    monkeypatch.setattr(Store, "write", lambda store, first, chunk: first and write(store, first, chunk))
    with pytest.raises(CrosscheckError, match=r"7 of 60 runs .*sweep\.zarr; needed: a folder"):
        sweep(*ARGUMENTS, output=tmp_path)


def test_attributes_are_those_of_netcdf(tmp_path):
    short = replace(load("pendulum"), duration=0.1)
    sweep(short, *ARGUMENTS[1:3], "peak:reaction_force", output=tmp_path)
    found = xarray.open_zarr(tmp_path / STORE_NAME, consolidated=False)
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
        with pytest.raises(CrosscheckError, match=r"cannot write .*sweep\.zarr: No space left on device"):
            sweep(*ARGUMENTS, output=tmp_path)
    found = sweep(*ARGUMENTS, output=tmp_path)
    assert 0 < found.results.executed < 60
    assert_equal(found, reference)


def test_folders_of_starts_that_were_killed_are_removed(tmp_path):
    old, new = tmp_path / ".sweep-0123abcd.zarr", tmp_path / ".sweep-4567abcd.zarr"
    for folder in (old, new):
        (folder / "status").mkdir(parents=True)
    os.utime(old, (0.0, 0.0))
    sweep(*ARGUMENTS, output=tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {STORE_NAME, new.name, ".sweep.lock"}


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
            "another plan: vary was dumbbell.mass, gravity.y, is gravity.y, dumbbell.mass;",
        ),
        (
            {"keep": "peak:reaction_force"},
            "keep was peak:reaction_force, at(1;2):dumbbell.position, is peak:reaction_force;",
        ),
        ({"rtol": 1e-6}, "another plan: rtol was 1e-10, is 1e-06;"),
        ({"scene": replace(load("pendulum"), name="swing")}, "another plan: scene was pendulum, is swing;"),
        ({"scene": replace(load("pendulum"), duration=9.0)}, "another scene: duration was 10, is 9;"),
        (
            {"scene": with_parameters(load("pendulum"), {"dumbbell.mass": 3.0})},
            "another scene: dumbbell.mass was 2, is 3;",
        ),
        (
            {"scene": replace(load("pendulum"), redundancy_tolerance=0.0)},
            "another scene: its start or structure differs;",
        ),
    ],
)
def test_another_plan_or_scene_is_refused(tmp_path, changed, words):
    arguments = dict(zip(("scene", "vary", "runs", "keep"), ARGUMENTS, strict=True))
    arguments["vary"] = {**arguments["vary"], "gravity.y": "uniform(-10, -9)"}
    sweep(**arguments, output=tmp_path)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / STORE_NAME).rglob("*")}
    with pytest.raises(CrosscheckError) as caught:
        sweep(**arguments | changed, output=tmp_path)
    assert words in str(caught.value)
    assert "name another folder" in str(caught.value)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / STORE_NAME).rglob("*")} == before


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("scipy.stats.qmc.LatinHypercube", "other samples"),
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


AT_WORK = """
import sys
from pathlib import Path
from crosscheck.sweeps.store_files import locked
with locked(Path(sys.argv[1])):
    print("at work", flush=True)
    sys.stdin.read()
"""


def test_a_folder_that_another_process_works_at_is_refused_until_that_ends(tmp_path):
    scene, vary, runs, keep = ARGUMENTS
    found = sweep(*ARGUMENTS, output=tmp_path)
    command = [sys.executable, "-c", AT_WORK, tmp_path / STORE_NAME]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "at work\n"
        with pytest.raises(CrosscheckError, match=r"another process .*sweep\.zarr"):
            sweep(scene, vary, 2 * runs, keep, output=tmp_path)
        assert len(found.check(1, ["newton_euler"]).checks) == 1
        other.kill()
    assert sweep(scene, vary, 2 * runs, keep, output=tmp_path).results.executed == runs


def test_a_folder_with_something_else_is_refused(tmp_path):
    (tmp_path / STORE_NAME).mkdir()
    with pytest.raises(CrosscheckError, match="holds no sweep"):
        sweep(*ARGUMENTS, output=tmp_path)


def flipped(file, random):
    """Flip one bit of a file."""
    content = bytearray(file.read_bytes())
    content[random.randrange(len(content))] ^= 1 << random.randrange(8)
    file.write_bytes(content)


HARM = {
    "a bit flipped": flipped,
    "cut": lambda file, random: file.write_bytes(file.read_bytes()[:-4]),
    "empty": lambda file, random: file.write_bytes(b""),
    "gone": lambda file, random: file.unlink(),
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of the small sweep, of tasks of 7 runs."""
    folder = tmp_path_factory.mktemp("finished")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(crosscheck.sweeps.results, "_task_size", lambda plan, at, progress: 7)
        sweep(*ARGUMENTS, output=folder)
    return folder


@pytest.fixture
def copied(finished, tmp_path):
    """A copy of that folder."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.mark.parametrize(
    ("name", "harm"),
    [
        *(("peak:reaction_force", harm) for harm in HARM),
        *((name, "a bit flipped") for name in ("dumbbell.mass", "at(1;2):dumbbell.position", "status")),
    ],
)
def test_runs_of_a_damaged_chunk_are_named_and_made_again(reference, copied, name, harm):
    random = Random(f"{name} {harm}")
    (file,) = [path for path in (copied / STORE_NAME / name / "c" / "3",) if path.exists()]
    while file.is_dir():
        (file,) = file.iterdir()
    HARM[harm](file, random)
    found = sweep(*ARGUMENTS, output=copied)
    assert found.results.executed == 7
    (line,) = found.results.repaired
    assert str(file) in line
    assert "runs 21 to 27 " in line
    assert line in str(found.report.summary[-1].lines)
    assert_equal(found, reference)
    again = sweep(*ARGUMENTS, output=copied)
    assert (again.results.executed, again.results.repaired) == (0, ())


@pytest.mark.slow  # a sweep for each bit
def test_any_flipped_bit_is_found(reference, copied):
    files = [path for path in (copied / STORE_NAME).glob("*/c/**/*") if path.is_file()]
    random = Random(8)
    for file in random.choices(files, k=60):
        flipped(file, random)
        found = sweep(*ARGUMENTS, output=copied)
        (line,) = found.results.repaired
        assert str(file.parent.parent) in line or str(file) in line
        assert_equal(found, reference)


def test_names_along_a_dimension_are_those_of_the_scene(reference, copied):
    group = zarr.open_group(copied / STORE_NAME)
    group["joint"][0] = "another"  # with a checksum that fits
    found = sweep(*ARGUMENTS, output=copied)
    assert len(found.results.repaired) == 1
    assert list(found.dataset["joint"].values) == ["pivot"]


def test_a_run_that_stopped_keeps_its_reason(tmp_path):
    """Its numbers are all not a number, and have a file all the same."""
    arguments = ("pendulum", {"dumbbell.mass": [1.0, -1.0]}, None, "peak:reaction_force")
    sweep(*arguments, sampling="grid", output=tmp_path)
    for name in ("error", "peak:reaction_force"):
        (file,) = [path for path in (tmp_path / STORE_NAME / name / "c").rglob("*") if path.is_file()]
        file.unlink()
        found = sweep(*arguments, sampling="grid", output=tmp_path)
        assert found.results.executed == 2
        assert list(found.errors) == [1]


def of_metadata(change):
    def harm(file):
        content = json.loads(file.read_text())
        change(content)
        file.write_text(json.dumps(content))

    return harm


def linked(file):
    file.rename(file.with_name("elsewhere"))
    file.symlink_to(file.with_name("elsewhere"))


def piped(file):
    file.unlink()
    os.mkfifo(file)


def device(file):
    file.unlink()
    file.symlink_to("/dev/zero")


@pytest.mark.parametrize(
    ("file", "harm"),
    [
        ("zarr.json", lambda file: file.write_bytes(file.read_bytes()[:-4])),
        ("zarr.json", of_metadata(lambda content: content["attributes"].update(runs=2**40))),
        ("zarr.json", of_metadata(lambda content: content["attributes"].update(chunk=8))),
        ("zarr.json", of_metadata(lambda content: content["attributes"].update(runs="60"))),
        ("zarr.json", of_metadata(lambda content: content["attributes"].update(seed=[0]))),
        ("status/zarr.json", of_metadata(lambda content: content.update(shape=[10**30]))),
        ("status/zarr.json", of_metadata(lambda content: content.update(shape="x"))),
        ("status/zarr.json", of_metadata(lambda content: content.update(data_type="float64"))),
        ("status/zarr.json", of_metadata(lambda content: content.update(fill_value=1))),
        ("status/zarr.json", of_metadata(lambda content: content["codecs"].pop())),
        ("error/zarr.json", of_metadata(lambda content: content["codecs"].insert(1, {"name": "zstd"}))),
        ("joint/zarr.json", of_metadata(lambda content: content["attributes"].update(units="m"))),
        ("dumbbell.mass/zarr.json", of_metadata(lambda content: content["attributes"].clear())),
        ("dumbbell.mass/zarr.json", of_metadata(lambda content: content.update(dimension_names=["joint"]))),
        ("status/zarr.json", piped),
        ("status/c/3", piped),
        ("status/c/3", device),
        ("status/c/3", linked),
        ("status", linked),
        ("error", lambda file: (file / "c").mkdir() or os.mkfifo(file / "c" / "0")),
        ("dumbbell.mass/c/3", lambda file: file.write_bytes(bytes(1000))),
    ],
)
def test_a_folder_of_other_files_is_one_line(copied, file, harm):
    harm(copied / STORE_NAME / file)
    with pytest.raises(CrosscheckError) as caught:
        sweep(*ARGUMENTS, output=copied)
    assert file.partition("/")[0] in str(caught.value)
    assert "name another folder" in str(caught.value)
    assert len(str(caught.value)) < 700


def check_damaged(finished, reference, folder, seed):
    """A damaged store gives the numbers that it had, or is refused in one line."""
    shutil.copytree(finished, folder)
    done = damaged(folder / STORE_NAME, Random(seed))
    refusal = ""
    try:
        found = sweep(*ARGUMENTS, output=folder)
    except CrosscheckError as error:
        refusal = str(error)
    if refusal:
        assert len(refusal) < 900, done
        assert refusal.isprintable(), done
        return
    assert_equal(found, reference)
    for name, values in reference.dataset.items():
        assert found.dataset[name].attrs == values.attrs, done


@pytest.mark.parametrize("seed", range(8))
def test_a_store_is_mended_or_refused(finished, reference, tmp_path, seed):
    check_damaged(finished, reference, tmp_path / "copy", seed)


@pytest.mark.slow  # minutes: a sweep for each
@pytest.mark.parametrize("seed", range(8, 300))
def test_more_stores_are_mended_or_refused(finished, reference, tmp_path, seed):
    check_damaged(finished, reference, tmp_path / "copy", seed)


def test_another_variable_is_refused(copied):
    shutil.copytree(copied / STORE_NAME / "status", copied / STORE_NAME / "more")
    with pytest.raises(CrosscheckError, match="more is no variable of this sweep"):
        sweep(*ARGUMENTS, output=copied)


@pytest.mark.parametrize(
    "make", [lambda lock, other: lock.symlink_to(other), lambda lock, _: os.mkfifo(lock)]
)
def test_a_lock_is_a_file_of_the_folder(tmp_path, make):
    other, folder = tmp_path / "precious", tmp_path / "out"
    other.write_text("content")
    folder.mkdir()
    make(folder / ".sweep.lock", other)
    with pytest.raises(CrosscheckError, match=r"cannot write .*\.sweep\.lock"):
        sweep(*ARGUMENTS, output=folder)
    assert other.read_text() == "content"
    assert list(folder.iterdir()) == [folder / ".sweep.lock"]


@pytest.mark.parametrize("name", ["dumbbell.mass", "peak:reaction_force", "joint", "error"])
def test_a_variable_that_is_not_there_is_named(tmp_path, name):
    sweep(*ARGUMENTS, output=tmp_path)
    (tmp_path / STORE_NAME / name).rename(tmp_path / "elsewhere")
    with pytest.raises(CrosscheckError, match=f"is damaged: {name} is missing; name another"):
        sweep(*ARGUMENTS, output=tmp_path)


KILLED = """
import sys
from crosscheck.sweeps.sweep import sweep
vary, keep = {"panel_7.mass": "normal(0.89, 0.05)"}, "peak:reaction_force"
sweep("tracker", vary, 5000, keep, rtol=1e-6, output=sys.argv[1])
"""


def stored(folder):
    """The number of runs that a sweep on disk has."""
    return int(np.count_nonzero(Store.at(folder / STORE_NAME).group["status"][:]))


@pytest.mark.slow  # a sweep of seconds, begun ten times
def test_a_sweep_of_few_runs_that_is_killed_ten_times_on_its_way_to_many_is_as_if_it_was_not(
    tmp_path, monkeypatch
):
    monkeypatch.undo()
    monkeypatch.setattr(
        crosscheck.sweeps.results, "TASK_DURATION_S", 0.1
    )  # many tasks, so that some are left
    vary, keep = {"panel_7.mass": "normal(0.89, 0.05)"}, "peak:reaction_force"
    runs, random, folder, counts = 5000, Random(1), tmp_path / "killed", [10]
    sweep("tracker", vary, counts[0], keep, rtol=1e-6, output=folder)
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
    found = sweep("tracker", vary, runs, keep, rtol=1e-6, output=folder)
    assert_equal(found, sweep("tracker", vary, runs, keep, rtol=1e-6))
    assert not found.errors
    assert len(np.unique(found.dataset["panel_7.mass"].values)) == runs
