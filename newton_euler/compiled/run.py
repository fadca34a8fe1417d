"""Integrate a compiled scene: bind its native functions to a native integrator and run it.

No Python runs inside a step, except near singular configurations, where constraints become dependent. An
`Integrator` turns an initial state into a table of states at given output times. Native functions read one
vector x (inputs,): the state (q, v), the time, flags, and parameters of the scene. A flag is 1 for a
redundant constraint row that is left out, else 0.

The other functions build records: structures of sizes, function pointers and work arrays that the native
integrators in `newton_euler.integrators` read. Their classes there describe the fields. Native code can
integrate several runs at once, each in one *lane* of the processor's vector registers
(`newton_euler.compiled.lanes`). Arrays then have an additional last axis for the lanes.
"""

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
from newton_euler.integrators.constraint_ratio import Availability, ConstraintRatio
from newton_euler.integrators.dense_projection import RESIDUAL_ROUND_OFF, Closing, closing_of, unprepared
from newton_euler.integrators.dop853 import CONTROLS, Dop853, integrate_dop853
from newton_euler.integrators.fixed_step import FixedStep, divisions, integrate_fixed
from newton_euler.integrators.options import FIXED, Options, max_adaptive_steps
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
"""Number of output states of a run with fixed steps that are examined for the cause of an early stop."""

MAX_REPEATED_STEPS = 10_000
"""Number of fixed steps since the last output above which these steps are not repeated to examine them."""

MAX_EXAMINED_STEPS = 200
"""Number of states at the end of the repeated steps that are examined for the cause of an early stop."""

COMPILATION_LOCK = threading.Lock()
"""Lock held during compilation, so that threads that need the same function do not compile it twice."""

METHODS: dict[str, Callable[..., None]] = {
    "DOP853": integrate_dop853,
    "Radau": integrate_radau,
    **dict.fromkeys(FIXED, integrate_fixed),
}
"""Native functions of the integrators by name."""


@lru_cache
def native_method(method: Callable[..., Any], in_lanes: bool = False) -> NativeFunctions:
    """Compile an integrator, once per process: its code is the same for all scenes.

    Args:
        method: one of the functions of `METHODS`, or another native function of a scene's equations.
        in_lanes: True for code that integrates several runs at once, one in each lane of a vector register.
    """
    return NativeFunctions([method], in_lanes)


def load_code(code: CompiledEquations, integrator: str) -> None:
    """Compile, or load from the cache, all functions that a run with an integrator needs."""
    native_method(METHODS[integrator])
    loops()  # the native code that evaluates the outputs of all states
    for name in needed(code, integrator):
        code.function(name)


def needed(code: CompiledEquations, integrator: str) -> list[str]:
    """Return the names of the scene's functions that a run with an integrator needs."""
    names = ["derivative", "output"]
    if code.projects:
        names += ["position", "velocity"]
    if code.exchangeable.numbers:
        names += ["shares"]  # whether to exchange redundant constraint rows, see `exchange_of`
    names += {"Euler": ["rate"], "Radau": ["jacobian"]}.get(integrator, [])
    if code.scene.sampled:
        names += ["measured"]  # the joint coordinates that digital controllers read
    return names


def marks(code: CompiledEquations, integrator: str) -> Array:
    """Mark the coordinates that an integrator wraps or normalizes after each step.

    Angles of which only the value modulo 2 pi matters are wrapped; quaternions are normalized. Under
    Baumgarte stabilization the Cartesian equations control the norms of quaternions themselves, so these are
    not marked. Only semi-implicit Euler still needs the normalization.

    Returns:
        (size,) `ANGLE` for an angle, `QUATERNION` or `QUATERNION_WITH_RATES` for the first element of a
        quaternion, else 0.
    """
    marked = np.zeros(code.size)
    marked[code.system.uncounted_angles] = ANGLE
    cartesian = isinstance(code.system, Cartesian)
    if not (cartesian and code.stabilization == "baumgarte" and integrator != "Euler"):
        starts = [place.start for place in code.system.quaternions]
        marked[starts] = QUATERNION_WITH_RATES if cartesian else QUATERNION
    return marked


def round_off_units(code: CompiledEquations) -> Array:
    """Return the magnitudes (size,) below which the round-off of a coordinate is constant, m or rad.

    A coordinate that is smaller than its magnitude has the round-off of the magnitude. The magnitude is 0 for
    velocities and for the work of forces, which is in q if the scene tracks it: their round-off is relative.
    """
    system, magnitudes = code.system, np.zeros(code.size)
    magnitudes[: system.carried.start] = system.coordinate_units
    magnitudes[system.carried] = 1.0  # rad, additional angles in q that count full revolutions
    return magnitudes


