"""Velocities and accelerations of MuJoCo's bodies, in the world frame, as its data holds them."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from newton_euler.scalars import Array


def body_velocity(model: Any, data: Any, body: int) -> tuple[Array, Array]:
    """(3,) of the center of mass, m/s, and (3,) angular, rad/s, after `mj_fwdVelocity`."""
    out = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, out, 0)
    return out[3:], out[:3]


def body_acceleration(model: Any, data: Any, body: int) -> tuple[Array, Array]:
    """(3,) of the center of mass, m/s^2, and (3,) angular, rad/s^2, after `mj_rnePostConstraint`."""
    out = np.zeros(6)
    mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_BODY, body, out, 0)
    return out[3:] + model.opt.gravity, out[:3]  # without gravity it is what an accelerometer reads
