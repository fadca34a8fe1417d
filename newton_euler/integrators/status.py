"""Result of a step, a projection or a run of an integrator, with a message for each case."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Result of a step, a projection or a run: `DONE` or the reason why it stopped.

    A projection moves a state onto the constraint equations of closed loops, against drift. At a singular
    configuration several motions branch; projection keeps a run on the motion of its initial velocities.

    The compiled integrators return the integer. `newton_euler.compiled.failures` turns it into an exception
    with the message.

    Attributes:
        message: text for the user. `newton_euler.compiled.failures` replaces the fields in braces: `joint`
            and `residual` (m or rad), `max_steps`, and `place`, a description of the singular configuration.
    """

    message: str

    def __new__(cls, number: int, message: str = "") -> Status:
        """Make a member with its number and its message."""
        status = int.__new__(cls, number)
        status._value_ = number
        status.message = message
        return status

    DONE = 0, "the run is complete"
    NOT_FINITE = 1, "the solution is not finite"
    SINGULAR = 2, "the equations of motion are singular"
    TOO_MANY_STEPS = 3, "more than {max_steps} steps"
    STEP_TOO_SMALL = 4, "steps have become too small"
    OPEN = 5, "projection cannot close joint {joint!r}, which is open by {residual:.3g} (m or rad)"
    INTERRUPTED = 6, "the run was interrupted"
    # accelerations are those at the stages of one Runge-Kutta step; "another step" means another step size
    STRAYING = 7, "accelerations of a step contradict each other near {place}; another step may pass"
    UNDETERMINED = (
        8,
        "the run starts at rest at {place}, and the direction of motion is undetermined: start it elsewhere, "
        "or with velocities",
    )
    UNPROJECTED = 9, "the run starts without projection at {place}, and may go over to another motion"
