"""Marches of compiled scenes: native steppers with the scene's native functions, no Python inside a step."""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache

import numpy as np

from newton_euler.codegen.native import Record
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.compiled import Code, Formulation
from newton_euler.errors import OptionError
from newton_euler.integrators import march as m
from newton_euler.integrators.adaptive import march_dop853
from newton_euler.integrators.closing import close
from newton_euler.integrators.collocation import Radau
from newton_euler.integrators.dop853 import Dop853
from newton_euler.integrators.failure import failure
from newton_euler.integrators.fixed import RungeKutta4, SemiImplicitEuler, march_euler, march_rk4
from newton_euler.integrators.integrate import Options
from newton_euler.integrators.outputs import Outputs, loops
from newton_euler.integrators.radau import march_radau
from newton_euler.integrators.stabilize import ROUND_OFF
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

MOST_STEPS = 1_000_000
"""Steps after which an adaptive method is taken to be getting nowhere, if a run does not say."""

COUNTED = 2**53
"""Steps that doubles count one by one."""

MOST_FIXED_STEPS = 1e10
"""Of a run; an hour at least."""

MARCHES: dict[str, Callable[..., int]] = {
    "DOP853": march_dop853,
    "Radau": march_radau,
    "RK4": march_rk4,
    "Euler": march_euler,
}


@lru_cache
def stepper(integrator: str) -> NativeFunctions:
    """An integrator, which no scene changes; compiled once."""
    return NativeFunctions([MARCHES[integrator]])


@lru_cache
def projector() -> NativeFunctions:
    """Projection by itself."""
    return NativeFunctions([m.project])


def load(code: Code, integrator: str) -> None:
    """Have everything ready for a run."""
    stepper(integrator)
    loops()
    for name in code.needed(integrator):
        code.function(name)


class Fallback:
    """What native code leaves to Python: states near singular, by the dense float form, and interrupts.

    Attributes:
        derivative, closing, pause: addresses of native callbacks.
        error: what that form raised last, if it did.
    """

    def __init__(self, code: Code, stopped: Sequence[bool] = ()) -> None:
        self._code, self._stopped = code, stopped
        self._interrupted = False
        self.error: Exception | None = None
        kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
        # alive as long as this object
        self._callbacks = (kind(self._derivative), kind(self._closing), kind(self._pause))
        self.derivative, self.closing, self.pause = (
            ctypes.cast(callback, ctypes.c_void_p).value for callback in self._callbacks
        )

    def _derivative(self, x: int, y: int) -> None:
        def rates(system: Formulation, state: Array) -> Array:
            q, v = state[: system.nq], state[system.nq : self._code.size]
            return np.concatenate([system.rate(q, v), system.acceleration(q, v)])

        self._guarded(x, y, rates)

    def _closing(self, x: int, y: int) -> None:
        self._guarded(x, y, lambda system, state: close(self._code, system, state))

    def _pause(self, counts: int, wish: int) -> None:
        """Python runs signal handlers here, between two of its own instructions."""
        _vector(wish, 1)[0] = float(self._interrupted or len(self._stopped) > 0)

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Turn an interrupt during native code into a wish to stop, and raise it afterwards."""
        in_main = threading.current_thread() is threading.main_thread()  # which alone handles signals
        if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            yield
            return

        def note(number: int, frame: object) -> None:
            self._interrupted = True

        before = signal.signal(signal.SIGINT, note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
            if self._interrupted:
                raise KeyboardInterrupt

    def _guarded(self, x: int, y: int, function: Callable[[Formulation, Array], Array]) -> None:
        """Write n results and 1.0, or anything and -1.0 if Python fails too."""
        code = self._code
        state, results = _vector(x, code.inputs).copy(), _vector(y, code.size + 1)
        system = code.float_system(state)
        results[-1] = -1.0
        try:
            with np.errstate(all="ignore"):  # the march checks what comes back
                results[:-1] = function(system, state)
        except Exception as error:  # nothing may pass through native code
            self.error = error
        else:
            results[-1] = 1.0


def _vector(address: int, size: int) -> Array:
    """The doubles at an address."""
    return np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))


class March:
    """A march over given times, ready to be run from many starts; one thread at a time.

    Attributes:
        x: (inputs,) the state with time and parameters: the start, and after the run where it ended.
        table: (n, size) the states at all times after a run, as far as `outputs` needs them.
        outputs: what the scene asks for of them.
        counts: what the run took.
    """

    def __init__(self, code: Code, times: Array, options: Options, stopped: Sequence[bool] = ()) -> None:
        """Make everything ready; a run stops if `stopped`, which other threads may fill, holds something."""
        self._code, self._python, self._integrator = code, Fallback(code, stopped), options.integrator
        self._times, self._most = times, min(options.most_steps or MOST_STEPS, COUNTED)
        self.x, self.counts = np.zeros(code.inputs), np.zeros(m.COUNTS)
        self.table = np.zeros((len(times), code.size))
        system = equations(code, self._python, code.marks(options.integrator), self.counts)
        table = m.Table(len(times), code.kept, times, self.table)
        method = _method(code, self.x, times, options, self._most)
        self._copies = [getattr(method, name) for name in ("at", "end") if hasattr(method, name)]
        self.outputs = Outputs(code, times, self.x, self.table)
        march = MARCHES[options.integrator]
        self._run = stepper(options.integrator).bind(march, system, table, method)

    def __call__(self, x: Array) -> None:
        """Run from x (inputs,).

        Raises:
            IntegrationError: with the time reached, the reason and the joint.
        """
        for copy in (self.x, *self._copies):
            copy[:] = x
        self.counts[:] = 0.0
        self._python.error = None
        with self._python.interruptible():
            status = self._run()
        if status == m.INTERRUPTED:
            raise KeyboardInterrupt
        if status != m.DONE:
            error = self._python.error
            raise failure(self._code, self._integrator, self._most, status, self.x, self.counts, error)

    def attempt(self, x: Array) -> tuple[dict[str, Array], IntegrationError | None]:
        """Run from x (inputs,): outputs at the times that were reached, and what ended it before the last.

        The arrays have a row for each of the first times; without any there are no arrays.
        """
        stopped: IntegrationError | None = None
        try:
            self(x)
        except IntegrationError as error:
            stopped = error
        rows = int(self.counts[m.WRITTEN])
        while rows > 0:
            try:
                return self.outputs(np.empty(self.outputs.shape), rows), stopped
            except IntegrationError as error:
                stopped, rows = stopped or error, int(np.searchsorted(self._times, error.time))
        return {}, stopped

    @property
    def counted(self) -> dict[str, int]:
        """What the run took, by name."""
        names = {
            "steps": m.STEPS,
            "rejected": m.REJECTED,
            "evaluations": m.EVALUATIONS,
            "dense": m.DENSE_CALLS,
        }
        return {name: int(self.counts[place]) for name, place in names.items()}


def equations(code: Code, python: Fallback, turning: Array, counts: Array) -> m.Equations:
    """A scene's native functions as steppers call them."""
    position, velocity = (code.function(name) if code.projects else None for name in ("position", "velocity"))
    lanes = position.lanes if position else 1
    return m.Equations(
        n=code.size,
        nq=code.system.nq,
        inputs=code.inputs,
        derivative=code.function("derivative"),
        dense=python.derivative,
        projecting=int(code.projects),
        tolerance=ROUND_OFF,
        lanes=lanes,
        position=position,
        velocity=velocity,
        closing=python.closing,
        beside=np.zeros((code.inputs + code.size + 2, lanes)),
        pause=python.pause,
        turning=turning,
        counts=counts,
    )


