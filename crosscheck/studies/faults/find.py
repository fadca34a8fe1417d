"""Search for injected faults: which faults are detected, and whether the diagnosis locates them correctly.

There are two searches. `find_faults` injects faults into the model of one engine; the comparison of engines
must detect them. `find_in_reading` injects faults into a scene that was read from a model file; the
verification of the scene against the file must detect them. This scene has random controls, so that every
actuator acts. A fault that is not detected must change nothing: newton_euler's equations are then the same
with and without the fault.
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
from crosscheck.studies.faults.velocity_terms import without_velocity_term
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
"""Number of random states, in addition to the initial state, at which equations are compared.

Fewer states do not separate the components of gravity.
"""

SMALLEST_REQUIRED = 1e-4
"""Relative size down to which all faults of engines must be detected."""

MOTION_LEVELS = EQUATION_LEVELS[1:]
"""Levels (groups of checks) that compare the motion: all levels except the first, which compares the numbers
of the model, such as masses."""

REFUSED = "refused"
"""Level of the detection of a fault with which an engine, or the mechanism, raises an error."""

READING = "the reading"
"""Name in place of the engine's name if faults are injected into a scene that was read from a file."""


@dataclass(frozen=True)
class Detection(Check):
    """First failing check that shows a fault. At the level `REFUSED`, `quantity` is the text of an error.

    Attributes:
        outlier: engine that the diagnosis finds to differ from the others; empty if the checks do not
            determine one.
    """

    outlier: str = ""

    @classmethod
    def of(cls, found: Check | Diagnosis, outlier: str = "") -> Detection:
        """Make the detection of a failing check, or of the check that a diagnosis explains."""
        return cls(
            level=found.level,
            quantity=found.quantity,
            between=found.between if isinstance(found, Check) else found.differing,
            value=found.value,
            tolerance=found.tolerance,
            where=found.where,
            outlier=outlier,
        )


@dataclass(frozen=True)
class FaultResult:
    """Result of the search for one fault.

    Attributes:
        fault: the fault.
        engine: name of the engine with the fault, or `READING`.
        detection: detection by all levels of equations; None if all checks pass.
        detection_by_motion: detection by `MOTION_LEVELS` alone; None if all their checks pass.
        observable: True if the fault, or a larger one of its kind, changes a pose, velocity, energy,
            acceleration or reaction. If no check of motion fails, newton_euler's equations with and without
            the fault are compared to find this out.
        model_difference: for a fault that is not detected, the first failing check between newton_euler's
            model with the fault and the engine's model. The engine's model does not contain the fault then.
        few_engines: True if fewer than three engines can express the scene, so that the majority of engines
            cannot determine which engine has the fault.
    """

    fault: Fault
    engine: str
    detection: Detection | None
    detection_by_motion: Detection | None
    observable: bool
    model_difference: Detection | None = None
    few_engines: bool = False

    @property
    def is_detectable(self) -> bool:
        """True if the fault can be detected: from the model's numbers, or from the motion."""
        return self.detection is not None or self.observable

    @property
    def located(self) -> bool:
        """True if the diagnosis names the engine with the fault, and the body, joint or term at fault."""
        return self._names(self.detection, self.fault.expected)

    @property
    def located_by_motion(self) -> bool:
        """True if the diagnosis from motion alone names the engine and the element, or a body next to it."""
        return self._names(self.detection_by_motion, self.fault.expected | self.fault.neighbors)

    def _names(self, detection: Detection | None, right: frozenset[str]) -> bool:
        """Return True if a detection names the engine with the fault and one of the elements `right`."""
        if detection is None or detection.where not in right:
            return False
        return detection.outlier == self.engine or (self.few_engines and not detection.outlier)


@dataclass(frozen=True)
class FaultSearch:
    """Results of the search for all faults of a scene.

    Attributes:
        found: result for each fault.
        engines: names of the engines with faults, or `READING`. Engines take the faults alternately.
        left_out: for each engine that cannot express the scene, the reason.
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
        progress: called with the number of faults so far, after every tenth fault.
        sizes: relative sizes of the faults.
        names: names of engines out of `INJECTED_ENGINES`; the engines take the faults alternately.

    Raises:
        CrosscheckError: if the engines disagree on the scene without a fault.
        NewtonEulerError: if no engine can express the scene.
    """
    fault_free = FaultFree(scene)
    engines = [fault_free.engines[name] for name in names if name in fault_free.engines]
    if not engines:
        raise fault_free.refusals[names[0]]
    faults = catalog(scene, sizes)
    counted = _with_progress(faults, progress)
    found = [find_fault(fault, engines[number % len(engines)], fault_free) for number, fault in counted]
    left_out = {name: str(error) for name, error in fault_free.refusals.items()}
    return FaultSearch(tuple(_observable(found)), tuple(engine.name for engine in engines), left_out)


