"""The benchmark of whole runs: what it measures, what it makes of it, and how it refuses."""

from __future__ import annotations

import dataclasses
import json
import re
import signal
import time
from functools import partial

import numpy as np
import pytest
from command_line import run
from mechanisms import slider_tree, spinning_top
from pictures import STALE, digest, made_from, words

import newton_euler
from crosscheck.engines.benchmarks import Ladder, Model, Run, poses_only
from crosscheck.engines.mujoco.benchmark import intervals
from crosscheck.engines.registry import ENGINES
from crosscheck.report.page import write_report
from crosscheck.report.table import Table
from crosscheck.studies.benchmark import reference as benchmark_reference
from crosscheck.studies.benchmark import work_precision
from crosscheck.studies.benchmark.reference import Reference, pose_errors, reference
from crosscheck.studies.benchmark.report import Benchmark, data, parts, verdict
from crosscheck.studies.benchmark.timing import machine
from crosscheck.studies.benchmark.work_precision import Measurement, WorkPrecision
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import time_limit
from newton_euler.model.euler_parameters import from_rotation_vector, product

POSES = (np.zeros((2, 1, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1, 1)))


def made_up(engine, name, error, seconds):
    """A measurement whose angle is a tenth as far off as its position."""
    return Measurement(engine, "method", name, error, 0.1 * error, 100, 2.0 * seconds, (seconds,) * 3)


MADE_UP = (
    made_up("newton_euler", "coarse", 1e-4, 1e-4),
    made_up("newton_euler", "fine", 1e-7, 2e-4),
    made_up("newton_euler", "worse than fine", 1e-6, 3e-4),
    made_up("mujoco", "coarse", 1e-5, 5e-3),
    made_up("pinocchio", "coarse", 1e-3, 5e-5),
    made_up("pinocchio", "fine", 1e-10, 4e-3),
)


def result(scene, measurements=MADE_UP, uncertainty=1e-12):
    """A benchmark that nobody ran."""
    differences = {"another": (0.5 * uncertainty, uncertainty)}
    against = Reference("made up", POSES, differences, {"third": "no reason"})
    measured = WorkPrecision(list(measurements), [], {"mujoco: method": "its last setting"})
    return Benchmark("tracker (leg_inertia=aligned)", scene, against, measured, list(ENGINES))


# Measuring


def test_errors_of_poses_are_distances_and_angles_whatever_the_sign_of_a_quaternion():
    angle = 1e-5
    position = np.zeros((3, 2, 3))
    quaternion = np.tile([0.5, 0.5, 0.5, 0.5], (3, 2, 1))
    moved, turned = position.copy(), -quaternion
    moved[1, 1] = [3e-6, 0.0, -4e-6]
    turned[2, 0] = product(from_rotation_vector(np.array([0.0, angle, 0.0])), quaternion[2, 0])
    errors = pose_errors((moved, turned), (position, quaternion))
    # round-off of quaternions of norm 1, twice
    np.testing.assert_allclose(errors, [5e-6, angle], rtol=0.0, atol=1e-15)


def off_by(error, seconds):
    """A run that is `error` off and takes `seconds` by its own clock."""
    return Run(seconds, 7, lambda: (POSES[0] + [error, 0.0, 0.0], POSES[1]))


def measured_of(**runs):
    """Measure one ladder of runs by name, and note the names as they are run."""
    calls, names = [], list(runs)

    def call(options):
        calls.append(options["name"])
        found = runs[options["name"]]
        return found() if callable(found) and not isinstance(found, Run) else found

    ladder = Ladder("m", lambda n: (names[n], {"name": names[n]}), range(len(names)), {})
    engines = {"engine": {"model": lambda: Model((ladder,), call)}}
    return work_precision.measure(engines, POSES, lambda message: None), calls


def refuse(reason, *_):
    raise CrosscheckError(reason)


def test_settings_run_once_for_their_error_and_then_take_turns():
    measured, calls = measured_of(a=off_by(1e-3, 1e-3), b=off_by(1e-6, 0.1))
    sample = round(work_precision.REPEAT_TIME / 1e-3) * ["a"]  # short runs follow one another
    # seven repeats of the quick one, three of the slow one spread over them
    turns = [[*sample, "b"] if turn in (0, 3, 5) else sample for turn in range(7)]
    assert calls == [*"ab", *(name for turn in turns for name in turn)]
    assert [len(m.times) for m in measured.measurements] == [7, work_precision.MIN_REPEATS]
    assert [m.error for m in measured.measurements] == pytest.approx([1e-3, 1e-6], rel=1e-12)
    assert measured.measurements[0].evaluations == 7
    assert measured.ended == {"engine: m": "its last setting"}


