"""Plots of a recording over time: one `Plot` per quantity, one line per engine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from crosscheck.comparison.runs import orientations_apart, positions_apart
from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.model.joint import Joint, Motion
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

SMALLEST = 1e-18
"""Where logarithms are cut off, so that a difference of zero can be drawn."""


@dataclass(frozen=True, eq=False)
class Plot:
    """One quantity over time.

    Attributes:
        row: 0 for joints, control and energy, 1 for the last body, 2 for what engines are judged by.
        group: plots of one group are shown side by side, the groups of one row as tabs.
        path: where its lines are logged, below `/plots`; the engine's name is added.
        title: the quantity and its unit.
        lines: (n,) values by engine.
        compares: whether a line is about two runs, and ends with the shorter.
    """

    row: int
    group: str
    path: tuple[str, ...]
    title: str
    lines: dict[str, Array]
    compares: bool = False

    @property
    def lines_coincide(self) -> bool:
        """True if engines that agree draw one line over the other."""
        return self.row < 2


def plots(scene: Scene, trajectories: dict[str, Trajectory]) -> list[Plot]:
    """All plots of a run; what the scene did not ask for is left out."""
    candidates = (
        *_joint_plots(scene.mechanism, trajectories),
        *_control_plots(scene, trajectories),
        *_energy_plots(trajectories),
        *_orientation_plots(scene.mechanism, trajectories),
        *_agreement_plots(trajectories),
    )
    return [plot for plot in candidates if plot.lines]


def rotated(quaternion: Array, vector: Array) -> Array:
    """Body-frame vectors (..., 3) in world components, for unit quaternions (..., 4)."""
    e0, e = quaternion[..., :1], quaternion[..., 1:]
    turned = 2.0 * np.cross(e, vector)
    return np.asarray(vector + e0 * turned + np.cross(e, turned))


def slide_position(mechanism: Mechanism, joint: Joint, motion: Motion, run: Trajectory) -> Array:
    """(n,) m: the second body's center of mass along the axis, which turns with the first body.

    It is measured from the first body's center of mass, or from the world's origin if the first
    body is the ground.
    """
    first, second = mechanism.body_index(joint.first), mechanism.body_index(joint.second)
    if first == 0:
        return np.asarray(run.position[:, second] @ motion.axis)
    axis = rotated(run.quaternion[:, first], mechanism.bodies[first].pose.vector_to_body(motion.axis))
    return np.sum(axis * (run.position[:, second] - run.position[:, first]), axis=1)


def hinge_angle(mechanism: Mechanism, joint: Joint, motion: Motion, run: Trajectory) -> Array:
    """(n,) rad, from the initial pose: the twist about the axis, continuous over whole turns."""
    first, second = mechanism.body_index(joint.first), mechanism.body_index(joint.second)
    back = product(mechanism.bodies[first].quaternion, conjugate(run.quaternion[:, first]).T)
    turn = product(run.quaternion[:, second].T, conjugate(mechanism.bodies[second].quaternion))
    relative = product(back, turn)
    relative = np.where(relative[0] < 0.0, -relative, relative)
    return np.unwrap(2.0 * np.arctan2(motion.axis @ relative[1:], relative[0]))


def _present(
    trajectories: dict[str, Trajectory], value: Callable[[Trajectory], Array | None]
) -> dict[str, Array]:
    values = {engine: value(run) for engine, run in trajectories.items()}
    return {engine: line for engine, line in values.items() if line is not None}


def _log10(values: Array) -> Array:
    return np.log10(np.maximum(values, SMALLEST))


def _axes(joint: Joint) -> list[tuple[str, Motion]]:
    """The joint's coordinates by name: the joint's own, numbered from 0 if it has several."""
    motions = [motion for motion in joint.motions if motion.kind != "ball"]
    if len(motions) == 1:
        return [(joint.name, motions[0])]
    return [(f"{joint.name}:{k}", motion) for k, motion in enumerate(motions)]


def _joint_plots(mechanism: Mechanism, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    """Coordinates of the actuated joints; of the joints on the ground if nothing is actuated."""
    ground = mechanism.body_names[0]
    joints = [joint for joint in mechanism.joints if joint.actuated] or [
        joint for joint in mechanism.joints if ground in (joint.first, joint.second)
    ]
    for joint in joints:
        for name, motion in _axes(joint):
            if motion.kind == "slide":
                lines = {
                    engine: slide_position(mechanism, joint, motion, run)
                    for engine, run in trajectories.items()
                }
                title = f"{joint.second} along {name} [m]"
                yield Plot(0, "Sliders", ("slider_position", name), title, lines)
            else:
                lines = {
                    engine: hinge_angle(mechanism, joint, motion, run) for engine, run in trajectories.items()
                }
                title = f"angle of {name} [rad]"
                yield Plot(0, "Joint angles", ("joint_angle", name), title, lines)


def _control_plots(scene: Scene, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    for k, law in enumerate(scene.control):
        joint = scene.mechanism.joint(law.joint)
        name, motion = _axes(joint)[law.coordinate]
        quantity = "force [N]" if motion.kind == "slide" else "torque [N m]"
        lines = _present(
            trajectories,
            lambda run, k=k: None if run.actuator_force is None else run.actuator_force[:, k],  # type: ignore[misc]
        )
        yield Plot(0, "Control", ("control", name), f"{name} {quantity}", lines)


def _energy_plots(trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    kinetic = _present(trajectories, lambda run: run.kinetic_energy)
    yield Plot(0, "Energy", ("energy", "kinetic"), "kinetic energy [J]", kinetic)
    potential = _present(trajectories, lambda run: run.potential_energy)
    yield Plot(0, "Energy", ("energy", "potential"), "potential energy [J]", potential)


def _orientation_plots(mechanism: Mechanism, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    """Orientation of the last body."""
    for k in range(4):
        lines = {engine: run.quaternion[:, -1, k] for engine, run in trajectories.items()}
        group = f"Euler parameters of {mechanism.body_names[-1]}"
        yield Plot(1, group, ("euler_parameters", f"e{k}"), f"e{k}", lines)


def _agreement_plots(trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    """Each engine against the first, largest over the bodies; and how far joints drift apart."""
    if not trajectories:  # of engines or models none of which came anywhere
        return
    (reference, first), *others = trajectories.items()
    distances, angles = {}, {}
    for engine, run in others:
        distances[engine] = np.max(positions_apart(first, run), axis=1)
        angles[engine] = np.max(orientations_apart(first, run), axis=1)
    drift = _present(
        trajectories,
        lambda run: None if run.constraint_violation is None else np.max(run.constraint_violation, axis=1),
    )
    differences = (("position", "m", distances), ("angle", "rad", angles))
    group = f"Agreement with {reference}"
    for quantity, unit, lines in differences:
        log_lines = {engine: _log10(line) for engine, line in lines.items()}
        title = f"log10 {quantity} difference [{unit}]"
        yield Plot(2, group, ("difference_log10", quantity), title, log_lines, True)
    log_drift = {engine: _log10(line) for engine, line in drift.items()}
    yield Plot(2, group, ("drift_log10",), "log10 joint drift [m, rad]", log_drift)
    group = f"Difference from {reference}"
    for quantity, unit, lines in differences:
        yield Plot(2, group, ("difference", quantity), f"{quantity} [{unit}]", lines, True)
