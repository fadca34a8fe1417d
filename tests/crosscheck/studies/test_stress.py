"""`crosscheck stress`: how cases are judged and run, the answers they are held against, and the report."""

from __future__ import annotations

import json
import os
import re
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from command_line import command, run

from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.library import load
from crosscheck.library.references import reference_values
from crosscheck.report.page import write_report
from crosscheck.studies.stress import configurations, extremes, integration, rotation
from crosscheck.studies.stress.cases import (
    Bound,
    Case,
    Measurement,
    refusal,
    run_case,
    run_cases,
    simulate_and_measure,
)
from crosscheck.studies.stress.integration import growth, smallest
from crosscheck.studies.stress.report import counts, report, write
from crosscheck.studies.stress.runs import (
    REFERENCE_SETTING,
    Setting,
    bar_angles,
    parallelogram_angle,
    parallelogram_error,
    solver_setting,
    symmetric_top,
    top_error,
    with_duration,
)
from crosscheck.studies.stress.topics import TOPICS, cases_of, wanted_topics
from crosscheck.support.errors import CrosscheckError
from newton_euler import simulate
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state

BOUND = Bound("error", "m", 1e-6, 1e-2, "for the sake of the test")
STEP = Bound("step", "s", 1.0, 0.1, "steps", at_least=True)
REFUSAL = refusal("error", "m")
STOPPED = IntegrationError(0.5, "joint 'rail'")


def case(measure, bound=BOUND, **more):
    return Case("something", Setting("newton_euler"), bound, measure, topic="a", **more)


def raising(error):
    def measure(setting):
        raise error

    return measure


# Judging


@pytest.mark.parametrize(
    ("bound", "figure", "verdict"),
    [
        *((BOUND, figure, "survives") for figure in (0.0, 1e-6)),
        *((BOUND, figure, "degrades") for figure in (1.1e-6, 1e-2)),
        *((BOUND, figure, "fails") for figure in (1.1e-2, np.nan, np.inf, -np.inf)),
        (STEP, 2.0, "survives"),
        (STEP, 0.5, "degrades"),
        *((STEP, figure, "fails") for figure in (0.05, np.nan, np.inf, -np.inf)),
    ],
)
def test_figures_are_judged_by_their_bounds(bound, figure, verdict):
    assert bound.verdict(figure) == verdict


@pytest.mark.parametrize(
    ("measure", "bound", "verdict", "passes", "reason"),
    [
        (lambda _: Measurement(1e-7, "well done"), BOUND, "survives", True, "well done"),
        (lambda _: Measurement(1e-3), BOUND, "degrades", False, ""),
        (raising(STOPPED), BOUND, "refuses", False, "integration stopped at t = 0.5 s: joint 'rail'"),
        (raising(STOPPED), REFUSAL, "refuses", True, "integration stopped at t = 0.5 s: joint 'rail'"),
        (lambda _: Measurement(0.0), REFUSAL, "fails", False, "completes without an error"),
        (raising(ZeroDivisionError("by zero")), BOUND, "fails", False, "ZeroDivisionError: by zero"),
        (raising(ZeroDivisionError("by zero")), REFUSAL, "fails", False, "ZeroDivisionError: by zero"),
    ],
)
def test_cases_are_judged(measure, bound, verdict, passes, reason):
    row = run_case(case(measure, bound))
    assert (row.verdict, row.passes, row.reason) == (verdict, passes, reason)


def test_a_refusal_has_to_name_what_it_should():
    assert run_case(case(raising(STOPPED), REFUSAL, required_texts=("'rail'", "t = 0.5 s"))).passes
    row = run_case(case(raising(STOPPED), REFUSAL, required_texts=("'rail'", "'push'")))
    assert (row.verdict, row.passes) == ("fails", False)
    assert row.reason.startswith("the error does not name 'push': ")


# Running


def without_end(setting):
    while True:
        pass


def found(value, setting):
    return Measurement(value)


def ended(status, setting):
    os._exit(status)


