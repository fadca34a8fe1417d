"""Import bodies and tree joints of a Pinocchio model; joints of massless links become one joint."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Free
from newton_euler.model.joint_parts import Part, combined, common_name
from newton_euler.model.mechanism import REALISABLE_TOLERANCE, Body
from newton_euler.reading.import_report import ImportReport, unique_name
from newton_euler.scalars import Array
from urdf.reading.source import SourceError
from urdf.reading.start import RobotAtStart

GROUND = "ground"


class Tree:
    """Imported bodies and tree joints.

    Attributes:
        bodies: bodies of the scene, ground first.
        joints: one joint for each moving body.
        names: for each of Pinocchio's joints, the body that the joint moves; None for a massless link.
        keys: joint and coordinate of each of Pinocchio's hinges and slides, by name; coordinates are zero at
            the start.
    """

    def __init__(self, path: str, start: RobotAtStart, motors: set[str], report: ImportReport) -> None:
        """Import bodies and joints; `motors` are the names of joints with a motor."""
        self._path, self._model, self._start = path, start.model, start
        self._scratch: Any = start.model.createData()
        self.bodies = [Body.ground(GROUND)]
        self.joints: list[Joint] = []
        self.names: list[str | None] = [GROUND] + [None] * (self._model.njoints - 1)
        self.keys: dict[str, Key] = {}
        waiting: dict[int, list[int]] = {}
        for index in range(1, self._model.njoints):
            chain = [*waiting.pop(int(self._model.parents[index]), []), index]
            if self._model.inertias[index].mass > 0.0:
                self._add(chain, motors, report)
            else:
                self._check_massless(index)
                waiting[index] = chain
        for chain in waiting.values():
            for index in chain:
                element = f"joint {self._model.names[index]!r}"
                report.left_out(element, "it moves no mass: held where it is", moves_nothing=True)
        if not self.joints:
            raise SourceError(path, "no joint moves any mass")
        self._report_links(report)

    def _link(self, joint: int) -> str:
        """Name of the link that a joint leads to, of the joint if it has none."""
        model: Any = self._model
        links = (f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == joint)
        return str(next(links, model.names[joint]))

    def _check_massless(self, joint: int) -> None:
        """Raise `SourceError` for what moves with a joint and has inertia, but no mass: bodies need both."""
        inertia = self._model.inertias[joint].inertia
        if np.any(inertia):
            moments = ", ".join(f"{moment:.6g}" for moment in np.linalg.eigvalsh(inertia))
            problem = (
                f"link {self._link(joint)!r}: a mass of 0 kg with principal moments of inertia {moments}"
            )
            raise SourceError(self._path, f"{problem} kg m^2; needed: a mass above 0, or no inertia")

    def _add(self, chain: list[int], motors: set[str], report: ImportReport) -> None:
        model, data = self._model, self._start.data
        last = chain[-1]
        own = [body.name for body in self.bodies]
        name = self.names[last] = unique_name(self._link(last), f"body_{last}", own)
        inertia, pose = model.inertias[last], data.oMi[last]
        a, b, c = np.linalg.eigvalsh(inertia.inertia)
        quaternion = pin.SE3ToXYZQUAT(pose)[[6, 3, 4, 5]]
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
        names = list(dict.fromkeys(self._start.robot.urdf_joints[k] for k in chain))
        own_name = names[0] if len(names) == 1 else common_name(names) or f"{name}_joints"
        joint_name = unique_name(own_name, name, self.joint_names)
        parts = [part for k in chain for part in self._parts(k)]
        if not parts:
            self.joints.append(Free(joint_name, parent, name, pose.translation))
        else:
            driven = bool(motors & set(names))
            joint, coordinates = combined(joint_name, parent, name, parts, driven)
            self.joints.append(joint)
            self.keys |= {part: (joint_name, k) for part, k in coordinates.items()}
        for k in names:
            report.imported(f"joint {k!r}", f"{self.joints[-1].kind} joint {joint_name!r}")

    @property
    def joint_names(self) -> list[str]:
        return [joint.name for joint in self.joints]

    def _parts(self, index: int) -> list[Part]:
        """Return the motions of one of Pinocchio's joints; none for a free joint."""
        model, pose = self._model, self._start.data.oMi[index]
        joint, name = model.joints[index], str(model.names[index])
        if joint.shortname() == "JointModelFreeFlyer":
            return []
        if joint.shortname() == "JointModelSpherical":
            return [Part(name, "ball", np.zeros(3), pose.translation)]
        columns = pin.computeJointJacobian(model, self._scratch, self._start.q, index)
        columns = np.reshape(columns, (6, model.nv))[:, joint.idx_v : joint.idx_v + joint.nv]
        parts = []
        for k, column in enumerate(columns.T):
            slides = not np.any(column[3:])
            axis = pose.rotation @ (column[:3] if slides else column[3:])
            part = name if joint.nv == 1 else f"{name} {k}"
            parts.append(Part(part, "slide" if slides else "hinge", axis, pose.translation))
        return parts

    def _report_links(self, report: ImportReport) -> None:
        for frame in self._model.frames:
            if frame.type == pin.FrameType.BODY:
                body = self.names[frame.parentJoint]
                what = f"body {body!r}" if body == frame.name else f"part of {body!r}"
                report.imported(f"link {frame.name!r}", what if body else "no body, because it has no mass")

    def end(self, frame: int) -> tuple[str, Array]:
        """Return the body and the place (3,), m, world frame, of one of Pinocchio's frames."""
        found = self._model.frames[frame]
        body = self.names[found.parentJoint]
        if body is None:
            raise SourceError(
                self._path, f"a loop ends on {found.name!r}, on a link without mass; give the link a mass"
            )
        return body, self._start.data.oMf[frame].translation.copy()
