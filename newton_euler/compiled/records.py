"""Records of a compiled scene and of an integrator, which the native integrators read.

Records are structures of sizes, function pointers and work arrays; their classes in
`newton_euler.integrators` describe the fields. Native code can integrate several runs at once, each in one
*lane* of the processor's vector registers (`newton_euler.compiled.lanes`). Arrays then have an additional
last axis for the lanes. Native functions read one vector x (inputs,): the state (q, v), the time, flags, and
parameters of the scene. A flag is 1 for a redundant constraint row that is left out, else 0.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

from newton_euler.codegen.compile import lane_count
from newton_euler.codegen.native import Callback, Record
from newton_euler.compiled.callbacks import DenseCallbacks, vector_at
from newton_euler.compiled.constraint_groups import group_places
from newton_euler.compiled.equations import OPEN_TOLERANCE, CompiledEquations
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.row_choice import exchanged
from newton_euler.integrators.constraint_ratio import Availability, ConstraintRatio
from newton_euler.integrators.dense_projection import RESIDUAL_ROUND_OFF, Closing, closing_of, unprepared
from newton_euler.integrators.dop853_stages import CONTROLS, Dop853
from newton_euler.integrators.fixed_step import FixedStep
from newton_euler.integrators.options import FIXED, Options, max_adaptive_steps
from newton_euler.integrators.radau_stages import Radau
from newton_euler.integrators.row_exchange import EXCHANGED, RowExchange, no_exchange
from newton_euler.integrators.stepper import ANGLE, QUATERNION, QUATERNION_WITH_RATES, Equations, Table
from newton_euler.integrators.switches import SAMPLES, Search, Switches, no_switches
from newton_euler.scalars import Array

COMPILATION_LOCK = threading.Lock()
"""Lock held during compilation, so that threads that need the same function do not compile it twice."""


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
        flags=code.flags.stop - code.flags.start,
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
        switches=switches_of(code, in_lanes),
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
        return no_exchange(code.row_flags.start)
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
                flags = inputs[code.row_flags, lane]
                matrix = jacobian.reshape(-1, code.system.nv)
                better = exchanged(matrix, places, units, flags)
                if not np.array_equal(better, flags):
                    inputs[code.row_flags, lane] = better
                    results[0, lane] = EXCHANGED

    return RowExchange(
        count=len(rows.numbers),
        first=code.row_flags.start,
        shares=shares,
        exchange=python.guarded(exchange),
        results=np.zeros((shares.outputs, lanes)),
    )


def switches_of(code: CompiledEquations, in_lanes: bool) -> Switches:
    """Return the record by which a run ends steps where branches of dry friction and stops are left.

    Args:
        code: compiled equations of the scene.
        in_lanes: True for functions that evaluate one state for each lane.
    """
    count = code.branch_flags.stop - code.branch_flags.start
    if count == 0:
        return no_switches()
    function = code.function("switching", in_lanes)
    scratch = scratch_for(function.lanes if in_lanes else 1)
    return Switches(
        count=count,
        first=code.branch_flags.start,
        evaluate=function,
        values=scratch(count),
        samples=scratch(SAMPLES + 1, count),
        search=scratch(len(Search)),
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
        steps: (room, size + 2 + flags) receives the first steps of DOP853, see `steps` of
            `newton_euler.compiled.run.Integrator`.
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
        steps: (room, n + 2 + flags) receives the first steps, see `method_of`; None to keep no steps.
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
