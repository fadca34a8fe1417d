"""A flyball governor whose slider hangs on stiff, damped springs.

Problem A05 of the IFToMM library of computational benchmark problems (M. Gonzalez, D. Dopico, U. Lugris,
J. Cuadrado, A benchmarking system for MBS simulation software, Multibody System Dynamics 16, 2006), with its
springs of 8e5 N/m and 4e4 N s/m. No motor: the shaft turns freely and its angular momentum is kept. The
arms' angle is measured from horizontal, downwards. The problem goes on for 10 s; here it is the first one,
a swing down and back, because explicit engines take thousands of steps for it.
"""

from __future__ import annotations

import numpy as np

from crosscheck.scenes.measure import Quantity, angle, angular_velocity, position, velocity
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.forces import PointSpring
from newton_euler.model.joint_kinds import Prismatic, Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

BAR_MASS, BAR_LENGTH, SECTION = 0.3, 1.0, 0.01
"""Of the shaft and of each arm, kg and m."""

AXIAL = BAR_MASS * SECTION**2 / 6.0
ACROSS = BAR_MASS * (BAR_LENGTH**2 + SECTION**2) / 12.0
"""Their moments of inertia, kg m^2."""

BALL_MASS = 5.0
"""Of the point mass at the end of each arm, kg."""

SLIDER_MASS, SLIDER_WIDTH = 3.0, 0.1
"""A cube, kg and m."""

HINGE_RADIUS = 0.05
"""Of the arms' hinges and the springs' ends from the shaft's axis, m."""

STIFFNESS, DAMPING, REST_LENGTH = 8e5, 4e4, 0.5
"""Of each spring, N/m, N s/m and m."""

HEIGHT = 0.5
"""Of the slider at first, m."""

ALPHA = np.pi / 6.0
"""Of the arms below horizontal at first, rad."""

SPEED = 2.0 * np.pi
"""Of the shaft at first, rad/s."""

X, Y, Z = np.eye(3)

SIDES = {"right": X, "left": -X}
"""Where the arms are at first."""


def flyball_governor() -> Scene:
    """Two balls of 5 kg turning at one revolution a second, the arms moving from 30 degrees, 10 s."""
    shaft = Body("shaft", BAR_MASS, 0.5 * BAR_LENGTH * Z, np.diag([ACROSS, ACROSS, AXIAL]))
    slider = Body("slider", SLIDER_MASS, HEIGHT * Z, SLIDER_MASS * SLIDER_WIDTH**2 / 6.0 * np.eye(3))
    joints = [
        Revolute("bearing", "ground", "shaft", np.zeros(3), axis=Z),
        Prismatic("guide", "shaft", "slider", HEIGHT * Z, axis=Z),
    ]
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
                stiffness=STIFFNESS,
                damping=DAMPING,
                rest_length=REST_LENGTH,
            )
        )
    mechanism = Mechanism([Body.ground(), shaft, slider, *arms], joints)
    state = State.initial(mechanism)
    state.angular_velocity[1:] = SPEED * Z
    state.linear_velocity[1:] = np.cross(SPEED * Z, state.position[1:])
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
    """An arm with its ball, from its hinge along a unit vector (3,)."""
    mass = BAR_MASS + BALL_MASS
    lever = (0.5 * BAR_MASS + BALL_MASS) * BAR_LENGTH / mass  # of the center of mass
    parts = BAR_MASS * (lever - 0.5 * BAR_LENGTH) ** 2 + BALL_MASS * (BAR_LENGTH - lever) ** 2
    axial = np.outer(along, along)
    inertia = AXIAL * axial + (ACROSS + parts) * (np.eye(3) - axial)
    return Body(name, mass, hinge + lever * along, inertia)


def _alpha(run: Trajectory) -> Array:
    """(n,) rad: how far the right arm points down."""
    along = rotations(run.quaternion[:, run.body_names.index("arm_right")]) @ ARM
    return np.asarray(np.arctan2(-along[:, 2], np.hypot(along[:, 0], along[:, 1])))


def _energy_dissipated(run: Trajectory) -> Array:
    assert run.kinetic_energy is not None
    assert run.potential_energy is not None
    energy = run.kinetic_energy + run.potential_energy
    return np.asarray(energy[0] - energy)


ARM = np.cos(ALPHA) * X - np.sin(ALPHA) * Z
CENTER = np.zeros(3)

FIGURES: dict[str, Quantity] = {
    "s": lambda run: position(run, "slider", CENTER)[:, 2],
    "s_dot": lambda run: velocity(run, "slider", CENTER)[:, 2],
    "alpha": _alpha,
    "shaft_angle": lambda run: angle(run, "shaft", Z),
    "shaft_omega": lambda run: angular_velocity(run, "shaft") @ Z,
    "energy_dissipated": _energy_dissipated,
}
"""Height (m) and velocity (m/s) of the slider, angle of the arms below horizontal (rad), angle (rad) and rate
(rad/s) of the shaft, energy lost to the dampers (J)."""
