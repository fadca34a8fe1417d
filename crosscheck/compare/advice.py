"""Advice on a crosscheck: MuJoCo's step and softness for an error, and which joints make reactions unique.

A planar loop of four hinges, built in space, has three rows too many: what they hold is held already. With
a ball in place of one hinge and a cylindrical joint in place of another, nothing is held twice and the
motion is the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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

WANTED = 1e-6
"""m and rad, the error that advice is for."""


@dataclass(frozen=True)
class Advice:
    """One piece of advice.

    Attributes:
        topic: "mujoco", "softness" or "redundancy".
        text: a sentence or two with the numbers that it is made of.
    """

    topic: str
    text: str

    def __str__(self) -> str:
        return f"{self.topic}: {self.text}"


def advise(
    scene: Scene, engines: Sequence[Engine], runs: Mapping[str, Trajectory], rows: Sequence[Check]
) -> tuple[Advice, ...]:
    """Give advice on what was measured; none where nothing is to be done.

    Runs in which nothing moves are no ground for any: what they are off says nothing about a motion.

    Args:
        scene: what was run.
        engines: that ran.
        runs: by engine.
        rows: the compared figures.
    """
    moving = not nothing_moves_in_rigid_runs(scene, engines, runs)
    of_runs = soft_advice(scene, engines, runs, rows) if moving else ()
    return (*of_runs, *redundancy_advice(scene))


# MuJoCo's step and softness

NAME = "mujoco"

MAX_EXTRAPOLATION = 4.0
"""Largest ratio of an advised step to the longer of two measured steps; a measured order holds only
nearby."""

PLAUSIBLE_ORDERS = (0.5, 4.5)
"""Range of measured orders that are used for advice."""

STEP_MARGIN = 0.9
"""Factor on the advised step, since the order is not measured exactly."""


def soft_advice(
    scene: Scene, engines: Sequence[Engine], runs: Mapping[str, Trajectory], rows: Sequence[Check]
) -> Iterator[Advice]:
    """Advise on MuJoCo's step and constraint softness, if MuJoCo ran together with an engine of rigid
    constraints.

    MuJoCo's error is the distance to the closest other run. Softness is mentioned only if the scene has
    constraints.
    """
    before = [row for row in rows if not row.level.startswith(("trajectories", "drift", "energy"))]
    if NAME not in runs or len(runs) < 2 or not before or not all(row.agrees for row in before):
        return
    errors = {name: distance(runs[NAME], run) for name, run in runs.items() if name != NAME}
    other = min(errors, key=lambda name: errors[name])
    engine = next(engine for engine in engines if engine.name == NAME)
    try:
        error, finer = errors[other], distance(engine.refined(scene), runs[other])
    except NewtonEulerError:
        return
    if min(error, finer) == 0.0:
        return
    apart = any(row.level == "trajectories" and NAME in row.between and not row.agrees for row in rows)
    if apart and has_equalities(scene):
        yield Advice(
            "softness",
            "MuJoCo's constraints are soft, the model is the same: made rigid they agree in all that was "
            f"compared before the runs, and half the step takes MuJoCo's distance to {other} from "
            f"{error:.2g} to {finer:.2g} (m, rad)",
        )
    yield _step_advice(scene, runs, error, finer)


def _step_advice(scene: Scene, runs: Mapping[str, Trajectory], error: float, finer: float) -> Advice:
    """The step for the wanted error, by errors at the step that was taken and at half of it."""
    settings = runs[NAME].settings
    step, order = float(settings["timestep"]), float(np.log2(error / finer))
    measured = f"at {step:.4g} s it is {error:.2g}, at half of that {finer:.2g}, an order of {order:.2g}"
    if not PLAUSIBLE_ORDERS[0] <= order <= PLAUSIBLE_ORDERS[1]:
        return Advice(NAME, f"its error does not follow its step, so that none can be advised: {measured}")
    wanted = STEP_MARGIN * step * (WANTED / error) ** (1.0 / order)
    wanted = fitting(scene, min(wanted, MAX_EXTRAPOLATION * step))
    if wanted > step and settings["integrator"] == "RK4":
        modes = modes_of_run(scene, runs.get("newton_euler"))
        wanted = wanted if is_stable_in_rk4(modes, wanted) else step
    relation = "is enough for" if wanted >= step else "is needed for"
    held = ""
    if has_equalities(scene):
        solimp = " ".join(f"{value:g}" for value in settings["solimp"])  # MuJoCo's default gives way far more
        held = f', solref "{2.0 * wanted:.12g} 1" and solimp "{solimp}" of all equalities'
    return Advice(
        NAME,
        f"{settings['integrator']} with timestep {wanted:.12g} s{held} {relation} an error of {WANTED:g} "
        f"(m, rad): {measured}",
    )


def has_equalities(scene: Scene) -> bool:
    """True if MuJoCo has soft constraints in a scene: loops, gears, screws or prescribed motions."""
    return bool(SpanningTree(scene.mechanism).cuts or couplings(scene))


def fitting(scene: Scene, step: float) -> float:
    """The largest step, s, of at most `step` that is a whole part of the time between outputs and samples.

    Divided by twos and fives, so that it can be written down.
    """
    from mjcf.simulate import default_timestep

    period = default_timestep(scene)
    if not scene.sampled and scene.output_period <= scene.duration:
        period = scene.output_period
    number = max(1, int(np.ceil(period / step * (1.0 - 1e-9))))
    while _without(_without(number, 2), 5) != 1:
        number += 1
    return period / number


def _without(number: int, prime: int) -> int:
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
"""Kinds that hold less, and need no direction that the joint does not have."""

MAX_CHANGED_JOINTS = 20
"""Largest number of joints at which changes are tried, first those to which no other element refers."""

RANDOM_STATES = 1
"""Number of random states, besides the initial one, at which a change is tried."""


def redundancy_advice(scene: Scene) -> Iterator[Advice]:
    """Advise on joints that make constraints redundant, by trying joints with more freedom."""
    states = [initial_state(scene), *random_states(scene, RANDOM_STATES)]
    redundant = _redundant(scene.mechanism, states)
    if redundant == 0:
        return
    driven = _driven(scene)
    coupled = {joint for coupling in couplings(scene) for joint, _ in coupling.factors}
    joints = zip(scene.mechanism.joints, scene.mechanism.equations, strict=True)
    holding = [joint for joint, equations in joints if equations.count and joint.name not in coupled]
    holding.sort(key=lambda joint: (joint.name in driven, joint.actuated))
    names = [joint.name for joint in holding[:MAX_CHANGED_JOINTS]]
    mechanism, steps, left = scene.mechanism, list[str](), redundant
    while left:
        changes = _changes(mechanism, left, names, driven, states)
        best = min(changes, key=lambda change: change[0], default=(left, "", mechanism))
        if best[0] >= left:
            break
        left = best[0]
        steps.append(best[1])
        mechanism = best[2]
    if not steps:
        return
    rows = "constraint" if redundant == 1 else "constraints"
    rest = f"then {left} of them {'is' if left == 1 else 'are'} left"
    if left == 0:
        rest = "then all reactions are determined"
    yield Advice(
        "redundancy",
        f"{redundant} redundant {rows}; the motion is the same with {', '.join(steps)}: {rest}",
    )


def _redundant(mechanism: Mechanism, states: list[State]) -> int:
    """Count the constraint rows that are redundant in all of the states."""
    scene = Scene("tried", mechanism, 1.0, 1.0)
    return min(undetermined(scene, state).shape[1] for state in states)


def _rows(mechanism: Mechanism) -> int:
    return sum(equations.count for equations in mechanism.equations)


def _driven(scene: Scene) -> set[str]:
    """Joints with a coordinate that a force, law, motion or armature refers to."""
    named = {law.joint for law in scene.control} | {motion.joint for motion in scene.motions}
    named |= {armature.joint for armature in scene.armatures}
    named |= {str(getattr(force, "joint", "")) for force in scene.forces}
    return named | {joint.name for joint in scene.mechanism.joints if joint.actuated}


def _changes(
    mechanism: Mechanism, redundant: int, names: list[str], driven: set[str], states: list[State]
) -> Iterator[tuple[int, str, Mechanism]]:
    """Yield mechanisms with the same motions and one joint less or of another kind.

    Each with the number of its redundant rows and what was done; the given one has `redundant` rows.
    """
    rank = _rows(mechanism) - redundant
    joints = {joint.name: joint for joint in mechanism.joints}
    for name in names:
        if name not in joints:
            continue
        joint = joints[name]
        for what, other in _options(joint, name in driven):
            changed = [other if j is joint else j for j in mechanism.joints]
            kept = [j for j in changed if j is not None]
            try:
                tried = Mechanism(mechanism.bodies, kept, mechanism.couplings)
                left = _redundant(tried, states)
                if _rows(tried) - left == rank:
                    yield left, what, tried
            except NewtonEulerError:  # a body that nothing holds any more
                continue


def _options(joint: Joint, driven: bool) -> Iterator[tuple[str, Joint | None]]:
    """List the joints that may replace a joint; one that is driven keeps its hinge or slide."""
    if not driven:
        yield f"joint {joint.name!r} left out", None
    for kind in SOFTER.get(joint.kind, ()):
        softer = _as(joint, kind)
        if not driven or set(joint.coordinate_kinds) <= set(softer.coordinate_kinds):
            yield f"a {kind.kind} joint for the {joint.kind} {joint.name!r}", softer


def _as(joint: Any, kind: type[Joint]) -> Joint:
    axis = {"axis": joint.axis} if "axis" in kind.axis_names else {}
    return kind(
        joint.name, joint.first, joint.second, joint.point, point_on_second=joint.point_on_second, **axis
    )
