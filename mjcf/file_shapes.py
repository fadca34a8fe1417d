"""Shapes of an MJCF file's bodies, for collisions and drawn ones, for a comparison of files.

MuJoCo moves the frame of a mesh to its center and turns it to its principal axes. The frame of a `FileShape`
is that of the mesh file, as the MJCF places it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.placements import rotation_of
from mjcf.reading.essentials import essential_texts
from mjcf.reading.source import copy_model
from mjcf.reading.xml_scan import SourceError, read_texts
from mjcf.robot import compiled, numbers_of
from newton_euler.model.source_file import path_text, xml_tree
from newton_euler.reading.digits import VARIANTS
from newton_euler.reading.file_shapes import GROUND, FileShape, FileShapes, Role, note_of_meshes
from newton_euler.reading.robot import Placement
from newton_euler.scalars import Array

KINDS = mujoco.mjtGeom
"""MuJoCo's kinds of shapes."""

KIND_NAMES = {
    KINDS.mjGEOM_PLANE: "plane",
    KINDS.mjGEOM_HFIELD: "height field",
    KINDS.mjGEOM_SPHERE: "sphere",
    KINDS.mjGEOM_CAPSULE: "capsule",
    KINDS.mjGEOM_ELLIPSOID: "ellipsoid",
    KINDS.mjGEOM_CYLINDER: "cylinder",
    KINDS.mjGEOM_BOX: "box",
    KINDS.mjGEOM_MESH: "mesh",
    KINDS.mjGEOM_SDF: "mesh",
}
"""Words for kinds of shapes."""

