"""A scene with a lid, made-up motions of it, and recordings read back, for the tests of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rerun.chunk import RrdReader

from crosscheck.recording.log import log_run
from crosscheck.recording.stream import recorded
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import from_rotation_vector
from newton_euler.model.geometry import Box, Capsule
from newton_euler.model.joint_kinds import Prismatic, Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

N = 5
PERIOD = 0.3  # 3 periods are a little less than 0.9 s in floating point
TILT = from_rotation_vector(np.array([0.3, -0.2, 0.5]))
AXIS = np.array([0.6, 0.0, 0.8])
LID_BOX = Box([0.1, 0.2, 0.01], [0.5, 0.1, 0.3], TILT)
LID_BAR = Capsule([0.4, 0.1, 0.3], [0.6, 0.3, 0.2], 0.02)
VERDICT = "# Verdict\n\n| a | b |\n|---|---|\n| 1 | 2 |\n"


def lid_scene() -> Scene:
    """A slider on an inclined rail, and on it a hinged lid with a body frame that is turned."""
    inertia = np.diag([0.1, 0.1, 0.1])
    bodies = (
        Body.ground(shapes=(Box([0.5, 0.5, 0.01], [0.0, 0.0, -0.01]),)),
        Body("slider", 1.0, [0.3, 0.1, 0.3], inertia),
        Body("lid", 1.0, [0.5, 0.1, 0.35], inertia, TILT, shapes=(LID_BOX, LID_BAR)),
    )
    joints = (
        Prismatic("rail", "ground", "slider", [0.3, 0.1, 0.3], axis=AXIS, actuated=True),
        Revolute("hinge", "slider", "lid", [0.4, 0.1, 0.3], axis=[0.0, 1.0, 0.0]),
    )
    control = (PD("rail", 10.0, 1.0, 0.1),)
    return Scene("lid_scene", Mechanism(bodies, joints), (N - 1) * PERIOD, PERIOD, control=control)


def motion(scene: Scene, seed: int) -> Trajectory:
    """Numbers of the right shapes; quaternions are of unit length, nothing else is physical."""
    random = np.random.default_rng(seed)
    mechanism = scene.mechanism
    b, j = len(mechanism.bodies), len(mechanism.joints)
    state = State.initial(mechanism)
    quaternion = state.quaternion + 0.2 * random.standard_normal((N, b, 4))
    position = state.position + 0.1 * random.standard_normal((N, b, 3))
    quaternion[:, 0], position[:, 0] = state.quaternion[0], state.position[0]
    return Trajectory(
        engine="made up",
        settings={},
        wall_time=0.0,
        time=scene.times,
        body_names=mechanism.body_names,
        joint_names=mechanism.joint_names,
        position=position,
        quaternion=quaternion / np.linalg.norm(quaternion, axis=2, keepdims=True),
        reaction_force=random.standard_normal((N, j, 3)),
        reaction_torque=random.standard_normal((N, j, 3)),
        actuator_force=random.standard_normal((N, 1)),
        constraint_violation=random.random((N, j)) * 1e-9,
        kinetic_energy=random.random(N),
        potential_energy=random.random(N),
    )


def lid_runs(scene: Scene) -> dict[str, Trajectory]:
    return {"zeta": motion(scene, 1), "alpha": motion(scene, 2)}


def write_recording(
    path: Path,
    scene: Scene,
    runs: dict[str, Trajectory],
    title: str = "lid_scene",
    tolerances: dict[tuple[str, ...], float] | None = None,
) -> None:
    path.write_bytes(recorded(log_run, scene, runs, VERDICT, title, tolerances))


class Recording(NamedTuple):
    """Values by (entity, component), as rows of instances; times in ns by entity."""

    static: dict[tuple[str, str], Any]
    columns: dict[tuple[str, str], list[Any]]
    times: dict[str, list[int]]

    @property
    def entities(self) -> set[str]:
        return {path for path, _ in self.static} | {path for path, _ in self.columns}

    def scalars(self, path: str) -> Array:
        return np.array(self.columns[path, "Scalars:scalars"])[:, 0]


def read_recording(path: Path) -> Recording:
    static, columns, times = {}, {}, {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        values = {name: batch.column(name) for name in batch.schema.names if ":" in name}
        for component, column in values.items():
            if chunk.is_static:
                static[chunk.entity_path, component] = column.to_pylist()[0]
            else:
                columns[chunk.entity_path, component] = column.to_pylist()
                assert chunk.timeline_names == ["time"]
                times[chunk.entity_path] = batch.column("time").cast("int64").to_pylist()
    return Recording(static, columns, times)
