"""Integrate a compiled scene: bind its native functions to a native integrator and run it.

No Python runs inside a step, except near singular configurations, where constraints become dependent. An
`Integrator` turns an initial state into a table of states at given output times. Native functions read one
vector x (inputs,): the state (q, v), the time, flags, and parameters of the scene. A flag is 1 for a
redundant constraint row that is left out, else 0.

`newton_euler.compiled.records` builds the records of sizes, functions and work arrays that native integrators
read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.compiled.callbacks import EQUATION_ERRORS, DenseCallbacks, raise_fatal, vector_at
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.failures import UNSTABLE_STATUSES, failure
from newton_euler.compiled.outputs import Outputs, loops
from newton_euler.compiled.records import equations, marks, method_of, table_of
from newton_euler.errors import OptionError
from newton_euler.integrators.dop853 import integrate_dop853
from newton_euler.integrators.fixed_step import divisions, integrate_fixed
from newton_euler.integrators.options import FIXED, Options
from newton_euler.integrators.projection import project
from newton_euler.integrators.radau import integrate_radau
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS, Count
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

MAX_EXAMINED = 8
"""Number of output states of a run with fixed steps that are examined for the cause of an early stop."""

MAX_REPEATED_STEPS = 10_000
"""Number of fixed steps since the last output above which these steps are not repeated to examine them."""

MAX_EXAMINED_STEPS = 200
"""Number of states at the end of the repeated steps that are examined for the cause of an early stop."""

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
    if code.scene.switched_forces:
        names += ["switching"]  # where branches of dry friction and stops are left
    names += {"Euler": ["rate"], "Radau": ["jacobian"]}.get(integrator, [])
    if code.scene.sampled:
        names += ["measured"]  # the joint coordinates that digital controllers read
    return names


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


def check_rest(code: CompiledEquations, options: Options) -> None:
    """Raise `OptionError` if the option `rest` ends runs at rest although functions of time always move the
    scene."""
    functions = (f for of_element in code.scene.functions.values() for f in of_element)
    if options.rest and not all(f.rests for f in functions):
        needed = "0 for a scene with functions of time other than Steps and Moves"
        raise OptionError("rest", options.rest, needed)


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
            OptionError: see `check_rest`.
        """
        check_rest(code, options)
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
