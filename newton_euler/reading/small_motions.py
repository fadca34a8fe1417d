"""Small motions of a model file about states of its run, as the file's own engine computes them.

A package for a file format derives from `SmallMotions`. A small motion x is the vector (n,) of the changes of
position (nv,), velocity (nv,) and actuator activations (na,). Two matrices describe small motions about a
state: A of dx/dt = A x in continuous time, and the map M of one time step of the engine, x_next = M x. The
eigenvalues of A, 1/s, show how fast the modes oscillate and decay. A mode whose eigenvalue of M has a
magnitude above 1 grows from step to step: the time step is too long for it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from newton_euler.scalars import Array

SettingsT = TypeVar("SettingsT")
"""Type of an engine's settings (time step, integrator, solver)."""

ModelChange = Callable[[Any], None]
"""Function that changes the engine's model in place, to simulate the file with the change."""


@dataclass(frozen=True)
class ForceElement:
    """Part of a model that exerts forces, and that can be removed to find the cause of a fast mode.

    Attributes:
        name: the part, such as "kp of actuator 'lift'".
        value: value of the part in the file, such as a gain or a stiffness in SI units; NaN if no number
            describes the part.
        can_be_scaled: True if `SmallMotions.scaled` can weaken the part.
        is_constraint: True if the part is a constraint, which also transmits the forces of other parts.
    """

    name: str
    value: float = np.nan
    can_be_scaled: bool = True
    is_constraint: bool = False


@dataclass(frozen=True)
class MovingBody:
    """The body with the most kinetic energy in a small motion.

    Attributes:
        name: name of the body.
        mass: kg.
        share: kinetic energy of the body, as a fraction of the kinetic energy of the small motion.
        neighbor: name of the heaviest body that a joint or a loop constraint connects to the body; "" without
            moving neighbors.
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
        velocities: slice of the velocities in the vector x of a small motion.
    """

    times: Array
    elements: tuple[ForceElement, ...]
    velocities: slice

    @abstractmethod
    def rates(self, state: int, settings: SettingsT, without: Collection[int] = ()) -> Array:
        """Return the matrix A (n, n), 1/s, of dx/dt = A x.

        Args:
            state: index of the state in `times`.
            settings: settings of the engine; the stiffness of constraints may depend on the time step.
            without: indices of the `elements` that are removed.
        """

    @abstractmethod
    def step(
        self,
        state: int,
        settings: SettingsT,
        without: Collection[int] = (),
        start: Array | None = None,
    ) -> Array:
        """Return the map M (n, n) of one time step, x_next = M x, or small motions (n, k) after one step.

        Args:
            state: index of the state in `times`.
            settings: settings of the engine, with its time step and integrator.
            without: indices of the `elements` that are removed.
            start: (n, k) small motions before the step, for the result M start; None for M.
        """

    @abstractmethod
    def at_timestep(self, settings: SettingsT, timestep: float) -> SettingsT:
        """Return settings with another time step, s."""

    @abstractmethod
    def moving(self, state: int, velocity: Array) -> MovingBody:
        """Return the body with the most kinetic energy in a mode.

        Args:
            state: index of the state in `times`.
            velocity: (nv,) complex amplitudes of the velocities in the mode.
        """

    @abstractmethod
    def scaled(self, elements: Collection[int], factor: float) -> ModelChange:
        """Return the change of the model that multiplies the forces of `elements`, by index, by a factor."""

    @abstractmethod
    def with_armature(self, state: int, velocity: Array, factor: float) -> tuple[ModelChange, str]:
        """Return the change of the model that adds armature (rotor inertia) to the joint that moves most.

        Args:
            state: index of the state in `times`.
            velocity: (nv,) complex amplitudes of the velocities in a mode.
            factor: armature, as a multiple of the joint's inertia while no other joint moves.

        Returns:
            The change, and its description, such as 'armature="0.01" of joint 'lift''.
        """
