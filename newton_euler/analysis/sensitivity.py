"""Sensitivities: derivatives of trajectories by parameters of a scene.

By traced derivatives of the equations of motion, carried along the steps of a run beside its states
(`newton_euler.integrators.tangents`), on the linearized constraints. The run itself is a plain one, to the
last bit; its tolerances hold for the derivatives about as they do for the states.

The times of events must not depend on parameters: set-points that jump and knots of splines are such. Sampled
controllers have no derivatives. Near singular configurations derivatives lose digits as accelerations do, and
runs that come too near to one are refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Unpack

import numpy as np

from newton_euler.codegen.compile import LARGE, Traced
from newton_euler.codegen.expression import Graph, Program, differentiate_along
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.parameters import pieces
from newton_euler.equations.sparse import least_squares
from newton_euler.errors import OptionError, SensitivityError, check_type
from newton_euler.integrators import stepper as m
from newton_euler.integrators.compiled import check_formulation
from newton_euler.integrators.options import FormulationName, Options, StepControl
from newton_euler.integrators.outputs import named
from newton_euler.integrators.run import Integrator
from newton_euler.integrators.singular import UNSAFE
from newton_euler.integrators.tangents import Tangents, evaluate_along, follow, methods
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import JointMotion, Trajectory, coordinate_names
from newton_euler.sampling import Interval, integrate_intervals
from newton_euler.scalars import Array, Floats, Scalar
from newton_euler.simulate import CompiledScene, native_trajectory

ALONG = " along"
RATES, SETTLED = "derivative" + ALONG, "settled" + ALONG
"""Names of programs that have a direction behind x."""

BESIDE = 6 * LARGE
"""Operations of derivatives of rates up to which several directions are taken side by side, by straight-line
code: it takes 8 s to compile."""

ROOM = 2048
"""Steps of a run that there is room for; those of a longer one are taken twice."""


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Derivatives of a run by p parameters at its n output times: b bodies, j joints, a actuators; SI.

    Arrays are those of a trajectory, with a last dimension for the parameters: `position[..., k]` is the
    derivative of `run.position` by `parameters[k]`. Arrays that the scene did not ask for are None, and so
    are reactions where constraints are redundant.

    Attributes:
        run: the run itself, to the last bit that of code with these parameters as inputs.
        parameters: names of the numbers by which derivatives are taken.

    Examples:
        >>> by = sensitivities(load("pendulum"), ["dumbbell.mass", "gravity"])
        >>> by
        <Sensitivities of newton_euler: 1001 outputs to 10 s, parameters: 4>
        >>> def largest_by_mass(by: Sensitivities) -> float:
        ...     of_angle = by.joint("pivot").coordinates[:, 0]
        ...     return float(abs(of_angle[:, by.parameters.index("dumbbell.mass")]).max())
        >>> print(f"{largest_by_mass(by):.2f} rad/kg")
        5.43 rad/kg
    """

    run: Trajectory
    parameters: tuple[str, ...]
    position: Floats
    """(n, b, 3, p) of centers of mass."""
    quaternion: Floats
    """(n, b, 4, p)"""
    linear_velocity: Floats | None = None
    """(n, b, 3, p)"""
    angular_velocity: Floats | None = None
    """(n, b, 3, p)"""
    reaction_force: Floats | None = None
    """(n, j, 3, p)"""
    reaction_torque: Floats | None = None
    """(n, j, 3, p)"""
    actuator_force: Floats | None = None
    """(n, a, p)"""
    kinetic_energy: Floats | None = None
    """(n, p)"""
    potential_energy: Floats | None = None
    """(n, p)"""
    work: Floats | None = None
    """(n, p)"""
    _coordinates: Floats = field(default_factory=lambda: np.zeros(0), repr=False)

    def __repr__(self) -> str:
        time = self.run.time
        size = f"{len(time)} outputs to {time[-1]:g} s, parameters: {len(self.parameters)}"
        return f"<Sensitivities of {self.run.engine}: {size}>"

    def joint(self, name: str) -> JointMotion:
        """Return the derivatives (n, k, p) of the coordinates of a joint, and of their rates.

        Raises:
            UnknownNameError: for an unknown joint.
        """
        mechanism = self.run.mechanism
        assert mechanism is not None
        counts = [len(equations.coordinates) for equations in mechanism.equations]
        number = mechanism.joint_index(name)
        place = slice(sum(counts[:number]), sum(counts[: number + 1]))
        x, rates = np.split(self._coordinates, 2, axis=1)
        has_rates = self.run.linear_velocity is not None
        names = coordinate_names(mechanism.joints[number])
        return JointMotion(names, x[:, place], rates[:, place] if has_rates else None)


