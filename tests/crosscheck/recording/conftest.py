"""A scene with everything that a recording shows, and two runs of it."""

from __future__ import annotations

import pytest
from recordings import lid_runs, lid_scene

from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory


@pytest.fixture(scope="package")
def scene() -> Scene:
    return lid_scene()


@pytest.fixture(scope="package")
def runs(scene: Scene) -> dict[str, Trajectory]:
    return lid_runs(scene)
