"""Two models that differ in what no figure is about: a difference where it moves the mechanism."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run

from crosscheck.against.align import align
from crosscheck.against.compare import Model
from crosscheck.against.uncompared import uncompared
from crosscheck.model_files.read import read_model

LINKAGE = Path(__file__).parents[3] / "examples" / "linkage.xml"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            'stiffness="0.5"',
            'stiffness="0.5" frictionloss="0.3"',
            "joint 'pivot': left out: its dry friction 0.3",
        ),
        (
            'stiffness="0.5"',
            'stiffness="0.5" limited="true" range="-5 5"',
            "joint 'pivot': left out: its limits -0.08727 to 0.08727: limits are no bilateral constraints",
        ),
        ('conaffinity="0"', 'conaffinity="1"', "3 geoms that can touch: left out: contacts are no"),
    ],
)
def test_what_is_left_out_of_one_model_only_is_a_difference(capsys, tmp_path, old, new, told) -> None:
    text = LINKAGE.read_text()
    assert old in text
    other = tmp_path / "other.xml"
    other.write_text(text.replace(old, new))
    for pair, where in (((LINKAGE, other), "there"), ((other, LINKAGE), "here")):
        status, out, err = run(capsys, "run", pair[0], "--against", pair[1], "--output", tmp_path / "out")
        assert (status, err) == (1, "")
        assert out.splitlines()[-1].startswith(f"DIFFERENT in what is not compared: only {where}: {told}")
        assert f"not compared, and not the same: only {where}: {told}" in out
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["agrees"] is False
    # it is no difference between a model and itself under other names
    renamed = tmp_path / "renamed.xml"
    renamed.write_text(other.read_text().replace("pivot", "hinge"))
    status, out, _ = run(capsys, "run", other, "--against", renamed, "--output", tmp_path / "out")
    assert status == 0
    assert out.splitlines()[-1].startswith("SAME: ")


GEARED = """<mujoco><compiler angle="radian"/>
<default><geom size="0.1" contype="0" conaffinity="0"/></default>
<worldbody><body name="left"><joint name="a" axis="0 1 0"/><geom pos="0 0 0.2"/></body>
<body name="right"><joint name="d" axis="0 1 0"/><geom pos="1 0 1"/></body></worldbody>
<equality><joint name="je" joint1="a" joint2="d" polycoef="0 1 {} 0 0"/></equality></mujoco>"""


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        ("0", "0.01", "only there: equality 'je': approximated: gear 'je' of ratio 1, its polynomial"),
        ("0.02", "0.01", "equality 'je': polycoef 0 1 0.02 here, 0 1 0.01 there"),
    ],
)
def test_approximations_that_differ_are_a_difference(capsys, tmp_path, first, second, told) -> None:
    paths = [tmp_path / "one.xml", tmp_path / "two.xml"]
    for path, square in zip(paths, (first, second), strict=True):
        path.write_text(GEARED.format(square))
    arguments = ("run", paths[0], "--against", paths[1], "--output", tmp_path / "out")
    status, out, _ = run(capsys, *arguments)
    assert status == 1
    assert out.splitlines()[-1].startswith(f"DIFFERENT in what is not compared: {told}")


def test_softness_and_stepping_inform(capsys, tmp_path) -> None:
    other = tmp_path / "other.xml"
    text = LINKAGE.read_text().replace('timestep="0.002"', 'timestep="0.01" integrator="RK4"')
    other.write_text(text.replace("<connect ", '<connect solref="0.1 1" '))
    status, out, _ = run(capsys, "run", LINKAGE, "--against", other, "--output", tmp_path / "out")
    assert status == 0
    *_, verdict = out.splitlines()
    assert verdict.startswith("SAME: ")
    assert verdict.endswith("; not compared and different: 3 elements, first timestep 0.002 here, 0.01 there")
    for told in ("timestep 0.002 here, 0.01 there", "solref of equality 'loop' 0.02 1 here, 0.1 1 there"):
        assert f"differs in softness or stepping only: {told}" in out


def test_one_file_against_itself_is_told(capsys, tmp_path) -> None:
    status, out, _ = run(capsys, "run", LINKAGE, "--against", LINKAGE, "--output", tmp_path / "out")
    assert status == 0
    assert f"both are {LINKAGE}: one model against itself" in out


# Values behind what is left out

HOLDING = """<mujoco><compiler angle="radian"/><option gravity="0 0 0"/>
<worldbody><geom type="plane" size="1 1 1"/>
<body name="one" pos="0 0 0.5"><joint name="a" axis="0 1 0" damping="0.1 0.5" limited="true" range="-1 2"
 frictionloss="0.1"/><geom name="bar" type="capsule" size="0.01" fromto="0 0 0 0.2 0 0" mass="1"/>
 <site name="s" pos="0.1 0 0"/></body>
