"""Equations of a scene with directional derivatives, traced and compiled.

The programs have an input vector x: the state (q, v), time, flags that select constraint rows, and
parameters. A second input, a direction, is a change of x; the programs return the derivatives of their
results along the direction (forward-mode differentiation). A direction that is integrated along a run is a
*tangent*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np

from newton_euler.codegen.compile import MIN_ROLLED_SIZE_IN_LANES, Traced
from newton_euler.codegen.expression import Graph, Program, differentiate_along, substitute
from newton_euler.compiled.equations import CACHED_SCENES, used_by
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.parameter_names import places
from newton_euler.equations.row_choice import dimensionless_rows
from newton_euler.equations.sparse import RowsInUse, least_squares, solve_constrained, sparse_vector
from newton_euler.integrators.options import FormulationName
from newton_euler.integrators.singular import UNSAFE_PIVOT_RATIO
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.simulate import CompiledScene
from newton_euler.scalars import Array, Scalar, minimum, objects, zeros

ALONG = " along"
"""End of the names of programs with derivatives along a direction."""

UNREFINED, RATES, PROJECTED = (name + ALONG for name in ("unrefined", "derivative", "settled"))
"""Names of programs: rates of state and tangent, solved without and with iterative refinement; projection of
a direction onto the linearized constraints."""

SIGN_CHANGES = "reversing"
"""Name of the program that returns, for each force that may jump, a vector that reverses at the jump.

