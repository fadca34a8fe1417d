"""Import a URDF with its loop file, or a Pinocchio model in memory, as a scene with an import report.

A scene is a mechanism with its forces, control laws and initial state. A URDF cannot describe closed loops;
the loop file does (`urdf.loops`). Pinocchio parses the URDF and merges links that fixed joints connect. The
scene starts at coordinates 0, with joints that follow others (mimics) at their offsets, or at the nearest
configuration with closed loops. The import report lists for each element of the file what it became in the
scene. The scene is then verified: its masses, motions and forces are compared with those of Pinocchio's
model, see `newton_euler.reading` and `urdf.reference`.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
import pinocchio as pin

from newton_euler.arguments import UNCHECKED, checked
from newton_euler.errors import NewtonEulerError, OptionError, check_choice, finite_array
from newton_euler.model.euler_parameters import conjugate, product, rotation
from newton_euler.model.forces import Force
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import ReadOptions, Request, path_text, read_text, read_xml
from newton_euler.model.spanning_tree import unweld_loops
from newton_euler.reading import plausibility
from newton_euler.reading.excitation import with_start_velocities
from newton_euler.reading.file_names import FileCoordinate, FileFrame, FileNames
from newton_euler.reading.import_report import EXCITED, Finding, ImportReport, Mistake, unique_name
from newton_euler.reading.verify import verify_report
from newton_euler.scalars import Array
from urdf.errors import UrdfError
from urdf.extensions import Extensions, PointSpringElement
from urdf.file_run import PinocchioFile, unsupported
from urdf.loops import NO_LOOPS, Loops, loop_files_beside
from urdf.model import ClosedLoopModel, build
from urdf.pinocchio_reference import PinocchioReference
from urdf.reading.bodies import W_X_Y_Z, Tree
from urdf.reading.extensions import read_extensions
from urdf.reading.forces import armatures, joint_springs, point_springs
from urdf.reading.friction_and_limits import friction_and_limits
from urdf.reading.given import Given, UrdfInMemory
from urdf.reading.leftovers import report_collisions, report_joints
from urdf.reading.loops import closing_joints, couplings
from urdf.reading.parser_messages import collected_messages, report_complaints
from urdf.reading.planes import turned_planes
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
from urdf.reading.vocabulary import BASES, BaseName
from urdf.reference import ModelReference, UrdfReference
from urdf.run_settings import EXAMPLE_CLOSED, EXAMPLE_OPEN, OwnRun, read_settings

DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
"""Default gravity, m/s^2; a URDF has no gravity."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Result of importing a URDF or a Pinocchio model.

    Attributes:
        scene: imported scene.
        report: import report: for each element, what the element became or why it is left out, see
            `ImportReport`.
    """

    scene: Scene
    report: ImportReport


@dataclass(frozen=True, eq=False)
class Robot:
    """Robot from files or from memory, before its loops are closed.

    Attributes:
        source_name: file or model, for messages.
        name: name of the scene.
        description: description of the scene.
        closed_model: Pinocchio's model with its loop closures.
        loops: content of the loop file, or its equivalent for a model in memory.
        mimics: mimics of the URDF.
        joints: springs, limits and other properties of joints.
        root: root element of the URDF; None for a model in memory.
        first: configuration near which to start, with its name in reports; None for coordinates 0.
        springs: springs between points of two links.
        own_run: settings that the user has given for the user's own simulation program (time step, gains,
            ...), by name, see `urdf.run_settings.PinocchioSettings`.
        gains: Baumgarte's gains kp, 1/s^2, and kd, 1/s, of each constraint in memory; None for a file.
    """

    source_name: str
    name: str
    description: str
    closed_model: ClosedLoopModel
    loops: Loops
    mimics: list[Mimic]
    joints: list[JointProperties]
    root: ET.Element | None = None
    first: tuple[Array, str] | None = None
    springs: tuple[PointSpringElement, ...] = ()
    own_run: dict[str, Any] = field(default_factory=dict)
    gains: Sequence[tuple[float, float]] | None = None


@checked
def read(
    model: Annotated[str | os.PathLike[str] | UrdfInMemory, UNCHECKED],
    loops: str | os.PathLike[str] | None = None,
    base: BaseName = "fixed",
    gravity: Sequence[float] | None = None,
    q: Sequence[float] | Array | None = None,
    ignore: str | Sequence[str] | None = None,
    own_run: Annotated[OwnRun | None, UNCHECKED] = None,
    **options: Unpack[ReadOptions],
) -> Reading:
    """Import a URDF, or a model that Pinocchio has in memory, as a scene.

    Args:
        model: path of the URDF, a `pinocchio.Model`, or a pair of a model and its constraints. Constraints
            are of the class `RigidConstraintModel`, `PointAnchorConstraintModel` or
            `FrameAnchorConstraintModel`. A constraint to the world with the default second placement holds
            its frame where the frame is at the start.
        loops: path of the loop file of a URDF; None for no loop file.
        base: "fixed" if the root link of a URDF is the ground, "free" if it floats.
        gravity: (3,) m/s^2; None for (0, 0, -9.81), or for the gravity of a model in memory.
        q: (nq,) Pinocchio's configuration from which a model in memory starts; None for neutral.
        ignore: tags or names of elements of a URDF other than links and joints, such as "loop_joint". These
            elements are left out instead of simulated or refused. None for no elements.
        own_run: settings of the loop in which you simulate the model: path of a YAML file, YAML text in
            braces, or a mapping, see `urdf.run_settings`. None for the settings of Pinocchio's examples, and
            the Baumgarte gains of a model's constraints.
        options: `duration`, `output_period`, `excitation`, `friction`, `limits` and other options of the
            scene, see `ReadOptions`. The scene is verified without excitation.

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
    run_settings = read_settings(own_run)
    if gravity is not None:
        gravity = finite_array("urdf.read", "gravity", gravity, (3,)).tolist()
    if isinstance(model, str | os.PathLike):
        if q is not None:
            raise OptionError("q", q, "no q for a URDF, which starts from coordinates 0")
        ignored = (ignore,) if isinstance(ignore, str) else () if ignore is None else tuple(ignore)
        gravity_of_file = DEFAULT_GRAVITY if gravity is None else gravity
        return _import_file(model, loops, base, gravity_of_file, request, ignored, run_settings)
    for option, value, default in (("loops", loops, None), ("base", base, "fixed"), ("ignore", ignore, None)):
        if value is not default and not (isinstance(value, str) and value == default):
            raise OptionError(option, value, f"no {option} for a model in memory, an option of URDF files")
    return _import_from_memory(model, gravity, q, request, run_settings)


