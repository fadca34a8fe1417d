"""Pinocchio model with loop closures as the reference model of a scene.

See `newton_euler.reading`. Loop closures, couplings and mimics are constraint rows. `urdf.reference` derives
the reference models of URDF files and of models in memory from the class of this module.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from newton_euler.equations.system import MassProperties
from newton_euler.model.couplings import MAX_DEGREE
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportReport, left_out, unique_name
from newton_euler.reading.quantities import Constraints, Forces, Kinematics
from newton_euler.reading.reference import MAX_HINGE_ROW_ANGLE, ReferenceModel, Sample, names_of_wholes
from newton_euler.scalars import Array, cross, tilde
from urdf.constraints import power_sums
from urdf.loops import REVOLUTE


class Closure(NamedTuple):
    """Loop closure between two frames.

    Attributes:
        element: name in reports.
        kind: one of `urdf.loops.CLOSURE_TYPES`.
        first: number of the first frame.
        second: number of the second frame, which no other closure has.
    """

    element: str
    kind: str
    first: int
    second: int


class PinocchioReference(ReferenceModel):
    """Reference model of a Pinocchio model with loop closures."""

    def __init__(
        self, model: Any, owners: Sequence[str], closures: list[Closure], report: ImportReport, scene: Scene
    ) -> None:
        """Take over a model.

        Args:
            model: `pinocchio.Model` with the gravity of the scene, which is changed.
            owners: name in reports of each joint.
            closures: loop closures.
            report: import report.
            scene: imported scene; its initial pose selects the start among the closed configurations.
        """
        self._model, self._of, self._closures = model, owners, closures
        self._without, self._report = left_out(report), report
        self._lengths: dict[int, float] = {}
        self._data: Any = model.createData()
        self._damping, self._stiffness, self._rests = np.zeros((3, model.nv))
        self._springs: list[tuple[str, tuple[int, int], float, float, float]] = []
        self._rows, self._offsets, self._owners = np.zeros((0, model.nv)), np.zeros(0), list[str]()
        self._bent = np.zeros((0, MAX_DEGREE, model.nv))  # factors of second and higher powers
        self._name(scene)

    def _begin(self, q: Array, opened: Array, scene: Scene) -> None:
        """Find the start next to a configuration (nq,); `opened` are the errors of coupling rows there."""
        self._from, self._open = q, opened
        self.stated = q, np.zeros(self._model.nv)
        self.begin(scene)
        self.keep_offsets()

    def _name(self, scene: Scene) -> None:
        model, self.size = self._model, scene.mechanism.size
        self._joints = [k for k in range(1, model.njoints) if model.inertias[k].mass > 0.0]
        taken = ["ground"]
        for k in self._joints:
            bodies = (f.name for f in model.frames if f.type == pin.FrameType.BODY and f.parentJoint == k)
            taken.append(unique_name(str(next(bodies, model.names[k])), f"body_{k}", taken))
        self.names = names_of_wholes(taken[1:], scene.mechanism.body_names)
        massless = {k for k in range(1, model.njoints) if k not in self._joints}
        self.ranges = np.full(model.nv, 3.0)
        names = [""] * model.nv
        data, neutral = model.createData(), pin.neutral(model)
        columns = np.reshape(pin.computeJointJacobians(model, data, neutral), (6, model.nv))
        for k in range(1, model.njoints):
            place = slice(model.joints[k].idx_v, model.joints[k].idx_v + model.joints[k].nv)
            names[place] = [f"joint {self._of[k]!r}"] * model.joints[k].nv
            if k in massless or model.parents[k] in massless:
                self.ranges[place] = MAX_HINGE_ROW_ANGLE
        self.motions = tuple(names)
        self.lengths = ~np.any(columns[3:] != 0.0, axis=0)
        self.units = np.where(self.lengths, self.size, 1.0)

    def _topics(self, element: str) -> set[str]:
        return self._without.get(element, set())

    # Quantities by Pinocchio

    def moved(self, q: Array, step: Array) -> Array:
        return np.asarray(pin.integrate(self._model, q, step))

    def difference(self, q: Array, other: Array) -> Array:
        return np.asarray(pin.difference(self._model, q, other))

    def points(self, q: Array) -> Array:
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, q)
        placed = list(zip(list(data.oMi)[1:], list(model.inertias)[1:], strict=True))
        centers = [pose.act(inertia.lever) for pose, inertia in placed]
        return np.array([*centers, *(pose.translation for pose, _ in placed)])

    def mass_properties(self) -> MassProperties:
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, self.start)
        placed = [data.oMi[k].act(model.inertias[k]) for k in self._joints]
        values = ([i.mass for i in placed], [i.lever for i in placed], [i.inertia for i in placed])
        return MassProperties(*(np.array(value) for value in values))

    def kinematics(self, q: Array, v: Array) -> Kinematics:
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        count = len(self._joints)
        places, turns = np.zeros((count, 3)), np.zeros((count, 3, 3))
        rows, drift = np.zeros((count, 6, model.nv)), np.zeros((count, 6))
        for n, k in enumerate(self._joints):
            pose = data.oMi[k]
            arm = pose.rotation @ model.inertias[k].lever
            places[n], turns[n] = pose.translation + arm, pose.rotation
            columns = pin.getJointJacobian(model, data, k, pin.LOCAL_WORLD_ALIGNED)
            rows[n] = np.reshape(columns, (6, model.nv))
            rows[n, :3] -= tilde(arm) @ rows[n, 3:]
            found = pin.getClassicalAcceleration(model, data, k, pin.LOCAL_WORLD_ALIGNED)
            omega = rows[n, 3:] @ v
            drift[n, 3:] = found.angular
            across = cross(found.angular, arm) + cross(omega, cross(omega, arm))
            drift[n, :3] = found.linear + across
        return Kinematics(places, turns, rows, drift)

    def constraints(self, q: Array) -> Constraints:
        model, data = self._model, self._data
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        residuals, rows, owners = [np.zeros(0)], [np.zeros((0, model.nv))], list[str]()
        for number, (element, kind, first, second) in enumerate(self._closures):
            a, b = data.oMf[first], data.oMf[second]
            line, apart = a.translation - b.translation, self._moving(first) - self._moving(second)
            before = len(rows)
            if kind != "rod":
                residuals.append(line / self.size)
                rows.append(apart[:3] / self.size)
            elif number in self._lengths:  # the length of a rod is known after the start is found
                length = np.linalg.norm(line)
                residuals.append(np.array([length - self._lengths[number]]) / self.size)
                rows.append((line / length @ apart[:3])[None] / self.size)
            if (
                kind == REVOLUTE
            ):  # the x axis of the first frame is perpendicular to the y and z axes of the second
                along, across = a.rotation[:, 0], b.rotation[:, 1:].T
                residuals.append(across @ along)
                rows.append(np.cross(along, across) @ apart[3:])
            if kind == "6d":
                turn = a.rotation.T @ b.rotation
                residuals.append(pin.log3(turn))
                rows.append(-pin.Jlog3(turn) @ b.rotation.T @ apart[3:])
            owners += [element] * sum(map(len, rows[before:]))
        # couplings and mimics
        x = pin.difference(model, pin.neutral(model), q)
        bent = np.sum(power_sums(self._bent, x, 0), axis=1)
        residuals.append(self._rows @ pin.difference(model, self._from, q) + self._open + bent)
        jacobian = np.concatenate([*rows, self._rows + power_sums(self._bent, x, 1)]) * self.units
        return Constraints(np.concatenate(residuals), jacobian, [*owners, *self._owners])

    def keep_offsets(self) -> None:
        model, data = self._model, self._data
        pin.framesForwardKinematics(model, data, self.start)
        for number, (_, kind, first, second) in enumerate(self._closures):
            if kind == "rod":
                line = data.oMf[first].translation - data.oMf[second].translation
                self._lengths[number] = float(np.linalg.norm(line))
            else:
                joint = data.oMi[model.frames[second].parentJoint]
                wanted = (
                    data.oMf[first]
                    if kind in ("6d", REVOLUTE)
                    else pin.SE3(np.eye(3), data.oMf[first].translation)
                )
                model.frames[second].placement = joint.actInv(wanted)
        self._from, self._open = self.start, np.zeros(len(self._open))
        self._data = model.createData()

    def _moving(self, frame: int) -> Array:
        """Return the Jacobian (6, nv) of a frame's linear and angular velocity, world axes."""
        found = pin.getFrameJacobian(self._model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)
        return np.reshape(found, (6, self._model.nv))

    def mass_matrix(self, q: Array) -> tuple[Array, Array]:
        upper = np.triu(pin.crba(self._model, self._data, q))
        rotors = np.diag(self._model.armature)
        return upper + np.triu(upper, 1).T - rotors, rotors

    def forces(self, q: Array, v: Array) -> Forces:
        weight = -np.array(pin.computeGeneralizedGravity(self._model, self._data, q))
        bias = np.array(pin.nonLinearEffects(self._model, self._data, q, v)) + weight
        springs, dampers = -self._stiffness * (self._coordinates(q) - self._rests), -self._damping * v
        for name, *_ in self._springs:
            pulls = self._pulls(name, q, v)
            springs, dampers = springs + pulls[0], dampers + pulls[1]
        return Forces(weight, springs, dampers, np.zeros(len(v)), bias)

    def _coordinates(self, q: Array) -> Array:
        """Return the coordinates (nv,) of hinges and slides."""
        return np.asarray(pin.difference(self._model, pin.neutral(self._model), q))

    def _pulls(self, spring: str, q: Array, v: Array) -> tuple[Array, Array, float]:
        """Return generalized forces (nv,) of a point spring and of its damper, and its energy, J."""
        model, data = self._model, self._data
        frames, stiffness, rest, damping = next(each[1:] for each in self._springs if each[0] == spring)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        first, second = frames
        line = data.oMf[second].translation - data.oMf[first].translation
        length = float(np.linalg.norm(line))
        rate = line / length @ (self._moving(second) - self._moving(first))[:3]
        stretch = length - rest
        return -stiffness * stretch * rate, -damping * (rate @ v) * rate, 0.5 * stiffness * stretch**2

    def energies(self, q: Array, v: Array) -> tuple[float, float]:
        kinetic = pin.computeKineticEnergy(self._model, self._data, q, v)
        potential = float(pin.computePotentialEnergy(self._model, self._data, q))
        potential += float(0.5 * self._stiffness @ (self._coordinates(q) - self._rests) ** 2)
        potential += sum(self._pulls(name, q, v)[2] for name, *_ in self._springs)
        return float(kinetic), potential

    def elements(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[list[Array]]]]:
        gravity, weights = self._model.gravity.linear.copy(), []
        for axis in np.eye(3):
            self._model.gravity.linear = axis
            alone = [np.array(self.forces(sample.q, sample.v)[:-1]) for sample in samples]
            weights.append([forces * np.eye(4)[0][:, None] for forces in alone])
        self._model.gravity.linear = gravity
        yield "gravity", weights
        for name in dict.fromkeys(self.motions):
            own, found = np.array([motion == name for motion in self.motions]), []
            for sample in samples:
                forces = np.array(self.forces(sample.q, sample.v)[:-1])
                found.append(np.where(own, forces, 0.0) * (1.0 - np.eye(4)[0][:, None]))
            if np.any(found):
                what = "stiffness and damping" if np.any(self._stiffness[own]) else "damping"
                yield f"{name}: {what}", [found]
        for name, *_ in self._springs:
            pulls = [self._pulls(name, sample.q, sample.v) for sample in samples]
            yield f"spring {name!r}", [[np.array([0.0 * k, k, d, 0.0 * d]) for k, d, _ in pulls]]

    def rotors(self, samples: Sequence[Sample]) -> Iterator[tuple[str, list[Array]]]:
        for name in dict.fromkeys(self.motions):
            own = np.array([motion == name for motion in self.motions])
            if np.any(self._model.armature[own]):
                yield name, [np.diag(np.where(own, self._model.armature, 0.0))] * len(samples)
