"""Vocabulary of URDF files: which elements and attributes are read, which move nothing, which are unknown.

Many tools extend URDF, and parsers ignore elements that they do not know. `unknown` yields the elements that
are in no list of this module. Such an element may exert a force or a constraint: `urdf.reading.extensions`
reads it, refuses it, or reports it as not understood.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Literal, get_args

from newton_euler.model.source_file import SourceError as FileError
from newton_euler.reading.import_report import ImportReport

BaseName = Literal["fixed", "free"]
"""Motion of the root link, which a URDF does not state: fixed to the ground, or free."""

BASES: tuple[BaseName, ...] = get_args(BaseName)
"""All values of `BaseName`."""

DRAKE_PREFIX = "drake:"
"""Prefix of the elements that Drake adds to URDF."""

READ_ELEMENTS = {
    "robot": frozenset({"link", "joint"}),
    "link": frozenset({"inertial", "visual", "collision"}),
    "inertial": frozenset({"origin", "mass", "inertia"}),
    "joint": frozenset(
        {"origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "safety_controller"}
    ),
}
"""Tags of the elements that the reader imports, by tag of the parent element."""

REPEATED_ELEMENTS = frozenset({"visual", "collision"})
"""Elements that a link may have several times. Of other repeated elements, parsers read only the first."""

PASSIVE_ELEMENTS: dict[str, frozenset[str]] = {
    "robot": frozenset(
        [
            "material",
            "sensor",
            "fixed_frame",
            "ros2_control",
            "ros_control",
            "group",
            "group_state",
            "virtual_joint",
            "passive_joint",
            "end_effector",
            "chain",
            "disable_collisions",
            "disable_default_collisions",
            "enable_collisions",
            "link_sphere_approximation",
            "joint_property",
            "sim_property",
            "plugin",
            "version",
            "drake:proximity_properties",
            "drake:collision_filter_group",
            "drake:parsing_options",
        ]
    ),
    "link": frozenset(
        [
            "self_filter",
            "origin",
            "contact",
            "collision_checking",
            "self_collision_checking",
            "material",
            "sensor",
            "audio_source",
            "type",
            "color",
            "visual_constraint",
            "drake:visual",
            "drake:accepting_renderer",
            "drake:ignore",
        ]
    ),
    "inertial": frozenset[str](),
    "joint": frozenset(
        [
            "calibration",
            "hardwareInterface",
            "drake:acceleration",
            "drake:controller_gains",
            "description",
            "safety",
            "gearbox",
        ]
    ),
    "gazebo link": frozenset(
        [
            "material",
            "mu",
            "mu1",
            "mu2",
            "kp",
            "kd",
            "fdir1",
            "slip1",
            "slip2",
            "maxVel",
            "max_vel",
            "minDepth",
            "min_depth",
            "maxContacts",
            "max_contacts",
            "selfCollide",
            "self_collide",
            "sensor",
            "visual",
            "collision",
            "laserRetro",
            "laser_retro",
            "light",
            "enable_wind",
            "frame",
            "canonical_link",
        ]
    ),
    "gazebo joint": frozenset(
        [
            "stopErp",
            "stopCfm",
            "stopKp",
            "stopKd",
            "fudgeFactor",
            "provideFeedback",
            "provide_feedback",
            "physics",
            "sensor",
            "cfmDamping",
            "disableFixedJointLumping",
            "preserveFixedJoint",
            "implicitSpringDamper",
            "erp",
            "cfm",
        ]
    ),
    "gazebo": frozenset(
        [
            "canonicalBody",
            "gazebo_ros_power_monitor",
            "self_collide",
            "selfCollide",
            "allow_auto_disable",
            "enable_wind",
            "sensor",
            "light",
            "frame",
            "sdf",
            "material",
            "physics",
            "scene",
            "audio",
        ]
    ),
    "transmission": frozenset({"drake:gear_ratio", "drake:rotor_inertia"}),
    "mujoco": frozenset({"compiler", "size"}),
}
"""Tags of elements without forces and constraints, by tag of the parent element.

A `<gazebo>` element belongs to a link ("gazebo link"), to a joint ("gazebo joint"), or to the whole model
("gazebo")."""

KNOWN_ATTRIBUTES = {
    "origin": frozenset({"xyz", "rpy"}),
    "axis": frozenset({"xyz"}),
    "mass": frozenset({"value"}),
    "inertia": frozenset(["ixx", "ixy", "ixz", "iyy", "iyz", "izz", "iyx", "izx", "izy"]),
    "limit": frozenset(
        [
            "command_effort",
            "current",
            "gear_velocity",
            "lower",
            "upper",
            "effort",
            "velocity",
            "acceleration",
            "deceleration",
            "jerk",
        ]
    ),
    "dynamics": frozenset(["damping", "friction", "spring_stiffness", "spring_reference", "armature"]),
    "mimic": frozenset({"joint", "multiplier", "offset"}),
    "parent": frozenset({"link", "joint"}),
    "child": frozenset({"link", "joint"}),
}
"""Attributes without report, by tag, of the elements whose attributes can affect the motion.

The list includes attributes that the reader ignores, such as the jerk of a limit."""

PASSIVE_PLUGIN = re.compile(
    r"control|state_?publisher|camera|imu|laser|ray|lidar|gps|gnss|p3d|ft_?sensor|force_?torque|sensor|"
    r"bumper|contact|range|odometry|ground_truth|video|range|joint_state|pose",
    re.IGNORECASE,
)
"""Pattern of the file names of Gazebo's plugins that exert no force without a command."""

ACTING_IN_TRANSMISSION = re.compile(r"inertia|stiff|damp|friction|backlash|spring|elastic", re.IGNORECASE)
"""Pattern of the tags in a `<transmission>` that exert forces; other tags map commands to forces."""

