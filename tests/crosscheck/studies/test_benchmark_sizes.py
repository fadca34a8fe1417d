"""Right-hand sides, sizes and batches: what their benchmarks measure and make of it."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import newton_euler
from crosscheck.engines.benchmarks import CompletedBatch, Ladder, poses_only
from crosscheck.engines.mujoco.benchmark import Batch, intervals
from crosscheck.engines.newton_euler.benchmark import Lanes, Scalar
from crosscheck.engines.registry import ENGINES
from crosscheck.studies.benchmark import batch, rhs
from crosscheck.studies.benchmark import reference as benchmark_reference
from crosscheck.studies.benchmark.batch_settings import fastest_setting
from crosscheck.studies.benchmark.reference import batch_references, pose_errors
from crosscheck.studies.benchmark.rhs import Timing, fastest_other, time_right_hand_sides
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.euler_parameters import from_rotation_vector
from newton_euler.model.trajectory import IntegrationError

ALL = tuple(ENGINES.values())


@pytest.fixture(scope="module")
def short(tracker):
    return poses_only(dataclasses.replace(tracker, duration=0.04))


# Right-hand sides

OWN, OTHER = "newton_euler relative", "mujoco mj_forward"


def timing(way, seconds, operations=None):
    return Timing(way, operations, (seconds,) * 2, 0.4)


TIMINGS = (
    timing(OWN, 3e-7, 1800),
    Timing("newton_euler cartesian", reason="too large"),
    timing(OTHER, 6e-6),
    timing("pinocchio constraintDynamics", 5e-6),
)


def test_right_hand_sides_are_compared_with_the_fastest_of_the_others():
    assert fastest_other(TIMINGS).way == "pinocchio constraintDynamics"
    table, lines = rhs.parts(TIMINGS)
    assert lines.lines == [
        "ratio: to pinocchio constraintDynamics, the fastest of the others",
        "load: in a fresh process, without a cache",
        "newton_euler cartesian cannot run the scene: too large",
    ]
    assert table.rows[0] == ["newton_euler relative", "1800", "0.3", "0%", "0.06", "0.40"]
    assert set(table.rows[1][1:]) == {"-"}


@pytest.mark.slow
def test_right_hand_sides_are_timed_here_and_loaded_in_processes_of_their_own(monkeypatch, short):
    wanted = [OTHER, "pinocchio constraintDynamics"]
    monkeypatch.setattr(rhs, "BATCH_DURATION", 1e-4)
    timings = time_right_hand_sides(short, ALL, lambda message: None, wanted)
    assert [t.way for t in timings] == wanted
    for t in timings:
        assert not t.reason
        assert len(t.times) == rhs.MAX_BATCHES
        assert t.load > 0.0


def test_a_process_that_fails_says_why(tracker):
    driven = newton_euler.PrescribedMotion("slide_12", newton_euler.Polynomial((0.0, 1.0)))
    (found,) = time_right_hand_sides(
        dataclasses.replace(tracker, control=(), motions=(driven,)), ALL, print, [OTHER]
    )
    assert "MuJoCo has no time-dependent equality" in found.reason
    assert found.times == ()


# Batches


def test_outputs_are_as_rare_as_memory_needs(tracker):
    assert batch.with_fewer_outputs(tracker, 10).times == pytest.approx(tracker.times)
    rare = batch.with_fewer_outputs(tracker, 10_000)
    size = 10_000 * len(rare.times) * len(tracker.mechanism.bodies) * 7 * 8
    # one output more would be too much
    assert 0.9 * batch.MAX_POSE_BYTES < size <= batch.MAX_POSE_BYTES
    assert intervals(rare.times) == [(len(rare.times) - 1, pytest.approx(rare.output_period))]
    with pytest.raises(CrosscheckError, match="--batch 1000000"):
        batch.with_fewer_outputs(tracker, 1_000_000)


def test_rollouts_are_the_runs_one_by_one(short, tracker_states):
    from mjcf.benchmark_kernels import Rollout, Stepper, compiled, physics_states

    system = compiled(short)
    rollout = Rollout(system, "RK4", 2, 1.0, 2)
    states = tracker_states[:25]
    coordinates = [system.coordinates(state) for state in states]
    found = rollout(physics_states(system, *map(np.array, zip(*coordinates, strict=True))))
    for k in (0, 24):
        single = compiled(dataclasses.replace(short, initial_state=states[k]))
        stepper = Stepper(single, "RK4", intervals(short.times), 2, 1.0)
        stepper.reset()
        stepper.run()
        # round-off of eight steps
        assert max(pose_errors(rollout.poses(found[k]), stepper.poses())) < 1e-13


class MadeUp:
    """An engine whose n-th settings are off by a known amount, and take a known time."""

    name = "made up"

    def __init__(self, methods) -> None:
        """`methods` are functions of n and the largest n."""
        self._methods, self.tried = methods, []

    def ladders(self):
        for k, (make, most) in enumerate(self._methods):
            finer = lambda n, make=make: (f"number {n}", {"n": n} | make(n))  # noqa: E731
            yield Ladder(f"method {k}", finer, range(1, most + 1), {})

    def run(self, options, states, threads):
        self.tried.append((options["n"], threads))
        if options["error"] == np.inf:
            raise IntegrationError(0.5, "made up")
        turn = from_rotation_vector(np.array([0.0, 0.0, options["error"]]))
        worst = np.zeros((1, 1, 3)), turn[None, None]
        return CompletedBatch(options["seconds"], 0.0, lambda: [EXACT] * (len(states) - 1) + [worst])


EXACT = np.zeros((1, 1, 3)), np.array([[[1.0, 0.0, 0.0, 0.0]]])


def choice(methods, error):
    engine = MadeUp(methods)
    return fastest_setting(engine, [None] * 3, [EXACT] * 3, error, lambda message: None), engine.tried


def test_the_setting_is_the_coarsest_that_the_worst_of_the_sample_reaches_the_error_with():
    # 1/n^2 <= 1e-2 from n = 10 on; 8 fails and 16 does not, so 12, 10, 9 lie between
    found, tried = choice([(lambda n: {"error": n**-2.0, "seconds": 1e-3 * n}, 100)], 1.0001e-2)
    assert found.options["n"] == 10
    assert found.error == pytest.approx(1e-2)
    assert list(dict.fromkeys(n for n, _ in tried)) == [1, 2, 4, 8, 16, 12, 10, 9]
    assert {threads for _, threads in tried} == {1}


def test_the_setting_is_the_quickest_of_all_methods():
    def method(needed, seconds):
        return lambda n: {"error": 1e-9 if n >= needed else np.inf, "seconds": seconds}, 8

    slower = lambda n: {"error": 1e-9 if n >= 4 else 1.0, "seconds": 0.3}, 8
    found, tried = choice([method(1, 0.5), method(2, 0.2), slower], 1e-6)
    assert (found.name, found.seconds) == ("method 1, number 2", 0.2)
    assert tried[-1] == (1, 1)  # the last was slower already where it did not reach the error
    with pytest.raises(CrosscheckError, match=r"made up .* 1e-10 .* 1\.0e-09"):
        choice([method(1, 0.5)], 1e-10)


def quick_batch(monkeypatch, tracker, error):
    """Four runs at one setting of each engine."""
    monkeypatch.setattr(batch, "TIME_LIMIT", 0.5)
    monkeypatch.setattr(batch, "SAMPLE_RUNS", 2)
    monkeypatch.setattr(batch, "BATCH_REPEATS", 2)
    own_setting = {"formulation": "relative", "stabilization": "projection", "rtol": 1e-8}
    other_setting = {"integrator": "RK4", "number": 2, "damping_ratio": 0.6}
    for engine, setting in ((Lanes, own_setting), (Batch, other_setting)):
        ladder = Ladder("method", lambda n: ("setting", {}), [1], setting)
        monkeypatch.setattr(engine, "ladders", lambda self, ladder=ladder: iter([ladder]))
    second = dataclasses.replace(tracker, duration=1.0)
    return batch.benchmark_batch(second, ALL, 4, error, lambda message: None)


@pytest.mark.slow
def test_a_batch_is_measured_for_every_engine(monkeypatch, tracker):
    result = quick_batch(monkeypatch, tracker, 1e-5)
    counts = batch.thread_counts()
    own, other = result.rates[: len(counts)], result.rates[len(counts) : -1]
    assert [(rate.engine, rate.threads, rate.runs) for rate in own] == [
        ("newton_euler", n, 4) for n in counts
    ]
    assert {rate.engine for rate in other} == {"mujoco"}
    # an order above the tolerances; MuJoCo RK4 at 5 ms is 3e-6 off
    assert own[0].error < 1e-6
    assert own[0].error < other[0].error < 1e-5
    assert result.uncertainty < 1e-9
    table, lines = batch.parts(result)
    assert (result.rates[-1].engine, result.rates[-1].threads) == (Scalar.name, 1)
    assert len(table.rows) == 2 * len(counts) + 1
    assert lines.lines[2].startswith("newton_euler: method, setting (error ")
    for rate in result.rates:
        assert len(rate.times) == 2
        assert rate.per_second == rate.runs / np.median(rate.times)


@pytest.mark.slow
def test_an_engine_that_does_not_reach_the_error_takes_no_part(monkeypatch, tracker):
    result = quick_batch(monkeypatch, tracker, 1e-7)
    assert {rate.engine for rate in result.rates} == {Lanes.name, Scalar.name}
    _, lines = batch.parts(result)
    mujoco, pinocchio = lines.lines[-2:]
    assert re.match(r"mujoco.*1e-07.*2 runs", mujoco)
    assert pinocchio.startswith("pinocchio is missing")


@pytest.mark.parametrize(
    ("limit", "error", "reason"),
    [(1e-3, 1e-6, r".*0\.001 s"), pytest.param(10.0, 1e-20, r"is known to .* only", marks=pytest.mark.slow)],
)
def test_a_batch_without_a_reference_is_refused(short, tracker_states, monkeypatch, limit, error, reason):
    monkeypatch.setattr(benchmark_reference, "RUN_TIME_LIMIT", limit)
    with pytest.raises(CrosscheckError, match=rf"none of 1 random runs has a reference.*{reason}"):
        batch_references(short, tracker_states[:1], error, lambda message: None)