def _with_progress(faults: Sequence[Fault], progress: Callable[[str], None]) -> Iterator[tuple[int, Fault]]:
    """Yield the faults with their numbers, and report every tenth to `progress`."""
    for number, fault in enumerate(faults):
        if number % 10 == 0:
            progress(f"{number} of {len(faults)} faults: {fault.name}")
        yield number, fault


def _observable(found: Sequence[FaultResult]) -> Iterator[FaultResult]:
    """Mark a fault as observable if the same fault of another size is: its size is only too small."""
    observable = {each.fault.identity for each in found if each.observable}
    for each in found:
        yield replace(each, observable=each.fault.identity in observable)


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
        samples: newton_euler's equations, evaluated at the states.

    Raises:
        CrosscheckError: if the engines disagree on the scene.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.samples = scene, samples_of(scene)
        self.engines: dict[str, Engine] = {}
        self.refusals: dict[str, NewtonEulerError] = {}
        self._samples_of_engine: dict[str, Samples] = {}
        for name, engine in ENGINES.items():
            try:
                system = engine.systems(scene)[0]
            except NewtonEulerError as error:
                self.refusals[name] = error
                continue
            self.engines[name] = engine
            self._samples_of_engine[name] = Samples(system, self.samples.states)
        pairs = combinations(self._samples_of_engine, 2)
        self._checks = {
            pair: list(self._compare(pair, self._samples_of_engine, EQUATION_LEVELS)) for pair in pairs
        }
        for (one, other), checks in self._checks.items():
            for check in checks:
                if not check.agrees:
                    raise CrosscheckError(
                        f"{one} and {other} differ on scene {scene.name!r} without a fault, at level "
                        f"{check.level!r}: {check.quantity}; for details run `crosscheck run`"
                    )

    def _compare(
        self, pair: tuple[str, str], samples: dict[str, Samples], levels: Sequence[Level]
    ) -> Iterator[Check]:
        """Compare the samples of two engines at some levels."""
        return compare_pair(pair, [samples[pair[0]]], [samples[pair[1]]], levels)

    def detect(self, name: str, faulty: Samples, levels: Sequence[Level]) -> Detection | None:
        """Compare all engines, one of them with a fault; return the first detection, None if all checks pass.

        Args:
            name: name of the engine with the fault.
            faulty: samples of this engine's equations with the fault.
            levels: levels of the comparison.
        """
        samples = self._samples_of_engine | {name: faulty}
        checks: list[Check] = []
        try:
            for pair, known in self._checks.items():
                checks += self._compare(pair, samples, levels) if name in pair else known
        except NewtonEulerError as error:
            return _refusal(error, name)
        for found in diagnose(tuple(samples), checks)[:1]:
            return Detection.of(found, found.outlier)
        return None


def find_fault(fault: Fault, engine: Engine, fault_free: FaultFree) -> FaultResult:
    """Inject one fault into one engine's model, and compare the engine with the others.

    Args:
        fault: the fault.
        engine: engine whose model gets the fault.
        fault_free: equations of all engines for the scene without the fault.
    """
    # Evaluate the engine's equations with the fault
    name, own, few_engines = engine.name, fault_free.samples, len(fault_free.engines) < 3
    try:
        samples = Samples(_with_fault(fault, engine, fault_free.scene), own.states)
    except NewtonEulerError as error:
        refusal = _refusal(error, name)
        return FaultResult(fault, name, refusal, refusal, observable=True, few_engines=few_engines)
    # Compare the engines, by all levels and by the levels of motion alone. If the numbers of the model agree,
    # the first detection already comes from the levels of motion.
    detection = fault_free.detect(name, samples, EQUATION_LEVELS)
    by_motion = detection
    if detection is not None and detection.level == "model":
        by_motion = fault_free.detect(name, samples, MOTION_LEVELS)
    if by_motion is not None:
        return FaultResult(fault, name, detection, by_motion, observable=True, few_engines=few_engines)
    # Compare newton_euler's equations with and without the fault: does the fault change anything?
    faulty = Samples(_without_term(fault, Relative(fault.inject(fault_free.scene))), own.states)
    observable = _first_failing(own, faulty, MOTION_LEVELS) is not None
    difference = None if detection else _first_failing(faulty, samples, EQUATION_LEVELS[:1])
    return FaultResult(fault, name, detection, None, observable, difference, few_engines)


