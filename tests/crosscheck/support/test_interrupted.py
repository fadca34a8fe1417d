"""Runs that are interrupted or killed, and full disks: complete files or none."""

from __future__ import annotations

import _imp
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from importlib.machinery import ExtensionFileLoader, ModuleSpec
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest
from command_line import command, run, scene_file, short_example
from rerun.chunk import RrdReader

from crosscheck.cli import _raise_interrupt
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import ABANDONED_AFTER_S, write_files
from newton_euler.model.trajectory import load_arrays

ENGINES = ("newton_euler", "pinocchio")
FILES = {*(f"{engine}.npz" for engine in ENGINES), "summary.json", "junit.xml", "four_bar.rrd"}
UNFINISHED = re.compile(r"\.(newton_euler|pinocchio|summary|junit|four_bar)-[0-9a-f]{8}\.(npz|json|xml|rrd)")
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)

WRITING = 6e-3
"""s that a run of the four-bar writes files for, measured from its first."""


def started(folder: Path) -> subprocess.Popen[bytes]:
    arguments = ["run", "four_bar.yaml", "--engines", ",".join(ENGINES), "--output", "out"]
    return subprocess.Popen(
        [sys.executable, "-m", "crosscheck", *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A folder with a scene and a complete run of it."""
    folder = tmp_path_factory.mktemp("finished")
    scene_file(folder, short_example(), "four_bar.yaml")
    assert started(folder).wait(timeout=120) == 0
    return folder


def check_complete(path: Path) -> None:
    """Read a file to its end."""
    if path.suffix == ".npz":
        arrays = load_arrays(path)
        assert len(arrays["position"]) == len(arrays["time"]) == 6
    elif path.suffix == ".json":
        assert json.loads(path.read_text())["scene"] == "four_bar"
    elif path.suffix == ".xml":
        assert ElementTree.parse(path).getroot().tag == "testsuites"
    else:
        reader = RrdReader(path)
        assert len(reader.recordings()) == 1
        assert any(chunk.entity_path == "/verdict" for chunk in reader.stream())


def check_folder(folder: Path, names: set[str]) -> list[Path]:
    """All files of a folder are complete, and so is the set if there is a summary; what is unfinished."""
    present = {path.name for path in folder.iterdir()} if folder.exists() else set()
    unfinished = {name for name in present if name.startswith(".")}
    assert all(UNFINISHED.fullmatch(name) for name in unfinished), unfinished
    assert present - unfinished <= names
    for name in present - unfinished:
        check_complete(folder / name)
    if "summary.json" in present:
        assert present - unfinished == names
    return [folder / name for name in unfinished]


def kill_while_writing(process: subprocess.Popen[bytes], out: Path, number: int, delay: float) -> None:
    """Send a signal some s after the first unfinished file is seen."""
    known = set(out.iterdir()) if out.exists() else set()
    while process.poll() is None:
        if out.exists() and any(path.name.startswith(".") for path in set(out.iterdir()) - known):
            time.sleep(delay)
            process.send_signal(number)
            return
        time.sleep(2e-4)


@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=() if k in (1, 2) else pytest.mark.slow) for k in range(6)]
)
def test_a_run_killed_while_it_writes_leaves_complete_files_or_none(tmp_path, finished, seed):
    """Half of them over an older run."""
    number, delay = SIGNALS[seed % 3], random.Random(seed).uniform(0.0, WRITING)
    shutil.copy(finished / "four_bar.yaml", tmp_path)
    if seed % 2 == 1:
        shutil.copytree(finished / "out", tmp_path / "out")
    process, out = started(tmp_path), tmp_path / "out"
    kill_while_writing(process, out, number, delay)
    process.wait(timeout=60)
    unfinished = check_folder(out, FILES)
    if number == signal.SIGKILL:
        for path in unfinished:
            os.utime(path, times=(time.time() - 2.0 * ABANDONED_AFTER_S,) * 2)
    else:
        assert unfinished == []


def test_the_next_run_removes_what_a_killed_one_left(tmp_path, capsys, good):
    out = tmp_path / "out"
    out.mkdir()
    old = [out / name for name in (".summary-0123abcd.json", ".pinocchio-0123abcd.npz")]
    others = [
        out / name for name in (".pinocchio-notes.npz", ".summary-0123abcd.txt", "pinocchio-0123abcd.npz")
    ]
    young = out / ".four_bar-0123abcd.rrd"
    for path in (*old, *others, young):
        path.write_bytes(b"half")
    for path in (*old, *others):
        os.utime(path, times=(time.time() - 2.0 * ABANDONED_AFTER_S,) * 2)
    status, _, _ = run(
        capsys, "run", scene_file(tmp_path, good, "four_bar.yaml"), "--engines", "pinocchio", "--output", out
    )
    assert status == 0
    files = {"pinocchio.npz", "summary.json", "junit.xml", "four_bar.rrd"}
    # somebody may still be writing the young one
    assert {path.name for path in out.iterdir()} == files | {path.name for path in (*others, young)}


def test_a_folder_with_a_summary_is_complete_while_it_is_written(tmp_path, capsys, good, monkeypatch):
    """The old summary goes before the first new file comes, and the new one comes last."""
    path, out = scene_file(tmp_path, good, "four_bar.yaml"), tmp_path / "out"
    arguments = ("run", path, "--engines", "pinocchio", "--output", out)
    assert run(capsys, *arguments)[0] == 0
    came, replace = [], Path.replace

    def recorded(self, target):
        if Path(target).parent == out and not Path(target).name.startswith("."):
            came.append((Path(target).name, (out / "summary.json").exists()))
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", recorded)
    assert run(capsys, *arguments)[0] == 0
    assert came == [
        ("four_bar.rrd", False),
        ("pinocchio.npz", False),
        ("junit.xml", False),
        ("summary.json", False),
    ]


def limited(size: int):
    """A limit on the size of files, as a full disk sets one."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def check_one_line(done: subprocess.CompletedProcess[str], path: str) -> None:
    assert done.returncode == 2
    # a busy machine names stages that take long
    (line,) = (line for line in done.stderr.splitlines() if not line.endswith(" ..."))
    assert line.startswith(f"crosscheck: error: cannot write {path}")
    assert line.endswith(": File too large")


@pytest.mark.slow
def test_a_full_disk_keeps_an_older_run(tmp_path, finished):
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    arguments = ("run", "four_bar.yaml", "--engines", ",".join(ENGINES), "--output", "out")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    done = command(tmp_path, *arguments, preexec_fn=limited(10_000))
    check_one_line(done, "out/")
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


@pytest.mark.parametrize("target", ["model.xml", "robot.urdf", "scene2.yaml"])
def test_a_full_disk_and_a_conversion(tmp_path, good, target):
    scene_file(tmp_path, good, "four_bar.yaml")
    done = command(tmp_path, "convert", "four_bar.yaml", target, preexec_fn=limited(500))
    assert done.returncode == 2
    assert re.fullmatch(rf"crosscheck: error: cannot write '?{target}'?: File too large\n", done.stderr)
    assert [path.name for path in tmp_path.iterdir()] == ["four_bar.yaml"]


@pytest.mark.slow
def test_a_full_disk_and_a_benchmark(tmp_path, good):
    scene_file(tmp_path, good, "four_bar.yaml")
    done = command(tmp_path, "bench", "four_bar.yaml", "--rhs", "--output", "out", preexec_fn=limited(500))
    check_one_line(done, "out/rhs.json")
    assert list((tmp_path / "out").iterdir()) == []


def test_a_full_disk_leaves_nothing(tmp_path):
    """Of files that are written together."""
    code = (
        "from pathlib import Path; from crosscheck.support.files import write_files\n"
        "from crosscheck.support.errors import CrosscheckError\n"
        "try: write_files({Path('out/a'): b'', Path('out/scaling.png'): bytes(10_000)})\n"
        "except CrosscheckError as error: print(error)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        preexec_fn=limited(500),
    )
    assert done.stdout == "cannot write out/scaling.png: File too large\n"
    assert list((tmp_path / "out").iterdir()) == []


def test_a_file_that_cannot_be_renamed_is_named(tmp_path):
    """Not the file that was written last."""
    (tmp_path / "first").mkdir()
    with pytest.raises(CrosscheckError, match=f"cannot write {tmp_path / 'first'}: Is a directory"):
        write_files({tmp_path / "first": b"", tmp_path / "last": b""})


COMMANDS = (
    ("run", "pendulum", "--output", "out"),
    (
        "sweep",
        "pendulum",
        "--vary",
        "dumbbell.mass=normal(1, 0.1)",
        "--runs",
        "100",
        "--keep",
        "final:kinetic_energy",
    ),
    ("regress", "pendulum", "--output", "out"),
    ("list",),
)

LOADED = """
import contextlib, gc, io, signal, sys, threading, typing, warnings
import crosscheck
set_handler = signal.signal
def announce(*arguments):
    signal.signal = set_handler
    before = set_handler(*arguments)
    print("loaded", flush=True)
    return before
signal.signal = announce
from crosscheck.cli import main
main(sys.argv[1:])
"""
"""A command that prints a line as soon as its own code handles interrupts. Before that, Python does."""


@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=() if k < len(COMMANDS) else pytest.mark.slow) for k in range(60)]
)
def test_an_interrupt_at_any_time_is_one_line(tmp_path, seed):
    """While packages are loaded, a command works, and it ends."""
    dice = random.Random(seed)
    process = subprocess.Popen(
        [sys.executable, "-c", LOADED, *COMMANDS[seed % len(COMMANDS)]],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])},
    )
    assert process.stdout.readline() == "loaded\n"
    time.sleep(dice.uniform(0.0, dice.choice([0.1, 1.0, 4.0])))
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=120)
    said = " ".join(line for line in err.splitlines() if not line.endswith(" ..."))
    if process.returncode == 130:
        assert re.fullmatch(r"crosscheck: error: interrupted(: .* are stored, .*)?", said)
    else:  # the command was through; Python ends itself by the signal if it was about to exit
        assert (process.returncode in (0, -signal.SIGINT), said) == (True, "")
    assert not [path for path in tmp_path.rglob(".*") if path.is_file() and path.name != ".sweep.lock"]


def test_an_interrupt_waits_for_the_import_of_a_native_module(monkeypatch):
    """A native module that is interrupted raises an ImportError, which is no interrupt."""
    imported = []

    def create(spec):
        signal.raise_signal(signal.SIGINT)
        imported.append(spec.name)
        return ModuleType(spec.name)

    def import_and_wait():
        ExtensionFileLoader("native", "native.so").create_module(ModuleSpec("native", None))
        time.sleep(10.0)

    monkeypatch.setattr(_imp, "create_dynamic", create)
    before = signal.signal(signal.SIGINT, _raise_interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            import_and_wait()
    finally:
        signal.signal(signal.SIGINT, before)
    assert imported == ["native"]
