"""Distances between the shapes of bodies, by MuJoCo's collision geometry."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from itertools import combinations

import numpy as np

from mjcf.write import GROUND_COLOR, add_geom
from newton_euler.model.joint import Pose
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array


def clearances(mechanism: Mechanism, position: Array, quaternion: Array) -> Array:
    """Compute the smallest distance between shapes of bodies that no joint connects.

    Args:
        mechanism: mechanism with shapes; bodies without shapes are ignored.
        position: (n, b, 3) m, centers of mass of all bodies, world frame.
        quaternion: (n, b, 4) orientations (w, x, y, z) of all bodies.

    Returns:
        (n,) m, negative if shapes overlap; infinite if there are no two such bodies.
    """
    import mujoco

    # a model with a mocap body for each body
    root = ET.Element("mujoco")
    world = ET.SubElement(root, "worldbody")
    owners = []
    for k, body in enumerate(mechanism.bodies):
        in_world = Pose(np.zeros(3), np.eye(3))
        element = world if k == 0 else ET.SubElement(world, "body", name=body.name, mocap="true")
        for shape in body.shapes:
            add_geom(
                element,
                shape,
                GROUND_COLOR,
                *((body.pose, body.quaternion) if k else (in_world, np.array([1.0, 0.0, 0.0, 0.0]))),
            )
            owners.append(k)
    # pairs of shapes of bodies that no joint connects
    joined = {frozenset((joint.first, joint.second)) for joint in mechanism.joints}
    names = mechanism.body_names
    pairs = np.array(
        [
            (i, j)
            for (i, one), (j, other) in combinations(enumerate(owners), 2)
            if one != other and frozenset((names[one], names[other])) not in joined
        ]
    ).reshape(-1, 2)
    if not len(pairs):
        return np.full(len(position), np.inf)
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    data, (first, second) = mujoco.MjData(model), pairs.T
    # smallest distance, by pairs in the order of the distance of their bounding spheres
    radii = model.geom_rbound[first] + model.geom_rbound[second]
    found = np.full(len(position), np.inf)
    for n in range(len(position)):
        data.mocap_pos[:], data.mocap_quat[:] = position[n, 1:], quaternion[n, 1:]
        mujoco.mj_kinematics(model, data)
        bounds = np.linalg.norm(data.geom_xpos[first] - data.geom_xpos[second], axis=1) - radii
        for k in np.argsort(bounds):
            if bounds[k] >= found[n]:
                break  # all other pairs are farther apart
            limit = 2.0 * (bounds[k] + radii[k]) + radii[k]
            distance = mujoco.mj_geomDistance(model, data, int(first[k]), int(second[k]), limit, None)
            found[n] = min(found[n], distance)
    return found
