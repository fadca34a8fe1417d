"""Search for injected faults: which faults are detected, and whether the diagnosis locates them correctly.

A fault is a single error in a model, such as a wrong mass. There are two searches. `find_faults` injects
faults into the model of one engine, such as MuJoCo; the comparison of the engines'
equations of motion must detect them. `find_in_reading` injects faults into a scene that was read from a model
file; the verification of the scene against the file must detect them. This scene has random controls, so that
every actuator acts. A fault that is not detected must be unobservable: newton_euler's equations are the same
with and without the fault.

A check compares one value of two engines with a tolerance. A level is a group of checks. `Samples` are the
equations of one engine, evaluated at some states. The diagnosis of all checks names the outlier, the engine
that differs from the others, and the body, joint or term at fault.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from crosscheck.compare.check import Check
from crosscheck.compare.diagnosis import Diagnosis
from crosscheck.compare.levels import EQUATION_LEVELS, Level, compare_pair
from crosscheck.compare.outlier import diagnose
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import ENGINES, EngineError, choose
from crosscheck.engines.usable import Reasons, failure, require_scene
from crosscheck.studies.faults.catalog import FAULT_SIZES, Fault, catalog
from crosscheck.studies.faults.misreadings import ALL_BODIES, misreadings
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
"""Smallest relative size of the faults of engines that must all be detected."""

MODEL_LEVELS, MOTION_LEVELS = EQUATION_LEVELS[:1], EQUATION_LEVELS[1:]
"""Levels (functions that yield their checks) that compare the numbers of the model, such as masses, and that
compare its motion: poses, velocities, energies, accelerations and reactions."""

REFUSED = "refused"
"""Level of the detection of a fault with which an engine, or the mechanism, raises an error."""

READING = "the import"
"""Name in place of the engine's name if faults are injected into a scene that was read from a file."""


@dataclass(frozen=True)
class Detection(Check):
    """First failing check that shows a fault. At the level `REFUSED`, `quantity` is the text of an error.

    The other attributes are those of `Check`: level, compared quantity, names of the compared engines, value,
    tolerance, and body, joint or term of the largest difference (`where`).

    Attributes:
        outlier: engine that the diagnosis finds to differ from the others; empty if the checks do not
            determine one.
    """

    outlier: str = ""

    @classmethod
    def of(cls, found: Check | Diagnosis, outlier: str = "") -> Detection:
        """Make a detection from a failing check, or from a diagnosis, which has the values of a check."""
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
        detection: detection by all levels of equations, or by the verification against a file; None if all
            checks pass.
        detection_by_motion: detection by `MOTION_LEVELS` alone; None if all their checks pass, and for faults
            in the reading.
        observable: True if the fault, or the same fault of another size, changes a pose, velocity, energy,
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
        """True if the diagnosis names the engine with the fault, and a body, joint or term at fault: one of
        `Fault.expected`."""
        return self._names(self.detection, self.fault.expected)

    @property
    def located_by_motion(self) -> bool:
        """True if the diagnosis from motion alone names the engine with the fault, and an element at fault
        or a body next to it (`Fault.neighbors`)."""
        return self._names(self.detection_by_motion, self.fault.expected | self.fault.neighbors)

    def _names(self, detection: Detection | None, elements: frozenset[str]) -> bool:
        """Return True if a detection names the engine with the fault, and one of the elements.

        Two engines alone determine no outlier: then it is enough that the detection names none.
        """
        if detection is None or detection.where not in elements:
            return False
        return detection.outlier == self.engine or (self.few_engines and not detection.outlier)


@dataclass(frozen=True)
class FaultSearch:
    """Results of the search for all faults of a scene.

    Attributes:
        found: result for each fault.
        engines: names of the engines with faults, or `READING`. Engines take the faults alternately.
        left_out: reasons by name of the engines that cannot express the scene or have no equations.
        smallest: smallest relative size of the faults that must all be detected.
    """

    found: tuple[FaultResult, ...]
    engines: tuple[str, ...]
    left_out: dict[str, str]
    smallest: float = SMALLEST_REQUIRED


