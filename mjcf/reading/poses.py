"""MuJoCo's collision detection and tendons at the poses of a run, whatever moved the bodies there."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from mjcf.reading.bodies import Bodies
from mjcf.reading.start import Start
from newton_euler.model.euler_parameters import rotation
from newton_euler.scalars import Array
from newton_euler.verification.activity import PARTS, UNSEEN, Bounds, Course, Judged

CARRIED = (("geom_xpos", "geom_xmat"), ("site_xpos", "site_xmat"), ("xipos", "ximat"), ("xpos", "xmat"))
"""Arrays of MuJoCo's data that bodies carry along: points and rotation matrices."""


HALVINGS = 6
"""Of the time between outputs, where geoms may touch in it."""


class Poses:
    """A compiled model, as its file has it, whose bodies are put where a run has them."""

    def __init__(self, start: Start, bodies: Bodies) -> None:
        self.model: Any = copy.copy(start.model)
        for bit in ("CONTACT", "CONSTRAINT"):
            self.model.opt.disableflags &= ~int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{bit}"))
        self._take_override()
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

    def _take_override(self) -> None:
        """Let margins be those that a file overrides them by, so that what is added to them counts."""
        override = int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
        if self.model.opt.enableflags & override:
            self.model.opt.enableflags &= ~override
            self.model.pair_margin[:] = self.model.opt.o_margin
            for each in ("geom", "body", "flex"):  # those of both sides add up
                getattr(self.model, f"{each}_margin")[:] = 0.5 * self.model.opt.o_margin

    @cached_property
    def data(self) -> Any:
        """MuJoCo's data that `put` writes to."""
        return mujoco.MjData(self.model)

    def put(self, centers: Array, quaternions: Array) -> Any:
        """MuJoCo's data with bodies at centers of mass (b, 3), collisions and tendons not worked out."""
        turns = np.array([rotation(q) for q in quaternions])
        for points, axes in CARRIED:
            owners, (arms, local) = self._owners[points], self._local[points]
            getattr(self.data, points)[:] = centers[owners] + (turns[owners] @ arms[:, :, None])[:, :, 0]
            getattr(self.data, axes)[:] = (turns[owners] @ local).reshape(-1, 9)
        return self.data

    def along(self, course: Course) -> Iterator[tuple[float, Any]]:
        """Each output time with MuJoCo's data there."""
        run = course.run
        for time, centers, quaternions in zip(run.time, run.position, run.quaternion, strict=True):
            yield float(time), self.put(centers, quaternions)

    def reach(self, moves: Array, turns: Array, points: str, radii: Array | float = 0.0) -> Array:
        """Bound the way of points or geoms, m, where bodies (b,) move by so much, m, and turn, rad."""
        owners, (arms, _) = self._owners[points], self._local[points]
        return np.asarray(moves[owners] + turns[owners] * (np.linalg.norm(arms, axis=1) + radii))


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
        for n in range(len(course.time) - 1):
            if found := self._within(course, n, 0.0, 1.0, HALVINGS):
                return Judged(True, found)
        return Judged(False, f"inactive at all {len(course.time)} output times and between them")

    def _within(self, course: Course, n: int, start: float, end: float, halvings: int) -> str:
        """Words on contacts between shares of the step after output n; "" if there are none for certain."""
        poses, step = self._poses, float(course.time[n + 1] - course.time[n])
        middle = float(course.time[n]) + 0.5 * (start + end) * step
        ahead = 0.5 * (end - start) * step
        (speeds, spins), (blur, unsure) = course.speeds, course.blur
        radii = poses.model.geom_rbound
        reach = poses.reach(speeds[n] * ahead + blur[n], spins[n] * ahead + unsure[n], "geom_xpos", radii)
        worst = self._nearest(poses.put(*course.poses(n, middle)), reach)
        if worst < 0.0:
            return f"active between output times, at {middle:.4g} s"
        if worst == np.inf:
            return ""
        if halvings == 0:
            return UNSEEN
        half = 0.5 * (start + end)
        return self._within(course, n, start, half, halvings - 1) or self._within(
            course, n, half, end, halvings - 1
        )

    def _nearest(self, data: Any, reach: Array) -> float:
        """Least room of geoms that may touch within their reaches (ngeom,), m; infinite if none may."""
        model, most = self._poses.model, 2.0 * float(np.max(reach, initial=0.0))
        if not np.isfinite(most):
            return 0.0
        # those of both geoms add up; MuJoCo looks at geoms of bodies that are within the bodies' own margins
        shares = {"pair_margin": most, "geom_margin": 0.5 * most, "body_margin": 0.5 * most}
        kept = {name: getattr(model, name).copy() for name in shares}
        for name, share in shares.items():
            getattr(model, name)[:] += share
        mujoco.mj_collision(model, data)
        for name, margins in kept.items():
            getattr(model, name)[:] = margins
        contact = data.contact
        room = contact.dist - (contact.includemargin - most)
        near = np.where(contact.geom >= 0, reach[contact.geom], 0.5 * most).sum(axis=1)  # or a flex
        return float(np.min(room[(room < near) & (contact.exclude == 0)], initial=np.inf))

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
        times, lengths = (
            [float(course.time[0])],
            [self._length(course.run.position[0], course.run.quaternion[0])],
        )
        for n in range(len(course.time) - 1):
            for at in np.linspace(course.time[n], course.time[n + 1], PARTS + 1)[1:].tolist():
                times.append(at)
                lengths.append(self._length(*course.poses(n, at)))
        sites = int(model.tendon_num[self._tendon])
        moved = (self._poses.reach(*each, "site_xpos") for each in zip(*course.blur, strict=True))
        blur = [2.0 * sites * float(np.max(each)) for each in moved]
        limits = Bounds((), low + margin, high - margin, "m")
        return limits.judged(np.array(times), np.array(lengths), np.repeat(blur, PARTS))

    def _length(self, centers: Array, quaternions: Array) -> float:
        data = self._poses.put(centers, quaternions)
        mujoco.mj_tendon(self._poses.model, data)
        return float(data.ten_length[self._tendon])
