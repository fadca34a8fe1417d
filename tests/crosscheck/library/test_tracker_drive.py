"""The tracker on lead screws: what the motors need, and that the screws hold without them."""

from dataclasses import replace

import numpy as np
import pytest

import newton_euler
from crosscheck.library import load
from crosscheck.library.tracker_drive import LEAD, PITCH_DIAMETER, RATIO, ROTOR_INERTIA
from newton_euler import PD, inverse_dynamics, statics
from newton_euler.analysis.loads.actuator_motions import ActuatorMotion
from newton_euler.analysis.loads.drives import Drive, Screw, motor_motion
from newton_euler.analysis.loads.power_screws import Thread

SCREW = Thread(LEAD, PITCH_DIAMETER, friction=0.15)


@pytest.mark.slow
def test_the_screws_hold_the_panel_without_motors():
    """They creep by less than the transition speed, and with little friction the panel falls."""
    drops = []
    for friction in (0.15, 0.02):
        scene = load("tracker_drive", friction=friction)
        free = tuple(PD(law.joint, 0.0, 0.0, 0.0) for law in scene.control)
        run = newton_euler.simulate(replace(scene, control=free, duration=0.5), integrator="Radau", rtol=1e-7)
        drops.append(-run.joint("slide_12").coordinates[-1, 0])
    assert 0.0 < drops[0] < 5e-4
    assert drops[1] > 2.0 * drops[0]


@pytest.fixture(scope="module")
def driven():
    """The scene without play, and its run."""
    scene = load("tracker_drive", play=0.0)
    return scene, newton_euler.simulate(scene)


@pytest.mark.slow
def test_motors_need_the_force_on_the_slider_over_the_efficiency_of_the_screw(driven):
    """At half the first stroke, raising at constant speed but for the sine's small acceleration."""
    scene, run = driven
    row = 62  # 0.62 s: a quarter of the second slider's period, its fastest motion upwards
    state = run.state(row)
    held = statics(replace(scene, forces=(), control=()), state, ["slide_12", "slide_13"])
    speed = run.joint("slide_13").rates[row, 0]
    rail, bearing = 0.4 + 0.2 / (1.0 + (speed / 0.01) ** 2), 1e-3
    torque = RATIO * (held.actuator_force[1] + rail) / SCREW.efficiency + bearing
    # the panel's accelerations at this speed are 1e-2 of gravity's
    assert run.actuator_force[row, 1] == pytest.approx(torque, rel=0.01)


@pytest.mark.slow
def test_sizing_of_drives_gives_the_torque_of_the_simulated_motors(driven):
    """Raised and lowered, also against the self-locking screws; at both ends of a stroke the nuts vibrate."""
    scene, run = driven
    names = ["slide_12", "slide_13", "motor_2", "motor_3"]
    rates = {name: run.joint(name).rates[:, 0] for name in names}
    accelerations = {name: np.gradient(rate, run.time, edge_order=2) for name, rate in rates.items()}
    needed = inverse_dynamics(replace(scene, forces=(), control=()), run, accelerations, names)
    stages = Screw(LEAD, SCREW.efficiency, SCREW.back_efficiency)
    drive = Drive("motor", 1.0, 1.0, 1e4, friction_torque=1e-3, motor_inertia=ROTOR_INERTIA, screw=stages)
    middles = 0.5 * (run.time[1:] + run.time[:-1])
    for k, name in enumerate(names[:2]):
        speed = rates[name]
        rail = (0.4 + 0.2 / (1.0 + (speed / 0.01) ** 2)) * np.sign(speed)
        force, position = needed.actuator_force[:, k] + rail, run.joint(name).coordinates[:, 0]
        motion = ActuatorMotion(name, True, run.time, force, position, speed)
        torque = motor_motion(drive, motion).torque.mean(axis=0)
        simulated = 0.5 * (run.actuator_force[1:, k] + run.actuator_force[:-1, k])
        steady = ((middles > 0.5) & (middles < 1.1)) | ((middles > 1.9) & (middles < 2.3))
        assert torque[steady] == pytest.approx(simulated[steady], rel=2e-3)
        assert np.sign(torque[middles > 1.9][0]) == (1.0 if k == 0 else -1.0)  # pushed down
