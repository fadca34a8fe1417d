"""Reference values: which hold for a run, how they are judged, and what the commands make of them."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from command_line import command, run, scene_file, short_example, verdict_of

import newton_euler
from crosscheck import check
from crosscheck.cli import run_all
from crosscheck.cli.run_all import SceneOutcome, outcome_lines, outcomes_table, run_scene
from crosscheck.cli.shared import UNFINISHED
from crosscheck.compare.check import ERROR_PER_CHANGE, MAX_RELATIVE_ERROR
from crosscheck.compare.reference_values import STEPS_ROUND_OFF, known_of, measure
from crosscheck.engines.registry import ENGINES
from crosscheck.library import REFERENCE_QUANTITIES, SCENES, load
from crosscheck.library.measure import angle, position, spin, velocity
from crosscheck.report.table import Cell
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.trajectory import Trajectory


def made_up(time, quaternion, position=(0.0, 0.0, 0.0), velocity=(0.0, 0.0, 0.0), omega=(0.0, 0.0, 0.0)):
    """A run of one body that nobody made."""
    n = len(time)
    return Trajectory(
        "made up", {}, 0.0, np.asarray(time), ("ground", "body"), (),
        np.tile(position, (n, 2, 1)).astype(float),
        np.stack([np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), quaternion], axis=1),
        np.tile(velocity, (n, 2, 1)).astype(float), np.tile(omega, (n, 2, 1)).astype(float),
    )  # fmt: skip


def test_points_and_spins_of_a_turned_body():
    half = np.sqrt(0.5)
    turned = made_up([0.0], [[half, 0.0, 0.0, half]], (1.0, 2.0, 3.0), (0.1, 0.0, 0.0), (2.0, 0.0, 0.0))
    # a quarter turn about z takes body x to world y
    assert position(turned, "body", np.array([0.5, 0.0, 0.0])) == pytest.approx(np.array([[1.0, 2.5, 3.0]]))
    # 2 rad/s about x moves that point along z at 2 * 0.5 m/s
    assert velocity(turned, "body", np.array([0.5, 0.0, 0.0])) == pytest.approx(np.array([[0.1, 0.0, 1.0]]))
    assert spin(turned, "body") == pytest.approx(np.array([[0.0, -2.0, 0.0]]))


@pytest.mark.parametrize("rate", [-3.0, 0.4, 3.1])
def test_whole_turns_are_counted(rate):
    time = np.arange(100.0)
    half = 0.5 * rate * time
    quaternion = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    seen = angle(made_up(time, quaternion), "body", np.array([0.0, 0.0, 1.0]))
    assert seen == pytest.approx(rate * time, abs=1e-12)  # 300 rad at 2e-16 each, and the sine of as much


def test_values_are_those_of_the_options():
    assert {known.options["N"] for known in known_of("four_bar", {})} == {2}
    assert {known.options["N"] for known in known_of("four_bar", {"N": "40"})} == {40}
    assert known_of("four_bar", {"N": "3"}) == []
    assert known_of("four_bar", {"N": "02"}) == known_of("four_bar", {"N": "2"})  # another text of one number
    assert {known.options["variant"] for known in known_of("slider_crank", {})} == {"A"}
    assert len(known_of("pendulum", {})) == 10
    assert known_of("tracker", {}) == known_of("scene.yaml", {}) == []


@pytest.fixture(scope="module")
def swing():
    return replace(load("pendulum"), duration=0.5)


def own(exact=None, **changes):
    """newton_euler with other functions; a function that returns the run with the most exact settings."""
    if exact:
        changes |= {"exact": {"exact": True}, "simulate": lambda scene, settings: exact()}
    return replace(ENGINES["newton_euler"], **changes)


def half_second():
    return [known for known in known_of("pendulum", {}) if known.time == 0.5]


def test_a_run_is_judged_by_its_uncertainty_and_its_own_error(swing):
    fine, coarse = (newton_euler.simulate(swing, rtol=r, atol=0.01 * r) for r in (1e-12, 1e-6))
    found = list(measure("pendulum", swing, own(lambda: fine, refined=lambda _: coarse), fine, half_second()))
    assert [each.known.quantity for each in found] == ["x", "y", "vx", "vy", "bar_tension"]
    for each in found:
        figure = REFERENCE_QUANTITIES["pendulum"][each.known.quantity]
        change = abs(figure(fine) - figure(coarse)).max()
        assert each.result == figure(fine)[-1]
        assert each.tolerance == pytest.approx(
            each.known.uncertainty + ERROR_PER_CHANGE * change + STEPS_ROUND_OFF * abs(figure(fine)).max(),
            rel=1e-12,
        )
        assert each.agrees
        assert each.summary()["reference"] == each.known.value


def test_a_wrong_reference_is_found(swing):
    off = [replace(known, value=known.value + 1e-8) for known in half_second()]
    found = measure("pendulum", swing, own(), newton_euler.simulate(swing), off)
    assert not any(each.agrees for each in found)


def test_a_coarse_run_excuses_no_more_than_a_hundredth(swing):
    fine = newton_euler.simulate(swing)
    elsewhere = newton_euler.simulate(replace(swing, gravity=0.5 * swing.gravity))
    engine = own(lambda: fine, refined=lambda _: elsewhere)
    for each in measure("pendulum", swing, engine, fine, half_second()):
        largest = abs(REFERENCE_QUANTITIES["pendulum"][each.known.quantity](fine)).max()
        own_error = (MAX_RELATIVE_ERROR + STEPS_ROUND_OFF) * largest
        assert each.tolerance == pytest.approx(each.known.uncertainty + own_error, rel=1e-12)


def test_an_engine_that_cannot_be_more_exact_is_judged_by_what_it_can(swing):
    def fails(*_):
        raise newton_euler.NewtonEulerError("steps have become too small")

    runs = {"refined": newton_euler.simulate(swing, rtol=1e-11), "usual": newton_euler.simulate(swing)}
    engine = own(fails, refined=lambda _: runs["refined"])
    (found, *_) = measure("pendulum", swing, engine, runs["usual"], half_second())
    assert found.result == REFERENCE_QUANTITIES["pendulum"]["x"](runs["refined"])[-1]
    assert found.tolerance - found.known.uncertainty > STEPS_ROUND_OFF


@pytest.mark.parametrize("exact", [False, True])
def test_an_engine_without_a_finer_run_is_not_judged_by_round_off(swing, exact):
    def fails(*_):
        raise newton_euler.NewtonEulerError("newton_euler, in a finer run: steps have become too small")

    engine = own(fails, refined=fails) if exact else replace(own(refined=fails), exact=None)
    with pytest.raises(newton_euler.NewtonEulerError, match="in a finer run: steps have become too small"):
        list(measure("pendulum", swing, engine, newton_euler.simulate(swing), half_second()))


def test_an_exact_run_without_a_finer_one_is_judged_by_the_usual(swing):
    def fails(*_):
        raise newton_euler.NewtonEulerError("steps have become too small")

    exact, usual = newton_euler.simulate(swing, rtol=1e-12, atol=1e-14), newton_euler.simulate(swing)
    (found, *_) = measure("pendulum", swing, own(lambda: exact, refined=fails), usual, half_second())
    figure = REFERENCE_QUANTITIES["pendulum"]["x"]
    assert found.result == figure(exact)[-1]
    own_error = (
        ERROR_PER_CHANGE * abs(figure(exact) - figure(usual)).max()
        + STEPS_ROUND_OFF * abs(figure(exact)).max()
    )
    assert found.tolerance == pytest.approx(found.known.uncertainty + own_error, rel=1e-12)


def test_a_figure_between_outputs_is_refused(swing):
    known = [replace(half_second()[0], time=0.123)]
    with pytest.raises(CrosscheckError, match=r"scene 'pendulum' has no output at 0\.123 s"):
        list(measure("pendulum", swing, own(), newton_euler.simulate(swing), known))


# Commands


def test_run_prints_and_stores_reference_values(capsys, tmp_path):
    arguments = ("--engines", "newton_euler,pinocchio", "--output", tmp_path)
    status, out, _ = run(capsys, "run", "free_top", *arguments)
    assert status == 0
    assert re.search(r"^reference +28 ok", out, re.MULTILINE)
    assert verdict_of(out).endswith(", and the reference in all 28; motion covers 0 of 2 elements")
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert {figure["engine"] for figure in summary["known_values"]} == {"newton_euler", "pinocchio"}
    (first, *_) = summary["known_values"]
    assert (first["quantity"], first["time"], first["reference"]) == ("omega_x", 0.5, 0.6263458468622101)
    assert first["difference"] <= first["allowed"] < 1e-9


def test_a_wrong_figure_is_status_1(capsys, tmp_path, monkeypatch):
    right = REFERENCE_QUANTITIES["pendulum"]
    monkeypatch.setitem(REFERENCE_QUANTITIES, "pendulum", {**right, "y": lambda run: 1.001 * right["y"](run)})
    status, out, _ = run(capsys, "run", "pendulum", "--engines", "newton_euler", "--output", tmp_path)
    assert status == 1
    verdict = verdict_of(out)
    assert verdict.startswith(
        "DISAGREE: newton_euler and the reference differ; against the reference: y: 0.00092 > "
    )
    assert verdict.endswith("(2 of 10 reference values fail)")


def test_an_engine_that_cannot_express_a_scene_is_left_out(capsys, tmp_path, monkeypatch):
    def refuse(scene):
        raise newton_euler.NewtonEulerError("no word for joint 'pivot'")

    unable = replace(ENGINES["pinocchio"], systems=refuse)
    monkeypatch.setitem(ENGINES, "pinocchio", unable)
    status, out, _ = run(capsys, "run", "pendulum", "--output", tmp_path)
    assert status == UNFINISHED
    assert verdict_of(out).startswith("AGREE (2 of 3 engines): newton_euler, mujoco ")
    said = (
        "; pinocchio left out: no word for joint 'pivot'; to do without, name the others (--engines newton_"
    )
    assert said in out
    assert json.loads((tmp_path / "summary.json").read_text())["left_out"] == {
        "pinocchio": "no word for joint 'pivot'"
    }
    path = scene_file(tmp_path, short_example())
    with pytest.raises(AssertionError, match=r"AGREE \(2 of 3 engines\): newton_euler, mujoco "):
        check(str(path)).assert_agrees()
    others = ("--engines", "newton_euler,mujoco", "--output", tmp_path / "others")
    assert run(capsys, "run", path, *others)[0] == 0
    status, _, err = run(capsys, "run", "pendulum", "--engines", "pinocchio", "--output", tmp_path)
    assert (status, err) == (2, "crosscheck: error: no word for joint 'pivot'\n")


# The library


def test_one_scene_of_the_library(tmp_path):
    found = run_scene("pendulum", ("newton_euler", "pinocchio"), tmp_path)
    assert found.agrees
    assert re.fullmatch(r" *\d+ % .+", found.nearest.text)
    assert {path.name for path in (tmp_path / "pendulum").iterdir()} == {
        "newton_euler.npz", "pinocchio.npz", "summary.json", "junit.xml", "pendulum.rrd",
    }  # fmt: skip


def test_a_scene_that_does_not_run_is_a_line(tmp_path, monkeypatch):
    def breaks(name):
        raise ZeroDivisionError("nothing there")

    monkeypatch.setattr(run_all, "load", breaks)
    found = run_scene("pendulum", ("newton_euler",), tmp_path)
    assert not found.agrees
    assert found.verdict == "did not run: internal error: ZeroDivisionError: nothing there"


OUTCOMES = [
    SceneOutcome(
        "good",
        1.0,
        True,
        "AGREE",
        Cell(" 10 % rod, positions"),
        Cell("AGREE", "holds"),
    ),
    SceneOutcome(
        "bad",
        2.0,
        False,
        "DISAGREE: bad parts",
    ),
]


def test_the_table_of_the_library():
    good, bad = ([cell.text for cell in row] for _, row in outcomes_table(OUTCOMES).sections())
    assert good == ["good", "AGREE", "1.0", " 10 % rod, positions"]
    assert bad == ["bad", "FAILS", "2.0", ""]
    assert list(outcome_lines(OUTCOMES)) == [
        "bad: DISAGREE: bad parts",
        "FAILS: 1 of 2 scenes: bad",
    ]
    assert list(outcome_lines(OUTCOMES[:1]))[-1] == "AGREE: all 1 scenes"


@pytest.mark.parametrize(("outcomes", "status"), [(OUTCOMES[:1], 0), (OUTCOMES, 1)])
def test_exit_status_of_the_library(capsys, monkeypatch, outcomes, status):
    monkeypatch.setattr(run_all, "run_all", lambda *_: outcomes)
    assert run(capsys, "run", "--all")[0] == status


def test_all_takes_no_scene(capsys):
    for name, *values in (("pendulum",), ("--set", "N=3"), ("--save", "x.rrd"), ("--advice",)):
        status, _, err = run(capsys, "run", "--all", name, *values)
        assert status == 2
        assert err.startswith("crosscheck: error: --all ")
        assert err.endswith(f"without {name if name.startswith('--') else 'SCENE'}\n")
    assert run(capsys, "run", "--all", "--engines", "bullet")[0] == 2


@pytest.mark.slow
def test_the_whole_library_agrees(tmp_path):
    done = command(tmp_path, "run", "--all", timeout=1200)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == f"AGREE: all {len(SCENES)} scenes"
