"""What can go wrong, one class a kind, all under `NewtonEulerError`.

Every error keeps the raw values it was raised with as attributes and reads as one line.
"""

from __future__ import annotations


class NewtonEulerError(Exception):
    """Base of every error that `newton_euler` raises on purpose."""


class MechanismError(NewtonEulerError):
    """A mechanism or scene that cannot be: names the element, its value and what would be right."""

    def __init__(self, element: str, problem: str, needed: str) -> None:
        self.element = element
        self.problem = problem
        self.needed = needed
        super().__init__(f"{element}: {problem}; needed: {needed}")


class UnknownNameError(NewtonEulerError):
    """A name that is not among the valid ones."""

    def __init__(self, what: str, name: object, valid: tuple[str, ...]) -> None:
        self.what = what
        self.name = name
        self.valid = valid
        super().__init__(f"unknown {what} {name!r}; choose from: {', '.join(valid)}")


class OptionError(NewtonEulerError):
    """An option of a solver with a value that it cannot take."""

    def __init__(self, option: str, value: object, needed: str) -> None:
        self.option = option
        self.value = value
        self.needed = needed
        super().__init__(f"{option} is {value!r}; needed: {needed}")


class AssemblyError(NewtonEulerError):
    """Positions or velocities that cannot be made to meet the constraints."""

    def __init__(self, joint: str, violation: float, tolerance: float) -> None:
        self.joint = joint
        self.violation = violation
        self.tolerance = tolerance
        super().__init__(
            f"joint {joint!r} stays open by {violation:.3g} (m or rad) after assembly; "
            f"needed: at most {tolerance:.3g}"
        )


class IntegrationError(NewtonEulerError):
    """A run that could not go on: the time it reached, and why."""

    def __init__(self, time: float, reason: str) -> None:
        self.time = time
        self.reason = reason
        super().__init__(f"integration stopped at t = {time:.6g} s: {reason}")


class SingularityError(NewtonEulerError):
    """Equations of motion without a unique solution, and the joint they fail at."""

    def __init__(self, joint: str, reason: str) -> None:
        self.joint = joint
        self.reason = reason
        super().__init__(f"equations of motion are singular at joint {joint!r}: {reason}")
