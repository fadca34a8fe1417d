"""Two models of one mechanism compared: levels in their order, up to the first that disagrees."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from crosscheck.against.accelerations import acceleration_rows, reactions_in_first
from crosscheck.against.align import Aligned, align
from crosscheck.against.dynamics import dynamics_rows
from crosscheck.against.kinematics import kinematics_rows
from crosscheck.against.model import beside_the_worst, bodies_row, differences, model_rows, start_rows
from crosscheck.against.uncompared import Uncompared, uncompared
from crosscheck.comparison.diagnosis import Diagnosis
from crosscheck.comparison.rows import Row, not_judged
from crosscheck.comparison.runs import compare_runs
from crosscheck.comparison.samples import Samples, States
from crosscheck.each_run import as_far_as_it_goes, each_run, finite
from crosscheck.engines import ENGINES, Engine
from crosscheck.limit import SHORTER, limited
from crosscheck.run import Crosscheck, Progress
from crosscheck.scenes.options import titled
from newton_euler.assemble import random_states
from newton_euler.equations.relative import Relative
from newton_euler.model.mapping import Mapping as Report
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

ENGINE = ENGINES["newton_euler"]
"""Whose equations both models are given."""


RANDOM_STATES = 8
"""Random consistent states, beside the first's start, at which the equations of both are compared: twice as
many as faults between engines are found with."""

TO_THE_END = "not run to the end"
"""How it is said that a run stopped."""


@dataclass(frozen=True)
class Model:
    """One of the two.

    Attributes:
        name: as in tables and files.
        source: the name or the file that it was loaded from.
        options: of the scene, as they were set.
        scene: what was read.
        mapping: what became of the elements of a model file; None for a scene of this package's own.
    """

    name: str
    source: str
    options: Mapping[str, str]
    scene: Scene
    mapping: Report | None

    @property
    def title(self) -> str:
        return titled(self.source, self.options)


@dataclass(frozen=True, eq=False)
class Against(Crosscheck):
    """What a comparison of two models found; runs are by the models' names, in the first's terms.

    Attributes:
        models: the two.
        uncompared: what differs and no figure is about.
        notes: also what was taken for what, and all that differs.
    """

    models: tuple[Model, Model] = field(kw_only=True)
    uncompared: tuple[Uncompared, ...] = ()

    @property
    def title(self) -> str:
        """Both models, with the options that were set."""
        return " against ".join(model.title for model in self.models)

    @property
    def differs(self) -> bool:
        """Whether any figure exceeds its tolerance, or anything else differs that moves the mechanism."""
        return super().differs or any(other.moves for other in self.uncompared)

    @cached_property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """None: of two models that differ neither is wrong."""
        return ()

    @property
    def verdict(self) -> str:
        """One line: whether they are the same, or the first level at which they are not, and where."""
        judged = [row for row in self.rows if not row.informs]
        failed = [row for row in judged if not row.agrees]
        names = " and ".join(model.title for model in self.models)
        ending = f"; {TO_THE_END}" if self.unfinished else ""
        if not failed:
            agree = f"{names} agree in all {len(judged)} figures{not_judged(self.rows)}"
            agree += "; nothing moves" if self.rests else ""
            if moving := [other for other in self.uncompared if other.moves]:
                more = f" (and {len(moving) - 1} more)" if len(moving) > 1 else ""
                return f"DIFFERENT in what is not compared: {moving[0].text}{more}; {agree}{ending}"
            if others := self.uncompared:
                count = "1 element" if len(others) == 1 else f"{len(others)} elements"
                agree += f"; not compared and different: {count}, first {others[0].text}"
            if self.unfinished:
                return f"UNFINISHED: {'; '.join(map(str, self.unfinished))}; as far as compared {agree}"
            return f"SAME: {agree}"
        row = failed[0]
        return (
            f"DIFFERENT: {names} part at level '{row.level}': {row.quantity}: {row.value:.3g} > "
            f"{row.tolerance:.3g}, worst at {row.where} ({len(failed)} of {len(judged)} figures fail){ending}"
        )

    def summary(self) -> dict[str, Any]:
        """As of any crosscheck, with what was compared."""
        models = [
            {
                "name": model.name,
                "source": model.source,
                "options": dict(model.options),
                "mapping": [asdict(entry) for entry in model.mapping.entries] if model.mapping else None,
                "start": model.mapping.start if model.mapping else None,
            }
            for model in self.models
        ]
        return super().summary() | {"models": models}


def together(models: tuple[Model, Model]) -> str:
    """What the two are called together, in files."""
    return "_against_".join(model.name for model in models)[:100]


def against(first: Model, second: Model, progress: Progress) -> Against:
    """Compare two models and run both for the first's duration; `progress` is told each stage.

    A run that cannot go on or is too long hides no difference that is known without it.

    Raises:
        CrosscheckError, NewtonEulerError: for models that cannot be compared.
    """
    begun = time.perf_counter()
    pair = first.name, second.name
    aligned = align(first.scene, second.scene)
    scenes = (aligned.first, aligned.second or second.scene)
    engines = [_engine(name, scene, aligned) for name, scene in zip(pair, scenes, strict=True)]
    with limited("comparing equations", SHORTER, progress):
        rows, notes, energy = _equations_compared(pair, aligned)
        others = tuple(uncompared(first, second, aligned))
    # bodies that have no partners cannot be laid over the first's
    able = engines[:1] if aligned.second is None else engines
    runs, stops = each_run(aligned.first, able, progress)
    if energy is not None and len(runs) == len(engines):
        # of both together: what a run is off by itself is no difference between models
        pairs = {
            name: replace(run, constraint_violation=None, potential_energy=None) for name, run in runs.items()
        }
        what = "comparing runs"
        with as_far_as_it_goes(what, stops), limited(what, SHORTER, progress):
            for row in finite(compare_runs(aligned.first, engines, pairs, energy)):
                rows.append(row)  # not all at once: those before an error are kept
    same_file = os.path.realpath(first.source) == os.path.realpath(second.source)
    if same_file and first.options == second.options:
        notes.insert(0, f"both are {first.title}: one model against itself")
    notes = [*aligned.notes, *notes, *map(str, others)]
    if stops:
        notes.insert(0, f"{TO_THE_END}: {'; '.join(map(str, stops))}")
    scene = replace(
        aligned.first, name=together((first, second)), description="newton_euler's equations of each"
    )
    return Against(
        source=first.source,
        options=first.options,
        scene=scene,
        engines=tuple(engines),
        left_out={},
        runs=runs,
        rows=tuple(rows),
        measured=(),
        wall_time=time.perf_counter() - begun,
        mapping=first.mapping,
        unfinished=tuple(stops),
        models=(first, second),
        uncompared=others,
        notes=tuple(notes),
    )


def _engine(name: str, scene: Scene, aligned: Aligned) -> Engine:
    """newton_euler with a model of its own, whatever scene it is asked to run; runs in the first's terms."""

    def seen(run: Trajectory) -> Trajectory:
        run = replace(run, engine=name)
        return run if scene is aligned.first else _in_first(run, aligned)

    return replace(
        ENGINE,
        name=name,
        simulate=lambda _: seen(ENGINE.simulate(scene)),
        refined=lru_cache(lambda _: seen(ENGINE.refined(scene))),
        systems=lambda _: (Relative(scene),),
    )


