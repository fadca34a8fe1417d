"""Runs of compiled scenes: native methods on the scene's native functions, no Python inside a step."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from newton_euler.codegen.compile import lane_count
from newton_euler.codegen.native import Callback, Record
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.compiled.callbacks import (
    EQUATION_ERRORS,
    DenseCallbacks,
    raise_fatal,
    vector_at,
)
from newton_euler.compiled.constraint_groups import group_places
from newton_euler.compiled.equations import OPEN_TOLERANCE, CompiledEquations
from newton_euler.compiled.failures import UNSTABLE_STATUSES, failure
from newton_euler.compiled.outputs import Outputs, loops
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.row_choice import exchanged
from newton_euler.errors import OptionError
from newton_euler.integrators.constraint_ratio import ConstraintRatio, Progress
from newton_euler.integrators.dense_projection import RESIDUAL_ROUND_OFF, Closing, closing_of, unprepared
from newton_euler.integrators.dop853 import CONTROLS, Dop853, integrate_dop853
from newton_euler.integrators.fixed_step import FixedStep, divisions, integrate_fixed
from newton_euler.integrators.options import FIXED, Options, most_steps
from newton_euler.integrators.projection import project
from newton_euler.integrators.radau import Radau, integrate_radau
from newton_euler.integrators.row_exchange import EXCHANGED, RowExchange, no_exchange
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    ANGLE,
    COUNTS,
    QUATERNION,
    QUATERNION_WITH_RATES,
    Count,
    Equations,
    Table,
)
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

MAX_EXAMINED = 8
"""Outputs of a run among which states are examined to explain how it ended."""

MAX_REPEATED_STEPS, MAX_EXAMINED_STEPS = 10_000, 200
"""Fixed steps since the last output that are made again to explain how a run ended; states are examined among
the last of them."""

COMPILATION_LOCK = threading.Lock()
"""Held while functions are compiled: threads that need the same wait for one of them."""

METHODS: dict[str, Callable[..., None]] = {
    "DOP853": integrate_dop853,
    "Radau": integrate_radau,
    **dict.fromkeys(FIXED, integrate_fixed),
}


@lru_cache
def native_method(method: Callable[..., Any], in_lanes: bool = False) -> NativeFunctions:
    """Compile a method, which no scene changes, once, for one run after another or for several in lanes."""
    return NativeFunctions([method], in_lanes)


def load(code: CompiledEquations, integrator: str) -> None:
    """Make everything ready that a run needs."""
    native_method(METHODS[integrator])
    loops()
    for name in needed(code, integrator):
        code.function(name)


def needed(code: CompiledEquations, integrator: str) -> list[str]:
    """Return the names of the functions that a run needs."""
    names = ["derivative", "output"] + ["position", "velocity"] * code.projects
    names += ["shares"] * (len(code.exchangeable.numbers) > 0)
    names += {"Euler": ["rate"], "Radau": ["jacobian"]}.get(integrator, [])
    return names + ["measured"] * bool(code.scene.sampled)


def marks(code: CompiledEquations, integrator: str) -> Array:
    """Mark angles and Euler parameters (size,), see `newton_euler.integrators.stepper`; others are 0.

    Norms that Baumgarte's method governs are its own, but for those that Euler's method leaves behind.
    """
    marked = np.zeros(code.size)
    marked[code.system.uncounted_angles] = ANGLE
    cartesian = isinstance(code.system, Cartesian)
    if not (cartesian and code.stabilization == "baumgarte" and integrator != "Euler"):
        starts = [place.start for place in code.system.quaternions]
        marked[starts] = QUATERNION_WITH_RATES if cartesian else QUATERNION
    return marked


def round_off_units(code: CompiledEquations) -> Array:
    """Return the units (size,) below which coordinates have the absolute round-off of their unit.

    Carried angles have the unit 1. Velocities and the work have none: their round-off is relative.
    """
    system, found = code.system, np.zeros(code.size)
    found[: system.carried.start] = system.coordinate_units
    found[system.carried] = 1.0
    return found


class Fallback(DenseCallbacks):
    """Callbacks of a run into Python: singular states, by the dense float form, and interrupts."""

    def __init__(self, code: CompiledEquations, counts: Array, stopped: Sequence[bool] = ()) -> None:
        super().__init__(counts, stopped)
        self._code = code
        self.derivative = self.guarded(self._derivative, self._failed)

    def _derivative(self, x: int, y: int, on: int) -> None:
        state, results = vector_at(x, self._code.inputs).copy(), vector_at(y, self._code.size + 1)
        system = self._code.float_system(state)
        q, v = state[: system.nq], state[system.nq : self._code.size]
        with np.errstate(all="ignore"):  # the method checks what comes back
            results[:-1] = np.concatenate([system.rate(q, v), system.acceleration(q, v)])
        results[-1] = 1.0

    def _failed(self, y: int, on: int) -> None:
        vector_at(y, self._code.size + 1)[-1] = -1.0


class Integrator:
    """A method on a compiled scene over given times, ready to run from many starts; one thread at a time.

    Attributes:
        times: (n,) s, its own copy, to be overwritten for a run over other times.
        x: (inputs,) the state with time and parameters: the start, and after the run where it ended.
        table: (n, size) the states at all times after a run, as far as `outputs` needs them.
        outputs: the arrays that the scene asks for.
        counts: (COUNTS,) of the run, see `newton_euler.integrators.stepper`.
        steps: (room, size + 2 + flags) the first steps, see `newton_euler.integrators.dop853.Dop853`.
    """

    def __init__(
        self,
        code: CompiledEquations,
        times: Array,
        options: Options,
        stopped: Sequence[bool] = (),
        room: int = 0,
    ) -> None:
        """Make everything ready; a run stops if `stopped`, which other threads may fill, holds something."""
        functions = (f for each in code.scene.functions.values() for f in each)
        if options.rest and not all(f.is_constant for f in functions):
            raise OptionError("rest", options.rest, "0 for a scene with functions of time other than Steps")
        self._code, self._options, self._stopped = code, options, stopped
        self.times, self.x, self.counts = times.copy(), np.zeros(code.inputs), np.zeros(COUNTS)
        self._python = Fallback(code, self.counts, stopped)
        self.table, self.steps = np.zeros((len(times), code.size)), np.zeros((room, code.flags.stop + 1))
        marked = marks(code, options.integrator)
        system = equations(code, self._python, code.function("derivative"), marked)
        table = table_of(code, self.times, self.x[None], self.table[None], np.zeros((1, COUNTS)))
        method = method_of(code, options, self.steps)
        self.outputs = Outputs(code, self.times, self.x[None], self.table[None], np.zeros(1))
        integrate = METHODS[options.integrator]
        self._run = native_method(integrate).bind(integrate, system, table, method)

    def __call__(self, x: Array) -> None:
        """Run from x (inputs,).

        Raises:
            IntegrationError: with the time reached, the reason and the joint.
        """
        self.x[:] = x
        error, status = self._execute(), int(self.counts[Count.STATUS])
        if status != Status.DONE or error is not None:
            # a run that goes on to another end has recovered from an error of the dense form
            error = error or (self._python.error if status == Status.SINGULAR else None)
            passed: list[Array] = []
            if self._options.step is not None and error is None and status in UNSTABLE_STATUSES:
                passed = [x, *self._outputs_passed(), *self._steps_passed()]
            raise failure(self._code, self._options, status, [*passed, self.x], self.counts, error)

    def _execute(self) -> Exception | None:
        """Run from `x`, interruptibly; return the error of the equations that ended the run, if one did.

        Raises:
            KeyboardInterrupt: if the user or `stopped` asks for it.
            BaseException: a mistake of the program.
        """
        python = self._python
        python.begin()
        with python.interruptible():
            self._run()
        if isinstance(python.fatal, EQUATION_ERRORS):
            return python.fatal
        if python.fatal is not None:
            raise python.fatal
        if self.counts[Count.STATUS] == Status.INTERRUPTED:
            raise KeyboardInterrupt
        return None

    def _outputs_passed(self) -> list[Array]:
        """Return some states (inputs,) of a run by fixed steps at its outputs."""
        written = int(self.counts[Count.ROWS_WRITTEN])
        return [self._row(row) for row in range(1, written, written // MAX_EXAMINED + 1)]

    def _steps_passed(self) -> list[Array]:
        """Return the last states (inputs,) of a run by fixed steps since its last output.

        These steps are made once more, with an output at each.
        """
        assert self._options.step is not None
        last = int(self.counts[Count.ROWS_WRITTEN]) - 1
        if last < 0 or last + 1 >= len(self.times):
            return []
        begin, end = self.times[last : last + 2]
        count = divisions(end - begin, self._options.step)
        if count > MAX_REPEATED_STEPS:
            return []
        again = Integrator(self._code, np.linspace(begin, end, count + 1), self._options, self._stopped)
        again.x[:] = self._row(last)
        again._execute()  # to where it ended, whatever ended it
        written = int(again.counts[Count.ROWS_WRITTEN])
        return [again._row(row) for row in range(max(1, written - MAX_EXAMINED_STEPS), written)]

    def _row(self, row: int) -> Array:
        """Return the state (inputs,) in a row of the table, of which the method has written all."""
        x, n = self.x.copy(), self._code.size
        x[: n + 1] = [*self.table[row], self.times[row]]
        return x

    def attempt(self, x: Array) -> tuple[Array, IntegrationError | None]:
        """Run from x (inputs,): results (n, outputs) at the n times that were reached, and the error before
        the last of all times."""
        stopped: IntegrationError | None = None
        try:
            self(x)
        except IntegrationError as error:
            stopped = error
        rows, results = int(self.counts[Count.ROWS_WRITTEN]), np.empty(self.outputs.shape)
        while rows > 0:
            try:
                self.outputs(results, rows)
                break
            except IntegrationError as error:
                stopped, rows = stopped or error, int(np.searchsorted(self.times, error.time))
        return results[:rows], stopped


def equations(
    code: CompiledEquations, python: DenseCallbacks, derivative: Callback, marked: Array
) -> Equations:
    """Return a scene's native functions as methods call them: in lanes, if the counts (COUNTS, lanes) of the
    callbacks are of as many runs."""
    in_lanes = python.counts.ndim > 1
    position, velocity = (
        code.function(name, in_lanes) if code.projects else None for name in ("position", "velocity")
    )
    lanes = position.lanes if position else 1
    return Equations(
        n=code.size,
        nq=code.system.nq,
        inputs=code.inputs,
        derivative=derivative,
        dense=python.derivative,
        loses_rank=int(code.loses_rank),
        ratio=ratio_on_demand(code, python, in_lanes),
        projecting=int(code.projects),
        tolerance=RESIDUAL_ROUND_OFF,
        open_tolerance=OPEN_TOLERANCE,
        lanes=1 if in_lanes else lanes,
        position=position,
        velocity=velocity,
        closing=closing_on_demand(code, python, in_lanes),
        exchange=exchange_of(code, python, in_lanes),
        projection_work=np.zeros((code.inputs + code.size + 3, lanes)),
        pause=python.pause,
        marks=marked,
        groups=int(code.groups.max(initial=0.0)),
        members=group_places(code.groups, code.system.nq),
        counts=python.counts,
    )


def closing_on_demand(code: CompiledEquations, python: DenseCallbacks, in_lanes: bool) -> Closing:
    """Return a record to close a scene with, whose functions are compiled when a run first comes near a
    singular configuration."""

    def prepare(x: int, y: int, on: int) -> None:
        with COMPILATION_LOCK:
            retract, surface = (code.function(name, in_lanes) for name in ("retract", "surface"))
        system, (constraints, places) = code.system, surface.layout
        functions, lanes = (retract, surface), surface.lanes
        units = system.velocity_units
        closing.overwrite_with(
            closing_of(system.nq, units, code.inputs, places, constraints, functions, lanes)
        )

    closing = unprepared(python.guarded(prepare), code.system.nq, code.system.nv)
    return closing


def ratio_on_demand(code: CompiledEquations, python: DenseCallbacks, in_lanes: bool) -> ConstraintRatio:
    """Return a record of the constraints alone, whose function is compiled when pivots are first small."""

    def prepare(x: int, y: int, on: int) -> None:
        with COMPILATION_LOCK:
            function = code.function("ratio", in_lanes)
        ratio.overwrite_with(ConstraintRatio(Progress.READY, None, function, found))

    found = np.zeros((1, lane_count() if in_lanes else 1))
    ratio = ConstraintRatio(Progress.UNPREPARED, python.guarded(prepare), None, found)
    return ratio


def exchange_of(code: CompiledEquations, python: DenseCallbacks, in_lanes: bool) -> RowExchange:
    """Return the record of a scene's exchangeable rows."""
    rows = code.exchangeable
    if not rows.numbers:
        return no_exchange(code.flags.start)
    shares, units = code.function("shares", in_lanes), np.array(rows.units)
    places = [code.rows.numbers.index(number) for number in rows.numbers]
    lanes = shares.lanes if in_lanes else 1

    def exchange(x: int, y: int, on: int) -> None:
        inputs = vector_at(x, code.inputs * lanes).reshape(-1, lanes)
        results = vector_at(y, shares.outputs * lanes).reshape(-1, lanes)
        for lane in range(lanes):
            if on >> lane & 1:
                jacobian = np.zeros(len(code.rows.numbers) * code.system.nv)
                jacobian[shares.layout] = results[1:, lane]
                flags = inputs[code.flags, lane]
                matrix = jacobian.reshape(-1, code.system.nv)
                better = exchanged(matrix, places, units, flags)
                if not np.array_equal(better, flags):
                    inputs[code.flags, lane] = better
                    results[0, lane] = EXCHANGED

    return RowExchange(
        count=len(rows.numbers),
        first=code.flags.start,
        shares=shares,
        exchange=python.guarded(exchange),
        found=np.zeros((shares.outputs, lanes)),
    )


