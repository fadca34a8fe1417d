"""Phi, Phi_q, Phi_t and gamma of whole mechanisms in all systems, by finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from constrained_motion import moving
from elements import COUPLED, JOINTS, MOTIONS
from finite_difference import derivative, jacobian
from mechanisms import REGULAR
from random_chains import CHAINS

from mjcf.rigid import RigidMuJoCo
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.system import at_time, constraint_rate
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array
from urdf.dynamics import PinocchioSystem

SCENES = {build.__name__: build() for build in REGULAR} | COUPLED

OPEN = {name: (JOINTS | MOTIONS)[name] for name in ("screw, cut", "rods", "rods only", "gears", "gear, cut")}
OPEN |= MOTIONS | {name: scene for name, scene in CHAINS.items() if "loop" in name}


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", SCENES)
def test_rates_of_all_rows(name, formulation):
    """Along a path with the system's accelerations at t = 0.3 s, to second order."""
    now, q, v = moving(FORMULATIONS[formulation](SCENES[name]), 0.3)
    a = now.acceleration(q, v)

    def path(s: float) -> tuple[Formulation, Array, Array]:
        return at_time(now, 0.3 + s), now.retract(q, s * v + 0.5 * s * s * a), v + s * a

    assert np.abs(constraint_rate(now, q, v)).max(initial=0.0) < 1e-12  # Phi_q qdot + Phi_t = 0, to round-off
    columns = jacobian(lambda x: now.phi(now.retract(q, x * now.velocity_units)), now.nv)
    norms = len(now.bodies) if isinstance(now, Cartesian) else 0  # which retract keeps
    rows = len(columns) - norms
    assert np.abs(columns - now.phi_jacobian(q) * now.velocity_units)[:rows].max(initial=0.0) < 1e-9
    rate = derivative(lambda s: path(s)[0].phi(path(s)[1]))
    assert np.abs(rate).max(initial=0.0) < 1e-9
    # the path is exact to s^2 and so is the rate to s; accelerations are of order 100
    second = derivative(lambda s: constraint_rate(*path(s)))
    assert np.abs(second).max(initial=0.0) < 1e-7


@pytest.mark.parametrize("engine", [RigidMuJoCo, PinocchioSystem], ids=lambda engine: engine.name)
@pytest.mark.parametrize("name", OPEN)
def test_rates_where_loops_are_open(name, engine):
    """As soft constraints always leave them. Differences are good to 1e-12, third derivatives reach 100."""
    system = at_time(engine(OPEN[name]), 0.1)
    rng = np.random.default_rng(7)
    q, _ = system.coordinates(initial_state(OPEN[name]))
    q = system.retract(q, rng.uniform(-0.2, 0.2, system.nv))
    v = rng.normal(size=system.nv)
    assert np.max(np.abs(system.phi(q))) > 0.01
    wanted = jacobian(lambda step: system.phi(system.retract(q, step)), system.nv)
    assert np.max(np.abs(system.phi_jacobian(q) - wanted)) < 1e-9
    wanted = derivative(lambda t: at_time(system, 0.1 + t).phi(q))
    assert np.max(np.abs(constraint_rate(system, q, np.zeros(system.nv)) - wanted)) < 1e-9
    if engine is PinocchioSystem:
        return
    wanted = derivative(lambda t: system.retract(q, t * v))
    assert np.max(np.abs(system.rate(q, v) - wanted)) < 1e-11
    if not OPEN[name].motions:
        wanted = derivative(lambda t: system.phi_jacobian(system.retract(q, t * v)) @ v)
        assert np.max(np.abs(system.velocity_product(q, v) - wanted)) < 1e-9
