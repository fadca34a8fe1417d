"""Mechanisms on moving and floating bases, against their equations of motion and what is invariant."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from mechanisms import GRAVITY, inertia, pendulum
from scipy.integrate import solve_ivp

import newton_euler
import urdf
from crosscheck.library import load
from newton_euler.errors import ArgumentError, MechanismError, NewtonEulerError
from newton_euler.model.control import ComputedTorque
from newton_euler.model.euler_parameters import from_rotation_vector, product, rotations
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Spline
from newton_euler.runs.moving_base import base_motion_from_csv, on_moving_base

WAVES = {
    "surge": Sine(0.1, 0.7, phase=0.4),
    "sway": Polynomial((0.1, 0.2)),
    "heave": Sine(0.3, 1.1),
    "roll": Sine(0.2, 1.1, phase=0.5),
    "pitch": Sine(0.1, 1.7, phase=0.2),
    "yaw": Polynomial((0.4, 0.05)),
}


def quickly(scene: Scene) -> Scene:
    return replace(scene, duration=1.0, output_period=0.05)


def test_a_pendulum_on_a_shaken_base_follows_its_equation():
    """J theta'' = -m l ((g + z'') sin theta + x'' cos theta) about the pivot, by scipy; 1e-8 rad at 1e-10."""
    scene = pendulum(length=1.0, angle=1.0)
    rod = scene.mechanism.bodies[1]
    arm, moment = 0.5, 1.01 / 12.0 + 0.25  # m, kg m^2 of a bar of 1 kg and 1 m, as `mechanisms.bar` makes it
    surge, heave = Sine(0.2, 5.0), Sine(0.1, 7.0, phase=1.0)

    def rates(t, y):
        x, z = surge.acceleration(t), heave.acceleration(t)
        return [y[1], -rod.mass * arm * ((9.81 + z) * np.sin(y[0]) + x * np.cos(y[0])) / moment]

    exact = solve_ivp(rates, (0.0, 2.0), [1.0, 0.0], "DOP853", scene.times, rtol=1e-12, atol=1e-12).y[0]
    moving = on_moving_base(scene, {"heave": heave, "surge": surge})
    for simulate in (newton_euler.simulate, urdf.simulate):
        found = simulate(moving).joint("pivot").coordinates[:, 0]
        assert np.abs(found - found[0] - (1.0 - exact)).max() < 1e-8


def test_a_base_of_constant_velocity_changes_no_reaction():
    """Galileo's, at tolerances of 1e-13."""
    scene = quickly(load("tracker_gravity"))
    velocity = np.array([2.0, -1.0, 0.5])
    drift = {name: Polynomial((0.0, v)) for name, v in zip(("surge", "sway", "heave"), velocity, strict=True)}
    scenes = scene, on_moving_base(scene, drift)
    still, moving = (newton_euler.simulate(each, rtol=1e-13, atol=1e-13) for each in scenes)
    joints = len(scene.mechanism.joints)
    assert np.abs(moving.reaction_force[:, :joints] - still.reaction_force).max() < 1e-11
    assert np.abs(moving.reaction_torque[:, :joints] - still.reaction_torque).max() < 1e-12
    carried = still.position[:, 1:] + moving.time[:, None, None] * velocity
    assert np.abs(moving.position[:, 2:] - carried).max() < 1e-12


