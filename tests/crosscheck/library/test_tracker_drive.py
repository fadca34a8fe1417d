"""The tracker on lead screws: efficiencies, what the motors need, and that the screws hold without them."""

from dataclasses import replace

import numpy as np
import pytest

import newton_euler
from crosscheck.library import load
from crosscheck.library.tracker_drive import LEAD, PITCH_DIAMETER, RATIO, screw_efficiencies
from newton_euler import PD, statics


def test_efficiencies_of_a_worked_example():
    """Shigley's Mechanical Engineering Design, Example 8-1: a square thread of lead 8 mm and mean diameter
    30 mm, friction 0.08; without the collar 15.94 N m raise and -0.466 N m lower 6.4 kN."""
    raising, lowering = 15.94, -0.466
    ideal = 6400.0 * 0.008 / (2.0 * np.pi)
    screw = screw_efficiencies(0.08, lead=0.008, diameter=0.030)
    assert ideal / screw.forward == pytest.approx(raising, abs=0.01)
    assert -ideal * screw.backward == pytest.approx(lowering, abs=0.01)


def test_a_thread_without_friction_loses_nothing():
    assert screw_efficiencies(0.0) == pytest.approx((1.0, 1.0), abs=1e-15)


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_a_thread_locks_itself_from_the_tangent_of_the_lead_angle_on(factor):
    friction = factor * LEAD / (np.pi * PITCH_DIAMETER)
    assert (screw_efficiencies(friction).backward < 0.0) == (factor > 1.0)


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


def test_motors_need_the_force_on_the_slider_over_the_efficiency_of_the_screw():
    """At half the first stroke, raising at constant speed but for the sine's small acceleration."""
    scene = load("tracker_drive", play=0.0)
    run = newton_euler.simulate(scene)
    row = 62  # 0.62 s: a quarter of the second slider's period, its fastest motion upwards
    state = run.state(row)
    held = statics(replace(scene, forces=(), control=()), state, ["slide_12", "slide_13"])
    speed = run.joint("slide_13").rates[row, 0]
    rail, bearing = 0.4 + 0.2 / (1.0 + (speed / 0.01) ** 2), 1e-3
    torque = RATIO * (held.actuator_force[1] + rail) / screw_efficiencies(0.15).forward + bearing
    # the panel's accelerations at this speed are 1e-2 of gravity's
    assert run.actuator_force[row, 1] == pytest.approx(torque, rel=0.01)
