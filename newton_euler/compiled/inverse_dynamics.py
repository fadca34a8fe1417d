"""Inverse dynamics in native code: forces of actuators for wanted accelerations, and all reactions.

The equations of motion are solved with the wanted accelerations as further constraints
(`newton_euler.equations.formulation.Formulation.servo_forces`). Closed loops, freedoms without an actuator
and redundant actuators need no special cases. The programs are compiled once for a scene and evaluate
thousands of states at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.program import native_program
from newton_euler.compiled.equations import NOT_COMPILED_FIELDS
from newton_euler.compiled.outputs import at_rows
from newton_euler.equations.formulation import Servos
from newton_euler.equations.parameters import measuring, numbered, pieces, with_values
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import exchangeable_rows, flags_at
from newton_euler.equations.servos import fault, servos_of
from newton_euler.equations.system import Evaluation, at_time
from newton_euler.errors import MechanismError, SingularityError, quoted
from newton_euler.integrators.projection import worst_joint
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array, Scalar, minimum

MAX_OPEN_LOOP = 1e-6
"""Largest loop-closure error of a state, sizes of the mechanism or rad: more than any engine leaves."""


class SolvedStates(NamedTuple):
    """Forces, reactions and accelerations at n states; a actuators, j joints, b bodies; SI, world frame."""

    actuator_force: Array
    """(n, a) N or N m."""
    reaction_force: Array
    """(n, j, 3) on the second body of each joint."""
    reaction_torque: Array
    """(n, j, 3) about its joint point."""
    linear_acceleration: Array
    """(n, b, 3) of the centers of mass."""
    angular_acceleration: Array
    """(n, b, 3)."""


class InverseDynamics:
    """Inverse dynamics of a scene in native code.

    Attributes:
        scene: the scene with control laws without force on the coordinates and the actuators.
        servos: the coordinates with wanted accelerations, and the actuators.
        system: its equations in joint coordinates.
    """

    def __init__(self, scene: Scene, coordinates: tuple[Key, ...], actuators: tuple[Key, ...]) -> None:
        """Check that the actuators can give the coordinates any accelerations.

        Raises:
            MechanismError: naming a coordinate or actuator, see `newton_euler.equations.servos.servos_of`.
        """
        self.scene = measuring(scene, [*actuators, *coordinates])
        self.servos = servos_of(scene, coordinates, actuators)
        self.system = Relative(self.scene)
        self._exchangeable = exchangeable_rows(self.system)

    @cached_property
    def forces(self) -> NativeFunction:
        """Compute forces (a,), pivot ratio, and squared loop-closure error.

        Inputs are q, v, flags of constraint rows, wanted accelerations, time and pieces of functions.
        """
        return self._function("forces", self._trace_forces, len(self.servos.coordinates))

    @cached_property
    def motion(self) -> NativeFunction:
        """Compute v (nv,) and the pivot ratio from q, an unused v, flags, rates, time and pieces."""
        return self._function("motion", self._trace_motion, len(self.servos.coordinates))

    @cached_property
    def evaluation(self) -> NativeFunction:
        """Compute reactions and accelerations of `SolvedStates` from q, v, flags, forces, time and pieces."""
        return self._function("loads", self._trace_evaluation, len(self.servos.actuators))

    def _function(self, name: str, trace: Callable[..., list[Scalar]], inputs: int) -> NativeFunction:
        held = pieces(self.scene, 0.0)
        rows = self._exchangeable.numbers
        ends = np.cumsum([self.system.nq, self.system.nv, len(rows), inputs, 1, *map(len, held.values())])

        def traced(x: Array) -> tuple[list[Scalar], None]:
            q, v, flags, given, (time,), *numbers = np.split(x, ends[:-1])
            scene = with_values(self.scene, dict(zip(held, numbers, strict=True)))
            servos = self.servos.with_flags(dict(zip(rows, flags, strict=True)))
            return trace(scene, servos, q, v, given, time), None

        begun = [float(motion.function.value(0.0)) for motion in self.scene.motions]
        chosen = self.scene, self.servos.coordinates, self.servos.actuators, begun
        name, neutral = f"inverse dynamics {name}", NOT_COMPILED_FIELDS
        return native_program(name, int(ends[-1]), traced, *chosen, neutral=neutral, many=True)

    def _trace_forces(
        self, scene: Scene, servos: Servos, q: Array, v: Array, accelerations: Array, time: Scalar
    ) -> list[Scalar]:
        system = at_time(Relative(scene), time)
        forces, pivot_ratio = system.servo_forces(q, v, servos, list(accelerations))
        loops = system.rows - len(system.couplings)
        phi = (system.phi(q) / system.phi_units)[:loops]
        return [*forces, minimum(pivot_ratio, 1.0), phi @ phi]

    def _trace_motion(
        self, scene: Scene, servos: Servos, q: Array, v: Array, rates: Array, time: Scalar
    ) -> list[Scalar]:
        system = at_time(Relative(scene), time)
        found, pivot_ratio = system.servo_velocities(q, servos, list(rates))
        return [*found, minimum(pivot_ratio, 1.0)]

    def _trace_evaluation(
        self, scene: Scene, servos: Servos, q: Array, v: Array, forces: Array, time: Scalar
    ) -> list[Scalar]:
        found, _ = self._with_forces(scene, forces, time).sparse_evaluation(q, v, servos.rows)
        return [scalar for array in _arrays(found) for scalar in array.ravel()]

    def _with_forces(self, scene: Scene, forces: Array, time: Scalar) -> Relative:
        """Return the equations of the scene with forces of the actuators (a,)."""
        values = {numbered("control", k, "feedforward"): u for k, u in enumerate(forces)}
        return at_time(Relative(with_values(scene, values)), time)

    def _time_inputs(self, time: Array) -> Array:
        """Return times (n,), s, each followed by the pieces of functions at that time."""
        if not pieces(self.scene, 0.0):
            return time[:, None]
        return np.array([np.concatenate([[t], *pieces(self.scene, t).values()]) for t in time.tolist()])

    def flags(self, q: Array) -> Array:
        """Choose constraint rows at q (n, nq): flags (n, m) of exchangeable rows."""
        rows = self._exchangeable
        chosen = [flags_at(self.system, each, self.servos.rows.numbers, rows) for each in q if rows.numbers]
        return np.array(chosen).reshape(len(q), len(rows.numbers))

    def velocities(self, q: Array, rates: Sequence[Array], time: Array) -> Array:
        """Compute v (n, nv) from the rates (n,) of each coordinate, at q (n, nq) and times (n,), s.

        Raises:
            SingularityError: for a state at which the coordinates do not determine the motion.
        """
        unused, flags = np.zeros((len(q), self.system.nv)), self.flags(q)
        found = at_rows(self.motion, np.column_stack([q, unused, flags, *rates, self._time_inputs(time)]))
        self._check_pivots(found[:, -1], found, q)
        return found[:, :-1]

    def _check_pivots(self, pivot_ratio: Array, found: Array, q: Array) -> None:
        """Raise `SingularityError` for the first state without a positive pivot ratio or finite results.

        Args:
            pivot_ratio: (n,) of the elimination.
            found: (n, k) results.
            q: (n, nq) states.
        """
        for row in np.flatnonzero(~(pivot_ratio > 0.0) | ~np.isfinite(found).all(axis=1))[:1]:
            flags = dict(zip(self._exchangeable.numbers, self.flags(q[[row]])[0].tolist(), strict=True))
            # dimensionless singular values below 1e-4 are those of rows that made the elimination fail
            at = fault(self.system, q[row], self.servos.with_flags(flags), tolerance=1e-4)
            if at is None and not len(self.servos.rows.numbers):
                problem = f"has no finite solution at state {row}"
                raise MechanismError("inverse dynamics", problem, "smaller rates and accelerations")
            if at is None:
                cut = self.system.row_owners[self.servos.rows.numbers[0]]
                raise SingularityError(cut, f"the loops at state {row} do not determine the motion")
            raise SingularityError(at[0][0], f"at state {row} the coordinate {at[1]}")

    def solve(self, q: Array, v: Array, accelerations: Sequence[Array], time: Array) -> SolvedStates:
        """Solve inverse dynamics at n states.

        Args:
            q, v: (n, nq) and (n, nv) coordinates and velocities of `system`.
            accelerations: (n,) m/s^2 or rad/s^2, for each of the coordinates.
            time: (n,) s.

        Raises:
            MechanismError: for a state whose loops are open, naming the joint.
            SingularityError: for a state at which an acceleration cannot be chosen, naming the coordinate.
        """
        # forces of the actuators
        table, flags, times = np.column_stack([q, v]), self.flags(q), self._time_inputs(time)
        found = at_rows(self.forces, np.column_stack([table, flags, *accelerations, times]))
        forces, pivot_ratio, opening = found[:, :-2], found[:, -2], found[:, -1]
        for row in np.flatnonzero(~(opening <= MAX_OPEN_LOOP**2))[:1]:
            joint, distance = worst_joint(self.system, self.system.state(q[row], v[row]))
            problem = f"joint {quoted(joint)} is open by {distance:.3g} (m or rad)"
            needed = f"closed loops, to {MAX_OPEN_LOOP:g} sizes of the mechanism"
            raise MechanismError(f"state {row}", problem, needed)
        self._check_pivots(pivot_ratio, forces, q)
        # reactions and accelerations under these forces
        joints, bodies = len(self.scene.mechanism.joints), len(self.scene.mechanism.bodies)
        shapes = [(joints, 3), (joints, 3), (bodies, 3), (bodies, 3)]
        if mobility(self.scene).redundant:  # only the dense form finds the smallest reactions
            values = self._dense_evaluation(q, v, forces, time)
        else:
            values = at_rows(self.evaluation, np.column_stack([table, flags, forces, times]))
        parts = np.split(values, np.cumsum([count * 3 for count, _ in shapes])[:-1], axis=1)
        return SolvedStates(
            forces, *(part.reshape(-1, *shape) for part, shape in zip(parts, shapes, strict=True))
        )

    def _dense_evaluation(self, q: Array, v: Array, forces: Array, time: Array) -> Array:
        """Compute the results of `evaluation` (n, k) in floats, with the smallest reactions."""
        rows = []
        for own_q, own_v, u, t in zip(q, v, forces, time, strict=True):
            found = self._with_forces(self.scene, u, float(t)).evaluate(own_q, own_v)
            rows.append(np.concatenate([array.ravel() for array in _arrays(found)]))
        return np.array(rows)


def _arrays(found: Evaluation) -> tuple[Array, ...]:
    """Return the arrays of `SolvedStates` without the forces, in their order."""
    return (
        found.reaction_force,
        found.reaction_torque,
        found.linear_acceleration,
        found.angular_acceleration,
    )
