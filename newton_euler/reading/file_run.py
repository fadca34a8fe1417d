"""Interface for simulating a model file with the file's own engine, time step, integrator and solver.

The run of the file is compared with the *reference*: an accurate solution of the scene that was imported from
the file. The comparison measures the error of the run and its causes, see `crosscheck.own_run`. A package for
a file format derives from `FileSimulation`. The run begins at the initial state of the imported scene and has
the scene's control inputs.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Generic, Protocol, TypeVar

from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.small_motions import ModelChange, SmallMotions
from newton_euler.scalars import Array


class Settings(Protocol):
    """Settings that all engines have: the time step, s, and the name of the integrator."""

    @property
    def timestep(self) -> float: ...
    @property
    def integrator(self) -> str: ...


SettingsT = TypeVar("SettingsT", bound=Settings)
"""Type of an engine's settings (time step, integrator, solver); one class for each engine."""


class CauseName(StrEnum):
    """Property of a file's settings that can cause an error of a run."""

    TIME_STEP = "time step"
    INTEGRATOR = "integrator"
    SOFT_CONSTRAINTS = "soft constraints"
    SOLVER_ITERATIONS = "solver iterations"
    SLEEP = "sleep"
    """Mechanisms at rest are not simulated."""
    EXPLICIT_DAMPING = "explicit damping"
    PROXIMAL_ITERATIONS = "proximal iterations"
    BAUMGARTE = "Baumgarte stabilization"


OF_UNSTABLE_MODES = (CauseName.TIME_STEP, CauseName.INTEGRATOR)
"""Causes of errors that may be due to an unstable mode: an oscillation of the model that is too fast for the
time step."""


CONTACT_OF = "contact of "
"""Beginning of `Event.element` of a contact, before the names of both bodies."""


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
class LoopErrors:
    """Violations of the k loop constraints of a file at the n outputs of a run.

    Attributes:
        names: the constraints, such as "equality 'loop'".
        openings: (n, k) distances, m; 0 for constraints of angles.
        angles: (n, k) angles, rad; 0 for constraints of lengths.
        have_lengths: (k,) True for constraints of lengths, or of lengths and angles, such as welds.
        have_angles: (k,) True for constraints of angles, or of lengths and angles.
    """

    names: tuple[str, ...]
    openings: Array
    angles: Array
    have_lengths: Array
    have_angles: Array


@dataclass(frozen=True, eq=False)
class FileRun:
    """Run of a model file by its own engine.

    Attributes:
        trajectory: motion of the scene's bodies up to the time at which the run ended.
        loop_errors: violations of the loop constraints at the output times.
        events: first action of each element that the reference does not simulate, in the order of time.
        stopped: reason why the run ended early, such as MuJoCo's warning; "" for a complete run.
        states: state of the engine at each output time, in the engine's own form, for
            `FileSimulation.small_motions`.
    """

    trajectory: Trajectory
    loop_errors: LoopErrors
    events: tuple[Event, ...] = ()
    stopped: str = ""
    states: Sequence[Any] = ()


@dataclass(frozen=True)
class Cause(Generic[SettingsT]):
    """One property of a file's settings whose contribution to the run's error can be measured.

    The contribution is the difference of two runs: with settings `against`, which have the error, and with
    settings `without`, which do not have it.

    Attributes:
        name: the property.
        without: the settings `against`, changed so that the error of the property disappears.
        against: settings with the error of the property; None for the settings of the file.
        is_choice: True if `without` is another choice, such as another integrator, which may also be worse;
            False if it is more exact, such as a smaller time step.
    """

    name: CauseName
    without: SettingsT
    against: SettingsT | None = None
    is_choice: bool = False


@dataclass(frozen=True)
class LoopNeed:
    """Elements that the judged run has, and that a user's own program lacks unless the user adds them.

    Attributes:
        elements: names, such as "rotor of joint 'knee'".
        remedy: what drops the elements, and what the user does about it.
    """

    elements: tuple[str, ...]
    remedy: str


