"""Spatial tendons of a MuJoCo model that are springs and dampers between points of two bodies."""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.placements import site_placement
from newton_euler.reading.robot import FileSpring


def point_springs(model: mujoco.MjModel, *, has_springs: bool, has_dampers: bool) -> dict[int, FileSpring]:
    """Describe tendons between two sites that have a linear spring or damper.

    Args:
        model: the model.
        has_springs, has_dampers: whether springs and dampers act, by the option flags of the model.

    Returns:
        the springs, by number of the tendon.
    """
    is_linear = ~np.any([*model.tendon_stiffnesspoly.T, *model.tendon_dampingpoly.T], axis=0)
    is_elastic = model.tendon_plasticadr < 0
    acts = (model.tendon_stiffness != 0.0) | (model.tendon_damping != 0.0)
    found = {}
    for tendon in np.flatnonzero(acts & is_linear & is_elastic).tolist():
        start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
        wraps = slice(start, start + count)
        if count != 2 or np.any(model.wrap_type[wraps] != mujoco.mjtWrap.mjWRAP_SITE):
            continue
        first, second = model.wrap_objid[wraps].tolist()
        low, high = model.tendon_lengthspring[tendon].tolist()
        found[tendon] = FileSpring(
            model.tendon(tendon).name,
            first=int(model.site_bodyid[first]) - 1,
            second=int(model.site_bodyid[second]) - 1,
            first_frame=site_placement(model, first),
            second_frame=site_placement(model, second),
            stiffness=float(model.tendon_stiffness[tendon]) * has_springs,
            damping=float(model.tendon_damping[tendon]) * has_dampers,
            rest=(low, high),
        )
    return found
