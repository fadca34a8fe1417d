"""Elements of a scene that Exudyn, or this adapter, cannot express."""

from __future__ import annotations

from collections.abc import Sequence

from crosscheck.engines.exudyn.joints import why_not
from crosscheck.engines.limits import Limit
from newton_euler.equations.load_friction import loaded_frictions
from newton_euler.errors import quoted
from newton_euler.model.scene import Scene


def limits(scene: Scene) -> Sequence[Limit]:
    """List the elements of a scene that cannot be expressed, with the reasons."""
    found = [
        Limit(f"{joint.kind} joint {quoted(joint.name)}", reason)
        for joint in scene.mechanism.joints
        if (reason := why_not(joint))
    ]
    found += [
        Limit(each.element, "a rotor of Exudyn has one coordinate, and a ball has none")
        for each in scene.armatures
        if each.on_ball
    ]
    found += [
        Limit(each.element, "forces of Exudyn's connectors do not depend on reactions")
        for each in loaded_frictions(scene)
    ]
    return tuple(found)
