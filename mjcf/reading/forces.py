"""Import springs, dampers, armatures and gravity compensation of a compiled MuJoCo model, for `mjcf.reader`.

An armature is the rotor inertia of a joint, tendon or actuator. The length of a fixed tendon is a weighted
sum of joint coordinates. If gears make these coordinates proportional to each other, the tendon's spring,
damper or armature becomes one of a single joint coordinate. Joint coordinates of a scene are 0 at the start.
The report has the kind of each imported element's counterpart: `FORCE`, `ROTOR`, or "" for all others.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from mjcf.loops import fixed_tendon_weights
from mjcf.reading.bodies import GROUND, Bodies
from mjcf.reading.joints import BALL, FREE, GearGroups, Joints
from mjcf.reading.loops import straight_tendon_ends
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
        """Import and report the springs and dampers of all joints and tendons, and gravity compensation.

        Args:
            start: MuJoCo's model and data at the start state.
            bodies: imported bodies.
            joints: imported joints of the tree.
            gear_groups: joint coordinates that gears make proportional to each other.
            gravity: (3,) m/s^2.
            report: report that receives the entries.
        """
        self._start, self._model, self._data = start, start.model, start.data
        self._bodies, self._joints, self._gear_groups, self._report = bodies, joints, gear_groups, report
        self.forces: list[Force] = []
        self._has_springs, self._has_dampers = not start.disabled("SPRING"), not start.disabled("DAMPER")
        for number in range(self._model.njnt):
            self._add_joint(number)
        for tendon in range(self._model.ntendon):
            self._add_tendon(tendon)
        for body in np.flatnonzero(self._model.body_gravcomp):
            self._add_compensation(int(body), gravity)

    def name(self, wanted: str, fallback: str) -> str:
        """Return a name that no point spring or wrench has yet."""
        taken = (force.name for force in self.forces if isinstance(force, PointSpring | Wrench))
        return unique_name(wanted, fallback, taken)

    def _linear(
        self, element: str, spring: tuple[float, Array], damper: tuple[float, Array]
    ) -> tuple[float, float]:
        """Return stiffness and damping, and report their nonlinear coefficients as left out.

        Args:
            element: name of the element in the report.
            spring: stiffness, and MuJoCo's coefficients of higher powers of the deflection.
            damper: damping, and MuJoCo's coefficients of higher powers of the rate.

        Returns:
            Stiffness and damping, SI; 0 if the file disables springs or dampers.
        """
        (stiffness, spring_powers), (damping, damper_powers) = spring, damper
        if (self._has_springs and np.any(spring_powers)) or (self._has_dampers and np.any(damper_powers)):
            why = "the nonlinear part of its stiffness or damping"
            self._report.left_out(element, why, topic="not linear")
        return float(stiffness) * self._has_springs, float(damping) * self._has_dampers

    def _add_joint(self, number: int) -> None:
        """Add the spring and damper of MuJoCo's joint `number`."""
        model, element = self._model, element_name(self._model, "joint", number)
        dof, qpos_index = int(model.jnt_dofadr[number]), int(model.jnt_qposadr[number])
        spring = model.jnt_stiffness[number], model.jnt_stiffnesspoly[number]
        damper = model.dof_damping[dof], model.dof_dampingpoly[dof]
        stiffness, damping = self._linear(element, spring, damper)
        if stiffness == 0.0 and damping == 0.0:
            return
        if stiffness:
            what = f"its stiffness {stiffness:g} and damping {damping:g} as a spring"
        else:
            what = f"its damping {damping:g} as a damper"
        # hinge or slide
        if number in self._joints.coordinate_keys:
            joint, coordinate = self._joints.coordinate_keys[number]
            rest = float(self._spring_reference(number)[0] - self._data.qpos[qpos_index])
            self._add_spring(JointSpring(joint, stiffness, damping, rest, coordinate))
            self._report.imported(element, what, FORCE if stiffness else "")
            return
        # ball, or free joint: three translations (coordinates 0 to 2) and a ball
        joint = self._joints.joint_names[number]
        if model.jnt_type[number] == FREE:
            rests = self._spring_reference(number)[:3] - self._data.qpos[qpos_index : qpos_index + 3]
            for coordinate, rest in enumerate(rests.tolist()):
                self._add_spring(JointSpring(joint, stiffness, damping, rest, coordinate))
            qpos_index += 3
        rest_rotation = self._rest_rotation(number, qpos_index)
        self.forces.append(BallSpring(joint, stiffness, damping, rest_rotation))
        self._report.imported(element, f"{what} of all its motions", FORCE)

    def _add_spring(self, spring: JointSpring) -> None:
        """Add a spring of a joint coordinate; two springs of the same coordinate become one spring."""
        key = spring.joint, spring.coordinate
        for index, other in enumerate(self.forces):
            if isinstance(other, JointSpring) and (other.joint, other.coordinate) == key:
                stiffness = other.stiffness + spring.stiffness
                # the forces add up: k rest = k_1 rest_1 + k_2 rest_2 with k = k_1 + k_2
                weighted_rests = other.stiffness * other.rest + spring.stiffness * spring.rest
                rest = weighted_rests / stiffness if stiffness else 0.0
                damping = other.damping + spring.damping
                self.forces[index] = JointSpring(spring.joint, stiffness, damping, rest, spring.coordinate)
                return
        self.forces.append(spring)

    def _spring_reference(self, number: int) -> Array:
        """Return the configuration of a joint, a part of qpos, in which its spring exerts no force.

        A spring with MuJoCo's attribute `springyield` deforms plastically: its rest changes, and is part of
        MuJoCo's state (`plastic`). Yielding is reported as left out unless the yield angle of a ball exceeds
        pi, the largest rotation.
        """
        model = self._model
        size = {int(FREE): 7, int(BALL): 4}.get(int(model.jnt_type[number]), 1)  # elements in qpos
        qpos_index, plastic_index = model.jnt_qposadr[number], model.jnt_plasticadr[number]
        if plastic_index < 0:  # not a yielding spring
            return np.asarray(model.qpos_spring[qpos_index : qpos_index + size])
        limit = float(model.jnt_springyield[number])
        if self._has_springs and (limit < np.pi or model.jnt_type[number] != BALL):
            self._report_yield(element_name(self._model, "joint", number), limit)
        return np.asarray(self._data.plastic[plastic_index : plastic_index + size])

    def _report_yield(self, element: str, limit: float) -> None:
        """Report that the spring of an element yields beyond a deflection, m or rad."""
        why = f"its spring yields beyond {limit:g}; springs of scenes are elastic"
        self._report.left_out(element, why, topic="yield")

    def _rest_rotation(self, number: int, quaternion_index: int) -> Array:
        """Return the rest of a ball's spring, as `BallSpring` defines it.

        Args:
            number: number of MuJoCo's ball or free joint.
            quaternion_index: index of the quaternion of the joint in qpos.

        Returns:
            Rotation vector (3,) of the second body from the start to the rest, rad, world frame.
        """
        # rotation vector in the frame of the child, then in the world frame; the quaternion is the last part
        # of a free joint's configuration
        in_child = np.empty(3)
        start_quaternion = self._data.qpos[quaternion_index : quaternion_index + 4]
        mujoco.mju_subQuat(in_child, self._spring_reference(number)[-4:], start_quaternion)
        child = int(self._model.jnt_bodyid[number])
        in_world = self._data.xmat[child].reshape(3, 3) @ in_child
        # opposite sign if the child is the first body of the scene's joint
        (joint,) = (joint for joint in self._joints.joints if joint.name == self._joints.joint_names[number])
        return np.asarray(in_world if joint.second == self._bodies.names[child] else -in_world)

    def _add_tendon(self, tendon: int) -> None:
        """Add the spring and damper of MuJoCo's tendon number `tendon`."""
        model = self._model
        element = element_name(model, "tendon", tendon)
        spring = model.tendon_stiffness[tendon], model.tendon_stiffnesspoly[tendon]
        damper = model.tendon_damping[tendon], model.tendon_dampingpoly[tendon]
        stiffness, damping = self._linear(element, spring, damper)
        if stiffness == 0.0 and damping == 0.0:
            return
        what = f"its stiffness {stiffness:g} and damping {damping:g}"
        # the spring of MuJoCo's tendon exerts no force between two lengths, which are usually equal
        low, high = (float(x) for x in model.tendon_lengthspring[tendon])
        plastic_index = int(model.tendon_plasticadr[tendon])
        if plastic_index >= 0:
            low, high = (float(x) for x in self._data.plastic[plastic_index : plastic_index + 2])
            if stiffness:
                self._report_yield(element, float(model.tendon_springyield[tendon]))
        ends = straight_tendon_ends(self._start, tendon)
        weights = fixed_tendon_weights(self._model, tendon)
        if low != high and stiffness:
            self._report.left_out(
                element,
                f"{what}: springs of scenes are never slack, as this is between {low:g} and {high:g} m",
            )
        elif weights is not None:
            along = JointSpring("", stiffness, damping, rest=low)
            self._add_fixed_tendon(tendon, element, what, weights, along)
        elif ends is None:
            self._report.left_out(
                element, f"{what}: point springs are straight, and this tendon bends around sites or geoms"
            )
        else:
            self._add_straight_tendon(tendon, element, what, ends, (stiffness, damping, max(low, 0.0)))

    def _add_fixed_tendon(
        self, tendon: int, element: str, what: str, weights: dict[int, float], along: JointSpring
    ) -> None:
        """Add the spring of a fixed tendon as a spring of its first joint coordinate.

        The tendon is left out unless gears make all its coordinates proportional to the first one. With the
        length L = L_start + slope x, a spring k of the tendon acts as a spring slope^2 k of x.

        Args:
            tendon: number of the tendon.
            element: name of the tendon in the report.
            what: first words of the entry in the report.
            weights: weight of each of MuJoCo's joints, see `fixed_tendon_weights`.
            along: stiffness, damping and rest of the tendon's length; its joint name is "" and not used.
        """
        slopes = self._gear_groups.slopes(
            {self._joints.coordinate_keys[joint]: w for joint, w in weights.items()}
        )
        if slopes is None:
            why = f"{what}: it acts on a sum of {len(weights)} joint coordinates that no gears couple"
            self._report.left_out(element, why)
            return
        # `slopes` has dL/dx by coordinate x; any of the coordinates can carry the spring
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

    def _add_straight_tendon(
        self,
        tendon: int,
        element: str,
        what: str,
        ends: tuple[tuple[int, Array], tuple[int, Array]],
        values: tuple[float, float, float],
    ) -> None:
        """Add the spring of a straight tendon as a spring between two points.

        Args:
            tendon: number of the tendon.
            element: name of the tendon in the report.
            what: first words of the entry in the report.
            ends: body and point of both ends, see `straight_tendon_ends`.
            values: stiffness, N/m, damping, N s/m, and rest length, m.
        """
        (first, point_on_first), (second, point_on_second) = ends
        names = self._bodies.names[first], self._bodies.names[second]
        if names[0] == names[1]:
            self._report.left_out(
                element, f"{what}: both its ends are parts of {names[0]!r}", moves_nothing=True
            )
            return
        stiffness, damping, rest = values
        # `mjcf.write` puts "spring" in front of the name
        name = self.name(self._model.tendon(tendon).name.removeprefix("spring "), f"tendon_{tendon}")
        spring = PointSpring(
            name,
            *names,
            point_on_first,
            point_on_second,
            stiffness=stiffness,
            rest_length=rest,
            damping=damping,
        )
        self.forces.append(spring)
        self._report.imported(element, f"{what} as point spring {spring.name!r}", FORCE)

    def _add_compensation(self, body: int, gravity: Array) -> None:
        """Add the gravity compensation of a body of MuJoCo as a constant force at the body's center of mass.

        Args:
            body: number of the body.
            gravity: (3,) m/s^2.
        """
        name = self._bodies.names[body]
        fraction = float(self._model.body_gravcomp[body])
        force = -fraction * float(self._model.body_mass[body]) * gravity
        element = element_name(self._model, "body", body)
        if name == GROUND or not np.any(force):
            return
        if not (self._has_springs or self._has_dampers):
            why = "MuJoCo applies no gravity compensation if the file disables springs and dampers"
            self._report.left_out(element, f"gravity compensation {fraction:g}: {why}", moves_nothing=True)
            return
        wrench = self.name(f"{self._model.body(body).name}_gravcomp", f"gravcomp_{body}")
        self.forces.append(Wrench(wrench, name, self._data.xipos[body].copy(), force))
        self._report.imported(element, f"gravity compensation {fraction:g} as wrench {wrench!r}", FORCE)


