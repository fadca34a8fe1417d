"""Points of the contract about runs as a whole: settings, refined runs, stops, equations and refusals.

A point is a function of a candidate that returns what is wrong, or "". Its docstring has three paragraphs:
what the point asks, why comparisons need that, and what a failure means. `crosscheck engine-check -v` prints
them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crosscheck.compare.check import REFERENCE
from crosscheck.compare.levels import compare_pair
from crosscheck.compare.runs import compare_runs
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.engine import FORCE_OUTPUTS, NO_SETTINGS
from crosscheck.engines.limits import CannotExpressError
from crosscheck.engines.registry import SOLVER
from crosscheck.studies.conformance.candidate import Candidate, ContractError, NotOfferedError
from crosscheck.studies.conformance.closed_forms import sampled_motion
from crosscheck.studies.conformance.differences import (
    POSES,
    arrays_of,
    first_difference,
    reference,
    reference_equations,
    relative,
)
from crosscheck.studies.conformance.element_scenes import SCENES
from crosscheck.studies.conformance.scenes import (
    FAILURE_TIME,
    SHORT_STEP,
    double,
    fast_swing,
    geared,
    linkage,
    short_swing,
    stopping,
    swing,
)
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import TooLongError
from newton_euler.equations.system import System
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import QUANTITIES, StoppedError
from newton_euler.runs.assemble import initial_state

REFINED_ERROR_SHARE = 0.75
"""Largest error of a refined run as a fraction of the error of the default run. Half the step halves the
error of a method of order 1, and reduces the error of other methods further."""

ROUND_OFF_ERROR = 1e-12
"""Relative error of positions below which a run is as accurate as floats and the reference allow."""


def refinement(candidate: Candidate) -> str:
    """A refined run is nearer to the exact motion than the default run, and has all of its outputs.

    The difference of both runs is the measured error of the engine, from which tolerances follow.

    The refined run has the settings of the default run, is shorter, or is less accurate.
    """
    scene = fast_swing()
    exact = reference(scene)
    default = relative(candidate.run(scene).position, exact.position)
    for in_full, wanted in ((False, scene.outputs - FORCE_OUTPUTS), (True, scene.outputs)):
        run = candidate.refined(scene, in_full)
        if not np.array_equal(run.time, scene.times):
            needed = f"{len(scene.times)} to {scene.duration:g} s"
            return f"the refined run has {len(run.time)} outputs to {run.time[-1]:g} s; needed: {needed}"
        for name in arrays_of(exact, (each for each in QUANTITIES if QUANTITIES[each].output in wanted)):
            if getattr(run, name) is None:
                return f"{name} is missing in the refined run"
        error = relative(run.position, exact.position)
        if not error <= max(REFINED_ERROR_SHARE * default, ROUND_OFF_ERROR):
            return f"the refined run has an error of {error:.2g}, the default run of {default:.2g}"
    return ""


def errors(candidate: Candidate) -> str:
    """Errors of the default run are within those that the engine declares, plus what a refined run changes.

    Tolerances of `crosscheck run` are these errors: `trajectory_error`, `drift` and `energy_error`, and four
    times the change of a refined run.

    An error is declared too small, or does not show in a refined run.
    """
    scenes, refusals = (fast_swing(), linkage()), list[Exception]()
    for scene in scenes:
        try:
            if why := _undeclared_error(candidate, scene):
                return why
        except CannotExpressError as error:
            refusals.append(error)
    if len(refusals) == len(scenes):
        raise refusals[-1]
    return ""


def _undeclared_error(candidate: Candidate, scene: Scene) -> str:
    """Describe the first error of a run that exceeds declared and measured errors; return "" if none does."""
    # The candidate calls the engine's refined runs, with its limit of time
    engine = replace(candidate.engine, refined=candidate.refined, refined_in_full=None)
    runs = {REFERENCE: reference(scene), engine.name: candidate.run(scene)}
    energy = States(scene, (initial_state(scene),)).energy
    for check in compare_runs(scene, (replace(SOLVER, name=REFERENCE), engine), runs, energy):
        differs = f"{check.quantity} differs by {check.value:.2g} at {check.where}"
        if engine.name in check.between and not check.agrees:
            return f"{differs}; declared and measured errors allow {check.tolerance:.2g}"
        if check.unconverged == engine.name:
            return f"{differs}, which a refined run does not reduce"
    return ""


def fixed_steps(candidate: Candidate) -> str:
    """Two runs at a fixed step are equal to the last bit, and have the step that is asked for.

    `crosscheck regress` compares such runs with stored ones, and takes a change as one of the code.

    Results depend on earlier runs, on threads or on time; or the step is ignored.
    """
    offered = candidate.engine.fixed_steps
    if offered is None:
        raise NotOfferedError(f"{candidate.engine.name} has no runs at fixed steps (`fixed_steps`)")
    scene = short_swing(offered.steps)
    one, two = (candidate.simulate(each, offered.settings(SHORT_STEP)) for each in (scene, replace(scene)))
    for (name, values), repeated in zip(one.arrays().items(), two.arrays().values(), strict=True):
        if not np.array_equal(values, repeated):
            return f"{name} differs between two runs with the same settings"
    if why := first_difference(one, arrays_of(reference(scene), POSES)):
        return why
    finer = candidate.simulate(scene, offered.settings(0.5 * SHORT_STEP))
    if np.array_equal(finer.position, one.position):
        return "a run at half the step is the same, so that the step is ignored"
    return ""


def stop(candidate: Candidate) -> str:
    """A run whose controller fails raises a `StoppedError` with the time, and the run until then.

    Comparisons use the outputs before a stop, and report its time and reason.

    The failure is ignored, the error is another one, or the outputs before the stop are lost.
    """
    scene = stopping()
    try:
        candidate.run(scene)
    except StoppedError as error:
        stopped = error
    else:
        return f"the run ends, although its controller fails at {FAILURE_TIME:g} s"
    kept = scene.times[scene.times < FAILURE_TIME]
    if not kept[-1] <= stopped.time <= FAILURE_TIME * (1.0 + 1e-9):
        return f"the error has the time {stopped.time:g} s; the controller fails at {FAILURE_TIME:g} s"
    if stopped.partial is None or not np.array_equal(stopped.partial.time, kept):
        found = "none" if stopped.partial is None else f"{len(stopped.partial.time)}"
        return f"outputs before the stop: {found} of {len(kept)} are kept"
    exact = {name: values[: len(kept)] for name, values in sampled_motion(scene).items()}
    return first_difference(stopped.partial, exact)


def equations(candidate: Candidate) -> str:
    """Equations of motion agree with newton_euler's at every level of `crosscheck run`.

    Differences of equations locate the body or joint; differences of runs do not. The mechanisms are a hinge,
    a chain, a loop and a gear, each at the start and in motion.

    A coordinate, mass matrix, force, constraint or reaction of the engine's equations is wrong.
    """
    systems, refusals = list[tuple[Scene, System]](), list[Exception]()
    for scene in (swing(), double(), linkage(), geared()):
        try:
            systems += [(scene, system) for system in candidate.systems(scene)]
        except CannotExpressError as error:
            refusals.append(error)
    if not systems:
        absent = NotOfferedError(f"{candidate.engine.name} has no equations of motion (`systems`)")
        raise [absent, *refusals][-1]
    pair = (REFERENCE, candidate.engine.name)
    for scene, system in systems:
        exact = reference_equations(scene)
        with candidate.limited(scene):
            for check in compare_pair(pair, [exact], [Samples(system, exact.states)]):
                if not check.agrees:
                    return f"{check.level}: {check.quantity} differs by {check.value:.2g} at {check.where}"
    return ""


def limits(candidate: Candidate) -> str:
    """Scenes for which `limits` lists something are refused by a `CannotExpressError`; all others run.

    Comparisons leave an engine out with the reason that `limits` gives, before they run anything.

    `limits` and `simulate` disagree, or a refusal is another error.
    """
    for scene in (construct() for construct in SCENES):
        found = candidate.limits(scene)
        try:
            candidate.run(scene)
        except CannotExpressError as error:
            if not found:
                return f"the scene is refused though `limits` lists nothing: {error}"
        else:
            if found:
                return f"the scene runs though `limits` lists {found[0]}"
    return ""


def settings(candidate: Candidate) -> str:
    """Empty settings are those of the engine's choice, and an unknown setting is an error.

    `crosscheck bench` and `stress` run engines with settings by name.

    A setting that does not exist is ignored, so that a misspelled one has no effect.
    """
    scene, _ = candidate.first_run()
    candidate.simulate(scene, NO_SETTINGS)
    try:
        candidate.simulate(scene, {"no_such_setting": 1.0})
    except CannotExpressError as error:
        return f"an unknown setting is refused as if it were a part of the scene: {error}"
    except (ContractError, TooLongError):  # no errors about the setting
        raise
    except (NewtonEulerError, CrosscheckError, TypeError, ValueError):
        return ""
    return "a setting that does not exist is ignored"
