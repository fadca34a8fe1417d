"""Alignment of two models of one mechanism, so that they can be compared in the same states.

In: two scenes, for example from an MJCF and a URDF of one robot. Out: `Aligned`: pairs of bodies, joints and
joint coordinates, and the second model with the bodies (order, names, frames) of the first one.

Bodies that are connected by `fixed` joints are merged first, since files differ in how they split a rigid
body. The origin of a body frame is the body's center of mass.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations.couplings import counted_angles
from newton_euler.equations.system import MassProperties
from newton_euler.model.elements import BALL
from newton_euler.model.euler_parameters import from_rotation, rotation
from newton_euler.model.forces import Force
from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Fixed
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state, measured_coordinate
from newton_euler.scalars import Array, cross

Groups = Mapping[str, tuple[str, ...]]
"""Names of bodies that are rigidly connected, by the name of the merged body."""


class Partner(NamedTuple):
    """Joint coordinate of one model that corresponds to a joint coordinate of the other model.

    Attributes:
        key: name of the joint, and number of the coordinate in the joint.
        sense: -1 if the two coordinates have opposite signs, else 1.
    """

    key: Key
    sense: float


@dataclass(frozen=True, eq=False)
class Aligned:
    """Two aligned models of one mechanism.

    Attributes:
        first: the first model, with merged bodies.
        second: the second model, with merged bodies in the order, names and frames of the first model. A
            state of the first model is then a state of the second one if centers of mass agree. Joints keep
            their names. None if a body has no partner.
        alone: names of bodies without partner, in the first and in the second model.
        names: name of each paired body in the first model, by its name in the second.
        joints: name of each paired joint in the second model, by its name in the first.
        coordinates: partner of each paired joint coordinate, by its key in the first model.
        centers: (b, 3) positions of the second model's centers of mass relative to those of the first, in the
            body frames of the first model, m.
        notes: sentences on names and kinds that differ between the models.
    """

    first: Scene
    second: Scene | None
    alone: tuple[tuple[str, ...], tuple[str, ...]]
    names: Mapping[str, str]
    joints: Mapping[str, str]
    coordinates: Mapping[Key, Partner]
    centers: Array
    notes: tuple[str, ...]

    @property
    def both(self) -> tuple[Scene, Scene]:
        """Both models; only if all bodies have partners."""
        assert self.second is not None
        return self.first, self.second

    @property
    def joint_names(self) -> dict[str, str]:
        """Name of each paired joint in the first model, by its name in the second."""
        return {other: name for name, other in self.joints.items()}

    def joint_pair(self, name: str) -> tuple[Joint, Joint]:
        """Return the joint with a name in the first model, and its partner."""
        a, b = (scene.mechanism for scene in self.both)
        return a.joint(name), b.joint(self.joints[name])

    def same_kind(self, name: str) -> bool:
        """Return True if a joint of the first model and its partner allow the same motions."""
        one, two = self.joint_pair(name)
        kinds = [sorted(motion.kind for motion in joint.motions) for joint in (one, two)]
        # a rod (`only_closes`) has no hinges, slides or balls, but is not rigid
        return kinds[0] == kinds[1] and one.only_closes == two.only_closes

    def of_first(self, key: Key) -> Partner:
        """Find the partner in the first model of a joint coordinate, or of a ball joint, of the second model.

        If there is no partner, the coordinate itself is returned.
        """
        for name, other in self.joints.items():
            if key == (other, BALL):
                one, two = self.joint_pair(name)
                return Partner((name, BALL), 1.0 if one.second == two.second else -1.0)
        found = (Partner(own, other.sense) for own, other in self.coordinates.items() if other.key == key)
        return next(found, Partner(key, 1.0))

    @cached_property
    def at_start(self) -> dict[Key, tuple[float, float]]:
        """Values of each paired joint coordinate in both models at the start of the first model, m or rad.

        They differ by a constant, since each model measures from its own initial pose.
        """
        first, second = self.both
        state, start = initial_state(first), initial_state(second)
        arms = [rotation(p) @ center for p, center in zip(state.quaternion, self.centers, strict=True)]
        there = replace(state, position=state.position + arms, angles=start.angles)
        return {
            key: (
                measured_coordinate(first, state, key)[0],
                measured_coordinate(second, there, partner.key)[0],
            )
            for key, partner in self.coordinates.items()
        }

    def in_second(self, state: State) -> State:
        """Return a state of the first model with the second model's joint angles, full revolutions included.

        Only angles that forces or couplings of the second model depend on are included.
        """
        counted, angles = counted_angles(self.both[1]), dict[Key, float]()
        for key, partner in self.coordinates.items():
            if partner.key in counted:
                here, there = self.at_start[key]
                x, _ = measured_coordinate(self.first, state, key)
                angles[partner.key] = there + partner.sense * (x - here)
        return replace(state, angles=angles)


def alignments(first: Scene, second: Scene) -> Iterator[Aligned]:
    """Yield possible alignments of two models, which differ in how body frames are matched.

    The comparison takes the alignment with the fewest differences. In the first one, bodies coincide at the
    start of both models. In the second one, body frames are those of the files, and a joint point of each
    body coincides. In the third one, body frames are those of the files, and centers of mass coincide.

    The second model gets the ground and the output times of the first.
    """
    # Merge and pair bodies
    first_groups, second_groups = _rigid_groups(first.mechanism), _rigid_groups(second.mechanism)
    names = pair_bodies(first.mechanism, first_groups, second.mechanism, second_groups)
    alone = (
        tuple(name for name in first_groups if name not in names.values()),
        tuple(name for name in second_groups if name not in names),
    )
    ground = first.mechanism.bodies[0]
    notes = [
        f"body {name} is {' and '.join(second_groups[other])} there"
        for other, name in names.items()
        if second_groups[other] != first_groups[name] and name != ground.name
    ]
    first = _with_merged_bodies(first, first_groups, ground)
    if any(alone):
        notes.append("bodies are paired by their names, and what is left by the names of its joints")
        yield Aligned(first, None, alone, names, {}, {}, np.zeros((0, 3)), tuple(notes))
        return
    # Restate the second model with the bodies of the first, and match the frames
    others = {name: other for other, name in names.items()}
    second = _with_merged_bodies(second, {name: second_groups[others[name]] for name in first_groups}, ground)
    second = replace(second, duration=first.duration, output_period=first.output_period)
    joints = pair_joints(first.mechanism, second.mechanism)
    at_joints = _centers_at_joints(first.mechanism, second.mechanism, joints)
    for restated, centers in (
        _with_frames_of_first(first, second),
        (second, at_joints),
        (second, np.zeros_like(at_joints)),
    ):
        coordinates = _pair_coordinates(first.mechanism, restated.mechanism, joints)
        of_joints = _joint_notes(first.mechanism, restated.mechanism, joints, coordinates)
        yield Aligned(first, restated, alone, names, joints, coordinates, centers, (*notes, *of_joints))


def _rigid_groups(mechanism: Mechanism) -> Groups:
    """Group rigidly connected bodies, in the order of the mechanism, by the name of their first body."""
    group_of = {name: name for name in mechanism.body_names}
    for joint in mechanism.joints:
        if isinstance(joint, Fixed):  # merge the two groups that the joint connects
            ends = group_of[joint.first], group_of[joint.second]
            kept, merged = sorted(ends, key=mechanism.body_names.index)
            group_of = {name: kept if group == merged else group for name, group in group_of.items()}
    return {
        group: tuple(name for name in mechanism.body_names if group_of[name] == group)
        for group in dict.fromkeys(group_of.values())
    }


def pair_bodies(first: Mechanism, here: Groups, second: Mechanism, there: Groups) -> dict[str, str]:
    """Pair merged bodies by the names of their parts, and the remaining ones by the names of their joints.

    The grounds of both models are paired whatever their names are.

    Args:
        first, second: the mechanisms.
        here, there: merged bodies of the first and of the second mechanism.

    Returns:
        Name of each paired body in the first model, by its name in the second.
    """
    names = {second.body_names[0]: first.body_names[0]}
    parts = tuple({name: frozenset(group) for name, group in groups.items()} for groups in (here, there))
    joints = _joints_of(first, here), _joints_of(second, there)
    for of_first, of_second in (parts, joints):
        unpaired_first = {name: of_first[name] for name in of_first if name not in names.values()}
        unpaired_second = {name: of_second[name] for name in of_second if name not in names}
        # Two bodies are paired if each has the most in common with the other
        for a, elements in unpaired_first.items():
            b = _nearest(elements, unpaired_second)
            if b is not None and _nearest(of_second[b], unpaired_first) == a:
                names[b] = a
    return names


def _nearest(wanted: frozenset[str], among: Mapping[str, frozenset[str]]) -> str | None:
    """Return the name of the set that has the most elements in common with `wanted`.

    None if no set has a common element, or if several sets have the same number of common elements.
    """
    common = {name: len(wanted & elements) for name, elements in among.items()}
    most = max(common.values(), default=0)
    best = [name for name, count in common.items() if count == most]
    return best[0] if most and len(best) == 1 else None


def _joints_of(mechanism: Mechanism, groups: Groups) -> dict[str, frozenset[str]]:
    """Return the names of the joints that connect each merged body to others."""
    return {
        name: frozenset(
            joint.name for joint in mechanism.joints if len({joint.first, joint.second} & set(group)) == 1
        )
        for name, group in groups.items()
    }


def pair_joints(first: Mechanism, second: Mechanism) -> dict[str, str]:
    """Pair joints of two mechanisms whose bodies have the same names.

    Joints with the same name are paired if they connect the same bodies. Of the remaining joints, two are
    paired if each of them is the only one left between the two bodies.

    Returns:
        Name of each paired joint in the second model, by its name in the first.
    """
    others = {joint.name: joint for joint in second.joints}
    found = {
        joint.name: joint.name
        for joint in first.joints
        if joint.name in others and _ends(joint) == _ends(others[joint.name])
    }
    left = [joint for joint in first.joints if joint.name not in found]
    right = [joint for joint in second.joints if joint.name not in found]
    for joint in left:
        parallel = [a for a in left if _ends(a) == _ends(joint)]
        candidates = [b for b in right if _ends(b) == _ends(joint)]
        if len(parallel) == len(candidates) == 1:
            found[joint.name] = candidates[0].name
    return found


def _ends(joint: Joint) -> frozenset[str]:
    """Return the names of the two bodies of a joint."""
    return frozenset((joint.first, joint.second))


def _pair_coordinates(first: Mechanism, second: Mechanism, joints: Mapping[str, str]) -> dict[Key, Partner]:
    """Pair the coordinates (hinges and slides) of paired joints, by the directions of their axes.

    Args:
        first, second: the mechanisms.
        joints: name of each paired joint in the second mechanism, by its name in the first.

    Returns:
        Partner of each paired coordinate, by its key in the first mechanism.
    """
    found: dict[Key, Partner] = {}
    for name, other in joints.items():
        a, b = first.joint(name), second.joint(other)
        swapped = -1.0 if a.first == b.second else 1.0
        unpaired = dict(enumerate(axes(second, b, a)))
        for k, (kind, own_axis) in enumerate(axes(first, a, a)):
            # Cosine of the angle to each axis of the same kind, in the body in which the axes are closer
            cosines = {
                n: max(np.sum(own_axis * other_axis, axis=1), key=abs)
                for n, (other_kind, other_axis) in unpaired.items()
                if other_kind == kind
            }
            if cosines:
                n = max(cosines, key=lambda n: abs(cosines[n]))
                found[name, k] = Partner((other, n), swapped * float(np.copysign(1.0, cosines[n])))
                del unpaired[n]
    return found


def axes(mechanism: Mechanism, joint: Joint, like: Joint) -> Iterator[tuple[str, Array]]:
    """Yield the kind and the axis of each hinge and slide of a joint.

    An axis is an array (2, 3): its direction in the frames of the first and of the second body of `like`, a
    joint between the same two bodies.
    """
    poses = [mechanism.body(name).pose for name in (like.first, like.second)]
    for motion in joint.motions:
        if motion.kind != "ball":
            yield motion.kind, np.array([pose.vector_to_body(motion.axis) for pose in poses])


def _joint_notes(
    first: Mechanism, second: Mechanism, joints: Mapping[str, str], coordinates: Mapping[Key, Partner]
) -> Iterator[str]:
    """Yield sentences on joints that differ in name, kind or sign, or that only one model has."""
    for name, other in joints.items():
        a, b = first.joint(name), second.joint(other)
        if name != other:
            yield f"joint {name} is {other} there, the only one left between {a.first} and {a.second}"
        if a.kind != b.kind:
            same = sorted(part.kind for part in a.motions) == sorted(part.kind for part in b.motions)
            equal = ", with the same motions" if same else ""
            yield f"joint {name} is {a.kind} here and {b.kind} there{equal}"
    here = [name for name in first.joint_names if name not in joints]
    there = [name for name in second.joint_names if name not in joints.values()]
    opposite = dict.fromkeys(key[0] for key, partner in coordinates.items() if partner.sense < 0.0)
    for what, names in (
        ("counted the other way there", opposite),
        ("joints only here", here),
        ("joints only there", there),
    ):
        if names:
            yield f"{what}: {', '.join(names)}"


def _with_merged_bodies(scene: Scene, groups: Groups, ground: Body) -> Scene:
    """Return a scene with merged bodies, without `fixed` joints, and with all outputs.

    Args:
        scene: the scene.
        groups: names of the bodies to merge, by the name of the merged body. The first group is the ground. A
            merged body has the frame of the first body of its group.
        ground: body that becomes the ground, possibly that of another model.
    """
    mechanism, start = scene.mechanism, initial_state(scene)
    bodies, state = [ground], State(*(np.zeros((len(groups), n)) for n in (3, 4, 3, 3)))
    state.position[0], state.quaternion[0] = ground.center_of_mass, ground.quaternion
    for k, (name, group) in enumerate(list(groups.items())[1:], 1):
        index = mechanism.body_index(group[0])
        body = replace(_merged(mechanism, [mechanism.body_index(member) for member in group]), name=name)
        before = mechanism.bodies[index].pose
        arm = rotation(start.quaternion[index]) @ before.point_to_body(body.center_of_mass)
        spin = start.angular_velocity[index]
        bodies.append(body)
        state.position[k], state.quaternion[k] = start.position[index] + arm, start.quaternion[index]
        state.linear_velocity[k] = start.linear_velocity[index] + cross(spin, arm)
        state.angular_velocity[k] = spin
    names = {member: name for name, group in groups.items() for member in group}
    joints = [replace(each, first=names[each.first], second=names[each.second]) for each in mechanism.joints]
    kept = [joint for joint in joints if joint.first != joint.second]
    angles = {key: angle for key, angle in start.angles.items() if key[0] in {each.name for each in kept}}
    return replace(
        scene,
        mechanism=Mechanism(bodies, kept, mechanism.couplings),
        initial_state=replace(state, angles=angles),
        forces=tuple(_renamed_forces(scene.forces, names, ground.name)),
        outputs=frozenset(OUTPUTS),
    )


def _merged(mechanism: Mechanism, indices: Sequence[int]) -> Body:
    """Return the merged body of the bodies with some numbers, in the frame of the first of them."""
    first = mechanism.bodies[indices[0]]
    if len(indices) == 1:
        return first
    found, parts = MassProperties.of(mechanism), [mechanism.bodies[k] for k in indices]
    masses, centers = found.mass[indices], found.center_of_mass[indices]
    center = masses @ centers / masses.sum()
    inertia = found.inertia[indices].sum(axis=0)
    for mass, arm in zip(masses, centers - center, strict=True):
        inertia = inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    into = first.pose.rotation.T
    local = into @ inertia @ into.T
    return replace(
        first,
        mass=float(masses.sum()),
        center_of_mass=center,
        inertia=0.5 * (local + local.T),
        shapes=tuple(shape for part in parts for shape in part.shapes),
        meshes=tuple(mesh for part in parts for mesh in part.meshes),
        allow_unrealisable_inertia=any(part.allow_unrealisable_inertia for part in parts),
    )


def _renamed_forces(forces: Sequence[Force], names: Mapping[str, str], ground: str) -> Iterator[Force]:
    """Yield forces with renamed bodies, without those that act within one body or on the ground only.

    Args:
        forces: forces of a scene.
        names: name of the merged body of each body.
        ground: name of the ground.
    """
    for force in forces:
        renamed: dict[str, Any] = {field: names[getattr(force, field)] for field in force.body_fields}
        bodies = set(renamed.values())
        if len(bodies) == len(force.body_fields) and bodies != {ground}:
            yield replace(force, **renamed)


def _with_frames_of_first(first: Scene, second: Scene) -> tuple[Scene, Array]:
    """Rotate the body frames of the second scene, so that both scenes start with the same orientations.

    Returns:
        The second scene with the rotated frames, and positions (b, 3), m, of its centers of mass. These are
        relative to those of the first scene at the start, in the body frames of the first.
    """
    mechanism, start, here = second.mechanism, initial_state(second), initial_state(first)
    own, others = ([rotation(p) for p in state.quaternion] for state in (start, here))
    bodies = []
    for body, before, after in zip(mechanism.bodies, own, others, strict=True):
        turn = before.T @ after
        inertia = turn.T @ body.inertia @ turn
        quaternion = from_rotation(body.pose.rotation @ turn)
        bodies.append(replace(body, inertia=0.5 * (inertia + inertia.T), quaternion=quaternion))
    turned = replace(
        second,
        mechanism=Mechanism(bodies, mechanism.joints, mechanism.couplings),
        initial_state=replace(start, quaternion=np.array([from_rotation(turn) for turn in others])),
    )
    return turned, np.einsum("bij,bi->bj", others, start.position - here.position)


def _centers_at_joints(first: Mechanism, second: Mechanism, joints: Mapping[str, str]) -> Array:
    """Compute centers of mass of the second mechanism relative to those of the first, if joints coincide.

    Body frames of both mechanisms are taken as equal, and restated so that the first paired joint of each
    body is at the same point. A joint has a `point` on its first body, and a `point_on_second`.

    Returns:
        (b, 3) positions in the body frames, m; 0 for a body without paired joint.
    """
    centers = np.zeros((len(first.bodies), 3))
    for k, body in enumerate(first.bodies[1:], 1):
        paired = [first.joint_names[n] for n in first.joints_at[k] if first.joint_names[n] in joints]
        for name in paired[:1]:
            pair = (first, first.joint(name)), (second, second.joint(joints[name]))
            here, there = (
                mechanism.bodies[k].pose.point_to_body(
                    joint.point if joint.first == body.name else joint.point_on_second
                )
                for mechanism, joint in pair
            )
            centers[k] = here - there
    return centers
