"""Power screws against worked examples of textbooks, inclined planes and Euler's beam."""

from __future__ import annotations

import math

import pytest

from newton_euler.analysis.loads.power_screws import (
    ENDS,
    STEEL_DENSITY,
    STEEL_MODULUS,
    Thread,
    buckling_force,
    critical_speed,
    usual_back_efficiency,
)


def test_example_8_1_of_shigley():
    """Square thread of 32 mm with 4 mm pitch and two starts, 6.4 kN, friction 0.08, collar of 40 mm.

    Shigley's Mechanical Engineering Design, 10th edition, example 8-1: 26.18 N m, 9.77 N m, 0.311.
    """
    thread = Thread(0.008, 0.030, 0.08, collar_diameter=0.040, collar_friction=0.08)
    assert thread.raising_torque(6400.0) == pytest.approx(26.18, abs=0.005)
    assert thread.lowering_torque(6400.0) == pytest.approx(9.77, abs=0.005)
    assert thread.efficiency == pytest.approx(0.311, abs=0.0005)
    assert thread.back_efficiency < 0.0
    # without the collar the load turns the screw: the example's -0.466 N m
    bare = Thread(0.008, 0.030, 0.08)
    assert bare.lowering_torque(6400.0) == pytest.approx(-0.466, abs=0.0005)
    assert bare.back_efficiency > 0.0


def test_example_17_1_of_mott():
    """Acme thread, 12,500 lb, pitch diameter 1.3429 in, lead 0.25 in, friction 0.15: 1809 lb in.

    R. L. Mott, Machine Elements in Mechanical Design, 4th edition, example problem 17-1. The numbers in
    its solution give 1814; without the flank angle the torque is 2 % smaller.
    """
    thread = Thread(0.25, 1.3429, 0.15, math.radians(14.5))  # in inches: torques are in lb in
    assert thread.raising_torque(12_500.0) == pytest.approx(1809.0, rel=4e-3)


def test_square_thread_is_an_inclined_plane():
    """Torque W r tan(friction angle +- lead angle), as of a wedge."""
    radius, lead, friction = 0.01, 0.006, 0.1
    slope, angle = math.atan(lead / (2.0 * math.pi * radius)), math.atan(friction)
    thread = Thread(lead, 2.0 * radius, friction)
    assert thread.raising_torque(100.0) == pytest.approx(100.0 * radius * math.tan(angle + slope), rel=1e-12)
    assert thread.lowering_torque(100.0) == pytest.approx(100.0 * radius * math.tan(angle - slope), rel=1e-12)
    assert thread.efficiency == pytest.approx(math.tan(slope) / math.tan(angle + slope), rel=1e-12)


@pytest.mark.parametrize("flank", [0.0, math.radians(15.0)])
def test_self_locking_begins_where_friction_exceeds_the_slope(flank):
    """Shigley (8-3): pi f d > l, with f / cos(flank) for inclined flanks."""
    lead, diameter = 0.004, 0.018
    critical = lead * math.cos(flank) / (math.pi * diameter)
    assert Thread(lead, diameter, 0.999 * critical, flank).back_efficiency > 0.0
    assert Thread(lead, diameter, critical, flank).back_efficiency == pytest.approx(0.0, abs=1e-12)
    assert Thread(lead, diameter, 1.001 * critical, flank).back_efficiency < 0.0
    assert Thread(lead, diameter, critical, flank).efficiency < 0.5


def test_a_thread_without_friction_loses_nothing():
    thread = Thread(0.004, 0.018, 0.0)
    assert (thread.efficiency, thread.back_efficiency) == pytest.approx((1.0, 1.0), abs=1e-15)


def test_a_screw_with_too_much_lead_wedges():
    assert Thread(0.1, 0.01, 0.3).can_turn
    assert not Thread(0.11, 0.01, 0.3).can_turn  # pi d = 31.4 mm, f l = 33 mm


def test_losses_of_a_stage_are_the_same_in_both_directions():
    assert usual_back_efficiency(0.9) == pytest.approx(1.0 - (1.0 / 0.9 - 1.0))
    assert usual_back_efficiency(0.5) == 0.0


def test_buckling_and_critical_speed_of_a_rod():
    """A rod of 16 mm and 1 m: Euler's force, and the bending frequency of a beam on two supports."""
    inertia, area = math.pi * 0.016**4 / 64.0, math.pi * 0.008**2
    supported = ENDS["supported"]
    euler = math.pi**2 * STEEL_MODULUS * inertia
    assert buckling_force(0.016, 1.0, supported) == pytest.approx(euler, rel=1e-12)
    frequency = math.pi**2 * math.sqrt(STEEL_MODULUS * inertia / (STEEL_DENSITY * area))
    assert critical_speed(0.016, 1.0, supported) == pytest.approx(frequency, rel=1e-12)
    ratios = {name: buckling_force(0.016, 1.0, ends) / euler for name, ends in ENDS.items()}
    assert ratios == pytest.approx(
        {"fixed-free": 0.25, "supported": 1.0, "fixed-supported": 2.0, "fixed": 4.0}
    )


@pytest.mark.parametrize(
    ("name", "equation"),
    [
        ("fixed-free", lambda x: math.cos(x) * math.cosh(x) + 1.0),
        ("fixed-supported", lambda x: math.tan(x) - math.tanh(x)),
        ("fixed", lambda x: math.cos(x) * math.cosh(x) - 1.0),
    ],
)
def test_roots_of_beams_solve_their_frequency_equations(name, equation):
    """The sign of the equation of a uniform beam changes within the digits of the root."""
    root = math.sqrt(ENDS[name].bending)
    assert equation(root - 2e-5) * equation(root + 2e-5) < 0.0
