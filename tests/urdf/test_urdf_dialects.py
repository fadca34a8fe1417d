"""Elements that tools add to URDF: loops, springs and rotors are read, or refused with their line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from urdf_files import joint, link, robot

from newton_euler.errors import NewtonEulerError
from newton_euler.model.forces import JointSpring, PointSpring
from newton_euler.runs.simulate import simulate
from urdf import read
from urdf.errors import UrdfError
from urdf.reader import Reading

BAR = """<link name="{0}"><inertial><origin xyz="{1}"/><mass value="0.5"/>
<inertia ixx="0.002" iyy="0.005" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
HINGE = """<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/>
<axis xyz="0 1 0"/>{4}</joint>"""
BARS = "".join(
    (
        BAR.format("crank", "0 0 0.1"),
        BAR.format("coupler", "0.15 0 0"),
        BAR.format("rocker", "0 0 0.1"),
        HINGE.format("a", "base", "crank", "0 0 0", ""),
        HINGE.format("b", "crank", "coupler", "0 0 0.2", ""),
        HINGE.format("c", "base", "rocker", "0.3 0 0", "{joint}"),
    )
)
"""A four-bar linkage whose coupler is not joined to its rocker, at (0.3, 0, 0.2)."""

GAZEBO = """<gazebo><joint name="close" type="{kind}"><parent>{parent}</parent><child>rocker</child>
<pose>{pose}</pose><axis><xyz>{axis}</xyz></axis></joint></gazebo>"""
ENDS = '<{0} link="coupler" xyz="0.3 0 0" rpy="0 0 0"/><{1} link="rocker" xyz="0 0 0.2" rpy="0 0 0"/>'
ORIGINS = """<parent link="coupler"/><child link="rocker"/><parent_origin xyz="0.3 0 0"/>
<child_origin xyz="0 0 0.2"/>"""


def drake(tag: str, *more: str, points: Sequence[str] = ("0.3 0 0", "0 0 0.2")) -> str:
    """An element of Drake between coupler and rocker."""
    names = (("body_A", "name", "coupler"), ("p_AP", "value", points[0]))
    names += (("body_B", "name", "rocker"), ("p_BQ", "value", points[1]))
    parts = [f'<drake:{tag}_{part} {key}="{value}"/>' for part, key, value in names]
    return f"<drake:{tag}>{''.join([*parts, *more])}</drake:{tag}>"


def four_bar(folder: Path, more: str, joint: str = "", **options: object) -> Reading:
    """Read the linkage with these elements."""
    path = folder / "bars.urdf"
    space = 'xmlns:drake="http://drake.mit.edu"'
    path.write_text(
        f'<robot name="bars" {space}><link name="base"/>\n{BARS.replace("{joint}", joint)}\n{more}</robot>'
    )
    return read(path, **options)  # type: ignore[arg-type]


def gazebo(
    kind: str = "revolute", parent: str = "coupler", pose: str = "0 0 0.2 0 0 0", axis: str = "0 1 0"
) -> str:
    """A joint in `<gazebo>` between a link and the rocker."""
    return GAZEBO.format(kind=kind, parent=parent, pose=pose, axis=axis)


def isaac(kind: str, inner: str) -> str:
    return f'<loop_joint name="close" type="{kind}">{inner}</loop_joint>'


TILTED = gazebo(pose="0 0 0.2 0.7 0 0")
IN_PARENT = "<use_parent_model_frame>1</use_parent_model_frame></axis>"

