"""Planted differences in a small MJCF and a small URDF: the changed numbers, and what the comparison says."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from crosscheck.differences.difference import Quantity, Standing
from crosscheck.differences.result import compare_models
from tests.support.planted.__main__ import PlantedModel
from tests.support.planted.format_changes import changes, rounded
from tests.support.planted.mjcf_text import MjcfText
from tests.support.planted.plant import mistakes

ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody>
<body name="base"><inertial pos="0 0 0.05" mass="3.5" diaginertia="0.021 0.022 0.023"/>
 <body name="upper" pos="0 0 0.1"><inertial pos="0.01 0.02 0.15" mass="2.25" diaginertia="0.021 0.032 0.043"/>
  <joint name="lift" axis="0 1 0" range="-1 1.5" damping="0.25"/>
  <body name="fore" pos="0 0 0.3"><inertial pos="0.11 0.01 0" mass="1.25"
   fullinertia="0.011 0.022 0.031 0.002 0.001 0.0015"/>
   <joint name="bend" axis="0 1 0" range="-2 1" damping="0.125"/></body></body></body></worldbody>
<actuator><motor name="lift_motor" joint="lift" gear="2"/>
 <motor name="bend_motor" joint="bend" gear="3"/></actuator>
</mujoco>"""


LINKAGE = """<mujoco model="linkage"><compiler angle="radian"/><worldbody>
<body name="base"><inertial pos="0 0 0.05" mass="3.5" diaginertia="0.021 0.022 0.023"/>
<body name="crank" pos="0 0 0.1"><inertial pos="0.01 0.02 0.1" mass="1.25" diaginertia="0.021 0.022 0.013"/>
 <joint name="drive" axis="0 1 0" range="-1 1.5" damping="0.25"/>
 <body name="coupler" pos="0 0 0.25">
  <inertial pos="0.2 0.01 0.02" mass="1.5" diaginertia="0.011 0.032 0.033"/>
  <joint name="pin" axis="0 1 0" range="-2 1.5" damping="0.125"/>
  <body name="tool" pos="0.2 0 0.1">
   <inertial pos="0.01 0.05 0.03" mass="0.75" diaginertia="0.004 0.005 0.006"/>
   <joint name="tilt" axis="1 0 0" range="-0.5 1.5" ref="0.7" damping="0.5"/></body></body></body>
<body name="rocker" pos="0.45 0 0.1">
 <inertial pos="0.02 0.01 0.12" mass="1.75" diaginertia="0.021 0.022 0.008"/>
 <joint name="swing" axis="0 1 0" range="-1 2" damping="0.375"/></body></body></worldbody>
<equality><connect body1="coupler" body2="rocker" anchor="0.4 0 0.02"/></equality>
<actuator><motor name="motor" joint="drive" gear="2"/></actuator>
</mujoco>"""


@pytest.fixture
def arm(tmp_path):
    """Return the path of the arm's file."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return path


@pytest.mark.parametrize(
    ("kind", "read", "factor"),
    [
        ("mass", lambda model: model.body_mass[1:].sum(), None),
        ("gear", lambda model: model.actuator_gear[:, 0], 1.2),
        ("damping", lambda model: model.dof_damping, 1.5),
        ("time step", lambda model: np.array([model.opt.timestep]), 2.0),
    ],
)
def test_a_change_alters_what_its_name_says(kind, read, factor):
    file = MjcfText(ARM)
    before = np.array(read(mujoco.MjModel.from_xml_string(ARM)))
    changes(file)[kind](file, np.random.default_rng(0))
    after = np.array(read(mujoco.MjModel.from_xml_string(file.text())))
    ratios = np.ravel(after / before)
    # numbers are written with ten digits
    if factor is None:
        assert ratios[0] > 1.0
    else:
        assert sorted(ratios)[-1] == pytest.approx(factor, rel=1e-9)
        assert sum(ratio != pytest.approx(1.0, rel=1e-9) for ratio in ratios) == 1


@pytest.mark.slow
@pytest.mark.parametrize("text", [pytest.param(ARM, id="arm"), pytest.param(LINKAGE, id="linkage")])
def test_all_cases_of_a_small_robot_are_right(text, tmp_path):
    path, folder = tmp_path / "robot.xml", tmp_path / "changed"
    path.write_text(text)
    folder.mkdir()
    cases = list(PlantedModel("robot", path, folder).cases())
    assert len({kind for case in cases for kind in case.kinds}) > 30
    assert [case for case in cases if case.mistakes or case.is_missed] == []


def test_a_joint_that_is_reversed_at_another_zero_is_one_row(tmp_path):
    """Only the axis is reversed: the coordinate is 0.7 rad at the start, and the zero elsewhere."""
    path, other = tmp_path / "robot.xml", tmp_path / "other.xml"
    path.write_text(LINKAGE)
    other.write_text(LINKAGE.replace('name="tilt" axis="1 0 0"', 'name="tilt" axis="-1 0 0"'))
    (row,) = compare_models((path, other), ({}, {}), {}, None, lambda stage: None).differences
    assert (row.element, row.quantity) == ("tilt", Quantity.SIGN)
    assert "limits not mirrored" in row.cause


@pytest.mark.parametrize(
    ("kind", "quantity", "size"),
    [
        ("time step", Quantity.TIME_STEP, 1.0),
        ("integrator", Quantity.INTEGRATOR, 1.0),
        ("mass of fixed base", Quantity.MASS, 0.2),
    ],
)
def test_what_does_not_change_the_motion_is_no_difference(arm, tmp_path, kind, quantity, size):
    file = MjcfText(ARM)
    changes(file)[kind](file, np.random.default_rng(0))
    other = tmp_path / "other.xml"
    other.write_text(file.text())
    comparison = compare_models((arm, other), ({}, {}), {}, None, lambda stage: None)
    (row,) = comparison.rows
    assert (row.quantity, row.standing, row.effect) == (quantity, Standing.CONVENTION, 0.0)
    assert row.size == pytest.approx(size, rel=1e-9)  # ten digits in the changed file
    assert comparison.outcome.passes()


def test_a_plant_that_is_not_there_is_a_mistake(arm):
    file = MjcfText(ARM)
    plant = changes(file)["mass"](file, np.random.default_rng(0))
    comparison = compare_models((arm, arm), ({}, {}), {}, None, lambda stage: None)
    assert [each.partition(" of")[0] for each in mistakes(comparison, [plant])] == ["missing: mass"]


def test_numbers_are_rounded_to_significant_digits():
    assert rounded('<a b="0.123456789 -12.3456789 1.5e-07 3"/>', 6) == '<a b="0.123457 -12.3457 1.5e-07 3"/>'
