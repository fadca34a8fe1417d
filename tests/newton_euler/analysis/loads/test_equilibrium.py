"""Equilibria: where runs end, which of several wells, unstable ones, and branches beyond singular poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import mass_on_rail, pendulum

from crosscheck.library import load
from crosscheck.library.slider_crank import PIVOT
from newton_euler import (
    PD,
    BranchWarning,
    Digital,
    JointSpring,
    PointSpring,
    Polynomial,
    PrescribedMotion,
    Scene,
    Sine,
    Spline,
    Steps,
    equilibrium,
    initial_state,
    linearize,
    simulate,
    solve_poses,
    start,
    statics,
)
from newton_euler.analysis.kinematics.crossings import passage
from newton_euler.analysis.loads.equilibrium import settle
from newton_euler.errors import MechanismError
from newton_euler.model.scene import Force

G = 9.81
SLIDERS = "slide_12", "slide_13"
TIMES = np.linspace(0.0, 10.0, 101)
RAMP = TIMES / 10.0
"""Times, s, and fractions of a ramp."""

AROUND, REST = 0.3, 0.5
"""m: distance of the spring's foot from the rail, and length of the spring without force."""


def two_wells(*others: Force, height: float, speed: float) -> Scene:
    """A mass on a vertical rail, whose spring pushes it away from the middle: at rest at +-0.4 m."""
    spring = PointSpring(
        "snap", "ground", "mass", [AROUND, 0.0, 0.0], [0.0] * 3, stiffness=80.0, rest_length=REST
    )
    return start(mass_on_rail(spring, *others, duration=3.0), rail=(height, speed))


def height(scene: Scene, state) -> float:
    """Height of the mass, m."""
    return state.position[scene.mechanism.body_index("mass"), 2]


@pytest.mark.parametrize(("speed", "well"), [(0.0, 0.4), (-0.2, 0.4), (-4.0, -0.4), (-8.0, 0.4)])
def test_equilibrium_is_the_well_in_which_the_run_settles(speed, well):
    """A fast mass passes the middle, and returns if the damper leaves it enough speed."""
    scene = two_wells(JointSpring("rail", 0.0, 6.0), height=0.3, speed=speed)
    long = simulate(replace(scene, duration=60.0))
    assert long.joint("rail").coordinates[-1, 0] == pytest.approx(well, abs=1e-9)
    found = settle(scene)
    assert found.settles
    assert height(scene, found.state) == pytest.approx(well, abs=1e-12)
    assert height(scene, equilibrium(scene)) == pytest.approx(well, abs=1e-12)
    # a state that is given is one at rest
    assert height(scene, equilibrium(scene, initial_state(scene))) == pytest.approx(0.4, abs=1e-12)


def test_slow_motion_ends_in_the_well_of_the_start_without_damping():
    for side in (1.0, -1.0):
        scene = two_wells(height=side * 0.1, speed=0.0)
        found = settle(scene)
        assert not found.settles
        assert height(scene, found.state) == pytest.approx(side * 0.4, abs=1e-12)


def test_unstable_equilibria_stay_unless_the_start_moves_away():
    standing = pendulum(angle=np.pi)
    assert equilibrium(standing).position[1, 2] == pytest.approx(0.5, abs=1e-12)
    assert linearize(standing, equilibrium(standing)).modes().damping_ratios.min() == pytest.approx(-1.0)
    pushed = start(standing, pivot=(0.0, 0.3))
    assert equilibrium(pushed).position[1, 2] == pytest.approx(-0.5, abs=1e-12)  # undamped, never at rest
    damped = replace(pushed, forces=(JointSpring("pivot", 0.0, 0.5),))
    assert settle(damped).settles
    assert equilibrium(damped).position[1, 2] == pytest.approx(-0.5, abs=1e-12)


def test_a_start_at_rest_in_equilibrium_is_returned():
    scene = pendulum(angle=0.0)
    found = settle(scene)
    assert found.settles
    assert found.passage.rows == ()
    assert np.array_equal(found.state.position, initial_state(scene).position)


@pytest.mark.slow
@pytest.mark.parametrize("forces", [(), (JointSpring("rail", 0.0, 2.0),)])
def test_falling_without_end_is_refused_in_one_line(forces):
    """Without a damper the mass falls ever faster, with one at a constant speed."""
    with pytest.raises(
        MechanismError, match="coordinate 'rail' still accelerates; needed: a spring or"
    ) as caught:
        equilibrium(mass_on_rail(*forces, gravity=(0.0, 0.0, -G)))
    assert "\n" not in str(caught.value)


