"""A mechanism as its recording shows it: by the Rerun viewer if that runs here, otherwise drawn with
matplotlib from the shapes and poses of the first engine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.report.plots import OTHER_STYLE, STYLES, png
from newton_euler.model.euler_parameters import rotation
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

MOST_TRIANGLES = 2000
"""Of a mesh; of a larger one every so many are drawn."""

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
EDGES = [(a, b) for a in range(8) for b in range(a) if np.sum(CORNERS[a] != CORNERS[b]) == 1]
"""Of a box: (8, 3) signs of the half sizes, and the pairs of them that an edge joins."""


def views(recording: Path, engine: str, shares: Sequence[float]) -> Iterator[tuple[bytes, str]]:
    """Pictures (PNG) and captions of a recording at shares of its duration, from 0 to 1.

    Raises:
        CrosscheckError: if there is nothing in the recording to draw.
    """
    poses, shapes = _read(recording, engine)
    if not poses:
        raise CrosscheckError(f"no bodies of {engine} in {recording}")
    duration = max(float(times[-1]) for times, *_ in poses.values())
    moments = [share * duration for share in shares]
    try:
        from crosscheck.recording.screenshot import screenshots

        taken = screenshots(recording, moments)
    except (CrosscheckError, ImportError):  # no driver for graphics, or another Rerun
        yield _drawn(poses, shapes, engine, moments), f"The mechanism at {_list(moments)} s, by {engine}"
        return
    for picture, moment in zip(taken, moments, strict=True):
        yield picture, f"The recording at {moment:.4g} s"


def _list(moments: Sequence[float]) -> str:
    return ", ".join(f"{moment:.4g}" for moment in moments)


Poses = dict[str, tuple[Array, Array, Array]]
"""Times (n,), s, translations (n, 3) and quaternions (n, 4) w-x-y-z, by entity."""

Shapes = dict[str, dict[str, Any]]
"""Components by name, by entity."""


def _read(recording: Path, engine: str) -> tuple[Poses, Shapes]:
    """The poses of an engine's bodies, and the shapes in their frames."""
    if not recording.is_file():  # a pipe would keep its reader waiting
        raise CrosscheckError(f"{recording}: not a regular file")
    try:
        return _entities(recording, engine)
    except (RuntimeError, OSError, ValueError, LookupError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise CrosscheckError(f"cannot read {recording}: {reason}") from error


def _entities(recording: Path, engine: str) -> tuple[Poses, Shapes]:
    """`_read` of a file that may hold anything."""
    from rerun.chunk import RrdReader

    poses: Poses = {}
    shapes: Shapes = {}
    for chunk in RrdReader(recording).stream():
        path = chunk.entity_path
        if not path.startswith(f"/mechanism/{engine}/"):
            continue
        batch = chunk.to_record_batch()
        columns = {name: batch.column(name) for name in batch.schema.names}
        if chunk.is_static:
            found = shapes.setdefault(path, {})
            found |= {name: column.to_pylist()[0] for name, column in columns.items() if ":" in name}
        elif "Transform3D:translation" in columns and "time" in columns:
            times = np.array(columns["time"].cast("int64").to_pylist()) * 1e-9
            translation = np.array(columns["Transform3D:translation"].to_pylist())[:, 0]
            xyzw = np.array(columns["Transform3D:quaternion"].to_pylist())[:, 0]
            poses[path] = times, translation, xyzw[:, [3, 0, 1, 2]]
    return poses, shapes


def _drawn(poses: Poses, shapes: Shapes, engine: str, moments: Sequence[float]) -> bytes:
    """Pictures side by side, at one scale."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * len(moments), 4.0), layout="constrained")
    axes: list[Axes3D] = []
    for number, moment in enumerate(moments):
        ax: Axes3D = figure.add_subplot(1, len(moments), number + 1, projection="3d")
        ax.set_title(f"{moment:.4g} s", fontsize="medium")
        for path, (times, translation, quaternion) in poses.items():
            n = int(np.argmin(np.abs(times - moment)))
            for entity, found in shapes.items():
                if entity == path or entity.startswith(f"{path}/mesh_"):
                    _draw(ax, found, translation[n], quaternion[n], engine)
        axes.append(ax)
    limits = [(ax.get_xlim3d(), ax.get_ylim3d(), ax.get_zlim3d()) for ax in axes]
    low = np.min([[x[0] for x in limit] for limit in limits], axis=0)
    high = np.max([[x[1] for x in limit] for limit in limits], axis=0)
    for ax in axes:
        ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
        ax.set_box_aspect(np.maximum(high - low, 0.05 * np.max(high - low)))
    return png(figure)


def _draw(ax: Axes3D, shape: dict[str, Any], origin: Array, quaternion: Array, engine: str) -> None:
    """The boxes, bars and meshes of one entity, whose frame is at an origin."""
    turn = rotation(quaternion)
    color = STYLES.get(engine, OTHER_STYLE)[0]

    def line(points: Array) -> None:
        ax.plot(*(origin + points @ turn.T).T, color=color, linewidth=1.5)

    boxes = (shape.get(f"Boxes3D:{name}") or [] for name in ("half_sizes", "centers", "quaternions"))
    for half_sizes, center, xyzw in zip(*boxes, strict=True):
        corners = center + (CORNERS * half_sizes) @ _rotation(xyzw).T
        for a, b in EDGES:
            line(corners[[a, b]])
    bars = (shape.get(f"Capsules3D:{name}") or [] for name in ("lengths", "translations", "quaternions"))
    for length, start, xyzw in zip(*bars, strict=True):
        line(np.array(start) + np.outer([0.0, length], _rotation(xyzw)[:, 2]))
    triangles = shape.get("Mesh3D:triangle_indices")
    if triangles:
        from mpl_toolkits.mplot3d.art3d import Poly3DCollection

        vertices = origin + np.array(shape["Mesh3D:vertex_positions"]) @ turn.T
        few = np.array(triangles)[:: 1 + len(triangles) // MOST_TRIANGLES]
        ax.add_collection3d(Poly3DCollection(vertices[few], facecolor=color, alpha=0.4))
        ax.auto_scale_xyz(*vertices.T)


def _rotation(xyzw: Sequence[float]) -> Array:
    x, y, z, w = xyzw
    return rotation(np.array([w, x, y, z]))
