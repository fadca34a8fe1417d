"""Read a URDF with its loop file, or a Pinocchio model, as a scene with an import report.

Pinocchio parses the URDF and merges links that fixed joints connect. The scene starts at coordinates 0, with
followers of mimics at their offsets, or at the nearest configuration with closed loops. The scene is verified
against Pinocchio's model of the file, see `newton_euler.reading` and `urdf.reference`. Models in memory with
their constraints are read in the same way.

For the loop file see `urdf.loops`.
"""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Unpack

import numpy as np

from newton_euler.arguments import UNCHECKED, checked
from newton_euler.errors import NewtonEulerError, OptionError, check_choice, finite_array
from newton_euler.model.forces import Force
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import ReadOptions, Request, path_text, read_text
from newton_euler.model.spanning_tree import unweld_loops
from newton_euler.reading import plausibility
from newton_euler.reading.activity import Bounds, Rest, Watch
from newton_euler.reading.excitation import with_start_velocities
from newton_euler.reading.import_report import (
    CONTACTS,
    FRICTION,
    LIMITS,
    VELOCITY_LIMITS,
    Finding,
    ImportReport,
    unique_name,
)
from newton_euler.reading.reference import ReferenceModel
from newton_euler.reading.verify import verify_report
from newton_euler.scalars import Array
from urdf.errors import UrdfError
from urdf.extensions import Extensions, PointSpringElement
from urdf.loops import NO_LOOPS, Loops
from urdf.model import BASES, BaseName, ClosedLoopModel, build
from urdf.reading.bodies import Tree
from urdf.reading.extensions import read_extensions
from urdf.reading.forces import armatures, joint_springs, point_springs
from urdf.reading.given import Given, PinocchioModel
from urdf.reading.loops import closing_joints, couplings
from urdf.reading.parser_messages import collected_messages, report_complaints
from urdf.reading.source import (
    JointProperties,
    SourceError,
    check_inertias,
    joint_properties,
    parsed,
    read_loops,
)
from urdf.reading.start import Mimic, RobotAtStart
from urdf.reading.visuals import with_visuals
from urdf.reference import ModelReference, UrdfReference

DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
"""Default gravity, m/s^2; a URDF has no gravity."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Scene imported from a URDF or a Pinocchio model, with the fate of every element."""

    scene: Scene
    report: ImportReport


@dataclass(frozen=True, eq=False)
class Robot:
    """Robot from files or from memory, before its loops are closed.

    Attributes:
        where: file or model, for messages.
        name: name of the scene.
        description: description of the scene.
        closed: Pinocchio's model and its closures.
        loops: content of the loop file, or its equivalent.
        mimics: mimics of the URDF.
        joints: springs, limits and other properties of joints.
        root: root element of the URDF; None for a model in memory.
        first: configuration to start near to, with its name in reports.
        springs: springs between points of two links.
    """

    where: str
    name: str
    description: str
    closed: ClosedLoopModel
    loops: Loops
    mimics: list[Mimic]
    joints: list[JointProperties]
    root: ET.Element | None = None
    first: tuple[Array, str] | None = None
    springs: tuple[PointSpringElement, ...] = ()


@checked
def read(
    model: Annotated[str | os.PathLike[str] | PinocchioModel, UNCHECKED],
    loops: str | os.PathLike[str] | None = None,
    base: BaseName = "fixed",
    gravity: Sequence[float] | None = None,
    q: Sequence[float] | Array | None = None,
    ignore: str | Sequence[str] | None = None,
    **options: Unpack[ReadOptions],
) -> Reading:
    """Read a URDF, or a model that Pinocchio has in memory.

    Args:
        model: path of the URDF, a `pinocchio.Model`, or a pair of a model and its constraints. Constraints
            are `RigidConstraintModel`s, or anchors of points and frames. A constraint to the world with the
            default second placement holds its frame at the start.
        loops: path of the loop file of a URDF; None for no loop file.
        base: "fixed" if the root link of a URDF is the ground, "free" if it floats.
        gravity: (3,) m/s^2; None for (0, 0, -9.81), or for the gravity of a model in memory.
        q: (nq,) Pinocchio's configuration from which a model in memory starts; None for neutral.
        ignore: tags or names of elements of a URDF other than links and joints, such as "loop_joint", that
            are left out instead of simulated or refused; None for no elements.
        options: see `newton_euler.model.source_file.Request`. The file is verified without excitation.

    Raises:
        UrdfError: for a model that cannot be read or verified, with file or model name and element.
        UnknownNameError: for an unknown base.
        OptionError: for an option that the kind of model does not have.

    Examples:
        >>> urdf.write(load("four_bar"), "output/four_bar.urdf")
        >>> found = urdf.read("output/four_bar.urdf", "output/four_bar.loops.yaml")
        >>> len(found.scene.mechanism.bodies)
        6
    """
    # options of both kinds of models, then those of one kind
    check_choice("base", base, BASES)
    request = Request.of(options)
    if gravity is not None:
        gravity = finite_array("urdf.read", "gravity", gravity, (3,)).tolist()
    if isinstance(model, str | os.PathLike):
        if q is not None:
            raise OptionError("q", q, "no q for a URDF, which starts from coordinates 0")
        pull = DEFAULT_GRAVITY if gravity is None else gravity
        ignored = (ignore,) if isinstance(ignore, str) else () if ignore is None else tuple(ignore)
        return _from_file(model, loops, base, pull, request, ignored)
    for option, value, default in (("loops", loops, None), ("base", base, "fixed"), ("ignore", ignore, None)):
        if value is not default and not (isinstance(value, str) and value == default):
            raise OptionError(option, value, f"no {option} for a model in memory, an option of URDF files")
    return _from_memory(model, gravity, q, request)


