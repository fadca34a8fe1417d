"""Outputs of a run in the user's loop with Pinocchio: poses, energies and loop errors.

`urdf.file_run` makes the runs. A scene is the mechanism with forces that `urdf.reader` imports from a URDF or
a Pinocchio model.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from newton_euler.model.euler_parameters import angle_between, conjugate, continuous, product, rotations
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import FileRun, LoopErrors
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array
from urdf.loops import REVOLUTE
from urdf.pinocchio_reference import PinocchioReference
from urdf.run_settings import PinocchioSettings

ENGINE = f"Pinocchio {pin.__version__}"
"""Engine of the runs, with its version."""


class Recorder:
    """Poses of bodies, energies and loop errors at the outputs of a run."""

    def __init__(self, reference: PinocchioReference) -> None:
        """Take the model of the run."""
        self._reference, self._data = reference, reference.model.createData()
        # both frames of each loop closure
        self._ends = [frame for closure in reference.closures for frame in (closure.first, closure.second)]
        self._times: list[float] = []
        self._poses: list[list[Array]] = []
        self._energies: list[tuple[float, float]] = []

    def record(self, now: float, q: Array, v: Array) -> None:
        """Add the state at a time, s, as an output."""
        data = self._data
        pin.framesForwardKinematics(self._reference.model, data, q)
        poses = [data.oMi[k] for k in self._reference.moving_bodies] + [data.oMf[k] for k in self._ends]
        self._times.append(now)
        self._poses.append([pin.SE3ToXYZQUAT(pose) for pose in poses])
        self._energies.append(self._reference.energies(q, v))

    def run(self, scene: Scene, settings: PinocchioSettings, thread_time: float, stopped: str) -> FileRun:
        """Return the motion of the scene's bodies and the errors of loops.

        Args:
            scene: imported scene.
            settings: settings of the run.
            thread_time: processor time of the steps, s.
            stopped: reason why the run ended early, or "".
        """
        reference = self._reference
        # poses of b joints that carry bodies, then of both frames of c closures, at n outputs:
        # (n, b + 2 c, 7) with position and quaternion (x, y, z, w)
        poses: Array = np.array(self._poses)
        translations, quaternions = poses[..., :3], np.roll(poses[..., 3:], 1, axis=-1)
        count = len(reference.moving_bodies)
        levers = np.array([reference.model.inertias[k].lever for k in reference.moving_bodies])
        centers = translations[:, :count] + (rotations(quaternions[:, :count]) @ levers[..., None])[..., 0]
        # bodies of the scene; those without a joint rest. Body frames of scene and model may differ, so that
        # rotations since the start are applied
        names, state = scene.mechanism.body_names, initial_state(scene)
        position = np.repeat(state.position[None], len(poses), axis=0)
        quaternion = np.repeat(state.quaternion[None], len(poses), axis=0)
        for k, name in enumerate(reference.names):
            body = names.index(name)
            position[:, body] = centers[:, k]
            from_start = _products(quaternions[:, k], conjugate(quaternions[:1, k]))
            quaternion[:, body] = _products(from_start, state.quaternion[None, body])
        kinetic, potential = np.array(self._energies).T
        trajectory = Trajectory(
            ENGINE,
            vars(settings),
            thread_time,
            np.array(self._times),
            names,
            scene.mechanism.joint_names,
            position,
            continuous(quaternion, quaternion[0]),
            kinetic_energy=kinetic,
            potential_energy=potential,
            mechanism=scene.mechanism,
        )
        openings, angles = np.zeros((2, len(poses), len(reference.closures)))
        for k, closure in enumerate(reference.closures):
            first, second = count + 2 * k, count + 2 * k + 1
            openings[:, k] = np.linalg.norm(translations[:, first] - translations[:, second], axis=1)
            angles[:, k] = _angular_errors(closure.kind, quaternions[:, first], quaternions[:, second])
        names = tuple(closure.element for closure in reference.closures)
        have_angles = np.array([closure.kind in ("6d", REVOLUTE) for closure in reference.closures], bool)
        errors = LoopErrors(names, openings, angles, np.ones(len(names), bool), have_angles)
        return FileRun(trajectory, errors, events=(), stopped=stopped)


def _products(p: Array, q: Array) -> Array:
    """Return the products (n, 4) of quaternions (n, 4)."""
    return np.asarray(product(p.T, q.T)).T


def _angular_errors(kind: str, first: Array, second: Array) -> Array:
    """Return the angular errors (n,), rad, of a loop closure.

    Args:
        kind: type of the closure: "6d" for coinciding frames, `REVOLUTE` for a hinge about the x axes of both
            frames; other types have no angular errors.
        first, second: (n, 4) orientations of the two frames of the closure.
    """
    if kind == "6d":
        return angle_between(first, second)
    if kind == REVOLUTE:
        axes = rotations(first)[:, :, 0], rotations(second)[:, :, 0]  # x axes
        return np.asarray(np.arcsin(np.minimum(1.0, np.linalg.norm(np.cross(*axes), axis=1))))
    return np.zeros(len(first))