def find_faults(
    scene: Scene,
    progress: Callable[[str], None],
    sizes: Sequence[float] = FAULT_SIZES,
    names: Sequence[str] = tuple(ENGINES),
) -> FaultSearch:
    """Inject all faults of a scene, one at a time, and search for each by comparing the engines.

    Args:
        scene: the scene without a fault.
        progress: called with the number of faults so far, after every tenth fault.
        sizes: relative sizes of the faults.
        names: names of the engines that take the faults, alternately. They are compared with each other and
            with the default engines.

    Raises:
        CrosscheckError: if the engines disagree on the scene without a fault.
        CrosscheckError, NewtonEulerError: the reason of the first named engine, if none can take the faults.
    """
    named = choose(names)
    compared = {engine.name: engine for engine in (*ENGINES.values(), *named)}
    fault_free = FaultFree(scene, list(compared.values()))
    engines = [engine for engine in named if engine.name in fault_free.engines]
    if not engines:
        raise fault_free.refusals[named[0].name]
    faults = catalog(scene, sizes)
    found = [
        find_fault(fault, engines[number % len(engines)], fault_free)
        for number, fault in _with_progress(faults, progress)
    ]
    left_out = {name: str(error) for name, error in fault_free.refusals.items()}
    return FaultSearch(tuple(_with_other_sizes(found)), tuple(engine.name for engine in engines), left_out)


def _with_progress(faults: Sequence[Fault], progress: Callable[[str], None]) -> Iterator[tuple[int, Fault]]:
    """Yield the faults with their numbers, and report every tenth to `progress`."""
    for number, fault in enumerate(faults):
        if number % 10 == 0:
            progress(f"{number} of {len(faults)} faults: {fault.name}")
        yield number, fault


def _with_other_sizes(found: Sequence[FaultResult]) -> Iterator[FaultResult]:
    """Yield the results; a fault becomes observable if the same fault of another size is observable."""
    observable = {each.fault.identity for each in found if each.observable}
    for each in found:
        yield replace(each, observable=each.fault.identity in observable)


def samples_of(scene: Scene) -> Samples:
    """Return newton_euler's equations of a scene with the states at which comparisons evaluate them.

    The states are the initial state and random states that satisfy all constraints.
    """
    states = initial_state(scene), *random_states(scene, RANDOM_STATES)
    return Samples(Relative(scene), States(scene, states))


class FaultFree:
    """Equations of all engines for a scene without a fault, at its initial state and at random states.

    Attributes:
        scene: the scene without a fault.
        engines: engines that can express the scene and have equations of motion, by name, newton_euler first.
        refusals: errors of the other engines, by name.
        samples: newton_euler's equations with these states.

    Raises:
        CrosscheckError: if the engines disagree on the scene.
    """

    def __init__(self, scene: Scene, engines: Sequence[Engine] | None = None) -> None:
        # Equations of each engine, in the first of its formulations (choices of coordinates)
        self.scene, self.samples = scene, samples_of(scene)
        self.engines: dict[str, Engine] = {}
        self.refusals: Reasons = {}
        self._samples_of_engine: dict[str, Samples] = {}
        for engine in ENGINES.values() if engines is None else engines:
            if error := failure(engine, self._evaluate):
                self.refusals[engine.name] = error
            else:
                self.engines[engine.name] = engine
        # Checks of each pair of engines, which must all pass
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

    def _evaluate(self, engine: Engine) -> None:
        """Make the equations of an engine, and keep them with the states."""
        require_scene(engine, self.scene)
        system, *_ = engine.systems(self.scene) or (None,)
        if system is None:
            raise EngineError(f"fault injection needs equations of motion; {engine.name} has none")
        self._samples_of_engine[engine.name] = Samples(system, self.samples.states)

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
            for pair, fault_free_checks in self._checks.items():
                checks += self._compare(pair, samples, levels) if name in pair else fault_free_checks
        except NewtonEulerError as error:
            return _refusal(error, name)
        diagnoses = diagnose(tuple(samples), checks)
        return Detection.of(diagnoses[0], diagnoses[0].outlier) if diagnoses else None