def armatures(
    start: ModelAtStart, joints: Joints, gear_groups: GearGroups, report: ImportReport
) -> tuple[dict[Key, float], dict[str, float]]:
    """Import the armatures of joints and tendons; for the arguments see `Forces`.

    Returns:
        Rotor inertias, kg m^2 or kg, by joint coordinate, and rotor inertias of balls, kg m^2, by joint.
    """
    model: Any = start.model
    coordinate_armatures: dict[Key, float] = {}
    ball_armatures: dict[str, float] = {}
    for number in range(model.njnt):
        inertia = float(model.dof_armature[model.jnt_dofadr[number]])
        if inertia == 0.0:
            continue
        element = element_name(model, "joint", number)
        if number in joints.coordinate_keys:
            key = joints.coordinate_keys[number]
            coordinate_armatures[key] = coordinate_armatures.get(key, 0.0) + inertia
        else:
            ball_armatures[joints.joint_names[number]] = inertia
            if model.jnt_type[number] == FREE:  # the armature acts on the three translations, too
                for coordinate in range(3):
                    coordinate_armatures[joints.joint_names[number], coordinate] = inertia
        report.imported(element, f"its armature {inertia:g}", ROTOR)
    for tendon in np.flatnonzero(model.tendon_armature):
        element = element_name(model, "tendon", int(tendon))
        inertia = float(model.tendon_armature[tendon])
        weights = (
            fixed_tendon_weights(start.model, int(tendon)) or {}
        )  # {} for other tendons: nothing to reduce to
        reduced = reduced_inertia(start, joints, gear_groups, weights, inertia)
        if reduced is None:
            why = f"its armature {inertia:g}: no single joint coordinate determines its length"
            report.left_out(element, why, topic="armature")
            continue
        key, inertia_of_coordinate = reduced
        coordinate_armatures[key] = coordinate_armatures.get(key, 0.0) + inertia_of_coordinate
        how = f"its armature {inertia:g} at joint {key[0]!r}, which determines its length"
        report.imported(element, how, ROTOR)
    return coordinate_armatures, ball_armatures


