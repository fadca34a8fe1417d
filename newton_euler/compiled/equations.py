"""Equations of motion of a scene as native functions: accelerations, projection, outputs and others.

Tracing evaluates the Python equations once over symbolic scalars and records their operations as a program.
LLVM compiles the program. Machine code is kept in a cache on disk under a fingerprint (hash) of all that the
program depends on.

All functions take one vector x = (q, v, time, flags, parameters) and write one vector. q and v are the
coordinates and velocities of the formulation. Parameters are numbers of the scene, such as masses and
joint points, that vary from run to run without a new compilation.

A constraint row is one scalar constraint equation, a row of the constraint Jacobian Phi_q. Redundant rows
follow from the other rows and are left out; the others are the rows in use. In a few scenes a redundant row
and a row in use are exchangeable: a run may leave out either (`newton_euler.equations.row_choice`). x has a
flag for each exchangeable row: 1 if the row is left out, else 0. Flags of switching functions follow, see
`newton_euler.integrators.switches`.
`newton_euler.integrators.stepper.Equations` lists the functions for integrators.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cache, cached_property
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np

from newton_euler.codegen.cache import cache_key, read_cache, write_cache
from newton_euler.codegen.compile import (
    MIN_ROLLED_SIZE,
    MIN_ROLLED_SIZE_IN_LANES,
    NativeFunction,
    Traced,
    lane_count,
)
from newton_euler.codegen.expression import Graph, Program, differentiate
from newton_euler.codegen.fingerprint import fingerprint
from newton_euler.compiled.constraint_groups import constraint_groups
from newton_euler.compiled.formulations import cheaper_formulation, formulate
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.model_control import share_model_control
from newton_euler.equations.parameter_names import Place, places
from newton_euler.equations.parameters import (
    parameter_layout,
    parameter_values,
    pieces,
    values_at,
    with_values,
)
from newton_euler.equations.redundancy import NearlyRedundant, loose_tolerance, mobility, residual
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
from newton_euler.equations.undetermined import check_loaded_frictions
from newton_euler.errors import UnknownNameError
from newton_euler.integrators.options import baumgarte_alpha
from newton_euler.integrators.singular import NEAR_PIVOT_RATIO, ratio_for_steps
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array, Scalar, minimum

MULTI_STATE_GROUPS = (("output",), ("position", "velocity"))
"""Groups of programs that evaluate several states per call, one in each lane of a vector register.

All programs of a group take the same number of states. A program of `MIN_ROLLED_SIZE` operations or more is
rolled: compiled as loops over repeated pieces instead of straight-line code. If one program of a group is
rolled, all of them take one state per call."""

POSITION_OUTPUTS = frozenset({"violation"})
"""Outputs of a scene that depend on the coordinates q but not on the velocities; poses always do."""

CACHED_SCENES = 8
"""Number of most recently used scenes whose compiled code each cache in memory (`lru_cache`) keeps."""

NOT_COMPILED_FIELDS = frozenset(
    {"description", "duration", "output_period", "controller", "shapes", "meshes", "times", "values"}
)
"""Fields of scenes, control laws, bodies and splines that do not enter the compiled equations.

Samples of a spline (`times`, `values`) do not enter because the current polynomial of the spline is an input
of the code."""

KINEMATIC_PROGRAMS = ("position", "velocity")
"""Names of the projection programs, whose only parameters are those of geometry and prescribed motions."""

OPEN_TOLERANCE = 1e-9
"""Largest constraint violation after projection: lengths divided by the mechanism's size, or rad."""

MAX_ROW_SUMS = 8
"""Largest number of combinations of rows in use that the program `shares` computes.

A left-out row is a combination of the rows in use; its coefficients are called shares. If there are more
exchangeable rows than this number, sums of rows with random signs replace the single rows. With 8 sums it is
unlikely that a row with a large share in a left-out row has a small share in every sum."""


