"""The first levels: the models' own numbers, and where they start."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from crosscheck.against.align import Aligned
from crosscheck.against.placing import Held, anyhow_apart, axes_apart, held, inertia_apart, points_apart
from crosscheck.against.worst import worst_row
from crosscheck.comparison.rows import ROUND_OFF, START, Row, reach, round_off
from newton_euler.equations.couplings import Coupling, couplings
from newton_euler.model.euler_parameters import angle_between, rotation
from newton_euler.model.joints import Key
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

MOST_NAMED = 4
"""Bodies or joints that are told of beside the worst."""


def bodies_row(pair: tuple[str, str], aligned: Aligned) -> Row:
    """How many bodies have no partner."""
    alone = [name for names in aligned.alone for name in names]
    return Row("model", "bodies without partner", pair, float(len(alone)), 0.5, ", ".join(alone))


class Difference(NamedTuple):
    """Of one quantity of the models."""

    quantity: str
    gap: Array
    """(n,) for each body, joint or coupling."""
    tolerance: float
    names: Sequence[str]
    elsewhere: Array | None = None
    """(n,) m, of points of joints: the difference if what a kind of joint leaves open counts too."""


def differences(aligned: Aligned) -> Iterator[Difference]:
    """Of each quantity of the models the difference for each body or joint.

    Each is taken in the bodies' frames, wherever the bodies start. Points of joints count as far as their
    kinds tell them, and axes as lines.
    """
    assert aligned.second is not None
    a, b, placed = aligned.first.mechanism, aligned.second.mechanism, aligned.placed[1:]
    bodies = a.body_names[1:]
    masses = np.array([[body.mass for body in mechanism.bodies[1:]] for mechanism in (a, b)])
    yield Difference("mass, rel", np.abs(masses[1] - masses[0]) / masses[0], ROUND_OFF, bodies)
    length = ROUND_OFF * reach(aligned.first, aligned.first.initial_state.position)
    centers = np.array([np.linalg.norm(way.center) for way in placed])
    yield Difference("centre of mass, m", centers, length, bodies)
    # both are in the first's frames
    inertia = [inertia_apart(x.inertia, y.inertia) for x, y in zip(a.bodies[1:], b.bodies[1:], strict=True)]
    yield Difference("inertia, rel", np.array(inertia), ROUND_OFF, bodies)
    joints = tuple(aligned.joints)
    if joints:
        axes, points, elsewhere = np.array([_on_bodies(aligned, name) for name in joints]).T
        yield Difference("joint axes, rad", axes, ROUND_OFF, joints)
        yield Difference("joint points, m", points, length, joints, elsewhere)
    coupled = dict(_couplings_apart(aligned))
    if coupled:
        yield Difference("couplings, rel", np.array(list(coupled.values())), ROUND_OFF, tuple(coupled))


def model_rows(pair: tuple[str, str], aligned: Aligned, found: Sequence[Difference]) -> Iterator[Row]:
    """The largest of each of the `differences` found, and how many joints are of other kinds, which the
    levels after this have to judge: a ball closes a plane loop as a hinge does."""
    yield bodies_row(pair, aligned)
    other = [name for name in aligned.joints if not same_kind(aligned, name)]
    yield Row("model", "joints of another kind", pair, float(len(other)), 0.0, ", ".join(other), informs=True)
    for quantity, gap, tolerance, names, _ in found:
        yield worst_row("model", quantity, pair, gap, tolerance, names)


def beside_the_worst(found: Sequence[Difference]) -> Iterator[str]:
    """What else of a quantity differs where several bodies or joints do, in words, and what lies elsewhere
    without making a difference."""
    for quantity, gap, tolerance, names, elsewhere in found:
        order = [int(k) for k in np.argsort(-gap) if not gap[k] <= tolerance]
        if len(order) > 1:
            told = ", ".join(f"{names[k]} {gap[k]:.1e}" for k in order[:MOST_NAMED])
            more = len(order) - MOST_NAMED
            yield f"{quantity} differs at {told}" + (f" and {more} more" if more > 0 else "")
        if elsewhere is not None:
            for name, apart, far in zip(names, gap, elsewhere, strict=True):
                if apart <= tolerance < far:
                    yield f"the point of joint {name} is {far:.1e} m elsewhere on what is one joint"


def start_rows(pair: tuple[str, str], aligned: Aligned, condition: float) -> Iterator[Row]:
    """Where the bodies start and how fast they move then; tolerances are round-off times the condition of
    the constraints, which starts are assembled by."""
    assert aligned.second is not None
    first, second = aligned.first, aligned.second
    here, there, names = first.initial_state, second.initial_state, first.mechanism.body_names
    share = round_off(condition)
    # where the first's centre of mass is on the second's body
    arms = np.array(
        [-rotation(p) @ way.center for p, way in zip(there.quaternion, aligned.placed, strict=True)]
    )
    length = first.mechanism.size
    speed = max(
        length, *(float(np.max(np.abs(v))) for v in (here.linear_velocity, length * here.angular_velocity))
    )
    velocity = there.linear_velocity + np.cross(there.angular_velocity, arms) - here.linear_velocity
    for quantity, gap, tolerance in (
        (
            "positions, m",
            np.linalg.norm(there.position + arms - here.position, axis=1),
            share * reach(first, here.position),
        ),
        ("orientations, rad", angle_between(here.quaternion, there.quaternion), share),
        ("velocities, rel", np.linalg.norm(velocity, axis=1) / speed, share),
        (
            "angular velocities, rel",
            np.linalg.norm(there.angular_velocity - here.angular_velocity, axis=1) * length / speed,
            share,
        ),
    ):
        yield worst_row(START, quantity, pair, gap, tolerance, names)


def _on_bodies(aligned: Aligned, name: str) -> Array:
    """(3,) how far a joint's axes are apart, its points, and its points whatever its kind leaves open: the
    larger on its two bodies."""
    assert aligned.second is not None
    a, b = aligned.first.mechanism, aligned.second.mechanism
    one, two = a.joints[a.joint_index(name)], b.joints[b.joint_index(aligned.joints[name])]
    found = np.zeros(3)
    for body in (one.first, one.second):
        k = a.body_index(body)
        parts = []
        for mechanism, joint in ((a, one), (b, two)):
            pose = mechanism.bodies[k].pose
            point, loose, axes = held(joint, body)
            axes = tuple((kind, pose.vector_to_body(axis)) for kind, axis in axes)
            parts.append(Held(pose.point_to_body(point), pose.rotation.T @ loose, axes))
        way = aligned.placed[k]._replace(turn=np.eye(3))  # the second's frames are the first's by now
        apart = [measure(parts[0], parts[1], way) for measure in (axes_apart, points_apart, anyhow_apart)]
        found = np.maximum(found, apart)
    return found


def same_kind(aligned: Aligned, name: str) -> bool:
    assert aligned.second is not None
    a, b = aligned.first.mechanism, aligned.second.mechanism
    one, two = a.joints[a.joint_index(name)], b.joints[b.joint_index(aligned.joints[name])]
    kinds = [sorted(motion.kind for motion in joint.motions) for joint in (one, two)]
    return kinds[0] == kinds[1] and one.only_closes == two.only_closes


def _couplings_apart(aligned: Aligned) -> Iterator[tuple[str, float]]:
    """For each gear, screw and motion how far its factors and function are apart; 1 without partner."""
    assert aligned.second is not None
    here, there = couplings(aligned.first), list(couplings(aligned.second))
    for coupling in here:
        factors = {
            aligned.coordinates[key].key: factor * aligned.coordinates[key].sense
            for key, factor in coupling.factors.items()
            if key in aligned.coordinates
        }
        partner = next((c for c in there if factors and c.factors.keys() == factors.keys()), None)
        if partner is None or len(factors) < len(coupling.factors):
            yield coupling.name, 1.0
            continue
        there.remove(partner)
        yield (
            coupling.name,
            max(
                _factors_apart(factors, partner.factors),
                _functions_apart(aligned.first, coupling, partner, factors),
            ),
        )
    for coupling in there:
        yield coupling.name, 1.0


def _factors_apart(one: Mapping[Key, float], two: Mapping[Key, float]) -> float:
    """Whatever both are multiplied by."""
    a, b = (np.array([factors[key] for key in one]) for factors in (one, two))
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    return float(min(np.max(np.abs(a - b)), np.max(np.abs(a + b))))


def _functions_apart(scene: Scene, one: Coupling, two: Coupling, factors: Mapping[Key, float]) -> float:
    """Of time, from where they begin, relative to how far they go, whatever both are multiplied by."""
    if one.function is None or two.function is None:
        return float(one.function is not two.function)
    c, d = (np.array([its[key] for key in factors]) for its in (factors, two.factors))
    a, b = (np.array([f.value(t) - f.value(0.0) for t in scene.times]) for f in (one.function, two.function))
    return float(np.max(np.abs((c @ d) / (d @ d) * b - a)) / max(float(np.max(np.abs(a))), 1e-12))
