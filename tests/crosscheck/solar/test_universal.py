"""A day of a panel on a universal joint, with a controller at each of its two coordinates."""

import numpy as np
import pytest

from crosscheck.solar.day import tracker_day
from crosscheck.solar.place import Place
from crosscheck.solar.results import summary_of, table_of_set_points
from crosscheck.solar.tracking import Tracking
from newton_euler import PD, Axis, Body, Box, Mechanism, Scene, Universal

NORMAL = Axis("panel", [0.0, 0.0, 1.0])

HEIGHT, G = 0.2, 9.81
"""Height of the center of the panel above the joint, m, and gravity, m/s^2."""


@pytest.fixture(scope="module")
def day():
    panel = Body.solid("panel", Box([0.5, 0.5, 0.02], center=[0, 0, HEIGHT]), density=100)
    joint = Universal(
        "u", "ground", "panel", [0, 0, 0], axis_on_first=[0, 1, 0], axis_on_second=[1, 0, 0], actuated=True
    )
    control = [PD("u", 2000.0, 200.0, 0.0, coordinate) for coordinate in (0, 1)]
    scene = Scene(
        "cardan", Mechanism([Body.ground(), panel], [joint]), 1.0, 0.1, gravity=[0, 0, -G], control=control
    )
    tracking = Tracking(max_tilt=60.0)
    return tracker_day(scene, NORMAL, Place(37.4, -6.0), "2026-03-21", tracking=tracking, period=3600.0)


def test_both_coordinates_have_the_torque_of_the_weight(day):
    """The center is at HEIGHT cos a cos b above the joint: torques are slopes of the potential energy."""
    assert list(day.actuators) == list(day.set_points) == ["u.0", "u.1"]
    a, b = day.set_points.values()
    weight = G * 100 * 1.0 * 1.0 * 0.04
    expected = {
        "u.0": -weight * HEIGHT * np.sin(a) * np.cos(b),
        "u.1": -weight * HEIGHT * np.cos(a) * np.sin(b),
    }
    assert np.ptp(a) > 1.0
    assert np.ptp(b) > 0.5
    for name, torque in expected.items():
        assert day.actuators[name].unit == "N m"
        assert day.actuators[name].holding[1:] == pytest.approx(torque[:-1], abs=1e-5)


def test_results_have_both_coordinates(day):
    """Energy by an own sum of the positive work of the simulated motion."""
    for (name, found), motion in zip(summary_of(day)["actuators"].items(), day.motions, strict=True):
        steps = 0.5 * (motion.force[1:] + motion.force[:-1]) * np.diff(motion.position)
        assert motion.name == name
        assert found["energy"] == pytest.approx(steps[steps > 0.0].sum(), rel=1e-12)
    header = table_of_set_points(day).decode().splitlines()[0].split(",")
    assert {"u.0_rad", "u.1_rad", "u.0_holding_N_m", "u.1_moving_N_m"} <= set(header)
