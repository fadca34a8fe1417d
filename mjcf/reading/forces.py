"""Import springs, dampers, rotor inertias and gravity compensation of a compiled model."""

from __future__ import annotations

from itertools import product
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from mjcf.reading.bodies import GROUND, Bodies
from mjcf.reading.joints import BALL, FREE, GearGroups, Joints
from mjcf.reading.loops import fixed_tendon_weights, straight_tendon_ends
from mjcf.reading.start import ModelAtStart
from newton_euler.model.forces import BallSpring, Force, JointSpring, PointSpring, Wrench
from newton_euler.model.joint import Key
from newton_euler.reading.import_report import FORCE, ROTOR, ImportReport, unique_name
from newton_euler.scalars import Array


class Forces:
    """Imported forces on joints and bodies, without gravity and actuators.

    Attributes:
        forces: springs and wrenches.
    """

    def __init__(
        self,
        start: ModelAtStart,
        bodies: Bodies,
        joints: Joints,
        gear_groups: GearGroups,
        gravity: Array,
        report: ImportReport,
    ) -> None:
        self._start, self._model, self._data = start, start.model, start.data
        self._bodies, self._joints, self._gear_groups, self._report = bodies, joints, gear_groups, report
        self.forces: list[Force] = []
        self._springs, self._dampers = not start.disabled("SPRING"), not start.disabled("DAMPER")
        for number in range(self._model.njnt):
            self._add_joint(number)
        for tendon in range(self._model.ntendon):
            self._add_tendon(tendon)
        for body in np.flatnonzero(self._model.body_gravcomp):
            self._add_compensation(int(body), gravity)

    def name(self, wanted: str, fallback: str) -> str:
        """Return a name that no point spring or wrench has yet."""
        named = (force.name for force in self.forces if isinstance(force, PointSpring | Wrench))
        return unique_name(wanted, fallback, named)

    def _linear(
        self, element: str, spring: tuple[float, Array], damper: tuple[float, Array]
    ) -> tuple[float, float]:
        """Return stiffness and damping, 0 if the file disables them, and report nonlinear coefficients."""
        (stiffness, bent), (damping, bent_rate) = spring, damper
        if (self._springs and np.any(bent)) or (self._dampers and np.any(bent_rate)):
            why = "the nonlinear part of its stiffness or damping"
            self._report.left_out(element, why, topic="not linear")
        return float(stiffness) * self._springs, float(damping) * self._dampers

    def _add_joint(self, number: int) -> None:
        model, element = self._model, element_name(self._model, "joint", number)
        dof, place = int(model.jnt_dofadr[number]), int(model.jnt_qposadr[number])
        spring = model.jnt_stiffness[number], model.jnt_stiffnesspoly[number]
        damper = model.dof_damping[dof], model.dof_dampingpoly[dof]
        stiffness, damping = self._linear(element, spring, damper)
        if stiffness == 0.0 and damping == 0.0:
            return
        what = f"its stiffness {stiffness:g} and damping {damping:g}"
        if number in self._joints.coordinate_keys:
            joint, coordinate = self._joints.coordinate_keys[number]
            rest = float(self._reference(number)[0] - self._data.qpos[place])
            self._add_spring(JointSpring(joint, stiffness, damping, rest, coordinate))
            self._report.imported(element, f"{what} as a spring", FORCE if stiffness else "")
            return
        joint = self._joints.joint_names[number]
        if model.jnt_type[number] == FREE:
            rests = self._reference(number)[:3] - self._data.qpos[place : place + 3]
            for coordinate, rest in enumerate(rests.tolist()):
                self._add_spring(JointSpring(joint, stiffness, damping, rest, coordinate))
            place += 3
        self.forces.append(BallSpring(joint, stiffness, damping, self._rest(number, place)))
        self._report.imported(element, f"{what} as a spring of all its motions", FORCE)

    def _add_spring(self, spring: JointSpring) -> None:
        """Add a spring, combined with a spring that its coordinate already has."""
        key = spring.joint, spring.coordinate
        for place, other in enumerate(self.forces):
            if isinstance(other, JointSpring) and (other.joint, other.coordinate) == key:
                stiffness = other.stiffness + spring.stiffness
                moments = other.stiffness * other.rest + spring.stiffness * spring.rest
                rest = moments / stiffness if stiffness else 0.0
                damping = other.damping + spring.damping
                self.forces[place] = JointSpring(spring.joint, stiffness, damping, rest, spring.coordinate)
                return
        self.forces.append(spring)

    def _reference(self, number: int) -> Array:
        """Return the rest of a joint's spring as a part of qpos; the rest of a yielding spring is a state."""
        model = self._model
        size = {int(FREE): 7, int(BALL): 4}.get(int(model.jnt_type[number]), 1)
        place, plastic = model.jnt_qposadr[number], model.jnt_plasticadr[number]
        if plastic < 0:
            return np.asarray(model.qpos_spring[place : place + size])
        limit = float(model.jnt_springyield[number])
        if limit < np.pi or model.jnt_type[number] != BALL:
            self._report_yield(element_name(self._model, "joint", number), limit)
        return np.asarray(self._data.plastic[plastic : plastic + size])

    def _report_yield(self, element: str, limit: float) -> None:
        why = f"its spring yields beyond {limit:g}; springs of scenes are elastic"
        self._report.left_out(element, why, topic="yield", numbers=[limit])

    def _rest(self, number: int, place: int) -> Array:
        """Return the rest (3,) of a ball's spring, see `BallSpring`; `place` is the quaternion's in qpos."""
        turned = np.empty(3)
        mujoco.mju_subQuat(turned, self._reference(number)[-4:], self._data.qpos[place : place + 4])
        child = int(self._model.jnt_bodyid[number])
        in_world = self._data.xmat[child].reshape(3, 3) @ turned
        (joint,) = (joint for joint in self._joints.joints if joint.name == self._joints.joint_names[number])
        return np.asarray(in_world if joint.second == self._bodies.names[child] else -in_world)

    def _add_tendon(self, tendon: int) -> None:
        model = self._model
        element = element_name(model, "tendon", tendon)
        spring = model.tendon_stiffness[tendon], model.tendon_stiffnesspoly[tendon]
        damper = model.tendon_damping[tendon], model.tendon_dampingpoly[tendon]
        stiffness, damping = self._linear(element, spring, damper)
        if stiffness == 0.0 and damping == 0.0:
            return
        what = f"its stiffness {stiffness:g} and damping {damping:g}"
        low, high = (float(x) for x in model.tendon_lengthspring[tendon])
        plastic = int(model.tendon_plasticadr[tendon])
        if plastic >= 0:
            low, high = (float(x) for x in self._data.plastic[plastic : plastic + 2])
            self._report_yield(element, float(model.tendon_springyield[tendon]))
        ends = straight_tendon_ends(self._start, tendon)
        weights = fixed_tendon_weights(self._start, tendon)
        if low != high and stiffness:
            self._report.left_out(
                element,
                f"{what}: springs of scenes are never slack, as this is between {low:g} and {high:g} m",
            )
        elif weights is not None:
            self._add_fixed_tendon(tendon, element, what, weights, JointSpring("", stiffness, damping, low))
        elif ends is None:
            self._report.left_out(
                element, f"{what}: point springs are straight, and this tendon bends around sites or geoms"
            )
        else:
            self._add_straight(tendon, element, what, ends, (stiffness, damping, max(low, 0.0)))

    def _add_fixed_tendon(
        self, tendon: int, element: str, what: str, weights: dict[int, float], along: JointSpring
    ) -> None:
        """Add the spring of a fixed tendon at the first coordinate of its sum, which the others follow."""
        slopes = self._gear_groups.slopes(
            {self._joints.coordinate_keys[joint]: w for joint, w in weights.items()}
        )
        if slopes is None:
            why = f"{what}: it acts on a sum of {len(weights)} joint coordinates that no gears couple"
            self._report.left_out(element, why)
            return
        (joint, coordinate), slope = next(iter(slopes.items()))
        if slope == 0.0:
            why = f"{what}: equalities keep its length constant, so that it does no work"
            self._report.left_out(element, why, moves_nothing=True)
            return
        rest = (along.rest - float(self._data.ten_length[tendon])) / slope
        stiffness, damping = along.stiffness * slope * slope, along.damping * slope * slope
        self._add_spring(JointSpring(joint, stiffness, damping, rest, coordinate))
        how = f"{what} as a spring of joint {joint!r}, which determines its length"
        self._report.imported(element, how, FORCE if stiffness else "")

    def _add_straight(
        self,
        tendon: int,
        element: str,
        what: str,
        ends: tuple[tuple[int, Array], tuple[int, Array]],
        values: tuple[float, float, float],
    ) -> None:
        """Add a point spring between two sites; `values` are stiffness, damping and rest length."""
        (first, p), (second, q) = ends
        names = self._bodies.names[first], self._bodies.names[second]
        if names[0] == names[1]:
            self._report.left_out(
                element, f"{what}: both its ends are parts of {names[0]!r}", moves_nothing=True
            )
            return
        stiffness, damping, rest = values
        name = self._model.tendon(tendon).name
        own = self.name(name.removeprefix("spring "), f"tendon_{tendon}")
        spring = PointSpring(own, *names, p, q, stiffness=stiffness, rest_length=rest, damping=damping)
        self.forces.append(spring)
        self._report.imported(element, f"{what} as point spring {spring.name!r}", FORCE)

    def _add_compensation(self, body: int, gravity: Array) -> None:
        name = self._bodies.names[body]
        share = float(self._model.body_gravcomp[body])
        force = -share * float(self._model.body_mass[body]) * gravity
        element = element_name(self._model, "body", body)
        if name == GROUND or not np.any(force):
            return
        if not (self._springs or self._dampers):
            why = "MuJoCo applies no gravity compensation if the file disables springs and dampers"
            self._report.left_out(element, f"gravity compensation {share:g}: {why}", moves_nothing=True)
            return
        wrench = self.name(f"{self._model.body(body).name}_gravcomp", f"gravcomp_{body}")
        self.forces.append(Wrench(wrench, name, self._data.xipos[body].copy(), force))
        self._report.imported(element, f"gravity compensation {share:g} as wrench {wrench!r}", FORCE)