class Fallback(DenseCallbacks):
    """Callbacks of a single run: dense equations of motion in Python at singular states, and interrupts.

    Native code passes the addresses x of the input and y of the results, and a mask `on` of active lanes.
    """

    def __init__(self, code: CompiledEquations, counts: Array, stopped: Sequence[bool] = ()) -> None:
        """Prepare the callbacks.

        Args:
            code: compiled equations of the scene, which also give the equations over floats.
            counts: (COUNTS,) counters of the run, see `newton_euler.integrators.stepper.Count`.
            stopped: a list that other threads may append to; the run stops if the list is not empty.
        """
        super().__init__(counts, stopped)
        self._code = code
        self.derivative = self.guarded(self._derivative, self._failed)

    def _derivative(self, x: int, y: int, on: int) -> None:
        """Write dq/dt, dv/dt and 1.0 to address y, for the state, time and parameters at address x."""
        state, results = vector_at(x, self._code.inputs).copy(), vector_at(y, self._code.size + 1)
        system = self._code.float_system(state)
        q, v = state[: system.nq], state[system.nq : self._code.size]
        with np.errstate(all="ignore"):  # the integrator checks that rates are finite
            results[:-1] = np.concatenate([system.rate(q, v), system.acceleration(q, v)])
        results[-1] = 1.0  # in place of the pivot ratio: the rates are valid

    def _failed(self, y: int, on: int) -> None:
        """Mark the rates at address y as missing, after an exception of the equations."""
        vector_at(y, self._code.size + 1)[-1] = -1.0


