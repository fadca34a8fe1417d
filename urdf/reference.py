"""URDF with its loop file, or a model in memory, as Pinocchio holds it: the reference model of a scene.

See `newton_euler.reading`. Pinocchio parses the file again. Loop closures, couplings and mimics are
constraint rows here. The module shares only the names of elements with `urdf.reading`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.model.couplings import MAX_DEGREE
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array
from urdf.extensions import ARMATURE, STIFFNESS, Extensions
from urdf.loops import NO_LOOPS, UNIVERSAL, Loops, closure_names, parse_loops
from urdf.pinocchio_reference import Closure, PinocchioReference

HINGE_MODELS = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}


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
        """Parse both files.

        Args:
            extensions: text of the URDF, and elements that act in addition to links and joints.
            loops: text of the loop file; None for no loop file.
            base: see `urdf.read`.
            gravity: see `urdf.read`.
            report: import report.
            scene: imported scene.
        """
        self._root = ET.fromstring(extensions.text)
        own = parse_loops(loops, "loop file") if loops is not None else NO_LOOPS
        self._loops = extensions.added_to(own)
        model, owners = _built(extensions.text, self._loops, base)
        model.gravity.linear = np.array(gravity)
        super().__init__(model, owners, _ends(model, self._loops), report, scene)
        self._damping = self._dampers()
        self._add(extensions)
        self.unaccounted = tuple(self._unaccounted(report))
        self._couple()
        guess = np.zeros(model.nv)
        for _ in self._followers:  # repeated for followers of followers
            for follower, driver, multiplier, offset in self._followers:
                guess[follower] = multiplier * guess[driver] + offset
        q = self.moved(pin.neutral(model), guess)
        self._begin(q, self._rows @ guess - self._offsets, scene)

    def _dampers(self) -> Array:
        """Return the damping (nv,) of hinges and slides in `<dynamics>`."""
        model, found = self._model, np.zeros(self._model.nv)
        numbers = {str(model.names[k]): k for k in range(1, model.njoints) if model.joints[k].nv == 1}
        for joint in self._root.findall("joint"):
            dynamics, name = joint.find("dynamics"), str(joint.get("name"))
            if dynamics is not None and name in numbers and "damping" not in self._topics(f"joint {name!r}"):
                found[model.joints[numbers[name]].idx_v] = float(dynamics.get("damping", 0.0))
        return found

    def _add(self, extensions: Extensions) -> None:
        """Add springs, dampers and rotors of elements other than joints."""
        model = self._model
        for k in range(1, model.njoints):
            joint, name = model.joints[k], str(model.names[k])
            if joint.nv != 1:
                continue
            topics, place = self._topics(f"joint {name!r}"), joint.idx_v
            if STIFFNESS not in topics:
                self._stiffness[place], self._rests[place] = extensions.springs.get(name, (0.0, 0.0))
            if "damping" not in topics:
                self._damping[place] += extensions.dampings.get(name, 0.0)
            if ARMATURE not in topics:
                model.armature[place] = extensions.armatures.get(name, 0.0)
        inert = {entry.element for entry in self._report.entries if entry.inert}
        for spring in extensions.point_springs:
            if f"spring {spring.name!r}" not in inert:
                frames = tuple(int(model.getFrameId(frame)) for frame in spring.frames)
                numbers = spring.stiffness, spring.rest_length, spring.damping
                self._springs.append((spring.name, (frames[0], frames[1]), *numbers))

    def _couple(self) -> None:
        """Set the rows of mimics and coupled joints: factors (c, nv), offsets (c,) and elements."""
        model, rows, offsets, owners = self._model, [], [], []
        bent: list[tuple[int, int, int, float]] = []
        self._followers: list[tuple[int, int, float, float]] = []
        places = {str(model.names[k]): model.joints[k].idx_v for k in range(1, model.njoints)}
        for joint in self._root.findall("joint"):
            for mimic in joint.findall("mimic"):
                name, driver = str(joint.get("name")), str(mimic.get("joint"))
                element = f"mimic of joint {name!r}"
                if joint.get("type") == "fixed" or self._topics(element):
                    continue
                row, offset = np.zeros(model.nv), float(mimic.get("offset", 0.0))
                multiplier = float(mimic.get("multiplier", 1.0))
                row[places[name]] += 1.0
                row[places[driver]] -= multiplier
                self._followers.append((places[name], places[driver], multiplier, offset))
                rows.append(row)
                offsets.append(offset)
                owners.append(element)
        for coupling in self._loops.coupled:
            element = f"coupled {', '.join(coupling)}"
            if not self._topics(element):
                row = np.zeros(model.nv)
                for name, factors in coupling.items():
                    row[places[name]] = factors[0]
                    for k, factor in enumerate(factors[1:], start=1):
                        bent.append((len(rows), k, places[name], factor))
                rows.append(row)
                offsets.append(0.0)
                owners.append(element)
        # scale each row to a largest factor of 1
        self._rows, self._owners = np.reshape(rows, (-1, model.nv)), owners
        scale = np.max(np.abs(self._rows * self.units), axis=1, initial=0.0)
        self._rows, self._offsets = self._rows / scale[:, None], np.array(offsets) / scale
        self._bent = np.zeros((len(rows), MAX_DEGREE, model.nv))
        for number, k, place, factor in bent:
            self._bent[number, k, place] = factor / scale[number]

    def _unaccounted(self, report: ImportReport) -> Iterator[str]:
        """Yield joints, mimics and closures that a report does not mention."""
        known = {entry.element for entry in report.entries}
        elements = [f"joint {name!r}" for name in self._of[1:] if name != "root_joint"]
        for joint in self._root.findall("joint"):
            if joint.get("type") != "fixed" and joint.find("mimic") is not None:
                elements.append(f"mimic of joint {joint.get('name')!r}")
        elements += [f"closed_loop {' and '.join(pair)}" for pair in self._loops.closed_loop]
        yield from (element for element in elements if element not in known)


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
            q: (nq,) configuration to start near to.
            gravity: (3,) m/s^2.
            report: import report.
            scene: imported scene.
        """
        # frames of the constraints; the default second placement is the frame at the start
        model, names = given.copy(), closure_names(given, constraints)
        model.gravity.linear = np.array(gravity)
        pin.framesForwardKinematics(model, data := model.createData(), q)
        closures = []
        for pair, constraint in zip(names, constraints, strict=True):
            first = constraint.joint1_id, constraint.joint1_placement
            second = constraint.joint2_id, constraint.joint2_placement
            if second[0] == 0 and second[1].isIdentity(0.0):
                second = 0, data.oMi[first[0]] * first[1]
            frames = [
                model.addFrame(pin.Frame(name, joint, placement, pin.FrameType.OP_FRAME), False)
                for name, (joint, placement) in zip(pair, (first, second), strict=True)
            ]
            kind = "3d" if constraint.type == pin.ContactType.CONTACT_3D else "6d"
            closures.append(Closure(f"closed_loop {' and '.join(pair)}", kind, *map(int, frames)))
        owners = ["", *(str(name) for name in list(model.names)[1:])]
        super().__init__(model, owners, closures, report, scene)
        for joint, motion in zip(list(model.joints)[1:], owners[1:], strict=True):
            place, topics = slice(joint.idx_v, joint.idx_v + joint.nv), self._topics(f"joint {motion!r}")
            if "damping" not in topics:
                self._damping[place] = model.damping[place]
            if ARMATURE in topics:
                model.armature[place] = 0.0
        known = {entry.element for entry in report.entries}
        elements = [*(f"joint {name!r}" for name in owners[1:]), *(each.element for each in closures)]
        self.unaccounted = tuple(element for element in elements if element not in known)
        self._begin(q, np.zeros(0), scene)


