"""Mapping reports: what of a model file a scene does not hold, in numbers, and how much of it there is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run

from newton_euler.verification.import_report import CLOSE, TINY, ImportReport, differing, value


@pytest.mark.parametrize(
    ("one", "two", "same"),
    [
        ((1.0, 2e3), (1.0 + 0.9 * CLOSE * 2e3, 2e3), True),
        ((1.0, 2e3), (1.0 + 1.1 * CLOSE * 2e3, 2e3), False),
        ((0.0,), (0.9 * TINY,), True),
        ((0.0,), (1.1 * TINY,), False),
        ((1.0,), (1.0, 0.0), False),
        (("box", 1.0), ("box", 1.0), True),
        (("box", 1.0), ("sphere", 1.0), False),
        (("1",), (1.0,), False),
    ],
)
def test_values_are_the_same_to_round_off(one, two, same) -> None:
    found = list(differing({"size": one, "pos": (1.0,)}, {"size": two, "pos": (1.0,)}))
    assert found == ([] if same else ["size"])


def test_values_that_only_one_has_differ() -> None:
    assert list(differing({"a": (1.0,)}, {"b": (1.0,)})) == ["a", "b"]


def test_values_are_what_json_can_hold() -> None:
    assert value([[1, 2], [3, float("inf")]]) == (1.0, 2.0, 3.0, "inf")
    assert json.loads(json.dumps(value(float("nan")), allow_nan=False)) == ["nan"]


def test_elements_that_move_something_are_counted_once() -> None:
    report = ImportReport()
    report.exactly("body 'a'", "a body")
    report.left_out("2 cameras", "they move nothing", inert=True)
    assert report.counts() == ""
    report.left_out("joint 'a'", "its limits", topic="limits")
    report.left_out("joint 'a'", "its dry friction", topic="dry friction")
    assert report.counts() == "1 element is left out"
    report.left_out("joint 'b'", "its limits", topic="limits")
    assert report.counts() == "2 elements are left out"
    report.approximated("equality 'e'", "by its slope")
    assert report.counts() == "1 element is approximated, 2 left out"


def test_what_acts_wherever_a_model_is_is_named_where_it_is_left_out() -> None:
    report = ImportReport()
    report.left_out("actuator 'a'", "its limit of the force", topic="limit of the force")
    assert report.counts() == "1 element is left out"
    for element in ("actuator 'b'", "actuator 'c'", "equality 'd'"):
        report.left_out(element, "it has dynamics")
    assert report.counts() == "4 elements are left out (1 equality, 2 actuators)"


def test_the_verdict_tells_how_much_of_the_file_is_not_in_it(capsys, tmp_path: Path) -> None:
    model = """<mujoco><compiler angle="radian"/><worldbody>
        <body name="l"><joint name="a" axis="0 1 0" limited="true" range="-1 1" frictionloss="0.1"/>
        <geom size="0.1" pos="0 0 0.2" contype="0" conaffinity="0"/></body>
        <body name="r"><joint name="d" axis="0 1 0"/>
        <geom size="0.1" pos="1 0 1" contype="0" conaffinity="0"/></body></worldbody>
        <equality><joint joint1="a" joint2="d" polycoef="0 1 0.3 0 0"/></equality>
        <sensor><clock/></sensor></mujoco>"""
    (tmp_path / "model.xml").write_text(model)
    out = tmp_path / "out"
    status, text, _ = run(
        capsys, "run", tmp_path / "model.xml", "--set", "duration=0.1", "--engines", "newton_euler,mujoco",
        "--output", out,
    )  # fmt: skip
    assert status == 0
    *_, verdict = text.splitlines()
    assert verdict.startswith("AGREE: newton_euler, mujoco agree on ")
    assert verdict.endswith(
        "; motion covers 7 of 7 elements; of the file 1 element is approximated, 1 left out"
    )
    assert json.loads((out / "summary.json").read_text())["verdict"] == verdict
