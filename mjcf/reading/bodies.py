"""Import the bodies of a compiled MuJoCo model as bodies of a scene, for `mjcf.reader`.

MuJoCo's bodies that are fixed to each other become one body of the scene, with their total mass and inertia.
Bodies that are fixed to the world become the ground. The shapes of a body are the boxes, spheres, cylinders,
capsules and meshes that MuJoCo's viewer shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from mjcf.loops import body_velocity
from mjcf.reading.start import ModelAtStart
from mjcf.reading.xml_scan import SourceError
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.geometry import Box, Capsule, Cylinder, Inertia, Mesh, Shape, Sphere, total_inertia
from newton_euler.model.mechanism import REALISABLE_TOLERANCE, Body
from newton_euler.reading.import_report import ImportReport, unique_name
from newton_euler.scalars import Array

FIRST_HIDDEN_GROUP = 3
"""First group of geoms that viewers hide by default. Models have their collision shapes in such groups."""

UNSET_COLOR = (0.5, 0.5, 0.5, 1.0)
"""Color (red, green, blue, opacity) of a geom in the compiled model if the file sets no color."""


GROUND = "ground"
"""Name of the ground, the first body of a scene."""


class Bodies:
    """Imported bodies.

    A root is a body of MuJoCo with joints, or the world body 0. Each of the other bodies is fixed to its
    nearest ancestor that is a root, and becomes a part of the root's body in the scene.

    Attributes:
        bodies: bodies of the scene, ground first.
        roots: MuJoCo's numbers of the roots, in the order of `bodies`.
        names: for each of MuJoCo's bodies, the name of its body in the scene.
    """

    def __init__(self, start: ModelAtStart, report: ImportReport) -> None:
        """Import all bodies at the start state, and report them.

        Args:
            start: MuJoCo's model and data at the start state of runs, and the path of the file.
            report: report that receives one entry for each of MuJoCo's bodies.

        Raises:
            SourceError: for a moving body without a positive mass.
        """
        model = start.model
        self._model, self._data = model, start.data
        # root of each body; body_weldid is not used, because mocap bodies are roots there
        self._root = [0] * model.nbody
        for k in range(1, model.nbody):
            self._root[k] = k if model.body_jntnum[k] else self._root[model.body_parentid[k]]
        self.roots = [0] + [k for k in range(1, model.nbody) if self._root[k] == k]
        name_of_root = {self.roots[0]: GROUND}
        for root in self.roots[1:]:
            name_of_root[root] = unique_name(model.body(root).name, f"body_{root}", name_of_root.values())
        self.names = [name_of_root[root] for root in self._root]
        self.bodies = [Body.ground(GROUND, self._shapes(0), meshes(model, start.data, self.members(0)))]
        for root in self.roots[1:]:
            self.bodies.append(self._body(root, start.path))
        for k in range(1, model.nbody):
            self._report(k, report)

    def _report(self, k: int, report: ImportReport) -> None:
        """Report the body of the scene to which MuJoCo's body number `k` belongs."""
        name = self._model.body(k).name
        element = element_name(self._model, "body", k)
        if k != self._root[k]:
            mocap = " where mocap has it at the start" if self._model.body_mocapid[k] >= 0 else ""
            report.imported(element, f"part of {self.names[k]!r}, to which it is fixed{mocap}")
        else:
            report.imported(element, f"body {self.names[k]!r}" if self.names[k] != name else "a body")

    def members(self, root: int) -> Array:
        """Return the numbers of a root and of the bodies that are fixed to the root."""
        return np.flatnonzero(np.array(self._root) == root)

    def _body(self, root: int, path: str) -> Body:
        """Return the body of the scene with the total inertia of a root and the bodies fixed to the root."""
        model, data = self._model, self._data
        members = self.members(root)
        name = self.names[root]
        mass = float(model.body_mass[members].sum())
        if not mass > 0.0:
            problem = "has no mass" if mass == 0.0 else f"has a mass of {mass:g} kg"
            raise SourceError(path, f"body {name!r} {problem}; needed: a positive mass")
        # center of mass and inertia, world axes
        axes = data.ximat.reshape(-1, 3, 3)
        whole = total_inertia(
            [
                Inertia(
                    model.body_mass[k], data.xipos[k], axes[k] @ np.diag(model.body_inertia[k]) @ axes[k].T
                )
                for k in members
            ]
        )
        # inertia in the frame of the root, made symmetric to the last bit
        quaternion = data.xquat[root] / np.linalg.norm(data.xquat[root])
        to_body = rotation(quaternion).T
        inertia = to_body @ whole.inertia @ to_body.T
        inertia = 0.5 * (inertia + inertia.T)
        # principal moments a <= b <= c of a real body satisfy a + b >= c; MuJoCo also simulates others
        a, b, c = np.linalg.eigvalsh(inertia)
        # as `Body` needs them, the inertia is in the body frame, all else in the world frame at the start
        return Body(
            name,
            mass=whole.mass,
            center_of_mass=whole.center_of_mass,
            inertia=inertia,
            quaternion=quaternion,
            shapes=self._shapes(root),
            allow_unrealisable_inertia=bool(a + b < c * (1.0 - REALISABLE_TOLERANCE)),
            meshes=meshes(model, data, members),
        )

    def _shapes(self, root: int) -> tuple[Shape, ...]:
        """Return boxes, spheres, cylinders and capsules among the visible geoms of a root and its members."""
        shapes = (self._shape(geom) for geom in visible_geoms(self._model, self.members(root)))
        return tuple(shape for shape in shapes if shape is not None)

    def _shape(self, geom: int) -> Shape | None:
        """Return the shape of a geom in the world frame; None for other types, such as meshes and planes."""
        model, kinds = self._model, mujoco.mjtGeom
        kind, size = kinds(model.geom_type[geom]), model.geom_size[geom]
        center, axes = self._data.geom_xpos[geom], self._data.geom_xmat[geom].reshape(3, 3)
        if kind == kinds.mjGEOM_BOX and np.all(size > 0.0):
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, axes.ravel())
            return Box(size, center, quaternion / np.linalg.norm(quaternion))
        if kind == kinds.mjGEOM_SPHERE and size[0] > 0.0:
            return Sphere(center, float(size[0]))
        bars: dict[Any, type[Capsule | Cylinder]]
        bars = {kinds.mjGEOM_CAPSULE: Capsule, kinds.mjGEOM_CYLINDER: Cylinder}
        radius, half_length = size[:2]
        if kind in bars and radius > 0.0 and half_length > 0.0:
            start, end = center - half_length * axes[:, 2], center + half_length * axes[:, 2]
            return bars[kind](start, end, float(radius))
        return None

    def root(self, name: str) -> int:
        """Return MuJoCo's number of the root of a body of the scene, by name; both have the same frame."""
        return next(root for root in self.roots if self.names[root] == name)

    def velocity(self, root: int, point: Array) -> tuple[Array, Array]:
        """Return the velocity of a point on a root, and the angular velocity of the root.

        Args:
            root: MuJoCo's number of the root.
            point: (3,) m, world frame.

        Returns:
            Velocity (3,), m/s, and angular velocity (3,), rad/s, world frame, at the start state.
        """
        center_velocity, angular = body_velocity(self._model, self._data, root)  # of the center of mass
        return center_velocity + np.cross(angular, point - self._data.xipos[root]), angular


