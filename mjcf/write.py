"""Write a scene (a mechanism with its forces, control laws and initial state) as MJCF.

- Body frames have their origin at the center of mass and the orientation `Body.quaternion`. The ground of the
  mechanism is MuJoCo's world body.
- `<connect>` and `<weld>` equalities close loops. A rod (a massless link with a ball at each end) is a
  tendon, whose length an equality keeps constant. Gears and screws are equalities of joints.
- MuJoCo has no time-dependent equality. In the file, an equality holds a joint with prescribed motion at the
  joint's initial position, and `mjcf.simulate` moves the joint.
- PD laws are `<position>` actuators. If a PD law depends on time or compensates gravity, the actuator is
  `<general>`, and its control is the part of the force that is not linear feedback. All other control laws
  are `<motor>` elements whose control is the force. `mjcf.soft` sets the controls during a run.
- Springs, wrenches and wind: see `mjcf.forces`. Dry friction and stops: see `mjcf.write_friction`.

The keyframe `start` has the initial state and the initial controls. After loading this keyframe, MuJoCo's
viewer runs the scene.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from types import MappingProxyType
from typing import assert_never

import numpy as np

from mjcf.constraint_solver import ConstraintSolver
from mjcf.errors import MjcfError, ModelError
from mjcf.forces import (
    add_site,
    add_sites,
    add_springs,
    add_tendon,
    add_winds,
    add_wrenches,
    ball_spring_rests,
    joint_attributes,
    wind_loads,
    wrenches,
)
from mjcf.layout import Layout, number, numbers
from newton_euler.arguments import checked
from newton_euler.equations.coupling_equations import TreeCouplings
from newton_euler.equations.couplings import Coupling, couplings
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
"""Attribute `solimp` of equalities: 0.9999 is the largest impedance that MuJoCo allows."""

START_KEY = "start"
"""Name of the keyframe with the initial state."""

REALIZABLE_SLACK = 1e-12
"""Least value of (A + B - C) / C that written principal moments A <= B <= C have.

The margin is above round-off, because MuJoCo refuses moments for which it computes A + B < C.
"""

MAX_PRINCIPAL_TILT = 1e-5
"""Angle between body axes and principal axes, rad, below which inertias are written in principal axes.

MuJoCo ignores angles up to about 1e-6 rad, see `_loses_products`.
"""

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
"""Largest depth of the tree of bodies: MuJoCo's parser allows 500 nested elements of any kind."""

GROUND_COLOR = "0.6 0.6 0.6 1"
"""Color of the shapes of the ground: red, green, blue, opacity."""


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
    # keep_bodies: close loops at fixed joints of the mechanism where possible, because readers of MJCF merge
    # bodies that have no joint between them; loaded: joints whose ball has a spring, damper or armature,
    # which an equality could not have
    welded = weld_loops(scene.mechanism, keep_bodies=True, loaded=scene.loaded_balls)
    document = welded_to_xml(scene, welded)
    if not scene.switched_forces:
        return document
    from mjcf.write_friction import constraint_attributes  # imports MuJoCo, which other scenes do not need

    try:
        return welded_to_xml(scene, welded, constraint_attributes(scene, document))
    except ValueError as error:
        raise ModelError(scene.name, " ".join(str(error).split())) from error