<body name="two" pos="0 0.2 0.5"><joint name="b" axis="0 1 0"/>
 <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><geom type="sphere" size="0.03"/>
 <site name="t" pos="0.1 0 0"/><site name="u" pos="0.1 0 0.1"/></body></worldbody>
<tendon><spatial name="cord" stiffness="5"><site site="s"/><site site="t"/><site site="u"/></spatial></tendon>
<actuator><general name="m" joint="a" dyntype="filter" dynprm="0.1" gainprm="3"/></actuator>
<keyframe><key ctrl="1"/></keyframe></mujoco>"""

LIMITED = """<robot name="arm"><link name="base"/><link name="rod"><inertial><origin xyz="0.1 0 0"/>
<mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="a" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="2" effort="5" velocity="3"/><dynamics friction="0.1"/>
<safety_controller k_velocity="4"/></joint></robot>"""

SINGLE = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody><body name="rod">
<joint name="a" axis="0 1 0" limited="true" range="-1 2" frictionloss="0.1"/>
<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
<geom type="sphere" size="0.1" pos="0.1 0 0"/></body></worldbody></mujoco>"""
"""The same as an MJCF."""


def loaded(folder: Path, name: str, text: str) -> Model:
    path = folder / name
    path.write_text(text)
    return Model(name, str(path), {}, *read_model(str(path), {}))


def apart(first: Model, second: Model) -> list[tuple[str, bool]]:
    """What differs and no figure is about, in words, and whether it moves something."""
    found = uncompared(first, second, align(first.scene, second.scene))
    return [(other.text, other.moves) for other in found]


def check_told(folder: Path, format: str, text: str, old: str, new: str, told: str) -> None:
    """A value changed in a model is the one difference, at the same place from either side."""
    assert text.count(old) == 1
    first = loaded(folder, f"one.{format}", text)
    second = loaded(folder, f"two.{format}", text.replace(old, new))
    assert not apart(first, first)
    ((found, moves),) = apart(first, second)
    assert found.startswith(told)
    assert moves
    ((found, _),) = apart(second, first)
    assert found.split(":")[0] == told.split(":")[0]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("0.1 0.5", "0.1 0.9", "joint 'a', not linear: dampingpoly 0.5 0 here, 0.9 0 there"),
        ("-1 2", "-1 3", "joint 'a', limits: range from the start -1 2 here, -1 3 there"),
        ('"-1 2"', '"-1 2" margin="0.1"', "joint 'a', limits: margin 0 here, 0.1 there"),
        ('loss="0.1"', 'loss="0.2"', "joint 'a', dry friction: dry friction 0.1 here, 0.2 there"),
        ('gainprm="3"', 'gainprm="30"', "actuator 'm': gainprm 3 0 0 here, 30 0 0 there"),
        ('dynprm="0.1"', 'dynprm="0.5"', "actuator 'm': dynprm 0.1 0 0 here, 0.5 0 0 there"),
        ('name="m" joint="a"', 'name="m" joint="b"', "actuator 'm': on a here, on b there"),
        ('"0.1 0 0.1"', '"0.1 0 0.4"', "tendon 'cord': lengthspring 0.3 0.3 here, 0.6 0.6 there; path "),
        ('size="0.03"', 'size="0.3"', "geom 2 of body 'two', contacts: size 0.03 here, 0.3 there"),
        ('name="bar"', 'name="bar" friction="2"', "geom 'bar', contacts: friction 1 0.005 0.0001 here, 2 "),
        ('size="1 1 1"', 'size="1 1 1" pos="0 0 0.4"', "geom 0 of body 'ground', contacts: pos 0 0 0 here, "),
        ('sphere" size="0.03"', 'box" size="1 1 1"', "geom 2 of body 'two', contacts: type sphere here, "),
        ('gravity="0 0 0"', 'gravity="0 0 0" cone="elliptic"', "option, contacts: cone 0 here, "),
    ],
)  # fmt: skip
def test_values_that_differ_are_a_difference(tmp_path: Path, old: str, new: str, told: str) -> None:
    check_told(tmp_path, "xml", HOLDING, old, new, told)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('lower="-1"', 'lower="-2"', "joint 'a', limits: range from the start -1 2 here, -2 2 there"),
        ('effort="5"', 'effort="50"', "joint 'a', limits: effort 5 here, 50 there"),
        ('friction="0.1"', 'friction="0.2"', "joint 'a', dry friction: dry friction 0.1 here, 0.2 there"),
        ('radius="0.1"', 'radius="0.3"', "collision 1 of link 'rod', contacts: radius 0.1 here, 0.3 there"),
        ('"0.1 0 0"/><g', '"0.2 0 0"/><g', "collision 1 of link 'rod', contacts: pos 0.1 0 0 here, 0.2 0 0 "),
        ('k_velocity="4"', 'k_velocity="6"', "joint 'a', safety controller: k_velocity 4 here, 6 there"),
    ],
)  # fmt: skip
def test_values_of_a_urdf_that_differ_are_a_difference(tmp_path: Path, old: str, new: str, told: str) -> None:
    check_told(tmp_path, "urdf", LIMITED, old, new, told)


