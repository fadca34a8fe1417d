"""Plots of a recording over time: one `Plot` per quantity, one line per engine."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from crosscheck.comparison.figure import OPEN, POSES
from crosscheck.comparison.runs import orientations_apart, positions_apart
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint import Joint, Motion
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

SMALLEST = 1e-18
"""Where logarithms are cut off, so that a difference of zero can be drawn."""

FLAT = 1e-5
"""Share of what is large in its unit that the lines of a plot cover at least."""

MOST_COORDINATES = 6
"""Joint coordinates that are plotted."""

MOST_BESIDE = 3
"""Joint coordinates, from which on the tilt has a tab of its own."""

Tolerances = Mapping[tuple[str, ...], float]
"""By quantity and the names of one or two engines."""


@dataclass(frozen=True, eq=False)
class Plot:
    """One quantity over time.

    Attributes:
        group: plots of one group are shown side by side, groups as tabs.
        path: where its lines are logged, below `/plots`; the engine's name is added.
        title: the quantity and its unit.
        lines: (n,) values by engine.
        large: what is large in its unit; lines that cover much less are flat.
        target: the value that a control law aims at.
        tolerances: by engine, in the unit of the plot.
        judges: whether engines are judged by it; else those that agree draw one line over the other.
    """

    group: str
    path: tuple[str, ...]
    title: str
    lines: dict[str, Array]
    large: float = 0.0
    target: float | None = None
    tolerances: dict[str, float] = field(default_factory=dict)
    judges: bool = False

    @property
    def is_flat(self) -> bool:
        """True if its lines neither move nor part."""
        covered = np.ptp(np.concatenate(list(self.lines.values())))
        return not self.judges and bool(covered <= FLAT * self.large)


def plots(scene: Scene, trajectories: dict[str, Trajectory], tolerances: Tolerances) -> list[Plot]:
    """All plots of a run; what the scene did not ask for and what is flat is left out."""
    candidates = (
        *_motion_plots(scene, trajectories),
        *_control_plots(scene, trajectories),
        *_energy_plots(trajectories),
        *_agreement_plots(trajectories, tolerances),
    )
    return [plot for plot in candidates if plot.lines and not plot.is_flat]


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


def _coordinates(scene: Scene) -> list[tuple[Joint, int]]:
    """Joint coordinates that laws or springs act on; else of actuated joints; else of those on the ground."""
    mechanism = scene.mechanism
    acting = (*scene.control, *(force for force in scene.forces if isinstance(force, JointSpring)))
    ground = mechanism.body_names[0]
    joints = [joint for joint in mechanism.joints if joint.actuated] or [
        joint for joint in mechanism.joints if ground in (joint.first, joint.second)
    ]
    found = dict.fromkeys((each.joint, each.coordinate) for each in acting)
    return [(mechanism.joint(name), k) for name, k in found] or [
        (joint, k) for joint in joints for k in range(len(_axes(joint)))
    ]


def _motion_plots(scene: Scene, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    """Joint coordinates with their targets, and the tilt of the last of the bodies with most joints."""
    mechanism = scene.mechanism
    targets = {(law.joint, law.coordinate): law.target for law in scene.control if isinstance(law, PD)}
    coordinates = _coordinates(scene)
    group = "Motion"
    if len(coordinates) > MOST_COORDINATES:
        group = f"Motion ({MOST_COORDINATES} of {len(coordinates)} joint coordinates)"
    for joint, k in coordinates[:MOST_COORDINATES]:
        name, motion = _axes(joint)[k]
        target = targets.get((joint.name, k))
        slides = motion.kind == "slide"
        measure = slide_position if slides else hinge_angle
        lines = {engine: measure(mechanism, joint, motion, run) for engine, run in trajectories.items()}
        if slides and target is not None:
            target += _reference_position(mechanism, joint, motion)
        path = ("slider_position" if slides else "joint_angle", name)
        title = f"{joint.second} along {name} [m]" if slides else f"angle of {name} [rad]"
        yield Plot(group, path, title, lines, mechanism.size if slides else 1.0, target)
    body = max(range(1, len(mechanism.bodies)), key=lambda k: (len(mechanism.joints_at[k]), k))
    name = mechanism.body_names[body]
    lines = {engine: tilt(run.quaternion[:, body]) for engine, run in trajectories.items()}
    if len(coordinates) >= MOST_BESIDE:
        group = "Tilt"
    yield Plot(group, ("tilt", name), f"tilt of {name} [deg]", lines, 90.0)


def _reference_position(mechanism: Mechanism, joint: Joint, motion: Motion) -> float:
    """The `slide_position`, m, at which the joint coordinate is zero."""
    first, second = mechanism.body(joint.first), mechanism.body(joint.second)
    start = 0.0 if joint.first == mechanism.body_names[0] else first.center_of_mass
    return float((second.center_of_mass - start) @ motion.axis)


def tilt(quaternion: Array) -> Array:
    """(n,) degrees between the body's zeta axis and the world's z axis, for quaternions (n, 4)."""
    x, y, z = rotated(quaternion, np.array([0.0, 0.0, 1.0])).T
    return np.asarray(np.degrees(np.arctan2(np.hypot(x, y), z)))


def _control_plots(scene: Scene, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    forces = _present(trajectories, lambda run: run.actuator_force)
    largest = _largest(forces.values())
    for k, law in enumerate(scene.control):
        joint = scene.mechanism.joint(law.joint)
        name, motion = _axes(joint)[law.coordinate]
        quantity = "force [N]" if motion.kind == "slide" else "torque [N m]"
        lines = {engine: force[:, k] for engine, force in forces.items()}
        yield Plot("Control", ("control", name), f"{name} {quantity}", lines, largest)


def _energy_plots(trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    kinetic = _present(trajectories, lambda run: run.kinetic_energy)
    potential = _present(trajectories, lambda run: run.potential_energy)
    largest = _largest([*kinetic.values(), *potential.values()])
    yield Plot("Energy", ("energy", "kinetic"), "kinetic energy [J]", kinetic, largest)
    yield Plot("Energy", ("energy", "potential"), "potential energy [J]", potential, largest)


def _largest(values: Iterable[Array]) -> float:
    return max((float(np.max(np.abs(each), initial=0.0)) for each in values), default=0.0)


def _agreement_plots(trajectories: dict[str, Trajectory], tolerances: Tolerances) -> Iterator[Plot]:
    """Each engine against the first, largest over the bodies; and how far joints drift apart."""
    if not trajectories:  # of engines or models none of which came anywhere
        return
    (reference, first), *others = trajectories.items()
    group = f"Agreement with {reference}; thin lines: tolerances"
    names = ("position", "angle")
    for name, quantity, apart in zip(names, POSES, (positions_apart, orientations_apart), strict=True):
        lines = {engine: _log10(np.max(apart(first, run), axis=1)) for engine, run in others}
        title = f"{name} difference [log10 {quantity.rpartition(', ')[2]}]"
        yield Plot(
            group,
            ("difference", name),
            title,
            lines,
            tolerances=_of_engines(tolerances, quantity, {engine: (reference, engine) for engine in lines}),
            judges=True,
        )
    drift = _present(
        trajectories,
        lambda run: None if run.constraint_violation is None else np.max(run.constraint_violation, axis=1),
    )
    yield Plot(
        group,
        ("drift",),
        "joint drift [log10 m, rad]",
        {engine: _log10(line) for engine, line in drift.items()},
        tolerances=_of_engines(tolerances, OPEN, {engine: (engine,) for engine in drift}),
        judges=True,
    )


def _of_engines(
    tolerances: Tolerances, quantity: str, between: Mapping[str, tuple[str, ...]]
) -> dict[str, float]:
    """log10 of those tolerances of a quantity that there are."""
    found = {engine: tolerances.get((quantity, *names), 0.0) for engine, names in between.items()}
    return {engine: float(np.log10(value)) for engine, value in found.items() if value > 0.0}
