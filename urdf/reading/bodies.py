"""Import the bodies of a Pinocchio model and the joints of its tree, for `urdf.reader`.

Loop closures are not joints of the tree; `urdf.reading.loops` imports them. A chain of joints through links
without mass becomes one joint of the scene, such as a universal joint. Pinocchio has already merged links
that fixed joints connect.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Free
from newton_euler.model.joint_parts import Part, combine_motions, common_name
from newton_euler.model.mechanism import REALISABLE_TOLERANCE, Body
from newton_euler.reading.import_report import ImportReport, unique_name
from newton_euler.scalars import Array
from urdf.reading.source import SourceError
from urdf.reading.start import RobotAtStart

W_X_Y_Z = [6, 3, 4, 5]
"""Indices of the quaternion (w, x, y, z) in `pinocchio.SE3ToXYZQUAT`, which ends with (x, y, z, w)."""

GROUND = "ground"
"""Name of the ground, the first body of a scene."""


class Tree:
    """Imported bodies and joints of the tree.

    A joint coordinate has the key (name of the scene's joint, number of the coordinate). Coordinates are zero
    at the start.

    Attributes:
        bodies: bodies of the scene, ground first.
        joints: one joint for each moving body.
        names: for each of Pinocchio's joints, the name of the scene's body that the joint moves; None if the
            joint moves a massless link.
        coordinate_keys: key of the coordinate of each of Pinocchio's hinges and slides, by name.
    """

    def __init__(self, path: str, start: RobotAtStart, motors: set[str], report: ImportReport) -> None:
        """Import and report bodies and joints.

        Args:
            path: file or model, for messages.
            start: Pinocchio's model and data at the start state.
            motors: names of joints with a motor.
            report: report that receives the entries.

        Raises:
            SourceError: for a link with inertia and without mass, several joints on a massless link, and a
                model without moving mass.
        """
        self._path, self._model, self._start = path, start.model, start
        self._scratch_data: Any = start.model.createData()  # for Jacobians; overwritten by each call
        self.bodies = [Body.ground(GROUND)]
        self.joints: list[Joint] = []
        self.names: list[str | None] = [GROUND] + [None] * (self._model.njoints - 1)
        self.coordinate_keys: dict[str, Key] = {}
        # chains of joints that end on a massless link, by number of the last joint; the next joint of the
        # link continues the chain
        massless_chains: dict[int, list[int]] = {}
        for index in range(1, self._model.njoints):
            chain = [*massless_chains.pop(int(self._model.parents[index]), []), index]
            if self._model.inertias[index].mass > 0.0:
                self._add_body(chain, motors, report)
            else:
                self._check_massless(index)
                massless_chains[index] = chain
        # chains at whose end no mass follows
        for chain in massless_chains.values():
            for index in chain:
                element = f"joint {self._model.names[index]!r}"
                report.left_out(element, "it moves no mass: held where it is", moves_nothing=True)
        if not self.joints:
            raise SourceError(path, "no joint moves any mass")
        self._report_links(report)

    def _link(self, joint: int) -> str:
        """Return the name of the link that a joint leads to, or the name of the joint without a link."""
        model: Any = self._model
        links = (f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == joint)
        return str(next(links, model.names[joint]))

    def _check_massless(self, joint: int) -> None:
        """Raise `SourceError` if the massless link of a joint has moments of inertia."""
        inertia = self._model.inertias[joint].inertia
        if np.any(inertia):
            moments = ", ".join(f"{moment:.6g}" for moment in np.linalg.eigvalsh(inertia))
            problem = (
                f"link {self._link(joint)!r}: a mass of 0 kg with principal moments of inertia {moments}"
            )
            raise SourceError(self._path, f"{problem} kg m^2; needed: a mass above 0, or no inertia")

    def _add_body(self, chain: list[int], motors: set[str], report: ImportReport) -> None:
        """Add a body and its joint.

        Args:
            chain: numbers of Pinocchio's joints from the parent body to the body.
            motors: names of joints with a motor.
            report: report that receives the entries of the joints.
        """
        model, data = self._model, self._start.data
        # the body
        last = chain[-1]
        taken = [body.name for body in self.bodies]
        name = self.names[last] = unique_name(self._link(last), f"body_{last}", taken)
        inertia, pose = model.inertias[last], data.oMi[last]
        # principal moments a <= b <= c of a real body satisfy a + b >= c; Pinocchio also simulates others
        a, b, c = np.linalg.eigvalsh(inertia.inertia)
        quaternion = pin.SE3ToXYZQUAT(pose)[W_X_Y_Z]
        self.bodies.append(
            Body(
                name,
                inertia.mass,
                pose.act(inertia.lever),
                0.5 * (inertia.inertia + inertia.inertia.T),
                quaternion / np.linalg.norm(quaternion),
                allow_unrealisable_inertia=bool(a + b < c * (1.0 - REALISABLE_TOLERANCE)),
            )
        )
        parent = self.names[int(model.parents[chain[0]])]
        if parent is None:
            holder = self._link(int(model.parents[chain[0]]))
            raise SourceError(self._path, f"link {holder!r} has several joints and no mass; give it a mass")
        # its joint, a free joint or a combination of the motions of the chain. Several of Pinocchio's joints
        # can come from one joint of the URDF; `closed_model`, the model with its loop closures, has the name
        names = list(dict.fromkeys(self._start.closed_model.urdf_joints[k] for k in chain))
        wanted_name = names[0] if len(names) == 1 else common_name(names) or f"{name}_joints"
        joint_name = unique_name(wanted_name, name, self.joint_names)
        parts = [part for k in chain for part in self._parts(k)]
        if not parts:
            self.joints.append(Free(joint_name, parent, name, pose.translation))
        else:
            actuated = bool(motors & set(names))
            # `coordinates`: number of the coordinate within the joint, by name of the part
            joint, coordinates = combine_motions(joint_name, parent, name, parts, actuated=actuated)
            self.joints.append(joint)
            self.coordinate_keys |= {part: (joint_name, k) for part, k in coordinates.items()}
        for k in names:
            report.imported(f"joint {k!r}", f"{self.joints[-1].kind} joint {joint_name!r}")

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints of the tree in the scene."""
        return [joint.name for joint in self.joints]

    def _parts(self, index: int) -> list[Part]:
        """Return the motions of one of Pinocchio's joints, world frame; an empty list for a free joint."""
        model, pose = self._model, self._start.data.oMi[index]
        joint, name = model.joints[index], str(model.names[index])
        if joint.shortname() == "JointModelFreeFlyer":
            return []
        if joint.shortname() == "JointModelSpherical":
            return [Part(name, "ball", np.zeros(3), pose.translation)]
        columns = pin.computeJointJacobian(model, self._scratch_data, self._start.q, index)
        columns = np.reshape(columns, (6, model.nv))[:, joint.idx_v : joint.idx_v + joint.nv]
        # a column has the linear and the angular velocity of one motion, in the frame of the joint
        parts = []
        for k, column in enumerate(columns.T):
            is_slide = not np.any(column[3:])
            axis = pose.rotation @ (column[:3] if is_slide else column[3:])
            part = name if joint.nv == 1 else f"{name} {k}"
            parts.append(Part(part, "slide" if is_slide else "hinge", axis, pose.translation))
        return parts

    def _report_links(self, report: ImportReport) -> None:
        """Report for each link of the model the body of the scene that the link became or is a part of."""
        for frame in self._model.frames:
            if frame.type == pin.FrameType.BODY:
                body = self.names[frame.parentJoint]
                what = f"body {body!r}" if body == frame.name else f"part of {body!r}"
                report.imported(f"link {frame.name!r}", what if body else "no body, because it has no mass")

    def body_and_point(self, number: int) -> tuple[str, Array]:
        """Return the name of the body and the origin (3,), m, world frame, of Pinocchio's frame `number`.

        Raises:
            SourceError: for a frame on a link without mass.
        """
        frame = self._model.frames[number]
        body = self.names[frame.parentJoint]
        if body is None:
            raise SourceError(
                self._path, f"a loop ends on {frame.name!r}, on a link without mass; give the link a mass"
            )
        return body, self._start.data.oMf[number].translation.copy()
