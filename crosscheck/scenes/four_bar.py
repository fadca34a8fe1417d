"""Four-bar windows in a row: N parallelograms that share their vertical bars, one degree of freedom."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from crosscheck.scenes.chain import LENGTH, rod
from crosscheck.scenes.measure import Quantity, angular_velocity, components, position, velocity
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

SPEED = 1.0
"""Of the couplers at the start, along x, m/s."""

X, Y, Z = np.eye(3)


def four_bar(N: Annotated[int, range(1, 1001)] = 2) -> Scene:
    """N windows of rods of 1 m and 1 kg, from upright with the couplers moving at 1 m/s, 10 s.

    Problem A02 of the IFToMM library of computational benchmark problems. All bars stay parallel, so
    one angle describes any number of windows and elliptic functions give it in closed form. Whenever
    the bars lie flat every window could fold its own way: N + 1 freedoms in place of one.

    A window cut at a hinge has three equations too many, as any flat loop in space. The right end of
    each coupler is a ball instead: cut there, it leaves just one, along z, which nothing can move.

    Args:
        N: windows; there are N + 1 vertical bars and N couplers.
    """
    feet = [k * LENGTH * X for k in range(N + 1)]
    tops = [foot + LENGTH * Y for foot in feet]
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
    """The initial pose with the first `bars` moving bodies turning about their feet, the others carried."""
    state = State.initial(mechanism)
    state.linear_velocity[1 : 1 + bars] = 0.5 * SPEED * X
    state.angular_velocity[1 : 1 + bars] = -SPEED / LENGTH * Z
    state.linear_velocity[1 + bars :] = SPEED * X
    return state


TOP = 0.5 * LENGTH * Y
"""Of a bar in its own frame, m."""

FIGURES: dict[str, Quantity] = {
    **components(("B0_x", "B0_y"), lambda run: position(run, "bar_0", TOP)),
    **components(("B0_vx", "B0_vy"), lambda run: velocity(run, "bar_0", TOP)),
    "bar_omega_cw": lambda run: -angular_velocity(run, "bar_0") @ Z,
}
"""Of the top of the first bar: position (m) and velocity (m/s); the bars' rate, clockwise (rad/s)."""
