"""Right-hand sides, sizes and batches: what their benchmarks measure and make of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import newton_euler
from crosscheck.errors import CrosscheckError
from crosscheck.studies.benchmark import batch, rhs, scaling
from crosscheck.studies.benchmark import reference as benchmark_reference
from crosscheck.studies.benchmark.batch import cheapest, identical, references
from crosscheck.studies.benchmark.engines import Done, Method, MuJoCo, Own
from crosscheck.studies.benchmark.ladders import intervals, poses_only
from crosscheck.studies.benchmark.reference import pose_errors
from crosscheck.studies.benchmark.rhs import (
    Timing,
    fastest_other,
    rhs_data,
    rhs_report,
    time_right_hand_sides,
)
from crosscheck.studies.benchmark.timing import machine
from newton_euler.model.euler_parameters import from_rotation_vector
from newton_euler.model.trajectory import IntegrationError


@pytest.fixture(scope="module")
def short(tracker):
    return poses_only(dataclasses.replace(tracker, duration=0.04))


# Right-hand sides

TIMINGS = (
    Timing("newton_euler", "relative", 1800, (3e-7, 3e-7), 0.4, 120_000_000, 80_000_000),
    Timing("newton_euler", "cartesian", reason="too large"),
    Timing("mujoco", "mj_forward", None, (6e-6, 6e-6), 0.1, 90_000_000, 40_000_000),
    Timing("pinocchio", "constraintDynamics", None, (5e-6, 5e-6), 0.1, 90_000_000, 40_000_000),
)


def test_right_hand_sides_are_compared_with_the_fastest_of_the_others():
    assert fastest_other(TIMINGS).way == "constraintDynamics"
    table, lines = rhs_report(TIMINGS).parts
    assert lines.lines == [
        "newton_euler (relative) takes 0.06 times as long as pinocchio (constraintDynamics)",
        "newton_euler (cartesian) cannot run the scene: too large",
    ]
    assert table.rows[0] == [
        *("newton_euler", "relative", "1800", "0.3", "0.3 to 0.3", "0.06", "0.40", "120", "80")
    ]
    assert set(table.rows[1][2:]) == {"-"}
    assert rhs_data("tracker", {}, TIMINGS)["right_hand_sides"][0]["memory"] == 120_000_000


def test_right_hand_sides_are_timed_here_and_weighed_in_processes_of_their_own(monkeypatch):
    wanted = {("mujoco", "mj_forward"), ("pinocchio", "constraintDynamics")}
    ways = {way: make for way, make in rhs.WAYS.items() if way in wanted}
    monkeypatch.setattr(rhs, "WAYS", ways)
    monkeypatch.setattr(rhs, "BATCH", 1e-4)
    timings = time_right_hand_sides("tracker", {}, lambda message: None)
    assert {(t.engine, t.way) for t in timings} == wanted
    for t in timings:
        assert not t.reason
        assert len(t.times) == rhs.ROUNDS
        assert 0 < t.own_memory < t.memory


def test_a_process_that_fails_says_why():
    found = rhs._probe(("mujoco", "mj_forward"), "nowhere.yaml", {}, 60.0)
    assert "nowhere.yaml" in found.reason
    assert found.times == ()


# Sizes


def timing(way, seconds):
    return Timing(*way, 100, (seconds,) * 2, 0.1, 120_000_000, 80_000_000)


OWN, OTHER = ("newton_euler", "relative"), ("mujoco", "mj_forward")

SIZES = scaling.Scaling(
    "chain",
    {},
    machine(),
    {
        1: (timing(OWN, 1e-6), timing(OTHER, 4e-6)),
        10: (timing(OWN, 1e-5), timing(OTHER, 4e-4)),
        100: (timing(OWN, 1e-3), Timing(*OTHER, reason="too large")),
    },
)


def test_sizes_as_table_words_and_json():
    table, lines = scaling.scaling_report(SIZES).parts
    assert table.rows[0][2:6] == ["1", "10", "1000", "1.00, 2.00"]
    assert table.rows[1][2:6] == ["4", "400", "-", "2.00"]
    words = lines.lines
    assert "newton_euler (relative) grows with exponents 1.00 from 1 to 10, 2.00 from 10 to 100" in words
    assert "N = 10: newton_euler (relative) takes 0.025 times as long as mujoco (mj_forward)" in words
    assert "N = 100: mujoco (mj_forward) cannot run: too large" in words
    assert scaling.scaling_data(SIZES)["sizes"][100][1]["reason"] == "too large"


def test_what_fails_at_a_size_is_not_tried_at_larger_ones(monkeypatch):
    asked = []

    def made_up_timings(source, options, progress, ways, limit):
        asked.append((options, ways))
        return [timing(OWN, 1e-6), Timing(*OTHER, reason="too large")]

    monkeypatch.setattr(scaling, "time_right_hand_sides", made_up_timings)
    monkeypatch.setattr(scaling, "SIZES", (1, 10))
    scaling.measure_sizes("chain", {}, lambda message: None)
    assert asked == [({"N": "1"}, list(scaling.WAYS)), ({"N": "10"}, [OWN])]


# Batches


def test_outputs_are_as_rare_as_memory_needs(tracker):
    assert batch.rarer(tracker, 10).times == pytest.approx(tracker.times)
    rare = batch.rarer(tracker, 10_000)
    size = 10_000 * len(rare.times) * len(tracker.mechanism.bodies) * 7 * 8
    # one output more would be too much
    assert 0.9 * batch.MOST < size <= batch.MOST
    assert intervals(rare.times) == [(len(rare.times) - 1, pytest.approx(rare.output_period))]
    with pytest.raises(CrosscheckError, match="--batch 1000000"):
        batch.rarer(tracker, 1_000_000)


def test_batches_that_differ_in_one_bit_are_not_identical(short, tracker_states):
    one, other = (newton_euler.simulate_batch(short, tracker_states[:3], threads=2) for _ in range(2))
    assert identical(one, other)
    other._results[1, 2] = np.nextafter(other._results[1, 2], np.inf)
    assert not identical(one, other)


def test_rollouts_are_the_runs_one_by_one(short, tracker_states):
    from mjcf.tight import Rollout, Stepper, compiled

    system = compiled(short)
    rollout = Rollout(system, "RK4", 2, 1.0, 2)
    states = tracker_states[:25]
    starts = np.array([rollout.start(*system.coordinates(state)) for state in states])
    found = rollout(starts)
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

    def methods(self):
        for k, (make, most) in enumerate(self._methods):
            yield Method(lambda n, k=k, make=make: (f"method {k}, number {n}", {"n": n} | make(n)), most)

    def run(self, options, states, threads):
        self.tried.append((options["n"], threads))
        if options["error"] == np.inf:
            raise IntegrationError(0.5, "made up")
        turn = from_rotation_vector(np.array([0.0, 0.0, options["error"]]))
        worst = np.zeros((1, 1, 3)), turn[None, None]
        return Done(np.inf, options["seconds"], 0.0, lambda: [EXACT] * (len(states) - 1) + [worst])


EXACT = np.zeros((1, 1, 3)), np.array([[[1.0, 0.0, 0.0, 0.0]]])


def choice(methods, error):
    engine = MadeUp(methods)
    return cheapest(engine, [None] * 3, [EXACT] * 3, error, lambda message: None), engine.tried


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
    with pytest.raises(
        CrosscheckError, match=r"made up does not reach an error of 1e-10 .* least is 1\.0e-09"
    ):
        choice([method(1, 0.5)], 1e-10)


def test_a_batch_is_measured_for_both_engines(monkeypatch):
    monkeypatch.setattr(batch, "LIMIT", 0.5)
    monkeypatch.setattr(batch, "SAMPLE", 2)
    monkeypatch.setattr(batch, "REPEATS", 2)
    own_setting = {"formulation": "relative", "stabilization": "projection", "rtol": 1e-8}
    other_setting = {"integrator": "RK4", "number": 2, "damping_ratio": 0.6}
    monkeypatch.setattr(Own, "methods", lambda self: iter([Method(lambda n: ("a", own_setting), 1)]))
    monkeypatch.setattr(MuJoCo, "methods", lambda self: iter([Method(lambda n: ("b", other_setting), 1)]))
    result = batch.benchmark_batch("tracker", {}, 4, 1e-5, lambda message: None)
    counts = batch.thread_counts()
    own, other = result.rates[: len(counts)], result.rates[len(counts) :]
    assert [(rate.engine, rate.threads, rate.runs) for rate in own] == [
        ("newton_euler", n, 4) for n in counts
    ]
    assert {rate.engine for rate in other} == {"mujoco"}
    # an order above the tolerances; MuJoCo RK4 at 5 ms is 3e-6 off
    assert own[0].error < 1e-6
    assert own[0].error < other[0].error < 1e-5
    assert result.uncertainty < 1e-9
    assert len(batch.batch_report(result).parts[0].rows) == 2 * len(counts)
    for found in batch.batch_data(result)["rates"]:
        assert len(found["times"]) == 2
        assert found["rate"] == found["runs"] / np.median(found["times"])


def test_an_error_below_what_the_reference_is_known_to_is_refused(monkeypatch):
    monkeypatch.setattr(batch, "SAMPLE", 1)
    monkeypatch.setattr(batch, "references", lambda scene, states: ({}, 1e-9))
    with pytest.raises(CrosscheckError, match=r"--error 1e-10: the reference is known to 1\.0e-09 only"):
        batch.benchmark_batch("tracker", {}, 2, 1e-10, lambda message: None)


def test_a_batch_without_a_reference_is_refused(short, tracker_states, monkeypatch):
    monkeypatch.setattr(benchmark_reference, "LIMIT", 1e-3)
    with pytest.raises(CrosscheckError, match=r"none of 1 random runs has a reference.*0\.001 s"):
        references(short, tracker_states[:1])