class Integrator:
    """A native integrator bound to a compiled scene and its output times, to run from many initial states.

    Each thread needs its own object.

    Attributes:
        times: (n,) s, output times. Overwrite the elements to run over other times.
        x: (inputs,) state, time, flags and parameters: where the run starts, afterwards where it ended.
        table: (n, size) states at the output times after a run. If the outputs need no velocities, only the
            coordinates are written.
        outputs: evaluates the arrays that the scene asks for.
        counts: (COUNTS,) counters of the run, see `newton_euler.integrators.stepper.Count`.
        steps: (room, size + 2 + flags) state, time and flags at the start of each of the first steps of
            DOP853, and the size of the step, s.
    """

    def __init__(
        self,
        code: CompiledEquations,
        times: Array,
        options: Options,
        stopped: Sequence[bool] = (),
        room: int = 0,
    ) -> None:
        """Bind the scene's functions to the integrator and allocate its memory.

        Args:
            code: compiled equations of the scene.
            times: (n,) s, output times; the first is the start.
            options: integrator and step control.
            stopped: a list that other threads may append to; the run stops if the list is not empty.
            room: number of steps to keep in `steps`.

        Raises:
            OptionError: if the option `rest` ends runs at rest although functions of time may move the scene.
        """
        functions = (f for of_element in code.scene.functions.values() for f in of_element)
        if options.rest and not all(f.is_constant for f in functions):
            raise OptionError("rest", options.rest, "0 for a scene with functions of time other than Steps")
        self._code, self._options, self._stopped = code, options, stopped
        self.times, self.x, self.counts = times.copy(), np.zeros(code.inputs), np.zeros(COUNTS)
        self._python = Fallback(code, self.counts, stopped)
        self.table, self.steps = np.zeros((len(times), code.size)), np.zeros((room, code.flags.stop + 1))
        marked = marks(code, options.integrator)
        system = equations(code, self._python, code.function("derivative"), marked)
        starts, states = self.x[None], self.table[None]  # views with a leading axis for the single run
        table = table_of(code, self.times, starts, states, tallies=np.zeros((1, COUNTS)))
        method = method_of(code, options, self.steps)
        self.outputs = Outputs(code, self.times, starts, states, result_numbers=np.zeros(1))
        integrate = METHODS[options.integrator]
        self._run = native_method(integrate).bind(integrate, system, table, method)

    def __call__(self, x: Array) -> None:
        """Run from x (inputs,): state, time, flags and parameters.

        Raises:
            IntegrationError: if the run stops early, with the time reached, the reason and the joint.
        """
        self.x[:] = x
        error, status = self._execute(), int(self.counts[Count.STATUS])
        if status != Status.DONE or error is not None:
            # the integrator may recover from an error of the dense equations and stop later for another
            # reason, so the last error counts only if the run ended as singular
            error = error or (self._python.error if status == Status.SINGULAR else None)
            # earlier states show whether a fixed step was too long
            earlier: list[Array] = []
            if self._options.step is not None and error is None and status in UNSTABLE_STATUSES:
                earlier = [x, *self._outputs_passed(), *self._steps_passed()]
            raise failure(self._code, self._options, status, [*earlier, self.x], self.counts, error)

    def _execute(self) -> Exception | None:
        """Run from the vector `self.x`; Ctrl-C stops the run.

        Returns:
            The error of the equations that ended the run, or None.

        Raises:
            KeyboardInterrupt: if the user pressed Ctrl-C or `stopped` is not empty.
            BaseException: the exception, a programming error, that ended the run in a callback.
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
        """Return up to `MAX_EXAMINED` vectors x (inputs,) of a run with fixed steps at its output times."""
        written = int(self.counts[Count.ROWS_WRITTEN])
        return [self._row(row) for row in range(1, written, written // MAX_EXAMINED + 1)]

    def _steps_passed(self) -> list[Array]:
        """Return the last vectors x (inputs,) of a run with fixed steps since its last output.

        The run repeats these steps, with an output at each of them. The result is empty for too many steps.
        """
        assert self._options.step is not None
        last = int(self.counts[Count.ROWS_WRITTEN]) - 1
        if last < 0 or last + 1 >= len(self.times):
            return []
        begin, end = self.times[last : last + 2]
        count = divisions(end - begin, self._options.step)
        if count > MAX_REPEATED_STEPS:
            return []
        repeated = Integrator(self._code, np.linspace(begin, end, count + 1), self._options, self._stopped)
        repeated.x[:] = self._row(last)
        repeated._execute()  # stops where this run stopped; the reason does not matter here
        written = int(repeated.counts[Count.ROWS_WRITTEN])
        return [repeated._row(row) for row in range(max(1, written - MAX_EXAMINED_STEPS), written)]

    def _row(self, row: int) -> Array:
        """Return the vector x (inputs,) of a row of the table, with velocities: only for fixed steps."""
        x, n = self.x.copy(), self._code.size
        x[: n + 1] = [*self.table[row], self.times[row]]
        return x

    def attempt(self, x: Array) -> tuple[Array, IntegrationError | None]:
        """Run from x (inputs,) and evaluate the outputs; do not raise if the run stops early.

        Returns:
            Results (rows, outputs) at the output times reached; the error that stopped the run, or None.
        """
        stopped: IntegrationError | None = None
        try:
            self(x)
        except IntegrationError as error:
            stopped = error
        # outputs may fail at a state; then only earlier ones are evaluated
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
    """Return the record of a scene's native functions that integrators read.

    Args:
        code: compiled equations of the scene.
        python: callbacks into Python. If its counters are of several runs, (COUNTS, lanes), the functions
            evaluate one state for each lane.
        derivative: computes dq/dt, dv/dt and the pivot ratio, which is about 1 far from singular
            configurations and at most 0 if the elimination fails.
        marked: (size,) marks of angles and quaternions, see `marks`.
    """
    # projection functions take several states per call: one of each run, or several outputs of a single run
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
        # x, projected state, squared residual, pivot ratio, and squared residual of the step before
        projection_work=np.zeros((code.inputs + code.size + 3, lanes)),
        pause=python.pause,
        marks=marked,
        # number and members of the groups of coordinates and velocities that constraints connect
        groups=int(code.groups.max(initial=0.0)),
        members=group_places(code.groups, code.system.nq),
        counts=python.counts,
    )


def closing_on_demand(code: CompiledEquations, python: DenseCallbacks, in_lanes: bool) -> Closing:
    """Return the record for projection with dense matrices, which works near singular configurations.

    Its functions are compiled when a run first comes near a singular configuration.

    Args:
        code: compiled equations of the scene.
        python: callbacks into Python.
        in_lanes: True for functions that evaluate one state for each lane.
    """

    def prepare(x: int, y: int, on: int) -> None:
        """Compile the functions and fill in the record; native code calls this at the first use.

        The addresses x and y and the mask `on` of active lanes, which native code passes, are not needed.
        """
        with COMPILATION_LOCK:
            # `retract` moves coordinates by a step; `surface` evaluates constraint residuals and rates, and
            # the nonzeros, at `places`, of the constraint Jacobian and of the mass matrix
            retract, surface = (code.function(name, in_lanes) for name in ("retract", "surface"))
        constraints, places = surface.layout
        prepared = closing_of(
            nq=code.system.nq,
            units=code.system.velocity_units,
            inputs=code.inputs,
            places=places,
            constraints=constraints,
            functions=(retract, surface),
            lanes=surface.lanes,
        )
        closing.overwrite_with(prepared)

    closing = unprepared(python.guarded(prepare), code.system.nq, code.system.nv)
    return closing


def ratio_on_demand(code: CompiledEquations, python: DenseCallbacks, in_lanes: bool) -> ConstraintRatio:
    """Return the record of the pivot ratio of the constraints, which shows how close a state is to singular.

    The pivot ratio of the equations of motion is small also if masses differ much; this one ignores masses.
    Its function is compiled when the pivots of the equations of motion are small for the first time.

    Args:
        code: compiled equations of the scene.
        python: callbacks into Python.
        in_lanes: True for functions that evaluate one state for each lane.
    """

    def prepare(x: int, y: int, on: int) -> None:
        """Compile the function and fill in the record; native code calls this at the first use."""
        with COMPILATION_LOCK:
            function = code.function("ratio", in_lanes)
        ratio.overwrite_with(
            ConstraintRatio(Availability.COMPILED, prepare=None, evaluate=function, results=results)
        )

    results = np.zeros((1, lane_count() if in_lanes else 1))
    ratio = ConstraintRatio(
        Availability.NOT_COMPILED, prepare=python.guarded(prepare), evaluate=None, results=results
    )
    return ratio


def exchange_of(code: CompiledEquations, python: DenseCallbacks, in_lanes: bool) -> RowExchange:
    """Return the record by which a run exchanges redundant constraint rows.

    A constraint row is one scalar constraint equation. If constraints are redundant, some rows imply the
    others. Near some configurations another choice of these rows is better conditioned. The record has a
    function `shares` that detects this, and a callback that makes the better choice. A share is a coefficient
    of a row in use, in the combination that gives a left-out row.

    Args:
        code: compiled equations of the scene.
        python: callbacks into Python.
        in_lanes: True for functions that evaluate one state for each lane.
    """
    rows = code.exchangeable
    if not rows.numbers:
        return no_exchange(code.flags.start)
    shares, units = code.function("shares", in_lanes), np.array(rows.units)
    places = [code.rows.numbers.index(number) for number in rows.numbers]  # indices into the Jacobian
    lanes = shares.lanes if in_lanes else 1

    def exchange(x: int, y: int, on: int) -> None:
        """Change the flags at address x to those of better rows, by the results of `shares` at address y."""
        inputs = vector_at(x, code.inputs * lanes).reshape(-1, lanes)
        results = vector_at(y, shares.outputs * lanes).reshape(-1, lanes)
        for lane in range(lanes):
            if on >> lane & 1:  # the lane is active
                # the constraint Jacobian from its nonzeros, which follow the largest share
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
        results=np.zeros((shares.outputs, lanes)),
    )


def table_of(
    code: CompiledEquations, times: Array, ends: Array, states: Array, tallies: Array, lanes: int = 1
) -> Table:
    """Return the record of the runs that an integrator makes, with the table of their states.

    Args:
        code: compiled equations of the scene.
        times: (n,) s, output times.
        ends: (runs, inputs) start states with time, flags and parameters; overwritten with the end states.
        states: (runs, n, size) states at the output times, written.
        tallies: (runs, COUNTS) counters of the runs, written.
        lanes: number of runs that are integrated at once; lane k makes the runs k, k + lanes, ...
    """
    return Table(
        count=len(times),
        output_state_size=code.output_state_size,
        runs=len(ends),
        stride=lanes,
        first=np.arange(float(lanes)),
        times=times,
        ends=ends,
        states=states,
        tallies=tallies,
    )


def method_of(code: CompiledEquations, options: Options, steps: Array, lanes: int = 1) -> Record:
    """Return the record of an integrator: its options, its state and its work arrays.

    Args:
        code: compiled equations of the scene.
        options: integrator and step control.
        steps: (room, size + 2 + flags) receives the first steps of DOP853, see `Integrator.steps`.
        lanes: number of runs that are integrated at once.
    """
    n, max_steps = code.size, max_adaptive_steps(options)
    if options.step is not None:  # an integrator with fixed steps
        rate = code.function("rate", in_lanes=lanes > 1) if options.integrator == "Euler" else None
        return fixed_step_of(n, code.inputs, options, rate, lanes)
    if options.integrator == "DOP853":
        # `noise`: largest singular value of constraints that are redundant but for rounded numbers of a file
        near = options.near_singular(code.noise, code.scene.mechanism.size)
        return dop853_of(n, code.inputs, options, near, max_steps, round_off_units(code), steps, lanes)
    return radau_of(n, code.inputs, options, max_steps, code.function("jacobian"), lanes)


def scratch_for(lanes: int) -> Callable[..., Array]:
    """Return a function that makes a work array of a given shape for each of some lanes."""
    return lambda *shape: np.zeros((*shape, lanes))


def fixed_step_of(n: int, inputs: int, options: Options, rate: Callback | None, lanes: int = 1) -> FixedStep:
    """Return the record of an integrator with fixed steps: its options, its state and its work arrays.

    Args:
        n: length of a state (q, v).
        inputs: length of a state with time, flags and parameters.
        options: integrator and size of the steps.
        rate: computes dq/dt of a state, for Euler; None for other integrators.
        lanes: number of runs that are integrated at once.
    """
    assert options.step is not None
    scratch = scratch_for(lanes)
    return FixedStep(
        number=FIXED.index(options.integrator),
        step=options.step,
        rate=rate,
        now=scratch(inputs),
        at=scratch(inputs),
        k=scratch(4, n + 1),
        change=scratch(n),
        control=scratch(2),
    )


def dop853_of(
    n: int,
    inputs: int,
    options: Options,
    near: tuple[float, float],
    max_steps: int,
    units: Array,
    steps: Array | None = None,
    lanes: int = 1,
) -> Dop853:
    """Return the record of DOP853: its options, its state and its work arrays.

    Args:
        n: length of a state (q, v).
        inputs: length of a state with time, flags and parameters.
        options: tolerances and other step control.
        near: relative and absolute tolerance next to a singular configuration.
        max_steps: largest number of steps.
        units: (n,) magnitudes below which the round-off of a number is constant, see `round_off_units`.
        steps: (room, n + 2 + flags) receives the first steps, see `Integrator.steps`; None to keep no steps.
        lanes: number of runs that are integrated at once.
    """
    steps, scratch = np.zeros((0, n + 2)) if steps is None else steps, scratch_for(lanes)
    return Dop853(
        rtol=options.rtol,
        atol=options.atol,
        near_rtol=near[0],
        near_atol=near[1],
        max_steps=max_steps,
        rest=options.rest,
        units=units,
        now=scratch(inputs),
        at=scratch(inputs),
        end=scratch(inputs),
        projected=scratch(inputs),
        # 12 stages and 4 evaluations for the dense output; the last element is not used
        k=scratch(16 * (n + 1) + 1),
        terms=scratch(7, n),
        room=len(steps),
        steps=steps,
        round_off=scratch(n),
        control=scratch(CONTROLS),
    )


def radau_of(
    n: int, inputs: int, options: Options, max_steps: int, jacobian: Callback, lanes: int = 1
) -> Radau:
    """Return the record of Radau: its options, its state and its work arrays.

    Args:
        n: length of a state (q, v).
        inputs: length of a state with time, flags and parameters.
        options: tolerances and other step control.
        max_steps: largest number of steps.
        jacobian: computes the Jacobian (n, n) of the rates dq/dt, dv/dt.
        lanes: number of runs that are integrated at once.
    """
    scratch = scratch_for(lanes)
    return Radau(
        rtol=options.rtol,
        atol=options.atol,
        max_steps=max_steps,
        jacobian=jacobian,
        now=scratch(inputs),
        at=scratch(inputs),
        projected=scratch(inputs),
        before=scratch(n),
        slope=scratch(n + 1),
        z=scratch(3, n),
        w=scratch(3, n),
        f=scratch(3, n + 1),
        change=scratch(3 * n + 1),
        terms=scratch(3, n),
        matrix=scratch(n, n),
        real=scratch(n, n),
        re=scratch(n, n),
        im=scratch(n, n),
        pivots=scratch(2, n),
    )


class Projection:
    """Projection of states onto the constraints of a scene: calling the object closes all loops."""

    def __init__(self, code: CompiledEquations) -> None:
        """Bind the compiled equations of a scene to the native projection."""
        self._python, self._projects = Fallback(code, np.zeros(COUNTS)), code.projects
        self.x = np.zeros(code.inputs)
        # projection never evaluates the rates, so that the Python callback stands for them uncompiled
        derivative = self._python.derivative
        system = equations(code, self._python, derivative, marked=np.zeros(code.size))
        with_velocities = 1
        self._run = native_method(project).bind(project, system, with_velocities, self.x)

    def __call__(self, x: Array) -> bool:
        """Move the state in x (inputs,) onto the constraints by the shortest steps.

        Returns:
            True if the constraints are closed; else False, and x is unchanged.
        """
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