def test_a_slide_on_a_turntable_bears_centrifugal_and_coriolis_forces():
    """m ((-W^2 r) e_r + 2 W v e_t), the force along the slide being that of its motion; no gravity."""
    mass, spin, begin, speed = 2.0, 3.0, 0.5, 0.8
    block = Body("block", mass, [begin, 0.0, 0.0], inertia(0.01, 0.02, 0.025))
    slide = Prismatic("slide", "ground", "block", [0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0])
    mechanism = Mechanism([Body.ground(), block], [slide])
    outward = PrescribedMotion("slide", Polynomial((0.0, speed)))
    scene = Scene("table", mechanism, 1.0, 0.1, motions=(outward,))
    table = on_moving_base(scene, {"yaw": Polynomial((0.3, spin))})
    for simulate in (newton_euler.simulate, urdf.simulate):
        run = simulate(table)
        angle = 0.3 + spin * run.time
        along = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
        across = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(len(angle))])
        force = -(spin**2) * (begin + speed * run.time)[:, None] * along + 2.0 * spin * speed * across
        assert np.abs(run.reaction_force[:, 0] - mass * force).max() < 1e-8


def test_a_floating_base_conserves_momentum():
    """Of a closed chain that moves on it, linear and angular; 1e-9 of what they are."""
    scene = newton_euler.start(replace(load("four_bar"), gravity=np.zeros(3)), pivot_0=(0.3, 4.0))
    hull = Body("raft", 3.0, [0.1, 0.2, -0.3], inertia(0.4, 0.5, 0.6, turn=(0.3, 0.2, 0.1)))
    run = newton_euler.simulate(quickly(on_moving_base(scene, hull=hull)))
    bodies = run.mechanism.bodies[1:]
    mass = np.array([body.mass for body in bodies])[:, None]
    momentum = mass * run.linear_velocity[:, 1:]
    turns = np.array([rotations(q) for q in run.quaternion[:, 1:]])
    tensors = turns @ np.array([body.inertia for body in bodies]) @ np.swapaxes(turns, -1, -2)
    spin = (tensors @ run.angular_velocity[:, 1:, :, None])[..., 0]
    angular = (spin + np.cross(run.position[:, 1:], momentum)).sum(axis=1)
    linear = momentum.sum(axis=1)
    assert np.linalg.norm(linear[0]) > 0.1
    assert np.linalg.norm(run.position[-1, 1] - run.position[0, 1]) > 0.01  # the raft gives way
    assert np.abs(linear - linear[0]).max() < 1e-9 * np.linalg.norm(linear[0])
    assert np.abs(angular - angular[0]).max() < 1e-9 * np.linalg.norm(angular[0])


def test_the_base_follows_its_motions_and_carries_the_start():
    """About a point of the base; joints of the tracker, which is started with speeds, start as they did."""
    scene = newton_euler.start(
        quickly(load("tracker_gravity")), slide_12=(0.004, 0.02), slide_13=(-0.003, 0.01)
    )
    moving = on_moving_base(scene, WAVES, point=(0.3, -0.2, 0.1))
    run, still = newton_euler.simulate(moving), newton_euler.simulate(scene)
    base = run.joint("base_motion")
    for k, name in enumerate(("surge", "sway", "heave", "yaw", "pitch", "roll")):
        assert base.coordinates[:, k] == pytest.approx([WAVES[name].value(t) for t in run.time], abs=1e-10)
        assert base.rates[:, k] == pytest.approx([WAVES[name].rate(t) for t in run.time], abs=1e-9)
    for joint in scene.mechanism.joint_names:
        assert run.joint(joint).coordinates[0] == pytest.approx(still.joint(joint).coordinates[0], abs=1e-12)
        assert run.joint(joint).rates[0] == pytest.approx(still.joint(joint).rates[0], abs=1e-12)


def test_loads_on_a_base_that_follows_samples():
    """Splines through samples of polynomials of their degree are these; times on and between knots."""
    heave, roll = Polynomial((0.1, 0.2, -0.3, 0.5, 0.2, -0.4)), Polynomial((0.0, 0.3, 0.5, -0.7, 0.1, 0.3))
    times = np.linspace(0.0, 1.0, 11)
    samples = (Spline(times, [function.value(t) for t in times]) for function in (heave, roll))
    scene = quickly(load("tracker_gravity"))
    found = []
    for motions in ((heave, roll), samples):
        moving = on_moving_base(scene, dict(zip(("heave", "roll"), motions, strict=True)))
        if not found:
            run = newton_euler.simulate(moving)
        wanted = {"slide_12": 0.1, "slide_13": np.linspace(-0.1, 0.2, len(run.time))}
        found.append(newton_euler.inverse_dynamics(moving, run, wanted))
    for name in ("actuator_force", "reaction_force", "reaction_torque"):
        exact, sampled = (getattr(loads, name) for loads in found)
        assert np.abs(sampled - exact).max() < 1e-10 * np.abs(exact).max()