def armatures(
    start: ModelAtStart, joints: Joints, gear_groups: GearGroups, report: ImportReport
) -> tuple[dict[Key, float], dict[str, float]]:
    """Return rotor inertias, kg m^2 or kg, by joint coordinate, and rotor inertias of balls by joint."""
    model: Any = start.model
    found: dict[Key, float] = {}
    balls: dict[str, float] = {}
    for number in range(model.njnt):
        inertia = float(model.dof_armature[model.jnt_dofadr[number]])
        if inertia == 0.0:
            continue
        element = element_name(model, "joint", number)
        if number in joints.coordinate_keys:
            key = joints.coordinate_keys[number]
            found[key] = found.get(key, 0.0) + inertia
        else:
            balls[joints.joint_names[number]] = inertia
            if model.jnt_type[number] == FREE:
                found |= {(joints.joint_names[number], coordinate): inertia for coordinate in range(3)}
        report.imported(element, f"its armature {inertia:g}", ROTOR)
    for tendon in np.flatnonzero(model.tendon_armature):
        element = element_name(model, "tendon", int(tendon))
        inertia = float(model.tendon_armature[tendon])
        weights = fixed_tendon_weights(start, int(tendon)) or {}
        rotor = reduced_inertia(start, joints, gear_groups, weights, inertia)
        if rotor is None:
            why = f"its armature {inertia:g}: no single joint coordinate determines its length"
            report.left_out(element, why, topic="armature")
            continue
        key, reduced = rotor
        found[key] = found.get(key, 0.0) + reduced
        how = f"its armature {inertia:g} at joint {key[0]!r}, which determines its length"
        report.imported(element, how, ROTOR)
    return found, balls


def reduced_inertia(
    start: ModelAtStart, joints: Joints, gear_groups: GearGroups, moments: dict[int, float], inertia: float
) -> tuple[Key, float] | None:
    """Reduce an inertia along a sum of joint coordinates to the first coordinate.

    MuJoCo's mass matrix has no entries for pairs of joints in different branches, and omits their part.

    Returns:
        The coordinate and its inertia; None unless gears couple all coordinates to the first.
    """
    rates = gear_groups.rates(joints.coordinate_keys[joint] for joint in moments)
    if rates is None:
        return None
    total = 0.0
    for one, two in product(moments, moments):
        if _one_branch(start, one, two):
            total += (
                moments[one]
                * moments[two]
                * rates[joints.coordinate_keys[one]]
                * rates[joints.coordinate_keys[two]]
            )
    return next(iter(rates)), inertia * total


def _one_branch(start: ModelAtStart, one: int, two: int) -> bool:
    """True if two hinges or slides are the same, or one is an ancestor of the other."""
    model: Any = start.model
    low, high = (int(x) for x in sorted((model.jnt_dofadr[one], model.jnt_dofadr[two])))
    while high > low:
        high = int(model.dof_parentid[high])
    return high == low
