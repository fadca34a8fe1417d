"""Whether the comparison finds a fault, and what it blames."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.comparison.levels import EQUATION_LEVELS, Level, compare_pair
from crosscheck.comparison.samples import Samples, States
from crosscheck.engines import ENGINES, Engine
from crosscheck.errors import CrosscheckError
from crosscheck.faults import PLANTED_IN
from crosscheck.faults.catalogue import SIZES, Fault, catalogue
from newton_euler.assemble import random_states
from newton_euler.errors import NewtonEulerError
from newton_euler.relative import Relative
from newton_euler.scene import Scene
from newton_euler.system import System

STATES = 4
"""Random consistent states beside the initial one; gravity has three components to be told from the rest."""

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
        observable: whether it, or a larger one like it, changes a pose, velocity, energy, acceleration or
            reaction. If no motion shows it, newton_euler's equations with it and without it are compared at
            the states; it is unobservable if they agree to round-off.
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


@dataclass(frozen=True)
class Search:
    """All faults of a scene.

    Attributes:
        found: what became of each.
        engines: in which they were planted, in turns.
        left_out: engines that cannot express the scene, and why.
    """

    found: tuple[Found, ...]
    engines: tuple[str, ...]
    left_out: dict[str, str]


def find_faults(
    scene: Scene,
    progress: Callable[[str], None],
    sizes: Sequence[float] = SIZES,
    names: Sequence[str] = PLANTED_IN,
) -> Search:
    """Plant all faults of a scene, one at a time, in one engine after the other, and look for each.

    Args:
        scene: as it should be.
        progress: is told how far it is.
        sizes: of the faults, see `SIZES`.
        names: of engines out of `PLANTED_IN`.

    Raises:
        CrosscheckError: for a scene that the engines disagree on as it is.
        NewtonEulerError: for a scene that none of the engines can express.
    """
    own = samples_of(scene)
    engines, left_out = _able(own, names)
    faults = catalogue(scene, sizes)
    found = []
    for number, fault in enumerate(faults):
        if number % PROGRESS == 0:
            progress(f"{number} of {len(faults)} faults: {fault.name}")
        found.append(find(fault, engines[number % len(engines)], own))
    return Search(tuple(_observable(found)), tuple(engine.name for engine in engines), left_out)


def _observable(found: Sequence[Found]) -> Iterator[Found]:
    """With those called observable of which a larger one is: they are too small, and no less at fault."""
    sights = {each.fault.alike for each in found if each.observable}
    for each in found:
        yield replace(each, observable=each.fault.alike in sights)


def samples_of(scene: Scene) -> Samples:
    """newton_euler at the initial state and at random ones."""
    return Samples(Relative(scene), States(scene, (scene.initial_state, *random_states(scene, STATES))))


def _able(own: Samples, names: Sequence[str]) -> tuple[list[Engine], dict[str, str]]:
    """The engines that can express a scene, which have to agree on it, and why the others cannot."""
    able, refusals = [], {}
    for name in names:
        try:
            (system,) = ENGINES[name].systems(own.states.scene)
        except NewtonEulerError as error:
            refusals[name] = error
            continue
        parting = _first_failing(own, Samples(system, own.states), name, EQUATION_LEVELS)
        if parting is not None:
            raise CrosscheckError(
                f"newton_euler and {name} part on scene {own.states.scene.name!r} without a fault, at level "
                f"{parting.level!r}: {parting.quantity}; `crosscheck run` says more"
            )
        able.append(ENGINES[name])
    if not able:
        raise next(iter(refusals.values()))
    return able, {name: str(error) for name, error in refusals.items()}


def find(fault: Fault, engine: Engine, own: Samples) -> Found:
    """Plant one fault in one engine and compare it with the right model's samples."""
    try:
        samples = Samples(_planted(fault, engine, own.states.scene), own.states)
    except NewtonEulerError as error:
        refusal = _refusal(error)
        return Found(fault, engine.name, refusal, refusal, True)
    seen = _first_failing(own, samples, engine.name, EQUATION_LEVELS)
    # where the model's own numbers agree, the levels after it have been looked at already
    numbers = seen is not None and seen.level == "model"
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
