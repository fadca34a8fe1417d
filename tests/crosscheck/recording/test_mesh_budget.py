"""Meshes in recordings: drawn of as many engines as fit into the limit, and a line about the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import pendulum

from crosscheck.recording.mesh_budget import (
    engines_with_meshes,
    mesh_bytes,
    meshes_left_out,
    without_meshes,
)
from newton_euler.limits import changed
from newton_euler.model.geometry import Mesh
from newton_euler.model.mechanism import Mechanism

ENGINES = ["first", "second", "third"]


def meshed(vertices: int) -> Mechanism:
    """A pendulum with a strip of as many vertices and as many triangles, less two."""
    plain = pendulum().mechanism
    points = np.random.default_rng(0).standard_normal((vertices, 3))
    faces = np.arange(vertices - 2)[:, None] + [0, 1, 2]
    ground, rod = plain.bodies
    return Mechanism([ground, replace(rod, meshes=(Mesh(points, faces),))], plain.joints)


@pytest.mark.parametrize(("size", "count"), [(3.0, 3), (2.9, 2), (0.9, 0)])
def test_as_many_engines_have_meshes_as_fit(size: float, count: int) -> None:
    mechanism = meshed(1002)  # 12 bytes for each of 1002 vertices and 1000 triangles
    assert mesh_bytes(mechanism) == 12 * 2002
    with changed({"recording_size": size * 24.024e-3 * (1.0 + 1e-9)}):
        assert engines_with_meshes(mechanism, ENGINES) == ENGINES[:count]
        line = meshes_left_out(mechanism, ENGINES)
    assert all((name in line) == (name not in ENGINES[:count]) for name in ENGINES)
    assert ("--set recording_size=" in line) == (count < 3)


def test_mechanisms_without_meshes_are_drawn_of_all_engines() -> None:
    bare = without_meshes(meshed(1002))
    assert mesh_bytes(bare) == 0
    assert engines_with_meshes(bare, ENGINES) == ENGINES
    assert meshes_left_out(bare, ENGINES) == ""
