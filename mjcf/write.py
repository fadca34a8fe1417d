"""Write a scene as MJCF.

- Body frames have their origin at the center of mass and the orientation `Body.quaternion`. The ground of the
  mechanism is MuJoCo's world body.
- Loops close by `<connect>` and `<weld>` equalities. Rods are tendons whose length an equality holds. Gears
  and
  screws are equalities of joints.
- MuJoCo has no time-dependent equality: the file holds a joint with prescribed motion at its start, and
  `mjcf.simulate` moves it.
- PD laws are `<position>` actuators. If a PD law depends on time, the control is the part of its force that
  depends on time. All other control laws are `<motor>` elements whose control is the force; `mjcf.soft` sets
  both kinds of controls.
- Springs, wrenches and wind: see `mjcf.forces`.

The keyframe `start` has the initial state, targets and held forces. A stock viewer runs the scene after the
key is loaded.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import assert_never

import numpy as np

from mjcf.errors import MjcfError, ModelError
from mjcf.forces import (
    add_site,
    add_sites,
    add_springs,
    add_tendon,
    add_winds,
    add_wrenches,
    joint_attributes,
    rests,
    wind_loads,
    wrenches,
)
from mjcf.layout import Layout, number, numbers
from newton_euler.arguments import checked
from newton_euler.equations.couplings import Coupling, TreeCouplings, couplings
from newton_euler.equations.model_control import roles
from newton_euler.equations.relative import Relative
from newton_euler.model.control import NO_FORCES, PD, ComputedTorque, Readings, StateFeedback
from newton_euler.model.digital_control import HeldLaw, Law
from newton_euler.model.euler_parameters import conjugate, from_rotation, product, rotation
from newton_euler.model.geometry import Box, Capsule, Cylinder, Shape, Sphere
from newton_euler.model.joint import Key, Pose
from newton_euler.model.joint_kinds import Rod, Spherical
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import (
    TreeJoint,
    WeldedMechanism,
    coordinate_name,
    motion_names,
    weld_loops,
)
from newton_euler.model.written_file import atomic_file
from newton_euler.reading.wrenches import Wrenches
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

TIMESTEP = 0.001
"""Time step of a written model, s."""

SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Constraint impedance: 0.9999 is MuJoCo's largest value, so that constraints are never rigid."""

START_KEY = "start"
"""Name of the keyframe with the initial state."""

REALISABLE_SLACK = 1e-12
"""Relative slack of A + B >= C in written inertias, for the round-off of MuJoCo."""

MAX_PRINCIPAL_TILT = 1e-5
"""Angle between body axes and principal axes, rad, below which inertias are written in principal axes."""

BODY_COLORS = (
    "0.12 0.47 0.71 1",
    "1 0.5 0.05 1",
    "0.17 0.63 0.17 1",
    "0.84 0.15 0.16 1",
    "0.58 0.4 0.74 1",
    "0.16 0.3 0.5 1",
    "0.89 0.47 0.76 1",
    "0.09 0.75 0.81 1",
)
"""Colors of moving bodies, used cyclically."""

MAX_NESTED_BODIES = 490
"""Largest depth of the tree of bodies: MuJoCo's parser allows 500 nested elements."""

GROUND_COLOR = "0.6 0.6 0.6 1"


