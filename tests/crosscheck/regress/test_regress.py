"""`crosscheck regress`: what moves is seen, what does not is not, and what it writes can be read."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import run

from crosscheck.compare.check import ERROR_PER_CHANGE
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.library.scene_file import write_scene
from crosscheck.regress import measure
from crosscheck.regress import run as regress
from crosscheck.regress.baseline import StoredQuantity, UpdateRecord, read_baseline
from crosscheck.regress.compare import (
    MODEL_FILE,
    Comparison,
    check_group,
    check_labels,
    check_unsimulated,
    compare,
    divergence_time,
)
from crosscheck.regress.plan import main_run, regress_scene
from crosscheck.regress.quantities import Measurement
from crosscheck.regress.report import quiet_versions, tables
from crosscheck.regress.run import GuardedScene

ROOT = Path(__file__).parents[3]


def quantity(array, tolerance=(1e-9,), name="position"):
    array = np.atleast_2d(np.asarray(array, dtype=float))
    rows, columns = [f"row {k}" for k in range(len(array))], list("xyz"[: array.shape[1]])
    return StoredQuantity.model_construct(
        group="relative", name=name, unit="m", rows=rows, columns=columns, value=array.tolist(),
        tolerance=[*tolerance] * (len(rows) // len(tolerance)),
    )  # fmt: skip


# Tolerances and quantities


def tolerances(monkeypatch, measured, plain, tighter):
    """Return the tolerances of a quantity that has another value with tighter error control."""
    values = {measured.plan.rtol["relative"]: plain, 0.1 * measured.plan.rtol["relative"]: tighter}
    monkeypatch.setitem(measure.GROUPS, "relative", lambda here: [values[here.plan.rtol["relative"]]])
    (found,) = measure.measure_group_with_errors("relative", load("pendulum"), measured.plan)
    return found.tolerance


@pytest.mark.parametrize(
    ("name", "changes", "grown"),
    [
        ("position", [0.0, 2e-9, 1e-9], [2e-9, 2e-9, 2e-9]),
        ("position over time", [0.0, 2e-9, 1e-9], [0.0, 2e-9, 2e-9]),
    ],
)
def test_a_tolerance_is_that_of_the_level_and_the_own_error(monkeypatch, measured, name, changes, grown):
    """The largest of all rows; over time it grows and never shrinks."""
    plain, tighter = (quantity([[x] for x in values], name=name) for values in ([0.0] * 3, changes))
    wanted = [1e-9 + ERROR_PER_CHANGE * each for each in grown]
    assert tolerances(monkeypatch, measured, plain, tighter) == pytest.approx(wanted, rel=1e-12)


def test_a_group_with_a_quantity_that_is_not_finite_is_left_out(monkeypatch, measured):
    wrong = quantity([[float("nan")]])
    monkeypatch.setitem(measure.GROUPS, "relative", lambda here: [wrong])
    found = measure.measure_group_with_errors("relative", load("pendulum"), measured.plan)
    assert found == "position is not finite"


def test_a_count_may_grow_by_two_percent(swing, measured):
    count = Measurement("relative", swing, measured.plan).count("steps", 101)
    assert count.tolerance == [3.0]  # 2 % rounded up


@pytest.mark.parametrize("moved", [0.9, -0.9, 1.1, -1.1])
def test_a_quantity_moves_where_it_leaves_its_tolerance(moved):
    stored = quantity([[1.0, 2.0], [3.0, 4.0]], [1e-6, 1e-9])
    (found,) = check_group([stored], [quantity([[1.0, 2.0], [3.0, 4.0 + moved * 1e-9]])])
    assert found.moved == (abs(moved) > 1.0)
    assert found.where == "row 1, y"
    assert found.tolerance_ratio == pytest.approx(abs(moved), rel=1e-5)  # 4 has 4e-16 of round-off


@pytest.mark.parametrize("now", [float("nan"), float("inf")])
def test_what_is_not_finite_has_moved(now):
    (found,) = check_group([quantity([[1.0]], [1e300])], [quantity([[now]])])
    assert found.moved


def test_what_is_not_measured_any_more_has_moved():
    stored = quantity([[1.0]], [1.0])
    for measured, problem in (
        ("SingularityError: no", "SingularityError: no"),
        ([quantity([[1.0]], name="other")], "no longer measured"),
        ([quantity([[1.0], [2.0]])], "has other coordinates or components than the baseline"),
    ):
        (found,) = check_group([stored], measured)
        assert (found.moved, found.problem) == (True, problem)


def masses(*bodies):
    return StoredQuantity(
        group="model",
        name="mass",
        unit="kg",
        rows=list(bodies),
        columns=[""],
        value=[[1.0 + len(body)] for body in bodies],
        tolerance=[1e-9] * len(bodies),
    )


def test_a_renamed_body_is_one_failed_check_that_names_it():
    stored, now = masses("crank", "rod"), masses("crank", "coupler")
    ((named, labels),) = check_labels([stored], [now])
    assert (named.quantity, named.moved) == ("bodies", True)
    assert "rod" in named.problem
    assert "coupler" in named.problem
    (found,) = check_group([stored], [now], labels)
    assert not found.moved  # the crank is the same
    heavier = now.model_copy(update={"value": [[7.0], [8.0]]})
    (found,) = check_group([stored], [heavier], labels)
    assert (found.moved, found.where, found.now) == (True, "crank", 7.0)


def test_poses_are_compared_at_bodies_that_both_have():
    stored = quantity([[1.0, 2.0, 3.0]]).model_copy(update={"columns": ["rod x", "crank x", "crank y"]})
    now = quantity([[2.0, 4.0]]).model_copy(update={"columns": ["crank x", "crank y"]})
    (found,) = check_group([stored], [now], {"rod"})
    assert (found.where, found.was, found.now) == ("row 0, crank y", 3.0, 4.0)
    assert check_group([stored], [now])[0].problem


def test_equal_problems_of_a_group_share_a_row():
    problems = [
        replace(check_group([quantity([[1.0]], name=name)], "no")[0], level=level)
        for name, level in (("a", "relative"), ("b", "relative"), ("c", "mujoco"))
    ]
    made = UpdateRecord(date="2026-01-01", reason="first", versions={})
    (table,) = tables([Comparison("s", tuple(problems), made, {}, None, 0.0)])
    assert [row[0] for row in table.rows] == ["joint coordinates: 2 quantities", "mujoco: c, m"]


def test_divergence_is_at_the_first_time_out_of_a_tolerance():
    name, times = "position over time", np.array([0.0, 0.5, 1.0])
    stored = quantity([[0.0], [0.0], [0.0]], name=name)
    assert divergence_time([stored], [quantity([[0.0], [1e-8], [1.0]], name=name)], times) == 0.5
    assert divergence_time([stored], [quantity([[0.0], [1e-10], [0.0]], name=name)], times) is None


# Costs: operations, steps and evaluations may fall, and may not grow


COST_NAMES = ["operations of derivative", "DOP853, rtol 1e-06: steps", "DOP853, rtol 1e-06: evaluations"]


@pytest.mark.parametrize("name", COST_NAMES)
@pytest.mark.parametrize(
    ("now", "moved", "cheaper"),
    [
        (100.0, False, False),
        (98.0, False, False),
        (97.0, False, True),
        (1.0, False, True),
        (102.0, False, False),
        (103.0, True, False),
        (float("nan"), True, False),
        (float("-inf"), True, False),
    ],
)
def test_a_cost_fails_only_where_it_grows(name, now, moved, cheaper):
    (found,) = check_group([quantity([[100.0]], [2.0], name)], [quantity([[now]], name=name)])
    assert (found.moved, found.cheaper) == (moved, cheaper)


def test_a_length_that_falls_has_moved():
    (found,) = check_group([quantity([[100.0]], [2.0])], [quantity([[97.0]])])
    assert (found.moved, found.cheaper) == (True, False)


def test_every_count_of_a_baseline_is_a_cost(measured):
    costs = {(each.group, each.name) for each in measured.quantities if each.is_cost}
    for group, compiled in (
        ("relative", ("derivative", "output")),
        ("cartesian", ("derivative", "output", "position", "velocity")),
    ):
        counted = {f"operations of {name}" for name in compiled} | set(COST_NAMES[1:])
        assert {name for owner, name in costs if owner == group} == counted
    assert all(
        float(value).is_integer() for each in measured.quantities if each.is_cost for (value,) in each.value
    )


def test_what_is_cheaper_is_reported_in_every_format(capsys, tmp_path, guarded, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = Path(shutil.copy(guarded / "mine.yaml", tmp_path))
    assert run(capsys, "regress", model, "--update", "first")[0] == 0
    stored = Path("mine.baseline.json")
    baseline = read_baseline(stored)
    name = "operations of derivative"
    dearer, cost = baseline.model_copy(deep=True), baseline.find("relative", name).value[0][0]
    dearer.find("relative", name).value[0][0] = 2.0 * cost
    stored.write_text(dearer.text())

    status, out, _ = run(capsys, "regress", model, "--output", "out")
    assert status == 0
    assert f"joint coordinates: {name}" in out
    content = json.loads(Path("out/regress.json").read_text())
    assert (content["quiet"], content["cheaper"]) == (True, ["mine"])
    (scene,) = content["scenes"]
    (entry,) = [each for each in scene["checks"] if each["cheaper"]]
    assert (entry["quantity"], entry["moved"], entry["was"], entry["now"]) == (name, False, 2.0 * cost, cost)
    assert f"joint coordinates: {name}" in Path("out/summary.md").read_text()
    suite = ElementTree.parse("out/junit.xml").getroot().find("testsuite")
    assert suite.get("failures") == "0"
    (output,) = suite.findall("testcase/system-out")
    assert name in output.text
    assert list(tmp_path.glob("out/*.rrd")) == []

    assert "Store the improvement" in json.dumps(content["report"])

    # dearer and cheaper at once: the failing check decides about the baseline
    both = baseline.model_copy(deep=True)
    both.find("relative", name).value[0][0] = 0.5 * cost
    both.find("cartesian", name).value[0][0] *= 2.0
    stored.write_text(both.text())
    status, out, _ = run(capsys, "regress", model, "--output", "out")
    assert status == 1
    assert "If the change is intended" in out
    assert "Store the improvement" not in out


# A scene against its baseline


@pytest.fixture(scope="module")
def swing():
    return replace(load("pendulum"), duration=1.0)


@pytest.fixture(scope="module")
def measured(swing):
    """The baseline of a second of the pendulum."""
    return regress.make_baseline(
        GuardedScene("pendulum", {}, swing, Path("none.json")), "first", lambda _: None
    )


def test_every_group_measures_the_pendulum_as_mechanics_has_it(swing, measured):
    assert measured.left_out == {}
    assert measured.groups == measure.groups_with(ENGINES)[:-1]  # without OWN_RUN_GROUP
    assert measured.plan.rtol == {"relative": 1e-12, "cartesian": 1e-12, "Radau": 1e-10}
    # at rest and released a pendulum falls along its circle: g times the sine, so less than g
    start = measured.find("relative", "start: linear acceleration").array
    assert 0.0 < np.linalg.norm(start) <= np.linalg.norm(swing.gravity)
    for engine in ("cartesian", "mujoco", "pinocchio"):
        names = engine, "relative"
        other, mine = (measured.find(name, "moving: linear acceleration").array for name in names)
        assert other == pytest.approx(mine, abs=1e-11)  # round-off of 10 m/s^2, four sets of equations
    assert np.any(np.abs(measured.plan.state.state().linear_velocity) > 0.1)


def test_a_millionth_of_gravity_is_seen_in_every_engine(swing, measured):
    heavier = replace(swing, gravity=swing.gravity * (1.0 + 1e-6))
    found = compare(heavier, measured, lambda _: None)
    assert {check.level for check in found.moved} == set(measured.groups)
    assert found.diverges is not None
    assert 0.0 < found.diverges <= swing.duration
    assert "MOVED" in found.verdict


def test_versions_that_changed_are_named():
    made = UpdateRecord(date="2026-01-01", reason="first", versions={"python": "3.11.0", "numpy": "2.0.0"})
    found = Comparison("s", (), made, {"python": "3.11.0", "numpy": "2.1.0", "pin": "4.1"}, None, 0.0)
    assert found.changed_versions == {"numpy": ("2.0.0", "2.1.0"), "pin": ("none", "4.1")}
    assert quiet_versions([found]).endswith(": numpy 2.0.0 -> 2.1.0, pin none -> 4.1")
    # baselines of several scenes: each package once
    older = replace(
        found, last_update=made.model_copy(update={"versions": {"python": "3.11.0", "numpy": "1.9.0"}})
    )
    assert quiet_versions([found, older]).endswith(": numpy several -> 2.1.0, pin none -> 4.1")
    assert quiet_versions([]) == ""


# The command


@pytest.fixture(scope="module")
def guarded(tmp_path_factory):
    """A folder with a scene file of a user's own: a pendulum of half a second."""
    folder = tmp_path_factory.mktemp("guarded")
    scene = replace(load("pendulum"), name="mine", duration=0.5, output_period=0.1)
    write_scene(scene, folder / "mine.yaml")
    return folder


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("mine.yaml", "--update"), "'--update' requires an argument"),
        (("mine.yaml", "--update", "  "), "--update: the reason is empty"),
        (("--baseline", "b.json"), "of one SCENE"),
        (("four_bar", "--set", "N=3"), "--set needs --baseline"),
        (("tracker", "tracker"), "both named 'tracker'"),
        (("nothing",), "unknown scene 'nothing'"),
    ],
)
def test_options_that_do_not_fit(capsys, monkeypatch, guarded, arguments, message):
    monkeypatch.chdir(guarded)
    status, out, err = run(capsys, "regress", *arguments)
    assert (status, out) == (2, "")
    assert message in err
    assert [path.name for path in guarded.iterdir()] == ["mine.yaml"]