def table_of(
    code: CompiledEquations, times: Array, ends: Array, states: Array, tallies: Array, lanes: int = 1
) -> Table:
    """Return a table of as many runs as there are ends; each lane makes the first one that is its own."""
    first = np.arange(float(lanes))
    return Table(len(times), code.output_state_size, len(ends), lanes, first, times, ends, states, tallies)


def method_of(code: CompiledEquations, options: Options, steps: Array, lanes: int = 1) -> Record:
    """Return a method with its state and scratch, for a run in each lane, and room for steps of one."""
    n, most = code.size, most_steps(options)

    def scratch(*shape: int) -> Array:
        return np.zeros((*shape, lanes))

    if options.step is not None:
        euler = options.integrator == "Euler"
        return FixedStep(
            number=FIXED.index(options.integrator),
            step=options.step,
            rate=code.function("rate", lanes > 1) if euler else None,
            now=scratch(code.inputs),
            at=scratch(code.inputs),
            k=scratch(4, n + 1),
            change=scratch(n),
            control=scratch(2),
        )
    if options.integrator == "DOP853":
        near = options.near(code.noise, code.scene.mechanism.size)
        return dop853_of(n, code.inputs, options, near, most, round_off_units(code), steps, lanes)
    return radau_of(n, code.inputs, options, most, code.function("jacobian"), lanes)


