"""Scene of four-bar linkages in a row: N parallelograms that share their vertical bars, one degree of
freedom."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from crosscheck.library.chain import ROD_LENGTH, rod
from crosscheck.library.measure import Quantity, angular_velocity, components, position, velocity
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

COUPLER_SPEED = 1.0
"""Initial velocity of the couplers along x, m/s."""

X, Y, Z = np.eye(3)


def four_bar(N: Annotated[int, range(1, 1001)] = 2) -> Scene:
    """Return N parallelograms of rods of 1 m and 1 kg, upright at the start, couplers moving at 1 m/s.

    A parallelogram is called a window: two vertical bars on hinges at their feet, and a coupler between their
    tops. Problem A02 of the IFToMM library of computational benchmark problems. All bars stay parallel, so
    one angle describes any number of windows, and elliptic functions give this angle. If all bars lie on one
    line, the configuration is singular: each window can fold as a parallelogram or as an antiparallelogram,
    and there are N + 1 degrees of freedom.

    A planar loop of hinges has three redundant constraints. The right end of each coupler is a ball joint,
    which leaves one redundant constraint per window, along z.

    Args:
        N: number of windows; there are N + 1 vertical bars and N couplers.
    """
    feet = [k * ROD_LENGTH * X for k in range(N + 1)]
    tops = [foot + ROD_LENGTH * Y for foot in feet]
    bars = [f"bar_{k}" for k in range(N + 1)]
    couplers = [f"coupler_{k}" for k in range(N)]
    bodies = [
        Body.ground(),
        *(rod(name, foot, Y) for name, foot in zip(bars, feet, strict=True)),
        *(rod(name, top, X) for name, top in zip(couplers, tops[:-1], strict=True)),
    ]
    joints: list[Joint] = [Revolute(f"pivot_{k}", "ground", bars[k], feet[k], axis=Z) for k in range(N + 1)]
    for k, coupler in enumerate(couplers):
        joints.append(Revolute(f"hinge_{k}", bars[k], coupler, tops[k], axis=Z))
        joints.append(Spherical(f"ball_{k}", coupler, bars[k + 1], tops[k + 1]))
    mechanism = Mechanism(bodies, joints)
    return Scene(
        "four_bar",
        mechanism,
        duration=10.0,
        output_period=0.01,
        gravity=-9.81 * Y,
        initial_state=_swinging(mechanism, N + 1),
        description="N four-bar windows in a row, one degree of freedom, closed form known",
    )


def _swinging(mechanism: Mechanism, bars: int) -> State:
    """Return the initial state: bars turn about their feet, couplers translate.

    Args:
        mechanism: the mechanism, with the bars before the couplers.
        bars: number of bars.
    """
    state = State.initial(mechanism)
    state.linear_velocity[1 : 1 + bars] = 0.5 * COUPLER_SPEED * X
    state.angular_velocity[1 : 1 + bars] = -COUPLER_SPEED / ROD_LENGTH * Z
    state.linear_velocity[1 + bars :] = COUPLER_SPEED * X
    return state


TOP = 0.5 * ROD_LENGTH * Y
"""Top (3,) of a bar in its own frame, m."""

REFERENCE_QUANTITIES: dict[str, Quantity] = {
    **components(("B0_x", "B0_y"), lambda run: position(run, "bar_0", TOP)),
    **components(("B0_vx", "B0_vy"), lambda run: velocity(run, "bar_0", TOP)),
    "bar_omega_cw": lambda run: -angular_velocity(run, "bar_0") @ Z,
}
"""Position (m), velocity (m/s) of the first bar's top; clockwise angular velocity of the bars (rad/s).

`crosscheck/library/references/four_bar.json` has exact values of these quantities for comparison."""
