"""Comparison of two models of one mechanism, such as two versions of a file.

In: two models. Out: a `TwoModelComparison`. newton_euler evaluates and simulates both models, and the checks
of `levels.py` are made level by level, up to the first level at which the models differ. All results of the
second model are expressed with the bodies, joints and signs of the first one (`align.py`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from crosscheck.compare.check import Check, not_judged, require_finite
from crosscheck.compare.comparison import ComparisonResult, ModelFile
from crosscheck.compare.crosscheck import Progress
from crosscheck.compare.levels import compare_pair
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.runs import compare_runs
from crosscheck.compare.samples import Samples
from crosscheck.compare.two_models.align import Aligned, alignments
from crosscheck.compare.two_models.levels import LEVELS, SharedStates, bodies_check, differences, start_checks
from crosscheck.compare.two_models.unsimulated import NEVER_COMPARED, Model, Unsimulated, is_mjcf, unsimulated
from crosscheck.engines.engine import ENGINES, Engine
from crosscheck.engines.engine_runs import Stop, collecting_errors, run_engines, stops_text
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
"""Number of random states, in addition to the start of the first model, at which equations are compared."""

NOT_COMPLETED = "not run to the end"
"""Text of the verdict on a run that stopped."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TwoModelComparison(ComparisonResult):
    """Result of a comparison of two models.

    The models take the place of engines: `engines`, `trajectories` and `checks` use their names. Results of
    the second model are expressed with the joints of the first one.

    Attributes:
        models: the two models.
        unsimulated: differences between the files in elements that are not simulated.
        notes: also how bodies and joints were paired, and all differences in `unsimulated`.
    """

    models: tuple[Model, Model]
    unsimulated: tuple[Unsimulated, ...] = ()

    @property
    def title(self) -> str:
        """Names of both models, with the options that the user set."""
        return " against ".join(model.title for model in self.models)

    @property
    def files(self) -> tuple[ModelFile, ...]:
        """The files of the models that were read from files, whose `mapping` is the import report."""
        return tuple(
            ModelFile(f"the file of {model.name}", f"{model.name}: ", model.scene, model.mapping)
            for model in self.models
            if model.mapping
        )

    @property
    def differs(self) -> bool:
        """True if a check fails, or if elements differ that are not simulated but can affect the motion."""
        return super().differs or any(other.moves for other in self.unsimulated)

    @property
    def outcome(self) -> Outcome:
        """Outcome: `DIFFERENT` (even if a run stopped later), else `UNFINISHED` or `SAME`."""
        if self.differs:
            return Outcome.DIFFERENT
        return Outcome.UNFINISHED if self.unfinished else Outcome.SAME

    @property
    def verdict(self) -> str:
        """Verdict in one line: the models are the same, or the first level and place at which they differ."""
        judged = self.judged
        failed = [check for check in judged if not check.agrees]
        names = " and ".join(model.title for model in self.models)
        ending = f"; {NOT_COMPLETED}" if self.unfinished else ""
        # All checks pass; elements that are not simulated may still differ
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
        # The first failing check, and the quantity that differs most at its level
        first = failed[0]
        worst = max(
            (each for each in failed if each.level == first.level), key=lambda each: each.tolerance_ratio
        )
        most = "" if worst is first else f", {worst.quantity.rpartition(', ')[0] or worst.quantity} most"
        return (
            f"DIFFERENT: {names} differ at level '{first.level}': {first.quantity}: {first.value:.3g} > "
            f"{first.tolerance:.3g}, worst at {first.place} "
            f"({len(failed)} of {len(judged)} checks fail{most}){ending}"
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


def pair_name(models: tuple[Model, Model]) -> str:
    """Return the name of a pair of models for files: "a_against_b"."""
    return "_against_".join(model.name for model in models)[:100]


def compare_models(first: Model, second: Model, progress: Progress) -> TwoModelComparison:
    """Compare two models: their equations, and their runs over the duration of the first model.

    Differences that are found before a run stops are still reported.

    Args:
        first, second: the models.
        progress: shows a message to the user before each stage.

    Raises:
        CrosscheckError, NewtonEulerError: for models that cannot be compared.
    """
    start = time.perf_counter()
    pair = first.name, second.name
    # Align the models and compare their equations
    stopped: list[Stop] = []
    with limited("comparing equations", SHORTER_RUN_ADVICE, progress):
        states = _aligned_best(list(alignments(first.scene, second.scene)), stopped)
        aligned, engines = states.aligned, _engines(pair, states.aligned)
        checks, notes = _equations_compared(pair, engines, states)
    # Simulate both models and compare their runs, if the equations agree
    runs, stops = run_engines(aligned.first, engines, progress)
    stops = [*stopped, *stops]
    if len(runs) == len(pair) and all(check.agrees for check in checks):
        # Without these outputs there are no checks of a single run, which are no differences between models
        compared = {
            name: replace(run, constraint_violation=None, potential_energy=None) for name, run in runs.items()
        }
        what = "comparing runs"
        with collecting_errors(what, stops), limited(what, SHORTER_RUN_ADVICE, progress):
            for check in require_finite(compare_runs(aligned.first, engines, compared, states.energy)):
                checks.append(check)  # one by one, to keep the checks before an error
    # Notes, and differences of elements that are not simulated
    same_file = os.path.realpath(first.source) == os.path.realpath(second.source)
    if same_file and first.options == second.options:
        notes.insert(0, f"both are {first.title}: one model against itself")
    if stops:
        notes.insert(0, f"{NOT_COMPLETED}: {stops_text(stops)}")
    others = tuple(unsimulated(first, second, aligned))
    scene = replace(
        aligned.first, name=pair_name((first, second)), description="newton_euler's equations of each"
    )
    return TwoModelComparison(
        source=first.source,
        options=first.options,
        scene=scene,
        engines=tuple(engines),
        trajectories=runs,
        checks=tuple(checks),
        wall_time=time.perf_counter() - start,
        unfinished=tuple(stops),
        models=(first, second),
        unsimulated=others,
        notes=(*notes, *aligned.notes, *(f"not compared, and {other.text}" for other in others)),
    )


def _aligned_best(candidates: Sequence[Aligned], stops: list[Stop]) -> SharedStates:
    """Choose the alignment with the fewest differing bodies and joints; the first one of several.

    Args:
        candidates: possible alignments.
        stops: if no random states can be found, the reason is appended here, and the start alone is used.

    Returns:
        The states at which equations are compared, with the alignment.
    """
    scene, states = candidates[0].first, [initial_state(candidates[0].first)]
    if candidates[0].second is not None:
        with collecting_errors("random states", stops):
            states += random_states(scene, RANDOM_STATES)
    shared = [SharedStates(scene, tuple(states), aligned) for aligned in candidates]
    if len(shared) == 1:
        return shared[0]
    return min(shared, key=lambda each: sum(len(found.differing) for found in differences(each)))


def _equations_compared(
    pair: tuple[str, str], engines: Sequence[Engine], states: SharedStates
) -> tuple[list[Check], list[str]]:
    """Compare the equations of the two models.

    Returns:
        Checks up to the first level at which the models differ, and notes on different initial states.
    """
    if states.aligned.second is None:
        return [bodies_check(pair, states.aligned)], []
    first, second = (engine.systems(states.scene)[0] for engine in engines)
    one, two = Samples(first, states), _SecondSamples(second, states)
    checks = list(require_finite(compare_pair(pair, [one], [two], LEVELS)))
    differences = [
        f"{check.quantity}: {check.value:.1e} at {check.where}"
        for check in start_checks(pair, one, two)
        if not check.agrees
    ]
    return checks, [f"starts differ: {'; '.join(differences)}"] if differences else []


class _SecondSamples(Samples):
    """Equations of the second model at states of the first model."""

    @cached_property
    def coordinates(self) -> list[tuple[Array, Array]]:
        """Coordinates q and velocities v at each state, with angles as the second model counts them."""
        assert isinstance(self.states, SharedStates)
        in_second = self.states.aligned.in_second
        return [self.system.coordinates(in_second(state)) for state in self.states.all]


class _SecondModel(Relative):
    """Joint-coordinate equations of motion of the second model, with reactions at joints of the first model.

    Attributes:
        aligned: the alignment of both models, set after construction.
    """

    aligned: Aligned

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Evaluate accelerations and reactions; see `Relative.evaluate`."""
        found = super().evaluate(q, v)
        state = found.state
        motion = state.position[None], state.quaternion[None]
        reactions = found.reaction_force[None], found.reaction_torque[None]
        (force,), (torque,) = reactions_in_first(self.aligned, *motion, *reactions)
        return replace(found, reaction_force=force, reaction_torque=torque)


def _engines(pair: tuple[str, str], aligned: Aligned) -> list[Engine]:
    """Return each model as an `Engine`, so that models are compared as engines are.

    Each engine simulates its own model in newton_euler, whatever scene it is given. Results of the second
    model are expressed with the joints of the first one. If a body has no partner, only the engine of the
    first model is returned. Refined runs, with tighter tolerances, are kept for repeated use.

    Args:
        pair: names of the models.
        aligned: their alignment.
    """

    def in_first_terms(name: str, run: Trajectory) -> Trajectory:
        run = replace(run, engine=name)
        return run if name == pair[0] else _in_first(run, aligned)

    def engine(name: str, scene: Scene) -> Engine:
        system = Relative(scene) if name == pair[0] else _SecondModel(scene)
        if isinstance(system, _SecondModel):
            system.aligned = aligned
        return replace(
            ENGINE,
            name=name,
            simulate=lambda _: in_first_terms(name, ENGINE.simulate(scene)),
            refined=lru_cache(lambda _: in_first_terms(name, ENGINE.refined(scene))),
            systems=lambda _: (system,),
        )

    first = engine(pair[0], aligned.first)
    return [first] if aligned.second is None else [first, engine(pair[1], aligned.second)]


def reactions_in_first(
    aligned: Aligned, position: Array, quaternion: Array, force: Array, torque: Array
) -> tuple[Array, Array]:
    """Convert reactions of the second model to the convention of the first: its second body, its joint point.

    Bodies of both models have the same order and frames. The result is exact if the centers of mass agree.

    Args:
        aligned: the alignment of both models.
        position, quaternion: (n, b, 3), m, and (n, b, 4) poses of the second model's bodies at n times.
        force, torque: (n, k, 3) reactions of the k joints of the second model, N and N m, world frame.

    Returns:
        Forces and torques (n, j, 3) of the j joints of the first model; 0 for a joint without partner.
    """
    a, b = (scene.mechanism for scene in aligned.both)
    forces, torques = np.zeros((2, len(force), len(a.joints), 3))

    def reaction_point(mechanism: Mechanism, joint: Joint) -> Array:
        """Return positions (n, 3) of the point of a joint, m, world frame."""
        k = mechanism.body_index(joint.second)
        arm = mechanism.bodies[k].pose.point_to_body(joint.point_on_second)
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
    """Express a run of the second model with the joints and actuators of the first.

    Values are 0 for joints and actuators without partner.
    """
    # Reactions and constraint violations
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
    # Actuator forces, with the sign of the first model's coordinate
    actuation = np.zeros((len(run.time), len(a.control)))
    numbers = {law.key: n for n, law in enumerate(a.control)}
    for k, law in enumerate(b.control):
        key, sense = aligned.of_first(law.key)
        if key in numbers and run.actuator_force is not None:
            actuation[:, numbers[key]] = sense * run.actuator_force[:, k]
    # Joint angles, as the first model counts them
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
