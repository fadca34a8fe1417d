"""Scene of a flyball governor: a slider that hangs on stiff, damped springs between two turning arms.

Problem A05 of the IFToMM library of computational benchmark problems (M. Gonzalez, D. Dopico, U. Lugris,
J. Cuadrado, A benchmarking system for MBS simulation software, Multibody System Dynamics 16, 2006). Its
springs have 8e5 N/m and 4e4 N s/m, which makes the problem stiff: explicit methods need thousands of steps.
The shaft has no motor. It turns freely and conserves its angular momentum.
"""

from __future__ import annotations

import numpy as np

from crosscheck.library.measure import Quantity, angle, angular_velocity, position, velocity
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.forces import PointSpring
from newton_euler.model.joint_kinds import Prismatic, Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

BAR_MASS, BAR_LENGTH, SECTION = 0.3, 1.0, 0.01
"""Mass (kg), length and width of the square section (m) of the shaft and of each arm."""

AXIAL = BAR_MASS * SECTION**2 / 6.0
ACROSS = BAR_MASS * (BAR_LENGTH**2 + SECTION**2) / 12.0
"""Moments of inertia of the shaft and of each arm along and across the bar, kg m^2."""

BALL_MASS = 5.0
"""Mass of the point at the end of each arm, kg."""

SLIDER_MASS, SLIDER_WIDTH = 3.0, 0.1
"""Mass (kg) and side (m) of the slider, a cube."""

HINGE_RADIUS = 0.05
"""Distance of the arms' hinges and of the springs' lower ends from the axis of the shaft, m."""

SPRING_STIFFNESS, SPRING_DAMPING, SPRING_REST_LENGTH = 8e5, 4e4, 0.5
"""Stiffness (N/m), damping (N s/m) and rest length (m) of each spring."""

HEIGHT = 0.5
"""Initial height of the slider, m."""

ALPHA = np.pi / 6.0
"""Initial angle of the arms below the horizontal, rad."""

SHAFT_SPEED = 2.0 * np.pi
"""Initial angular velocity of the shaft, rad/s."""

X, Y, Z = np.eye(3)

SIDES = {"right": X, "left": -X}
"""Initial directions of the arms, outwards from the shaft."""


def flyball_governor() -> Scene:
    """Return the governor: two balls of 5 kg, at first one revolution per second, 10 s; gravity along -z."""
    shaft = Body("shaft", BAR_MASS, 0.5 * BAR_LENGTH * Z, np.diag([ACROSS, ACROSS, AXIAL]))
    slider = Body("slider", SLIDER_MASS, HEIGHT * Z, SLIDER_MASS * SLIDER_WIDTH**2 / 6.0 * np.eye(3))
    joints = [
        Revolute("bearing", "ground", "shaft", np.zeros(3), axis=Z),
        Prismatic("guide", "shaft", "slider", HEIGHT * Z, axis=Z),
    ]
    # Arms on hinges at the top of the shaft, and springs from the middle of the arms to the slider
    arms, springs = [], []
    for side, outwards in SIDES.items():
        hinge = HINGE_RADIUS * outwards + BAR_LENGTH * Z
        along = np.cos(ALPHA) * outwards - np.sin(ALPHA) * Z
        middle = hinge + 0.5 * BAR_LENGTH * along
        arms.append(_arm(f"arm_{side}", hinge, along))
        joints.append(Revolute(f"hinge_{side}", "shaft", f"arm_{side}", hinge, axis=Y))
        springs.append(
            PointSpring(
                f"spring_{side}",
                f"arm_{side}",
                "slider",
                middle,
                HINGE_RADIUS * outwards + HEIGHT * Z,
                stiffness=SPRING_STIFFNESS,
                damping=SPRING_DAMPING,
                rest_length=SPRING_REST_LENGTH,
            )
        )
    # All bodies turn about the axis of the shaft at first
    mechanism = Mechanism([Body.ground(), shaft, slider, *arms], joints)
    state = State.initial(mechanism)
    state.angular_velocity[1:] = SHAFT_SPEED * Z
    state.linear_velocity[1:] = np.cross(SHAFT_SPEED * Z, state.position[1:])
    return Scene(
        "flyball_governor",
        mechanism,
        duration=10.0,
        output_period=0.001,
        gravity=-9.81 * Z,
        initial_state=state,
        forces=tuple(springs),
        description="flyball governor with stiff damped springs, turning freely",
    )


def _arm(name: str, hinge: Array, along: Array) -> Body:
    """Return an arm with its ball; the arm extends from its hinge (3,), m, along a unit vector (3,)."""
    mass = BAR_MASS + BALL_MASS
    lever = (0.5 * BAR_MASS + BALL_MASS) * BAR_LENGTH / mass  # distance of the center of mass from the hinge
    # parallel-axis terms of bar and ball about the common center of mass
    steiner = BAR_MASS * (lever - 0.5 * BAR_LENGTH) ** 2 + BALL_MASS * (BAR_LENGTH - lever) ** 2
    projector = np.outer(along, along)
    inertia = AXIAL * projector + (ACROSS + steiner) * (np.eye(3) - projector)
    return Body(name, mass, hinge + lever * along, inertia)


def _alpha(run: Trajectory) -> Array:
    """Return the angle (n,), rad, of the right arm below the horizontal."""
    along = rotations(run.quaternion[:, run.body_names.index("arm_right")]) @ ARM
    return np.asarray(np.arctan2(-along[:, 2], np.hypot(along[:, 0], along[:, 1])))


def _energy_dissipated(run: Trajectory) -> Array:
    """Return the mechanical energy (n,), J, lost since the start."""
    assert run.kinetic_energy is not None
    assert run.potential_energy is not None
    energy = run.kinetic_energy + run.potential_energy
    return np.asarray(energy[0] - energy)


ARM = np.cos(ALPHA) * X - np.sin(ALPHA) * Z
"""Direction (3,) of the right arm, in its own frame; at first all body frames are parallel to the world."""

CENTER = np.zeros(3)
"""Center of mass (3,) of a body, in its own frame, m."""

REFERENCE_QUANTITIES: dict[str, Quantity] = {
    "s": lambda run: position(run, "slider", CENTER)[:, 2],
    "s_dot": lambda run: velocity(run, "slider", CENTER)[:, 2],
    "alpha": _alpha,
    "shaft_angle": lambda run: angle(run, "shaft", Z),
    "shaft_omega": lambda run: angular_velocity(run, "shaft") @ Z,
    "energy_dissipated": _energy_dissipated,
}
"""Quantities with values from an independent computation in minimal coordinates, by name.

Height s (m) and velocity (m/s) of the slider; angle alpha (rad) of the arms below the horizontal; angle (rad)
and angular velocity (rad/s) of the shaft; energy lost to the dampers (J)."""