def _first_failing(one: Samples, other: Samples, levels: Sequence[Level]) -> Detection | None:
    """Return the first failing check between two samples of equations; None if all checks pass."""
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
    """Inject faults into a scene that was read from a file, and verify it against the file with each fault.

    Args:
        report: import report of the file, which holds the file's own model and the scene.
        progress: called with the number of faults so far, after every tenth fault.
        faults: the faults; all `misreadings` of the scene if None.
    """
    # the last pair has random controls, in which every actuator acts
    reference, scene = report.references[-1]
    own = samples_of(scene)
    faults = list(misreadings(scene)) if faults is None else faults
    found = [
        _find_fault_in_reading(fault, reference, own, report) for _, fault in _with_progress(faults, progress)
    ]
    return FaultSearch(tuple(found), (READING,), {}, smallest=0.0)


def _find_fault_in_reading(
    fault: Fault, reference: ReferenceModel, own: Samples, report: ImportReport
) -> FaultResult:
    """Verify a scene with one fault against the file's own model.

    Args:
        fault: the fault.
        reference: the file's own model.
        own: newton_euler's equations without the fault, evaluated at some states.
        report: import report of the file.
    """
    # The first failing check of the verification
    try:
        injected = fault.inject(own.states.scene)
        checks = verify(reference, Relative(injected))
        failing = next((check for check in checks if not check.agrees), None)
    except NewtonEulerError as error:
        where = fault.element if fault.element in str(error) else ""
        refusal = Detection(REFUSED, str(error), (READING,), np.nan, np.nan, where, outlier=READING)
        return FaultResult(fault, READING, refusal, None, observable=True)
    # If the verification passes: does the fault change the motion?
    if failing is None:
        faulty = Samples(Relative(injected), own.states)
        rows = compare_pair(("right", "wrong"), [own], [faulty], MOTION_LEVELS)
        observable = any(not (row.agrees or row.quantity.startswith("reaction")) for row in rows)
        return FaultResult(fault, READING, None, None, observable)
    # Does the failing check name the element at fault?
    named = any(_is_named(element, failing.where, report) for element in fault.expected | fault.neighbors)
    where = fault.element if named else failing.where
    detection = Detection(
        level="verification",
        quantity=failing.quantity,
        between=(READING,),
        value=failing.value,
        tolerance=failing.tolerance,
        where=where,
        outlier=READING,
    )
    return FaultResult(fault, READING, detection, None, observable=True)


def _is_named(element: str, where: str, report: ImportReport) -> bool:
    """Return True if a failing check names an element of the scene, or the element of the file it comes from.

    Args:
        element: name of the element of the scene, or `EVERYTHING`.
        where: place of the failing check.
        report: import report of the file.
    """
    if element in (where, EVERYTHING) or repr(element) in where:
        return True
    named = where.split(":")[0]
    return any(entry.element == named and repr(element) in entry.how for entry in report.entries)


def _with_fault(fault: Fault, engine: Engine, scene: Scene) -> System:
    """Return the engine's equations of motion for the scene with the fault.

    A mechanism with a loop that does not close raises an error before any engine evaluates it. For MuJoCo
    such a fault is therefore injected into the compiled model.
    """
    if fault.closure_shift is None or engine.name != "mujoco":
        return _without_term(fault, engine.systems(fault.inject(scene))[0])
    from mjcf.rigid import RigidMuJoCo

    system = RigidMuJoCo(scene)
    system.move_anchor(fault.element, fault.closure_shift)
    return system


def _without_term(fault: Fault, system: System) -> System:
    """Return the equations without the velocity term that the fault drops; unchanged for other faults."""
    return system if fault.hinge is None else without_velocity_term(system, fault.hinge)