@pytest.mark.parametrize(
    "ways",
    [
        # names, frames and digits
        [('"bar"', '"beam"'), ('name="m"', 'name="motor"'), ('name="cord"', 'name="rope"')],
        [('"-1 2"', '"-1.00000000000001 2"')],
        [('size="0.01" fromto="0 0 0 0.2 0 0"', 'pos="0.1 0 0" size="0.01 0.1" zaxis="-1 0 0"')],
        [('size="1 1 1"', 'size="3 2 1" pos="0.4 -7 0"')],
    ],
)  # fmt: skip
def test_ways_to_write_the_same_values_are_no_difference(tmp_path: Path, ways) -> None:
    text = HOLDING
    for old, new in ways:
        assert old in text
        text = text.replace(old, new)
    assert not apart(loaded(tmp_path, "one.xml", HOLDING), loaded(tmp_path, "two.xml", text))


def test_the_order_of_geoms_is_no_difference(tmp_path: Path) -> None:
    geoms = [f'<geom size="{size}" pos="{x} 0 9"/>' for size, x in ((0.1, 0), (0.2, 1), (0.3, 2))]
    one, two = (HOLDING.replace("<worldbody>", "<worldbody>" + "".join(own)) for own in (geoms, geoms[::-1]))
    assert not apart(loaded(tmp_path, "one.xml", one), loaded(tmp_path, "two.xml", two))
    more = two.replace("<worldbody>", '<worldbody><geom name="wall" size="4" pos="9 9 9"/>')
    ((text, _),) = apart(loaded(tmp_path, "one.xml", one), loaded(tmp_path, "more.xml", more))
    assert text == "only there: geom 'wall': left out: contacts are no bilateral constraints"


def test_limits_of_a_hinge_that_counts_the_other_way_are_the_same(tmp_path: Path) -> None:
    first = loaded(tmp_path, "one.xml", SINGLE)
    turned = SINGLE.replace('axis="0 1 0"', 'axis="0 -1 0"')
    assert not apart(first, loaded(tmp_path, "two.xml", turned.replace('"-1 2"', '"-2 1"')))
    ((text, _),) = apart(first, loaded(tmp_path, "two.xml", turned))
    assert text == "joint 'a', limits: range from the start -1 2 here, -2 1 there"


