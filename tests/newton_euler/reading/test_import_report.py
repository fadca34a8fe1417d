"""Import reports: how much of a model file a scene does not hold."""

from __future__ import annotations

import json
from pathlib import Path

from command_line import run

from crosscheck.compare.outcome import ExitStatus, Outcome
from newton_euler.reading.import_report import ImportReport


def test_elements_that_move_something_are_counted_once() -> None:
    report = ImportReport()
    report.imported("body 'a'", "a body")
    report.left_out("2 cameras", "they move nothing", moves_nothing=True)
    assert report.counts() == ""
    report.left_out("joint 'a'", "its limits", topic="limits")
    report.left_out("joint 'a'", "its dry friction", topic="dry friction")
    assert report.counts() == "1 element is left out (joint 'a': limits, dry friction)"
    report.left_out("joint 'b'", "its limits", topic="limits")
    assert report.counts() == "2 elements are left out"


def test_what_acts_wherever_a_model_is_is_named_where_it_is_left_out() -> None:
    report = ImportReport()
    report.left_out("actuator 'a'", "its limit of the force", topic="limit of the force")
    assert report.counts() == "1 element is left out (actuator 'a': limit of the force)"
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
    assert status == ExitStatus.REDUCED
    (verdict,) = (line for line in text.splitlines() if line.startswith(Outcome.AGREE_ON_A_REDUCED_MODEL))
    assert verdict.endswith(
        "; motion covers 7 of 7 elements; of the file, 1 element is left out (joint 'a': dry friction)"
    )
    assert json.loads((out / "summary.json").read_text())["verdict"] == verdict


def test_unsimulated_elements_are_those_that_can_act() -> None:
    report = ImportReport()
    report.imported("joint 'a'", "a hinge")
    report.left_out("2 cameras", "they move nothing", moves_nothing=True)
    report.left_out("equality 'open'", "inactive", switched_off=True)
    report.left_out("joint 'a'", "its limits", topic="limits")
    report.not_understood("<muscle>", "no rule knows it")
    assert [entry.element for entry in report.unsimulated()] == ["joint 'a'", "<muscle>"]
    assert [entry.element for entry in report.entries if entry.is_off] == ["equality 'open'"]
    assert "1 not understood" in report.counts()
    assert "1 switched off" in report.counts()
