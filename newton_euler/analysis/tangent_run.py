"""Runs with their derivatives along directions of the start and of the parameters.

Traced derivatives of the equations of motion are carried along the steps of a run beside its states
(`newton_euler.integrators.tangents`), on the linearized constraints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np

from newton_euler.codegen.compile import VERY_LARGE, Traced
from newton_euler.codegen.expression import Graph, Program, differentiate_along, substitute
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.parameters import is_kinematic, pieces, places
from newton_euler.equations.sparse import least_squares, solve_constrained, sparse_vector
from newton_euler.errors import OptionError, SensitivityError
from newton_euler.integrators import stepper as m
from newton_euler.integrators.options import FormulationName, Options, StepControl
from newton_euler.integrators.outputs import at_rows
from newton_euler.integrators.run import Fallback, Integrator, most_steps
from newton_euler.integrators.singular import NEAR, UNSAFE
from newton_euler.integrators.tangents import (
    REACHED,
    Tangents,
    evaluate_along,
    follow,
    methods,
    settle_outputs,
)
from newton_euler.model.scene import Scene
from newton_euler.sampling import Interval, integrate_intervals
from newton_euler.scalars import Array, Scalar, minimum, objects, zeros
from newton_euler.simulate import CompiledScene
from newton_euler.starts import Assembly, initial_numbers
from newton_euler.variation import own_values, run_values

TOO_NEAR = "the run comes too near to a singular configuration"
ALONG = " along"
RATES, SETTLED = "derivative" + ALONG, "settled" + ALONG  # names of programs that have a direction behind x
DIFFERENCE = 1e-4  # of parameters of starts, of the mechanism's size, m, or of their own value beyond 1

WEIGHTS = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
"""Of the central difference of order 6."""

COARSE = np.array([0.0, 1.0, -8.0, 8.0, -1.0, 0.0]) / 12.0
"""Of that of order 4, by the same places."""

APART = 1e-6
"""By which the two may differ, of the largest of what they are of: near singular configurations they do."""

LEAST = 1e-3  # SI, of numbers that are compared
SPACING = 0.05  # rad, or share of the size, between states whose pivot ratios are looked at
FINER = 20  # pivot ratios between two that are beside a least one, twice
OF_TANGENTS = 100.0  # their tolerance in units of `rtol`: hardly a step of a scene that moves is divided
ROOM = 2048  # steps of a run that there is room for; those of a longer one are taken twice


def tangent_code(scene: Scene, names: Sequence[str], formulation: FormulationName | None) -> TangentCode:
    """Return the code of a scene with derivatives by numbers that are parameters, see `components`."""
    initial = initial_numbers(scene, names)
    code = TangentCode(scene, formulation, parameters=[name for name in names if name not in initial])
    code.alone = len(names) == 1
    return code


def tangent_options(control: Mapping[str, Any]) -> Options:
    """Return the options of DOP853 with projection, of which alone there are derivatives.

    Raises:
        OptionError: for another integrator or stabilization, and for options that it does not have.
    """
    chosen = dict(control)
    for name, only in (("integrator", "DOP853"), ("stabilization", "projection"), ("rest", 0.0)):
        if (value := chosen.pop(name, only)) != only:
            raise OptionError(name, value, f"{only}, which derivatives are of")
    return Options.of("DOP853", cast(StepControl, chosen))


def components(scene: Scene, names: Sequence[str]) -> tuple[str, ...]:
    """Return the names (p,) of the numbers of parameters, those of symmetric matrices once."""
    found = list[str]()
    for name, value in own_values(scene, names).items():
        for index in np.ndindex(*value.shape):
            if value.shape == (3, 3) and index[0] > index[1]:
                continue
            spatial = set(value.shape) == {3}
            component = "".join("xyz"[k] for k in index) if spatial else ".".join(map(str, index))
            found.append(f"{name}.{component}" if component else name)
    return tuple(found)


def own_numbers(scene: Scene, names: Sequence[str]) -> Array:
    """Return the scene's own values (p,) of numbers that are parameters, initial coordinates among them."""
    return np.array([float(value) for value in own_values(scene, names).values()])


