"""Write the forces of a scene (a mechanism with forces and control laws) as MJCF elements, for `mjcf.write`.

- Springs and armatures (rotor inertias) of hinges and slides are attributes of MuJoCo's joints.
- Springs of balls rest at qpos0 in MuJoCo. Only a plastic spring can rest elsewhere: a joint of MuJoCo 4 with
  the attribute `springyield`, whose rest is the part `plastic` of the state. A spring that rests elsewhere
  gets a yield angle that is never reached, and the attribute `plastic` of the keyframe has its rest.
- Springs between points are spatial tendons.
- A wrench, a constant force and torque, is a motor on a site with control 1. The motor turns with its site
  unless its `refsite` is a site of the world.
- Dry friction, stops and elastic gears have no element here: `mjcf.model` applies their forces to MuJoCo's
  joints.
- Wind on a rectangular plate is three motors on a site with the axes of the plate: the force along the normal
  and the moments about both sides. `mjcf.model` computes the controls.

Names of the elements contain a space, so that they cannot clash with names of the scene.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import TypeGuard, assert_never

import numpy as np

from mjcf.layout import Layout, ball_name, number, numbers
from newton_euler.model.elements import OnBall, OnCoordinate
from newton_euler.model.euler_parameters import from_rotation, from_rotation_vector
from newton_euler.model.forces import BallSpring, Force, JointSpring, PointSpring, Wrench
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree, coordinate_name
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

WORLD_SITE = "world frame"
"""Name of the world site, the frame of wrenches with constant direction."""

SITE_SIZE = 0.01
"""Radius of a site, as a fraction of the mechanism's size."""

UNREACHED_YIELD_ANGLE = 4.0
"""Yield angle, rad, of springs that must not yield: deflections of balls are at most pi."""

WIND_MOTORS = {"force": 2, "first moment": 3, "second moment": 4}
"""Index, for each motor of a wind load, of the only nonzero element of MuJoCo's `gear`.

A gear is three forces, then three torques, along x, y, z of the site: the sides and the normal of the plate.
"""

TENDON_WIDTH = 0.003
"""Radius of a tendon, as a fraction of the mechanism's size."""


def joint_attributes(scene: Scene) -> dict[str, dict[str, str]]:
    """Return the attributes of springs and armatures, by name of MuJoCo's joint.

    Joint coordinates are zero at the initial pose in the scene and in the MJCF file, so that both have the
    same rest positions.
    """
    attributes: dict[str, dict[str, str]] = {}
    for armature in scene.armatures:
        attributes[_mujoco_joint_name(scene.mechanism, armature)] = {"armature": number(armature.inertia)}
    for spring in scene.forces:
        if isinstance(spring, PointSpring | Wrench | WindLoad | JointFriction | JointStop | ElasticGear):
            continue  # on sites, see `add_sites`, or without an element of MuJoCo
        if isinstance(spring, JointSpring | BallSpring):
            name = _mujoco_joint_name(scene.mechanism, spring)
            attributes[name] = attributes.get(name, {}) | {
                "stiffness": number(spring.stiffness),
                "damping": number(spring.damping),
            }
            if isinstance(spring, JointSpring):
                attributes[name]["springref"] = number(spring.rest)
            elif _rests_elsewhere(spring):
                attributes[name]["springyield"] = number(UNREACHED_YIELD_ANGLE)
        else:
            assert_never(spring)
    return attributes


def _mujoco_joint_name(mechanism: Mechanism, element: OnCoordinate | OnBall) -> str:
    """Return the name of MuJoCo's joint that a spring or armature of the scene belongs to."""
    joint = mechanism.joint(element.joint)
    if element.on_ball:
        return ball_name(joint)
    _, coordinate = element.key  # joint name, index of the hinge or slide within the joint
    return coordinate_name(joint, coordinate)


def ball_spring_rests(scene: Scene, tree: SpanningTree, layout: Layout) -> Array:
    """Return rest quaternions (4 n,) of the n ball springs that do not rest at qpos0.

    The order is that of MuJoCo's joints.

    Args:
        scene: scene with the springs.
        tree: spanning tree of the bodies in the file.
        layout: map from the coordinates q of the tree to MuJoCo's qpos.
    """
    mechanism = scene.mechanism
    rest_of_joint = {
        mechanism.joint_index(force.joint): force.rest for force in scene.forces if _rests_elsewhere(force)
    }
    quaternions, qpos_index = [np.zeros(0)], 0
    for tree_joint in layout.order:
        for motion, in_q, _ in tree_joint.places:  # `in_q`: slice of the motion's coordinates in q
            size = in_q.stop - in_q.start
            if motion.kind == "ball" and tree_joint.joint in rest_of_joint:
                # coordinates of the tree with this ball at its rest; a ball's rest is a rotation vector from
                # the first to the second body of the joint, which is the tree's parent if `forward`
                rest, q = rest_of_joint[tree_joint.joint], np.zeros(tree.nq)
                q[in_q] = from_rotation_vector(rest if tree_joint.forward else -rest)
                quaternions.append((layout.to_qpos @ q)[qpos_index : qpos_index + size])
            qpos_index += size
    return np.concatenate(quaternions)


