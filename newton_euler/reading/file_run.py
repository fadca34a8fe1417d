"""A model file as its own engine simulates it, with the time step, integrator and solver of the file.

The file's run is compared with a reference solution of the imported scene, see `crosscheck.own_run`. A
package for a file format derives from `FileSimulation`; start and inputs are those of the imported scene.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

SettingsT = TypeVar("SettingsT")


@dataclass(frozen=True)
class Event:
    """First action of an element of a file that the reference does not simulate.

    Attributes:
        time: s.
        element: the element, such as "contact of 'foot' and 'floor'".
    """

    time: float
    element: str


@dataclass(frozen=True, eq=False)
class FileRun:
    """Run of a model file by its own engine.

    Attributes:
        trajectory: motion of the scene's bodies, as far as the run came.
        opening: (n,) largest error of the file's loop constraints at the output times, m or rad.
        events: first action of each element that the reference does not simulate, in the order of time.
        stopped: reason why the run ended early, such as MuJoCo's warning; "" for a complete run.
    """

    trajectory: Trajectory
    opening: Any
    events: tuple[Event, ...] = ()
    stopped: str = ""


@dataclass(frozen=True)
class Cause(Generic[SettingsT]):
    """One property of a file's settings whose share of the error can be measured.

    Attributes:
        name: the property, such as "time step".
        without: settings that remove the error of the property and keep all else.
        against: settings to compare with; None means the settings of the file.
    """

    name: str
    without: SettingsT
    against: SettingsT | None = None


class FileSimulation(ABC, Generic[SettingsT]):
    """A model file with its own settings, at the start of an imported scene and with the scene's inputs.

    Attributes:
        engine: name and version of the engine, such as "MuJoCo 4.0".
        scene: the imported scene.
        settings: settings of the file.
    """

    engine: str
    scene: Scene
    settings: SettingsT

    @abstractmethod
    def timestep(self, settings: SettingsT) -> float:
        """Return the time step of settings, s."""

    @abstractmethod
    def evaluations(self, settings: SettingsT) -> float:
        """Return the number of evaluations of the equations of motion per second of motion."""

    @abstractmethod
    def words(self) -> str:
        """Describe the settings of the file in a few words, such as "implicitfast, 2 ms, solref 0.02"."""

    @abstractmethod
    def changes(self, settings: SettingsT) -> Mapping[str, str]:
        """Map the names of settings that differ from those of the file to their values in words."""

    @abstractmethod
    def fragment(self, settings: SettingsT) -> str:
        """Return the text that gives the file these settings."""

    @abstractmethod
    def run(self, settings: SettingsT, steps: int, every: int, reduced: bool = False) -> FileRun:
        """Simulate the file.

        Args:
            settings: settings of the run.
            steps: number of time steps.
            every: number of steps from one output to the next.
            reduced: whether to switch off all elements that the imported scene does not have.
        """

    @abstractmethod
    def causes(self) -> Iterator[Cause[SettingsT]]:
        """Yield the properties of the file's settings that can cause an error."""

    @abstractmethod
    def alternatives(self, divisor: int) -> Iterator[SettingsT]:
        """Yield all other kinds of settings with the file's time step divided by `divisor`."""

    @abstractmethod
    def at_divisor(self, settings: SettingsT, divisor: int) -> SettingsT:
        """Return settings of the same kind with the file's time step divided by `divisor`."""

    @property
    def options(self) -> Mapping[str, Any]:
        """Settings of the file by name, for JSON."""
        return vars(self.settings)
