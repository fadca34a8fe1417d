"""Native code: the same numbers as plain Python, and a cache that cannot do harm."""

from __future__ import annotations

import errno
import math
import os
import stat
import subprocess
import sys
import time
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
import pytest
from llvmlite.binding import FeatureMap
from mechanisms import pendulum
from test_expression import everything, traced

import newton_euler.codegen.cache
from newton_euler.codegen.cache import CACHE_VARIABLE, cache_key, read_cache, write_cache
from newton_euler.codegen.compile import CODE_LEVEL, NativeFunction, NativeModule, Traced
from newton_euler.codegen.expression import Graph
from newton_euler.codegen.native import Callback, NativeError, Record, Signature, Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.codegen.translate import text
from newton_euler.codegen.trigonometry import REGISTER_DOUBLES
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.run import load_code, native_method
from newton_euler.errors import OptionError


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache directory."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_native_code_computes_what_the_program_says(cache):
    program = traced(everything, 3)
    function = NativeFunction(lambda: Traced(program))
    rng = np.random.default_rng(0)
    for _ in range(20):
        x = rng.standard_normal(3)
        # a product and a sum may be rounded once instead of twice
        assert function(x) == pytest.approx(program.run(x), rel=1e-14, abs=1e-15)
    with pytest.raises(ValueError, match=r"needed: \(3,\)"):
        function(np.zeros(2))


def compiled(text):
    return NativeModule(
        text, lambda: (text, CODE_LEVEL), {"f": Signature({"x": "double"}, "double")}, optimize=True
    )


SOURCE = "define double @f(double %x) {\n  %y = fadd double %x, 1.0\n  ret double %y\n}"


def test_the_second_time_comes_from_the_cache(cache):
    assert not compiled(SOURCE).from_cache
    assert compiled(SOURCE).from_cache
    assert len(list(cache.iterdir())) == 1


@pytest.mark.parametrize("harm", [b"", b"short", os.urandom(5000)], ids=["empty", "short", "random"])
def test_a_corrupt_cache_is_compiled_over(cache, harm):
    compiled(SOURCE)
    (path,) = cache.iterdir()
    path.write_bytes(harm)
    assert not compiled(SOURCE).from_cache
    assert compiled(SOURCE).from_cache


def test_a_truncated_file_is_not_trusted(cache):
    compiled(SOURCE)
    (path,) = cache.iterdir()
    path.write_bytes(path.read_bytes()[:-7])
    assert not compiled(SOURCE).from_cache


