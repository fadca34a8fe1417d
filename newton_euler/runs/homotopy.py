"""Homotopy in native code: follow a closed configuration while parameters of the mechanism change.

The parameters move along a straight line in small steps, from the values of the scene to the values of a run.
After each step, minimum-norm Newton steps close the loops (`newton_euler.integrators.projection.project`).
The mechanism therefore stays on its branch, such as the elbow-up configuration of a four-bar linkage.
"""

from __future__ import annotations

from dataclasses import dataclass

from newton_euler.codegen.native import Record, Vector, native
from newton_euler.integrators.projection import project
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import Equations


@dataclass(frozen=True, eq=False)
class HomotopyRecord(Record):
    """Paths of several runs from the parameters of the scene to the parameters of the runs.

    Vectors of length `inputs` hold a state (q, v), the time, flags that select constraint rows, and
    parameters.

    Attributes:
        count: number of runs.
        may_open: 1 if loops may be open at intermediate steps, because given joint coordinates are redundant
            and agree only at the end; else 0.
        steps: (count,) numbers of steps.
        begins: (count, inputs) closed states with the parameters at the beginning.
        ends: (count, inputs) parameters at the end; the closed states at the end are written there.
        x: (inputs,) scratch.
        statuses: (count,) written: status of the last projection of each run.
    """

    count: int
    may_open: int
    steps: Vector
    begins: Vector
    ends: Vector
    x: Vector
    statuses: Vector


@native
def assemble_all(system: Equations, paths: HomotopyRecord) -> None:
    """Follow the paths of all runs; write the closed states at the end of the paths.

    Args:
        system: equations of the constraints.
        paths: the paths and the results.
    """
    n = system.n  # length of a state
    inputs = system.inputs
    x = paths.x
    for run in range(paths.count):
        begin = paths.begins[inputs * run :]
        end = paths.ends[inputs * run :]
        steps = int(paths.steps[run])
        status = Status.DONE
        # state and time at the beginning
        for i in range(n + 1):
            x[i] = begin[i]
        for step in range(steps):
            # parameters between the beginning and the end; exactly those of the end in the last step
            last = 1 if step + 1 == steps else 0
            for i in range(n + 1, inputs):
                x[i] = end[i]
                if last == 0:
                    x[i] = begin[i] + (end[i] - begin[i]) * (float(step + 1) / float(steps))
            # close the loops, if there are any (`projecting` is 1); the second argument is 1 to project
            # velocities, too: only in the last step
            if system.projecting == 1:
                status = project(system, last, x)
            if status != Status.DONE and (status != Status.OPEN or paths.may_open == 0):
                break
        # project again: the round-off of the first projection is relative to the velocities before it, which
        # may be much larger than those after it
        if status == Status.DONE and system.projecting == 1:
            status = project(system, 1, x)
        for i in range(n):
            end[i] = x[i]
        paths.statuses[run] = float(status)