def test_between_formats_what_both_have_is_compared(tmp_path: Path) -> None:
    first = loaded(tmp_path, "arm.xml", SINGLE)
    alone = LIMITED.replace('<safety_controller k_velocity="4"/>', "")
    assert not apart(first, loaded(tmp_path, "arm.urdf", alone))
    # contacts have no numbers in common
    assert not apart(first, loaded(tmp_path, "arm.urdf", alone.replace('radius="0.1"', 'radius="0.3"')))
    for old, new, told in (
        ('lower="-1"', 'lower="-2"', "joint 'a', limits: range from the start -1 2 here, -2 2 there"),
        ('friction="0.1"', 'friction="0.2"', "joint 'a', dry friction: dry friction 0.1 here, 0.2 there"),
        ('<dynamics friction="0.1"/>', "", "only here: joint 'a': left out: its dry friction 0.1"),
    ):
        ((text, moves),) = apart(first, loaded(tmp_path, "arm.urdf", alone.replace(old, new)))
        assert (text, moves) == (told, True)
    # a URDF demands limits
    unlimited = SINGLE.replace('limited="true" range="-1 2"', "")
    assert not apart(loaded(tmp_path, "free.xml", unlimited), loaded(tmp_path, "arm.urdf", alone))
    touching = unlimited.replace('size="0.1"', 'size="0.1" contype="0" conaffinity="0"')
    ((text, _),) = apart(loaded(tmp_path, "free.xml", touching), loaded(tmp_path, "arm.urdf", alone))
    assert text.startswith("only there: 1 collision elements: left out: contacts")


def test_what_a_file_disables_moves_nothing(tmp_path: Path) -> None:
    flags = (
        '<option gravity="0 0 0"><flag contact="disable" limit="disable" frictionloss="disable"/></option>'
    )
    off = HOLDING.replace('<option gravity="0 0 0"/>', flags)
    smaller = off.replace('size="0.03"', 'size="0.02"').replace('"-1 2"', '"-1 1"')
    found = apart(loaded(tmp_path, "one.xml", off), loaded(tmp_path, "two.xml", smaller))
    assert [moves for _, moves in found] == [False, False]
    told = apart(loaded(tmp_path, "one.xml", HOLDING), loaded(tmp_path, "two.xml", off))
    assert all(moves for _, moves in told)
    assert {text.split(":")[0] for text, _ in told} >= {"joint 'a', limits", "joint 'a', dry friction"}


def test_a_difference_in_a_value_is_the_verdict(capsys, tmp_path) -> None:
    paths = [tmp_path / "one.urdf", tmp_path / "two.urdf"]
    for path, effort in zip(paths, ("5", "50"), strict=True):
        path.write_text(LIMITED.replace('effort="5"', f'effort="{effort}"'))
    status, out, _ = run(capsys, "run", paths[0], "--against", paths[1], "--output", tmp_path / "out")
    assert status == 1
    told = "DIFFERENT in what is not compared: joint 'a', limits: effort 5 here, 50 there; "
    assert out.splitlines()[-1].startswith(told)


def test_limits_of_what_moves_no_mass_are_compared_too(tmp_path: Path) -> None:
    """A flange on a hinge that no body hangs on."""
    tip = (
        '<link name="tip"/><joint name="t" type="revolute"><parent link="rod"/><child link="tip"/>'
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    first = loaded(tmp_path, "one.urdf", LIMITED.replace("</robot>", tip))
    wider = tip.replace('upper="1"', 'upper="2"')
    ((text, _),) = apart(first, loaded(tmp_path, "two.urdf", LIMITED.replace("</robot>", wider)))
    assert text.startswith("joint 't', limits: range")


MOTOR = '<motor name="m" joint="a" gear="2"/>'
DRIVEN = SINGLE.replace("</mujoco>", f"<actuator>{MOTOR}</actuator></mujoco>")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('gear="2"', 'gear="3"', "actuator 'm': gear 2 0 0 here, 3 0 0 there"),
        (MOTOR, "", "only here: actuator 'm': exactly: control law of joint"),
    ],
)
def test_what_drives_nothing_is_told_of(tmp_path: Path, old: str, new: str, told: str) -> None:
    """A motor whose control is 0: no figure sees its gear, and nothing would move otherwise."""
    assert DRIVEN.count(old) == 1
    first, second = loaded(tmp_path, "one.xml", DRIVEN), loaded(tmp_path, "two.xml", DRIVEN.replace(old, new))
    assert not apart(first, first)
    ((found, moves),) = apart(first, second)
    assert found.startswith(told)
    assert not moves