LOOPS = {
    "gazebo": (gazebo(), "revolute"),
    "gazebo, turned": (gazebo(pose="0 0 0.2 0 0 1.5707963267948966", axis="1 0 0"), "revolute"),
    "gazebo, model": (TILTED.replace("<xyz>", '<xyz expressed_in="__model__">'), "revolute"),
    "gazebo, SDF 1.4": (TILTED.replace("</axis>", IN_PARENT), "revolute"),
    "gazebo, child": (gazebo().replace("<pose>", '<pose relative_to="rocker">'), "revolute"),
    "gazebo, link": (
        gazebo(pose="0.3 0 0.2 0 0 0").replace("<pose>", '<pose relative_to="base">'),
        "revolute",
    ),
    "gazebo, ball": (gazebo("ball"), "spherical"),
    "isaac": (isaac("spherical", ENDS.format("link1", "link1")), "spherical"),
    "isaac, second spelling": (isaac("spherical", ENDS.format("link1", "link2")), "spherical"),
    "origins": (isaac("revolute", f'{ORIGINS}<axis xyz="0 1 0" frame="parent"/>'), "revolute"),
    "drake": (drake("ball_constraint"), "spherical"),
}
"""Closures, and the kind of the joint that they become."""


@pytest.mark.parametrize("name", LOOPS)
def test_loops_of_other_tools_are_closed(name: str, tmp_path: Path) -> None:
    text, kind = LOOPS[name]
    scene = four_bar(tmp_path, text).scene
    (closing,) = [j for j in scene.mechanism.joints if j.name not in ("a", "b", "c")]
    assert closing.kind == kind
    assert closing.name == "close" or "<loop_joint" not in text
    assert closing.point == pytest.approx([0.3, 0.0, 0.2])
    if kind == "revolute":
        assert np.abs(closing.axis) == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)  # type: ignore[attr-defined]


def test_a_loop_of_gazebo_moves_as_one_of_a_loop_file(tmp_path: Path) -> None:
    own = simulate(four_bar(tmp_path, gazebo(), duration=0.5).scene)
    (tmp_path / "loops.yaml").write_text("closed_loop: [[p, q]]\ntype: [3d]\nname_mot: []\n")
    tips = (
        '<link name="p"/><link name="q"/><joint name="tp" type="fixed"><parent link="coupler"/>'
        '<child link="p"/><origin xyz="0.3 0 0"/></joint><joint name="tq" type="fixed">'
        '<parent link="rocker"/><child link="q"/><origin xyz="0 0 0.2"/></joint>'
    )
    other = simulate(four_bar(tmp_path, tips, loops=tmp_path / "loops.yaml", duration=0.5).scene)
    # both runs have a relative tolerance of 1e-10
    assert own.position[-1] == pytest.approx(other.position[-1], abs=1e-8)


@pytest.mark.parametrize(
    "text",
    [
        f'<constraint name="close" type="revolute">{ORIGINS}</constraint>',
        '<loop name="close"/>',
        '<loop_closure name="close"/>',
        f'<loop_joint name="close" type="revolute">{ORIGINS}</loop_joint>',
        f'<loop_joint name="close" type="gearbox">{ORIGINS}</loop_joint>',
        '<loop_joint name="close" type="spherical"><link1 link="coupler"/></loop_joint>',
        gazebo("prismatic"),
        gazebo("universal"),
        gazebo(pose="0 0 0.2 0 0"),
        gazebo().replace("<pose>", '<pose relative_to="nowhere">'),
        gazebo(axis="0 0 0"),
        gazebo(parent="nowhere"),
        gazebo(parent="rocker"),
        drake("ball_constraint", points=("0.3 0", "0 0 0.2")),
        drake("ball_constraint").replace('name="rocker"', 'name="nowhere"'),
        drake("linear_bushing_rpy"),
        drake("distance_constraint"),
        drake("tendon_constraint"),
        drake("linear_spring_damper"),
        '<drake:joint name="close" type="ball"/>',
        "<equality><connect/></equality>",
        '<weld name="close"/>',
        '<gazebo reference="nowhere"><springStiffness>3</springStiffness></gazebo>',
        '<gazebo reference="a"><springStiffness>-3</springStiffness></gazebo>',
    ],
)
def test_what_holds_or_pushes_and_is_not_understood_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(UrdfError) as error:
        four_bar(tmp_path, text)
    assert str(tmp_path / "bars.urdf") in str(error.value)
    last = len((tmp_path / "bars.urdf").read_text().splitlines())
    assert any(f"line {line}" in str(error.value) for line in range(1, last + 1)) or "stiffness" in str(
        error.value
    )


