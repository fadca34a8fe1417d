"""Search for planted faults: which are found, and who is blamed.

Faults of an engine's model are searched for by the comparison of engines. Faults of a reading are planted
between the reading of a model file and its verification, in the scene with all controls at random, in which
every actuator acts, and searched for by the verification. A fault that is not found has to change nothing:
then newton_euler's own equations are the same with it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from crosscheck.compare.diagnosis import Diagnosis, diagnose
from crosscheck.compare.figure import Figure
from crosscheck.compare.levels import EQUATION_LEVELS, Level, compare_pair
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.engine import ENGINES, Engine
from crosscheck.studies.faults import PLANTED_IN
from crosscheck.studies.faults.catalog import SIZES, Fault, catalog
from crosscheck.studies.faults.misreadings import EVERYTHING, misreadings
from crosscheck.studies.faults.turning import without_turning
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.reading.excitation import random_states
from newton_euler.reading.import_report import ImportReport
from newton_euler.reading.reference import ReferenceModel
from newton_euler.reading.verify import verify
from newton_euler.runs.assemble import initial_state

STATES = 4
"""Random consistent states beside the initial one; gravity has three components to be told from the rest."""

PROGRESS = 10
"""Faults between two messages."""

SMALLEST = 1e-4
"""Relative size down to which all faults of engines have to be found."""

MOTION = EQUATION_LEVELS[1:]
"""Levels that look at what a model does and not at its numbers."""

REFUSED = "refused"
"""The level of a fault that an engine or the mechanism itself refuses to run with."""

READING = "the reading"
"""In place of an engine, where faults are planted in what was read."""


@dataclass(frozen=True)
class Sighting(Figure):
    """The first figure that shows a fault; of one at the level `REFUSED` the quantity is the error's text.

    Attributes:
        odd: the engine that the diagnosis blames; "" if nothing settles which.
    """

    odd: str = ""

    @classmethod
    def of(cls, figure: Figure | Diagnosis, odd: str = "") -> Sighting:
        """A figure that fails, or the one that a diagnosis is about."""
        between = figure.between if isinstance(figure, Figure) else figure.parting
        place = figure.value, figure.tolerance, figure.where
        return cls(figure.level, figure.quantity, between, *place, odd=odd)


@dataclass(frozen=True)
class Found:
    """The outcome of a search for a fault.

    Attributes:
        fault, engine: what was planted where.
        seen: its first sighting at the levels of equations; None if all agree.
        moves: the same at those after the model, by motion alone.
        alone: whether too few engines express the scene for any to be the odd one out.
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
    alone: bool = False

    @property
    def counts(self) -> bool:
        """True if it can be found: it shows in the model's numbers, or does something."""
        return self.seen is not None or self.observable

    @property
    def blamed(self) -> bool:
        """True if the engine that has it is blamed, and the very body, joint or term is named."""
        return self._names(self.seen, self.fault.right)

    @property
    def blamed_by_motion(self) -> bool:
        """The same by motion alone, where a joint's fault may be seen at the bodies it connects."""
        return self._names(self.moves, self.fault.right | self.fault.near)

    def _names(self, sighting: Sighting | None, right: frozenset[str]) -> bool:
        if sighting is None or sighting.where not in right:
            return False
        return sighting.odd == self.engine or (self.alone and not sighting.odd)


@dataclass(frozen=True)
class Search:
    """All faults of a scene.

    Attributes:
        found: what became of each.
        engines: in which they were planted, in turns, or `READING`.
        left_out: engines that cannot express the scene, and why.
        smallest: size down to which all have to be found.
    """

    found: tuple[Found, ...]
    engines: tuple[str, ...]
    left_out: dict[str, str]
    smallest: float = SMALLEST


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
    sound = Sound(scene)
    engines = [sound.engines[name] for name in names if name in sound.engines]
    if not engines:
        raise sound.refusals[names[0]]
    faults = catalog(scene, sizes)
    counted = _counted(faults, progress)
    found = [find(fault, engines[number % len(engines)], sound) for number, fault in counted]
    left_out = {name: str(error) for name, error in sound.refusals.items()}
    return Search(tuple(_observable(found)), tuple(engine.name for engine in engines), left_out)


