"""Elements that allow the same motions in other words: joints, bases, welds, parallel springs and drives."""

from __future__ import annotations

from pathlib import Path

import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Quantity, Standing
from crosscheck.differences.motion import Likeness

ARM = """<mujoco model="arm"><worldbody><site name="start" pos="0 0.5 1.5"/>
  <body name="upper" pos="0 0 1">{base}<inertial pos="0.1 0.01 0" mass="1.2" diaginertia="0.01 0.02 0.022"/>
  <body name="fore" pos="0.3 0 0"><joint name="elbow" axis="0 1 0"/><site name="end" pos="0.1 0 0.05"/>
    <inertial pos="0.1 0 0.02" mass="0.5" diaginertia="0.011 0.012 0.013"/>
  <body name="hand" pos="0.2 0 0">{wrist}
    <inertial pos="0.05 0.02 0" mass="0.25" diaginertia="1e-3 2e-3 2e-3"/>
  {last}</body></body></body></worldbody>{end}</mujoco>"""
PLAIN = {
    "base": '<joint name="shoulder" axis="0 1 0"/>',
    "wrist": '<joint name="wrist" axis="1 0 0"/>',
    "last": "",
    "end": "",
}


@pytest.fixture
def diff(tmp_path: Path):
    def compared(first, second):
        paths = [tmp_path / "first.xml", tmp_path / "second.xml"]
        for path, numbers in zip(paths, (first, second), strict=True):
            path.write_text(ARM.format(**PLAIN | numbers))
        return crosscheck.diff(*map(str, paths))

    return compared


def conventions(found):
    rows = found.comparison.of_standing(Standing.CONVENTION)
    return [(row.element, row.quantity) for row in rows]


BALL = {"wrist": '<joint name="wrist" type="ball"/>'}
HINGES = '<joint name="x" axis="1 0 0"{}/><joint name="y" axis="0 1 0"/><joint name="z" axis="0 0 1"/>'


def test_a_ball_and_three_hinges_are_the_same_joint(diff):
    for files in ((BALL, {"wrist": HINGES.format("")}), ({"wrist": HINGES.format("")}, BALL)):
        found = diff(*files)
        assert (found.outcome, found.motion.likeness) == (Outcome.SAME, Likeness.EQUAL)
        assert [quantity for _, quantity in conventions(found)] == [Quantity.KIND]


@pytest.mark.parametrize(
    "number", ['range="-9 9"', 'frictionloss="1"', 'damping="1"', 'actuatorfrcrange="-1 1"']
)
def test_a_ball_and_three_hinges_with_numbers_of_one_hinge_differ(number, diff):
    found = diff(BALL, {"wrist": HINGES.format(" " + number)})
    assert found.outcome is Outcome.DIFFERENT
    assert [row.quantity for row in found.differences] == [Quantity.KIND]


WELDED = {"base": "<freejoint/>", "end": '<equality><weld body1="upper"/></equality>'}


def test_a_weld_to_the_ground_is_a_fixed_base(diff):
    found = diff({"base": ""}, WELDED)
    assert (found.outcome, found.motion.likeness) == (Outcome.SAME, Likeness.EQUAL)
    assert ("arm", Quantity.BASE) in conventions(found)
    for end in ("", '<equality><weld body1="upper" relpose="0 0 1.5 1 0 0 0"/></equality>'):
        found = diff({"base": ""}, WELDED | {"end": end})
        assert Quantity.BASE in [row.quantity for row in found.differences]


DUMMY = """<body name="dummy"><joint name="idle" axis="0 0 1"/><inertial pos="0 0 0" mass="{0}"
  diaginertia="{1} {1} {1}"/></body>"""


@pytest.mark.parametrize(
    ("mass", "inertia", "outcome"),
    [
        ("1e-9", "1e-12", Outcome.SAME),
        ("1e-9", "1e-3", Outcome.DIFFERENT),
        ("1e-3", "1e-9", Outcome.DIFFERENT),
    ],
)
def test_bodies_that_are_too_light_to_change_the_motion(mass, inertia, outcome, diff):
    found = diff({}, {"last": DUMMY.format(mass, inertia)})
    rows = conventions(found) if outcome is Outcome.SAME else found.differences
    assert (found.outcome, len(rows)) == (outcome, 1)


