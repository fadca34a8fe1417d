"""Inverse dynamics in native code: actuator forces for desired accelerations, and all joint reactions.

The equations of motion are solved with the desired accelerations as additional constraints
(`newton_euler.equations.formulation.Formulation.servo_forces`). Closed loops, degrees of freedom without an
actuator and redundant actuators need no special cases. The functions are compiled once for a scene and
evaluate many states per call.

The functions also take flags. A constraint row is one scalar constraint equation. If constraints are
redundant, some rows are exchangeable: which of them is best left out depends on the configuration
(`newton_euler.equations.row_choice`). The flag of an exchangeable row is 1 if the row is left out, else 0.
Most scenes have no such rows.

Functions of time, such as splines, consist of polynomial pieces between knots. The coefficients of the piece
that is valid at a state's time are inputs, so that one compiled function serves all times.
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
from newton_euler.equations.parameter_names import numbered
from newton_euler.equations.parameters import measuring, pieces, with_values
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import exchangeable_rows, flags_at
from newton_euler.equations.servos import find_fault, servos_of
from newton_euler.equations.system import Evaluation, at_time
from newton_euler.errors import MechanismError, SingularityError, quoted
from newton_euler.integrators.projection import worst_joint
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array, Scalar, minimum

MAX_OPEN_LOOP = 1e-6
"""Largest loop-closure error of a state: lengths divided by the mechanism's size, or rad.