def sensitivities(
    scene: Scene,
    parameters: Sequence[str],
    formulation: FormulationName | None = None,
    **control: Unpack[StepControl],
) -> Sensitivities:
    """Run a scene, and differentiate its trajectory by parameters.

    Args:
        scene: what is run, by DOP853 with projection.
        parameters: names, see `newton_euler.equations.parameters`; by each number of those that are arrays.
        formulation: as of `simulate`.
        control: of steps, as of `simulate`.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, a run that cannot go on, and for one
            whose derivatives do not exist or are not known.

    Examples:
        >>> by = sensitivities(load("tracker"), ["panel_7.mass", "slide_12.stiffness"])
        >>> by.run.position.shape[1:], by.position.shape[1:]
        ((7, 3), (7, 3, 2))
    """
    check_type("scene", scene, Scene)
    check_formulation(formulation)
    names = checked_names(parameters)
    options = Options.of("DOP853", control)
    code = TangentCode(scene, formulation, parameters=names)
    labels, directions = unit_directions(code, names)
    found = FollowedRun(code, options, ("output", "coordinates"))(code.start.copy(), directions)
    settings = {"formulation": code.formulation, "stabilization": code.stabilization}
    settings |= options.chosen() | found.counts
    values = named(code, found.results)
    signs = values["quaternion"].copy()
    run = native_trajectory(scene, settings, found.wall_time, values)
    arrays = {
        name: found.derivatives["output"][:, start:stop].reshape(len(run.time), *shape, len(labels))
        for name, (start, stop, shape) in code.function("output" + ALONG).layout.items()
    }
    signs = np.sign(np.sum(signs * run.quaternion, axis=2))  # of rotations that were made continuous
    arrays["quaternion"] = arrays["quaternion"] * signs[:, :, None, None]
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise SensitivityError(f"derivatives of {name} are not finite")
    _, of_joints = np.split(found.derivatives["coordinates"], 2, axis=1)
    return Sensitivities(run, labels, **arrays, _coordinates=of_joints)


def checked_names(parameters: Sequence[str]) -> tuple[str, ...]:
    """Return names of parameters, one or more, each once; raises `OptionError` for anything else."""
    valid = isinstance(parameters, list | tuple) and all(isinstance(name, str) for name in parameters)
    if not valid or not 0 < len(set(parameters)) == len(parameters):
        raise OptionError("parameters", parameters, "names of parameters, one or more, each once")
    return tuple(parameters)


def unit_directions(code: TangentCode, names: Iterable[str]) -> tuple[tuple[str, ...], Array]:
    """Return labels (p,) of the numbers of parameters, and their directions (inputs, p) of x."""
    labels, directions = list[str](), list[Array]()
    for name in names:
        shape, first = code.parameters[name], code.place(name)
        is_symmetric = shape == (3, 3)
        for number, index in enumerate(np.ndindex(*shape)):
            if is_symmetric and index[0] > index[1]:
                continue
            component = "".join("xyz"[k] for k in index) if set(shape) == {3} else ".".join(map(str, index))
            labels.append(f"{name}.{component}" if component else name)
            direction = np.zeros(code.inputs)
            direction[first + number] = 1.0
            if is_symmetric:
                direction[first + 3 * index[1] + index[0]] = 1.0
            directions.append(direction)
    return tuple(labels), np.column_stack(directions)


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

    def _traced(self, name: str, in_lanes: bool) -> Traced:
        if not name.endswith(ALONG):
            return super()._traced(name, in_lanes)
        program = self.program(name)
        many = program.operations < BESIDE if name == RATES else self.function(RATES).lanes > 1
        return Traced(program, many, self._layouts.get(name), straight=many)

    def _identity_of(self, name: str) -> str | None:
        return super()._identity_of(name.removesuffix(ALONG))

    def _trace(self, name: str) -> Program:
        if not name.endswith(ALONG):
            return super()._trace(name)
        graph, base = Graph(), name.removesuffix(ALONG)
        x, along = graph.variables(self.inputs), graph.variables(self.inputs)
        along[self.size] = 0.0  # at the same time
        system = self._system_of(x, tuple(self.parameters))
        if name == SETTLED:
            return graph.prune(self._settled(system, x, along))
        scalars = self._scalars(base, system, x)
        if name == RATES:
            rates, pivot_ratio = scalars[: self.size], scalars[self.size]
            return graph.prune([*rates, *differentiated(rates, x, along), pivot_ratio])
        kept = self._smooth(scalars) if base == "output" else scalars
        found = differentiated(kept, x, along)
        return graph.prune([*kept, *found] if base == "coordinates" else found)

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
        phi_t = system.phi_t()
        moved[on_v] -= step([sum(e * v[k] for k, e in jacobian[i].items()) + phi_t[i] for i in used])
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
            ends = frames[equations.first], frames[equations.second]
            for measure in equations.coordinates:
                coordinates += measure.phi(*ends).tolist()
                rates += measure.jacobian(*ends).rate(*ends).tolist()
        return [*coordinates, *rates]


