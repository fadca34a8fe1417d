"""Reference models of a URDF with its loop file, and of a Pinocchio model in memory.

An imported scene is verified against the reference model (`newton_euler.reading`). Pinocchio parses the file
again for this purpose. The module shares only the names of elements, and the numbers that
`urdf.reading.extensions` reads, with the reader, `urdf.reading`. Both can therefore not make the same mistake
in the conversion. For the equations see `urdf.pinocchio_reference`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from newton_euler.model.couplings import MAX_DEGREE
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import xml_tree
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array
from urdf.extensions import ARMATURE, STIFFNESS, Extensions
from urdf.loops import NO_LOOPS, UNIVERSAL, Loops, closure_names, parse_loops
from urdf.pinocchio_reference import Closure, PinocchioReference, PointSpring

HINGE_MODELS = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}
"""Pinocchio's joint models of hinges, by axis."""


MAX_LIMIT = 1e9
"""Magnitude, m or rad, from which on a limit of a joint is none."""


class MimicOfVelocities(NamedTuple):
    """Mimic of a URDF, x_follower = multiplier * x_driver + offset, by indices of velocities.

    Attributes:
        follower: index of the follower's velocity.
        driver: index of the driver's velocity.
        multiplier: derivative of the follower by the driver.
        offset: coordinate of the follower for the driver at 0, m or rad.
    """

    follower: int
    driver: int
    multiplier: float
    offset: float


