"""Read the loops, springs and rotors that tools add to a URDF in elements other than links and joints.

The results are in an `Extensions`: plain numbers, and the text of the URDF with a link (a frame without mass)
at each end of a loop and of a spring. The same loops can also be in a separate loop file, see `urdf.loops`.
The reader supports these documented elements:

- `<gazebo><joint>`, https://classic.gazebosim.org/tutorials?tut=kinematic_loop: its `<pose>` is in the frame
  of the child, its axis in the frame of the joint (SDF 1.7). The links have the poses for all joints at 0;
- `<gazebo reference="JOINT">` with `springStiffness` and `springReference`, or `<dynamics>`;
- `<loop_joint>` of Isaac Sim's importer;
- `drake:ball_constraint`, `drake:linear_spring_damper`, `drake:rotor_inertia` and `drake:gear_ratio`, see
  `parse_urdf.cc` and `detail_common.h` of Drake.

Other elements whose tags mean that they connect or push bodies raise an error with their line.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

from newton_euler.errors import choices
from newton_euler.model.source_file import MAX_MODEL_NUMBER, scan
from newton_euler.reading.import_report import FRICTION, ImportReport, unique_name
from newton_euler.scalars import Array
from urdf.extensions import Extensions, PointSpringElement
from urdf.loops import REVOLUTE, Loops
from urdf.reading.source import SourceError
from urdf.reading.vocabulary import ACTING_TAGS, DRAKE_PREFIX, report_unmoving, tag_of, unknown

CLOSURE_TYPE_OF_JOINT = {
    "revolute": REVOLUTE,
    "continuous": REVOLUTE,
    "ball": "3d",
    "spherical": "3d",
    "fixed": "6d",
}
"""Type of the loop closure in `urdf.loops`, by type of the joint in the file.

