"""Next steps of a crosscheck on its page: errors of logs first, and no assumed settings as yours."""

from __future__ import annotations

from dataclasses import replace

import pytest

import crosscheck
from crosscheck.library import load
from crosscheck.report.run_page import next_steps
from newton_euler import simulate

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("factor", "is_named"), [(1.0, False), (1.5, True)])
def test_a_log_with_a_large_error_has_the_first_step(factor, is_named):
    run = simulate(load("pendulum"))
    angle = run.joint("pivot").coordinates[:, 0]
    log = {"time": run.time, "pivot": angle[0] + factor * (angle - angle[0])}
    verdict = crosscheck.check("pendulum", ["newton_euler"], runs={"bench": log})
    first, *_ = next_steps(verdict.crosscheck)
    assert ("log bench" in first) is is_named


def test_assumed_settings_are_not_called_yours():
    verdict = crosscheck.check("examples/arm.urdf", ["newton_euler", "pinocchio"], duration=0.2)
    result = verdict.crosscheck
    assert result.own_run.are_assumed
    assert any("--set own_run=FILE" in step for step in next_steps(result))
    given = replace(result, own_run=replace(result.own_run, are_assumed=False))
    assert not any("--set own_run=FILE" in step for step in next_steps(given))
