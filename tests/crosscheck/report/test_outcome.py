"""Outcomes: what acts in a file and is not simulated limits the verdict in every format and exit status."""

from __future__ import annotations

import json
import time
from xml.etree import ElementTree

import pytest
from command_line import run, verdict_of
from mjcf_models import LOOP

import crosscheck
from crosscheck.compare.check import READING
from crosscheck.compare.crosscheck import MISREAD
from crosscheck.compare.crosscheck import crosscheck as run_crosscheck
from crosscheck.compare.outcome import ExitStatus, Outcome
from crosscheck.engines.engine_runs import Stop, stops_text
from crosscheck.engines.registry import ENGINES
from crosscheck.loading.load import load_scene
from crosscheck.report.run import verdict_limits
from crosscheck.support.errors import CrosscheckError

FAST = ["newton_euler", "mujoco"]

DROP = """<mujoco model="drop"><option timestep="0.004" integrator="implicitfast"/><worldbody>
<geom name="floor" type="plane" size="1 1 0.1"/>
<body name="cube" pos="0 0 {height}"><freejoint/>
<geom name="cube" type="box" size="0.02 0.02 0.02" mass="0.1"/></body>
</worldbody></mujoco>"""
"""A cube above a floor, through which it falls as contacts are not simulated."""


def file(tmp_path, text, name="model.xml"):
    path = tmp_path / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("outcome", Outcome)
def test_every_outcome_has_a_color_and_an_exit_status(outcome):
    assert outcome.judged in ("holds", "doubtful", "fails")
    assert outcome.exit_status() in ExitStatus
    assert outcome.passes() == (outcome.exit_status() == 0)
    assert not (outcome.passes() and outcome.judged == "fails")


def test_exit_statuses():
    assert [int(status) for status in ExitStatus] == [0, 1, 2, 3, 4, 5]
    reduced = Outcome.AGREE_ON_A_REDUCED_MODEL
    assert (reduced.exit_status(), reduced.exit_status(allow_reduced=True)) == (4, 0)
    unchanged = set(Outcome) - {reduced, Outcome.QUIET_ON_A_REDUCED_MODEL}
    assert all(one.exit_status() == one.exit_status(allow_reduced=True) for one in unchanged)


@pytest.mark.slow
def test_a_cube_that_falls_through_a_floor_is_no_plain_agreement(capsys, tmp_path):
    """It falls by 9.81 / 2 t^2 and touches after 0.05 m: at 0.101 s."""
    path, out = file(tmp_path, DROP.format(height=0.07)), tmp_path / "out"
    arguments = [path, "--engines", "newton_euler,mujoco", "--set", "excitation=off", "--output", out]
    status, text, _ = run(capsys, "run", *arguments)
    assert status == ExitStatus.REDUCED
    assert verdict_of(text).startswith(Outcome.AGREE_ON_A_REDUCED_MODEL)
    found = json.loads((out / "summary.json").read_text())
    assert (found["outcome"], found["agrees"]) == ("AGREE ON A REDUCED MODEL", False)
    (acting,) = found["not_simulated"]
    assert acting["topic"] == "contacts"
    assert {"floor", "cube"} <= set(acting["seen"].replace("'", " ").split())
    assert found["as_in_the_file_until"] == acting["since"] == pytest.approx(0.101, abs=0.001)
    until = [row for row in found["checks"] if "until" in row["quantity"]]
    assert {row["level"] for row in until} == {"trajectories"}
    assert len(until) == 2
    assert found["report"]["judged"] == {
        "text": "AGREE ON A REDUCED MODEL",
        "verdict": "doubtful",
        "about": "",
    }
    assert run(capsys, "run", *arguments, "--allow-reduced")[0] == ExitStatus.AGREE


@pytest.mark.slow
@pytest.mark.parametrize(("excitation", "named"), [("on", 1), ("off", 0)])
def test_an_excitation_is_named_as_a_possible_cause_of_what_acts_later(excitation, named, tmp_path):
    """Not of what acts from the start on, as in a cube that starts in the floor."""
    late, early = (
        crosscheck.check(
            file(tmp_path, DROP.format(height=height)), FAST, excitation=excitation, duration=0.2
        )
        for height in (0.07, 0.01)
    )
    lines = [
        [line for line in verdict_limits(each.crosscheck) if "excitation=off" in line]
        for each in (late, early)
    ]
    assert (len(lines[0]), lines[1]) == (named, [])


def test_a_cube_that_does_not_arrive_agrees(tmp_path):
    verdict = crosscheck.check(file(tmp_path, DROP.format(height=9.0)), FAST)
    assert (verdict.crosscheck.acting, verdict.crosscheck.until) == ([], None)
    assert verdict.outcome is not Outcome.AGREE_ON_A_REDUCED_MODEL
    assert verdict.outcome.passes()


def test_elements_that_could_not_be_watched_count_as_acting(tmp_path, monkeypatch):
    """As if the time limit interrupted it."""

    def stops(*_):
        raise CrosscheckError("not finished")

    monkeypatch.setattr("crosscheck.compare.crosscheck.watched", stops)
    verdict = crosscheck.check(file(tmp_path, DROP.format(height=9.0)), FAST)
    assert verdict.outcome is Outcome.AGREE_ON_A_REDUCED_MODEL
    assert verdict.crosscheck.until == 0.0
    assert any("not finished" in note for note in verdict.crosscheck.notes)


