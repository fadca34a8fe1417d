"""Elements without names, drives of one joint, and drives without force, against accelerations of MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.motion import Likeness

ARM = """<mujoco><worldbody><body pos="0 0 1"><inertial pos="0 0 0" mass="3.1" diaginertia="0.11 0.12 0.13"/>
  <body pos="0.1 0.2 0.3"><joint name="j1" axis="0 1 0" damping="0.3"/>
    <inertial pos="0.05 0.01 -0.2" mass="{upper}" fullinertia="0.021 0.022 0.013 0.001 0.002 -0.001"/>
  <body pos="0.01 0.02 -0.4"><joint name="j2" axis="1 0 0"/>
    <inertial pos="0.02 0.03 -0.15" mass="{lower}" diaginertia="{inertia}"/></body></body></body></worldbody>
  <actuator>{drives}</actuator></mujoco>"""


def arm(upper="1.2", lower="0.7", inertia="0.011 0.012 0.003", drives=""):
    return ARM.format(upper=upper, lower=lower, inertia=inertia, drives=drives)


def accelerations(text):
    """Accelerations of plain MuJoCo at a state that excites everything."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = (0.3, 0.2), (0.5, -0.4), 1.0
    mujoco.mj_forward(model, data)
    return data.qacc.copy()


@pytest.fixture
def diff(tmp_path):
    def compared(first, second, **options):
        for name, text in (("a", first), ("b", second)):
            (tmp_path / f"{name}.xml").write_text(text)
        return crosscheck.diff(tmp_path / "a.xml", tmp_path / "b.xml", **options)

    return compared


def test_masses_of_bodies_without_names(diff):
    found = diff(arm(), arm(upper="1.21", lower="0.8"))
    assert [(row.element, row.quantity, row.first, row.second) for row in found.differences] == [
        ("body 3", "mass", 0.7, 0.8),
        ("body 2", "mass", 1.2, 1.21),
    ]
    effects = [row.effect for row in found.differences]
    # 14 % and 0.8 % of the masses: each row has its own effect
    assert effects[0] > 5.0 * effects[1] > 0.0


def test_a_tolerance_excuses_no_larger_change_of_a_body_without_name(diff):
    found = diff(arm(), arm(upper="1.2001", lower="0.9"), tolerance=1e-3)
    assert [row.element for row in found.differences] == ["body 3"]
    assert found.outcome is Outcome.DIFFERENT


@pytest.mark.parametrize("names", [("", "", "", ""), tuple(f'name="{letter}"' for letter in "pqrs")])
def test_two_drives_of_one_joint_in_any_order(diff, names):
    position, velocity = '<position {} joint="j1" kp="10"/>', '<velocity {} joint="j1" kv="1"/>'
    one = arm(drives=position.format(names[0]) + velocity.format(names[1]))
    other = arm(drives=velocity.format(names[2]) + position.format(names[3]))
    assert accelerations(one) == pytest.approx(accelerations(other), rel=1e-13)
    found = diff(one, other)
    assert found.same
    assert found.motion.likeness is Likeness.EQUAL


def test_drives_without_names_have_their_own_effects(diff):
    motors = '<motor joint="j1" gear="50"/><motor joint="j2" gear="50"/>'
    changed = '<motor joint="j1" gear="49"/><motor joint="j2" gear="5"/>'
    found = diff(arm(drives=motors), arm(drives=changed))
    assert [(row.element, row.first, row.second) for row in found.differences] == [
        ("j2", 50.0, 5.0),
        ("j1", 50.0, 49.0),
    ]
    assert all(row.effect for row in found.differences)


@pytest.mark.parametrize("gears", [("0", "1"), ("1", "0")])
def test_a_gear_of_zero_changes_the_motion(diff, gears):
    texts = [arm(drives=f'<motor name="m" joint="j1" gear="{gear}"/>') for gear in gears]
    assert np.abs(accelerations(texts[0]) - accelerations(texts[1])).max() > 1.0  # rad/s^2
    found = diff(*texts)
    assert found.motion.likeness is Likeness.DIFFERENT
    [row] = found.differences
    assert (row.quantity, row.effect > 0.01) == ("gear", True)


def test_exchanged_moments_of_inertia_are_no_lost_rotation(diff):
    [row] = diff(arm(), arm(inertia="0.012 0.011 0.003")).differences
    assert "ixx and iyy are exchanged" in row.cause


def test_compensation_of_gravity_of_bodies_without_names(diff):
    def compensated(upper):
        inner = '<body pos="0.01 0.02 -0.4" gravcomp="1">'
        text = arm().replace('<body pos="0.1 0.2 0.3">', f'<body pos="0.1 0.2 0.3" gravcomp="{upper}">')
        return text.replace('<body pos="0.01 0.02 -0.4">', inner)

    one, other = compensated(1), compensated(0.2)
    assert np.abs(accelerations(one) - accelerations(other)).max() > 0.1  # rad/s^2
    [row] = diff(one, other).differences
    assert (row.element, row.cause, row.first, row.second) == ("body 2", "gravcomp", 1.0, 0.2)


def test_a_joint_that_has_the_name_of_the_body_of_a_joint_without_name(diff):
    """The name of such a body is taken; the drive stays at its joint."""
    one = arm(drives='<motor name="m" joint="lower" gear="9"/>').replace('"j1"', '"lower"')
    one = one.replace('<body pos="0.01 0.02 -0.4">', '<body name="lower" pos="0.01 0.02 -0.4">')
    unnamed = one.replace(' name="j2"', "")
    for texts in ((one, unnamed), (unnamed, one), (unnamed, unnamed)):
        found = diff(*texts)
        assert found.outcome is Outcome.SAME
        assert found.motion.likeness is Likeness.EQUAL
    [row] = diff(unnamed, unnamed.replace('axis="1 0 0"', 'axis="1 0 0" damping="0.5"')).differences
    assert (row.element, row.quantity, row.first, row.second) == ("lower (2)", "damping", 0.0, 0.5)
