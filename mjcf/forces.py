"""The forces of a scene as MJCF.

Springs of joints are attributes of MuJoCo's joints. Those of balls have no attribute for where they rest,
which is qpos0. MuJoCo can move it while it runs: it does for a spring that yields, and then a key says where
it is. Springs between points are spatial tendons, and wrenches are motors on sites whose control is 1: MuJoCo
turns a motor's force with its site, or not if a site of the world is its `refsite`. Wind on a plate is three
motors on a site with the plate's axes, whose controls `mjcf.model` works out: the force along its normal and
the moments about its sides. Names hold a space, which no name of a scene does, so that none clash.
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
"""Name of the site against which motors of wrenches that keep their direction are turned."""

SITE_SIZE = 0.01
"""Radius of a site, in sizes of the mechanism."""

NEVER = 4.0
"""rad, beyond which a spring yields that never does: no ball turns more than half a turn."""

WIND_MOTORS = {"force": 2, "first moment": 3, "second moment": 4}
"""Of a wind load, each by its place among forces and torques along the axes of its site."""

TENDON_WIDTH = 0.003
"""Radius of a tendon, in sizes of the mechanism."""


def joint_attributes(scene: Scene) -> dict[str, dict[str, str]]:
    """Attributes of MuJoCo's joints, by their names, that make up the springs and armatures of joints."""
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
                found[name]["springyield"] = number(NEVER)
        else:
            assert_never(spring)
    return found


def _motion_name(mechanism: Mechanism, on: OnCoordinate | OnBall) -> str:
    joint, coordinate = mechanism.joint(on.joint), on.key[1]
    return ball_name(joint) if on.on_ball else coordinate_name(joint, coordinate)


def rests(scene: Scene, tree: SpanningTree, layout: Layout) -> Array:
    """(4 n,) quaternions of MuJoCo's balls where the springs rest that do so elsewhere than in qpos0."""
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
    """Give bodies, by their number, the sites of springs between points, of wrenches and of wind."""
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
    """A point (3,) of a body, given in the world at the initial pose."""
    index = mechanism.body_index(body)
    local = mechanism.bodies[index].pose.point_to_body(point) if index else point
    size = number(SITE_SIZE * mechanism.size)
    return ET.SubElement(elements[index], "site", name=name, pos=numbers(local), size=size)


def add_springs(tendons: ET.Element, scene: Scene) -> None:
    """Springs between points."""
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
    """A straight tendon between the sites that bear its name on two bodies."""
    width = number(TENDON_WIDTH * mechanism.size)
    element = ET.SubElement(tendons, "spatial", {"name": name, "width": width, **more})
    for body in bodies:
        ET.SubElement(element, "site", site=f"{name} on {body}")


def wrenches(scene: Scene) -> list[Wrench]:
    """The wrenches of a scene, in the order of their motors, which come after those of control laws."""
    return [force for force in scene.forces if isinstance(force, Wrench)]


def wind_loads(scene: Scene) -> list[WindLoad]:
    """The wind loads of a scene, in the order of their motors, which come last, three for each."""
    return [force for force in scene.forces if isinstance(force, WindLoad)]


def wind_site(load: WindLoad) -> str:
    """Name of the site at the center of a plate, with its axes."""
    return f"wind {load.name}"


def add_wrenches(actuators: ET.Element, scene: Scene) -> None:
    """Motors on the sites of wrenches."""
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
    """Motors on the sites of wind loads, see `wind_loads`."""
    for load in wind_loads(scene):
        site = wind_site(load)
        for what, place in WIND_MOTORS.items():
            gear = numbers(np.eye(6)[place])
            ET.SubElement(actuators, "motor", name=f"{site} {what}", site=site, gear=gear)
