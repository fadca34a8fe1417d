"""A URDF with its loop file, or a model in memory, as Pinocchio has them, to verify scenes read from them.

See `newton_euler.reading`. Pinocchio parses the file anew. What the loop file says, and mimics, are rows
of constraints here; nothing is shared with `urdf.reading` but the names of elements.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
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
from urdf.extensions import Extensions
from urdf.loops import NO_LOOPS, REVOLUTE, UNIVERSAL, Loops, closure_names, parse_loops

HINGE_MODELS = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}


ARMATURE = "armature"
"""Topic of rotor inertias."""

STIFFNESS = "stiffness"
"""Topic of springs of joints."""


class Closure(NamedTuple):
    """Two frames that something closes, the second its own.

    Attributes:
        element: what reports call it.
        kind: one of `urdf.loops.CLOSURE_TYPES`.
        first, second: numbers of the frames.
    """

    element: str
    kind: str
    first: int
    second: int


class PinocchioReference(ReferenceModel):
    """A Pinocchio model and what closes its loops."""

    def __init__(
        self, model: Any, owners: Sequence[str], closures: list[Closure], report: ImportReport, scene: Scene
    ) -> None:
        """Take over a model.

        Args:
            model: a `pinocchio.Model` that nothing else has, with the gravity of the scene.
            owners: what reports call each of its joints.
            closures: of its frames.
            report: of the reading.
            scene: what was read; its initial pose says which of the closed ones is the start.
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
        """Find the start next to a configuration (nq,), with rows of couplings open by so much."""
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

    # What Pinocchio says

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
            elif number in self._lengths:  # rods have none before the start is found
                length = np.linalg.norm(line)
                residuals.append(np.array([length - self._lengths[number]]) / self.size)
                rows.append((line / length @ apart[:3])[None] / self.size)
            if kind == REVOLUTE:  # the first frame's x axis is perpendicular to the second's y and z axes
                along, across = a.rotation[:, 0], b.rotation[:, 1:].T
                residuals.append(across @ along)
                rows.append(np.cross(along, across) @ apart[3:])
            if kind == "6d":
                turn = a.rotation.T @ b.rotation
                residuals.append(pin.log3(turn))
                rows.append(-pin.Jlog3(turn) @ b.rotation.T @ apart[3:])
            owners += [element] * sum(map(len, rows[before:]))
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
        """(6, nv) velocity of a frame's origin, and angular, in the world."""
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
        """(nv,) of joints of one motion."""
        return np.asarray(pin.difference(self._model, pin.neutral(self._model), q))

    def _pulls(self, spring: str, q: Array, v: Array) -> tuple[Array, Array, float]:
        """Generalized forces (nv,) of a spring between points and of its damper, and its energy, J."""
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


class UrdfReference(PinocchioReference):
    """A URDF and its loop file."""

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
            extensions: the text of the URDF, and what acts in it beyond its links and joints.
            loops: text of the loop file; None if there is none.
            base, gravity: as of `urdf.read`.
            report: of the reading.
            scene: what was read.
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
        for _ in self._followers:  # of followers of followers too
            for follower, driver, multiplier, offset in self._followers:
                guess[follower] = multiplier * guess[driver] + offset
        q = self.moved(pin.neutral(model), guess)
        self._begin(q, self._rows @ guess - self._offsets, scene)

    def _dampers(self) -> Array:
        """(nv,) of the URDF's joints that have one motion."""
        model, found = self._model, np.zeros(self._model.nv)
        numbers = {str(model.names[k]): k for k in range(1, model.njoints) if model.joints[k].nv == 1}
        for joint in self._root.findall("joint"):
            dynamics, name = joint.find("dynamics"), str(joint.get("name"))
            if dynamics is not None and name in numbers and "damping" not in self._topics(f"joint {name!r}"):
                found[model.joints[numbers[name]].idx_v] = float(dynamics.get("damping", 0.0))
        return found

    def _add(self, extensions: Extensions) -> None:
        """Add springs, dampers and rotors of elements that are no joints."""
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
        """Rows of mimics and of coupled joints: factors (c, nv), offsets (c,), owners."""
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
        self._rows, self._owners = np.reshape(rows, (-1, model.nv)), owners
        scale = np.max(np.abs(self._rows * self.units), axis=1, initial=0.0)
        self._rows, self._offsets = self._rows / scale[:, None], np.array(offsets) / scale
        self._bent = np.zeros((len(rows), MAX_DEGREE, model.nv))
        for number, k, place, factor in bent:
            self._bent[number, k, place] = factor / scale[number]

    def _unaccounted(self, report: ImportReport) -> Iterator[str]:
        """Joints, mimics and closures that a report says nothing of."""
        known = {entry.element for entry in report.entries}
        elements = [f"joint {name!r}" for name in self._of[1:] if name != "root_joint"]
        for joint in self._root.findall("joint"):
            if joint.get("type") != "fixed" and joint.find("mimic") is not None:
                elements.append(f"mimic of joint {joint.get('name')!r}")
        elements += [f"closed_loop {' and '.join(pair)}" for pair in self._loops.closed_loop]
        yield from (element for element in elements if element not in known)


class ModelReference(PinocchioReference):
    """A model in memory and its rigid constraints, as they are."""

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
            given, constraints: as of `urdf.read`.
            q: (nq,) where it starts, or next to there.
            gravity: m/s^2.
            report: of the reading.
            scene: what was read.
        """
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
    """Closures of a loop file; second frames are added to the model."""
    frames = {frame.name: k for k, frame in reversed(list(enumerate(model.frames)))}
    found = []
    for number, ((first, second), kind) in enumerate(zip(loops.closed_loop, loops.type, strict=True)):
        copied = pin.Frame(model.frames[frames[second]])
        copied.name, copied.inertia = f"end of closed_loop {number}", pin.Inertia.Zero()
        added = int(model.addFrame(copied, False))
        found.append(Closure(f"closed_loop {first} and {second}", kind, frames[first], added))
    return found


def _built(text: str, loops: Loops, base: str) -> tuple[Any, list[str]]:
    """Pinocchio's model, joints as the loop file has them, and the URDF's joint of each of its joints."""
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