def _ends(model: Any, loops: Loops) -> list[Closure]:
    """Return the closures of a loop file; adds their second frames to the model."""
    frames = {frame.name: k for k, frame in reversed(list(enumerate(model.frames)))}
    found = []
    for number, ((first, second), kind) in enumerate(zip(loops.closed_loop, loops.type, strict=True)):
        copied = pin.Frame(model.frames[frames[second]])
        copied.name, copied.inertia = f"end of closed_loop {number}", pin.Inertia.Zero()
        added = int(model.addFrame(copied, False))
        found.append(Closure(f"closed_loop {first} and {second}", kind, frames[first], added))
    return found


def _built(text: str, loops: Loops, base: str) -> tuple[Any, list[str]]:
    """Build Pinocchio's model with the joint types of the loop file, and the URDF joint of each joint."""
    plain = pin.buildModelFromXML(text, *([pin.JointModelFreeFlyer()] if base == "free" else []))
    types = dict(zip(loops.joint_name, loops.joint_type, strict=True))
    held = [plain.getJointId(name) for name, kind in types.items() if kind == "FIXED"]
    if held:
        plain = pin.buildReducedModel(plain, held, pin.neutral(plain))
    model, number, owners = pin.Model(), {0: 0}, [""]
    for k in range(1, plain.njoints):
        name = str(plain.names[k])
        kind, pose = types.get(name, ""), plain.jointPlacements[k]
        turning = [HINGE_MODELS[axis]() for axis in UNIVERSAL.get(kind, "")]
        chain = turning or [pin.JointModelSpherical() if kind == "SPHERICAL" else plain.joints[k]]
        number[k] = number[plain.parents[k]]
        for n, joint in enumerate(chain):
            own = name if len(chain) == 1 else f"{name}_{UNIVERSAL[kind][n]}"
            number[k] = model.addJoint(number[k], joint, pose if n == 0 else pin.SE3.Identity(), own)
            owners.append(name)
        model.appendBodyToJoint(number[k], plain.inertias[k], pin.SE3.Identity())
    for frame in list(plain.frames)[1:]:
        frame.parentJoint = number[frame.parentJoint]
        model.addFrame(frame, False)
    return model, owners
