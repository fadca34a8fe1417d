"""Search for injected faults: which faults are detected, and whether the diagnosis locates them correctly.

Faults of an engine's model are searched by the comparison of engines. Faults of a reading are injected after
a model file was read, into the scene with random controls, in which every actuator acts. The verification of
readings searches them. A fault that is not detected must change nothing: newton_euler's equations are then
the same with and without it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from crosscheck.compare.check import Check
from crosscheck.compare.diagnosis import Diagnosis, diagnose
from crosscheck.compare.levels import EQUATION_LEVELS, Level, compare_pair
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.engine import ENGINES, Engine
from crosscheck.studies.faults import INJECTED_ENGINES
from crosscheck.studies.faults.catalog import FAULT_SIZES, Fault, catalog
from crosscheck.studies.faults.misreadings import EVERYTHING, misreadings
from crosscheck.studies.faults.velocity_terms import without_turning
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

RANDOM_STATES = 4
"""Number of random consistent states besides the initial one; fewer do not separate the components of
gravity."""

SMALLEST_REQUIRED = 1e-4
"""Relative size down to which all faults of engines must be detected."""

MOTION_LEVELS = EQUATION_LEVELS[1:]
"""Levels of the comparison that see the motion of a model, not its numbers."""

REFUSED = "refused"
"""Level of a fault with which an engine, or the mechanism, raises an error."""

READING = "the reading"
"""Name that stands for the engine if faults are injected into a reading."""


@dataclass(frozen=True)
class Detection(Check):
    """First failing check that shows a fault. At the level `REFUSED` its quantity is the text of the error.

    Attributes:
        outlier: the outlier that the diagnosis names; empty if the checks do not determine it.
    """

    outlier: str = ""

    @classmethod
    def of(cls, figure: Check | Diagnosis, outlier: str = "") -> Detection:
        """Make the detection of a failing check, or of the check that a diagnosis explains."""
        between = figure.between if isinstance(figure, Check) else figure.differing
        place = figure.value, figure.tolerance, figure.where
        return cls(figure.level, figure.quantity, between, *place, outlier=outlier)


@dataclass(frozen=True)
class FaultResult:
    """Result of the search for one fault.

    Attributes:
        fault: the fault.
        engine: name of the engine with the fault.
        seen: first detection at the levels of equations; None if all checks pass.
        moves: first detection at the levels after the model, from motion alone.
        observable: True if the fault, or a larger one of its kind, changes a pose, velocity, energy,
            acceleration or reaction. If no motion shows the fault, newton_euler's equations with and without
            it are compared at the states.
        lost: for a fault that is not detected, where newton_euler with the fault differs from the engine's
            model: the engine's model does not contain the fault.
        alone: True if fewer than three engines can express the scene, so that no engine can be an outlier.
    """

    fault: Fault
    engine: str
    seen: Detection | None
    moves: Detection | None
    observable: bool
    lost: Detection | None = None
    alone: bool = False

    @property
    def counts(self) -> bool:
        """True if the fault can be detected: from the model's numbers, or from the motion."""
        return self.seen is not None or self.observable

    @property
    def located(self) -> bool:
        """True if the diagnosis names the engine with the fault, and the body, joint or term at fault."""
        return self._names(self.seen, self.fault.right)

    @property
    def located_by_motion(self) -> bool:
        """True if the diagnosis from motion alone names the engine and the element, or a body next to it."""
        return self._names(self.moves, self.fault.right | self.fault.near)

    def _names(self, detection: Detection | None, right: frozenset[str]) -> bool:
        if detection is None or detection.where not in right:
            return False
        return detection.outlier == self.engine or (self.alone and not detection.outlier)


@dataclass(frozen=True)
class FaultSearch:
    """Results of the search for all faults of a scene.

    Attributes:
        found: result for each fault.
        engines: names of the engines with faults, which alternate, or `READING`.
        left_out: reason by engine that cannot express the scene.
        smallest: relative size down to which all faults must be detected.
    """

    found: tuple[FaultResult, ...]
    engines: tuple[str, ...]
    left_out: dict[str, str]
    smallest: float = SMALLEST_REQUIRED


