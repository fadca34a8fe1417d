"""The stiff stepper and the linear algebra in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import newton_euler
from crosscheck.library import load
from newton_euler import PD, compile_scene
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.integrators.constraint_ratio import no_ratio
from newton_euler.integrators.lu import factor_complex, factor_real, solve_complex, solve_real, zero_block
from newton_euler.integrators.radau import integrate_radau
from newton_euler.integrators.radau_stages import ALPHA, BETA, GAMMA, Radau
from newton_euler.integrators.row_exchange import no_exchange
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS, Count, Equations, Table
from newton_euler.integrators.switches import no_switches
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene


@pytest.fixture(scope="module")
def linear():
    return NativeFunctions([factor_real, solve_real, factor_complex, solve_complex, zero_block])


@pytest.mark.parametrize(("n", "m"), [(1, 0), (1, 1), (2, 0), (7, 0), (7, 3), (20, 0), (20, 10), (20, 19)])
def test_linear_systems_are_those_of_numpy(linear, n, m):
    """With and without a leading block that is a number times the identity."""
    rng = np.random.default_rng(n)
    a = rng.standard_normal((n, n))
    if n > m + 1:
        a[m, m] = 0.0  # needs an exchange of rows
    a[:m, :m] = 3.0 * np.eye(m)
    x, pivots = rng.standard_normal(n), np.zeros(n)
    expected, work = np.linalg.solve(a, x), a.T.copy()
    assert linear(factor_real, n, m, work, pivots) == 0
    linear(solve_real, n, m, work, pivots, x)
    assert x == pytest.approx(expected, rel=1e-10)  # condition below 1e4
    b = a + 1j * rng.standard_normal((n, n))
    b[:m, :m] = (3.0 + 4.0j) * np.eye(m)
    y = rng.standard_normal(n) + 1j * rng.standard_normal(n)
    expected = np.linalg.solve(b, y)
    re, im, y_re, y_im = (np.ascontiguousarray(part) for part in (b.T.real, b.T.imag, y.real, y.imag))
    assert linear(factor_complex, n, m, re, im, pivots) == 0
    linear(solve_complex, n, m, re, im, pivots, y_re, y_im)
    assert y_re + 1j * y_im == pytest.approx(expected, rel=1e-10)


def test_the_block_of_zeros_ends_where_its_row_or_its_column_has_an_entry(linear):
    a = np.zeros((4, 4))
    assert linear(zero_block, 4, a) == 4
    a[3, 0] = 1.0
    assert linear(zero_block, 4, a) == 3
    a[1, 2] = 1.0
    assert linear(zero_block, 4, a) == 2
    a[0, 0] = 1.0
    assert linear(zero_block, 4, a) == 0


def test_singular_matrices_are_reported(linear):
    a = np.array([[1.0, 2.0], [2.0, 4.0]])
    assert linear(factor_real, 2, 0, a.copy(), np.zeros(2)) == 1
    assert linear(factor_complex, 2, 0, a.copy(), np.zeros((2, 2)), np.zeros(2)) == 1


def test_eigenvalues_are_the_published_ones():
    """Hairer and Wanner II, section IV.8: gamma, alpha and beta in closed form."""
    root = 9.0 ** (1.0 / 3.0)
    cube = 3.0 ** (1.0 / 3.0)
    assert pytest.approx(3.0 + root - cube, rel=1e-14) == GAMMA
    assert pytest.approx(3.0 - 0.5 * (root - cube), rel=1e-14) == ALPHA
    assert pytest.approx(0.5 * np.sqrt(3.0) * (root + cube), rel=1e-13) == abs(BETA)


def test_the_jacobian_is_the_derivatives(tracker_states, tracker):
    from finite_difference import jacobian

    compiled = compile_scene(tracker)
    n = compiled.size
    derivative = compiled.function("derivative")
    for state in tracker_states[:3]:
        x = compiled.packed(*compiled.system.coordinates(state))
        found = compiled.function("jacobian")(x).reshape(n, n)

        def along(step, x=x):
            return derivative(x + np.append(step, 0.0))[:n]

        expected = jacobian(along, n)
        # central differences of step 1e-6: truncation 1e-12 and round-off 1e-10 of entries up to 1e3
        assert np.abs(found - expected).max() < 1e-8 * np.abs(expected).max()


def test_measured_order(tracker):
    """Work for an error: order 5 means that 32 times the accuracy costs twice the steps."""
    scene = replace(tracker, duration=1.0, output_period=1.0, outputs=frozenset())
    reference = newton_euler.simulate(scene, rtol=1e-13, atol=1e-15)
    compiled = compile_scene(scene)
    steps, errors = [], []
    for rtol in (1e-4, 1e-5, 1e-6, 1e-7):
        run = compiled.simulate("Radau", rtol=rtol, atol=1e-2 * rtol)
        steps.append(run.settings["steps"])
        errors.append(np.abs(run.quaternion[-1] - reference.quaternion[-1]).max())
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 4.5 < order < 6.0


def spring_cart(stiffness: float, damping: float) -> Scene:
    """A cart of 1 kg on a rail, held by a spring and a damper, started 0.1 m away at rest."""
    body = Body("cart", 1.0, np.zeros(3), np.eye(3))
    rail = Prismatic("rail", "ground", "cart", [0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0], actuated=True)
    law = PD("rail", stiffness, damping, target=0.1)
    return Scene("cart", Mechanism([Body.ground(), body], [rail]), 1.0, 0.1, control=(law,))


def test_stiff_gains_cost_a_stiff_stepper_nothing():
    """Overdamped: x = target (1 - slow mode), the fast mode 1e6 times as fast."""
    # without the work, which the fast mode does in a microsecond
    scene = replace(spring_cart(stiffness=1e6, damping=1e6), outputs=frozenset({"velocities"}))
    run = newton_euler.simulate(scene, integrator="Radau", rtol=1e-8, atol=1e-12)
    fast, slow = (0.5 * (1e6 + sign * np.sqrt(1e12 - 4e6)) for sign in (1.0, -1.0))
    slow = 1e6 / fast  # the same without cancellation
    expected = 0.1 * (
        1.0 - (fast * np.exp(-slow * run.time) - slow * np.exp(-fast * run.time)) / (fast - slow)
    )
    assert run.position[:, 1, 0] == pytest.approx(expected, abs=1e-8)  # rtol 1e-8 over some ten steps
    assert run.settings["evaluations"] < 2000
    explicit = newton_euler.simulate(scene, rtol=1e-8, atol=1e-12)
    assert explicit.settings["evaluations"] > 1e6


def test_tight_tolerances_of_stiff_gains_are_met():
    """Round-off of forces of 1e6 N/m is more than Newton's iteration is asked to leave, at rest above all."""
    scene = replace(load("tracker"), duration=0.1, output_period=2.5e-3, outputs=frozenset())
    stiff = replace(scene, control=tuple(PD(law.joint, 1e6, 1e3, law.target) for law in scene.control))
    compiled = compile_scene(stiff)
    exact = compiled.simulate(rtol=1e-13, atol=1e-15)
    for rtol in (1e-7, 1e-8, 1e-9):
        # at most 2,000 steps are accepted at 1e-9, and hundreds of thousands rejected where round-off counts
        run = compiled.simulate("Radau", rtol=rtol, atol=1e-3 * rtol, most_steps=20_000)
        assert np.abs(run.position - exact.position).max() < 1e-3 * rtol


