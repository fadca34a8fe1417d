"""Rows of the table of files' own runs, and the script that repeats these runs with MuJoCo alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from own_runs import judged_run

from crosscheck.loading.load import load_scene, with_excitation
from crosscheck.own_run.judge import Judgement
from crosscheck.studies.own_run_table import own_run_result, own_run_table

SCRIPT = Path(__file__).parents[3] / "docs" / "results" / "own_runs" / "engine_alone.py"

ARM_ON_A_LOOP = """<mujoco><option timestep="0.004"/><worldbody>
  <body name="crank"><joint name="a" axis="0 1 0" frictionloss="0.1" range="-5 5"/>
    <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01" mass="0.3"/>
    <body name="coupler" pos="0.1 0 0"><joint name="b" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0.1" size="0.01" mass="0.5"/></body></body>
  <body name="rocker" pos="0.35 0 -0.1"><joint name="c" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.01" mass="0.4"/></body></worldbody>
  <equality><connect body1="coupler" body2="rocker" anchor="0.25 0 0.1"/></equality>
  <actuator><motor joint="a" gear="2" ctrlrange="-1 1"/></actuator></mujoco>"""

STIFF_SERVO = """<mujoco><option timestep="0.002"/><worldbody><body><joint name="a" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0.1 0 0" size="0.01" mass="0.1"/></body></worldbody>
  <actuator><position joint="a" kp="20000"/></actuator></mujoco>"""


def judged(folder: Path, text: str) -> tuple[Judgement, Path, Path]:
    """Judge the run of a model; return the judgement, the model file and the summary."""
    path, summary = folder / "model.xml", folder / "summary.json"
    path.write_text(text)
    judgement = judged_run(*load_scene(str(path), with_excitation(str(path), {})))
    summary.write_text(json.dumps({"own_run": judgement.summary()}))
    return judgement, path, summary


@pytest.mark.slow
def test_mujoco_alone_repeats_the_errors(tmp_path: Path) -> None:
    judgement, path, summary = judged(tmp_path, ARM_ON_A_LOOP)
    assert judgement.events, "dry friction acts and is left out"
    assert any(judgement.run_inputs["ctrl"]["sine"]), "the motor is driven"
    assert judgement.without is not None
    assert judgement.without.remedies
    row = own_run_result(path, summary, SCRIPT)
    assert row is not None
    assert row.repeats
    assert row.word == "WRONG"
    assert row.without.startswith("dry friction of joint 'a'")
    assert len(row.repeated.split("; ")) == 1 + len(judgement.without.remedies)


@pytest.mark.slow
def test_other_numbers_are_not_repeated(tmp_path: Path) -> None:
    judgement, path, summary = judged(tmp_path, ARM_ON_A_LOOP)
    content = judgement.summary()
    for name in ("position", "rotation", "largest_position", "largest_rotation"):
        content["without"]["error"][name] *= 1.2
    summary.write_text(json.dumps({"own_run": content}))
    row = own_run_result(path, summary, SCRIPT)
    assert row is not None
    assert not row.repeats
    path.unlink()
    row = own_run_result(path, summary, SCRIPT)
    assert row is not None
    assert row.repeated == ""


@pytest.mark.slow
def test_a_run_that_diverges(tmp_path: Path) -> None:
    judgement, path, summary = judged(tmp_path, STIFF_SERVO)
    assert judgement.stopped
    row = own_run_result(path, summary, SCRIPT)
    assert row is not None
    assert (row.word, row.repeats) == ("DIVERGED", True)
    assert row.repeated.startswith("diverges; ")
    assert "kp of actuator" in row.cause


def test_a_run_that_was_not_judged(tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    summary.write_text('{"own_run": null}')
    assert own_run_result(tmp_path / "model.xml", summary, SCRIPT) is None


@pytest.mark.slow
def test_all_models_are_listed(tmp_path: Path) -> None:
    _, path, summary = judged(tmp_path, ARM_ON_A_LOOP)
    row = own_run_result(path, summary, SCRIPT)
    assert row is not None
    rows = [("some/robots 1234567", "arm.xml", row), ("some/robots 1234567", "broken.xml", "refused: no XML")]
    lines = list(own_run_table(rows))
    assert lines[:2] == ["1 models are judged: 1 WRONG.", "The engine alone repeats the errors of 1 of them."]
    assert sum(line.startswith("| **some/robots 1234567** |") for line in lines) == 2
    assert any(line.startswith("| arm.xml | WRONG | ") and f"| {row.settings} |" in line for line in lines)
    assert lines[-2] == "| some/robots 1234567: broken.xml | refused: no XML |"
