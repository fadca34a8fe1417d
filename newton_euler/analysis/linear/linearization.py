"""Linear models of a scene in independent coordinates, by exact derivatives of its equations.

Let z be d independent joint coordinates with J T = 0 and J_z T = I. Motions of the mechanism are v = T zdot.
The equations of motion give vdot and zddot = J_z vdot - gamma_z, with gamma_z = -(dJ_z/dt) v. A change of
z_i at constant zdot changes the velocities by dv_i,

    dv_i = -[J; J_z]^-1 (d[J; J_z]/dz_i) v
    d zddot / dz_i = (d zddot / dq) qdot(T_i) + (d zddot / dv) dv_i,    d zddot / dzdot_i = (d zddot / dv) T_i

Here q and v are the coordinates and velocities of the spanning tree, the mechanism without the joints that
close loops. J is the Jacobian of the constraints of these joints, J_z the Jacobian of z with respect to v,
and [J; J_z] has the rows of both. The columns of T are motions that leave loops closed. Joint coordinates
have keys (joint, number).

The partial derivatives are exact: the equations are traced and differentiated in compiled code, with one
evaluation for each direction. The model holds at every state with closed loops, also in motion. The rotation
of a ball joint has no coordinates. Small rotations dtheta of the joint's second body about its axes replace
them, with the angular velocity omega: d/dt dtheta = domega - omega x dtheta. An independent coordinate is a
`Freedom`. If it is not a joint coordinate, it has no key, and its rate is component `v_index` of v. If it
belongs to a ball joint, `ball_start` is the index in v of the first component of omega; otherwise -1.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from itertools import accumulate
from typing import Any

import numpy as np

from newton_euler.analysis.kinematics.freedoms import (
    AXIS_NAMES,
    Freedom,
    chosen_freedoms,
    coordinate_jacobian,
)
from newton_euler.analysis.linear.linear_model import LinearModel, label
from newton_euler.arguments import checked
from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.expression import differentiate_along
from newton_euler.codegen.program import native_program
from newton_euler.compiled.equations import CACHED_SCENES, NOT_COMPILED_FIELDS
from newton_euler.compiled.outputs import at_rows
from newton_euler.equations.dense import largest, singular_values
from newton_euler.equations.model_control import share_model_control
from newton_euler.equations.parameter_names import numbered, unambiguous
from newton_euler.equations.parameters import (
    check_dynamic,
    measuring,
    parameter_layout,
    parameter_values,
    pieces,
    pieces_along,
    with_laws,
    with_values,
)
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import candidate_rows, exchangeable_rows, flags_at, rows_in_use
from newton_euler.equations.sparse import RowsInUse, dot
from newton_euler.equations.system import at_time, constraint_rate, dimensionless_jacobian, fastest_joint
from newton_euler.errors import (
    MechanismError,
    SingularityError,
    UnknownNameError,
    check_choice,
    nearest,
)
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import check_revolutions, initial_state
from newton_euler.runs.controllers import Controllers
from newton_euler.runs.intervals import with_held_values
from newton_euler.scalars import Array, Scalar, minimum, tilde

MIN_SINGULAR_VALUE = 1e-9
"""Singular value of [J; J_z] below which the coordinates do not determine the motion."""

MAX_OPEN = 1e-6
"""Largest loop-closure error of a state, sizes of the mechanism or rad, and its largest rate, 1/s. Both are
multiplied by the largest velocity if it exceeds 1. The errors in runs of all engines are smaller."""


@checked
def linearize(
    scene: Scene,
    state: State | None = None,
    coordinates: Sequence[str | Key] | None = None,
    inputs: Sequence[str | Key] | None = None,
    outputs: Sequence[str | Key] | None = None,
    *,
    closed_loop: bool = True,
    time: float = 0.0,
) -> LinearModel:
    """Linearize a scene about a state, in independent coordinates and with exact derivatives.

    Args:
        scene: the mechanism with its forces and control laws.
        state: state with closed loops; the scene's initial state if None. The state may move and need not be
            an equilibrium, see `LinearModel.f` and `LinearModel.is_equilibrium`.
        coordinates: as many as degrees of freedom: joint coordinates, by the name of the joint, or by (name,
            number) for joints of several coordinates; or rotations of a ball, `JOINT.ball.x`, about an axis
            of the body that it moves, which is parallel to the world's x at the initial pose. If None,
            coordinates with control laws are chosen first, then those that move most.
        inputs: joint coordinates, for additional forces on them, N or N m, or parameters
            (`newton_euler.equations.parameters`) such as `slide_12.target` or `panel_7.mass`. The coordinates
            with control laws if None.
        outputs: joint coordinates, or bodies with six outputs each: position of the center of mass, m, and
            small rotation, rad, world frame. The `coordinates` if None.
        closed_loop: True if control laws act as in a run, False if their forces at the state are held.
        time: s, of prescribed motions and of control laws that depend on time.

    Raises:
        UnknownNameError: for an unknown name.
        MechanismError: for a state that does not belong to the scene, too many or too few coordinates, and a
            sampled controller in a closed loop, which has no derivatives.
        SingularityError: naming a coordinate that does not determine the motion at the state.

    Examples:
        >>> model = linearize(load("tracker"), inputs=["slide_12.target"], outputs=["panel_7"])
        >>> model.B.shape, model.C.shape, model.is_equilibrium
        ((4, 1), (6, 4), False)
    """
    state = initial_state(scene) if state is None else state
    scene.check_numbers(state, f"state of scene {scene.name!r}")
    check_revolutions(scene, state)
    time = float(time)
    scene.check_functions(time, time, "the time asked for")
    if closed_loop and scene.sampled:
        problem = "has no derivative, being sampled"
        raise MechanismError(scene.sampled[0].element, problem, "closed_loop=False, or a law as PD")
    # names of coordinates, inputs and outputs
    freedoms = chosen_freedoms(scene, state, coordinates)
    mechanism, law_keys = scene.mechanism, tuple(law.key for law in scene.control)
    input_names = list(map(mechanism.coordinate_name, law_keys)) if inputs is None else list(inputs)
    resolved = _resolved_inputs(with_laws(scene, scene.control if closed_loop else ()), input_names)
    output_names = [freedom.name for freedom in freedoms] if outputs is None else list(outputs)
    # joint coordinates that the equations have to measure, and parameters among the inputs
    output_keys = [mechanism.coordinate(name) for name in output_names if _is_coordinate(scene, name)]
    force_keys = [key for key in resolved if isinstance(key, tuple)]
    freedom_keys = [freedom.key for freedom in freedoms if freedom.key]
    measured = tuple(dict.fromkeys([*freedom_keys, *force_keys, *output_keys, *law_keys]))
    parameters = tuple(name for name in resolved if isinstance(name, str))
    rows = _well_conditioned_rows(scene, state)
    compiled = _compiled(scene, freedoms, measured, parameters, closed_loop, rows)
    return compiled.linearized(state, resolved, input_names, output_names, time)


def _is_coordinate(scene: Scene, name: str | Key) -> bool:
    """Return True if a name stands for a joint coordinate."""
    return isinstance(name, tuple) or name in scene.mechanism.joint_names


def _well_conditioned_rows(scene: Scene, state: State) -> tuple[int, ...] | None:
    """Select constraint rows that are well conditioned at a state.

    A constraint row is one scalar constraint equation. If constraints are redundant, some rows are
    exchangeable: which of them is best left out depends on the configuration. The result has the numbers of
    the rows in use, the others are left out; None if no rows are exchangeable.
    """
    system = Relative(scene)
    exchangeable = exchangeable_rows(system)
    if not exchangeable.numbers:
        return None
    used, left_out = candidate_rows(system, exchangeable=exchangeable)
    rows = RowsInUse(system.rows_of([*used, *left_out]))
    # a flag is 1 for a row that is left out
    flags = flags_at(system, system.coordinates(state)[0], rows.numbers, exchangeable)
    return tuple(rows._replace(flags=dict(zip(exchangeable.numbers, flags, strict=True))).in_use)


def _resolved_inputs(scene: Scene, names: Sequence[str | Key]) -> list[Key | str]:
    """Return, for each name, the key of a joint coordinate (input is a force) or the name of a parameter."""
    resolved: list[Key | str] = []
    for name in names:
        if _is_coordinate(scene, name):
            resolved.append(scene.mechanism.coordinate(name))
            continue
        try:
            check_dynamic(scene, [str(name)], "input of a linear model")
            resolved.append(unambiguous(scene, str(name)))
        except UnknownNameError as error:
            similar_names = nearest(name, (*scene.mechanism.joint_names, *error.valid))
            raise UnknownNameError("input", name, similar_names, proposed=True) from error
    return resolved


class Linearization:
    """Derivatives of the accelerations of independent coordinates, in native code; see `linearize`.

    Attributes:
        original: the scene that is linearized.
        scene: the same scene with the control laws of the closed loop, followed by laws of zero force on the
            measured coordinates. The constant force (feedforward) of each of these laws is an input.
        values: values of the inputs by parameter name: these constant forces, parameters, then coefficients
            of the polynomial pieces of functions of time.
        system: equations of `scene` in joint coordinates.
        rows: constraint rows in use.
    """

    def __init__(
        self,
        scene: Scene,
        freedoms: tuple[Freedom, ...],
        measured: tuple[Key, ...],
        parameters: tuple[str, ...],
        closed_loop: bool,
        used: tuple[int, ...] | None,
    ) -> None:
        """Prepare the equations.

        Args:
            scene: the scene.
            freedoms: independent coordinates.
            measured: joint coordinates of freedoms, inputs, outputs and control laws.
            parameters: names of the parameters that are inputs.
            closed_loop: True if control laws act.
            used: constraint rows that are well conditioned at the state, see `_well_conditioned_rows`.
        """
        self.original, self.freedoms, self.measured = scene, freedoms, measured
        self.closed_loop, laws = closed_loop, scene.control if closed_loop else ()
        self.scene = with_laws(scene, [*laws, *measuring(scene, measured).control])
        # parameter name of the constant force on each measured coordinate
        self._force_names = {
            key: numbered("control", len(laws) + k, "feedforward") for k, key in enumerate(measured)
        }
        self._pieces = tuple(pieces(self.scene, 0.0))
        names = [*self._force_names.values(), *parameters, *self._pieces]
        self.values = parameter_values(self.scene, names)
        self.system = Relative(self.scene)
        self.used, self.rows = used, rows_in_use(self.system, used)

    @cached_property
    def function(self) -> NativeFunction:
        """Compiled function of (q, v, inputs, a direction of these three, time), see `_trace`."""
        # all that the code depends on; constraint rows depend on prescribed motions at the initial pose
        initial_motions = [float(motion.function.value(0.0)) for motion in self.scene.motions]
        inputs = parameter_layout(self.scene, self.values)
        names = tuple(label(freedom.name) for freedom in self.freedoms)
        depends_on = self.scene, names, self.measured, inputs, self.used, initial_motions
        count = 2 * self._count + 1
        # neutral: fields of these objects that do not change the code; many: evaluate several inputs at once
        return native_program(
            "linearization", count, self._trace, *depends_on, neutral=NOT_COMPILED_FIELDS, many=True
        )

    @property
    def _count(self) -> int:
        """Number of entries of (q, v, inputs)."""
        return self.system.nq + self.system.nv + sum(value.size for value in self.values.values())

    def _trace(self, variables: Array) -> tuple[list[Scalar], None]:
        """Trace zddot (d,), its derivative along a direction, that of [J; J_z] v at constant v, pivot ratio.

        The pivot ratio is about 1 far from singular configurations, and at most 0 at one.
        """
        nq, nv, graph = self.system.nq, self.system.nv, variables[-1].graph
        x, directions, (time,) = np.split(variables, [self._count, 2 * self._count])
        # accelerations of the independent coordinates
        q, v, given = np.split(x, [nq, nq + nv])
        system = at_time(Relative(with_values(self.scene, self._values(given))), time)
        # control laws with inverse dynamics choose constraint rows by numbers; `system` has only symbols
        share_model_control(system, floats=self.system)
        solution = system.sparse_solution(q, v, self.rows)
        keys = [freedom.key for freedom in self.freedoms if freedom.key]
        rows, gamma = system.sparse_coordinates(q, v, keys)
        joint_accelerations = iter(
            [dot(row, solution.acceleration) - g for row, g in zip(rows, gamma, strict=True)]
        )
        accelerations = [
            next(joint_accelerations) if freedom.key else solution.acceleration.get(freedom.v_index, 0.0)
            for freedom in self.freedoms
        ]
        # [J; J_z] v, whose change along z at constant v gives dv
        jacobian = system.phi_and_jacobian(q)[1]
        rates = [sum((x * v[k] for k, x in jacobian[i].items()), start=0.0) for i in self.rows.numbers]
        measured = system.measured(q, v)
        rates += [measured[each.key].rate if each.key else v[each.v_index] for each in self.freedoms]
        scalars = [
            *accelerations,
            *differentiate_along(graph, accelerations, x.tolist(), directions.tolist()),
            *differentiate_along(graph, rates, q.tolist(), directions[:nq].tolist()),
            minimum(solution.pivot_ratio, 1.0),
        ]
        return scalars, None

    @cached_property
    def _places(self) -> dict[str, slice]:
        """Slice of each input, by name, in the vector (m,) of the numbers of all inputs."""
        ends = list(accumulate((value.size for value in self.values.values()), initial=0))
        return dict(zip(self.values, map(slice, ends, ends[1:]), strict=True))

    def _values(self, given: Array) -> dict[str, Any]:
        """Return the inputs by name from their numbers (m,)."""
        values = {}
        for name, value in self.values.items():
            numbers = given[self._places[name]]
            values[name] = numbers.reshape(value.shape) if value.shape else numbers[0]
        return values

    def _scene_without_pieces(self, given: Array) -> Scene:
        """Return the scene with inputs (m,), except the polynomial pieces of its functions of time."""
        values = {name: value for name, value in self._values(given).items() if name not in self._pieces}
        return with_values(self.scene, values)

    def tangent(self, q: Array) -> tuple[Array, Array]:
        """Compute [J; J_z]^-1 (nv, k + d), and T (nv, d), its last columns, at q (nq,).

        k is the number of constraint rows in use.

        Raises:
            SingularityError: naming a coordinate that does not determine the motion.
        """
        system = self.system
        loop_rows = dimensionless_jacobian(system, q)[self.rows.numbers]
        rows = np.concatenate([loop_rows, coordinate_jacobian(system, q, self.freedoms)])
        left, values, _ = singular_values(rows, full=True)
        if values[-1:] < MIN_SINGULAR_VALUE:
            # the coordinate with the largest share in the dependent combination of rows
            share = np.abs(left[len(loop_rows) :, -1])
            name = self.freedoms[int(np.argmax(share))].name
            raise SingularityError(
                label(name), "the coordinate depends on loops and the other coordinates there"
            )
        units = np.concatenate([system.phi_units[self.rows.numbers], [each.unit for each in self.freedoms]])
        inverse = system.velocity_units[:, None] * np.linalg.inv(rows) / units
        return inverse, inverse[:, len(loop_rows) :]

    def linearized(
        self,
        state: State,
        inputs: Sequence[Key | str],
        names: Sequence[str | Key],
        outputs: Sequence[str | Key],
        time: float,
    ) -> LinearModel:
        """Evaluate the matrices at a state.

        Args:
            state: state with closed loops.
            inputs: keys of joint coordinates and names of parameters, from `_resolved_inputs`.
            names: names of these inputs as the user gave them.
            outputs: names of joint coordinates, freedoms or bodies.
            time: s.
        """
        # the state in joint coordinates, and the numbers of the inputs
        system, freedoms, d = at_time(self.system, time), self.freedoms, len(self.freedoms)
        q, v = system.coordinates(state)
        values = self.values | pieces(self.scene, time)
        if not self.closed_loop:
            held = held_forces(self.original, state, time)
            values |= {self._force_names[key]: np.array(force) for key, force in held.items()}
        given = np.concatenate([np.zeros(0), *(np.ravel(value) for value in values.values())])
        self._check_closed(system, q, v)
        # T, and its columns as rates of q
        inverse, tangent = self.tangent(q)
        on_q = np.array([system.rate(q, column) for column in tangent.T]).reshape(d, system.nq)

        def derivatives_along(by_q: Array, by_v: Array, by_input: Array) -> Array:
            """Evaluate `function` (n, results) along directions (n, nq), (n, nv) and (n, m)."""
            directions = np.column_stack([by_q, by_v, by_input])
            state_rows = np.tile(np.concatenate([q, v, given]), (len(directions), 1))
            times = np.full(len(directions), time)
            return at_rows(self.function, np.column_stack([state_rows, directions, times]))

        # a change of a parameter of a function of time also changes the coefficients of its current piece
        m = len(given)
        by_input = np.eye(m)
        if self._pieces:
            for name, changes in pieces_along(self._scene_without_pieces, given, np.eye(m), time).items():
                by_input[:, self._places[name]] += changes.T
        # derivatives along z at constant v give dv; then along z with dv, along zdot, and along the inputs;
        # columns of the results: zddot, its derivative, derivative of [J; J_z] v, pivot ratio
        at_constant_v = derivatives_along(on_q, np.zeros((d, system.nv)), np.zeros((d, m)))
        on_v = -at_constant_v[:, 2 * d : -1] @ inverse.T
        results = derivatives_along(
            np.concatenate([on_q, np.zeros((d + m, system.nq))]),
            np.concatenate([on_v, tangent.T, np.zeros((m, system.nv))]),
            np.concatenate([np.zeros((2 * d, m)), by_input]),
        )
        if not np.isfinite(results).all() or not np.all(results[:, -1] > 0.0):
            joint = fastest_joint(system.mechanism, state)
            raise SingularityError(joint, "accelerations are not determined at the state")
        # matrices; rotations of balls are about axes that turn
        a, twists = np.zeros((2 * d, 2 * d)), system.velocity_transformation(q) @ tangent
        a[:d, d:] = np.eye(d)
        a[d:] = results[: 2 * d, d : 2 * d].T
        for row, freedom in zip(a, freedoms, strict=False):
            if freedom.ball_start >= 0:  # d/dt dtheta = domega - omega x dtheta
                place = slice(freedom.ball_start, freedom.ball_start + 3)
                row[:d] -= (tilde(v[place]) @ tangent[place])[freedom.v_index - freedom.ball_start]
        b, input_labels = self._columns(results[2 * d :, d : 2 * d], inputs, names)
        c, output_labels = self._outputs(q, tangent, twists, outputs)
        jacobian = coordinate_jacobian(self.system, q, freedoms)
        return LinearModel(
            scene=self.original.name,
            state=state,
            coordinates=tuple(freedom.name for freedom in freedoms),
            inputs=input_labels,
            outputs=output_labels,
            units=np.array([freedom.unit for freedom in freedoms]),
            size=system.mechanism.size,
            A=a,
            B=np.concatenate([np.zeros_like(b), b]),
            C=np.hstack([c, np.zeros_like(c)]),
            D=np.zeros((len(c), b.shape[1])),
            f=np.concatenate([jacobian @ (v / system.velocity_units), results[0, :d]]),
            twists=twists.reshape(-1, 6, d),
        )

    def _check_closed(self, system: Relative, q: Array, v: Array) -> None:
        """Raise `MechanismError` for a state whose loops are open or opening."""
        where = f"state of scene {self.original.name!r}"
        for verb, residuals in (("is open by", system.phi(q)), ("opens at", constraint_rate(system, q, v))):
            shares = np.abs(residuals / system.phi_units)[self.rows.numbers]
            if largest(shares) > MAX_OPEN * max(1.0, largest(v / system.velocity_units)):
                worst = self.rows.numbers[int(np.argmax(shares))]
                problem = (
                    f"joint {system.row_owners[worst]!r} {verb} {abs(residuals[worst]):.3g} (m or rad, s)"
                )
                raise MechanismError(where, problem, "closed loops; see newton_euler.assemble(scene, guess)")

    def _columns(
        self, table: Array, inputs: Sequence[Key | str], names: Sequence[str | Key]
    ) -> tuple[Array, tuple[str | Key, ...]]:
        """Select the columns of B that belong to the accelerations, for the inputs asked for.

        Args:
            table: (numbers of all inputs, d) derivatives of the accelerations.
            inputs: keys of joint coordinates and names of parameters.
            names: names of these inputs as the user gave them.

        Returns:
            Columns (d, m); their names. An input of several numbers has one column for each number.
        """
        columns, labels = [np.zeros((0, table.shape[1]))], list[str | Key]()
        for each, name in zip(inputs, names, strict=True):
            parameter = each if isinstance(each, str) else self._force_names[each]
            count = self.values[parameter].size
            columns.append(table[self._places[parameter]])
            labels += [name] if count == 1 else [f"{name}[{k}]" for k in range(count)]
        return np.concatenate(columns).T, tuple(labels)

    def _outputs(
        self, q: Array, tangent: Array, twists: Array, names: Sequence[str | Key]
    ) -> tuple[Array, tuple[str | Key, ...]]:
        """Compute the Jacobian (p, d) of the outputs with respect to the coordinates, and output names.

        Args:
            q: (nq,) configuration.
            tangent: (nv, d) T.
            twists: (6 b, d) Jacobian of the velocities of all b bodies, ground first.
            names: names of joint coordinates, freedoms or bodies.
        """
        mechanism = self.scene.mechanism
        measured = self.system.measured(q, np.zeros(self.system.nv))
        rows, labels = [np.zeros((0, tangent.shape[1]))], list[str | Key]()
        freedom_names = [freedom.name for freedom in self.freedoms]
        for name in names:
            if _is_coordinate(self.scene, name):
                jacobian = measured[mechanism.coordinate(name)].jacobian
                # a coordinate that no motion of the tree changes has an empty Jacobian
                row = sum((x * tangent[k] for k, x in jacobian.items()), np.zeros(tangent.shape[1]))
                rows.append(row[None])
                labels.append(name)
            elif name in freedom_names:
                rows.append(np.eye(len(freedom_names))[[freedom_names.index(name)]])
                labels.append(name)
            else:
                check_choice("output", name, (*mechanism.joint_names, *mechanism.body_names))
                body = mechanism.body_index(str(name))
                rows.append(twists[6 * body : 6 * body + 6])
                labels += [f"{name}.{kind}{axis}" for kind in ("", "r") for axis in AXIS_NAMES]
        return np.concatenate(rows), tuple(labels)


_compiled = lru_cache(maxsize=CACHED_SCENES)(Linearization)
"""Constructor of `Linearization` that keeps recent objects, whose compiled code is used again."""


def held_forces(scene: Scene, state: State, time: float) -> dict[Key, float]:
    """Compute the forces of all control laws at a state and a time, s: N or N m, by coordinate."""
    system = at_time(Relative(scene), time)
    q, v = system.coordinates(state)
    if scene.sampled:
        readings = np.array(system.measure(q, v), dtype=float)
        system = with_held_values(system, Controllers(scene).sample(scene.sampled, time, readings))
    # forces of control laws come first, then those of springs
    return {law.key: float(u) for law, u in zip(scene.control, system.control_forces(q, v), strict=True)}
