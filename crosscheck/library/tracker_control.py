"""Solar tracker under gravity: both sliders follow a smooth reference by one of four controllers."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from crosscheck.library.options import Beside, Between
from crosscheck.library.tracker import tracker_gravity
from newton_euler.analysis.linear.regulator import lqr
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.digital_control import Digital, Law
from newton_euler.model.joint import Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.runs.variation import start

STIFFNESS, DAMPING = 400.0, 40.0
"""Gains of computed torque, 1/s^2 and 1/s: critically damped, errors decay with exp(-20 t)."""

INERTIA = {"slide_12": 2.5, "slide_13": 0.7}
"""Effective masses at the actuators at the initial pose, kg. They scale the gains of PD laws to be as fast as
computed torque."""

REFERENCE = {
    "slide_12": Sine(-0.01, np.pi, 0.5 * np.pi, offset=0.01),
    "slide_13": Sine(-0.0075, 2.0 * np.pi, 0.5 * np.pi, offset=0.0075),
}
"""References of the sliders, m: up by 20 mm and back once in 2 s, up by 15 mm and back twice, from rest at
the initial pose. The LQR is designed about the middle of this motion."""


COMPUTER = Beside("period")


def tracker_computed_torque(
    controller: Literal["computed_torque", "pd", "pd_gravity", "lqr"] = "computed_torque",
    period: Annotated[float, Between(0.0, 0.05, "s")] = 0.0,
    delay: Annotated[int, range(11), "periods", COMPUTER] = 0,
    resolution: Annotated[float, Between(0.0, 0.001, "m"), COMPUTER] = 0.0,
    force_limit: Annotated[float, Between(0.0, 1000.0, "N"), COMPUTER] = 0.0,
    mass_error: Annotated[float, Between(-0.5, 0.5, "of it"), Beside("controller", "computed_torque")] = 0.0,
) -> Scene:
    """Return the tracker under gravity, both sliders on a smooth reference, 2 s.

    Args:
        controller: computed torque; PD without or with gravity compensation; or an LQR about the middle.
        period: sampling period of a digital controller; 0 for a continuous controller.
        delay: delay of the digital controller, in periods.
        resolution: resolution of the encoders; 0 for exact measurements.
        force_limit: largest force of an actuator; 0 for no limit.
        mass_error: relative error of the panel's mass in the model of computed torque.
    """
    scene = replace(tracker_gravity(), duration=2.0)
    laws = _laws(scene, controller, mass_error)
    control: tuple[Law, ...] = laws
    if period:
        limit = force_limit or np.inf
        control = tuple(Digital(law, period, delay, resolution, limit) for law in laws)
    description = f"dual-axis solar tracker, {controller} along a smooth motion, under gravity"
    return replace(scene, name="tracker_computed_torque", description=description, control=control)


def _laws(
    scene: Scene, controller: str, mass_error: float
) -> tuple[PD | ComputedTorque | StateFeedback, ...]:
    if controller == "lqr":
        middle = start(scene, **{name: (reference.offset, 0.0) for name, reference in REFERENCE.items()})
        # position errors cost as much as the forces of the PD laws against them, rates likewise
        weights = [(gain * INERTIA[name]) ** 2 for gain in (STIFFNESS, DAMPING) for name in REFERENCE]
        targets: dict[str | Key, float | TimeFunction] = dict(REFERENCE.items())
        return lqr(scene, weights, 1.0, middle.initial_state, list(REFERENCE), targets=targets)
    if controller == "computed_torque":
        panel = scene.mechanism.body("panel_7")
        model = {"panel_7.mass": (1.0 + mass_error) * panel.mass} if mass_error else {}
        return tuple(
            ComputedTorque(name, STIFFNESS, DAMPING, reference, model=model)
            for name, reference in REFERENCE.items()
        )
    holds = controller == "pd_gravity"
    return tuple(
        PD(name, STIFFNESS * mass, DAMPING * mass, REFERENCE[name], gravity_compensation=holds)
        for name, mass in INERTIA.items()
    )
