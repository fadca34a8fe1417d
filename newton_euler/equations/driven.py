"""Mechanisms driven at chosen joint coordinates, without forces: the basis of kinematics.

Each chosen coordinate gets a prescribed motion, a driving constraint next to those of the loops (E. J. Haug,
Computer Aided Kinematics and Dynamics of Mechanical Systems, 1989, chapter 3). Poses for goals, starts with
other initial coordinates and the forward kinematics of encoders solve the equations of such a mechanism.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from newton_euler.equations.formulation import Formulation
from newton_euler.equations.parameters import numbered
from newton_euler.model.joint import Key
from newton_euler.model.motions import PrescribedMotion, TimeFunction
from newton_euler.model.scene import Scene


class DrivenMechanism(NamedTuple):
    """A scene without forces whose last prescribed motions drive chosen coordinates; see `driven`.

    Attributes:
        scene: with the driving motions behind its other motions.
        functions: names of the parameters that the driving motions' functions are, by joint coordinate.
    """

    scene: Scene
    functions: Mapping[Key, str]

    def rows(self, system: Formulation) -> range:
        """Return the rows of `phi` of the driving constraints, in the order of `functions`.

        Args:
            system: equations of `scene`.
        """
        end = system.rows - len(system.couplings) + len(self.scene.motions)
        return range(end - len(self.functions), end)


def driven(
    scene: Scene,
    functions: Mapping[Key, TimeFunction],
    motions: Sequence[PrescribedMotion] | None = None,
    **changes: Any,
) -> DrivenMechanism:
    """Drive joint coordinates of a scene that has no forces otherwise.

    Args:
        scene: the mechanism; control laws and forces are left out.
        functions: m or rad from the initial pose, by joint coordinate.
        motions: other prescribed motions; those of the scene if None.
        changes: of other fields of the scene, such as `initial_state`.
    """
    others = scene.motions if motions is None else tuple(motions)
    driving = tuple(PrescribedMotion(joint, function, k) for (joint, k), function in functions.items())
    names = {key: numbered("motions", k, "function") for k, key in enumerate(functions, start=len(others))}
    return DrivenMechanism(replace(scene.without_forces(), motions=(*others, *driving), **changes), names)
