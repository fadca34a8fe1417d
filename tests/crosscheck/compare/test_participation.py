"""Engines that take no part in some checks: an engine without equations, and one that stopped."""

from __future__ import annotations

from dataclasses import replace

import pytest
from mechanisms import pendulum
from support.results import crosscheck_of

from crosscheck.compare.check import FILE, LEVELS_OF_EQUATIONS, LEVELS_OF_RUNS, READING, Check
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.participation import by_runs_only, participation
from crosscheck.compare.result import misread
from crosscheck.engines.engine import no_systems
from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.report.render import terminal
from crosscheck.report.run import report
from crosscheck.report.summary import NO_PART, levels_table
from newton_euler.errors import NewtonEulerError

BARE = replace(ENGINES["pinocchio"], name="bare", systems=no_systems)
"""An engine without equations of motion, whose runs are those of Pinocchio."""

NE, MJ = "newton_euler", "mujoco"


def a_check(level, *between, **values):
    return Check(level, "x, rel", between, **{"value": 0.0, "tolerance": 1e-9, "where": "rod"} | values)


def test_checks_are_counted_by_what_they_compare():
    checks = [
        a_check(READING, NE, FILE),
        a_check("model", "relative", "cartesian"),
        a_check("model", NE, MJ),
        a_check("kinematics", NE, MJ, judged=False),  # for information
        a_check("trajectories", NE, MJ),
        a_check("trajectories", NE, "toy"),
        a_check("trajectories", MJ, "toy", judged=False, unconverged="toy"),
        a_check("energy", NE),
        a_check("energy", MJ),
    ]
    found = participation([NE, MJ, "toy"], checks)
    assert found[NE] == (3, 1, 2, 0, ())
    assert found[MJ] == (2, 0, 1, 1, (READING,))
    assert found["toy"] == (1, 0, 0, 1, (READING, "model", "energy"))
    assert by_runs_only([NE, MJ, "toy"], checks) == ("toy",)
    assert by_runs_only([NE, MJ, "toy"], checks[1:2]) == (MJ, "toy")


@pytest.fixture(scope="module")
def compared():
    """A pendulum in newton_euler and an engine without equations, which is named first."""
    return crosscheck(replace(pendulum(), duration=0.5), [BARE, SOLVER], lambda _: None, "", {})


def test_an_engine_without_equations_has_no_part_in_their_levels(compared):
    assert compared.outcome is Outcome.AGREE
    bare, own = compared.participation["bare"], compared.participation[NE]
    # positions, orientations, reaction forces and torques, and kinetic energies; drift and energy balance
    assert (bare.with_engines, bare.alone, bare.no_part_in) == (5, 2, LEVELS_OF_EQUATIONS)
    assert own.with_engines == 5
    assert own.alone + 5 + 2 == len(compared.judged)
    assert own.no_part_in == ()
    text = f"all {len(compared.judged)} checks, of which 5 compare bare with another engine (bare has no part"
    assert text in compared.verdict
    assert all(level in compared.verdict for level in LEVELS_OF_EQUATIONS)
    assert compared.summary()["engines"]["bare"]["checks"] == bare._asdict()


def test_errors_are_measured_by_an_engine_whose_equations_are_compared():
    """The reference is newton_euler's refined run, although the engine without equations is named first."""

    def shifted(scene):
        run = BARE.refined(scene)
        return replace(run, position=run.position + 1e-3)

    wrong_reference = replace(BARE, refined=shifted)
    scene = replace(pendulum(), duration=0.2)
    found = crosscheck(scene, [wrong_reference, SOLVER], lambda _: None, "", {})
    assert found.outcome is Outcome.AGREE
    assert max(found.run_errors.values()) < 1e-8


def test_the_table_of_levels_shows_who_has_no_part(compared):
    """The columns are differences from the first engine with equations, whichever is named first."""
    table = levels_table(compared)
    assert [column.heading for column in table.columns][2:-1] == ["bare"]
    shown = {row[0].text: row[2].text for _, row in table.sections()}
    assert [level for level in shown if shown[level] == NO_PART] == [
        level.partition(" and ")[0] for level in LEVELS_OF_EQUATIONS
    ]
    assert set(LEVELS_OF_RUNS) < set(shown)
    every = terminal(report(compared).parts)
    assert "number of checks of each engine" in every
    assert "compared by runs only, not by equations of motion: bare" in every


def test_an_engine_that_stops_at_its_start_has_no_part_in_runs():
    def stopping(scene):
        raise NewtonEulerError("no license")

    broken = replace(ENGINES["pinocchio"], simulate=stopping)
    found = crosscheck(replace(pendulum(), duration=0.2), [SOLVER, broken], lambda _: None, "", {})
    assert found.outcome is Outcome.UNFINISHED
    part = found.participation["pinocchio"]
    assert part.no_part_in == ("drift",)  # the momentum balance is at the level of energies
    assert f"of which {part.with_engines} compare pinocchio with another engine" in found.verdict
    assert found.verdict.endswith("; no checks of trajectories")  # of one run


def test_an_engine_that_no_judged_check_compares_is_not_in_agreement():
    unjudged = {"judged": False, "unconverged": "mujoco"}
    pairs = [
        a_check("model", NE, "pinocchio"),
        *(a_check("trajectories", name, MJ, **unjudged) for name in (NE, "pinocchio")),
    ]
    of_some = crosscheck_of([*pairs, a_check("energy", MJ)])
    assert of_some.outcome is Outcome.AGREE_OF_SOME_ENGINES
    assert of_some.verdict.startswith("AGREE (2 of 3 engines): newton_euler, pinocchio agree")
    assert "no judged check compares mujoco with another engine" in of_some.verdict
    two = {"engines": (SOLVER, ENGINES["mujoco"])}
    alone = crosscheck_of([pairs[1], a_check("energy", MJ)], **two)
    assert alone.outcome is Outcome.NOT_COMPARED
    assert alone.verdict.startswith("NOT COMPARED: nothing could be compared on pendulum")
    assert "all 1" in alone.verdict
    assert crosscheck_of(pairs[:1], **two | {"engines": (SOLVER,)}).uncompared == ()


def test_a_file_is_misread_if_all_engines_with_equations_differ_from_it():
    """An engine without equations is not compared with the file."""
    wrong, right = (a_check(READING, NE, FILE, value=value) for value in (1.0, 0.0))
    assert misread([wrong])
    assert misread([wrong, a_check(READING, MJ, FILE, value=1.0)])
    assert not misread([wrong, a_check(READING, MJ, FILE)])
    assert not misread([right])
    assert not misread([a_check("model", NE, MJ, value=1.0)])
