"""Write dry friction and stops of a scene as MuJoCo's `frictionloss` and `range`, for `mjcf.write`.

MuJoCo simulates both by constraints, whose softness the attributes `solref...` and `solimp...` set. For the
rule see `mjcf.reading.friction_and_limits`, which reads these attributes: with the softness written here, a
joint that sticks creeps as in the scene, a stop has the same stiffness, and the same damping at the depth
`DAMPED_DEPTH`. The Stribeck effect is left out. A joint has one softness for both of its limits, that of the
stiffer stop. A stop of stiffness 0 exerts nothing, and is no limit.
"""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import mujoco

from mjcf.layout import number, numbers
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import coordinate_name
from newton_euler.model.switched_forces import JointFriction, JointStop, acting_stops
from newton_euler.reading.approximations import DAMPED_DEPTH, NO_LIMIT

FRICTION_IMPEDANCE, LIMIT_IMPEDANCE = 0.9, 0.95
"""Impedances d of written friction and limits: those of MuJoCo's default at depth 0 and at large depth."""

WIDTH = 1e-3
"""Third number of a written `solimp`, without effect as the impedance is constant."""


def constraint_attributes(scene: Scene, document: str) -> dict[str, dict[str, str]]:
    """Return the attributes of dry friction and stops by name of MuJoCo's joint.

    Args:
        scene: the scene.
        document: MJCF text of the scene without dry friction and stops.

    Raises:
        ValueError: if MuJoCo refuses the document.
    """
    model: Any = mujoco.MjModel.from_xml_string(document)
    attributes = defaultdict[str, dict[str, str]](dict)
    for force in scene.switched_forces:
        if isinstance(force, JointFriction) and force.coulomb:
            name = coordinate_name(scene.mechanism.joint(force.joint), force.coordinate)
            attributes[name] |= _friction_attributes(force, _mobility(model, name))
    for (joint, coordinate), stops in acting_stops(scene.switched_forces).items():
        name = coordinate_name(scene.mechanism.joint(joint), coordinate)
        attributes[name] |= _limit_attributes(stops, _mobility(model, name))
    return attributes


def _mobility(model: Any, joint: str) -> float:
    """Return the acceleration per force of a joint, by MuJoCo."""
    return float(model.dof_invweight0[model.joint(joint).dofadr[0]])


def _friction_attributes(force: JointFriction, inverse_inertia: float) -> dict[str, str]:
    """Return the attributes of dry friction: F = D b v_t, with D = d / ((1 - d) w)."""
    d = FRICTION_IMPEDANCE
    damping = force.coulomb * (1.0 - d) / d * inverse_inertia / force.transition_speed
    return {
        "frictionloss": number(force.coulomb),
        # friction has no stiffness, but both numbers must be negative
        "solreffriction": numbers([-1.0, -damping * d]),
        "solimpfriction": numbers([d, d, WIDTH]),
    }


def _limit_attributes(stops: list[JointStop], inverse_inertia: float) -> dict[str, str]:
    """Return the attributes of limits: stiffness D k d and damping D b at `DAMPED_DEPTH`.

    MuJoCo divides the stiffness in `solref` by d^2 and the damping by d.
    """
    d, limits = LIMIT_IMPEDANCE, {"low": -NO_LIMIT, "high": NO_LIMIT}
    for stop in stops:
        limits[stop.side] = stop.limit
    stiffest = max(stops, key=lambda stop: stop.stiffness)
    stiffness = stiffest.stiffness * (1.0 - d) * inverse_inertia
    damping = stiffest.dissipation * DAMPED_DEPTH * stiffness
    return {
        "range": numbers([limits["low"], limits["high"]]),
        "solreflimit": numbers([-stiffness, -damping]),
        "solimplimit": numbers([d, d, WIDTH]),
    }
