"""Changes that only one format has: drives, springs, loops and base of an MJCF, mimic joints of a URDF.

Also changes of the text of any file: fewer digits. See `tests.support.planted.changes`.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable

import mujoco
import numpy as np

from crosscheck.differences.difference import Quantity
from newton_euler.reading.robot import Placement
from tests.support.planted.changes import COMMON, Change, chosen, one
from tests.support.planted.mjcf_text import MjcfText
from tests.support.planted.model_text import ModelText
from tests.support.planted.plant import Expected, NotApplicable, Plant, numbers, text, turn
from tests.support.planted.urdf_text import UrdfText

MjcfChange = Callable[[MjcfText, np.random.Generator], Plant]
UrdfChange = Callable[[UrdfText, np.random.Generator], Plant]

OF_MJCF: dict[str, MjcfChange] = {}
"""Changes of MJCF files by the name of their kind."""

OF_URDF: dict[str, UrdfChange] = {}
"""Changes of URDF files by the name of their kind."""


def of_mjcf(change: MjcfChange) -> MjcfChange:
    """Add a change to `OF_MJCF`; its name without underscores is the kind."""
    OF_MJCF[change.__name__.replace("_", " ")] = change
    return change


def of_urdf(change: UrdfChange) -> UrdfChange:
    """Add a change to `OF_URDF`; its name without underscores is the kind."""
    OF_URDF[change.__name__.replace("_", " ")] = change
    return change


def changes(file: ModelText) -> dict[str, Change]:
    """Return all changes of files of a format by the name of their kind."""
    own = OF_MJCF if isinstance(file, MjcfText) else OF_URDF
    return {**COMMON, **own}  # type: ignore[dict-item]


# Drives of MJCF


def _drives(file: MjcfText) -> dict[str, ET.Element]:
    """Return the actuators that have a name by their name."""
    found = [each for part in file.root.findall("actuator") for each in part]
    return {str(each.get("name")): each for each in found if each.get("name")}


def _servos(file: MjcfText) -> list[str]:
    """Return the names of position servos without a motor's gear of their own."""
    affine = int(mujoco.mjtBias.mjBIAS_AFFINE)
    servos = []
    for name, drive in _drives(file).items():
        own = file.model.actuator(name)
        is_plain = "dampratio" not in drive.attrib and "timeconst" not in drive.attrib
        if file.model.actuator_biastype[own.id] == affine and own.biasprm[1] and is_plain:
            servos.append(name)
    return servos


def _set_law(file: MjcfText, name: str, kp: float, kv: float) -> None:
    """Multiply kp and kv of a servo with factors."""
    drive, own = _drives(file)[name], file.model.actuator(name)
    if drive.tag == "position":
        file.set(drive, kp=text(kp * own.gainprm[0]), kv=text(-kv * own.biasprm[2]))
    elif drive.tag == "general":
        file.set(
            drive,
            gainprm=text(kp * own.gainprm[0]),
            biasprm=text(own.biasprm[0], kp * own.biasprm[1], kv * own.biasprm[2]),
        )
    else:
        raise NotApplicable(f"a {drive.tag} has no kp")