def test_cases_run_in_processes_with_a_time_limit_and_come_back_in_order():
    cases = [
        case(partial(found, 1e-9)),
        case(without_end, time_limit=0.5),
        case(partial(ended, 3)),
        case(partial(found, 1.0)),
        case(partial(found, 0.0), REFUSAL),
    ]
    told = []
    rows = run_cases(cases, told.append)
    assert [row.verdict for row in rows] == ["survives", "fails", "fails", "fails", "fails"]
    assert [row.value for row in rows] == [1e-9, None, None, 1.0, 0.0]
    assert rows[1].reason == "not done after 0.5 s of processor time"
    assert rows[2].reason == "the process ended, 3"
    assert len(told) == len(cases)
    assert told[-1].startswith("5 of 5 cases")


def slept(setting):
    time.sleep(0.3)
    return Measurement(1e-9)


def test_waiting_takes_no_time_of_a_case():
    """As where other processes have the processors, or one begins and imports."""
    (row,) = run_cases([case(slept, time_limit=0.1)], lambda line: None)
    assert row.verdict == "survives"


@pytest.mark.parametrize("wanted", [1, 2, 7, 31, 32, 1000])
def test_bisection_finds_where_it_becomes_true(wanted):
    found = smallest(lambda n: n >= wanted, 5000)
    assert wanted <= found <= wanted * (1.0 + 1.0 / 31.0)
    assert smallest(lambda n: False, 100) is None


@pytest.mark.parametrize("letter", TOPICS)
@pytest.mark.parametrize("full", [False, True])
def test_cases_are_of_their_topic_and_say_why_their_bound(letter, full):
    cases = cases_of(letter, full, [*ENGINES.values()])
    assert cases
    assert {found.topic for found in cases} == {letter}
    assert all(found.bound.reason and found.time_limit <= 150.0 for found in cases)
    told_apart = {
        (found.name, found.setting.engine, str(found.setting), found.bound.quantity) for found in cases
    }
    assert len(told_apart) == len(cases)


def test_an_unknown_topic_is_refused():
    with pytest.raises(CrosscheckError, match=r"unknown topic 'x'; choose from: a, b"):
        wanted_topics("ax")


# The answers


@pytest.mark.parametrize("windows", [2, 40])
def test_closed_motion_of_windows_against_elliptic_functions(windows):
    known = [f for f in reference_values("four_bar") if f.options["N"] == windows and f.quantity == "B0_x"]
    assert known
    scene = replace(load("four_bar", N=windows), output_period=0.5)
    angle = dict(zip(scene.times.tolist(), parallelogram_angle(scene).tolist(), strict=True))
    for figure in known:
        # rtol 1e-13 of the quadrature, over ten seconds of a motion that doubles errors now and then
        assert np.sin(angle[figure.time]) == pytest.approx(figure.value, abs=1e-10)


def test_windows_that_start_flat_go_down_at_their_speed():
    scene = configurations.with_flat_start(with_duration(load("four_bar", N=2), 0.01, 10), 2)
    angle = parallelogram_angle(scene)
    assert angle[0] == pytest.approx(0.5 * np.pi, abs=1e-15)
    # ((N + 1)/2 + N) g / ((N + 1)/3 + N) / L = 3.5/3 g at first; the next term is of order t^3
    expected = 0.5 * np.pi + configurations.FLAT_SPEED * 0.01 + 0.5 * 3.5 / 3.0 * 9.81 * 0.01**2
    assert angle[-1] == pytest.approx(expected, abs=1e-6)
    assert bar_angles(initial_state(scene).position[None], scene.mechanism.bodies)[0] == angle[0]


@pytest.mark.parametrize("moments", [(1.0, 2.0), (2.0, 1.0), (1e-4, 1.0)])
def test_closed_form_of_the_symmetric_top(moments):
    scene = symmetric_top(*moments, np.array([0.3, -0.7, 1.1]), 5.0)
    run = REFERENCE_SETTING.simulate(scene)
    # what tolerances of 1e-13 a step leave after 5 s and some hundred steps
    assert top_error(scene, run) < 1e-10
    other = symmetric_top(*moments, np.array([-0.3, -0.7, 1.1]), 5.0)
    assert top_error(other, run) > 0.1


