"""URDF and loop file, or Pinocchio model -> scene, with a report of what became of every element.

Pinocchio parses the URDF and adds up what fixed joints hold together; the scene is made of its model at
coordinates 0, with followers of mimics where their offsets put them, or next to that where the loops close.
It is verified against Pinocchio's own model of the file, see `newton_euler.reading` and `urdf.reference`.
Models in memory, with their constraints, go the same way.

The loop file has the keys of Gepetto's example-parallel-robots, see `urdf.loops`.
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
from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling, PolynomialCoupling
from newton_euler.model.forces import Force
from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Fixed, Revolute, Rod, Spherical
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
from urdf.loops import NO_LOOPS, REVOLUTE, Loops
from urdf.model import BASES, BaseName, ClosedLoopModel, build
from urdf.reading.bodies import Tree
from urdf.reading.extensions import read_extensions
from urdf.reading.forces import armatures, joint_springs, point_springs
from urdf.reading.given import Given, PinocchioModel
from urdf.reading.parser_messages import overheard, report_complaints
from urdf.reading.source import (
    JointProperties,
    SourceError,
    check_inertias,
    joint_properties,
    parsed,
    read_loops,
)
from urdf.reading.start import Mimic, Start
from urdf.reading.visuals import with_visuals
from urdf.reference import ModelReference, UrdfReference

DEFAULT_GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2, unless another one is asked for; a URDF has none."""

CLOSURE_JOINTS: dict[str, type[Joint]] = {"3d": Spherical, "6d": Fixed}


@dataclass(frozen=True, eq=False)
class Reading:
    """A scene read from a file, and what became of every element."""

    scene: Scene
    report: ImportReport


@dataclass(frozen=True, eq=False)
class Robot:
    """Parts of a scene, from files or from memory.

    Attributes:
        where, name, description: for messages, and of the scene.
        closed: Pinocchio's model and its closures.
        loops, mimics: of the files, or what they would be.
        joints: what joints have beside their motions.
        root: of the URDF; None of a model in memory.
        first: a configuration to start near to, and what reports call it.
        springs: between points of two links.
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
        model: path of the URDF; or a `pinocchio.Model`, or a pair of one and the `RigidConstraintModel`s that
            close its loops, or its anchors of points and frames. Those whose second placement is the world's
            own, as by default, hold where they start.
        loops: path of a URDF's loop file; none if None.
        base: "fixed" or "free", whether the root link of a URDF is the ground or floats.
        gravity: (3,) of the scene, m/s^2; (0, 0, -9.81) for a URDF and the model's own otherwise, if None.
        q: (nq,) Pinocchio's configuration that a model in memory starts from, or next to where its loops
            close; neutral if None.
        ignore: tags or names of elements of a URDF that are no link and no joint, such as "loop_joint": they
            are left out, where they would be refused or simulated; none if None.
        options: see `newton_euler.model.source_file.Request`. What is verified is the file as it stands.

    Raises:
        UrdfError: naming the file or model and the element at fault, one that was not read right among them.
        UnknownNameError: for another base.
        OptionError: for an option that is not of such a model.

    Examples:
        >>> urdf.write(load("four_bar"), "output/four_bar.urdf")
        >>> found = urdf.read("output/four_bar.urdf", "output/four_bar.loops.yaml")
        >>> len(found.scene.mechanism.bodies)
        6
    """
    check_choice("base", base, BASES)
    request = Request.of(options)
    if gravity is not None:
        gravity = finite_array("urdf.read", "gravity", gravity, (3,)).tolist()
    if isinstance(model, str | os.PathLike):
        if q is not None:
            raise OptionError("q", q, "none, as a URDF starts from coordinates 0")
        pull = DEFAULT_GRAVITY if gravity is None else gravity
        ignored = (ignore,) if isinstance(ignore, str) else () if ignore is None else tuple(ignore)
        return _from_file(model, loops, base, pull, request, ignored)
    for option, value, default in (("loops", loops, None), ("base", base, "fixed"), ("ignore", ignore, None)):
        if value is not default and not (isinstance(value, str) and value == default):
            raise OptionError(option, value, "none, as it is of URDF files")
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
    if text.startswith("<?xml"):  # Pinocchio would take the encoding that it names for that of the text
        text = text[text.index("?>") + 2 :]
    closing, loop_text = NO_LOOPS, None
    report = ImportReport()
    if loops is None:
        report.findings.extend(_unread_loops(Path(where)))
    else:
        loop_path = path_text(loops, SourceError)
        loop_text = read_text(loop_path, "scene_size", SourceError)
        closing = read_loops(loop_path, loop_text)
    words: list[str] = []
    try:
        with overheard(words):
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
    except RuntimeError as error:  # what Pinocchio asserts, of inertias for one
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
    """Find a loop file beside a URDF that is read without one."""
    for beside in (path.with_suffix(".loops.yaml"), path.with_suffix(".yaml")):
        with suppress(SourceError):
            if beside.is_file() and "closed_loop" in read_text(str(beside), "scene_size", SourceError):
                yield Finding(
                    "unread-loops",
                    beside.name,
                    "a loop file stands beside the URDF and was not read",
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
    """Properties of the joints of a URDF, with the springs, dampers and rotors of its other elements."""
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
    start = Start(robot.where, robot.closed, robot.loops, robot.mimics, report, tolerance, robot.first)
    tree = Tree(robot.where, start, set(robot.loops.name_mot), report)
    if robot.root is not None:
        tree.bodies = with_visuals(robot.where, robot.root, start, tree, report)
    scene = _scene(robot, start, tree, report, request, gravity)
    # what overflows is refused; the parser has been heard before
    with np.errstate(all="ignore"), overheard([]):
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
    start: Start,
    tree: Tree,
    report: ImportReport,
    request: Request,
    gravity: Sequence[float],
) -> Scene:
    for joint, kind in zip(start.loops.joint_name, start.loops.joint_type, strict=True):
        if kind == "FIXED":
            report.exactly(f"joint {joint!r}", "held at 0, as the loop file says")
    joints = [*tree.joints, *_closing(start, tree, report)]
    gears = list(_gears(start, tree, [joint.name for joint in joints], report))
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