def work_past_the_limit():
    end = time.process_time() + 30.0
    while time.process_time() < end:
        pass
    raise AssertionError("nobody gave it up")


def test_a_ladder_ends_after_a_run_that_takes_too_long_and_says_so(monkeypatch):
    monkeypatch.setattr(work_precision, "RUN_TIME_LIMIT", 0.05)
    monkeypatch.setattr(work_precision, "LADDER_TIME_LIMIT", 0.01)
    measured, calls = measured_of(hangs=work_past_the_limit, never=off_by(1e-6, 1e-3))
    assert not measured.measurements
    assert calls == ["hangs"]
    assert [f.reason for f in measured.failures] == ["not finished after 0.05 s of processor time"]
    assert measured.ended["engine: m"].endswith(" s, more than 0.01 s")
    monkeypatch.setattr(work_precision, "ENGINE_TIME_LIMIT", 0.0)
    measured, calls = measured_of(never=off_by(1e-3, 1e-3))
    assert (calls, measured.measurements, set(measured.ended)) == ([], [], {"engine: m"})


def test_native_runs_are_given_up_too(tracker):
    endless = newton_euler.compile_scene(dataclasses.replace(poses_only(tracker), duration=1e4))
    with pytest.raises(CrosscheckError, match=r"not finished after 0\.2 s"), time_limit(0.2):
        endless.simulate(integrator="RK4", step=1e-5, most_steps=10**9)


def test_an_interrupt_while_python_parses_is_understood():
    """CPython 3.11 makes a SystemError of it."""

    def parse():
        try:
            while True:
                pass
        except KeyboardInterrupt:
            raise SystemError("AST constructor recursion depth mismatch") from None

    with pytest.raises(CrosscheckError, match="not finished"), time_limit(0.01):
        parse()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_that_python_loses_is_repeated():
    """Python goes on after whatever is raised while it frees an object."""

    class Deaf:
        def __del__(self):
            work_past_the_limit()

    def work():
        Deaf()
        work_past_the_limit()

    with pytest.raises(CrosscheckError, match="not finished"), time_limit(0.01):
        work()


def test_interrupts_from_the_keyboard_stay_what_they_are():
    before = signal.getsignal(signal.SIGPROF)
    with pytest.raises(KeyboardInterrupt), time_limit(30.0):
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGPROF) is before
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)


def test_what_cannot_run_is_listed_with_its_reason_and_the_rest_goes_on():
    measured, _ = measured_of(
        refused=partial(refuse, "no such luck"), diverges=off_by(np.nan, 1e-3), runs=off_by(1e-3, 1e-3)
    )
    assert [m.name for m in measured.measurements] == ["m, runs"]
    assert [(f.name, f.reason) for f in measured.failures] == [
        ("m, refused", "no such luck"),
        ("m, diverges", "its motion is not finite"),
    ]
    broken = {"engine": {"broken": partial(refuse, "will not load")}}
    measured = work_precision.measure(broken, POSES, lambda message: None)
    assert [(f.name, f.reason) for f in measured.failures] == [("broken", "will not load")]


# What is made of it


def test_the_cheapest_setting_is_the_fastest_that_is_exact_enough(tracker):
    found = result(tracker)
    assert found.fastest_setting("newton_euler", 1e-4).name == "coarse"
    assert found.fastest_setting("newton_euler", 1e-5).name == "fine"
    assert found.fastest_setting("mujoco", 1e-6) is None
    assert [m.name for m in found.pareto_optimal("newton_euler")] == ["coarse", "fine"]
    # none is more exact than the reference is known
    assert result(tracker, uncertainty=1e-9).fastest_setting("pinocchio", 1e-9).name == "fine"
    assert result(tracker, uncertainty=2e-9).fastest_setting("pinocchio", 1e-9) is None


def test_the_verdict_in_words(tracker):
    own, mujoco, pinocchio = verdict(result(tracker), 1e-5).split("; ")
    assert re.search(r"1e-05.* newton_euler .*200 us", own)
    assert re.search(r"mujoco .*5 ms.* 25 ", mujoco)
    assert re.search(r"pinocchio .*4 ms.* 20 ", pinocchio)
    _, mujoco, _ = verdict(result(tracker), 1e-6).split("; ")
    assert re.search("mujoco .*not reach", mujoco)
    _, mujoco, _ = verdict(result(tracker, [m for m in MADE_UP if m.engine != "mujoco"]), 1e-5).split("; ")
    assert re.search("mujoco cannot run", mujoco)
    unresolved = verdict(result(tracker, uncertainty=2e-11), 1e-11)
    assert re.search(r"1e-11.* 2\.0e-11", unresolved)