def evaluations_per_step(integrator: str) -> int:
    """Return the number of evaluations of the equations of motion per step: four stages of RK4, else one."""
    return 4 if integrator == "RK4" else 1


class FileSimulation(ABC, Generic[SettingsT]):
    """A model file with its own settings, at the start of an imported scene and with the scene's inputs.

    Attributes:
        engine: name and version of the engine, such as "MuJoCo 4.0".
        scene: the imported scene.
        settings: settings of the file.
        are_assumed: True if the settings are usual ones, since the file has none and the user gives none.
        approximated: dry friction and limits of the file that the scene has as forces, such as "limits of
            joint 'knee'". They act in all runs of the file.
        stiffer_limits: change of the file that makes its limits stiffer, as text; "" if no limits are among
            `approximated`, or if the limits are as stiff as the time step permits.
        needs: elements of the file that the user's own program lacks although these runs have them, if the
            user writes the time loop.
        settings_place: where the user pastes `fragment`.
        has_all_elements: True if runs have all elements of the file, also those that the scene lacks; False
            if runs never have these, such as those of a loop without limits and dry friction.
        max_evaluations: largest number of evaluations of the equations of motion in a run, with the file's
            time step or a smaller one; lower for an engine whose time loop runs in Python.
    """

    are_assumed: bool = False
    approximated: Sequence[str] = ()
    stiffer_limits: str = ""
    needs: Sequence[LoopNeed] = ()
    settings_place: str = "the model"
    has_all_elements: bool = True
    max_evaluations: float = math.inf
    engine: str
    scene: Scene
    settings: SettingsT

    def evaluations(self, settings: SettingsT) -> float:
        """Return the number of evaluations of the equations of motion per second of simulated time."""
        return evaluations_per_step(settings.integrator) / settings.timestep

    @abstractmethod
    def words(self) -> str:
        """Describe the settings of the file in one short text, such as "implicitfast, 2 ms, solref 0.02"."""

    @abstractmethod
    def changes(self, settings: SettingsT) -> Mapping[str, str]:
        """Return the settings that differ from those of the file: their values as text, by name."""

    @abstractmethod
    def fragment(self, settings: SettingsT) -> str:
        """Return the lines of the file format, such as an XML element, that give the file these settings."""

    @abstractmethod
    def run(self, settings: SettingsT, steps: int, every: int, reduced: bool = False) -> FileRun:
        """Simulate the file.

        Args:
            settings: settings of the run.
            steps: number of time steps.
            every: number of steps from one output to the next.
            reduced: True to switch off all elements that the imported scene does not have.
        """

    @abstractmethod
    def run_inputs(self, reduced: bool) -> Mapping[str, Any]:
        """Return start and controls, as numbers for JSON, so that the engine alone can repeat the run.

        Args:
            reduced: whether elements that the imported scene does not have are switched off.
        """

    @abstractmethod
    def causes(self) -> Iterator[Cause[SettingsT]]:
        """Yield the properties of the file's settings that can cause an error."""

    @abstractmethod
    def alternatives(self, divisor: int) -> Iterator[SettingsT]:
        """Yield other settings that may reduce the error, such as another integrator.

        Args:
            divisor: number by which the file's time step is divided.
        """

    @abstractmethod
    def at_divisor(self, settings: SettingsT, divisor: float) -> SettingsT:
        """Return the same settings with the file's time step divided by `divisor`."""

    def small_motions(self, run: FileRun, outputs: Sequence[int]) -> SmallMotions[SettingsT] | None:
        """Return linearizations about states of a run, which show whether the time step is stable.

        The result is None for an engine without this analysis.

        Args:
            run: run of the file without the elements that the scene does not have.
            outputs: indices of the output times whose states are taken; if empty, the state at the start.
        """

    def changed(self, change: ModelChange) -> FileSimulation[SettingsT]:
        """Return the simulation of the file after a change of the engine's model, such as more armature.

        Only an engine with `small_motions` has this method.

        Args:
            change: function that changes the engine's model in place.
        """
        raise NotImplementedError(f"{self.engine}: changes of the model")