def differentiated(scalars: Sequence[Scalar], x: Array, along: Array) -> list[Scalar]:
    """Differentiate scalars along a direction (inputs,) of x (inputs,)."""
    return differentiate_along(x[-1].graph, scalars, x.tolist(), along.tolist())


class FollowedRun:
    """Runs of a compiled scene with their derivatives along directions."""

    def __init__(self, code: TangentCode, options: Options, programs: Sequence[str]) -> None:
        """Make everything ready for derivatives of the results of these programs."""
        scene = code.scene
        if scene.sampled:
            raise SensitivityError(f"sampled controller of joint {scene.sampled[0].joint!r} has none")
        if options.integrator != "DOP853" or options.rest:
            raise OptionError("rest", options.rest, "0 for derivatives")
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
        return Followed(run.results, derivatives, run.counts, run.wall_time)

    def _along(
        self, integrator: Integrator, begun: Array, interval: Interval, directions: Array
    ) -> dict[str, Array]:
        """Carry directions (inputs, p) through an interval from x (inputs,); derivatives there by program."""
        code = self._code
        steps = int(integrator.counts[m.STEPS])
        if steps > len(integrator.steps):
            integrator = Integrator(code, interval.times, self._options, room=steps)
            integrator(begun)
        self._turn_pieces(begun, interval, directions)
        functions = {name: code.function(name + ALONG) for name in self._programs}
        rates, settled = code.function(RATES), code.function(SETTLED) if code.projects else None
        n, inputs, lanes, rows = code.size, code.inputs, rates.lanes, len(interval.times)
        found = {
            name: np.empty((rows, function.outputs, directions.shape[1]))
            for name, function in functions.items()
        }
        x = np.zeros((2 * inputs, lanes))
        tangents = Tangents(
            n=n,
            inputs=inputs,
            lanes=lanes,
            count=steps,
            rows=rows,
            projecting=int(code.projects),
            rates=rates,
            settled=settled,
            steps=integrator.steps,
            times=integrator.times,
            states=integrator.table,
            x=x,
            at=np.zeros_like(x),
            k=np.empty((17, 2 * n + 1, lanes)),
            table=np.empty((rows, n, lanes)),
            least=np.ones(1),
            found=np.empty((max(function.outputs for function in functions.values()), lanes)),
        )
        for first in range(0, directions.shape[1], lanes):
            beside = directions[:, first : first + lanes]
            together = beside.shape[1]
            x[:inputs] = begun[:, None]
            x[inputs:] = 0.0
            x[inputs:, :together] = beside
            tangents.at[:] = x
            methods()(follow, tangents, integrator.x)
            if code.projects and tangents.least[0] < UNSAFE:
                raise SensitivityError("the run comes too near to a singular configuration")
            beside[:n] = x[inputs : inputs + n, :together]
            for name, function in functions.items():
                results, columns = found[name], directions.shape[1]
                methods()(evaluate_along, tangents, function, function.outputs, first, columns, results)
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
