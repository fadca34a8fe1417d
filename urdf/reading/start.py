"""Start of a model: coordinates 0 or a given configuration, mimics at their offsets, closed loops."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.equations.loop_closure import FileStart, Units, reach
from newton_euler.model.mechanism import spread
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array
from urdf.constraints import Closures, power_sums
from urdf.loops import Loops
from urdf.model import ClosedLoopModel
from urdf.reading.source import SourceError


class Mimic:
    """Mimic of a URDF: x_follower = multiplier * x_driver + offset."""

    def __init__(self, joint: ET.Element, mimic: ET.Element) -> None:
        self.follower, self.driver = str(joint.get("name")), str(mimic.get("joint"))
        self.multiplier, self.offset = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))


class _IdentityMap:
    """Map of coordinates that changes nothing."""

    @staticmethod
    def v_from_pinocchio(v: Array) -> Array:
        return v


class RobotAtStart(FileStart):
    """Model at its start.

    Attributes:
        robot: Pinocchio's model and its closures.
        loops: content of the loop file.
        mimics: mimics of the URDF.
        q: (nq,) Pinocchio's coordinates at the start.
        data: `pinocchio.Data` with joint and frame placements at the start.
    """

    error = SourceError

    def __init__(
        self,
        path: str,
        closed: ClosedLoopModel,
        loops: Loops,
        mimics: list[Mimic],
        report: ImportReport,
        tolerance: float,
        first: tuple[Array, str] | None = None,
    ) -> None:
        """Close the loops.

        Args:
            path: file or model, for messages.
            closed: Pinocchio's model and its closures.
            loops: content of the loop file.
            mimics: mimics of the URDF.
            report: report that receives lines about the start.
            tolerance: `redundancy_tolerance` of the scene.
            first: configuration (nq,) to start near to, with its name; None for coordinates 0.

        Raises:
            SourceError: for loops that do not close.
        """
        self.path, self.robot = path, closed
        self.model, self.loops, self.mimics = closed.model, loops, mimics
        self.data: Any = self.model.createData()
        self._closures = Closures(closed, _IdentityMap(), 1.0)  # type: ignore[arg-type]
        # rows of loops, couplings and mimics
        names = [" and ".join(p) for p, t in zip(loops.closed_loop, loops.type, strict=True) if t != "rod"]
        rows = [3 if kind == "3d" else 6 for kind in loops.type if kind != "rod"]
        self.owners = [f"loop of {n}" for n, count in zip(names, rows, strict=True) for _ in range(count)]
        self.owners += ["a coupling"] * len(closed.couplings) + [f"mimic of {m.follower}" for m in mimics]
        self._linear = np.array([*closed.couplings[:, 0], *(self._row(path, m) for m in mimics)])
        self._linear = self._linear.reshape(-1, self.model.nv)
        moved = self._mimicked(mimics)
        if not np.all(np.isfinite(moved)):
            raise SourceError(path, "the offsets of its mimics overflow")
        self._first = pin.integrate(self.model, pin.neutral(self.model), moved)
        offsets = np.array([0.0] * len(closed.couplings) + [m.offset for m in mimics])
        self._open = self._linear @ moved - offsets
        self._moved, self._bent = moved, closed.couplings.copy()
        self._bent[:, 0] = 0.0  # the linear part is in `_linear`
        # the configuration to start near to, and the closed one
        called = "coordinates 0"
        if followers := [f"{m.follower!r} {x:.6g}" for m in mimics if (x := moved[self.place(m.follower)])]:
            called += " and mimics at their offsets"
            report.start.append(
                "followers of mimics start at these coordinates, with drivers at 0, m or rad: "
                + ", ".join(followers)
            )
        if first is not None:
            self._first, called = first
        self.q, lines, report.moved = self.closed(self._first, called, tolerance)
        report.start.extend(lines)

    def _mimicked(self, mimics: list[Mimic]) -> Array:
        """Return displacements (nv,) of followers of mimics, m or rad, for all other joints at 0.

        A joint that follows itself through others stays at 0; loop closure finds a consistent value.
        """
        by_follower = {mimic.follower: mimic for mimic in mimics}
        moved = np.zeros(self.model.nv)
        for name in by_follower:
            drivers = [name]
            while drivers[-1] in by_follower and len(drivers) <= len(mimics):
                drivers.append(by_follower[drivers[-1]].driver)
            if drivers[-1] not in by_follower:
                for follower in reversed(drivers[:-1]):
                    mimic = by_follower[follower]
                    driven = moved[self.place(mimic.driver)]
                    moved[self.place(follower)] = mimic.multiplier * driven + mimic.offset
        return moved

    def place(self, name: str) -> int | None:
        """Return the place of the velocity of a joint of one motion; None if there is no such joint."""
        if not self.model.existJointName(name):
            return None
        joint = self.model.joints[self.model.getJointId(name)]
        return int(joint.idx_v) if joint.nv == 1 else None

    def displacement(self, name: str) -> float:
        """Return the starting coordinate of a hinge or slide, rad or m; 0 if there is no such joint."""
        place = self.place(name)
        moved = pin.difference(self.model, pin.neutral(self.model), self.q)
        return 0.0 if place is None else float(moved[place])

    def _row(self, path: str, mimic: Mimic) -> Array:
        row = np.zeros(self.model.nv)
        for name, factor in ((mimic.follower, 1.0), (mimic.driver, -mimic.multiplier)):
            place = self.place(name)
            if place is None:
                raise SourceError(
                    path, f"joint {mimic.follower!r}: mimic of {name!r}; needed: a hinge or slide"
                )
            row[place] += factor
        return row

    def residuals(self, q: Array) -> tuple[Array, Array]:
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        x = pin.difference(self.model, self._first, q)
        coupled, slopes, count = self._linear @ x + self._open, self._linear.copy(), len(self._bent)
        coupled[:count] += np.sum(power_sums(self._bent, self._moved + x, 0), axis=1)
        slopes[:count] += power_sums(self._bent, self._moved + x, 1)
        phi = np.concatenate([self._closures.phi(self.data), coupled])
        return phi, np.vstack([self._closures.jacobian(self.data), slopes])

    def units(self) -> Units:
        model, data = self.model, self.data
        points = [*self.centers()[1:], *(placement.translation for placement in list(data.oMi)[1:])]
        velocities = np.where(np.any(np.reshape(data.J, (6, -1))[3:] != 0.0, axis=0), 1.0, spread(points))
        rows = []
        for pair, weld in self._closures.pairs:
            motions, levers = [], []
            for frame in pair:
                joint = model.frames[frame].parentJoint
                center = data.oMi[joint].act(model.inertias[joint].lever)
                motion = np.array(pin.getJointJacobian(model, data, joint, pin.WORLD)).reshape(6, -1)
                motion[:3] += np.cross(motion[3:].T, center).T
                motions.append(motion)
                levers.append(float(np.linalg.norm(data.oMf[frame].translation - center)))
            moves, turns = reach(motions, levers, velocities)
            rows += [moves] * 3 + [turns] * (3 if weld else 0)
        coupled = np.linalg.norm(self._linear * velocities, axis=1)
        return Units(velocities, np.array([*rows, *np.where(coupled > 0.0, coupled, 1.0)]))

    def moved(self, q: Array, step: Array) -> Array:
        return np.asarray(pin.integrate(self.model, q, step))

    def difference(self, q: Array, other: Array) -> Array:
        return np.asarray(pin.difference(self.model, q, other))

    def joint_of(self, dof: int) -> str:
        named = zip(self.model.names, self.model.joints, strict=True)
        return str(next(name for name, joint in named if joint.idx_v <= dof < joint.idx_v + joint.nv))

    def center_names(self) -> list[str]:
        return list(self.model.names)

    def centers(self) -> Array:
        poses = zip(self.data.oMi, self.model.inertias, strict=True)
        return np.array([pose.act(inertia.lever) for pose, inertia in poses])
