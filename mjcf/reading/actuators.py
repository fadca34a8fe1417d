"""Import actuators of a compiled model as forces and control laws.

Controls are held at the start, or follow a sine about it. MuJoCo's force on a transmission of length l is
gain * ctrl + b_0 + b_1 l + b_2 dl/dt. With l = g q for a joint coordinate, and x = q minus its value at the
start, the force on the joint is

    u = g (gain ctrl + b_0) + g^2 b_1 (q_start + x) + g^2 b_2 dx/dt,

a PD law with stiffness -g^2 b_1, damping -g^2 b_2, target 0, and the other terms as feedforward.

If l is a sum of coordinates that gears couple, l - l_start = s x for each of them. A law on the first
coordinate with s instead of g does the same work. If l = sum_j g_j q_j of independent coordinates, each of
them has the state feedback

    u_i = g_i (gain ctrl + b_0 + b_1 l_start) + g_i sum_j g_j (b_1 x_j + b_2 dx_j/dt).

A sine of the control adds g gain times the sine to the feedforward.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Mapping as Given
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
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
from mjcf.reading.loops import fixed_tendon_weights
from mjcf.reading.start import ModelAtStart
from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.forces import Wrench
from newton_euler.model.joint import Key
from newton_euler.model.smooth_functions import Sine
from newton_euler.reading.activity import Bounds
from newton_euler.reading.import_report import CONTROL, CONTROL_RANGE, FORCE, ROTOR, ImportReport
from newton_euler.scalars import Array

TRANSMISSION, DYNAMICS, GAIN, BIAS = mujoco.mjtTrn, mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias

ACTUATOR_GROUPS = 31
"""Number of groups of actuators that a file can disable."""


def driven_joints(model: Any) -> set[int]:
    """Return the numbers of MuJoCo's joints that actuators may drive."""
    found: set[int] = set()
    for actuator in range(model.nactuator):
        kind, target = TRANSMISSION(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        if kind in JOINT_TRANSMISSIONS:
            found.add(target)
        elif kind == TRANSMISSION.mjTRN_TENDON:
            first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
            for wrap in range(first, first + count):
                if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT:
                    found.add(int(model.wrap_objid[wrap]))
    return found


class Actuators:
    """Imported actuators, as one control law for each driven joint coordinate.

    Attributes:
        armatures: rotor inertias of actuators by joint coordinate, kg m^2 or kg.
        drives: actuators with fixed gain that are part of control laws, by number.
    """

    def __init__(
        self,
        start: ModelAtStart,
        bodies: Bodies,
        joints: Joints,
        gear_groups: GearGroups,
        forces: Forces,
        report: ImportReport,
        swings: Given[int, Sine],
    ) -> None:
        """Import all actuators; `swings` are the sines of controls, by number of the actuator."""
        self._start, self._model, self._data = start, start.model, start.data
        self._bodies, self._joints, self._gear_groups = bodies, joints, gear_groups
        self._forces, self._report = forces, report
        self._swings = swings
        self._acting: dict[Key, JointActuation] = {}
        self.armatures: dict[Key, float] = {}
        self.drives: dict[int, Drive] = {}
        self._pushed: list[int] = []  # numbers of MuJoCo's bodies with wrenches of actuators
        self._compute_forces()
        for actuator in range(self._model.nactuator):
            self._add(actuator)
        for joint in np.flatnonzero(self._model.jnt_actfrclimited).tolist():
            self._report_joint_limit(joint)

    def _compute_forces(self) -> None:
        """Compute the forces of actuators at the start, without limits, in MuJoCo's data."""
        limits = [getattr(self._model, f"{name}limited") for name in FORCE_LIMITS]
        kept = [each.copy() for each in limits]
        for each in limits:
            each[:] = 0
        mujoco.mj_fwdActuation(self._model, self._data)
        for each, before in zip(limits, kept, strict=True):
            each[:] = before

    @property
    def laws(self) -> tuple[PD | StateFeedback, ...]:
        """Control laws, one for each driven joint coordinate."""
        return tuple(acting.law(key) for key, acting in self._acting.items())

    def _add(self, actuator: int) -> None:
        model = self._model
        element = element_name(model, "actuator", actuator)
        kind = TRANSMISSION(model.actuator_trntype[actuator])
        moments = self._moments(actuator, kind)
        if why := self._disabled(actuator):
            self._report.left_out(element, why, switched_off=True)
            self._add_rotor(actuator, element, moments)
            return
        law = self._affine(actuator, element)
        if law is None:
            return
        self._report_damping(actuator, element)
        if moments is not None:
            acts = self._add_to_joints(actuator, element, law, moments)
        elif law == Affine(0.0, 0.0, 0.0) and not model.actuator_armature[actuator]:
            self._report_exactly(actuator, "no force at the control of the start", CONTROL)
            acts = True
        elif kind == TRANSMISSION.mjTRN_SITE:
            acts = self._add_wrench(actuator, element, law, model.actuator_gear[actuator])
        else:
            self._report.left_out(element, f"no control law acts {self._through(actuator, kind)}")
            acts = False
        if acts:
            self._report_limits(actuator, element, law, moments)

    def _moments(self, actuator: int, kind: mujoco.mjtTrn) -> dict[int, float] | None:
        """Return the moment arm at each joint; None unless the actuator acts on hinges and slides alone."""
        target, gear = int(self._model.actuator_trnid[actuator, 0]), self._model.actuator_gear[actuator, 0]
        weights: dict[int, float] | None = None
        if kind in JOINT_TRANSMISSIONS:
            weights = {target: 1.0}
        elif kind == TRANSMISSION.mjTRN_TENDON:
            weights = fixed_tendon_weights(self._start, target)
        if weights is None or any(joint not in self._joints.coordinate_keys for joint in weights):
            return None
        return {joint: weight * float(gear) for joint, weight in weights.items()}

    def _through(self, actuator: int, kind: mujoco.mjtTrn) -> str:
        """Describe a transmission that control laws do not have."""
        if kind not in JOINT_TRANSMISSIONS:
            return f"through its transmission, {kind.name.removeprefix('mjTRN_').lower()}"
        joint = int(self._model.actuator_trnid[actuator, 0])
        what = "free" if self._model.jnt_type[joint] == FREE else "ball"
        return f"on a {what} joint, as {element_name(self._model, 'joint', joint)} is"

    def _disabled(self, actuator: int) -> str:
        """Return the reason why the file itself disables the actuator; "" if the actuator is enabled."""
        if self._start.disabled("ACTUATION"):
            return "the file disables actuators"
        group = int(self._model.actuator_group[actuator])
        # groups beyond the bits of the option cannot be disabled
        if 0 <= group < ACTUATOR_GROUPS and int(self._model.opt.disableactuator) >> group & 1:
            return f"the file disables actuators of group {group}"
        return ""

    def _control(self, actuator: int) -> float:
        """Return the control at the start, clipped to its range."""
        model = self._model
        ctrl = float(self._data.ctrl[int(model.actuator_ctrladr[actuator])])
        if model.actuator_ctrllimited[actuator] and not self._start.disabled("CLAMPCTRL"):
            ctrl = float(np.clip(ctrl, *model.actuator_ctrlrange[actuator]))
        return ctrl

    def _activation(self, actuator: int) -> float | None:
        """Return the activation (or control) that multiplies the gain; None if the activation changes."""
        kind, ctrl = DYNAMICS(self._model.actuator_dyntype[actuator]), self._control(actuator)
        if kind == DYNAMICS.mjDYN_NONE:
            return ctrl
        first = int(self._model.actuator_actadr[actuator])
        activation = float(self._data.act[first]) if first >= 0 else np.nan
        rests = {
            DYNAMICS.mjDYN_INTEGRATOR: ctrl == 0.0,
            DYNAMICS.mjDYN_FILTER: ctrl == activation,
            DYNAMICS.mjDYN_FILTEREXACT: ctrl == activation,
        }
        return activation if rests.get(kind, False) else None

    def _affine(self, actuator: int, element: str) -> Affine | None:
        """Return the force at a held control; None if the force is not affine in length and rate."""
        model = self._model
        known = (
            model.actuator_plugin[actuator] < 0
            and not model.actuator_delay[actuator]
            and GAIN(model.actuator_gaintype[actuator]) in (GAIN.mjGAIN_FIXED, GAIN.mjGAIN_AFFINE)
            and BIAS(model.actuator_biastype[actuator]) in (BIAS.mjBIAS_NONE, BIAS.mjBIAS_AFFINE)
        )
        activation = self._activation(actuator)
        if not known or activation is None:
            self._report.left_out(
                element,
                "its activation changes at the start, or it has a delay, a plugin, or no affine gain or bias",
            )
            return None
        gain, bias = model.actuator_gainprm[actuator][:3] * activation, model.actuator_biasprm[actuator][:3]
        if GAIN(model.actuator_gaintype[actuator]) == GAIN.mjGAIN_FIXED:
            gain = gain * [1.0, 0.0, 0.0]
        if BIAS(model.actuator_biastype[actuator]) == BIAS.mjBIAS_AFFINE:
            gain = gain + bias
        return Affine(*(float(x) for x in gain))

    def _report_exactly(self, actuator: int, how: str, became: str) -> None:
        model, numbers = self._model, dict[str, Sequence[float]]()
        given = float(self._data.ctrl[int(model.actuator_ctrladr[actuator])])
        if given != (control := self._control(actuator)):
            how += f"; its control {given:g} is clipped to {control:g} by its range, as in MuJoCo"
        silent = control == 0.0 and actuator not in self._swings
        if model.actuator_ctrllimited[actuator]:
            numbers[CONTROL_RANGE] = model.actuator_ctrlrange[actuator].tolist()
        element = element_name(model, "actuator", actuator)
        self._report.imported(element, how, became, moves_nothing=silent, numbers=numbers)

    def _report_limits(
        self, actuator: int, element: str, law: Affine, moments: dict[int, float] | None
    ) -> None:
        """Report the limit of the actuator's force, and its tendon's limit of all actuator forces."""
        model, report = self._model, self._report
        if model.actuator_forcelimited[actuator]:
            low, high = (float(x) for x in model.actuator_forcerange[actuator])
            terms = tuple((self._joints.coordinate_keys[k], moment) for k, moment in (moments or {}).items())
            constant = law.constant + law.by_length * float(self._data.actuator_length[actuator])
            moving = constant_plus_sines(constant, tuple(self._swing_force(actuator, 1.0)))
            unit = actuator_force_unit(model, actuator)
            watch = Bounds(terms, low, high, unit, moving, law.by_length, law.by_rate)
            known = moments is not None or not (law.by_length or law.by_rate)
            why = f"its limit of the force, {low:g} to {high:g}"
            watches = [watch] if known else []
            report.left_out(element, why, topic="limit of the force", watches=watches, numbers=[low, high])
        if (tendon := limited_tendon(model, actuator)) is not None:
            low, high = (float(x) for x in model.tendon_actfrcrange[tendon])
            why = f"its tendon's limit of actuator forces, {low:g} to {high:g}"
            report.left_out(element, why, topic="limit of its tendon", numbers=[low, high])

    def _report_joint_limit(self, joint: int) -> None:
        """Report a joint's limit of the sum of its actuator forces."""
        model, data = self._model, self._data
        key, element = self._joints.coordinate_keys.get(joint), element_name(self._model, "joint", joint)
        low, high = bounds = [float(x) for x in model.jnt_actfrcrange[joint]]
        why, topic = f"its limit of actuator forces, {low:g} to {high:g}", "limit of actuator forces"
        law = None if key is None else self._acting.get(key)
        if others := self._other_forces(joint):
            self._report.left_out(element, f"{why}, which includes {others}", topic=topic, numbers=bounds)
        elif key is not None and law is not None:
            watch = joint_force_watch(law, low, high, joint_force_unit(model, joint))
            watches = [watch] if watch else []
            self._report.left_out(element, why, topic=topic, watches=watches, numbers=bounds)
        elif data.qfrc_actuator[model.jnt_dofadr[joint]]:
            self._report.left_out(element, why, topic=topic, numbers=bounds)

    def _other_forces(self, joint: int) -> str:
        """Describe forces in a joint's limit that are not part of its control law."""
        model, found = self._model, []
        if any(self._moves(joint, body) for body in self._pushed):
            found.append("forces on sites")
        if model.jnt_actgravcomp[joint] and any(
            self._moves(joint, int(body)) for body in np.flatnonzero(model.body_gravcomp)
        ):
            found.append("gravity compensation")
        return " and ".join(found)

    def _moves(self, joint: int, body: int) -> bool:
        """True if a joint of MuJoCo moves a body; parents have lower numbers than children."""
        above = int(self._model.jnt_bodyid[joint])
        while body > above:
            body = int(self._model.body_parentid[body])
        return body == above

    def _report_damping(self, actuator: int, element: str) -> None:
        model = self._model
        if np.any(model.actuator_damping[actuator]) or np.any(model.actuator_dampingpoly[actuator]):
            self._report.left_out(element, "the damping of the actuator", topic="damping")

    def _add_to_joints(self, actuator: int, element: str, law: Affine, moments: dict[int, float]) -> bool:
        """Add the force to the laws of joint coordinates; False if the actuator is left out."""
        keys = self._joints.coordinate_keys
        slopes = self._gear_groups.slopes({keys[joint]: moment for joint, moment in moments.items()})
        constant = law.constant + law.by_length * float(self._data.actuator_length[actuator])
        self._add_rotor(actuator, element, moments)
        shares = {keys[joint]: moment for joint, moment in moments.items()}
        # the sum acts on one coordinate, unless joints with limits need their own force
        limited = any(self._model.jnt_actfrclimited[k] for k in moments)
        if slopes and (law.by_length or law.by_rate) and not limited:
            key, slope = next(iter(slopes.items()))
            if slope == 0.0:
                why = "equalities keep its length constant, so that it does no work"
                self._report.left_out(element, why, moves_nothing=True)
                return False
            shares = {key: slope}
        for key, share in shares.items():
            # the change of length by one coordinate, or by all coordinates of the sum
            length = {key: slopes[key]} if slopes else shares
            acting = self._acting.get(key, JointActuation())
            for other, slope in length.items() if law.by_length or law.by_rate else ():
                acting = acting.with_feedback(
                    other, -share * slope * law.by_length, -share * slope * law.by_rate
                )
            self._acting[key] = acting._replace(
                constant=acting.constant + share * constant,
                swings=(*acting.swings, *self._swing_force(actuator, share)),
            )
        self._add_drive(actuator, shares, moments)
        names = ", ".join(repr(joint) for joint, _ in shares)
        how = f"control law of joint {names}, its {self._control_text(actuator)}"
        self._report_exactly(actuator, how, CONTROL)
        return True

    def _gain(self, actuator: int) -> float:
        """Return the force per unit of control or activation, N or N m; 0 without a fixed gain."""
        fixed_gain = GAIN(self._model.actuator_gaintype[actuator]) == GAIN.mjGAIN_FIXED
        return float(self._model.actuator_gainprm[actuator, 0]) if fixed_gain else 0.0

    def _swing_force(self, actuator: int, share: float) -> Iterator[Sine]:
        """Yield the sine of the force, times `share`, if the control follows a sine."""
        if swing := self._swings.get(actuator):
            yield replace(swing, amplitude=share * self._gain(actuator) * swing.amplitude)

    def _control_text(self, actuator: int) -> str:
        """Describe the control."""
        swing = self._swings.get(actuator)
        if swing is None:
            return f"control held at {self._control(actuator):g}"
        what = "control" if self._is_direct(actuator) else "activation"
        sine = f"{swing.amplitude:.3g} sin({swing.angular_frequency:.4g} t)"
        return f"{what} {self._activation(actuator):g} + {sine}"

    def _is_direct(self, actuator: int) -> bool:
        """True if the actuator has no activation dynamics."""
        return DYNAMICS(self._model.actuator_dyntype[actuator]) == DYNAMICS.mjDYN_NONE

    def _add_drive(self, actuator: int, shares: dict[Key, float], moments: dict[int, float]) -> None:
        """Add the range of the control or activation in which no limit is exceeded to `drives`."""
        gain, control = self._gain(actuator), self._activation(actuator)
        if not gain or control is None:
            return
        model, data, low, high = self._model, self._data, -np.inf, np.inf
        if model.actuator_ctrllimited[actuator] and not self._start.disabled("CLAMPCTRL"):
            needed, now = control_per_activation(model, actuator), self._control(actuator)
            low, high = (control + (float(x) - now) / needed for x in model.actuator_ctrlrange[actuator])
        if model.actuator_actlimited[actuator]:
            down, up = (float(x) for x in model.actuator_actrange[actuator])
            low, high = max(low, down), min(high, up)
        for factor, room in distances_from_limits(model, data, actuator, moments):
            down, up = sorted(float(x) / (gain * factor) for x in room)
            low, high = max(low, control + down), min(high, control + up)
        gains = {key: gain * x for key, x in shares.items()}
        self.drives[actuator] = Drive(control, gains, low, high, not self._is_direct(actuator))

    def _add_rotor(self, actuator: int, element: str, moments: dict[int, float] | None) -> None:
        """Add the armature, which MuJoCo also applies for disabled actuators."""
        inertia = float(self._model.actuator_armature[actuator])
        if not inertia:
            return
        rotor = reduced_inertia(self._start, self._joints, self._gear_groups, moments or {}, inertia)
        if rotor is None:
            why = f"its armature {inertia:g}: no single joint coordinate determines its length"
            self._report.left_out(element, why, topic="armature")
            return
        self.armatures[rotor[0]] = self.armatures.get(rotor[0], 0.0) + rotor[1]
        self._report.imported(element, f"its armature {inertia:g} at joint {rotor[0][0]!r}", ROTOR)

    def _add_wrench(self, actuator: int, element: str, law: Affine, gear: Array) -> bool:
        """Add a constant force and torque at a site, in the frame of the site or of a fixed site.

        Returns:
            False if the actuator is left out.
        """
        model, data = self._model, self._data
        site, reference = (int(k) for k in model.actuator_trnid[actuator])
        body = self._bodies.names[int(model.site_bodyid[site])]
        turning = reference < 0
        if law.by_length or law.by_rate or body == GROUND:
            self._report.left_out(element, "its force on a site depends on the place of the site")
            return False
        if not turning and self._bodies.names[int(model.site_bodyid[reference])] != GROUND:
            self._report.left_out(element, "its force on a site has the direction of another moving body")
            return False
        axes = data.site_xmat[site if turning else reference].reshape(3, 3)
        force, torque = law.constant * (gear.reshape(2, 3) @ axes.T)
        own = model.actuator(actuator).name.removeprefix("wrench ")
        name = self._forces.name(own, f"actuator_{actuator}")
        self._pushed.append(int(model.site_bodyid[site]))
        frame: Any = "body" if turning else "world"
        self._forces.forces.append(Wrench(name, body, data.site_xpos[site].copy(), force, torque, frame))
        self._report_exactly(actuator, f"wrench {name!r}, constant in the {frame}", FORCE)
        return True
