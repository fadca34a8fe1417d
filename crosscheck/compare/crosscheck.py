"""A crosscheck: one scene is simulated in several engines, and the engines are compared.

`crosscheck` executes all stages: runs, checks, diagnosis, coverage and advice. The command `crosscheck run`
and the Python function `crosscheck.check` call this module.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from crosscheck.compare.activity import watched, what_acted
from crosscheck.compare.advice import Advice, redundancy_advice
from crosscheck.compare.check import Check, require_finite
from crosscheck.compare.coverage import Coverage, coverage
from crosscheck.compare.levels import in_order, reading_checks, stages
from crosscheck.compare.reference_values import ReferenceCheck, known_of, measure
from crosscheck.compare.result import JUDGING, ComparisonResult, diagnosed, misread
from crosscheck.compare.runs import measure_run_errors
from crosscheck.compare.singularity import SingularConfigurations, find_singular_configurations
from crosscheck.compare.wording import verdict_of
from crosscheck.engines.engine import Engine
from crosscheck.engines.engine_runs import Stop, collecting_errors, run_engines, stops_text
from crosscheck.own_run.judge import Judgement, judge
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import SHORTER_RUN_ADVICE, limited
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import Event
from newton_euler.reading.import_report import ImportReport

MIN_SAMPLED_VELOCITIES = 200
"""Smallest total number of velocities of the random states at which equations are compared."""

MIN_RANDOM_STATES, MAX_RANDOM_STATES = 4, 20
"""Range of the number of random states. Small mechanisms use more states: each state tests few joints."""

COVERAGE_OMITTED = "it is left out, the verdict does not depend on it"
"""Note on a coverage analysis that exceeds its time limit."""

MISREAD = "the scene does not match the file: no engine was run, and nothing else was compared"
"""Note on a crosscheck that ends because the imported scene differs from its model file."""

Progress = Callable[[str], None]
"""Function that shows a message to the user before each stage."""


@dataclass(frozen=True, eq=False)
class Crosscheck(ComparisonResult):
    """Result of a crosscheck: one scene in several engines."""

    @property
    def verdict(self) -> str:
        """Verdict in one line: agreement, or the outlier with the first failing check."""
        return verdict_of(self)


def crosscheck(
    scene: Scene,
    engines: Sequence[Engine],
    progress: Progress,
    source: str,
    options: Mapping[str, str],
    mapping: ImportReport | None = None,
    advised: bool = False,
) -> Crosscheck:
    """Simulate a scene in the engines and compare them.

    If an engine stops or a part of the comparison fails, everything else is still compared.

    Args:
        scene: scene to simulate, with the outputs velocities, reactions and violation.
        engines: engines to compare.
        progress: shows a message to the user before each stage.
        source: name or file that the scene was loaded from; empty if it was made in Python.
        options: options of the scene or file that the user set.
        mapping: import report of a model file; None for other scenes.
        advised: True to compute advice on redundant constraints, if all engines completed.

    Raises:
        CrosscheckError: for a scene without the required outputs, or if no engine runs and no check could be
            made.
        NewtonEulerError: for a scene that no engine can represent.
    """
    for output in ("velocities", "reactions", "violation"):
        if output not in scene.outputs:
            raise CrosscheckError(f"scene {scene.name!r} does not ask for the output {output!r}, needed here")
    start = time.perf_counter()
    usable, left_out = _usable_engines(scene, engines)
    # Compare the equations with the model file; end here if the import is wrong
    rows: list[Check] = []
    file_stops: list[Stop] = []
    what = "comparing with the file"
    with collecting_errors(what, file_stops), limited(what, SHORTER_RUN_ADVICE, progress):
        for row in require_finite(reading_checks(usable, mapping)):
            rows.append(row)  # one by one, to keep the checks before an error
    if misread(usable, rows):
        return Crosscheck(
            source=source,
            options=options,
            scene=scene,
            engines=tuple(usable),
            left_out=left_out,
            trajectories={},
            checks=tuple(rows),
            measured=(),
            wall_time=time.perf_counter() - start,
            mapping=mapping,
            notes=(MISREAD,),
        )
    # Simulate the scene in all engines
    runs, stops = run_engines(scene, usable, progress)
    stopped = {stop.what for stop in stops}
    stops += file_stops
    # Find elements of the file that are not simulated but would act in the run
    note_stops: list[Stop] = []  # failures that do not affect the verdict
    if mapping and runs:
        what = "watching what was left out"
        imported, mapping = mapping, mapping.unwatched()  # kept if the search fails
        with collecting_errors(what, note_stops), limited(what, SHORTER_RUN_ADVICE, progress):
            mapping = watched(scene, imported, next(iter(runs.values())))
    # Judge the run that the file's own engine makes with the settings of the file
    own_run: Judgement | None = None
    if mapping and mapping.simulation and runs:
        acting = [Event(entry.since or 0.0, what_acted(entry)) for entry in mapping.acting]
        with collecting_errors(JUDGING, note_stops), limited(JUDGING, SHORTER_RUN_ADVICE, progress):
            own_run = judge(mapping.simulation, acting)
    until = mapping.acting[0].since if mapping and mapping.acting else None
    # Compare equations and runs; runs are not comparable if the scene does not determine its motion
    comparable = {} if any(stop.undetermined for stop in stops) else runs
    for what, stage in stages(scene, usable, comparable, _random_states(scene), until).items():
        with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
            for row in require_finite(stage(tuple(rows))):
                rows.append(row)
    if not (rows or runs):
        raise CrosscheckError(stops_text(stops))
    rows = in_order(rows)
    # Compare with reference values
    measured: list[ReferenceCheck] = []
    known = known_of(source, options)
    for engine in usable if known else ():
        if engine.name not in stopped:
            what = f"{engine.name}: reference values"
            with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
                measured.extend(measure(source, scene, engine, runs[engine.name], known))
    # Additional analyses: coverage, singular configurations, advice, and errors of runs
    covered: Coverage | None = None
    what = "working out what the motion covers"
    with collecting_errors(what, note_stops), limited(what, COVERAGE_OMITTED, progress, "coverage_time"):
        covered = coverage(scene, comparable, rows)
    singular: SingularConfigurations | None = None
    what = "searching singular configurations"
    with collecting_errors(what, note_stops), limited(what, SHORTER_RUN_ADVICE, progress):
        singular = find_singular_configurations(scene, next(iter(runs.values()))) if runs else None
    advice: tuple[Advice, ...] = ()
    if advised and not stops:
        what = "working out advice"
        with collecting_errors(what, note_stops), limited(what, "there is none", progress):
            advice = tuple(redundancy_advice(scene))
    run_errors: dict[str, float] = {}
    outliers = {diagnosis.outlier for diagnosis in diagnosed(scene, usable, rows, measured, stops)}
    what = "measuring each engine's error"
    with collecting_errors(what, note_stops), limited(what, SHORTER_RUN_ADVICE, progress):
        trusted = [engine for engine in usable if engine.name not in outliers]
        run_errors = measure_run_errors(scene, trusted, comparable)
    return Crosscheck(
        source=source,
        options=options,
        scene=scene,
        engines=tuple(usable),
        left_out=left_out,
        trajectories=runs,
        checks=tuple(rows),
        measured=tuple(measured),
        wall_time=time.perf_counter() - start,
        mapping=mapping,
        advice=advice,
        unfinished=tuple(stops),
        coverage=covered,
        notes=tuple(map(str, note_stops)),
        run_errors=run_errors,
        singular=singular,
        own_run=own_run,
    )


def _random_states(scene: Scene) -> int:
    """Return the number of random states at which equations are compared."""
    velocities = max(1, SpanningTree(scene.mechanism).nv)
    states = -(-MIN_SAMPLED_VELOCITIES // velocities)  # rounded up
    return max(MIN_RANDOM_STATES, min(MAX_RANDOM_STATES, states))


def _usable_engines(scene: Scene, engines: Sequence[Engine]) -> tuple[list[Engine], dict[str, str]]:
    """Find the engines that can represent a scene.

    Returns:
        These engines, and the reason for each other engine. The refined run and the equations of each engine
        are cached, since several checks use them.

    Raises:
        NewtonEulerError: the error of the first engine, if no engine can represent the scene.
    """
    usable, errors = [], {}
    for engine in engines:
        refined = lru_cache(_naming_refined_run(engine))
        cached = replace(engine, refined=refined, systems=lru_cache(engine.systems))
        try:
            cached.systems(scene)
        except NewtonEulerError as error:
            errors[engine.name] = error
        else:
            usable.append(cached)
    if not usable:
        raise errors[engines[0].name]
    return usable, {name: str(error) for name, error in errors.items()}


def _naming_refined_run(engine: Engine) -> Callable[[Scene], Trajectory]:
    """Return the engine's function for refined runs, with errors that name the engine and the purpose."""

    def refined(scene: Scene) -> Trajectory:
        name = f"{engine.name}, in a finer run for comparison"
        try:
            return engine.refined(scene)
        except NewtonEulerError as error:
            error.args = (f"{name}: {error}",)
            raise
        except Exception as error:
            raise CrosscheckError(f"{name}: {reason_of(error)}") from error

    return refined