def test_a_user_guards_a_model(capsys, guarded, monkeypatch):
    monkeypatch.chdir(guarded)
    model, stored, folder = Path("mine.yaml"), Path("mine.baseline.json"), Path("output/regress/mine")
    for reason in ("first", "again"):
        status, out, _ = run(capsys, "regress", model, "--update", reason)
        assert status == 0
        assert str(stored) in out
    assert [record["reason"] for record in json.loads(stored.read_text())["history"]] == ["first", "again"]

    status, out, _ = run(capsys, "regress", model, "-v")
    assert status == 0
    assert "QUIET" in out
    assert "quaternion over time" in out  # as every quantity
    assert {path.name for path in folder.iterdir()} == set(regress.REPORTS)
    assert json.loads((folder / "regress.json").read_text())["quiet"]
    assert ElementTree.parse(folder / "junit.xml").getroot().find("testsuite").get("failures") == "0"

    heavier = model.read_text().replace("-9.81", "-9.810001")
    assert heavier != model.read_text()
    model.write_text(heavier)
    status, out, _ = run(capsys, "regress", model)
    assert status == 1
    assert "mine: MOVED" in out
    assert "(again)" in out
    assert (folder / "mine.rrd").read_bytes()[:4] == b"RRF2"
    assert "recording: output/regress/mine/mine.rrd" in out
    content = json.loads((folder / "regress.json").read_text())
    (scene,) = content["scenes"]
    assert (content["quiet"], scene["recording"]) == (False, "output/regress/mine/mine.rrd")
    suite = ElementTree.parse(folder / "junit.xml").getroot().find("testsuite")
    moved = sum(each["moved"] for each in scene["checks"])
    assert int(suite.get("failures")) == len(suite.findall("testcase/failure")) == moved > 10
    assert int(suite.get("tests")) == len(suite.findall("testcase")) == len(scene["checks"])
    summary = (folder / "summary.md").read_text()
    assert summary.startswith("# crosscheck regress\n\n**MOVED: 1 of 1 scenes: mine**")


