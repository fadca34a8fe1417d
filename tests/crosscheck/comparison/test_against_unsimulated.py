"""Elements that are not simulated and that only one of two models has: a difference if they move it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run, verdict_of

from crosscheck.against.align import alignments
from crosscheck.against.compare import Model, unsimulated
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
        assert verdict_of(out).startswith(f"DIFFERENT in what is not compared: only {where}: {told}")
        assert f"not compared, and only {where}: {told}" in out
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["agrees"] is False
    # it is no difference between a model and itself under other names
    renamed = tmp_path / "renamed.xml"
    renamed.write_text(other.read_text().replace("pivot", "hinge"))
    status, out, _ = run(capsys, "run", other, "--against", renamed, "--output", tmp_path / "out")
    assert status == 0
    assert verdict_of(out).startswith("SAME: ")


GEARED = """<mujoco><compiler angle="radian"/>
<default><geom size="0.1" contype="0" conaffinity="0"/></default>
<worldbody><body name="left"><joint name="a" axis="0 1 0"/><geom pos="0 0 0.2"/></body>
<body name="right"><joint name="d" axis="0 1 0"/><geom pos="1 0 1"/></body></worldbody>
<equality><joint name="je" joint1="a" joint2="d" polycoef="0 1 {} 0 0"/></equality></mujoco>"""


def test_an_approximation_of_one_file_only_is_a_difference(capsys, tmp_path) -> None:
    paths = [tmp_path / "one.xml", tmp_path / "two.xml"]
    for path, square in zip(paths, ("0", "0.01"), strict=True):
        path.write_text(GEARED.format(square))
    arguments = ("run", paths[0], "--against", paths[1], "--output", tmp_path / "out")
    status, out, _ = run(capsys, *arguments)
    assert status == 1
    told = "only there: equality 'je': approximated: gear 'je' of ratio 1, its polynomial"
    assert verdict_of(out).startswith(f"DIFFERENT in what is not compared: {told}")


def test_one_file_against_itself_is_told(capsys, tmp_path) -> None:
    status, out, _ = run(capsys, "run", LINKAGE, "--against", LINKAGE, "--output", tmp_path / "out")
    assert status == 0
    assert f"both are {LINKAGE}: one model against itself" in out


LIMITED = """<robot name="arm"><link name="base"/><link name="rod"><inertial><origin xyz="0.1 0 0"/>
<mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="a" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="2" effort="5" velocity="3"/><dynamics friction="0.1"/></joint></robot>"""

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
    """Elements that only one file has and no figure is about, and whether they move something."""
    return [tuple(found) for found in unsimulated(first, second, next(alignments(first.scene, second.scene)))]


def test_values_and_counts_of_what_is_not_simulated_are_no_difference(tmp_path: Path) -> None:
    first = loaded(tmp_path, "one.xml", SINGLE)
    geom = '<geom type="sphere" size="0.1" pos="0.1 0 0"/>'
    for old, new in (
        ("-1 2", "-1 3"),
        ('loss="0.1"', 'loss="0.2"'),
        ("size", 'margin="1" size'),
        (geom, 2 * geom),
    ):
        assert old in SINGLE
        assert not apart(first, loaded(tmp_path, "two.xml", SINGLE.replace(old, new)))


def test_between_formats_what_both_can_have_is_compared(tmp_path: Path) -> None:
    first = loaded(tmp_path, "arm.xml", SINGLE)
    assert not apart(first, loaded(tmp_path, "arm.urdf", LIMITED))
    ((text, moves),) = apart(
        first, loaded(tmp_path, "arm.urdf", LIMITED.replace('<dynamics friction="0.1"/>', ""))
    )
    assert (text, moves) == ("only here: joint 'a': left out: its dry friction 0.1", True)
    # a URDF demands limits
    unlimited = SINGLE.replace('limited="true" range="-1 2"', "")
    assert not apart(loaded(tmp_path, "free.xml", unlimited), loaded(tmp_path, "arm.urdf", LIMITED))
    touching = unlimited.replace('size="0.1"', 'size="0.1" contype="0" conaffinity="0"')
    ((text, _),) = apart(loaded(tmp_path, "free.xml", touching), loaded(tmp_path, "arm.urdf", LIMITED))
    assert text.startswith("only there: 1 collision elements: left out: contacts")


def test_what_a_file_disables_is_another_thing_than_what_moves(tmp_path: Path) -> None:
    flags = '<option gravity="0 0 -9.81"><flag contact="disable" limit="disable"/></option>'
    off = SINGLE.replace('<option gravity="0 0 -9.81"/>', flags)
    found = apart(loaded(tmp_path, "one.xml", SINGLE), loaded(tmp_path, "two.xml", off))
    assert [(text.split(":")[0], moves) for text, moves in found] == [
        ("only here", True),
        ("only here", True),
        ("only there", False),
        ("only there", False),
    ]


DRIVEN = SINGLE.replace("</mujoco>", '<actuator><motor name="m" joint="a" gear="2"/></actuator></mujoco>')


def test_what_drives_nothing_is_told_of(tmp_path: Path) -> None:
    """A motor whose control is 0: no figure sees it, and nothing would move otherwise."""
    ((text, moves),) = apart(loaded(tmp_path, "one.xml", DRIVEN), loaded(tmp_path, "two.xml", SINGLE))
    assert text.startswith("only here: actuator 'm': exactly: control law of joint")
    assert not moves