def _in_first(run: Trajectory, aligned: Aligned) -> Trajectory:
    """The second model's run with the joints and actuators of the first; 0 at what the first has alone."""
    assert aligned.second is not None
    a, b = aligned.first, aligned.second
    assert run.reaction_force is not None
    assert run.reaction_torque is not None
    force, torque = reactions_in_first(
        aligned, run.position, run.quaternion, run.reaction_force, run.reaction_torque
    )
    violation = actuation = None
    if run.constraint_violation is not None:
        violation = np.zeros((len(run.time), len(a.mechanism.joints)))
        for name, other in aligned.joints.items():
            k = b.mechanism.joint_index(other)
            violation[:, a.mechanism.joint_index(name)] = run.constraint_violation[:, k]
    if run.actuator_force is not None:
        actuation = np.zeros((len(run.time), len(a.control)))
        laws = {(law.joint, law.coordinate): k for k, law in enumerate(b.control)}
        for n, law in enumerate(a.control):
            partner = aligned.coordinates.get((law.joint, law.coordinate))
            if partner is not None and partner.key in laws:
                actuation[:, n] = partner.sense * run.actuator_force[:, laws[partner.key]]
    return replace(
        run,
        joint_names=a.mechanism.joint_names,
        reaction_force=force,
        reaction_torque=torque,
        constraint_violation=violation,
        actuator_force=actuation,
    )


def _equations_compared(pair: tuple[str, str], aligned: Aligned) -> tuple[list[Row], list[str], float | None]:
    """The figures of equations up to the first level that disagrees, and what there is to say about them.

    And if all agree the energy that those of runs are relative to at least, J.
    """
    if aligned.second is None:
        return [bodies_row(pair, aligned)], [], None
    scene = aligned.first
    start = States(scene, (scene.initial_state,))
    starts = list(start_rows(pair, aligned, Samples(Relative(scene), start).condition))
    found = tuple(differences(aligned))
    notes = list(beside_the_worst(found))
    if apart := [row for row in starts if not row.agrees]:
        told = "; ".join(f"{row.quantity}: {row.value:.1e} at {row.where}" for row in apart)
        notes.insert(0, f"starts differ: {told}; the models are compared where their bodies coincide best")
    rows: list[Row] = []

    def parts(level: Iterable[Row]) -> bool:
        """Whether the models part at a level; the later ones are not worked out then."""
        figures = list(finite(level))
        rows.extend(figures)
        failed = [row for row in figures if not row.agrees]
        if len(failed) > 1:
            also = "; ".join(f"{row.quantity}: {row.value:.1e} at {row.where}" for row in failed[1:])
            notes.append(f"differs too at level {failed[0].level!r}: {also}")
        return bool(failed)

    if parts(model_rows(pair, aligned, found)) or parts(starts):
        return rows, notes, None
    states = States(scene, (scene.initial_state, *random_states(scene, RANDOM_STATES)))
    first, second = Samples(Relative(scene), states), Samples(Relative(aligned.second), states)
    parted = (
        parts(kinematics_rows(pair, aligned, first, second))
        or parts(dynamics_rows(pair, aligned, first, second))
        or parts(acceleration_rows(pair, aligned, first, second))
    )
    return rows, notes, None if parted else states.energy
