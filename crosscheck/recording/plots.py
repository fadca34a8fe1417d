"""Plots of a recording over time: one `Plot` per quantity, one line per engine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from crosscheck.compare.check import OPEN, POSES
from crosscheck.compare.runs import orientations_apart, positions_apart
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

SMALLEST = 1e-18
"""Smallest plotted difference, since the axis is logarithmic."""

FLAT = 1e-5
"""Share of what is large in its unit that the lines of a plot cover at least."""

MOST_COORDINATES = 5
"""Joint coordinates that are plotted."""

Tolerances = Mapping[tuple[str, ...], float]
"""Tolerances by quantity and the names of one or two engines."""


@dataclass(frozen=True, eq=False)
class Plot:
    """One quantity over time.

    Attributes:
        group: plots of one group are shown side by side, groups as tabs.
        path: where its lines are logged, below `/plots`; the engine's name is added.
        title: the quantity and its unit.
        lines: (n,) values by engine.
        large: what is large in its unit; lines that cover much less are flat.
        target: what a control law aims at.
        tolerances: by engine, in the unit of the plot.
        judges: whether engines are judged by it; else those that agree draw one line over the other.
    """

    group: str
    path: tuple[str, ...]
    title: str
    lines: dict[str, Array]
    large: float = 0.0
    target: float | TimeFunction | None = None
    tolerances: dict[str, float] = field(default_factory=dict)
    judges: bool = False

    @property
    def is_flat(self) -> bool:
        """True if its lines neither move nor part."""
        covered = np.ptp(np.concatenate(list(self.lines.values())))
        return not self.judges and bool(covered <= FLAT * self.large)


def plots(scene: Scene, trajectories: dict[str, Trajectory], tolerances: Tolerances) -> list[Plot]:
    """All plots of a run; what the scene did not ask for and what is flat is left out."""
    if not trajectories:  # of engines or models none of which came anywhere
        return []
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


def platforms(mechanism: Mechanism) -> list[int]:
    """Numbers of the bodies on at least three joints; the tilt of the last is plotted."""
    return [k for k in range(1, len(mechanism.bodies)) if len(mechanism.joints_at[k]) >= 3]


def tilt(quaternion: Array) -> Array:
    """(n,) degrees between the body's zeta axis and the world's z axis, for quaternions (n, 4)."""
    x, y, z = rotated(quaternion, np.array([0.0, 0.0, 1.0])).T
    return np.asarray(np.degrees(np.arctan2(np.hypot(x, y), z)))


def _coordinates(scene: Scene) -> list[Key]:
    """Joint coordinates that laws or springs act on; else of actuated joints; else of those on the ground."""
    joints, ground = scene.mechanism.joints, scene.mechanism.body_names[0]
    acting = (*scene.control, *(force for force in scene.forces if isinstance(force, JointSpring)))
    chosen = [joint for joint in joints if joint.actuated] or [
        joint for joint in joints if ground in (joint.first, joint.second)
    ]
    found = [(joint.name, k) for joint in chosen for k in range(len(joint.coordinate_kinds))]
    return list(dict.fromkeys((each.joint, each.coordinate) for each in acting)) or found


def _motion_plots(scene: Scene, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    """Joint coordinates with their targets, and the tilt of a platform."""
    mechanism = scene.mechanism
    declared = [law.law if isinstance(law, Digital) else law for law in scene.control]
    targets = {law.key: law.target for law in declared if isinstance(law, DeclaredLaw)}
    for key in _coordinates(scene)[:MOST_COORDINATES]:
        name, slides = coordinate_name(mechanism.joint(key[0]), key[1]), mechanism.is_slide(*key)
        moved = {e: replace(run, mechanism=mechanism).joint(key[0]) for e, run in trajectories.items()}
        lines = {engine: motion.coordinates[:, key[1]] for engine, motion in moved.items()}
        title, large = (f"{name} [m]", mechanism.size) if slides else (f"{name} [rad]", 1.0)
        yield Plot("Motion", ("coordinate", name), title, lines, large, targets.get(key))
    for body in platforms(mechanism)[-1:]:
        name = mechanism.body_names[body]
        lines = {engine: tilt(run.quaternion[:, body]) for engine, run in trajectories.items()}
        yield Plot("Motion", ("tilt", name), f"tilt of {name} [deg]", lines, 90.0)


def _control_plots(scene: Scene, trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    forces = _present(trajectories, "actuator_force")
    for k, law in enumerate(scene.control):
        name = coordinate_name(scene.mechanism.joint(law.joint), law.coordinate)
        unit = "N" if scene.mechanism.is_slide(law.joint, law.coordinate) else "N m"
        lines = {engine: force[:, k] for engine, force in forces.items()}
        yield Plot("Control", ("control", name), f"{name} [{unit}]", lines, _largest(forces))


def _energy_plots(trajectories: dict[str, Trajectory]) -> Iterator[Plot]:
    found = {kind: _present(trajectories, f"{kind}_energy") for kind in ("kinetic", "potential")}
    large = max(map(_largest, found.values()))
    for kind, lines in found.items():
        yield Plot("Energy", ("energy", kind), f"{kind} energy [J]", lines, large)


def _present(trajectories: dict[str, Trajectory], name: str) -> dict[str, Array]:
    """An array of those runs that have it."""
    values = {engine: getattr(run, name) for engine, run in trajectories.items()}
    return {engine: line for engine, line in values.items() if line is not None}


def _largest(lines: dict[str, Array]) -> float:
    return max((float(np.max(np.abs(line), initial=0.0)) for line in lines.values()), default=0.0)


def _agreement_plots(trajectories: dict[str, Trajectory], tolerances: Tolerances) -> Iterator[Plot]:
    """Each engine against the first, largest over the bodies; and how far joints drift apart."""
    (reference, first), *others = trajectories.items()
    group = f"log10 of differences from {reference}; thin lines: tolerances"
    for name, quantity, title, values in (
        ("position", POSES[0], "position [m]", {e: positions_apart(first, r) for e, r in others}),
        ("angle", POSES[1], "angle [rad]", {e: orientations_apart(first, r) for e, r in others}),
        ("drift", OPEN, "drift [m, rad]", _present(trajectories, "constraint_violation")),
    ):
        lines = {engine: np.log10(np.maximum(np.max(x, axis=1), SMALLEST)) for engine, x in values.items()}
        single = quantity == OPEN
        found = {e: tolerances.get((quantity, e) if single else (quantity, reference, e), 0.0) for e in lines}
        bounds = {engine: float(np.log10(bound)) for engine, bound in found.items() if bound > 0.0}
        yield Plot(group, ("agreement", name), title, lines, tolerances=bounds, judges=True)
