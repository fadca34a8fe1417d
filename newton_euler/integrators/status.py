"""Statuses of steps, projections and runs: one vocabulary for all methods, with the message of each."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Status of a step, a projection or a run.

    Native code sees the number of a status.

    Attributes:
        message: what the user reads. Fields in braces are filled in by the module that reports the failure:
            `joint` and `residual` (m or rad), `max_steps`, and `place`, the singular configuration.
    """

    message: str

    def __new__(cls, number: int, message: str = "") -> Status:
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
    STRAYING = 7, "accelerations of a step contradict each other near {place}; another step may pass"
    UNDETERMINED = (
        8,
        "the run starts at rest at {place}, and the direction of motion is undetermined: start it elsewhere, "
        "or with velocities",
    )
    UNPROJECTED = 9, "the run starts without projection at {place}, and may go over to another motion"
