"""Scene of the solar tracker under gravity: both sliders follow smooth references with one of four
controllers.

The controllers are computed torque, PD with and without gravity compensation, and an LQR (linear-quadratic
regulator).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from crosscheck.library.options import Between, OnlyWith
from crosscheck.library.tracker import tracker_gravity
from newton_euler.analysis.linear.regulator import lqr
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.digital_control import Digital, Law
from newton_euler.model.joint import Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.runs.variation import start

POSITION_GAIN, VELOCITY_GAIN = 400.0, 40.0
"""Gains of computed torque on position and velocity errors, 1/s^2 and 1/s.

Errors are critically damped and decay with exp(-20 t), t in s."""

EFFECTIVE_MASSES = {"slide_12": 2.5, "slide_13": 0.7}
"""Effective masses at the actuators in the initial pose, by joint, kg: force of an actuator divided by the
acceleration of its slider, with a constant force of the other actuator.

PD controllers with gains multiplied by these masses are as fast as computed torque."""

REFERENCES = {
    "slide_12": Sine(-0.01, angular_frequency=np.pi, phase=0.5 * np.pi, offset=0.01),
    "slide_13": Sine(-0.0075, angular_frequency=2.0 * np.pi, phase=0.5 * np.pi, offset=0.0075),
}
"""Reference displacements of the sliders by joint, m, from rest in the initial pose.

In 2 s, one slider moves up by 20 mm and back once, the other moves up by 15 mm and back twice."""

DIGITAL_ONLY = OnlyWith("period")
"""Condition of the options of digital controllers: the sampling period is not 0."""


def tracker_computed_torque(
    controller: Literal["computed_torque", "pd", "pd_gravity", "lqr"] = "computed_torque",
    period: Annotated[float, Between(0.0, 0.05, "s")] = 0.0,
    delay: Annotated[int, range(11), "periods", DIGITAL_ONLY] = 0,
    resolution: Annotated[float, Between(0.0, 0.001, "m"), DIGITAL_ONLY] = 0.0,
    force_limit: Annotated[float, Between(0.0, 1000.0, "N"), DIGITAL_ONLY] = 0.0,
    mass_error: Annotated[
        float, Between(-0.5, 0.5, unit="of it"), OnlyWith("controller", "computed_torque")
    ] = 0.0,
) -> Scene:
    """Return the tracker under gravity, both sliders on smooth references, 2 s.

    Args:
        controller: computed torque; PD without or with gravity compensation; or an LQR, designed for the
            equations linearized in the middle of the motion.
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
        control = tuple(Digital(law, period, delay, resolution, force_limit=limit) for law in laws)
    description = f"dual-axis solar tracker, {controller} along a smooth motion, under gravity"
    return replace(scene, name="tracker_computed_torque", description=description, control=control)


def _laws(
    scene: Scene, controller: str, mass_error: float
) -> tuple[PD | ComputedTorque | StateFeedback, ...]:
    """Make the continuous control laws of both actuators; arguments as of `tracker_computed_torque`."""
    if controller == "lqr":
        # the scene with both sliders at rest in the middle of their motions
        middle = start(scene, **{name: (reference.offset, 0.0) for name, reference in REFERENCES.items()})
        # weights of position and velocity errors: squares of the forces that the PD controllers would apply
        weights = [
            (gain * EFFECTIVE_MASSES[name]) ** 2
            for gain in (POSITION_GAIN, VELOCITY_GAIN)
            for name in REFERENCES
        ]
        targets: dict[str | Key, float | TimeFunction] = dict(REFERENCES.items())
        return lqr(
            scene,
            Q=weights,
            R=1.0,
            state=middle.initial_state,
            coordinates=list(REFERENCES),
            targets=targets,
        )
    if controller == "computed_torque":
        panel = scene.mechanism.body("panel_7")
        model = {"panel_7.mass": (1.0 + mass_error) * panel.mass} if mass_error else {}
        return tuple(
            ComputedTorque(name, POSITION_GAIN, VELOCITY_GAIN, reference, model=model)
            for name, reference in REFERENCES.items()
        )
    compensates = controller == "pd_gravity"
    return tuple(
        PD(
            name,
            POSITION_GAIN * mass,
            VELOCITY_GAIN * mass,
            REFERENCES[name],
            gravity_compensation=compensates,
        )
        for name, mass in EFFECTIVE_MASSES.items()
    )
