"""Options of runs with error control: integrator, tolerances and number of steps, chosen for each scene.

Runs use DOP853, or Radau for stiff scenes. "Native" means that the equations are compiled, as in
newton_euler; those of other engines may be evaluated by Python. Tolerances of refined runs are a hundredth of
the default ones for DOP853, a tenth for Radau. `native_run` is newton_euler's run, by which settings of other
engines are chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import lru_cache
from typing import Any

from crosscheck.engines.engine import Settings, without_forces
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory

REFINED_RTOL, REFINED_ATOL = 1e-12, 1e-14
"""Tolerances of refined runs with DOP853, a hundredth of the default ones. DOP853 accepts no rtol below
2.2e-14."""

NATIVE_STEP_BUDGET = 100_000
"""Largest number of steps that DOP853 may need for stability in native code, which take some seconds. If it
needs more, Radau is used, see `crosscheck.engines.stiffness`."""

PYTHON_STEP_BUDGET = 60
"""Largest number of steps that DOP853 may need for stability if Python evaluates the equations; the number of
outputs is used instead if that is larger.

At this limit, DOP853 costs about as much as Radau: on damped solar trackers and servo-driven arms, DOP853
took 4 to 7 times as many steps as stability requires, with 13 evaluations each. Radau took 500 to 900 steps
for a second of an arm's motion, with 7 evaluations each."""

RADAU_SHARE = 0.25
"""Largest number of evaluations of Radau in Python, as a fraction of those that DOP853 needs.

Radau needs 0.11 to 0.24 of them on the governor and on servo-driven arms. It needs 4.6 times as many on a
walker with stiff springs, whose oscillations both methods have to follow."""

RADAU_EVALUATIONS = 7
"""Number of evaluations per step of Radau in Python: two or three Newton iterations of three stages each."""

MIN_RADAU_STEPS = 500
"""Smallest number of steps that Radau is allowed in Python; if it were fewer, Radau is not tried.

Radau took 508 to 867 steps for a second of the motion of servo-driven arms, a humanoid and a hand, 220 of
them at the start, where its steps are short."""

NATIVE_MAX_STEPS, PYTHON_MAX_STEPS = 200_000, 10_000
"""Largest numbers of steps of adaptive runs in native code and in Python, so that none lasts for hours."""

STIFF_RTOL, STIFF_ATOL = 1e-8, 1e-10
"""Tolerances of Radau. A hundred times tighter tolerances need about ten times as many steps."""

STIFF_REFINEMENT = 0.1
"""Factor on the tolerances of Radau in refined runs."""

LOOSER_TOLERANCE_FACTOR = 5.0
"""Factor on the tolerances of a refined run in Python that is repeated because it stopped. Accelerations of
nearly singular loops and of stiff machines may have too few accurate digits for `REFINED_RTOL`."""


def newton_euler_options(scene: Scene, refined: bool = False) -> dict[str, Any]:
    """Choose the options of `newton_euler.simulate` for a scene: integrator, tolerances and number of steps.

    Args:
        scene: the scene.
        refined: True for a refined run, with tighter tolerances than the default ones.
    """
    is_stiff = _needs_radau(scene, NATIVE_STEP_BUDGET)
    return {"most_steps": NATIVE_MAX_STEPS} | (_radau(refined) if is_stiff else _dop853(refined))


def python_options(scene: Scene, refined: bool) -> list[dict[str, Any]]:
    """Choose the same options as `newton_euler_options` for runs whose equations are evaluated in Python.

    Returns:
        Options to try in order: later ones if a run with the earlier ones stops.
    """
    explicit = {"most_steps": PYTHON_MAX_STEPS} | _dop853(refined)
    if not _needs_radau(scene, max(PYTHON_STEP_BUDGET, len(scene.times))):
        return [explicit]
    # Radau first; DOP853 if Radau takes too many steps, and newton_euler shows that DOP853 does not
    expected = expected_run(scene)
    settings = {} if expected is None else expected.settings
    if settings.get("integrator") != "DOP853" or settings["steps"] > PYTHON_MAX_STEPS:
        return [{"most_steps": PYTHON_MAX_STEPS} | _radau(refined)]
    steps = int(RADAU_SHARE * settings["evaluations"] / RADAU_EVALUATIONS)
    if steps < MIN_RADAU_STEPS:
        return [explicit]
    return [{"most_steps": min(PYTHON_MAX_STEPS, steps)} | _radau(refined), explicit]


def python_run(simulate: Callable[..., Trajectory], scene: Scene, settings: Settings) -> Trajectory:
    """Simulate a scene by equations that Python evaluates, with given settings or those of `python_options`.

    Args:
        simulate: function of a scene and the settings as keywords.
        scene: the scene.
        settings: settings of the run; if there are none, they are chosen for the scene.
    """
    return _first_run(simulate, scene, [dict(settings)] if settings else python_options(scene, refined=False))


def refined_python_run(
    simulate: Callable[..., Trajectory], scene: Scene, in_full: bool = False
) -> Trajectory:
    """Simulate a scene as `python_run` does, at refined tolerances, or at looser ones if that run stops.

    Args:
        simulate, scene: see `python_run`.
        in_full: True to compute all outputs of the scene; False to omit reactions and actuator forces.
    """
    methods = python_options(scene, refined=True)
    looser = {name: LOOSER_TOLERANCE_FACTOR * methods[-1][name] for name in ("rtol", "atol")}
    outputs = scene if in_full else without_forces(scene)
    return _first_run(simulate, outputs, [*methods, methods[-1] | looser])


def _first_run(
    simulate: Callable[..., Trajectory], scene: Scene, methods: Sequence[dict[str, Any]]
) -> Trajectory:
    """Simulate a scene with the first options with which the run does not stop."""
    for method in methods[:-1]:
        with suppress(StoppedError):
            return simulate(scene, **method)
    return simulate(scene, **methods[-1])


def _needs_radau(scene: Scene, max_steps: int) -> bool:
    """Return True if DOP853 needs more steps for stability than `max_steps`."""
    from crosscheck.engines.stiffness import explicit_steps

    return explicit_steps(scene) > max_steps


def _radau(refined: bool) -> dict[str, Any]:
    """Return the options of a run with Radau."""
    factor = STIFF_REFINEMENT if refined else 1.0
    return {"integrator": "Radau", "rtol": factor * STIFF_RTOL, "atol": factor * STIFF_ATOL}


def _dop853(refined: bool) -> dict[str, Any]:
    """Return the options of a run with DOP853."""
    return {"rtol": REFINED_RTOL, "atol": REFINED_ATOL} if refined else {}


@lru_cache(maxsize=1)
def native_run(scene: Scene) -> Trajectory:
    """Simulate a scene in newton_euler with default settings; the last run is cached for other uses."""
    from newton_euler import simulate

    return simulate(scene, **newton_euler_options(scene))


@lru_cache(maxsize=1)
def native_refined(scene: Scene) -> Trajectory:
    """Simulate a scene in newton_euler at refined tolerances; the last run is cached."""
    from newton_euler import simulate

    return simulate(scene, **newton_euler_options(scene, refined=True))


def expected_run(scene: Scene) -> Trajectory | None:
    """Return newton_euler's run, by which settings of the other engines are chosen.

    The run is partial if it stopped, and None if it failed.
    """
    try:
        return native_run(scene)
    except StoppedError as error:
        return error.partial
    except NewtonEulerError:
        return None
