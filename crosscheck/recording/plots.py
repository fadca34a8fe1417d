"""Choose the plots of a recording: one `Plot` per quantity over time, with one line per engine.

Engines are simulators that ran the same scene (a mechanism with its forces and controllers). A recording
shows their runs in the Rerun viewer.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from crosscheck.compare.check import CONSTRAINT_VIOLATION, POSES
from crosscheck.compare.run_differences import orientations_apart, positions_apart
from newton_euler.model.control import DeclaredLaw
from newton_euler.model.digital_control import Digital
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import coordinate_name
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

MIN_LOG_DIFFERENCE = 1e-18
"""Smallest difference, m or rad, in plots of logarithms; smaller ones, also zero, are replaced by it."""

MIN_VARIATION = 1e-5
"""Smallest variation of a quantity that is plotted, in multiples of `Plot.scale`."""

MAX_COORDINATES = 5
"""Largest number of joint coordinates that are plotted."""

Tolerances = Mapping[tuple[str, ...], float]
"""Tolerances by the name of a quantity and the names of one or two engines."""


@dataclass(frozen=True, eq=False)
class Plot:
    """One quantity over time.

    Attributes:
        group: name of the group; the viewer shows a group as a tab, and its plots side by side.
        path: parts of the path of the lines in the recording, below `/plots`; the engine's name is added.
        title: the quantity and its unit.
        lines: values (n,) over the output times, by engine.
        scale: a large value of the quantity, in its unit; a plot whose lines vary much less is left out.
        target: set-point of a control law, a constant or a function of time; None without one.
        tolerances: tolerance of each engine, in the unit of the plot: its logarithm in a plot of logarithms.
        is_judged: True for a difference or a constraint violation, by which engines are judged; False for a
            quantity of the motion, of which the lines of several engines coincide if they agree.
    """

    group: str
    path: tuple[str, ...]
    title: str
    lines: dict[str, Array]
    scale: float = 0.0
    target: float | TimeFunction | None = None
    tolerances: dict[str, float] = field(default_factory=dict)
    is_judged: bool = False

    @property
    def is_flat(self) -> bool:
        """True if the lines are constant and equal, so that the plot would show nothing; never if judged."""
        variation = np.ptp(np.concatenate(list(self.lines.values())))
        return not self.is_judged and bool(variation <= MIN_VARIATION * self.scale)


def plots(scene: Scene, trajectories: dict[str, Trajectory], tolerances: Tolerances) -> list[Plot]:
    """Make the plots of the engines' runs; quantities that were not stored or do not vary are left out.

    Args:
        scene: the scene that was run.
        trajectories: run of each engine, by name; the other engines are compared with the first.
        tolerances: tolerances of the differences and of the constraint violations.
    """
    if not trajectories:  # every engine stopped before its first output
        return []
    candidates = (
        *_motion_plots(scene, trajectories),
        *_control_plots(scene, trajectories),
        *_energy_plots(trajectories),
        *_agreement_plots(trajectories, tolerances),
    )
    return [plot for plot in candidates if plot.lines and not plot.is_flat]


def rotated(quaternion: Array, vector: Array) -> Array:
    """Rotate vectors (..., 3) from the body frame to the world frame, by unit quaternions (..., 4).

    With the quaternion (e0, e), the rotated vector is v + e0 t + e x t with t = 2 e x v.
    """
    e0, e = quaternion[..., :1], quaternion[..., 1:]
    turned = 2.0 * np.cross(e, vector)
    return np.asarray(vector + e0 * turned + np.cross(e, turned))


def platforms(mechanism: Mechanism) -> list[int]:
    """Return the numbers of platforms: bodies with three or more joints. The tilt of the last is plotted."""
    return [k for k in range(1, len(mechanism.bodies)) if len(mechanism.joints_at[k]) >= 3]


def tilt(quaternion: Array) -> Array:
    """Compute the angles (n,), degrees, between the z axis of a body's frame and the world's z axis.

    Args:
        quaternion: orientations of the body (n, 4), (w, x, y, z).
    """
    x, y, z = rotated(quaternion, np.array([0.0, 0.0, 1.0])).T
    return np.asarray(np.degrees(np.arctan2(np.hypot(x, y), z)))


def _coordinates(scene: Scene) -> list[Key]:
    """Choose the joint coordinates to plot: (joint, number) pairs.

    These are the coordinates that control laws or springs act on. If there are none, the coordinates of
    actuated joints (joints that control laws may drive) are plotted. Without actuated joints, the coordinates
    of joints at the ground are plotted.
    """
    joints, ground = scene.mechanism.joints, scene.mechanism.body_names[0]
    acting = (*scene.control, *(force for force in scene.forces if isinstance(force, JointSpring)))
    if acting:
        return list(dict.fromkeys((each.joint, each.coordinate) for each in acting))
    chosen = [joint for joint in joints if joint.actuated] or [
        joint for joint in joints if ground in (joint.first, joint.second)
    ]
    return [(joint.name, k) for joint in chosen for k in range(len(joint.coordinate_kinds))]


def _motion_plots(scene: Scene, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    """Plot joint coordinates with their set-points, and the tilt of a platform."""
    mechanism = scene.mechanism
    # set-points by joint coordinate, also of laws that a digital controller evaluates at its samples;
    # controllers that are Python functions have none
    continuous = [law.law if isinstance(law, Digital) else law for law in scene.control]
    targets = {law.key: law.target for law in continuous if isinstance(law, DeclaredLaw)}
    for joint, number in _coordinates(scene)[:MAX_COORDINATES]:
        name = coordinate_name(mechanism.joint(joint), number)
        lines = {  # `Trajectory.joint` needs a mechanism, which a run made from arrays lacks
            engine: replace(run, mechanism=mechanism).joint(joint).coordinates[:, number]
            for engine, run in trajectories.items()
        }
        unit, scale = ("m", mechanism.size) if mechanism.is_slide(joint, number) else ("rad", 1.0)
        target = targets.get((joint, number))
        yield Plot("Motion", ("coordinate", name), f"{name} [{unit}]", lines, scale, target)
    for body in platforms(mechanism)[-1:]:
        name = mechanism.body_names[body]
        lines = {engine: tilt(run.quaternion[:, body]) for engine, run in trajectories.items()}
        yield Plot("Motion", ("tilt", name), f"tilt of {name} [deg]", lines, scale=90.0)


def _control_plots(scene: Scene, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    """Plot the actuator force or torque of each control law."""
    forces = _stored_arrays(trajectories, "actuator_force")
    for k, law in enumerate(scene.control):
        name = coordinate_name(scene.mechanism.joint(law.joint), law.coordinate)
        unit = "N" if scene.mechanism.is_slide(law.joint, law.coordinate) else "N m"
        lines = {engine: force[:, k] for engine, force in forces.items()}
        yield Plot("Control", ("control", name), f"{name} [{unit}]", lines, scale=_max_abs(forces))


def _energy_plots(trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    """Plot the kinetic and the potential energy."""
    energies = {kind: _stored_arrays(trajectories, f"{kind}_energy") for kind in ("kinetic", "potential")}
    scale = max(map(_max_abs, energies.values()))
    for kind, lines in energies.items():
        yield Plot("Energy", ("energy", kind), f"{kind} energy [J]", lines, scale)


def _stored_arrays(trajectories: dict[str, Trajectory], name: str) -> dict[str, Array]:
    """Return an array of `Trajectory`, given by its name, of the runs that have the array; by engine."""
    arrays = {engine: getattr(run, name) for engine, run in trajectories.items()}
    return {engine: array for engine, array in arrays.items() if array is not None}


def _max_abs(arrays: dict[str, Array]) -> float:
    """Return the largest absolute value of the arrays of all engines; 0 if there are none."""
    return max((float(np.max(np.abs(array), initial=0.0)) for array in arrays.values()), default=0.0)


def _agreement_plots(trajectories: dict[str, Trajectory], tolerances: Tolerances) -> Iterator[Plot]:
    """Plot the logarithms of differences from the first engine, and of constraint violations (drift).

    Differences of positions and orientations are the largest over the bodies, violations the largest over the
    joints. Tolerances are lines in the same plots.
    """
    (first_engine, first), *others = trajectories.items()
    group = f"log10 of differences from {first_engine}; thin lines: tolerances"
    positions, orientations = POSES  # names of the quantities in checks
    violations = _stored_arrays(trajectories, "constraint_violation")
    for name, quantity, title, differences in (
        ("position", positions, "position [m]", {e: positions_apart(first, run) for e, run in others}),
        ("angle", orientations, "angle [rad]", {e: orientations_apart(first, run) for e, run in others}),
        ("drift", CONSTRAINT_VIOLATION, "drift [m, rad]", violations),
    ):
        lines, logarithms_of_tolerances = {}, {}
        for engine, values in differences.items():
            lines[engine] = np.log10(np.maximum(np.max(values, axis=1), MIN_LOG_DIFFERENCE))
            # the violation is of one engine, differences are between two
            key = (quantity, engine) if name == "drift" else (quantity, first_engine, engine)
            tolerance = tolerances.get(key, 0.0)
            if tolerance > 0.0:
                logarithms_of_tolerances[engine] = float(np.log10(tolerance))
        yield Plot(
            group,
            ("agreement", name),
            title,
            lines,
            tolerances=logarithms_of_tolerances,
            is_judged=True,
        )
