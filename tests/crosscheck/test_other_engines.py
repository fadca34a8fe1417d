"""Engines besides the default ones in every command: a toy, whose functions are those of newton_euler."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import pytest
from command_line import run
from mechanisms import mass_on_rail

from crosscheck import importers
from crosscheck.compare.outcome import Outcome
from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.engine import no_systems
from crosscheck.engines.limits import CannotExpressError, Limit
from crosscheck.engines.palette import LOOKS, line_of, palette
from crosscheck.engines.registry import ENGINES, SOLVER, choose
from crosscheck.library import load
from crosscheck.library.scene_file import write_scene
from crosscheck.pytest_plugin import CheckedModel
from crosscheck.regress import measure
from crosscheck.regress.baseline import read_baseline
from crosscheck.regress.compare import compare
from crosscheck.regress.report import junit, report
from crosscheck.regress.run import GuardedScene, engines_of, update_baselines
from crosscheck.studies.benchmark import run as benchmarks
from crosscheck.studies.benchmark.run import BenchmarkRequest
from crosscheck.studies.faults.find import FaultFree
from crosscheck.studies.stress import cases, topics
from crosscheck.studies.stress.cases import CaseResult
from crosscheck.studies.stress.topics import TOPICS, cases_of
from crosscheck.support.colors import OTHER_COLORS
from crosscheck.support.errors import CrosscheckError
from crosscheck.verdict import check
from newton_euler.model.control import PD

TOY = replace(SOLVER, name="toy", package="click", line=(":", 3.0))
OWN_COLOR = replace(TOY, name="colored", color="#123456")


def test_colors_and_lines_of_an_engine_do_not_depend_on_those_beside_it(with_engines):
    with_engines(TOY)
    alone = palette(["toy"])
    with_engines(OWN_COLOR, replace(TOY, name="a_toy"), TOY)
    beside = palette(["other", "colored", "mujoco", "toy"])
    assert alone["toy"] == beside["toy"] == "#881122"  # in all installations
    assert beside["colored"] == "#123456"
    assert beside["mujoco"] == LOOKS["mujoco"].color
    assert beside["other"] == OTHER_COLORS[0]
    assert line_of("toy") == (":", 3.0)
    assert line_of("baseline") is None


def test_runs_of_engines_of_an_earlier_result_are_removed(with_engines, capsys, tmp_path):
    with_engines(TOY)
    arguments = ("run", "pendulum", "--output", tmp_path, "--engines")
    run(capsys, *arguments, "toy,newton_euler")
    assert "click" in json.loads((tmp_path / "summary.json").read_text())["versions"]
    assert (tmp_path / "toy.npz").exists()
    with_engines()  # no longer installed
    run(capsys, *arguments, "newton_euler")
    assert [path.name for path in tmp_path.glob("*.npz")] == ["newton_euler.npz"]
    assert "click" not in json.loads((tmp_path / "summary.json").read_text())["versions"]


# Stress tests


def no_loops(scene):
    """The limits of an engine for chains alone."""
    joints, bodies = scene.mechanism.joint_names, scene.mechanism.body_names
    return [Limit(f"joint {joints[-1]!r}", "no loops")] if len(joints) >= len(bodies) else []


def broken(*_):
    raise RuntimeError("no license")


@pytest.mark.slow
def test_stress_tests_of_an_engine_that_cannot_express_all(with_engines, capsys, monkeypatch, tmp_path):
    unusable = replace(TOY, name="unusable", stress_settings=broken)
    toy = replace(TOY, limits=no_loops, stress_settings=None)  # by its default run alone
    with_engines(toy, unusable)
    monkeypatch.setattr(cases, "run_in_processes", lambda run, tasks, *_, **options: map(run, tasks))
    arguments = ("stress", "--ci", "--only", "dh", "--output", tmp_path)
    status, out, _ = run(capsys, *arguments, "--engines", "toy,unusable")
    assert status == 0
    assert re.search("^unusable: .*no license$", out, re.MULTILINE)
    rows = json.loads((tmp_path / "stress.json").read_text())["rows"]
    assert {row["engine"] for row in rows} == {"toy"}
    loops = [row for row in rows if row["name"].startswith("four_bar")]
    assert {(row["verdict"], row["passes"]) for row in loops} == {("not expressed", None)}
    others = [row for row in rows if row not in loops]
    assert all(row["passes"] for row in others)
    assert any("not expressed" in row["reason"] for row in others)  # a part of the random mechanisms
    expected = {"(d) mass": f"{len(others) - 2} of {len(others) - 2}", "(h) random": "2 of 2"}
    passed = json.loads((tmp_path / "stress.json").read_text())["passed"]
    assert {title[:8]: counts["toy"] for title, counts in passed.items()} == {
        title[:8]: counts for title, counts in expected.items()
    }
    assert f"{len(others)} of {len(others)} cases pass; {len(loops)} not expressed" in out


@pytest.mark.parametrize(
    ("letters", "limits", "reason"),
    [
        ("b", TOY.limits, "toy ran in topic b: the Engine has no settings"),
        ("ab", TOY.limits, "toy ran in topics a, b"),
        ("d", lambda scene: [Limit("gravity", "no gravity")], "toy cannot express gravity"),
    ],
)
def test_a_stress_test_without_any_case_is_no_success(
    with_engines, capsys, monkeypatch, tmp_path, letters, limits, reason
):
    with_engines(replace(TOY, limits=limits, stress_settings=None))
    monkeypatch.setattr(cases, "run_in_processes", lambda run, tasks, *_, **options: map(run, tasks))
    arguments = ("stress", "--ci", "--only", letters, "--output", tmp_path)
    status, out, err = run(capsys, *arguments, "--engines", "toy")
    assert (status, out) == (2, "")
    assert reason in err
    assert len(err.splitlines()) == 1
    assert not [*tmp_path.iterdir()]


def test_an_engine_without_cases_beside_others_is_named(with_engines, capsys, monkeypatch, tmp_path):
    with_engines(replace(TOY, stress_settings=None))
    monkeypatch.setattr(
        topics, "run_cases", lambda found, _: [CaseResult(each, "survives", "") for each in found]
    )
    arguments = ("stress", "--ci", "--only", "bg", "--output", tmp_path)
    status, out, _ = run(capsys, *arguments, "--engines", "mujoco,toy")
    assert status == 0
    assert "\ntoy has no cases in topic b\n" in out
    assert "mujoco has no cases" not in out


def test_every_topic_has_cases_of_an_engine_with_no_settings(with_engines):
    bare = replace(TOY, stress_settings=None, systems=no_systems)
    with_engines(bare)
    for letter in set(TOPICS) - {"a", "b"}:  # settings of long runs, and of steps to search
        for full in (True, False):
            found = cases_of(letter, full, [bare])
            assert {case.setting.engine for case in found} - {"all"} == {"toy"}
    result = cases.run_case(next(iter(cases_of("h", False, [bare]))))
    assert result.verdict == "not expressed"
    result = cases.run_case(next(iter(cases_of("g", False, [bare]))))
    assert result.passes


# Other commands


def refusing(scene):
    return [Limit("joint 'pivot'", "no hinges")]


OLD = replace(TOY, name="old", min_version="9999")
LIMITED = replace(TOY, name="limited", limits=refusing)
FAULTY = replace(TOY, name="faulty", limits=lambda scene: [], systems=broken, simulate=broken)
BARE = replace(TOY, name="bare", benchmarks=Benchmarks)


def test_list_has_a_line_of_each_engine(with_engines, capsys):
    with_engines(TOY, OLD)
    lines = run(capsys, "list")[1].split("engines:\n")[1].splitlines()
    assert [line.split(":")[0].strip() for line in lines] == [*ENGINES, "old", "toy"]
    assert lines[-1] == f"    toy: click {version('click')}"
    assert "cannot be used: package click has version" in lines[-2]


def test_controllers_leave_out_an_engine_that_cannot_run(with_engines, capsys, tmp_path):
    with_engines(TOY, OLD, LIMITED, FAULTY)
    scene = mass_on_rail(duration=0.1, control=(PD("rail", 100.0, 20.0, 0.1),))
    write_scene(scene, tmp_path / "rail.yaml")
    arguments = ("controllers", tmp_path / "rail.yaml", "--output", tmp_path, "--engines")
    status, out, err = run(capsys, *arguments, "all")
    assert (status, err) == (3, "")
    content = json.loads((tmp_path / "controllers.json").read_text())
    assert [row["engine"] for row in content["runs"]] == [*ENGINES, "toy"]
    reasons = ("faulty: internal error", "no hinges", "click>=9999")
    for reason, line in zip(reasons, content["missing"], strict=True):
        assert reason in line
    assert "no hinges" in out
    status, out, err = run(capsys, *arguments, "limited")
    assert (status, out) == (2, "")
    assert "no hinges" in err


def test_benchmarks_leave_out_an_engine_that_cannot_run(with_engines, tmp_path):
    with_engines(TOY, OLD, LIMITED, BARE)
    old = next(engine for engine in choose(["all"]) if engine.name == "old")
    engines = [TOY, LIMITED, BARE, old]
    wanted = BenchmarkRequest(load("pendulum"), "pendulum", {}, engines, 1e-6)
    usable, reasons = benchmarks._of_usable_engines(wanted)
    assert usable.engines == [TOY]
    assert set(reasons) == {"limited", "bare", "old"}
    with pytest.raises(CannotExpressError):
        benchmarks._of_usable_engines(wanted._replace(engines=[LIMITED]))


def test_faults_leave_out_an_engine_that_cannot_run(with_engines):
    bare = replace(TOY, name="bare", systems=no_systems)
    with_engines(LIMITED, FAULTY, bare)
    found = FaultFree(load("pendulum"), [SOLVER, TOY, LIMITED, FAULTY, bare])
    assert set(found.engines) == {"newton_euler", "toy"}
    assert set(found.refusals) == {"limited", "faulty", "bare"}
    assert str(found.refusals["bare"]) == "fault injection needs equations of motion; bare has none"


@pytest.mark.slow
def test_importers_of_other_packages_take_part(monkeypatch, tmp_path):
    """The importer runs in a process of its own, which finds the package by itself."""
    (tmp_path / "toy_package.py").write_text(
        "from dataclasses import replace\n"
        "from crosscheck.engines.registry import ENGINES\n"
        "ENGINE = replace(ENGINES['mujoco'], name='toy', label='Toy 1/2')\n"
    )
    info = tmp_path / "toy_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: toy-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[crosscheck.engines]\ntoy = toy_package:ENGINE\n")
    monkeypatch.syspath_prepend(tmp_path)
    found = importers(Path(__file__).parents[2] / "examples" / "linkage.xml")
    assert found["Toy 1/2"].result is found["MuJoCo"].result is Outcome.SAME
    assert "Toy 1/2" in found.report.verdict


# Baselines


@pytest.fixture
def guarded(with_engines, monkeypatch, tmp_path):
    """A pendulum whose baseline has newton_euler's accelerations and those of two other engines."""
    with_engines(TOY, OWN_COLOR)
    monkeypatch.setattr(measure, "GROUPS", {name: measure.GROUPS[name] for name in ("relative", "own_run")})
    scene = replace(load("pendulum"), duration=0.1)
    guarded = GuardedScene("pendulum", {}, scene, tmp_path / "baseline.json")
    update_baselines([guarded], "first", lambda _: None, ["newton_euler", "toy", "colored"])
    return guarded