class UrdfReference(PinocchioReference):
    """Reference model of a URDF with its loop file."""

    def __init__(
        self,
        extensions: Extensions,
        loops: str | None,
        base: str,
        gravity: Sequence[float],
        report: ImportReport,
        scene: Scene,
    ) -> None:
        """Parse the URDF and the loop file, and find the start configuration.

        Args:
            extensions: text of the URDF, and elements that act in addition to links and joints.
            loops: text of the loop file; None for no loop file.
            base: "fixed" if the root link is the ground, "free" if it floats.
            gravity: (3,) m/s^2.
            report: import report.
            scene: imported scene.
        """
        # Pinocchio's model with the loops of the loop file and of the URDF's additional elements
        self._root = xml_tree(extensions.text)
        loops_of_file = parse_loops(loops, "loop file") if loops is not None else NO_LOOPS
        self._loops = extensions.added_to(loops_of_file)
        model, joint_names = _build_model(extensions.text, self._loops, base)
        model.gravity.linear = np.array(gravity)
        super().__init__(model, joint_names, _closures(model, self._loops), report, scene)
        # forces and couplings
        self._damping = self._dampings()
        self._set_friction_and_limits()
        self._add_extensions(extensions)
        self.unaccounted = tuple(self._unaccounted(report))
        self._add_couplings()
        # displacements from neutral at the start: followers of mimics at their offsets
        x0 = np.zeros(model.nv)
        for _ in self._mimics:  # repeated for followers of followers
            for mimic in self._mimics:
                x0[mimic.follower] = mimic.multiplier * x0[mimic.driver] + mimic.offset
        q = self.integrate(pin.neutral(model), x0)
        self._begin(q, residuals=self._linear @ x0 - self._offsets, scene=scene)

    @property
    def mimic_names(self) -> tuple[str, ...]:
        """Names of the mimics, such as "mimic of joint 'finger'"."""
        return tuple(name for name in self._coupling_elements if name.startswith("mimic of "))

    def _dampings(self) -> Array:
        """Return the damping (nv,) of hinges and slides in elements `<dynamics>`, SI units.

        It is 0 where the scene leaves the damping out, which `_topics` lists.
        """
        model, dampings = self._model, np.zeros(self._model.nv)
        numbers = {str(model.names[k]): k for k in range(1, model.njoints) if model.joints[k].nv == 1}
        for joint in self._root.findall("joint"):
            dynamics, name = joint.find("dynamics"), str(joint.get("name"))
            if dynamics is not None and name in numbers and "damping" not in self._topics(f"joint {name!r}"):
                dampings[model.joints[numbers[name]].idx_v] = float(dynamics.get("damping", 0.0))
        return dampings

    def _set_friction_and_limits(self) -> None:
        """Read dry friction (elements `<dynamics>`) and limits (elements `<limit>`) of hinges and slides."""
        model = self._model
        numbers = {str(model.names[k]): k for k in range(1, model.njoints) if model.joints[k].nv == 1}
        for joint in self._root.findall("joint"):
            name, dynamics, limit = str(joint.get("name")), joint.find("dynamics"), joint.find("limit")
            if name not in numbers:
                continue
            index = model.joints[numbers[name]].idx_v
            if dynamics is not None:
                self._friction[index] = float(dynamics.get("friction", 0.0))
            if limit is not None:
                for limits, attribute in ((self._low, "lower"), (self._high, "upper")):
                    value = float(limit.get(attribute, 0.0))
                    if abs(value) < MAX_LIMIT:
                        limits[index] = value

    def _add_extensions(self, extensions: Extensions) -> None:
        """Add springs, dampers and rotors of elements beyond the URDF standard, such as those of Drake.

        `_topics` are properties of an element that the scene leaves out; the reference leaves them out, too.
        """
        model = self._model
        for k in range(1, model.njoints):
            joint, name = model.joints[k], str(model.names[k])
            if joint.nv != 1:
                continue
            topics, index = self._topics(f"joint {name!r}"), joint.idx_v
            if STIFFNESS not in topics:
                self._stiffness[index], self._rests[index] = extensions.springs.get(name, (0.0, 0.0))
            if "damping" not in topics:
                self._damping[index] += extensions.dampings.get(name, 0.0)
            if ARMATURE not in topics:
                model.armature[index] = extensions.armatures.get(name, 0.0)
        # springs between two points of one body do nothing
        without_effect = {entry.element for entry in self._report.entries if entry.moves_nothing}
        for spring in extensions.point_springs:
            if f"spring {spring.name!r}" not in without_effect:
                first, second = (int(model.getFrameId(frame)) for frame in spring.frames)
                numbers = spring.stiffness, spring.rest_length, spring.damping
                self._springs.append(PointSpring(spring.name, first, second, *numbers))

    def _add_couplings(self) -> None:
        """Set the residuals of mimics and coupled joints, see `PinocchioReference`."""
        model, rows, offsets, elements = self._model, [], [], []
        # factors of second and higher powers: row, power - 1, index of the velocity, factor
        higher_powers: list[tuple[int, int, int, float]] = []
        self._mimics: list[MimicOfVelocities] = []
        velocity_index = {str(model.names[k]): model.joints[k].idx_v for k in range(1, model.njoints)}
        # mimics: x_follower - multiplier x_driver = offset
        for joint in self._root.findall("joint"):
            for mimic in joint.findall("mimic"):
                name, driver = str(joint.get("name")), str(mimic.get("joint"))
                element = f"mimic of joint {name!r}"
                if joint.get("type") == "fixed" or self._topics(element):  # left out
                    continue
                row, offset = np.zeros(model.nv), float(mimic.get("offset", 0.0))
                multiplier = float(mimic.get("multiplier", 1.0))
                row[velocity_index[name]] += 1.0
                row[velocity_index[driver]] -= multiplier
                self._mimics.append(
                    MimicOfVelocities(velocity_index[name], velocity_index[driver], multiplier, offset)
                )
                rows.append(row)
                offsets.append(offset)
                elements.append(element)
        # couplings of the loop file: factors of the powers 1, 2, ... of coordinates
        for coupling in self._loops.coupled:
            element = f"coupled {', '.join(coupling)}"
            if not self._topics(element):
                row = np.zeros(model.nv)
                for name, factors in coupling.items():
                    row[velocity_index[name]] = factors[0]
                    for k, factor in enumerate(factors[1:], start=1):
                        higher_powers.append((len(rows), k, velocity_index[name], factor))
                rows.append(row)
                offsets.append(0.0)
                elements.append(element)
        # scale each row to a largest factor of 1
        linear, self._coupling_elements = np.reshape(rows, (-1, model.nv)), elements
        scale = np.max(np.abs(linear * self.units), axis=1, initial=0.0)
        self._linear, self._offsets = linear / scale[:, None], np.array(offsets) / scale
        self._higher_powers = np.zeros((len(rows), MAX_DEGREE, model.nv))
        for number, k, index, factor in higher_powers:
            self._higher_powers[number, k, index] = factor / scale[number]

    def _unaccounted(self, report: ImportReport) -> Iterator[str]:
        """Yield the names of joints, mimics and loop closures that a report does not mention."""
        mentioned = {entry.element for entry in report.entries}
        elements = [f"joint {name!r}" for name in self._joint_names[1:] if name != "root_joint"]
        for joint in self._root.findall("joint"):
            if joint.get("type") != "fixed" and joint.find("mimic") is not None:
                elements.append(f"mimic of joint {joint.get('name')!r}")
        elements += [f"closed_loop {' and '.join(pair)}" for pair in self._loops.closed_loop]
        yield from (element for element in elements if element not in mentioned)


