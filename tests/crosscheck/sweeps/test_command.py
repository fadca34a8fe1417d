"""`crosscheck sweep`: its tables and files, its page, crosschecks, and bad input in one line each."""

from __future__ import annotations

import json
import re
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from command_line import run
from mechanisms import Z, bolted
from mjcf_models import LOOP, PAIR, model
from rerun.chunk import RrdReader

import crosscheck.sweeps.checks
import crosscheck.sweeps.execute
import crosscheck.sweeps.plan
from crosscheck import Sweep, sweep
from crosscheck.compare.check import Check
from crosscheck.compare.crosscheck import Crosscheck
from crosscheck.compare.outcome import ExitStatus, Outcome
from crosscheck.library import load
from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.checks import default_count
from crosscheck.sweeps.output import MAX_RECORDED_EXTREMES, to_record
from newton_euler import Revolute, with_parameters
from newton_euler.codegen.compile import lane_count
from newton_euler.errors import DISTRIBUTION

VARY = "dumbbell.mass=uniform(1, 2)"

KEEP = "peak:reaction_force,final:dumbbell.position.y"

TWO = {"gravity.y": "uniform(-10, -9)", "gravity.z": "uniform(-1, 1)"}

ARGUMENTS = ("--vary", VARY, "--vary", "gravity.y=normal(-9.81, 0.1)", "--runs", "64", "--keep", KEEP)