def test_a_mechanism_that_cannot_move_has_no_equilibrium_to_search():
    held = mass_on_rail(motions=(PrescribedMotion("rail", Polynomial((0.0,))),))
    with pytest.raises(MechanismError, match="has no degree of freedom"):
        equilibrium(held)


@pytest.mark.parametrize(
    ("target", "held_at", "value"),
    [
        (Steps((0.0, 1.0, 2.0), (0.1, 0.3, 0.2)), 10.0, 0.2),
        (Spline(TIMES, 0.2 * RAMP**3 * (10.0 - 15.0 * RAMP + 6.0 * RAMP**2)), 10.0, 0.2),
        (Sine(0.1, 2.0, offset=0.05), 0.0, 0.05),
        (Polynomial((0.1, 0.02)), 0.0, 0.1),
    ],
)
def test_set_points_are_held_at_the_end_of_the_run_if_they_rest_there(target, held_at, value):
    """An interpolated step ends with zero rate and acceleration; others hold their values at the start."""
    scene = mass_on_rail(control=(PD("rail", 50.0, 8.0, target),))
    found = settle(scene)
    assert found.time == held_at
    assert found.state.position[1, 2] == pytest.approx(value, abs=1e-6)
    assert equilibrium(scene).position[1, 2] == pytest.approx(float(target.value(0.0)), abs=1e-12)
    assert settle(scene, time=1.5).state.position[1, 2] == pytest.approx(float(target.value(1.5)), abs=1e-9)
    model = linearize(found.scene, found.state)
    assert model.is_equilibrium


def test_digital_laws_have_no_equilibrium():
    law = Digital(PD("rail", 50.0, 5.0, 0.1), period=0.01)
    with pytest.raises(MechanismError, match="has no derivative, being sampled"):
        equilibrium(mass_on_rail(control=(law,)))


def test_passages_of_a_slider_crank_are_its_dead_centers():
    """The slider does not determine the crank where the crank points to the slider's axis or away from it."""
    scene = load("slider_crank")
    center = np.arctan2(-PIVOT[1], PIVOT[2])  # the crank begins along z
    angles = np.linspace(-1.0, 5.5, 131)
    poses = solve_poses(scene, {"pivot": angles})
    path = [poses.state(k) for k in range(len(angles))]
    found = passage(scene, path, coordinates=["guide"])
    expected = np.searchsorted(angles, [center, center + np.pi, center + 2.0 * np.pi])
    assert found.rows == tuple(expected[expected < len(angles)])
    assert found.beyond == (len(found.rows) % 2 == 1)
    assert passage(scene, path, coordinates=["pivot"]).rows == ()


@pytest.mark.slow
def test_the_tracker_falls_through_a_singular_configuration():
    """Its run ends on another branch: the initial branch has no pose with sliders as low."""
    scene = load("tracker_gravity")
    run = simulate(replace(scene, duration=20.0, output_period=0.01))
    ends = {name: run.joint(name).coordinates[-1, 0] for name in SLIDERS}
    assert list(ends.values()) == pytest.approx([0.0330, -0.0427], abs=5e-5)
    found = settle(scene)
    assert found.settles
    assert found.passage.coordinates == SLIDERS
    (time,) = found.passing_times
    # the smallest singular value of the sliders' Jacobian is least where the run passes
    begin = solve_poses(scene, {name: run.joint(name).coordinates[:12, 0] for name in SLIDERS})
    assert begin.reached.all()
    assert np.all(np.diff(begin.independence(SLIDERS)) < 0.0)
    assert 0.11 < time < 0.15
    beyond = solve_poses(scene, ends)
    assert not beyond.reached.any()
    np.testing.assert_allclose(found.state.position, run.position[-1], rtol=0.0, atol=1e-9)
    # loads along the run are those of the initial branch until then
    begin = simulate(replace(scene, duration=0.3, output_period=0.01))
    loads = statics(scene, begin)
    first = np.flatnonzero(loads.beyond)[0]
    assert abs(time - begin.time[first]) < 0.026  # outputs of the search are 25 ms apart
    assert loads.beyond[first:].all()
    assert not statics(scene).beyond
    with pytest.warns(
        BranchWarning, match="beyond a singular configuration of 'slide_12', 'slide_13'"
    ) as caught:
        equilibrium(scene)
    assert caught[0].message.coordinates == SLIDERS