def test_the_slider_comes_to_rest_at_its_dead_centers():
    scene = configurations.centered_slider_crank()
    half_turn = np.pi / configurations.CRANK_SPEED
    scene = replace(
        scene,
        duration=2.0 * half_turn,
        output_period=half_turn,
        outputs=frozenset({"velocities", "violation"}),
    )
    run = REFERENCE_SETTING.simulate(scene)
    r, rod = configurations.CRANK_LENGTH, configurations.ROD_LENGTH
    assert run.position[:, 3, 0] == pytest.approx([rod + r, rod - r, rod + r], abs=1e-14)  # round-off
    assert np.abs(run.linear_velocity[:, 3]).max() < 1e-13
    assert configurations.position_of_slider(scene, run).value < 1e-14


def test_a_wrong_motion_of_the_windows_is_seen():
    scene = with_duration(load("four_bar", N=1), 0.5, 5)
    run = simulate(scene)
    assert parallelogram_error(scene, run) < 1e-9
    heavier = replace(scene, gravity=1.01 * scene.gravity)
    assert parallelogram_error(scene, simulate(heavier)) > 1e-4


def test_the_limit_of_rk4_is_where_its_growth_is_one():
    z = -RK4_LIMIT
    growth = 1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0
    assert growth == pytest.approx(1.0, abs=1e-3)  # four digits of the limit


@pytest.mark.parametrize(
    ("power", "words"), [(p, f"grows like t^{p:.2f}") for p in (0.5, 1.0, 4.0)] + [(0.0, "does not grow")]
)
def test_growth_is_fitted(power, words):
    times = np.linspace(0.0, 1e4, 201)
    assert growth(times, 1e-12 * times**power) == words


def test_bodies_are_put_off_by_as_much_as_asked_for():
    scene = load("tracker")
    state = configurations.displaced_state(scene, 1e-4)
    shifts = np.linalg.norm(state.position - initial_state(scene).position, axis=1)
    np.testing.assert_allclose(shifts, [0.0, *[1e-4] * 6], rtol=1e-9)
    assert not np.any(initial_state(scene).position - initial_state(load("tracker")).position)


# What newton_euler has to do


@pytest.mark.parametrize(
    "trap", [*extremes.floating_point_cases(True, [SOLVER])], ids=lambda c: f"{c.name}, {c.setting}"
)
def test_traps(trap):
    """What has no answer is refused; what has one is found, or refused where squares of it overflow."""
    row = run_case(trap)
    if trap.bound.has_answer:
        overflows = "denormal body" in trap.name or "huge force" in trap.name
        assert row.verdict == "survives" or (overflows and row.verdict == "refuses"), row.reason
    else:
        assert row.passes, row.reason


@pytest.mark.parametrize("offset", configurations.START_OFFSETS)
def test_starts_off_the_constraints_are_assembled(offset):
    found = configurations.measure_assembled_violation(offset, REFERENCE_SETTING)
    assert configurations.ASSEMBLED.verdict(found.value) == "survives"


# Energies: round-off is told from what a method adds by itself


def noted(setting, scene, duration):
    """The energy error of a run and the round-off in it."""
    found = integration.measure_energy(scene, duration, setting)
    return found.value, float(re.match(r"accumulated round-off (\S+);", found.note)[1])


def test_round_off_is_told_from_errors_of_the_method():
    """Next to passages of flat bars all of a tight run's error is round-off, next to none of a pendulum's."""
    error, rounding = noted(REFERENCE_SETTING, "four_bar", 20.0)
    assert 0.05 * error < rounding < 20.0 * error
    error, rounding = noted(solver_setting(integrator="RK4", step=1e-2), "pendulum", 50.0)
    assert 0.0 < rounding < 1e-5 * error