def _import_file(
    path: str | os.PathLike[str],
    loops: str | os.PathLike[str] | None,
    base: BaseName,
    gravity: Sequence[float],
    request: Request,
    ignore: Sequence[str],
    own_run: dict[str, Any],
) -> Reading:
    """Import a URDF file; for the arguments see `read`."""
    source_name = path_text(path, SourceError)
    text = read_xml(source_name, SourceError)
    root = parsed(source_name, text)
    if text.startswith("<?xml"):  # Pinocchio would decode the text by the encoding in the declaration
        text = text[text.index("?>") + 2 :]
    # content of the loop file
    loop_content, loop_text = NO_LOOPS, None
    report = ImportReport()
    if loops is None:
        report.findings.extend(_unread_loops(Path(source_name)))
    else:
        loop_path = path_text(loops, SourceError)
        loop_text = read_text(loop_path, limit="scene_size", error=SourceError)
        loop_content = read_loops(loop_path, loop_text)
    # parse, import and verify, and collect the messages that Pinocchio's parser would print
    parser_messages: list[str] = []
    try:
        with collected_messages(parser_messages):
            # loops and springs that tools add to a URDF get frames in the text
            extensions = read_extensions(source_name, text, root, loop_content, ignore, report)
            text = extensions.text
            loop_content = extensions.added_to(loop_content)
            closed_model = build(text, loop_content, base=base)
        if closed_model.model.nv == 0:
            raise SourceError(source_name, "no joint can move")
        moving = [joint for joint in root.findall("joint") if joint.get("type") != "fixed"]
        mimics = [Mimic(joint, mimic) for joint in moving for mimic in joint.findall("mimic")]
        robot = Robot(
            source_name,
            name=root.get("name", "") or Path(source_name).stem,
            description=Path(source_name).name,
            closed_model=closed_model,
            loops=loop_content,
            mimics=mimics,
            joints=_joints_with_extensions(root, extensions),
            root=root,
            springs=tuple(extensions.point_springs),
            own_run=own_run,
        )
        # `_import` calls this function with the report and the scene
        make_reference = partial(UrdfReference, extensions, loop_text, base, gravity)
        reading = _import(robot, report, request, gravity, make_reference)
    except RuntimeError as error:  # assertions of Pinocchio, for example of inertias
        check_inertias(source_name, root)
        raise SourceError(source_name, f"Pinocchio refuses it: {' '.join(str(error).split())}") from error
    except UrdfError as error:
        # the message already names the URDF or the loop file
        if str(error).startswith(source_name) or (
            loop_content.source and str(error).startswith(loop_content.source)
        ):
            raise
        errors = [
            line.removeprefix("Error:").strip() for line in parser_messages if line.startswith("Error:")
        ]
        raise SourceError(source_name, "; ".join([str(error), *errors])) from error
    except (NewtonEulerError, np.linalg.LinAlgError) as error:
        check_inertias(source_name, root)
        raise SourceError(source_name, str(error)) from error
    report_complaints(parser_messages, report)
    root_link = "is the ground" if base == "fixed" else "floats"
    components = " ".join(f"{component:g}" for component in gravity)
    reading.report.start.append(f"gravity is {components} m/s^2, a URDF has none; its root link {root_link}")
    return reading