@pytest.mark.parametrize("name", ["constraint", "close"])
@pytest.mark.parametrize("names", [list, np.array])
def test_what_is_refused_can_be_left_out_by_tag_or_name(name: str, names: Any, tmp_path: Path) -> None:
    text = f'<constraint name="close" type="revolute">{ORIGINS}</constraint>'
    found = four_bar(tmp_path, text, ignore=names([name]))
    assert [entry.element for entry in found.report.unsimulated()] == ["<constraint> 'close'"]
    assert len(found.scene.mechanism.joints) == 3
    with pytest.raises(UrdfError, match="tendon"):
        four_bar(tmp_path, text, ignore=[name, "tendon"])


def test_loops_that_are_understood_can_be_left_out(tmp_path: Path) -> None:
    found = four_bar(tmp_path, gazebo(), ignore="close")
    assert len(found.scene.mechanism.joints) == 3
    assert len(found.report.unsimulated()) == 1


SPRINGS = {
    "gazebo": ('<gazebo reference="c"><springStiffness>4</springStiffness>'
               "<springReference>0.2</springReference><implicitSpringDamper>1</implicitSpringDamper></gazebo>",
               "", (4.0, 0.2, 0.0)),
    "gazebo's dynamics": ('<gazebo reference="c"><dynamics><damping>0.3</damping><spring_stiffness>2'
                          "</spring_stiffness></dynamics></gazebo>", "", (2.0, 0.0, 0.3)),
    "dynamics": (
        "", '<dynamics damping="0.1" spring_stiffness="3" spring_reference="-0.4"/>', (3.0, -0.4, 0.1)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SPRINGS)
def test_springs_of_joints(name: str, tmp_path: Path) -> None:
    more, dynamics, numbers = SPRINGS[name]
    (spring,) = four_bar(tmp_path, more, dynamics).scene.forces
    assert isinstance(spring, JointSpring)
    assert (spring.joint, spring.stiffness, spring.rest, spring.damping) == ("c", *numbers)


def test_springs_between_points(tmp_path: Path) -> None:
    values = {"free_length": 0.1, "stiffness": 50.0, "damping": 2.0}
    more = [f'<drake:linear_spring_damper_{part} value="{value}"/>' for part, value in values.items()]
    text = drake("linear_spring_damper", *more, points=("0.1 0 0", "0 0 0.15"))
    (spring,) = four_bar(tmp_path, text).scene.forces
    assert isinstance(spring, PointSpring)
    assert (spring.rest_length, spring.stiffness, spring.damping) == (0.1, 50.0, 2.0)
    assert spring.point_on_first == pytest.approx([0.1, 0.0, 0.2])
    assert spring.point_on_second == pytest.approx([0.3, 0.0, 0.15])


ROTORS = {
    "in the joint": ("", '<drake:rotor_inertia value="2e-5"/><drake:gear_ratio value="100"/>', 0.2),
    "in the actuator": ('<transmission name="t"><joint name="c"/><actuator name="m"><drake:rotor_inertia '
                        'value="2e-5"/><drake:gear_ratio value="50"/></actuator></transmission>', "", 0.05),
    "armature": ("", '<dynamics damping="0" armature="0.3"/>', 0.3),
}  # fmt: skip


@pytest.mark.parametrize("name", ROTORS)
def test_rotors(name: str, tmp_path: Path) -> None:
    more, inner, inertia = ROTORS[name]
    (rotor,) = four_bar(tmp_path, more, inner).scene.armatures
    assert (rotor.joint, rotor.inertia) == ("c", pytest.approx(inertia))  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("more", "inner"),
    [
        ("<muscle/>", ""),
        ("<gazebo><static>true</static></gazebo>", ""),
        ("", '<dynamics damping="0"/><dynamics damping="3"/>'),
        ('<mujoco><option gravity="0 0 0"/></mujoco>', ""),
        ('<gazebo reference="rocker"><gravity>false</gravity></gazebo>', ""),
        ('<gazebo reference="rocker"><dampingFactor>0.1</dampingFactor></gazebo>', ""),
        ('<gazebo><plugin filename="libhydrodynamics.so"/></gazebo>', ""),
        ('<transmission name="t"><joint name="c"/><backlash>0.1</backlash></transmission>', ""),
        ("", '<dynamics damping="0" stiction="0.1"/>'),
        ("", "<screw_thread_pitch/>"),
    ],
)
def test_what_no_rule_knows_counts_as_not_understood(more: str, inner: str, tmp_path: Path) -> None:
    report = four_bar(tmp_path, more, inner).report
    (entry,) = [entry for entry in report.entries if not entry.is_understood]
    assert entry.is_unsimulated
    assert "1 not understood" in report.counts()


