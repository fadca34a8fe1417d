"""MuJoCo's collision detection and tendons at the poses of a run, whatever moved the bodies there."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from mjcf.reading.bodies import Bodies
from mjcf.reading.start import Start
from newton_euler.model.euler_parameters import rotation
from newton_euler.scalars import Array
from newton_euler.verification.activity import Course, Judged

CARRIED = (("geom_xpos", "geom_xmat"), ("site_xpos", "site_xmat"), ("xipos", "ximat"), ("xpos", "xmat"))
"""Arrays of MuJoCo's data that bodies carry along: points and rotation matrices."""


class Poses:
    """A compiled model, as its file has it, whose bodies are put where a run has them."""

    def __init__(self, start: Start, bodies: Bodies) -> None:
        self.model: Any = copy.copy(start.model)
        for bit in ("CONTACT", "CONSTRAINT"):
            self.model.opt.disableflags &= ~int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{bit}"))
        model, data = self.model, start.data
        numbers = {name: k for k, name in enumerate(body.name for body in bodies.bodies)}
        of_bodies = np.array([numbers[name] for name in bodies.names])
        self._owners = {
            "geom_xpos": of_bodies[model.geom_bodyid],
            "site_xpos": of_bodies[model.site_bodyid],
            "xipos": of_bodies,
            "xpos": of_bodies,
        }
        centers = np.array([body.center_of_mass for body in bodies.bodies])
        turns = np.array([rotation(body.quaternion) for body in bodies.bodies])
        self._local: dict[str, tuple[Array, Array]] = {}
        for points, axes in CARRIED:
            into = turns[self._owners[points]].transpose(0, 2, 1)
            arms = getattr(data, points) - centers[self._owners[points]]
            local = into @ arms[:, :, None], into @ getattr(data, axes).reshape(-1, 3, 3)
            self._local[points] = local[0][:, :, 0], local[1]

    def along(self, course: Course) -> Iterator[tuple[float, Any]]:
        """Each output time with MuJoCo's data there, collisions and tendons not worked out."""
        data: Any = mujoco.MjData(self.model)
        run = course.run
        for time, centers, quaternions in zip(run.time, run.position, run.quaternion, strict=True):
            turns = np.array([rotation(q) for q in quaternions])
            for points, axes in CARRIED:
                owners, (arms, local) = self._owners[points], self._local[points]
                getattr(data, points)[:] = centers[owners] + (turns[owners] @ arms[:, :, None])[:, :, 0]
                getattr(data, axes)[:] = (turns[owners] @ local).reshape(-1, 9)
            yield float(time), data


class Touching:
    """Contacts: nothing is nearer than the margin at which MuJoCo's contacts begin to push."""

    def __init__(self, poses: Poses) -> None:
        self._poses = poses

    def judge(self, course: Course) -> Judged:
        model, count, first = self._poses.model, 0, ""
        for time, data in self._poses.along(course):
            mujoco.mj_collision(model, data)
            pushing = np.flatnonzero(data.contact.exclude == 0)
            if not pushing.size:
                continue
            count += 1
            if not first:
                deepest = int(pushing[np.argmin(data.contact.dist[pushing])])
                names = " and ".join(self._name(int(geom)) for geom in data.contact.geom[deepest])
                depth = float(data.contact.includemargin[deepest] - data.contact.dist[deepest])
                first = f"first at {time:.4g} s: {names}, {depth:.3g} m nearer than their margin"
        if count:
            return Judged(True, f"active at {count} of {len(course.time)} output times, {first}")
        return Judged(False, f"inactive at all {len(course.time)} output times")

    def _name(self, geom: int) -> str:
        if geom < 0:
            return "a flex"
        name = self._poses.model.geom(geom).name
        body = self._poses.model.body(int(self._poses.model.geom_bodyid[geom])).name
        return f"geom {name!r}" if name else f"a geom of {body!r}"


class Stretched:
    """Limits of a tendon that goes through sites, by MuJoCo's own path of it."""

    def __init__(self, poses: Poses, tendon: int) -> None:
        self._poses, self._tendon = poses, tendon

    def judge(self, course: Course) -> Judged:
        model = self._poses.model
        margin = float(model.tendon_margin[self._tendon])
        low, high = (float(x) for x in model.tendon_range[self._tendon])
        lengths = []
        for _, data in self._poses.along(course):
            mujoco.mj_tendon(model, data)
            lengths.append(float(data.ten_length[self._tendon]))
        room = np.minimum(np.array(lengths) - low, high - np.array(lengths)) - margin
        least = int(np.argmin(room))
        if room[least] >= 0.0:
            return Judged(False, f"closest {room[least]:.3g} m at {course.time[least]:.4g} s")
        first = float(course.time[int(np.argmax(room < 0.0))])
        return Judged(True, f"passed from {first:.4g} s on, by up to {-room[least]:.3g} m")
