"""Two models of one mechanism compared: levels in their order, up to the first that disagrees."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from crosscheck.compare.check import Check, finite, not_judged
from crosscheck.compare.crosscheck import Crosscheck, Progress
from crosscheck.compare.diagnosis import Diagnosis
from crosscheck.compare.levels import compare_pair
from crosscheck.compare.runs import compare_runs
from crosscheck.compare.samples import Samples
from crosscheck.compare.two_models.align import Aligned, alignments
from crosscheck.compare.two_models.levels import LEVELS, SharedStates, bodies_row, differences, start_rows
from crosscheck.compare.two_models.unsimulated import NEVER_COMPARED, Model, Unsimulated, is_mjcf, unsimulated
from crosscheck.engines.engine import ENGINES, Engine
from crosscheck.engines.engine_runs import Stop, collecting_errors, run_engines, stops_text
from crosscheck.report.outcome import Outcome
from crosscheck.support.time_limits import SHORTER_RUN_ADVICE, limited
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.joint import Joint
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

ENGINE = ENGINES["newton_euler"]
"""Engine that evaluates both models."""

RANDOM_STATES = 8
"""Number of random consistent states, besides the first model's start, at which the equations are
compared."""

NOT_COMPLETED = "not run to the end"
"""Text on a run that stopped."""


@dataclass(frozen=True, eq=False)
class TwoModelComparison(Crosscheck):
    """Result of a comparison of two models; runs are by the models' names, in the first's terms.

    Attributes:
        models: the two.
        unsimulated: what the files do not have alike and no check is about.
        notes: also what was taken for what, and all that differs.
    """

    models: tuple[Model, Model] = field(kw_only=True)
    unsimulated: tuple[Unsimulated, ...] = ()

    @property
    def title(self) -> str:
        """Both models, with the options that were set."""
        return " against ".join(model.title for model in self.models)

    @property
    def differs(self) -> bool:
        """True if any check exceeds its tolerance, or anything else differs that moves the mechanism."""
        return super().differs or any(other.moves for other in self.unsimulated)

    @property
    def outcome(self) -> Outcome:
        """Same, different, or unfinished; a difference that was found before a run stopped is one."""
        if self.differs:
            return Outcome.DIFFERENT
        return Outcome.UNFINISHED if self.unfinished else Outcome.SAME

    @property
    def agrees(self) -> bool:
        """True if the two models do not differ in anything that was compared, and all was."""
        return self.outcome is Outcome.SAME

    @cached_property
    def diagnosis(self) -> tuple[Diagnosis, ...]:
        """None: of two models that differ neither is wrong."""
        return ()

    @property
    def verdict(self) -> str:
        """One line: whether they are the same, or the first level at which they are not, and where."""
        judged = [row for row in self.checks if row.judged]
        failed = [row for row in judged if not row.agrees]
        names = " and ".join(model.title for model in self.models)
        ending = f"; {NOT_COMPLETED}" if self.unfinished else ""
        if not failed:
            agree = f"{names} agree in all {len(judged)} checks{not_judged(self.checks)}"
            agree += "; nothing moves" if self.nothing_moves else ""
            if moving := [other for other in self.unsimulated if other.moves]:
                more = f" (and {len(moving) - 1} more)" if len(moving) > 1 else ""
                return f"DIFFERENT in what is not compared: {moving[0].text}{more}; {agree}{ending}"
            if others := self.unsimulated:
                count = "1 element" if len(others) == 1 else f"{len(others)} elements"
                agree += f"; not compared and different: {count}, first {others[0].text}"
            if self.unfinished:
                return f"UNFINISHED: {stops_text(self.unfinished)}; as far as compared {agree}"
            if all(map(is_mjcf, self.models)):
                agree += f"; {NEVER_COMPARED}"
            return f"SAME: {agree}"
        row = failed[0]
        worst = max(
            (each for each in failed if each.level == row.level), key=lambda each: each.tolerance_ratio
        )
        beside = "" if worst is row else f", {worst.quantity.rpartition(', ')[0] or worst.quantity} most"
        return (
            f"DIFFERENT: {names} differ at level '{row.level}': {row.quantity}: {row.value:.3g} > "
            f"{row.tolerance:.3g}, worst at {row.place} "
            f"({len(failed)} of {len(judged)} checks fail{beside}){ending}"
        )

    def summary(self) -> dict[str, Any]:
        """Summary of a crosscheck, with the two models, for JSON."""
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
    """Return the name of a pair of models in files."""
    return "_against_".join(model.name for model in models)[:100]


def compare_models(first: Model, second: Model, progress: Progress) -> TwoModelComparison:
    """Compare two models and run both for the first's duration; `progress` is told each stage.

    A run that cannot go on or is too long hides no difference that is known without it.

    Raises:
        CrosscheckError, NewtonEulerError: for models that cannot be compared.
    """
    begun = time.perf_counter()
    pair = first.name, second.name
    stopped: list[Stop] = []
    with limited("comparing equations", SHORTER_RUN_ADVICE, progress):
        states = _aligned_best(list(alignments(first.scene, second.scene)), stopped)
        aligned, engines = states.aligned, _engines(pair, states.aligned)
        rows, notes = _equations_compared(pair, engines, states)
    runs, stops = run_engines(aligned.first, engines, progress)
    stops = [*stopped, *stops]
    if len(runs) == len(pair) and all(row.agrees for row in rows):
        # of both together: what a run is off by itself is no difference between models
        pairs = {
            name: replace(run, constraint_violation=None, potential_energy=None) for name, run in runs.items()
        }
        what = "comparing runs"
        with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
            for row in finite(compare_runs(aligned.first, engines, pairs, states.energy)):
                rows.append(row)  # not all at once: those before an error are kept
    same_file = os.path.realpath(first.source) == os.path.realpath(second.source)
    if same_file and first.options == second.options:
        notes.insert(0, f"both are {first.title}: one model against itself")
    if stops:
        notes.insert(0, f"{NOT_COMPLETED}: {stops_text(stops)}")
    others = tuple(unsimulated(first, second, aligned))
    scene = replace(
        aligned.first, name=together((first, second)), description="newton_euler's equations of each"
    )
    return TwoModelComparison(
        source=first.source,
        options=first.options,
        scene=scene,
        engines=tuple(engines),
        left_out={},
        trajectories=runs,
        checks=tuple(rows),
        measured=(),
        wall_time=time.perf_counter() - begun,
        mapping=first.mapping,
        unfinished=tuple(stops),
        models=(first, second),
        unsimulated=others,
        notes=(*notes, *aligned.notes, *(f"not compared, and {other.text}" for other in others)),
    )


def _aligned_best(candidates: Sequence[Aligned], stops: list[Stop]) -> SharedStates:
    """The alignment by which the fewest bodies and joints differ, of equals the first, and states for it.

    The start alone, and one more of the stops, where no random states can be had.
    """
    scene, states = candidates[0].first, [initial_state(candidates[0].first)]
    if candidates[0].second is not None:
        with collecting_errors("random states", stops):
            states += random_states(scene, RANDOM_STATES)
    shared = [SharedStates(scene, tuple(states), aligned) for aligned in candidates]
    if len(shared) == 1:
        return shared[0]
    return min(shared, key=lambda each: sum(len(found.larger) for found in differences(each)))


def _equations_compared(
    pair: tuple[str, str], engines: Sequence[Engine], states: SharedStates
) -> tuple[list[Check], list[str]]:
    """Figures of equations up to the first level that disagrees, and what there is to say of the starts."""
    if states.aligned.second is None:
        return [bodies_row(pair, states.aligned)], []
    first, second = (engine.systems(states.scene)[0] for engine in engines)
    one, two = Samples(first, states), _SecondSamples(second, states)
    rows = list(finite(compare_pair(pair, [one], [two], LEVELS)))
    apart = [
        f"{row.quantity}: {row.value:.1e} at {row.where}"
        for row in start_rows(pair, one, two)
        if not row.agrees
    ]
    return rows, [f"starts differ: {'; '.join(apart)}"] if apart else []


class _SecondSamples(Samples):
    """The second model at states of the first."""

    @cached_property
    def coordinates(self) -> list[tuple[Array, Array]]:
        """q and v at each state, its angles as the second model counts them."""
        assert isinstance(self.states, SharedStates)
        in_second = self.states.aligned.in_second
        return [self.system.coordinates(in_second(state)) for state in self.states.all]


class _Second(Relative):
    """Equations of motion of the second model, with reactions in the first's terms.

    Attributes:
        aligned: both models; what control laws make of this class for a model of their own has none.
    """

    aligned: Aligned

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        found = super().evaluate(q, v)
        state = found.state
        motion = state.position[None], state.quaternion[None]
        reactions = found.reaction_force[None], found.reaction_torque[None]
        (force,), (torque,) = reactions_in_first(self.aligned, *motion, *reactions)
        return replace(found, reaction_force=force, reaction_torque=torque)


def _engines(pair: tuple[str, str], aligned: Aligned) -> list[Engine]:
    """newton_euler with each model, whatever scene it is asked to run, in the first's terms.

    The first alone if bodies have no partners: then the second cannot be laid over it.
    """

    def seen(name: str, run: Trajectory) -> Trajectory:
        run = replace(run, engine=name)
        return run if name == pair[0] else _in_first(run, aligned)

    def engine(name: str, scene: Scene) -> Engine:
        system = Relative(scene) if name == pair[0] else _Second(scene)
        if isinstance(system, _Second):
            system.aligned = aligned
        return replace(
            ENGINE,
            name=name,
            simulate=lambda _: seen(name, ENGINE.simulate(scene)),
            refined=lru_cache(lambda _: seen(name, ENGINE.refined(scene))),
            systems=lambda _: (system,),
        )

    first = engine(pair[0], aligned.first)
    return [first] if aligned.second is None else [first, engine(pair[1], aligned.second)]


def reactions_in_first(
    aligned: Aligned, position: Array, quaternion: Array, force: Array, torque: Array
) -> tuple[Array, Array]:
    """Reactions of the second model's joints as the first model has them: on its second body, at its point.

    Args:
        position, quaternion: (n, b, 3) and (n, b, 4) of the second model's bodies.
        force, torque: (n, k, 3) of its k joints, N and N m.

    Returns:
        (n, j, 3) both for the j joints of the first; 0 at those that it has alone.
    """
    a, b = (scene.mechanism for scene in aligned.both)
    forces, torques = np.zeros((2, len(force), len(a.joints), 3))

    def reaction_point(mechanism: Mechanism, joint: Joint) -> Array:
        k = mechanism.body_index(joint.second)
        arm = mechanism.bodies[k].pose.point_to_body(joint.reaction_point)
        return np.asarray(position[:, k] + rotations(quaternion[:, k]) @ arm)

    for name, other in aligned.joints.items():
        j, k = a.joint_index(name), b.joint_index(other)
        one, two = aligned.joint_pair(name)
        sign = 1.0 if one.second == two.second else -1.0
        forces[:, j] = sign * force[:, k]
        arm = reaction_point(b, two) - reaction_point(a, one)
        torques[:, j] = sign * torque[:, k] + np.cross(arm, forces[:, j])
    return forces, torques


def _in_first(run: Trajectory, aligned: Aligned) -> Trajectory:
    """The second model's run with the joints and actuators of the first; 0 at what the first has alone."""
    a, b = aligned.both
    assert run.reaction_force is not None
    assert run.reaction_torque is not None
    assert run.constraint_violation is not None
    reactions = run.reaction_force, run.reaction_torque
    force, torque = reactions_in_first(aligned, run.position, run.quaternion, *reactions)
    violation = np.zeros((len(run.time), len(a.mechanism.joints)))
    for name, other in aligned.joints.items():
        k = b.mechanism.joint_index(other)
        violation[:, a.mechanism.joint_index(name)] = run.constraint_violation[:, k]
    actuation = np.zeros((len(run.time), len(a.control)))
    numbers = {law.key: n for n, law in enumerate(a.control)}
    for k, law in enumerate(b.control):
        key, sense = aligned.of_first(law.key)
        if key in numbers and run.actuator_force is not None:
            actuation[:, numbers[key]] = sense * run.actuator_force[:, k]
    angles, labels = dict[str, Array](), a.mechanism.coordinate_labels
    keys = {label: key for key, label in b.mechanism.coordinate_labels.items()}
    for column, label in enumerate(run.angle_names):
        key, sense = aligned.of_first(keys[label])
        if key in aligned.coordinates and run.joint_angle is not None:
            here, there = aligned.at_start[key]
            angles[labels[key]] = here + sense * (run.joint_angle[:, column] - there)
    return replace(
        run,
        joint_names=a.mechanism.joint_names,
        angle_names=tuple(angles),
        joint_angle=np.column_stack([*angles.values()]) if angles else None,
        reaction_force=force,
        reaction_torque=torque,
        constraint_violation=violation,
        actuator_force=actuation,
    )
