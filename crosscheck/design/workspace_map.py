"""Map of a workspace: reachable poses, singular poses, clearances, and positions of a point."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from functools import cached_property

import numpy as np

from crosscheck.support.errors import CrosscheckError
from mjcf.clearance import clearances, pairs_within
from newton_euler import Axis, Point, Poses, Scene, Workspace, initial_state, singular_poses, workspace
from newton_euler.model.joint import Key
from newton_euler.scalars import Array

MAX_POINTS = 1_000_000
"""Largest number of points of the grid."""

SINGULAR_SEARCHES = 4000
"""Number of random configurations from which singular poses are searched."""

NEAR_SHIFT, NEAR_TURN = 0.15, 0.6
"""Displacement of bodies, in sizes of the mechanism, and rotation, rad, between a singular pose and a pose of
the grid next to it. Both grow with the root of the distance in coordinates."""

WORLD_AXES = ("x", "y", "z")
"""Names of the world axes."""


class WorkspaceMap:
    """Workspace of a scene.

    Attributes:
        scene: the scene.
        space: reachable poses over a grid of joint coordinates, in n points of the grid.
        singular: singular poses of all assembly branches.
        clearance: (n,) m, smallest distance between bodies at each reachable pose; negative if bodies
            collide, infinite if bodies have no shapes.
        left_out: pairs of bodies whose shapes overlap in the initial pose, by design; they are not examined.
        axis, point: the axis and the point of a body that are mapped, or None.
    """

    def __init__(
        self,
        scene: Scene,
        space: Workspace,
        singular: Poses,
        clearance: Array,
        axis: Axis | None = None,
        point: Point | None = None,
        left_out: Collection[frozenset[str]] = (),
    ) -> None:
        """Keep the results; see the attributes."""
        self.scene, self.space, self.singular, self.clearance = scene, space, singular, clearance
        self.left_out = left_out
        self.axis, self.point = axis, point

    def unit(self, name: str | Key) -> str:
        """Return the unit of a joint coordinate."""
        return "m" if self.scene.mechanism.is_slide(*self.scene.mechanism.coordinate(name)) else "rad"

    @property
    def labels(self) -> dict[str | Key, str]:
        """Texts of the varied coordinates: JOINT, or JOINT.K for coordinate K of a joint with several."""
        names = self.space.grid
        return {name: name if isinstance(name, str) else f"{name[0]}.{name[1]}" for name in names}

    def quantity(self, name: str | Key) -> str:
        """Return the text of a varied coordinate with its unit, such as "slide, m"."""
        return f"{self.labels[name]}, {self.unit(name)}"

    @property
    def has_shapes(self) -> bool:
        """True if clearances are known."""
        return bool(np.isfinite(self.clearance).any())

    @property
    def collides(self) -> Array:
        """(n,) True for reachable poses in which bodies collide."""
        return self.clearance <= 0.0

    @property
    def moves(self) -> Array | None:
        """Directions (r, 3) in which the point moves; None without a point."""
        return self.space.directions

    @property
    def move_names(self) -> tuple[str, ...]:
        """Names of the directions in which the point moves: world axes, or directions of an oblique plane."""
        moves = np.zeros((0, 3)) if self.moves is None else self.moves
        oblique = ("along",) if len(moves) == 1 else ("horizontal", "upward")
        is_axis = bool(np.all(np.max(moves, axis=1, initial=0.0) == 1.0))
        return tuple(
            WORLD_AXES[int(np.argmax(direction))] if is_axis else oblique[k]
            for k, direction in enumerate(moves)
        )

    @cached_property
    def place(self) -> Array:
        """Position (n, r) of the point at the reachable poses, m, along the directions of its motion."""
        if self.moves is None or self.space.position is None:
            return np.zeros((len(self.space.poses), 0))
        return np.asarray(self.space.position[self.space.reachable] @ self.moves.T)

    @property
    def conditioning(self) -> Array | None:
        """(n,) conditioning of the point; None without a point, and for one coordinate, where it is 1."""
        values = self.space.conditioning
        return None if values is None or len(self.space.grid) == 1 else values[self.space.reachable]

    @cached_property
    def singular_place(self) -> Array:
        """Position (k, r) of the point at singular poses on the grid next to reachable ones, m.

        These poses bound the branch. Singular poses of other branches may have the same coordinates, but
        other positions of bodies.
        """
        poses, singular = self.space.poses, self.singular
        if self.moves is None or self.point is None or not len(poses) or not len(singular):
            return np.zeros((0, len(self.move_names)))
        from scipy.spatial import cKDTree

        # the reachable poses within one cell of the grid
        cells = [float(values[1] - values[0]) for values in self.space.grid.values()]
        reached_at, singular_at = (
            np.stack([each.coordinates[name] for name in self.space.grid], axis=1) / cells
            for each in (poses, singular)
        )
        nearest = min(len(poses), 2 ** len(cells))
        distance, index = cKDTree(reached_at).query(singular_at, nearest, p=np.inf)
        distance, index = distance.reshape(-1, nearest), index.reshape(-1, nearest)
        # of these, one in which all bodies are near
        shift = np.abs(poses.position[index] - singular.position[:, None])
        turn = 2.0 * np.arccos(
            np.minimum(1.0, np.abs(np.sum(poses.quaternion[index] * singular.quaternion[:, None], axis=-1)))
        )
        near = np.max(shift, axis=(2, 3)) < NEAR_SHIFT * self.scene.mechanism.size
        near &= np.max(turn, axis=2) < NEAR_TURN
        chosen = np.any(near & (distance <= 1.0), axis=1)
        for name, values in self.space.grid.items():
            chosen &= (values[0] <= singular.coordinates[name]) & (singular.coordinates[name] <= values[-1])
        return np.asarray(singular.positions(self.point)[chosen] @ self.moves.T)


def measure(
    scene: Scene,
    grid: Mapping[str | Key, Array],
    axis: Axis | None,
    point: Point | None,
    progress: Callable[[str], None],
) -> WorkspaceMap:
    """Map the workspace of a scene.

    Args:
        scene: the scene.
        grid: values of each varied joint coordinate, m or rad.
        axis: axis fixed in a body, whose direction is computed; None for no axis. Its elevation is the angle
            above the world's xy plane, its azimuth the angle in this plane from x to y.
        point: point fixed in a body, whose position is computed; None for no point.
        progress: called with the name of each stage.

    Raises:
        CrosscheckError: for a grid with too many points.
    """
    if np.prod([float(len(values)) for values in grid.values()]) > MAX_POINTS:
        raise CrosscheckError(f"--vary asks for more than {MAX_POINTS} points; give fewer, LOW:HIGH:POINTS")
    progress("solving poses")
    space = workspace(scene, grid, axis, point=point)
    progress("searching singular configurations")
    singular = singular_poses(scene, list(grid), SINGULAR_SEARCHES)
    progress("measuring clearances")
    start, poses = initial_state(scene), space.poses
    left_out = pairs_within(scene.mechanism, start.position, start.quaternion)
    distances = clearances(scene.mechanism, poses.position, poses.quaternion, left_out)
    return WorkspaceMap(scene, space, singular, distances, axis, point, left_out)