def _method(code: Code, x: Array, times: Array, options: Options, most: int) -> Record:
    """An integrator that begins at x (inputs,), with its scratch."""
    n, like = code.size, np.zeros_like
    if options.step is not None:
        span = float(times[-1] - times[0])
        if span / options.step > MOST_FIXED_STEPS:
            needed = f"at least {span / MOST_FIXED_STEPS:.3g} s, {MOST_FIXED_STEPS:.0e} steps"
            raise OptionError("step", options.step, needed)
        if options.integrator == "RK4":
            return RungeKutta4(options.step, x, like(x), np.empty((4, n + 1)), np.empty(n))
        return SemiImplicitEuler(options.step, code.function("rate"), x, np.empty(n + 1), np.empty(n))
    if options.integrator == "DOP853":
        near = options.near(code.noise, code.scene.mechanism.size)
        k, terms = np.empty(16 * (n + 1) + 1), np.empty((7, n))
        return Dop853(options.rtol, options.atol, *near, most, x, like(x), like(x), k, terms)
    return Radau(
        rtol=options.rtol,
        atol=options.atol,
        most=most,
        jacobian=code.function("jacobian"),
        now=x,
        at=like(x),
        before=np.empty(n),
        slope=np.empty(n + 2),
        z=np.empty((3, n)),
        w=np.empty((3, n)),
        f=np.empty((3, n + 1)),
        change=np.empty(3 * n + 2),
        terms=np.empty((3, n)),
        matrix=np.empty((n, n)),
        real=np.empty((n, n)),
        re=np.empty((n, n)),
        im=np.empty((n, n)),
        pivots=np.empty((2, n)),
    )


class Projection:
    """Puts states on the constraints of a scene."""

    def __init__(self, code: Code) -> None:
        self._python, self._projects = Fallback(code), code.projects
        self.x = np.zeros(code.inputs)
        system = equations(code, self._python, np.zeros(code.size), np.zeros(m.COUNTS))
        self._run = projector().bind(m.project, system, 1, self.x)

    def __call__(self, x: Array) -> bool:
        """Change x (inputs,) by the least that meets the constraints; whether that could be done."""
        if not self._projects:
            return True
        self.x[:] = x
        if self._run() != m.DONE:
            return False
        x[:] = self.x
        return True