def test_outputs_between_steps_are_as_exact_as_the_steps():
    """Prothero and Robinson's y' = k (y - sin t) + cos t, y = sin t: steps as long as one likes meet it."""

    def derivative(x, y):
        y[0], y[1] = -1e6 * (x[0] - np.sin(x[1])) + np.cos(x[1]), 1.0

    def jacobian(x, y):
        y[0] = -1e6

    def pause(counts, wish):
        """Nobody wants to stop."""

    times = np.linspace(0.0, 10.0, 21)
    table, n = np.empty(len(times)), 1
    system = Equations(
        n=n,
        nq=0,
        inputs=n + 1,
        flags=0,
        derivative=derivative,
        dense=derivative,
        loses_rank=1,
        ratio=no_ratio(),
        projecting=0,
        tolerance=1e-12,
        open_tolerance=1e-12,
        lanes=1,
        position=None,
        velocity=None,
        closing=None,
        exchange=no_exchange(2),
        switches=no_switches(),
        projection_work=np.zeros(0),
        pause=pause,
        marks=np.zeros(n),
        groups=0,
        members=np.zeros(0),
        counts=np.zeros(COUNTS),
    )
    sizes = (n, n + 1, 3 * n, 3 * n, 3 * n + 3, 3 * n + 1, 3 * n, n * n, n * n, n * n, n * n, 2 * n)
    for rtol in (1e-3, 1e-6, 1e-9):
        scratch = (np.empty(size) for size in sizes)
        method = Radau(rtol, 1e-2 * rtol, 10**6, jacobian, *np.zeros((3, 2)), *scratch)
        runs = Table(len(times), n, 1, 1, np.zeros(1), times, np.zeros(2), table, np.zeros(COUNTS))
        integrate_radau(system, runs, method)
        assert system.counts[Count.STATUS] == Status.DONE
        assert np.abs(table - np.sin(times)).max() < rtol  # one tolerance: stiff errors do not add up