"3d": the origins of two frames coincide; "6d": the frames coincide; `REVOLUTE`: a hinge about the x axes of
both frames."""

ONSHAPE_LOOP_NAME = re.compile(r"closing_(.+)_([12])")
"""Pattern of the names of the two links that the tool onshape-to-robot writes at the ends of a loop."""


class End(NamedTuple):
    """One end of a loop or spring: a frame on a link.

    Attributes:
        link: name of the link.
        placement: `pinocchio.SE3` of the frame in the frame of the link.
    """

    link: str
    placement: Any


def read_extensions(
    path: str, text: str, root: ET.Element, loops: Loops, ignored: Sequence[str], report: ImportReport
) -> Extensions:
    """Read all elements of a URDF other than links and joints.

    Args:
        path: path of the URDF.
        text: text of the URDF.
        root: root element of the checked URDF.
        loops: content of the loop file.
        ignored: tags or names of elements to leave out.
        report: report that receives entries of elements that are left out.

    Raises:
        SourceError: for an unknown element that may connect or push bodies, with its line. Also for an
            ignored element that the file does not have.
    """
    return _Reader(path, text, root, loops, ignored, report).extensions


class _Reader:
    """Reader of the additional elements of one URDF.

    Attributes:
        extensions: elements that were read.
    """

    def __init__(
        self,
        path: str,
        text: str,
        root: ET.Element,
        loops: Loops,
        ignored: Sequence[str],
        report: ImportReport,
    ) -> None:
        """Read all elements; for the arguments see `read_extensions`."""
        self._path, self._root, self._report = path, root, report
        # line of each element, for messages; `scan` calls the function for each element in the order of text
        lines: list[int] = []
        scan(path, text, "robot", lambda tag, attributes, line: lines.append(line), SourceError)
        self._lines = dict(zip(root.iter(), lines, strict=True))
        self._links = {str(link.get("name")) for link in root.findall("link")}
        self._joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
        self._taken_names = [*self._links, *self._joints]
        self._frames: list[tuple[str, End]] = []  # name of each new frame, and its link and placement
        # names to ignore, the names among them that occurred, and all names that could be ignored
        self._ignored, self._used = set(ignored), set[str]()
        self._candidates: list[str] = []
        self._text = text
        self.extensions = Extensions(text)
        self._read_all(loops)
        if missing := [name for name in ignored if name not in self._used]:
            known = list(dict.fromkeys(self._candidates))
            needed = choices(missing[0], known) if known else "no name, the file has no such elements"
            problem = f"ignore is {missing[0]!r:.100}; needed: a tag or a name of an element; {needed}"
            raise SourceError(path, problem)
        self.extensions.text = self._text_with_frames(text)

    def _read_all(self, loops: Loops) -> None:
        """Read all additional elements and attributes; `loops` is the content of the loop file."""
        for element in self._root:
            self._read_rotors(element)
        # elements beyond the URDF standard that are not known to move nothing
        for element, name_in_report in unknown(self._root):
            tag, parent = tag_of(element), self._top_parent(element)
            if self._is_ignored(element, parent, name_in_report):
                continue
            if not self._read(element, tag, parent):
                # the tag means a constraint or a force, such as "spring"
                if ACTING_TAGS.search(tag) or tag in ("joint", f"{DRAKE_PREFIX}joint"):
                    raise self._refused(element, "is unknown, and may close a loop or exert a force")
                self._report.not_understood(name_in_report, "unknown to the reader and not simulated")
        self._check_onshape(loops)
        for joint in self._joints.values():
            self._read_dynamics(joint)
        report_unmoving(self._root, self._report)

    def _top_parent(self, element: ET.Element) -> ET.Element:
        """Return the child of the root that contains an element; the root, if the element is such a child."""
        for child in self._root:
            if child is element:
                return self._root
            if any(part is element for part in child.iter()):
                return child
        return self._root

    def _is_ignored(self, element: ET.Element, parent: ET.Element, name_in_report: str) -> bool:
        """Return True, and report the element as left out, if the user ignores its tag or name."""
        tag_and_name = [tag_of(element), element.get("name")]
        self._candidates += [name for name in tag_and_name if name]
        # a user can also ignore all of <gazebo reference="NAME"> by the name
        matches = self._ignored & {name for name in (*tag_and_name, parent.get("reference")) if name}
        if matches:
            self._used |= matches
            self._report.left_out(name_in_report, "ignored by the option `ignore`")
        return bool(matches)

    def _refused(self, element: ET.Element, problem: str) -> SourceError:
        """Return the error for an element, with its line and what the user can do."""
        tag, name = tag_of(element), element.get("name")
        named = f"<{tag}>" + (f" {name!r:.100}" if name else "")
        exerts_force = re.search("spring|bushing|tendon", tag)
        remedy = "remove it" if exerts_force else "put its loop into a loop file (--set loops=FILE)"
        text = f"line {self._lines[element]}: {named} {problem}; {remedy}, or leave it out: "
        return SourceError(self._path, f"{text}--set ignore={name or tag}")

    def _read(self, element: ET.Element, tag: str, parent: ET.Element) -> bool:
        """Read an element beyond the URDF standard; return False for an unknown element.

        Args:
            element: the element.
            tag: its tag.
            parent: the child of the root that contains the element, or the root, see `_top_parent`.
        """
        match tag_of(parent), tag:
            case "gazebo", "joint":
                self._read_gazebo_joint(element)
            case "gazebo", "springStiffness" | "springReference" | "dynamics" if parent.get("reference"):
                self._read_gazebo_spring(element, str(parent.get("reference")), parent)
            case "gazebo" | "link", "gravity" | "turnGravityOff" | "kinematic" | "static":
                return self._is_ordinary(element, tag)
            case _, "loop_joint":
                self._read_loop_joint(element)
            case _, "drake:ball_constraint":
                ends = self._drake_ends(element, tag)
                self._add_loop(element, element.get("name") or "ball_constraint", "3d", *ends)
            case _, "drake:linear_spring_damper":
                self._read_spring(element)
            case "joint", "drake:rotor_inertia" | "drake:gear_ratio":
                pass  # `_read_rotors` has read these
            case "joint", "joint_properties":
                return self._is_zero(element, parent)
            case _:
                return False
        return True

    @staticmethod
    def _is_ordinary(element: ET.Element, tag: str) -> bool:
        """Return True if an element leaves a body movable and subject to gravity, as bodies of scenes are.

        `tag` is "gravity", "turnGravityOff", "kinematic" or "static"; the text of the element is true or
        false.
        """
        text = (element.text or "").strip().lower()
        return text in (("true", "1") if tag == "gravity" else ("false", "0"))

    def _is_zero(self, element: ET.Element, joint: ET.Element) -> bool:
        """Report an element whose only attributes are friction and damping of 0; return False for others."""
        if not element.attrib or not element.attrib.keys() <= {"friction", "damping"}:
            return False
        numbers = [self._number(element, value, name) for name, value in element.attrib.items()]
        if any(numbers):
            return False
        what = f"<{tag_of(element)}> of joint {joint.get('name')!r:.100}"
        self._report.left_out(what, f"its {' and '.join(element.attrib)} is 0", moves_nothing=True)
        return True

    # Numbers

    def _numbers(self, element: ET.Element, text: str | None, count: int, what: str) -> Array:
        """Return the numbers (count,) in a text, or raise `SourceError`.

        Args:
            element: element of the text, for the message.
            text: numbers, separated by spaces.
            count: needed number of numbers.
            what: name of the attribute or child with the text, for the message.
        """
        try:
            values = [float(x) for x in (text or "").split()]
        except ValueError:
            values = []
        if len(values) != count or not all(abs(x) <= MAX_MODEL_NUMBER for x in values):
            needed = "a finite number" if count == 1 else f"{count} finite numbers"
            tag, line = tag_of(element), self._lines[element]
            raise SourceError(self._path, f"line {line}: <{tag}>: {what} is {text!r:.100}; needed: {needed}")
        return np.array(values)

    def _number(self, element: ET.Element, text: str | None, what: str) -> float:
        """Return the number in a text; for the arguments see `_numbers`."""
        return float(self._numbers(element, text, 1, what)[0])

    def _pose(self, element: ET.Element, xyz: str | None, rpy: str | None) -> Any:
        """Return the `pinocchio.SE3` of the attributes xyz, m, and rpy, rad, of an element."""
        rotation = pin.rpy.rpyToMatrix(*self._numbers(element, rpy or "0 0 0", 3, "rpy"))
        return pin.SE3(rotation, self._numbers(element, xyz or "0 0 0", 3, "xyz"))

    def _end(self, element: ET.Element, link: str | None, placement: Any) -> End:
        """Return an end with a placement in the frame of a link; raises `SourceError` for an unknown link."""
        name = (link or "").strip()
        if name not in self._links:
            line = self._lines[element]
            known = choices(name, sorted(self._links))
            raise SourceError(
                self._path, f"line {line}: <{tag_of(element)}>: no link {name!r:.100}; {known:.300}"
            )
        return End(name, placement)

    # Loops

    def _world_placement(self, end: End) -> Any:
        """Return the `pinocchio.SE3` of an end in the world, for all joints at 0."""
        model = pin.buildModelFromXML(self._text)
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        return data.oMf[model.getFrameId(end.link, pin.FrameType.BODY)] * end.placement

    def _coinciding(self, end: End, other: str) -> End:
        """Return an end on the link `other`, whose frame coincides with that of `end` for all joints at 0."""
        other_link = self._world_placement(End(other, pin.SE3.Identity()))
        return End(other, other_link.actInv(self._world_placement(end)))

    def _read_gazebo_joint(self, element: ET.Element) -> None:
        """Read a loop that a `<joint>` in `<gazebo>` closes, see the start of this module."""
        kind = self._closure_type(element)
        # the end on the child; `<pose>` (xyz, m, and roll, pitch, yaw, rad) may be relative to another link
        pose = element.find("pose")
        numbers, link = np.zeros(6), (element.findtext("child") or "").strip()
        frame = link
        if pose is not None:
            frame = pose.get("relative_to") or pose.get("frame") or link
            if frame not in self._links:
                raise self._refused(pose, f"is relative to {frame!r:.100}, which is not a link")
            numbers = self._numbers(pose, pose.text or "0 0 0 0 0 0", 6, "pose")
        placement = pin.SE3(pin.rpy.rpyToMatrix(*numbers[3:]), numbers[:3])
        child = self._end(element, link, placement)
        if frame != link:
            child = self._coinciding(End(frame, placement), link)
        # the axis of a hinge, in the frame of the joint or of the model
        if kind == REVOLUTE:
            xyz = element.find("axis/xyz")
            axis = np.array([0.0, 0.0, 1.0])
            if xyz is not None:
                axis = self._numbers(xyz, xyz.text, 3, "axis")
                in_model = (element.findtext("axis/use_parent_model_frame") or "").strip() in ("1", "true")
                if in_model or xyz.get("expressed_in") == "__model__":
                    axis = self._world_placement(child).rotation.T @ axis
                elif xyz.get("expressed_in"):
                    raise self._refused(xyz, f"is expressed in {xyz.get('expressed_in')!r:.100}")
            child = self._with_x_axis(element, child, axis)
        # the end on the parent; `_end` checks that the link exists
        parent_link = self._end(element, element.findtext("parent"), placement=None).link
        parent = self._coinciding(child, parent_link)
        self._add_loop(element, str(element.get("name") or "loop"), kind, parent, child)
        self._report_unused_properties(element)

    def _report_unused_properties(self, element: ET.Element) -> None:
        """Report damping, friction, stiffness and limits of a joint in `<gazebo>` as left out.

        The topic of an entry in the report is the property.
        """
        name = f"joint {element.get('name')!r} of gazebo"
        for part in ("damping", "friction", "spring_stiffness"):
            text = element.findtext(f"axis/dynamics/{part}")
            if text is not None and self._number(element, text, part):
                self._report.left_out(name, f"its {part} {text.strip()}", topic=part)
        if element.find("axis/limit") is not None:
            self._report.left_out(name, "its limits: limits are one-sided and not simulated", topic="limits")

    def _with_x_axis(self, element: ET.Element, end: End, axis: Array) -> End:
        """Return the end with its frame rotated: the new x axis is along `axis` (3,) of the old frame."""
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise SourceError(
                self._path, f"line {self._lines[element]}: its axis is 0 0 0; needed: a direction"
            )
        x_to_axis = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), axis / length)
        return End(end.link, end.placement * pin.SE3(x_to_axis.toRotationMatrix(), np.zeros(3)))

    def _closure_type(self, element: ET.Element) -> str:
        """Return the type of the loop closure of a joint; raises `SourceError` for other types of joints."""
        kind = element.get("type")
        if kind not in CLOSURE_TYPE_OF_JOINT:
            needed = choices(kind, CLOSURE_TYPE_OF_JOINT)
            raise self._refused(element, f"has the type {kind!r:.100}, which cannot close a loop ({needed})")
        return CLOSURE_TYPE_OF_JOINT[kind]

    def _read_loop_joint(self, element: ET.Element) -> None:
        """Read a loop that a `<loop_joint>` of Isaac Sim closes.

        The element has two links with placements, as `<link1>` and `<link2>` or as `<parent>` and `<child>`.
        """
        kind = self._closure_type(element)
        parts = [part for part in element if tag_of(part) in ("link1", "link2")]
        if len(parts) == 2:
            one, two = (self._end(p, p.get("link"), self._pose(p, p.get("xyz"), p.get("rpy"))) for p in parts)
        else:
            one, two = (self._origin_end(element, side) for side in ("parent", "child"))
        if kind == REVOLUTE:
            axis = element.find("axis")
            if axis is None:
                raise self._refused(element, "is revolute and has no axis")
            # the axis is in the frame of the joint, or of its parent
            if axis.get("frame") == "parent":
                one = End(one.link, pin.SE3(np.eye(3), one.placement.translation))
            one = self._with_x_axis(element, one, self._numbers(axis, axis.get("xyz"), 3, "xyz"))
            # the second end keeps its point; its frame is parallel to the first end's for all joints at 0
            rotation = self._coinciding(one, two.link).placement.rotation
            two = End(two.link, pin.SE3(rotation, two.placement.translation))
        self._add_loop(element, str(element.get("name") or "loop_joint"), kind, one, two)

    def _origin_end(self, element: ET.Element, side: str) -> End:
        """Return the end of a `<loop_joint>` on its "parent" or "child"."""
        link, origin = element.find(side), element.find(f"{side}_origin")
        if link is None or origin is None:
            raise self._refused(element, f"has no <{side}> with a <{side}_origin>, nor two <link1>")
        return self._end(link, link.get("link"), self._pose(origin, origin.get("xyz"), origin.get("rpy")))

    def _add_loop(self, element: ET.Element, name: str, kind: str, first: End, second: End) -> None:
        """Add a loop closure with a name and a type of `urdf.loops` between two ends."""
        if first.link == second.link:
            raise self._refused(element, f"joins link {first.link!r:.100} to itself")
        pair = self._add_frames(name, first, second)
        self.extensions.closed_loop.append(pair)
        self.extensions.closure_types.append(kind)

    def _add_frames(self, name: str, *ends: End) -> tuple[str, str]:
        """Add a frame for each of two ends, named "<name>_on_<link>", and return the names of both.

        The name of the loop or spring gets a number if it is taken.
        """
        taken = {frame.rpartition("_on_")[0] for frame, _ in self._frames}
        name, names = unique_name(name, "loop", taken), []
        for end in ends:
            frame = unique_name(f"{name}_on_{end.link}", "frame", self._taken_names)
            self._taken_names.append(frame)
            self._frames.append((frame, end))
            names.append(frame)
        return names[0], names[1]

    def _check_onshape(self, loops: Loops) -> None:
        """Raise `SourceError` for a loop that onshape-to-robot has marked by two links and nothing closes.

        `loops` is the content of the loop file, which may close the loop.
        """
        closed = {frame for pair in loops.closed_loop for frame in pair}
        pairs: dict[str, set[str]] = {}
        for link in self._root.findall("link"):
            if found := ONSHAPE_LOOP_NAME.fullmatch(str(link.get("name"))):
                pairs.setdefault(found[1], set()).add(found[2])
        for name, numbers in pairs.items():
            frames = [f"closing_{name}_{k}" for k in (1, 2)]
            self._candidates.append(f"closing_{name}")
            # not a pair, or closed by the loop file
            if len(numbers) < 2 or closed & set(frames):
                continue
            if f"closing_{name}" in self._ignored:
                self._used.add(f"closing_{name}")
                self._report.left_out(f"loop 'closing_{name}'", "ignored by the option `ignore`")
                continue
            # content of a loop file; `name_mot` lists joints with a motor
            text = f"closed_loop: [[{', '.join(frames)}]], type: [3d], name_mot: []"
            problem = f"links {' and '.join(frames)}: onshape-to-robot's ends of a loop that nothing closes"
            remedy = f"write a loop file with {text} (--set loops=FILE), or --set ignore=closing_{name}"
            raise SourceError(self._path, f"{problem}; {remedy}")

    # Springs and rotors

    def _drake_ends(self, element: ET.Element, tag: str) -> tuple[End, End]:
        """Return both ends of an element of Drake: point P on body A and point Q on body B."""
        ends = []
        for body, point in (("body_A", "p_AP"), ("body_B", "p_BQ")):
            link, position = self._drake_child(element, tag, body), self._drake_child(element, tag, point)
            placement = pin.SE3(np.eye(3), self._numbers(position, position.get("value"), 3, point))
            ends.append(self._end(link, link.get("name"), placement))
        return ends[0], ends[1]

    def _drake_child(self, element: ET.Element, tag: str, part: str) -> ET.Element:
        """Return the child "<tag>_<part>" of an element of Drake; raises `SourceError` without one."""
        child_tag = f"{tag}_{part}"
        for child in element:
            if tag_of(child) == child_tag:
                return child
        raise self._refused(element, f"has no <{child_tag}>")

    def _read_spring(self, element: ET.Element) -> None:
        """Read a `drake:linear_spring_damper`: a spring and damper between two points."""
        tag = tag_of(element)
        ends = self._drake_ends(element, tag)
        numbers = []
        for part in ("stiffness", "free_length", "damping"):
            child = self._drake_child(element, tag, part)
            numbers.append(self._number(child, child.get("value"), part))
            if numbers[-1] < 0.0:
                raise self._refused(element, f"has a negative {part}")
        if ends[0].link == ends[1].link:
            raise self._refused(element, f"joins link {ends[0].link!r:.100} to itself")
        frames = self._add_frames(element.get("name") or "spring", *ends)
        name = frames[0].rpartition("_on_")[0]
        self.extensions.point_springs.append(PointSpringElement(name, frames, *numbers))

    def _read_gazebo_spring(self, element: ET.Element, joint: str, parent: ET.Element) -> None:
        """Read a stiffness, a rest, or `<dynamics>` of a joint from the `<gazebo>` element `parent`."""
        if joint not in self._joints:
            line = self._lines[parent]
            raise SourceError(
                self._path, f"line {line}: <gazebo> refers to {joint!r:.100}, which is not a joint"
            )
        tag = tag_of(element)
        if tag == "dynamics":
            names = ("damping", "spring_stiffness", "spring_reference", "friction")
            values = {name: element.get(name) or element.findtext(name) for name in names}
            numbers = {n: self._number(element, text, n) for n, text in values.items() if text is not None}
            self._set_spring(joint, numbers.get("spring_stiffness"), numbers.get("spring_reference"))
            if damping := numbers.get("damping"):
                self.extensions.dampings[joint] = self.extensions.dampings.get(joint, 0.0) + damping
            if friction := numbers.get("friction"):
                why = f"its dry friction {friction:g}"
                self._report.left_out(f"joint {joint!r}", why, topic=FRICTION)
            return
        value = self._number(element, element.text, tag)
        if tag == "springStiffness":
            self._set_spring(joint, stiffness=value, rest=None)
        else:
            self._set_spring(joint, stiffness=None, rest=value)

    def _set_spring(self, joint: str, stiffness: float | None, rest: float | None) -> None:
        """Set stiffness (N m/rad or N/m) or rest (rad or m) of a joint's spring; None keeps the value."""
        old_stiffness, old_rest = self.extensions.springs.get(joint, (0.0, 0.0))
        if stiffness is not None and stiffness < 0.0:
            raise SourceError(
                self._path, f"joint {joint!r:.100}: a stiffness of {stiffness:g}; needed: none below 0"
            )
        spring = (old_stiffness if stiffness is None else stiffness, old_rest if rest is None else rest)
        if spring != (0.0, 0.0):
            self.extensions.springs[joint] = spring

    def _read_dynamics(self, joint: ET.Element) -> None:
        """Read attributes of a joint's `<dynamics>` beyond the URDF standard: spring and armature."""
        for dynamics in joint.findall("dynamics"):
            name = str(joint.get("name"))
            values = {
                key: self._number(dynamics, dynamics.get(key), key)
                for key in ("spring_stiffness", "spring_reference", "armature")
                if key in dynamics.attrib
            }
            self._set_spring(name, values.get("spring_stiffness"), values.get("spring_reference"))
            if values.get("armature"):
                self.extensions.armatures[name] = (
                    self.extensions.armatures.get(name, 0.0) + values["armature"]
                )

    def _read_rotors(self, element: ET.Element) -> None:
        """Read the rotors of Drake's actuators: armature = gear ratio^2 times the rotor's inertia.

        The numbers are in a `<joint>`, or in the actuators of a `<transmission>`; other elements have none.
        """
        if element.tag == "joint":
            holders = [(str(element.get("name")), element)]
        elif element.tag == "transmission":
            joint = element.find("joint")
            name = "" if joint is None else str(joint.get("name") or "")
            holders = [(name, actuator) for actuator in element.findall("actuator")]
        else:
            return
        for joint_name, holder in holders:
            values = {"drake:rotor_inertia": 0.0, "drake:gear_ratio": 1.0}
            for part in holder:
                if tag_of(part) in values:
                    values[tag_of(part)] = self._number(part, part.get("value"), tag_of(part))
            inertia = values["drake:rotor_inertia"] * values["drake:gear_ratio"] ** 2
            if not inertia:
                continue
            if joint_name not in self._joints or inertia < 0.0 or not math.isfinite(inertia):
                line = self._lines[holder]
                raise SourceError(
                    self._path, f"line {line}: a rotor of {inertia:g} kg m^2 on joint {joint_name!r:.100}"
                )
            self.extensions.armatures[joint_name] = self.extensions.armatures.get(joint_name, 0.0) + inertia

    def _text_with_frames(self, text: str) -> str:
        """Return the text of a URDF with a link and a fixed joint for each new frame."""
        if not self._frames:
            return text
        return text.rpartition("</robot")[0] + "".join(self._frame_elements()) + "</robot>"

    def _frame_elements(self) -> Iterator[str]:
        """Yield the XML text of the link and the fixed joint of each new frame."""
        for frame, (link, placement) in self._frames:
            xyz = " ".join(repr(float(x)) for x in placement.translation)
            rpy = " ".join(repr(float(x)) for x in pin.rpy.matrixToRpy(placement.rotation))
            yield f'<link name={quoteattr(frame)}/><joint name={quoteattr(frame + "_frame")} type="fixed">'
            yield f"<parent link={quoteattr(link)}/><child link={quoteattr(frame)}/>"
            yield f'<origin xyz="{xyz}" rpy="{rpy}"/>'
            yield "</joint>"
