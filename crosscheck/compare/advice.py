"""Advice on a crosscheck: MuJoCo's step for a wanted error, and joints without redundant constraints.

In: the runs and checks of a crosscheck. Out: sentences of advice.

Redundant constraints leave joint reactions undetermined. A planar four-bar linkage with four parallel hinges,
for example, has three redundant constraints in space. With a ball joint in place of one hinge and a
cylindrical joint in place of another, no constraint is redundant and the motion is the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from crosscheck.compare.check import Check
from crosscheck.compare.runs import nothing_moves_in_rigid_runs
from crosscheck.engines.engine import Engine
from crosscheck.engines.stiffness import is_stable_in_rk4, modes_of_run
from newton_euler.equations.couplings import couplings
from newton_euler.equations.undetermined import undetermined
from newton_euler.errors import NewtonEulerError
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Cylindrical, Spherical
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory, distance
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state

WANTED_ERROR = 1e-6
"""Error of a run, m and rad, that the advised step of MuJoCo is for."""


@dataclass(frozen=True)
class Advice:
    """One piece of advice.

    Attributes:
        topic: "mujoco" (its step), "softness" (of its constraints) or "redundancy" (of constraints).
        text: one or two sentences, with the measured numbers.
    """

    topic: str
    text: str

    def __str__(self) -> str:
        return f"{self.topic}: {self.text}"


def advise(
    scene: Scene, engines: Sequence[Engine], runs: Mapping[str, Trajectory], rows: Sequence[Check]
) -> tuple[Advice, ...]:
    """Give advice on MuJoCo's settings and on redundant constraints; empty if there is none.

    Runs in which nothing moves give no advice on settings, since their errors do not represent a motion.

    Args:
        scene: scene that was simulated.
        engines: engines that were compared.
        runs: runs by engine.
        rows: all checks.
    """
    moving = not nothing_moves_in_rigid_runs(scene, engines, runs)
    of_runs = soft_advice(scene, engines, runs, rows) if moving else ()
    return (*of_runs, *redundancy_advice(scene))


# MuJoCo's step and softness

NAME = "mujoco"
"""Name of the engine that the advice is on."""

MAX_EXTRAPOLATION = 4.0
"""Largest ratio of an advised step to the step of the run: a measured order is valid near that step only."""

PLAUSIBLE_ORDERS = (0.5, 4.5)
"""Range of measured orders of convergence that are used for advice."""

STEP_MARGIN = 0.9
"""Safety factor on the advised step, since the measured order is not exact."""


def soft_advice(
    scene: Scene, engines: Sequence[Engine], runs: Mapping[str, Trajectory], rows: Sequence[Check]
) -> Iterator[Advice]:
    """Advise on MuJoCo's step and on the softness of its constraints.

    There is no advice without a run of another engine, or if the equations of the engines differ. MuJoCo's
    error is the distance to the closest other run. Softness is mentioned if trajectories differ and the scene
    has soft constraints in MuJoCo.

    Args:
        scene, engines, runs, rows: see `advise`.
    """
    of_equations = [row for row in rows if not row.level.startswith(("trajectories", "drift", "energy"))]
    if NAME not in runs or len(runs) < 2 or not of_equations:
        return
    if not all(row.agrees for row in of_equations):
        return
    # MuJoCo's error at its step, and at half the step
    errors = {name: distance(runs[NAME], run) for name, run in runs.items() if name != NAME}
    other = min(errors, key=lambda name: errors[name])
    engine = next(engine for engine in engines if engine.name == NAME)
    try:
        error, refined_error = errors[other], distance(engine.refined(scene), runs[other])
    except NewtonEulerError:
        return
    if min(error, refined_error) == 0.0:
        return
    differ = any(row.level == "trajectories" and NAME in row.between and not row.agrees for row in rows)
    if differ and has_equalities(scene):
        yield Advice(
            "softness",
            "MuJoCo's constraints are soft, the model is the same: made rigid they agree in all that was "
            f"compared before the runs, and half the step takes MuJoCo's distance to {other} from "
            f"{error:.2g} to {refined_error:.2g} (m, rad)",
        )
    yield _step_advice(scene, runs, error, refined_error)


def _step_advice(scene: Scene, runs: Mapping[str, Trajectory], error: float, refined_error: float) -> Advice:
    """Advise the step of MuJoCo for `WANTED_ERROR`, extrapolated from two measured errors.

    Args:
        scene: the scene.
        runs: runs by engine, with MuJoCo's.
        error: MuJoCo's error at the step of its run, m or rad.
        refined_error: MuJoCo's error at half the step, m or rad.
    """
    # The order of convergence
    settings = runs[NAME].settings
    step, order = float(settings["timestep"]), float(np.log2(error / refined_error))
    measured = (
        f"at {step:.4g} s it is {error:.2g}, at half of that {refined_error:.2g}, an order of {order:.2g}"
    )
    if not PLAUSIBLE_ORDERS[0] <= order <= PLAUSIBLE_ORDERS[1]:
        return Advice(NAME, f"its error does not follow its step, so that none can be advised: {measured}")
    # The step, rounded to a decimal number and checked for stability
    advised = STEP_MARGIN * step * (WANTED_ERROR / error) ** (1.0 / order)
    advised = rounded_step(scene, min(advised, MAX_EXTRAPOLATION * step))
    if advised > step and settings["integrator"] == "RK4":
        modes = modes_of_run(scene, runs.get("newton_euler"))
        advised = advised if is_stable_in_rk4(modes, advised) else step
    # The sentence; with settings of constraints, since MuJoCo's default ones are much softer
    relation = "is enough for" if advised >= step else "is needed for"
    constraints = ""
    if has_equalities(scene):
        solimp = " ".join(f"{value:g}" for value in settings["solimp"])
        constraints = f', solref "{2.0 * advised:.12g} 1" and solimp "{solimp}" of all equalities'
    return Advice(
        NAME,
        f"{settings['integrator']} with timestep {advised:.12g} s{constraints} {relation} an error of "
        f"{WANTED_ERROR:g} (m, rad): {measured}",
    )


def has_equalities(scene: Scene) -> bool:
    """Return True if a scene has soft constraints in MuJoCo: loops, gears, screws or prescribed motions."""
    return bool(SpanningTree(scene.mechanism).cuts or couplings(scene))


def rounded_step(scene: Scene, step: float) -> float:
    """Return the largest step, s, not above `step`, that divides the output period and can be written down.

    The period is divided by an integer that is a product of twos and fives, so the step is a short decimal
    number. With digital control, MuJoCo's default step is divided instead.
    """
    from mjcf.simulate import default_timestep

    period = default_timestep(scene)
    if not scene.sampled and scene.output_period <= scene.duration:
        period = scene.output_period
    number = max(1, int(np.ceil(period / step * (1.0 - 1e-9))))  # 1e-9 allows for round-off
    while _without_factor(_without_factor(number, 2), 5) != 1:
        number += 1
    return period / number


def _without_factor(number: int, prime: int) -> int:
    """Divide a number by a prime as often as possible."""
    while number % prime == 0:
        number //= prime
    return number


# Redundant constraints

SOFTER: dict[str, tuple[type[Joint], ...]] = {
    "revolute": (Cylindrical, Spherical),
    "prismatic": (Cylindrical,),
    "universal": (Spherical,),
    "fixed": (Spherical,),
}
"""Kinds of joints with more freedom that can replace a joint of each kind, with the same point and axis."""

MAX_CHANGED_JOINTS = 20
"""Largest number of joints that are changed, beginning with joints to which no other element refers."""

REDUNDANCY_TEST_STATES = 1
"""Number of random states, in addition to the initial state, at which redundant constraints are counted."""


class Change(NamedTuple):
    """A mechanism with the same motions, in which one joint is replaced or left out.

    Attributes:
        redundant: number of its redundant constraint equations.
        text: description of the change.
        mechanism: the changed mechanism.
    """

    redundant: int
    text: str
    mechanism: Mechanism


def redundancy_advice(scene: Scene) -> Iterator[Advice]:
    """Advise which joints to replace by joints with more freedom, so that no constraint is redundant.

    Joints are replaced one after the other; each time the change that leaves the fewest redundant constraints
    is taken.
    """
    states = [initial_state(scene), *random_states(scene, REDUNDANCY_TEST_STATES)]
    redundant = _count_redundant(scene.mechanism, states)
    if redundant == 0:
        return
    # Joints that may be changed: those with constraints and without couplings, unreferenced ones first
    referenced = _referenced_joints(scene)
    coupled = {joint for coupling in couplings(scene) for joint, _ in coupling.factors}
    joints = zip(scene.mechanism.joints, scene.mechanism.equations, strict=True)
    candidates = [joint for joint, equations in joints if equations.count and joint.name not in coupled]
    candidates.sort(key=lambda joint: (joint.name in referenced, joint.actuated))
    names = [joint.name for joint in candidates[:MAX_CHANGED_JOINTS]]
    # The best change, repeatedly
    mechanism, texts, left = scene.mechanism, list[str](), redundant
    while left:
        changes = _changes(mechanism, left, names, referenced, states)
        best = min(changes, key=lambda change: change.redundant, default=Change(left, "", mechanism))
        if best.redundant >= left:
            break
        left = best.redundant
        texts.append(best.text)
        mechanism = best.mechanism
    if not texts:
        return
    noun = "constraint" if redundant == 1 else "constraints"
    rest = f"then {left} of them {'is' if left == 1 else 'are'} left"
    if left == 0:
        rest = "then all reactions are determined"
    yield Advice(
        "redundancy",
        f"{redundant} redundant {noun}; the motion is the same with {', '.join(texts)}: {rest}",
    )


def _count_redundant(mechanism: Mechanism, states: list[State]) -> int:
    """Count the constraint equations that are redundant in all of the states."""
    scene = Scene("tried", mechanism, 1.0, 1.0)
    return min(undetermined(scene, state).shape[1] for state in states)


def _count_constraints(mechanism: Mechanism) -> int:
    """Count the constraint equations of all joints."""
    return sum(equations.count for equations in mechanism.equations)


def _referenced_joints(scene: Scene) -> set[str]:
    """Return names of joints that are actuated, or that a force, controller, motion or armature refers to."""
    named = {law.joint for law in scene.control} | {motion.joint for motion in scene.motions}
    named |= {armature.joint for armature in scene.armatures}
    named |= {str(getattr(force, "joint", "")) for force in scene.forces}
    return named | {joint.name for joint in scene.mechanism.joints if joint.actuated}


def _changes(
    mechanism: Mechanism, redundant: int, names: list[str], referenced: set[str], states: list[State]
) -> Iterator[Change]:
    """Yield all changes of one joint that keep the motions of a mechanism.

    Args:
        mechanism: the mechanism.
        redundant: number of its redundant constraint equations.
        names: names of the joints that may be changed.
        referenced: names of joints whose coordinates must be kept.
        states: states at which redundant constraints are counted.
    """
    rank = _count_constraints(mechanism) - redundant
    joints = {joint.name: joint for joint in mechanism.joints}
    for name in names:
        if name not in joints:
            continue
        joint = joints[name]
        for text, other in _replacements(joint, name in referenced):
            changed = [other if j is joint else j for j in mechanism.joints]
            kept = [j for j in changed if j is not None]
            try:
                tried = Mechanism(mechanism.bodies, kept, mechanism.couplings)
                left = _count_redundant(tried, states)
                if _count_constraints(tried) - left == rank:
                    yield Change(left, text, tried)
            except NewtonEulerError:  # a body is not connected any more
                continue


def _replacements(joint: Joint, referenced: bool) -> Iterator[tuple[str, Joint | None]]:
    """Yield joints that may replace a joint, with a description; None to leave the joint out.

    Args:
        joint: the joint.
        referenced: True if the coordinates of the joint must be kept.
    """
    if not referenced:
        yield f"joint {joint.name!r} left out", None
    for kind in SOFTER.get(joint.kind, ()):
        softer = _of_kind(joint, kind)
        if not referenced or set(joint.coordinate_kinds) <= set(softer.coordinate_kinds):
            yield f"a {kind.kind} joint for the {joint.kind} {joint.name!r}", softer


def _of_kind(joint: Any, kind: type[Joint]) -> Joint:
    """Return a joint of another kind with the same name, bodies, points and axis."""
    axis = {"axis": joint.axis} if "axis" in kind.axis_names else {}
    return kind(
        joint.name, joint.first, joint.second, joint.point, point_on_second=joint.point_on_second, **axis
    )