class Starts:
    """Starts of a scene's runs with p of its numbers, and their derivatives by these.

    Derivatives of the assembly are differences of order 6 of what Newton's steps assemble to round-off, good
    to 1e-11, or refused where those of order 4 differ from them; they are put on the linearized constraints
    with all others.
    """

    def __init__(
        self, code: CompiledScene, names: Sequence[str], held: Mapping[str, float] | None = None
    ) -> None:
        """`held` are initial coordinates and rates that are not among the p numbers."""
        self._code, self._held = code, np.array(list((held or {}).values()))
        self._names = (*names, *(held or {}))
        self._assembly = Assembly(code.scene, self._names)
        moving = {*self._assembly.kinematic, *self._assembly.initial}
        self._moving = [k for k, name in enumerate(names) if name in moving]

    def __call__(self, numbers: Array) -> tuple[Array, Array]:
        """Compute x (inputs,) of the start with these numbers (p,), and its derivatives (inputs, p).

        Raises:
            MechanismError: for numbers that make no sense, and those with which a loop stays open.
        """
        code, step = self._code, DIFFERENCE * min(1.0, self._code.scene.mechanism.size)
        steps = step * np.maximum(1.0, np.abs(numbers))
        count, numbers = len(numbers), np.concatenate([numbers, self._held])
        x, directions = code.start.copy(), np.zeros((code.inputs, count))
        for k, name in enumerate(self._names[:count]):
            if name in code.parameters:
                x[code.place(name)] = numbers[k]
                directions[code.place(name), k] = 1.0
        rows = [numbers]
        for k in self._moving:
            for number in WEIGHTS:
                rows.append(numbers.copy())
                rows[-1][k] += number * steps[k]
        values = run_values(code.scene, dict(zip(self._names, np.array(rows).T, strict=True)))
        for error in values.errors.values():
            raise error
        if self._assembly.is_needed:
            found, errors = self._assembly(values.arrays)
            for row, error in errors.items():
                if row == 0:
                    raise error
                name = self._names[self._moving[(row - 1) // len(WEIGHTS)]]
                raise SensitivityError(f"{name} cannot vary alone: {error.problem}")
            states = self._assembly.starts(code, found)
            x[: code.size] = states[0]
            weights, system = np.array(list(WEIGHTS.values())), code.system
            angles = [*system.angles.values(), *system.uncounted_angles]  # within a revolution
            for k, moved in zip(self._moving, states[1:].reshape(-1, len(weights), code.size), strict=True):
                apart = moved - states[0]
                apart[:, angles] -= 2.0 * np.pi * np.round(apart[:, angles] / (2.0 * np.pi))
                fine, coarse = weights @ apart / steps[k], COARSE @ apart / steps[k]
                for part in (slice(system.nq), slice(system.nq, code.size)):
                    largest = np.abs([fine[part], states[0, part]]).max(initial=LEAST)
                    if not np.abs(fine - coarse)[part].max(initial=0.0) <= APART * largest:
                        unknown = f"the derivative of the start by {self._names[k]} is not known"
                        raise SensitivityError(f"{unknown}: {TOO_NEAR}")
                directions[: code.size, k] = fine
        return x, directions


class Followed(NamedTuple):
    """A run with its derivatives along p directions."""

    results: Array
    """(n, outputs) what the scene asks for."""
    derivatives: dict[str, Array]
    """(n, outputs, p) of programs, by name; of "coordinates" these themselves before."""
    counts: dict[str, int]
    wall_time: float
    """s, of the run and its derivatives."""


class TangentCode(CompiledScene):
    """A compiled scene with derivatives along a direction of (q, v, parameters).

    Programs whose names end with `ALONG` take x with a direction behind it, another x; several directions
    are taken side by side.
    """

    alone = False
    """True if there is a single direction."""

    @cached_property
    def kept(self) -> int:
        """All elements of a state: derivatives need them, whatever the outputs."""
        return self.size

    @cached_property
    def moves_loops(self) -> bool:
        """True if parameters move the closed configurations: near singular ones without bound."""
        found = places(self.scene, self._named).values()
        return any(is_kinematic(place) and place.owner[0] != "bodies" for place in found)

    def _traced(self, name: str, in_lanes: bool) -> Traced:
        if not name.endswith(ALONG):
            return super()._traced(name, in_lanes)
        program = self.program(name)
        straight = program.operations < VERY_LARGE
        many = name != RATES or not self.alone  # a single direction is beside itself at other output times
        return Traced(program, many, self._layouts.get(name), straight=straight)

    def _identity_of(self, name: str) -> str | None:
        known = super()._identity_of(name.removesuffix(ALONG))
        return known and f"{known}{' alone' * (self.alone and name == RATES)}"

    def _trace(self, name: str) -> Program:
        if not name.endswith(ALONG):
            return super()._trace(name)
        graph, base = Graph(), name.removesuffix(ALONG)
        x, along = graph.variables(self.inputs), graph.variables(self.inputs)
        along[self.size] = 0.0  # at the same time
        system = self._system_of(x, tuple(self.parameters))
        if name == SETTLED:
            return graph.prune(self._settled(system, x, along))
        if name == RATES:
            return graph.prune(self._rates_along(system, x, along))._replace(inputs=2 * self.inputs)
        scalars = self._scalars(base, system, x)
        kept = self._smooth(scalars) if base == "output" else scalars
        found = differentiated(kept, x, along)
        return graph.prune([*kept, *found] if base == "coordinates" else found)

    def _rates_along(self, system: Formulation, x: Array, along: Array) -> list[Scalar]:
        """Return (qdot, vdot), their derivatives, and the pivot ratio.

        Accelerations are differentiated implicitly: the residuals of the equations that they solve, for
        accelerations and multipliers held, are what the equations are solved for once more, with the same
        factors.
        """
        q, v, graph = x[: system.nq], x[system.nq : self.size], x[-1].graph
        equations = system.sparse_equations(q, v, self.rows)
        solution = solve_constrained(equations)
        count, used = len(equations.factor.columns), equations.rows.numbers
        accelerations, of_rows = graph.variables(count), graph.variables(len(used))
        multipliers = zeros(len(equations.jacobian), x)
        multipliers[used] = of_rows
        held = [*accelerations, *of_rows]
        values = [solution.acceleration.get(k, 0.0) for k in range(count)]
        values += [solution.multipliers.get(i, 0.0) for i in used]
        residuals = system.sparse_residuals(q, v, self.rows, accelerations, multipliers)
        right = substitute(graph, differentiated(np.concatenate(residuals).tolist(), x, along), held, values)
        force, gamma = sparse_vector([-change for change in right[:count]]), -objects(right[count:])
        found = solve_constrained(equations._replace(force=force, gamma=gamma)).acceleration
        moved = [found.get(k, 0.0) for k in range(count)]
        of_held = replace(solution, acceleration=dict(enumerate(accelerations)))
        vdot = system.sparse_vdot(q, v, of_held).tolist()
        changes = differentiate_along(graph, vdot, [*x, *accelerations], [*along, *moved])
        rates = [*system.rate(q, v), *system.sparse_vdot(q, v, solution)]
        changes = differentiated(rates[: system.nq], x, along) + substitute(graph, changes, held, values)
        return [*rates, *changes, minimum(solution.pivot_ratio, 1.0)]

    def _settled(self, system: Formulation, x: Array, along: Array) -> list[Scalar]:
        """Put a direction at a state on the constraints on the linearized ones, (q, v) of it.

        By steps of least length, as states are: of coordinates, then of velocities.
        """
        on_q, on_v = slice(system.nq), slice(system.nq, self.size)
        q, v, moved = x[on_q], x[on_v], along.copy()
        for place in system.quaternions:
            moved[place] -= q[place] * (q[place] @ moved[place])
        phi, jacobian = system.phi_and_jacobian(q)
        rows, units = self._dimensionless(system, jacobian), system.velocity_units

        def step(residuals: Sequence[Scalar]) -> Array:
            """The least step (nv,) for residuals (k,) along the direction."""
            right = np.array(differentiated(residuals, x, moved)) / system.phi_units[self.rows.numbers]
            least, _ = least_squares(rows, right)
            return np.array([units[k] * least.get(k, 0.0) for k in range(system.nv)])

        used = self.rows.numbers
        change = system.rate(q, step(phi[used].tolist()))
        change[system.work] = 0.0
        moved[on_q] -= change
        rate = system.phi_rate(q, v)
        norms = {i: sum(e * v[k] for k, e in jacobian[i].items()) for i in used if i >= system.rows}
        moved[on_v] -= step([norms[i] if i in norms else rate[i] for i in used])
        return moved[: self.size].tolist()

    def _smooth(self, scalars: list[Scalar]) -> list[Scalar]:
        """Select the outputs that have derivatives, with a layout of their own."""
        without = {"phi", "pivot_ratio"}
        if self.redundant:  # and not unique
            without |= {"reaction_force", "reaction_torque"}
        kept: list[Scalar] = []
        places: dict[str, tuple[int, int, tuple[int, ...]]] = {}
        for name, (start, stop, shape) in self._layouts["output"].items():
            if name not in without:
                places[name] = len(kept), len(kept) + stop - start, shape
                kept += scalars[start:stop]
        self._layouts["output" + ALONG] = places
        return kept

    def _trace_coordinates(self, system: Formulation, q: Array, v: Array) -> list[Scalar]:
        """Trace the coordinates of all joints, m or rad, then their rates."""
        frames, coordinates, rates = system.frames(q, v), list[Scalar](), list[Scalar]()
        for equations in system.equations:
            for k in range(len(equations.coordinates)):
                x, rate = equations.measure(k, frames)
                coordinates.append(x)
                rates.append(rate)
        return [*coordinates, *rates]


def differentiated(scalars: Sequence[Scalar], x: Array, along: Array) -> list[Scalar]:
    """Differentiate scalars along a direction (inputs,) of x (inputs,)."""
    return differentiate_along(x[-1].graph, scalars, x.tolist(), along.tolist())


class _Path:
    """Motion through the steps of a run, by cubics through the states and rates at their ends.

    Its pivot ratios are those of the constraints alone, Phi_q Phi_q^T without dimension: where a light body
    is at a dead center those with masses vanish, too.
    """

    def __init__(self, code: TangentCode, steps: Array, begun: Array, end: Array) -> None:
        """Of steps (m, n + 2), see `Dop853`, from x (inputs,) to another."""
        n, system = code.size, code.system
        self._velocity, self._sizes = code.function("velocity"), steps[:, n + 1 :]
        self._ends = np.tile(begun, (len(steps) + 1, 1))
        self._ends[:-1, : n + 1] = steps[:, : n + 1]
        self._ends[-1, : n + 1] = end[: n + 1]
        self._slopes = at_rows(code.function("derivative"), self._ends)[:, :n]
        speeds = np.abs(self._ends[:, system.nq : n] / system.velocity_units).max(axis=1, initial=0.0)
        moved = self._sizes[:, 0] * np.maximum(speeds[:-1], speeds[1:])
        self._counts = 1 + (moved / SPACING).astype(int)

    def least_pivot_ratio(self) -> float:
        """Find the least pivot ratio in units of the largest one, independent of where steps end.

        Not a number counts as 0.
        """
        places = np.concatenate([k + np.arange(count) / count for k, count in enumerate(self._counts)])
        places = np.append(places, len(self._counts))
        ratios = self._pivot_ratios(places)
        most = ratios.max()
        for _ in range(2):
            padded = np.pad(ratios, 1, constant_values=np.inf)
            lowest = np.flatnonzero((ratios <= padded[:-2]) & (ratios <= padded[2:]))
            first, last = places[np.maximum(lowest - 1, 0)], places[np.minimum(lowest + 1, len(places) - 1)]
            places = np.unique(np.linspace(first, last, 2 * FINER + 1))
            ratios = self._pivot_ratios(places)
        return float(ratios.min() / most) if most > 0.0 else 0.0

    def _pivot_ratios(self, places: Array) -> Array:
        """Return pivot ratios (k,) at places (k,): numbers of steps and shares of them."""
        step = np.minimum(places.astype(int), len(self._counts) - 1)
        share, size = (places - step)[:, None], self._sizes[step]
        x, n = self._ends[step], self._slopes.shape[1]
        begin, end = size * self._slopes[step], size * self._slopes[step + 1]
        change = self._ends[step + 1, :n] - x[:, :n]
        change -= 2.0 * np.pi * np.round((change - 0.5 * (begin + end)) / (2.0 * np.pi))  # of angles
        bend = (1.0 - share) * (begin - change) + share * (change - end)
        x[:, :n] += share * (change + (1.0 - share) * bend)
        x[:, n] += share[:, 0] * size[:, 0]
        ratios = at_rows(self._velocity, x[:, : self._velocity.inputs])[:, n + 1]
        return np.where(ratios > 0.0, ratios, 0.0)


class FollowedRun:
    """Runs of a compiled scene with their derivatives along directions."""

    def __init__(self, code: TangentCode, options: Options, programs: Sequence[str]) -> None:
        """Make everything ready for derivatives of the results of these programs."""
        scene = code.scene
        if scene.sampled:
            raise SensitivityError(f"sampled controller of joint {scene.sampled[0].joint!r} has none")
        self._code, self._options, self._programs = code, options, programs

    def __call__(self, x: Array, directions: Array, times: Array | None = None) -> Followed:
        """Run from x (inputs,) over the scene's output times, or others, s, along directions (inputs, p).

        Both are changed to what they are at the end.

        Raises:
            IntegrationError: for a run that cannot go on.
            SensitivityError: for one near a singular configuration.
        """
        parts: dict[str, list[Array]] = {name: [] for name in self._programs}

        def carry(integrator: Integrator, begun: Array, interval: Interval) -> None:
            for name, part in self._along(integrator, begun, interval, directions).items():
                parts[name].append(part if interval.wanted.all() else part[interval.wanted])

        run = integrate_intervals(self._code, x, self._options, room=ROOM, carry=carry, times=times)
        if run.stopped:
            raise run.stopped
        derivatives = {
            name: found[0] if len(found) == 1 else np.concatenate(found) for name, found in parts.items()
        }
        return Followed(run.results, derivatives, m.counted(run.counts), run.wall_time)

    def _along(
        self, integrator: Integrator, begun: Array, interval: Interval, directions: Array
    ) -> dict[str, Array]:
        """Carry directions (inputs, p) through an interval from x (inputs,); derivatives there by program."""
        code = self._code
        steps = int(integrator.counts[m.STEPS])
        if steps > len(integrator.steps):
            integrator = Integrator(code, interval.times, self._options, room=steps)
            integrator(begun)
        if code.projects and code.moves_loops:
            path = _Path(code, integrator.steps[:steps], begun, integrator.x)
            if path.least_pivot_ratio() < NEAR:
                raise SensitivityError(TOO_NEAR)
        self._turn_pieces(begun, interval, directions)
        functions = {name: code.function(name + ALONG) for name in self._programs}
        rates, settled = code.function(RATES), code.function(SETTLED) if code.projects else None
        n, inputs, lanes, rows = code.size, code.inputs, rates.lanes, len(interval.times)
        found = {
            name: np.empty((rows, function.outputs, directions.shape[1]))
            for name, function in functions.items()
        }
        x, wide = np.zeros((2 * inputs, lanes)), next(iter(functions.values())).lanes
        python, most = Fallback(code), most_steps(self._options)
        tangents = Tangents(
            n=n,
            inputs=inputs,
            lanes=lanes,
            wide=wide,
            count=steps,
            rows=rows,
            most=most,
            projecting=int(code.projects),
            places=code.system.work.start,
            speeds=code.system.nq,
            tolerance=OF_TANGENTS * self._options.rtol,
            rates=rates,
            settled=settled,
            pause=python.pause,
            steps=integrator.steps,
            times=integrator.times,
            states=integrator.table,
            x=x,
            beside=np.empty((2 * inputs, wide)),
            at=np.zeros_like(x),
            k=np.empty((17, 2 * n + 1, lanes)),
            table=np.empty((rows, n, lanes)),
            least=np.ones(1),
            errors=np.empty(2 * lanes),
            tried=np.empty(lanes + 1),
            noise=np.zeros(lanes),
            counts=np.zeros(3),
            found=np.empty((max(n, *(function.outputs for function in functions.values())), wide)),
        )
        for first in range(0, directions.shape[1], lanes):
            beside = directions[:, first : first + lanes]
            together = beside.shape[1]
            x[:inputs] = begun[:, None]
            x[inputs:] = 0.0
            x[inputs:, :together] = beside
            tangents.at[:] = x
            tangents.noise[:] = 0.0
            with python.interruptible():
                status = methods()(follow, tangents, integrator.x)
            if status == m.TOO_MANY_STEPS:
                reached = f"more than {most} parts of steps at t = {tangents.counts[REACHED]:.6g} s"
                raise SensitivityError(f"{reached}; derivatives vibrate much faster than the run moves")
            if code.projects and tangents.least[0] < UNSAFE:
                raise SensitivityError(TOO_NEAR)
            beside[:n] = x[inputs : inputs + n, :together]
            methods()(settle_outputs, tangents, together)
            for name, function in functions.items():
                into = function.outputs, first, directions.shape[1], found[name]
                methods()(evaluate_along, tangents, together, function, *into)
        return found

    def _turn_pieces(self, x: Array, interval: Interval, directions: Array) -> None:
        """Set directions (inputs, p) of the numbers of functions between knots, linear in parameters."""
        code = self._code
        here = pieces(code.scene, interval.middle)
        if not here:
            return
        here = pieces(code.parametrized(x), interval.middle)
        for direction in directions.T:
            moved = pieces(code.parametrized(x + direction), interval.middle)
            for name, piece in here.items():
                place = code.place(name)
                direction[place : place + piece.size] = moved[name] - piece
