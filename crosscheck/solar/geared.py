"""Trackers whose motors move the panel through elastic gears, such as lead screws.

The controllers of such a tracker turn motors. Poses, clearances and holding forces of set-points are those of
the followers of the gears, such as sliders: play, deflection and friction do not count there. The simulated
motion has all of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, Self

from crosscheck.support.errors import CrosscheckError
from newton_euler import Poses, initial_state, start
from newton_euler.model.control import PD
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.switched_forces import ElasticGear


class Geared(NamedTuple):
    """A tracker, and the same tracker with controllers on the followers of its elastic gears.

    Attributes:
        scene: the tracker.
        planned: the tracker without elastic gears, whose controllers act on the followers; the scene itself
            without gears.
        keys: joint coordinates that the controllers of `planned` act on.
        ratios: travel of each of them per motion of the controller's own coordinate; 1 without a gear.
    """

    scene: Scene
    planned: Scene
    keys: tuple[Key, ...]
    ratios: tuple[float, ...]

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """Find the gears between the controllers of a tracker and the joints that move its panel.

        Raises:
            CrosscheckError: for a gear whose follower is not actuated.
        """
        gears = {gear.keys[0]: gear for gear in scene.forces if isinstance(gear, ElasticGear)}
        keys, ratios, control = list[Key](), list[float](), list[PD]()
        for law in scene.control:
            gear = gears.get(law.key)
            keys.append(gear.keys[1] if gear else law.key)
            ratios.append(gear.ratio if gear else 1.0)
            joint, coordinate = keys[-1]
            if not scene.mechanism.joint(joint).actuated:
                raise CrosscheckError(
                    f"scene {scene.name!r}: joint {joint!r} is the follower of a gear, and not actuated; "
                    "needed: actuated: true, so that set-points have forces there"
                )
            control.append(PD(joint, 0.0, 0.0, 0.0, coordinate))
        if not gears:
            return cls(scene, scene, tuple(keys), tuple(ratios))
        forces = tuple(force for force in scene.forces if not isinstance(force, ElasticGear))
        planned = replace(scene, control=tuple(control), forces=forces)
        return cls(scene, planned, tuple(keys), tuple(ratios))

    def start(self, poses: Poses) -> State:
        """Return the state at rest in the first pose, with the motors where their gears need them."""
        state = poses.state(0)
        moved = {
            law.joint: (float(poses.coordinates[key][0]) / ratio, 0.0)
            for law, key, ratio in zip(self.scene.control, self.keys, self.ratios, strict=True)
            if law.key != key
        }
        if not moved:
            return state
        return initial_state(start(replace(self.scene, initial_state=state), **moved))
