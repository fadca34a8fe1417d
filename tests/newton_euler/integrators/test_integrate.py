"""Integrators: closed-form pendulum, measured orders, projection, and refusals."""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import ball_loop, pendulum, spinning_top
from scipy.special import ellipj, ellipk

import newton_euler
import urdf
from crosscheck.library import load
from newton_euler import Body, Mechanism
from newton_euler.compiled.evaluated import integrate
from newton_euler.equations.relative import Relative
from newton_euler.errors import OptionError, UnknownNameError
from newton_euler.integrators.options import INTEGRATORS, STABILIZATIONS, Options, StepControl
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import run


def exact_height(scene, times):
    """Height of a physical pendulum's center of mass, by Jacobi's elliptic functions.

    phi = angle from hanging: sin(phi/2) = k sn(K + w t | k^2), k = sin(phi0 / 2), w^2 = m g c / I.
    """
    rod = scene.mechanism.bodies[1]
    c = np.linalg.norm(rod.center_of_mass)
    w = np.sqrt(rod.mass * 9.81 * c / (np.sort(np.linalg.eigvalsh(rod.inertia))[1] + rod.mass * c**2))
    m = (1.0 + rod.center_of_mass[2] / c) / 2.0  # sin^2(phi0 / 2)
    sn = ellipj(ellipk(m) + w * times, m)[0]
    return -c * (1.0 - 2.0 * m * sn**2)


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
def test_pendulum_matches_its_closed_form(formulation, integrator):
    scene = pendulum()
    # Radau at order 5 needs many more steps for the same error
    rtol, bound = (1e-12, 1e-10) if integrator == "DOP853" else (1e-8, 1e-6)
    run = newton_euler.simulate(scene, formulation, integrator, rtol=rtol, atol=1e-2 * rtol)
    assert np.abs(run.position[:, 1, 2] - exact_height(scene, run.time)).max() < bound
    energy = run.kinetic_energy + run.potential_energy
    assert np.abs(energy - energy[0]).max() < 10 * bound


@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
def test_copies_of_a_mechanism_take_the_steps_of_one(integrator):
    """Errors are root mean squares over the coordinates, so that the number of coordinates is no factor."""
    one = replace(pendulum(), output_period=0.01)
    rod, pivot = one.mechanism.bodies[1], one.mechanism.joints[0]
    rods = [replace(rod, name=f"rod_{k}") for k in range(5)]
    pivots = [replace(pivot, name=f"pivot_{k}", second=f"rod_{k}") for k in range(5)]
    five = replace(one, mechanism=Mechanism([Body.ground(), *rods], pivots))
    options = {"integrator": integrator, "rtol": 1e-7, "atol": 1e-9}
    single, copies = (newton_euler.simulate(scene, **options) for scene in (one, five))
    for count in ("steps", "rejected"):
        assert copies.settings[count] == single.settings[count]
    assert np.ptp(copies.position[:, 1:], axis=1).max() < 1e-14
    assert copies.position[:, 1] == pytest.approx(single.position[:, 1], abs=1e-12)


@pytest.mark.parametrize(("integrator", "order"), [("RK4", 4), ("Euler", 1)])
@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_measured_order_of_fixed_steps(integrator, order, formulation):
    scene = replace(ball_loop(), duration=0.3)  # it falls through a singular pose later
    exact = newton_euler.simulate(scene, rtol=1e-12, atol=1e-13)
    errors = []
    for step in (0.02, 0.01, 0.005):
        run = newton_euler.simulate(scene, formulation, integrator, step=step)
        errors.append(np.abs(run.position - exact.position).max())
    measured = np.log2(np.array(errors[:-1]) / errors[1:])
    # higher terms of the error at these steps shift the order by up to 0.3
    assert np.all(np.abs(measured - order) < 0.3), measured


def test_error_follows_the_tolerance():
    scene = spinning_top()
    exact = newton_euler.simulate(scene, rtol=1e-13, atol=1e-14)
    for rtol in (1e-6, 1e-9):
        run = newton_euler.simulate(scene, rtol=rtol, atol=rtol)
        error = angle_between(run.quaternion, exact.quaternion).max()
        # per-step control of order 8 over 10 turns: the global error stays within 100 tolerances
        assert 0.0 < error < 100 * rtol


