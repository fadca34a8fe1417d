"""Makes baselines: chooses how a scene is measured and finds out how exactly its figures are known.

The band of a figure is `FACTOR` times what it changes when its errors do, and round-off. Two things change
them: tolerances a tenth as large show what the integrator leaves, and a start that is moved by some units
in the last place shows what the mechanism makes of round-off. Where a figure comes from fixed steps, the
second is all that may differ from one machine to another.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.regress.baseline import Baseline, Figure, GroupName, Plan, Record, StoredState
from crosscheck.regress.compare import unsimulated
from crosscheck.regress.measure import (
    GROUPS,
    MAIN,
    PLAIN,
    Variant,
    main_run,
    measure_group,
    part,
    regress_scene,
)
from crosscheck.regress.values import Value
from newton_euler import compile_scene
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.compiled import FORMULATIONS
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array
from newton_euler.verification.import_report import ImportReport

FACTOR = 10.0
"""Two siblings show an error's size, not its bound."""

ROUND_OFF = 1e-13
"""Share of a figure's scale: some hundred operations of 1e-16 each, in another order on another machine."""

COUNT_SHARE = 0.02
"""Of a count: libraries of other versions round constants differently, and a step more or less follows."""

NUDGED = Variant(nudge=1e-14)
TIGHTER = Variant(tighten=0.1)

TOLERANCES = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8)
"""Of runs: the first that can be made a tenth as large as well."""

EVALUATIONS = 4
"""Of RK4 in a step."""

Progress = Callable[[str], None]


def make(
    scene: Scene,
    options: dict[str, str],
    reason: str,
    history: list[Record],
    progress: Progress,
    mapping: ImportReport | None = None,
) -> Baseline:
    """Measure a scene's figures and their bands.

    Args:
        scene: as loaded.
        options: of the scene, as they were set.
        reason: why, for the history.
        history: of the baseline that this one replaces.
        progress: is told each stage.
        mapping: what became of the elements of a model file; None for a scene of this package's own.

    Raises:
        CrosscheckError: for a scene that newton_euler cannot run at any tolerance.
    """
    scene = regress_scene(scene)
    plan = _plan(scene)
    figures, left_out = [], {}
    for group in GROUPS:
        progress(f"{scene.name}: {group}")
        found = _figures(group, scene, plan)
        if isinstance(found, str):
            left_out[group] = found
        else:
            figures.extend(found)
    if MAIN in left_out:
        raise CrosscheckError(f"scene {scene.name!r} has no figures: {left_out[MAIN]}")
    return Baseline(
        scene=scene.name,
        options=options,
        unsimulated=None if mapping is None else unsimulated(mapping),
        history=[*history, Record.now(reason)],
        plan=plan,
        left_out=left_out,
        figures=figures,
    )


def _plan(scene: Scene) -> Plan:
    rtol: dict[str, float] = {MAIN: _tolerance(scene, MAIN)}
    run = main_run(scene, rtol[MAIN])
    moment = _moment(run)
    # as many evaluations a second as the adaptive run needs, so that RK4 is stable and not exact
    step = float(f"{EVALUATIONS * scene.duration / run.settings['evaluations']:.1e}")
    for formulation in FORMULATIONS:
        if formulation != MAIN:
            rtol[formulation] = _tolerance(part(scene, formulation, step), formulation)
    return Plan(rtol=rtol, step=step, time=float(run.time[moment]), state=StoredState.of(_state(run, moment)))


def _tolerance(scene: Scene, formulation: str) -> float:
    """The first of the tolerances that works, also with a tenth of it."""
    compiled = compile_scene(scene, formulation)
    for rtol in TOLERANCES:
        try:
            for each in (rtol, TIGHTER.tighten * rtol):
                compiled.simulate(rtol=each, atol=0.01 * each)
        except NewtonEulerError as error:
            reason = error
        else:
            return rtol
    if formulation == MAIN:
        raise CrosscheckError(f"scene {scene.name!r} cannot be run: {reason}")
    return TOLERANCES[-1]  # the group fails at it, and is left out with the reason


def _moment(run: Trajectory) -> int:
    """The output whose kinetic energy is nearest to half of the largest: all moves, nothing is special."""
    assert run.kinetic_energy is not None
    return int(np.argmin(np.abs(run.kinetic_energy - 0.5 * np.max(run.kinetic_energy))))


def _state(run: Trajectory, n: int) -> State:
    assert run.linear_velocity is not None
    assert run.angular_velocity is not None
    return State(run.position[n], run.quaternion[n], run.linear_velocity[n], run.angular_velocity[n])


def _figures(group: GroupName, scene: Scene, plan: Plan) -> list[Figure] | str:
    """The figures of a group with their bands, or why there are none."""
    measured = []
    for variant in (PLAIN, NUDGED, TIGHTER):
        found = measure_group(group, scene, plan, variant)
        if isinstance(found, str):
            return found
        measured.append(found)
    figures = []
    for plain, *siblings in zip(*measured, strict=True):
        if not np.all(np.isfinite(plain.array)):
            return f"{plain.name} is not finite"
        figures.append(_figure(group, plain, band(plain, siblings)))
    return figures


def _figure(group: GroupName, value: Value, widths: Array) -> Figure:
    return Figure(
        group=group,
        name=value.name,
        unit=value.unit,
        rows=list(value.rows),
        columns=list(value.columns),
        value=value.array.tolist(),
        band=widths.tolist(),
    )


def band(value: Value, siblings: list[Value]) -> Array:
    """(rows,): how far a figure may move, from what it is under the same code with other errors."""
    if value.is_count:
        nudged = siblings[0]
        changes = np.abs(nudged.array - value.array).max(axis=1)
        return np.asarray(FACTOR * changes + np.ceil(COUNT_SHARE * value.scale))
    change = np.max([np.abs(sibling.array - value.array) for sibling in siblings], axis=0, initial=0.0)
    change = change.max(axis=1, initial=0.0)
    if value.over_time:
        change = np.maximum.accumulate(change)
    else:
        change = np.full(len(value.rows), change.max(initial=0.0))
    return np.asarray(FACTOR * change + ROUND_OFF * value.scale)