def test_an_unwritable_cache_costs_nothing_else(cache, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("newton_euler.codegen.cache.tempfile.mkstemp", full)
    assert not compiled(SOURCE).from_cache
    assert not compiled(SOURCE).from_cache


def blocked(folder: Path) -> dict[str, str]:
    """Names of what cannot be a directory, by why."""
    (folder / "file").write_text("")
    os.mkfifo(folder / "pipe")
    (folder / "circle").symlink_to("circle")
    return {
        "Not a directory": str(folder / "file"),
        "Not a directory, a pipe": str(folder / "pipe"),
        "Not a directory, below a file": str(folder / "file" / "cache"),
        "Too many levels of symbolic links": str(folder / "circle"),
        "File name too long": "a" * 300,
        "File name too long, a path": str(folder / ("a/" * 3000)),
    }


def test_a_cache_that_cannot_be_one_is_refused(tmp_path, monkeypatch):
    for why, name in blocked(tmp_path).items():
        monkeypatch.setenv(CACHE_VARIABLE, name)
        with pytest.raises(OptionError, match=r"NEWTON_EULER_CACHE is .*; needed: a directory") as caught:
            compiled(SOURCE)
        assert str(caught.value).endswith(f"({why.partition(',')[0]})")
        assert len(str(caught.value)) < 300


def test_the_directory_is_made_for_its_user_alone(cache):
    before = os.umask(0)
    try:
        compiled(SOURCE)
    finally:
        os.umask(before)
    (entry,) = cache.iterdir()
    assert stat.S_IMODE(cache.stat().st_mode) == 0o700
    assert stat.S_IMODE(entry.stat().st_mode) == 0o600


@pytest.mark.parametrize("mode", [0o775, 0o777, 0o1777, 0o2770])
def test_a_directory_that_others_can_write_is_refused(cache, mode):
    compiled(SOURCE)
    cache.chmod(mode)
    with pytest.raises(OptionError, match="others can write it"):
        compiled(SOURCE)
    cache.chmod(0o755)
    assert compiled(SOURCE).from_cache


def test_a_directory_of_another_user_is_refused(cache, monkeypatch):
    compiled(SOURCE)
    as_of = os.stat(cache)
    theirs = os.stat_result((*as_of[:4], os.geteuid() + 1, *as_of[5:]))
    with monkeypatch.context() as patch:
        patch.setattr("newton_euler.codegen.cache.os.stat", lambda name: theirs)
        with pytest.raises(OptionError, match="it belongs to user") as caught:
            compiled(SOURCE)
    assert caught.value.value == str(cache)
    assert compiled(SOURCE).from_cache


def test_a_link_of_another_user_to_a_directory_of_ones_own_is_refused(cache, tmp_path, monkeypatch):
    compiled(SOURCE)
    link = tmp_path / "link"
    link.symlink_to(cache)
    monkeypatch.setenv(CACHE_VARIABLE, str(link))
    assert compiled(SOURCE).from_cache
    as_of = os.lstat(link)
    theirs = os.stat_result((*as_of[:4], os.geteuid() + 1, *as_of[5:]))
    with monkeypatch.context() as patch:
        patch.setattr("newton_euler.codegen.cache.os.lstat", lambda name: theirs)
        with pytest.raises(OptionError, match="it belongs to user"):
            compiled(SOURCE)


def test_a_default_directory_that_others_could_write_is_closed(tmp_path, monkeypatch):
    """Earlier ones were made as the umask of the user permits."""
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    compiled(SOURCE)
    (tmp_path / "newton_euler").chmod(0o775)
    assert compiled(SOURCE).from_cache
    assert stat.S_IMODE((tmp_path / "newton_euler").stat().st_mode) == 0o700


def replaced_by_link(path):
    path.rename(path.with_name("elsewhere"))
    path.symlink_to(path.with_name("elsewhere"))


def replaced_by_pipe(path):
    path.unlink()
    os.mkfifo(path)


@pytest.mark.parametrize(
    "harm",
    [lambda path: path.chmod(0o666), lambda path: path.chmod(0o620), replaced_by_link, replaced_by_pipe],
)
def test_an_entry_that_others_could_have_written_is_compiled_over(cache, harm):
    compiled(SOURCE)
    (path,) = cache.iterdir()
    harm(path)
    assert not compiled(SOURCE).from_cache
    assert stat.S_ISREG(path.lstat().st_mode)
    assert compiled(SOURCE).from_cache


def test_an_entry_of_another_user_is_compiled_over(cache, monkeypatch):
    compiled(SOURCE)
    fstat, own = os.fstat, os.geteuid()

    def theirs(handle):
        status = fstat(handle)
        return os.stat_result((*status[:4], own + 1, *status[5:]))

    with monkeypatch.context() as patch:
        patch.setattr("newton_euler.codegen.cache.os.fstat", theirs)
        assert not compiled(SOURCE).from_cache
    assert compiled(SOURCE).from_cache


def test_a_read_only_cache_is_read(cache):
    compiled(SOURCE)
    cache.chmod(stat.S_IRUSR | stat.S_IXUSR)
    try:
        assert compiled(SOURCE).from_cache
    finally:
        cache.chmod(stat.S_IRWXU)


def test_no_cache_if_the_user_wants_none(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, "")
    monkeypatch.chdir(tmp_path)
    assert not compiled(SOURCE).from_cache
    assert not list(tmp_path.iterdir())


def test_a_user_without_a_home_has_no_cache(tmp_path, monkeypatch):
    for variable in (CACHE_VARIABLE, "XDG_CACHE_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr("os.path.expanduser", lambda path: path)  # as it leaves "~" for such a user
    monkeypatch.chdir(tmp_path)
    assert not compiled(SOURCE).from_cache
    assert not list(tmp_path.iterdir())


def test_processes_that_compile_at_once_do_not_disturb_each_other(cache):
    code = "from newton_euler.codegen.compile import NativeModule\n"
    code += f"NativeModule({SOURCE!r}, lambda: ({SOURCE!r}, 1), {{}}, optimize=True)"
    environment = os.environ | {CACHE_VARIABLE: str(cache)}
    jobs = [subprocess.Popen([sys.executable, "-c", code], env=environment) for _ in range(3)]
    assert [job.wait() for job in jobs] == [0] * 3
    assert len(list(cache.iterdir())) == 1
    assert compiled(SOURCE).from_cache


def test_runs_that_are_killed_leave_the_cache_usable(cache):
    """Killed at random moments while they compile and write, again and again."""
    code = "from newton_euler.codegen.compile import NativeModule\nk = 0\nwhile True:\n    k += 1\n" + (
        f"    NativeModule({SOURCE!r} + '; %d' % (k % 7), lambda: ({SOURCE!r}, 1), {{}}, optimize=True)\n"
        "    import shutil, os\n"
        "    for name in os.listdir(os.environ['NEWTON_EULER_CACHE'])[:3]:\n"
        "        if not name.startswith('.'): os.unlink(os.environ['NEWTON_EULER_CACHE'] + '/' + name)\n"
    )
    environment = os.environ | {CACHE_VARIABLE: str(cache)}
    rng = np.random.default_rng(0)
    sources = [f"{SOURCE}; {k}" for k in range(7)]
    for _ in range(5):
        job = subprocess.Popen([sys.executable, "-c", code], env=environment)
        time.sleep(rng.uniform(0.15, 0.5))
        job.kill()
        job.wait()
        for source in sources:
            assert compiled(source).addresses["f"]
    assert all(compiled(source).from_cache for source in sources)


def written(cache: Path, number: int) -> str:
    """The key of a kilobyte in the cache that was used so many hours after 1970."""
    key = cache_key("entry", number)
    write_cache(key, bytes(1000))
    os.utime(cache / f"{key}.newton-euler", (3600.0 * number,) * 2)
    return key


def test_the_cache_keeps_what_was_used_last_below_its_limit(cache, monkeypatch):
    monkeypatch.setattr(newton_euler.codegen.cache, "MAX_CACHE_BYTES", 100_000)
    cache.mkdir()
    (cache / "notes.txt").write_bytes(bytes(200_000))  # somebody's own
    keys = []
    for number in range(1000):
        keys.append(written(cache, number))
        assert read_cache(keys[0]) is not None  # in use all the time
    found = {path.name for path in cache.iterdir()}
    assert "notes.txt" in found
    # as many as fit, three quarters of that after a count, and what comes before the next one
    assert 75_000 - 1032 < 1032 * (len(found) - 1) < 100_000 + 1032 * 100
    kept = [keys[0], *keys[2 - len(found) :]]
    assert found == {"notes.txt", *(f"{key}.newton-euler" for key in kept)}


def test_a_directory_that_somebody_else_uses_too(cache, tmp_path, monkeypatch):
    """Old files with names like the cache's own, and links to large ones, which count for nothing."""
    monkeypatch.setattr(newton_euler.codegen.cache, "_WRITES_PER_CHECK", 1)
    monkeypatch.setattr(newton_euler.codegen.cache, "MAX_CACHE_BYTES", 10_000)
    cache.mkdir()
    large = tmp_path / "large"
    large.write_bytes(bytes(20_000))
    key = cache_key("theirs")
    theirs = {".new-notes.txt", key, f"{key}.newton-euler.txt", f"copy-{key}.newton-euler"}
    for name in theirs:
        (cache / name).write_bytes(bytes(20_000))
        os.utime(cache / name, (0.0, 0.0))
    links = {f"{cache_key('link')}.newton-euler", ".newton-euler-new-link"}
    for name in links:
        (cache / name).symlink_to(large)
        os.utime(cache / name, (0.0, 0.0), follow_symlinks=False)
    own = {f"{written(cache, number)}.newton-euler" for number in range(5)}  # half of the limit
    assert {path.name for path in cache.iterdir()} == theirs | links | own


def test_reading_counts_no_files(cache, monkeypatch):
    key = written(cache, 0)
    monkeypatch.setattr(os, "scandir", None)
    assert read_cache(key) == bytes(1000)


def test_what_cannot_be_marked_as_used_is_read(cache, monkeypatch):
    key = written(cache, 0)

    def read_only(*arguments: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(os, "utime", read_only)
    assert read_cache(key) == bytes(1000)


def test_what_a_killed_run_left_is_removed_in_time(cache, monkeypatch):
    monkeypatch.setattr(newton_euler.codegen.cache, "_WRITES_PER_CHECK", 1)
    compiled(SOURCE)
    old, new = cache / ".newton-euler-new-old", cache / ".newton-euler-new-new"
    for path in (old, new):
        path.write_bytes(b"half")
    os.utime(old, (time.time() - 7200.0,) * 2)
    compiled(SOURCE + "; other")
    assert not old.exists()
    assert new.exists()  # its run may still be writing


def test_another_integrator_is_compiled_before_its_run():
    native_method.cache_clear()
    code = CompiledEquations(pendulum())
    load_code(code, "DOP853")
    assert native_method.cache_info().currsize == 1
    load_code(code, "RK4")  # which needs nothing else of this scene
    assert native_method.cache_info().currsize == 2


def test_code_of_another_processor_is_another_and_says_the_same(cache, monkeypatch, tracker, tracker_states):
    """The plainest of its kind, which rounds products and sums apart where others fuse them."""
    codes = [CompiledEquations(tracker)]
    codes[0].function("derivative")
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_name", lambda: "generic")
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", FeatureMap)
    codes.append(CompiledEquations(tracker))
    assert not codes[1].function("derivative").module.from_cache
    for state in tracker_states[:5]:
        x = codes[0].packed(*codes[0].system.coordinates(state))
        here, there = (code.function("derivative")(x) for code in codes)
        # condition numbers of 1e2, on round-off of 1e-16
        assert np.abs(here - there).max() < 1e-13 * np.abs(here).max()


def test_sine_and_cosine_are_the_librarys():
    graph = Graph()
    (x,) = graph.variables(1)
    function = NativeFunction(lambda: Traced(graph.prune([x.sin(), x.cos()])))
    rng = np.random.default_rng(0)
    angles = np.concatenate(
        [
            rng.uniform(-10.0, 10.0, 2000),
            rng.uniform(-1e5, 1e5, 2000),
            0.5 * np.pi * np.arange(-200, 201),
            10.0 ** rng.uniform(-300.0, 5.0, 500),
            rng.uniform(1e5, 1e15, 100),
            [0.0],
        ]
    )
    for angle in angles:
        for found, exact in zip(function(np.array([angle])), (math.sin(angle), math.cos(angle)), strict=True):
            assert abs(found - exact) <= 2.0 * math.ulp(exact)  # half a unit is the library's own
    assert np.all(np.isnan(function(np.array([np.inf]))))


TABLE = (1.0, 2.5, -3.0)


class Place(IntEnum):
    FIRST = 1
    LAST = 4


@dataclass(frozen=True, eq=False)
class Line(Record):
    n: int
    slope: float
    x: Vector
    f: Callback


@native
def axpy(line: Line, a: float, x: Vector, y: Vector) -> None:
    for k in range(line.n - 1):
        y[k] += a * x[k] + line.slope * line.x[k]


@native
def mixture(line: Line, x: Vector, y: Vector, f: Callback) -> float:
    """Every construct once."""
    n = line.n
    total = 0.0
    k = 0
    axpy(line, 2, x[1:], y[1:])
    line.f(line.x[1:], y)
    f(x, y)
    while k < n:
        if y[k] > 3.0 and x[k] != 2.0:
            k += 1
            continue
        if not y[k] < 100.0 or k == 50 or y[Place.LAST] > 1e3:
            break
        total += max(abs(y[k]), 1) * TABLE[k % 3] if k >= 1 else 0.5
        k += 1
    for j in range(Place.FIRST, 3):
        total -= float(j // 2) / 8 + x[j] * int(2.9)
    return total**2 if total > 0.0 else -total


def test_native_functions_mean_what_python_means(cache):
    program = traced(lambda *x: [x[2] + 1.0, *x[:4]], 5)
    native_f = NativeFunction(lambda: Traced(program))
    module = NativeFunctions([mixture])
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, y = 2.0 * rng.standard_normal((2, 5))
        copy, longer = y.copy(), rng.standard_normal(6)

        def plain_f(a, b):
            b[:5] = program.run(a[:5])

        expected = mixture(Line(5, 0.3, longer, plain_f), x, y, plain_f)
        line = Line(5, 0.3, longer, native_f)
        assert module(mixture, line, x, copy, native_f) == pytest.approx(expected, rel=1e-14, abs=1e-14)
        assert copy == pytest.approx(y, rel=1e-14)


def test_several_at_once_are_what_each_is_alone(cache):
    program = traced(everything, 3)
    many = NativeFunction(lambda: Traced(program, many=True))
    assert many.lanes == REGISTER_DOUBLES > 1
    rng = np.random.default_rng(0)
    near = rng.standard_normal((3, REGISTER_DOUBLES))
    far = near.copy()
    far[:, 1] *= 1e7  # beyond the polynomials of sine and cosine, in one lane alone
    for given in (near, far):
        alone = np.stack([program.run(lane) for lane in given.T], axis=1)
        # a product and a sum may be rounded once instead of twice
        assert many(given) == pytest.approx(alone, rel=1e-14, abs=1e-15)
    assert np.array_equal(many(near[:, 0]), many(near)[:, 0])
    with pytest.raises(ValueError, match=r"shape \(3, 2\); needed: \(3,\) or \(3, 4\)"):
        many(near[:, :2])


@native
def with_a_list(x: Vector) -> float:
    return sum([x[0], 1.0])


@native
def with_a_chain(x: Vector) -> float:
    if 0.0 < x[0] < 1.0:
        return 1.0
    return 0.0


@native
def with_no_field(line: Line) -> float:
    return line.curvature


@native
def with_no_member(x: Vector) -> float:
    return x[Place.MIDDLE]


@native
def with_a_new_record(line: Line, x: Vector) -> None:
    line = x  # noqa: F841


@native
def with_a_changed_record(line: Line) -> None:
    line.slope = 2.0


@pytest.mark.parametrize(
    "function",
    [with_a_list, with_a_chain, with_no_field, with_no_member, with_a_new_record, with_a_changed_record],
)
def test_other_python_is_refused_with_its_line(function):
    line = function.__code__.co_firstlineno + 2  # after the decorator and the def
    with pytest.raises(NativeError, match=f"{function.__name__}, line {line}"):
        text([function])