@pytest.mark.parametrize(
    ("armature", "couplings", "likeness"),
    [
        (0, '<joint joint1="idle" joint2="wrist"/>', Likeness.EQUAL),
        (1, '<joint joint1="idle" joint2="wrist"/>', Likeness.DIFFERENT),
        (0, '<joint joint1="idle" joint2="wrist"/><joint joint1="idle" joint2="elbow"/>', Likeness.DIFFERENT),
    ],
    ids=["massless", "rotor", "differential"],
)
def test_light_bodies_that_are_coupled_to_others_are_part_of_the_motion(armature, couplings, likeness, diff):
    last = DUMMY.format("1e-9", "1e-12").replace("/>", f' armature="{armature}"/>', 1)
    coupled = {"last": last, "end": f"<equality>{couplings}</equality>"}
    for files in (({}, coupled), (coupled, {})):
        found = diff(*files)
        assert (found.outcome, found.motion.likeness) == (Outcome.DIFFERENT, likeness)


def weld(pose):
    return {"end": f'<equality><weld name="hold" body1="hand" body2="upper" {pose}/></equality>'}


def test_welds_are_compared_by_the_pose_that_they_hold(diff):
    """A weld of two bodies in the pose of the file holds the same pose wherever it is."""
    for anchor in ("0 0 0", "0.1 0.2 0.3"):
        assert diff(weld(""), weld(f'anchor="{anchor}"')).outcome is Outcome.SAME
    poses = ['relpose="-0.5 0 0 1 0 0 0"', 'relpose="-0.5 0 0 0.6 0.8 0 0"', 'relpose="-0.4 0 0 1 0 0 0"']
    (turned,) = diff(weld(poses[0]), weld(poses[1])).differences
    assert (turned.element, turned.quantity, turned.unit) == ("hold", Quantity.LOOP_AXIS, "rad")
    assert turned.size == pytest.approx(1.854590436)  # 2 arccos 0.6
    (moved,) = diff(weld(poses[0]), weld(poses[2])).differences
    assert (moved.element, moved.quantity) == ("hold", Quantity.LOOP_POINT)
    assert moved.size == pytest.approx(0.1)


SPRINGS = (
    '<spatial stiffness="10"><site site="start"/><site site="end"/></spatial>',
    '<spatial stiffness="20" damping="3"><site site="start"/><site site="end"/></spatial>',
)
DRIVES = ('<motor joint="elbow" gear="3"/>', '<motor joint="elbow" gear="5" ctrlrange="-1 1"/>')


@pytest.mark.parametrize(("tag", "parts"), [("tendon", SPRINGS), ("actuator", DRIVES)])
def test_elements_side_by_side_without_names_have_any_order(tag, parts, diff):
    first, second = ({"end": f"<{tag}>{''.join(each)}</{tag}>"} for each in (parts, parts[::-1]))
    assert diff(first, second).outcome is Outcome.SAME


def test_drives_with_exchanged_names_are_other_drives_for_controllers(diff):
    drives = '<actuator><motor name="{}" joint="elbow"/><motor name="{}" joint="wrist"/></actuator>'
    first = {"end": drives.format("a", "b")}
    found = diff(first, {"end": drives.format("b", "a")})
    (row,) = found.differences
    assert (row.element_kind, row.quantity, row.elements) == ("drive", Quantity.NAME, ("a", "b"))
    assert found.motion.likeness is Likeness.EQUAL
    assert diff(first, {"end": drives.format("c", "d")}).outcome is Outcome.SAME


def test_a_drive_on_a_ball_in_one_file_is_another_drive(diff):
    drive = '<actuator><motor name="turn" joint="{}"/></actuator>'
    hinges = {"wrist": HINGES.format(""), "end": drive.format("x")}
    rows = diff(BALL | {"end": drive.format("wrist")}, hinges).differences
    (values,) = [(row.first, row.second) for row in rows if row.quantity is Quantity.TRANSMISSION]
    assert all(values)