class ModelReference(PinocchioReference):
    """Reference model of a Pinocchio model in memory with its rigid constraints."""

    def __init__(
        self,
        given: Any,
        constraints: Sequence[Any],
        q: Array,
        gravity: Sequence[float],
        report: ImportReport,
        scene: Scene,
    ) -> None:
        """Take a copy of a model.

        Args:
            given: `pinocchio.Model`.
            constraints: its `RigidConstraintModel`s.
            q: (nq,) configuration near which to start.
            gravity: (3,) m/s^2.
            report: import report.
            scene: imported scene.
        """
        model, names = given.copy(), closure_names(given, constraints)
        model.gravity.linear = np.array(gravity)
        data = model.createData()
        pin.framesForwardKinematics(model, data, q)
        # two frames for each constraint
        closures = []
        for pair, constraint in zip(names, constraints, strict=True):
            joint_1, placement_1 = constraint.joint1_id, constraint.joint1_placement
            joint_2, placement_2 = constraint.joint2_id, constraint.joint2_placement
            # a constraint to the world with default placement holds the first frame where it is at the start
            if joint_2 == 0 and placement_2.isIdentity(0.0):
                placement_2 = data.oMi[joint_1] * placement_1
            frames = [
                model.addFrame(pin.Frame(name, joint, placement, pin.FrameType.OP_FRAME), False)
                for name, joint, placement in zip(
                    pair, (joint_1, joint_2), (placement_1, placement_2), strict=True
                )
            ]
            kind = "3d" if constraint.type == pin.ContactType.CONTACT_3D else "6d"
            first, second = map(int, frames)
            closures.append(Closure(f"closed_loop {' and '.join(pair)}", kind, first, second))
        joint_names = ["", *(str(name) for name in list(model.names)[1:])]
        super().__init__(model, joint_names, closures, report, scene)
        for joint, name in zip(list(model.joints)[1:], joint_names[1:], strict=True):
            in_v, topics = slice(joint.idx_v, joint.idx_v + joint.nv), self._topics(f"joint {name!r}")
            if "damping" not in topics:
                self._damping[in_v] = model.damping[in_v]
            if ARMATURE in topics:
                model.armature[in_v] = 0.0
            index = joint.idx_v
            if joint.nv == 1:
                dry = model.lowerDryFrictionLimit[index], model.upperDryFrictionLimit[index]
                self._friction[index] = max(abs(x) for x in (*dry, model.friction[index]))
            if joint.nv == joint.nq == 1:
                low, high = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
                self._low[index] = low if abs(low) < MAX_LIMIT else -np.inf
                self._high[index] = high if abs(high) < MAX_LIMIT else np.inf
        # elements that the report does not mention
        mentioned = {entry.element for entry in report.entries}
        elements = [*(f"joint {name!r}" for name in joint_names[1:]), *(each.element for each in closures)]
        self.unaccounted = tuple(element for element in elements if element not in mentioned)
        self._begin(q, residuals=np.zeros(0), scene=scene)  # no couplings