@of_mjcf
def gear(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make a gear larger by 20 %."""
    name = chosen(random, _drives(file))
    file.set(_drives(file)[name], gear=text(*1.2 * file.model.actuator(name).gear))
    return one(name, Quantity.GEAR, 0.2)


@of_mjcf
def sign_of_gear(file: MjcfText, random: np.random.Generator) -> Plant:
    """Reverse the sign of a gear."""
    name = chosen(random, _drives(file))
    file.set(_drives(file)[name], gear=text(*-file.model.actuator(name).gear))
    return one(name, Quantity.GEAR, 2.0)


@of_mjcf
def kp(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make the stiffness (kp) of a servo larger by 30 %."""
    name = chosen(random, _servos(file))
    _set_law(file, name, 1.3, 1.0)
    return one(name, Quantity.KP, 0.3)


@of_mjcf
def kv(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make the damping (kv) of a servo larger by 30 %."""
    servos = [name for name in _servos(file) if file.model.actuator(name).biasprm[2]]
    name = chosen(random, servos)
    _set_law(file, name, 1.0, 1.3)
    return one(name, Quantity.KV, 0.3)


@of_mjcf
def control_limits(file: MjcfText, random: np.random.Generator) -> Plant:
    """Halve the range of controls of a drive."""
    limited = [name for name in _drives(file) if file.model.actuator(name).ctrllimited[0]]
    name = chosen(random, limited)
    low, high = file.model.actuator(name).ctrlrange
    file.set(_drives(file)[name], ctrlrange=text(0.5 * low, 0.5 * high))
    return one(name, Quantity.CONTROL_LIMITS, 0.5)


@of_mjcf
def force_limits(file: MjcfText, random: np.random.Generator) -> Plant:
    """Halve the force limits of a drive, or give it limits of 20 N m."""
    name = chosen(random, _drives(file))
    own = file.model.actuator(name)
    is_limited = bool(own.forcelimited[0])
    low, high = own.forcerange if is_limited else (-20.0, 20.0)
    file.set(
        _drives(file)[name],
        forcerange=text(*(np.array([low, high]) * (0.5 if is_limited else 1.0))),
        forcelimited="true",
    )
    return one(name, Quantity.FORCE_LIMITS, 0.5 if is_limited else 1.0)


@of_mjcf
def motor_dropped(file: MjcfText, random: np.random.Generator) -> Plant:
    """Remove a drive."""
    name = chosen(random, _drives(file))
    for part in file.root.findall("actuator"):
        if _drives(file)[name] in list(part):
            part.remove(_drives(file)[name])
            break
    file.set(file.root)
    return one(name, Quantity.PRESENCE)


@of_mjcf
def motor_on_another_joint(file: MjcfText, random: np.random.Generator) -> Plant:
    """Let a drive act on a joint that another drive acts on already."""
    driven = {name: str(drive.get("joint")) for name, drive in _drives(file).items() if drive.get("joint")}
    name = chosen(random, driven)
    joint = chosen(random, [other for other in driven.values() if other != driven[name]])
    file.set(_drives(file)[name], joint=joint)
    return one(name, Quantity.TRANSMISSION, None, "another joint")


# Joints of MJCF


@of_mjcf
def armature(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make the armature of a joint larger by 50 %, or give it 0.01 kg m^2."""
    joint = chosen(random, file.hinges())
    value = file.number(joint, "armature")
    file.set_number(joint, "armature", 1.5 * value if value else 0.01)
    return one(joint, Quantity.ARMATURE, 0.5 if value else 1.0)


@of_mjcf
def stiffness(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make the spring of a joint stiffer by 50 %, or give it 5 N m/rad."""
    joint = chosen(random, file.hinges())
    value = file.number(joint, "stiffness")
    file.set_number(joint, "stiffness", 1.5 * value if value else 5.0)
    return one(joint, Quantity.STIFFNESS, 0.5 if value else 1.0)


@of_mjcf
def rest_of_spring(file: MjcfText, random: np.random.Generator) -> Plant:
    """Move the angle at which a spring has no force by 0.2 rad."""
    joint = chosen(random, (joint for joint in file.hinges() if file.number(joint, "stiffness")))
    rest = file.model.qpos_spring[file.model.joint(joint).qposadr[0]] + 0.2
    file.set(file.joint_elements[joint], springref=text(rest / file.angle_unit))
    return one(joint, Quantity.REST, 0.2)


@of_mjcf
def kind_of_joint(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make a hinge a slide."""
    hinges = {joint: body for joint, body in file.hinges().items() if not file.number(joint, "stiffness")}
    joint = chosen(random, hinges)
    file.set(file.joint_elements[joint], type="slide")
    rows = (Expected(joint, Quantity.KIND),)
    return Plant(rows, touched=frozenset([joint, hinges[joint]]), has_truth=False)


# Loops and couplings of MJCF


def _equalities(file: MjcfText, tag: str) -> dict[str, ET.Element]:
    """Return the equality constraints of a kind by the names that rows of differences have for them."""
    found = {}
    for each in (each for part in file.root.findall("equality") for each in part.findall(tag)):
        if each.get("active") != "false":
            bodies = f"{each.get('body1')} and {each.get('body2', 'the ground')}"
            found[each.get("name") or (bodies if tag != "joint" else str(each.get("joint1")))] = each
    return found


@of_mjcf
def loop_point(file: MjcfText, random: np.random.Generator) -> Plant:
    """Move the point at which a loop is closed by 5 mm."""
    loops = {name: each for name, each in _equalities(file, "connect").items() if each.get("anchor")}
    name = chosen(random, loops)
    anchor = numbers(loops[name].get("anchor"), "0 0 0")
    file.set(loops[name], anchor=text(*anchor + np.array([0.0, 0.005, 0.0])))
    return one(name, Quantity.LOOP_POINT, 0.005)


@of_mjcf
def loop_dropped(file: MjcfText, random: np.random.Generator) -> Plant:
    """Remove the constraint that closes a loop."""
    name = chosen(random, _equalities(file, "connect"))
    return _without_equality(file, "connect", name)


@of_mjcf
def coupling_dropped(file: MjcfText, random: np.random.Generator) -> Plant:
    """Remove the coupling of two joints."""
    name = chosen(random, _equalities(file, "joint"))
    return _without_equality(file, "joint", name)


def _without_equality(file: MjcfText, tag: str, name: str) -> Plant:
    """Remove an equality constraint."""
    element = _equalities(file, tag)[name]
    for part in file.root.findall("equality"):
        if element in list(part):
            part.remove(element)
    file.set(file.root)
    return one(name, Quantity.PRESENCE)


@of_mjcf
def coupling(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make the factor of a coupling larger by 0.1."""
    couplings = _equalities(file, "joint")
    name = chosen(random, couplings)
    powers = numbers(couplings[name].get("polycoef"), "0 1 0 0 0")
    powers[1] += 0.1
    file.set(couplings[name], polycoef=text(*powers))
    return one(name, Quantity.COUPLING, 0.1)


# Whole robot in MJCF


def _set_option(file: MjcfText, **attributes: str) -> None:
    """Replace attributes of the <option>."""
    found = file.root.find("option")
    file.set(ET.SubElement(file.root, "option") if found is None else found, **attributes)


@of_mjcf
def gravity(file: MjcfText, random: np.random.Generator) -> Plant:
    """Set gravity to 9 m/s^2."""
    before = np.linalg.norm(file.model.opt.gravity)
    _set_option(file, gravity="0 0 -9")
    return Plant((Expected("", Quantity.GRAVITY, abs(9.0 - float(before)) / float(before)),))


@of_mjcf
def time_step(file: MjcfText, random: np.random.Generator) -> Plant:
    """Double the time step, which does not change the robot."""
    _set_option(file, timestep=text(2.0 * file.model.opt.timestep))
    return Plant(conventions=(Quantity.TIME_STEP,))


@of_mjcf
def integrator(file: MjcfText, random: np.random.Generator) -> Plant:
    """Replace RK4 by Euler, or another integrator by RK4, which does not change the robot."""
    is_rk4 = file.model.opt.integrator == int(mujoco.mjtIntegrator.mjINT_RK4)
    _set_option(file, integrator="Euler" if is_rk4 else "RK4")
    return Plant(conventions=(Quantity.INTEGRATOR,))


@of_mjcf
def base_fixed_or_floating(file: MjcfText, random: np.random.Generator) -> Plant:
    """Remove the free joint of the base, or add one."""
    base = file.bodies()[0]
    element = file.elements[base]
    free = [each for each in element if each.tag == "freejoint" or each.get("type") == "free"]
    if free:
        element.remove(free[0])
    elif file.joints_above(base):
        raise NotApplicable("a joint carries the base")
    else:
        ET.SubElement(element, "freejoint", name="planted_free_joint")
    file._read()
    return Plant((Expected("", Quantity.BASE),), has_truth=False)


def _fixed_base(file: ModelText) -> str:
    """Return the name of the first body if it is fixed to the ground and carries a joint."""
    base = file.bodies()[0]
    if file.joints_above(base) or file.parent(base) is not None:
        raise NotApplicable("the base is not fixed")
    return base


@of_mjcf
def base_tilted(file: MjcfText, random: np.random.Generator) -> Plant:
    """Tilt a fixed base by 0.1 rad."""
    base = _fixed_base(file)
    rotation = turn(np.array([1.0, 0.0, 0.0]), 0.1)
    file.set_placement(base, Placement(np.zeros(3), rotation) @ file.placement(base))
    return Plant((Expected(base, Quantity.BASE, 0.1, "turned against gravity"),), touched=frozenset([base]))


@of_mjcf
def base_moved(file: MjcfText, random: np.random.Generator) -> Plant:
    """Move a fixed base by 0.37 m and turn it by 1 rad about the vertical, which changes nothing."""
    base = _fixed_base(file)
    elsewhere = Placement(np.array([0.3, 0.1, 0.2]), turn(np.array([0.0, 0.0, 1.0]), 1.0))
    file.set_placement(base, elsewhere @ file.placement(base))
    return Plant(conventions=(Quantity.BASE,), touched=frozenset([base]))


@of_mjcf
def mass_of_fixed_base(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make a fixed base heavier by 20 %, which does not change the motion."""
    base = _fixed_base(file)
    file.set_mass(base, 1.2 * file.inertial(base).mass)
    return Plant(conventions=(Quantity.MASS,), touched=frozenset([base]))


@of_mjcf
def size_of_shape(file: MjcfText, random: np.random.Generator) -> Plant:
    """Make a shape that gives its body mass thicker by 10 %."""
    shapes = {
        body: each
        for body in file.bodies()
        if not file.has_inertial(body)
        for each in file.elements[body].findall("geom")
        if each.get("size") and file.is_moving(body)
    }
    body = chosen(random, shapes)
    before = file.inertial(body)
    sizes = numbers(shapes[body].get("size"), "0")
    file.set(shapes[body], size=text(1.1 * sizes[0], *sizes[1:]))
    after = file.inertial(body)
    rows = [Expected(body, Quantity.INERTIA)]
    if after.mass != before.mass:
        rows.append(Expected(body, Quantity.MASS, after.mass / before.mass - 1.0))
    shift = math.dist(after.center, before.center)
    if shift > 1e-6:
        rows.append(Expected(body, Quantity.CENTER, shift))
    return Plant(tuple(rows), touched=frozenset([body]))


# URDF


@of_urdf
def speed_limit(file: UrdfText, random: np.random.Generator) -> Plant:
    """Make the speed limit of a joint larger by 50 %."""
    joints = [joint for joint in file.hinges() if 0.0 < file.number(joint, "speed") < math.inf]
    joint = chosen(random, joints)
    file.set_number(joint, "speed", 1.5 * file.number(joint, "speed"))
    return one(joint, Quantity.SPEED, 0.5)


def _mimic(file: UrdfText, random: np.random.Generator) -> tuple[str, ET.Element]:
    """Return the name of a joint that mimics another one, and its <mimic>."""
    joints = {
        name: each.findall("mimic") for name, each in file.joints.items() if each.get("type") != "fixed"
    }
    joint = chosen(random, (name for name, each in joints.items() if each))
    return joint, joints[joint][0]


@of_urdf
def mimic_factor(file: UrdfText, random: np.random.Generator) -> Plant:
    """Make the factor of a mimic joint larger by 0.1."""
    joint, mimic = _mimic(file, random)
    mimic.set("multiplier", text(float(mimic.get("multiplier", "1")) + 0.1))
    return Plant((Expected(joint, Quantity.COUPLING, 0.1),), touched=frozenset([joint]), has_truth=False)


@of_urdf
def mimic_dropped(file: UrdfText, random: np.random.Generator) -> Plant:
    """Remove the coupling of a mimic joint."""
    joint, mimic = _mimic(file, random)
    file.joints[joint].remove(mimic)
    return Plant((Expected(joint, Quantity.PRESENCE),), touched=frozenset([joint]), has_truth=False)


@of_urdf
def joint_fixed(file: UrdfText, random: np.random.Generator) -> Plant:
    """Fix a joint."""
    ends = {joint: body for joint, body in file.hinges().items() if file.has_inertial(body)}
    joint = chosen(random, ends)
    file.reverse_drives(joint)  # refuses couplings
    file.joints[joint].set("type", "fixed")
    return Plant(
        (Expected(joint, Quantity.PRESENCE),), touched=frozenset([joint, ends[joint]]), has_truth=False
    )


@of_urdf
def order_of_rpy(file: UrdfText, random: np.random.Generator) -> Plant:
    """Exchange roll and yaw of a joint's origin."""
    turned = {}
    for joint, body in file.hinges().items():
        origin = file.joints[joint].find("origin")
        angles = numbers(None if origin is None else origin.get("rpy"), "0 0 0")
        if origin is not None and abs(abs(angles[0]) - abs(angles[2])) > 0.01 and file.has_inertial(body):
            turned[joint] = (body, origin, angles)
    joint = chosen(random, turned)
    body, origin, angles = turned[joint]
    before = file.placement(body).rotation
    origin.set("rpy", text(*angles[::-1]))
    between = before.T @ file.placement(body).rotation
    axis = file.axis(joint) / np.linalg.norm(file.axis(joint))
    tilt = math.acos(np.clip(axis @ between @ axis, -1.0, 1.0))
    if tilt < 0.05 or tilt > 3.0:
        raise NotApplicable("the axis stays in its line")
    row = Expected(joint, Quantity.JOINT_AXIS, None, "turned at its parent")
    return Plant((row,), touched=frozenset([joint, body]))


# Text of any file

NUMBER = re.compile(r"-?\d*\.\d+(?:[eE][-+]?\d+)?")
"""Pattern of a number with decimals."""


def rounded(source: str, digits: int) -> str:
    """Return an XML text in which every number with decimals has that many significant digits."""
    return NUMBER.sub(lambda found: f"{float(found[0]):.{digits}g}", source)
