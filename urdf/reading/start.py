"""Pinocchio model at its start state: coordinates 0 or a given configuration, moved to close all loops.

A mimic of a URDF makes one joint follow another: x_follower = multiplier * x_driver + offset. Followers start
at their offsets. A coupling of the loop file is a sum of polynomials of joint coordinates that is zero.
`RobotAtStart` holds Pinocchio's model and data at the start. All modules of the reader take element values
from this model and positions from this data. The base class `FileStart` closes the loops by Newton steps,
with residuals, Jacobian and units from `RobotAtStart`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.equations.loop_closure import FileStart, Units, reach
from newton_euler.model.mechanism import characteristic_length
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array
from urdf.constraints import Closures, power_sums
from urdf.loops import Loops
from urdf.model import ClosedLoopModel
from urdf.reading.source import SourceError


class Mimic:
    """Mimic of a URDF: x_follower = multiplier * x_driver + offset, for coordinates x in m or rad.

    Attributes:
        follower: name of the joint that follows.
        driver: name of the joint that is followed.
        multiplier: derivative of the follower by the driver.
        offset: coordinate of the follower for the driver at 0, m or rad.
    """

    def __init__(self, joint: ET.Element, mimic: ET.Element) -> None:
        """Read the element `<mimic>` of an element `<joint>`."""
        self.follower, self.driver = str(joint.get("name")), str(mimic.get("joint"))
        self.multiplier, self.offset = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))


class _IdentityMap:
    """Coordinate map that keeps Pinocchio's order, for `Closures`, which can convert to another order."""

    @staticmethod
    def v_from_pinocchio(v: Array) -> Array:
        """Return the velocities unchanged."""
        return v


