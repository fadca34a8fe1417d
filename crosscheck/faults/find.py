"""Whether the comparison finds a fault, and what it blames."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from crosscheck.comparison.levels import EQUATION_LEVELS, Level, compare_pair
from crosscheck.comparison.rows import LEVELS
from crosscheck.comparison.samples import Samples, States
from crosscheck.engines import ENGINES, Engine
from crosscheck.errors import CrosscheckError
from crosscheck.faults.catalogue import SIZES, Fault, catalogue
from newton_euler.assemble import random_states
from newton_euler.errors import NewtonEulerError
from newton_euler.relative import Relative
from newton_euler.scene import Scene
from newton_euler.system import System

STATES = 4
"""Random consistent states beside the initial one; gravity has three components to be told from the rest."""

PLANTED_IN = ("mujoco", "pinocchio")
"""In turns; newton_euler is what they are compared with."""

PROGRESS = 10
"""Faults between two messages."""

MOTION = EQUATION_LEVELS[1:]
"""Levels that look at what a model does and not at its numbers."""

REFUSED = "refused"
"""The level of a fault that an engine or the mechanism itself refuses to run with."""


@dataclass(frozen=True)
class Sighting:
    """Where a fault shows first.

    Attributes:
        level: of the comparison, or `REFUSED`.
        quantity: the figure that fails; the error's text if refused.
        value, tolerance: of the figure; NaN if refused.
        where: what is blamed.
    """

    level: str
    quantity: str
    value: float
    tolerance: float
    where: str


@dataclass(frozen=True)
class Found:
    """What became of a fault.

    Attributes:
        fault, engine: what was planted where.
        seen: its first sighting at levels 1 to 4; None if all agree.
        moves: the same at levels 2 to 4, by motion alone.
        lost: for one that is not seen, where newton_euler with the same fault parts from the engine's model:
            the engine does not hold it.
        observable: whether it changes a pose, velocity, energy, acceleration or reaction at all. If no motion
            shows it, newton_euler's equations with it and without it are compared at the states; it is
            unobservable if they agree to round-off.
    """

    fault: Fault
    engine: str
    seen: Sighting | None
    moves: Sighting | None
    observable: bool
    lost: Sighting | None = None

    @property
    def counts(self) -> bool:
        """Whether it can be found: it shows in the model's numbers, or does something."""
        return self.seen is not None or self.observable

    @property
    def blamed(self) -> bool:
        """Whether the very body, joint or term is named."""
        return self.seen is not None and self.seen.where in self.fault.right

    @property
    def blamed_by_motion(self) -> bool:
        """The same by motion alone, where a joint's fault may be seen at the bodies it connects."""
        return self.moves is not None and self.moves.where in self.fault.right | self.fault.near


def find_faults(scene: Scene, progress: Callable[[str], None], sizes: Sequence[float] = SIZES) -> list[Found]:
    """Plant all faults of a scene, one at a time, in one engine after the other, and look for each.

    Raises:
        CrosscheckError: for a scene that the engines disagree on as it is.
        NewtonEulerError: for a scene that neither engine can express.
    """
    own = samples_of(scene)
    engines = _able(own)
    faults = catalogue(scene, sizes)
    found = []
    for number, fault in enumerate(faults):
        if number % PROGRESS == 0:
            progress(f"{number} of {len(faults)} faults: {fault.name}")
        found.append(find(fault, engines[number % len(engines)], own))
    return found


def samples_of(scene: Scene) -> Samples:
    """newton_euler at the initial state and at random ones."""
    return Samples(Relative(scene), States(scene, (scene.initial_state, *random_states(scene, STATES))))


def _able(own: Samples) -> list[Engine]:
    """The engines of `PLANTED_IN` that can express a scene; they have to agree on it."""
    able, refusal = [], None
    for name in PLANTED_IN:
        try:
            (system,) = ENGINES[name].systems(own.states.scene)
        except NewtonEulerError as error:
            refusal = error
            continue
        parting = _first_failing(own, Samples(system, own.states), name, EQUATION_LEVELS)
        if parting is not None:
            raise CrosscheckError(
                f"newton_euler and {name} part on scene {own.states.scene.name!r} without a fault, at level "
                f"{parting.level!r}: {parting.quantity}; `crosscheck run` says more"
            )
        able.append(ENGINES[name])
    if refusal is not None and not able:
        raise refusal
    return able


def find(fault: Fault, engine: Engine, own: Samples) -> Found:
    """Plant one fault in one engine and compare it with the right model's samples."""
    try:
        samples = Samples(_planted(fault, engine, own.states.scene), own.states)
    except NewtonEulerError as error:
        refusal = _refusal(error)
        return Found(fault, engine.name, refusal, refusal, True)
    seen = _first_failing(own, samples, engine.name, EQUATION_LEVELS)
    # where the model's own numbers agree, the levels after it have been looked at already
    numbers = seen is not None and seen.level == LEVELS[0]
    moves = _first_failing(own, samples, engine.name, MOTION) if numbers else seen
    if moves is not None:
        return Found(fault, engine.name, seen, moves, True)
    # the same equations of motion with the fault and without it
    faulty = Samples(Relative(fault.plant(own.states.scene)), own.states)
    observable = _first_failing(own, faulty, "newton_euler with the fault", MOTION) is not None
    lost = None if seen else _first_failing(faulty, samples, engine.name, EQUATION_LEVELS[:1])
    return Found(fault, engine.name, seen, moves, observable, lost)


def _first_failing(own: Samples, samples: Samples, name: str, levels: Sequence[Level]) -> Sighting | None:
    try:
        for row in compare_pair(("newton_euler", name), [own], [samples], levels):
            if not row.agrees:
                return Sighting(row.level, row.quantity, row.value, row.tolerance, row.where)
    except NewtonEulerError as error:
        return _refusal(error)
    return None


def _refusal(error: NewtonEulerError) -> Sighting:
    """The error as a sighting; where is the joint or body that it is about."""
    element = getattr(error, "joint", getattr(error, "element", ""))
    named = re.search(r"'(.*)'", element)
    return Sighting(REFUSED, str(error), np.nan, np.nan, named[1] if named else element)


def _planted(fault: Fault, engine: Engine, scene: Scene) -> System:
    """The engine's rigid system with the fault.

    A loop that does not close is refused by the mechanism, before an engine sees it. In MuJoCo it is planted
    in the compiled model, where nothing refuses it.
    """
    if fault.shift is None or engine.name != "mujoco":
        return engine.systems(fault.plant(scene))[0]
    from mjcf.inspect import move_anchor
    from mjcf.rigid import RigidMuJoCo

    system = RigidMuJoCo(scene)
    move_anchor(system, fault.element, fault.shift)
    return system
