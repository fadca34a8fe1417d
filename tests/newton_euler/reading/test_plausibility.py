"""Likely mistakes of model files: each rule finds its own, and nothing in models without one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mjcf import read as read_mjcf
from mjcf.reading.plausibility import _is_closed
from newton_euler.reading.plausibility import twin_name
from urdf import read as read_urdf

GOOD = "0.0005 0.0005 0.0001"


def arm(
    folder: Path, mass: str = "0.5", inertia: str = GOOD, place: str = "0 0 0.1", geometry: str = ""
) -> list[str]:
    """Names of the findings on the second of two links."""
    xx, yy, zz = inertia.split()
    moments = f'ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"'
    fair = 'ixx="0.002" iyy="0.002" izz="0.0003" ixy="0" ixz="0" iyz="0"'
    visual = f"<visual>{geometry}</visual>" if geometry else ""
    path = folder / "arm.urdf"
    path.write_text(
        f'<robot name="arm"><link name="base"/><link name="upper"><inertial>'
        f'<origin xyz="0 0 0.1"/><mass value="1"/><inertia {fair}/></inertial></link>'
        f'<link name="lower"><inertial><origin xyz="{place}"/>'
        f'<mass value="{mass}"/><inertia {moments}/></inertial>{visual}</link>'
        '<joint name="a" type="continuous"><parent link="base"/><child link="upper"/>'
        '<axis xyz="0 1 0"/></joint>'
        '<joint name="b" type="continuous"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.2"/>'
        '<axis xyz="1 0 0"/></joint></robot>'
    )
    return [finding.name for finding in read_urdf(path).report.findings]


BOX = '<origin xyz="0 0 0.1"/><geometry><box size="0.04 0.04 0.2"/></geometry>'


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({}, []),
        ({"geometry": BOX}, []),
        ({"inertia": "1 1 1"}, ["inertia-too-large"]),
        ({"inertia": "1 1 1", "geometry": BOX}, ["inertia-too-large"]),
        ({"mass": "500", "inertia": "1500 1200 800"}, ["inertia-too-large"]),
        ({"inertia": "500 500 100", "geometry": BOX}, ["inertia-too-large"]),
        ({"inertia": "0.5 0.5 0.1", "geometry": BOX}, ["inertia-too-large"]),
        ({"inertia": "5e-10 5e-10 1e-10", "geometry": BOX}, ["inertia-too-small"]),
        ({"inertia": "1e-4 1e-4 5e-4"}, ["impossible-inertia"]),
        ({"place": "0 0 100", "geometry": BOX}, ["center-outside"]),
        ({"mass": "500", "inertia": "0.5 0.5 0.1", "geometry": BOX}, ["mass-too-large"]),
        ({"mass": "1e-8", "inertia": "1e-11 1e-11 2e-12"}, ["mass-too-small"]),
    ],
)
def test_each_rule(changes: dict[str, str], found: list[str], tmp_path: Path) -> None:
    assert arm(tmp_path, **changes) == found


def sides(
    folder: Path, mass: str = "0.5", place: str = "0.05 {0}0.02 -0.1", moments: str = GOOD
) -> list[str]:
    """Names of the findings on legs of which the left one has these numbers."""
    legs = "".join(
        f'<body name="{name}_leg" pos="0 {sign}0.1 0"><joint axis="0 1 0"/><inertial '
        f'pos="{where.format(sign)}" mass="{kg}" diaginertia="{inertia}"/></body>'
        for name, sign, kg, where, inertia in (
            ("left", "", mass, place, moments),
            ("right", "-", "0.5", "0.05 {0}0.02 -0.1", GOOD),
        )
    )
    path = folder / "legs.xml"
    path.write_text(f"<mujoco><worldbody>{legs}</worldbody></mujoco>")
    return [finding.name for finding in read_mjcf(path).report.findings]


def test_twins_that_differ(tmp_path: Path) -> None:
    assert sides(tmp_path) == []
    assert sides(tmp_path, mass="0.6") == ["twins-differ"]
    (finding,) = read_mjcf(tmp_path / "legs.xml").report.findings
    assert "mirror" not in finding.remedy  # a reflection keeps the mass
    assert sides(tmp_path, place="0.05 -0.06 -0.1") == ["twins-differ"]
    assert sides(tmp_path, moments="0.0006 0.0005 0.0002") == ["twins-differ"]
    assert sides(tmp_path, place="0.05 -0.02 -0.1") == []  # one part on both sides, moved


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("mass", "found"), [("0.5", []), ("0.6", ["twins-differ"])])
def test_twins_may_be_mirrored_along_any_axis(axis: int, mass: str, found: list[str], tmp_path: Path) -> None:
    legs = ""
    for name, sign, kg in (("left", 1.0, mass), ("right", -1.0, "0.5")):
        place, center = np.zeros(3), np.array([0.05, 0.02, -0.1])
        place[axis] = 0.1 * sign
        center[axis] *= sign
        at, com = (" ".join(map(str, vector)) for vector in (place, center))
        inertial = f'<inertial pos="{com}" mass="{kg}" diaginertia="{GOOD}"/>'
        legs += f'<body name="{name}_leg" pos="{at}"><joint axis="0 1 0"/>{inertial}</body>'
    path = tmp_path / "legs.xml"
    path.write_text(f"<mujoco><worldbody>{legs}</worldbody></mujoco>")
    assert [finding.name for finding in read_mjcf(path).report.findings] == found


@pytest.mark.parametrize(
    ("name", "twin"),
    [
        ("left_leg", "right_leg"),
        ("LeftFoot", "RightFoot"),
        ("l_wrist", "r_wrist"),
        ("hip_R", "hip_L"),
        ("FL_calf", "FR_calf"),
        ("RR", "RL"),
        ("gripper_left_right_finger", ""),
        ("motor_back_leftR_link", "motor_back_rightL_link"),
        ("rightLeg", "leftLeg"),
        ("leftRoll_link", "rightRoll_link"),
        ("pelvis", ""),
        ("lever", ""),
    ],
)
def test_names_of_twins(name: str, twin: str) -> None:
    assert twin_name(name) == twin


def test_letters_of_a_series_are_no_sides() -> None:
    """Motoman names the joints of its arms S, L, U, R, B and T."""
    assert twin_name("link_l", ["link_s", "link_l", "link_u", "link_r"]) == ""
    assert twin_name("finger_l", ["palm", "finger_l", "finger_r", "thumb_1"]) == "finger_r"


def test_many_bodies_with_one_mistake_are_few_findings(tmp_path: Path) -> None:
    bodies = "".join(
        f'<body name="b{k}" pos="{0.2 * k} 0 0"><joint axis="0 1 0"/><inertial pos="0 0 0.1" mass="1" '
        'diaginertia="9 9 9"/><geom type="box" size="0.05 0.05 0.1" pos="0 0 0.1"/></body>'
        for k in range(9)
    )
    path = tmp_path / "many.xml"
    path.write_text(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    findings = read_mjcf(path).report.findings
    assert [finding.name for finding in findings] == ["inertia-too-large"] * 4
    assert findings[3].element.startswith("6 more")


L_SHAPE = (
    "0 0 0  3 0 0  3 1 0  1 1 0  1 3 0  0 3 0  0 0 1  3 0 1  3 1 1  1 1 1  1 3 1  0 3 1",
    "0 2 1  0 3 2  0 5 3  3 5 4  6 7 8  6 8 9  6 9 11  9 10 11  0 1 7  0 7 6  1 2 8  1 8 7  "
    "2 3 9  2 9 8  3 4 10  3 10 9  4 5 11  4 11 10  5 0 6  5 6 11",
)
"""Points and triangles of a prism over an L."""


@pytest.mark.parametrize(
    ("kind", "found"), [("exact", []), ("convex", ["mesh-inertia"]), ("shell", ["mesh-inertia"])]
)
def test_inertia_of_meshes(kind: str, found: list[str], tmp_path: Path) -> None:
    points, faces = L_SHAPE
    path = tmp_path / "mesh.xml"
    path.write_text(
        f'<mujoco><asset><mesh name="l" inertia="{kind}" scale="0.1 0.1 0.1" vertex="{points}" '
        f'face="{faces}"/></asset><worldbody><body name="a"><joint axis="0 1 0"/>'
        '<geom type="mesh" mesh="l"/></body></worldbody></mujoco>'
    )
    findings = read_mjcf(path).report.findings
    assert [finding.name for finding in findings] == found


@pytest.mark.parametrize(("added", "closed"), [([], True), ([[0, 2, 1]], False), ([[0, 1, 2]], False)])
def test_a_closed_mesh_passes_each_edge_once_each_way(added: list[list[int]], closed: bool) -> None:
    faces = np.array(L_SHAPE[1].split(), dtype=int).reshape(-1, 3)
    assert _is_closed(np.concatenate([faces, np.reshape(added, (-1, 3)).astype(int)])) is closed
    assert not _is_closed(faces[:-1])  # a hole
    assert not _is_closed(np.concatenate([faces[:-1], faces[-1:, ::-1]]))  # a triangle inside out


@pytest.mark.parametrize(("numbers", "found"), [("0.2 0.1", ["short-keyframe"]), ("0.2 0.1 0", [])])
def test_keyframes_that_are_filled_up(numbers: str, found: list[str], tmp_path: Path) -> None:
    path = tmp_path / "keys.xml"
    path.write_text(
        '<mujoco><worldbody><replicate count="3" offset="0 1 0"><body><joint axis="0 1 0"/>'
        '<geom size="0.1" pos="0.2 0 0"/></body></replicate></worldbody>'
        f'<keyframe><key name="k" qpos="{numbers}"/></keyframe></mujoco>'
    )
    report = read_mjcf(path).report
    assert [finding.name for finding in report.findings] == found
    assert all(np.array([len(finding.remedy) for finding in report.findings]) > 0)