def _from_file(
    path: str | os.PathLike[str],
    loops: str | os.PathLike[str] | None,
    base: BaseName,
    gravity: Sequence[float],
    request: Request,
    ignore: Sequence[str],
) -> Reading:
    where = path_text(path, SourceError)
    text = read_text(where, "file_size", SourceError)
    root = parsed(where, text)
    if text.startswith("<?xml"):  # Pinocchio would decode the text by the encoding in the declaration
        text = text[text.index("?>") + 2 :]
    closing, loop_text = NO_LOOPS, None
    report = ImportReport()
    if loops is None:
        report.findings.extend(_unread_loops(Path(where)))
    else:
        loop_path = path_text(loops, SourceError)
        loop_text = read_text(loop_path, "scene_size", SourceError)
        closing = read_loops(loop_path, loop_text)
    # parse, import and verify, with the messages of Pinocchio's parser
    words: list[str] = []
    try:
        with collected_messages(words):
            extensions = read_extensions(where, text, root, closing, ignore, report)
            text = extensions.text
            closing = extensions.added_to(closing)
            closed = build(text, closing, base=base)
        if closed.model.nv == 0:
            raise SourceError(where, "no joint can move")
        moving = [j for j in root.findall("joint") if j.get("type") != "fixed"]
        mimics = [Mimic(j, m) for j in moving for m in j.findall("mimic")]
        name, joints = root.get("name", "") or Path(where).stem, _with_extensions(root, extensions)
        springs = tuple(extensions.point_springs)
        robot = Robot(where, name, Path(where).name, closed, closing, mimics, joints, root, springs=springs)
        found = _reading(
            robot, report, request, gravity, partial(UrdfReference, extensions, loop_text, base, gravity)
        )
    except RuntimeError as error:  # assertions of Pinocchio, for example of inertias
        check_inertias(where, root)
        raise SourceError(where, f"Pinocchio refuses it: {' '.join(str(error).split())}") from error
    except UrdfError as error:
        if str(error).startswith(where) or (closing.source and str(error).startswith(closing.source)):
            raise
        errors = [line.removeprefix("Error:").strip() for line in words if line.startswith("Error:")]
        raise SourceError(where, "; ".join([str(error), *errors])) from error
    except (NewtonEulerError, np.linalg.LinAlgError) as error:
        check_inertias(where, root)
        raise SourceError(where, str(error)) from error
    report_complaints(words, report)
    root_link = "is the ground" if base == "fixed" else "floats"
    pull = " ".join(f"{g:g}" for g in gravity)
    found.report.start.append(f"gravity is {pull} m/s^2, a URDF has none; its root link {root_link}")
    return found


def _unread_loops(path: Path) -> Iterator[Finding]:
    """Find a loop file next to a URDF that is read without its loop file."""
    for beside in (path.with_suffix(".loops.yaml"), path.with_suffix(".yaml")):
        with suppress(SourceError):
            if beside.is_file() and "closed_loop" in read_text(str(beside), "scene_size", SourceError):
                yield Finding(
                    "unread-loops",
                    beside.name,
                    "a loop file is next to the URDF and was not read",
                    "its loops are open in this run",
                    f"--set loops={beside} closes them",
                )


def _from_memory(
    model: object, gravity: Sequence[float] | None, q: Sequence[float] | Array | None, request: Request
) -> Reading:
    given = Given(model, q)
    robot = Robot(
        given.where,
        given.name,
        given.where,
        given.closed,
        given.loops,
        [],
        given.joints,
        first=(given.q, given.called),
    )
    pull = given.closed.model.gravity.linear if gravity is None else gravity
    try:
        return _reading(
            robot,
            ImportReport(),
            request,
            pull,
            partial(ModelReference, given.model, given.constraints, given.q, pull),
        )
    except SourceError:
        raise
    except (NewtonEulerError, RuntimeError, np.linalg.LinAlgError) as error:
        raise SourceError(given.where, " ".join(str(error).split())) from error


def _with_extensions(root: ET.Element, extensions: Extensions) -> list[JointProperties]:
    """Return the properties of joints, including springs, dampers and rotors of other elements."""
    found = []
    for joint in joint_properties(root):
        stiffness, rest = extensions.springs.get(joint.name, (0.0, 0.0))
        found.append(
            joint._replace(
                stiffness=stiffness,
                rest=rest,
                damping=joint.damping + extensions.dampings.get(joint.name, 0.0),
                armature=extensions.armatures.get(joint.name, 0.0),
            )
        )
    return found