def reduced_inertia(
    start: ModelAtStart, joints: Joints, gear_groups: GearGroups, moments: dict[int, float], inertia: float
) -> tuple[Key, float] | None:
    """Reduce the inertia of a sum L = sum_j g_j x_j of joint coordinates to the first coordinate x_1.

    The kinetic energy I (dL/dt)^2 / 2 equals I' (dx_1/dt)^2 / 2 with I' = I sum_ij g_i g_j r_i r_j, where r_j
    is the derivative of x_j by x_1. MuJoCo's mass matrix has no entries for pairs of joints in different
    branches of the tree of bodies. These pairs are omitted here, too.

    Args:
        start: MuJoCo's model and data at the start state.
        joints: imported joints.
        gear_groups: joint coordinates that gears make proportional to each other.
        moments: moment arm g_j by number of MuJoCo's joint.
        inertia: inertia I of the sum, kg or kg m^2.

    Returns:
        The first coordinate and its inertia I'; None unless gears couple all coordinates to the first.
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
    """Return True if two hinges or slides are on one branch of the tree of bodies, or are the same joint."""
    model: Any = start.model
    low, high = (int(x) for x in sorted((model.jnt_dofadr[one], model.jnt_dofadr[two])))
    while high > low:
        high = int(model.dof_parentid[high])
    return high == low
