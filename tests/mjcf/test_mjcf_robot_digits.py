"""Uncertainties of described MJCF files by the digits of their numbers, computed by hand."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from robot_dynamics import mass_matrix, pose

from mjcf.robot import describe
from newton_euler.reading.robot import Robot, RobotFile
from newton_euler.scalars import Array

ROOT = Path(__file__).parents[2]
HALF = 0.5e-6
"""Half a unit of the sixth significant digit of numbers from 0.1 to 1."""


def matrix(robot: Robot) -> Array:
    """Return the mass matrix at fixed coordinates of all joints, hinges and slides."""
    coordinates = {
        (number, k): np.array([0.3 + 0.1 * number + 0.05 * k])
        for number, body in enumerate(robot.bodies)
        for k in range(len(body.joints))
    }
    return mass_matrix(robot, pose(robot, coordinates))


def change(file: RobotFile, quantity: Callable[[Robot], Array | float]) -> Array:
    """Return the largest change of a quantity among the variants."""
    written = np.asarray(quantity(file.robot))
    assert len(file.variants) == 16
    return np.max([np.abs(np.asarray(quantity(variant)) - written) for variant in file.variants], axis=0)


def described(folder: Path, text: str) -> RobotFile:
    path = folder / "model.xml"
    path.write_text(text)
    return describe(path)


PENDULUM = """<mujoco><worldbody><body name="rod"><joint name="h" axis="0 1 0"/>
  <inertial pos="{center} 0 0" mass="{mass}" diaginertia="1 1 1"/></body></worldbody></mujoco>"""


def test_the_uncertainty_of_a_pendulum_by_hand(tmp_path: Path) -> None:
    """M = m c^2 + I, where I is exact. With dm = dc = 0.5e-6: dM = c^2 dm + 2 m c dc."""
    mass, center = 0.123, 0.75
    file = described(tmp_path, PENDULUM.format(mass=mass, center=center))
    expected = center**2 * HALF + 2.0 * mass * center * HALF
    # both signs are equal in one of two variants, so that the largest sum occurs; dm dc is 1e-6 of the sum
    assert change(file, matrix)[0, 0] == pytest.approx(expected, rel=1e-5)
    assert change(file, lambda robot: robot.bodies[0].mass) == pytest.approx(HALF, rel=1e-9)
    # more digits: half a unit of the last one
    finer = described(tmp_path, PENDULUM.format(mass="0.12300000", center=3))
    assert change(finer, matrix)[0, 0] == pytest.approx(9.0 * 0.5e-8, rel=1e-5)
    # a whole number is exact
    exact = described(tmp_path, PENDULUM.format(mass=2, center=3))
    assert change(exact, matrix)[0, 0] == 0.0


def test_a_rotated_inertia_by_hand(tmp_path: Path) -> None:
    """Ixx = 0.2 cos^2 a + 0.4 sin^2 a, with a = 2 atan(0.5) about z from the quaternion (1, 0, 0, 0.5)."""
    text = PENDULUM.format(mass=1, center=0).replace(
        'diaginertia="1 1 1"', 'diaginertia="0.2 0.4 0.5" quat="1 0 0 0.5"'
    )
    file = described(tmp_path, text)
    angle = 2.0 * np.arctan(0.5)
    by_angle = 0.2 * np.sin(2.0 * angle) * 2.0 / (1.0 + 0.5**2)  # dI/da da/dw
    expected = (np.cos(angle) ** 2 + np.sin(angle) ** 2 + by_angle) * HALF
    inertia = file.robot.bodies[0].inertia
    assert inertia[0, 0] == pytest.approx(0.2 * np.cos(angle) ** 2 + 0.4 * np.sin(angle) ** 2, rel=1e-12)
    assert change(file, lambda robot: robot.bodies[0].inertia)[0, 0] == pytest.approx(expected, rel=1e-5)


def test_numbers_of_defaults_change_all_their_elements(tmp_path: Path) -> None:
    """Two joints of a class share a number; their changes are equal. A third one has its own."""
    body = '<body><joint name="{0}" class="c" {1}/><geom size="1"/></body>'
    parts = body.format("a", "") + body.format("b", "") + body.format("own", 'damping="0.456"')
    file = described(
        tmp_path,
        f'<mujoco><default><default class="c"><joint damping="0.123"/></default></default>'
        f"<worldbody>{parts}</worldbody></mujoco>",
    )
    changes = np.array([[body.joints[0].damping for body in variant.bodies] for variant in file.variants]) - [
        0.123,
        0.123,
        0.456,
    ]
    assert np.abs(changes) == pytest.approx(np.full((16, 3), HALF), rel=1e-9)
    assert np.all(changes[:, 0] == changes[:, 1])
    assert np.any(changes[:, 0] * changes[:, 2] < 0.0)


def test_numbers_of_included_files_change(tmp_path: Path) -> None:
    (tmp_path / "joint.xml").write_text('<mujoco><joint damping="0.123"/></mujoco>')
    file = described(
        tmp_path,
        '<mujoco><worldbody><body pos="0.5 0 0"><include file="joint.xml"/><geom size="0.25"/></body>'
        "</worldbody></mujoco>",
    )
    assert change(file, lambda robot: robot.bodies[0].joints[0].damping) == pytest.approx(HALF, rel=1e-9)
    # mass of a sphere: 1000 4/3 pi r^3
    by_radius = 1000.0 * 4.0 * np.pi * 0.25**2 * HALF
    assert change(file, lambda robot: robot.bodies[0].mass) == pytest.approx(by_radius, rel=1e-5)


@pytest.mark.parametrize(
    "inertia", ['diaginertia="0.5 0.3 0.2"', 'fullinertia="0.5 0.3 0.2 0 0 0"', 'diaginertia="0.5 0.5 1e-12"']
)
def test_thin_bodies_have_all_variants(inertia: str, tmp_path: Path) -> None:
    """0.2 + 0.3 = 0.5: half of the variants break A + B >= C, which MuJoCo refuses."""
    text = PENDULUM.format(mass=1, center=0).replace('diaginertia="1 1 1"', inertia)
    file = described(tmp_path, text)
    moments = np.array([np.diag(variant.bodies[0].inertia) for variant in file.variants])
    assert np.any(moments[:, 1] + moments[:, 2] < moments[:, 0])
    written = np.diag(file.robot.bodies[0].inertia)
    half_units = np.array([HALF if value > 1e-6 else 0.5e-17 for value in written])
    assert np.abs(moments - written) == pytest.approx(np.tile(half_units, (16, 1)), rel=1e-6, abs=1e-16)


@pytest.mark.parametrize(
    "path", [ROOT / "examples/linkage.xml", ROOT / "mjcf/tracker.xml"], ids=["linkage", "tracker"]
)
def test_a_copy_with_six_digits_is_within_the_digits(path: Path, tmp_path: Path) -> None:
    """A copy that MuJoCo saves has 6 digits."""
    copy = tmp_path / "copy.xml"
    mujoco.mj_saveLastXML(str(copy), mujoco.MjModel.from_xml_path(str(path)))
    file, saved = describe(path), describe(copy)
    difference = np.abs(matrix(saved.robot) - matrix(file.robot))
    assert np.max(difference) > 1e-9
    # twice the largest of 16 random sums; round-off of the matrix
    allowed = 2.0 * (change(file, matrix) + change(saved, matrix)) + 1e-14 * np.max(matrix(file.robot))
    assert np.all(difference <= allowed)


def test_a_mass_that_is_larger_by_a_thousandth_is_outside_of_the_digits(tmp_path: Path) -> None:
    file = describe(ROOT / "mjcf/tracker.xml")
    text = (ROOT / "mjcf/tracker.xml").read_text()
    mass = re.findall(r'mass="([\d.]+)"', text)[2]
    changed = described(tmp_path, text.replace(f'mass="{mass}"', f'mass="{1.001 * float(mass):.6g}"'))

    def masses(robot: Robot) -> Array:
        return np.array([body.mass for body in robot.bodies])

    difference = masses(changed.robot) - masses(file.robot)
    outside = np.abs(difference) > 2.0 * (change(file, masses) + change(changed, masses))
    # the new mass has six digits
    assert difference[outside] == pytest.approx([1e-3 * float(mass)], rel=1e-2)
    assert np.all(difference[~outside] == 0.0)


CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "".join(
    f"f {face}\n"
    for face in (
        *("1 2 4", "1 4 3", "5 7 8", "5 8 6", "1 5 6", "1 6 2"),
        *("3 4 8", "3 8 7", "1 3 7", "1 7 5", "2 6 8", "2 8 4"),
    )
)
"""Unit cube as a Wavefront OBJ file."""

MESH = """<mujoco><asset><mesh name="c" file="cube.obj" scale="0.123456 0.23456 0.1"/></asset><worldbody>
  <body name="a"><joint/><geom type="mesh" mesh="c" pos="0.1 0.2 0.34567" density="1234.56"/></body>