def find_faults(
    scene: Scene,
    progress: Callable[[str], None],
    sizes: Sequence[float] = FAULT_SIZES,
    names: Sequence[str] = INJECTED_ENGINES,
) -> FaultSearch:
    """Inject all faults of a scene, one at a time, and search for each by comparing the engines.

    Args:
        scene: the scene without a fault.
        progress: called with the number of faults so far.
        sizes: relative sizes of the faults.
        names: engines out of `INJECTED_ENGINES`; they take the faults alternately.

    Raises:
        CrosscheckError: if the engines disagree on the scene without a fault.
        NewtonEulerError: if no engine can express the scene.
    """
    sound = FaultFree(scene)
    engines = [sound.engines[name] for name in names if name in sound.engines]
    if not engines:
        raise sound.refusals[names[0]]
    faults = catalog(scene, sizes)
    counted = _counted(faults, progress)
    found = [find(fault, engines[number % len(engines)], sound) for number, fault in counted]
    left_out = {name: str(error) for name, error in sound.refusals.items()}
    return FaultSearch(tuple(_observable(found)), tuple(engine.name for engine in engines), left_out)


def _counted(faults: Sequence[Fault], progress: Callable[[str], None]) -> Iterator[tuple[int, Fault]]:
    """Yield the faults with their numbers, and report every tenth to `progress`."""
    for number, fault in enumerate(faults):
        if number % 10 == 0:
            progress(f"{number} of {len(faults)} faults: {fault.name}")
        yield number, fault


def _observable(found: Sequence[FaultResult]) -> Iterator[FaultResult]:
    """Mark a fault as observable if a larger one of its kind is: it is only too small to be detected."""
    sights = {each.fault.alike for each in found if each.observable}
    for each in found:
        yield replace(each, observable=each.fault.alike in sights)


def samples_of(scene: Scene) -> Samples:
    """Evaluate newton_euler's equations at the initial state and at random states."""
    states = initial_state(scene), *random_states(scene, RANDOM_STATES)
    return Samples(Relative(scene), States(scene, states))


class FaultFree:
    """Equations of all engines for a scene without a fault, at its initial state and at random states.

    Attributes:
        scene: the scene without a fault.
        engines: engines that can express the scene, by name, newton_euler first.
        refusals: errors of the other engines, by name.
        own: newton_euler's equations at the states.

    Raises:
        CrosscheckError: if the engines disagree on the scene.
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
                        f"{one} and {other} differ on scene {scene.name!r} without a fault, at level "
                        f"{row.level!r}: {row.quantity}; for details run `crosscheck run`"
                    )

    def _compared(
        self, pair: tuple[str, str], samples: dict[str, Samples], levels: Sequence[Level]
    ) -> Iterator[Check]:
        return compare_pair(pair, [samples[pair[0]]], [samples[pair[1]]], levels)

    def diagnosed(self, name: str, faulty: Samples, levels: Sequence[Level]) -> Detection | None:
        """Diagnose all engines, with `faulty` as the samples of engine `name`; None if all checks pass."""
        samples = self._samples | {name: faulty}
        rows: list[Check] = []
        try:
            for pair, known in self._rows.items():
                rows += self._compared(pair, samples, levels) if name in pair else known
        except NewtonEulerError as error:
            return _refusal(error, name)
        for found in diagnose(tuple(samples), rows)[:1]:
            return Detection.of(found, found.outlier)
        return None


def find(fault: Fault, engine: Engine, sound: FaultFree) -> FaultResult:
    """Inject one fault into one engine's model, and compare the engine with the others."""
    name, own, alone = engine.name, sound.own, len(sound.engines) < 3
    try:
        samples = Samples(_with_fault(fault, engine, sound.scene), own.states)
    except NewtonEulerError as error:
        refusal = _refusal(error, name)
        return FaultResult(fault, name, refusal, refusal, True, alone=alone)
    seen = sound.diagnosed(name, samples, EQUATION_LEVELS)
    # if the numbers of the model agree, the diagnosis already comes from the levels of motion
    numbers = seen is not None and seen.level == "model"
    moves = sound.diagnosed(name, samples, MOTION_LEVELS) if numbers else seen
    if moves is not None:
        return FaultResult(fault, name, seen, moves, True, alone=alone)
    # compare newton_euler's equations with and without the fault: does it change anything?
    faulty = Samples(_with_dropped_term(fault, Relative(fault.inject(sound.scene))), own.states)
    observable = _first_failing(own, faulty, MOTION_LEVELS) is not None
    lost = None if seen else _first_failing(faulty, samples, EQUATION_LEVELS[:1])
    return FaultResult(fault, name, seen, moves, observable, lost, alone)


