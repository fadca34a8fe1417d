"""Range of a wind load's coefficients, compared with the motion of the plate in a run.

The coefficients of `newton_euler.WindLoad` hold for plates with an aspect ratio (span / chord) in a range, in
free flow. The chord is the plate's extent along the wind, the span the extent across it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from newton_euler.model.euler_parameters import rotations
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array, Floats

LEAST_RATIO, MOST_RATIO = 1.0 / 6.0, 6.0
"""Range of span / chord of the coefficients' source, see `newton_euler.WindLoad`."""

MIN_CLEARANCE = 0.5
"""Distance from the ground, in chords, below which the flow is not free: a choice of this program."""

CORNERS = 0.5 * np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]])
"""Corners of a plate, in its lengths, from its center."""


class WindRange(NamedTuple):
    """Ranges of the flow on a plate over a run.

    Attributes:
        load: name of the wind load.
        body: body of the plate.
        minimum_attack, maximum_attack: angles of attack, degrees.
        minimum_ratio, maximum_ratio: span / chord.
        clearance: least height of the plate's lowest corner above the world's origin, in chords; None without
            gravity, which gives the vertical.
    """

    load: str
    body: str
    minimum_attack: float
    maximum_attack: float
    minimum_ratio: float
    maximum_ratio: float
    clearance: float | None

    @property
    def line(self) -> str:
        """The ranges in one sentence."""
        angles = _range_text(self.minimum_attack, self.maximum_attack)
        ratios = _range_text(self.minimum_ratio, self.maximum_ratio)
        return f"wind {self.load!r} meets {self.body!r} at {angles} degrees; span / chord is {ratios}"

    @property
    def warning(self) -> str:
        """Values outside of the validity of the coefficients, in one sentence; empty if there are none."""
        problems = []
        if self.minimum_ratio < LEAST_RATIO or self.maximum_ratio > MOST_RATIO:
            ratios = _range_text(self.minimum_ratio, self.maximum_ratio)
            problems.append(f"span / chord is {ratios}, its coefficients are for 1/6 to {MOST_RATIO:g}")
        if self.clearance is not None and self.clearance < MIN_CLEARANCE:
            where = f"{self.clearance:.2g} chords above the height 0"
            problems.append(f"the plate comes to {where}, its coefficients are for free flow")
        return f"wind {self.load!r} is not reliable: {'; '.join(problems)}" if problems else ""


def _range_text(least: float, most: float) -> str:
    """Format a range with 3 digits, or one number if both ends are equal in these digits."""
    low, high = f"{least:.3g}", f"{most:.3g}"
    return low if low == high else f"{low} to {high}"


def wind_ranges(scene: Scene, run: Trajectory) -> list[WindRange]:
    """Return the ranges of all wind loads over the outputs of a run; loads without wind are left out."""
    loads = [force for force in scene.forces if isinstance(force, WindLoad)]
    found = (_wind_range(scene, run, load) for load in loads)
    return [each for each in found if each is not None]


def _wind_range(scene: Scene, run: Trajectory, load: WindLoad) -> WindRange | None:
    """Return the ranges of one wind load; None if there is no wind at any output."""
    assert run.linear_velocity is not None
    assert run.angular_velocity is not None
    mechanism = scene.mechanism
    k = mechanism.body_index(load.body)
    pose = mechanism.bodies[k].pose
    # Axes of the plate (n, 3, 3), and relative wind (n, 3) along them
    axes = rotations(run.quaternion[:, k]) @ (pose.rotation.T @ load.axes)
    arms = rotations(run.quaternion[:, k]) @ pose.point_to_body(load.point)
    plate = run.linear_velocity[:, k] + np.cross(run.angular_velocity[:, k], arms)
    winds = np.array([load.velocity(float(time)) for time in run.time])
    relative = np.einsum("nij,ni->nj", axes, winds - plate)
    along, blows = np.hypot(relative[:, 0], relative[:, 1]), np.linalg.norm(winds, axis=1) > 0.0
    if not blows.any():
        return None
    attack = np.degrees(np.arctan2(np.abs(relative[:, 2]), along))[blows]
    chord = _extent(load, relative[:, :2], along)[blows]
    ratio = _extent(load, relative[:, 1::-1], along)[blows] / chord
    clearance = None
    if np.any(scene.gravity):
        up = -scene.gravity / np.linalg.norm(scene.gravity)
        offsets = (CORNERS[:, :2] * load.lengths) @ np.swapaxes(axes[:, :, :2], 1, 2)  # (n, 4, 3)
        corners = run.position[:, k, None] + arms[:, None] + offsets
        clearance = float(np.min((corners @ up).min(axis=1)[blows] / chord))
    angles, ratios = (float(attack.min()), float(attack.max())), (float(ratio.min()), float(ratio.max()))
    return WindRange(load.name, load.body, *angles, *ratios, clearance)


def _extent(load: WindLoad, components: Array, along: Floats) -> Floats:
    """Return the extent (n,) of a plate, m, along directions given by components (n, 2) along its sides."""
    cosines = np.where(along[:, None] > 0.0, components / np.maximum(along, 1e-300)[:, None], np.sqrt(0.5))
    return np.asarray(np.linalg.norm(cosines * load.lengths, axis=1))
