"""Homotopy in native code: closed states carried in small steps from one set of parameters to another.

A homotopy moves the parameters along a straight line. After each step Newton's steps of least length close
the loops (`newton_euler.integrators.projection.project`), so that the mechanism stays on its branch.
"""

from __future__ import annotations

from dataclasses import dataclass

from newton_euler.codegen.native import Record, Vector, native
from newton_euler.integrators.projection import project
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import Equations


@dataclass(frozen=True, eq=False)
class HomotopyRecord(Record):
    """Paths of n runs from the parameters of the scene to the parameters of the runs.

    Attributes:
        count: n.
        passing: 1 if some coordinates follow from others and may stay open before the last step, else 0.
        steps: (n,) numbers of steps.
        own: (n, inputs) states with their parameters at the beginning.
        states: (n, inputs) parameters at the end; their states are replaced by the closed ones.
        x: (inputs,) scratch.
        statuses: (n,) statuses of the last projections.
    """

    count: int
    passing: int
    steps: Vector
    own: Vector
    states: Vector
    x: Vector
    statuses: Vector


@native
def assemble_all(system: Equations, paths: HomotopyRecord) -> None:
    """Close the states of all runs at the parameters at the end of their paths."""
    n = system.n
    inputs = system.inputs
    x = paths.x
    for run in range(paths.count):
        own = paths.own[inputs * run :]
        target = paths.states[inputs * run :]
        steps = int(paths.steps[run])
        status = Status.DONE
        # begin at the closed state of the scene
        for i in range(n + 1):
            x[i] = own[i]
        for step in range(steps):
            # parameters between the beginning and the end; exactly those of the end in the last step
            last = 1 if step + 1 == steps else 0
            for i in range(n + 1, inputs):
                x[i] = target[i]
                if last == 0:
                    x[i] = own[i] + (target[i] - own[i]) * (float(step + 1) / float(steps))
            # close the loops; velocities only in the last step
            if system.projecting == 1:
                status = project(system, last, x)
            if status != Status.DONE and (status != Status.OPEN or paths.passing == 0):
                break
        # project again: velocities far below the first ones get their digits
        if status == Status.DONE and system.projecting == 1:
            status = project(system, 1, x)
        for i in range(n):
            target[i] = x[i]
        paths.statuses[run] = float(status)