def test_projection_restores_positions_and_velocities():
    scene = ball_loop()
    system = Relative(scene)
    rng = np.random.default_rng(0)
    q, v = system.coordinates(initial_state(scene))
    options = Options(integrator="RK4", step=0.05)
    q, v = q + 1e-3 * rng.standard_normal(q.size), v + rng.standard_normal(v.size)
    assert np.abs(system.phi(q)).max() > 1e-4
    table, _, _ = integrate(system, q, v, np.array([0.0, 0.1]), options)
    for q, v in zip(table[:, : system.nq], table[:, system.nq :], strict=True):
        assert np.abs(system.phi(q)).max() < 1e-14  # round-off of meters
        assert np.abs(system.phi_jacobian(q) @ v).max() < 1e-13


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"integrator": "Dopri"}, f"choose from: {', '.join(INTEGRATORS)}"),
        ({"formulation": "lagrange"}, "choose from: relative, cartesian"),
        ({"stabilization": "gggl"}, f"choose from: {', '.join(STABILIZATIONS)}"),
        ({"rtol": 0.0}, "rtol is 0.0"),
        ({"rtol": float("nan")}, "rtol is nan"),
        ({"atol": -1.0}, "atol is -1.0"),
        ({"integrator": "RK4"}, "step is None"),
        ({"integrator": "RK4", "step": 0.0}, "step is 0.0"),
        ({"integrator": "RK4", "step": True}, "step is True"),
        ({"integrator": "Euler", "step": 1e-25}, "step is 1e-25"),
        ({"step": 0.1}, "chooses its own steps"),
        (
            {"integrator": "RK4", "step": 0.1, "rtol": 1e-6},
            "rtol is 1e-06; needed: none: RK4 takes fixed",
        ),
        ({"alpha": float("inf")}, "alpha is inf"),
        ({"alpha": 5.0}, "alpha is 5.0; needed: none: stabilization is 'projection', not 'baumgarte'"),
        ({"most_steps": 0}, "most_steps is 0"),
        ({"most_steps": 1e6}, "most_steps is 1000000.0"),
    ],
)
def test_impossible_options_are_refused(options, message):
    for simulate in (newton_euler.simulate, newton_euler.simulate_batch, urdf.simulate):
        if simulate is urdf.simulate and "formulation" in options:
            continue
        with pytest.raises((OptionError, UnknownNameError)) as caught:
            simulate(pendulum(), **options)
        assert message in str(caught.value)


@pytest.mark.parametrize("simulate", [newton_euler.simulate, newton_euler.simulate_batch, urdf.simulate])
def test_an_unknown_option_is_answered_by_all_keyword_arguments(simulate):
    with pytest.raises(UnknownNameError) as caught:
        simulate(pendulum(), alhpa=5.0)
    others = {"scene", "states", "parameters", "threads", "control"}
    keywords = {*inspect.signature(simulate).parameters, *StepControl.__annotations__} - others
    assert set(caught.value.valid) == keywords
    assert "did you mean 'alpha'" in str(caught.value)


def test_a_run_that_gets_nowhere_says_so():
    with pytest.raises(IntegrationError, match="more than 5 steps"):
        run(Relative(pendulum()), "newton_euler", Options(most_steps=5), {})
    with pytest.raises(IntegrationError, match=r"more than 5 steps; .* at joint 'pivot'"):
        newton_euler.simulate(pendulum(), most_steps=5)


def test_hundreds_of_turns_cost_no_digits():
    """A crank turns 500 times in 300 s; with its angle kept as it is, 1.5e-11 of the energy is lost."""
    scene = replace(load("slider_crank"), duration=300.0, output_period=3.0, outputs=frozenset({"energy"}))
    run = newton_euler.simulate(scene, rtol=1e-13, atol=1e-15)
    energy = run.kinetic_energy + run.potential_energy
    # 97,000 steps of 1e-13, most of it in phase
    assert np.abs(energy - energy[0]).max() < 4e-12 * np.abs(energy).max()


@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
@pytest.mark.parametrize("error", [TypeError, KeyboardInterrupt])
def test_what_is_no_error_of_the_equations_is_raised_as_it_is(integrator, error, monkeypatch):
    """Native code asks Python for accelerations; it ends at once where that is interrupted or at fault."""
    evaluated, calls = Relative.acceleration, []

    def acceleration(self, q, v):
        calls.append(q)
        if len(calls) > 50:
            raise error
        return evaluated(self, q, v)

    monkeypatch.setattr(Relative, "acceleration", acceleration)
    with pytest.raises(error):
        run(Relative(pendulum()), "newton_euler", Options(integrator), {})
    assert len(calls) < 100
