"""Checks of a formulation's constraints along paths that meet them, shared by tests."""

from __future__ import annotations

import numpy as np
from finite_difference import derivative, jacobian

from crosscheck.comparison.samples import admissible_basis, body_units
from newton_euler.assemble import initial_state
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System, at_time, constraint_rate
from newton_euler.integrators.compiled import Code, Formulation
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

SYSTEMS = {"relative": Relative, "cartesian": Cartesian}


def admissible_projector(system: System, state: State) -> Array:
    """Orthogonal projector (6 b, 6 b) onto the body velocities that the constraints leave free."""
    basis, _ = admissible_basis(system, system.coordinates(state)[0], body_units(system.scene))
    return basis @ basis.T


def moving(system: Formulation, t: float, seed: int = 0) -> tuple[Formulation, Array, Array]:
    """The system at time t, and q and v that meet all constraints, in random motion."""
    rng = np.random.default_rng(seed)
    now = at_time(system, t)
    q, _ = now.coordinates(initial_state(now.scene))
    q = project_position(now, now.retract(q, 0.1 * now.velocity_units * rng.uniform(-1, 1, now.nv)))
    return now, q, project_velocity(now, q, now.velocity_units * rng.standard_normal(now.nv))


def check_rates(system: Formulation, t: float = 0.3) -> None:
    """Phi_q, Phi_t and gamma of all rows, by differences along a path with the system's accelerations."""
    now, q, v = moving(system, t)
    a = now.acceleration(q, v)

    def path(s: float) -> tuple[Formulation, Array, Array]:
        return at_time(now, t + s), now.retract(q, s * v + 0.5 * s * s * a), v + s * a

    assert np.abs(constraint_rate(now, q, v)).max() < 1e-12  # Phi_q qdot + Phi_t = 0, to round-off
    columns = jacobian(lambda x: now.phi(now.retract(q, x * now.velocity_units)), now.nv)
    norms = len(now.bodies) if isinstance(now, Cartesian) else 0  # which retract keeps
    rows = len(columns) - norms
    assert np.abs(columns - now.phi_jacobian(q) * now.velocity_units)[:rows].max(initial=0.0) < 1e-9
    rate = derivative(lambda s: path(s)[0].phi(path(s)[1]))
    assert np.abs(rate).max() < 1e-9
    # the path is exact to s^2 and so is the rate to s; accelerations are of order 100
    second = derivative(lambda s: constraint_rate(*path(s)))
    assert np.abs(second).max() < 1e-7


def check_agreement(scene: Scene, times: tuple[float, ...] = (0.0, 0.4)) -> None:
    """Accelerations and reactions of both formulations."""
    for t in times:
        now, q, v = moving(Relative(scene), t, seed=3)
        other = at_time(Cartesian(scene), t)
        wanted, found = now.evaluate(q, v), other.evaluate(*other.coordinates(now.state(q, v)))
        for name in ("linear_acceleration", "angular_acceleration", "reaction_force", "reaction_torque"):
            a, b = getattr(wanted, name), getattr(found, name)
            assert np.abs(a - b).max() < 1e-10 * np.abs(a).max(), name  # condition below 1e5


def check_compiled(scene: Scene, formulation: str, times: tuple[float, ...]) -> None:
    """Compiled accelerations and projections against floats."""
    code = Code(scene, formulation)
    for seed, t in enumerate(times):
        now, q, v = moving(code.system, t, seed)
        y = code.function("derivative")(code.packed(q, v, t))
        wanted = np.concatenate([now.rate(q, v), now.acceleration(q, v)])
        assert y[-1] > 0.0
        assert np.abs(y[:-1] - wanted).max() < 1e-12 * np.abs(wanted).max()
        closed = code.function("velocity")(code.packed(q, v + 0.1 * now.velocity_units, t))
        assert np.abs(constraint_rate(now, closed[: now.nq], closed[now.nq : code.size])).max() < 1e-12
        moved = now.retract(q, 1e-4 * now.velocity_units * np.cos(np.arange(now.nv)))
        for _ in range(4):
            moved = code.function("position")(code.packed(moved, v, t))[: now.nq]
        assert np.abs(now.phi(moved)).max() < 1e-13
