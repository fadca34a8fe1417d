"""Fixtures shared by the tests: scenes, and runs that several tests look at."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import one_thread  # noqa: F401  # before NumPy
import pytest
from command_line import EXAMPLE, short_example
from compiler import Compiler
from hostile_process import Server
from slow_variants import slow_variants

import mjcf.reading.source
import newton_euler
from crosscheck.cli import shared
from crosscheck.engines import registry
from crosscheck.engines.engine import Engine
from crosscheck.library import load
from newton_euler.errors import MissingPackageError
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.excitation import random_states

# shells have what they start in the background ignore interrupts, which some tests send
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# lines of output would wrap there; GNU readline, which pytest loads, sets it without Python's knowledge
os.environ.pop("COLUMNS", None)
os.unsetenv("COLUMNS")

# in a workflow of GitHub, commands would print workflow commands below their output
os.environ.pop("GITHUB_ACTIONS", None)


EXTRAS = {
    "sweeps": ("sweep", ("distributed", "SALib", "xarray", "zarr")),
    "solar": ("sun", ("pandas", "pvlib")),
}
"""Folders of tests that need an extra: its name, and the packages without which they are skipped."""


class SkippedModule(pytest.Module):
    """A module of tests whose extra is not installed."""

    extra = ""

    def collect(self) -> list[pytest.Item]:
        pytest.skip(f"the extra {self.extra!r} is not installed", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    """Skip tests of an extra in a base environment."""
    extra, packages = EXTRAS.get(module_path.parent.name, ("", ()))
    if all(find_spec(package) for package in packages):
        return None
    module = SkippedModule.from_parent(parent, path=module_path)
    module.extra = extra
    return module


@pytest.hookimpl(tryfirst=True)  # before pytest selects by marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow variants of tests whose other variants are fast."""
    names = slow_variants()
    for item in items:
        if item.nodeid in names:
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[None]:
    """Skip a test that meets an optional package that is not installed."""
    try:
        return (yield)
    except MissingPackageError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session", autouse=True)
def compiler() -> Iterator[None]:
    """MuJoCo's compiler without its imports for each file."""
    forks = Compiler()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mjcf.reading.source, "subprocess", forks)
        yield
    forks.close()


@pytest.fixture(scope="session", autouse=True)
def stages() -> Iterator[None]:
    """Standard error without the stages that take long on a busy machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shared, "PROGRESS_DELAY_S", 600.0)
        yield


@pytest.fixture(scope="session")
def server() -> Iterator[Server]:
    """A process that runs command lines in processes of their own."""
    server = Server()
    yield server
    server.close()


@pytest.fixture(scope="session")
def tracker() -> Scene:
    """The paper's simulation."""
    return load("tracker")


@pytest.fixture(scope="session")
def tracker_states(tracker: Scene) -> list[State]:
    """200 random consistent states of the tracker."""
    return random_states(tracker, 200, seed=1)


@pytest.fixture(scope="session")
def tracker_run(tracker: Scene) -> Callable[..., Trajectory]:
    """Runs of the tracker by newton_euler, each set of options run once."""

    @lru_cache
    def run(**options: object) -> Trajectory:
        return newton_euler.simulate(tracker, **options)  # type: ignore[arg-type]

    return run


@pytest.fixture(scope="session")
def locking() -> Scene:
    """A linkage whose crank is driven at 1e5 rad/s, until it locks after half a turn."""
    paper = load(str(EXAMPLE))
    motion = PrescribedMotion("motor", Polynomial((0.0, 1e5)))
    changed = {"duration": 0.01, "output_period": 0.001, "control": (), "motions": (motion,)}
    return replace(paper, initial_state=None, **changed)


@pytest.fixture
def with_engines(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """A function that registers engines, as other packages do, without optional ones of this project."""

    def register(*engines: Engine) -> None:
        points = [
            SimpleNamespace(
                name=engine.name, value=f"tests:{engine.name}", dist=None, load=lambda engine=engine: engine
            )
            for engine in engines
        ]
        monkeypatch.setattr(registry, "entry_points", lambda group: points)
        monkeypatch.setattr(registry, "OPTIONAL", {})

    return register


@pytest.fixture
def good() -> dict[str, Any]:
    """The content of a scene file with nothing wrong."""
    return short_example()
