"""Settings with which `crosscheck regress` measures a scene: tolerances, step and duration of its runs.

`regress_scene` prepares a scene for the measurement. `make_plan` tries runs of newton_euler, this project's
solver, and returns a `MeasurementPlan`, which the baseline stores: later measurements repeat it. newton_euler
has two formulations: "relative" (joint coordinates) and "cartesian" (positions and orientations of bodies).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crosscheck.regress.baseline import MeasurementPlan, StoredState
from newton_euler import compile_scene
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import FormulationName
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.trajectory import Trajectory

MAIN_FORMULATION: FormulationName = "relative"
"""Formulation of newton_euler whose run over the whole duration is stored, and name of its group."""

OUTPUT_COUNT = 25
"""Number of output times of a whole run after the initial one: enough to tell when two runs begin to
differ."""

CARTESIAN_FRACTION = 0.1
"""Duration of the run in Cartesian coordinates, as a fraction of the scene's duration.

With redundant or nearly singular constraints a Cartesian run costs a hundred times as much as in joint
coordinates. It tests the same integrator, so a short one is enough."""

MAX_CARTESIAN_STEPS = 1000
"""Upper limit of the duration of the Cartesian run, in multiples of the plan's fixed step."""

RADAU_RTOL = 1e-10
"""Relative tolerance of Radau (implicit, order 5): a few hundred steps in a short run."""

CANDIDATE_RTOLS = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8)
"""Relative tolerances of runs, of which a plan takes the first feasible one: a run at this tolerance and a
run at a tenth of it have to complete."""

TIGHTER_FACTOR = 0.1
"""Factor of the relative tolerances in the second run, whose changes show the error of the first run."""

RK4_EVALUATIONS = 4
"""Evaluations of the equations per step of RK4."""


def regress_scene(scene: Scene) -> Scene:
    """Return the scene with all kinds of outputs (such as energies) at `OUTPUT_COUNT` times after the start.

    With redundant constraints, reactions are computed in Python at each output: hundreds of outputs would
    take longer than all other measurements.
    """
    return replace(scene, output_period=scene.duration / OUTPUT_COUNT, outputs=frozenset(OUTPUTS))


def make_plan(scene: Scene) -> MeasurementPlan:
    """Choose the settings of the measurement of a scene: tolerances, fixed step, and a state in motion.

    Args:
        scene: a result of `regress_scene`.

    Raises:
        NewtonEulerError: for a scene that newton_euler cannot run at any tolerance.
    """
    rtol: dict[str, float] = {MAIN_FORMULATION: _feasible_rtol(scene, MAIN_FORMULATION), "Radau": RADAU_RTOL}
    run = main_run(scene, rtol[MAIN_FORMULATION])
    assert run.kinetic_energy is not None
    # the state nearest to half of the largest kinetic energy: all bodies move, and no velocity is extreme
    n = int(np.argmin(np.abs(run.kinetic_energy - 0.5 * np.max(run.kinetic_energy))))
    # as many evaluations of dv/dt per second as the adaptive run needs, so that RK4 is stable but not exact;
    # rounded to two digits, as the plan is stored
    step = float(f"{RK4_EVALUATIONS * scene.duration / run.settings['evaluations']:.1e}")
    for formulation in FORMULATIONS:
        if formulation != MAIN_FORMULATION:
            rtol[formulation] = _feasible_rtol(shortened_scene(scene, formulation, step), formulation)
    return MeasurementPlan(rtol=rtol, step=step, time=float(run.time[n]), state=StoredState.of(run.state(n)))


def _feasible_rtol(scene: Scene, formulation: FormulationName) -> float:
    """Return the first of `CANDIDATE_RTOLS` at which a run and a run at a tenth of it complete.

    Without a feasible candidate, the last one is returned for a formulation other than `MAIN_FORMULATION`.
    The measurement of its group then fails, and the baseline leaves the group out with the reason.

    Raises:
        NewtonEulerError: for `MAIN_FORMULATION` without a feasible candidate.
    """
    compiled = compile_scene(scene, formulation)
    for rtol in CANDIDATE_RTOLS:
        try:
            for tried in (rtol, TIGHTER_FACTOR * rtol):
                compiled.simulate(rtol=tried, atol=0.01 * tried)
            return rtol
        except NewtonEulerError:
            if rtol == CANDIDATE_RTOLS[-1] and formulation == MAIN_FORMULATION:
                raise
    return CANDIDATE_RTOLS[-1]


def main_run(scene: Scene, rtol: float) -> Trajectory:
    """Run a scene in newton_euler in joint coordinates over its whole duration."""
    return compile_scene(scene, MAIN_FORMULATION).simulate(rtol=rtol, atol=0.01 * rtol)


def shortened_scene(scene: Scene, formulation: str, step: float) -> Scene:
    """Return the scene with the duration that it is run for in a formulation.

    The run in `MAIN_FORMULATION` has the whole duration. In other formulations, the run ends after a fraction
    of the duration, see `CARTESIAN_FRACTION`, with one output at its end.

    Args:
        scene: a result of `regress_scene`.
        formulation: "relative" or "cartesian".
        step: s, fixed step of short runs.
    """
    if formulation == MAIN_FORMULATION:
        return scene
    duration = min(CARTESIAN_FRACTION * scene.duration, MAX_CARTESIAN_STEPS * step)
    return replace(scene, duration=duration, output_period=duration)
