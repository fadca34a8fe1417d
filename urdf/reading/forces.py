"""Import springs, dampers and rotors of joints, and springs between points of links."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from newton_euler.model.forces import Armature, JointSpring, PointSpring
from newton_euler.reading.import_report import FORCE, ImportReport
from urdf.extensions import ARMATURE, STIFFNESS, PointSpringElement
from urdf.reading.bodies import Tree
from urdf.reading.source import JointProperties
from urdf.reading.start import RobotAtStart


def joint_springs(
    joints: list[JointProperties], start: RobotAtStart, tree: Tree, report: ImportReport
) -> Iterator[JointSpring]:
    """Yield springs and dampers of joints."""
    for joint in joints:
        name, damping, stiffness = joint.name, joint.damping, joint.stiffness
        if not (damping or stiffness):
            continue
        damper = f"its damping {damping:g} as a damper" if damping else ""
        spring = f"its stiffness {stiffness:g} about {joint.rest:g} as a spring" if stiffness else ""
        if name in tree.keys:
            (key, coordinate), rest = tree.keys[name], joint.rest - start.displacement(name)
            yield JointSpring(key, stiffness, damping, rest if stiffness else 0.0, coordinate)
            how = " and ".join(filter(None, [spring, damper]))
            report.imported(f"joint {name!r}", how, FORCE if stiffness else "")
            continue
        if damping:
            why = f"its damping {damping:g}: the joint is not a moving hinge or slide"
            report.left_out(f"joint {name!r}", why, topic="damping")
        if stiffness:
            why = f"its stiffness {stiffness:g}: the joint is not a moving hinge or slide"
            report.left_out(f"joint {name!r}", why, topic=STIFFNESS)


def point_springs(
    springs: Sequence[PointSpringElement], start: RobotAtStart, tree: Tree, report: ImportReport
) -> Iterator[PointSpring]:
    """Yield springs and dampers between points."""
    model = start.model
    for spring in springs:
        (a, p), (b, q) = (tree.end(model.getFrameId(name)) for name in spring.frames)
        element = f"spring {spring.name!r}"
        if a == b:
            report.left_out(element, f"both its ends are on {a!r}", moves_nothing=True)
            continue
        yield PointSpring(
            spring.name,
            a,
            b,
            p,
            q,
            stiffness=spring.stiffness,
            rest_length=spring.rest_length,
            damping=spring.damping,
        )
        how = (
            f"stiffness {spring.stiffness:g}, rest length {spring.rest_length:g}, damping {spring.damping:g}"
        )
        report.imported(element, f"{how}, between {a!r} and {b!r}", FORCE)


def armatures(joints: list[JointProperties], tree: Tree, report: ImportReport) -> Iterator[Armature]:
    """Yield rotor inertias of joints."""
    for joint in joints:
        name, armature = joint.name, joint.armature
        if armature and name in tree.keys:
            key = tree.keys[name]
            yield Armature(key[0], armature, key[1])
            report.imported(f"joint {name!r}", f"its armature {armature:g} as a rotor inertia")
        elif armature:
            why = f"its armature {armature:g}: the joint is not a moving hinge or slide"
            report.left_out(f"joint {name!r}", why, topic=ARMATURE)
