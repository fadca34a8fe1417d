"""Runs by Pinocchio against this package's own."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from constrained_motion import states_near_start
from elements import ELEMENTS, MOTIONS
from mechanisms import pendulum

import newton_euler
import urdf
from crosscheck.library import load
from newton_euler.equations.system import at_time
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.forces import JointSpring
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state
from urdf import benchmark_kernels
from urdf.benchmark_kernels import equations_of


@pytest.fixture(scope="module")
def run(tracker):
    """Runs of the tracker, each set of options run once."""

    @lru_cache
    def simulate(**options):
        return urdf.simulate(tracker, **options)

    return simulate


@pytest.mark.parametrize("stabilization", ["baumgarte", "projection", "none"])
def test_tracker_moves_as_in_newton_euler_to_1e_9(tracker_run, run, stabilization):
    """The project's promise at tight tolerance: 1e-9 m and 1e-9 rad, every body, every output time."""
    tight = {"rtol": 1e-11, "atol": 1e-13}
    found = run(stabilization=stabilization, **tight)
    for formulation in ("relative", "cartesian"):
        wanted = tracker_run(formulation=formulation, **tight)
        assert np.max(np.abs(found.position - wanted.position)) < 1e-9
        assert np.max(angle_between(found.quaternion, wanted.quaternion)) < 1e-9


@pytest.mark.parametrize(
    ("stabilization", "drift"), [("projection", 1e-14), ("baumgarte", 1e-10), ("none", 1e-9)]
)
def test_loops_stay_closed(tracker, stabilization, drift):
    """m and rad. Projection: round-off. Without: the steps' error, rtol 1e-10, which adds up only
    where nothing pulls it back."""
    run = urdf.simulate(replace(tracker, duration=1.0), stabilization=stabilization)
    assert np.max(run.constraint_violation) < drift


def test_fixed_steps_converge_with_order_four(tracker):
    """Runge-Kutta's order 4 within 10 %, between steps that are well inside its stability limit and
    whose errors of 1e-6 m and less are far above those of the run they are measured against."""
    scene = replace(tracker, duration=1.0)
    exact = urdf.simulate(scene)
    runs = [urdf.simulate(scene, integrator="RK4", step=step) for step in (5e-3, 2.5e-3)]
    errors = [np.max(np.abs(run.position - exact.position)) for run in runs]
    assert errors[0] < 1e-6
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("name", MOTIONS)
def test_drift_of_couplings_is_that_of_newton_euler(name):
    """Without stabilization coarse steps miss what a motion prescribes, in every engine by as much."""
    options = {"integrator": "RK4", "step": 0.05, "stabilization": "none"}
    scene = replace(MOTIONS[name], duration=0.5, output_period=0.1)
    found, wanted = (engine.simulate(scene, **options) for engine in (urdf, newton_euler))
    driven = [scene.mechanism.joint_index(motion.joint) for motion in scene.motions]
    missed, opened = found.constraint_violation[:, driven], wanted.constraint_violation[:, driven]
    # the same steps; 10 %: where a joint is cut, the coordinates that they are made in are others
    assert missed == pytest.approx(opened, rel=0.1, abs=1e-12)
    assert name != "motions of a tree" or missed.max() > 1e-7


SPRUNG = replace(pendulum(), forces=(JointSpring("pivot", 10.0, 0.5, 0.2),))
"""Nothing but a spring drives it."""


@pytest.mark.parametrize("scene", [*ELEMENTS.values(), SPRUNG], ids=[*ELEMENTS, "sprung"])
def test_tight_equations_are_those_of_runs(scene):
    scene = replace(scene, outputs=frozenset())
    equations = equations_of(scene, 0.0, None)
    system = at_time(equations.system, 0.1)
    for state in (initial_state(scene), *(() if scene.motions else states_near_start(scene, 2))):
        q, v = system.coordinates(state)
        y = np.concatenate([system.map.q_to_pinocchio(q), system.map.v_to_pinocchio(v)])
        wanted = system.map.v_to_pinocchio(system.acceleration(q, v))
        found = equations.rates(0.1, y)[equations.nq :]
        # 1e-8: redundant closures are regularized in other ways
        assert found == pytest.approx(wanted, abs=1e-8 * max(1.0, np.max(np.abs(wanted))))


@pytest.mark.parametrize(("duration", "period"), [(3.2, 0.01), (0.70845000884, 0.70845000884)])
def test_bars_pass_flat_configurations_with_all_digits(duration, period):
    """Where the rank of the constraints drops; scipy's own step control leaves 4e-6 there.

    A run that ends in one passes it, too.
    """
    scene = replace(load("four_bar", N="1"), duration=duration, output_period=period)
    own = newton_euler.simulate(scene, rtol=1e-12, atol=1e-14)
    run = urdf.simulate(scene, rtol=1e-12, atol=1e-14, most_steps=1000)
    # two passages; either engine is good to about 1e-11 here
    assert np.abs(run.position - own.position).max() < 1e-9


def test_rows_of_bars_hop_over_flat_configurations():
    """Steps that stay short after one that was shortened for its place come ever closer and stop."""
    scene = replace(load("four_bar", N=10), duration=3.2)
    # two passages at rtol 1e-10, which magnify errors some hundredfold
    assert np.abs(urdf.simulate(scene).position - newton_euler.simulate(scene).position).max() < 1e-7


@pytest.mark.slow
def test_a_linkage_that_locks_is_given_up_soon(locking):
    """Not only when steps are as short as a double can hold, a thousand of them later."""
    with pytest.raises(IntegrationError, match=r"steps have become too small; .*fastest at joint 'motor'"):
        urdf.simulate(locking, integrator="Radau", rtol=1e-8, atol=1e-10)


def test_lsoda_reports_the_time_that_it_reached(monkeypatch):
    """SciPy leaves the times of outputs after the failure undefined."""
    monkeypatch.setattr(benchmark_kernels, "MAX_LSODA_STEPS", 3)
    scene = load("pendulum")
    with pytest.raises(IntegrationError) as caught:
        benchmark_kernels.lsoda(equations_of(scene, 0.0, lcaba=None), rtol=1e-12, atol=1e-14)
    assert 0.0 < caught.value.time < scene.times[1]
