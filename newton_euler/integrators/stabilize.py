"""Keeping a run on its constraints: coordinate and velocity projection, and what else there is.

Baumgarte stabilisation is part of the equations of motion (the gains of a `System`); projection
acts on the result of each step (Eich-Soellner and Fuehrer, Numerical Methods in Multibody Dynamics,
1998, chapter 5).
"""

from __future__ import annotations

import numpy as np

from newton_euler.equations.couplings import couplings, residuals, row_owners, row_units
from newton_euler.equations.dense import largest, minimum_norm
from newton_euler.equations.redundancy import loosely_closed, rows_left_out, without
from newton_euler.equations.system import Rheonomic, System, opening
from newton_euler.errors import AssemblyError, OptionError, check_choice, is_finite_number
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

STABILIZATIONS = ("projection", "baumgarte", "none")

PAPER_ALPHA = 10.0
"""The paper's choice for K_D = 2 alpha, K_P = alpha^2 (Appendix B), 1/s."""

NEWTON_STEPS = 20

RK4_LIMIT = 2.785
"""Largest product of a gain alpha and a step of RK4 that is stable (E. Hairer, G. Wanner, Solving Ordinary
Differential Equations II, second edition, Springer 1996, section IV.2)."""

COME_OPEN = 1e-2
"""Lengths of the mechanism's longest body, or rad, by which a joint may come open without projection before
what runs on is another mechanism: a hundredth can be seen."""

ROUND_OFF = 16.0 * np.finfo(float).eps
"""Residuals below this share of the mechanism's size are what evaluating them loses."""


def baumgarte_alpha(stabilization: str, alpha: float) -> float:
    """The alpha that a system of equations takes under a stabilisation; raises for impossible ones."""
    if not is_finite_number(alpha) or alpha < 0.0:
        raise OptionError("alpha", alpha, "a number of 1/s, zero or more")
    check_choice("stabilization", stabilization, STABILIZATIONS)
    return alpha if stabilization == "baumgarte" else 0.0


@np.errstate(invalid="ignore")  # of hinges in a row, which do not reach every orientation
def project_position(system: System, q: Array) -> Array:
    """Find the coordinates near q that meet phi(q) = 0 to round-off, by Newton's steps of least length.

    Nearly redundant constraints stay open as far as the others leave them.

    Raises:
        AssemblyError: if the independent constraints stay open by more than `CLOSURE_TOLERANCE`, or nearly
            redundant ones by more than the scene's tolerance.
    """
    unused = rows_left_out(system)
    at = best = system.retract(q, np.zeros(system.nv))
    worse, least = 0, np.inf
    for _ in range(NEWTON_STEPS + 1):
        phi, jacobian = system.phi(at), without(system.phi_jacobian(at), unused)
        open_by = largest(without(phi, unused))
        worse = 0 if open_by < least else worse + 1
        if worse == 0:
            best, least = at, open_by
        if not np.isfinite(phi).all() or least < ROUND_OFF * system.mechanism.size or worse == 2:
            break
        step = minimum_norm(jacobian, without(phi, unused), system.phi_units, system.velocity_units)
        at = system.retract(at, -step)
    if not is_closed(system, system.phi(best)):
        joint, gap = worst_joint(system, system.state(best, np.zeros(system.nv)))
        raise AssemblyError(joint, gap, CLOSURE_TOLERANCE)
    return best


def is_closed(system: System, phi: Array) -> bool:
    """Whether residuals (k,) are within `CLOSURE_TOLERANCE`, or noise of rows that are left out."""
    unused = rows_left_out(system)
    noise = largest(phi[unused] / system.phi_units[unused])
    loose = loosely_closed(system.scene.redundancy_tolerance)
    return largest(without(phi, unused)) <= CLOSURE_TOLERANCE and noise <= loose


def project_velocity(system: System, q: Array, v: Array) -> Array:
    """The velocities nearest to v that meet the constraints' rate, Phi_q v + Phi_t = 0."""
    unused = rows_left_out(system)
    jacobian, excess = without(system.phi_jacobian(q), unused), without(opening(system, q, v), unused)
    step = minimum_norm(jacobian, excess, system.phi_units, system.velocity_units)
    return np.asarray(v - step)


def joint_residuals(mechanism: Mechanism, state: State) -> Array:
    """(k,) residuals of all joints' equations in a state, m or rad."""
    frames = state.frames()
    return np.concatenate(
        [np.zeros(0), *(e.phi(frames[e.first], frames[e.second]) for e in mechanism.equations)]
    )


def joint_violations(mechanism: Mechanism, state: State) -> Array:
    """(j,) largest residual of each joint's equations in a state, m or rad."""
    frames = state.frames()
    return np.array([largest(e.phi(frames[e.first], frames[e.second])) for e in mechanism.equations])


def check_still_closed(scene: Scene, times: Array, phi: Array) -> None:
    """Raise `IntegrationError` at the first of times (n,) with a residual (n, k) of more than `COME_OPEN`.

    Residuals are those of all joints, then of couplings. Where the first are larger than that, as of a start
    that nobody has checked, twice as much is allowed: gains may still close it. Nothing is known of the steps
    between the times, which are those of outputs: a joint that closes again by the next one passes.
    """
    coupled, mechanism = couplings(scene), scene.mechanism
    gaps = np.abs(phi) / row_units(mechanism.equations, coupled, mechanism.longest)
    largest_gap = np.max(gaps, axis=1, initial=0.0)
    start = float(largest_gap[0])
    wide = np.flatnonzero(largest_gap > (COME_OPEN if start <= COME_OPEN else 2.0 * start))
    if not wide.size:
        return
    row = int(wide[0])
    worst = int(np.argmax(gaps[row]))
    owner = row_owners(mechanism.equations, coupled)[worst]
    gap = abs(float(phi[row, worst]))
    reason = f"joint {owner!r} has come open by {gap:.3g} (m or rad); projection would keep it closed"
    raise IntegrationError(float(times[row]), reason)


def worst_joint(system: System, state: State) -> tuple[str, float]:
    """Name and residual (m or rad) of the joint or gear that is open the most."""
    coupled = couplings(system.scene)
    time = system.time if isinstance(system, Rheonomic) else 0.0
    phi, _ = residuals(system.mechanism, coupled, state.frames(), time)
    gaps = np.concatenate([joint_violations(system.mechanism, state), np.abs(phi)])
    worst = int(np.argmax(gaps))
    names = (*system.mechanism.joint_names, *(coupling.name for coupling in coupled))
    return names[worst], float(gaps[worst])