@pytest.mark.slow
def test_computed_torque_follows_on_a_boat_as_on_land():
    """A spline that begins where the sliders do, at rest: 1e-9 m at tolerances of 1e-10; the same law in
    Pinocchio's equations."""
    times = np.linspace(0.0, 1.0, 11)
    rise = Spline(times, 0.01 * times**3 * (1.0 - times) ** 2)
    laws = tuple(ComputedTorque(joint, 100.0, 20.0, rise) for joint in ("slide_12", "slide_13"))
    scene = on_moving_base(replace(quickly(load("tracker_gravity")), control=laws), WAVES)
    run = newton_euler.simulate(scene)
    wanted = [rise.value(t) for t in run.time]
    for joint in ("slide_12", "slide_13"):
        assert run.joint(joint).coordinates[:, 0] == pytest.approx(wanted, abs=1e-9)
    assert np.abs(urdf.simulate(scene).position - run.position).max() < 1e-9


def written(tmp_path, text: str) -> str:
    path = tmp_path / "boat.csv"
    path.write_text(text)
    return str(path)


def rows(columns: dict[str, np.ndarray]) -> str:
    lines = [",".join(columns)]
    lines += [",".join(f"{number:.12g}" for number in row) for row in zip(*columns.values(), strict=True)]
    return "\n".join(lines)


def test_poses_of_a_file_are_those_of_the_motion(tmp_path):
    """By angles wrapped to half a revolution, and by quaternions of either sign, of a yaw that goes round."""
    time = np.arange(0.0, 6.0, 0.05)
    roll, pitch, yaw = 0.3 * np.sin(time), 0.2 * np.cos(1.3 * time), 3.0 + 2.0 * time
    place = {"time": 100.0 + time, "x": np.sin(0.5 * time), "y": 0.1 * time, "z": 0.2 * np.cos(time)}
    angles = zip(np.array([yaw, pitch, roll]).T, strict=True)
    axes = np.eye(3)[::-1]
    turns = [reduce(product, map(from_rotation_vector, each[:, None] * axes)) for (each,) in angles]
    signs = np.where(np.arange(len(time)) % 3, 1.0, -1.0)
    quaternions = dict(zip(("qw", "qx", "qy", "qz"), signs * np.array(turns).T, strict=True))
    wrapped = {"yaw": (yaw + np.pi) % (2.0 * np.pi) - np.pi, "roll": roll, "pitch": pitch}
    for columns in (place | quaternions, wrapped | place):
        found = base_motion_from_csv(written(tmp_path, rows(columns)))
        assert set(found) == {"surge", "sway", "heave", "roll", "pitch", "yaw"}
        whole = 2.0 * np.pi * round((found["yaw"].value(0.0) - yaw[0]) / (2.0 * np.pi))
        for at in (0.525, 2.0, 5.3):
            assert found["surge"].value(at) == pytest.approx(np.sin(0.5 * at), abs=1e-9)
            assert found["roll"].value(at) == pytest.approx(0.3 * np.sin(at), abs=1e-9)
            assert found["pitch"].value(at) == pytest.approx(0.2 * np.cos(1.3 * at), abs=1e-9)
            assert found["yaw"].value(at) - whole == pytest.approx(3.0 + 2.0 * at, abs=1e-9)
    moving = on_moving_base(quickly(pendulum()), found)
    for simulate in (newton_euler.simulate, urdf.simulate):
        run = simulate(moving)
        n = len(run.time)
        assert np.abs(np.sum(run.quaternion[:, 1] * turns[:n], axis=1)) == pytest.approx(1.0, abs=1e-12)
        assert run.position[:, 1] == pytest.approx(np.column_stack([place[x] for x in "xyz"])[:n], abs=1e-9)