CONTACT = ("contype", "conaffinity", "condim", "friction", "margin", "gap")
"""Numbers that decide whether and how shapes touch."""

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Vertices that stand for those of a mesh file that is not read, m."""


def file_shapes(
    source: str | os.PathLike[str] | mujoco.MjModel | mujoco.MjSpec, root: str | None = None
) -> FileShapes:
    """Read the shapes of a model, and the vertices of their meshes.

    Args:
        source: path of an MJCF file, or a model in memory, which has no text and so no uncertainty.
        root: folder that must contain all files that a file refers to; None as in `mjcf.robot.describe`.

    Raises:
        SourceError: for a file that cannot be read, and a model that MuJoCo refuses.
    """
    if not isinstance(source, str | os.PathLike):
        _, model, _ = copy_model(source)
        return FileShapes(tuple(_shapes(model, ())))
    path = path_text(source, SourceError)
    files = read_texts(path, root)
    bodies = {each.get("name") for text in files.texts.values() for each in xml_tree(text).iter("body")}
    # a missing file stays in the text, and gets other vertices when the text is compiled
    with_missing = files._replace(find_asset=lambda tag, file: files.find_asset(tag, file) or file)
    texts = essential_texts(with_missing, shapes_of=frozenset((GROUND, *bodies))).texts
    notes: tuple[str, ...] = ()
    with collected_warnings():
        meshes = _Meshes(reads_files=True)
        try:
            model = compiled(texts, is_variant=True, prepare=meshes.prepare)
            notes = note_of_meshes(list(meshes.replaced.values()))
        except (ValueError, mujoco.FatalError) as error:
            # for example of a file that is no mesh
            meshes = _Meshes(reads_files=False)
            notes = (f"meshes are compared by place only: {' '.join(str(error).split()):.200}",)
            try:
                model = compiled(texts, is_variant=True, prepare=meshes.prepare)
            except (ValueError, mujoco.FatalError) as refusal:
                raise SourceError(path, f"MuJoCo refuses its shapes: {refusal}") from refusal
        shapes = tuple(_shapes(model, meshes.replaced))
        numbers = {name: numbers_of(text) for name, text in texts.items()}
        random = np.random.default_rng(0)
        variants = []
        for _ in range(VARIANTS):
            changed = {name: each.variant(random) for name, each in numbers.items()}
            with suppress(ValueError, mujoco.FatalError):
                replaced = _Meshes(reads_files=False)
                variant = compiled(changed, is_variant=True, prepare=replaced.prepare)
                variants.append(tuple(_shapes(variant, replaced.replaced)))
    return FileShapes(shapes, tuple(variants), notes)


class _Meshes:
    """Replacement of mesh files by a few vertices, which keeps the places of shapes.

    Attributes:
        replaced: name of the file of each mesh that is replaced, by the name of the mesh.
    """

    def __init__(self, reads_files: bool) -> None:
        """Decide which files are replaced.

        Args:
            reads_files: True to replace missing files only; False to replace all files but those that a shape
                of another kind is fitted to.
        """
        self._reads_files = reads_files
        self.replaced: dict[str, str] = {}

    def prepare(self, spec: mujoco.MjSpec) -> None:
        """Replace the mesh files and the files of height fields in a model before it is compiled."""
        of_mesh = KINDS.mjGEOM_MESH, KINDS.mjGEOM_SDF
        fitted = {geom.meshname for geom in spec.geoms if geom.type not in of_mesh}
        for mesh in spec.meshes:
            mesh.name = mesh.name or Path(mesh.file).stem
            is_missing = not Path(mesh.file).is_file()
            if mesh.file and (is_missing or not (self._reads_files or mesh.name in fitted)):
                self.replaced[mesh.name] = Path(mesh.file).name
                mesh.file, mesh.content_type = "", ""
                mesh.uservert = TETRAHEDRON.ravel()
            if mesh.name not in fitted:
                # the solid of an open mesh may have no volume, which MuJoCo refuses
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        for field in spec.hfields:
            if field.file:
                field.file, field.content_type = "", ""
                field.nrow, field.ncol, field.userdata = 2, 2, np.zeros(4)


def _shapes(model: mujoco.MjModel, unread: dict[str, str] | tuple[()]) -> Iterator[FileShape]:
    """Yield the shapes of a compiled model.

    Args:
        model: the model.
        unread: names of meshes whose vertices stand for others.
    """
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        kind = KINDS(model.geom_type[geom])
        placement = Placement(model.geom_pos[geom].copy(), rotation_of(model.geom_quat[geom]))
        vertices, scale = None, np.ones(3)
        if KIND_NAMES[kind] == "mesh":
            mesh = model.mesh(model.geom_dataid[geom])
            moved = Placement(model.mesh_pos[mesh.id], rotation_of(model.mesh_quat[mesh.id]))
            placement, scale = placement @ moved.inverse(), model.mesh_scale[mesh.id].copy()
            if mesh.name not in unread:
                first, count = mesh.vertadr[0], mesh.vertnum[0]
                own = np.array(model.mesh_vert[first : first + count], dtype=float)
                vertices = moved.position + own @ moved.rotation.T
        touches = model.geom_contype[geom] or model.geom_conaffinity[geom]
        yield FileShape(
            body=(model.body(body).name or f"body {body}") if body else GROUND,
            role=Role.COLLISION if touches else Role.VISUAL,
            kind=KIND_NAMES[kind],
            placement=placement,
            size=_size(model, geom, kind),
            vertices=vertices,
            scale=scale,
            contact={
                name: tuple(np.atleast_1d(getattr(model, f"geom_{name}")[geom]).tolist()) for name in CONTACT
            },
        )


def _size(model: mujoco.MjModel, geom: int, kind: mujoco.mjtGeom) -> Array:
    """Return the numbers of `FileShape.size` of a geom."""
    size = model.geom_size[geom]
    match kind:
        case KINDS.mjGEOM_BOX:
            return np.asarray(2.0 * size)
        case KINDS.mjGEOM_SPHERE:
            return size[:1].copy()
        case KINDS.mjGEOM_CAPSULE | KINDS.mjGEOM_CYLINDER:
            return np.array([size[0], 2.0 * size[1]])
        case KINDS.mjGEOM_ELLIPSOID:
            return size.copy()
        case KINDS.mjGEOM_HFIELD:
            return model.hfield_size[model.geom_dataid[geom]].copy()
    return np.zeros(0)
