"""Candidate: an engine that is checked, with its runs of the scenes of the contract, and errors of its code.

A point gets a candidate and calls the engine by its methods. The candidate remembers the scene of the last
call, so that the report of an error can name the scene and the line of the engine's code.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from traceback import walk_tb
from typing import Any, ParamSpec, TypeVar

from crosscheck.engines.engine import Engine, Settings
from crosscheck.engines.limits import CannotExpressError, Limit
from crosscheck.studies.conformance.scenes import ONE_BODY
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import limited
from newton_euler.equations.system import System
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

TIME_ADVICE = "the scenes are motions of less than half a second"
"""Advice in the error message of a scene that takes too long."""

P = ParamSpec("P")
R = TypeVar("R")


class NotOfferedError(CrosscheckError):
    """A point about a part of the contract that engines may leave out, such as equations of motion."""


class ContractError(CrosscheckError):
    """A result of an engine that is not of the class that the contract asks for."""


class Candidate:
    """An engine that is checked.

    Attributes:
        engine: the engine.
        scene: name of the scene of the last call; "" before the first one.
    """

    def __init__(self, engine: Engine, progress: Callable[[str], None] = lambda message: None) -> None:
        """Prepare to check an engine; `progress` shows a message to the user."""
        self.engine, self.scene = engine, ""
        self._progress = progress
        self._called: Callable[..., Any] = engine.simulate
        self._runs: dict[str, Trajectory | Exception] = {}

    def run(self, scene: Scene) -> Trajectory:
        """Return the engine's run of a scene with its own settings; the engine simulates a scene once.

        Raises:
            Exception: the error of the engine.
        """
        if scene.name not in self._runs:
            try:
                self._runs[scene.name] = self.simulate(scene)
            except Exception as error:
                self._runs[scene.name] = error
        self.scene, found = scene.name, self._runs[scene.name]
        if isinstance(found, Exception):
            raise found
        return found

    def first_run(self) -> tuple[Scene, Trajectory]:
        """Return the first scene of `ONE_BODY` that the engine can express, and its run.

        Raises:
            CannotExpressError: if the engine can express none of these scenes; the error is that of the first
                one.
            Exception: another error of the engine.
        """
        refusals = []
        for scene in (construct() for construct in ONE_BODY):
            try:
                return scene, self.run(scene)
            except CannotExpressError as error:
                refusals.append(error)
        raise refusals[0]

    def simulate(self, scene: Scene, settings: Settings | None = None) -> Trajectory:
        """Simulate a scene, with settings unless they are None."""
        arguments = (scene,) if settings is None else (scene, settings)
        return self._checked(self._call(scene, self.engine.simulate, *arguments), scene)

    def refined(self, scene: Scene, in_full: bool = False) -> Trajectory:
        """Simulate a scene more accurately; `in_full` with all outputs."""
        function = (self.engine.refined_in_full if in_full else None) or self.engine.refined
        return self._checked(self._call(scene, function, scene), scene)

    def systems(self, scene: Scene) -> Sequence[System]:
        """Return the engine's equations of motion of a scene."""
        return self._call(scene, self.engine.systems, scene)

    def limits(self, scene: Scene) -> Sequence[Limit]:
        """List what the engine cannot express of a scene."""
        return self._call(scene, self.engine.limits, scene)

    def place_of(self, error: BaseException) -> str:
        """Return file and line of the engine's code where an error was raised.

        If no line of the engine is in the traceback, as for a result of a wrong class, the place is that of
        the function that was called last. The result is "" for a function that is not written in Python.
        """
        package = _package_of(self.engine.simulate)
        lines = [
            f"{_shown(frame.f_code.co_filename)}:{line}"
            for frame, line in walk_tb(error.__traceback__)
            if f"{frame.f_globals.get('__name__')}.".startswith(f"{package}.")
        ]
        return lines[-1] if lines else _definition_of(self._called)

    @contextmanager
    def limited(self, scene: Scene) -> Iterator[None]:
        """Interrupt code of the engine after the limit of processor time, and remember the scene.

        Raises:
            TooLongError: if the limit is exceeded.
            ContractError: if the code exits.
        """
        self.scene = scene.name
        try:
            with limited(f"{self.engine.name}: scene {scene.name}", TIME_ADVICE, self._progress):
                yield
        except SystemExit as error:
            raise ContractError(f"it exits with {error.code}; needed: a run or an error") from error

    def _call(self, scene: Scene, function: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
        """Call a function of the engine within the limit of time, and remember it and the scene."""
        self._called = function
        with self.limited(scene):
            return function(*args, **kwargs)

    def _checked(self, found: object, scene: Scene) -> Trajectory:
        """Return a result that is a `Trajectory`; raise `ContractError` otherwise."""
        if isinstance(found, Trajectory):
            return found
        raise ContractError(f"the result is {found!r:.100}; needed: a Trajectory of scene {scene.name!r}")


def _unwrapped(function: Callable[..., Any]) -> Any:
    """Return the function below decorators and `functools.partial`."""
    while isinstance(function, partial):
        function = function.func
    return inspect.unwrap(function)


def _package_of(function: Callable[..., Any]) -> str:
    """Return the package of an engine that has a function: the first name of its module; of engines in
    crosscheck the first three."""
    names = str(_unwrapped(function).__module__).split(".")
    return ".".join(names[:3] if names[0] == __name__.split(".")[0] else names[:1])


def _definition_of(function: Callable[..., Any]) -> str:
    """Return file and line of the definition of a function; "" if it is not written in Python."""
    code = getattr(_unwrapped(function), "__code__", None)
    return "" if code is None else f"{_shown(code.co_filename)}:{code.co_firstlineno}"


def _shown(path: str) -> str:
    """Return the path of a file, relative to the working folder if the file is below it."""
    folder = Path.cwd()
    return str(Path(path).relative_to(folder)) if Path(path).is_relative_to(folder) else path
