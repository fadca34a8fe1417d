"""Faults planted in a reading of a model file, between the reading and its verification, one at a time.

Values of each element are doubled, halved, dropped, put in another order, and a millionth more; joints are
tilted and moved by as much, loops left open. The scene is that with all controls at random, in which every
actuator acts. A fault that the verification does not see has to change nothing: then poses, velocities,
energies and accelerations of the scene's own equations are the same with it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crosscheck.comparison.levels import compare_pair
from crosscheck.comparison.samples import Samples
from crosscheck.faults import plant
from crosscheck.faults.catalogue import SKEW, Fault
from crosscheck.faults.find import MOTION, samples_of
from newton_euler.control import PD
from newton_euler.couplings import Gear, JointCoupling, LinearCoupling
from newton_euler.errors import NewtonEulerError
from newton_euler.forces import BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.mapping import Mapping
from newton_euler.mechanism import Body
from newton_euler.relative import Relative
from newton_euler.scene import Scene
from newton_euler.tree import SpanningTree
from newton_euler.verification.verify import verify

FACTORS = {"doubled": 2.0, "halved": 0.5, "dropped": 0.0, "times 1 + 1e-6": 1.0 + 1e-6}

SMALL, LARGE = 1e-6, 0.1
"""rad, and sizes."""

ORDER = [1, 2, 0]
"""Of axes that inertias are permuted to."""

EVERYTHING = "all bodies"


@dataclass(frozen=True)
class Outcome:
    """What became of a fault.

    Attributes:
        fault: what was planted.
        figure: the first quantity that fails; "refused" where no scene has the fault; "" if none does.
        where: what is blamed.
        named: whether that is the element at fault.
        moves: whether the fault changes any motion; True where it is seen.
    """

    fault: Fault
    figure: str
    where: str
    named: bool
    moves: bool

    @property
    def missed(self) -> bool:
        """Whether it changes what moves, and is not seen."""
        return self.moves and not self.figure


def reading_faults(scene: Scene) -> Iterator[Fault]:
    """All faults of a scene that was read."""
    bodies, joints = scene.mechanism.body_names[1:], scene.mechanism.joints
    for what, factor in FACTORS.items():
        share = max(factor, plant.REMAINS)
        for body in bodies:
            yield _fault("mass", body, what, plant.mass(body, share - 1.0))
            yield _fault("inertia", body, what, plant.change_bodies({body: _scaled("inertia", share)}))
        scaled = plant.change_bodies(dict.fromkeys(bodies, _scaled("mass", share)))
        yield _fault("mass", EVERYTHING, what, scaled)
        yield from _of_forces(scene, what, factor)
    yield _fault("inertia", EVERYTHING, "permuted", plant.change_bodies(dict.fromkeys(bodies, _permuted)))
    size = scene.mechanism.size
    for angle in (SMALL, LARGE):
        for body in bodies:
            yield _fault("frame", body, f"turned by {angle:g}", plant.inertia_frame(body, SKEW, angle))
            shifted = plant.center_of_mass(body, angle * size * SKEW)
            yield _fault("center of mass", body, f"moved by {angle:g}", shifted)
        for joint in joints:
            for direction, tilted in plant.tilted(joint, angle).items():
                yield _of_axis(scene, joint.name, f"tilted by {angle:g} {direction}", tilted)
            moved = plant.joint_point(joint.name, angle * size * SKEW)
            yield _fault("joint point", joint.name, f"moved by {angle:g}", moved)
    for joint in joints:
        for name in joint.axis_names:
            turned = plant.joint_axes(joint.name, {name: -getattr(joint, name)})
            yield _of_axis(scene, joint.name, f"{name} the other way", turned)
    for cut in SpanningTree(scene.mechanism).cuts:
        yield _fault("equality", joints[cut].name, "dropped", plant.missing_joint(joints[cut].name))


def _of_forces(scene: Scene, what: str, factor: float) -> Iterator[Fault]:
    """Values of springs, dampers, armatures, gears, laws and gravity."""
    for field in ("control", "forces"):
        for index, force in enumerate(getattr(scene, field)):
            for name in force.parameters:
                value = getattr(force, name)
                idle = name in ("rest", "target") and not force.stiffness
                if np.any(value) and not idle:
                    changed = _entry(field, index, name, factor * value)
                    yield _fault(f"{name} of {type(force).__name__}", _element(force), what, changed)
    for index, rotor in enumerate(scene.armatures):
        changed = (
            _entry("armatures", index, "inertia", factor * rotor.inertia)
            if factor
            else _without("armatures", index)
        )
        yield _fault("armature", rotor.joint, what, changed)
    for index, motion in enumerate(scene.motions):
        if not factor:
            yield _fault("equality", motion.joint, what, _without("motions", index))
    for index, gear in enumerate(scene.mechanism.couplings):
        yield _fault("gear", gear.name, what, _other_gear(index, factor))
    if np.any(scene.gravity):
        yield _fault("gravity", "gravity", what, plant.gravity(factor * scene.gravity))


def _scaled(name: str, share: float) -> Callable[[Body], dict[str, Any]]:
    return lambda body: {name: share * getattr(body, name)}


def _permuted(body: Body) -> dict[str, Any]:
    return {"inertia": body.inertia[np.ix_(ORDER, ORDER)]}


def _of_axis(scene: Scene, joint: str, detail: str, planted: plant.Plant) -> Fault:
    """One that may be blamed on gears as well, whose coordinates are about that axis."""
    joints = ((each.name, {name for name, _ in each.factors()}) for each in scene.mechanism.couplings)
    gears = (name for name, coupled in joints if joint in coupled)
    return replace(_fault("axis", joint, detail, planted), right=frozenset({joint, *gears}))


def _fault(kind: str, element: str, detail: str, planted: plant.Plant) -> Fault:
    return Fault(kind, element, detail, None, planted, frozenset({element}))


def _element(force: PD | JointSpring | BallSpring | PointSpring | Wrench) -> str:
    return force.name if isinstance(force, PointSpring | Wrench) else force.joint


def _entry(field: str, index: int, name: str, value: object) -> plant.Plant:
    def planted(scene: Scene) -> Scene:
        entries = list(getattr(scene, field))
        entries[index] = replace(entries[index], **{name: value})
        return replace(scene, **{field: tuple(entries)})  # type: ignore[arg-type]

    return planted


def _without(field: str, index: int) -> plant.Plant:
    def planted(scene: Scene) -> Scene:
        entries = getattr(scene, field)
        rest: Any = {field: (*entries[:index], *entries[index + 1 :]), "initial_state": None}
        return replace(scene, **rest)

    return planted


def _other_gear(index: int, factor: float) -> plant.Plant:
    def planted(scene: Scene) -> Scene:
        gears = list(scene.mechanism.couplings)
        gear = gears.pop(index)
        if factor:
            gears.insert(index, _with_other_factor(gear, factor))
        mechanism = type(scene.mechanism)(scene.mechanism.bodies, scene.mechanism.joints, gears)
        return replace(scene, mechanism=mechanism, initial_state=None)  # type: ignore[arg-type]

    return planted


def _with_other_factor(coupling: JointCoupling, factor: float) -> JointCoupling:
    """A coupling with its last factor against the first multiplied."""
    if isinstance(coupling, Gear):
        return replace(coupling, ratio=factor * coupling.ratio)
    assert isinstance(coupling, LinearCoupling)
    *terms, (joint, coordinate, last) = coupling.terms
    return replace(coupling, terms=(*terms, (joint, coordinate, factor * last)))


def find_in_reading(
    report: Mapping, progress: Callable[[str], None], faults: Sequence[Fault] | None = None
) -> list[Outcome]:
    """Plant faults, all that there are if None are given, one at a time, and verify the scene with each."""
    original, scene = report.originals[-1]
    own: list[Samples] = []
    outcomes = []
    faults = list(reading_faults(scene)) if faults is None else faults
    for number, fault in enumerate(faults):
        progress(f"{number} of {len(faults)} faults: {fault.name}")
        try:
            planted = fault.plant(scene)
            failing = next((f for f in verify(original, Relative(planted)) if not f.agrees), None)
        except NewtonEulerError as error:
            outcomes.append(Outcome(fault, "refused", str(error), fault.element in str(error), True))
            continue
        if failing is None:
            own = own or [samples_of(scene)]
            wrong = [Samples(Relative(planted), own[0].states)]
            rows = compare_pair(("right", "wrong"), own, wrong, MOTION)
            moves = any(not (row.agrees or row.quantity.startswith("reaction")) for row in rows)
            outcomes.append(Outcome(fault, "", "", False, moves))
            continue
        named = any(_is_named(element, failing.where, report) for element in fault.right)
        outcomes.append(Outcome(fault, failing.quantity, failing.where, named, True))
    return outcomes


def _is_named(element: str, where: str, report: Mapping) -> bool:
    """Whether what is blamed is the element, or one of the file's that became it."""
    if element in (where, EVERYTHING) or repr(element) in where:
        return True
    told = where.split(":")[0]
    return any(entry.element == told and repr(element) in entry.how for entry in report.entries)


def reading_lines(path: str, found: Sequence[Outcome]) -> Iterator[str]:
    """What became of the faults: by the figure that shows them, what is missed, what changes nothing."""
    for figure, count in Counter(outcome.figure for outcome in found if outcome.figure).most_common():
        yield f"{count} seen by {figure}"
    for outcome in found:
        if outcome.missed:
            yield f"missed: {outcome.fault.name}"
        elif outcome.figure and not outcome.named:
            yield f"blamed elsewhere: {outcome.fault.name}: {outcome.figure} at {outcome.where}"
    idle = Counter((outcome.fault.kind, outcome.fault.detail) for outcome in found if not outcome.moves)
    for (kind, detail), count in idle.items():
        yield f"{count} without any effect on motion: {kind} {detail}"
    moving = [outcome for outcome in found if outcome.moves]
    seen = [outcome for outcome in moving if outcome.figure]
    named = sum(outcome.named for outcome in seen)
    word = "FOUND" if len(seen) == len(moving) else "MISSED"
    yield (
        f"{word}: of {len(moving)} faults in the reading of {path} that change its motion {len(seen)} are "
        f"seen, {named} with their element named"
    )
