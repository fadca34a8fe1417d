"""Compare the controllers of a scene: tracking error, actuator force and energy in each engine.

`compared` runs a scene with each of its controllers in each engine, such as MuJoCo, and
`write` writes tables of their performance. A controller is a set of control laws, one for each driven joint
coordinate; a control law may follow a target, a number or a function of time.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import choose
from crosscheck.engines.usable import Reasons, failure, require_scene
from crosscheck.library import SCENES, load
from crosscheck.library.options import options_of
from crosscheck.report.chart import Measure, log_chart
from crosscheck.report.render import as_json
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    number_columns,
    text_columns,
)
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from crosscheck.support.time_limits import with_progress
from newton_euler.analysis.loads.envelope import work_and_energy
from newton_euler.model.control import ComputedTorque, DeclaredLaw, reference
from newton_euler.model.digital_control import Digital
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

CONTROLLER_OPTION = "controller"
"""Name of the option by which a scene of the library chooses its controller."""

MIN_OUTPUTS, MAX_OUTPUTS = 1000, 20_000
"""Smallest and largest number of outputs of a run, from which mean values and integrals over time are
computed. A digital law has an output in each of its periods, in which its force is constant."""


CONTROLLERS_FILES = "controllers.json", "controllers.csv"
"""Names of the result files."""

UNITS = {"slides": ("m", "N"), "hinges": ("rad", "N m")}
"""Units of tracking errors and of forces, by kind of coordinate."""


class Performance(NamedTuple):
    """Tracking performance of one run, over all slides (m, N) or all hinges (rad, N m) that follow a target.

    Attributes:
        error_rms, error_peak: root mean square over time and coordinates, and largest magnitude, of the
            tracking error x - r (coordinate minus target).
        force_rms, force_peak: root mean square over time and coordinates, and largest magnitude, of the
            actuator forces or torques.
        energy: positive work of these actuators, J; braking recovers no energy.
    """

    error_rms: float
    error_peak: float
    force_rms: float
    force_peak: float
    energy: float


def controllers(scene: str, given: Mapping[str, str | float]) -> Iterator[tuple[str, Scene]]:
    """Yield the name of each controller of a scene, and the scene with that controller.

    A scene without the option `controller` is yielded once, with the control laws that it declares.

    Raises:
        CrosscheckError: if no control law of the scene follows a target.
    """
    # Names of the controllers: allowed values of the option of a library scene, unless the user chose one
    known = options_of(SCENES[scene]) if scene in SCENES else {}
    has_choice = CONTROLLER_OPTION in known and CONTROLLER_OPTION not in given
    values: object = known[CONTROLLER_OPTION].values if has_choice else ()
    names = [str(value) for value in values] if isinstance(values, tuple) else []
    for name in names or [""]:
        loaded = load(scene, **given, **({CONTROLLER_OPTION: name} if name else {}))
        if not _targets(loaded):
            raise CrosscheckError(f"scene {loaded.name!r} has no control law that follows a target")
        yield name or str(given.get(CONTROLLER_OPTION, "as declared")), loaded


def _output_period(scene: Scene) -> float:
    """Return the time between two outputs, s, in which no force of a digital law is missed."""
    of_laws = min((law.period for law in scene.sampled), default=math.inf)
    shortest = max(of_laws, scene.duration / MAX_OUTPUTS)
    return min(scene.output_period, scene.duration / MIN_OUTPUTS, shortest)


def performance(scene: Scene, run: Trajectory) -> dict[str, Performance]:
    """Compute the tracking performance of a run with the output "actuation", the actuator forces.

    Returns:
        The performance by kind of coordinate, "slides" or "hinges".
    """
    targets_of_kinds: dict[str, dict[int, float | TimeFunction]] = {}
    for k, target in _targets(scene).items():
        law = scene.control[k]
        kind = "slides" if scene.mechanism.is_slide(law.joint, law.coordinate) else "hinges"
        targets_of_kinds.setdefault(kind, {})[k] = target
    return {kind: _performance(scene, run, targets) for kind, targets in targets_of_kinds.items()}


def _performance(scene: Scene, run: Trajectory, targets: Mapping[int, float | TimeFunction]) -> Performance:
    """Compute the performance of the control laws in `targets`, whose keys are indices in `scene.control`."""
    assert run.actuator_force is not None
    errors, energy = [], 0.0
    forces = run.actuator_force[:, list(targets)]
    for force, (k, target) in zip(forces.T, targets.items(), strict=True):
        law = scene.control[k]
        x = run.joint(law.joint).coordinates[:, law.coordinate]
        _, energy_until = work_and_energy(force, x)
        energy += float(energy_until[-1])
        errors.append(x - [float(reference(target, float(t)).value) for t in run.time])

    def magnitudes(signals: Array) -> tuple[float, float]:
        """Return root mean square over time and signals, and largest magnitude, of signals (laws, n)."""
        mean_square = float(np.trapezoid(signals**2, run.time).mean() / run.time[-1])
        return mean_square**0.5, float(np.max(np.abs(signals)))

    error_rms, error_peak = magnitudes(np.array(errors))
    force_rms, force_peak = magnitudes(forces.T)
    return Performance(error_rms, error_peak, force_rms, force_peak, energy)


def _targets(scene: Scene) -> dict[int, float | TimeFunction]:
    """Return the targets of the control laws that follow one, by the index of the law in `scene.control`."""
    # a `DeclaredLaw` has a target, other laws have none; a sampled (digital) law contains a declared law
    declared = [law.law if isinstance(law, Digital) else law for law in scene.control]
    laws = {k: law for k, law in enumerate(declared) if isinstance(law, DeclaredLaw)}
    return {k: law.target for k, law in laws.items() if _follows(law)}


def _follows(law: DeclaredLaw) -> bool:
    """Return True if a gain of the law acts on its target.

    Motors of model files have no gains; a damper has a gain K_d only, which acts on moving targets only.
    """
    target_moves = isinstance(law.target, TimeFunction)
    gains = law.feedback.values()
    return isinstance(law, ComputedTorque) or any(k_p or (k_d and target_moves) for k_p, k_d in gains)


class ControllerRun(NamedTuple):
    """Performance of one controller in one engine, over the coordinates of one kind.

    Attributes:
        controller: name of the controller.
        engine: name of the engine.
        kind: "slides" or "hinges".
        performance: the performance.
    """

    controller: str
    engine: str
    kind: str
    performance: Performance


def compared(
    scene: str, given: Mapping[str, str | float], engines: Sequence[str], progress: Callable[[str], None]
) -> tuple[list[ControllerRun], list[str]]:
    """Run a scene with each of its controllers in each engine that can be used.

    Args:
        scene: name or file of the scene.
        given: options of the scene.
        engines: names of the engines.
        progress: called with the name of each stage.

    Returns:
        A row for each controller, engine and kind of coordinate that has targets, in this order, and a line
        for each run that is missing, with the reason.

    Raises:
        CrosscheckError, NewtonEulerError: the first reason, if there is no run at all.
    """
    rows, missing, errors = list[ControllerRun](), list[str](), Reasons()
    pairs = list(product(controllers(scene, given), choose(engines)))
    for (name, loaded), engine in with_progress(pairs, progress, "run"):
        with_outputs = replace(loaded, output_period=_output_period(loaded), outputs=frozenset({"actuation"}))
        if error := failure(engine, partial(_run, name, with_outputs, rows)):
            missing.append(f"{name}: no run: {error}")
            errors.setdefault(engine.name, error)
    if not rows:
        raise next(iter(errors.values()))
    return rows, missing


def _run(controller: str, scene: Scene, rows: list[ControllerRun], engine: Engine) -> None:
    """Simulate a scene in an engine, and append the performance of its controller to `rows`."""
    require_scene(engine, scene)
    found = performance(scene, engine.simulate(scene))
    rows += [ControllerRun(controller, engine.name, kind, each) for kind, each in found.items()]


def report(source: str, rows: Sequence[ControllerRun], missing: Sequence[str]) -> Report:
    """Make the report: a table for slides if slides have targets, and one for hinges if hinges have targets.

    Args:
        source: name or file of the scene.
        rows, missing: results of `compared`.
    """
    kinds, names = ({getattr(row, field): None for row in rows} for field in ("kind", "controller"))
    tables: list[Part] = []
    for kind in kinds:
        cells: Rows = []
        for row in (row for row in rows if row.kind == kind):
            if row.controller not in cells:  # a heading above the rows of the engines
                cells.append(row.controller)
            cells.append([f"  {row.engine}", *(f"{value:.3g}" for value in row.performance)])
        tables.append(Table(kind if len(kinds) > 1 else "", columns(kind), cells))
    if missing:
        tables.append(Lines("", list(missing)))
    first = min(
        (row for row in rows if row.kind == next(iter(kinds))), key=lambda row: row.performance.error_rms
    )
    count = f"{len(names)} controller{'s' * (len(names) != 1)}"
    title = f"{Path(source).stem}: {count}, {', '.join(names)}"
    length, _ = UNITS[first.kind]
    verdict = f"smallest tracking error {first.performance.error_rms:.3g} {length}: {first.controller}"
    errors = [
        Measure(f"{row.controller}, {row.engine}", error, f"{error:.3g} {length}")
        for row in rows
        if row.kind == first.kind
        for error in [row.performance.error_rms]
    ]
    steps = [f"Compare effort and energy, too, before you choose {first.controller}: the table has both."]
    if missing:
        steps.append("Leave out engines that cannot make a run with `--engines`; the notes have the reasons.")
    return Report(
        title,
        verdict,
        Cell(""),
        [*tables],
        summary=[*tables],
        charts=log_chart("Tracking error", f"Root mean square over time, {first.kind}", errors, length),
        next_steps=steps,
    )


def write(
    rows: Sequence[ControllerRun],
    missing: Sequence[str],
    paths: Sequence[Path],
    source: str,
    options: Mapping[str, str],
) -> Report:
    """Write the results of `compared`, and return the report.

    Args:
        rows, missing: the results.
        paths: paths of `CONTROLLERS_FILES`, in their order.
        source: name or file of the scene.
        options: options of the scene.
    """
    results, table = paths
    made = report(source, rows, missing)
    runs = [
        {"controller": row.controller, "engine": row.engine, "kind": row.kind, **row.performance._asdict()}
        for row in rows
    ]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(runs[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(runs)
    content = {"source": source, "options": dict(options), "units": UNITS, "runs": runs, "missing": missing}
    write_files({results: as_json(content, made), table: text.getvalue().encode()})
    return made


def columns(kind: str) -> list[Column]:
    """Return the columns of the table of slides or hinges."""
    length, force = UNITS[kind]
    return [
        *text_columns("controller"),
        *number_columns(f"error, {length}", "peak error", f"force, {force}", "peak force", "energy, J"),
    ]
