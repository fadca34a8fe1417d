"""Linear-quadratic regulators: feedback of all independent coordinates from the linear model of a scene.

A key (joint, k) names coordinate k of a joint, from 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from newton_euler.analysis.linear.linearization import linearize
from newton_euler.analysis.loads.statics import statics
from newton_euler.arguments import checked
from newton_euler.errors import MechanismError, OptionError, real_array
from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.joint import Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state, measured_coordinate
from newton_euler.scalars import Array


@checked
def lqr(
    scene: Scene,
    Q: Any,
    R: Any,
    state: State | None = None,
    coordinates: Sequence[str | Key] | None = None,
    actuators: Sequence[str | Key] | None = None,
    targets: Mapping[str | Key, float | TimeFunction] | None = None,
) -> tuple[StateFeedback, ...]:
    """Design control laws u = u_0 - K (x - r) that are optimal for small motions about a state at rest.

    x are independent coordinates, then their rates. u_0 are the forces that hold the mechanism at the state
    (`statics`). Let e and f be the deviations of x and u from their values at the state. K minimizes the
    integral of e^T Q e + f^T R f for the linear model de/dt = A e + B f about the state (`linearize`):
    K = R^-1 B^T P with the solution P of A^T P + P A - P B R^-1 B^T P + Q = 0.

    Args:
        scene: the mechanism with its forces; its control laws are left out.
        Q: (2 d, 2 d), weights of the coordinates and then of their rates, or (2 d,) for a diagonal, in the
            order of `linearize(scene).coordinates`.
        R: (m, m), weights of the forces, or (m,) for a diagonal, or one number for all.
        state: state, taken at rest; the scene's initial pose if None.
        coordinates: d independent joint coordinates, see `linearize`.
        actuators: joint coordinates that forces act on. If None, the coordinates of the scene's control laws,
            or of all actuated joints if the scene has none.
        targets: r of coordinates, m or rad from the initial pose, numbers or functions of time; the values at
            the state for others.

    Raises:
        MechanismError: naming the body that the actuators do not hold at rest; see also `linearize`.
        OptionError: for weights of another shape, and for weights without a stabilizing regulator.

    Examples:
        >>> scene = load("tracker_gravity")
        >>> laws = lqr(scene, Q=[1e4, 1e4, 1.0, 1.0], R=1.0)
        >>> [law.joint for law in laws]
        ['slide_12', 'slide_13']
    """
    from scipy.linalg import solve_continuous_are

    # the state at rest, and the forces u_0 of the actuators that hold it
    mechanism, actuator_keys = scene.mechanism, _actuated(scene, actuators)
    if not actuator_keys:
        raise OptionError("actuators", (), "one joint coordinate or more")
    start = initial_state(scene) if state is None else state
    zero = np.zeros_like(start.position)
    state = replace(start, linear_velocity=zero, angular_velocity=zero)
    names = [mechanism.coordinate_name(key) for key in actuator_keys]
    holding_forces = statics(scene, state, names).actuator_force
    # the linear model about the state, under control laws of these constant forces
    laws = [
        PD(joint, stiffness=0.0, damping=0.0, target=0.0, coordinate=k, feedforward=float(force))
        for (joint, k), force in zip(actuator_keys, holding_forces, strict=True)
    ]
    model = linearize(
        replace(scene, control=tuple(laws)), state, coordinates, inputs=actuator_keys, outputs=[]
    )
    keys = [_coordinate(scene, name) for name in model.coordinates]
    # gains from the Riccati equation
    q, r = _weights("Q", Q, 2 * len(keys)), _weights("R", R, len(actuator_keys))
    try:
        with np.errstate(all="ignore"):  # numbers are checked
            p = solve_continuous_are(model.A, model.B, q, r)
            gains = np.linalg.solve(r, model.B.T @ p)
        if not np.all(np.isfinite(gains)):
            raise ValueError("no finite gains")
    except (np.linalg.LinAlgError, ValueError) as error:
        needed = "positive weights of forces, and weights of all that does not come to rest by itself"
        where = f"the pair Q and R for scene {scene.name!r}"
        raise OptionError(where, (q.tolist(), r.tolist()), needed) from error
    # r of each coordinate: the target, or the value at the state
    given = {mechanism.coordinate(name): value for name, value in (targets or {}).items()}
    references = {key: given.get(key, measured_coordinate(scene, state, key)[0]) for key in keys}
    # control laws: one for each actuator, with gains (proportional, derivative) of all coordinates
    feedback = []
    proportional, derivative = np.split(gains, 2, axis=1)
    for (joint, k), force, k_p, k_d in zip(
        actuator_keys, holding_forces, proportional, derivative, strict=True
    ):
        law_gains: dict[str | Key, tuple[float, float]] = {
            key: (float(p_gain), float(d_gain)) for key, p_gain, d_gain in zip(keys, k_p, k_d, strict=True)
        }
        others: dict[str | Key, float | TimeFunction] = dict(references)
        # a driven coordinate outside x has no gain, so that its target has no effect
        target = others.pop((joint, k), 0.0)
        law = StateFeedback(joint, law_gains, target, coordinate=k, feedforward=float(force), targets=others)
        feedback.append(law)
    return tuple(feedback)


def _actuated(scene: Scene, actuators: Sequence[str | Key] | None) -> tuple[Key, ...]:
    """Return the joint coordinates that forces act on, see `actuators` of `lqr`."""
    mechanism = scene.mechanism
    if actuators is not None:
        return tuple(mechanism.coordinate(name) for name in actuators)
    actuated = (key for key in mechanism.coordinate_labels if mechanism.joint(key[0]).actuated)
    return tuple(law.key for law in scene.control) or tuple(actuated)


def _coordinate(scene: Scene, name: str | Key) -> Key:
    """Return the joint coordinate with a name; raises `MechanismError` for a rotation of a ball."""
    if isinstance(name, str) and name not in scene.mechanism.joint_names:
        needed = "joint coordinates alone, which laws can read"
        raise MechanismError(f"scene {scene.name!r}", f"moves along {name}, a rotation of a ball", needed)
    return scene.mechanism.coordinate(name)


def _weights(name: str, given: Any, count: int) -> Array:
    """Return a symmetric matrix (count, count) of weights; raises `OptionError`."""
    try:
        weights = real_array(given)
    except (TypeError, ValueError, OverflowError):
        weights = np.full(1, np.nan)
    if weights.ndim < 2 and weights.size in (1, count):
        weights = np.diag(np.broadcast_to(weights, count))
    if weights.shape != (count, count) or not np.all(np.isfinite(weights)) or np.any(weights != weights.T):
        needed = f"{count} weights, or a symmetric matrix of {count} rows"
        raise OptionError(name, given, needed)
    return weights
