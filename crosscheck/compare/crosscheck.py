"""A crosscheck: one scene is simulated in several engines, and the engines are compared.

A scene is a mechanism with its forces, inputs and initial state. Engines are simulators: newton_euler (this
project's solver), and others such as MuJoCo. `crosscheck` executes all stages: runs, checks, diagnosis (which
engine is the outlier), coverage (which elements of the scene the runs test) and advice. The command
`crosscheck run` and the Python function `crosscheck.check` call this module.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from crosscheck.compare.activity import acting_events, watched
from crosscheck.compare.advice import Advice, redundancy_advice
from crosscheck.compare.check import Check, require_finite
from crosscheck.compare.coverage import Coverage, coverage
from crosscheck.compare.levels import in_order, reading_checks, stages
from crosscheck.compare.participation import by_runs_only
from crosscheck.compare.reference_values import ReferenceCheck, known_of, measure
from crosscheck.compare.result import JUDGING, EngineComparison, diagnosed, misread
from crosscheck.compare.runs import measure_run_errors
from crosscheck.compare.singularity import SingularConfigurations, find_singular_configurations
from crosscheck.compare.wording import verdict_of
from crosscheck.engines.engine import Engine
from crosscheck.engines.engine_runs import Stop, collecting_errors, run_engines, stops_text
from crosscheck.engines.usable import divide, require_scene
from crosscheck.own_run.judge import Judgement, judge
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import SHORTER_RUN_ADVICE, limited
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.import_report import ImportReport

RANDOM_VELOCITIES = 200
"""Number of random joint velocities at which equations are compared: number of random states times number of
joint velocities of the mechanism. Small mechanisms use more states, because each state tests few joints."""

MIN_RANDOM_STATES, MAX_RANDOM_STATES = 4, 20
"""Limits of the number of random states, which take precedence over `RANDOM_VELOCITIES`."""

COVERAGE_OMITTED = "it is left out, the verdict does not depend on it"
"""Note on a coverage analysis that exceeds its time limit."""

MISREAD = "the scene does not match the file: no engine was run, and nothing else was compared"
"""Note on a crosscheck that ends because the imported scene differs from its model file."""

Progress = Callable[[str], None]
"""Function that shows a message to the user before each stage."""


@dataclass(frozen=True, eq=False)
class Crosscheck(EngineComparison):
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

    If an engine stops or a part of the comparison fails, everything else is still compared. Each part has a
    limit of processor time.

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
    # Compare the equations with the model file; end here if the import is wrong. A `Stop` is a part of the
    # crosscheck that did not complete, with the reason. `limited` stops a part at its time limit, with an
    # error message that contains the second argument
    checks: list[Check] = []
    file_stops: list[Stop] = []
    what = "comparing with the file"
    with collecting_errors(what, file_stops), limited(what, SHORTER_RUN_ADVICE, progress):
        for check in require_finite(reading_checks(usable, mapping)):
            checks.append(check)  # one by one, to keep the checks before an error
    if misread(checks):
        return Crosscheck(
            source=source,
            options=options,
            scene=scene,
            engines=tuple(usable),
            left_out=left_out,
            trajectories={},
            checks=tuple(checks),
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
        # if the search fails, all elements that are not simulated count as acting
        imported, mapping = mapping, mapping.unwatched()
        with collecting_errors(what, note_stops), limited(what, SHORTER_RUN_ADVICE, progress):
            mapping = watched(scene, imported, next(iter(runs.values())))
    # Judge the run that the file's own engine makes with the settings of the file
    own_run: Judgement | None = None
    if mapping and mapping.simulation and runs:
        with collecting_errors(JUDGING, note_stops), limited(JUDGING, SHORTER_RUN_ADVICE, progress):
            own_run = judge(mapping.simulation, acting_events(mapping))
    # Compare equations and runs; runs are not comparable if the scene does not determine its motion. `until`
    # is the time at which the first element that is not simulated would act. A stage yields checks, and takes
    # those of earlier stages
    until = mapping.acting[0].since if mapping and mapping.acting else None
    comparable = {} if any(stop.undetermined for stop in stops) else runs
    for what, stage in stages(scene, usable, comparable, _count_random_states(scene), until).items():
        with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
            for check in require_finite(stage(tuple(checks))):
                checks.append(check)
    if not (checks or runs):
        raise CrosscheckError(stops_text(stops))
    checks = in_order(checks)
    # Compare with reference values (published or exact results), which some scenes of the library have
    reference_checks: list[ReferenceCheck] = []
    known = known_of(source, options)
    for engine in usable if known else ():
        if engine.name not in stopped:
            what = f"{engine.name}: reference values"
            with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
                reference_checks.extend(measure(source, scene, engine, runs[engine.name], known))
    # Additional analyses: coverage, singular configurations, advice, and errors of runs
    covered: Coverage | None = None
    what = "working out what the motion covers"
    with collecting_errors(what, note_stops), limited(what, COVERAGE_OMITTED, progress, name="coverage_time"):
        covered = coverage(scene, comparable, checks)
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
    diagnoses = diagnosed(scene, usable, checks, reference_checks, stops)
    outliers = {diagnosis.outlier for diagnosis in diagnoses}
    what = "measuring each engine's error"
    with collecting_errors(what, note_stops), limited(what, SHORTER_RUN_ADVICE, progress):
        trusted = [engine for engine in usable if engine.name not in outliers]
        # the first one provides the reference: an engine whose equations are compared, if there is one
        unverified = by_runs_only([engine.name for engine in trusted], checks)
        trusted.sort(key=lambda engine: engine.name in unverified)
        run_errors = measure_run_errors(scene, trusted, comparable)
    return Crosscheck(
        source=source,
        options=options,
        scene=scene,
        engines=tuple(usable),
        left_out=left_out,
        trajectories=runs,
        checks=tuple(checks),
        reference_checks=tuple(reference_checks),
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


def _count_random_states(scene: Scene) -> int:
    """Choose the number of random states at which equations are compared."""
    velocities = max(1, SpanningTree(scene.mechanism).nv)
    states = -(-RANDOM_VELOCITIES // velocities)  # rounded up
    return max(MIN_RANDOM_STATES, min(MAX_RANDOM_STATES, states))


def _usable_engines(scene: Scene, engines: Sequence[Engine]) -> tuple[list[Engine], dict[str, str]]:
    """Find the engines that can represent a scene.

    Returns:
        The engines that can, and by name the reason why each other engine cannot. The functions for refined
        runs and `systems` of the returned engines are cached, since several checks use the refined run and
        the equations.

    Raises:
        NewtonEulerError: the error of the first engine, if no engine can represent the scene.
    """

    def make_equations(engine: Engine) -> None:
        require_scene(engine, scene)
        engine.systems(scene)

    cached = [
        replace(
            engine,
            refined=lru_cache(_naming_refined_run(engine, engine.refined)),
            refined_in_full=engine.refined_in_full
            and lru_cache(_naming_refined_run(engine, engine.refined_in_full)),
            systems=lru_cache(engine.systems),
        )
        for engine in engines
    ]
    usable, errors = divide(cached, make_equations)
    return usable, {name: str(error) for name, error in errors.items()}


def _naming_refined_run(
    engine: Engine, simulate: Callable[[Scene], Trajectory]
) -> Callable[[Scene], Trajectory]:
    """Return an engine's function for refined runs, with errors that name the engine and the purpose."""

    def refined(scene: Scene) -> Trajectory:
        name = f"{engine.name}, in a finer run for comparison"
        try:
            return simulate(scene)
        except NewtonEulerError as error:
            error.args = (f"{name}: {error}",)
            raise
        except Exception as error:
            raise CrosscheckError(f"{name}: {reason_of(error)}") from error

    return refined
