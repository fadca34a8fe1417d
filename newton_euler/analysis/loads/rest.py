"""Static load cases: a scene held at rest in its initial pose, under constant values of inputs that vary in
time.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from newton_euler.analysis.loads.statics import statics
from newton_euler.arguments import checked
from newton_euler.model.motions import TimeFunction, terms
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.trajectory import Trajectory
from newton_euler.model.wind import WindLoad
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Floats, Stack, unstacked

MIN_SAMPLES, MAX_SAMPLES = 1_000, 1_000_000
"""Smallest and largest number of times over a run at which the largest speed of a wind is searched."""

SAMPLES_PER_PERIOD = 40
"""Times per period of the fastest sine; the largest value is then found within 0.4 % of the amplitude."""


class HeldWind(NamedTuple):
    """Constant speed that stands for a wind speed that varies in time.

    Attributes:
        load: name of the wind load.
        component: "speed" or "vertical_speed".
        speed: the speed of largest magnitude over the run, m/s.
        time: time of this speed in the run, s.
        mean: mean speed over the run, m/s.
    """

    load: str
    component: str
    speed: float
    time: float
    mean: float


@checked
def rest_case(scene: Scene) -> Trajectory:
    """Hold a scene at rest in its initial pose by its actuators: a trajectory with one output.

    Inputs that vary in time have these values:

    - wind: its largest speed over the run, as for an equivalent static gust (`wind_at_peak`);
    - prescribed motions, also those of a moving base: their values at time 0, without velocity and
      acceleration;
    - targets of control laws do not matter, because the actuators hold the initial pose.

    `newton_euler.statics` takes other poses, too.

    Raises:
        NewtonEulerError: see `statics`.

    Examples:
        >>> scene = load("tracker_gravity")
        >>> envelope = load_envelope(scene, {"weight": rest_case(scene)})
        >>> up = [envelope.of(name, "actuator force").maximum for name in ("slide_12", "slide_13")]
        >>> weight = sum(up) + envelope.of("hinge_14", "force z").maximum  # what actuators and hinge hold
        >>> round(weight / 9.81, 3)  # kg
        1.482
    """
    scene, _ = wind_at_peak(scene)
    loads, state = statics(scene), initial_state(scene)
    zero_velocities = np.zeros_like(state.position)[None]
    return Trajectory(
        engine="newton_euler",
        settings={},
        wall_time=0.0,
        time=np.zeros(1),
        body_names=scene.mechanism.body_names,
        joint_names=scene.mechanism.joint_names,
        position=state.position[None],
        quaternion=state.quaternion[None],
        linear_velocity=zero_velocities,
        angular_velocity=zero_velocities,
        reaction_force=loads.reaction_force[None],
        reaction_torque=loads.reaction_torque[None],
        actuator_force=loads.actuator_force[None],
        angle_names=tuple(scene.mechanism.coordinate_labels[key] for key in state.angles),
        joint_angle=np.array([[*state.angles.values()]]) if state.angles else None,
        mechanism=scene.mechanism,
    )


def wind_at_peak(scene: Scene) -> tuple[Scene, list[HeldWind]]:
    """Replace wind speeds that vary in time by their values of largest magnitude over the run.

    Returns:
        The scene with constant winds, and the replaced speeds.
    """
    forces, held = list(scene.forces), list[HeldWind]()
    for k, force in enumerate(forces):
        if not isinstance(force, WindLoad):
            continue
        constant = dict[str, Any]()
        for component in force.functions:
            function = getattr(force, component)
            if isinstance(function, TimeFunction):
                times = _sample_times(function, scene.duration)
                speeds = unstacked([function.value(Stack(times))], len(times))[:, 0]
                row = int(np.argmax(np.abs(speeds)))
                found = float(speeds[row]), float(times[row]), float(np.mean(speeds))
                held.append(HeldWind(force.name, component, *found))
                constant[component] = held[-1].speed
        forces[k] = replace(force, **constant)
    return replace(scene, forces=tuple(forces)) if held else scene, held


def _sample_times(function: TimeFunction, duration: float) -> Floats:
    """Return times (n,), s, from 0 to a duration, close enough for the fastest sine of a function."""
    frequencies = [abs(term.angular_frequency) for term in terms(function) if isinstance(term, Sine)]
    periods = max(frequencies, default=0.0) * duration / (2.0 * np.pi)
    count = int(np.clip(SAMPLES_PER_PERIOD * periods, MIN_SAMPLES, MAX_SAMPLES)) + 1
    # knots, where steps jump; the mean is that of evenly spaced times, which the few knots hardly change
    knots = [knot for knot in function.knots if knot <= duration]
    return np.union1d(np.linspace(0.0, duration, count), knots)
