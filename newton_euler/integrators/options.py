"""Names and options of the integrators and of the stabilization of closed loops.

`Options` holds one integrator with its tolerances or its fixed step, and checks what the user asks for.
`newton_euler.runs.simulate` makes it from the keyword arguments of a run. The algorithms themselves are in
`dop853`, `radau` and `fixed_step`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypedDict, get_args

from newton_euler.errors import OptionError, check_choice, check_choices, is_count, is_finite_number

IntegratorName = Literal["DOP853", "Radau", "RK4", "Euler"]

INTEGRATORS: tuple[IntegratorName, ...] = get_args(IntegratorName)
"""All integrators that a run may name."""

ADAPTIVE: tuple[IntegratorName, ...] = ("DOP853", "Radau")
"""Integrators that choose their steps by an error estimate.

DOP853 is an explicit Runge-Kutta method of order 8 (Hairer, Norsett, Wanner, Solving ODEs I, 1993, section
II.5). Radau is the implicit Radau IIA of order 5 for stiff equations (Hairer, Wanner, Solving ODEs II, 1996,
section IV.8)."""

FIXED: tuple[IntegratorName, ...] = ("RK4", "Euler")
"""Integrators with fixed steps: classical Runge-Kutta of order 4, and semi-implicit Euler of order 1.