The value is larger than the error that any engine leaves in its trajectories."""


class SolvedStates(NamedTuple):
    """Results of inverse dynamics at n states of a scene with a actuators, j joints and b bodies.

    Attributes:
        actuator_force: (n, a) N or N m.
        reaction_force: (n, j, 3) N, on the second body of each joint, world frame.
        reaction_torque: (n, j, 3) N m, on the second body about its joint point, world frame.
        linear_acceleration: (n, b, 3) m/s^2, of the centers of mass, world frame.
        angular_acceleration: (n, b, 3) rad/s^2, world frame.
    """

    actuator_force: Array
    reaction_force: Array
    reaction_torque: Array
    linear_acceleration: Array
    angular_acceleration: Array


class InverseDynamics:
    """Inverse dynamics of one scene, compiled when first needed.

    Attributes:
        scene: the scene, whose control laws are replaced by laws of zero force on the actuators, then on the
            coordinates: the equations measure only coordinates that forces or couplings need. The actuator
            forces of a state are set as the constant parts of these laws.
        servos: the joint coordinates with desired accelerations, the actuators, and the constraint rows in
            use (`rows`).
        system: equations of the scene in joint coordinates.
    """

    def __init__(self, scene: Scene, coordinates: tuple[Key, ...], actuators: tuple[Key, ...]) -> None:
        """Check that the actuators can give the coordinates any accelerations.

        Args:
            scene: the scene.
            coordinates: (joint, number) of each joint coordinate with a desired acceleration.
            actuators: (joint, number) of each joint coordinate that an actuator drives.

        Raises:
            MechanismError: naming a coordinate or actuator, see `newton_euler.equations.servos.servos_of`.
        """
        self.scene = measuring(scene, [*actuators, *coordinates])
        self.servos = servos_of(scene, coordinates, actuators)
        self.system = Relative(self.scene)
        self._exchangeable = exchangeable_rows(self.system)

    @cached_property
    def forces(self) -> NativeFunction:
        """Native function that computes actuator forces (a,), pivot ratio and squared loop-closure error.

        The pivot ratio is at most 0 at a singular state; a ratio above 1 is returned as 1. Inputs are q, v,
        flags of constraint rows, desired accelerations, time and the polynomial pieces of functions of time
        at that time.
        """
        return self._function("forces", self._trace_forces, len(self.servos.coordinates))

    @cached_property
    def motion(self) -> NativeFunction:
        """Native function that computes all velocities v (nv,) from the rates of the coordinates.

        The pivot ratio follows in the last place. Inputs are those of `forces`, with desired rates in place
        of accelerations; v is ignored.
        """
        return self._function("motion", self._trace_motion, len(self.servos.coordinates))

    @cached_property
    def evaluation(self) -> NativeFunction:
        """Native function that computes the reactions and accelerations of `SolvedStates` in their order.

        Inputs are those of `forces`, with actuator forces in place of accelerations.
        """
        return self._function("loads", self._trace_evaluation, len(self.servos.actuators))

    def _function(self, name: str, trace: Callable[..., list[Scalar]], given_count: int) -> NativeFunction:
        """Compile a function of q, v, flags, some given numbers, time and polynomial pieces.

        Args:
            name: distinguishes the functions of a scene in the cache.
            trace: one of the `_trace_...` methods, which computes the results over symbolic scalars.
            given_count: number of given accelerations, rates or forces.
        """
        functions = pieces(self.scene, 0.0)  # polynomial coefficients by parameter name; only lengths matter
        rows = self._exchangeable.numbers
        lengths = [self.system.nq, self.system.nv, len(rows), given_count, 1, *map(len, functions.values())]
        ends = np.cumsum(lengths)

        def traced(x: Array) -> tuple[list[Scalar], None]:
            """Split x (inputs,) into its parts and compute the results; None: no description for callers."""
            q, v, flags, given, (time,), *coefficients = np.split(x, ends[:-1])
            scene = with_values(self.scene, dict(zip(functions, coefficients, strict=True)))
            servos = self.servos.with_flags(dict(zip(rows, flags, strict=True)))
            return trace(scene, servos, q, v, given, time), None

        # constraint rows are selected at the initial pose, which depends on prescribed motions
        initial_motions = [float(motion.function.value(0.0)) for motion in self.scene.motions]
        depends_on = self.scene, self.servos.coordinates, self.servos.actuators, initial_motions
        # cached code is found by the contents of `depends_on` without the fields `neutral`, which do not
        # change the results; `many` allows several states at once in the lanes of vector registers
        name, neutral = f"inverse dynamics {name}", NOT_COMPILED_FIELDS
        return native_program(name, int(ends[-1]), traced, *depends_on, neutral=neutral, many=True)

    def _trace_forces(
        self, scene: Scene, servos: Servos, q: Array, v: Array, accelerations: Array, time: Scalar
    ) -> list[Scalar]:
        """Trace actuator forces (a,), pivot ratio and squared loop-closure error (without couplings)."""
        system = at_time(Relative(scene), time)
        forces, pivot_ratio = system.servo_forces(q, v, servos, list(accelerations))
        loop_rows = system.rows - len(system.couplings)  # rows of couplings follow those of loops
        phi = (system.phi(q) / system.phi_units)[:loop_rows]
        return [*forces, minimum(pivot_ratio, 1.0), phi @ phi]

    def _trace_motion(
        self, scene: Scene, servos: Servos, q: Array, v: Array, rates: Array, time: Scalar
    ) -> list[Scalar]:
        """Trace the velocities v (nv,) for given rates of the coordinates, and the pivot ratio."""
        system = at_time(Relative(scene), time)
        velocities, pivot_ratio = system.servo_velocities(q, servos, list(rates))
        return [*velocities, minimum(pivot_ratio, 1.0)]

    def _trace_evaluation(
        self, scene: Scene, servos: Servos, q: Array, v: Array, forces: Array, time: Scalar
    ) -> list[Scalar]:
        """Trace the reactions and accelerations under given actuator forces (a,)."""
        evaluation, _ = self._with_forces(scene, forces, time).sparse_evaluation(q, v, servos.rows)
        return [scalar for array in _arrays(evaluation) for scalar in array.ravel()]

    def _with_forces(self, scene: Scene, forces: Array, time: Scalar) -> Relative:
        """Return the equations of the scene at a time, s, with given actuator forces (a,), N or N m."""
        # law number k acts on actuator number k; `feedforward` is its constant part
        values = {numbered("control", k, "feedforward"): force for k, force in enumerate(forces)}
        return at_time(Relative(with_values(scene, values)), time)

    def _time_inputs(self, time: Array) -> Array:
        """Return rows (n, 1 + k): each time, s, and the polynomial pieces of functions at that time."""
        if not pieces(self.scene, 0.0):
            return time[:, None]
        return np.array([np.concatenate([[t], *pieces(self.scene, t).values()]) for t in time.tolist()])

    def flags(self, q: Array) -> Array:
        """Choose constraint rows at n states q (n, nq): flags (n, m), 1 for a row that is left out."""
        rows = self._exchangeable
        chosen = [flags_at(self.system, each, self.servos.rows.numbers, rows) for each in q if rows.numbers]
        return np.array(chosen).reshape(len(q), len(rows.numbers))

    def velocities(self, q: Array, rates: Sequence[Array], time: Array) -> Array:
        """Compute the velocities of all joint coordinates from the rates of the chosen coordinates.

        Args:
            q: (n, nq) coordinates of `system` at n states.
            rates: (n,) m/s or rad/s, for each coordinate of `servos`.
            time: (n,) s.

        Returns:
            (n, nv) velocities of `system`.

        Raises:
            SingularityError: for a state at which the coordinates do not determine the motion.
        """
        ignored_v, flags = np.zeros((len(q), self.system.nv)), self.flags(q)
        inputs = np.column_stack([q, ignored_v, flags, *rates, self._time_inputs(time)])
        results = at_rows(self.motion, inputs)
        self._check_pivots(results[:, -1], results, q)
        return results[:, :-1]

    def _check_pivots(self, pivot_ratio: Array, results: Array, q: Array) -> None:
        """Raise an error for the first state without a positive pivot ratio or finite results.

        Args:
            pivot_ratio: (n,) smallest pivot of the elimination relative to its reference magnitude.
            results: (n, k) results of the elimination.
            q: (n, nq) coordinates.

        Raises:
            SingularityError: for a singular state, naming the coordinate or a joint that closes a loop.
            MechanismError: for numbers that overflow in a mechanism without loops.
        """
        for row in np.flatnonzero(~(pivot_ratio > 0.0) | ~np.isfinite(results).all(axis=1))[:1]:
            flags = dict(zip(self._exchangeable.numbers, self.flags(q[[row]])[0].tolist(), strict=True))
            # find the coordinate at fault; rows with dimensionless singular values below 1e-4 are dependent
            # to the precision at which the elimination fails
            fault = find_fault(self.system, q[row], self.servos.with_flags(flags), tolerance=1e-4)
            if fault is None and not len(self.servos.rows.numbers):
                problem = f"has no finite solution at state {row}"
                raise MechanismError("inverse dynamics", problem, "smaller rates and accelerations")
            if fault is None:
                joint = self.system.row_owners[self.servos.rows.numbers[0]]
                raise SingularityError(joint, f"the loops at state {row} do not determine the motion")
            (joint, _), reason = fault  # key (joint, number) of the coordinate
            raise SingularityError(joint, f"at state {row} the coordinate {reason}")

    def solve(self, q: Array, v: Array, accelerations: Sequence[Array], time: Array) -> SolvedStates:
        """Solve inverse dynamics at n states.

        Args:
            q: (n, nq) coordinates of `system`.
            v: (n, nv) velocities of `system`.
            accelerations: (n,) m/s^2 or rad/s^2, for each coordinate of `servos`.
            time: (n,) s.

        Raises:
            MechanismError: for a state whose loops are open, naming the joint.
            SingularityError: for a state at which the actuators cannot give a coordinate any acceleration,
                naming the coordinate.
        """
        # actuator forces
        states, flags, times = np.column_stack([q, v]), self.flags(q), self._time_inputs(time)
        results = at_rows(self.forces, np.column_stack([states, flags, *accelerations, times]))
        forces, pivot_ratio, squared_error = results[:, :-2], results[:, -2], results[:, -1]
        for row in np.flatnonzero(~(squared_error <= MAX_OPEN_LOOP**2))[:1]:
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
            values = at_rows(self.evaluation, np.column_stack([states, flags, forces, times]))
        parts = np.split(values, np.cumsum([count * 3 for count, _ in shapes])[:-1], axis=1)
        return SolvedStates(
            forces, *(part.reshape(-1, *shape) for part, shape in zip(parts, shapes, strict=True))
        )

    def _dense_evaluation(self, q: Array, v: Array, forces: Array, time: Array) -> Array:
        """Compute the results of `evaluation` (n, k) in floats, with the minimum-norm reactions.

        Redundant constraints leave the reactions undetermined; the minimum-norm solution is one of many.
        """
        rows = []
        for state_q, state_v, state_forces, t in zip(q, v, forces, time, strict=True):
            system = self._with_forces(self.scene, state_forces, float(t))
            evaluation = system.evaluate(state_q, state_v)
            rows.append(np.concatenate([array.ravel() for array in _arrays(evaluation)]))
        return np.array(rows)


def _arrays(evaluation: Evaluation) -> tuple[Array, ...]:
    """Return the reactions and accelerations of an evaluation in the order of `SolvedStates`."""
    return (
        evaluation.reaction_force,
        evaluation.reaction_torque,
        evaluation.linear_acceleration,
        evaluation.angular_acceleration,
    )