def find_fault(fault: Fault, engine: Engine, fault_free: FaultFree) -> FaultResult:
    """Inject one fault into one engine's model, and compare the engine with the others.

    Args:
        fault: the fault.
        engine: engine whose model gets the fault.
        fault_free: equations of all engines for the scene without the fault.
    """
    # Make the engine's equations with the fault
    name, without_fault, few_engines = engine.name, fault_free.samples, len(fault_free.engines) < 3
    try:
        with_fault = Samples(_with_fault(fault, engine, fault_free.scene), without_fault.states)
    except NewtonEulerError as error:
        refusal = _refusal(error, name)
        return FaultResult(
            fault,
            name,
            detection=refusal,
            detection_by_motion=refusal,
            observable=True,
            few_engines=few_engines,
        )
    # Compare the engines, by all levels and by the levels of motion alone. If the numbers of the model agree,
    # the first detection already comes from the levels of motion.
    detection = fault_free.detect(name, with_fault, EQUATION_LEVELS)
    by_motion = detection
    if detection is not None and detection.level == "model":
        by_motion = fault_free.detect(name, with_fault, MOTION_LEVELS)
    if by_motion is not None:
        return FaultResult(fault, name, detection, by_motion, observable=True, few_engines=few_engines)
    # Compare newton_euler's equations with and without the fault: does the fault change the motion?
    expected = Samples(_without_term(fault, Relative(fault.inject(fault_free.scene))), without_fault.states)
    observable = _first_failing(without_fault, expected, MOTION_LEVELS) is not None
    # If no engine differs: does the engine's model have the fault at all?
    model_difference = None if detection else _first_failing(expected, with_fault, MODEL_LEVELS)
    return FaultResult(
        fault,
        name,
        detection,
        detection_by_motion=None,
        observable=observable,
        model_difference=model_difference,
        few_engines=few_engines,
    )


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
    """Return the error of an engine as a detection at the joint or body that the error quotes in its
    attribute `joint` or `element`."""
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
    # pairs of the file's model and the scene with the same controls; the last pair has random controls
    reference, scene = report.references[-1]
    without_fault = samples_of(scene)
    faults = list(misreadings(scene)) if faults is None else faults
    found = [
        _find_fault_in_reading(fault, reference, without_fault, report)
        for _, fault in _with_progress(faults, progress)
    ]
    return FaultSearch(tuple(found), (READING,), left_out={}, smallest=0.0)


def _find_fault_in_reading(
    fault: Fault, reference: ReferenceModel, without_fault: Samples, report: ImportReport
) -> FaultResult:
    """Verify a scene with one fault against the file's own model.

    Args:
        fault: the fault.
        reference: the file's own model.
        without_fault: newton_euler's equations without the fault, with some states.
        report: import report of the file.
    """
    # The first failing check of the verification
    try:
        injected = fault.inject(without_fault.states.scene)
        checks = verify(reference, Relative(injected))
        failing = next((check for check in checks if not check.agrees), None)
    except NewtonEulerError as error:
        where = fault.element if fault.element in str(error) else ""
        refusal = Detection(REFUSED, str(error), (READING,), np.nan, np.nan, where, outlier=READING)
        return FaultResult(fault, READING, refusal, detection_by_motion=None, observable=True)
    # If the verification passes: does the fault change the motion? Reactions are not part of a file
    if failing is None:
        with_fault = Samples(Relative(injected), without_fault.states)
        rows = compare_pair(("right", "wrong"), [without_fault], [with_fault], MOTION_LEVELS)
        observable = any(not (row.agrees or row.quantity.startswith("reaction")) for row in rows)
        return FaultResult(fault, READING, detection=None, detection_by_motion=None, observable=observable)
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
    return FaultResult(fault, READING, detection, detection_by_motion=None, observable=True)


def _is_named(element: str, where: str, report: ImportReport) -> bool:
    """Return True if a failing check names an element of the scene, or the element of the file it comes from.

    Args:
        element: name of the element of the scene, or `ALL_BODIES` for a fault in all bodies, which any place
            names.
        where: place of the failing check.
        report: import report of the file.
    """
    if element in (where, ALL_BODIES) or repr(element) in where:
        return True
    # `where` begins with an element of the file; the report tells how it was imported, as which elements
    element_of_file = where.split(":")[0]
    return any(entry.element == element_of_file and repr(element) in entry.how for entry in report.entries)


def _with_fault(fault: Fault, engine: Engine, scene: Scene) -> System:
    """Return the equations of motion, in the engine's first formulation, for the scene with the fault.

    A scene whose loop cannot be closed raises an error before an engine evaluates it. A wrong point of a
    loop-closing joint is therefore injected into the compiled model of an engine that has anchors.
    """
    if fault.closure_shift is None or engine.with_moved_anchor is None:
        return _without_term(fault, engine.systems(fault.inject(scene))[0])
    return engine.with_moved_anchor(scene, fault.element, fault.closure_shift)


def _without_term(fault: Fault, system: System) -> System:
    """Return the equations without the velocity term (omega x axis v) of a hinge, if the fault drops it."""
    return system if fault.hinge is None else without_velocity_term(system, fault.hinge)
