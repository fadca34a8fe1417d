"""Processes that are killed, that share a cache and a folder, and caches that somebody damaged."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import scene_file, short_example

import newton_euler
from crosscheck.library import load
from crosscheck.regress.baseline import read_baseline
from newton_euler.codegen.cache import CACHE_VARIABLE
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.run import needed
from newton_euler.model.trajectory import load_arrays

ENGINES = "newton_euler,pinocchio"

COMMANDS = {
    "run": (["run", "four_bar.yaml", "--engines", ENGINES, "--output", "out"], 4.0),
    "regress": (["regress", "four_bar.yaml", "--update", "a test"], 12.0),
    "bench": (["bench", "four_bar.yaml", "--rhs", "--output", "out"], 12.0),
}
"""And s that they take at most on a quiet machine."""

TAMPERED = 50


def started(folder: Path, arguments: list[str], cache: Path | None = None) -> subprocess.Popen[bytes]:
    changed = {} if cache is None else {CACHE_VARIABLE: str(cache)}
    return subprocess.Popen(
        [sys.executable, "-m", "crosscheck", *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])} | changed,
    )


def check_complete(folder: Path) -> None:
    """Every file that a folder has under its own name is whole."""
    for path in folder.rglob("*"):
        if path.name.startswith(".") or not path.is_file():
            continue
        if path.suffix == ".npz":
            assert len(load_arrays(path)["time"]) == 6
        elif path.name == "four_bar.baseline.json":
            assert read_baseline(path).scene == "four_bar"
        elif path.suffix == ".json":
            json.loads(path.read_text())
        elif path.suffix == ".rrd":
            assert path.read_bytes().startswith(b"RRF2")


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which every command has come to its end, with a baseline of an earlier day."""
    folder = tmp_path_factory.mktemp("earlier")
    scene_file(folder, short_example(), "four_bar.yaml")
    for arguments, _ in COMMANDS.values():
        assert started(folder, arguments).wait(timeout=300) == 0
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(60))
def test_a_kill_at_any_moment(tmp_path: Path, earlier: Path, seed: int) -> None:
    """Twenty of each command; half of them over what an earlier one left."""
    arguments, longest = [*COMMANDS.values()][seed % 3]
    chance = random.Random(seed)
    shutil.copy(earlier / "four_bar.yaml", tmp_path)
    over = seed % 2 == 1
    if over:
        shutil.copytree(earlier, tmp_path, dirs_exist_ok=True)
    process = started(tmp_path, arguments)
    time.sleep(chance.uniform(0.1, longest))
    process.send_signal(chance.choice((signal.SIGKILL, signal.SIGTERM, signal.SIGINT)))
    process.wait(timeout=60)
    check_complete(tmp_path)
    assert not over or (tmp_path / "four_bar.baseline.json").exists()


def truncated(path: Path, chance: random.Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: chance.randrange(len(content))])


def flipped(path: Path, chance: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    path.write_bytes(content)


def exchanged(path: Path, chance: random.Random) -> None:
    """With the content of another one, whole as it is."""
    others = sorted(other for other in path.parent.iterdir() if other != path and other.is_file())
    shutil.copy(chance.choice(others), path)


def piped(path: Path, chance: random.Random) -> None:
    path.unlink()
    os.mkfifo(path)


TAMPERING: tuple[Callable[[Path, random.Random], None], ...] = (truncated, flipped, exchanged, piped)


@pytest.mark.parametrize(
    "seed", [pytest.param(k, marks=() if k < 4 else pytest.mark.slow) for k in range(TAMPERED)]
)
def test_a_damaged_cache_is_not_used(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    """All native code of a scene and its rows are damaged in turn; results stay as they were."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    scene = load("pendulum")
    expected = newton_euler.simulate(scene)
    chance = random.Random(seed)
    files = sorted(tmp_path.glob("*.newton-euler"))
    kept = {path: path.read_bytes() for path in files}
    damaged = files if seed < len(TAMPERING) else chance.sample(files, chance.randint(1, len(files)))
    for path in damaged:
        TAMPERING[seed % len(TAMPERING)](path, chance)
    again = newton_euler.simulate(replace(scene))
    np.testing.assert_array_equal(again.position, expected.position)
    np.testing.assert_array_equal(again.quaternion, expected.quaternion)
    assert any(path.is_file() and path.read_bytes() == kept[path] for path in damaged)  # made again


def test_no_pickle_is_in_the_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pickles run what they hold; rows are JSON, and the rest is object code."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    code = CompiledEquations(load("pendulum"))
    for name in needed(code, "Radau"):
        code.function(name)
    contents = [path.read_bytes()[32:] for path in tmp_path.glob("*.newton-euler")]
    assert contents
    assert all(content.startswith((b"[", b"\x7fELF", b"\xcf\xfa\xed\xfe")) for content in contents)


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 8])
def test_processes_on_one_cold_cache_and_one_folder(tmp_path: Path, count: int) -> None:
    """All end well, and what they leave is one complete run, the same as that of one alone."""
    scene_file(tmp_path, short_example(), "four_bar.yaml")
    arguments, _ = COMMANDS["run"]
    running = [started(tmp_path, arguments, tmp_path / "cache") for _ in range(count)]
    assert {process.wait(timeout=600) for process in running} == {0}
    check_complete(tmp_path)
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"newton_euler.npz", "pinocchio.npz", "summary.json", "junit.xml", "four_bar.rrd"}
    alone = newton_euler.simulate(load(str(tmp_path / "four_bar.yaml")))
    arrays = load_arrays(tmp_path / "out" / "newton_euler.npz")
    np.testing.assert_array_equal(arrays["position"], alone.position)
    for path in (tmp_path / "cache").iterdir():
        assert not path.name.startswith(".newton-euler-new-")