def test_tables_show_errors_below_the_uncertainty_as_such(tracker):
    times, settings = (
        part.rows for part in parts(result(tracker, uncertainty=2e-10)) if isinstance(part, Table)
    )
    assert [row[1] for row in settings[-2:]] == ["1.0e-03", "<= 2.0e-10"]
    assert times[2] == ["1e-05", "0.2", "0%", "5", "0%", "25", "4", "0%", "20"]
    assert times[3][3:6] == ["-", "", ""]
    assert len(times) == 9


def test_pictures_are_of_what_is_printed(tracker, tmp_path, capsys, monkeypatch):
    found = result(tracker, [*MADE_UP, made_up("mujoco", "fine", 1e-8, 5e-3)])
    monkeypatch.setattr("crosscheck.studies.benchmark.run.reference", lambda *_: found.reference)
    monkeypatch.setattr("crosscheck.studies.benchmark.run.measure", lambda *_: found.measured)
    where = {"processor": "one", "cores": 2, "load": 0.0}
    monkeypatch.setattr("crosscheck.studies.benchmark.run.machine", lambda engines: where)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    content = digest(words(run(capsys, "bench", "tracker")[1]))
    for picture in ("bench.svg", "work_precision.png"):
        assert made_from(picture) == content, f"{picture} {STALE}"


def test_a_benchmark_is_written_as_json_and_picture(tracker, tmp_path, capsys, monkeypatch):
    content = data(result(tracker))
    assert [entry["error_position"] for entry in content["measurements"]] == [m.error for m in MADE_UP]
    assert content["reference"]["missing"] == {"third": "no reason"}
    monkeypatch.setattr("crosscheck.studies.benchmark.run.reference", lambda *_: result(tracker).reference)
    monkeypatch.setattr("crosscheck.studies.benchmark.run.measure", lambda *_: result(tracker).measured)
    status, out, _ = run(capsys, "bench", "tracker", "--error", "1e-5", "--output", tmp_path / "new")
    assert status == 0
    assert out.splitlines()[:9] == [
        "bench tracker",
        "to an error of 1e-05 (m, rad): newton_euler takes 200 us; mujoco takes 5 ms, 25 times as long; "
        "pinocchio takes 4 ms, 20 times as long",
        "",
        "ms for an error of  1e-03  1e-05  1e-07  1e-09  1e-11",
        "newton_euler          0.1    0.2    0.2      -      -",
        "mujoco                  5      5      -      -      -",
        "pinocchio            0.05      4      4      4      -",
        "",
        "newton_euler for 1e-05: fine",
    ]
    every = run(capsys, "bench", "tracker", "--error", "1e-5", "--output", tmp_path / "new", "-v")[1]
    assert "Pareto" in every
    starts = {path.name: path.read_bytes()[:4] for path in (tmp_path / "new").iterdir()}
    assert starts == {"bench.json": b'{\n "', "work_precision.png": b"\x89PNG"}
    page = write_report(tmp_path / "new", lambda _: None).path.read_text()
    assert "mujoco takes 5 ms, 25 times as long" in page
    assert 'alt="Run time against error of all settings; lower left is better"' in page


def test_the_record_of_the_machine_names_processor_cores_and_versions():
    found = machine(ENGINES.values())
    assert found["processor"]
    assert found["cores"] >= 1
    assert {"numpy", "mujoco", "pin", "scipy"} <= found["versions"].keys()


# Engines


@pytest.fixture(scope="module")
def short(tracker):
    return poses_only(dataclasses.replace(tracker, duration=0.045))  # a last output out of period


@pytest.mark.slow
def test_every_engine_and_setting_on_a_short_scene(short, monkeypatch):
    monkeypatch.setattr(work_precision, "MIN_REPEATS", 1)
    monkeypatch.setattr(work_precision, "SETTING_TIME", 0.0)
    monkeypatch.setattr(work_precision, "REPEAT_TIME", 0.0)
    against = reference(short, lambda message: None)
    assert against.name.startswith("Pinocchio")
    assert len(against.differences) == 3
    assert not against.missing
    # a few hundred round-off errors of angles of order 1
    assert against.uncertainty < 1e-13
    finest = {}
    for engine, each in ENGINES.items():
        models = each.benchmarks().models(short)
        measured = work_precision.measure({engine: models}, against.poses, lambda message: None)
        assert not measured.failures
        finest[engine] = min(m.error for m in measured.measurements)
        methods = {m.method for m in measured.measurements}
        for method in methods:
            errors = [m.error for m in measured.measurements if m.method == method]
            assert errors[-1] < max(errors[0], 1e-13), method
    # MuJoCo's constraints are soft, with a time constant of two steps of 20 us
    assert finest["mujoco"] < 1e-9
    assert finest["newton_euler"] < 1e-13
    assert finest["pinocchio"] < 1e-13


