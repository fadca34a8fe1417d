"""Actuators of a compiled model with the controls of the start, held: forces and PD laws.

MuJoCo's force on a transmission of length l is gain * ctrl + b_0 + b_1 l + b_2 dl/dt. With l = g q of a
joint coordinate and x = q less its value at the start, the force on the joint is

    u = g (gain ctrl + b_0) + g^2 b_1 (q_start + x) + g^2 b_2 dx/dt,

a PD law of stiffness -g^2 b_1, damping -g^2 b_2 and target 0, and the rest as its feedforward. Where l is
a sum of coordinates that gears tie to each other, l - l_start = s x for each of them, and g s takes the
place of g^2.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from mjcf.reading.bodies import GROUND, Bodies
from mjcf.reading.forces import Forces, reduced_inertia
from mjcf.reading.joints import Joints
from mjcf.reading.loops import fixed
from mjcf.reading.start import Start
from mjcf.reading.ties import Ties
from newton_euler.control import PD
from newton_euler.forces import Wrench
from newton_euler.mapping import Mapping
from newton_euler.measured import Key
from newton_euler.scalars import Array

TRANSMISSION, DYNAMICS, GAIN, BIAS = mujoco.mjtTrn, mujoco.mjtDyn, mujoco.mjtGain, mujoco.mjtBias

TO_JOINTS = (TRANSMISSION.mjTRN_JOINT, TRANSMISSION.mjTRN_JOINTINPARENT)


class Affine(NamedTuple):
    """constant + by_length l + by_rate dl/dt, N or N m."""

    constant: float
    by_length: float
    by_rate: float


def driven_joints(model: Any) -> set[int]:
    """Numbers of MuJoCo's joints that actuators may drive."""
    found: set[int] = set()
    for actuator in range(model.nu):
        kind, target = TRANSMISSION(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
        if kind in TO_JOINTS:
            found.add(target)
        elif kind == TRANSMISSION.mjTRN_TENDON:
            first, count = int(model.tendon_adr[target]), int(model.tendon_num[target])
            for wrap in range(first, first + count):
                if model.wrap_type[wrap] == mujoco.mjtWrap.mjWRAP_JOINT:
                    found.add(int(model.wrap_objid[wrap]))
    return found


class Actuators:
    """Control laws, one for each joint coordinate that is driven.

    Attributes:
        armatures: what actuators' rotors add to those of joints, by joint and coordinate.
    """

    def __init__(
        self, start: Start, bodies: Bodies, joints: Joints, ties: Ties, forces: Forces, report: Mapping
    ) -> None:
        self._start, self._model, self._data = start, start.model, start.data
        self._bodies, self._joints, self._ties = bodies, joints, ties
        self._forces, self._report = forces, report
        self._laws: dict[Key, PD] = {}
        self.armatures: dict[Key, float] = {}
        for actuator in range(self._model.nu):
            self._add(actuator)

    @property
    def laws(self) -> tuple[PD, ...]:
        """Laws with a stiffness have their constant force as a target."""
        return tuple(
            replace(law, target=law.feedforward / law.stiffness, feedforward=0.0) if law.stiffness else law
            for law in self._laws.values()
        )

    def _add(self, actuator: int) -> None:
        model = self._model
        element = f"actuator {model.actuator(actuator).name or actuator!r}"
        law = self._affine(actuator, element)
        if law is None:
            return
        self._report_limits(actuator, element)
        target, gear = int(model.actuator_trnid[actuator, 0]), model.actuator_gear[actuator]
        kind = TRANSMISSION(model.actuator_trntype[actuator])
        weights: dict[int, float] | None = None
        if kind in TO_JOINTS:
            weights = {target: 1.0}
        elif kind == TRANSMISSION.mjTRN_TENDON:
            weights = fixed(self._start, target)
        if weights is not None and all(joint in self._joints.keys for joint in weights):
            self._add_to_joints(actuator, element, law, {k: w * float(gear[0]) for k, w in weights.items()})
        elif law == Affine(0.0, 0.0, 0.0):
            self._report.exactly(element, "no force at the controls of the start")
        elif kind == TRANSMISSION.mjTRN_SITE:
            self._add_wrench(actuator, element, law, gear)
        else:
            what = kind.name.removeprefix("mjTRN_").lower()
            self._leave(actuator, element, f"no control law acts through its transmission, {what}")

    def _affine(self, actuator: int, element: str) -> Affine | None:
        """Its force with the control held; None if it is no affine function of length and rate."""
        model = self._model
        if self._start.disabled("ACTUATION"):
            self._report.left_out(element, "the file disables actuators")
            return None
        known = (
            DYNAMICS(model.actuator_dyntype[actuator]) == DYNAMICS.mjDYN_NONE
            and GAIN(model.actuator_gaintype[actuator]) in (GAIN.mjGAIN_FIXED, GAIN.mjGAIN_AFFINE)
            and BIAS(model.actuator_biastype[actuator]) in (BIAS.mjBIAS_NONE, BIAS.mjBIAS_AFFINE)
        )
        if not known:
            self._leave(actuator, element, "has dynamics, gain or bias that is no affine function")
            return None
        place = int(model.actuator_ctrladr[actuator])
        ctrl = float(self._data.ctrl[place])
        if model.actuator_ctrllimited[actuator] and not self._start.disabled("CLAMPCTRL"):
            ctrl = float(np.clip(ctrl, *model.actuator_ctrlrange[actuator]))
        gain, bias = model.actuator_gainprm[actuator][:3] * ctrl, model.actuator_biasprm[actuator][:3]
        if GAIN(model.actuator_gaintype[actuator]) == GAIN.mjGAIN_FIXED:
            gain = gain * [1.0, 0.0, 0.0]
        if BIAS(model.actuator_biastype[actuator]) == BIAS.mjBIAS_AFFINE:
            gain = gain + bias
        return self._limited(actuator, element, Affine(*(float(x) for x in gain)))

    def _leave(self, actuator: int, element: str, why: str) -> None:
        self._report.left_out(element, why)
        self._start.left.append(("actuator", actuator))

    def _limited(self, actuator: int, element: str, law: Affine) -> Affine:
        """The law, or its limit where it is above that at the start."""
        model, data = self._model, self._data
        if not model.actuator_forcelimited[actuator]:
            return law
        low, high = (float(x) for x in model.actuator_forcerange[actuator])
        length, rate = data.actuator_length[actuator], data.actuator_velocity[actuator]
        force = float(law.constant + law.by_length * length + law.by_rate * rate)
        if low <= force <= high:
            self._report.left_out(element, f"its limit of the force, {low:g} to {high:g}")
            return law
        held = min(max(force, low), high)
        why = f"its force would be {force:.4g} at the start and is held at its limit there, {held:g}"
        self._report.approximated(element, why)
        return Affine(held, 0.0, 0.0)

    def _report_limits(self, actuator: int, element: str) -> None:
        model = self._model
        if np.any(model.actuator_damping[actuator]) or np.any(model.actuator_dampingpoly[actuator]):
            self._report.left_out(element, "damping of its own")

    def _add_to_joints(self, actuator: int, element: str, law: Affine, moments: dict[int, float]) -> None:
        model = self._model
        inertia = float(model.actuator_armature[actuator])
        keys = self._joints.keys
        slopes = self._ties.slopes({keys[joint]: moment for joint, moment in moments.items()})
        if slopes is None and (law.by_length or law.by_rate or inertia):
            what = f"a sum of {len(moments)} joint coordinates that no gears tie"
            self._leave(actuator, element, f"its force depends on {what}")
            return
        constant = law.constant + law.by_length * float(self._data.actuator_length[actuator])
        rotor = reduced_inertia(self._start, self._joints, self._ties, moments, inertia) if inertia else None
        if rotor is not None:
            self.armatures[rotor[0]] = self.armatures.get(rotor[0], 0.0) + rotor[1]
        for joint, moment in moments.items():
            key = keys[joint]
            slope = 0.0 if slopes is None else slopes[key]
            before = self._laws.get(key, PD(key[0], 0.0, 0.0, 0.0, key[1]))
            self._laws[key] = PD(
                key[0],
                before.stiffness - moment * slope * law.by_length,
                before.damping - moment * slope * law.by_rate,
                0.0,
                key[1],
                before.feedforward + moment * constant,
            )
            if model.jnt_actfrclimited[joint]:
                self._report.left_out(self._joints.element(joint), "its limit of actuator forces")
        ctrl = float(self._data.ctrl[int(model.actuator_ctrladr[actuator])])
        names = ", ".join(repr(self._joints.of[joint]) for joint in moments)
        self._report.exactly(element, f"control law of joint {names}, its control held at {ctrl:g}")

    def _add_wrench(self, actuator: int, element: str, law: Affine, gear: Array) -> None:
        """A constant force and torque at a site, in the site's frame or in that of a fixed one."""
        model, data = self._model, self._data
        site, reference = (int(k) for k in model.actuator_trnid[actuator])
        body = self._bodies.names[int(model.site_bodyid[site])]
        turning = reference < 0
        if law.by_length or law.by_rate or body == GROUND:
            self._leave(actuator, element, "its force on a site depends on where that is")
            return
        if not turning and self._bodies.names[int(model.site_bodyid[reference])] != GROUND:
            self._leave(actuator, element, "its force on a site turns with another moving body")
            return
        axes = data.site_xmat[site if turning else reference].reshape(3, 3)
        force, torque = law.constant * (gear.reshape(2, 3) @ axes.T)
        own = model.actuator(actuator).name.removeprefix("wrench ")
        name = self._forces.name(own, f"actuator_{actuator}")
        frame: Any = "body" if turning else "world"
        self._forces.forces.append(Wrench(name, body, data.site_xpos[site].copy(), force, torque, frame))
        self._report.exactly(element, f"wrench {name!r}, constant in the {frame}")
