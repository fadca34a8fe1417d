"""Smallest distance between the shapes of a mechanism's bodies at given poses, computed by MuJoCo."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection
from itertools import combinations
from typing import NamedTuple

import numpy as np

from mjcf.write import GROUND_COLOR, add_geom
from newton_euler.model.joint import Pose
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array


class Closest(NamedTuple):
    """Bodies that come closest to each other in n poses of a mechanism.

    Attributes:
        distance: (n,) m, smallest distance between shapes of two bodies; negative if shapes overlap; infinite
            if no pair of bodies is examined.
        bodies: (n, 2) indices of these two bodies; zeros without a pair.
    """

    distance: Array
    bodies: Array


def clearances(
    mechanism: Mechanism, position: Array, quaternion: Array, left_out: Collection[frozenset[str]] = ()
) -> Array:
    """Compute the smallest distance (n,), m, between bodies that no joint connects, see `closest`."""
    return closest(mechanism, position, quaternion, left_out).distance


def pairs_within(
    mechanism: Mechanism,
    position: Array,
    quaternion: Array,
    distance: float = 0.0,
    left_out: Collection[frozenset[str]] = (),
) -> set[frozenset[str]]:
    """Find the pairs of bodies that no joint connects and that are near each other in one pose.

    Pairs that overlap in the pose in which a mechanism is drawn (distance 0) overlap by design, such as a
    shaft that stands in a box; their clearance means nothing in other poses.

    Args:
        mechanism, left_out: as of `closest`.
        position, quaternion: (b, 3) m and (b, 4), the pose.
        distance: m, up to which a pair counts as near.

    Returns:
        Names of the bodies of each pair.
    """
    found = set[frozenset[str]]()
    while True:
        nearest = closest(mechanism, position[None], quaternion[None], found | set(left_out))
        if nearest.distance[0] > distance:
            return found
        found.add(frozenset(mechanism.body_names[k] for k in nearest.bodies[0]))


def pair_names(pairs: Collection[frozenset[str]]) -> str:
    """Return the names of pairs of bodies for a message, such as "base and leg_5, base and leg_6"."""
    return ", ".join(" and ".join(pair) for pair in sorted(map(sorted, pairs)))


def closest(
    mechanism: Mechanism,
    position: Array,
    quaternion: Array,
    left_out: Collection[frozenset[str]] = (),
    among: Collection[frozenset[str]] | None = None,
) -> Closest:
    """Find the smallest distance between shapes of bodies that no joint connects.

    Args:
        mechanism: mechanism with shapes; bodies without shapes are ignored.
        position: (n, b, 3) m, centers of mass of all bodies, world frame.
        quaternion: (n, b, 4) orientations (w, x, y, z) of all bodies.
        left_out: names of other pairs of bodies that are not examined.
        among: names of the only pairs of bodies that are examined; None for all.
    """
    import mujoco

    # a model with a mocap body (a body whose pose is set freely) for each moving body; body 0 is the ground.
    # Shapes are given in the world at the initial pose; `add_geom` converts them to the body frame
    root = ET.Element("mujoco")
    world = ET.SubElement(root, "worldbody")
    body_of_geom = []
    for k, body in enumerate(mechanism.bodies):
        if k == 0:
            element, pose, orientation = world, Pose(np.zeros(3), np.eye(3)), np.array([1.0, 0.0, 0.0, 0.0])
        else:
            element = ET.SubElement(world, "body", name=body.name, mocap="true")
            pose, orientation = body.pose, body.quaternion
        for shape in body.shapes:
            add_geom(element, shape, GROUND_COLOR, pose, orientation)
            body_of_geom.append(k)
    # pairs of geoms of bodies that no joint connects
    joined = {frozenset((joint.first, joint.second)) for joint in mechanism.joints} | set(left_out)
    names = mechanism.body_names
    pairs = []
    for (geom_1, body_1), (geom_2, body_2) in combinations(enumerate(body_of_geom), 2):
        pair = frozenset((names[body_1], names[body_2]))
        if body_1 != body_2 and pair not in joined and (among is None or pair in among):
            pairs.append((geom_1, geom_2))
    smallest, bodies = np.full(len(position), np.inf), np.zeros((len(position), 2), dtype=int)
    if not pairs:
        return Closest(smallest, bodies)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data, (first, second) = mujoco.MjData(model), np.array(pairs).T
    # examine pairs in the order of the distance of their bounding spheres, a lower bound of the distance
    radii = model.geom_rbound[first] + model.geom_rbound[second]
    for n in range(len(position)):
        data.mocap_pos[:], data.mocap_quat[:] = position[n, 1:], quaternion[n, 1:]
        mujoco.mj_kinematics(model, data)
        lower_bounds = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1) - radii
        for k in np.argsort(lower_bounds):
            if lower_bounds[k] >= smallest[n]:
                break  # all other pairs are farther apart
            # MuJoCo searches up to a limit; the distance of the centers plus the radii would be enough, the
            # rest is a margin
            limit = 2.0 * (lower_bounds[k] + radii[k]) + radii[k]
            distance = mujoco.mj_geomDistance(model, data, int(first[k]), int(second[k]), limit, None)
            if distance < smallest[n]:
                smallest[n], bodies[n] = distance, (body_of_geom[first[k]], body_of_geom[second[k]])
    return Closest(smallest, bodies)
