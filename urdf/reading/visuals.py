"""Import the visual elements of a URDF's links for display: boxes, cylinders, spheres and meshes.

Mesh files are read in a separate process with limits of time and memory (`load_meshes`), because a file may
be hostile. An element that cannot be shown is reported as left out; this does not affect the simulation.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import starmap
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.errors import NewtonEulerError
from newton_euler.limits import size_in_bytes
from newton_euler.model.geometry import Box, Cylinder, Mesh, Shape, Sphere
from newton_euler.model.mechanism import Body
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array
from urdf.reading.bodies import W_X_Y_Z, Tree
from urdf.reading.start import RobotAtStart

MAX_MESH_BYTES = 50_000_000
"""Largest size of a mesh file."""

MAX_MESHES_S = 60.0
"""Largest waiting time, s, for the process that reads all meshes; `load_meshes` limits the CPU time."""

Color = tuple[float, float, float, float]
"""Red, green, blue and opacity, 0 to 1."""


@dataclass(frozen=True)
class _Visual:
    """Visual element of a link.

    Attributes:
        body: number of the body in the scene.
        link: name of the link.
        element: XML element.
        pose: `pinocchio.SE3` of the element in the world at the start.
        color: color of the element or of its material; None without color.
    """

    body: int
    link: str
    element: ET.Element
    pose: Any
    color: Color | None


class UnusableShape(Exception):
    """Shape of a link that cannot be read; the message is the reason."""


def with_visuals(
    path: str, root: ET.Element, start: RobotAtStart, tree: Tree, report: ImportReport
) -> list[Body]:
    """Return the bodies of a tree with shapes and meshes, and report visual elements that cannot be shown.

    A mesh file must be in the folder of the URDF, in its parent folder, or in the package that its path
    names. A package is a parent folder of that name, or a folder with a `package.xml` in a parent folder.

    Args:
        path: path of the URDF.
        root: root element of the URDF.
        start: Pinocchio's model and data at the start state.
        tree: imported bodies.
        report: report that receives the entries.
    """
    shapes: list[tuple[_Visual, Shape]] = []
    meshes: list[tuple[_Visual, Path, Array]] = []  # visual element, file, scale (3,)
    for visual in _visuals(root, start, tree):
        element = f"visual of link {visual.link!r}"
        try:
            shape = _primitive(visual)
            if shape is None:
                meshes.append((visual, *mesh_file(Path(path), visual.element)))
            else:
                shapes.append((visual, shape))
        except (UnusableShape, NewtonEulerError) as error:
            report.left_out(element, str(error), moves_nothing=True)
    files = read_meshes(list(dict.fromkeys(file for _, file, _ in meshes)))
    drawn: list[tuple[_Visual, Mesh]] = []
    for visual, file, scale in meshes:
        mesh = files[file]
        if mesh is None:
            element, why = f"visual of link {visual.link!r}", f"no mesh can be read from {file.name!r}"
            report.left_out(element, why, moves_nothing=True)
        else:
            drawn.append((visual, _placed(visual, mesh, scale)))
    if shapes or drawn:
        report.imported(f"{len(shapes) + len(drawn)} visuals", "drawn")
    return [
        replace(
            body,
            shapes=tuple(shape for visual, shape in shapes if visual.body == k),
            meshes=tuple(mesh for visual, mesh in drawn if visual.body == k),
        )
        for k, body in enumerate(tree.bodies)
    ]


def link_shapes(path: str, root: ET.Element, links: Collection[str]) -> dict[str, list[Shape | Mesh]]:
    """Return the shapes of links in the frames of the links: visual ones, or else those for collisions.

    Args:
        path: path of the URDF.
        root: root element of the URDF.
        links: names of the links; a link with other shapes that cannot be read is left out.
    """
    candidates: dict[str, list[list[tuple[_Visual, Shape | None]]]] = {}
    files: dict[int, tuple[Path, Array]] = {}  # of meshes, by identity of the element
    for link in root.findall("link"):
        name = str(link.get("name"))
        for tag in ("visual", "collision") if name in links else ():
            of_tag = []
            with suppress(UnusableShape, NewtonEulerError):
                for element in link.findall(tag):
                    visual = _Visual(0, name, element, origin(element.find("origin")), None)
                    of_tag.append((visual, _primitive(visual)))
                    if of_tag[-1][1] is None:
                        files[id(element)] = mesh_file(Path(path), visual.element)
                candidates.setdefault(name, []).append(of_tag)
    meshes = read_meshes(list(dict.fromkeys(file for file, _ in files.values())))

    def loaded(visual: _Visual, shape: Shape | None) -> Shape | Mesh | None:
        """Return a shape, or its mesh in the frame of the link; None for a mesh that cannot be read."""
        if shape is not None:
            return shape
        file, scale = files[id(visual.element)]
        mesh = meshes[file]
        return None if mesh is None else _placed(visual, mesh, scale)

    found: dict[str, list[Shape | Mesh]] = {}
    for name, alternatives in candidates.items():
        for of_tag in alternatives:
            shapes = [shape for shape in starmap(loaded, of_tag) if shape is not None]
            if len(shapes) == len(of_tag) > 0:
                found[name] = shapes
                break
    return found


def _visuals(root: ET.Element, start: RobotAtStart, tree: Tree) -> list[_Visual]:
    """Return the visual elements of links that are part of a body; some massless links are part of none."""
    bodies = {body.name: k for k, body in enumerate(tree.bodies)}
    colors = {m.get("name"): _rgba(m) for m in root.findall("material")}
    visuals = []
    frames = {f.name: k for k, f in enumerate(start.model.frames) if f.type == pin.FrameType.BODY}
    for link in root.findall("link"):
        name = str(link.get("name"))
        frame = frames.get(name)
        body = None if frame is None else tree.names[start.model.frames[frame].parentJoint]
        if body is None:
            continue
        for element in link.findall("visual"):
            material = element.find("material")
            color = None if material is None else _rgba(material) or colors.get(material.get("name"))
            pose = start.data.oMf[frame] * origin(element.find("origin"))
            visuals.append(_Visual(bodies[body], name, element, pose, color))
    return visuals


def _rgba(material: ET.Element) -> Color | None:
    """Return the color of an element `<material>`; None without a valid color."""
    element = material.find("color")
    if element is None:
        return None
    try:
        red, green, blue, opacity = (min(max(float(x), 0.0), 1.0) for x in element.get("rgba", "").split())
    except ValueError:
        return None
    return red, green, blue, opacity


def origin(element: ET.Element | None) -> Any:
    """Return the `pinocchio.SE3` of an element `<origin>`, the identity without an element.

    `urdf.reading.source` has checked the numbers of the element.
    """
    if element is None:
        return pin.SE3.Identity()
    rpy = [float(x) for x in element.get("rpy", "0 0 0").split()]
    xyz = [float(x) for x in element.get("xyz", "0 0 0").split()]
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def _primitive(visual: _Visual) -> Shape | None:
    """Return the box, cylinder or sphere of a visual element; None for other shapes, such as meshes."""
    geometry = visual.element.find("geometry")
    box, cylinder, sphere = (
        None if geometry is None else geometry.find(kind) for kind in ("box", "cylinder", "sphere")
    )
    pose = visual.pose
    if box is not None:
        quaternion = pin.SE3ToXYZQUAT(pose)[W_X_Y_Z]
        half = 0.5 * shape_numbers(box, "size", 3)
        return Box(half, pose.translation, quaternion / np.linalg.norm(quaternion))
    if cylinder is not None:
        arm = 0.5 * shape_numbers(cylinder, "length", 1) * pose.rotation[:, 2]
        radius = float(shape_numbers(cylinder, "radius", 1)[0])
        return Cylinder(pose.translation - arm, pose.translation + arm, radius)
    if sphere is not None:
        return Sphere(pose.translation, float(shape_numbers(sphere, "radius", 1)[0]))
    return None


def shape_numbers(element: ET.Element, name: str, count: int) -> Array:
    """Return the numbers (count,) of an attribute; raises `UnusableShape` for anything else."""
    try:
        values = [float(x) for x in element.get(name, "").split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        needed = "a number" if count == 1 else f"{count} numbers"
        raise UnusableShape(f"<{element.tag}> has {name}={element.get(name, '')!r:.100}; needed: {needed}")
    return np.array(values)


def mesh_file(urdf: Path, element: ET.Element) -> tuple[Path, Array]:
    """Return the path of the mesh file of a `<visual>` or `<collision>`, and the scale (3,) of the mesh.

    Raises `UnusableShape` for a file that does not exist, is too large, or is outside of the allowed folders.
    """
    mesh = element.find("geometry/mesh")
    if mesh is None:
        raise UnusableShape("it has no box, cylinder, sphere or mesh")
    scale = shape_numbers(mesh, "scale", 3) if mesh.get("scale") else np.ones(3)
    name = mesh.get("filename", "")
    home = urdf.resolve().parent
    package, _, rest = name.removeprefix("package://").partition("/")
    if name.startswith("package://"):
        candidates = [(folder, folder / rest) for folder in packages(home, package)]
    else:
        # files may be in the parent folder, unless it is the root of the disk
        allowed_folder = home if home.parent == Path(home.anchor) else home.parent
        candidates = [(allowed_folder, home / name.removeprefix("file://"))]
    for folder, file in candidates:
        if "\0" in name or not file.resolve().is_relative_to(folder.resolve()):
            raise UnusableShape(f"mesh {name!r:.200} leads outside of {str(folder)!r}")
        if file.is_file():
            if file.stat().st_size > MAX_MESH_BYTES:
                raise UnusableShape(f"mesh {name!r:.200} is larger than {MAX_MESH_BYTES} bytes")
            return file.resolve(), scale
    raise UnusableShape(f"mesh {name!r:.200} does not exist")


def packages(home: Path, name: str) -> list[Path]:
    """Return the folders that may be the ROS package `name`, nearest to the folder `home` of the URDF first.

    They are parents of `home` with this name, and folders of this name in a parent. The latter need a
    `package.xml`; otherwise a URDF could name any file of the disk. The root of the disk is not searched.
    """
    if name in ("", ".", "..") or "\0" in name:
        return []
    folders = []
    for folder in (home, *home.parents):
        if folder == folder.parent:
            break
        if folder.name == name:
            folders.append(folder)
        elif (folder / name / "package.xml").is_file():
            folders.append(folder / name)
    return folders


def read_meshes(files: list[Path]) -> dict[Path, Mesh | None]:
    """Return the mesh of each file, in the coordinates of the file; None for a file that cannot be read."""
    meshes: dict[Path, Mesh | None] = dict.fromkeys(files)
    if not files:
        return meshes
    with tempfile.TemporaryDirectory() as folder:
        # run by path, so that the process imports only coal, the library of Pinocchio that reads meshes
        script = Path(__file__).with_name("load_meshes.py")
        memory = str(size_in_bytes("memory"))  # limit for the process, which users may set
        command = [sys.executable, "-P", str(script), folder, memory, *map(str, files)]
        with suppress(subprocess.TimeoutExpired):
            subprocess.run(
                command,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                timeout=MAX_MESHES_S,
                check=False,
            )
        for number, file in enumerate(files):
            with suppress(OSError, ValueError, KeyError, EOFError, NewtonEulerError):
                arrays = np.load(Path(folder) / f"{number}.npz")
                meshes[file] = Mesh(arrays["vertices"], arrays["triangles"].reshape(-1, 3))
    return meshes


def _placed(visual: _Visual, mesh: Mesh, scale: Array) -> Mesh:
    """Return the mesh of a file, scaled by (3,) and placed at the pose of a visual element, world frame."""
    vertices = (scale * mesh.vertices) @ visual.pose.rotation.T + visual.pose.translation
    # a reflection reverses the order of corners, which defines the outer side
    triangles = mesh.triangles if np.prod(scale) > 0.0 else mesh.triangles[:, ::-1]
    return Mesh(vertices, triangles, visual.color)
