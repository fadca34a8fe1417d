"""Choose the engines that a recording draws with meshes, so that its file stays of a bearable size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from newton_euler.limits import MB, size_in_bytes
from newton_euler.model.mechanism import Mechanism

BYTES_PER_ROW = 12
"""Three numbers of single precision for a vertex, three indices for a triangle."""


def mesh_bytes(mechanism: Mechanism) -> int:
    """Compute the bytes of the meshes of all bodies in a recording, for one engine."""
    meshes = [mesh for body in mechanism.bodies for mesh in body.meshes]
    return BYTES_PER_ROW * sum(len(mesh.vertices) + len(mesh.triangles) for mesh in meshes)


def engines_with_meshes(mechanism: Mechanism, engines: Sequence[str]) -> list[str]:
    """Choose the first engines whose meshes together fit into the limit `recording_size`.

    The bodies of the others are drawn as bars and simple shapes.
    """
    size = mesh_bytes(mechanism)
    return list(engines[: size_in_bytes("recording_size") // size] if size else engines)


def without_meshes(mechanism: Mechanism) -> Mechanism:
    """Copy a mechanism without the meshes of its bodies, to be drawn."""
    bodies = [replace(body, meshes=()) for body in mechanism.bodies]
    return Mechanism(bodies, mechanism.joints, mechanism.couplings)


def meshes_left_out(mechanism: Mechanism, engines: Sequence[str]) -> str:
    """Word which engines are drawn without meshes and which option draws all; "" if none is."""
    others = engines[len(engines_with_meshes(mechanism, engines)) :]
    if not others:
        return ""
    size = mesh_bytes(mechanism) / MB
    needed = int(size * len(engines)) + 1
    return (
        f"recording without meshes of {', '.join(others)}: {size:.0f} MB for each engine; "
        f"to record all: --set recording_size={needed}"
    )
