"""Write forces of a scene as MJCF elements.

- Springs of hinges and slides are attributes of MuJoCo's joints.
- Springs of balls rest at qpos0 in MuJoCo. If a spring rests elsewhere, it is declared as a yielding spring
  that never yields; a keyframe holds its rest.
- Springs between points are spatial tendons.
- Wrenches are motors on sites with control 1. A motor turns with its site unless its `refsite` is a site of
  the world.
- Wind on a plate is three motors on a site with the axes of the plate: the force along the normal and the
  moments about the sides. `mjcf.model` computes the controls.

Names contain a space, so that they cannot clash with names of the scene.
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
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

WORLD_SITE = "world frame"
"""Name of the world site, the frame of wrenches with constant direction."""

SITE_SIZE = 0.01
"""Radius of a site, in sizes of the mechanism."""

UNREACHED_YIELD_ANGLE = 4.0
"""Yield angle, rad, of springs that must not yield: balls turn by at most pi."""

WIND_MOTORS = {"force": 2, "first moment": 3, "second moment": 4}
"""Motors of a wind load, with their place among the forces and torques along the axes of the site."""

TENDON_WIDTH = 0.003
"""Radius of a tendon, in sizes of the mechanism."""


def joint_attributes(scene: Scene) -> dict[str, dict[str, str]]:
    """Map names of MuJoCo's joints to the attributes of their springs and armatures."""
    found: dict[str, dict[str, str]] = {}
    for armature in scene.armatures:
        found[_motion_name(scene.mechanism, armature)] = {"armature": number(armature.inertia)}
    for spring in scene.forces:
        if isinstance(spring, PointSpring | Wrench | WindLoad):
            continue  # on sites, see `add_sites`
        if isinstance(spring, JointSpring | BallSpring):
            name = _motion_name(scene.mechanism, spring)
            found[name] = found.get(name, {}) | {
                "stiffness": number(spring.stiffness),
                "damping": number(spring.damping),
            }
            if isinstance(spring, JointSpring):
                found[name]["springref"] = number(spring.rest)
            elif _is_turned(spring):
                found[name]["springyield"] = number(UNREACHED_YIELD_ANGLE)
        else:
            assert_never(spring)
    return found


def _motion_name(mechanism: Mechanism, on: OnCoordinate | OnBall) -> str:
    joint, coordinate = mechanism.joint(on.joint), on.key[1]
    return ball_name(joint) if on.on_ball else coordinate_name(joint, coordinate)


def rests(scene: Scene, tree: SpanningTree, layout: Layout) -> Array:
    """Return rest quaternions (4 n,) of MuJoCo's ball springs that do not rest at qpos0."""
    mechanism = scene.mechanism
    turned = {mechanism.joint_index(force.joint): force.rest for force in scene.forces if _is_turned(force)}
    found, place = [np.zeros(0)], 0
    for kept in layout.order:
        for motion, on_q, _ in kept.places:
            size = on_q.stop - on_q.start
            if motion.kind == "ball" and kept.joint in turned:
                rest, q = turned[kept.joint], np.zeros(tree.nq)
                q[on_q] = from_rotation_vector(rest if kept.forward else -rest)
                found.append((layout.to_qpos @ q)[place : place + size])
            place += size
    return np.concatenate(found)


def _is_turned(force: Force) -> TypeGuard[BallSpring]:
    return isinstance(force, BallSpring) and bool(np.any(force.rest))


def add_sites(elements: dict[int, ET.Element], scene: Scene) -> None:
    """Add the sites of point springs, wrenches and wind loads to the elements of bodies, by body number."""
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
        elif not isinstance(force, JointSpring | BallSpring):  # these two are attributes of joints
            assert_never(force)
    if any(isinstance(force, Wrench) and force.frame == "world" for force in scene.forces):
        add_site(elements, mechanism, WORLD_SITE, mechanism.body_names[0], np.zeros(3))


def add_site(
    elements: dict[int, ET.Element], mechanism: Mechanism, name: str, body: str, point: Array
) -> ET.Element:
    """Add a site to a body at a point (3,), m, world frame at the initial pose."""
    index = mechanism.body_index(body)
    local = mechanism.bodies[index].pose.point_to_body(point) if index else point
    size = number(SITE_SIZE * mechanism.size)
    return ET.SubElement(elements[index], "site", name=name, pos=numbers(local), size=size)


def add_springs(tendons: ET.Element, scene: Scene) -> None:
    """Add the tendons of springs between points."""
    for spring in scene.forces:
        if isinstance(spring, PointSpring):
            more = {
                "stiffness": number(spring.stiffness),
                "damping": number(spring.damping),
                "springlength": number(spring.rest_length),
            }
            add_tendon(tendons, scene.mechanism, f"spring {spring.name}", (spring.first, spring.second), more)


def add_tendon(
    tendons: ET.Element, mechanism: Mechanism, name: str, bodies: tuple[str, str], more: dict[str, str]
) -> None:
    """Add a straight tendon between the two sites of its name on two bodies."""
    width = number(TENDON_WIDTH * mechanism.size)
    element = ET.SubElement(tendons, "spatial", {"name": name, "width": width, **more})
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
    """Add motors on the sites of wrenches."""
    mechanism = scene.mechanism
    for wrench in wrenches(scene):
        pose = mechanism.body(wrench.body).pose
        parts = [wrench.force, wrench.torque]
        if wrench.frame == "body":
            parts = [pose.vector_to_body(part) for part in parts]
        name = f"wrench {wrench.name}"
        attributes = {"name": name, "site": name, "gear": numbers(np.concatenate(parts))}
        if wrench.frame == "world":
            attributes["refsite"] = WORLD_SITE
        ET.SubElement(actuators, "motor", attributes)


def add_winds(actuators: ET.Element, scene: Scene) -> None:
    """Add motors on the sites of wind loads, see `wind_loads`."""
    for load in wind_loads(scene):
        site = wind_site(load)
        for what, place in WIND_MOTORS.items():
            gear = numbers(np.eye(6)[place])
            ET.SubElement(actuators, "motor", name=f"{site} {what}", site=site, gear=gear)