def welded_to_xml(
    scene: Scene,
    welded: WeldedMechanism,
    friction_and_limits: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> str:
    """Return the MJCF document of a scene for its welded mechanism, as `weld_loops` makes it.

    Dry friction and stops are no part of the document unless their attributes are given: for `mjcf.model`,
    MuJoCo gets them as forces.

    In the welded mechanism, only balls, rods and welds close loops: at other joints that close a loop, a body
    is cut into halves, which a weld joins. The halves follow the bodies of the scene.

    Args:
        scene: the scene.
        welded: welded mechanism.
        friction_and_limits: attributes of dry friction and limits, by name of MuJoCo's joint, see
            `mjcf.write_friction`.

    Raises:
        ModelError: for a mechanism that MJCF cannot represent.
    """
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
    _add_settings(root, scene)
    layout = Layout(welded.tree)
    _add_world(root, scene, welded, layout, friction_and_limits)
    _add_tendons(root, scene, welded)
    _add_equalities(root, scene, welded)
    _add_actuators(root, scene)
    _add_start_keyframe(root, scene, welded, layout)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add_settings(root: ET.Element, scene: Scene) -> None:
    """Add options of the compiler and the solver, and defaults of shapes and equalities.

    Shapes have neither contacts nor mass. Equalities are as stiff as the time step allows.
    """
    solver = ConstraintSolver()
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    ET.SubElement(
        root,
        "option",
        timestep=number(TIMESTEP),
        gravity=numbers(scene.gravity),
        integrator="RK4",
        solver=solver.name,
        iterations=f"{solver.iterations}",
        tolerance=number(solver.tolerance),
    )
    default = ET.SubElement(root, "default")
    ET.SubElement(default, "geom", contype="0", conaffinity="0", mass="0", group="1")
    ET.SubElement(default, "equality", solref=numbers([2.0 * TIMESTEP, 1.0]), solimp=numbers(SOLIMP))


def _add_camera(root: ET.Element, scene: Scene) -> None:
    """Point the initial camera of viewers at the mechanism, and set the light."""
    mechanism = scene.mechanism
    points = [body.center_of_mass for body in mechanism.bodies[1:]]  # without the ground
    points += [joint.point for joint in mechanism.joints]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    extent = max(float(np.linalg.norm(high - low)), mechanism.size)
    ET.SubElement(root, "statistic", center=numbers(0.5 * (low + high)), extent=number(extent))
    visual = ET.SubElement(root, "visual")
    ET.SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.5 0.5 0.5")
    ET.SubElement(visual, "global", azimuth="135", elevation="-20")


def _add_world(
    root: ET.Element,
    scene: Scene,
    welded: WeldedMechanism,
    layout: Layout,
    friction_and_limits: Mapping[str, Mapping[str, str]],
) -> None:
    """Add the tree of bodies with their shapes, and the sites to which forces and rods are attached."""
    _add_camera(root, scene)
    world = ET.SubElement(root, "worldbody")
    world_pose = Pose(np.zeros(3), np.eye(3))
    for shape in scene.mechanism.shapes(0):
        add_geom(world, shape, GROUND_COLOR, world_pose, np.array([1.0, 0.0, 0.0, 0.0]))
    elements = {0: world}  # XML element by number of the body
    force_attributes = joint_attributes(scene)
    for name, attributes in friction_and_limits.items():
        force_attributes[name] = {**force_attributes.get(name, {}), **attributes}
    for tree_joint in layout.order:  # depth first, as MuJoCo numbers bodies
        element = _add_body(elements[tree_joint.parent], tree_joint, welded, force_attributes)
        elements[tree_joint.child] = element
        # added halves of cut bodies have no shapes
        if tree_joint.child < len(scene.mechanism.bodies):
            body = scene.mechanism.bodies[tree_joint.child]
            color = BODY_COLORS[(tree_joint.child - 1) % len(BODY_COLORS)]
            for shape in scene.mechanism.shapes(tree_joint.child):
                add_geom(element, shape, color, body.pose, body.quaternion)
    add_sites(elements, scene)
    for rod in rods(welded):
        # `point` is the rod's end on the first body, `point_on_second` on the second
        for body_name, point in ((rod.first, rod.point), (rod.second, rod.point_on_second)):
            add_site(elements, welded.mechanism, f"rod {rod.name} on {body_name}", body_name, point)


def _add_body(
    parent_element: ET.Element,
    tree_joint: TreeJoint,
    welded: WeldedMechanism,
    force_attributes: dict[str, dict[str, str]],
) -> ET.Element:
    """Add a body with its inertia and joints, without shapes, sites and children; return its element.

    Args:
        parent_element: XML element of the parent body.
        tree_joint: joint of the spanning tree between parent and body. MuJoCo has a joint for each of its
            elementary motions (hinge, slide, ball). `forward` is True if the body is the joint's second one.
        welded: welded mechanism.
        force_attributes: attributes of springs, armatures, friction and limits, by name of MuJoCo's joint.
    """
    mechanism = welded.mechanism
    body, parent = mechanism.bodies[tree_joint.child], mechanism.bodies[tree_joint.parent]
    position, quaternion = body.center_of_mass, body.quaternion
    if tree_joint.parent != 0:
        position = parent.pose.point_to_body(body.center_of_mass)
        quaternion = product(conjugate(parent.quaternion), body.quaternion)
    element = ET.SubElement(
        parent_element, "body", name=body.name, pos=numbers(position), quat=numbers(quaternion)
    )
    _add_inertial(element, body)
    joint = welded.tree.joint(tree_joint.joint)
    names = motion_names(joint, forward=tree_joint.forward)
    for name, motion, point in zip(names, tree_joint.motions, tree_joint.points, strict=True):
        attributes = {"name": name, "type": motion.kind}
        attributes["pos"] = numbers(body.pose.point_to_body(point))
        if motion.kind != "ball":
            attributes["axis"] = numbers(body.pose.vector_to_body(motion.axis))
        ET.SubElement(element, "joint", attributes | force_attributes.get(name, {}))
    return element


def _add_inertial(element: ET.Element, body: Body) -> None:
    """Add mass and inertia of a body.

    MuJoCo refuses principal moments A <= B <= C that violate A + B >= C, even by round-off. If necessary, all
    three are raised, and a comment in the file reports by how much.
    """
    inertia = body.inertia
    a, b, c = np.linalg.eigvalsh(inertia)
    increase = c - a - b + REALIZABLE_SLACK * c
    if increase > 0.0:
        # an equal increase of all three moments keeps the principal axes
        inertia = inertia + increase * np.eye(3)
        note = f"moments of inertia raised by {increase:.3g} kg m^2 so that A + B >= C holds"
        element.append(ET.Comment(f" {note} "))
    inertial = ET.SubElement(element, "inertial", pos="0 0 0", mass=number(body.mass))
    if _loses_products(inertia):
        moments, axes = principal(inertia)
        inertial.set("quat", numbers(from_rotation(axes)))
        inertial.set("diaginertia", numbers(moments))
        element.set("simple", "false")  # otherwise MuJoCo uses the body axes
        return
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    inertial.set("fullinertia", numbers([xx, yy, zz, xy, xz, yz]))


def _loses_products(inertia: Array) -> bool:
    """Return True if MuJoCo would drop a product of the inertia (3, 3) about body axes, kg m^2.

    MuJoCo's principal axes ignore an angle of about 1e-6 rad between body axes and principal axes.
    """
    rows, columns = np.triu_indices(3, 1)
    products = np.abs(inertia[rows, columns])
    moments = np.diag(inertia)
    has_small_angle = products < MAX_PRINCIPAL_TILT * np.abs(moments[rows] - moments[columns])
    return bool(np.any(has_small_angle & (products > np.finfo(float).eps * moments.max())))


def principal(inertia: Array) -> tuple[Array, Array]:
    """Return principal moments (3,) of an inertia (3, 3), and its axes as columns of a rotation matrix."""
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.linalg.det(axes)  # a reflection (determinant -1) becomes a rotation
    return moments, axes


def add_geom(element: ET.Element, shape: Shape, color: str, pose: Pose, quaternion: Array) -> None:
    """Add a shape to the XML element of its body.

    Args:
        element: XML element of the body.
        shape: shape in the world frame at the initial pose.
        color: red, green, blue and opacity as an MJCF attribute.
        pose: initial pose of the body.
        quaternion: (4,) initial orientation of the body.
    """
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
    """Return the rods among the joints of a welded mechanism."""
    return [joint for joint in welded.mechanism.joints if isinstance(joint, Rod)]


def _add_tendons(root: ET.Element, scene: Scene, welded: WeldedMechanism) -> None:
    """Add tendons of point springs, of couplings with more than two coordinates, and of rods."""
    tendons = ET.Element("tendon")
    add_springs(tendons, scene)
    for coupling in couplings(scene):
        if len(coupling.factors) > 2:
            weighted_sum = ET.SubElement(tendons, "fixed", name=f"coupling {coupling.name}")
            for key, factor in coupling.factors.items():
                joint = _mujoco_joint_name(scene, key)
                ET.SubElement(weighted_sum, "joint", joint=joint, coef=number(factor))
    for rod in rods(welded):
        add_tendon(tendons, welded.mechanism, f"rod {rod.name}", (rod.first, rod.second), {})
    if len(tendons):
        root.append(tendons)


def _add_equalities(root: ET.Element, scene: Scene, welded: WeldedMechanism) -> None:
    """Add equalities of loop closures, then of couplings (gears, screws, prescribed motions)."""
    equality = ET.Element("equality")
    _add_loop_closures(equality, welded)
    for coupling in couplings(scene):
        _add_coupling(equality, scene, coupling)
    if len(equality):
        root.append(equality)


def _add_coupling(equality: ET.Element, scene: Scene, coupling: Coupling) -> None:
    """Add the equality of a coupling, a sum of polynomials of joint coordinates that equals f(t).

    For one or two coordinates, MuJoCo's equality is x_1 = constant + p(x_2) with a polynomial p. A prescribed
    motion has one coordinate, and the constant is its value at t = 0. Couplings of more coordinates are
    linear. Their equality keeps the length of a fixed tendon, the weighted sum of the coordinates, constant.
    """
    names = [_mujoco_joint_name(scene, key) for key in coupling.factors]
    if len(names) > 2:
        attributes = {"name": f"coupling {coupling.name}", "tendon1": f"coupling {coupling.name}"}
        ET.SubElement(equality, "tendon", attributes, polycoef="0 0 0 0 0")
        return
    # first x_1 + second x_2 + sum_k higher_k x_2^(k + 2) = f(t), k = 0, 1, 2; only x_2 has higher powers
    first, *second = coupling.factors.values()
    constant = coupling.function.value(0.0) / first if coupling.function else 0.0
    higher = [factor for powers in coupling.powers.values() for factor in powers]
    coefficients = [constant, *(-factor / first for factor in (*second, *higher)), 0.0, 0.0, 0.0, 0.0]
    attributes = {f"joint{k}": name for k, name in enumerate(names, start=1)}
    # a joint may have several prescribed motions; the name of the coordinate is unique
    attributes["name"] = f"{coupling.what} {coupling.name if second else names[0]}"
    attributes["polycoef"] = numbers(coefficients[:5])
    ET.SubElement(equality, "joint", attributes)


def _mujoco_joint_name(scene: Scene, key: Key) -> str:
    """Return the name of MuJoCo's hinge or slide for a joint coordinate (joint name, index)."""
    joint_name, index = key
    return coordinate_name(scene.mechanism.joint(joint_name), index)


def _add_loop_closures(equality: ET.Element, welded: WeldedMechanism) -> None:
    """Add equalities of balls, rods and welds that close loops."""
    mechanism = welded.mechanism
    ground = mechanism.body_names[0]
    for index in welded.tree.cuts:  # joints that are not in the tree of bodies
        joint = mechanism.joints[index]
        first, second = (
            "world" if body_name == ground else body_name for body_name in (joint.first, joint.second)
        )
        attributes = {"name": joint.name, "body1": first, "body2": second}
        if isinstance(joint, Rod):
            length = {"tendon1": f"rod {joint.name}", "polycoef": "0 0 0 0 0"}
            ET.SubElement(equality, "tendon", name=joint.name, attrib=length)
            continue
        # position and quaternion of both body frames; MuJoCo's world body is at the origin, not at the pose
        # of the ground
        poses = []
        for body in (mechanism.body(joint.first), mechanism.body(joint.second)):
            if body is mechanism.bodies[0]:
                poses.append((np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])))
            else:
                poses.append((body.center_of_mass, body.quaternion))
        (p1, q1), (p2, q2) = poses
        if isinstance(joint, Spherical):
            anchor = rotation(q1).T @ (joint.point - p1)
            ET.SubElement(equality, "connect", attributes, anchor=numbers(anchor))
        else:
            anchor = rotation(q2).T @ (joint.point_on_second - p2)
            # the position in `relpose` is the anchor in body 1, not the position of body 2
            anchor_in_first = rotation(q1).T @ (joint.point_on_second - p1)
            relpose = np.concatenate([anchor_in_first, product(conjugate(q1), q2)])
            ET.SubElement(equality, "weld", attributes, anchor=numbers(anchor), relpose=numbers(relpose))