def dop853_of(
    n: int,
    inputs: int,
    options: Options,
    near: tuple[float, float],
    most: int,
    units: Array,
    steps: Array | None = None,
    lanes: int = 1,
) -> Dop853:
    """Return DOP853 with its state and scratch; arguments as of its attributes."""
    steps = np.zeros((0, n + 2)) if steps is None else steps

    def scratch(*shape: int) -> Array:
        return np.zeros((*shape, lanes))

    return Dop853(
        rtol=options.rtol,
        atol=options.atol,
        near_rtol=near[0],
        near_atol=near[1],
        max_steps=most,
        rest=options.rest,
        units=units,
        now=scratch(inputs),
        at=scratch(inputs),
        end=scratch(inputs),
        projected=scratch(inputs),
        k=scratch(16 * (n + 1) + 1),
        terms=scratch(7, n),
        room=len(steps),
        steps=steps,
        round_off=scratch(n),
        control=scratch(CONTROLS),
    )


def radau_of(n: int, inputs: int, options: Options, most: int, jacobian: Callback, lanes: int = 1) -> Radau:
    """Return Radau with its state and scratch; arguments as of its attributes."""

    def scratch(*shape: int) -> Array:
        return np.zeros((*shape, lanes))

    return Radau(
        rtol=options.rtol,
        atol=options.atol,
        max_steps=most,
        jacobian=jacobian,
        now=scratch(inputs),
        at=scratch(inputs),
        projected=scratch(inputs),
        before=scratch(n),
        slope=scratch(n + 2),
        z=scratch(3, n),
        w=scratch(3, n),
        f=scratch(3, n + 1),
        change=scratch(3 * n + 2),
        terms=scratch(3, n),
        matrix=scratch(n, n),
        real=scratch(n, n),
        re=scratch(n, n),
        im=scratch(n, n),
        pivots=scratch(2, n),
    )


class Projection:
    """Projection of states onto the constraints of a scene."""

    def __init__(self, code: CompiledEquations) -> None:
        self._python, self._projects = Fallback(code, np.zeros(COUNTS)), code.projects
        self.x = np.zeros(code.inputs)
        rates = self._python.derivative  # projection calls none, and compiling them takes time
        system = equations(code, self._python, rates, np.zeros(code.size))
        self._run = native_method(project).bind(project, system, 1, self.x)

    def __call__(self, x: Array) -> bool:
        """Change x (inputs,) by the least that meets the constraints; False if that cannot be done."""
        if not self._projects:
            return True
        self.x[:] = x
        self._python.begin()
        status = self._run()
        raise_fatal(self._python)
        if status != Status.DONE:
            return False
        x[:] = self.x
        return True
