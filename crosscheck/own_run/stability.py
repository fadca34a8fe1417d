"""Find the mode of a model that is too fast for the time step of its run, and the elements that cause it.

Elements are parts of the model that exert forces, such as springs, dampers, actuators and constraints. The
run of a model file is linearized at some states, see `newton_euler.reading.small_motions`. A time step is
unstable if it multiplies a small motion by far more than the exact motion does. The stability limit is the
largest stable time step, found by bisection with the engine's own steps. The elements at fault are those
whose removal makes the file's time step stable.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.own_run.errors import RunError
from newton_euler.reading.file_run import FileRun, FileSimulation
from newton_euler.reading.small_motions import ForceElement, MovingBody, SmallMotions
from newton_euler.scalars import Array

MAX_GROWTH = 10.0
"""Largest factor by which time steps may multiply a small motion during a run, beyond the exact growth."""

EXACT_GROWTH_FACTOR = 2.0
"""Multiple of the exact growth, 1/s, that is not attributed to the time step. In a motion that is unstable
itself, such as that of an inverted pendulum, the linearized states show the exact growth only roughly."""

MIN_STEP_GROWTH = 1e-4
"""Logarithm of the growth per step below which round-off may be the cause. A double eigenvalue 1, such as
that of a free motion, is known only to the square root of the round-off of finite differences."""

MAX_STEP_DOUBLINGS, MAX_STEP_HALVINGS = 12, 24
"""Largest numbers of doublings and halvings of a time step in the search for the stability limit. They also
limit the powers of two by which a model is changed."""

LIMIT_TOL = 0.01
"""Relative error of the stability limit."""

MIN_CAUSE_SHARE = 0.25
"""Share in a stable mode's change per step, above which an element counts as the cause of the mode. The share
of a spring in an oscillation is one half: velocities change by forces, and positions by velocities."""

ALIKE = 0.9
"""Smallest cosine between two shapes, relative to the most similar ones, that count as the same."""


@dataclass(frozen=True)
class Stability:
    """Stability limit of the time step of a run, and the mode that sets the limit.

    Attributes:
        timestep: time step of the file, s.
        limit: largest stable time step, s; 0 if none was found, infinite if all that were tried are stable.
        time: time of the linearized state, s.
        rate: magnitude of the mode's eigenvalue, 1/s. The mode is the one that time steps multiply most, or
            the fastest one if the time step is stable.
        growth: factor by which one time step multiplies the mode.
        elements: elements at fault, the most important one first; if the time step is stable, the one element
            that causes the fastest mode, or none if no element has a large share in it.
        limit_without: largest stable time step without these elements, s.
        body: body that moves most in the mode.
    """

    timestep: float
    limit: float
    time: float
    rate: float
    growth: float
    elements: tuple[ForceElement, ...]
    limit_without: float
    body: MovingBody

    @property
    def is_stable(self) -> bool:
        """True if the time step of the file is below the limit."""
        return self.timestep <= self.limit


@dataclass(frozen=True)
class ModelChange:
    """Change of a model with which the time step of the file is stable. The changed model was run.

    Attributes:
        change: the change in words, such as "kp of actuator 'lift' 500 instead of 2000".
        error: difference of the changed run from the reference of the unchanged model.
    """

    change: str
    error: RunError


class StepStability:
    """Growth of small motions about one state in time steps of any size.

    Attributes:
        motions: small motions.
        state: number of the state.
    """

    def __init__(
        self, motions: SmallMotions[Any], state: int, settings: Any, duration: float, exact_growth: float
    ) -> None:
        """Take small motions.

        Args:
            motions: small motions.
            state: number of the state.
            settings: settings of the run; the time step is replaced.
            duration: duration of the run, s.
            exact_growth: largest growth of exact small motions about any state of the run, 1/s.
        """
        self.motions, self.state = motions, state
        self._settings, self._duration = settings, duration
        self._exact_growths = {frozenset[int](): exact_growth}

    def of_changed(self, motions: SmallMotions[Any]) -> StepStability:
        """Return the growth of small motions of a changed model about the same state."""
        growth = self._exact_growths[frozenset()]
        return StepStability(motions, self.state, self._settings, self._duration, growth)

    def _exact_growth(self, without: Collection[int]) -> float:
        """Return the growth of exact small motions without some elements, 1/s."""
        removed = frozenset(without)
        if removed not in self._exact_growths:
            rates = self.motions.rates(self.state, self._settings, without)
            growth = float(np.max(np.linalg.eigvals(rates).real))
            self._exact_growths[removed] = max(self._exact_growths[frozenset()], growth)
        return self._exact_growths[removed]

    def added_growth(self, timestep: float, without: Collection[int] = ()) -> float:
        """Return the growth of small motions that time steps add, 1/s; -inf if round-off can explain it.

        Args:
            timestep: s.
            without: numbers of removed elements.
        """
        settings = self.motions.at_timestep(self._settings, timestep)
        step = self.motions.step(self.state, settings, without)
        if not np.all(np.isfinite(step)):
            return math.inf
        per_step = math.log(max(float(np.max(np.abs(np.linalg.eigvals(step)))), 1e-300))
        if per_step < MIN_STEP_GROWTH:
            return -math.inf
        return per_step / timestep - EXACT_GROWTH_FACTOR * self._exact_growth(without)

    def is_stable(self, timestep: float, without: Collection[int] = ()) -> bool:
        """Return whether time steps multiply small motions by no more than `MAX_GROWTH` during the run."""
        return self.added_growth(timestep, without) * self._duration <= math.log(MAX_GROWTH)

    def limit(self, timestep: float, without: Collection[int] = ()) -> float:
        """Find the largest stable time step, s: 0 if there is none, infinite if all are stable.

        Args:
            timestep: first time step to try, s.
            without: numbers of removed elements.
        """
        stable, unstable = 0.0, math.inf
        starts_stable = self.is_stable(timestep, without)
        for _ in range(MAX_STEP_DOUBLINGS if starts_stable else MAX_STEP_HALVINGS):
            if self.is_stable(timestep, without):
                stable, timestep = timestep, 2.0 * timestep
            else:
                unstable, timestep = timestep, 0.5 * timestep
            if stable and unstable < math.inf:
                break
        else:
            return math.inf if starts_stable else 0.0
        while unstable > (1.0 + LIMIT_TOL) * stable:
            between = math.sqrt(stable * unstable)
            if self.is_stable(between, without):
                stable = between
            else:
                unstable = between
        return stable


class ModeAtFault:
    """Mode of a run that time steps multiply most, and the elements that cause it.

    Attributes:
        found: the result.
        steps: growth of small motions about the state at which the mode was found.
        shape: complex amplitudes (nv,) of the velocities of the mode.
        elements: numbers of the elements at fault.
    """

    def __init__(self, motions: SmallMotions[Any], settings: Any, timestep: float, duration: float) -> None:
        """Find the mode.

        Args:
            motions: small motions about states of a run.
            settings: settings of the file.
            timestep: time step of the file, s.
            duration: duration of the run, s.
        """
        self._settings = settings
        # the state at which time steps add most growth; if they are stable, the state with the fastest mode
        rates = [np.linalg.eigvals(motions.rates(k, settings)) for k in range(len(motions.times))]
        growth = max(0.0, *(float(np.max(each.real)) for each in rates))
        states = [StepStability(motions, k, settings, duration, growth) for k in range(len(rates))]
        self.steps = max(states, key=lambda steps: steps.added_growth(timestep))
        limit = self.steps.limit(timestep)
        is_stable = timestep <= limit
        if is_stable:
            self.steps = states[int(np.argmax([np.max(np.abs(each)) for each in rates]))]
        # the mode in the exact motion and in the map of one time step
        state = self.steps.state
        values, vectors = np.linalg.eig(motions.rates(state, settings))
        multipliers, step_vectors = np.linalg.eig(motions.step(state, settings))
        if is_stable:
            mode = int(np.argmax(np.abs(values)))
            self.shape = vectors[motions.velocities, mode]
            step_mode = _alike(step_vectors[motions.velocities], self.shape, np.abs(multipliers - 1.0))
        else:
            step_mode = int(np.argmax(np.abs(multipliers)))
            self.shape = step_vectors[motions.velocities, step_mode]
            mode = _alike(vectors[motions.velocities], self.shape, np.abs(values))
        # the elements that cause it
        shares = self._shares(np.linalg.pinv(step_vectors)[step_mode], step_vectors[:, step_mode])
        order = np.argsort(-shares).tolist()
        if is_stable:
            self.elements = tuple(k for k in order[:1] if shares[k] > MIN_CAUSE_SHARE)
        else:
            self.elements = tuple(self._needed(order, timestep))
        self.found = Stability(
            timestep,
            limit,
            float(motions.times[state]),
            float(np.abs(values[mode])),
            float(np.abs(multipliers[step_mode])),
            tuple(motions.elements[k] for k in self.elements),
            self.steps.limit(timestep, self.elements) if self.elements else limit,
            motions.moving(state, self.shape),
        )

    def _shares(self, left: Array, right: Array) -> Array:
        """Return the part of a mode's change per step that each element makes.

        One step changes a mode by m - 1, where m = left M right is the eigenvalue. An element whose removal
        changes M by D makes left D right of this change.

        Args:
            left: left eigenvector (n,) of the mode, with left right = 1.
            right: right eigenvector (n,) of the mode.
        """
        motions, state = self.steps.motions, self.steps.state
        start = np.column_stack([right.real, right.imag])

        def after_step(without: Collection[int]) -> Any:
            """Return left M right, M of the model without some elements."""
            real, imaginary = left @ motions.step(state, self._settings, without, start)
            return real + 1j * imaginary

        whole = after_step(())
        changed = whole - 1.0
        made = np.array([whole - after_step((k,)) for k in range(len(motions.elements))])
        shares: Array = np.real(made * np.conj(changed)) / np.maximum(np.abs(changed) ** 2, 1e-300)
        return shares

    def _needed(self, order: list[int], timestep: float) -> list[int]:
        """Return the fewest elements without which a time step is stable, the most important one first.

        Single elements are tried first, and the one whose removal allows the largest time step is taken.
        Otherwise elements are removed in order, forces before constraints, which only pass forces on. If no
        removal makes the time step stable, the element with the largest share is returned.

        Args:
            order: elements that contribute to the mode, largest share first.
            timestep: s.
        """
        elements = self.steps.motions.elements
        alone = [k for k in range(len(elements)) if self.steps.is_stable(timestep, (k,))]
        if alone:
            limits = {k: self.steps.limit(timestep, (k,)) for k in alone}
            return [max(alone, key=lambda k: limits[k])]
        removed: list[int] = []
        for k in sorted(order, key=lambda k: elements[k].is_constraint):
            removed.append(k)
            if self.steps.is_stable(timestep, removed):
                break
        else:
            return order[:1]
        for k in removed[:-1]:
            others = [other for other in removed if other != k]
            if self.steps.is_stable(timestep, others):
                removed = others
        return removed


def model_changes(
    mode: ModeAtFault,
    simulation: FileSimulation[Any],
    is_stable: Callable[[FileSimulation[Any]], bool],
    run: Callable[[FileSimulation[Any]], FileRun],
    error: Callable[[FileRun], RunError],
) -> Iterator[ModelChange]:
    """Weaken the elements at fault, or add armature to the joint that moves, and run the changed models.

    Args:
        mode: an unstable mode.
        simulation: the file.
        is_stable: function that returns whether the time step of the file is stable for a changed model.
        run: function that simulates a changed model with the settings of the file.
        error: function that compares a run with the reference.
    """
    motions, found = mode.steps.motions, mode.found
    # the smallest change that is stable, among powers of two
    if found.elements and all(element.can_be_scaled for element in found.elements):
        for k in range(1, MAX_STEP_HALVINGS):
            weaker = simulation.changed(motions.scaled(mode.elements, 0.5**k))
            if is_stable(weaker):
                changed = run(weaker)
                if not changed.stopped:
                    yield ModelChange(_weakened(found.elements, 2**k), error(changed))
                    break
    for k in range(-MAX_STEP_DOUBLINGS, MAX_STEP_HALVINGS):
        change, words = motions.with_armature(mode.steps.state, mode.shape, 2.0**k)
        heavier = simulation.changed(change)
        if is_stable(heavier):
            changed = run(heavier)
            if not changed.stopped:
                yield ModelChange(words, error(changed))
                break


def _weakened(elements: tuple[ForceElement, ...], divisor: int) -> str:
    """Format the division of elements' values."""
    first = elements[0]
    if len(elements) == 1:
        return f"{first.name} {float(f'{first.value / divisor:.3g}'):g} instead of {first.value:g}"
    others = f"{len(elements) - 1} more" if elements[2:] else elements[1].name
    return f"{first.name} and {others} divided by {divisor}"


def _alike(shapes: Array, shape: Array, speeds: Array) -> int:
    """Return the number of the fastest one of the shapes that are nearly parallel to a shape.

    Args:
        shapes: (n, k) velocities of modes.
        shape: (n,) velocities of one mode.
        speeds: (k,) speed of each column.
    """
    norms = np.maximum(np.linalg.norm(shapes, axis=0), 1e-300)
    cosines = np.abs(shape.conj() @ shapes) / norms
    return int(np.argmax(np.where(cosines >= ALIKE * np.max(cosines), speeds, -1.0)))
