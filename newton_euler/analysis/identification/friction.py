"""Joints with dry friction that stick in all measured runs of an identification.

Such a joint bounds its friction from below only. The regularized friction of `JointFriction` still moves the
joint, by less than its transition speed, so that a fit finds a number with a small standard deviation. This
number follows from the transition speed and is not a property of the mechanism.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from newton_euler.equations.parameter_names import element_of, places
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.scalars import Array


def frictions_of(scene: Scene, names: Sequence[str]) -> dict[str, JointFriction]:
    """Return the friction element of each parameter of joint friction, by the name of the parameter."""
    initial, found = initial_numbers(scene, names), {}
    for name in names:
        if name not in initial:
            (place,) = places(scene, [name]).values()
            element = element_of(scene, place.owner)
            if isinstance(element, JointFriction):
                found[name] = element
    return found


def sticking(scene: Scene, names: Sequence[str], rates: Mapping[Key, Array]) -> dict[str, list[str]]:
    """Find joints with fitted friction that stick in all runs.

    Args:
        scene: scene with the fitted values.
        names: names of the fitted parameters.
        rates: rates (k,) of the joint coordinates in all runs.

    Returns:
        The names of the parameters of the friction, by the label of the joint coordinate.
    """
    found: dict[str, list[str]] = {}
    for name, friction in frictions_of(scene, names).items():
        if np.abs(rates[friction.key]).max() <= friction.transition_speed:
            found.setdefault(scene.mechanism.coordinate_labels[friction.key], []).append(name)
    return found