def _add_actuators(root: ET.Element, scene: Scene) -> None:
    """Add the actuators of control laws, then the motors of wrenches and of wind."""
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
        control_is_force = law.depends_on_time or law.uses_model
        if law.feedforward or control_is_force:
            # force = gain ctrl + constant - stiffness x - damping dx/dt. Either ctrl is the whole part of the
            # force that is not feedback (feedforward, target, gravity compensation), or ctrl is the target.
            element.tag = "general"
            gain, constant = (1.0, 0.0) if control_is_force else (law.stiffness, law.feedforward_at(0.0))
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
    """Return the controls of MuJoCo's actuators without wind: of control laws, then 1 for each wrench.

    Args:
        scene: scene with the control laws.
        time: s.
        readings: measured coordinates (m or rad) and rates, by joint coordinate.
        model: forces that laws compute from a model of the mechanism (computed torque, gravity compensation),
            N or N m, by joint coordinate.
    """
    return [control(law, time, readings, model) for law in scene.control] + [1.0] * len(wrenches(scene))


def control(law: Law, time: float, readings: Readings, model: Mapping[Key, float]) -> float:
    """Return the control of a law's actuator.

    The control of a PD law is its target, m or rad. If a PD law depends on time or on a model of the
    mechanism, its control is its force at x = dx/dt = 0, N or N m; the actuator adds the feedback. The
    control of other laws is their force. For the arguments see `controls`.
    """
    if isinstance(law, HeldLaw):  # a digital law, whose force is constant between samples
        return law.held
    if isinstance(law, StateFeedback | ComputedTorque):
        # force that drives the readings towards the set-points
        return float(law.towards(law.references(time), readings, time, model))
    if not isinstance(law, PD):
        assert_never(law)
    if law.uses_model:
        return float(law.force(x=0.0, x_rate=0.0, time=time) + model[law.key])
    if law.depends_on_time:
        return float(law.force(x=0.0, x_rate=0.0, time=time))
    return float(law.references(time)[law.key].value)  # the target, by the key of its joint coordinate


