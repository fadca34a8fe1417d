"""Runs of a scene with derivatives along directions of the initial state and of the parameters.

A run is integrated first, and its steps are recorded. The derivatives, called tangents, satisfy the
linearized equations of motion. They are integrated along the recorded steps
(`newton_euler.integrators.tangent_steps`) and projected onto the linearized constraints.

x (inputs,) is the input vector of compiled programs: the state (q, v) of length n, time, flags that select
constraint rows, and parameters. A direction (inputs,) is a change of x. Native code treats several directions
at once, each in one lane of a vector register.
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
"""Error message of runs near a singular configuration, where derivatives grow without bound."""

MASS_RATIO = "masses differ too much: beside heavy bodies, light ones amplify the errors of derivatives"
"""Error message of runs whose equations of motion have small pivots although constraints are regular."""

PIVOT_SPACING = 0.1
"""Largest motion, rad or sizes of the mechanism, between two states of a run at which pivot ratios are
evaluated. A pivot ratio is the smallest ratio of a pivot of the constraint equations to its reference
magnitude; it vanishes at a singular configuration."""

PIVOT_REFINEMENT = 20
"""Number of points on each side of a minimum at which pivot ratios are evaluated again, twice in a row."""

TOLERANCE_FACTOR = 100.0
"""Tolerance of derivatives, divided by the run's `rtol`. At this value the steps of the run are rarely too
long for the derivatives, and rarely divided."""

RECORDED_STEPS = 2048
"""Number of steps of a run for which memory is allocated. A longer run is repeated with more memory."""


def tangent_options(control: Mapping[str, Any]) -> Options:
    """Return the options of DOP853 with projection; derivatives exist for no other method.

    The option `rest`, rates below which a mechanism counts as at rest and is not integrated, must be 0.

    Args:
        control: options of the run by name.

    Raises:
        OptionError: for another integrator or stabilization, and for options that DOP853 does not have.
    """
    chosen = dict(control)
    for name, only in (("integrator", "DOP853"), ("stabilization", "projection"), ("rest", 0.0)):
        value = chosen.pop(name, only)
        if not isinstance(value, str | float | int) or value != only:
            raise OptionError(name, value, f"{only}, which derivatives are of")
    return Options.of("DOP853", cast(StepControl, chosen))


class TangentResults(NamedTuple):
    """A run at its m output times, with its derivatives along p directions.

    Attributes:
        results: (m, outputs) outputs of the scene.
        derivatives: (m, results, p) by program, "output" or "coordinates". The program "coordinates" has the
            joint coordinates and rates themselves, followed by their derivatives.
        counts: numbers of steps and evaluations by name.
        wall_time: s, of the run and its derivatives.
    """

    results: Array
    derivatives: dict[str, Array]
    counts: dict[str, float]
    wall_time: float


class _RecordedMotion:
    """Motion of a run between its recorded steps, interpolated by cubics through states and rates.

    A place in the motion is a number of a step plus a fraction of this step, such as 2.5 for the middle of
    step 2.

    Pivot ratios are those of Phi_q Phi_q^T with the dimensionless constraint Jacobian Phi_q, without masses.
    Pivot ratios with masses would also vanish where a light body is at a dead center.
    """

    def __init__(self, code: TangentCode, steps: Array, begin: Array, end: Array) -> None:
        """Collect states, times and flags at the ends of all steps.

        Args:
            code: compiled equations.
            steps: (m, n + 2 + flags) state, time and flags at the start of each step, and its size, s.
            begin, end: x (inputs,) at the beginning and at the end.
        """
        n, nq, recorded = code.size, code.system.nq, code.flags.stop
        self._code, self._n, self._nq = code, n, nq
        # sizes (m, 1), s; the last step may reach beyond the end
        self._sizes = np.minimum(steps[:, -1:], end[n] - steps[:, n : n + 1])
        self._ends = np.tile(begin, (len(steps) + 1, 1))
        self._ends[:-1, :recorded] = steps[:, :recorded]
        self._ends[-1, :recorded] = end[:recorded]
        # number of parts of each step, so that the motion in a part is at most `PIVOT_SPACING`
        speeds = np.abs(self._ends[:, nq:n] / code.system.velocity_units).max(axis=1, initial=0.0)
        moved = self._sizes[:, 0] * np.maximum(speeds[:-1], speeds[1:])
        self._part_counts = 1 + (moved / PIVOT_SPACING).astype(int)

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
            # local minima, and finer places between the neighbors of each
            padded = np.pad(ratios, 1, constant_values=np.inf)
            (minima,) = np.nonzero(small & (ratios <= padded[:-2]) & (ratios <= padded[2:]))
            first, last = places[np.maximum(minima - 1, 0)], places[np.minimum(minima + 1, len(places) - 1)]
            places = np.unique(np.linspace(first, last, 2 * PIVOT_REFINEMENT + 1))
            ratios = self._pivot_ratios(self._states(places))
            least = min(least, ratios.min())
        return float(least / most) if most > 0.0 else 0.0

    def jump(self) -> str:
        """Describe the force that jumps in the run, and the time; empty if no force jumps.

        The vector of a force reverses at a jump, see `SIGN_CHANGES`. A vector that reverses within a step is
        examined at many places of the step, because a smooth rotation may have reversed it.
        """
        has_reversed = np.any([*self._reversals(self._ends).values()], axis=0)
        for step in np.flatnonzero(has_reversed):
            x = self._states(np.linspace(step, step + 1, PIVOT_REFINEMENT * PIVOT_REFINEMENT))
            for force, reversals in self._reversals(x).items():
                if reversals.any():
                    return f"{force} jumps at t = {x[reversals.argmax(), self._n]:.6g} s"
        return ""

    def _reversals(self, x: Array) -> dict[str, Array]:
        """Find where the vector of each force that may jump reverses between two successive x.

        Args:
            x: (k, inputs) states with time and parameters.

        Returns:
            (k - 1,) True for a reversal, by name of the force.
        """
        vectors = self._evaluated(SIGN_CHANGES, x)
        products = vectors[1:] * vectors[:-1]
        layout = self._code.function(SIGN_CHANGES).layout
        return {
            force: products[:, first:last].sum(axis=1) < 0.0 for force, (first, last, _) in layout.items()
        }

    def _places(self) -> Array:
        """Return places (k,) in the motion, at most `PIVOT_SPACING` apart: ends of all parts of steps."""
        counts = self._part_counts
        step = np.repeat(np.arange(len(counts)), counts)
        first_part = np.repeat(np.cumsum(counts) - counts, counts)
        fraction = (np.arange(len(first_part)) - first_part) / np.repeat(counts, counts)
        return np.append(step + fraction, len(counts))

    @cached_property
    def _slopes(self) -> Array:
        """Rates (m + 1, nq) of coordinates at both ends of all steps."""
        return self._evaluated("rate", self._ends)

    def _states(self, places: Array) -> Array:
        """Return x (k, inputs) at places (k,), with the velocities at the beginning of the step.

        Let s be the fraction of a step, h its size, d the change of a coordinate in the step, and r_0 and r_1
        the rates at its ends. The cubic is q_0 + s (d + (1 - s) ((1 - s) (h r_0 - d) + s (d - h r_1))).
        """
        step = np.minimum(places.astype(int), len(self._part_counts) - 1)
        fraction, size = (places - step)[:, None], self._sizes[step]
        x, nq = self._ends[step], self._nq
        begin, end = size * self._slopes[step], size * self._slopes[step + 1]
        change = self._ends[step + 1, :nq] - x[:, :nq]
        # remove full revolutions, by which the run may change an angle at the end of a step
        change -= 2.0 * np.pi * np.round((change - 0.5 * (begin + end)) / (2.0 * np.pi))
        deviation = (1.0 - fraction) * (begin - change) + fraction * (change - end)
        x[:, :nq] += fraction * (change + (1.0 - fraction) * deviation)
        x[:, self._n] += fraction[:, 0] * size[:, 0]
        return x

    def _pivot_ratios(self, x: Array) -> Array:
        """Return pivot ratios (k,) at x (k, inputs)."""
        ratios = self._evaluated("velocity", x)[:, -1]  # after the results of the projection of velocities
        return np.where(ratios > 0.0, ratios, 0.0)

    def _evaluated(self, program: str, x: Array) -> Array:
        """Evaluate a program by name at x (k, inputs); programs may need only the first elements of x."""
        function = self._code.function(program)
        return at_rows(function, x[:, : function.inputs])


class TangentRun:
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

    def __call__(self, x: Array, directions: Array, times: Array | None = None) -> TangentResults:
        """Run from x (inputs,) with derivatives along directions (inputs, p).

        Args:
            x, directions: input vector and directions at the start; changed to their values at the end.
            times: output times, s; those of the scene if None.

        Raises:
            IntegrationError: for a run that stops.
            SensitivityError: for a run near a singular configuration, or without derivatives.
        """
        # derivatives by program, one array for each interval between knots of splines
        parts: dict[str, list[Array]] = {name: [] for name in self._programs}

        def differentiate(integrator: Integrator, begin: Array, interval: Interval) -> None:
            """Integrate the directions through an interval, after its run."""
            for name, part in self._along(integrator, begin, interval, directions).items():
                parts[name].append(part if interval.is_output.all() else part[interval.is_output])

        run = integrate_intervals(
            self._code, x, self._options, room=RECORDED_STEPS, after_interval=differentiate, times=times
        )
        if run.stopped:
            raise run.stopped
        derivatives = {
            name: arrays[0] if len(arrays) == 1 else np.concatenate(arrays) for name, arrays in parts.items()
        }
        return TangentResults(run.results, derivatives, reported_counts(run.counts), run.wall_time)

    def _along(
        self, integrator: Integrator, begin: Array, interval: Interval, directions: Array
    ) -> dict[str, Array]:
        """Integrate directions through an interval.

        Args:
            integrator: has made the run in this interval, and recorded its first steps.
            begin: x (inputs,) at the beginning.
            interval: the interval.
            directions: (inputs, p) at the beginning; changed to their values at the end.

        Returns:
            Derivatives (m, results, p) at the m times of the interval, by program.
        """
        # a run of more steps than recorded is repeated
        code = self._code
        steps = int(integrator.counts[Count.STEPS])
        if steps > len(integrator.steps):
            integrator = Integrator(code, interval.times, self._options, room=steps)
            integrator(begin)
        motion = _RecordedMotion(code, integrator.steps[:steps], begin, integrator.x)
        self._check(motion)
        self._set_piece_directions(begin, interval, directions)
        # the first program of rates whose results are accurate
        for rates in code.rates:
            derivatives = self._integrate(rates, integrator, begin, directions)
            if derivatives is not None:
                return derivatives
        # constraints of loops and couplings lose rank in singular configurations; otherwise small pivots come
        # from the masses
        is_near_singular = code.loses_rank and motion.least_pivot_ratio() < NEAR_PIVOT_RATIO
        raise SensitivityError(NEAR_SINGULAR if is_near_singular else MASS_RATIO)

    def _check(self, motion: _RecordedMotion) -> None:
        """Raise `SensitivityError` for a run without derivatives, or whose derivatives are inaccurate."""
        code = self._code
        # near a singular configuration only derivatives by parameters that move loops grow without bound
        if code.projects and code.moves_loops and motion.least_pivot_ratio() < NEAR_PIVOT_RATIO:
            raise SensitivityError(NEAR_SINGULAR)
        if any(force.may_jump for force in code.scene.forces) and (jump := motion.jump()):
            raise SensitivityError(f"{jump}, a time that depends on parameters")

    def _integrate(
        self, program: str, integrator: Integrator, begin: Array, directions: Array
    ) -> dict[str, Array] | None:
        """Integrate directions (inputs, p) along the recorded steps of a run.

        Args:
            program: name of the program of rates of state and tangent.
            integrator: has made the run.
            begin: x (inputs,) at the beginning.
            directions: changed to their values at the end.

        Returns:
            Derivatives at the output times by program; None, without changes, if pivot ratios are too small
            for this program of rates.
        """
        # functions: rates, projection, and results to differentiate. The program `RATES` refines its solution
        # iteratively, so that it is accurate at smaller pivot ratios than the others
        code, max_substeps = self._code, max_adaptive_steps(self._options)
        rates = code.function(program)
        min_pivot_ratio = UNSAFE_PIVOT_RATIO if program == RATES else NEAR_PIVOT_RATIO
        project = code.function(PROJECTED) if code.projects else None
        functions = {name: code.function(name + ALONG) for name in self._programs}
        # arrays of the results, and the record of the native code, whose class describes the fields. Programs
        # of results have `wide` lanes, which may hold directions at several output times
        n, inputs, lanes, rows = code.size, code.inputs, rates.lanes, len(integrator.times)
        derivatives = {
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
            max_substeps=max_substeps,
            projecting=int(code.projects),
            places=code.system.work.start,  # end of the coordinates in a state; the work of forces follows
            speeds=code.system.nq,  # start of the velocities
            tolerance=TOLERANCE_FACTOR * self._options.rtol,
            floor=min_pivot_ratio if code.projects else -HUGE,
            rates=rates,
            project=project,
            pause=python.pause,
            steps=integrator.steps,
            times=integrator.times,
            states=integrator.table,
            flags=np.empty((rows, code.flags.stop - code.flags.start)),
            x=x,
            wide_x=np.empty((2 * inputs, wide)),
            at=np.zeros_like(x),
            k=np.empty((17, 2 * n + 1, lanes)),  # rates of the 16 stages of DOP853, and scratch
            table=np.empty((rows, n, lanes)),
            min_pivot_ratio=np.ones(1),
            errors=np.empty(2 * lanes),
            longer_errors=np.empty(lanes + 1),
            noise=np.zeros(lanes),
            counts=np.zeros(len(TangentCount)),
            found=np.empty((max(n, *(function.outputs for function in functions.values())), wide)),
        )
        # integrate groups of directions, one direction in each lane
        for first in range(0, directions.shape[1], lanes):
            group = directions[:, first : first + lanes]
            group_size = group.shape[1]
            x[:inputs] = begin[:, None]
            x[inputs:] = 0.0
            x[inputs:, :group_size] = group
            tangents.at[:] = x
            tangents.noise[:] = 0.0
            with python.interruptible():
                status = tangent_methods()(integrate_tangents, tangents, integrator.x)
            if status == Status.SINGULAR:
                return None
            if status == Status.TOO_MANY_STEPS:
                reached = tangents.counts[TangentCount.TIME_REACHED]
                limit = f"more than {max_substeps} parts of steps at t = {reached:.6g} s"
                raise SensitivityError(f"{limit}; derivatives vibrate much faster than the run moves")
            ends[:, first : first + group_size] = x[inputs : inputs + n, :group_size]
            # project the directions at the outputs, except at the start (row 0); then differentiate the
            # results of all programs at all outputs. A place is the number of results, the first column to
            # write, the number of columns, and the array
            call_native = tangent_methods()
            if project:
                place = n, 0, lanes, tangents.table
                call_native(evaluate_along, tangents, 1, group_size, project, *place)
            for name, function in functions.items():
                place = function.outputs, first, directions.shape[1], derivatives[name]
                call_native(evaluate_along, tangents, 0, group_size, function, *place)
        directions[:n] = ends
        return derivatives

    def _set_piece_directions(self, x: Array, interval: Interval, directions: Array) -> None:
        """Set the directions of the polynomial pieces of functions of time, in place.

        The coefficients of the piece that is valid in an interval are elements of x and depend linearly on
        parameters such as the samples of a spline.

        Args:
            x: (inputs,) at the beginning of the interval.
            interval: the interval.
            directions: (inputs, p).
        """
        code = self._code
        if not code.piecewise:
            return
        for name, changes in pieces_along(code.parametrized, x, directions, interval.middle).items():
            place = code.place(name)
            directions[place : place + len(changes)] = changes
