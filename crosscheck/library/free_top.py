"""Scene of a free top: an asymmetric body without torque. Elliptic functions solve its equations of motion.

L. D. Landau, E. M. Lifshitz, Mechanics, section 37. The case `dzhanibekov` starts next to the unstable axis:
while the top stays near this axis, errors double every 1.2 s. The case `hairer` has the moments and the
angular momentum (cos 1.1, 0, sin 1.1) of E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration. No
mass distribution has its moments 2, 1 and 2/3.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from crosscheck.library.measure import Quantity, components, quaternion, spin
from newton_euler.model.joint_kinds import Free
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

CASES = {
    "general": ((1.0, 2.0, 3.0), (0.3, -0.7, 1.1)),
    "dzhanibekov": ((1.0, 2.0, 3.0), (0.001, 1.0, 0.001)),
    "hairer": ((2.0, 1.0, 2.0 / 3.0), (np.cos(1.1) / 2.0, 0.0, np.sin(1.1) * 1.5)),
}
"""Principal moments (kg m^2) and initial angular velocity in the body frame (rad/s) of each case."""


def free_top(case: Literal["general", "dzhanibekov", "hairer"] = "general") -> Scene:
    """Return a top of 1 kg that spins freely for 10 s; its body frame starts aligned with the world frame.

    Args:
        case: moments of inertia and initial angular velocity, see `CASES`.
    """
    moments, omega = CASES[case]
    top = Body(
        "top",
        mass=1.0,
        center_of_mass=np.zeros(3),
        inertia=np.diag(moments),
        allow_unrealisable_inertia=case == "hairer",
    )
    mechanism = Mechanism([Body.ground(), top], [Free("floating", "ground", "top", point=np.zeros(3))])
    state = State.initial(mechanism)
    state.angular_velocity[1] = omega
    return Scene(
        "free_top",
        mechanism,
        duration=10.0,
        output_period=0.01,
        initial_state=state,
        description="torque-free asymmetric top, closed form known",
    )


REFERENCE_QUANTITIES: dict[str, Quantity] = {
    **components(("omega_x", "omega_y", "omega_z"), lambda run: spin(run, "top")),
    **components(("q0", "q1", "q2", "q3"), lambda run: quaternion(run, "top")),
}
"""Quantities of a run that are compared with the elliptic functions: angular velocity in the body frame
(rad/s) and orientation (w, x, y, z)."""