def _counted(faults: Sequence[Fault], progress: Callable[[str], None]) -> Iterator[tuple[int, Fault]]:
    """The faults with their numbers, of which `progress` is told every `PROGRESS`th."""
    for number, fault in enumerate(faults):
        if number % PROGRESS == 0:
            progress(f"{number} of {len(faults)} faults: {fault.name}")
        yield number, fault


def _observable(found: Sequence[Found]) -> Iterator[Found]:
    """With those called observable of which a larger one is: they are too small, and no less at fault."""
    sights = {each.fault.alike for each in found if each.observable}
    for each in found:
        yield replace(each, observable=each.fault.alike in sights)


def samples_of(scene: Scene) -> Samples:
    """newton_euler at the initial state and at random ones."""
    return Samples(Relative(scene), States(scene, (initial_state(scene), *random_states(scene, STATES))))


class Sound:
    """The engines' equations of a scene without a fault, at its initial state and at random ones.

    Attributes:
        scene: as it should be.
        engines: by name, those that can express it, newton_euler first.
        refusals: of the others, by name.
        own: newton_euler.

    Raises:
        CrosscheckError: for a scene that the engines disagree on.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.own = scene, samples_of(scene)
        self.engines: dict[str, Engine] = {}
        self.refusals: dict[str, NewtonEulerError] = {}
        self._samples: dict[str, Samples] = {}
        for name, engine in ENGINES.items():
            try:
                system = engine.systems(scene)[0]
            except NewtonEulerError as error:
                self.refusals[name] = error
                continue
            self.engines[name] = engine
            self._samples[name] = Samples(system, self.own.states)
        pairs = combinations(self._samples, 2)
        self._rows = {pair: list(self._compared(pair, self._samples, EQUATION_LEVELS)) for pair in pairs}
        for (one, other), rows in self._rows.items():
            for row in rows:
                if not row.agrees:
                    raise CrosscheckError(
                        f"{one} and {other} part on scene {scene.name!r} without a fault, at level "
                        f"{row.level!r}: {row.quantity}; `crosscheck run` says more"
                    )

    def _compared(
        self, pair: tuple[str, str], samples: dict[str, Samples], levels: Sequence[Level]
    ) -> Iterator[Figure]:
        return compare_pair(pair, [samples[pair[0]]], [samples[pair[1]]], levels)

    def diagnosed(self, name: str, faulty: Samples, levels: Sequence[Level]) -> Sighting | None:
        """Diagnose all engines, one of them with other samples; None if they agree."""
        samples = self._samples | {name: faulty}
        rows: list[Figure] = []
        try:
            for pair, known in self._rows.items():
                rows += self._compared(pair, samples, levels) if name in pair else known
        except NewtonEulerError as error:
            return _refusal(error, name)
        for found in diagnose(tuple(samples), rows)[:1]:
            return Sighting.of(found, found.odd)
        return None


def find(fault: Fault, engine: Engine, sound: Sound) -> Found:
    """Plant one fault in one engine and compare it with the others."""
    name, own, alone = engine.name, sound.own, len(sound.engines) < 3
    try:
        samples = Samples(_planted(fault, engine, sound.scene), own.states)
    except NewtonEulerError as error:
        refusal = _refusal(error, name)
        return Found(fault, name, refusal, refusal, True, alone=alone)
    seen = sound.diagnosed(name, samples, EQUATION_LEVELS)
    # where the model's own numbers agree, the levels after it have been looked at already
    numbers = seen is not None and seen.level == "model"
    moves = sound.diagnosed(name, samples, MOTION) if numbers else seen
    if moves is not None:
        return Found(fault, name, seen, moves, True, alone=alone)
    # the same equations of motion with the fault and without it
    faulty = Samples(_with_dropped_term(fault, Relative(fault.plant(sound.scene))), own.states)
    observable = _first_failing(own, faulty, MOTION) is not None
    lost = None if seen else _first_failing(faulty, samples, EQUATION_LEVELS[:1])
    return Found(fault, name, seen, moves, observable, lost, alone)


def _first_failing(one: Samples, other: Samples, levels: Sequence[Level]) -> Sighting | None:
    try:
        for row in compare_pair(("one", "other"), [one], [other], levels):
            if not row.agrees:
                return Sighting.of(row)
    except NewtonEulerError as error:
        return _refusal(error, "")
    return None


def _refusal(error: NewtonEulerError, engine: str) -> Sighting:
    """The error of an engine as a sighting; where is the joint or body that it is about."""
    element = getattr(error, "joint", getattr(error, "element", ""))
    named = re.search(r"'(.*)'", element)
    where = named[1] if named else element
    return Sighting(REFUSED, str(error), (engine,), np.nan, np.nan, where, odd=engine)


def find_in_reading(
    report: ImportReport, progress: Callable[[str], None], faults: Sequence[Fault] | None = None
) -> Search:
    """Plant faults, all that there are if None are given, one at a time, and verify the scene with each."""
    reference, scene = report.references[-1]
    own = samples_of(scene)
    faults = list(misreadings(scene)) if faults is None else faults
    found = [_found_in_reading(fault, reference, own, report) for _, fault in _counted(faults, progress)]
    return Search(tuple(found), (READING,), {}, smallest=0.0)


def _found_in_reading(fault: Fault, reference: ReferenceModel, own: Samples, report: ImportReport) -> Found:
    """Verify a scene with one fault; one that is not seen is looked for in the motion."""
    try:
        planted = fault.plant(own.states.scene)
        figures = verify(reference, Relative(planted))
        failing = next((figure for figure in figures if not figure.agrees), None)
    except NewtonEulerError as error:
        where = fault.element if fault.element in str(error) else ""
        refusal = Sighting(REFUSED, str(error), (READING,), np.nan, np.nan, where, odd=READING)
        return Found(fault, READING, refusal, None, True)
    if failing is None:
        rows = compare_pair(("right", "wrong"), [own], [Samples(Relative(planted), own.states)], MOTION)
        moves = any(not (row.agrees or row.quantity.startswith("reaction")) for row in rows)
        return Found(fault, READING, None, None, moves)
    named = any(_is_named(element, failing.where, report) for element in fault.right | fault.near)
    where = fault.element if named else failing.where
    place = failing.value, failing.tolerance, where
    seen = Sighting("verification", failing.quantity, (READING,), *place, odd=READING)
    return Found(fault, READING, seen, None, True)


def _is_named(element: str, where: str, report: ImportReport) -> bool:
    """True if the blamed element is this one, or one of the file's that became it."""
    if element in (where, EVERYTHING) or repr(element) in where:
        return True
    blamed = where.split(":")[0]
    return any(entry.element == blamed and repr(element) in entry.how for entry in report.entries)


def _planted(fault: Fault, engine: Engine, scene: Scene) -> System:
    """Return the engine's rigid system with the fault.

    A loop that does not close is refused by the mechanism, before an engine sees it. In MuJoCo it is planted
    in the compiled model, where nothing refuses it.
    """
    if fault.shift is None or engine.name != "mujoco":
        return _with_dropped_term(fault, engine.systems(fault.plant(scene))[0])
    from mjcf.rigid import RigidMuJoCo

    system = RigidMuJoCo(scene)
    system.move_anchor(fault.element, fault.shift)
    return system


def _with_dropped_term(fault: Fault, system: System) -> System:
    """Return equations without the velocity term that a fault drops, if it drops one."""
    return system if fault.hinge is None else without_turning(system, fault.hinge)