class RobotAtStart(FileStart):
    """Pinocchio model at its start state.

    Attributes:
        path: file or model, for messages.
        closed_model: Pinocchio's model with its loop closures.
        model: `pinocchio.Model` of `closed_model`.
        loops: content of the loop file.
        mimics: mimics of the URDF.
        q: (nq,) Pinocchio's coordinates at the start.
        data: `pinocchio.Data` with joint and frame placements at the start.
    """

    error = SourceError
    """Class of the error that `FileStart` raises for loops that do not close."""

    def __init__(
        self,
        path: str,
        closed_model: ClosedLoopModel,
        loops: Loops,
        mimics: list[Mimic],
        report: ImportReport,
        tolerance: float,
        first: tuple[Array, str] | None = None,
    ) -> None:
        """Close the loops near the starting configuration.

        Args:
            path: file or model, for messages.
            closed_model: Pinocchio's model and its closures.
            loops: content of the loop file.
            mimics: mimics of the URDF.
            report: report that receives lines about the start.
            tolerance: size, without unit, of the independent part of a constraint below which the constraint
                counts as redundant (`redundancy_tolerance` of the scene).
            first: configuration (nq,) near which to start, with its name; None for coordinates 0. Only for
                models without couplings and mimics, whose residuals count from the followers' offsets.

        Raises:
            SourceError: for loops that do not close.
        """
        self.path, self.closed_model = path, closed_model
        self.model, self.loops, self.mimics = closed_model.model, loops, mimics
        self.data: Any = self.model.createData()
        # `length` is not used: Newton steps divide residuals by the units of the method `units`
        self._closures = Closures(closed_model, _IdentityMap(), length=1.0)  # type: ignore[arg-type]
        # element of each residual, in the order loops, couplings, mimics. A rod keeps the distance of two
        # points; its length is their distance at the start, so that it has no residual
        self.owners: list[str] = []
        for pair, kind in zip(loops.closed_loop, loops.type, strict=True):
            if kind != "rod":
                row_count = 3 if kind == "3d" else 6  # "6d" closes a frame, a hinge two points on its axis
                self.owners += [f"loop of {' and '.join(pair)}"] * row_count
        self.owners += ["a coupling"] * len(closed_model.couplings)
        self.owners += [f"mimic of {mimic.follower}" for mimic in mimics]
        # residuals of couplings and mimics: let q0 (`_q0`) be the first configuration, with displacement x0
        # from neutral. At q = q0 + x the residuals are `_linear` x + `_residuals_at_q0` + polynomials of
        # second and higher powers of x0 + x. `couplings` (c, d, nv) has the factors of the powers 1 to d
        self._linear = np.array([*closed_model.couplings[:, 0], *(self._mimic_row(path, m) for m in mimics)])
        self._linear = self._linear.reshape(-1, self.model.nv)
        x0 = self._mimicked(mimics)
        if not np.all(np.isfinite(x0)):
            raise SourceError(path, "the offsets of its mimics overflow")
        self._q0 = pin.integrate(self.model, pin.neutral(self.model), x0)
        offsets = np.array([0.0] * len(closed_model.couplings) + [m.offset for m in mimics])
        self._residuals_at_q0 = self._linear @ x0 - offsets
        self._x0, self._higher_powers = x0, closed_model.couplings.copy()
        self._higher_powers[:, 0] = 0.0
        # the configuration near which to start, its name in the report, and the closed configuration
        name = "coordinates 0"
        followers = [f"{m.follower!r} {x:.6g}" for m in mimics if (x := x0[self.velocity_index(m.follower)])]
        if followers:
            name += " and mimics at their offsets"
            report.start.append(
                "followers of mimics start at these coordinates, with drivers at 0, m or rad: "
                + ", ".join(followers)
            )
        if first is not None:
            self._q0, name = first
        # `closed` (base class) returns the configuration, lines for the report, and how far bodies and joints
        # moved until the loops closed
        self.q, lines, report.moved = self.closed(self._q0, name, tolerance)
        report.start.extend(lines)

    def _mimicked(self, mimics: list[Mimic]) -> Array:
        """Return displacements (nv,) from neutral, m or rad: followers of mimics, with all other joints at 0.

        A joint that follows itself through others stays at 0; loop closure finds a consistent value.
        """
        by_follower = {mimic.follower: mimic for mimic in mimics}
        x0 = np.zeros(self.model.nv)
        for name in by_follower:
            # the follower, its driver, the driver of the driver, ...
            chain = [name]
            while chain[-1] in by_follower and len(chain) <= len(mimics):
                chain.append(by_follower[chain[-1]].driver)
            if chain[-1] not in by_follower:
                for follower in reversed(chain[:-1]):
                    mimic = by_follower[follower]
                    x_driver = x0[self.velocity_index(mimic.driver)]
                    x0[self.velocity_index(follower)] = mimic.multiplier * x_driver + mimic.offset
        return x0

    def velocity_index(self, name: str) -> int | None:
        """Return the index of the velocity of a hinge or slide; None if there is no such joint."""
        if not self.model.existJointName(name):
            return None
        joint = self.model.joints[self.model.getJointId(name)]
        return int(joint.idx_v) if joint.nv == 1 else None

    def displacement(self, name: str) -> float:
        """Return the coordinate of a hinge or slide at the start, rad or m; 0 if there is no such joint."""
        index = self.velocity_index(name)
        displacements = pin.difference(self.model, pin.neutral(self.model), self.q)
        return 0.0 if index is None else float(displacements[index])

    def _mimic_row(self, path: str, mimic: Mimic) -> Array:
        """Return the Jacobian row (nv,) of x_follower - multiplier * x_driver; raises `SourceError`."""
        row = np.zeros(self.model.nv)
        for name, factor in ((mimic.follower, 1.0), (mimic.driver, -mimic.multiplier)):
            index = self.velocity_index(name)
            if index is None:
                raise SourceError(
                    path, f"joint {mimic.follower!r}: mimic of {name!r}; needed: a hinge or slide"
                )
            row[index] += factor
        return row

    def residuals(self, q: Array) -> tuple[Array, Array]:
        """Compute residuals (k,), m or rad, of loops, couplings and mimics, and their Jacobian (k, nv)."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        x = pin.difference(self.model, self._q0, q)
        coupled, slopes = self._linear @ x + self._residuals_at_q0, self._linear.copy()
        count = len(self._higher_powers)  # couplings; mimics are linear
        coupled[:count] += np.sum(power_sums(self._higher_powers, self._x0 + x, derivative=0), axis=1)
        slopes[:count] += power_sums(self._higher_powers, self._x0 + x, derivative=1)
        phi = np.concatenate([self._closures.phi(self.data), coupled])
        return phi, np.vstack([self._closures.jacobian(self.data), slopes])

    def units(self) -> Units:
        """Return units of velocities (nv,) and of residuals (k,), which make loop closure dimensionless."""
        model, data = self.model, self.data
        # velocities: 1 rad/s for rotations; for translations the radius of the mechanism, m, per second
        points = [*self.centers()[1:], *(placement.translation for placement in list(data.oMi)[1:])]
        is_rotation = np.any(np.reshape(data.J, (6, -1))[3:] != 0.0, axis=0)
        velocity_units = np.where(is_rotation, 1.0, characteristic_length(points))
        # residuals of loop closures: the largest motion that one unit velocity gives to the closing point on
        # one of the two bodies alone, see `reach`; motions of both bodies can cancel in the row
        row_units = []
        for pair, is_weld in self._closures.pairs:
            body_jacobians, levers = [], []
            for frame in pair:
                joint = model.frames[frame].parentJoint
                center = data.oMi[joint].act(model.inertias[joint].lever)
                # convert the velocity of the body's point at the world's origin to that of the center of mass
                jacobian = np.array(pin.getJointJacobian(model, data, joint, pin.WORLD)).reshape(6, -1)
                jacobian[:3] += np.cross(jacobian[3:].T, center).T
                body_jacobians.append(jacobian)
                levers.append(float(np.linalg.norm(data.oMf[frame].translation - center)))
            translation, rotation = reach(body_jacobians, levers, velocity_units)
            row_units += [translation] * 3 + [rotation] * (3 if is_weld else 0)
        # residuals of couplings and mimics: norm of the Jacobian row in these units
        norms = np.linalg.norm(self._linear * velocity_units, axis=1)
        return Units(velocity_units, np.array([*row_units, *np.where(norms > 0.0, norms, 1.0)]))

    def moved(self, q: Array, step: Array) -> Array:
        """Return the configuration (nq,) that velocities `step` (nv,) reach from q (nq,) in 1 s."""
        return np.asarray(pin.integrate(self.model, q, step))

    def difference(self, q: Array, other: Array) -> Array:
        """Return the velocities (nv,) that lead from configuration q (nq,) to `other` (nq,) in 1 s."""
        return np.asarray(pin.difference(self.model, q, other))

    def joint_of(self, dof: int) -> str:
        """Return the name of the joint that velocity number `dof` belongs to."""
        named = zip(self.model.names, self.model.joints, strict=True)
        return str(next(name for name, joint in named if joint.idx_v <= dof < joint.idx_v + joint.nv))

    def center_names(self) -> list[str]:
        """Return the names of Pinocchio's joints, in the order of `centers`."""
        return list(self.model.names)

    def centers(self) -> Array:
        """Return the centers of mass (njoints, 3) of the bodies that joints move, m, world frame."""
        poses = zip(self.data.oMi, self.model.inertias, strict=True)
        return np.array([pose.act(inertia.lever) for pose, inertia in poses])
