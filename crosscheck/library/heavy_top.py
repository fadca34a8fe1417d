"""Scene of a heavy top: a fast symmetric top on a fixed point that swings down to within 1e-6 rad of hanging
vertically.

M. Geradin, A. Cardona, Flexible Multibody Dynamics, 2001; parameters as in Z. Terze, A. Muller,
D. Zlatar, Singularity-free time integration of rotational quaternions using non-redundant ordinary
differential equations, Multibody System Dynamics 38, 2016. The initial rate about the vertical is -4.61538
rad/s, as printed there. Up to the rounding of this number, the angular momentum about the vertical is that
of a hanging top with the same spin. Therefore the top comes so close to hanging.
"""

from __future__ import annotations

import numpy as np

from crosscheck.library.measure import Quantity, components, position, quaternion, spin
from newton_euler.model.joint_kinds import Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

TOP_MASS = 15.0
"""Mass of the top, kg."""

MOMENTS = (0.234375, 0.46875, 0.234375)
"""Principal moments of inertia about the center of mass, kg m^2."""

CENTER_OF_MASS = np.array([0.0, 1.0, 0.0])
"""Initial position (3,) of the center of mass from the fixed point, m."""

INITIAL_ANGULAR_VELOCITY = np.array([0.0, 150.0, -4.61538])
"""Initial angular velocity (3,), body and world frame, rad/s."""


def heavy_top() -> Scene:
    """Return the top: 15 kg, 150 rad/s about a horizontal axis, 1.5 s, two nutations; gravity along -z."""
    top = Body("top", TOP_MASS, CENTER_OF_MASS, np.diag(MOMENTS))
    mechanism = Mechanism([Body.ground(), top], [Spherical("tip", "ground", "top", np.zeros(3))])
    state = State.initial(mechanism)
    state.angular_velocity[1] = INITIAL_ANGULAR_VELOCITY
    state.linear_velocity[1] = np.cross(INITIAL_ANGULAR_VELOCITY, CENTER_OF_MASS)
    return Scene(
        "heavy_top",
        mechanism,
        duration=1.5,
        output_period=0.01,
        gravity=np.array([0.0, 0.0, -9.81]),
        initial_state=state,
        description="fast heavy symmetric top on a fixed point, passes close to hanging",
    )


REFERENCE_QUANTITIES: dict[str, Quantity] = {
    **components(("com_x", "com_y", "com_z"), lambda run: position(run, "top", offset=np.zeros(3))),
    **components(("omega_x", "omega_y", "omega_z"), lambda run: spin(run, "top")),
    **components(("q0", "q1", "q2", "q3"), lambda run: quaternion(run, "top")),
}
"""Functions that measure the quantities of a run for which `crosscheck.library.references` has values from a
Taylor series: center of mass (m), angular velocity in the body frame (rad/s), orientation (w, x, y, z)."""
