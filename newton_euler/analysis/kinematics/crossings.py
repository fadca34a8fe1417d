"""Singular configurations on the path of a mechanism: where its coordinates stop determining its pose.

A mechanism with closed loops can often be assembled in several ways for the same joint coordinates. Where two
such assembly branches meet, the coordinates do not determine the motion: the determinant of the loop
equations and the coordinates is zero (singular configuration of the second kind, C. Gosselin, J. Angeles,
IEEE Transactions on Robotics and Automation 6(3), 1990). The determinant has the same sign at all poses that
can be reached from each other without passing such a configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from newton_euler.analysis.kinematics.configurations import Chain, Configurations
from newton_euler.analysis.kinematics.continuation import reachable
from newton_euler.analysis.kinematics.freedoms import Freedom, chosen_freedoms
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

if TYPE_CHECKING:  # `States` are made of poses
    from newton_euler.analysis.loads.states import States


@dataclass(frozen=True)
class Passage:
    """Singular configurations that a path of poses passes.

    Attributes:
        coordinates: names of the independent coordinates, which do not determine the pose at a singular
            configuration; empty for a mechanism without loops, which has none.
        rows: indices of the states right after a singular configuration of these coordinates.

    Examples:
        >>> Passage(("slide_12", "slide_13"), rows=(14,)).beyond
        True
    """

    coordinates: tuple[str | Key, ...]
    rows: tuple[int, ...]

    @property
    def beyond(self) -> bool:
        """True if the end of the path lies beyond a singular configuration, as seen from its begin."""
        return len(self.rows) % 2 == 1


def passage(scene: Scene, path: Sequence[State], coordinates: Sequence[str | Key] | None = None) -> Passage:
    """Find the singular configurations between successive states of a path.

    A singular configuration is passed where the determinant of loop equations and coordinates changes its
    sign. Two that lie between the same two states are not seen.

    Args:
        scene: gives the mechanism.
        path: one or more states with closed loops, each near the one before.
        coordinates: joint coordinates, as many as degrees of freedom. If None, independent ones at the first
            state, those of control laws first.
    """
    freedoms = chosen_freedoms(scene, path[0], coordinates)
    keys = [freedom.key for freedom in freedoms if freedom.key is not None]
    chain = Chain(scene.without_forces(), keys, 0, None, has_axis_goal=False, state=initial_state(scene))
    if not len(chain.independent):
        return Passage((), ())
    configs = chain.at(np.array([chain.system.coordinates(state)[0] for state in path]))
    signs = _signs(configs, freedoms)
    numbers = np.flatnonzero(signs)  # without states that are singular configurations themselves
    changes = np.flatnonzero(signs[numbers[1:]] != signs[numbers[:-1]])
    return Passage(tuple(freedom.name for freedom in freedoms), tuple(numbers[changes + 1].tolist()))


def beyond_start(scene: Scene, states: States) -> Array:
    """Return True (n,) for states that lie beyond a singular configuration, as seen from the initial state.

    The mechanism does not reach such a state from its initial state without passing a configuration in which
    its independent joint coordinates, those of control laws first, do not determine the motion.

    Args:
        scene: gives the mechanism, the control laws and the initial state.
        states: n states with closed loops.
    """
    start = initial_state(scene)
    freedoms = chosen_freedoms(scene, start, names=None)
    keys = [freedom.key for freedom in freedoms if freedom.key is not None]
    chain = Chain(scene.without_forces(), keys, len(keys), None, has_axis_goal=False, state=start)
    if not len(chain.independent):
        return np.zeros(len(states), dtype=bool)
    q, _ = states.coordinates(chain.system, np.zeros(len(states)))
    begin, configs = chain.at(chain.start[None]), chain.at(q)
    if len(keys) == len(freedoms):
        return ~reachable(begin, configs)
    # motion along other coordinates, such as rotations of a ball, is not followed
    return np.asarray(_signs(configs, freedoms) * _signs(begin, freedoms) < 0.0)


def _signs(configs: Configurations, freedoms: Sequence[Freedom]) -> Array:
    """Compute the signs (n,) of the determinant of loop equations and independent coordinates."""
    chain = configs.chain
    # rows of the loops, of the joint coordinates, and of velocities of the tree that are no joint coordinates
    others = np.eye(chain.system.nv)[[freedom.v_index for freedom in freedoms if freedom.key is None]]
    rows = [configs.jacobian[:, chain.independent], configs.coordinate_jacobian]
    matrix = np.concatenate([*rows, np.tile(others, (len(configs), 1, 1))], axis=1)
    return np.asarray(np.sign(np.linalg.det(matrix)))
