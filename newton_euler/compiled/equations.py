"""A scene compiled: its equations traced, pruned to what is wanted, and turned into native code.

All functions take one vector x = (q, v, time, flags, parameters) and write one vector. Those that methods of
integration call are as `newton_euler.integrators.stepper.Equations` says. The flags leave out exchangeable
constraint rows (`newton_euler.equations.row_choice`); most scenes have none.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cache, cached_property
from itertools import accumulate
from typing import Any

import numpy as np

from newton_euler.codegen.cache import cache_key, read_cache, write_cache
from newton_euler.codegen.compile import LARGE, VERY_LARGE, NativeFunction, Traced, lane_count
from newton_euler.codegen.expression import Graph, Program, differentiate
from newton_euler.codegen.fingerprint import fingerprint
from newton_euler.compiled.constraint_groups import constraint_groups
from newton_euler.compiled.formulations import cheaper_formulation, formulate
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.model_control import share_model_control
from newton_euler.equations.parameters import (
    parameter_layout,
    parameter_values,
    pieces,
    places,
    with_values,
)
from newton_euler.equations.redundancy import NearlyRedundant, loosely_closed, mobility, residual
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import (
    NO_ROWS,
    ExchangeableRows,
    constraint_scales,
    dimensionless_rows,
    exchangeable_rows,
    rows_in_use,
)
from newton_euler.equations.sparse import RowsInUse, add, dot, gram_factor, is_zero, least_squares
from newton_euler.equations.system import Observation, at_time
from newton_euler.errors import UnknownNameError
from newton_euler.integrators.options import baumgarte_alpha
from newton_euler.integrators.singular import NEAR_PIVOT_RATIO, ratio_for_steps
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array, Scalar, minimum

MULTI_STATE_GROUPS = (("output",), ("position", "velocity"))
"""Programs that take several states at once, the same number in each group: outputs are many."""

POSITION_OUTPUTS = frozenset({"violation"})
"""Outputs that depend on q alone, as poses do."""

CACHED_SCENES = 8
"""Number of most recently used scenes whose compiled code stays in memory, for each kind of code."""

NOT_COMPILED_FIELDS = frozenset(
    {"description", "duration", "output_period", "controller", "shapes", "meshes", "times", "values"}
)
"""Fields of scenes, control laws, bodies and functions with knots that no equation sees."""

KINEMATIC_PROGRAMS = ("position", "velocity")
"""Programs that no parameter enters but those of geometry and motions; coverage takes those of the run."""

OPEN_TOLERANCE = 1e-9
"""Sizes of the mechanism, or rad, that a constraint may stay open after projection."""


MAX_ROW_SUMS = 8
"""Sums of rows that are left out whose shares are looked at. The more there are, the less likely all of their
shares are small by chance."""


class CompiledEquations:
    """Native functions of one formulation of a scene. Each is traced and compiled when first needed.

    Attributes:
        scene: the scene that is compiled.
        system: its formulation, whose float form is the reference.
        formulation: "relative" or "cartesian".
        stabilization, alpha: as asked for.
        parameters: names of the parameters that are inputs of the code, with their shapes: pieces of motions
            first, then those asked for, of geometry and motions before others, pieces of control laws and
            what sampled controllers hold.
        kinematic: those of geometry and motions among the parameters that were asked for.
        piecewise: True if functions of time have pieces.
        size: length of (q, v).
        programs: traced so far, by name: derivative, position, velocity, rate, jacobian, output,
            measured, retract, surface, shares, ratio.
        functions: native code made or loaded so far, by the same names.
        trace_time, compile_time: s taken so far; loading from the cache counts as compiling.
    """

    def __init__(
        self,
        scene: Scene,
        formulation: str | None = None,
        stabilization: str = "projection",
        alpha: float | None = None,
        parameters: Sequence[str] = (),
        independent: Sequence[int] | None = None,
    ) -> None:
        """`formulation` is the cheaper one if None; `independent` are rows of closures to use in every
        configuration. If None, `redundancy` selects the rows at first, and runs exchange them."""
        self.scene = scene
        formulation = formulation or cheaper_formulation(scene.mechanism)
        self._independent, self._named = independent, tuple(parameters)
        self.formulation, self.stabilization = formulation, stabilization
        self.alpha = baumgarte_alpha(stabilization, alpha)
        self.system = formulate(scene, formulation, self.alpha)
        of_functions = list(pieces(scene, 0.0))
        of_motions = [name for name in of_functions if name.startswith("motions")]
        self.piecewise = len(of_functions) > 0
        found = places(scene, parameters)
        self.kinematic = tuple(name for name, place in found.items() if place.field.moves_loops)
        self._kinematic = (*of_motions, *self.kinematic)
        others = [name for name in parameters if name not in self.kinematic]
        held = [f"{law.prefix}.held" for law in scene.sampled]
        names = [*self._kinematic, *others, *of_functions[len(of_motions) :], *held]
        self.parameters = {name: value.shape for name, value in parameter_values(scene, names).items()}
        self.size = self.system.nq + self.system.nv
        self.programs: dict[str, Program] = {}
        self.functions: dict[str, NativeFunction] = {}
        self._layouts: dict[str, Any] = {}
        self.trace_time = self.compile_time = 0.0

    @cached_property
    def inputs(self) -> int:
        """Length of (q, v, time, flags, parameters)."""
        return self._length(self.parameters)

    def _length(self, parameters: Iterable[str]) -> int:
        """Return the length of x with these parameters."""
        return self.flags.stop + sum(int(np.prod(self.parameters[name])) for name in parameters)

    @property
    def flags(self) -> slice:
        """Place in x of the flags, 1 for exchangeable rows that are left out and 0 for those in use."""
        return slice(self.size + 1, self.size + 1 + len(self.exchangeable.numbers))

    @property
    def operations(self) -> dict[str, int]:
        """Floating-point operations of each function."""
        return {name: function.operations for name, function in self.functions.items()}

    @property
    def from_cache(self) -> bool:
        """True if all of it came from the cache."""
        return all(function.module.from_cache for function in self.functions.values())

    @property
    def settings(self) -> dict[str, Any]:
        """The choices that it was made with, as settings of runs have them."""
        chosen = {"formulation": self.formulation, "stabilization": self.stabilization}
        return chosen | ({"alpha": self.alpha} if self.stabilization == "baumgarte" else {})

    @property
    def projects(self) -> bool:
        """True if runs are projected onto the constraints, or quaternions at least onto norm 1."""
        closes = len(self.system.phi_units) > 0 or len(self.system.quaternions) > 0
        return self.stabilization == "projection" and closes

    @cached_property
    def groups(self) -> Array:
        """Groups (size,) that constraints connect, see `constraint_groups`; none if nothing is projected."""
        return constraint_groups(self.system) if self.projects else np.zeros(0)

    @cached_property
    def loses_rank(self) -> bool:
        """True if constraints, those of loops and couplings, may become dependent in some configuration."""
        return len(SpanningTree(self.scene.mechanism).cuts) > 0 or len(self.system.couplings) > 0

    @cached_property
    def output_state_size(self) -> int:
        """Number of elements of a state that outputs need: its first nq, or all."""
        return self.system.nq if self.scene.outputs <= POSITION_OUTPUTS else self.size

    @cached_property
    def arrays(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Place in the results of `output`, and shape, of each array that the scene asks for."""
        layout = self.function("output").layout
        return {name: (slice(start, stop), tuple(shape)) for name, (start, stop, shape) in layout.items()}

    def function(self, name: str, in_lanes: bool = False) -> NativeFunction:
        """Return one of the functions, compiled when first needed; of `lane_count()` states if wanted."""
        key = f"{name} in lanes" if in_lanes else name
        if key not in self.functions:
            known = self._identity_of(name)
            identity = known and f"{known} {key}"
            start, traced = time.perf_counter(), self.trace_time
            self.functions[key] = NativeFunction(lambda: self._traced(name, in_lanes), identity)
            self.compile_time += time.perf_counter() - start - (self.trace_time - traced)
        return self.functions[key]

    def program(self, name: str) -> Program:
        """Return one of the programs, traced when first needed."""
        if name not in self.programs:
            start = time.perf_counter()
            self.programs[name] = self._trace(name)
            self.trace_time += time.perf_counter() - start
        return self.programs[name]

    def _traced(self, name: str, in_lanes: bool) -> Traced:
        """Return one of the programs with its layout."""
        group = next((group for group in MULTI_STATE_GROUPS if name in group), ())
        many = len(group) > 0 and all(self.program(other).operations < LARGE for other in group)
        program, layout = self.program(name), self._layouts.get(name)
        if in_lanes:
            return Traced(program, True, layout, program.operations < VERY_LARGE, lane_count())
        return Traced(program, many, layout)

    def _identity_of(self, name: str) -> str | None:
        """Fingerprint of everything that a program, or the choice of "rows", depends on."""
        parameters = self._kinematic if name in KINEMATIC_PROGRAMS else tuple(self.parameters)
        neutral = NOT_COMPILED_FIELDS if name == "output" else NOT_COMPILED_FIELDS | {"outputs"}
        return self._fingerprint(parameters, neutral)

    @cached_property
    def _fingerprint(self) -> Callable[[tuple[str, ...], frozenset[str]], str | None]:
        """Fingerprint of the scene with parameters, but for neutral fields, worked out once."""
        chosen: list[Any] = [self.formulation, self.stabilization, self.alpha, self.scene.tracks_work]
        if self._independent is not None:
            chosen.append(tuple(self._independent))
        # the choice of rows begins where the scene does
        chosen += [float(motion.function.value(0.0)) for motion in self.scene.motions]

        def found(parameters: tuple[str, ...], neutral: frozenset[str]) -> str | None:
            inputs = parameter_layout(self.scene, parameters)
            return fingerprint(self.scene, *chosen, inputs, neutral=neutral)

        return cache(found)

    @cached_property
    def _decided(self) -> tuple[RowsInUse, ExchangeableRows, bool, tuple[NearlyRedundant, ...]]:
        """Rows in use, exchangeable rows, True if multipliers are not unique, weak constraints."""
        known = self._identity_of("rows")
        key = known and cache_key(known, "rows")
        stored = read_cache(key) if key else None
        if stored is not None:
            with suppress(
                ValueError, TypeError, RecursionError
            ):  # of something else than what is written below
                rows, exchangeable, redundant, nearly = json.loads(stored)
                weak = tuple(NearlyRedundant(*each) for each in nearly)
                return RowsInUse(*rows), ExchangeableRows(*exchangeable), bool(redundant), weak
        with np.errstate(all="ignore"):  # forces that overflow are for a run to report
            found = mobility(self.scene)
            exchange = exchangeable_rows(self.system) if self._independent is None else NO_ROWS
            chosen = rows_in_use(self.system, self._independent, exchange)._replace(flags=None)
        unused = len(self.system.phi_units) - len(chosen.numbers) + sum(exchange.left_out)
        if isinstance(self.system, Relative):  # where rows may be zero everywhere
            unused = len(found.redundant)
        decided = chosen, exchange, unused > 0, found.nearly
        if key:
            write_cache(key, json.dumps(decided).encode())
        return decided

    @property
    def rows(self) -> RowsInUse:
        """Constraint rows that imply all others; exchangeable ones are among them."""
        return self._decided[0]

    @property
    def exchangeable(self) -> ExchangeableRows:
        """Constraint rows among which a run chooses."""
        return self._decided[1]

    @property
    def rank(self) -> int:
        """Number of constraint rows in use at a time."""
        return len(self.rows.numbers) - int(sum(self.exchangeable.left_out))

    @property
    def redundant(self) -> bool:
        """True if reactions are not unique."""
        return self._decided[2]

    @property
    def nearly_redundant(self) -> tuple[NearlyRedundant, ...]:
        """Constraints that are almost redundant, and their treatment."""
        return self._decided[3]

    @property
    def noise(self) -> float:
        """The largest singular value that is taken as redundant, 0 for none."""
        return residual(self.nearly_redundant)

    @cached_property
    def omitted(self) -> list[int]:
        """Constraint rows that are taken as redundant and are not, quite: all but those in use."""
        if self.noise == 0.0:
            return []
        return sorted(set(range(len(self.system.phi_units))) - set(self.rows.numbers))

    def packed(self, q: Array, v: Array, time: float = 0.0, values: dict[str, Array] | None = None) -> Array:
        """Pack x (inputs,) for native functions; parameters not in `values` are the scene's own."""
        own = parameter_values(self.scene, self.parameters) | pieces(self.scene, time) | (values or {})
        flags = self.exchangeable.left_out
        return np.concatenate([q, v, [time], flags, *(np.ravel(own[name]) for name in self.parameters)])

    def float_system(self, x: Array) -> Formulation:
        """Return the float form at the time and the parameters in x (inputs,)."""
        system = self.system
        if self.parameters:
            system = self._formulated(with_values(self.scene, self.values(x)))
        system.omitted = self.omitted
        return at_time(system, x[self.size])

    def _formulated(self, scene: Scene) -> Formulation:
        """Return the equations of the scene with other values of its parameters."""
        system = formulate(scene, self.formulation, self.alpha)
        share_model_control(system, self.system)
        return system

    def parametrized(self, x: Array) -> Scene:
        """Return the scene with the values in x (inputs,) of the parameters that were asked for."""
        return with_values(self.scene, self.values(x, self._named)) if self._named else self.scene

    def place(self, parameter: str) -> int:
        """Return the place where a parameter begins in x (inputs,)."""
        if parameter not in self.parameters:
            raise UnknownNameError("parameter", parameter, tuple(self.parameters))
        return self._places[parameter]

    @cached_property
    def _places(self) -> dict[str, int]:
        """The place of each parameter by name."""
        sizes = [int(np.prod(shape)) for shape in self.parameters.values()]
        starts = accumulate(sizes, initial=self.flags.stop)
        return dict(zip(self.parameters, starts, strict=False))

    def values(self, x: Array, names: Iterable[str] | None = None) -> dict[str, Any]:
        """Return these parameters, or all, in x (inputs,), by name."""
        values = {}
        for name in self.parameters if names is None else names:
            start, shape = self._places[name], self.parameters[name]
            values[name] = x[start : start + int(np.prod(shape))].reshape(shape) if shape else x[start]
        return values

    # Tracing

    def _trace(self, name: str) -> Program:
        """Trace a program; those whose results have names leave their layout in `_layouts`."""
        graph = Graph()
        names = self._kinematic if name in KINEMATIC_PROGRAMS else tuple(self.parameters)
        x = graph.variables(self._length(names))
        return graph.prune(self._scalars(name, self._system_of(x, names), x))

    def _system_of(self, x: Array, names: Iterable[str]) -> Formulation:
        """Return the equations over scalars x (inputs,), which end with these parameters."""
        scene = with_values(self.scene, self.values(x, names))
        system = at_time(self._formulated(scene), x[self.size])
        system.in_use = self.rows_at(x)
        return system

    def rows_at(self, x: Array) -> RowsInUse:
        """Return the constraint rows with the flags in x (inputs,)."""
        numbers = self.exchangeable.numbers
        return (
            self.rows._replace(flags=dict(zip(numbers, x[self.flags], strict=True))) if numbers else self.rows
        )

    def _scalars(self, name: str, system: Formulation, x: Array) -> list[Scalar]:
        """Evaluate a program at x (inputs,)."""
        q, v = x[: system.nq], x[system.nq : self.size]
        scalars: list[Scalar] = getattr(self, f"_trace_{name}")(system, q, v)
        return scalars

    def _trace_derivative(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace (qdot, vdot, pivot ratio)."""
        acceleration, pivot_ratio = system.sparse_acceleration(q, v, used_by(system))
        return [*system.rate(q, v), *acceleration, minimum(pivot_ratio, 1.0)]

    def _trace_jacobian(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the derivative (n, n) of (qdot, vdot) by (q, v), row by row."""
        if self.size == 0:
            return []
        acceleration, _ = system.sparse_acceleration(q, v, used_by(system))
        rates = [*system.rate(q, v), *acceleration]
        return list(differentiate(q[0].graph, rates, [*q, *v]).ravel())

    def _trace_rate(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace qdot."""
        return [*system.rate(q, v)]

    def _trace_position(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace (q after one Newton step, v, squared residual before it, pivot ratio)."""
        norms = [q[place] @ q[place] - 1.0 for place in system.quaternions]
        q = system.retract(q, np.zeros(system.nv))  # quaternions of norm 1
        phi, step, pivot_ratio = self._correction(system, q, None)
        square = self._open(phi) + sum(norm * norm for norm in norms)
        return [*system.retract(q, -step), *v, square, pivot_ratio]

    def _open(self, phi: Array) -> Scalar:
        """Square dimensionless residuals (k,); rows that are omitted may open by more than the others."""
        weights = np.ones(len(phi))
        if self.omitted:
            weights[self.omitted] = OPEN_TOLERANCE / loosely_closed(self.scene.redundancy_tolerance)
        weighted = weights * phi
        return weighted @ weighted

    def _trace_velocity(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace (q, v on the constraints, squared residual of positions, pivot ratio)."""
        phi, step, pivot_ratio = self._correction(system, q, v)
        return [*q, *(v - step), self._open(phi), pivot_ratio]

    def _correction(self, system: Formulation, q: Array, v: Array | None) -> tuple[Array, Array, Scalar]:
        """Find residuals, the least step (nv,) that removes them or their rate at v, and its pivot ratio.

        All but the step is dimensionless.
        """
        units = system.velocity_units
        phi, jacobian = system.phi_and_jacobian(q)
        rows, used = dimensionless_rows(system, jacobian, self.rows.numbers), used_by(system)
        phi = phi / system.phi_units
        right = phi[self.rows.numbers]
        if v is not None:
            rate = (system.phi_t() / system.phi_units)[self.rows.numbers]
            right = rate + [sum(x * (v[k] / units[k]) for k, x in row.items()) for row in rows]
        step, pivot_ratio = least_squares(rows, right, used)
        least = np.array([units[k] * step.get(k, 0.0) for k in range(system.nv)])
        return phi, least, minimum(pivot_ratio, 1.0)

    def _trace_ratio(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the pivot ratio of the constraints alone."""
        rows = dimensionless_rows(system, system.phi_and_jacobian(q)[1], self.rows.numbers)
        usual = constraint_scales(self.system, self._independent, self.exchangeable)
        return [minimum(gram_factor(rows, used_by(system), usual).pivot_ratio, 1.0)]

    def pivot_ratio(self, x: Array) -> float:
        """Evaluate the pivot ratio at x (inputs,), as methods of integration see it."""
        if not self.loses_rank:
            return 1.0
        ratio = float(self.function("derivative")(x)[-1])
        return (
            ratio_for_steps(ratio, float(self.function("ratio")(x)[0])) if ratio < NEAR_PIVOT_RATIO else ratio
        )

    def _trace_shares(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the square of the largest share of a row in use in one left out, and the nonzeros of rows.

        If many rows are exchangeable, it is the largest share in some sums of rows with random signs. The
        layout has the places of nonzeros in the matrix (k, nv) of all rows, dimensionless.
        """
        exchange, used = self.exchangeable, used_by(system)
        rows = dimensionless_rows(system, system.phi_and_jacobian(q)[1], self.rows.numbers)
        factor, flags, count = gram_factor(rows, used), used.flags or {}, len(exchange.numbers)
        weights = np.eye(count)
        if count > MAX_ROW_SUMS:
            weights = np.random.default_rng(0).choice([-1.0, 1.0], (MAX_ROW_SUMS, count))
        places = [used.numbers.index(number) for number in exchange.numbers]
        worst: Scalar = 0.0
        for signs in weights / np.array(exchange.units):
            total: dict[int, Scalar] = {}
            for place, number, sign in zip(places, exchange.numbers, signs, strict=True):
                for k, entry in rows[place].items() if sign != 0.0 else ():
                    add(total, k, flags[number] * (sign * entry))
            right = {n: dot(row, total) for n, row in enumerate(rows)}
            shares = factor.solve({n: x for n, x in right.items() if not is_zero(x)})
            for place, unit in zip(places, exchange.units, strict=True):
                share = unit * shares.get(place, 0.0)
                worst = minimum(worst, -(share * share))
        self._layouts["shares"] = [system.nv * n + k for n, row in enumerate(rows) for k in row]
        return [-worst, *(entry for row in rows for entry in row.values())]

    def _trace_retract(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace q moved by a step (nv,) that stands in place of v."""
        return [*system.retract(q, v)]

    def _trace_surface(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace (Phi, dPhi/dt, nonzeros of Phi_q, nonzeros of M on and below its diagonal), dimensionless.

        The layout has the number of rows and the places of nonzeros. Rows that are omitted, or zero
        everywhere, are left out.
        """
        units, phi_units = self.system.velocity_units, self.system.phi_units
        phi, jacobian = system.phi_and_jacobian(q)
        phi_t = system.phi_t()
        kept = [i for i in range(len(phi)) if i not in self.omitted and (jacobian[i] or not is_zero(phi[i]))]
        scalars: list[Scalar] = [phi[i] / phi_units[i] for i in kept]
        for i in kept:
            rate = sum(x * v[k] for k, x in jacobian[i].items()) + phi_t[i]
            scalars.append(rate / phi_units[i])
        on_jacobian: list[int] = []
        for row, i in enumerate(kept):
            on_jacobian.extend(system.nv * row + k for k in jacobian[i])
            scalars.extend(x * (units[k] / phi_units[i]) for k, x in jacobian[i].items())
        on_mass: list[int] = []
        for i, entries in enumerate(system.mass_rows(q)):
            lower = [k for k in entries if k <= i]
            on_mass.extend(system.nv * i + k for k in lower)
            scalars.extend(entries[k] * (units[i] * units[k]) for k in lower)
        self._layouts["surface"] = len(kept), (on_jacobian, on_mass)
        return scalars

    def _trace_output(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the arrays that the scene asks for; the layout has their places and shapes."""
        wanted = self.scene.outputs
        if self.scene.needs_accelerations:
            e, pivot_ratio = system.sparse_evaluation(q, v, used_by(system))
            seen: Observation = e
        else:
            seen = system.observe(q, v)
        state = seen.state
        arrays: dict[str, Any] = {"position": state.position, "quaternion": state.quaternion}
        if state.angles:
            arrays["joint_angle"] = np.array(list(state.angles.values()))
        if "velocities" in wanted:
            arrays["linear_velocity"] = state.linear_velocity
            arrays["angular_velocity"] = state.angular_velocity
        if "reactions" in wanted:
            arrays["reaction_force"], arrays["reaction_torque"] = e.reaction_force, e.reaction_torque
        if "actuation" in wanted:
            arrays["actuator_force"] = e.actuator_force
        if "energy" in wanted:
            arrays["kinetic_energy"] = np.array(seen.kinetic_energy)
            arrays["potential_energy"] = np.array(seen.potential_energy)
        if self.scene.tracks_work:
            arrays["work"] = np.array(q[system.work][0])
        if "violation" in wanted or self.stabilization != "projection":
            arrays["phi"] = system.joint_phi(q)
        if "reactions" in wanted:
            arrays["pivot_ratio"] = np.array(minimum(pivot_ratio, 1.0))
        places: dict[str, tuple[int, int, tuple[int, ...]]] = {}
        scalars: list[Scalar] = []
        for name, array in arrays.items():
            places[name] = len(scalars), len(scalars) + array.size, array.shape
            scalars.extend(array.ravel())
        self._layouts["output"] = places
        return scalars

    def _trace_measured(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the coordinates of all control laws, then their rates."""
        seen = system.measure(q, v)
        return [*(x for x, _ in seen), *(rate for _, rate in seen)]


def used_by(system: Formulation) -> RowsInUse:
    """Return the constraint rows of a system over scalars."""
    assert system.in_use is not None
    return system.in_use
