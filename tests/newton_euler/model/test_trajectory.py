"""What people ask a trajectory: joint coordinates, tables, one line of text."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mechanisms import Y, bar, inertia

from newton_euler import Body, Cylindrical, Mechanism, Planar, Revolute, Scene, Spherical, State, Trajectory
from newton_euler.errors import MechanismError, MissingPackageError, NewtonEulerError, UnknownNameError
from newton_euler.model.euler_parameters import from_rotation_vector, product
from newton_euler.model.joint import Joint

AXIS, POINT = np.array([0.0, 0.0, 1.0]), np.array([0.2, -0.1, 0.3])

RATE, SPEED = 7.0, 0.5
"""rad/s and m/s of the body that turns about the axis and slides along it."""


def screwing(joint: type[Joint], period: float) -> Trajectory:
    """A body off the axis of the joint that leads it, at `RATE` and `SPEED`."""
    slides = joint is not Revolute
    center = np.array([1.2, -0.1, 0.3])
    body = Body("body", 1.0, center, inertia(1.0, 1.0, 1.0))
    mechanism = Mechanism([Body.ground(), body], [joint("guide", "ground", "body", POINT, axis=AXIS)])
    time = np.arange(0.0, 3.0, period)
    start = State.initial(mechanism)
    position, linear, angular = (np.tile(start.position, (len(time), 1, 1)) for _ in range(3))
    quaternion = np.tile(start.quaternion, (len(time), 1, 1))
    linear[:], angular[:] = 0.0, 0.0
    for n, t in enumerate(time):
        c, s = np.cos(RATE * t), np.sin(RATE * t)
        position[n, 1] = POINT + np.array([c, s, slides * SPEED * t])
        quaternion[n, 1] = product(from_rotation_vector(RATE * t * AXIS), start.quaternion[1])
        linear[n, 1] = [-RATE * s, RATE * c, slides * SPEED]
        angular[n, 1] = RATE * AXIS
    arrays = (position, quaternion, linear, angular)
    names = (mechanism.body_names, mechanism.joint_names)
    return Trajectory("made up", {}, 0.0, time, *names, *arrays, mechanism=mechanism)


@pytest.mark.parametrize("period", [0.1, 0.7])  # s; the longer one is 0.8 revolutions
def test_angles_are_continuous_and_slides_are_slides(period):
    run = screwing(Cylindrical, period)
    names, coordinates, rates = run.joint("guide")
    assert names == ("position", "angle")
    # round-off of sines of some 20 rad
    np.testing.assert_allclose(coordinates, np.outer(run.time, [SPEED, RATE]), atol=1e-13)
    np.testing.assert_allclose(rates, np.tile([SPEED, RATE], (len(run.time), 1)), atol=1e-13)


def test_without_velocities_there_are_angles_but_no_rates():
    run = replace(screwing(Revolute, 0.1), linear_velocity=None)
    names, coordinates, rates = run.joint("guide")
    assert (names, rates) == (("angle",), None)
    np.testing.assert_allclose(coordinates[:, 0], RATE * run.time, atol=1e-13)


def test_angles_ignore_the_signs_of_quaternions():
    run = screwing(Revolute, 0.1)
    signs = np.where(np.arange(len(run.time)) % 3 == 0, -1.0, 1.0)
    flipped = replace(run, quaternion=run.quaternion * signs[:, None, None])
    np.testing.assert_array_equal(flipped.joint("guide").coordinates, run.joint("guide").coordinates)


def test_coordinates_of_one_kind_are_numbered_and_balls_have_none():
    body = bar("body", [0.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    ends = ("ground", "body", [0.0, 0.0, 0.0])
    names = []
    for joint in (Planar("joint", *ends, axis=Y), Spherical("joint", *ends)):
        mechanism = Mechanism([Body.ground(), body], [joint])
        start = State.initial(mechanism)
        arrays = (mechanism.body_names, mechanism.joint_names, start.position[None], start.quaternion[None])
        motion = Trajectory("", {}, 0.0, np.zeros(1), *arrays, mechanism=mechanism).joint("joint")
        names.append(motion.names)
        assert motion.coordinates.shape == (1, len(motion.names))
    assert names == [("position_1", "position_2", "angle"), ()]


def test_joints_that_are_not_there_are_errors():
    run = screwing(Revolute, 0.1)
    with pytest.raises(UnknownNameError, match="unknown joint 'giude'; did you mean 'guide'"):
        run.joint("giude")
    with pytest.raises(MechanismError, match="trajectory: has no mechanism"):
        replace(run, mechanism=None).joint("guide")


def test_representations_are_one_line():
    run = screwing(Cylindrical, 0.5)
    assert repr(run) == "<Trajectory of made up: 6 outputs to 2.5 s, bodies: 2, joints: 1>"
    assert repr(run.mechanism) == "<Mechanism: bodies: 2; joints: 1 cylindrical; couplings: 0>"
    scene = Scene("some", run.mechanism, 1.0, 0.1)
    assert repr(scene) == "<Scene 'some': 11 outputs to 1 s, bodies: 2, joints: 1>"


@pytest.mark.parametrize("installed", ["pandas", "polars"])
def test_tables_have_a_column_per_component(installed, monkeypatch):
    run = replace(screwing(Cylindrical, 0.5), actuator_force=np.arange(6.0)[:, None])
    for library in ("pandas", "polars"):
        table = SimpleNamespace(DataFrame=lambda columns: (installed, columns))
        monkeypatch.setitem(sys.modules, library, table if library == installed else None)
    library, columns = run.to_dataframe()
    assert library == installed
    assert list(columns)[:5] == ["time", "position.ground.x", "position.ground.y", "position.ground.z",
                                 "position.body.x"]  # fmt: skip
    assert len(columns) == 1 + 2 * (3 + 4 + 3 + 3) + 1
    np.testing.assert_array_equal(columns["quaternion.body.w"], run.quaternion[:, 1, 0])
    np.testing.assert_array_equal(columns["actuator_force.0"], run.actuator_force[:, 0])


def test_tables_without_a_library_say_what_to_install(monkeypatch):
    for library in ("pandas", "polars"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingPackageError) as caught:
        screwing(Revolute, 0.5).to_dataframe()
    assert (caught.value.package, caught.value.extra) == ("pandas", "tables")


def test_a_pipe_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    pipe = tmp_path / "run.npz"
    os.mkfifo(pipe)
    with pytest.raises(NewtonEulerError, match="not a regular file"):
        screwing(Revolute, 0.5).save(pipe)
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]
