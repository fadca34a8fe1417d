"""One changed number of a file, or one exchange, is one row, though several described numbers differ."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import crosscheck
from crosscheck.differences.difference import Quantity

ROOT = Path(__file__).parents[3]
TRACKER = (ROOT / "mjcf/tracker.xml").read_text()
LINKAGE = (ROOT / "examples/linkage.xml").read_text()
ROD = (
    LINKAGE.replace(
        '<connect name="loop" site1="coupler_end" site2="rocker_end"/>', '<tendon name="rod" tendon1="rod"/>'
    )
    .replace(
        "</worldbody>",
        '</worldbody><tendon><spatial name="rod"><site site="coupler_end"/><site site="rocker_end"/>'
        "</spatial></tendon>",
    )
    .replace('name="rocker" pos="0.3 0 0"', 'name="rocker" pos="0.4 0 0"')
)
SPRING = ROD.replace('<spatial name="rod">', '<spatial name="rod" stiffness="20">').replace(
    '<tendon name="rod" tendon1="rod"/>', ""
)
AXES = tuple(line for line in TRACKER.splitlines() if 'name="universal_47_' in line)


class Case(NamedTuple):
    """A file, two changes of its text, and the row: element, quantity, size, and what follows."""

    text: str
    before: str
    after: str
    element: str
    quantity: Quantity
    size: float
    consequences: tuple[str, ...]


CASES = {
    "anchor of a connect": Case(
        TRACKER,
        '0.016011923533000003 0 0.05063533305500001" />\n    <connect',
        '0.016011923533000003 0 0.05563533305500001" />\n    <connect',
        "ball_67",
        Quantity.LOOP_POINT,
        0.005,
        ("ball_67",),
    ),
    "joint in a loop": Case(
        TRACKER,
        'name="leg_6" pos="0.03168 0 0.04167"',
        'name="leg_6" pos="0.03168 0 0.04667"',
        "hinge_26",
        Quantity.JOINT_ORIGIN,
        0.005,
        ("ball_67",),
    ),
    "body with a universal joint in two loops": Case(
        TRACKER,
        'name="panel_7" pos="-0.022780000000000005',
        'name="panel_7" pos="-0.027780000000000005',
        "universal_47_2",
        Quantity.JOINT_ORIGIN,
        0.005,
        ("ball_67", "ball_57"),
    ),
    "point of a rod": Case(
        ROD, 'pos="0.3 0 0.15"/>', 'pos="0.305 0 0.15"/>', "rod", Quantity.LOOP_POINT, 0.005, ("rod",)
    ),
    "joint before a rod": Case(
        ROD, 'pos="0 0 0.1"', 'pos="0 0 0.105"', "elbow", Quantity.JOINT_ORIGIN, 0.005, ("rod",)
    ),
    "point of a spring": Case(
        SPRING, 'pos="0.3 0 0.15"/>', 'pos="0.305 0 0.15"/>', "rod", Quantity.SPRING_POINT, 0.005, ("rod",)
    ),
    "point that does not follow": Case(
        LINKAGE, 'pos="0.3 0 0.15"/>', 'pos="0.305 0 0.15"/>', "loop", Quantity.LOOP_POINT, 0.005, ()
    ),
}


def compared(folder: Path, first: str, second: str) -> crosscheck.Diff:
    paths = [folder / "first.xml", folder / "second.xml"]
    for path, text in zip(paths, (first, second), strict=True):
        path.write_text(text)
    return crosscheck.diff(*map(str, paths))


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_one_number_of_a_file_is_one_row(case: Case, tmp_path: Path) -> None:
    assert case.text.count(case.before) == 1
    second = case.text.replace(case.before, case.after)
    (row,) = compared(tmp_path, case.text, second).differences
    assert (row.element, row.quantity, row.consequences) == (case.element, case.quantity, case.consequences)
    assert row.size == pytest.approx(case.size)
    assert row.effect is not None
    assert row.effect > 0.0


def test_the_effect_of_a_row_is_that_of_all_that_follows(tmp_path: Path) -> None:
    """A spring whose unloaded length is that of the pose of the file has no force in it, in both files."""
    case = CASES["point of a spring"]
    found = compared(tmp_path, case.text, case.text.replace(case.before, case.after))
    (row,) = found.differences
    assert row.effect == pytest.approx(found.comparison.motion.change, rel=1e-6)


def test_a_length_that_differs_beside_a_point_is_a_row_of_its_own(tmp_path: Path) -> None:
    second = ROD.replace('pos="0.3 0 0.15"/>', 'pos="0.305 0 0.15"/>')
    second = second.replace('tendon1="rod"/>', 'tendon1="rod" polycoef="0.01 0 0 0 0"/>')
    rows = compared(tmp_path, ROD, second).differences
    assert {(row.quantity, row.consequences) for row in rows} == {
        (Quantity.LOOP_POINT, ()),
        (Quantity.LOOP_LENGTH, ()),
    }


WELD = """<mujoco><worldbody>
  <body name="a"><joint name="j" axis="0 1 0"/>
    <inertial pos="0.1 0.02 0" mass="1" diaginertia="0.01 0.02 0.02"/>
  <body name="b" pos="0.3 0 0"><joint name="k" axis="0 1 0"/>
    <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/></body></body>
  <body name="c" pos="0.6 0 0"><joint name="turn" axis="0 1 0"/><joint name="x" type="slide" axis="1 0 0"/>
    <joint name="z" type="slide" axis="0 0 1"/>
    <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/></body></worldbody>
  <equality><weld name="hold" body1="b" body2="c"{}/></equality></mujoco>"""


def test_the_rotation_that_a_weld_holds_is_a_row(tmp_path: Path) -> None:
    half = np.radians(5.0)
    texts = [
        WELD.format(f' relpose="0.3 0 0 {np.cos(angle):.12f} 0 {np.sin(angle):.12f} 0"')
        for angle in (0.0, half)
    ]
    (row,) = compared(tmp_path, *texts).differences
    assert (row.element, row.quantity, row.unit) == ("hold", Quantity.LOOP_AXIS, "rad")
    assert row.size == pytest.approx(2.0 * half)


@pytest.mark.parametrize("place", ['pos="0.3 0 0" euler="10 0 0"', 'pos="0.31 0 0"'])
def test_a_weld_in_the_pose_of_the_file_follows_a_joint(place: str, tmp_path: Path) -> None:
    first = WELD.format("")
    second = first.replace('name="b" pos="0.3 0 0"', f'name="b" {place}')
    (row,) = compared(tmp_path, first, second).differences
    assert (row.element, row.element_kind, row.consequences) == ("k", "joint", ("hold",))


@pytest.mark.parametrize("has_names", [True, False], ids=["with their names", "without their names"])
@pytest.mark.parametrize("numbers", ["", ' damping="0.3" range="-0.5 1"'], ids=["plain", "with numbers"])
def test_exchanged_joints_of_a_universal_joint_are_one_row(
    has_names: bool, numbers: str, tmp_path: Path
) -> None:
    first = AXES[0].replace(" type=", f"{numbers} type="), AXES[1]
    second = first[::-1]
    if not has_names:
        names = "universal_47_1", "universal_47_2"
        second = second[0].replace(names[1], names[0]), second[1].replace(names[0], names[1])
    texts = [TRACKER.replace("\n".join(AXES), "\n".join(lines)) for lines in (first, second)]
    found = compared(tmp_path, *texts)
    (row,) = found.differences
    assert (row.quantity, {*row.elements}) == (Quantity.JOINT_AXIS, {"universal_47_1", "universal_47_2"})
    assert row.size == pytest.approx(np.pi / 2)
    assert not [other for other in found.comparison.rows if other.quantity is Quantity.SIGN]


def test_a_convention_names_the_cause_of_all_its_elements(tmp_path: Path) -> None:
    """Both hinges count the other way; only one has a drive, whose limits show that the file means it."""
    first = LINKAGE.replace('name="motor"', 'name="motor" range="-100 50"')
    second = LINKAGE.replace('<joint name="elbow"/>', '<joint name="elbow" axis="0 -1 0"/>')
    second = second.replace('name="motor"', 'name="motor" axis="0 -1 0" range="-50 100"')
    found = compared(tmp_path, first, second).comparison
    rows = {row.elements: row for row in found.rows if row.quantity is Quantity.SIGN}
    assert rows.keys() == {("motor",), ("elbow",)}
    assert all(row.convention for row in rows.values())
    assert len({row.cause for row in rows.values()}) == 2


def test_two_loops_of_the_same_bodies_follow_a_joint_in_the_same_words(tmp_path: Path) -> None:
    connect = '<connect name="loop" site1="coupler_end" site2="rocker_end"/>'
    twice = '<connect body1="coupler" body2="rocker" anchor="{} 0 0"/>'
    text = LINKAGE.replace(connect, twice.format(0.3) + twice.format(0.2))
    (row,) = compared(
        tmp_path, text, text.replace('name="rocker" pos="0.3 0 0"', 'name="rocker" pos="0.31 0 0"')
    ).differences
    words = row.cause.split("; ")
    assert len(words) == len({*words}) == 1