</worldbody></mujoco>"""


def test_a_mass_from_a_mesh_has_the_digits_of_scale_and_density(tmp_path: Path) -> None:
    (tmp_path / "cube.obj").write_text(CUBE)
    path = tmp_path / "robot.xml"

    def model_with(*changes: tuple[str, str]) -> mujoco.MjModel:
        text = MESH
        for before, after in changes:
            text = text.replace(before, after)
        path.write_text(text)
        return mujoco.MjModel.from_xml_path(str(path))

    largest = model_with(
        ("0.123456", "0.1234565"),
        ("0.23456", "0.2345605"),
        (' 0.1"', ' 0.1000005"'),
        ("1234.56", "1234.565"),
    )
    written = model_with()
    found = describe(path)
    masses = np.array([robot.bodies[0].mass for robot in found.variants])
    relative = np.abs(masses / written.body_mass[1] - 1.0).max()
    bound = largest.body_mass[1] / written.body_mass[1] - 1.0
    # 16 random sums of four numbers reach most of the bound; MuJoCo keeps vertices in single precision
    assert 0.7 * bound < relative < bound + 1e-6
    inertias = np.array([np.trace(robot.bodies[0].inertia) for robot in found.variants])
    traces = [model.body_inertia[1].sum() for model in (written, largest)]
    assert np.abs(inertias / traces[0] - 1.0).max() == pytest.approx(traces[1] / traces[0] - 1.0, rel=0.4)
