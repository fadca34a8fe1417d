"""Couplings and prescribed motions over the coordinates of a tree that keeps all the joints they couple.

The tree of a welded mechanism does: only balls, rods and welds are cut there, which have no coordinates.
"""

from __future__ import annotations

import numpy as np

from newton_euler.model.couplings import couplings, turns
from newton_euler.model.joints import Key
from newton_euler.model.scene import Scene
from newton_euler.model.tree import SpanningTree
from newton_euler.scalars import Array


class TreeCouplings:
    """The couplings of a scene, in order: jacobian @ v + phi_t = 0 with a constant Jacobian.

    Attributes:
        couplings: as of `newton_euler.model.couplings.couplings`.
        jacobian: (c, nv).
        units: (c,) what makes the equations dimensionless: the mechanism's size (m) for lengths, else 1.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        self.couplings = couplings(scene)
        self._angles: set[Key] = set()
        self._on_q: dict[Key, int] = {}
        self.jacobian = np.zeros((len(self.couplings), tree.nv))
        for row, coupling in zip(self.jacobian, self.couplings, strict=True):
            for key, factor in coupling.factors.items():
                place = tree.place(*key)
                assert place is not None
                self._on_q[key], on_v = place
                row[on_v] = factor
                joint = scene.mechanism.joints[scene.mechanism.joint_index(key[0])]
                if joint.coordinate_kinds[key[1]] == "hinge":
                    self._angles.add(key)
        size = scene.mechanism.size
        self.units = np.array([size if coupling.is_length else 1.0 for coupling in self.couplings])

    def phi(self, q: Array, time: float) -> Array:
        """Residuals (c,), m or rad."""
        x = {key: q[place] for key, place in self._on_q.items()}
        return np.array([coupling.combine(x) for coupling in self.couplings]) - self.value(time)

    def value(self, time: float) -> Array:
        """(c,) what the combinations of coordinates are to be, m or rad."""
        return np.array([c.function.value(time) if c.function else 0.0 for c in self.couplings])

    def rate(self, time: float) -> Array:
        """(c,) its first derivative."""
        return np.array([c.function.rate(time) if c.function else 0.0 for c in self.couplings])

    def acceleration(self, time: float) -> Array:
        """(c,) its second derivative."""
        return np.array([c.function.acceleration(time) if c.function else 0.0 for c in self.couplings])

    def turned(self, q: Array, time: float) -> Array:
        """Coordinates that poses gave, with angles in the turn that the couplings ask for."""
        x = {key: float(q[place]) for key, place in self._on_q.items()}
        q = q.copy()
        for key, turn in turns(self.couplings, x, self._angles, time).items():
            q[self._on_q[key]] += turn
        return q