Euler updates velocities first, then positions with the new velocities. Euler evaluates the gyroscopic torque
t = -omega x I omega at the start of the step. This torque does no work, but each step h adds
h^2/2 t^T I^-1 t to the energy of a freely rotating body, a fraction of order (h omega)^2."""

FormulationName = Literal["relative", "cartesian"]
"""Coordinates of the equations of motion: joint coordinates (relative), or positions and Euler parameters of
all bodies (cartesian)."""

StabilizationName = Literal["projection", "baumgarte", "none"]
"""Method that keeps loops closed during a run: projection onto the constraints after each step, Baumgarte
feedback of the constraint violation, or none."""

STABILIZATIONS: tuple[StabilizationName, ...] = get_args(StabilizationName)
"""All stabilizations that a run may name."""

RUN_ARGUMENTS = ("integrator", "stabilization", "alpha")
"""Keyword arguments of `newton_euler.simulate` and of similar functions, in addition to `StepControl`."""

PAPER_ALPHA = 10.0
"""Default gain alpha of Baumgarte stabilization, 1/s: feedback 2 alpha of the velocity error and alpha^2 of
the position error of the constraints (Appendix B of the paper cited in
`newton_euler.equations.cartesian`)."""

DEFAULT_MAX_STEPS = 1_000_000
"""Number of steps after which an adaptive integrator stops, if the option `most_steps` is not set."""

MAX_EXACT_COUNT = 2**53
"""Largest number of steps that a double counts exactly: native code keeps its counts as doubles."""

MAX_FIXED_STEPS = 20_000_000
"""Largest number of fixed steps of a run, if the option `most_steps` is not set. So many steps take seconds
for a pendulum and minutes for the largest mechanisms."""


class StepControl(TypedDict, total=False):
    """Keyword arguments of a run that control the steps of its integrator.

    Attributes:
        rtol, atol: relative and absolute tolerance of the error of one step, for each component of the state;
            1e-10 and 1e-12 if they are not given. Only "DOP853" and "Radau" take tolerances.
        step: largest step, s, which "RK4" and "Euler" need. The step is shortened if it does not divide the
            time between two outputs or between two samples of a controller.
        most_steps: largest number of steps of a run. If it is None or not given, 1,000,000 for "DOP853" and
            "Radau" (fewer if Python evaluates the equations), and 20,000,000 for "RK4" and "Euler".
        rest: threshold of the rates of all coordinates and velocities, SI. If all are below, the mechanism
            counts as at rest. It is not integrated until the next controller sample, or the next jump in a
            derivative of a function of time; while a function of time changes, it is integrated in any case.
            The default 0 turns this off. If a motion decays with time constant T, bodies stop about `rest` T
            before their final positions. Unstable equilibria count as rest, too. Only "DOP853" of
            newton_euler uses this option.
    """

    rtol: float
    atol: float
    step: float | None
    most_steps: int | None
    rest: float


def baumgarte_alpha(stabilization: str, alpha: float | None) -> float:
    """Return the Baumgarte gain of a run, 1/s: 0 without Baumgarte stabilization.

    Args:
        stabilization: one of `STABILIZATIONS`.
        alpha: gain that the user has asked for, or None for the default, `PAPER_ALPHA`.

    Raises:
        OptionError: if alpha is negative or not finite, or if the stabilization does not use alpha.
    """
    check_choice("stabilization", stabilization, STABILIZATIONS)
    if alpha is None:
        return PAPER_ALPHA if stabilization == "baumgarte" else 0.0
    if not is_finite_number(alpha) or alpha < 0.0:
        raise OptionError("alpha", alpha, "a number of 1/s, zero or more")
    if stabilization != "baumgarte" and alpha > 0.0:
        raise OptionError("alpha", alpha, f"none: stabilization is {stabilization!r}, not 'baumgarte'")
    return float(alpha)


@dataclass(frozen=True)
class Options:
    """An integrator and the control of its steps.

    Attributes:
        integrator: one of `INTEGRATORS`.
        rtol, atol, step, most_steps, rest: see `StepControl`. If `most_steps` is None, the limits are
            `DEFAULT_MAX_STEPS` and `MAX_FIXED_STEPS`.
        projection: True to project states onto the constraints after each step and at outputs.
    """

    integrator: str = "DOP853"
    rtol: float = 1e-10
    atol: float = 1e-12
    step: float | None = None
    most_steps: int | None = None
    rest: float = 0.0
    projection: bool = True

    def __post_init__(self) -> None:
        check_choice("integrator", self.integrator, INTEGRATORS)
        for name in ("rtol", "atol"):
            value = getattr(self, name)
            if not is_finite_number(value) or not 0.0 < value < 1.0:
                raise OptionError(name, value, "a number between 0 and 1")
            object.__setattr__(self, name, float(value))
        if self.most_steps is not None:
            if not is_count(self.most_steps):
                raise OptionError("most_steps", self.most_steps, "a whole number of steps")
            object.__setattr__(self, "most_steps", int(self.most_steps))
        if not is_finite_number(self.rest) or self.rest < 0.0:
            raise OptionError("rest", self.rest, "rates of 0 or more")
        if self.rest and self.integrator != "DOP853":
            raise OptionError("rest", self.rest, f"0: {self.integrator} makes its steps at rest, too")
        object.__setattr__(self, "rest", float(self.rest))
        if self.integrator in FIXED:
            if self.step is None or not is_finite_number(self.step) or self.step <= 0.0:
                raise OptionError("step", self.step, f"a positive number of seconds for {self.integrator}")
            object.__setattr__(self, "step", float(self.step))
        elif self.step is not None:
            raise OptionError("step", self.step, f"none: {self.integrator} chooses its own steps")

    @classmethod
    def of(cls, integrator: str, control: StepControl, others: Sequence[str] = ()) -> Options:
        """Make options from the name of an integrator and keyword arguments.

        Args:
            integrator: one of `INTEGRATORS`.
            control: keyword arguments that control the steps.
            others: further keyword arguments that the caller takes, listed if one of `control` is unknown.

        Raises:
            UnknownNameError: if there is no integrator or no option of this name.
            OptionError: if a value is impossible, or if tolerances are given for fixed steps.
        """
        check_choice("integrator", integrator, INTEGRATORS)
        check_choices("option", control, (*others, *StepControl.__annotations__))
        for name in ("rtol", "atol") if integrator in FIXED else ():
            if name in control:
                raise OptionError(name, control[name], f"none: {integrator} takes fixed steps")
        return cls(integrator, **control)

    def check_steps(self, duration: float) -> None:
        """Raise `OptionError` if a run of this duration, s, needs too many fixed steps."""
        most = self.most_steps or MAX_FIXED_STEPS
        if self.step is not None and duration / self.step > most:
            needed = f"at least {duration / most:.3g} s, {most} steps; most_steps allows more"
            raise OptionError("step", self.step, needed)

    def near_singular(self, noise: float, size: float) -> tuple[float, float]:
        """Return rtol and atol of steps next to a singular configuration, where branches of motion meet.

        Rounded numbers of a model file leave a small noise in constraints that count as redundant. The noise
        bends the branches around each other, so that they no longer meet. A step with a tolerance below the
        noise would follow the bend onto the wrong branch.

        Args:
            noise: largest singular value of the constraints that count as redundant, dimensionless. `atol`
                counts it in rad, or in m (times `size`) if that is smaller.
            size: the mechanism's size, m.
        """
        return self.rtol + noise, self.atol + noise * min(1.0, size)

    def as_settings(self) -> dict[str, Any]:
        """Return the integrator and its step or tolerances by name, as a trajectory records them."""
        control = {"step": self.step} if self.step else {"rtol": self.rtol, "atol": self.atol}
        return {"integrator": self.integrator} | control | ({"rest": self.rest} if self.rest else {})


def max_adaptive_steps(options: Options) -> int:
    """Return the largest number of steps of an adaptive integrator in native code."""
    return min(options.most_steps or DEFAULT_MAX_STEPS, MAX_EXACT_COUNT)
