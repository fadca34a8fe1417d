"""Dry friction that grows with the reaction force of its joint.

Such friction f_j = -s_j |R_j| depends on accelerations, because the reaction R_j does, and R_j depends on all
such frictions. At a given state the reactions are linear in the frictions f_k,

    R_j = R_j0 + sum_k R_jk f_k,

with the reactions R_j0 without them, and the responses R_jk to unit forces on the joint coordinates. Newton's
method solves the n equations for f_j. The slope s_j is the load coefficient of the friction times the
saturated speed, see `newton_euler.model.switched_forces.JointFriction`.

The equations have no solution if a sliding joint *jams*: friction adds more to the reaction of its joint than
the reaction adds to the friction (self-locking, the paradox of P. Painleve, Comptes Rendus 121, 1895, pp.
112-115). The residual f + s |R(f)| is convex in a single friction, so that Newton's method finds a solution
with a positive derivative if there is one. A friction without such a solution is NaN: integrators then reject
a step, and end the run if all shorter steps fail, too.

Numbers may be floats or generic scalars such as expressions of the code generator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction
from newton_euler.scalars import Array, Scalar, minimum, sqrt

FRICTION_STEPS = 8
"""Number of Newton steps for the frictions. The first guess has an error of some coefficients of friction
squared, and each step squares the relative error: 0.1 becomes 1e-16 in four steps. Near self-locking, where
the derivative of the residual is 0.01, eight steps reach 1e-10."""

SETTLED = 1e-6
"""Largest change of a friction in the last Newton step, relative to the friction. The error after this step
is about the square of the change."""

UNNOTICED_CHANGE = 1e-12
"""Change of a friction, N or N m, that is always accepted: rates near zero have frictions near zero."""

NO_EFFECT = 1e-300
"""Factor that makes a number vanish in a sum with 1, unless the number is NaN."""

NEAR_JAM = 1.01
"""Factor of load coefficients to find out whether a run has ended because a friction jams: the last state is
one just before."""

MIN_REACTION = 1e-9
"""Force, N, that is added to reactions in quadrature, so that their magnitude has a derivative at zero."""

HeldFriction = Mapping[str, Scalar]
"""Given frictions, N or N m, by identity of the element."""


def loaded_frictions(scene: Scene) -> list[JointFriction]:
    """Return the elements of a scene whose friction grows with the reaction of their joint."""
    return [each for each in scene.forces if isinstance(each, JointFriction) and each.is_loaded]


def solve_frictions(
    slopes: Mapping[str, Scalar], reactions: Callable[[HeldFriction], Sequence[Array]]
) -> dict[str, Scalar]:
    """Solve for the frictions of all elements, N or N m, by identity.

    Args:
        slopes: s_j by identity of the element: dimensionless for a slide, m about a hinge.
        reactions: computes the reaction forces (3,), N, of the elements' joints, in the order of `slopes`,
            for given frictions.

    Returns:
        The frictions; NaN for those that jam.
    """
    names, s = list(slopes), list(slopes.values())
    count = range(len(names))
    alone = reactions(dict.fromkeys(names, 0.0))
    responses = []
    for k in count:
        unit = {name: 1.0 if number == k else 0.0 for number, name in enumerate(names)}
        responses.append([loaded - free for loaded, free in zip(reactions(unit), alone, strict=True)])
    forces: list[Scalar] = [0.0 for _ in count]
    for _ in range(FRICTION_STEPS):
        residuals, rows, magnitudes = [], [], []
        for j in count:
            reaction = alone[j] + sum(responses[k][j] * forces[k] for k in count)
            magnitude = sqrt(reaction @ reaction + MIN_REACTION * MIN_REACTION)
            magnitudes.append(magnitude)
            residuals.append(forces[j] + s[j] * magnitude)
            slope = s[j] / magnitude
            rows.append([slope * (reaction @ responses[k][j]) + (1.0 if k == j else 0.0) for k in count])
        changes, pivots = _eliminated(rows, residuals)
        forces = [force - change for force, change in zip(forces, changes, strict=True)]
    for j in count:
        allowed, change = SETTLED * s[j] * magnitudes[j], changes[j]
        settled = allowed * allowed - change * change + UNNOTICED_CHANGE * UNNOTICED_CHANGE
        with np.errstate(invalid="ignore"):  # the root of a negative number is NaN
            forces[j] = forces[j] * (1.0 + NO_EFFECT * sqrt(minimum(settled, pivots[j])))
    return dict(zip(names, forces, strict=True))


def jam(scene: Scene, frictions: Callable[[float], HeldFriction], arguments: Sequence[Array | float]) -> str:
    """Describe the frictions that jam at a state at which a run has ended, and what to change; "" for none.

    Args:
        scene: the scene.
        frictions: computes the frictions at the state for load coefficients times a factor.
        arguments: coordinates, velocities and time of the state. A state that is not finite has no frictions.
    """
    elements = loaded_frictions(scene)
    if not elements or not all(np.all(np.isfinite(argument)) for argument in arguments):
        return ""
    found = frictions(NEAR_JAM)
    jammed = [element for element in elements if not np.isfinite(float(found[element.identity]))]
    if not jammed:
        return ""
    names = " and ".join(
        f"{each.element} (load_coefficient {float(each.load_coefficient):g})" for each in jammed
    )
    return (
        f"{names} jams: friction adds more to the reaction than the reaction adds to the friction, so that "
        "the joint cannot slide; use a smaller load_coefficient, or another geometry or direction of motion"
    )


def _eliminated(rows: list[list[Scalar]], right: list[Scalar]) -> tuple[list[Scalar], list[Scalar]]:
    """Solve linear equations by elimination without pivoting; the matrix is the identity plus small terms.

    Returns:
        The solution, and the pivots.
    """
    rows, right, count = [[*row] for row in rows], [*right], len(right)
    for k in range(count):
        for i in range(k + 1, count):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
            right[i] = right[i] - factor * right[k]
    solution: list[Scalar] = [0.0] * count
    for k in reversed(range(count)):
        known = sum((rows[k][i] * solution[i] for i in range(k + 1, count)), start=0.0)
        solution[k] = (right[k] - known) / rows[k][k]
    return solution, [rows[k][k] for k in range(count)]


class FrictionModel(Protocol):
    """Equations of motion of an engine, with frictions that are given."""

    scene: Scene
    time: Scalar
    held_friction: HeldFriction | None

    def evaluate(self, q: Array, v: Array) -> Any:
        """Compute an `Evaluation` of a state."""


class EngineFriction:
    """Frictions that grow with reactions, by the equations of another engine.

    Attributes:
        elements: the elements of the scene whose friction grows with reactions.
    """

    def __init__(self, scene: Scene, build: Callable[[Scene], FrictionModel]) -> None:
        """Find the elements of a scene; `build` makes the engine's model when it is first needed."""
        self._scene, self._build = scene, build
        self.elements = loaded_frictions(scene)
        self._joints = [scene.mechanism.joint_index(element.joint) for element in self.elements]
        self._model: FrictionModel | None = None
        self._last: tuple[Any, dict[str, float]] = None, {}

    @property
    def model(self) -> FrictionModel:
        """The engine's model of the scene."""
        self._model = self._model or self._build(self._scene)
        return self._model

    def forces(
        self, scene: Scene, q: Array, v: Array, time: float, rates: Sequence[float], factor: float = 1.0
    ) -> dict[str, float]:
        """Compute the frictions, N or N m, by identity; the result for the last state is reused.

        A state that is not finite has frictions NaN.

        Args:
            scene: the scene with the present forces of sampled controllers and pieces of functions.
            q, v: (nq,) and (nv,) coordinates and velocities of the engine's model.
            time: s.
            rates: rates of the joint coordinates of the elements, m/s or rad/s.
            factor: of the load coefficients.
        """
        if not (np.all(np.isfinite(q)) and np.all(np.isfinite(v))):  # as after a friction that jams
            return {element.identity: np.nan for element in self.elements}
        state = scene, q.tobytes(), v.tobytes(), time, factor
        if self._last[0] != state:
            model = self.model
            model.time, model.scene = time, scene

            def reactions(held: HeldFriction) -> list[Array]:
                """Compute the reactions for given frictions."""
                model.held_friction = held
                evaluation = model.evaluate(q, v)
                return [evaluation.reaction_force[joint] for joint in self._joints]

            slopes = {
                element.identity: factor
                * element.load_coefficient
                * float(np.clip(rate / element.transition_speed, -1.0, 1.0))
                for element, rate in zip(self.elements, rates, strict=True)
            }
            found = dict.fromkeys(slopes, 0.0)
            if any(slopes.values()):
                found = solve_frictions(slopes, reactions)
            self._last = state, found
        return self._last[1]