def test_a_baseline_has_the_engines_that_are_named(guarded, with_engines):
    stored = read_baseline(guarded.path)
    assert stored.groups == ["relative", "toy", "colored"]
    assert engines_of(guarded) == ["newton_euler", "toy", "colored"]
    assert "click" in stored.last_update.versions
    assert "mujoco" not in stored.last_update.versions
    update_baselines([guarded], "again", lambda _: None)  # the engines are those of the baseline
    assert read_baseline(guarded.path).groups == stored.groups
    with_engines(TOY)
    with pytest.raises(CrosscheckError, match=r"engine 'colored'.*--engines"):
        update_baselines([guarded], "again", lambda _: None)


def test_an_engine_of_a_baseline_that_is_not_installed_is_not_measured(guarded, with_engines):
    old = replace(OWN_COLOR, min_version="9999")
    for engines, reason in (([TOY], "engine 'colored' is not installed"), ([TOY, old], "click>=9999")):
        with_engines(*engines)
        found = compare(guarded.scene, guarded.baseline(), lambda _: None)
        assert not found.moved
        assert {check.level for check in found.checks} == {"relative", "toy"}
        assert [*found.not_measured] == ["colored"]
        assert reason in found.not_measured["colored"]
        assert reason in found.verdict
        assert found.outcome is Outcome.QUIET_OF_SOME_ENGINES
        assert found.outcome.exit_status(allow_reduced=True) == 3
        suite = ElementTree.fromstring(junit(report([found], {}, {})))
        (failure,) = suite.iter("failure")
        assert reason in failure.get("message")