def visible_geoms(model: Any, bodies: Array) -> Iterator[int]:
    """Yield the numbers of the geoms of MuJoCo's `bodies` (k,) that viewers show by default."""
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, bodies)):
        if model.geom_group[geom] < FIRST_HIDDEN_GROUP and _color(model, int(geom))[3] > 0.0:
            yield int(geom)


def meshes(model: Any, data: Any, bodies: Array) -> tuple[Mesh, ...]:
    """Return the visible meshes of MuJoCo's `bodies` (k,), world frame, at the state in `data`."""
    visible_meshes = []
    for geom in visible_geoms(model, bodies):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        mesh = model.mesh(model.geom_dataid[geom])
        points = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
        triangles = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
        vertices = data.geom_xpos[geom] + points @ data.geom_xmat[geom].reshape(3, 3).T
        visible_meshes.append(Mesh(vertices, triangles, _color(model, geom)))
    return tuple(visible_meshes)


def _color(model: Any, geom: int) -> tuple[float, float, float, float]:
    """Return (red, green, blue, opacity), 0 to 1, of a geom, or of its material if the geom has no color."""
    material, color = model.geom_matid[geom], model.geom_rgba[geom]
    if material >= 0 and np.allclose(color, UNSET_COLOR):
        color = model.mat_rgba[material]
    red, green, blue, opacity = np.clip(color, 0.0, 1.0).tolist()
    return red, green, blue, opacity