ACTING_TAGS = re.compile(r"constraint|loop|closure|closing|weld|tendon|bushing|spring|coupl|equality", re.I)
"""Pattern of tags that suggest a constraint or a force; a file with an unknown element of such a tag is
refused."""


def tag_of(element: ET.Element) -> str:
    """Return the tag of an element: Drake's tags with their prefix, other tags without their prefix."""
    tag = str(element.tag)
    return tag if tag.startswith(DRAKE_PREFIX) else tag.rpartition(":")[2]


def check_expanded(path: str, error: type[FileError]) -> Callable[[str, dict[str, str], int], None]:
    """Return a callback for `newton_euler.model.source_file.scan` that refuses SDF files and xacro macros.

    Args:
        path: path of the file, for messages.
        error: class of the error to raise.
    """
    tags: list[str] = []  # of all elements so far

    def begin(tag: str, attributes: dict[str, str], line: int) -> None:
        """Check the beginning of an element."""
        tags.append(tag)
        if len(tags) == 1 and tag == "sdf":
            needed = (
                "needed: a URDF or an MJCF; `sdf2mjcf IN.sdf OUT.xml` of the package sdformat-mjcf makes one"
            )
            raise error(path, f"line {line}: an SDF file, which is not read; {needed}")
        if len(tags) == 1 and tag != "robot":
            raise error(path, f"line {line}: root element is <{tag:.100}>, not <robot>")
        macro = next((value for value in attributes.values() if "${" in value or "$(" in value), "")
        if tag.startswith("xacro:") or macro:
            what = f"<{tag:.100}>" + (f" with {macro!r:.100}" if macro else "")
            raise error(path, f"line {line}: {what} is of xacro; run xacro first: xacro {path} -o robot.urdf")

    return begin


def unknown(root: ET.Element) -> Iterator[tuple[ET.Element, str]]:
    """Yield the elements that no list of this module contains, with their names in reports.

    The search includes elements in `<gazebo>`, `<transmission>` and `<mujoco>`.
    """
    links = {link.get("name") for link in root.findall("link")}
    for element in root:
        tag, name = tag_of(element), element.get("name") or element.get("reference") or ""
        parent_name = f"{tag} {name!r:.100}"
        if tag in ("link", "joint"):
            yield from _inside(element, tag, parent_name)
            for inertial in element.findall("inertial"):
                yield from _inside(inertial, "inertial", parent_name)
        elif tag == "gazebo":
            reference = element.get("reference")
            key = "gazebo" if reference is None else f"gazebo {'link' if reference in links else 'joint'}"
            yield from _inside(element, key, parent_name if name else tag)
        elif tag in ("transmission", "mujoco"):
            for part in element.iter():
                part_tag = tag_of(part)
                acts = ACTING_IN_TRANSMISSION.search(part_tag) if tag == "transmission" else True
                if part is not element and acts and part_tag not in PASSIVE_ELEMENTS[tag]:
                    yield part, f"<{part_tag}> of {parent_name if name else tag}"
        elif tag not in PASSIVE_ELEMENTS["robot"]:
            yield element, f"<{tag}>{f' {name!r:.100}' if name else ''}"
    # repeated elements, and unknown attributes of elements that are read
    for element in (*root.findall("link"), *root.findall("joint")):
        yield from _repeated(element)
        for part in (*element, *element.findall("inertial/*")):
            known_attributes = KNOWN_ATTRIBUTES.get(part.tag, part.attrib)
            unknown_attributes = [name for name in part.attrib if name not in known_attributes]
            if unknown_attributes:
                parent_name = f"{element.tag} {element.get('name')!r:.100}"
                yield part, f"{', '.join(unknown_attributes)} of <{part.tag}> of {parent_name}"


def _repeated(element: ET.Element) -> Iterator[tuple[ET.Element, str]]:
    """Yield repeated elements of a link or joint; parsers read only the first of each tag."""
    parent_name = f"{element.tag} {element.get('name')!r:.100}"
    for parent in (element, *element.findall("inertial")):
        for tag in sorted(READ_ELEMENTS[parent.tag] - REPEATED_ELEMENTS):
            for part in parent.findall(tag)[1:]:
                yield part, f"another <{tag}> of {parent_name}"


def _inside(element: ET.Element, key: str, parent_name: str) -> Iterator[tuple[ET.Element, str]]:
    """Yield the unknown children of an element, with their names in reports.

    Args:
        element: parent element.
        key: key of `PASSIVE_ELEMENTS`.
        parent_name: name of the parent in reports.
    """
    known_tags = READ_ELEMENTS.get(key, frozenset()) | PASSIVE_ELEMENTS[key]
    if key.startswith("gazebo"):  # flags of joints on links, and of links on joints, do nothing
        known_tags |= PASSIVE_ELEMENTS["gazebo link"] | PASSIVE_ELEMENTS["gazebo joint"]
    for part in element:
        tag = tag_of(part)
        text = f"{part.get('filename', '')} {part.get('name', '')}" if tag == "plugin" else tag
        is_passive = key.startswith("gazebo") and PASSIVE_PLUGIN.search(text)
        if tag not in known_tags and not is_passive:
            file = f" {part.get('filename')!r:.100}" if part.get("filename") else ""
            yield part, f"<{tag}>{file} of {parent_name}"


def report_unmoving(root: ET.Element, report: ImportReport) -> None:
    """Report how many children of the root move nothing, for each tag except those of links and joints."""
    counts = Counter(tag_of(element) for element in root)
    for tag, count in counts.items():
        if tag not in ("link", "joint", "material"):
            report.left_out(f"{count} <{tag}>", "its known parts move nothing", moves_nothing=True)