def _unread_loops(path: Path) -> Iterator[Finding]:
    """Yield a finding for each loop file next to the URDF at `path`, if the URDF is imported without one."""
    for loop_file in loop_files_beside(path):
        yield Finding(
            name=Mistake.UNREAD_LOOPS,
            element=loop_file.name,
            what="a loop file is next to the URDF and was not read",
            consequence="its loops are open in this run",
            remedy=f"--set loops={loop_file} closes them",
        )


def _import_from_memory(
    model: object,
    gravity: Sequence[float] | None,
    q: Sequence[float] | Array | None,
    request: Request,
    own_run: dict[str, Any],
) -> Reading:
    """Import a model that Pinocchio has in memory; for the arguments see `read`."""
    given = Given(model, q)
    robot = Robot(
        given.source_name,
        name=given.name,
        description=given.source_name,
        closed_model=given.closed_model,
        loops=given.loops,
        mimics=[],
        joints=given.joints,
        first=(given.q, given.name_of_q),
        own_run=own_run,
        gains=given.gains,
    )
    model_gravity = given.closed_model.model.gravity.linear if gravity is None else gravity
    # `_import` calls this function with the report and the scene
    make_reference = partial(ModelReference, given.model, given.constraints, given.q, model_gravity)
    try:
        return _import(robot, ImportReport(), request, model_gravity, make_reference)
    except SourceError:
        raise
    except (NewtonEulerError, RuntimeError, np.linalg.LinAlgError) as error:
        raise SourceError(given.source_name, " ".join(str(error).split())) from error


def _joints_with_extensions(root: ET.Element, extensions: Extensions) -> list[JointProperties]:
    """Return the properties of joints, including springs, dampers and rotors that tools add to URDF."""
    joints = []
    for joint in joint_properties(root):
        stiffness, rest = extensions.springs.get(joint.name, (0.0, 0.0))
        joints.append(
            joint._replace(
                stiffness=stiffness,
                rest=rest,
                damping=joint.damping + extensions.dampings.get(joint.name, 0.0),
                armature=extensions.armatures.get(joint.name, 0.0),
            )
        )
    return joints


def _import(
    robot: Robot,
    report: ImportReport,
    request: Request,
    gravity: Sequence[float],
    make_reference: Callable[[ImportReport, Scene], PinocchioReference],
) -> Reading:
    """Import a robot as a scene, and verify the scene; on request, excite it (give joints start velocities).

    Args:
        robot: robot from files or from memory.
        report: report that receives the entries.
        request: options of the scene.
        gravity: (3,) m/s^2.
        make_reference: makes the reference model for verification from the report and the scene.
    """
    tolerance = request.redundancy_tolerance
    start = RobotAtStart(
        robot.source_name, robot.closed_model, robot.loops, robot.mimics, report, tolerance, robot.first
    )
    motor_joints = set(robot.loops.name_mot)
    tree = Tree(robot.source_name, start, motor_joints, report)
    if robot.root is not None:
        tree.bodies = with_visuals(robot.source_name, robot.root, start, tree, report)
    scene = _scene(robot, start, tree, report, request, gravity)
    report.names = _file_names(start, tree)
    # numbers that overflow are refused later; messages of the parser were already collected
    with np.errstate(all="ignore"), collected_messages([]):
        reference = make_reference(report, scene)
        report.references.append((reference, scene))
    if request.verified:
        report.start.append(verify_report(report))
    report.findings.extend(plausibility.findings(scene.mechanism))  # likely mistakes in the file
    if request.excitation:
        scene, largest_speeds = with_start_velocities(scene, report.bounds)
        report.start.append(f"{EXCITED}{largest_speeds}")
    _add_users_loop(robot, reference, scene, report)
    return Reading(scene, report)