def _closing(start: Start, tree: Tree, report: ImportReport) -> Iterator[Joint]:
    """The joints that the loop file adds."""
    taken, closed, loops = tree.joint_names, start.robot, start.loops
    frames, rods = iter(closed.frames), iter(closed.rods)
    for number, (pair, kind) in enumerate(zip(loops.closed_loop, loops.type, strict=True)):
        first, second = next(rods) if kind == "rod" else next(frames)
        along = next(frames)[0] if kind == REVOLUTE else first  # a second point on the axis
        (a, p), (b, q) = tree.end(first), tree.end(second)
        element = f"closed_loop {' and '.join(pair)}"
        if a == b:
            report.left_out(element, f"both frames are on {a!r}", inert=True)
            continue
        own, other = (frame.rpartition("_on_")[0] for frame in pair)  # as `urdf.write` names them
        wanted = own if own and own == other else f"closure_{number + 1}"
        name = unique_name(wanted, "closure", taken)
        taken = [*taken, name]
        # one point for both, so that the loop keeps what the file's digits leave it open by
        joint: Joint
        if kind == "rod":
            joint = Rod(name, a, b, p, point_on_second=q)
        elif kind == REVOLUTE:
            joint = Revolute(name, a, b, p, axis=tree.end(along)[1] - p)
        else:
            joint = CLOSURE_JOINTS[kind](name, a, b, p)
        yield joint
        report.exactly(element, f"{joint.kind} joint {name!r}")


def _gears(start: Start, tree: Tree, taken: list[str], report: ImportReport) -> Iterator[JointCoupling]:
    """Gears of mimics, and those and other couplings of coupled joints."""
    pairs: list[tuple[str, Key, Key, float]] = []
    sums: list[LinearCoupling] = []
    bent: list[PolynomialCoupling] = []
    for mimic in start.mimics:
        element = f"mimic of joint {mimic.follower!r}"
        if mimic.follower in tree.keys and mimic.driver in tree.keys:
            follower, driver = tree.keys[mimic.follower], tree.keys[mimic.driver]
            pairs.append((element, follower, driver, mimic.multiplier))
        else:
            report.left_out(element, "one of its joints moves nothing")
    for coupling in start.loops.coupled:
        element = f"coupled {', '.join(coupling)}"
        if any(len(factors) > 1 for factors in coupling.values()):
            if polynomial := _polynomial(start, tree, coupling, f"polynomial_{len(bent) + 1}", taken):
                bent.append(polynomial)
                report.exactly(element, f"polynomial coupling {polynomial.name!r}")
            else:
                why = "couples joints by polynomials; needed: two joints, one with its first power alone"
                report.left_out(element, why)
            continue
        terms = [(tree.keys[name], c) for name, (c,) in coupling.items() if c and name in tree.keys]
        if len(terms) > 2:
            name = unique_name(f"coupling_{len(sums) + 1}", "coupling", taken)
            sums.append(LinearCoupling(name, tuple((*key, factor) for key, factor in terms)))
            report.exactly(element, f"coupling {name!r} of {len(terms)} joint coordinates")
            continue
        if len(terms) != 2:
            report.left_out(element, f"couples {len(terms)} joints that move")
            continue
        (follower, own), (driver, other) = terms
        pairs.append((element, follower, driver, -other / own))
    for number, (element, follower, driver, ratio) in enumerate(pairs):
        name = unique_name(f"gear_{number + 1}", "gear", taken)
        yield Gear(name, driver[0], follower[0], ratio, driver[1], follower[1])
        report.exactly(element, f"gear {name!r} of ratio {ratio:.6g}")
    yield from sums
    yield from bent


