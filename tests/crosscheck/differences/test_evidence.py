"""Evidence speaks for the file without the planted fault, and is silent where nothing tells the right one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import crosscheck
from crosscheck.differences.difference import Difference, Evidence, Quantity, Side
from crosscheck.differences.evidence import with_evidence
from crosscheck.differences.rows import differences
from crosscheck.report.diff import report
from crosscheck.report.render import terminal
from newton_euler.reading.robot import Robot
from tests.support.file_robots import aligned, arm, as_file, body_of, turn, walker, with_body, with_joint

MIRROR = np.diag([1.0, -1.0, 1.0])


def evidence_of(first: Robot, second: Robot) -> dict[tuple[str, Quantity], tuple[Evidence, ...]]:
    """Return the evidence on each row about two robots, by its element and quantity."""
    files, alignment = (as_file(first), as_file(second)), aligned(first, second)
    rows = with_evidence(differences(*files, alignment, None), files, alignment)
    return {(row.element, row.quantity): row.evidence for row in rows}


def sides(evidence: tuple[Evidence, ...]) -> list[Side]:
    return [each.speaks_for for each in evidence]


@pytest.mark.parametrize(
    ("moments", "problem"),
    [
        # trunk of the Mini Cheetah with a misplaced decimal point
        ((0.011353, 0.042773, 0.36213), "0.01135 + 0.04277 < 0.3621 kg m^2"),
        # elbow of Digit
        ((-0.00119031, 0.00165717, 0.00956413), "the smallest moment is -0.00119 kg m^2"),
        # leg of an iCub with a mass and no inertia
        ((0.0, 0.0, 0.0), "all moments are 0"),
    ],
)
def test_no_body_has_moments_that_violate_the_triangle_inequality(moments, problem):
    good = arm()
    bad = with_body(good, "fore", inertia=np.diag(moments))
    key = "fore", Quantity.INERTIA
    assert evidence_of(bad, good)[key] == (
        Evidence(Side.SECOND, f"no rigid body has the first inertia: {problem}"),
    )
    assert evidence_of(good, bad)[key] == (
        Evidence(Side.FIRST, f"no rigid body has the second inertia: {problem}"),
    )
    worse = with_body(good, "fore", inertia=np.diag([1.0, 1.0, 5.0]))
    (both,) = evidence_of(bad, worse)[key]
    assert both.speaks_for is Side.NEITHER


def test_a_thin_rod_is_no_violation():
    """Moments 0, c and c of a rod satisfy the inequality with equality, which digits may break."""
    rod = with_body(arm(), "fore", inertia=np.diag([0.0, 0.01, 0.01 + 1e-9]))
    assert not evidence_of(arm(), rod)["fore", Quantity.INERTIA]


def changed_shin(quantity: Quantity) -> Robot:
    """Return a walker whose left shin is no longer the mirror image of the right one."""
    robot = walker()
    shin = body_of(robot, "left_shin")
    match quantity:
        case Quantity.MASS:
            return with_body(robot, "left_shin", mass=0.5 * shin.mass)
        case Quantity.CENTER:
            return with_body(robot, "left_shin", center=MIRROR @ shin.center)
        case Quantity.INERTIA:
            return with_body(robot, "left_shin", inertia=1.2 * shin.inertia)
        case Quantity.INERTIA_AXES:
            tilted = turn("z", 0.3)
            return with_body(robot, "left_shin", inertia=tilted @ shin.inertia @ tilted.T)
        case Quantity.EFFORT:
            return with_joint(robot, "left_knee", effort=60.0)
    return with_joint(robot, "left_knee", limits=(0.0, 2.0))


@pytest.mark.parametrize(
    ("quantity", "element", "twin"),
    [
        (Quantity.MASS, "left_shin", "right_shin"),
        (Quantity.CENTER, "left_shin", "right_shin"),
        (Quantity.INERTIA, "left_shin", "right_shin"),
        (Quantity.INERTIA_AXES, "left_shin", "right_shin"),
        (Quantity.EFFORT, "left_knee", "right_knee"),
        (Quantity.LIMITS, "left_knee", "right_knee"),
    ],
)
def test_the_file_with_equal_sides_has_the_evidence(quantity, element, twin):
    good, bad = walker(), changed_shin(quantity)
    text = f"{element} and {twin} are alike in this file, and not in the other"
    assert evidence_of(good, bad)[element, quantity] == (Evidence(Side.FIRST, text),)
    assert evidence_of(bad, good)[element, quantity] == (Evidence(Side.SECOND, text),)


def test_two_files_with_equal_sides_have_no_evidence():
    first = second = walker()
    for name in ("left_shin", "right_shin"):
        second = with_body(second, name, mass=2.0)
    assert not any(evidence_of(first, second).values())


def test_a_small_change_at_the_side_that_is_right_has_no_evidence():
    """Left and right differ because of the left side, by much more than the files differ at the right one."""
    bad = changed_shin(Quantity.MASS)
    bad = with_body(bad, "right_shin", mass=body_of(bad, "right_shin").mass * 1.001)
    found = evidence_of(walker(), bad)
    assert sides(found["left_shin", Quantity.MASS]) == [Side.FIRST]
    assert found["right_shin", Quantity.MASS] == ()


BOX = """
<robot name="r"><link name="base"/>
<link name="box">{shape}<inertial><origin xyz="{center}"/><mass value="{mass}"/>
<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="box"/><axis xyz="0 0 1"/></joint>
</robot>"""
SHAPE = '<visual><origin xyz="0.5 0 0"/><geometry><box size="0.2 0.4 0.6"/></geometry></visual>'
# homogeneous box of 0.2 m x 0.4 m x 0.6 m, 48 l, with the density of water: m (a^2 + b^2) / 12
RIGHT = {"center": "0.5 0 0", "mass": 48.0, "ixx": 2.08, "iyy": 1.6, "izz": 0.8}


def box_differences(folder: Path, shape: str = SHAPE, **wrong: object) -> tuple[Difference, ...]:
    """Return the differences of the URDF of a box and of one with other values; only the first has shapes."""
    files = folder / "right.urdf", folder / "wrong.urdf"
    files[0].write_text(BOX.format(shape=shape, **RIGHT))
    files[1].write_text(BOX.format(shape="", **(RIGHT | wrong)))
    return crosscheck.diff(*files).differences


def test_an_implausible_density_speaks_for_the_other_mass(tmp_path):
    tons = {name: 1e3 * RIGHT[name] for name in ("mass", "ixx", "iyy", "izz")}
    (row,) = (row for row in box_differences(tmp_path, **tons) if row.quantity is Quantity.MASS)
    # 48 kg and 48000 kg in 0.048 m^3
    text = "1000 against 1000000 kg/m^3 in the hull of its shapes"
    assert row.evidence == (Evidence(Side.FIRST, text),)


def test_a_large_radius_of_gyration_speaks_for_the_other_inertia(tmp_path):
    (row,) = box_differences(tmp_path, ixx=208.0, iyy=160.0, izz=80.0)
    # sqrt((0.2^2 + 0.4^2 + 0.6^2) / 12) = 0.216 m
    text = "radii of gyration of 0.216 against 2.16 m; the homogeneous hull of its shapes has 0.216 m"
    assert row.evidence == (Evidence(Side.FIRST, text),)


def test_a_center_outside_the_shapes_speaks_for_the_other_center(tmp_path):
    (row,) = box_differences(tmp_path, center="0.5 0 0.7")
    text = "the other value is 400 mm outside the box around its shapes"
    assert row.evidence == (Evidence(Side.FIRST, text),)


@pytest.mark.parametrize(
    "shape", ["", SHAPE.replace("<box size='0.2 0.4 0.6'/>", "<mesh filename='none.stl'/>")]
)
def test_small_differences_and_missing_shapes_have_no_evidence(tmp_path, shape):
    wrong = {"mass": 50.0, "center": "0.5 0 0.02", "ixx": 2.2}
    rows = box_differences(tmp_path, shape, **wrong)
    assert {row.quantity for row in rows} == {Quantity.MASS, Quantity.CENTER, Quantity.INERTIA}
    assert [row.evidence for row in rows] == [(), (), ()]


def test_evidence_is_shown_and_changes_no_verdict(tmp_path):
    files = tmp_path / "right.urdf", tmp_path / "wrong.urdf"
    files[0].write_text(BOX.format(shape="", **RIGHT))
    files[1].write_text(BOX.format(shape="", **(RIGHT | {"izz": 8.0})))
    found = crosscheck.diff(*files)
    assert not found.same
    text = "no rigid body has the second inertia: 1.6 + 2.08 < 8 kg m^2"
    assert f"inertia of box speaks for the first file: {text}" in " ".join(
        terminal(report(found.comparison).summary).split()
    )
    (row,) = found.comparison.summary()["differences"]
    assert row["evidence"] == ({"speaks_for": "first", "text": text},)


def test_a_turned_link_has_no_evidence():
    first = walker()
    hip = body_of(first, "left_hip")
    tilted = hip.placement._replace(rotation=turn("x", 0.1))
    assert not any(evidence_of(first, with_body(first, "left_hip", placement=tilted)).values())
