"""Elements that are not simulated and that two models do not have alike: a difference if they move it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run

from crosscheck.compare.two_models.align import alignments
from crosscheck.compare.two_models.unsimulated import NEVER_COMPARED, Model, unsimulated
from crosscheck.library.model_files import read_model

LINKAGE = Path(__file__).parents[3] / "examples" / "linkage.xml"


FRICTION = "joint 'pivot': left out: its dry friction 0.3"

SHORT = ("--set", "duration=0.1")


def test_what_is_left_out_of_one_model_only_is_a_difference(capsys, tmp_path) -> None:
    other, renamed = tmp_path / "other.xml", tmp_path / "renamed.xml"
    other.write_text(LINKAGE.read_text().replace('stiffness="0.5"', 'stiffness="0.5" frictionloss="0.3"'))
    renamed.write_text(other.read_text().replace("pivot", "hinge"))
    for pair, where in (((LINKAGE, other), "there"), ((other, LINKAGE), "here")):
        models = ("run", pair[0], "--against", pair[1], *SHORT)
        status, out, err = run(capsys, *models, "--output", tmp_path / "out")
        assert (status, err) == (1, "")
        told = f"only {where}: {FRICTION}"
        assert f"DIFFERENT in what is not compared: {told}" in out
    content = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert content["agrees"] is False
    assert any(note.startswith(f"not compared, and {told}") for note in content["notes"])
    # it is no difference between a model and itself, under other names or not
    for second in (renamed, other):
        status, out, _ = run(capsys, "run", other, "--against", second, "--output", tmp_path / "out")
        assert status == 0
        assert "SAME: " in out
    (note,) = json.loads((tmp_path / "out" / "summary.json").read_text())["notes"]
    assert note == f"both are {other}: one model against itself"


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


MOTOR = '<motor name="m" joint="a" gear="2" ctrlrange="-1 1" forcerange="-5 5"/>'

DRIVEN = SINGLE.replace("</mujoco>", f"<actuator>{MOTOR}</actuator></mujoco>")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("-1 2", "-1 3", "limits of joint 'a': -1 to 2 in {}, -1 to 3 in {}"),
        ("-1 2", "-1 2.0001", "limits of joint 'a': -1 to 2 in {}, -1 to 2.0001 in {}"),
        ('loss="0.1"', 'loss="0.2"', "dry friction of joint 'a': 0.1 in {}, 0.2 in {}"),
        ("-5 5", "-5 9", "limit of the force of actuator 'm': -5 to 5 in {}, -5 to 9 in {}"),
        ("-1 1", "-1 8", "control range of actuator 'm': -1 to 1 in {}, -1 to 8 in {}"),
    ],
)
def test_other_numbers_of_what_is_not_simulated_are_a_difference(tmp_path: Path, old, new, told) -> None:
    assert DRIVEN.count(old) == 1
    models = (
        loaded(tmp_path, "one.xml", DRIVEN),
        loaded(tmp_path, "two.xml", DRIVEN.replace(old, new)),
    )
    for first, second in (models, models[::-1]):
        ((text, moves),) = apart(first, second)
        assert moves
        if first is models[0]:
            assert text == told.format(*(model.source for model in models))


def test_round_off_contacts_and_counts_of_what_is_not_simulated_are_no_difference(tmp_path: Path) -> None:
    first = loaded(tmp_path, "one.xml", SINGLE)
    geom = '<geom type="sphere" size="0.1" pos="0.1 0 0"/>'
    for old, new in (
        ("-1 2", "-1.00001 1.99999"),
        ('loss="0.1"', 'loss="0.1000005"'),
        ("size", 'margin="1" size'),
        (geom, 2 * geom),
    ):
        assert old in SINGLE
        assert not apart(first, loaded(tmp_path, "two.xml", SINGLE.replace(old, new)))


def test_limits_are_compared_in_the_counting_of_each_file(tmp_path: Path) -> None:
    """A coordinate may count the other way, and from another pose."""
    first = loaded(tmp_path, "one.xml", SINGLE)
    for axis, limits, same in (
        ("0 -1 0", "-2 1", True),
        ("0 -1 0", "-1 2", False),
    ):
        other = SINGLE.replace('axis="0 1 0"', f'axis="{axis}"').replace("-1 2", limits)
        assert (not apart(first, loaded(tmp_path, "two.xml", other))) == same
    shifted = SINGLE.replace("-1 2", "-0.5 2.5").replace("limited", 'ref="0.5" limited')
    assert not apart(first, loaded(tmp_path, "two.xml", shifted))
    ((text, moves),) = apart(first, loaded(tmp_path, "arm.urdf", LIMITED.replace('upper="2"', 'upper="3"')))
    assert moves
    assert text.startswith("limits of joint 'a': -1 to 2 in ")


def test_a_range_of_a_control_that_only_one_file_has_is_a_difference(tmp_path: Path) -> None:
    free = DRIVEN.replace(' ctrlrange="-1 1"', "")
    models = loaded(tmp_path, "one.xml", DRIVEN), loaded(tmp_path, "two.xml", free)
    for pair, where in ((models, "here"), (models[::-1], "there")):
        assert apart(*pair) == [(f"only {where}: control range of actuator 'm': -1 to 1", True)]
    # a URDF has no actuators, and an idle motor that only one file has is compared as a whole
    driven = loaded(tmp_path, "idle.xml", DRIVEN.replace(' forcerange="-5 5"', ""))
    assert not apart(driven, loaded(tmp_path, "arm.urdf", LIMITED))
    assert [moves for _, moves in apart(driven, loaded(tmp_path, "bare.xml", SINGLE))] == [False]


def test_the_verdict_of_two_mjcf_names_what_is_never_compared(capsys, tmp_path: Path) -> None:
    other = tmp_path / "other.xml"
    text = LINKAGE.read_text()
    assert '<connect name="loop"' in text
    other.write_text(text.replace('<connect name="loop"', '<connect name="loop" solref="0.5 1"'))
    status, _, _ = run(capsys, "run", LINKAGE, "--against", other, *SHORT, "--output", tmp_path / "out")
    assert status == 0
    verdict = json.loads((tmp_path / "out" / "summary.json").read_text())["verdict"]
    assert verdict.endswith(NEVER_COMPARED)


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


IDLE = SINGLE.replace("</mujoco>", '<actuator><motor name="m" joint="a" gear="2"/></actuator></mujoco>')


@pytest.mark.parametrize(
    ("one", "two", "told", "wanted"),
    [
        # a motor whose control is 0: no figure sees it, and nothing would move otherwise
        (IDLE, SINGLE, "only here: actuator 'm': exactly: control law of joint", False),
    ],
)
def test_what_only_one_file_has_is_told_with_whether_it_moves(tmp_path: Path, one, two, told, wanted) -> None:
    ((text, moves),) = apart(loaded(tmp_path, "one.xml", one), loaded(tmp_path, "two.xml", two))
    assert text.startswith(told)
    assert moves == wanted