def test_a_sweep_prints_what_matters_and_writes_files(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = run(capsys, "sweep", "pendulum", *ARGUMENTS, "--check", "0", "--output", tmp_path)
    assert status == 0
    lines = out.splitlines()
    assert len(lines) <= 25
    assert max(len(line) for line in lines if str(tmp_path) not in line) <= 80
    assert "pendulum: 64 runs, random, seed 0" in lines[0]
    assert re.search("64 of 64 runs.* cross-checked", out)
    assert "peak:reaction_force pivot, N" in out
    assert "; there tornado.png, histograms.png, scatter.png and numbers, sweep.zarr" in " ".join(out.split())
    names = {"sweep.zarr", "sweep.json", "sweep.rrd", "tornado.png", "histograms.png", "scatter.png"}
    assert {path.name for path in tmp_path.iterdir()} == names | {".sweep.lock"}
    content = json.loads((tmp_path / "sweep.json").read_text())
    first, second = content["effects"]["peak:reaction_force pivot"]
    assert (first["name"], first["share"]) == ("dumbbell.mass", None)
    assert first["rank"] - first["rank_error"] > 0.9 > second["rank_error"] > 0.2
    assert re.search("no Sobol indices .*: 64 runs.* 400", out)
    entities = {chunk.entity_path for chunk in RrdReader(str(tmp_path / "sweep.rrd")).stream()}
    assert "/mechanism/nominal/dumbbell" in entities
    assert any(str(path).startswith("/plots/0/") for path in entities)
    # the same again makes no run
    status, again, _ = run(capsys, "sweep", "pendulum", *ARGUMENTS, "--check", "0", "--output", tmp_path)
    assert status == 0
    assert "simulated" not in again.splitlines()[0]


def test_extreme_runs_and_some_at_random_are_cross_checked():
    short = replace(load("pendulum"), duration=1.0)
    swept = sweep(short, {"dumbbell.mass": "uniform(1, 2)"}, 40, "peak:reaction_force").check(3)
    why = {each.run: each.why for each in swept.checks}
    forces = swept.dataset["peak:reaction_force"].values[:, 0]
    assert why[int(forces.argmax())] == "largest peak:reaction_force pivot"
    assert why[int(forces.argmin())] == "smallest peak:reaction_force pivot"
    assert list(why.values()).count("at random") == 1
    assert all(each.complete and not each.differs for each in swept.checks)
    kept = {each.between[0]: each for each in swept.checks[0].kept}
    assert not kept["mujoco"].judged  # forces of its soft joints are some per mille off
    assert 0.0 <= kept["pinocchio"].value <= kept["pinocchio"].tolerance < 1e-6 * forces.max()
    assert swept.report.verdict.startswith(
        "AGREE: 40 of 40 runs completed; newton_euler, mujoco, pinocchio agree in all checks of 3 runs "
        "(2 with extreme outputs, 1 at random)"
    )
    assert "outputs not judged: reactions of mujoco" in str(swept)


def test_a_variable_of_many_numbers_hides_no_other_one():
    """Of each as many are analyzed and checked, from the first to the last, and that is said."""
    short = replace(load("pendulum"), duration=2.0)
    swept = sweep(short, {"dumbbell.mass": "uniform(1, 2)"}, 3, "at():dumbbell.position, peak:reaction_force")
    labels = [scalar.label for scalar in swept.findings.scalars]
    assert (labels[0], labels[99], labels[100:]) == (
        "at():dumbbell.position 0 s x",
        "at():dumbbell.position 2 s z",
        ["peak:reaction_force pivot"],
    )
    assert "at():dumbbell.position: 100 of its 603 components are analyzed" in str(swept)
    swept.results.dataset["peak:reaction_force"][:] *= 1.001
    assert swept.check(1, ["pinocchio"]).report.verdict.startswith("DISAGREE")


@pytest.mark.slow
def test_how_a_file_is_excited_is_said(capsys, tmp_path):
    path = tmp_path / "pair.xml"
    path.write_text(model(PAIR, '<actuator><motor name="motor" joint="p"/></actuator>'))
    more = (
        "--vary",
        "gravity.z=values(-9,-10)",
        "--runs",
        "2",
        "--set",
        "duration=0.1",
        "--keep",
        "final:kinetic_energy",
        "--check",
        "0",
        "--output",
        tmp_path,
    )
    for settings, excitation in (((), "on"), (("--set", "excitation=off"), "off")):
        out = run(capsys, "sweep", path, *more, *settings)[1]
        content = json.loads((tmp_path / "sweep.json").read_text())
        assert content["options"] == {"excitation": excitation, "duration": "0.1"}
        line = "excited: 1 actuator driven at "
        assert (line in out, any(line in note for note in content["notes"])) == (excitation == "on",) * 2
        shutil.rmtree(tmp_path / "sweep.zarr")


@pytest.mark.slow
@pytest.mark.parametrize(("allowed", "expected"), [((), ExitStatus.REDUCED), (("--allow-reduced",), 0)])
def test_a_sweep_of_a_reduced_model_and_a_moved_start_says_so(capsys, tmp_path, allowed, expected):
    """The crank falls past its limit, which is not simulated; the loop is open by 3 cm in the file."""
    path = tmp_path / "limited.xml"
    path.write_text(LOOP.format(reach=0.43).replace('name="a"', 'name="a" range="-0.05 0.05" limited="true"'))
    arguments = ("--vary", "gravity.z=values(-9,-10)", "--runs", "2", "--keep", "final:kinetic_energy")
    status, out, err = run(
        capsys,
        "sweep",
        path,
        *arguments,
        "--set",
        "duration=0.3",
        "--check",
        "1",
        *allowed,
        "--output",
        tmp_path,
    )
    assert status == expected, err
    assert "AGREE ON A REDUCED MODEL: not simulated: limits of joint 'a', in 1 of 1 runs" in " ".join(
        out.split()
    )
    assert "the start is not the file's" in " ".join(out.split())
    assert "the start is not the file's" in " ".join(err.split())
    content = json.loads((tmp_path / "sweep.json").read_text())
    assert content["checked"][0]["acting"][0]["element"] == "joint 'a'"
    assert any("the start is not the file's" in note for note in content["notes"])


def test_newton_euler_alone_does_not_confirm_its_own_sweep():
    swept = sweep(
        replace(load("pendulum"), duration=0.1), {"dumbbell.mass": "uniform(1, 2)"}, 2, "final:kinetic_energy"
    )
    assert swept.check(1, ["newton_euler"]).findings.outcome is Outcome.ONE_ENGINE_ALONE
    assert swept.check(1, ["pinocchio"]).findings.outcome is Outcome.AGREE


@pytest.mark.slow
def test_reactions_that_redundant_constraints_leave_open_are_not_judged(tmp_path):
    scene = replace(bolted(Revolute, axis=Z), duration=0.2)
    keep = "peak:reaction_force, peak:pivot.reaction_force, peak:bolt.reaction_force"
    checked = sweep(scene, {"a.mass": "uniform(1, 2)"}, 3, keep).check(1, ["newton_euler", "pinocchio"])
    assert checked.report.verdict.startswith("AGREE")
    unjudged = "outputs not judged: reactions that are not unique"
    assert unjudged in str(checked)
    of = {(each.quantity, not each.judged) for each in checked.checks[0].kept if "pinocchio" in each.between}
    assert of == {
        ("peak:reaction_force pivot, N", False),
        ("peak:pivot.reaction_force, N", False),
        ("peak:reaction_force second_bolt, N", True),
        ("peak:bolt.reaction_force, N", True),
    }
    note = "reactions not unique: 5 redundant constraints at joints bolt, second_bolt"
    assert note in str(checked)
    checked.save(tmp_path)
    assert json.loads((tmp_path / "sweep.json").read_text())["notes"][1:] == [unjudged, note]


def test_what_has_no_effect_is_said_and_checked_all_the_same():
    short = replace(load("pendulum"), duration=1.0)
    swept = sweep(short, {"dumbbell.mass": "uniform(1, 2)"}, 3, "final:dumbbell.position.z").check(1)
    assert [each.why for each in swept.checks] == ["at random"]
    assert "no effect" in str(swept)
    assert swept.report.verdict.startswith(
        "AGREE: 3 of 3 runs completed; newton_euler, mujoco, pinocchio agree in all checks of 1 run "
        "(1 at random)"
    )


def test_motions_that_test_nothing_are_not_said_to_agree(capsys, tmp_path):
    at_rest = ("--vary", "gravity.y=values(0)", "--check", "1")
    others = ("--vary", VARY, "--runs", "3", "--keep", KEEP, "--output", tmp_path / "out")
    status, out, _ = run(capsys, "sweep", "pendulum", *at_rest, *others)
    assert status == 0
    assert "\nAGREE AT RANDOM STATES ONLY: 3 of 3 runs completed; " in out
    assert "nothing moves" in out


def test_runs_that_fail_are_counted_by_reason(capsys, tmp_path):
    vary = ("--vary", "dumbbell.mass=normal(1, 2)", "--runs", "20", "--keep", KEEP, "--check", "0")
    status, out, _ = run(capsys, "sweep", "pendulum", *vary, "--output", tmp_path)
    assert status == 3
    said = " ".join(out.split())
    failed = 20 - int(re.search(r"UNFINISHED: (\d+) of 20 runs", said)[1])
    assert re.search(rf"{failed} runs failed.* run \d+", said)
    assert "; needed: a positive mass" in said
    assert "dumbbell.mass=truncated_normal(1, 2, LOW, HIGH) stays within bounds" in said


def test_numbers_that_hardly_vary_have_the_digits_to_tell():
    short = replace(load("pendulum"), duration=0.1)
    keep = "final:dumbbell.position.y"
    swept = sweep(short, {"gravity.y": "uniform(-9.8100001, -9.81)"}, 8, keep)
    row = next(line for line in str(swept).splitlines() if line.startswith(keep))
    assert len(set(row.split()[-4:])) == 4


def test_where_no_run_ends_nothing_is_said_of_effects():
    swept = sweep("pendulum", {"dumbbell.mass": "uniform(1, 2)"}, 3, KEEP, most_steps=3)
    assert "no effect" not in str(swept)
    assert "3 runs failed" in str(swept)


def test_a_nominal_value_far_from_its_distribution_is_named():
    short = replace(load("pendulum"), duration=0.1)
    vary = {"dumbbell.mass": "normal(1, 0.1)", "gravity.y": "normal(-9.81, 0.1)", "gravity.x": [1.0]}
    said = " ".join(str(sweep(short, vary, 3, KEEP)).split())
    assert "nominal dumbbell.mass, 2, is 10 deviations from the mean of normal(1, 0.1)" in said
    assert said.count("deviations from") == 1
    crank = replace(load("slider_crank"), duration=0.1)
    swept = sweep(crank, {"pivot.point.y": "normal(1e-4, 1e-5)"}, 2, "final:kinetic_energy")
    said = " ".join(str(swept).split())
    assert "nominal pivot.point.y, 0, an offset from 0.1, is 10 deviations from the mean of normal(" in said


def test_a_single_run_is_no_plural():
    said = str(sweep(replace(load("pendulum"), duration=0.1), {"dumbbell.mass": "uniform(1, 2)"}, 1, KEEP))
    assert "1 run, " in said
    assert "1 of 1 run completed" in said


def test_extreme_runs_and_others_are_checked_by_turns_and_engines_are_named():
    short = replace(load("pendulum"), duration=0.1)
    keep = "final:kinetic_energy, final:dumbbell.position.y"
    swept, told = sweep(short, {"gravity.y": "uniform(-10, 10)"}, 9, keep), list[str]()
    swept = swept.check(3, ["newton_euler"], told.append)
    why = [each.why for each in swept.checks]
    assert why == ["largest final:kinetic_energy", "at random", "smallest final:kinetic_energy"]
    assert swept.report.verdict.startswith(
        "ONE ENGINE ALONE: 9 of 9 runs completed; newton_euler passes all "
    )
    assert "3 runs (2 of 3 with extreme outputs," in swept.report.verdict
    assert told[0] == "cross-check 1 of 3, unknown time left"
    assert any(
        re.fullmatch(r"cross-check 3 of 3, .* s each, .* s left: newton_euler: 0.1 s .*", one) for one in told
    )


@pytest.mark.parametrize(("runs", "checks"), [(1, 2), (2_999, 2), (3_000, 3), (10**9, 6)])
def test_more_runs_have_more_checks_up_to_a_number(runs, checks):
    assert default_count(runs) == checks


def test_shares_that_lost_runs_leave_none_of_are_named():
    short = replace(load("pendulum"), duration=0.1)
    keep = "late=when:dumbbell.linear_velocity.y < -0.475"
    swept = sweep(short, TWO, 4 * 64, keep, sampling="saltelli")
    late = swept.dataset["late"].values
    assert 0.2 < np.isnan(late).mean() < 0.8
    said = " ".join(str(swept).split())
    assert "no Sobol indices of late: too many runs without it" in said
    assert f"late: has a value in {np.isfinite(late).sum()} of 256 runs" in said


def test_numbers_that_no_run_has_are_named():
    short = replace(load("pendulum"), duration=0.1)
    swept = sweep(short, {"dumbbell.mass": "uniform(1, 2)"}, 3, "up=when:dumbbell.position.y > 0.1")
    assert "up: has no value in any run" in str(swept).splitlines()
    assert "nan" not in str(swept)


@pytest.mark.parametrize("keep", ["w=when:0/0 > 1", "w=final:0/0", "w=final:1", "w=peak:[1, 2, 3]"])
def test_expressions_without_an_output_are_refused(keep):
    with pytest.raises(CrosscheckError, match="no output of a run"):
        sweep("pendulum", {"dumbbell.mass": "uniform(1, 2)"}, 3, keep)


def test_base_samples_that_shares_are_of_are_counted():
    short = replace(load("pendulum"), duration=0.1)
    keep = "late=when:dumbbell.linear_velocity.y < -0.455"
    swept = sweep(short, TWO, 4 * 128, keep, sampling="saltelli")
    whole = np.isfinite(swept.dataset["late"].values).reshape(-1, 4).all(axis=1).sum()
    assert 64 <= whole < 128
    assert f"effects on late are those of {whole} of 128 base samples" in " ".join(str(swept).split())


def test_a_nominal_run_that_cannot_go_on_is_left_out(tmp_path):
    scene = replace(load("pendulum"), duration=0.1)
    heavy = with_parameters(scene, {"gravity.y": -1e9})
    swept = sweep(heavy, {"gravity.y": "uniform(-10, -9)"}, 3, KEEP, most_steps=50)
    assert not swept.errors
    names = {path.name for path in swept.save(tmp_path)}
    assert {"sweep.json", "sweep.rrd"} <= names


def test_extreme_runs_are_recorded_as_the_sweep_made_them(tmp_path):
    """To the last bit: one that starts elsewhere by round-off may not get past a singular configuration."""
    scene = replace(load("slider_crank"), duration=0.3)
    keep = "at():slider.position.x"
    swept = sweep(scene, {"ball.point.z": "normal(0, 1e-4)"}, 8, keep, output=tmp_path)
    _, runs, envelopes, *_ = to_record(swept.findings, swept.report)
    slider, kept = scene.mechanism.body_index("slider"), swept.dataset[keep].values
    assert len(runs) > 2
    for name in [name for name in runs if name != "nominal"]:
        of_sweep = kept[int(name.removeprefix("run "))]
        assert np.array_equal(runs[name].position[:, slider, 0], of_sweep)
        assert np.array_equal(envelopes[0].lines[name], of_sweep)
    assert np.array_equal(envelopes[0].sample, kept)


def test_runs_that_are_recorded_are_made_a_few_at_a_time(monkeypatch):
    """By all processors, in as much memory as the sweep took."""
    scene = replace(load("pendulum"), duration=0.1)
    swept = sweep(scene, {"gravity.y": "uniform(-10, -9)"}, 30, KEEP)
    of_all = to_record(swept.findings, swept.report)[2]
    made, batch = [], crosscheck.sweeps.plan.make_batch

    def noted(scene, parameters, threads, **control):
        made.append((len(parameters["gravity.y"]), threads))
        return batch(scene, parameters=parameters, threads=threads, **control)

    monkeypatch.setattr(crosscheck.sweeps.plan, "make_batch", noted)
    monkeypatch.setattr(crosscheck.sweeps.plan, "MAX_OUTPUT_BYTES", 1)
    found = to_record(swept.findings, swept.report)[2]
    assert max(count for count, _ in made) <= max(1 + MAX_RECORDED_EXTREMES, lane_count())
    assert {threads for _, threads in made} == {None}
    for one, other in zip(found, of_all, strict=True):
        assert one.sample.shape == (30, len(scene.times))
        assert np.array_equal(one.sample, other.sample)


def test_tables_are_printed_before_what_may_fail(capsys, tmp_path, monkeypatch):
    def full(swept, folder):
        raise CrosscheckError("cannot write: No space left on device")

    monkeypatch.setattr(Sweep, "save", full)
    status, out, err = run(capsys, "sweep", "pendulum", *ARGUMENTS, "--check", "0", "--output", tmp_path)
    assert (status, "No space left" in err) == (2, True)
    assert "peak:reaction_force pivot, N" in out


def test_outputs_that_a_scene_does_not_ask_for_are_kept(tmp_path):
    scene = replace(load("pendulum"), duration=0.1, outputs=frozenset())
    swept = sweep(scene, {"gravity.y": "uniform(-10, -9)"}, 3, "peak:reaction_force").check(1)
    assert swept.report.verdict.startswith("AGREE")
    swept.save(tmp_path)


def test_a_kept_number_that_engines_do_not_confirm_is_named():
    short, vary = replace(load("pendulum"), duration=1.0), {"dumbbell.mass": "uniform(1, 2)"}
    swept = sweep(short, vary, 4, "final:kinetic_energy")
    swept.results.dataset["final:kinetic_energy"][:] *= 1.001
    verdict = swept.check(2).report.verdict
    assert verdict.startswith("DISAGREE: run ")
    assert "final:kinetic_energy, " in verdict
    assert " J; 2 runs (1 with extreme outputs, 1 at random) cross-checked; " in verdict


def test_a_far_run_does_not_loosen_the_checks_of_others():
    short, vary = replace(load("pendulum"), duration=0.1), {"dumbbell.mass": "values(1, 1.1, 1.2, 1e9)"}
    swept = sweep(short, vary, None, "final:kinetic_energy", sampling="grid")
    swept.results.dataset["final:kinetic_energy"][:3] *= 1.001
    assert swept.check(4, ["pinocchio"]).report.verdict.startswith("DISAGREE")


@pytest.mark.parametrize(("elsewhere", "verdict"), [(0.0, "DISAGREE"), (1e-6, "AGREE")])
def test_numbers_may_be_off_by_what_finer_runs_change_at_any_time(monkeypatch, elsewhere, verdict):
    """Errors pass through zero, and a number may change by less than its own."""
    short, vary = replace(load("pendulum"), duration=1.0), {"dumbbell.mass": "uniform(1, 2)"}
    swept = sweep(short, vary, 2, "final:kinetic_energy")
    finer_of = crosscheck.sweeps.checks._finer_of

    def changed(*arguments):
        outputs, values = finer_of(*arguments)
        energy = outputs.stacked("kinetic_energy").copy()
        energy[:, 50] += elsewhere
        return replace(outputs, stacked=lambda name: energy), values

    monkeypatch.setattr(crosscheck.sweeps.checks, "_finer_of", changed)
    swept.results.dataset["final:kinetic_energy"][:] += 1e-6
    assert swept.check(1, ["pinocchio"]).report.verdict.startswith(verdict)


def test_an_unsettled_number_hides_no_wrong_one(monkeypatch):
    """Of a variable x is further off, but finer runs change it, and y is wrong beyond its limit."""
    short, vary = replace(load("pendulum"), duration=1.0), {"dumbbell.mass": "uniform(1, 2)"}
    swept = sweep(short, vary, 2, "final:dumbbell.position")
    finer_of = crosscheck.sweeps.checks._finer_of

    def unsettled(*arguments):
        outputs, values = finer_of(*arguments)
        values["final:dumbbell.position"][0] += 0.1
        return outputs, values

    monkeypatch.setattr(crosscheck.sweeps.checks, "_finer_of", unsettled)
    swept.results.dataset["final:dumbbell.position"][:, :2] += [1e-6, 4e-8]
    verdict = swept.check(1, ["pinocchio"]).report.verdict
    assert verdict.startswith("DISAGREE: run ")
    assert "final:dumbbell.position y" in verdict


def test_a_check_that_an_engine_was_in_the_way_of_is_made_again(monkeypatch, tmp_path):
    def fail(*arguments, **options):
        raise CrosscheckError("the engine is not there")

    short, vary = replace(load("pendulum"), duration=0.1), {"dumbbell.mass": "uniform(1, 2)"}
    swept = sweep(short, vary, 2, "final:kinetic_energy", output=tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr(crosscheck.sweeps.checks, "crosscheck", fail)
        verdict = swept.check(1).report.verdict
    assert verdict.startswith("UNFINISHED: run ")
    assert "the engine is not there" in verdict
    assert swept.check(1).report.verdict.startswith("AGREE")


def test_a_run_on_which_engines_differ_is_named(monkeypatch):
    wrong = Check("dynamics", "a fault", ("newton_euler", "mujoco"), 2.0, 1.0, "dumbbell")

    def planted(*arguments, **options):
        result = Crosscheck.__new__(Crosscheck)
        result.__dict__.update(
            scene=arguments[0],
            checks=(wrong,),
            reference_checks=(),
            left_out={},
            unfinished=(),
            trajectories={},
            engines=(),
            coverage=None,
        )
        result.__dict__["verdict"] = "DISAGREE: mujoco differs"
        return result

    monkeypatch.setattr(Crosscheck, "verdict", "DISAGREE: mujoco differs")
    monkeypatch.setattr(crosscheck.sweeps.checks, "crosscheck", planted)
    swept = sweep("pendulum", {"dumbbell.mass": "uniform(1, 2)"}, 8, "peak:reaction_force").check(1)
    assert swept.report.judged.verdict == "fails"
    assert swept.report.verdict.startswith("DISAGREE: run ")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("--vary", "dumbbell.mass", "--runs", "3", "--keep", KEEP),
            "not of the form NAME=DISTRIBUTION",
        ),
        (("--vary", VARY, "--vary", VARY, "--runs", "3", "--keep", KEEP), "given twice"),
        (("--vary", VARY, "--keep", KEEP), "needs a number of runs (--runs N)"),
        (("--vary", VARY, "--runs", "-3", "--keep", KEEP), "runs is -3"),
        (("--vary", "dumbell.mass=uniform(1, 2)", "--runs", "3", "--keep", KEEP), "unknown parameter"),
        (("--vary", "gravity=uniform(1, 2)", "--runs", "3", "--keep", KEEP), "gravity: it has 3 numbers"),
        (("--vary", VARY, "--runs", "3", "--keep", "peak:forces"), "unknown output 'forces'"),
        (("--vary", VARY, "--runs", "3", "--keep", KEEP, "--rtol", "0"), "rtol is 0.0"),
        (("--vary", VARY, "--runs", "4", "--keep", KEEP, "--sampling", "saltelli"), "3 or 6"),
        (("--vary", VARY, "--runs", "3", "--keep", KEEP, "--cluster", "tcp://127.0.0.1:1"), "cannot reach"),
        (("--vary", VARY, "--runs", "3", "--keep", KEEP, "--cluster", "nowhere"), "cannot reach"),
    ],
)
def test_bad_input_is_one_line(capsys, tmp_path, monkeypatch, arguments, words):
    monkeypatch.setattr(crosscheck.sweeps.execute, "CONNECT_TIMEOUT_S", 1.0)
    status, out, err = run(capsys, "sweep", "pendulum", *arguments, "--output", tmp_path / "out")
    assert (status, out) == (2, "")
    assert words in " ".join(err.split())
    assert len(err.splitlines()) == 1
    assert not list(tmp_path.rglob("*.zarr"))


@pytest.mark.parametrize("missing", ["xarray", "zarr"])
def test_a_missing_group_is_named(capsys, tmp_path, monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    status, _, err = run(capsys, "sweep", "pendulum", *ARGUMENTS, "--output", tmp_path / "out")
    assert status == 2
    assert f"{missing} is not installed" in err
    assert f"'{DISTRIBUTION}[sweep]'" in err
