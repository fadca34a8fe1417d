"""Find out what the simulation of a log lacks: dampers, springs, rotors, dry friction or gravity.

The reference is simulated again without all elements of one kind, and without those that importers most often
drop together. If the log fits such a reference far better, its simulation does not have these elements.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from crosscheck.logs.mistakes import MAX_SEARCH_S
from crosscheck.logs.options import LogOptions
from crosscheck.logs.reading import LogReading
from crosscheck.own_run.errors import MotionScale, RunError, run_error
from newton_euler.errors import NewtonEulerError
from newton_euler.model.forces import BallSpring, Force, JointSpring, PointSpring
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction

GRAVITY = "gravity"
"""Name of gravity among the elements."""

LACK_FACTOR = 10.0
"""Factor by which the error must fall without the elements."""


@dataclass(frozen=True)
class Lack:
    """Elements of the model that the simulation of a log does not have.

    Attributes:
        elements: names of the elements, such as "damping of joint 'hip'".
        before: error of the log.
        after: error against the reference without the elements.
    """

    elements: tuple[str, ...]
    before: RunError
    after: RunError

    @property
    def is_gravity(self) -> bool:
        """True if gravity is lacking, as it seems to be if motors hold all bodies."""
        return self.elements == (GRAVITY,)


def find_lack(
    reading: LogReading, options: LogOptions, before: RunError, rows: int, scale: MotionScale
) -> Lack | None:
    """Find the elements without which the reference fits a log far better; None if there are none.

    Args:
        reading: the log.
        options: options of the user.
        before: error of the log against the complete reference.
        rows: number of compared rows.
        scale: extent of the motion, by which errors are divided.
    """
    best: Lack | None = None
    end = time.process_time() + MAX_SEARCH_S
    for scene, elements in _reduced_scenes(reading.scene):
        if time.process_time() > end:
            break
        try:
            tried = LogReading(scene, reading.names, reading.table).compared(options)
        except NewtonEulerError:
            continue  # the scene without the elements has no reference
        run = tried.run.first(rows)
        if tried.reference.time[-1] < run.time[-1]:
            continue  # the reference stops before, where little has moved
        error = run_error(run, tried.reference_at(run.time), scale)
        if best is None or error.relative < best.after.relative:
            best = Lack(elements, before, error)
    return best if best and best.after.relative * LACK_FACTOR < before.relative else None


def _reduced_scenes(scene: Scene) -> Iterator[tuple[Scene, tuple[str, ...]]]:
    """Yield scenes without all elements of a kind, and the names of these elements."""
    without_damping, dampers = _without(scene, "damping")
    without_springs, springs = _without(scene, "stiffness")
    rotors = tuple(str(each.element) for each in scene.armatures)
    if dampers:
        yield without_damping, dampers
    if springs:
        yield without_springs, springs
    if rotors:
        yield replace(scene, armatures=()), rotors
    if sum(map(bool, (dampers, springs, rotors))) > 1:
        without_both, _ = _without(without_damping, "stiffness")
        yield replace(without_both, armatures=()), (*dampers, *springs, *rotors)
    if frictions := tuple(force.element for force in scene.forces if isinstance(force, JointFriction)):
        others = tuple(force for force in scene.forces if not isinstance(force, JointFriction))
        yield replace(scene, forces=others), frictions
    if scene.gravity.any():
        yield replace(scene, gravity=(0.0, 0.0, 0.0)), (GRAVITY,)


def _without(scene: Scene, quantity: Literal["damping", "stiffness"]) -> tuple[Scene, tuple[str, ...]]:
    """Return the scene without damping or stiffness of its springs, and names of the values that are gone."""
    forces, names = list[Force](), list[str]()
    for force in scene.forces:
        if isinstance(force, JointSpring | PointSpring | BallSpring) and getattr(force, quantity):
            names.append(f"{quantity} of {force.element.removeprefix('spring of ')}")
            force = replace(force, damping=0.0) if quantity == "damping" else replace(force, stiffness=0.0)
        forces.append(force)
    return replace(scene, forces=tuple(forces)), tuple(names)
