"""Names and options of the methods of integration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypedDict, get_args

from newton_euler.errors import OptionError, check_choice, check_choices, is_count, is_finite_number

IntegratorName = Literal["DOP853", "Radau", "RK4", "Euler"]

INTEGRATORS: tuple[IntegratorName, ...] = get_args(IntegratorName)

ADAPTIVE: tuple[IntegratorName, ...] = ("DOP853", "Radau")
"""Runge-Kutta of order 8 (Hairer, Norsett, Wanner, Solving ODEs I, 1993, section II.5) and the stiff
Radau IIA of order 5 (Hairer, Wanner, Solving ODEs II, 1996, section IV.8)."""

FIXED: tuple[IntegratorName, ...] = ("RK4", "Euler")
"""Methods with fixed steps: classical Runge-Kutta of order 4, and semi-implicit Euler of order 1, velocities
first, then positions with the new velocities. Euler takes gyroscopic torques t = -omega x I omega
explicitly: they do no work, but each step h adds h^2/2 t^T I^-1 t to the energy of a freely turning body, a
share of order (h omega)^2."""

FormulationName = Literal["relative", "cartesian"]
"""The equations' unknowns: joint coordinates, or those of the bodies."""

StabilizationName = Literal["projection", "baumgarte", "none"]
"""Method that keeps loops closed."""

STABILIZATIONS: tuple[StabilizationName, ...] = get_args(StabilizationName)

PAPER_ALPHA = 10.0
"""The paper's choice for K_D = 2 alpha, K_P = alpha^2 (Appendix B), 1/s."""

MOST_STEPS = 1_000_000
"""Steps after which an adaptive method gives up, if a run does not say."""

COUNTED = 2**53
"""Steps that doubles count one by one."""

MOST_FIXED_STEPS = 20_000_000
"""Default largest number of fixed steps of a run: seconds for a pendulum, minutes for the largest
mechanisms."""


class StepControl(TypedDict, total=False):
    """The choice of steps, as keywords; see `Options`."""

    rtol: float
    atol: float
    step: float | None
    most_steps: int | None
    rest: float


def baumgarte_alpha(stabilization: str, alpha: float | None) -> float:
    """Return the alpha that equations take; raises `OptionError` for impossible choices."""
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
    """A method of integration and its choice of steps.

    Attributes:
        integrator: one of `INTEGRATORS`.
        rtol, atol: error control of the adaptive methods, per step and component.
        step: s, of the methods with fixed steps; made smaller where it does not divide the time
            between outputs, or sampling instants of controllers.
        most_steps: steps after which an adaptive method is taken to be getting nowhere; if not given, a
            million in native code and `MOST_STEPS` in Python. A run that needs more fixed steps, or more than
            `MOST_FIXED_STEPS` if it is not given, is refused.
        rest: rates of coordinates and velocities, SI, below all of which a mechanism is at rest: it stays
            where it is until the next sampling instant or knot of a function of time, and no steps are made.
            0 for never. Where motions die away with a time constant T, bodies are left some `rest` T from
            where they would get to; unstable equilibria are taken for rest, too. DOP853's in native code.
        projection: True to project onto the constraints after each step and at outputs.
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
    def of(cls, integrator: str, control: StepControl) -> Options:
        """Make the options of a method.

        Raises:
            UnknownNameError: for an option that there is not.
            OptionError: for an impossible value, and tolerances of a method with fixed steps.
        """
        check_choice("integrator", integrator, INTEGRATORS)
        check_choices("option", control, StepControl.__annotations__)
        for name in ("rtol", "atol") if integrator in FIXED else ():
            if name in control:
                raise OptionError(name, control[name], f"none: {integrator} takes fixed steps")
        return cls(integrator, **control)

    def check_steps(self, duration: float) -> None:
        """Raise `OptionError` for fixed steps that are too many in a duration, s."""
        most = self.most_steps or MOST_FIXED_STEPS
        if self.step is not None and duration / self.step > most:
            needed = f"at least {duration / most:.3g} s, {most} steps; most_steps allows more"
            raise OptionError("step", self.step, needed)

    def near(self, noise: float, size: float) -> tuple[float, float]:
        """Return rtol and atol of steps next to a singular configuration of a mechanism of a size, m.

        A motion is known no better than the noise of constraints that are taken as redundant (their largest
        singular value). There it bends branches that meet by design around each other, and a step that saw
        more than the noise would follow the bend.
        """
        return self.rtol + noise, self.atol + noise * min(1.0, size)

    def chosen(self) -> dict[str, Any]:
        """Return what a run was asked for, by name."""
        control = {"step": self.step} if self.step else {"rtol": self.rtol, "atol": self.atol}
        return {"integrator": self.integrator} | control | ({"rest": self.rest} if self.rest else {})


def most_steps(options: Options) -> int:
    """Return the largest number of steps of an adaptive method."""
    return min(options.most_steps or MOST_STEPS, COUNTED)
