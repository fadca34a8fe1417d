"""Wind on plates against published coefficients and closed forms; gusts and spectra of wind."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from mechanisms import mass_on_rail
from scipy.integrate import quad

import mjcf
import newton_euler
import urdf
from newton_euler import (
    Body,
    Free,
    Mechanism,
    NewtonEulerError,
    Polynomial,
    Scene,
    Spline,
    State,
    Steps,
    WindLoad,
    wind_gust,
    wind_turbulence,
)
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.applied_forces import surroundings
from newton_euler.model.euler_parameters import rotation
from newton_euler.reading.wrenches import Wrenches

X, Y, Z = np.eye(3)
SPEED = 20.0
PRESSURE = 0.5 * 1.225 * SPEED**2
CALM = 1e-6
"""Of coefficients at 20 m/s: speeds are off by (0.01 m/s)^2 / 2 speed."""


def floating(*loads: WindLoad, velocity=(0.0, 0.0, 0.0)) -> Scene:
    plate = Body("plate", 2.0, [0.0, 0.0, 1.0], np.diag([0.1, 0.1, 0.2]))
    mechanism = Mechanism([Body.ground(), plate], [Free("floats", "ground", "plate", [0.0, 0.0, 0.0])])
    state = replace(State.initial(mechanism), linear_velocity=np.array([np.zeros(3), velocity]))
    return Scene("plate", mechanism, 1.0, 0.1, forces=loads, initial_state=state)


def load(length=1.0, width=1.0, direction=X, speed=SPEED, **more) -> WindLoad:
    """On a plate across z at the body's center of mass."""
    sides = {"first_side": length * X, "second_side": width * Y}
    return WindLoad("wind", "plate", [0.0, 0.0, 1.0], **sides, direction=direction, speed=speed, **more)


def acting(wind: WindLoad, **more) -> tuple[np.ndarray, np.ndarray]:
    """Force and torque about the plate's center."""
    scene = floating(wind, **more)
    ((_, wrench),) = wind.wrenches(surroundings(scene, scene.initial_state))
    return wrench[:3], wrench[3:]


@pytest.mark.parametrize(
    ("length", "width", "coefficient", "tolerance"),
    [(1.0, 1.0, 1.17, 0.01), (0.5, 0.5, 1.17, 0.01), (2000.0, 1.0, 1.98, 0.01)],
)
def test_plates_across_the_wind_have_hoerners_drag(length, width, coefficient, tolerance):
    """1.17 of a square and 1.98 of an endless plate: S. F. Hoerner, Fluid-Dynamic Drag, 1965, chapter 3."""
    force, torque = acting(load(length, width, direction=-Z))
    assert force[2] / (PRESSURE * length * width) == pytest.approx(-coefficient, abs=tolerance)
    assert np.abs([*force[:2], *torque]).max() < 1e-12


@pytest.mark.parametrize("degrees", [20.0, 45.0, 70.0, 110.0, -30.0])
def test_force_and_center_of_pressure_at_an_angle(degrees):
    """Along the longer side of a plate of 3 m by 1 m, by the formulas in degrees."""
    angle = np.radians(degrees)
    force, torque = acting(load(3.0, 1.0, direction=np.cos(angle) * X + np.sin(angle) * Z))
    sine, attack = abs(np.sin(angle)), np.degrees(np.arcsin(abs(np.sin(angle))))
    normal = 1.98 * sine * (1.0 / (0.56 + 0.44 * sine) - 0.41 * (1.0 - np.exp(-17.0 / 3.0)))
    assert force[2] == pytest.approx(np.sign(np.sin(angle)) * 3.0 * PRESSURE * normal, rel=CALM)
    ahead = 0.175 * (1.0 - attack / 90.0) * 3.0
    towards = -np.sign(np.cos(angle))  # the edge that the wind meets first
    assert -torque[1] / force[2] == pytest.approx(towards * ahead, rel=1e-4)  # 0.01 of 7 m/s along the plate
    assert np.abs([force[0], force[1], torque[0], torque[2]]).max() < 1e-9


def test_only_the_relative_wind_counts():
    still, moving = acting(load(direction=-Z)), acting(load(direction=-Z, speed=5.0), velocity=15.0 * Z)
    assert moving[0] == pytest.approx(still[0], rel=1e-12)
    assert np.abs(acting(load(direction=Z), velocity=SPEED * Z)).max() == 0.0


