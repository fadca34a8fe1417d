"""Small motions of a model file about states of its run, as the file's own engine computes them.

A package for a file format derives from `SmallMotions`. A small motion x holds the changes of position (nv,),
velocity (nv,) and actuator activations (na,). Two matrices describe small motions about a state: the rates A
of dx/dt = A x, and the map M of one time step, x_next = M x. The eigenvalues of A are the speeds of the
modes. A mode whose eigenvalue of M has a magnitude above 1 grows from step to step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from newton_euler.scalars import Array

SettingsT = TypeVar("SettingsT")

ModelChange = Callable[[Any], None]
"""Function that changes the engine's model, for `FileSimulation.changed`."""


@dataclass(frozen=True)
class ForceElement:
    """Part of a model that makes forces, and that can be removed for a trial.

    Attributes:
        name: the part, such as "kp of actuator 'lift'".
        value: value in the file, such as a gain or a stiffness in SI units; nan if no number describes it.
        can_be_scaled: whether `SmallMotions.scaled` can weaken it.
        is_constraint: whether it is a constraint, which also passes on the forces of others.
    """

    name: str
    value: float = np.nan
    can_be_scaled: bool = True
    is_constraint: bool = False


@dataclass(frozen=True)
class MovingBody:
    """Body that moves most in a small motion.

    Attributes:
        name: the body.
        mass: kg.
        share: part of the kinetic energy of the small motion.
        neighbor: heaviest body that a joint or a loop constraint connects to it; "" without moving neighbors.
        neighbor_mass: mass of the neighbor, kg.
    """

    name: str
    mass: float
    share: float
    neighbor: str = ""
    neighbor_mass: float = 0.0


class SmallMotions(ABC, Generic[SettingsT]):
    """Small motions about some states of a run.

    Attributes:
        times: (k,) time of each state, s; the first state is the start.
        elements: force elements of the model.
        velocities: slice of the velocities in a small motion.
    """

    times: Array
    elements: tuple[ForceElement, ...]
    velocities: slice

    @abstractmethod
    def rates(self, state: int, settings: SettingsT, without: Collection[int] = ()) -> Array:
        """Return the matrix A (n, n) of dx/dt = A x.

        Args:
            state: number of the state.
            settings: settings; the stiffness of constraints may depend on the time step.
            without: numbers of the elements that are removed.
        """

    @abstractmethod
    def step(self, state: int, settings: SettingsT, without: Collection[int] = ()) -> Array:
        """Return the map M (n, n) of one time step, x_next = M x.

        Args:
            state: number of the state.
            settings: time step and integrator.
            without: numbers of the elements that are removed.
        """

    @abstractmethod
    def at_timestep(self, settings: SettingsT, timestep: float) -> SettingsT:
        """Return settings with another time step, s."""

    @abstractmethod
    def moving(self, state: int, velocity: Array) -> MovingBody:
        """Return the body with most kinetic energy for complex amplitudes of the velocities (nv,)."""

    @abstractmethod
    def scaled(self, elements: Collection[int], factor: float) -> ModelChange:
        """Return the change that multiplies elements by a factor."""

    @abstractmethod
    def with_armature(self, state: int, velocity: Array, factor: float) -> tuple[ModelChange, str]:
        """Add armature to the joint that moves most, see `moving`.

        Args:
            state: number of the state.
            velocity: complex amplitudes of the velocities (nv,).
            factor: armature, as a multiple of the joint's apparent inertia.

        Returns:
            The change, and its words, such as 'armature="0.01" of joint 'lift''.
        """