def _rests_elsewhere(force: Force) -> TypeGuard[BallSpring]:
    """Return True for a ball spring that does not rest at the initial pose."""
    return isinstance(force, BallSpring) and bool(np.any(force.rest))


def add_sites(elements: dict[int, ET.Element], scene: Scene) -> None:
    """Add the sites of point springs, wrenches and wind loads to the XML elements of bodies.

    Args:
        elements: XML element of each body, by number of the body in the mechanism; the ground is body 0.
        scene: scene with the forces.
    """
    mechanism = scene.mechanism
    for force in scene.forces:
        if isinstance(force, PointSpring):
            ends = ((force.first, force.point_on_first), (force.second, force.point_on_second))
            for body, point in ends:
                add_site(elements, mechanism, f"spring {force.name} on {body}", body, point)
        elif isinstance(force, Wrench):
            add_site(elements, mechanism, f"wrench {force.name}", force.body, force.point)
        elif isinstance(force, WindLoad):
            pose = mechanism.body(force.body).pose
            site = add_site(elements, mechanism, wind_site(force), force.body, force.point)
            site.set("quat", numbers(from_rotation(pose.rotation.T @ force.axes)))
        # forces at joints have no site
        elif not isinstance(force, JointSpring | BallSpring | JointFriction | JointStop | ElasticGear):
            assert_never(force)
    if any(isinstance(force, Wrench) and force.frame == "world" for force in scene.forces):
        add_site(elements, mechanism, WORLD_SITE, mechanism.body_names[0], np.zeros(3))


def add_site(
    elements: dict[int, ET.Element], mechanism: Mechanism, name: str, body: str, point: Array
) -> ET.Element:
    """Add a site to a body, and return its XML element.

    Args:
        elements: XML element of each body, by number of the body in the mechanism.
        mechanism: mechanism with the body.
        name: name of the site.
        body: name of the body.
        point: (3,) m, world frame at the initial pose.
    """
    index = mechanism.body_index(body)
    # MuJoCo's world body (index 0) has the world frame
    local = mechanism.bodies[index].pose.point_to_body(point) if index else point
    size = number(SITE_SIZE * mechanism.size)
    return ET.SubElement(elements[index], "site", name=name, pos=numbers(local), size=size)


def add_springs(tendons: ET.Element, scene: Scene) -> None:
    """Add the tendons of springs between points."""
    for spring in scene.forces:
        if isinstance(spring, PointSpring):
            attributes = {
                "stiffness": number(spring.stiffness),
                "damping": number(spring.damping),
                "springlength": number(spring.rest_length),
            }
            bodies = spring.first, spring.second
            add_tendon(tendons, scene.mechanism, f"spring {spring.name}", bodies, attributes)


def add_tendon(
    tendons: ET.Element, mechanism: Mechanism, name: str, bodies: tuple[str, str], attributes: dict[str, str]
) -> None:
    """Add a straight tendon between two sites, which `add_sites` names "<name> on <body>".

    Args:
        tendons: XML element of all tendons.
        mechanism: mechanism, whose size determines the width of the line.
        name: name of the tendon.
        bodies: names of the two bodies.
        attributes: further attributes of the tendon, such as its stiffness.
    """
    width = number(TENDON_WIDTH * mechanism.size)
    element = ET.SubElement(tendons, "spatial", {"name": name, "width": width, **attributes})
    for body in bodies:
        ET.SubElement(element, "site", site=f"{name} on {body}")


def wrenches(scene: Scene) -> list[Wrench]:
    """Return the wrenches of a scene; their motors follow the actuators of control laws in this order."""
    return [force for force in scene.forces if isinstance(force, Wrench)]


def wind_loads(scene: Scene) -> list[WindLoad]:
    """Return the wind loads of a scene; their motors, three for each, are the last ones."""
    return [force for force in scene.forces if isinstance(force, WindLoad)]


def wind_site(load: WindLoad) -> str:
    """Return the name of the site at the center of a plate, with the axes of the plate."""
    return f"wind {load.name}"


def add_wrenches(actuators: ET.Element, scene: Scene) -> None:
    """Add a motor on the site of each wrench, with force and torque as its gear."""
    mechanism = scene.mechanism
    for wrench in wrenches(scene):
        pose = mechanism.body(wrench.body).pose
        force_and_torque = [wrench.force, wrench.torque]  # world components at the initial pose
        if wrench.frame == "body":
            force_and_torque = [pose.vector_to_body(vector) for vector in force_and_torque]
        name = f"wrench {wrench.name}"
        attributes = {"name": name, "site": name, "gear": numbers(np.concatenate(force_and_torque))}
        if wrench.frame == "world":
            attributes["refsite"] = WORLD_SITE
        ET.SubElement(actuators, "motor", attributes)


def add_winds(actuators: ET.Element, scene: Scene) -> None:
    """Add three motors on the site of each wind load."""
    for load in wind_loads(scene):
        site = wind_site(load)
        for what, gear_index in WIND_MOTORS.items():
            gear = numbers(np.eye(6)[gear_index])
            ET.SubElement(actuators, "motor", name=f"{site} {what}", site=site, gear=gear)