def test_both_writings_agree():
    """Round-off of some ten operations."""
    rng = np.random.default_rng(5)
    for velocity in rng.normal(size=(20, 3)) * np.geomspace(1e-4, 30.0, 20)[:, None]:
        wind = load(*rng.uniform(0.5, 2.0, 2), rng.normal(size=3), speed=rng.normal())
        force, torque = acting(wind, velocity=velocity)
        scene = floating(wind, velocity=velocity)
        found = Wrenches(scene.mechanism, scene.initial_state).wind(wind)
        assert found == pytest.approx([force[2], *torque[:2]], rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_plate_falls_at_its_terminal_speed(formulation):
    """v = v_t tanh(g t / v_t); below 0.01 m/s, in the first millisecond, drag is no square of the speed."""
    plate = WindLoad("air", "mass", np.zeros(3), first_side=X, second_side=Y, direction=X, speed=0.0)
    run = newton_euler.simulate(mass_on_rail(plate, gravity=(0.0, 0.0, -9.81)), formulation)
    mass = run.mechanism.body("mass").mass
    terminal = np.sqrt(mass * 9.81 / (0.5 * 1.225 * 1.98 * (1.0 - plate.end_loss)))
    wanted = -terminal * np.tanh(9.81 * run.time / terminal)
    assert run.linear_velocity[:, 1, 2] == pytest.approx(wanted, abs=1e-5 * terminal)
    energy = run.kinetic_energy + run.potential_energy
    assert energy - energy[0] == pytest.approx(run.work, abs=1e-8 * abs(run.work[-1]))


def test_a_calm_is_smooth():
    """No force, and a slope, where the relative wind is zero or along the plate."""
    step = 1e-6
    for direction in (X, Z):
        for speed in (0.0, 10.0) if direction is X else (0.0,):
            forces = [
                acting(load(direction=direction, speed=speed), velocity=v * Z)[0][2] for v in (-step, 0, step)
            ]
            assert forces[1] == 0.0
            assert forces[0] == pytest.approx(-forces[2], rel=1e-6)
            assert forces[0] > 0.0


def test_a_changed_wind_needs_no_new_code():
    scene = floating(load(direction=[1.0, 2.0, 2.0], speed=Polynomial((3.0, 1.0))))
    names = ("wind.speed", "wind.air_density", "wind.direction")
    compiled = newton_euler.compile_scene(scene, parameters=names)
    other = load(direction=[0.0, 1.0, 1.0], speed=Polynomial((6.0, 2.0)), air_density=1.0)
    scene = replace(scene, forces=(other,))
    found, wanted = compiled.with_scene(scene).simulate(), newton_euler.simulate(scene)
    assert found.position == pytest.approx(wanted.position, rel=1e-10, abs=1e-12)
    assert abs(found.position[-1]).max() > 3.0  # blown away


@pytest.mark.parametrize(
    "speed", [Steps([0.0, 0.333], [3.0, 12.0]), Spline([0.0, 0.4, 1.1], [2.0, 9.0, 4.0])]
)
def test_winds_that_jump_and_follow_samples(speed):
    """Runs are cut at knots: tolerances of 1e-10, and in MuJoCo steps that a jump falls into no one of."""
    scene = floating(load(2.0, 1.0, [1.0, 0.5, 1.0], speed))
    runs = [engine.simulate(scene) for engine in (newton_euler, urdf, mjcf)]
    assert runs[1].position == pytest.approx(runs[0].position, abs=1e-8)
    assert runs[2].position == pytest.approx(runs[0].position, abs=1e-8)
    assert abs(runs[0].position[-1, 1, 2] - 1.0) > 1.0


def kaimal(f, mean, deviation, length):
    return 4.0 * deviation**2 * length / mean / (1.0 + 6.0 * f * length / mean) ** (5.0 / 3.0)


def test_turbulence_has_kaimals_spectrum():
    """Each sine the variance of its part of the band, and all of it in the time series of many periods."""
    mean, deviation, length, count = 10.0, 1.5, 12.0, 8
    wind = wind_turbulence(mean, deviation, length, seed=4, lowest=0.05, highest=5.0, count=count)
    edges = np.geomspace(0.05, 5.0, count + 1)
    parts = list(pairwise(edges))
    variances = [quad(kaimal, *part, args=(mean, deviation, length))[0] for part in parts]
    sines = wind.terms[1:]
    assert [0.5 * sine.amplitude**2 for sine in sines] == pytest.approx(variances, rel=1e-9)
    for sine, (low, high) in zip(sines, parts, strict=True):
        assert low <= sine.angular_frequency / (2.0 * np.pi) < high
    whole = wind_turbulence(mean, deviation, length, seed=4, lowest=1e-7, highest=1e7)
    assert sum(0.5 * sine.amplitude**2 for sine in whole.terms[1:]) == pytest.approx(deviation**2, rel=1e-4)
    series = [wind.value(t) for t in np.arange(0.0, 2000.0, 0.1)]
    # beats of neighboring sines over 100 periods of the slowest
    assert np.mean(series) == pytest.approx(mean, abs=0.01 * deviation)
    assert np.var(series) == pytest.approx(sum(variances), rel=0.02)


def test_seeds_choose_among_winds():
    one, same, other = (wind_turbulence(10.0, 1.0, 12.0, seed) for seed in (1, 1, 2))
    assert one == same
    assert one != other


def test_the_gust_is_that_of_the_standard():
    wind, period = wind_gust(12.0, 6.0), 10.5
    for t in np.linspace(0.0, period, 22):
        angle = np.pi * t / period
        wanted = 12.0 - 0.37 * 6.0 * np.sin(3.0 * angle) * (1.0 - np.cos(2.0 * angle))
        assert wind.value(t) == pytest.approx(wanted, abs=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: load(direction=np.zeros(3)),
            "wind load 'wind': direction is [0.0, 0.0, 0.0]; needed: a vector",
        ),
        (lambda: replace(load(), second_side=X), "its sides have a cosine of 1; needed: perpendicular sides"),
        (lambda: load(length=0.0), "wind load 'wind': first_side is [0.0, 0.0, 0.0]"),
        (lambda: load(speed="strong"), "wind load 'wind': speed is 'strong'; needed: a finite number"),
        (lambda: load(air_density=-1.0), "air_density is -1.0; needed: a finite number, 0 or more"),
        (lambda: floating(replace(load(), body="ground")), "wind load 'wind': acts on the ground 'ground'"),
        (lambda: wind_gust(np.nan, 1.0), "wind_gust: mean is nan; needed: a finite number"),
        (lambda: wind_gust(1.0, 1.0, 0.0), "wind gust: period is 0.0; needed: a positive number"),
        (
            lambda: wind_turbulence(0.0, 1.0, 1.0, 1),
            "wind turbulence: mean is 0.0; needed: a positive number",
        ),
        (
            lambda: wind_turbulence(1.0, 1.0, 1.0, -1),
            "wind_turbulence: seed is -1; needed: a whole number, 0 or more",
        ),
        (
            lambda: wind_turbulence(1.0, 1.0, 1.0, 1, 2.0, 1.0),
            "wind turbulence: highest is 1 Hz; needed: more than lowest",
        ),
    ],
)
def test_winds_that_cannot_be(make, message):
    with pytest.raises(NewtonEulerError) as caught:
        make()
    assert message in str(caught.value)


def test_a_plate_turned_with_its_body():
    """The same plate described where it is, and where it was before its body turned."""
    p = np.array([0.8, 0.1, -0.5, 0.316227766016838])
    p /= np.linalg.norm(p)
    turn = rotation(p)
    scene = floating(load(2.0, 1.0, direction=[1.0, 2.0, 0.5]))
    state = replace(scene.initial_state, quaternion=np.array([scene.initial_state.quaternion[0], p]))
    turned = WindLoad(
        "wind", "plate", [0.0, 0.0, 1.0], first_side=2.0 * turn[:, 0], second_side=turn[:, 1],
        direction=[1.0, 2.0, 0.5], speed=SPEED,
    )  # fmt: skip
    ((_, found),) = scene.forces[0].wrenches(surroundings(scene, state))
    assert found == pytest.approx(np.concatenate(acting(turned)), rel=1e-12, abs=1e-12)
