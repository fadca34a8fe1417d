"""Projection next to a singular configuration, of linear constraints: Phi = J q - b, dPhi/dt = J v."""

import numpy as np
import pytest

from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.compiled.callbacks import PythonCallback, vector_at
from newton_euler.integrators.dense_projection import WEAK_CONSTRAINT_LENGTH, close, closing_of


def closed(form, jacobian, b, mass, units, q, v):
    """Close (q, v) in native code or in plain Python: q, v and success."""
    k, nv = jacobian.shape
    lower = [(i, j) for i in range(nv) for j in range(i + 1)]
    counts = {"retract": nv, "surface": 2 * k + k * nv + len(lower)}

    def retract(x, y):
        y[:nv] = x[:nv] + x[nv : 2 * nv]

    def surface(x, y):
        phi, rates = jacobian @ x[:nv] - b, jacobian @ x[nv : 2 * nv]
        scaled = [mass[i, j] * units[i] * units[j] for i, j in lower]
        y[: counts["surface"]] = np.concatenate([phi, rates, (jacobian * units).ravel(), scaled])

    def called(function):
        def call(x, y, on):
            function(vector_at(x, 2 * nv), vector_at(y, counts[function.__name__]))

        return PythonCallback(call)

    functions = (retract, surface)
    if form == "native":
        functions = tuple(map(called, functions))
    places = [*range(k * nv)], [nv * i + j for i, j in lower]
    closing = closing_of(nv, units, 2 * nv, places, k, functions)
    x, y = np.concatenate([q, v]), np.zeros(2 * nv + 1)
    if form == "native":
        NativeFunctions([close])(close, closing, x, y)
    else:
        close(closing, x, y)
    return y[:nv], y[nv:-1], y[-1]


@pytest.mark.parametrize("form", ["native", "plain"])
@pytest.mark.parametrize("rank", [3, 2])
def test_corrections_are_the_least_in_the_metric_of_the_mass_matrix(form, rank):
    """With and without a redundant row."""
    rng = np.random.default_rng(rank)
    nv, k = 5, 3
    jacobian = rng.standard_normal((k, rank)) @ rng.standard_normal((rank, nv))
    root, units = rng.standard_normal((nv, nv)), rng.uniform(0.5, 2.0, nv)
    mass, q, v = np.eye(nv) + root @ root.T, rng.standard_normal(nv), rng.standard_normal(nv)
    b = jacobian @ rng.standard_normal(nv)
    found_q, found_v, success = closed(form, jacobian, b, mass, units, q, v)
    free = np.linalg.solve(mass, jacobian.T)
    back = free @ np.linalg.pinv(jacobian @ free, rcond=1e-10)  # the singular values are of order 1, or 0
    assert success == 1.0
    assert found_q == pytest.approx(q - back @ (jacobian @ q - b), abs=1e-12)  # condition below 1e3
    assert found_v == pytest.approx(v - back @ (jacobian @ v), abs=1e-12)


@pytest.mark.parametrize("form", ["native", "plain"])
@pytest.mark.parametrize(
    ("angle", "moved"), [(0.1 * WEAK_CONSTRAINT_LENGTH, False), (10.0 * WEAK_CONSTRAINT_LENGTH, True)]
)
def test_weak_constraints_move_nothing(form, angle, moved):
    """Two rows at a small angle, and a residual of 1e-10 in one alone."""
    jacobian = np.array([[1.0, 0.0], [1.0, angle]])
    b, zero = np.array([0.0, 1e-10]), np.zeros(2)
    q, v, success = closed(form, jacobian, b, np.eye(2), np.ones(2), zero, np.array([0.0, 1e-10]))
    assert success == 1.0
    assert np.abs(q).max() == pytest.approx(1e-10 / angle if moved else 0.0, rel=1e-6, abs=1e-10)
    assert v == pytest.approx([0.0, 0.0 if moved else 1e-10], abs=1e-14)


@pytest.mark.parametrize("form", ["native", "plain"])
@pytest.mark.parametrize(
    ("mass", "b"),
    [(-1.0, [0.0, 0.0]), (np.nan, [0.0, 0.0]), (1.0, [0.0, 1.0]), (1.0, [0.0, np.nan])],
    ids=["indefinite", "mass", "contradiction", "residual"],
)
def test_what_cannot_be_closed_is_reported(form, mass, b):
    jacobian = np.array([[1.0, 0.0], [1.0, 0.0]])
    masses = np.diag([1.0, mass])
    assert closed(form, jacobian, np.array(b), masses, np.ones(2), np.ones(2), np.ones(2))[2] == -1.0