def test_a_recording_holds_both_runs(swing, measured):
    heavier = replace(swing, gravity=swing.gravity * 1.01)
    now, before = regress.both_runs(heavier, measured).values()
    # the baseline's own scene gives the baseline's poses, to what its tolerance says
    swing_now = main_run(regress_scene(swing), 1e-12)
    assert before.position == pytest.approx(swing_now.position, abs=1e-11)
    assert np.max(np.abs(now.position - before.position)) > 1e-3  # 1 % more gravity, for a second
    assert regress.both_runs(load("four_bar"), measured) == {}  # of other bodies


# What a model file holds and no quantity is about


@pytest.mark.parametrize(
    ("found", "moved"),
    [
        (["a", "b"], []),
        (["b", "a"], []),
        (["a"], [("b", "no longer so")]),
        (["a", "b", "b"], [("b", "new")]),
    ],
)
def test_what_is_in_no_quantity_moves_where_its_line_does(found, moved):
    checked = check_unsimulated(["a", "b"], found)
    assert {each.level for each in checked} == {MODEL_FILE}
    assert [(each.quantity, each.problem) for each in checked if each.moved] == moved


def test_a_model_file_is_guarded_with_what_is_in_no_quantity(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = """<mujoco><worldbody><geom type="plane" size="1 1 1"/><body name="leg" pos="0 0 1">
        <joint name="hip" axis="0 1 0" limited="true" range="-60 50"/>
        <geom name="foot" size="0.1" pos="0 0 -0.5"/></body></worldbody></mujoco>"""
    model, stored = Path("model.xml"), Path("model.baseline.json")
    model.write_text(text)
    assert run(capsys, "regress", model, "--update", "first")[0] == 0
    content = json.loads(stored.read_text())
    limits = "joint 'hip': left out: its limits -1.047 to 0.8727: limits are one-sided and not simulated"
    assert limits in content["unsimulated"]
    assert any(line.startswith("2 geoms that can touch") for line in content["unsimulated"])

    # start velocities follow the larger room, which stays the same
    model.write_text(text.replace('"-60 50"', '"-60 30"'))
    status, out, _ = run(capsys, "regress", model, "--output", "out")
    assert status == 1
    assert "MOVED: 1 of 1 scenes: model" in out
    suite = ElementTree.parse("out/junit.xml").getroot().find("testsuite")
    told = [failure.get("message") for failure in suite.findall("testcase/failure")]
    new = limits.replace("to 0.8727", "to 0.5236")
    assert told == [f"model file: {limits}: where no longer so", f"model file: {new}: where new"]
    assert "model file: joint 'hip'" in out
