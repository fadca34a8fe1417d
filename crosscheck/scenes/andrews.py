"""Andrews' squeezing mechanism: seven flat bodies, three loops, fast.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section VII.7; parameters and published
solution of the Test Set for IVP Solvers (F. Mazzia, C. Magherini, release 2.4, problem andrews); problem A03
of the IFToMM library of computational benchmark problems. A constant torque drives the crank against a
spring from the triangle BDE to the fixed point C. All axes are along z; no gravity.
"""

from __future__ import annotations

import numpy as np

from crosscheck.scenes.measure import Quantity, angle, angular_velocity, components, position
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
"""Initial angles, rad."""

A, B, C = np.array([[-0.06934, -0.00227, 0.0], [-0.03635, 0.03273, 0.0], [0.014, 0.072, 0.0]])
"""Fixed points, m; the crank turns about the origin."""

MASSES = {
    "crank": 0.04325,
    "coupler": 0.00365,
    "triangle": 0.02373,
    "rod_EG": 0.00706,
    "lever_AG": 0.0705,
    "rod_EH": 0.00706,
    "lever_AH": 0.05498,
}
"""Of the bodies K1 to K7, kg."""

INERTIAS = (2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5)
"""About their centers of mass along z, kg m^2; what they are across z plays no part."""

TORQUE = 0.033
"""On the crank, N m."""

STIFFNESS, REST_LENGTH = 4530.0, 0.07785
"""Of the spring, N/m and m."""

X, Y, Z = np.eye(3)


def _along(turn: float, length: float, across: float = 0.0) -> Array:
    """(3,) m: `length` along x and `across` along y of a frame turned about z."""
    c, s = np.cos(turn), np.sin(turn)
    return np.array([length * c - across * s, length * s + across * c, 0.0])


F = _along(BETA, 0.007)
E = B + _along(GAMMA, 0.0, -0.035)
D = B + _along(GAMMA, 0.02, -0.018)
G = A + _along(DELTA, 0.04)
H = A + _along(EPSILON, 0.0, -0.04)
"""Moving points at first, m; E is where four bodies meet."""


def andrews() -> Scene:
    """The crank of 7 mm that 0.033 N m turn up to 1000 rad/s and more, from rest, 0.05 s."""
    centers = (
        _along(BETA, 0.00092),
        F + _along(BETA + THETA, -0.0115),
        B + _along(GAMMA, 0.01043, -0.01874),
        G + _along(PHI + DELTA, 0.0, 0.01421 - 0.02),
        A + _along(DELTA, 0.02308, 0.00916),
        H + _along(OMEGA + EPSILON, 0.02 - 0.01421),
        A + _along(EPSILON, -0.00449, -0.01228),
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
    # balls in place of hinges: cut there, a flat loop has one equation too many, which nothing can break
    joints += [Spherical(f"E_{body}", "triangle", body, E) for body in ("coupler", "rod_EG", "rod_EH")]
    return Scene(
        "andrews",
        Mechanism([Body.ground(), *bodies], joints),
        duration=0.05,
        output_period=0.001,
        forces=(
            PointSpring("spring", "ground", "triangle", C, D, stiffness=STIFFNESS, rest_length=REST_LENGTH),
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
"""Initial value, rad, the body that has turned and the one that it is seen from."""


def _angle(initial: float, body: str, against: str) -> Quantity:
    return lambda run: initial + angle(run, body, Z) - angle(run, against, Z)


def _rate(body: str, against: str) -> Quantity:
    return lambda run: (angular_velocity(run, body) - angular_velocity(run, against)) @ Z


def _crank_pin(run: Trajectory) -> Array:
    return position(run, "crank", F - _along(BETA, 0.00092))


FIGURES: dict[str, Quantity] = {
    **{name: _angle(*entry) for name, entry in ANGLES.items()},
    **{f"{name}_dot": _rate(*entry[1:]) for name, entry in ANGLES.items()},
    **components(("F_x", "F_y"), _crank_pin),
}
"""The seven angles of the Test Set (rad, whole turns counted), their rates (rad/s), the crank's pin (m)."""