def test_an_engine_that_fails_now_has_moved(guarded, with_engines):
    with_engines(replace(TOY, limits=lambda scene: [Limit("joint 'pivot'", "no hinges")]), OWN_COLOR)
    found = compare(guarded.scene, guarded.baseline(), lambda _: None)
    assert {check.level for check in found.moved} == {"toy"}
    assert all("no hinges" in check.problem for check in found.moved)


def test_a_baseline_of_a_test_suite_has_the_engines_that_the_test_names(guarded, with_engines):
    guarded.path.unlink()
    verdict, folder = check(guarded.scene, ["newton_euler", "toy"]), guarded.path.parent
    CheckedModel(verdict, folder, "first", folder).assert_unchanged()
    stored = read_baseline(folder / "pendulum.baseline.json")
    assert stored.engines == ["mujoco", "pinocchio", "toy"]
    CheckedModel(verdict, folder, None, folder).assert_unchanged()
    with_engines()
    with pytest.raises(pytest.fail.Exception, match="engine 'toy' is not installed"):
        CheckedModel(verdict, folder, None, folder).assert_unchanged()


def test_engines_of_baselines_are_chosen_when_they_are_made(capsys, tmp_path):
    status, out, err = run(capsys, "regress", "pendulum", "--engines", "mujoco", "--output", tmp_path)
    assert (status, out) == (2, "")
    assert "--update" in err
