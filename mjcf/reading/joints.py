"""Import the joints of a compiled MuJoCo model as joints of a scene, for `mjcf.reader`.

A body of MuJoCo can have several joints: hinges, slides and a ball. All joints of one body become one joint
of the scene, such as a universal joint. `GearGroups` finds joint coordinates that gears make proportional to
each other, so that forces on one coordinate can be replaced by forces on another.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import mujoco

from mjcf.layout import element_name
from mjcf.reading.bodies import GROUND, Bodies
from mjcf.reading.start import ModelAtStart
from newton_euler.model.couplings import Gear, JointCoupling
from newton_euler.model.joint import Joint, Key
from newton_euler.model.joint_kinds import Free
from newton_euler.model.joint_parts import Part, combine_motions, common_name
from newton_euler.reading.import_report import ImportReport, unique_name

BALL, FREE = mujoco.mjtJoint.mjJNT_BALL, mujoco.mjtJoint.mjJNT_FREE
"""MuJoCo's types of ball joints and free joints."""

MOTION_KINDS = {
    int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
    int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
    int(mujoco.mjtJoint.mjJNT_BALL): "ball",
}
"""Kinds of motions of a scene's joint, by MuJoCo's type of joint."""


class Joints:
    """Imported joints of the tree of bodies.

    A joint coordinate has the key (name of the scene's joint, number of the coordinate). Coordinates are zero
    at the start.

    Attributes:
        joints: one joint for each moving body of the scene, to its parent in the tree.
        coordinate_keys: key of the coordinate of each hinge and slide of MuJoCo, by number of MuJoCo's joint.
        joint_names: name of the scene's joint for each of MuJoCo's joints, by number.
    """

    def __init__(self, start: ModelAtStart, bodies: Bodies, driven: set[int], report: ImportReport) -> None:
        """Import and report all joints.

        Args:
            start: MuJoCo's model and data at the start state.
            bodies: imported bodies.
            driven: numbers of MuJoCo's joints that actuators drive.
            report: report that receives one entry for each of MuJoCo's joints.
        """
        self._model, self._data = start.model, start.data
        self.joints: list[Joint] = []
        self.coordinate_keys: dict[int, Key] = {}
        self.joint_names: dict[int, str] = {}
        # roots are MuJoCo's bodies with joints, after the world; other bodies are fixed to a root
        for root in bodies.roots[1:]:
            first = int(self._model.body_jntadr[root])
            numbers = range(first, first + int(self._model.body_jntnum[root]))
            parent = bodies.names[int(self._model.body_parentid[root])]
            joint = self._combined(list(numbers), parent, bodies.names[root], bool(driven & set(numbers)))
            self.joints.append(joint)
            for number in numbers:
                self.joint_names[number] = joint.name
                report.imported(element_name(self._model, "joint", number), self._counterpart(number, joint))

    def _counterpart(self, number: int, joint: Joint) -> str:
        """Describe, for the report, the part of the scene's `joint` that MuJoCo's joint `number` became."""
        if number not in self.coordinate_keys or len(joint.coordinate_kinds) == 1:
            return f"{joint.kind} joint {joint.name!r}"
        return f"coordinate {self.coordinate_keys[number][1]} of {joint.kind} joint {joint.name!r}"

    def _combined(self, numbers: Sequence[int], parent: str, child: str, actuated: bool) -> Joint:
        """Combine all of MuJoCo's joints of one body to one joint, and store the keys of its coordinates.

        Args:
            numbers: numbers of MuJoCo's joints of the body, in the order of MuJoCo.
            parent: name of the first body of the joint.
            child: name of the second body, which the joint moves.
            actuated: True if an actuator drives one of the joints, so that control laws may drive the result.
        """
        model, data = self._model, self._data
        names = [model.joint(k).name for k in numbers]
        wanted_name = names[0] if len(names) == 1 else common_name(names) or f"{child}_joints"
        name = unique_name(wanted_name, f"{child}_joint", (joint.name for joint in self.joints))
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
        # `coordinates`: number of the coordinate within the joint, by name of the part; a ball has none
        joint, coordinates = combine_motions(name, parent, child, list(parts.values()), actuated)
        for k, part in parts.items():
            if part.name in coordinates:
                self.coordinate_keys[k] = (name, coordinates[part.name])
        return joint


class GearGroups:
    """Groups of joint coordinates that gears make proportional to each other.

    Each coordinate is a constant ratio times the leader of its group, one of the coordinates. A coordinate
    without gears is the leader of its own group.
    """

    def __init__(self, gears: Iterable[JointCoupling]) -> None:
        """Merge the groups of driver and follower for each gear; other couplings have no constant ratio."""
        self._leader_and_ratio: dict[Key, tuple[Key, float]] = {}
        for gear in gears:
            if not isinstance(gear, Gear):
                continue
            driver = (gear.driver, gear.driver_coordinate)
            follower = (gear.follower, gear.follower_coordinate)
            leader_1, ratio_1 = self._member(driver)
            leader_2, ratio_2 = self._member(follower)
            # x_driver = ratio_1 leader_1, x_follower = ratio_2 leader_2, x_follower = gear.ratio x_driver
            ratio = gear.ratio * ratio_1 / ratio_2  # leader_2 = ratio leader_1
            for key in (driver, follower):
                self._leader_and_ratio.setdefault(key, (key, 1.0))
            # the group of leader_2 joins the group of leader_1, unless both are the same group already
            for key, (leader, ratio_to_leader) in list(self._leader_and_ratio.items()):
                if leader == leader_2 != leader_1:
                    self._leader_and_ratio[key] = (leader_1, ratio_to_leader * ratio)

    def _member(self, key: Key) -> tuple[Key, float]:
        """Return the leader of a coordinate's group, and the ratio of the coordinate to the leader."""
        return self._leader_and_ratio.get(key, (key, 1.0))

    def rates(self, keys: Iterable[Key]) -> dict[Key, float] | None:
        """Return the derivative of each coordinate by the first key; None unless all are in one group."""
        members = {key: self._member(key) for key in keys}
        if len({leader for leader, _ in members.values()}) != 1:
            return None
        first_ratio = next(iter(members.values()))[1]
        return {key: ratio / first_ratio for key, (_, ratio) in members.items()}

    def slopes(self, weights: Mapping[Key, float]) -> dict[Key, float] | None:
        """Return the total derivative of a weighted sum of coordinates by each of the coordinates.

        While one coordinate changes, the others of its group change in proportion.

        Args:
            weights: factor of each coordinate in the sum.

        Returns:
            The derivatives by coordinate; None unless all coordinates are in one group.
        """
        rates = self.rates(weights)
        if rates is None:
            return None
        total = sum(weight * rates[key] for key, weight in weights.items())
        return {key: total / rate for key, rate in rates.items()}