def test_python_states_the_outcome(tmp_path):
    verdict = crosscheck.check(file(tmp_path, DROP.format(height=0.03)), FAST, duration=0.2)
    assert verdict.outcome is Outcome.AGREE_ON_A_REDUCED_MODEL
    assert not verdict.agrees
    with pytest.raises(AssertionError):
        verdict.assert_agrees()
    verdict.assert_agrees(allow_reduced=True)
    assert '<div class="answer doubtful"><b>AGREE ON A REDUCED MODEL</b>' in verdict._repr_html_()


@pytest.mark.parametrize(("reach", "moved"), [(0.4, False), (0.400001, False), (0.43, True)])
def test_a_start_that_is_not_the_files_is_reported_first(reach, moved, tmp_path):
    verdict = crosscheck.check(file(tmp_path, LOOP.format(reach=reach)), FAST, duration=0.1)
    first = next(verdict_limits(verdict.crosscheck), "")
    assert ("'close'" in first) == moved
    if moved:
        change = verdict.crosscheck.mapping.moved
        assert (change.loop, change.open) == ("equality 'close'", pytest.approx(0.03))
        assert "; loops closed" in str(verdict)
        assert change.body in ("crank", "rod", "lever")
        assert change.displacement > 0.005
        assert f"{change.open:.3g} m" in first
        assert verdict.crosscheck.summary()["moved_start"]["body"] == change.body


@pytest.mark.slow
@pytest.mark.parametrize(("rates", "changed"), [("0 0 0", False), ("1 2 3", True)])
def test_velocities_of_a_file_that_do_not_fit_its_loops_are_reported(rates, changed, tmp_path):
    key = f'<keyframe><key name="go" qvel="{rates}"/></keyframe></mujoco>'
    path = file(tmp_path, LOOP.format(reach=0.4).replace("</mujoco>", key))
    verdict = crosscheck.check(path, FAST, duration=0.1, key="go")
    lines = [line for line in verdict_limits(verdict.crosscheck) if "velocities of go" in line]
    found = verdict.crosscheck.summary()["changed_velocities"]
    assert (bool(lines), found is not None) == (changed, changed)
    (motion,) = (line for line in str(verdict).splitlines() if line.startswith("  motion "))
    assert ("velocities changed to fit the constraints" in motion) == changed
    if changed:
        assert found["share"] > 0.01
        assert f"{found['angular']:.3g} rad/s" in lines[0]


def test_the_settings_of_the_file_stand_in_the_output(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = LOOP.format(reach=0.4).replace('timestep="0.002"', 'timestep="0.003" integrator="implicit"')
    path = file(tmp_path, text)
    _, out, _ = run(
        capsys, "run", path, "--engines", "mujoco", "--set", "duration=0.1", "--output", tmp_path / "out"
    )
    assert "implicit, 3 ms, solref 0.02" in out


def test_after_a_wrong_reading_no_engine_runs(tmp_path):
    """The scene of a file in which gravity pulls twice as much as the file says."""
    path = str(file(tmp_path, LOOP.format(reach=0.4)))
    _, report = load_scene(path, {"excitation": "on"}, verified=False)
    wrong, _ = load_scene(
        str(file(tmp_path, LOOP.format(reach=0.4).replace('density="900"', 'density="1800"'), "wrong.xml")),
        {"excitation": "on"},
        verified=False,
    )
    report.references = [(reference, wrong) for reference, _ in report.references]
    told = []
    begin = time.perf_counter()
    engines = [ENGINES[name] for name in FAST]
    found = run_crosscheck(wrong, engines, told.append, path, {"excitation": "on"}, report)
    assert time.perf_counter() - begin < 60.0
    assert found.outcome is Outcome.DISAGREE
    assert not found.trajectories
    assert {row.level for row in found.checks} == {READING}
    assert found.notes == (MISREAD,)
    assert told == ["comparing with the file"]


def test_options_of_a_summary_make_the_same_scene(tmp_path):
    path = file(tmp_path, LOOP.format(reach=0.4))
    verdict = crosscheck.check(path, ["newton_euler"], duration=0.1)
    options = verdict.crosscheck.summary()["options"]
    again = crosscheck.check(path, ["newton_euler"], **options)
    first, second = (each.trajectories["newton_euler"].position for each in (verdict, again))
    assert (first == second).all()
    assert options["excitation"] == "on"


def test_regress_reports_elements_that_act(capsys, tmp_path):
    path, out = file(tmp_path, DROP.format(height=0.03)), tmp_path / "out"
    options = ["--set", "duration=0.2", "--output", out]
    assert run(capsys, "regress", path, *options, "--update", "as delivered")[0] == ExitStatus.AGREE
    status, text, _ = run(capsys, "regress", path, "--output", out)
    assert status == ExitStatus.REDUCED
    *_, result, next_step = text.splitlines()
    assert result.startswith("QUIET ON A REDUCED MODEL: ")
    assert "--allow-reduced" in next_step
    failures = ElementTree.parse(out / "junit.xml").findall(".//failure")
    assert len(failures) == 1
    content = json.loads((out / "regress.json").read_text())
    assert content["report"]["judged"]["verdict"] == "doubtful"
    assert content["scenes"][0]["not_simulated"][0]["topic"] == "contacts"
    assert run(capsys, "regress", path, "--output", out, "--allow-reduced")[0] == ExitStatus.AGREE
    accepted = ElementTree.parse(out / "junit.xml")
    assert (len(accepted.findall(".//failure")), len(accepted.findall(".//skipped"))) == (0, 1)


def test_a_reason_that_several_parts_share_is_given_once():
    stops = [Stop("a", "too long"), Stop("b", "no memory"), Stop("c", "too long")]
    assert stops_text(stops) == "a, c: too long; b: no memory"