Such a force is discontinuous in the state, for example that of a spring whose two ends meet."""


@lru_cache(maxsize=CACHED_SCENES)
def tangent_code(scene: Scene, names: tuple[str, ...], formulation: FormulationName | None) -> TangentCode:
    """Return the code of a scene with derivatives with respect to parameters, from a cache if possible.

    Args:
        scene: the scene to run.
        names: names of parameters, see `newton_euler.analysis.sensitivity.tangent_starts.components`. Their
            values are inputs of the code.
        formulation: see `newton_euler.simulate`.
    """
    initial = initial_numbers(scene, names)
    code = TangentCode(scene, formulation, parameters=[name for name in names if name not in initial])
    code.has_single_direction = len(names) == 1
    return code


class TangentCode(CompiledScene):
    """A compiled scene with derivatives along a direction of (q, v, parameters).

    Inputs of programs whose names end with `ALONG` are x and a direction of the same length. Several
    directions are evaluated at once in the lanes (elements) of vector registers. A method `_trace_NAME`
    returns the results of the program NAME.
    """

    has_single_direction = False
    """True if derivatives are computed along one direction only. Lanes then hold different output times."""

    @property
    def rates(self) -> tuple[str, ...]:
        """Names of the programs of rates of state and tangent, in the order in which they are tried.

        The first is faster. The last is also accurate if constraints are nearly dependent. The pivot ratio,
        the smallest ratio of a pivot of the elimination to its reference magnitude, is small there.
        """
        return (RATES,) if self.formulation == "relative" else (UNREFINED, RATES)

    @cached_property
    def moves_loops(self) -> bool:
        """True if parameters change the configurations in which loops close, such as a joint point.

        Near a singular configuration derivatives with respect to such parameters grow without bound.
        """
        if not (SpanningTree(self.scene.mechanism).cuts or self.system.couplings):
            return False
        changed = places(self.scene, self._requested).values()
        # the center and the frame of a body describe its pose; they do not move the joints
        return any(place.field.moves_loops and place.owner[0] != "bodies" for place in changed)

    def _traced(self, name: str, in_lanes: bool) -> Traced:
        """Return a program by name, with the instructions how to compile it."""
        if not name.endswith(ALONG):
            return super()._traced(name, in_lanes)
        program = self.program(name)
        # programs for the rates become code without loops, unless they would take too long to compile
        straight = name in self.rates and program.operation_count < MIN_ROLLED_SIZE_IN_LANES
        # rates of a single direction are needed for one state at a time
        many = name not in self.rates or not self.has_single_direction
        return Traced(program, many=many, layout=self._layouts.get(name), straight=straight)

    def _identity_of(self, name: str) -> str | None:
        """Return the fingerprint of all that a program by name depends on; None without a fingerprint."""
        known = super()._identity_of(name.removesuffix(ALONG))
        if known and self.has_single_direction and name in self.rates:
            return f"{known} alone"
        return known

    def _trace(self, name: str) -> Program:
        """Trace a program by name; inputs of a program with derivatives are x and the direction `along`."""
        if not name.endswith(ALONG):
            return super()._trace(name)
        graph, base = Graph(), name.removesuffix(ALONG)
        x, along = graph.variables(self.inputs), graph.variables(self.inputs)
        along[self.size : self.flags.stop] = 0.0  # time and flags of constraint rows do not change
        system = self._system_of(x, tuple(self.parameters))
        if name == PROJECTED:
            return graph.prune(self._projected(system, x, along))
        if name in self.rates:
            rates = self._rates_along(system, x, along, refined=name == RATES)
            return graph.prune(rates)._replace(inputs=2 * self.inputs)
        scalars = self._scalars(base, system, x)
        kept = self._differentiable(scalars) if base == "output" else scalars
        changes = differentiated(kept, x, along)
        return graph.prune([*kept, *changes] if base == "coordinates" else changes)

    def _rates_along(self, system: Formulation, x: Array, along: Array, refined: bool) -> list[Scalar]:
        """Return (qdot, vdot), their derivatives, and the pivot ratio.

        Accelerations are differentiated implicitly. Let r(x, a) = 0 be the equations for the accelerations
        and multipliers a. The derivative da along the direction solves (dr/da) da = -(dr/dx) dx, with the
        factors that are known from the solution for a. Without refinement the relative error of da is
        round-off divided by the pivot ratio.

        Args:
            system: equations of motion at x.
            x, along: (inputs,) symbolic inputs and direction.
            refined: True for iterative refinement of the solutions.
        """
        # accelerations and multipliers at x
        q, v, graph = x[: system.nq], x[system.nq : self.size], x[-1].graph
        rows = used_by(system)
        if not refined:
            # without reference magnitudes, each pivot is compared with its diagonal element: the ratio then
            # shows the digits that the elimination loses
            rows = RowsInUse(rows.numbers, flags=rows.flags)
        equations = system.sparse_equations(q, v, rows)
        equations = equations._replace(refine=equations.refine and refined)
        solution = solve_constrained(equations)
        # residuals r(x, a), differentiated at constant a: a is a vector of variables `held`, which are
        # replaced by their values after the differentiation
        count, used = len(equations.factor.pivots), equations.rows.numbers
        accelerations, used_multipliers = graph.variables(count), graph.variables(len(used))
        multipliers = zeros(len(equations.jacobian), x)
        multipliers[used] = used_multipliers
        held = [*accelerations, *used_multipliers]
        values = [solution.acceleration.get(k, 0.0) for k in range(count)]
        values += [solution.multipliers.get(i, 0.0) for i in used]
        residuals = system.sparse_residuals(q, v, rows, accelerations, multipliers)
        right = substitute(graph, differentiated(np.concatenate(residuals).tolist(), x, along), held, values)
        # derivatives of the accelerations
        force, gamma = sparse_vector([-change for change in right[:count]]), -objects(right[count:])
        reduced_force = equations.factor.lower(force)
        changed = equations._replace(reduced_force=reduced_force, gamma=gamma)
        solution_change = solve_constrained(changed).acceleration
        acceleration_changes = [solution_change.get(k, 0.0) for k in range(count)]
        # derivatives of qdot and vdot, which depend on x and on the accelerations
        held_solution = replace(solution, acceleration=dict(enumerate(accelerations)))
        vdot = system.sparse_vdot(q, v, held_solution).tolist()
        changes = differentiate_along(graph, vdot, [*x, *accelerations], [*along, *acceleration_changes])
        rates = [*system.rate(q, v), *system.sparse_vdot(q, v, solution)]
        changes = differentiated(rates[: system.nq], x, along) + substitute(graph, changes, held, values)
        return [*rates, *changes, minimum(solution.pivot_ratio, 1.0)]

    def _projected(self, system: Formulation, x: Array, along: Array) -> list[Scalar]:
        """Project a direction at a closed state onto the linearized constraints; return its (q, v).

        Coordinates are projected first, then velocities, by steps of least length. Where constraints are
        nearly dependent, the steps are round-off. A factor then reduces them to zero, and the direction keeps
        the error of its integration.

        Args:
            system: equations of motion at x.
            x, along: (inputs,) symbolic inputs and direction.
        """
        on_q, on_v = slice(system.nq), slice(system.nq, self.size)
        q, v, moved = x[on_q], x[on_v], along.copy()
        for place in system.quaternions:  # changes of a unit quaternion are perpendicular to it
            moved[place] -= q[place] * (q[place] @ moved[place])
        phi, jacobian = system.phi_and_jacobian(q)
        used = self.rows.numbers  # constraint rows from which all others follow
        rows, units = dimensionless_rows(system, jacobian, used), system.velocity_units

        def step(residuals: Sequence[Scalar]) -> Array:
            """Compute the shortest step (nv,) for the derivatives of residuals (k,) along the direction."""
            right = np.array(differentiated(residuals, x, moved)) / system.phi_units[used]
            least, pivot_ratio = least_squares(rows, right, used_by(system))
            # the factor falls from 1 to 0 with the fourth power of small pivot ratios
            ratio = minimum(pivot_ratio * (1.0 / UNSAFE_PIVOT_RATIO), 1.0)
            factor = ratio * ratio * (ratio * ratio)
            return np.array([factor * units[k] * least.get(k, 0.0) for k in range(system.nv)])

        # coordinates
        change = system.rate(q, step(phi[used].tolist()))
        change[system.work] = 0.0  # entry of q with the work of forces, which is no coordinate
        moved[on_q] -= change
        # velocities; `phi_rate` has the first `system.rows` rows of phi, but not the norms of quaternions
        rate = system.phi_rate(q, v)
        norm_rates = {i: sum(e * v[k] for k, e in jacobian[i].items()) for i in used if i >= system.rows}
        moved[on_v] -= step([norm_rates[i] if i in norm_rates else rate[i] for i in used])
        return moved[: self.size].tolist()

    def _differentiable(self, scalars: list[Scalar]) -> list[Scalar]:
        """Select the outputs that have derivatives, and store their layout."""
        without = {"phi", "pivot_ratio", "joint_angle"}  # the program `coordinates` has the angles of joints
        if self.redundant:  # reactions are not unique
            without |= {"reaction_force", "reaction_torque"}
        kept: list[Scalar] = []
        places: dict[str, tuple[int, int, tuple[int, ...]]] = {}
        for name, (start, stop, shape) in self._layouts["output"].items():
            if name not in without:
                places[name] = len(kept), len(kept) + stop - start, shape
                kept += scalars[start:stop]
        self._layouts["output" + ALONG] = places
        return kept

    def _trace_reversing(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace a vector for each force that may jump, which reverses at the jump.

        The layout has the first index, the end index and the shape of each vector, by name of the force.
        """
        force_inputs, scalars = system.surroundings(q, v), list[Scalar]()
        places: dict[str, tuple[int, int, tuple[int, ...]]] = {}
        for force in system.scene.forces:
            if force.may_jump:
                vector = force.reversing_vector(force_inputs).tolist()
                places[force.element] = len(scalars), len(scalars) + len(vector), (len(vector),)
                scalars += vector
        self._layouts[SIGN_CHANGES] = places
        return scalars

    def _trace_coordinates(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the coordinates of all joints, m or rad, then their rates."""
        frames, coordinates, rates = system.frames(q, v), list[Scalar](), list[Scalar]()
        for equations in system.equations:
            for k in range(len(equations.coordinates)):
                x, rate = equations.measure(k, frames)
                coordinates.append(x)
                rates.append(rate)
        return [*coordinates, *rates]


def differentiated(scalars: Sequence[Scalar], x: Array, along: Array) -> list[Scalar]:
    """Differentiate scalars along a direction (inputs,) of x (inputs,)."""
    return differentiate_along(x[-1].graph, scalars, x.tolist(), along.tolist())
