"""Numbers of MJCF files for which the description of a robot has no model, and their forces in MuJoCo."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Quantity, Value
from crosscheck.library import load
from crosscheck.report.diff import verdict
from newton_euler import with_parameters
from newton_euler.scalars import Array

ARM = """
<mujoco model="arm"><option{option}/><worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"{shoulder}/>
    <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/>
  <body name="fore" pos="0.3 0 0"{fore}><joint name="elbow" axis="0 1 0"/>
    <site name="tip" pos="{tip} 0 0.05"/>
    <inertial pos="0.1 0 0.02" mass="0.5" diaginertia="0.01 0.01 0.01"/>
  <body name="hand" pos="0.2 0 0"><joint name="wrist" axis="0 1 0"/>
    <inertial pos="0.05 0 0" mass="0.25" diaginertia="0.001 0.001 0.001"/></body></body></body></worldbody>
<tendon><fixed name="cord"{cord}><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-1"/>
  <joint joint="wrist" coef="{coef}"/></fixed></tendon>{end}</mujoco>"""
PLAIN = {"option": "", "shoulder": "", "fore": "", "tip": "0.1", "cord": "", "coef": "1", "end": ""}
THRUSTER = '<actuator><motor name="push" site="tip" gear="0 0 1 0 0 0"/></actuator>'
PULL = '<actuator><motor name="pull" tendon="cord" gear="9"{}/></actuator>'
PUSH = '<actuator><general name="push" joint="elbow"{}/></actuator>'
EARLY = ' dyntype="integrator" gainprm="300"{}'
LINES = """<tendon><fixed name="one" range="-9 9"><joint joint="elbow" coef="1"/></fixed>
  <fixed name="two" range="-9 9"><joint joint="wrist" coef="1"/></fixed></tendon>
  <equality><tendon name="tie" tendon1="cord" tendon2="{}"/></equality>"""
MOTOR = '<actuator><motor name="push" joint="elbow" group="1"/></actuator>'
HOLD = '<equality><tendon name="hold" tendon1="cord"/></equality>'


class Case(NamedTuple):
    """Two files that differ in one number, its row, and the force that no compared motion has."""

    first: dict[str, str]
    second: dict[str, str]
    element: str
    what: str
    values: tuple[Value, Value]
    unmodeled: str


CASES = {
    "gravity compensation": Case(
        {}, {"fore": ' gravcomp="0.75"'}, "fore", "gravcomp", (None, 0.75), "gravcomp of body 'fore'"
    ),
    "spring of a tendon": Case(
        {"cord": ' stiffness="5"'},
        {"cord": ' stiffness="50"'},
        "cord",
        "stiffness",
        ((5.0, 0.0, 0.0), (50.0, 0.0, 0.0)),
        "stiffness of tendon 'cord'",
    ),
    "polynomial of a spring": Case(
        {"shoulder": ' stiffness="3"'},
        {"shoulder": ' stiffness="3 2 1"'},
        "shoulder",
        "polynomial of the stiffness",
        (None, (2.0, 1.0)),
        "polynomial of the stiffness of joint 'shoulder'",
    ),
    "polynomial of a damper": Case(
        {"shoulder": ' damping="0.25"'},
        {"shoulder": ' damping="0.25 2"'},
        "shoulder",
        "polynomial of the damping",
        (None, (2.0, 0.0)),
        "polynomial of the damping of joint 'shoulder'",
    ),
    "equality of three joints": Case(
        {"end": HOLD},
        {"end": HOLD, "coef": "3"},
        "cord",
        "coefficient of 'wrist'",
        (1.0, 3.0),
        "coefficients of equality 'hold'",
    ),
    "place of a thruster": Case(
        {"end": THRUSTER},
        {"end": THRUSTER, "tip": "0.4"},
        "push",
        "site",
        ((0.1, 0.0, 0.05), (0.4, 0.0, 0.05)),
        "drive 'push'",
    ),
    "fluid": Case(
        {"option": ' density="1000"'},
        {"option": ' density="1000" viscosity="2"'},
        "arm",
        "viscosity",
        (None, 2.0),
        "density",
    ),
    "actuation switched off": Case(
        {"end": MOTOR},
        {"end": MOTOR + '<option><flag actuation="disable"/></option>'},
        "arm",
        "flag actuation",
        (None, "disable"),
        "",
    ),
    "gravity compensation by limited actuators": Case(
        {"fore": ' gravcomp="0.75"', "shoulder": ' actuatorfrcrange="-1 1"'},
        {"fore": ' gravcomp="0.75"', "shoulder": ' actuatorfrcrange="-1 1" actuatorgravcomp="true"'},
        "shoulder",
        "actuatorgravcomp",
        (None, 1.0),
        "gravcomp of body 'fore'",
    ),
    "polynomial of an actuator's damper": Case(
        {"end": PUSH.format(' damping="0.5"')},
        {"end": PUSH.format(' damping="0.5 2"')},
        "push",
        "polynomial of the damping 1",
        (None, 2.0),
        "",
    ),
    "rotor of an actuator that pulls a tendon": Case(
        {"end": PULL.format("")},
        {"end": PULL.format(' armature="0.5"')},
        "pull",
        "armature of the actuator",
        (None, 0.5),
        "",
    ),
    "activation of the next step": Case(
        {"end": PUSH.format(EARLY.format(""))},
        {"end": PUSH.format(EARLY.format(' actearly="true"'))},
        "push",
        "actearly",
        (None, 1.0),
        "",
    ),
    "tendons of an equality": Case(
        {"end": LINES.format("one")},
        {"end": LINES.format("two")},
        "tie",
        "second tendon",
        ("one", "two"),
        "coefficients of equality 'tie'",
    ),
    "group switched off": Case(
        {"end": MOTOR},
        {"end": MOTOR, "option": ' actuatorgroupdisable="1"'},
        "push",
        "switched off",
        (None, "by its group"),
        "",
    ),
}


def compared(folder: Path, first: dict[str, str], second: dict[str, str]) -> crosscheck.Diff:
    paths = [folder / "first.xml", folder / "second.xml"]
    for path, numbers in zip(paths, (first, second), strict=True):
        path.write_text(ARM.format(**PLAIN | numbers))
    return crosscheck.diff(*map(str, paths))


def accelerations(numbers: dict[str, str]) -> Array:
    """Return the accelerations of the joints by MuJoCo in one state, with controls of 1."""
    model = mujoco.MjModel.from_xml_string(ARM.format(**PLAIN | numbers))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = (0.3, 0.2, -0.4), (1.0, -2.0, 0.5), 1.0
    mujoco.mj_forward(model, data)
    return data.qacc.copy()


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_a_number_that_changes_accelerations_in_mujoco_is_a_row(case: Case, tmp_path: Path) -> None:
    one, two = accelerations(case.first), accelerations(case.second)
    # far beyond round-off, which is below 1e-12
    assert np.linalg.norm(two - one) > 1e-3 * np.linalg.norm(one)
    found = compared(tmp_path, case.first, case.second)
    (row,) = found.differences
    assert (row.element, row.quantity, row.cause) == (case.element, Quantity.SETTING, case.what)
    for value, expected in zip((row.first, row.second), case.values, strict=True):
        assert value == (pytest.approx(expected, abs=1e-12) if isinstance(expected, tuple) else expected)
    assert row.effect is None
    assert found.outcome is Outcome.DIFFERENT
    assert case.unmodeled in ("", *found.comparison.unmodeled)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_the_result_of_equal_files_names_forces_that_no_motion_has(case: Case, tmp_path: Path) -> None:
    found = compared(tmp_path, case.second, case.second)
    assert found.outcome is Outcome.SAME
    names = ", ".join(found.comparison.unmodeled)
    words = f" without {names}" if case.unmodeled else ""
    assert verdict(found.comparison) == f"SAME: all numbers and motions{words} are equal"


def test_numbers_that_make_no_force_by_themselves_are_rows(tmp_path: Path) -> None:
    """Ranges of tendons and muscles; forces of a tendon at its range are one-sided, as of a joint."""
    muscle = '<actuator><muscle name="flexor" joint="elbow" lengthrange="0 {}"/></actuator>'
    first = {"cord": ' limited="true" range="-0.1 0.1"', "end": muscle.format(1)}
    second = {"cord": ' limited="true" range="-0.5 0.5"', "end": muscle.format(2)}
    found = compared(tmp_path, first, second)
    rows = {row.cause: (row.element, row.first, row.second) for row in found.differences}
    assert rows == {
        "range": ("cord", (-0.1, 0.1), (-0.5, 0.5)),
        "length range 2": ("flexor", 1.0, 2.0),
    }
    assert found.comparison.unmodeled == ("drive 'flexor'",)


def test_largest_angles_of_balls_are_limits(tmp_path: Path) -> None:
    text = ARM.format(**PLAIN).replace('name="wrist" axis="0 1 0"', 'name="wrist" type="ball" range="0 {}"')
    text = text.replace('<joint joint="wrist" coef="1"/>', "").replace("<option/>", "")
    text = text.replace("<worldbody>", '<compiler angle="radian" autolimits="true"/><worldbody>')
    paths = [tmp_path / "first.xml", tmp_path / "second.xml"]
    for path, angle in zip(paths, (1, 2), strict=True):
        path.write_text(text.replace("{}", str(angle)))
    (row,) = crosscheck.diff(*map(str, paths)).differences
    assert (row.element, row.quantity, row.unit) == ("wrist", Quantity.LIMITS, "rad")
    assert (row.first, row.second) == ((0.0, 1.0), (0.0, 2.0))


def test_digits_of_the_file_leave_settings_open(tmp_path: Path) -> None:
    """0.7500001 and 0.75 are equal to six digits."""
    found = compared(tmp_path, {"fore": ' gravcomp="0.75"'}, {"fore": ' gravcomp="0.7500001"'})
    assert found.outcome is Outcome.SAME_TO_ROUNDING


def compared_texts(folder: Path, *texts: str) -> crosscheck.Diff:
    paths = [folder / "first.xml", folder / "second.xml"]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text)
    return crosscheck.diff(*map(str, paths))


def test_polynomials_of_two_joints_of_one_body_are_two_settings(tmp_path: Path) -> None:
    pole = """<mujoco><worldbody><body name="pole"><joint axis="0 1 0" damping="0.1 {}"/>
      <joint axis="1 0 0" damping="0.1 2"/><inertial pos="0 0 1" mass="1" diaginertia="1 1 1"/></body>
      </worldbody></mujoco>"""
    (row,) = compared_texts(tmp_path, pole.format(1), pole.format(9)).differences
    assert (row.element, row.first, row.second) == ("pole", (1.0, 0.0), (9.0, 0.0))


@pytest.mark.parametrize("number", ['limited="true" range="-1 1"', 'frictionloss="0.5"'])
def test_a_flag_that_switches_all_constraints_off_removes_limits_and_friction(
    number: str, tmp_path: Path
) -> None:
    second = {"option": '><flag constraint="disable"/></option><option'}
    for element in ("shoulder", "cord"):
        one = {element: f" {number}"}
        assert len(compared(tmp_path, one, one | second).differences) == 1


def test_the_body_of_a_site_counts_and_its_name_does_not(tmp_path: Path) -> None:
    first = ARM.format(**PLAIN | {"end": THRUSTER})
    assert compared_texts(tmp_path, first, first.replace('"tip"', '"tool"')).outcome is Outcome.SAME
    site = '<site name="tip" pos="0.1 0 0.05"/>'
    moved = first.replace(site, "").replace('<joint name="wrist"', site + '<joint name="wrist"')
    (row,) = compared_texts(tmp_path, first, moved).differences
    assert (row.element, row.cause, row.first, row.second) == ("push", "site", "fore", "hand")


def test_tendons_without_names_have_partners_by_their_joints(tmp_path: Path) -> None:
    def text(*ranges: tuple[str, int]) -> str:
        tendons = (
            f'<fixed range="-9 {largest}"><joint joint="{joint}" coef="2"/>'
            '<joint joint="shoulder" coef="1"/></fixed>'
            for joint, largest in ranges
        )
        return ARM.format(**PLAIN).replace("</tendon>", f"{''.join(tendons)}</tendon>")

    one = text(("elbow", 3), ("wrist", 4))
    assert compared_texts(tmp_path, one, text(("wrist", 4), ("elbow", 3))).outcome is Outcome.SAME
    (row,) = compared_texts(tmp_path, one, text(("wrist", 4), ("elbow", 5))).differences
    assert (row.element, row.cause, row.first, row.second) == ("tendon 2", "range", (-9.0, 3.0), (-9.0, 5.0))
    inserted = compared_texts(tmp_path, one, text(("wrist", 4), ("wrist", 8), ("elbow", 3)))
    assert all(row.first is None for row in inserted.differences)


def test_tendons_keep_their_meaning_with_other_names_senses_and_zeros_of_joints(tmp_path: Path) -> None:
    first = ARM.format(**PLAIN | {"cord": ' range="-1 1"'})
    named = first.replace('"cord"', '"rope"').replace('"elbow"', '"middle"').replace('"fore"', '"ulna"')
    assert compared_texts(tmp_path, first, named).outcome is Outcome.SAME
    elbow, coefficient = 'name="elbow" axis="0 1 0"', '"elbow" coef="-1"'
    turned = first.replace(elbow, 'name="elbow" axis="0 -1 0"')
    other = turned.replace(coefficient, '"elbow" coef="1"')
    assert compared_texts(tmp_path, first, other).outcome is Outcome.SAME
    (row,) = compared_texts(tmp_path, first, turned).differences
    assert (row.cause, row.first, row.second) == ("coefficient of 'elbow'", -1.0, 1.0)
    # 90 degrees of the elbow are -pi/2 of the length
    moved = first.replace(elbow, f'{elbow} ref="90"')
    assert compared_texts(tmp_path, first, moved).outcome is Outcome.DIFFERENT
    fitting = moved.replace('range="-1 1"', f'range="{-1 - np.pi / 2} {1 - np.pi / 2}"')
    assert compared_texts(tmp_path, first, fitting).same


def test_prescribed_motions_are_rows_and_no_run_leaves_them_out() -> None:
    """A crank at constant speed moves its slider in the same way whatever the slider weighs."""
    scene = load("examples/planar_slider_crank.yaml")
    heavier = with_parameters(scene, {"slider.mass": 1.1})
    faster = with_parameters(scene, {"motor.motion.function": (0.0, 31.0)})
    for other, element, quantity in (
        (heavier, "slider", Quantity.MASS),
        (faster, "motor", Quantity.SETTING),
    ):
        found = crosscheck.diff(scene, other)
        (row,) = found.differences
        assert (row.element, row.quantity) == (element, quantity)
        assert found.run is None
        assert "without prescribed motion of joint 'motor'" in verdict(found.comparison)
