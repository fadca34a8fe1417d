"""Driven mechanisms for kinematics: chosen joint coordinates follow given functions, and no forces act.

Each chosen coordinate gets a prescribed motion. This motion is a driving constraint in addition to the
constraints of the loops (E. J. Haug, Computer Aided Kinematics and Dynamics of Mechanical Systems, 1989,
chapter 3). Inverse kinematics, initial joint coordinates and forward kinematics from encoder readings solve
the equations of such a mechanism.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from newton_euler.equations.formulation import Formulation
from newton_euler.equations.parameter_names import numbered
from newton_euler.model.joint import Key
from newton_euler.model.motions import PrescribedMotion, TimeFunction
from newton_euler.model.scene import Scene


class DrivenMechanism(NamedTuple):
    """A scene without forces whose chosen joint coordinates are driven; see `driven`.

    Attributes:
        scene: the scene; the driving motions are the last ones of its prescribed motions.
        function_names: for each driven joint coordinate, by key (joint, index of the coordinate), the
            parameter name of its function of time, such as `motions[0].function`.
    """

    scene: Scene
    function_names: Mapping[Key, str]

    def rows(self, system: Formulation) -> range:
        """Return the indices of the driving constraints in the residuals `phi`, ordered as `function_names`.

        Args:
            system: equations of `scene`.
        """
        # rows of joints, then one row per coupling: prescribed motions first, then screws and gears
        end = system.rows - len(system.couplings) + len(self.scene.motions)
        return range(end - len(self.function_names), end)


def driven(
    scene: Scene,
    functions: Mapping[Key, TimeFunction],
    motions: Sequence[PrescribedMotion] | None = None,
    **changes: Any,
) -> DrivenMechanism:
    """Return a scene without forces in which chosen joint coordinates follow functions of time.

    Args:
        scene: the mechanism; its control laws and forces are removed.
        functions: function of time for each driven coordinate, by key (joint, index of the coordinate), m or
            rad from the initial pose.
        motions: prescribed motions of other coordinates; those of the scene if None.
        changes: new values of other fields of the scene, such as `initial_state`.
    """
    others = scene.motions if motions is None else tuple(motions)
    driving = tuple(PrescribedMotion(joint, function, k) for (joint, k), function in functions.items())
    names = {key: numbered("motions", k, "function") for k, key in enumerate(functions, start=len(others))}
    return DrivenMechanism(replace(scene.without_forces(), motions=(*others, *driving), **changes), names)
