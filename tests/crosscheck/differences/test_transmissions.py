"""Transmissions of two URDFs: rows of reductions, interfaces, joints and actuators, without effect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import pytest
from urdf_files import CHAIN

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Difference, Quantity, Standing, Value
from newton_euler.reading.robot import FileTransmission
from urdf.robot import describe

ELBOW = {"joint": "third", "name": "third_trans", "actuator": "third_motor", "type": "SimpleTransmission"}
"""Names of a transmission on a joint of `CHAIN`."""


def transmission(**changed: Any) -> str:
    """Return a transmission in the form of ROS 1; reductions of None are missing."""
    numbers = {"reduction": 50, "at_joint": None, "offset": None, "interface": "EffortJointInterface"}
    given = ELBOW | numbers | changed
    at_joint, at_actuator = (
        "" if given[key] is None else f"<mechanicalReduction>{given[key]}</mechanicalReduction>"
        for key in ("at_joint", "reduction")
    )
    offset = "" if given["offset"] is None else f"<offset>{given['offset']}</offset>"
    return (
        f'<transmission name="{given["name"]}"><type>{given["type"]}</type><joint name="{given["joint"]}">'
        f"<hardwareInterface>{given['interface']}</hardwareInterface>{at_joint}{offset}</joint>"
        f'<actuator name="{given["actuator"]}">{at_actuator}</actuator></transmission>'
    )


def file_with(path: Path, *transmissions: str) -> str:
    """Write `CHAIN` with transmissions."""
    path.write_text(CHAIN.replace("</robot>", f"{''.join(transmissions)}</robot>"))
    return str(path)


def compared(folder: Path, first: list[str], second: list[str]) -> crosscheck.Diff:
    """Compare two files with transmissions."""
    paths = [file_with(folder / f"{k}.urdf", *each) for k, each in enumerate((first, second))]
    return crosscheck.diff(*paths)


def of_standing(found: crosscheck.Diff, standing: Standing) -> list[tuple[str, Quantity, Value, Value]]:
    """Return element, quantity and values of rows."""
    rows: tuple[Difference, ...] = found.comparison.of_standing(standing)
    return [(row.element, row.quantity, row.first, row.second) for row in rows]


CASES: dict[str, tuple[dict[str, Any], dict[str, Any], tuple[str, Quantity, Value, Value]]] = {
    "reduction": ({}, {"reduction": 30}, ("third", Quantity.REDUCTION, 50.0, 30.0)),
    "reduction that is missing": (
        {"reduction": 2},
        {"reduction": None},
        ("third", Quantity.REDUCTION, 2.0, 1.0),
    ),
    "reduction at the joint": ({}, {"at_joint": 4}, ("third", Quantity.REDUCTION, 1.0, 4.0)),
    "no number": ({}, {"reduction": "fifty"}, ("third", Quantity.REDUCTION, 50.0, "'fifty'")),
    "not finite": ({}, {"reduction": "1e999"}, ("third", Quantity.REDUCTION, 50.0, "'1e999'")),
    "offset": ({}, {"offset": 0.5}, ("third", Quantity.TRANSMISSION_OFFSET, 0.0, 0.5)),
    "interface": (
        {},
        {"interface": "PositionJointInterface"},
        ("third", Quantity.HARDWARE_INTERFACE, "EffortJointInterface", "PositionJointInterface"),
    ),
    "kind": (
        {},
        {"type": "FourBarLinkageTransmission"},
        ("third_trans", Quantity.KIND, "SimpleTransmission", "FourBarLinkageTransmission"),
    ),
    "another joint": (
        {},
        {"joint": "first"},
        ("third_trans", Quantity.TRANSMISSION_JOINTS, "third", "first"),
    ),
}


@pytest.mark.parametrize(("first", "second", "row"), CASES.values(), ids=CASES.keys())
def test_another_transmission_is_one_row_and_the_same_motion(
    first: dict[str, Any],
    second: dict[str, Any],
    row: tuple[str, Quantity, Value, Value],
    tmp_path: Path,
) -> None:
    found = compared(tmp_path, [transmission(**first)], [transmission(**second)])
    assert of_standing(found, Standing.DIFFERENT) == [row]
    assert found.differences[0].effect is None
    assert (found.outcome, found.motion.change) == (Outcome.DIFFERENT, 0.0)


@pytest.mark.parametrize(
    "changed",
    [
        {"name": "t1"},
        {"reduction": "50.0"},
        {"at_joint": 1},
        {"offset": 0},
        {"interface": "hardware_interface/EffortJointInterface"},
    ],
    ids=str,
)
def test_other_words_for_one_transmission_are_no_difference(changed: dict[str, Any], tmp_path: Path) -> None:
    found = compared(tmp_path, [transmission()], [transmission(**changed)])
    assert (found.outcome, found.comparison.rows) == (Outcome.SAME, ())


def test_digits_of_a_reduction_are_rounding(tmp_path: Path) -> None:
    found = compared(tmp_path, [transmission(reduction=50.5)], [transmission(reduction=50.50003)])
    assert found.outcome is Outcome.SAME_TO_ROUNDING
    assert of_standing(found, Standing.ROUNDING) == [("third", Quantity.REDUCTION, 50.5, 50.50003)]


def test_transmissions_of_one_file_are_one_row(tmp_path: Path) -> None:
    found = compared(tmp_path, [], [transmission(), transmission(joint="first", name="first_trans")])
    (row,) = found.differences
    assert (row.element_kind, row.quantity, row.first) == ("transmission", Quantity.PRESENCE, None)
    assert row.elements == ("third_trans", "first_trans")
    assert (found.outcome, found.motion.change) == (Outcome.DIFFERENT, 0.0)


def test_an_mjcf_lacks_no_transmissions(tmp_path: Path) -> None:
    model = file_with(tmp_path / "model.urdf", transmission())
    plain = file_with(tmp_path / "plain.urdf")
    for other in (model, plain):
        found = crosscheck.diff(mujoco.MjModel.from_xml_path(plain), other)
        kinds = {row.element_kind for row in found.differences}
        assert "transmission" not in kinds
        conventions = [row for row in found.comparison.rows if row.element_kind == "transmission"]
        assert len(conventions) == (other == model)
        assert all(row.standing is Standing.CONVENTION for row in conventions)


def test_an_actuator_may_have_another_name_but_not_that_of_another_one(tmp_path: Path) -> None:
    both = [transmission(), transmission(joint="first", name="first_trans", actuator="first_motor")]
    found = compared(tmp_path, both, [both[0].replace("third_motor", "m3"), both[1]])
    assert found.outcome is Outcome.SAME
    assert of_standing(found, Standing.CONVENTION) == [("third", Quantity.ACTUATOR, "third_motor", "m3")]
    exchanged = [
        both[0].replace("third_motor", "first_motor"),
        both[1].replace("first_motor", "third_motor"),
    ]
    found = compared(tmp_path, both, exchanged)
    (row,) = found.differences
    assert (row.quantity, row.elements) == (Quantity.ACTUATOR, ("third", "first"))
    assert found.outcome is Outcome.DIFFERENT


DIFFERENTIAL = """<transmission name="wrist"><type>DifferentialTransmission</type>
<actuator name="{0}" role="actuator1"><mechanicalReduction>{1}</mechanicalReduction></actuator>
<actuator name="right" role="actuator2"><mechanicalReduction>20</mechanicalReduction></actuator>
<joint name="first" role="joint1"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
<joint name="third" role="joint2"><hardwareInterface>EffortJointInterface</hardwareInterface></joint>
</transmission>"""


def read(path: Path, text: str) -> FileTransmission:
    """Return the transmission of a file."""
    (found,) = describe(file_with(path, text)).robot.transmissions
    return found


def test_each_actuator_of_a_differential_has_its_reduction(tmp_path: Path) -> None:
    found = compared(tmp_path, [DIFFERENTIAL.format("left", 10)], [DIFFERENTIAL.format("left", 12)])
    assert of_standing(found, Standing.DIFFERENT) == [("first", Quantity.REDUCTION, 10.0, 12.0)]


def test_roles_tell_ends_apart_whatever_their_order(tmp_path: Path) -> None:
    parts = [f'<{tag} name="{tag}{k}" role="{tag}{k}"/>' for tag in ("joint", "actuator") for k in (2, 1)]
    found = read(tmp_path / "model.urdf", f'<transmission name="t">{"".join(parts)}</transmission>')
    assert [end.name for end in (*found.joints, *found.actuators)] == [
        "joint1", "joint2", "actuator1", "actuator2"
    ]  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        '<ros2_control name="arm"><transmission name="t"><plugin>SimpleTransmission</plugin>'
        '<joint name="third"><mechanical_reduction>50</mechanical_reduction></joint>'
        "</transmission></ros2_control>",
        '<transmission name="t" type="SimpleTransmission">'
        '<joint name="third" mechanicalReduction="50"/></transmission>',
    ],
    ids=["ROS 2", "attribute"],
)
def test_reductions_in_other_dialects(text: str, tmp_path: Path) -> None:
    found = read(tmp_path / "model.urdf", text)
    assert (found.kind, found.joints[0].name) == ("SimpleTransmission", "third")
    assert found.joints[0].reduction == 50.0


def test_a_reduction_of_the_whole_transmission(tmp_path: Path) -> None:
    texts = [
        f'<transmission name="t"><actuator name="m"/><joint name="third"/>'
        f"<mechanicalReduction>{number}</mechanicalReduction></transmission>"
        for number in (50, -30)
    ]
    found = compared(tmp_path, texts[:1], texts[1:])
    assert of_standing(found, Standing.DIFFERENT) == [("third", Quantity.REDUCTION, 50.0, -30.0)]


def test_joints_and_numbers_that_do_not_exist_are_notes(tmp_path: Path) -> None:
    wrong = [transmission(joint="nowhere"), transmission(name="t", reduction="")]
    notes = describe(file_with(tmp_path / "model.urdf", *wrong)).notes
    assert len(notes) == 2
    assert ["'nowhere'" in note for note in notes] == [True, False]
    assert ["mechanicalReduction ''" in note for note in notes] == [False, True]