def test_an_error_far_from_round_off_is_not_held_against_it():
    found = integration.measure_energy("pendulum", 20.0, solver_setting(integrator="Euler", step=1e-2))
    assert found.value > 1e-3
    assert "round-off" not in found.note


def test_energy_of_fixed_steps_is_what_the_gyroscopic_torque_adds():
    """To first order h omega^2 T times a number of the body's: ten times less with a tenth of the step."""
    errors = [
        simulate_and_measure(
            rotation.top(rotation.FIXED_STEP_SPEED, 1.0),
            rotation.kinetic_energy,
            solver_setting(formulation=form, integrator="Euler", step=step),
        ).value
        for form in ("relative", "cartesian")
        for step in (1e-4, 1e-5)
    ]
    assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.05)
    assert errors[2:] == pytest.approx(errors[:2], rel=1e-6)  # the same method in other coordinates


# The report


@pytest.fixture
def rows():
    cases = [
        case(lambda _: Measurement(1e-7, "<fine>")),
        case(lambda _: Measurement(1e-3)),
        case(lambda _: Measurement(np.nan)),
        case(raising(IntegrationError(0.5, "too | hard"))),
        case(raising(STOPPED), REFUSAL, required_texts=("rail",)),
    ]
    return [run_case(found) for found in cases]


def test_passing_cases_are_counted_by_topic_and_engine(rows):
    others = [
        replace(rows[1], case=replace(rows[1].case, setting=Setting("mujoco"))),
        replace(rows[0], case=replace(rows[0].case, topic="i")),
    ]
    assert counts([*rows, *others]) == {
        "(a) drift and energy over long runs": {"newton_euler": "2 of 5", "mujoco": "0 of 1"},
        "(i) floating-point traps": {"newton_euler": "1 of 1", "mujoco": ""},
    }


def test_the_report_counts_what_passes_and_names_what_does_not(rows, tmp_path):
    folder = tmp_path / "out"
    written = write(
        rows, report(rows, "ac", False, 60.0, [SOLVER], {"toy": "toy: no license"}), False, folder
    )
    assert [path.name for path in written] == ["stress.json", "stress.md"]
    text = (folder / "stress.md").read_text()
    setting = str(rows[0].case.setting)
    assert f"| newton_euler | {setting} | 2 of 5 |" in text
    lost = [line for line in text.splitlines() if line.startswith("| something | ")]
    results = ("degrades | 1.0e-03", "fails | nan", "refuses | ")
    assert lost == [f"| something | newton_euler | {setting} | {result} |" for result in results]
    assert "for the sake of the test" in text
    assert "toy: no license" in text
    assert "newton_euler has no cases in topic c" in text
    content = json.loads((folder / "stress.json").read_text(), parse_constant=pytest.fail)
    assert [row["verdict"] for row in content["rows"]] == [row.verdict for row in rows]
    assert content["rows"][2]["value"] == "nan"
    assert "2 of 5 cases pass" in write_report(folder, lambda _: None).path.read_text()


def test_a_folder_that_cannot_be_written_is_said_before_the_run(capsys, tmp_path):
    (tmp_path / "file").write_text("")
    status, out, err = run(capsys, "stress", "--ci", "--output", tmp_path / "file")
    assert (status, out) == (2, "")
    assert "cannot write" in err


@pytest.mark.slow
def test_the_ci_form_covers_all_topics(tmp_path):
    done = command(tmp_path, "stress", "--ci", "--output", "out", timeout=600)
    assert done.returncode == 0, done.stderr
    content = json.loads((tmp_path / "out" / "stress.json").read_text())
    assert {row["topic"] for row in content["rows"]} == set(TOPICS)
    of_ours = [row for row in content["rows"] if row["engine"] == "newton_euler"]
    assert not [row for row in of_ours if "Error" in row["reason"].split(":")[0]]
    # projected, with error control: what users get unless they ask for something else
    default = [row for row in of_ours if row["setting"] == "relative, projection" and row["topic"] != "i"]
    assert len(default) > 10
    assert [row["name"] for row in default if not row["passes"]] == []
