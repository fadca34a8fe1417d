"""Planar chains of rods on hinges, and Lagrange's equations of the same chains."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene

Y = np.array([0.0, 1.0, 0.0])
G = 9.81


def hanging_chain(masses, length, angle, duration):
    """Return links of equal length, m, in a row at an angle from the vertical, on hinges about y."""
    along = length * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    bodies, joints = [Body.ground()], []
    for k, mass in enumerate(masses):
        inertia = mass * length**2 / 12.0 * np.diag([1.0, 1.1, 0.9])
        bodies.append(Body(f"link_{k}", mass, (k + 0.5) * along, inertia))
        parent = bodies[k].name
        joints.append(Revolute(f"hinge_{k}", parent, f"link_{k}", k * along, axis=Y))
    return Scene("chain", Mechanism(bodies, joints), duration, 0.1 * duration, gravity=[0.0, 0.0, -G])


def lagrange(masses, length, angle, times):
    """Integrate Lagrange's equations of the angles from the vertical: centers (n, 2, links), m."""
    count = len(masses)
    reach = np.tril(np.ones((count, count)), -1) + 0.5 * np.eye(count)  # of angles on centers, in lengths
    weights = length**2 * reach.T @ np.diag(masses) @ reach
    inertias = 1.1 * np.array(masses) * length**2 / 12.0
    moments = G * length * (np.array(masses) @ reach)

    def rates(_, y):
        angles, speeds = y[:count], y[count:]
        between = angles[:, None] - angles
        matrix = weights * np.cos(between) + np.diag(inertias)
        return [
            *speeds,
            *np.linalg.solve(matrix, -weights * np.sin(between) @ speeds**2 - moments * np.sin(angles)),
        ]

    begun = np.concatenate([np.full(count, angle), np.zeros(count)])
    found = solve_ivp(rates, times[[0, -1]], begun, "DOP853", times, rtol=1e-12, atol=1e-12)
    angles = found.y[:count].T
    return length * np.stack([np.sin(angles), -np.cos(angles)], axis=-1).transpose(0, 2, 1) @ reach.T
