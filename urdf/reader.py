"""URDF and loop file -> scene, with a report of what became of every element.

Pinocchio parses the URDF and adds up what fixed joints hold together; the scene is made of its model at
coordinates 0, with followers of mimics where their offsets put them, or next to that where the loops close.
It is verified against Pinocchio's own model of the file, see `newton_euler.verification` and `urdf.original`.

The loop file has the keys of Gepetto's example-parallel-robots, see `urdf.loops`.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Unpack

import numpy as np

from newton_euler.errors import NewtonEulerError, check_choice
from newton_euler.exercise import moving as exercised
from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Fixed, Rod, Spherical
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import ReadOptions, Request, path_text, read_text
from newton_euler.model.spanning_tree import unweld_loops
from newton_euler.verification.activity import Bounds, Rest, Watch
from newton_euler.verification.import_report import (
    CONTACTS,
    FRICTION,
    LIMITS,
    ImportReport,
    unique_name,
)
from newton_euler.verification.verify import check
from urdf.errors import UrdfError
from urdf.loops import NO_LOOPS
from urdf.model import BASES, BaseName, build
from urdf.original import UrdfOriginal
from urdf.reading.bodies import Tree
from urdf.reading.source import SourceError, check_inertias, parsed, read_loops
from urdf.reading.start import Mimic, Start
from urdf.reading.visuals import dressed

GRAVITY = (0.0, 0.0, -9.81)
"""m/s^2, unless another one is asked for; a URDF has none."""

PARTS = {
    "link": ("inertial", "visual", "collision"),
    "joint": (
        "origin", "parent", "child", "axis", "limit", "dynamics", "mimic", "safety_controller", "calibration"
    ),
}  # fmt: skip
"""What is known inside of links and joints."""

CLOSURES: dict[str, type[Joint]] = {"3d": Spherical, "6d": Fixed}


@dataclass(frozen=True, eq=False)
class Reading:
    """A scene read from a file, and what became of every element."""

    scene: Scene
    report: ImportReport


def read(
    path: str | os.PathLike[str],
    loops: str | os.PathLike[str] | None = None,
    base: BaseName = "fixed",
    gravity: Sequence[float] = GRAVITY,
    **options: Unpack[ReadOptions],
) -> Reading:
    """Read a URDF.

    Args:
        path: of the URDF.
        loops: of its loop file; none if None.
        base: "fixed" or "free", whether its root link is the ground or floats.
        gravity: (3,) of the scene, m/s^2.
        options: see `newton_euler.model.source_file.Request`. What is verified is the file as it stands.

    Raises:
        UrdfError: naming the file and the element at fault, one that was not read right among them.
        UnknownNameError: for another base.

    Examples:
        >>> urdf.write(load("four_bar"), "output/four_bar.urdf")
        >>> found = urdf.read("output/four_bar.urdf", "output/four_bar.loops.yaml")
        >>> len(found.scene.mechanism.bodies)
        6
    """
    check_choice("base", base, BASES)
    where, report, request = path_text(path, SourceError), ImportReport(), Request(**options)
    text = read_text(where, "file_size", SourceError)
    root = parsed(where, text)
    if text.startswith("<?xml"):  # Pinocchio would take the encoding that it names for that of the text
        text = text[text.index("?>") + 2 :]
    closing, loop_text = NO_LOOPS, None
    if loops is not None:
        loop_path = path_text(loops, SourceError)
        loop_text = read_text(loop_path, "scene_size", SourceError)
        closing = read_loops(loop_path, loop_text)
    words: list[str] = []
    try:
        with _overheard(words):
            closed = build(text, closing, base=base)
        if closed.model.nv == 0:
            raise SourceError(where, "no joint can move")
        moving = [j for j in root.findall("joint") if j.get("type") != "fixed"]
        mimics = [Mimic(j, m) for j in moving for m in j.findall("mimic")]
        start = Start(where, closed, closing, mimics, report, request.redundancy_tolerance)
        tree = Tree(where, start, set(closing.name_mot), report)
        tree.bodies = dressed(where, root, start, tree, report)
        scene = _scene(where, root, start, tree, report, request, gravity)
        with np.errstate(all="ignore"):  # what overflows is refused
            original = UrdfOriginal(text, loop_text, base, gravity, report, scene)
            report.originals.append((original, scene))
        if request.verified:
            report.start.append(check(report))
        if request.exercise:
            scene, fastest = exercised(scene)
            report.start.append(f"exercised: {fastest}")
        root_link = "is the ground" if base == "fixed" else "floats"
        pull = " ".join(f"{g:g}" for g in gravity)
        report.start.append(f"gravity is {pull} m/s^2, a URDF has none; its root link {root_link}")
    except RuntimeError as error:  # what Pinocchio asserts, of inertias for one
        check_inertias(where, root)
        raise SourceError(where, f"Pinocchio refuses it: {' '.join(str(error).split())}") from error
    except UrdfError as error:
        if str(error).startswith(where) or (closing.source and str(error).startswith(closing.source)):
            raise
        raise SourceError(where, "; ".join([str(error), *words])) from error
    except (NewtonEulerError, np.linalg.LinAlgError) as error:
        check_inertias(where, root)
        raise SourceError(where, str(error)) from error
    return Reading(scene, report)


@contextmanager
def _overheard(words: list[str]) -> Iterator[None]:
    """Keep what the parser says on standard error beside what it raises, which names no element."""
    sys.stderr.flush()
    before = os.dup(2)
    with tempfile.TemporaryFile() as said:
        os.dup2(said.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(before, 2)
            os.close(before)
            said.seek(0)
            lines = said.read().decode(errors="replace").splitlines()
            words += [line.removeprefix("Error:").strip() for line in lines if line.startswith("Error:")]


def _scene(
    path: str,
    root: ET.Element,
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
    name = unique_name(root.get("name", "") or Path(path).stem, "robot", ())[:100].strip(".") or "robot"
    springs = tuple(_springs(root, tree, report))
    _report_leftovers(start, root, tree, report)
    return Scene(
        name,
        unweld_loops(Mechanism(tree.bodies, joints, gears)),
        request.duration,
        request.output_period,
        gravity=np.array(gravity),
        forces=springs,
        description=Path(path).name,
        redundancy_tolerance=request.redundancy_tolerance,
    )


def _closing(start: Start, tree: Tree, report: ImportReport) -> Iterator[Joint]:
    """The joints that the loop file adds."""
    taken, closed, loops = tree.joint_names, start.robot, start.loops
    frames, rods = iter(closed.frames), iter(closed.rods)
    for number, (pair, kind) in enumerate(zip(loops.closed_loop, loops.type, strict=True)):
        first, second = next(rods) if kind == "rod" else next(frames)
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
        yield Rod(name, a, b, p, point_on_second=q) if kind == "rod" else CLOSURES[kind](name, a, b, p)
        report.exactly(element, f"{'rod' if kind == 'rod' else CLOSURES[kind].kind} joint {name!r}")


def _gears(start: Start, tree: Tree, taken: list[str], report: ImportReport) -> Iterator[JointCoupling]:
    """Gears of mimics, and those and other couplings of coupled joints."""
    pairs: list[tuple[str, Key, Key, float]] = []
    sums: list[LinearCoupling] = []
    for mimic in start.mimics:
        element = f"mimic of joint {mimic.follower!r}"
        if mimic.follower in tree.keys and mimic.driver in tree.keys:
            follower, driver = tree.keys[mimic.follower], tree.keys[mimic.driver]
            pairs.append((element, follower, driver, mimic.multiplier))
        else:
            report.left_out(element, "one of its joints moves nothing")
    for coupling in start.loops.coupled:
        terms = [(tree.keys[name], c) for name, c in coupling.items() if c and name in tree.keys]
        element = f"coupled {', '.join(coupling)}"
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


def _springs(root: ET.Element, tree: Tree, report: ImportReport) -> Iterator[JointSpring]:
    """The dampers of joints."""
    for joint in root.findall("joint"):
        name, dynamics = str(joint.get("name")), joint.find("dynamics")
        damping = 0.0 if dynamics is None else float(dynamics.get("damping", 0.0))
        if damping and name in tree.keys:
            key = tree.keys[name]
            yield JointSpring(key[0], damping=damping, coordinate=key[1])
            report.exactly(f"joint {name!r}", f"its damping {damping:g} as a damper")
        elif damping:
            why = f"its damping {damping:g}: it is no hinge or slide that moves"
            report.left_out(f"joint {name!r}", why, topic="damping")


def _limits(start: Start, joint: ET.Element, key: Key) -> list[Watch]:
    """Watches how far a joint goes and how fast; what it may be driven with limits nothing: nothing does."""
    limit, at = joint.find("limit"), start.displacement(str(joint.get("name")))
    assert limit is not None
    low, high, speed = (float(limit.get(name, 0.0)) for name in ("lower", "upper", "velocity"))
    terms, unit = ((key, 1.0),), "m" if joint.get("type") == "prismatic" else "rad"
    found: list[Watch] = [Bounds(terms, low - at, high - at, unit)]
    if math.isfinite(speed):
        found.append(Bounds(terms, -speed, speed, f"{unit}/s", by_value=0.0, by_rate=1.0))
    return found


def _report_leftovers(start: Start, root: ET.Element, tree: Tree, report: ImportReport) -> None:
    """Tell of everything that is no rigid body and no bilateral constraint."""
    for joint in root.findall("joint"):
        element, dynamics = f"joint {joint.get('name')!r}", joint.find("dynamics")
        key, limit = tree.keys.get(str(joint.get("name"))), joint.find("limit")
        friction = 0.0 if dynamics is None else float(dynamics.get("friction", 0.0))
        if friction:
            why = f"its dry friction {friction:g}"
            resting = [Rest((key,))] if key else []
            report.left_out(element, why, topic=FRICTION, watches=resting)
        if limit is not None and joint.get("type") in ("revolute", "prismatic"):
            low, high = (float(limit.get(name, 0.0)) for name in ("lower", "upper"))
            why = f"its limits {low:.4g} to {high:.4g}: limits are no bilateral constraints"
            watches = _limits(start, joint, key) if key else []
            report.left_out(element, why, topic=LIMITS, watches=watches)
        if joint.find("safety_controller") is not None:
            report.left_out(element, "its safety controller", topic="safety controller")
    for tag, known in PARTS.items():
        parts = Counter(part.tag for element in root.findall(tag) for part in element)
        for inner, count in parts.items():
            if inner not in known:
                report.left_out(f"{count} <{inner}> of {tag}s", "no part of a URDF's mechanics", inert=True)
    if touching := root.findall("link/collision"):
        why = "contacts are no bilateral constraints"
        report.left_out(f"{len(touching)} collision elements", why, topic=CONTACTS)
    for tag in dict.fromkeys(child.tag for child in root if child.tag not in ("link", "joint", "material")):
        element = f"{len(root.findall(tag))} <{tag}>"
        report.left_out(element, "no part of a URDF's mechanics", inert=True)
