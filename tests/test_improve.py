"""Code made in a hurry and what takes its place: the same numbers to the last bit, whenever that happens."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import replace
from weakref import WeakValueDictionary

import numpy as np
import pytest

import newton_euler.steppers.run
from crosscheck.scenes import SCENES, load
from newton_euler import compile_scene
from newton_euler.cache import CACHE_VARIABLE
from newton_euler.compile import NativeFunction
from newton_euler.compiled import FORMULATIONS, Code
from newton_euler.improve import MOST_WAITING, _Improver
from newton_euler.steppers.outputs import loops
from newton_euler.steppers.run import MARCHES, stepper


@pytest.fixture
def no_cache(monkeypatch):
    """Everything is compiled, and by nobody before."""
    monkeypatch.setenv(CACHE_VARIABLE, "")
    monkeypatch.setattr("newton_euler.compile._HURRIED", WeakValueDictionary())
    stepper.cache_clear(), loops.cache_clear()
    yield
    stepper.cache_clear(), loops.cache_clear()


def values(function: NativeFunction, code: Code) -> bytes:
    """Of states near the start, consistent or not."""
    rng = np.random.default_rng(0)
    states = code.start + 0.1 * rng.standard_normal((40, code.inputs))
    return b"".join(function(state).tobytes() for state in states)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("scene", SCENES)
def test_better_code_rounds_alike(no_cache, scene, formulation):
    code = Code(load(scene), formulation)
    for name in ("derivative", "output"):
        function = NativeFunction(code.program(name), name == "output", hurry=True)
        assert function.module.quick
        before = values(function, code)
        function.module.improve()
        assert not function.module.quick
        assert values(function, code) == before


def test_better_loops_round_alike(no_cache, monkeypatch):
    monkeypatch.setattr("newton_euler.compile.LARGE", 0)
    code = Code(load("tracker"))
    function = NativeFunction(code.program("jacobian"), hurry=True)
    before = values(function, code)
    function.module.improve()
    assert values(function, code) == before


@pytest.mark.parametrize("integrator", MARCHES)
def test_better_marches_round_alike(no_cache, monkeypatch, integrator):
    waiting = []
    monkeypatch.setattr(newton_euler.steppers.run, "improve", waiting.extend)
    scene = replace(load("tracker"), duration=0.5)
    code = compile_scene(scene)
    settings = {"step": 0.005} if integrator in ("RK4", "Euler") else {"rtol": 1e-6}
    before = code.simulate(integrator, **settings)
    assert all(module.quick for module in waiting)
    for module in waiting:
        module.improve()
    after = code.simulate(integrator, **settings)
    assert after.position.tobytes() == before.position.tobytes()
    assert after.quaternion.tobytes() == before.quaternion.tobytes()


def test_who_asks_next_shares_what_is_there(no_cache):
    program = Code(load("pendulum")).program("derivative")
    first, second = (NativeFunction(program, hurry=True) for _ in range(2))
    assert second.module is first.module
    assert NativeFunction(program).module is not first.module  # good code was asked for


def test_code_is_exchanged_while_it_runs(no_cache):
    code = Code(load("tracker"))
    function = NativeFunction(code.program("derivative"), hurry=True)
    expected, found, done = function(code.start).tobytes(), [], threading.Event()

    def call() -> None:
        while not done.is_set():
            found.append(function(code.start).tobytes())

    threads = [threading.Thread(target=call) for _ in range(3)]
    for thread in threads:
        thread.start()
    function.module.improve()
    done.set()
    for thread in threads:
        thread.join(60.0)
    assert len(found) > 3
    assert set(found) == {expected}


RUN = """
from crosscheck.scenes import load
from newton_euler import compile_scene
from newton_euler.compiled import Code
code = compile_scene(load("pendulum"))
"""


def run(text: str, cache: object) -> str:
    environment = os.environ | {CACHE_VARIABLE: str(cache)}
    command = [sys.executable, "-c", RUN + text]
    return subprocess.run(
        command, env=environment, check=True, capture_output=True, text=True, timeout=120
    ).stdout


def test_a_process_leaves_the_next_one_the_better_code(tmp_path):
    assert run("print(code.from_cache)", tmp_path) == "False\n"
    assert run("print(code.from_cache)", tmp_path) == "True\n"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="of Unix")
def test_a_child_may_compile_whatever_its_parent_was_at(tmp_path):
    """Forked at once, while the parent has begun to improve its code."""
    text = """
import os
child = os.fork()
if child == 0:
    Code(load("free_top")).function("derivative")
    os._exit(7)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    assert run(text, tmp_path) == "7\n"


class Module:
    """Stands for one that cannot be improved, or that tells when it is."""

    quick = True

    def __init__(self, fails: bool) -> None:
        self.fails, self.improved = fails, False

    def improve(self) -> None:
        if self.fails:
            raise RuntimeError
        self.improved = True


def test_what_cannot_be_improved_stays_as_it_is():
    improver, modules = _Improver(), [Module(fails=True), Module(fails=False)]
    improver.add(modules)
    improver.finish()
    assert [module.improved for module in modules] == [False, True]
    assert improver._thread is None


def test_what_is_in_a_hurry_goes_first():
    improver, module = _Improver(), Module(fails=False)
    with improver.give_way():
        improver.add([module])
        improver._thread.join(0.2)
        assert not module.improved
    improver.finish()
    assert module.improved


def test_a_sweep_leaves_no_long_wait_behind():
    """The newest modules wait; without the others a run goes on with what it has."""
    improver, modules = _Improver(), [Module(fails=False) for _ in range(MOST_WAITING + 5)]
    with improver.give_way():
        improver.add(modules[:5])
        improver.add(modules[5:])
        improver.add(modules[5:])  # once is enough
    improver.finish()
    assert [module.improved for module in modules] == [False] * 5 + [True] * MOST_WAITING
