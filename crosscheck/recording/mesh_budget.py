"""Choose the engines that a recording draws with meshes, so that its file does not exceed a size limit.

Engines are simulators that ran the same model; the recording draws the bodies of each in its own poses. The
user can set the limit, `recording_size`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from newton_euler.limits import MB, size_in_bytes
from newton_euler.model.mechanism import Mechanism

BYTES_PER_ROW = 12
"""Bytes of a vertex (three numbers in single precision), and of a triangle (three indices)."""


def mesh_bytes(mechanism: Mechanism) -> int:
    """Compute the bytes of the meshes of all bodies in a recording, for one engine."""
    meshes = [mesh for body in mechanism.bodies for mesh in body.meshes]
    return BYTES_PER_ROW * sum(len(mesh.vertices) + len(mesh.triangles) for mesh in meshes)


def engines_with_meshes(mechanism: Mechanism, engines: Sequence[str]) -> list[str]:
    """Choose the first engines whose meshes together fit into the limit `recording_size`.

    The recording shows the bodies of the other engines as bars and simple shapes.
    """
    per_engine = mesh_bytes(mechanism)
    if not per_engine:
        return list(engines)
    return list(engines[: size_in_bytes("recording_size") // per_engine])


def without_meshes(mechanism: Mechanism) -> Mechanism:
    """Copy a mechanism without the meshes of its bodies."""
    bodies = [replace(body, meshes=()) for body in mechanism.bodies]
    return Mechanism(bodies, mechanism.joints, mechanism.couplings)


def meshes_left_out(mechanism: Mechanism, engines: Sequence[str]) -> str:
    """Name the engines that are drawn without meshes, and the option that draws all; "" if there are none."""
    without = engines[len(engines_with_meshes(mechanism, engines)) :]
    if not without:
        return ""
    per_engine = mesh_bytes(mechanism) / MB
    needed = int(per_engine * len(engines)) + 1
    return (
        f"recording without meshes of {', '.join(without)}: {per_engine:.0f} MB for each engine; "
        f"to record all: --set recording_size={needed}"
    )
