"""A recording of a scene that moved: its run beside that of the baseline."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from crosscheck.regress.baseline import Baseline
from crosscheck.regress.measure import MAIN, main_run, regress_scene
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory


def write(path: Path, scene: Scene, baseline: Baseline, diverges: float | None, verdict: str) -> bool:
    """Write an .rrd that opens where poses part from the baseline's; at the start where they do not.

    Args:
        scene: as loaded.
        diverges: s.
        verdict: Markdown.

    Returns:
        Whether there is one; none is of a scene that does not run any more, or is of other bodies.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.log import write_recording

    scene = regress_scene(scene)
    stored = stored_run(scene, baseline)
    if stored is None:
        return False
    try:
        runs = {"newton_euler": main_run(scene, baseline.plan.rtol[MAIN]), "baseline": stored}
    except NewtonEulerError:
        return False
    write_recording(path, scene, runs, verdict, f"{scene.name} against its baseline", diverges)
    return True


def stored_run(scene: Scene, baseline: Baseline) -> Trajectory | None:
    """The run that the baseline holds; None if its bodies or times are not the scene's."""
    position = baseline.figure(MAIN, "position over time")
    quaternion = baseline.figure(MAIN, "quaternion over time")
    count, bodies = len(scene.times), len(scene.mechanism.bodies) - 1
    if position is None or quaternion is None or position.array.shape != (count, 3 * bodies):
        return None
    ground = scene.mechanism.bodies[0]

    def with_ground(own: tuple[float, ...], others: np.ndarray) -> np.ndarray:
        first = np.tile(own, (count, 1, 1))
        return np.concatenate([first, others.reshape(count, bodies, len(own))], axis=1)

    return Trajectory(
        engine="baseline",
        settings={},
        wall_time=0.0,
        time=scene.times,
        body_names=scene.mechanism.body_names,
        joint_names=scene.mechanism.joint_names,
        position=with_ground(tuple(ground.center_of_mass), position.array),
        quaternion=with_ground(tuple(ground.quaternion), quaternion.array),
    )