def _first_failing(one: Samples, other: Samples, levels: Sequence[Level]) -> Detection | None:
    try:
        for row in compare_pair(("one", "other"), [one], [other], levels):
            if not row.agrees:
                return Detection.of(row)
    except NewtonEulerError as error:
        return _refusal(error, "")
    return None


def _refusal(error: NewtonEulerError, engine: str) -> Detection:
    """Return the error of an engine as a detection at the joint or body that the error names."""
    element = getattr(error, "joint", getattr(error, "element", ""))
    named = re.search(r"'(.*)'", element)
    where = named[1] if named else element
    return Detection(REFUSED, str(error), (engine,), np.nan, np.nan, where, outlier=engine)


def find_in_reading(
    report: ImportReport, progress: Callable[[str], None], faults: Sequence[Fault] | None = None
) -> FaultSearch:
    """Inject faults into a reading, one at a time, and verify the scene with each against the model file.

    Args:
        report: import report of the reading.
        progress: called with the number of faults so far.
        faults: the faults; all `misreadings` if None.
    """
    reference, scene = report.references[-1]
    own = samples_of(scene)
    faults = list(misreadings(scene)) if faults is None else faults
    found = [_found_in_reading(fault, reference, own, report) for _, fault in _counted(faults, progress)]
    return FaultSearch(tuple(found), (READING,), {}, smallest=0.0)


def _found_in_reading(
    fault: Fault, reference: ReferenceModel, own: Samples, report: ImportReport
) -> FaultResult:
    """Verify a scene with one fault; if the verification passes, find out whether the fault changes the
    motion."""
    try:
        injected = fault.inject(own.states.scene)
        figures = verify(reference, Relative(injected))
        failing = next((figure for figure in figures if not figure.agrees), None)
    except NewtonEulerError as error:
        where = fault.element if fault.element in str(error) else ""
        refusal = Detection(REFUSED, str(error), (READING,), np.nan, np.nan, where, outlier=READING)
        return FaultResult(fault, READING, refusal, None, True)
    if failing is None:
        faulty = Samples(Relative(injected), own.states)
        rows = compare_pair(("right", "wrong"), [own], [faulty], MOTION_LEVELS)
        moves = any(not (row.agrees or row.quantity.startswith("reaction")) for row in rows)
        return FaultResult(fault, READING, None, None, moves)
    named = any(_is_named(element, failing.where, report) for element in fault.right | fault.near)
    where = fault.element if named else failing.where
    place = failing.value, failing.tolerance, where
    seen = Detection("verification", failing.quantity, (READING,), *place, outlier=READING)
    return FaultResult(fault, READING, seen, None, True)


def _is_named(element: str, where: str, report: ImportReport) -> bool:
    """Return True if the failing check is at the element, or at an element of the file that became it."""
    if element in (where, EVERYTHING) or repr(element) in where:
        return True
    named = where.split(":")[0]
    return any(entry.element == named and repr(element) in entry.how for entry in report.entries)


def _with_fault(fault: Fault, engine: Engine, scene: Scene) -> System:
    """Return the engine's rigid system with the fault.

    A mechanism with a loop that does not close is refused before an engine sees it. For MuJoCo such a fault
    is therefore injected into the compiled model.
    """
    if fault.shift is None or engine.name != "mujoco":
        return _with_dropped_term(fault, engine.systems(fault.inject(scene))[0])
    from mjcf.rigid import RigidMuJoCo

    system = RigidMuJoCo(scene)
    system.move_anchor(fault.element, fault.shift)
    return system


def _with_dropped_term(fault: Fault, system: System) -> System:
    """Return the equations without the velocity term that the fault drops, if the fault drops one."""
    return system if fault.hinge is None else without_turning(system, fault.hinge)