def _reading(
    robot: Robot,
    report: ImportReport,
    request: Request,
    gravity: Sequence[float],
    reference: Callable[[ImportReport, Scene], ReferenceModel],
) -> Reading:
    tolerance = request.redundancy_tolerance
    start = RobotAtStart(robot.where, robot.closed, robot.loops, robot.mimics, report, tolerance, robot.first)
    tree = Tree(robot.where, start, set(robot.loops.name_mot), report)
    if robot.root is not None:
        tree.bodies = with_visuals(robot.where, robot.root, start, tree, report)
    scene = _scene(robot, start, tree, report, request, gravity)
    # numbers that overflow are refused later; messages of the parser were already collected
    with np.errstate(all="ignore"), collected_messages([]):
        report.references.append((reference(report, scene), scene))
    if request.verified:
        report.start.append(verify_report(report))
    report.findings.extend(plausibility.findings(scene.mechanism))
    if request.excitation:
        scene, fastest = with_start_velocities(scene, report.bounds)
        report.start.append(f"excited: {fastest}")
    return Reading(scene, report)


def _scene(
    robot: Robot,
    start: RobotAtStart,
    tree: Tree,
    report: ImportReport,
    request: Request,
    gravity: Sequence[float],
) -> Scene:
    for joint, kind in zip(start.loops.joint_name, start.loops.joint_type, strict=True):
        if kind == "FIXED":
            report.imported(f"joint {joint!r}", "held at 0 by the loop file")
    joints = [*tree.joints, *closing_joints(start, tree, report)]
    gears = list(couplings(start, tree, [joint.name for joint in joints], report))
    name = unique_name(robot.name, "robot", ())[:100].strip(".") or "robot"
    springs: tuple[Force, ...] = (
        *joint_springs(robot.joints, start, tree, report),
        *point_springs(robot.springs, start, tree, report),
    )
    rotors = tuple(armatures(robot.joints, tree, report))
    _report_joints(robot.joints, start, tree, report)
    if robot.root is not None:
        _report_leftovers(robot.root, report)
    return Scene(
        name,
        unweld_loops(Mechanism(tree.bodies, joints, gears)),
        request.duration,
        request.output_period,
        gravity=np.array(gravity),
        forces=springs,
        armatures=rotors,
        description=robot.description,
        redundancy_tolerance=request.redundancy_tolerance,
    )


def _limits(start: RobotAtStart, joint: JointProperties, key: Key) -> list[Watch]:
    """Make the watch of a joint's limits."""
    assert joint.limits is not None
    (low, high, _), at = joint.limits, start.displacement(joint.name)
    return [Bounds(((key, 1.0),), low - at, high - at, joint.unit)]


def _speed_limit(joint: JointProperties, key: Key) -> list[Watch]:
    """Make the watch of a joint's limit of velocity."""
    assert joint.limits is not None
    speed = joint.limits[2]
    return [Bounds(((key, 1.0),), -speed, speed, f"{joint.unit}/s", by_value=0.0, by_rate=1.0)]


def _report_joints(
    joints: list[JointProperties], start: RobotAtStart, tree: Tree, report: ImportReport
) -> None:
    """Report dry friction, limits, rotors and safety controllers, which are not simulated."""
    for joint in joints:
        element, key = f"joint {joint.name!r}", tree.coordinate_keys.get(joint.name)
        if joint.friction:
            why = f"its dry friction {joint.friction:g}"
            resting = [Rest((key,))] if key else []
            report.left_out(element, why, topic=FRICTION, watches=resting, numbers=[joint.friction])
        if joint.limits:
            low, high, speed = joint.limits
            why = f"its limits {low:.4g} to {high:.4g}: limits are one-sided and not simulated"
            watches = _limits(start, joint, key) if key else []
            report.left_out(element, why, topic=LIMITS, watches=watches, numbers=[low, high])
            if math.isfinite(speed):
                why = f"its limit of velocity, {speed:.4g} {joint.unit}/s"
                watches = _speed_limit(joint, key) if key else []
                report.left_out(element, why, topic=VELOCITY_LIMITS, watches=watches, numbers=[speed])
        if joint.rotor:
            why = f"its rotor, rotorInertia times rotorGearRatio^2 of {joint.rotor:g}"
            remedy = "Pinocchio's dynamics use model.armature only; add the inertia there"
            report.left_out(element, f"{why}: {remedy}", topic="rotor", numbers=[joint.rotor])
        if joint.has_safety:
            why = "its safety controller, a program outside of the model"
            report.left_out(element, why, topic="safety controller", examined=False)


def _report_leftovers(root: ET.Element, report: ImportReport) -> None:
    """Report the contacts of a URDF, which are not simulated."""
    if touching := root.findall("link/collision"):
        why = "contacts are not simulated; a URDF does not define which bodies may touch, an MJCF does"
        report.left_out(f"{len(touching)} collision elements", why, topic=CONTACTS, examined=False)