@checked
def write(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a scene as an MJCF file; a failed write leaves no partial file. Raises `MjcfError`.

    Examples:
        >>> mjcf.write(load("four_bar"), "output/four_bar.xml")
    """
    text = to_xml(scene)
    try:
        with atomic_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise MjcfError(f"cannot write {os.fspath(path)!r}: {error.strerror}") from error


@checked
def to_xml(scene: Scene) -> str:
    """Return a scene as an MJCF document; numbers keep all digits. Raises `MjcfError`.

    Examples:
        >>> mjcf.to_xml(load("pendulum"))[:7]
        '<mujoco'
    """
    return welded_to_xml(scene, weld_loops(scene.mechanism, keep_bodies=True, loaded=scene.loaded_balls))


def welded_to_xml(scene: Scene, welded: WeldedMechanism) -> str:
    """Return the MJCF document of a scene whose loops are already cut."""
    for body in welded.mechanism.bodies[1:]:
        if body.name == "world":
            raise ModelError(
                scene.name, "a moving body is named 'world', the name of MuJoCo's ground; rename the body"
            )
    depth = [0] * len(welded.mechanism.bodies)
    for joint in welded.tree.joints:
        depth[joint.child] = depth[joint.parent] + 1
    if max(depth) > MAX_NESTED_BODIES:
        reason = f"{max(depth)} bodies in one branch; MuJoCo's XML allows at most {MAX_NESTED_BODIES}"
        raise ModelError(scene.name, reason)
    root = ET.Element("mujoco", model=scene.name)
    _settings(root, scene)
    layout = Layout(welded.tree)
    _world(root, scene, welded, layout)
    _tendons(root, scene, welded)
    _equalities(root, scene, welded)
    _actuators(root, scene)
    _start(root, scene, welded, layout)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _settings(root: ET.Element, scene: Scene) -> None:
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    ET.SubElement(
        root,
        "option",
        timestep=number(TIMESTEP),
        gravity=numbers(scene.gravity),
        integrator="RK4",
        solver="Newton",
        iterations="100",
        tolerance="1e-15",
    )
    default = ET.SubElement(root, "default")
    ET.SubElement(default, "geom", contype="0", conaffinity="0", mass="0", group="1")
    ET.SubElement(default, "equality", solref=numbers([2.0 * TIMESTEP, 1.0]), solimp=numbers(SOLIMP))


def _look(root: ET.Element, scene: Scene) -> None:
    """Set the initial camera of viewers to the mechanism."""
    mechanism = scene.mechanism
    points = [body.center_of_mass for body in mechanism.bodies[1:]]
    points += [joint.point for joint in mechanism.joints]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    extent = max(float(np.linalg.norm(high - low)), mechanism.size)
    ET.SubElement(root, "statistic", center=numbers(0.5 * (low + high)), extent=number(extent))
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.5 0.5 0.5")
    ET.SubElement(visual, "global", azimuth="135", elevation="-20")


def _world(root: ET.Element, scene: Scene, welded: WeldedMechanism, layout: Layout) -> None:
    """Add the tree of bodies with their shapes and sites."""
    _look(root, scene)
    world = ET.SubElement(root, "worldbody")
    in_world = Pose(np.zeros(3), np.eye(3))
    for shape in scene.mechanism.shapes(0):
        add_geom(world, shape, GROUND_COLOR, in_world, np.array([1.0, 0.0, 0.0, 0.0]))
    elements = {0: world}
    springs = joint_attributes(scene)
    for kept in layout.order:
        element = _body(elements[kept.parent], kept, welded, springs)
        elements[kept.child] = element
        if kept.child < len(scene.mechanism.bodies):
            body = scene.mechanism.bodies[kept.child]
            color = BODY_COLORS[(kept.child - 1) % len(BODY_COLORS)]
            for shape in scene.mechanism.shapes(kept.child):
                add_geom(element, shape, color, body.pose, body.quaternion)
    add_sites(elements, scene)
    for rod in rods(welded):
        for end, point in ((rod.first, rod.point), (rod.second, rod.reaction_point)):
            add_site(elements, welded.mechanism, f"rod {rod.name} on {end}", end, point)


def _body(
    parent_element: ET.Element,
    kept: TreeJoint,
    welded: WeldedMechanism,
    springs: dict[str, dict[str, str]],
) -> ET.Element:
    """Add a body with its inertia and joints, without shapes, sites and children."""
    mechanism = welded.mechanism
    body, parent = mechanism.bodies[kept.child], mechanism.bodies[kept.parent]
    position, quaternion = body.center_of_mass, body.quaternion
    if kept.parent != 0:
        position = parent.pose.point_to_body(body.center_of_mass)
        quaternion = product(conjugate(parent.quaternion), body.quaternion)
    element = ET.SubElement(
        parent_element, "body", name=body.name, pos=numbers(position), quat=numbers(quaternion)
    )
    _inertial(element, body)
    joint = welded.tree.joint(kept.joint)
    named = zip(motion_names(joint, kept.forward), kept.motions, kept.points, strict=True)
    for name, motion, point in named:
        attributes = {"name": name, "type": motion.kind}
        attributes["pos"] = numbers(body.pose.point_to_body(point))
        if motion.kind != "ball":
            attributes["axis"] = numbers(body.pose.vector_to_body(motion.axis))
        ET.SubElement(element, "joint", attributes | springs.get(name, {}))
    return element


def _inertial(element: ET.Element, body: Body) -> None:
    """Add mass and inertia. MuJoCo refuses an inertia that violates A + B >= C, even by round-off."""
    inertia = body.inertia
    a, b, c = np.linalg.eigvalsh(inertia)
    lacking = c - a - b + REALISABLE_SLACK * c
    if lacking > 0.0:
        # an equal increase of all three moments keeps the principal axes
        inertia = inertia + lacking * np.eye(3)
        note = f"moments of inertia raised by {lacking:.3g} kg m^2 so that A + B >= C holds"
        element.append(ET.Comment(f" {note} "))
    inertial = ET.SubElement(element, "inertial", pos="0 0 0", mass=number(body.mass))
    if _nearly_principal(inertia):
        moments, axes = principal(inertia)
        inertial.set("quat", numbers(from_rotation(axes)))
        inertial.set("diaginertia", numbers(moments))
        element.set("simple", "false")  # otherwise MuJoCo uses the body axes
        return
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    inertial.set("fullinertia", numbers([xx, yy, zz, xy, xz, yz]))


def _nearly_principal(inertia: Array) -> bool:
    """True if MuJoCo would drop products of inertia: its principal axes ignore turns of about 1e-6 rad."""
    rows, columns = np.triu_indices(3, 1)
    products = np.abs(inertia[rows, columns])
    moments = np.diag(inertia)
    turns = products < MAX_PRINCIPAL_TILT * np.abs(moments[rows] - moments[columns])
    return bool(np.any(turns & (products > np.finfo(float).eps * moments.max())))


def principal(inertia: Array) -> tuple[Array, Array]:
    """Return principal moments (3,) of an inertia (3, 3), and its axes as columns of a rotation matrix."""
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)
    return moments, axes


def add_geom(element: ET.Element, shape: Shape, color: str, pose: Pose, quaternion: Array) -> None:
    """Add a shape in the frame of its body."""
    geom = ET.SubElement(element, "geom")
    geom.set("type", type(shape).__name__.lower())
    if isinstance(shape, Box):
        geom.set("pos", numbers(pose.point_to_body(shape.center)))
        geom.set("quat", numbers(product(conjugate(quaternion), shape.quaternion)))
        geom.set("size", numbers(shape.half_sizes))
    elif isinstance(shape, Sphere):
        geom.set("pos", numbers(pose.point_to_body(shape.center)))
        geom.set("size", number(shape.radius))
    elif isinstance(shape, Capsule | Cylinder):
        geom.set("fromto", numbers([*pose.point_to_body(shape.start), *pose.point_to_body(shape.end)]))
        geom.set("size", number(shape.radius))
    else:
        assert_never(shape)
    geom.set("rgba", color)


def rods(welded: WeldedMechanism) -> list[Rod]:
    """Return the rods among the joints."""
    return [joint for joint in welded.mechanism.joints if isinstance(joint, Rod)]


def _tendons(root: ET.Element, scene: Scene, welded: WeldedMechanism) -> None:
    tendons = ET.Element("tendon")
    add_springs(tendons, scene)
    for coupling in couplings(scene):
        if len(coupling.factors) > 2:
            sum_of = ET.SubElement(tendons, "fixed", name=f"coupling {coupling.name}")
            for key, factor in coupling.factors.items():
                ET.SubElement(sum_of, "joint", joint=_coordinate(scene, key), coef=number(factor))
    for rod in rods(welded):
        add_tendon(tendons, welded.mechanism, f"rod {rod.name}", (rod.first, rod.second), {})
    if len(tendons):
        root.append(tendons)


def _equalities(root: ET.Element, scene: Scene, welded: WeldedMechanism) -> None:
    """Add equalities of loop closures, then of couplings."""
    equality = ET.Element("equality")
    _add_cuts(equality, welded)
    for coupling in couplings(scene):
        _add_coupling(equality, scene, coupling)
    if len(equality):
        root.append(equality)


def _add_coupling(equality: ET.Element, scene: Scene, coupling: Coupling) -> None:
    """Add x_1 = constant + p(x_2); the constant is the first value of a prescribed motion."""
    names = [_coordinate(scene, key) for key in coupling.factors]
    if len(names) > 2:
        attributes = {"name": f"coupling {coupling.name}", "tendon1": f"coupling {coupling.name}"}
        ET.SubElement(equality, "tendon", attributes, polycoef="0 0 0 0 0")
        return
    first, *second = coupling.factors.values()
    constant = coupling.function.value(0.0) / first if coupling.function else 0.0
    higher = [factor for powers in coupling.powers.values() for factor in powers]  # powers of the driver
    coefficients = [constant, *(-factor / first for factor in (*second, *higher)), 0.0, 0.0, 0.0, 0.0]
    attributes = {f"joint{k}": name for k, name in enumerate(names, start=1)}
    # the coordinate makes names of several motions of one joint unique
    attributes["name"] = f"{coupling.what} {coupling.name if second else names[0]}"
    attributes["polycoef"] = numbers(coefficients[:5])
    ET.SubElement(equality, "joint", attributes)


def _coordinate(scene: Scene, key: Key) -> str:
    mechanism = scene.mechanism
    return coordinate_name(mechanism.joint(key[0]), key[1])


def _add_cuts(equality: ET.Element, welded: WeldedMechanism) -> None:
    """Add equalities of balls, rods and welds that close loops."""
    mechanism = welded.mechanism
    ground = mechanism.body_names[0]
    for index in welded.tree.cuts:
        joint = mechanism.joints[index]
        first, second = ("world" if n == ground else n for n in (joint.first, joint.second))
        attributes = {"name": joint.name, "body1": first, "body2": second}
        if isinstance(joint, Rod):
            length = {"tendon1": f"rod {joint.name}", "polycoef": "0 0 0 0 0"}
            ET.SubElement(equality, "tendon", name=joint.name, attrib=length)
            continue
        # MuJoCo's world body is at the origin, not at the pose of the ground
        (p1, q1), (p2, q2) = (
            (np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
            if body is mechanism.bodies[0]
            else (body.center_of_mass, body.quaternion)
            for body in (mechanism.body(n) for n in (joint.first, joint.second))
        )
        if isinstance(joint, Spherical):
            anchor = rotation(q1).T @ (joint.point - p1)
            ET.SubElement(equality, "connect", attributes, anchor=numbers(anchor))
        else:
            anchor = rotation(q2).T @ (joint.reaction_point - p2)
            # the position of relpose is the anchor's, not the body's
            place = rotation(q1).T @ (joint.reaction_point - p1)
            relative = np.concatenate([place, product(conjugate(q1), q2)])
            ET.SubElement(equality, "weld", attributes, anchor=numbers(anchor), relpose=numbers(relative))


def _actuators(root: ET.Element, scene: Scene) -> None:
    actuator = ET.Element("actuator")
    mechanism = scene.mechanism
    for law in scene.control:
        name = coordinate_name(mechanism.joint(law.joint), law.coordinate)
        if not isinstance(law, PD):
            ET.SubElement(actuator, "motor", name=name, joint=name)
            continue
        if law.damping < 0.0:
            reason = f"damping of joint {law.joint!r} is {law.damping:g}; MuJoCo needs 0 or more"
            raise ModelError(scene.name, reason)
        element = ET.SubElement(actuator, "position", name=name, joint=name)
        gains = {"kp": number(law.stiffness), "kv": number(law.damping)}
        changes = law.is_driven or law.uses_model
        if law.feedforward or changes:
            # a position actuator written as general, with a constant or a control in addition
            element.tag = "general"
            gain, constant = (1.0, 0.0) if changes else (law.stiffness, law.feedforward_at(0.0))
            bias = numbers([constant, -law.stiffness, -law.damping])
            gains = {"gainprm": number(gain), "biastype": "affine", "biasprm": bias}
        element.attrib.update(gains)
    add_wrenches(actuator, scene)
    add_winds(actuator, scene)
    if len(actuator):
        root.append(actuator)


def controls(
    scene: Scene, time: float, readings: Readings, model: Mapping[Key, float] = NO_FORCES
) -> list[float]:
    """Return the controls of MuJoCo's actuators at a time, s: of control laws, and 1 for wrenches."""
    return [control(law, time, readings, model) for law in scene.control] + [1.0] * len(wrenches(scene))


def control(law: Law, time: float, readings: Readings, model: Mapping[Key, float]) -> float:
    """Return the control of a law's actuator at a time, s.

    The control of a PD law is its target, m or rad, or its time-dependent force, N or N m, if the law depends
    on time or on a model. The control of other laws is their force. `model` has the model-based forces of
    laws.
    """
    if isinstance(law, HeldLaw):
        return law.held
    if isinstance(law, StateFeedback | ComputedTorque):
        return float(law.towards(law.references(time), readings, time, model))
    if not isinstance(law, PD):
        assert_never(law)
    if law.uses_model:
        return float(law.force(0.0, 0.0, time) + model[law.key])
    if law.is_driven:
        return float(law.force(0.0, 0.0, time))
    return float(law.references(time)[law.key].value)


def _start(root: ET.Element, scene: Scene, welded: WeldedMechanism, layout: Layout) -> None:
    state = initial_state(scene)
    q, v = welded.tree.coordinates(welded.state(state))
    q = TreeCouplings(scene, welded.tree).turned(q, state, 0.0)
    attributes = {"name": START_KEY}
    if len(q):
        attributes["qpos"] = numbers(layout.to_qpos @ q)
        attributes["qvel"] = numbers(layout.to_qvel @ v)
    places = {key: welded.tree.place(*key) for key in scene.sensed}
    readings = {key: (q[place[0]], v[place[1]]) for key, place in places.items() if place}
    model: Mapping[Key, float] = {}
    if roles(scene):
        system = Relative(scene)
        model = system.model_forces(*system.coordinates(state))
    acting = Wrenches(scene.mechanism, state)
    winds = [value for load in wind_loads(scene) for value in acting.wind(load)]
    if ctrl := controls(scene, 0.0, readings, model) + winds:
        attributes["ctrl"] = numbers(ctrl)
    if len(resting := rests(scene, welded.tree, layout)):
        attributes["plastic"] = numbers(resting)
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", attributes)
