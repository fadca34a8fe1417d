"""Import springs, dampers and armatures of joints, and springs between points of links, for `urdf.reader`.

An armature is the rotor inertia of a joint. URDF itself has only dampers of joints; the other elements come
from extensions of the format (`urdf.extensions`). Elements of joints other than moving hinges and slides,
which have a coordinate in the scene, are left out. The import report receives one entry for each element.
`FORCE` marks springs, which not every file format can represent. The topic of an entry is the property of the
joint that is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from newton_euler.model.armatures import Armature
from newton_euler.model.forces import JointSpring, PointSpring
from newton_euler.reading.import_report import FORCE, ImportReport
from urdf.extensions import ARMATURE, STIFFNESS, PointSpringElement
from urdf.reading.bodies import Tree
from urdf.reading.source import JointProperties
from urdf.reading.start import RobotAtStart


def joint_springs(
    joints: list[JointProperties], start: RobotAtStart, tree: Tree, report: ImportReport
) -> Iterator[JointSpring]:
    """Yield springs and dampers of joints, and report them.

    Args:
        joints: properties of the joints in the file.
        start: Pinocchio's model of the file, at the start state of the scene.
        tree: imported bodies and joints of the tree.
        report: report that receives the entries.
    """
    for joint in joints:
        name, damping, stiffness = joint.name, joint.damping, joint.stiffness
        if not (damping or stiffness):
            continue
        damper = f"its damping {damping:g} as a damper" if damping else ""
        spring = f"its stiffness {stiffness:g} about {joint.rest:g} as a spring" if stiffness else ""
        if name in tree.coordinate_keys:
            # the file counts coordinates from its zero pose, the scene from the start; `displacement` is the
            # coordinate at the start, counted from the zero pose
            rest = joint.rest - start.displacement(name) if stiffness else 0.0
            scene_joint, coordinate = tree.coordinate_keys[name]
            yield JointSpring(scene_joint, stiffness, damping, rest, coordinate)
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
    """Yield springs and dampers between points of two bodies, and report them.

    Args:
        springs: springs in the file.
        start: Pinocchio's model of the file, at the start state of the scene.
        tree: imported bodies and joints of the tree.
        report: report that receives the entries.
    """
    model = start.model
    for spring in springs:
        (first, point_on_first), (second, point_on_second) = (
            tree.body_and_point(model.getFrameId(name)) for name in spring.frames
        )
        element = f"spring {spring.name!r}"
        if first == second:  # forces inside one body: the scene moves as if the spring were imported
            report.left_out(element, f"both its ends are on {first!r}", moves_nothing=True)
            continue
        yield PointSpring(
            spring.name,
            first,
            second,
            point_on_first,
            point_on_second,
            stiffness=spring.stiffness,
            rest_length=spring.rest_length,
            damping=spring.damping,
        )
        how = (
            f"stiffness {spring.stiffness:g}, rest length {spring.rest_length:g}, damping {spring.damping:g}"
        )
        report.imported(element, f"{how}, between {first!r} and {second!r}", FORCE)


def armatures(joints: list[JointProperties], tree: Tree, report: ImportReport) -> Iterator[Armature]:
    """Yield the rotor inertias of joints, and report them; for the arguments see `joint_springs`."""
    for joint in joints:
        name, armature = joint.name, joint.armature
        if armature and name in tree.coordinate_keys:
            scene_joint, coordinate = tree.coordinate_keys[name]
            yield Armature(scene_joint, armature, coordinate)
            report.imported(f"joint {name!r}", f"its armature {armature:g} as a rotor inertia")
        elif armature:
            why = f"its armature {armature:g}: the joint is not a moving hinge or slide"
            report.left_out(f"joint {name!r}", why, topic=ARMATURE)
