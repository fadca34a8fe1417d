"""The tracker under gravity on a smooth reference of both sliders, by one of four controllers."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from crosscheck.scenes.options import Beside, Between
from crosscheck.scenes.tracker import tracker_gravity
from newton_euler.analysis.regulator import lqr
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.digital_control import Digital, Law
from newton_euler.model.joint import Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.variation import start

STIFFNESS, DAMPING = 400.0, 40.0
"""1/s^2 and 1/s of computed torque: critical, errors vanish with exp(-20 t)."""

INERTIA = {"slide_12": 2.5, "slide_13": 0.7}
"""kg that the actuators move at the initial pose, for gains of PD laws that are about as quick."""

REFERENCE = {
    "slide_12": Sine(-0.01, np.pi, 0.5 * np.pi, offset=0.01),
    "slide_13": Sine(-0.0075, 2.0 * np.pi, 0.5 * np.pi, offset=0.0075),
}
"""m: up by 20 and 15 mm and back, once in 2 s and twice, from rest at the initial pose.
A regulator is designed about the middle."""


COMPUTER = Beside("period")


def tracker_computed_torque(
    controller: Literal["computed_torque", "pd", "pd_gravity", "lqr"] = "computed_torque",
    period: Annotated[float, Between(0.0, 0.05, "s")] = 0.0,
    delay: Annotated[int, range(11), "periods", COMPUTER] = 0,
    resolution: Annotated[float, Between(0.0, 0.001, "m"), COMPUTER] = 0.0,
    force_limit: Annotated[float, Between(0.0, 1000.0, "N"), COMPUTER] = 0.0,
    mass_error: Annotated[float, Between(-0.5, 0.5, "of it"), Beside("controller", "computed_torque")] = 0.0,
) -> Scene:
    """The tracker under gravity, both sliders on a smooth reference, 2 s.

    Args:
        controller: computed torque; PD, without and with gravity compensation, or an LQR about the middle.
        period: of the computer that executes it; 0 for none, at all times.
        delay: of the computer, in periods.
        resolution: of the computer's encoders; 0 for none.
        force_limit: of the computer; 0 for none.
        mass_error: of the panel's mass in the model that computed torque has.
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