def _closures(model: Any, loops: Loops) -> list[Closure]:
    """Return the loop closures of a loop file.

    The second frame of each closure is a copy that is added to the model. Except for rods, `keep_offsets`
    moves the copy to the first frame at the start, so that rounded numbers of the file leave no residual.
    """
    # number of the first frame of each name
    frames = {frame.name: k for k, frame in reversed(list(enumerate(model.frames)))}
    closures = []
    for number, ((first, second), kind) in enumerate(zip(loops.closed_loop, loops.type, strict=True)):
        copied = pin.Frame(model.frames[frames[second]])
        copied.name, copied.inertia = f"end of closed_loop {number}", pin.Inertia.Zero()
        added = int(model.addFrame(copied, False))
        closures.append(Closure(f"closed_loop {first} and {second}", kind, frames[first], added))
    return closures


def _turned_planes(text: str) -> dict[str, Array]:
    """Return the unit normals (3,) of planar joints whose plane is not across z, by name of the joint."""
    normals = {}
    for joint in xml_tree(text).iterfind("joint[@type='planar']"):
        axis = joint.find("axis")
        normal = np.array([1.0, 0.0, 0.0] if axis is None else axis.attrib["xyz"].split(), dtype=float)
        if normal[0] != 0.0 or normal[1] != 0.0 or normal[2] < 0.0:
            normals[joint.attrib["name"]] = normal / np.linalg.norm(normal)
    return normals


def _build_model(text: str, loops: Loops, base: str) -> tuple[Any, list[str]]:
    """Build Pinocchio's model of a URDF, with the types of joints in the loop file.

    Args:
        text: text of the URDF.
        loops: content of the loop file.
        base: "fixed" if the root link is the ground, "free" if it floats.

    Returns:
        The `pinocchio.Model`, and the name of the URDF joint for each of its joints.
    """
    plain = pin.buildModelFromXML(text, *([pin.JointModelFreeFlyer()] if base == "free" else []))
    types = dict(zip(loops.joint_name, loops.joint_type, strict=True))
    held = [plain.getJointId(name) for name, kind in types.items() if kind == "FIXED"]
    if held:
        plain = pin.buildReducedModel(plain, held, pin.neutral(plain))
    # new number of each joint, and URDF joint of each new joint
    model, number, urdf_joints, planes = pin.Model(), {0: 0}, [""], _turned_planes(text)
    for k in range(1, plain.njoints):
        name = str(plain.names[k])
        kind, pose = types.get(name, ""), plain.jointPlacements[k]
        # two hinges for a universal joint, three joints for a plane that is not across z, one for all others
        chain, letters = [plain.joints[k]], UNIVERSAL.get(kind, "")
        if letters:
            chain = [HINGE_MODELS[axis]() for axis in letters]
        elif kind == "SPHERICAL":
            chain = [pin.JointModelSpherical()]
        elif not kind and name in planes:
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), planes[name]).matrix()
            slides = [pin.JointModelPrismaticUnaligned(axis) for axis in turn.T[:2]]
            chain, letters = [*slides, pin.JointModelRevoluteUnaligned(turn[:, 2])], "xyz"
        number[k] = number[plain.parents[k]]
        for n, joint in enumerate(chain):
            joint_name = name if len(chain) == 1 else f"{name}_{letters[n]}"
            number[k] = model.addJoint(number[k], joint, pose if n == 0 else pin.SE3.Identity(), joint_name)
            urdf_joints.append(name)
        model.appendBodyToJoint(number[k], plain.inertias[k], pin.SE3.Identity())
    for frame in list(plain.frames)[1:]:
        frame.parentJoint = number[frame.parentJoint]
        model.addFrame(frame, False)
    return model, urdf_joints
