"""Steps of tangents in plain Python, beside a state that rests."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler.integrators.status import Status
from newton_euler.integrators.tangent_steps import integrate_tangents
from newton_euler.integrators.tangents import TangentCount, Tangents


def followed(rates_along, start, most=2000, floor=0.0, steps=1, project=None):
    """Carry one tangent (q, v) from `start` through 1 s in equal steps, in `most` parts at most; the tangent,
    how often its rates were evaluated, and a status.

    `rates_along` gives the rates (2,) of the tangent (2,); their pivot ratio is 1. `project` puts x on
    constraints, if there are any.
    """
    calls, h = [], 1.0 / steps

    def rates(x, k):
        calls.append(x)
        assert len(calls) < 2000
        k[:2], k[2:4], k[4] = 0.0, rates_along(x[3:5]), 1.0

    x = np.array([0.0, 0.0, 0.0, *start, 0.0])
    tangents = Tangents(
        n=2,
        inputs=3,
        known=3,
        lanes=1,
        wide=1,
        count=steps,
        rows=1,
        max_substeps=most,
        projecting=int(project is not None),
        places=1,
        speeds=1,
        tolerance=1e-8,
        floor=floor,
        rates=rates,
        project=project,
        pause=None,
        steps=np.concatenate([[0.0, 0.0, k * h, h] for k in range(steps)]),
        times=np.array([steps * h]),
        states=np.zeros(2),
        flags=np.zeros(0),
        x=x,
        wide_x=np.empty(6),
        at=x.copy(),
        k=np.empty(17 * 5),
        table=np.empty(2),
        min_pivot_ratio=np.ones(1),
        errors=np.empty(2),
        longer_errors=np.empty(2),
        noise=np.zeros(1),
        counts=np.zeros(len(TangentCount)),
        found=np.empty(2),
    )
    status = integrate_tangents(tangents, np.zeros(3))
    return x[3:5], len(calls), status


def test_a_step_is_taken_in_parts():
    """Of an oscillator of 30 rad/s, which a step of 1 s blows up."""
    found, _, _ = followed(lambda tangent: [tangent[1], -900.0 * tangent[0]], [1.0, 0.0])
    # fewer than a hundred parts, each to 1e-8 of the largest
    assert found == pytest.approx([np.cos(30.0), -30.0 * np.sin(30.0)], abs=30.0 * 1e-6)


def test_tangents_are_put_on_the_linearized_constraints_every_few_steps():
    """Before steps 0, 4 and 8, and in the end."""
    calls = []

    def projected(x, found):
        calls.append(x)
        found[:] = x[3:5]

    found, evaluations, _ = followed(
        lambda tangent: [tangent[1], -9.0 * tangent[0]], [1.0, 0.0], steps=10, project=projected
    )
    assert found == pytest.approx([np.cos(3.0), -3.0 * np.sin(3.0)], abs=1e-9)  # 0.3^8 / 8! / 3^8 a step
    assert len(calls) == 4
    assert evaluations == 10 * 13


def test_parts_have_a_limit():
    _, evaluations, status = followed(lambda tangent: [tangent[1], -900.0 * tangent[0]], [1.0, 0.0], most=5)
    assert status == Status.TOO_MANY_STEPS
    # of five parts, and the tries to find the length of the first
    assert evaluations < 13 * 10


def test_round_off_does_not_divide_steps():
    """Rates that are nothing but noise have no error that shorter parts make less: that is found out once."""
    rng = np.random.default_rng(5)
    found, evaluations, _ = followed(lambda tangent: [tangent[1], 1e-16 * rng.normal()], [0.0, 0.0])
    assert np.abs(found).max() < 1e-15
    # some tries, and parts that grow from a tenth of the step; without it there is no end
    assert evaluations < 13 * 15


def test_what_is_not_finite_ends():
    """Such results are refused where they are used."""
    found, _, _ = followed(lambda tangent: [tangent[1], np.nan], [1.0, 0.0])
    assert np.isnan(found).any()


def test_rates_whose_pivot_ratio_is_below_the_floor_end():
    _, evaluations, status = followed(lambda tangent: [tangent[1], 0.0], [1.0, 0.0], floor=2.0)
    assert status == Status.SINGULAR
    assert evaluations == 13  # of the stages of one part
