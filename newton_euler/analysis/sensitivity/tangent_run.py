"""Runs of a scene with derivatives along directions of the initial state and of the parameters.

A run is integrated first, and its steps are recorded. The derivatives, called tangents, satisfy the
linearized equations of motion. They are integrated along the recorded steps
(`newton_euler.integrators.tangent_steps`) and projected onto the linearized constraints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from newton_euler.analysis.sensitivity.tangent_code import ALONG, PROJECTED, RATES, SIGN_CHANGES, TangentCode
from newton_euler.compiled.callbacks import Callbacks
from newton_euler.compiled.outputs import at_rows
from newton_euler.compiled.run import Integrator
from newton_euler.equations.parameters import pieces_along
from newton_euler.errors import OptionError, SensitivityError
from newton_euler.integrators.options import Options, StepControl, max_adaptive_steps
from newton_euler.integrators.singular import FAR_PIVOT_RATIO, NEAR_PIVOT_RATIO, UNSAFE_PIVOT_RATIO
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS, HUGE, Count, reported_counts
from newton_euler.integrators.tangent_steps import integrate_tangents, tangent_methods
from newton_euler.integrators.tangents import TangentCount, Tangents, evaluate_along
from newton_euler.runs.intervals import Interval, integrate_intervals
from newton_euler.scalars import Array

NEAR_SINGULAR = "the run comes too near to a singular configuration"
MASS_RATIO = "masses differ too much: beside heavy bodies, light ones amplify the errors of derivatives"

PIVOT_SPACING = 0.1
"""Largest motion, rad or sizes of the mechanism, between two states of a run at which pivot ratios are
evaluated. A pivot ratio is the smallest ratio of a pivot of the constraint equations to its usual magnitude;
it vanishes at a singular configuration."""

PIVOT_REFINEMENT = 20
"""Number of points on each side of a minimum at which pivot ratios are evaluated again, twice in a row."""

TOLERANCE_FACTOR = 100.0
"""Tolerance of derivatives, divided by `rtol`. At this value steps of a moving scene are rarely divided."""

RECORDED_STEPS = 2048
"""Number of steps of a run for which memory is allocated. A longer run is repeated with more memory."""


def tangent_options(control: Mapping[str, Any]) -> Options:
    """Return the options of DOP853 with projection, of which alone there are derivatives.

    Raises:
        OptionError: for another integrator or stabilization, and for options that it does not have.
    """
    chosen = dict(control)
    for name, only in (("integrator", "DOP853"), ("stabilization", "projection"), ("rest", 0.0)):
        value = chosen.pop(name, only)
        if not isinstance(value, str | float | int) or value != only:
            raise OptionError(name, value, f"{only}, which derivatives are of")
    return Options.of("DOP853", cast(StepControl, chosen))


class Followed(NamedTuple):
    """A run with its derivatives along p directions."""

    results: Array
    """(n, outputs) outputs of the scene."""
    derivatives: dict[str, Array]
    """(n, outputs, p) by program; the program "coordinates" has the coordinates before their derivatives."""
    counts: dict[str, float]
    wall_time: float
    """s, of the run and its derivatives."""


class _Path:
    """Motion within the steps of a run, interpolated by cubics through states and rates at the ends.

    Pivot ratios are those of Phi_q Phi_q^T with the dimensionless constraint Jacobian Phi_q, without masses.
    Pivot ratios with masses would also vanish where a light body is at a dead center.
    """

    def __init__(self, code: TangentCode, steps: Array, begun: Array, end: Array) -> None:
        """Take the recorded steps of a run.

        Args:
            code: compiled equations.
            steps: (m, n + 2 + flags), see `newton_euler.integrators.dop853.Dop853`.
            begun, end: x (inputs,) at the beginning and at the end.
        """
        n, nq, known = code.size, code.system.nq, code.flags.stop
        self._code, self._n, self._nq = code, n, nq
        self._sizes = np.minimum(steps[:, -1:], end[n] - steps[:, n : n + 1])  # the last may go beyond
        self._ends = np.tile(begun, (len(steps) + 1, 1))
        self._ends[:-1, :known] = steps[:, :known]
        self._ends[-1, :known] = end[:known]
        speeds = np.abs(self._ends[:, nq:n] / code.system.velocity_units).max(axis=1, initial=0.0)
        moved = self._sizes[:, 0] * np.maximum(speeds[:-1], speeds[1:])
        self._counts = 1 + (moved / PIVOT_SPACING).astype(int)

    def least_pivot_ratio(self) -> float:
        """Find the smallest pivot ratio of the run, divided by the largest.

        The result does not depend on the length of steps: the ratio is evaluated within steps, too, and small
        minima are refined twice. A ratio of NaN counts as 0.
        """
        places = self._places()
        ratios = self._pivot_ratios(self._ends if len(places) == len(self._ends) else self._states(places))
        least, most = ratios.min(), ratios.max()
        for _ in range(2):
            small = ratios < FAR_PIVOT_RATIO * most
            if least < NEAR_PIVOT_RATIO * most or not small.any():
                break
            padded = np.pad(ratios, 1, constant_values=np.inf)
            (lowest,) = np.nonzero(small & (ratios <= padded[:-2]) & (ratios <= padded[2:]))
            first, last = places[np.maximum(lowest - 1, 0)], places[np.minimum(lowest + 1, len(places) - 1)]
            places = np.unique(np.linspace(first, last, 2 * PIVOT_REFINEMENT + 1))
            ratios = self._pivot_ratios(self._states(places))
            least = min(least, ratios.min())
        return float(least / most) if most > 0.0 else 0.0

    def jump(self) -> str:
        """Describe the force that jumps in the run, and the time; empty if no force jumps.

        A vector that turns far within a step is examined at points between: a jump reverses it at once.
        """
        turned = np.any([*self._reversals(self._ends).values()], axis=0)
        for step in np.flatnonzero(turned):
            x = self._states(np.linspace(step, step + 1, PIVOT_REFINEMENT * PIVOT_REFINEMENT))
            for force, found in self._reversals(x).items():
                if found.any():
                    return f"{force} jumps at t = {x[found.argmax(), self._n]:.6g} s"
        return ""

    def _reversals(self, x: Array) -> dict[str, Array]:
        """True (k - 1,) where the vector of a force reverses between two of x (k, inputs), by its name."""
        vectors = self._evaluated(SIGN_CHANGES, x)
        products = vectors[1:] * vectors[:-1]
        layout = self._code.function(SIGN_CHANGES).layout
        return {
            force: products[:, first:last].sum(axis=1) < 0.0 for force, (first, last, _) in layout.items()
        }

    def _places(self) -> Array:
        """Return step numbers and fractions of a step (k,): both ends, and at most `PIVOT_SPACING` apart."""
        counts = np.repeat(self._counts, self._counts)
        first = np.repeat(np.cumsum(self._counts) - self._counts, self._counts)
        step = np.repeat(np.arange(len(self._counts)), self._counts)
        return np.append(step + (np.arange(len(first)) - first) / counts, len(self._counts))

    @cached_property
    def _slopes(self) -> Array:
        """Rates (m + 1, nq) of coordinates at both ends of all steps."""
        return self._evaluated("rate", self._ends)

    def _states(self, places: Array) -> Array:
        """Return x (k, inputs) at places (k,), with the velocities at the beginning of the step."""
        step = np.minimum(places.astype(int), len(self._counts) - 1)
        share, size = (places - step)[:, None], self._sizes[step]
        x, nq = self._ends[step], self._nq
        begin, end = size * self._slopes[step], size * self._slopes[step + 1]
        change = self._ends[step + 1, :nq] - x[:, :nq]
        change -= 2.0 * np.pi * np.round((change - 0.5 * (begin + end)) / (2.0 * np.pi))  # of angles
        bend = (1.0 - share) * (begin - change) + share * (change - end)
        x[:, :nq] += share * (change + (1.0 - share) * bend)
        x[:, self._n] += share[:, 0] * size[:, 0]
        return x

    def _pivot_ratios(self, x: Array) -> Array:
        """Return pivot ratios (k,) at x (k, inputs)."""
        ratios = self._evaluated("velocity", x)[:, -1]
        return np.where(ratios > 0.0, ratios, 0.0)

    def _evaluated(self, program: str, x: Array) -> Array:
        """Evaluate a program at x (k, inputs)."""
        function = self._code.function(program)
        return at_rows(function, x[:, : function.inputs])


class FollowedRun:
    """Function that runs a compiled scene with derivatives along directions."""

    def __init__(self, code: TangentCode, options: Options, programs: Sequence[str]) -> None:
        """Prepare the run.

        Args:
            code: compiled scene with derivatives.
            options: step control.
            programs: names of the programs whose results are differentiated, "output" or "coordinates".

        Raises:
            SensitivityError: for a sampled controller, naming its joint.
        """
        scene = code.scene
        if scene.sampled:
            raise SensitivityError(f"sampled controller of joint {scene.sampled[0].joint!r} has none")
        self._code, self._options, self._programs = code, options, programs

    def __call__(self, x: Array, directions: Array, times: Array | None = None) -> Followed:
        """Run from x (inputs,) with derivatives along directions (inputs, p).

        Args:
            x, directions: input vector and directions at the start; changed to their values at the end.
            times: output times, s; those of the scene if None.

        Raises:
            IntegrationError: for a run that stops.
            SensitivityError: for a run near a singular configuration, or without derivatives.
        """
        parts: dict[str, list[Array]] = {name: [] for name in self._programs}

        def differentiate(integrator: Integrator, begun: Array, interval: Interval) -> None:
            """Integrate the directions through an interval between jumps, after its run."""
            for name, part in self._along(integrator, begun, interval, directions).items():
                parts[name].append(part if interval.is_output.all() else part[interval.is_output])

        run = integrate_intervals(
            self._code, x, self._options, room=RECORDED_STEPS, after_interval=differentiate, times=times
        )
        if run.stopped:
            raise run.stopped
        derivatives = {
            name: found[0] if len(found) == 1 else np.concatenate(found) for name, found in parts.items()
        }
        return Followed(run.results, derivatives, reported_counts(run.counts), run.wall_time)

    def _along(
        self, integrator: Integrator, begun: Array, interval: Interval, directions: Array
    ) -> dict[str, Array]:
        """Integrate directions (inputs, p) through an interval from x (inputs,); results by program."""
        code = self._code
        steps = int(integrator.counts[Count.STEPS])
        if steps > len(integrator.steps):
            integrator = Integrator(code, interval.times, self._options, room=steps)
            integrator(begun)
        path = _Path(code, integrator.steps[:steps], begun, integrator.x)
        self._check(path)
        self._turn_pieces(begun, interval, directions)
        for rates in code.rates:
            found = self._carried(rates, integrator, begun, directions)
            if found is not None:
                return found
        near = code.loses_rank and path.least_pivot_ratio() < NEAR_PIVOT_RATIO
        raise SensitivityError(NEAR_SINGULAR if near else MASS_RATIO)

    def _check(self, path: _Path) -> None:
        """Raise `SensitivityError` for a run without derivatives, or without known derivatives."""
        code = self._code
        if code.projects and code.moves_loops and path.least_pivot_ratio() < NEAR_PIVOT_RATIO:
            raise SensitivityError(NEAR_SINGULAR)
        if any(force.may_jump for force in code.scene.forces) and (jump := path.jump()):
            raise SensitivityError(f"{jump}, a time that depends on parameters")

    def _carried(
        self, program: str, integrator: Integrator, begun: Array, directions: Array
    ) -> dict[str, Array] | None:
        """Integrate directions (inputs, p) along the recorded steps of a run.

        Args:
            program: name of the program of rates.
            integrator: has made the run.
            begun: x (inputs,) at the beginning.
            directions: changed to their values at the end.

        Returns:
            Derivatives at the output times by program; None, without changes, if pivot ratios are too small
            for this program of rates.
        """
        # results, and the record of the native code
        code, most, rates = self._code, max_adaptive_steps(self._options), self._code.function(program)
        floor = UNSAFE_PIVOT_RATIO if program == RATES else NEAR_PIVOT_RATIO
        settled = code.function(PROJECTED) if code.projects else None
        functions = {name: code.function(name + ALONG) for name in self._programs}
        n, inputs, lanes, rows = code.size, code.inputs, rates.lanes, len(integrator.times)
        found = {
            name: np.empty((rows, function.outputs, directions.shape[1]))
            for name, function in functions.items()
        }
        x, wide = np.zeros((2 * inputs, lanes)), next(iter(functions.values())).lanes
        python, ends = Callbacks(np.zeros(COUNTS)), directions[:n].copy()
        tangents = Tangents(
            n=n,
            inputs=inputs,
            known=code.flags.stop,
            lanes=lanes,
            wide=wide,
            count=int(integrator.counts[Count.STEPS]),
            rows=rows,
            max_substeps=most,
            projecting=int(code.projects),
            places=code.system.work.start,
            speeds=code.system.nq,
            tolerance=TOLERANCE_FACTOR * self._options.rtol,
            floor=floor if code.projects else -HUGE,
            rates=rates,
            project=settled,
            pause=python.pause,
            steps=integrator.steps,
            times=integrator.times,
            states=integrator.table,
            flags=np.empty((rows, code.flags.stop - code.flags.start)),
            x=x,
            wide_x=np.empty((2 * inputs, wide)),
            at=np.zeros_like(x),
            k=np.empty((17, 2 * n + 1, lanes)),
            table=np.empty((rows, n, lanes)),
            min_pivot_ratio=np.ones(1),
            errors=np.empty(2 * lanes),
            longer_errors=np.empty(lanes + 1),
            noise=np.zeros(lanes),
            counts=np.zeros(len(TangentCount)),
            found=np.empty((max(n, *(function.outputs for function in functions.values())), wide)),
        )
        # integrate groups of directions side by side
        for first in range(0, directions.shape[1], lanes):
            beside = directions[:, first : first + lanes]
            together = beside.shape[1]
            x[:inputs] = begun[:, None]
            x[inputs:] = 0.0
            x[inputs:, :together] = beside
            tangents.at[:] = x
            tangents.noise[:] = 0.0
            with python.interruptible():
                status = tangent_methods()(integrate_tangents, tangents, integrator.x)
            if status == Status.SINGULAR:
                return None
            if status == Status.TOO_MANY_STEPS:
                reached = tangents.counts[TangentCount.TIME_REACHED]
                limit = f"more than {most} parts of steps at t = {reached:.6g} s"
                raise SensitivityError(f"{limit}; derivatives vibrate much faster than the run moves")
            ends[:, first : first + together] = x[inputs : inputs + n, :together]
            # project the directions at the outputs, and differentiate the results of all programs
            if settled:
                tangent_methods()(evaluate_along, tangents, 1, together, settled, n, 0, lanes, tangents.table)
            for name, function in functions.items():
                into = function.outputs, first, directions.shape[1], found[name]
                tangent_methods()(evaluate_along, tangents, 0, together, function, *into)
        directions[:n] = ends
        return found

    def _turn_pieces(self, x: Array, interval: Interval, directions: Array) -> None:
        """Set directions (inputs, p) of the pieces of functions, which are linear in parameters."""
        code = self._code
        if not code.piecewise:
            return
        for name, changes in pieces_along(code.parametrized, x, directions, interval.middle).items():
            place = code.place(name)
            directions[place : place + len(changes)] = changes