@pytest.mark.parametrize("make", [spinning_top, slider_tree])
def test_pinocchio_runs_scenes_with_quaternions(make):
    scene = poses_only(dataclasses.replace(make(), duration=0.1))
    own = newton_euler.simulate(scene, rtol=1e-12, atol=1e-14)
    model = ENGINES["pinocchio"].benchmarks().models(scene)["constraintDynamics, alpha 10"]()
    found = model.run({"rtol": 1e-10, "atol": 1e-12})
    # a few dozen steps, each off by its tolerance
    assert max(pose_errors(found.poses(), (own.position, own.quaternion))) < 1e-8


def test_a_scene_with_a_sampled_controller_is_refused(tracker):
    sampled = newton_euler.Sampled("slide_12", lambda time, x, x_rate: 0.0, 0.01)
    scene = dataclasses.replace(tracker, control=(sampled,))
    with pytest.raises(CrosscheckError, match="sampled controller"):
        poses_only(scene)


def test_a_reference_comes_from_looser_tolerances_where_the_tight_one_fails(short, monkeypatch):
    candidates = benchmark_reference._candidates

    def only_loosely(scene, rtol):
        found = candidates(scene, rtol)
        return {name: partial(refuse, "too tight") for name in found} if rtol < 1e-12 else found

    monkeypatch.setattr(benchmark_reference, "_candidates", only_loosely)
    against = reference(short, lambda message: None)
    assert against.name == "Pinocchio, DOP853 rtol 1e-11"
    assert set(against.missing.values()) == {"too tight"}
    # 1e-11 an error of each step, a handful of steps
    assert against.uncertainty < 1e-9


@pytest.mark.parametrize("integrator", ["RK4", "Euler", "implicitfast"])
def test_mujoco_delivers_poses_of_its_own_outputs(short, integrator):
    """A last output out of period, and poses of each output, not of the step before."""
    import mjcf
    from mjcf.benchmark_kernels import Stepper, compiled

    stepper = Stepper(compiled(short), integrator, intervals(short.times), 2, 1.0)
    stepper.reset()
    stepper.run()
    same = dataclasses.replace(short, duration=0.04)
    own = mjcf.simulate(same, timestep=0.005, integrator=integrator)
    found = [array[: len(same.times)] for array in stepper.poses()]
    # the same arithmetic in another order of calls; a step before is 1e-3 off
    assert max(pose_errors(tuple(found), (own.position, own.quaternion))) < 1e-12


# Command line


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "unknown scene 'nowhere'"),
        (["tracker", "--set", "wheels=4"], "unknown option 'wheels'"),
        (["tracker", "--error", "-1"], "--error is -1"),
        (["tracker", "--error", "nan"], "--error is nan"),
        (["--rhs", "nowhere"], "unknown scene 'nowhere'"),
        (["--rhs", "--batch", "10"], "--rhs and --batch are different benchmarks; choose one"),
        (["--rhs", "--sensitivities"], "choose one"),
        (["--batch", "1"], "--batch"),
        (["--batch", "10", "--error", "0"], "--error is 0"),
    ],
)
def test_bad_usage_is_one_line(capsys, tmp_path, arguments, message):
    status, out, err = run(capsys, "bench", *arguments, "--output", tmp_path / "results")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("crosscheck: error: ")
    assert message in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("flags", [[], ["--rhs"], ["--batch", "9"], ["--sensitivities"]])
def test_a_folder_that_cannot_be_written_is_found_before_the_measurement(capsys, tmp_path, flags):
    (tmp_path / "file").write_text("in the way")
    status, out, err = run(capsys, "bench", *flags, "--output", tmp_path / "file" / "folder")
    assert (status, out) == (2, "")
    assert err.startswith("crosscheck: error: cannot write ")


def test_derivatives_are_timed_in_runs(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("crosscheck.studies.benchmark.sensitivities.REPEATS", 2)
    status, out, _ = run(capsys, "bench", "slider_crank", "--sensitivities", "--output", tmp_path)
    assert status == 0
    assert "joint points: 1" in out
    costs = json.loads((tmp_path / "sensitivities.json").read_text())["sensitivities"]
    kinds = [(cost["parameters"], cost["kind"]) for cost in costs]
    assert kinds == [(0, ""), (1, "masses"), (2, "masses"), (1, "joint points")]  # of three bodies
    assert all(len(cost["times"]) == 2 and min(cost["times"]) > 0.0 for cost in costs)
    assert "runs per parameter" in write_report(tmp_path, lambda _: None).path.read_text()