def _polynomial(
    start: Start, tree: Tree, coupling: dict[str, tuple[float, ...]], own: str, taken: list[str]
) -> PolynomialCoupling | None:
    """Return the coupling of two joints of which one has a first power only, from the start on; else None."""
    moving = {name: factors for name, factors in coupling.items() if name in tree.keys and any(factors)}
    linear = [name for name, factors in moving.items() if not any(factors[1:])]
    if len(moving) != 2 or not linear:
        return None
    follower = linear[0]
    (driver,) = moving.keys() - {follower}
    coefficients = tuple(-factor / moving[follower][0] for factor in moving[driver])
    ends = (tree.keys[driver], tree.keys[follower])
    found = PolynomialCoupling(
        unique_name(own, "polynomial", taken), ends[0][0], ends[1][0], coefficients, ends[0][1], ends[1][1]
    )
    return found.from_zero(start.displacement(driver))


def _limits(start: Start, joint: JointProperties, key: Key) -> list[Watch]:
    """Watch how far a joint goes."""
    assert joint.limits is not None
    (low, high, _), at = joint.limits, start.displacement(joint.name)
    return [Bounds(((key, 1.0),), low - at, high - at, joint.unit)]


def _speed_limit(joint: JointProperties, key: Key) -> list[Watch]:
    """Watch how fast a joint moves."""
    assert joint.limits is not None
    speed = joint.limits[2]
    return [Bounds(((key, 1.0),), -speed, speed, f"{joint.unit}/s", by_value=0.0, by_rate=1.0)]


def _report_joints(joints: list[JointProperties], start: Start, tree: Tree, report: ImportReport) -> None:
    """Tell of dry friction, limits and safety controllers, which are no bilateral constraints."""
    for joint in joints:
        element, key = f"joint {joint.name!r}", tree.keys.get(joint.name)
        if joint.friction:
            why = f"its dry friction {joint.friction:g}"
            resting = [Rest((key,))] if key else []
            report.left_out(element, why, topic=FRICTION, watches=resting, numbers=[joint.friction])
        if joint.limits:
            low, high, speed = joint.limits
            why = f"its limits {low:.4g} to {high:.4g}: limits are no bilateral constraints"
            watches = _limits(start, joint, key) if key else []
            report.left_out(element, why, topic=LIMITS, watches=watches, numbers=[low, high])
            if math.isfinite(speed):
                why = f"its limit of velocity, {speed:.4g} {joint.unit}/s"
                watches = _speed_limit(joint, key) if key else []
                report.left_out(element, why, topic=VELOCITY_LIMITS, watches=watches, numbers=[speed])
        if joint.rotor:
            why = f"its rotor, rotorInertia times rotorGearRatio^2 of {joint.rotor:g}"
            remedy = "Pinocchio's dynamics have model.armature alone: add it there"
            report.left_out(element, f"{why}: {remedy}", topic="rotor", numbers=[joint.rotor])
        if joint.has_safety:
            why = "its safety controller: a program that runs beside the mechanism"
            report.left_out(element, why, topic="safety controller", examined=False)


def _report_leftovers(root: ET.Element, report: ImportReport) -> None:
    """Report the contacts of a URDF, which are no bilateral constraints."""
    if touching := root.findall("link/collision"):
        why = "contacts: a URDF does not say which bodies may touch, nor what ground there is; an MJCF does"
        report.left_out(f"{len(touching)} collision elements", why, topic=CONTACTS, examined=False)
