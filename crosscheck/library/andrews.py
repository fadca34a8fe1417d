"""Scene of Andrews' squeezing mechanism: seven bodies in a plane and three loops, driven by a constant
torque.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section VII.7; parameters and published
solution of the Test Set for IVP Solvers (F. Mazzia, C. Magherini, release 2.4, problem andrews); problem A03
of the IFToMM library of computational benchmark problems. The torque turns the crank against a spring between
the triangle BDE and the fixed point C. All hinge axes are along z. There is no gravity.
"""

from __future__ import annotations

import numpy as np

from crosscheck.library.measure import Quantity, angle, angular_velocity, components, position
from newton_euler.model.forces import PointSpring, Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

BETA, THETA, GAMMA, PHI, DELTA, OMEGA, EPSILON = (
    -0.0617138900142764496358948458001,
    0.0,
    0.455279819163070380255912382449,
    0.222668390165885884674473185609,
    0.48736497954384255022559895353,
    -0.222668390165885884674473185609,
    1.23054744454982119249735015568,
)
"""Initial angles of the bodies, rad, as the Test Set names them."""

A, B, C = np.array([[-0.06934, -0.00227, 0.0], [-0.03635, 0.03273, 0.0], [0.014, 0.072, 0.0]])
"""Fixed points, m. The crank turns about the origin."""

MASSES = {
    "crank": 0.04325,
    "coupler": 0.00365,
    "triangle": 0.02373,
    "rod_EG": 0.00706,
    "lever_AG": 0.0705,
    "rod_EH": 0.00706,
    "lever_AH": 0.05498,
}
"""Masses of the bodies, K1 to K7 in the Test Set, kg."""

INERTIAS = (2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5)
"""Moments of inertia of K1 to K7 along z about their centers of mass, kg m^2. Moments about other axes
have no effect in a plane."""

TORQUE = 0.033
"""Torque on the crank, N m."""

SPRING_STIFFNESS, SPRING_REST_LENGTH = 4530.0, 0.07785
"""Stiffness (N/m) and rest length (m) of the spring."""

X, Y, Z = np.eye(3)


def _turned(angle: float, x: float, y: float = 0.0) -> Array:
    """Return the vector (3,), m, with components x and y in a frame turned about z by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([x * c - y * s, x * s + y * c, 0.0])


F = _turned(BETA, 0.007)
E = B + _turned(GAMMA, 0.0, -0.035)
D = B + _turned(GAMMA, 0.02, -0.018)
G = A + _turned(DELTA, 0.04)
H = A + _turned(EPSILON, 0.0, -0.04)
"""Initial positions of the moving points D to H of the Test Set, m. Four bodies meet at E."""

CRANK_CENTER = _turned(BETA, 0.00092)
"""Initial center of mass of the crank, m."""


def andrews() -> Scene:
    """Return the mechanism: 0.033 N m turn a crank of 7 mm from rest to over 1000 rad/s in 0.05 s."""
    centers = (  # of mass, in the order of `MASSES`; lengths in m are those of the Test Set
        CRANK_CENTER,
        F + _turned(BETA + THETA, -0.0115),
        B + _turned(GAMMA, 0.01043, -0.01874),
        G + _turned(PHI + DELTA, 0.0, 0.01421 - 0.02),
        A + _turned(DELTA, 0.02308, 0.00916),
        H + _turned(OMEGA + EPSILON, 0.02 - 0.01421),
        A + _turned(EPSILON, -0.00449, -0.01228),
    )
    bodies = [
        Body(name, mass, center, moment * np.eye(3))
        for (name, mass), moment, center in zip(MASSES.items(), INERTIAS, centers, strict=True)
    ]
    hinges = (
        ("O", "ground", "crank", np.zeros(3)),
        ("F", "crank", "coupler", F),
        ("B", "ground", "triangle", B),
        ("A_G", "ground", "lever_AG", A),
        ("G", "lever_AG", "rod_EG", G),
        ("A_H", "ground", "lever_AH", A),
        ("H", "lever_AH", "rod_EH", H),
    )
    joints: list[Joint] = [Revolute(*hinge, axis=Z) for hinge in hinges]
    # ball joints, not hinges: a planar loop closed at a ball has one redundant constraint instead of three
    joints += [Spherical(f"E_{body}", "triangle", body, E) for body in ("coupler", "rod_EG", "rod_EH")]
    return Scene(
        "andrews",
        Mechanism([Body.ground(), *bodies], joints),
        duration=0.05,
        output_period=0.001,
        forces=(
            PointSpring(
                "spring",
                "ground",
                "triangle",
                C,
                D,
                stiffness=SPRING_STIFFNESS,
                rest_length=SPRING_REST_LENGTH,
            ),
            Wrench("motor", "crank", np.zeros(3), force=np.zeros(3), torque=TORQUE * Z, frame="world"),
        ),
        description="Andrews' squeezing mechanism, seven bodies and three loops driven by a constant torque",
    )


ANGLES: dict[str, tuple[float, str, str]] = {
    "beta": (BETA, "crank", "ground"),
    "Theta": (THETA, "coupler", "crank"),
    "gamma": (GAMMA, "triangle", "ground"),
    "Phi": (PHI, "rod_EG", "lever_AG"),
    "delta": (DELTA, "lever_AG", "ground"),
    "Omega": (OMEGA, "rod_EH", "lever_AH"),
    "epsilon": (EPSILON, "lever_AH", "ground"),
}
"""Initial value (rad), body and reference body of each angle of the Test Set."""


def _angle(initial: float, body: str, against: str) -> Quantity:
    """Return the function that measures the angle (n,), rad, of a body relative to another one."""
    return lambda run: initial + angle(run, body, Z) - angle(run, against, Z)


def _rate(body: str, against: str) -> Quantity:
    """Return the function that measures the angular velocity (n,), rad/s, of a body relative to another."""
    return lambda run: (angular_velocity(run, body) - angular_velocity(run, against)) @ Z


def _crank_pin(run: Trajectory) -> Array:
    """Return the positions (n, 3) of the pin F at the end of the crank, m."""
    return position(run, "crank", F - CRANK_CENTER)


REFERENCE_QUANTITIES: dict[str, Quantity] = {
    **{name: _angle(*entry) for name, entry in ANGLES.items()},
    **{f"{name}_dot": _rate(*entry[1:]) for name, entry in ANGLES.items()},
    **components(("F_x", "F_y"), _crank_pin),
}
"""Quantities with published values: angles of the Test Set (rad, with revolutions), their rates (rad/s), and
the position of the crank's pin (m) of problem A03."""
