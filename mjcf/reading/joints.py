"""Import joints of a compiled model; all joints of one body become one joint."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mujoco

from mjcf.layout import element_name
from mjcf.reading.bodies import GROUND, Bodies
from mjcf.reading.start import ModelAtStart
from newton_euler.model.couplings import Gear, JointCoupling
from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Free
from newton_euler.model.joint_parts import Part, combined, common_name
from newton_euler.reading.import_report import ImportReport, unique_name

BALL, FREE = mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_FREE

MOTION_KINDS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
}


class Joints:
    """Imported joints of the tree of bodies.

    Attributes:
        joints: one joint for each moving body.
        keys: joint and coordinate of each of MuJoCo's hinges and slides, by number; coordinates are zero at
            the start.
        of: name of the joint of each of MuJoCo's joints, by number.
    """

    def __init__(self, start: ModelAtStart, bodies: Bodies, driven: set[int], report: ImportReport) -> None:
        """Import all joints; `driven` are the numbers of MuJoCo's joints that actuators drive."""
        self._start, self._model, self._data = start, start.model, start.data
        self.joints: list[Joint] = []
        self.coordinate_keys: dict[int, Key] = {}
        self.joint_names: dict[int, str] = {}
        for root in bodies.roots[1:]:
            first = int(self._model.body_jntadr[root])
            numbers = range(first, first + int(self._model.body_jntnum[root]))
            parent = bodies.names[int(self._model.body_parentid[root])]
            joint = self._joint(list(numbers), parent, bodies.names[root], bool(driven & set(numbers)))
            self.joints.append(joint)
            for number in numbers:
                self.joint_names[number] = joint.name
                report.imported(element_name(self._model, "joint", number), self._became(number, joint))

    def _became(self, number: int, joint: Joint) -> str:
        if number not in self.coordinate_keys or len(joint.coordinate_kinds) == 1:
            return f"{joint.kind} joint {joint.name!r}"
        return f"coordinate {self.coordinate_keys[number][1]} of {joint.kind} joint {joint.name!r}"

    def _joint(self, numbers: Sequence[int], parent: str, child: str, actuated: bool) -> Joint:
        model, data = self._model, self._data
        names = [model.joint(k).name for k in numbers]
        own = names[0] if len(names) == 1 else common_name(names) or f"{child}_joints"
        name = unique_name(own, f"{child}_joint", (joint.name for joint in self.joints))
        if model.jnt_type[numbers[0]] == FREE:
            return Free(name, GROUND, child, data.xanchor[numbers[0]])
        parts = {
            k: Part(
                model.joint(k).name or f"number {k}",
                MOTION_KINDS[int(model.jnt_type[k])],
                data.xaxis[k].copy(),
                data.xanchor[k].copy(),
            )
            for k in numbers
        }
        joint, coordinates = combined(name, parent, child, list(parts.values()), actuated)
        for k, part in parts.items():
            if part.name in coordinates:
                self.coordinate_keys[k] = (name, coordinates[part.name])
        return joint


class GearGroups:
    """Groups of joint coordinates that gears couple, each with a constant ratio to the first of its group."""

    def __init__(self, gears: Iterable[JointCoupling]) -> None:
        self._of: dict[Key, tuple[Key, float]] = {}
        for gear in gears:
            if not isinstance(gear, Gear):
                continue  # other couplings have no constant ratio
            driver = (gear.driver, gear.driver_coordinate)
            follower = (gear.follower, gear.follower_coordinate)
            (first, a), (second, b) = self._member(driver), self._member(follower)
            ratio = gear.ratio * a / b  # ratio between the first coordinates of both groups
            for key in (driver, follower):
                self._of.setdefault(key, (key, 1.0))
            for key, (group, factor) in list(self._of.items()):
                if group == second != first:
                    self._of[key] = (first, factor * ratio)

    def _member(self, key: Key) -> tuple[Key, float]:
        return self._of.get(key, (key, 1.0))

    def rates(self, keys: Iterable[Key]) -> dict[Key, float] | None:
        """Return the derivative of each coordinate by the first; None unless all are in one group."""
        members = {key: self._member(key) for key in keys}
        if len({group for group, _ in members.values()}) != 1:
            return None
        first = next(iter(members.values()))[1]
        return {key: factor / first for key, (_, factor) in members.items()}

    def slopes(self, weights: Mapping[Key, float]) -> dict[Key, float] | None:
        """Return the total derivative of a weighted sum of coordinates by each coordinate.

        The result is None unless all coordinates are in one group.
        """
        rates = self.rates(weights)
        if rates is None:
            return None
        total = sum(weight * rates[key] for key, weight in weights.items())
        return {key: total / rate for key, rate in rates.items()}
