"""Baselines of model files hold the error of the run with the settings of the file, which may not grow."""

from __future__ import annotations

import json
from xml.etree import ElementTree

import pytest
from command_line import run

from crosscheck.regress.baseline import OWN_RUN_GROUP, StoredQuantity, read_baseline
from crosscheck.regress.compare import check_group
from crosscheck.regress.measure import ERROR_TOLERANCE_REASON, MAX_ERROR_GROWTH, MIN_ERROR

PENDULUM = """<mujoco model="swing"><option timestep="{step}" integrator="{integrator}"/><worldbody>
  <body name="bar" euler="0 40 0"><joint name="hinge" axis="0 1 0" {more}/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.01" mass="0.4" contype="0"/></body>
  </worldbody></mujoco>"""

NAMES = [
    "relative error",
    "error of position",
    "error of rotation",
    "loop opening",
    "loop angle",
    "error of energy",
]


def write(folder, step, integrator="Euler", more=""):
    path = folder / "swing.xml"
    path.write_text(PENDULUM.format(step=step, integrator=integrator, more=more))
    return path


@pytest.fixture
def guarded(capsys, tmp_path, monkeypatch):
    """The folder of a pendulum at 4 ms and its baseline."""
    monkeypatch.chdir(tmp_path)
    status, _, _ = run(
        capsys, "regress", write(tmp_path, 0.004), "--set", "duration=0.4", "--update", "first"
    )
    assert status == 0
    return tmp_path


def stored(folder):
    found = read_baseline(folder / "swing.baseline.json")
    return {each.name: each for each in found.quantities if each.group == OWN_RUN_GROUP}


def compared(capsys, folder):
    """Exit status and output of a comparison, and its results in JSON."""
    status, out, _ = run(capsys, "regress", "swing.xml", "--output", "out")
    return status, out, json.loads((folder / "out" / "regress.json").read_text())


def test_a_baseline_holds_the_errors_with_tolerance_and_reason(guarded):
    errors = stored(guarded)
    assert list(errors) == NAMES
    for each in errors.values():
        assert each.reason == ERROR_TOLERANCE_REASON
        assert each.is_error
    ((relative,),) = errors["relative error"].value
    assert relative > 1e-4
    assert errors["relative error"].tolerance[0] == pytest.approx(MAX_ERROR_GROWTH * relative, rel=0.01)
    # no loops: the tolerance is a part of the motion
    assert errors["loop opening"].value == [[0.0]]
    assert errors["loop opening"].tolerance[0] < 0.3 * MIN_ERROR
    text = (guarded / "swing.baseline.json").read_text()
    assert text.count('"reason": "2 %') == len(NAMES)
    assert text.count('"reason"') == len(NAMES) + 1  # and that of the update


@pytest.mark.slow
def test_a_longer_step_fails_and_a_shorter_one_is_more_accurate(capsys, guarded):
    assert compared(capsys, guarded)[0] == 0
    # twice the step: twice the error of a method of order 1, and nothing else moves
    write(guarded, 0.008)
    status, out, content = compared(capsys, guarded)
    assert status == 1
    assert "crosscheck run names cause and fix" in out
    (scene,) = content["scenes"]
    moved = {each["quantity"]: each for each in scene["checks"] if each["moved"]}
    assert set(moved) == set(NAMES) - {"loop opening", "loop angle"}
    assert moved["relative error"]["now"] == pytest.approx(2.0 * moved["relative error"]["was"], rel=0.1)
    assert moved["relative error"]["reason"] == ERROR_TOLERANCE_REASON
    failures = ElementTree.parse(guarded / "out" / "junit.xml").findall(".//failure")
    assert len(failures) == len(moved)
    # half the step
    write(guarded, 0.002)
    status, out, content = compared(capsys, guarded)
    assert status == 0
    assert "what is more accurate" in out
    assert out.splitlines()[-1].endswith("; more accurate: swing")
    assert content["more_accurate"] == ["swing"]
    assert "more accurate" in (guarded / "out" / "summary.md").read_text()


@pytest.mark.slow
def test_a_run_that_diverges_fails(capsys, guarded):
    """A stiff spring, which an explicit step of 4 ms does not survive."""
    path = write(guarded, 0.004, more='stiffness="1e6"')
    status, out, content = compared(capsys, guarded)
    assert status == 1
    (scene,) = content["scenes"]
    problems = {each["problem"] for each in scene["checks"] if each["level"] == OWN_RUN_GROUP}
    assert all("the run with the settings of the file diverges: " in problem for problem in problems)
    # and no baseline of its errors can be made
    (guarded / "swing.baseline.json").unlink()
    status, out, _ = run(capsys, "regress", path, "--set", "duration=0.4", "--update", "first")
    assert status == 0
    assert (
        "own_run left out: CrosscheckError: the run with the settings" in out
        or "own_run left out: the" in out
    )
    assert not stored(guarded)


def test_baselines_without_these_errors_are_compared_as_before(capsys, guarded):
    path = guarded / "swing.baseline.json"
    found = read_baseline(path)
    others = [each for each in found.quantities if each.group != OWN_RUN_GROUP]
    path.write_text(found.model_copy(update={"quantities": others}).text())
    write(guarded, 0.008)
    assert compared(capsys, guarded)[0] == 0


@pytest.mark.parametrize(
    ("now", "moved", "better"), [(1.01, False, False), (1.03, True, False), (0.5, False, True)]
)
def test_an_error_fails_only_where_it_grows(now, moved, better):
    def error(value):
        return StoredQuantity(
            group="own_run",
            name="error",
            unit="m",
            rows=[""],
            columns=[""],
            value=[[value]],
            tolerance=[0.02],
        )

    (found,) = check_group([error(1.0)], [error(now)])
    assert (found.moved, found.more_accurate, found.cheaper) == (moved, better, False)


@pytest.mark.slow
def test_a_chaotic_motion_is_compared_until_the_time_in_the_baseline(capsys, guarded):
    path = guarded / "swing.baseline.json"
    found = read_baseline(path)
    assert found.plan.own_run_until == ()
    assert "own_run_until" not in path.read_text()
    plan = found.plan.model_copy(update={"own_run_until": (0.2,)})
    path.write_text(found.model_copy(update={"plan": plan}).text())
    assert read_baseline(path).plan.own_run_until == (0.2,)
    # the error of half the run is smaller
    assert compared(capsys, guarded)[2]["more_accurate"] == ["swing"]