class RankDecisions(NamedTuple):
    """Choice of the constraint rows of a scene, as stored in the cache on disk.

    Attributes:
        rows: constraint rows that imply all other rows, exchangeable rows included.
        exchangeable: the rows that a run may exchange for each other.
        redundant: True if redundant constraints make the joint reactions non-unique.
        nearly_redundant: constraints that are almost redundant.
    """

    rows: RowsInUse
    exchangeable: ExchangeableRows
    redundant: bool
    nearly_redundant: tuple[NearlyRedundant, ...]


class CompiledEquations:
    """Native functions of one formulation of a scene, each traced and compiled when first needed.

    Attributes:
        scene: the scene that is compiled: mechanism, forces, control laws, prescribed motions.
        system: the same equations over floats, in Python: the reference for the compiled ones.
        formulation: "relative" (joint coordinates) or "cartesian" (poses of all bodies).
        stabilization: "projection", "baumgarte" or "none": how runs keep constraints closed.
        alpha: 1/s, Baumgarte's parameter.
        parameters: shapes, by name, of the parameters at the end of x. The order is: polynomial pieces of
            prescribed motions, requested parameters of geometry and motions, other requested parameters,
            polynomial pieces of other functions of time, forces that sampled controllers hold between two
            samples.
        kinematic: names of the requested parameters that belong to geometry or prescribed motions.
        piecewise: True if a function of time, such as a spline, consists of polynomial pieces between knots.
            The coefficients of its current piece are a parameter.
        size: length of a state (q, v).
        programs: programs traced so far, by name: derivative, position, velocity, rate, jacobian, output,
            measured, retract, surface, shares, ratio, switching. The method `_trace_NAME` describes the
            results.
        functions: native functions compiled or loaded so far, by name; "NAME in lanes" for several runs.
        trace_time: s spent on tracing so far.
        compile_time: s spent so far on compiling and on loading from the cache.
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
        """Prepare the equations; nothing is compiled yet.

        Args:
            scene: the scene to compile.
            formulation: see `newton_euler.compiled.formulations`; the cheaper one if None.
            stabilization: see the attributes of this class.
            alpha: 1/s, Baumgarte's parameter; the default of the stabilization if None.
            parameters: names of scene parameters that become inputs of the code
                (`newton_euler.equations.parameters`).
            independent: numbers of the constraint rows, in joint coordinates, to use in every configuration.
                If None, the mobility analysis of the scene selects the rows, and runs may exchange redundant
                ones.
        """
        self.scene = scene
        check_loaded_frictions(scene)
        formulation = formulation or cheaper_formulation(scene.mechanism)
        self._independent, self._requested = independent, tuple(parameters)
        self.formulation, self.stabilization = formulation, stabilization
        self.alpha = baumgarte_alpha(stabilization, alpha)
        self.system = formulate(scene, formulation, self.alpha)
        # names of the parameters in their order in x; prescribed motions come first among the pieces
        piece_names = list(pieces(scene, 0.0))
        motion_pieces = [name for name in piece_names if name.startswith("motions")]
        self.piecewise = len(piece_names) > 0
        requested = places(scene, parameters)
        self.kinematic = tuple(name for name, place in requested.items() if place.field.moves_loops)
        self._kinematic = (*motion_pieces, *self.kinematic)
        others = [name for name in parameters if name not in self.kinematic]
        held_forces = [f"{law.prefix}.held" for law in scene.sampled]
        names = [*self._kinematic, *others, *piece_names[len(motion_pieces) :], *held_forces]
        self.parameters = {name: value.shape for name, value in parameter_values(scene, names).items()}
        self.size = self.system.nq + self.system.nv
        self.programs: dict[str, Program] = {}
        self.functions: dict[str, NativeFunction] = {}
        self._layouts: dict[str, Any] = {}  # descriptions of the results of programs, for their callers
        self.trace_time = self.compile_time = 0.0

    @cached_property
    def inputs(self) -> int:
        """Length of the input vector x = (q, v, time, flags, parameters)."""
        return self._length(self.parameters)

    def _length(self, parameters: Iterable[str]) -> int:
        """Return the length of an input vector x that has only the named parameters at its end."""
        return self.flags.stop + sum(int(np.prod(self.parameters[name])) for name in parameters)

    @property
    def row_flags(self) -> slice:
        """Slice of x with flags of exchangeable constraint rows: 1 for a row that is left out, else 0."""
        return slice(self.size + 1, self.size + 1 + len(self.exchangeable.numbers))

    @property
    def branch_flags(self) -> slice:
        """Slice of x with flags of switching functions: 1 for a positive one, else 0."""
        first = self.row_flags.stop
        return slice(first, first + sum(force.switch_count for force in self.scene.switched_forces))

    @property
    def flags(self) -> slice:
        """Slice of x with all flags."""
        return slice(self.row_flags.start, self.branch_flags.stop)

    @property
    def operations(self) -> dict[str, int]:
        """Number of floating-point operations of each native function made so far, by name."""
        return {name: function.operation_count for name, function in self.functions.items()}

    @property
    def from_cache(self) -> bool:
        """True if the machine code of all native functions so far was loaded from the cache on disk."""
        return all(function.module.from_cache for function in self.functions.values())

    @property
    def settings(self) -> dict[str, Any]:
        """Formulation, stabilization and alpha, as in `Trajectory.settings`."""
        chosen = {"formulation": self.formulation, "stabilization": self.stabilization}
        return chosen | ({"alpha": self.alpha} if self.stabilization == "baumgarte" else {})

    @property
    def projects(self) -> bool:
        """True if runs project states onto the constraints, or at least quaternions onto norm 1."""
        has_constraints = len(self.system.phi_units) > 0 or len(self.system.quaternions) > 0
        return self.stabilization == "projection" and has_constraints

    @cached_property
    def groups(self) -> Array:
        """Group numbers (size,) of coordinates and velocities that constraints connect.

        See `newton_euler.compiled.constraint_groups`; an empty array if runs are not projected.
        """
        return constraint_groups(self.system) if self.projects else np.zeros(0)

    @cached_property
    def loses_rank(self) -> bool:
        """True if constraints of loops or couplings may become dependent in a singular configuration.

        The cuts of a spanning tree are the joints outside the tree; each closes a loop.
        """
        return len(SpanningTree(self.scene.mechanism).cuts) > 0 or len(self.system.couplings) > 0

    @cached_property
    def output_state_size(self) -> int:
        """Number of leading elements of a state (q, v) that the outputs need: nq or all of them."""
        return self.system.nq if self.scene.outputs <= POSITION_OUTPUTS else self.size

    @cached_property
    def arrays(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Slice in the results of the function `output`, and shape, of each array that the scene asks for."""
        layout = self.function("output").layout
        return {name: (slice(start, stop), tuple(shape)) for name, (start, stop, shape) in layout.items()}

    def function(self, name: str, in_lanes: bool = False) -> NativeFunction:
        """Return a native function, compiled when first needed.

        Args:
            name: one of the names of `programs`.
            in_lanes: True for a function that evaluates `lane_count()` states per call, one for each run.
        """
        key = f"{name} in lanes" if in_lanes else name
        if key not in self.functions:
            known = self._identity_of(name)
            identity = f"{known} {key}" if known else None
            start, earlier_trace_time = time.perf_counter(), self.trace_time
            self.functions[key] = NativeFunction(lambda: self._traced(name, in_lanes), identity)
            # the function traces the program if its code is not in the cache
            self.compile_time += time.perf_counter() - start - (self.trace_time - earlier_trace_time)
        return self.functions[key]

    def program(self, name: str) -> Program:
        """Return the operations of a program by name, traced when first needed."""
        if name not in self.programs:
            start = time.perf_counter()
            self.programs[name] = self._trace(name)
            self.trace_time += time.perf_counter() - start
        return self.programs[name]

    def _traced(self, name: str, in_lanes: bool) -> Traced:
        """Return a program by name, with the instructions how to compile it."""
        program, layout = self.program(name), self._layouts.get(name)
        if in_lanes:
            straight = program.operation_count < MIN_ROLLED_SIZE_IN_LANES
            return Traced(program, many=True, layout=layout, straight=straight, lanes=lane_count())
        group = next((group for group in MULTI_STATE_GROUPS if name in group), ())
        many = len(group) > 0 and all(
            self.program(other).operation_count < MIN_ROLLED_SIZE for other in group
        )
        return Traced(program, many=many, layout=layout)

    def _identity_of(self, name: str) -> str | None:
        """Return the fingerprint of all that a program depends on.

        Args:
            name: name of the program, or "rows" for the choice of the constraint rows.

        Returns:
            The fingerprint; None if the scene contains objects without one, such as classes of the user.
        """
        parameters = self._kinematic if name in KINEMATIC_PROGRAMS else tuple(self.parameters)
        ignored = NOT_COMPILED_FIELDS if name == "output" else NOT_COMPILED_FIELDS | {"outputs"}
        return self._fingerprint(parameters, ignored)

    @cached_property
    def _fingerprint(self) -> Callable[[tuple[str, ...], frozenset[str]], str | None]:
        """Function that computes the fingerprint from names of parameters and names of fields to ignore.

        The function remembers its results.
        """
        settings: list[Any] = [self.formulation, self.stabilization, self.alpha, self.scene.tracks_work]
        if self._independent is not None:
            settings.append(tuple(self._independent))
        # constraint rows are selected at the scene's initial pose, which depends on prescribed motions
        settings += [float(motion.function.value(0.0)) for motion in self.scene.motions]

        def compute(parameters: tuple[str, ...], ignored: frozenset[str]) -> str | None:
            """Compute the fingerprint for names of parameters and names of fields to ignore."""
            inputs = parameter_layout(self.scene, parameters)
            return fingerprint(self.scene, *settings, inputs, neutral=ignored)

        return cache(compute)

    @cached_property
    def _rank_decisions(self) -> RankDecisions:
        """Choice of the constraint rows, from the cache on disk if possible."""
        known = self._identity_of("rows")
        key = known and cache_key(known, "rows")
        stored = read_cache(key) if key else None
        if stored is not None:
            # an entry of another format than the one written below raises one of these errors
            with suppress(ValueError, TypeError, RecursionError):
                rows, exchangeable, redundant, nearly = json.loads(stored)
                nearly_redundant = tuple(NearlyRedundant(*each) for each in nearly)
                return RankDecisions(
                    RowsInUse(*rows), ExchangeableRows(*exchangeable), bool(redundant), nearly_redundant
                )
        with np.errstate(all="ignore"):  # a run reports forces that overflow
            analysis = mobility(self.scene)
            exchange = exchangeable_rows(self.system) if self._independent is None else NO_ROWS
            chosen = rows_in_use(self.system, self._independent, exchange)._replace(flags=None)
        # rows not in use are redundant, but in joint coordinates some of them are zero everywhere and have no
        # reaction: there the analysis counts the redundant ones
        unused = len(self.system.phi_units) - len(chosen.numbers) + sum(exchange.left_out)
        redundant_count = len(analysis.redundant) if isinstance(self.system, Relative) else unused
        decided = RankDecisions(chosen, exchange, redundant_count > 0, analysis.nearly)
        if key:
            write_cache(key, json.dumps(decided).encode())
        return decided

    @property
    def rows(self) -> RowsInUse:
        """Constraint rows that imply all other rows, exchangeable rows included."""
        return self._rank_decisions.rows

    @property
    def exchangeable(self) -> ExchangeableRows:
        """Constraint rows of which some are redundant; a run chooses which of them to leave out."""
        return self._rank_decisions.exchangeable

    @property
    def rank(self) -> int:
        """Number of constraint rows in use at a time."""
        return len(self.rows.numbers) - int(sum(self.exchangeable.left_out))

    @property
    def redundant(self) -> bool:
        """True if redundant constraints make the joint reactions non-unique."""
        return self._rank_decisions.redundant

    @property
    def nearly_redundant(self) -> tuple[NearlyRedundant, ...]:
        """Constraints that are almost redundant, each with its treatment: kept or ignored."""
        return self._rank_decisions.nearly_redundant

    @property
    def noise(self) -> float:
        """Largest dimensionless singular value of almost redundant constraints that are ignored, else 0.

        Rounded numbers in a model file cause such singular values.
        """
        return residual(self.nearly_redundant)

    @cached_property
    def omitted(self) -> list[int]:
        """Numbers of the constraint rows not in use, if some of them are only almost redundant; else empty.

        Loops cannot satisfy such rows exactly, so that projection allows them a larger violation.
        """
        if self.noise == 0.0:
            return []
        return sorted(set(range(len(self.system.phi_units))) - set(self.rows.numbers))

    def packed(self, q: Array, v: Array, time: float = 0.0, values: dict[str, Array] | None = None) -> Array:
        """Pack the input vector x (inputs,) of native functions.

        Args:
            q: (nq,) coordinates.
            v: (nv,) velocities.
            time: s.
            values: values of parameters by name; all others have the scene's own values.
        """
        own_values = values_at(self.scene, self._scene_places)
        by_name = own_values | pieces(self.scene, time) | (values or {})
        flags = np.zeros(self.flags.stop - self.flags.start)
        flags[: len(self.exchangeable.numbers)] = self.exchangeable.left_out
        x = np.concatenate([q, v, [time], flags, *(np.ravel(by_name[name]) for name in self.parameters)])
        if self.scene.switched_forces:
            x[self.branch_flags] = np.array(self.float_system(x).switching(q, v)) > 0.0
        return x

    def float_system(self, x: Array) -> Formulation:
        """Return the equations over floats at the time and the parameters in x (inputs,)."""
        system = self.system
        if self.parameters:
            system = self._formulated(with_values(self.scene, self.values(x)))
        system.omitted = self.omitted
        return at_time(system, x[self.size])

    def _formulated(self, scene: Scene) -> Formulation:
        """Return the equations of a scene that differs from this one in the values of its parameters."""
        system = formulate(scene, self.formulation, self.alpha)
        share_model_control(system, self.system)  # inverse dynamics of controllers with a model
        return system

    def parametrized(self, x: Array) -> Scene:
        """Return the scene with the values that x (inputs,) has for the requested parameters."""
        return with_values(self.scene, self.values(x, self._requested)) if self._requested else self.scene

    def place(self, parameter: str) -> int:
        """Return the index in x (inputs,) at which a parameter begins.

        Raises:
            UnknownNameError: for a name that is no parameter of this code.
        """
        if parameter not in self.parameters:
            raise UnknownNameError("parameter", parameter, tuple(self.parameters))
        return self._places[parameter]

    @cached_property
    def _scene_places(self) -> dict[str, Place]:
        """Location in the scene of each parameter, by name."""
        return places(self.scene, self.parameters)

    @cached_property
    def _places(self) -> dict[str, int]:
        """Index in x at which each parameter begins, by name."""
        sizes = [int(np.prod(shape)) for shape in self.parameters.values()]
        starts = accumulate(sizes, initial=self.flags.stop)
        return dict(zip(self.parameters, starts, strict=False))

    def values(self, x: Array, names: Iterable[str] | None = None) -> dict[str, Any]:
        """Return the values that x (inputs,) has for some parameters, or for all if `names` is None."""
        values = {}
        for name in self.parameters if names is None else names:
            start, shape = self._places[name], self.parameters[name]
            values[name] = x[start : start + int(np.prod(shape))].reshape(shape) if shape else x[start]
        return values

    # Tracing: each method `_trace_NAME` evaluates one program over symbolic scalars q and v

    def _trace(self, name: str) -> Program:
        """Trace a program by name. Programs whose results need a description store it in `_layouts`."""
        graph = Graph()
        names = self._kinematic if name in KINEMATIC_PROGRAMS else tuple(self.parameters)
        x = graph.variables(self._length(names))
        system = self._system_of(x, names)
        if name == "output":  # the flags in x are those of the end of the run, not those of each output
            system.branches = {}
        return graph.prune(self._scalars(name, system, x))

    def _system_of(self, x: Array, names: Iterable[str]) -> Formulation:
        """Return the equations of the scene over symbolic scalars x, which end with the named parameters."""
        scene = with_values(self.scene, self.values(x, names))
        system = at_time(self._formulated(scene), x[self.size])
        system.in_use = self.rows_at(x)
        system.branches = self.branches_at(x)
        return system

    def branches_at(self, x: Array) -> dict[str, Array]:
        """Return the flags in x (inputs,) of switched forces, by identity of the force."""
        flags, first = {}, self.branch_flags.start
        for force in self.scene.switched_forces:
            flags[force.identity] = x[first : first + force.switch_count]
            first += force.switch_count
        return flags

    def rows_at(self, x: Array) -> RowsInUse:
        """Return the constraint rows `rows`, with the flags in x (inputs,) of the exchangeable ones."""
        numbers = self.exchangeable.numbers
        if not numbers:
            return self.rows
        return self.rows._replace(flags=dict(zip(numbers, x[self.row_flags], strict=True)))

    def _scalars(self, name: str, system: Formulation, x: Array) -> list[Scalar]:
        """Evaluate the results of a program by name over symbolic scalars x (inputs,)."""
        q, v = x[: system.nq], x[system.nq : self.size]
        scalars: list[Scalar] = getattr(self, f"_trace_{name}")(system, q, v)
        return scalars

    def _trace_derivative(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace (dq/dt, dv/dt, pivot ratio).

        The pivot ratio is the smallest quotient of a pivot of the elimination and its reference magnitude.
        The reference is the largest value of the pivot in some configurations that are not singular. The
        ratio is about 1 far from a singular configuration, and at most 0 if the elimination fails.
        """
        acceleration, pivot_ratio = system.sparse_acceleration(q, v, used_by(system))
        return [*system.rate(q, v), *acceleration, minimum(pivot_ratio, 1.0)]

    def _trace_jacobian(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the Jacobian (n, n) of (dq/dt, dv/dt) with respect to (q, v), row by row."""
        if self.size == 0:
            return []
        acceleration, _ = system.sparse_acceleration(q, v, used_by(system))
        rates = [*system.rate(q, v), *acceleration]
        return list(differentiate(q[0].graph, rates, [*q, *v]).ravel())

    def _trace_switching(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the switching functions of all switched forces, in the order of their flags."""
        return system.switching(q, v)

    def _trace_rate(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace dq/dt."""
        return [*system.rate(q, v)]

    def _trace_position(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace one Newton step onto the constraints: (new q, v, squared residual before, pivot ratio)."""
        norm_errors = [q[place] @ q[place] - 1.0 for place in system.quaternions]
        q = system.retract(q, np.zeros(system.nv))  # quaternions of norm 1
        phi, step, pivot_ratio = self._correction(system, q, None)
        square = self._squared_violation(phi) + sum(error * error for error in norm_errors)
        return [*system.retract(q, -step), *v, square, pivot_ratio]

    def _squared_violation(self, phi: Array) -> Scalar:
        """Compute the squared norm of dimensionless constraint residuals (k,).

        Rows in `omitted` have a smaller weight, because their violation may be as large as `loose_tolerance`
        instead of `OPEN_TOLERANCE`.
        """
        weights = np.ones(len(phi))
        if self.omitted:
            weights[self.omitted] = OPEN_TOLERANCE / loose_tolerance(self.scene.redundancy_tolerance)
        weighted = weights * phi
        return weighted @ weighted

    def _trace_velocity(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the projection of velocities: (q, new v, squared residual of positions, pivot ratio)."""
        phi, step, pivot_ratio = self._correction(system, q, v)
        return [*q, *(v - step), self._squared_violation(phi), pivot_ratio]

    def _correction(self, system: Formulation, q: Array, v: Array | None) -> tuple[Array, Array, Scalar]:
        """Compute the shortest step that removes the constraint residuals, or their rates.

        Args:
            system: the equations.
            q: (nq,) coordinates.
            v: (nv,) velocities, to remove the rates of the residuals; None to remove the residuals.

        Returns:
            Dimensionless residuals (k,) at q; the step (nv,), m or rad, or per s; the pivot ratio of the
            least-squares problem.
        """
        units = system.velocity_units
        phi, jacobian = system.phi_and_jacobian(q)
        rows, used = dimensionless_rows(system, jacobian, self.rows.numbers), used_by(system)
        phi = phi / system.phi_units
        right = phi[self.rows.numbers]
        if v is not None:  # dPhi/dt = Phi_q v + Phi_t
            phi_t = (system.phi_t() / system.phi_units)[self.rows.numbers]
            right = phi_t + [sum(entry * (v[k] / units[k]) for k, entry in row.items()) for row in rows]
        solution, pivot_ratio = least_squares(rows, right, used)
        step = np.array([units[k] * solution.get(k, 0.0) for k in range(system.nv)])
        return phi, step, minimum(pivot_ratio, 1.0)

    def _trace_ratio(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the pivot ratio of the constraint Jacobian alone, without masses."""
        rows = dimensionless_rows(system, system.phi_and_jacobian(q)[1], self.rows.numbers)
        reference_pivots = constraint_scales(self.system, self._independent, self.exchangeable)
        return [minimum(gram_factor(rows, used_by(system), reference_pivots).pivot_ratio, 1.0)]

    def pivot_ratio(self, x: Array) -> float:
        """Evaluate the pivot ratio at x (inputs,) in the same way as integrators do.

        The result is 1 far from singular configurations and falls to 0 at a singular one.
        """
        if not self.loses_rank:
            return 1.0
        ratio = float(self.function("derivative")(x)[-1])
        if ratio < NEAR_PIVOT_RATIO:  # masses alone may make it small: compare with the ratio without masses
            ratio = ratio_for_steps(ratio, float(self.function("ratio")(x)[0]))
        return ratio

    def _trace_shares(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace what a run needs to decide whether to exchange constraint rows.

        A left-out row is a combination of the rows in use; the coefficient of a row in use is its share. A
        share far above 1 shows that the left-out row would be the better choice.

        Returns:
            The square of the largest share, then the nonzeros of the dimensionless constraint Jacobian. The
            layout lists the indices of the nonzeros in the flattened matrix (k, nv).
        """
        # Gram matrix (inner products) of the rows in use, factorized
        exchange, used = self.exchangeable, used_by(system)
        rows = dimensionless_rows(system, system.phi_and_jacobian(q)[1], self.rows.numbers)
        factor, flags, count = gram_factor(rows, used), used.flags or {}, len(exchange.numbers)
        # weights (sums, count) of the exchangeable rows: each row alone, or, if there are many, sums of all
        # rows with random signs
        weights = np.eye(count)
        if count > MAX_ROW_SUMS:
            weights = np.random.default_rng(0).choice([-1.0, 1.0], (MAX_ROW_SUMS, count))
        positions = [used.numbers.index(number) for number in exchange.numbers]  # indices into `rows`
        least: Scalar = 0.0  # minus the square of the largest share
        for row_weights in weights / np.array(exchange.units):  # units: magnitudes of the rows
            # sum of the left-out rows: a flag is 0 for a row in use, which therefore adds nothing
            left_out: dict[int, Scalar] = {}
            for position, number, weight in zip(positions, exchange.numbers, row_weights, strict=True):
                for k, entry in rows[position].items() if weight != 0.0 else ():
                    add(left_out, k, flags[number] * (weight * entry))
            # coefficients of the rows in use, by least squares with the factorized Gram matrix
            right = {n: dot(row, left_out) for n, row in enumerate(rows)}
            shares = factor.solve({n: x for n, x in right.items() if not is_zero(x)})
            for position, unit in zip(positions, exchange.units, strict=True):
                share = unit * shares.get(position, 0.0)
                least = minimum(least, -(share * share))
        self._layouts["shares"] = [system.nv * n + k for n, row in enumerate(rows) for k in row]
        return [-least, *(entry for row in rows for entry in row.values())]

    def _trace_retract(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace q after a step. The step (nv,), m or rad, is passed in place of the velocities v."""
        return [*system.retract(q, v)]

    def _trace_surface(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace what dense projection near a singular configuration needs, all dimensionless.

        Constraint rows in `omitted` and rows that are zero everywhere are left out.

        Returns:
            Constraint residuals Phi, their rates dPhi/dt, nonzeros of the constraint Jacobian Phi_q, nonzeros
            of the mass matrix M on and below its diagonal. The layout has the number of rows, and the indices
            of the nonzeros in the flattened matrices Phi_q (k, nv) and M (nv, nv).
        """
        # residuals and their rates dPhi/dt = Phi_q v + Phi_t
        units, phi_units = self.system.velocity_units, self.system.phi_units
        phi, jacobian = system.phi_and_jacobian(q)
        phi_t = system.phi_t()
        kept = [i for i in range(len(phi)) if i not in self.omitted and (jacobian[i] or not is_zero(phi[i]))]
        scalars: list[Scalar] = [phi[i] / phi_units[i] for i in kept]
        for i in kept:
            rate = sum(entry * v[k] for k, entry in jacobian[i].items()) + phi_t[i]
            scalars.append(rate / phi_units[i])
        # constraint Jacobian
        jacobian_places: list[int] = []
        for row, i in enumerate(kept):
            jacobian_places.extend(system.nv * row + k for k in jacobian[i])
            scalars.extend(entry * (units[k] / phi_units[i]) for k, entry in jacobian[i].items())
        # lower triangle of the mass matrix
        mass_places: list[int] = []
        for i, entries in enumerate(system.mass_rows(q)):
            lower = [k for k in entries if k <= i]
            mass_places.extend(system.nv * i + k for k in lower)
            scalars.extend(entries[k] * (units[i] * units[k]) for k in lower)
        self._layouts["surface"] = len(kept), (jacobian_places, mass_places)
        return scalars

    def _trace_output(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the arrays that the scene asks for, one after another.

        The layout has the first index, the end index and the shape of each array by name.
        """
        # 1. evaluate the system; accelerations only if an output needs them
        wanted = self.scene.outputs
        if self.scene.needs_accelerations:
            evaluation, pivot_ratio = system.sparse_evaluation(q, v, used_by(system))
            observation: Observation = evaluation
        else:
            observation = system.observe(q, v)
        # 2. collect the arrays by name
        state = observation.state
        arrays: dict[str, Any] = {"position": state.position, "quaternion": state.quaternion}
        if state.angles:  # angles with full revolutions, on which forces or couplings depend
            arrays["joint_angle"] = np.array(list(state.angles.values()))
        if "velocities" in wanted:
            arrays["linear_velocity"] = state.linear_velocity
            arrays["angular_velocity"] = state.angular_velocity
        if "reactions" in wanted:
            arrays["reaction_force"] = evaluation.reaction_force
            arrays["reaction_torque"] = evaluation.reaction_torque
        if "actuation" in wanted:
            arrays["actuator_force"] = evaluation.actuator_force
        if "energy" in wanted:
            arrays["kinetic_energy"] = np.array(observation.kinetic_energy)
            arrays["potential_energy"] = np.array(observation.potential_energy)
        if self.scene.tracks_work:  # the state contains the work of forces without potential energy
            arrays["work"] = np.array(q[system.work][0])
        if "violation" in wanted or self.stabilization != "projection":  # then runs check for open joints
            arrays["phi"] = system.joint_phi(q)
        if "reactions" in wanted:
            arrays["pivot_ratio"] = np.array(minimum(pivot_ratio, 1.0))
        # 3. one list of scalars and its layout
        layout: dict[str, tuple[int, int, tuple[int, ...]]] = {}
        scalars: list[Scalar] = []
        for name, array in arrays.items():
            layout[name] = len(scalars), len(scalars) + array.size, array.shape
            scalars.extend(array.ravel())
        self._layouts["output"] = layout
        return scalars

    def _trace_measured(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the joint coordinates that controllers measure (m or rad), then their rates."""
        measured = system.measure(q, v)
        return [*(coordinate for coordinate, _ in measured), *(rate for _, rate in measured)]


def used_by(system: Formulation) -> RowsInUse:
    """Return the constraint rows that `CompiledEquations` has set for a system over symbolic scalars."""
    assert system.in_use is not None
    return system.in_use