def _add_start_keyframe(root: ET.Element, scene: Scene, welded: WeldedMechanism, layout: Layout) -> None:
    """Add the keyframe with the initial state, the initial controls, and the rests of ball springs.

    The attribute `plastic` of a key, new in MuJoCo 4, has the rest orientations of ball springs that do not
    rest at qpos0, see `mjcf.forces`.
    """
    state = initial_state(scene)
    q, v = welded.tree.coordinates(welded.state(state))
    # poses give angles up to full revolutions; couplings and springs need the revolutions too
    q = TreeCouplings(scene, welded.tree).turned(q, state, time=0.0)
    attributes = {"name": START_KEY}
    if len(q):
        attributes["qpos"] = numbers(layout.to_qpos @ q)
        attributes["qvel"] = numbers(layout.to_qvel @ v)
    # coordinates and rates that control laws measure; `place` gives their indices in q and v, or None for a
    # joint that closes a loop
    readings = {}
    for key in scene.sensed:
        if indices := welded.tree.place(*key):
            q_index, v_index = indices
            readings[key] = q[q_index], v[v_index]
    # forces of computed torque and gravity compensation, by the joint-coordinate formulation (`Relative`)
    model_forces: Mapping[Key, float] = {}
    if roles(scene):  # the laws that use a model of the mechanism
        system = Relative(scene)
        model_forces = system.model_forces(*system.coordinates(state))
    # each wind load has three controls: its normal force, N, and two moments, N m
    forces_at_start = Wrenches(scene.mechanism, state)
    winds = [value for load in wind_loads(scene) for value in forces_at_start.wind(load)]
    if ctrl := controls(scene, 0.0, readings, model_forces) + winds:
        attributes["ctrl"] = numbers(ctrl)
    if len(rests := ball_spring_rests(scene, welded.tree, layout)):
        attributes["plastic"] = numbers(rests)
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", attributes)