def _add_users_loop(robot: Robot, reference: PinocchioReference, scene: Scene, report: ImportReport) -> None:
    """Set `report.simulation`: the model as the user's own simulation loop with Pinocchio runs it.

    The settings of the loop are those that the user gives, and else those of Pinocchio's examples. The report
    gets a line instead if the model has elements that such a loop does not simulate.
    """
    default = EXAMPLE_CLOSED if reference.closures else EXAMPLE_OPEN
    if robot.gains:  # each constraint in memory has its own Baumgarte gains
        default = replace(default, kp=None, kd=None)
    settings = replace(default, **robot.own_run)
    planes = {} if robot.root is None else turned_planes(robot.root)
    problem = unsupported(reference, scene)
    if planes:  # the reference has them as the format defines them
        problem = f"Pinocchio moves planar joint {next(iter(planes))!r} across z, not across its axis"
    if problem:
        report.start.append(f"a user's loop with Pinocchio is not judged: {problem}")
        return
    is_assumed = not robot.own_run
    report.simulation = PinocchioFile(reference, scene, settings, is_assumed, robot.gains or ())


def _file_names(start: RobotAtStart, tree: Tree) -> FileNames:
    """Record how joints and links of the file correspond to the scene.

    Logs of other simulators use the file's names and zeros; the record translates them to the scene.
    """
    model, names = start.model, FileNames()
    for index in range(1, model.njoints):
        joint, name = model.joints[index], str(model.names[index])
        if joint.nv == 1 and name in tree.coordinate_keys:
            q = start.q[joint.idx_q : joint.idx_q + joint.nq]
            # a hinge without limits has the cosine and the sine of the angle
            value = float(q[0]) if joint.nq == 1 else float(np.arctan2(q[1], q[0]))
            names.coordinates[name] = FileCoordinate(tree.coordinate_keys[name], value)
    bodies = {body.name: body for body in tree.bodies}
    for frame, pose in zip(model.frames, start.data.oMf, strict=True):
        owner = tree.names[frame.parentJoint]
        if frame.type != pin.FrameType.BODY or owner is None:
            continue
        # frame of the link in the frame of the scene's body
        body = bodies[owner]
        point, center = (
            rotation(body.quaternion).T @ (place - body.center_of_mass)
            for place in (pose.translation, _own_center(model, start.data, frame, pose))
        )
        turn = product(conjugate(body.quaternion), pin.SE3ToXYZQUAT(pose)[W_X_Y_Z])
        names.frames[str(frame.name)] = FileFrame(body.name, point, center, turn)
    return names


def _own_center(model: Any, data: Any, frame: Any, pose: Any) -> Array:
    """Return the center of mass (3,), world frame, of a link alone; the origin of a link without mass.

    Pinocchio merges links that fixed joints connect. It keeps the inertia of a link behind a fixed joint in
    the frame of this joint; the rest of the merged inertia is that of the first link.

    Args:
        model, data: Pinocchio's model, and data with the frames at the start.
        frame: frame of the link.
        pose: pose of the frame at the start.
    """
    parent = model.frames[frame.parentFrame]
    if parent.type == pin.FrameType.FIXED_JOINT:
        center = data.oMf[frame.parentFrame].act(parent.inertia.lever)
        return np.array(center if parent.inertia.mass else pose.translation)
    merged = model.inertias[frame.parentJoint]
    mass, moment = merged.mass, merged.mass * merged.lever  # kg, and kg m in the frame of the joint
    for each in model.frames:
        if each.parentJoint == frame.parentJoint:
            mass -= each.inertia.mass
            moment = moment - each.inertia.mass * each.placement.act(each.inertia.lever)
    if mass <= 1e-12 * merged.mass:  # round-off of the difference
        return np.array(pose.translation)
    return np.array(data.oMi[frame.parentJoint].act(moment / mass))


def _scene(
    robot: Robot,
    start: RobotAtStart,
    tree: Tree,
    report: ImportReport,
    request: Request,
    gravity: Sequence[float],
) -> Scene:
    """Build the scene from the imported bodies and all other elements, and fill the report."""
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
    joint_armatures = tuple(armatures(robot.joints, tree, report))
    report_joints(robot.joints, report)
    if robot.root is not None:
        report_collisions(robot.root, report)
    # `unweld_loops` merges the body halves by which `urdf.write` closes loops in exported files
    scene = Scene(
        name,
        unweld_loops(Mechanism(tree.bodies, joints, gears)),
        request.duration,
        request.output_period,
        gravity=np.array(gravity),
        forces=springs,
        armatures=joint_armatures,
        description=robot.description,
        redundancy_tolerance=request.redundancy_tolerance,
    )
    switched = friction_and_limits(robot.joints, start, tree, scene, request, report)
    return replace(scene, forces=(*springs, *switched))