@pytest.mark.parametrize(
    "more",
    [
        '<gazebo reference="rocker"><mu1>0.2</mu1><material>Red</material><gravity>true</gravity></gazebo>',
        "<gazebo><static>false</static></gazebo>",
        '<gazebo><plugin filename="libgazebo_ros2_control.so" name="control"/></gazebo>',
        '<transmission name="t"><type>x</type><joint name="c"/><actuator name="m"><mechanicalReduction>9'
        "</mechanicalReduction></actuator></transmission>",
        '<ros2_control name="x"><joint name="c"/></ros2_control><fixed_frame name="tool"/>',
        '<mujoco><compiler balanceinertia="true"/></mujoco>',
    ],
)
def test_what_moves_nothing_is_no_element_that_acts(more: str, tmp_path: Path) -> None:
    assert four_bar(tmp_path, more).report.unsimulated() == []


def test_onshape_closing_frames_need_a_loop_file(tmp_path: Path) -> None:
    tips = "".join(
        f'<link name="closing_knee_{k}"/><joint name="t{k}" type="fixed"><parent link="{parent}"/>'
        f'<child link="closing_knee_{k}"/><origin xyz="{xyz}"/></joint>'
        for k, parent, xyz in ((1, "coupler", "0.3 0 0"), (2, "rocker", "0 0 0.2"))
    )
    with pytest.raises(UrdfError) as error:
        four_bar(tmp_path, tips)
    assert "closed_loop: [[closing_knee_1, closing_knee_2]]" in str(error.value)
    text = "closed_loop: [[closing_knee_1, closing_knee_2]]\ntype: [3d]\nname_mot: []\n"
    (tmp_path / "loops.yaml").write_text(text)
    assert len(four_bar(tmp_path, tips, loops=tmp_path / "loops.yaml").scene.mechanism.joints) == 4
    assert len(four_bar(tmp_path, tips, ignore="closing_knee").report.unsimulated()) == 1


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ('<sdf version="1.7"><model name="m"/></sdf>', "SDF"),
        ('<robot name="r"><xacro:macro name="m"/></robot>', "xacro robot"),
        ('<robot name="r"><link name="${prefix}a"/></robot>', "xacro robot"),
        ('<robot name="r"><link name="a"><visual><geometry><mesh filename="$(find x)/m.stl"/></geometry>'
         "</visual></link></robot>", "xacro robot"),
    ],
)  # fmt: skip
def test_other_formats_are_refused_with_what_to_do(text: str, word: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("robot.urdf").write_text(text)
    with pytest.raises(NewtonEulerError) as error:
        read("robot.urdf")
    assert word in str(error.value)
    assert "line 1" in str(error.value)


def test_the_parser_writes_nothing_on_the_terminal(tmp_path: Path, capfd) -> None:
    material = '<material><color rgba="1 0 0 1"/></material>'
    visual = f'<visual><geometry><box size="1 1 1"/></geometry>{material}</visual>'
    text = robot(link("a").replace("</link>", f"{visual}</link>"), joint("j", "revolute", "base", "a"))
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    report = read(path).report
    assert capfd.readouterr() == ("", "")
    assert report.findings == []
