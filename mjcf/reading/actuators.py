"""Import the actuators of a compiled MuJoCo model as control laws and forces, for `mjcf.reader`.

In the scene, a control keeps its value at the start, or follows a sine about this value that excites the
mechanism. MuJoCo's force on a transmission of length l is gain * ctrl + b_0 + b_1 l + b_2 dl/dt (MuJoCo's
documentation, Computation, section Actuation). For a transmission l = g q of a joint coordinate, let x be q
minus its value at the start. The force on the joint is

    u = g (gain ctrl + b_0) + g^2 b_1 (q_start + x) + g^2 b_2 dx/dt,

a PD law with stiffness -g^2 b_1, damping -g^2 b_2, target 0, and the other terms as feedforward.

If l is a sum of coordinates that gears make proportional to each other, l - l_start = s x for each of the
coordinates. A law on the first coordinate with s instead of g does the same work. If l = sum_j g_j q_j is a
sum of independent coordinates, each coordinate i has the state feedback

    u_i = g_i (gain ctrl + b_0 + b_1 l_start) + g_i sum_j g_j (b_1 x_j + b_2 dx_j/dt).

A sine of the control adds g gain times the sine to the feedforward.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Mapping as ReadOnlyMapping
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from mjcf.loops import fixed_tendon_weights
from mjcf.reading.bodies import GROUND, Bodies
from mjcf.reading.force_limits import (
    FORCE_LIMITS,
    JOINT_TRANSMISSIONS,
    actuator_force_unit,
    distances_from_limits,
    joint_force_unit,
    joint_force_watch,
    limited_tendon,
)
from mjcf.reading.forces import Forces, reduced_inertia
from mjcf.reading.joints import FREE, GearGroups, Joints
from mjcf.reading.laws import Affine, Drive, JointActuation, constant_plus_sines, control_per_activation
from mjcf.reading.start import ModelAtStart
from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.forces import Wrench
from newton_euler.model.joint import Key
from newton_euler.model.smooth_functions import Sine
from newton_euler.reading.activity import Bounds
from newton_euler.reading.import_report import (
    ACTUATOR_LIMIT,
    CONTROL,
    FORCE,
    JOINT_LIMIT,
    ROTOR,
    TENDON_LIMIT,
    ImportReport,
)
from newton_euler.scalars import Array

TRANSMISSION, DYNAMICS, GAIN, BIAS = mujoco.mjtTrn, mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias
"""MuJoCo's types of transmissions, activation dynamics, gains and biases of actuators."""

ACTUATOR_GROUPS = 31
"""Number of groups of actuators that a file can disable, groups 0 to 30: bits of `opt.disableactuator`."""