GOOD = "time, x, roll\n" + "".join(f"{t / 10}, 0.{t}, 0.1\n" for t in range(10))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1: needed: a column time"),
        ("time,x\n0,1\n", "has 1 rows of poses; needed: 6 or more"),
        ("x, roll\n1, 2\n", "line 1: needed: a column time"),
        (GOOD.replace("roll", "rol"), "line 1: unknown column 'rol'; did you mean 'roll'"),
        (GOOD.replace("roll", "x"), "line 1: column 'x' is there twice"),
        (GOOD.replace("roll", "qw"), "needed: all of qw, qx, qy, qz, or any of roll"),
        (GOOD.replace("0.4, 0.4, 0.1", "0.4, , 0.1"), "line 6: x is missing"),
        (GOOD.replace("0.4, 0.4, 0.1", "0.4, 0.4"), "line 6: has 2 cells; needed: 3"),
        (GOOD.replace("0.4, 0.4, 0.1", "0.4, nan, 0.1"), "line 6: x is 'nan'; needed: a finite number"),
        (GOOD.replace("0.4, 0.4, 0.1", "0.4, O.4, 0.1"), "line 6: x is 'O.4'"),
        (GOOD.replace("0.4, 0.4, 0.1", "0.2, 0.4, 0.1"), "line 6: time is 0.2; needed: times in ascending"),
        (GOOD + "2.5, 1.0, 0.1\n", "line 12: time is 2.5; needed: at most 0.5 s after the row before"),
        (
            GOOD.replace("roll", "pitch").replace("0.5, 0.1", "0.5, 1.5"),
            "line 7: pitch is 1.5; needed: at most",
        ),
        (
            "time,qw,qx,qy,qz\n" + "".join(f"{t},{1.0 + 0.1 * (t == 4)},0,0,0\n" for t in range(9)),
            "line 6: the norm of the quaternion is 1.1; needed: 1",
        ),
        ('time,x\n0,"1\n', "has 1 rows"),
    ],
)
def test_files_that_are_refused(tmp_path, text, words):
    with pytest.raises(NewtonEulerError, match=r"boat\.csv: ") as caught:
        base_motion_from_csv(written(tmp_path, text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_missing():
    with pytest.raises(NewtonEulerError, match=r"nowhere\.csv: cannot be read"):
        base_motion_from_csv("nowhere.csv")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"motions": {"rol": Sine(0.1, 1.0)}}, "unknown motion 'rol'; needed: did you mean 'roll'"),
        ({"motions": {"roll": 0.1}}, "motions['roll'] is 0.1; needed: a Polynomial or a Sine"),
        ({"motions": {}}, "motions is {}"),
        ({"motions": WAVES, "joint": "pivot"}, "joint is 'pivot', a name that is in use"),
        ({"motions": WAVES, "world": "ground"}, "world is 'ground', a name that is in use"),
        ({"motions": WAVES, "point": (0.0, np.nan, 0.0)}, "point is"),
        ({}, "floats, and ground 'ground' has no mass; needed: hull="),
    ],
)
def test_bases_that_are_refused(arguments, words):
    with pytest.raises((MechanismError, ArgumentError)) as caught:
        on_moving_base(pendulum(), **arguments)
    assert words in str(caught.value)


def test_shapes_and_gravity_are_kept():
    scene = load("tracker_gravity")
    moving = on_moving_base(scene, WAVES)
    assert moving.mechanism.body("base").shapes == scene.mechanism.body("base").shapes
    assert np.array_equal(moving.gravity, GRAVITY)