def driven_joints(model: Any) -> set[int]:
    """Return the numbers of MuJoCo's joints that actuators may drive."""
    joints: set[int] = set()
    for actuator in range(model.nactuator):
        kind, target = TRANSMISSION(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        if kind in JOINT_TRANSMISSIONS:
            joints.add(target)
        elif kind == TRANSMISSION.mjTRN_TENDON:
            first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
            for wrap in range(first, first + count):
                if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT:
                    joints.add(int(model.wrap_objid[wrap]))
    return joints


class Actuators:
    """Imported actuators, as one control law for each driven joint coordinate.

    Attributes:
        armatures: rotor inertias of actuators by joint coordinate, kg m^2 or kg.
        drives: actuators with fixed gain that are part of control laws, by number, with the range in which
            excitation may vary their controls.
    """

    def __init__(
        self,
        start: ModelAtStart,
        bodies: Bodies,
        joints: Joints,
        gear_groups: GearGroups,
        forces: Forces,
        report: ImportReport,
        sines: ReadOnlyMapping[int, Sine],
    ) -> None:
        """Import and report all actuators.

        Args:
            start: MuJoCo's model and data at the start state.
            bodies: imported bodies.
            joints: imported joints of the tree.
            gear_groups: joint coordinates that gears make proportional to each other.
            forces: imported forces; actuators on sites add wrenches to them.
            report: report that receives the entries.
            sines: sines of the excitation that are added to controls, by number of the actuator.
        """
        self._start, self._model, self._data = start, start.model, start.data
        self._bodies, self._joints, self._gear_groups = bodies, joints, gear_groups
        self._forces, self._report = forces, report
        self._sines = sines
        self._actuations: dict[Key, JointActuation] = {}
        self.armatures: dict[Key, float] = {}
        self.drives: dict[int, Drive] = {}
        self._bodies_with_wrenches: list[int] = []  # MuJoCo's numbers; actuators on sites act on them
        self._compute_forces()
        for actuator in range(self._model.nactuator):
            self._add(actuator)
        for joint in np.flatnonzero(self._model.jnt_actfrclimited).tolist():
            self._report_joint_limit(joint)

    def _compute_forces(self) -> None:
        """Compute the forces of actuators at the start in MuJoCo's data, with force limits switched off."""
        limited_flags = [getattr(self._model, f"{name}limited") for name in FORCE_LIMITS]
        saved = [flags.copy() for flags in limited_flags]
        for flags in limited_flags:
            flags[:] = 0
        mujoco.mj_fwdActuation(self._model, self._data)
        for flags, values in zip(limited_flags, saved, strict=True):
            flags[:] = values

    @property
    def laws(self) -> tuple[PD | StateFeedback, ...]:
        """Control laws, one for each driven joint coordinate."""
        return tuple(actuation.law(key) for key, actuation in self._actuations.items())

    def _add(self, actuator: int) -> None:
        """Import actuator number `actuator`: as part of control laws, as a wrench, or as left out."""
        model = self._model
        element = element_name(model, "actuator", actuator)
        kind = TRANSMISSION(model.actuator_trntype[actuator])
        moments = self._moments(actuator, kind)
        if why := self._why_disabled(actuator):
            self._report.left_out(element, why, switched_off=True)
            self._add_rotor(actuator, element, moments)
            self._report_damping(actuator, element)
            return
        force = self._affine_force(actuator, element)
        if force is None:  # reported as left out
            return
        self._report_damping(actuator, element)
        if moments is not None:  # acts on hinges and slides
            is_imported = self._add_to_joints(actuator, element, force, moments)
        elif force == Affine(0.0, 0.0, 0.0) and not model.actuator_armature[actuator]:
            self._report_imported(actuator, "no force at the control of the start", CONTROL)
            is_imported = True
        elif kind == TRANSMISSION.mjTRN_SITE:
            is_imported = self._add_wrench(actuator, element, force, model.actuator_gear[actuator])
        else:
            transmission = self._describe_transmission(actuator, kind)
            self._report.left_out(element, f"no control law acts {transmission}")
            is_imported = False
        if is_imported:
            self._report_limits(actuator, element, force, moments)

    def _moments(self, actuator: int, kind: mujoco.mjtTrn) -> dict[int, float] | None:
        """Return the moment arm of an actuator at each of MuJoCo's joints, by number.

        The result is None if the actuator acts on anything but hinges and slides.
        """
        target, gear = int(self._model.actuator_trnid[actuator, 0]), self._model.actuator_gear[actuator, 0]
        weights: dict[int, float] | None = None
        if kind in JOINT_TRANSMISSIONS:
            weights = {target: 1.0}
        elif kind == TRANSMISSION.mjTRN_TENDON:
            weights = fixed_tendon_weights(self._model, target)
        if weights is None or any(joint not in self._joints.coordinate_keys for joint in weights):
            return None
        return {joint: weight * float(gear) for joint, weight in weights.items()}

    def _describe_transmission(self, actuator: int, kind: mujoco.mjtTrn) -> str:
        """Describe, for the report, a transmission on which control laws cannot act."""
        if kind not in JOINT_TRANSMISSIONS:
            return f"through its transmission, {kind.name.removeprefix('mjTRN_').lower()}"
        joint = int(self._model.actuator_trnid[actuator, 0])
        what = "free" if self._model.jnt_type[joint] == FREE else "ball"
        return f"on a {what} joint, as {element_name(self._model, 'joint', joint)} is"

    def _why_disabled(self, actuator: int) -> str:
        """Return the reason why the file itself disables the actuator; "" if the actuator is enabled."""
        if self._start.disabled("ACTUATION"):
            return "the file disables actuators"
        group = int(self._model.actuator_group[actuator])
        # other groups have no bit in the option, and cannot be disabled
        if 0 <= group < ACTUATOR_GROUPS and int(self._model.opt.disableactuator) >> group & 1:
            return f"the file disables actuators of group {group}"
        return ""

    def _control(self, actuator: int) -> float:
        """Return the control at the start, clipped to the range of controls."""
        model = self._model
        # `actuator_ctrladr`: index of the first control; in MuJoCo 4 an actuator may have several
        ctrl = float(self._data.ctrl[int(model.actuator_ctrladr[actuator])])
        if model.actuator_ctrllimited[actuator] and not self._start.disabled("CLAMPCTRL"):
            ctrl = float(np.clip(ctrl, *model.actuator_ctrlrange[actuator]))
        return ctrl

    def _activation(self, actuator: int) -> float | None:
        """Return the number that multiplies the gain: the activation, or the control without dynamics.

        The result is None if the activation is not constant for the control at the start.
        """
        kind, ctrl = DYNAMICS(self._model.actuator_dyntype[actuator]), self._control(actuator)
        if kind == DYNAMICS.mjDYN_NONE:
            return ctrl
        first = int(self._model.actuator_actadr[actuator])
        activation = float(self._data.act[first]) if first >= 0 else np.nan
        # integrator: d act/dt = ctrl; filters: d act/dt is proportional to ctrl - act
        is_constant = {
            DYNAMICS.mjDYN_INTEGRATOR: ctrl == 0.0,
            DYNAMICS.mjDYN_FILTER: ctrl == activation,
            DYNAMICS.mjDYN_FILTEREXACT: ctrl == activation,
        }
        return activation if is_constant.get(kind, False) else None

    def _why_not_affine(self, actuator: int) -> str:
        """Return why the force is not affine in length and rate at a constant activation; "" if it is."""
        model = self._model
        if model.actuator_plugin[actuator] >= 0:
            return "a plugin computes its force"
        if model.actuator_delay[actuator]:
            return "its control is delayed"
        gain, bias = GAIN(model.actuator_gaintype[actuator]), BIAS(model.actuator_biastype[actuator])
        if gain not in (GAIN.mjGAIN_FIXED, GAIN.mjGAIN_AFFINE):
            return f"its gain has the type {gain.name.removeprefix('mjGAIN_').lower()}"
        if bias not in (BIAS.mjBIAS_NONE, BIAS.mjBIAS_AFFINE):
            return f"its bias has the type {bias.name.removeprefix('mjBIAS_').lower()}"
        return ""

    def _affine_force(self, actuator: int, element: str) -> Affine | None:
        """Return the force for the control at the start, as a function of the transmission's length and rate.

        If the force is not affine in length and rate, the actuator is reported as left out and the result is
        None.
        """
        model, activation = self._model, self._activation(actuator)
        if reason := self._why_not_affine(actuator):
            self._report.left_out(element, reason)
            return None
        if activation is None:
            self._report.left_out(element, "its activation changes from the start on")
            return None
        # coefficients of 1, l and dl/dt; a fixed gain has the first one only
        coefficients = model.actuator_gainprm[actuator][:3] * activation
        if GAIN(model.actuator_gaintype[actuator]) == GAIN.mjGAIN_FIXED:
            coefficients = coefficients * [1.0, 0.0, 0.0]
        if BIAS(model.actuator_biastype[actuator]) == BIAS.mjBIAS_AFFINE:
            coefficients = coefficients + model.actuator_biasprm[actuator][:3]
        return Affine(*(float(x) for x in coefficients))

    def _report_imported(self, actuator: int, how: str, became: str) -> None:
        """Report an actuator as imported.

        Args:
            actuator: number of the actuator.
            how: counterpart of the actuator in the scene, in words.
            became: kind of the counterpart: `CONTROL` for a control law, `FORCE` for a wrench.
        """
        ctrl_of_file = float(self._data.ctrl[int(self._model.actuator_ctrladr[actuator])])
        control = self._control(actuator)
        if ctrl_of_file != control:
            how += f"; its control {ctrl_of_file:g} is clipped to {control:g} by its range, as in MuJoCo"
        # reported as idle: the control is 0 throughout (a force that does not depend on it may still act)
        moves_nothing = control == 0.0 and actuator not in self._sines
        element = element_name(self._model, "actuator", actuator)
        self._report.imported(element, how, became, moves_nothing=moves_nothing)

    def _report_limits(
        self, actuator: int, element: str, force: Affine, moments: dict[int, float] | None
    ) -> None:
        """Report the limit of the actuator's force, and its tendon's limit of all actuator forces.

        Scenes do not simulate these limits. The report gets a watch, a test after a run whether the force
        would have passed the limit. For the arguments see `_add_to_joints`.
        """
        model, report = self._model, self._report
        if model.actuator_forcelimited[actuator]:
            low, high = (float(x) for x in model.actuator_forcerange[actuator])
            # force of the actuator itself (moment arm 1); coordinates are zero at the start
            terms = tuple((self._joints.coordinate_keys[k], moment) for k, moment in (moments or {}).items())
            constant = force.constant + force.by_length * float(self._data.actuator_length[actuator])
            force_of_time = constant_plus_sines(constant, tuple(self._sine_of_force(actuator, arm=1.0)))
            unit = actuator_force_unit(model, actuator)
            watch = Bounds(
                terms,
                low,
                high,
                unit,
                constant=force_of_time,
                by_value=force.by_length,
                by_rate=force.by_rate,
            )
            # a watch needs the force as a function of joint coordinates and time
            can_watch = moments is not None or not (force.by_length or force.by_rate)
            why = f"its limit of the force, {low:g} to {high:g}"
            watches = [watch] if can_watch else []
            report.left_out(element, why, topic=ACTUATOR_LIMIT, watches=watches)
        if (tendon := limited_tendon(model, actuator)) is not None:
            low, high = (float(x) for x in model.tendon_actfrcrange[tendon])
            why = f"its tendon's limit of actuator forces, {low:g} to {high:g}"
            report.left_out(element, why, topic=TENDON_LIMIT)

    def _report_joint_limit(self, joint: int) -> None:
        """Report the limit that MuJoCo's joint number `joint` sets to the sum of its actuator forces."""
        model, data = self._model, self._data
        key, element = self._joints.coordinate_keys.get(joint), element_name(self._model, "joint", joint)
        limits = [float(x) for x in model.jnt_actfrcrange[joint]]
        low, high = limits
        why, topic = f"its limit of actuator forces, {low:g} to {high:g}", JOINT_LIMIT
        actuation = None if key is None else self._actuations.get(key)
        if others := self._other_forces(joint):
            self._report.left_out(element, f"{why}, which includes {others}", topic=topic)
        elif actuation is not None:
            watch = joint_force_watch(actuation, low, high, joint_force_unit(model, joint))
            watches = [watch] if watch else []
            self._report.left_out(element, why, topic=topic, watches=watches)
        elif data.qfrc_actuator[model.jnt_dofadr[joint]]:
            # only actuators that are left out act on the joint, so that no run can show the force
            self._report.left_out(element, why, topic=topic)

    def _other_forces(self, joint: int) -> str:
        """Describe the forces that a joint's limit includes and its control law does not; "" for none.

        MuJoCo adds gravity compensation to the actuator forces of joints with `actuatorgravcomp`.
        """
        model, forces = self._model, []
        if any(self._moves(joint, body) for body in self._bodies_with_wrenches):
            forces.append("forces on sites")
        if model.jnt_actgravcomp[joint] and any(
            self._moves(joint, int(body)) for body in np.flatnonzero(model.body_gravcomp)
        ):
            forces.append("gravity compensation")
        return " and ".join(forces)

    def _moves(self, joint: int, body: int) -> bool:
        """Return True if MuJoCo's joint moves MuJoCo's body: the body is the joint's body or a descendant."""
        joint_body = int(self._model.jnt_bodyid[joint])
        while body > joint_body:  # parents have lower numbers than children
            body = int(self._model.body_parentid[body])
        return body == joint_body

    def _report_damping(self, actuator: int, element: str) -> None:
        """Report the damping attribute of an actuator, which acts even if actuators are disabled."""
        model = self._model
        if np.any(model.actuator_damping[actuator]) or np.any(model.actuator_dampingpoly[actuator]):
            why, is_off = "the damping of the actuator", self._start.disabled("DAMPER")
            self._report.left_out(element, why, topic="damping", switched_off=is_off)

    def _add_to_joints(self, actuator: int, element: str, force: Affine, moments: dict[int, float]) -> bool:
        """Add the force of an actuator to the control laws of joint coordinates.

        Args:
            actuator: number of the actuator.
            element: name of the actuator in the report.
            force: force as a function of the length of the transmission.
            moments: moment arm by number of MuJoCo's joint.

        Returns:
            False if the actuator is left out.
        """
        keys = self._joints.coordinate_keys
        # total derivative of the length by each coordinate, if gears make all coordinates proportional
        slopes = self._gear_groups.slopes({keys[joint]: moment for joint, moment in moments.items()})
        # force at the start, where all coordinates of the scene are zero
        constant = force.constant + force.by_length * float(self._data.actuator_length[actuator])
        self._add_rotor(actuator, element, moments)
        # moment arm of the actuator at each coordinate that gets a part of the force
        arms = {keys[joint]: moment for joint, moment in moments.items()}
        # proportional coordinates: the whole force acts on the first one, unless a joint limits its actuator
        # forces; the limit applies to the joint's part of the force
        has_limits = any(self._model.jnt_actfrclimited[k] for k in moments)
        if slopes and (force.by_length or force.by_rate) and not has_limits:
            key, slope = next(iter(slopes.items()))
            if slope == 0.0:
                why = "equalities keep its length constant, so that it does no work"
                self._report.left_out(element, why, moves_nothing=True)
                return False
            arms = {key: slope}
        for key, arm in arms.items():
            # derivatives of the length: by this coordinate alone, or by all coordinates if these are not
            # proportional
            length_slopes = {key: slopes[key]} if slopes else arms
            actuation = self._actuations.get(key, JointActuation())
            for other, slope in length_slopes.items() if force.by_length or force.by_rate else ():
                actuation = actuation.with_feedback(
                    other, stiffness=-arm * slope * force.by_length, damping=-arm * slope * force.by_rate
                )
            self._actuations[key] = actuation._replace(
                constant=actuation.constant + arm * constant,
                sines=(*actuation.sines, *self._sine_of_force(actuator, arm)),
            )
        self._add_drive(actuator, arms, moments)
        names = ", ".join(repr(joint) for joint, _ in arms)
        how = f"control law of joint {names}, its {self._describe_control(actuator)}"
        self._report_imported(actuator, how, CONTROL)
        return True

    def _gain(self, actuator: int) -> float:
        """Return the force per unit of control or activation, N or N m; 0 without a fixed gain."""
        fixed_gain = GAIN(self._model.actuator_gaintype[actuator]) == GAIN.mjGAIN_FIXED
        return float(self._model.actuator_gainprm[actuator, 0]) if fixed_gain else 0.0

    def _sine_of_force(self, actuator: int, arm: float) -> Iterator[Sine]:
        """Yield the sine of the generalized force with moment arm `arm`, unless the control is constant."""
        if sine := self._sines.get(actuator):
            yield replace(sine, amplitude=arm * self._gain(actuator) * sine.amplitude)

    def _describe_control(self, actuator: int) -> str:
        """Describe the control of an actuator, for the report."""
        sine = self._sines.get(actuator)
        if sine is None:
            return f"control held at {self._control(actuator):g}"
        what = "activation" if self._has_dynamics(actuator) else "control"
        function = f"{sine.amplitude:.3g} sin({sine.angular_frequency:.4g} t)"
        return f"{what} {self._activation(actuator):g} + {function}"

    def _has_dynamics(self, actuator: int) -> bool:
        """Return True if the actuator has activation dynamics."""
        return DYNAMICS(self._model.actuator_dyntype[actuator]) != DYNAMICS.mjDYN_NONE

    def _add_drive(self, actuator: int, arms: dict[Key, float], moments: dict[int, float]) -> None:
        """Add an actuator to `drives`, with the range of its control in which no limit is exceeded.

        With activation dynamics, the control here is the activation, see `Drive.control`.

        Args:
            actuator: number of the actuator.
            arms: moment arm by joint coordinate.
            moments: moment arm by number of MuJoCo's joint.
        """
        gain, control = self._gain(actuator), self._activation(actuator)
        if not gain or control is None:
            return
        model, data, low, high = self._model, self._data, -np.inf, np.inf
        # range of the control; with dynamics, the control that causes a sine of the activation has a larger
        # amplitude than the activation
        if model.actuator_ctrllimited[actuator] and not self._start.disabled("CLAMPCTRL"):
            amplification, now = control_per_activation(model, actuator), self._control(actuator)
            low, high = (
                control + (float(x) - now) / amplification for x in model.actuator_ctrlrange[actuator]
            )
        # range of the activation
        if model.actuator_actlimited[actuator]:
            down, up = (float(x) for x in model.actuator_actrange[actuator])
            low, high = max(low, down), min(high, up)
        # limits of the force of the actuator, its tendon and its joints
        # `force_factor`: limited force per unit force of the actuator
        for force_factor, distances in distances_from_limits(model, data, actuator, moments):
            down, up = sorted(float(x) / (gain * force_factor) for x in distances)
            low, high = max(low, control + down), min(high, control + up)
        gains = {key: gain * arm for key, arm in arms.items()}
        self.drives[actuator] = Drive(
            control=control, gains=gains, low=low, high=high, has_dynamics=self._has_dynamics(actuator)
        )

    def _add_rotor(self, actuator: int, element: str, moments: dict[int, float] | None) -> None:
        """Add the armature (rotor inertia) of an actuator, also of a disabled one, as MuJoCo does."""
        inertia = float(self._model.actuator_armature[actuator])
        if not inertia:
            return
        reduced = reduced_inertia(self._start, self._joints, self._gear_groups, moments or {}, inertia)
        if reduced is None:
            why = f"its armature {inertia:g}: no single joint coordinate determines its length"
            self._report.left_out(element, why, topic="armature")
            return
        key, inertia_of_coordinate = reduced
        joint, _ = key
        self.armatures[key] = self.armatures.get(key, 0.0) + inertia_of_coordinate
        self._report.imported(element, f"its armature {inertia:g} at joint {joint!r}", ROTOR)

    def _add_wrench(self, actuator: int, element: str, force: Affine, gear: Array) -> bool:
        """Add the constant force and torque of an actuator on a site as a wrench.

        The force has a constant direction in the frame of the site, or of a reference site on the ground.

        Args:
            actuator: number of the actuator.
            element: name of the actuator in the report.
            force: scalar force of the actuator, as a function of the length of the transmission.
            gear: (6,) force and torque per unit of the scalar force, along the axes of the frame.

        Returns:
            False if the actuator is left out.
        """
        model, data = self._model, self._data
        site, reference = (int(k) for k in model.actuator_trnid[actuator])
        body = self._bodies.names[int(model.site_bodyid[site])]
        turns_with_body = reference < 0  # no reference site
        if body == GROUND:
            self._report.left_out(
                element, "its site is on the ground, which no force moves", moves_nothing=True
            )
            return False
        if force.by_length or force.by_rate:
            what = "position" if force.by_length else "velocity"
            self._report.left_out(element, f"its force depends on the {what} of its site")
            return False
        if not turns_with_body and self._bodies.names[int(model.site_bodyid[reference])] != GROUND:
            self._report.left_out(element, "its force on a site has the direction of another moving body")
            return False
        axes = data.site_xmat[site if turns_with_body else reference].reshape(3, 3)
        world_force, world_torque = force.constant * (gear.reshape(2, 3) @ axes.T)
        # `mjcf.write` puts "wrench" in front of the name of an exported wrench
        wanted_name = model.actuator(actuator).name.removeprefix("wrench ")
        name = self._forces.name(wanted_name, f"actuator_{actuator}")
        self._bodies_with_wrenches.append(int(model.site_bodyid[site]))
        frame: Any = "body" if turns_with_body else "world"
        point = data.site_xpos[site].copy()
        self._forces.forces.append(Wrench(name, body, point, world_force, world_torque, frame))
        self._report_imported(actuator, f"wrench {name!r}, constant in the {frame}", FORCE)
        return True
