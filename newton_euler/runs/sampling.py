"""Runs with sampled controllers and with functions of time that have knots, from one sampling instant or knot
to the next, whatever integrates in between; and the model of a mechanism that computers of digital laws have.

Encoders tell their pose: actuated coordinates and their rates, by forward kinematics from the pose before.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from newton_euler.analysis.loads.inverse_dynamics import KEPT, InverseDynamics
from newton_euler.compiled.equations import Code
from newton_euler.compiled.failures import singular_joint
from newton_euler.compiled.run import Integrator, Projection
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.model_control import Roles, known_scene, roles
from newton_euler.equations.parameters import PIECE, numbered, pieces, with_values
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import MechanismError, SingularityError, is_finite_number
from newton_euler.integrators.options import Options
from newton_euler.integrators.singular import UNSAFE
from newton_euler.integrators.stepper import COUNTS, EXCESS
from newton_euler.model.control import Readings
from newton_euler.model.digital_control import HeldLaw
from newton_euler.model.joint import Key
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.splines import Spline
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state, measured_coordinate
from newton_euler.scalars import Array

SAME = 1e-9  # share of a period, or of the time between knots, by which times that are one may differ


class Interval(NamedTuple):
    """A part of a run in which forces of sampled controllers are constant, and functions of time smooth.

    Attributes:
        due: laws whose controllers are called where it begins.
        times: (n,) s, n >= 2: where it begins, the output times in it, where it ends.
        wanted: (n,) True for those of `times` that are outputs of this interval. One where the next interval
            begins belongs to that: at a sampling instant the new force holds already.
    """

    due: tuple[HeldLaw, ...]
    times: Array
    wanted: Array

    @property
    def middle(self) -> float:
        """A time in s between the knots around the interval."""
        return float(0.5 * (self.times[0] + self.times[-1]))


def intervals(scene: Scene, knots: Sequence[float], times: Array | None = None) -> Iterator[Interval]:
    """Divide a run of the scene at sampling instants and knots; a single interval if there are none.

    Controllers are called at multiples of their periods from 0 on, but not at the end of the run.

    Args:
        scene: what is run.
        knots: s, ascending.
        times: of outputs, s, from 0 on; the scene's if not given.
    """
    outputs, laws = scene.times if times is None else times, scene.sampled
    end = float(outputs[-1])
    slack = SAME * float(np.min(np.diff(knots), initial=scene.output_period))
    ahead = [_met(knot, slack, outputs) for knot in reversed(knots) if slack < knot < end - slack]
    begin, due, calls = 0.0, list(range(len(laws))), [0] * len(laws)
    while begin < end:
        for k in due:
            calls[k] += 1
        upcoming = [_instant(law, number, outputs) for law, number in zip(laws, calls, strict=True)]
        while ahead and ahead[-1] <= begin + slack:
            ahead.pop()
        stop = min([*upcoming, *ahead[-1:], end])
        first, last = np.searchsorted(outputs, [begin, stop])
        inside = outputs[first:] if stop == end else outputs[first:last]
        times = np.union1d(inside, [begin, stop])
        yield Interval(tuple(laws[k] for k in due), times, np.isin(times, inside))
        begin, due = stop, [k for k, law in enumerate(laws) if upcoming[k] - stop < SAME * law.period]


def _instant(law: HeldLaw, number: int, outputs: Array) -> float:
    """Return the time of the call of a controller with that number, from 0."""
    return _met(number * law.period, SAME * law.period, outputs)


def _met(time: float, slack: float, outputs: Array) -> float:
    """Return an output time, s, instead of one that differs from it by less than the slack."""
    k = int(np.searchsorted(outputs, time - slack))
    return float(outputs[k]) if k < len(outputs) and outputs[k] < time + slack else time


class Controllers:
    """The controllers of a scene in one run."""

    def __init__(self, scene: Scene) -> None:
        model = ControllerModel(scene).forces if roles(scene, digital=True) else None
        self._controllers = {law.key: law.controller_of(scene.control, model) for law in scene.sampled}

    def sample(self, due: tuple[HeldLaw, ...], time: float, readings: Array) -> dict[str, float]:
        """Call controllers, and return their forces (N or N m) by the names of `equations.parameters`.

        Args:
            due: laws of the controllers.
            time: s.
            readings: (s, 2) coordinates of `Scene.sensed` (m or rad) and their rates.

        Raises:
            IntegrationError: for a controller that fails, or returns something else than a finite number.
        """
        forces = {}
        for law in due:
            try:
                force = self._controllers[law.key](time, *readings.T.copy())
            except Exception as error:
                reason = f"controller of joint {law.joint!r} failed: {type(error).__name__}: {error}"
                raise IntegrationError(time, _one_line(reason)) from error
            if not is_finite_number(force):
                reason = f"controller of joint {law.joint!r} returned {force!r:.200}"
                raise IntegrationError(time, _one_line(reason))
            forces[f"{law.prefix}.held"] = float(force)
        return forces


def _one_line(text: str) -> str:
    return " ".join(text.split())


class OfScene(Protocol):
    """Equations of a scene, which take control laws from it whenever they are evaluated."""

    scene: Scene


S = TypeVar("S", bound=OfScene)


def holding(system: S, values: Mapping[str, Any]) -> S:
    """Return the same equations with these values, as `sample` and `pieces` name them; models are shared."""
    changed = copy.copy(system)
    changed.scene = with_values(system.scene, values)
    return changed


Carry = Callable[[Integrator, Array, Interval], None]
"""What goes on beside the intervals of a run: the integrator after one, x (inputs,) before, the interval."""


class NativeRun(NamedTuple):
    """A run in native code.

    Attributes:
        results: (n, outputs) what the scene asks for at the n output times that were reached, see
            `newton_euler.compiled.outputs.named`.
        counts: (COUNTS,) of steps and evaluations, see `newton_euler.integrators.stepper.counted`.
        stopped: the error that ended the run before the last output; None if none did.
        wall_time: s, of the run itself, without making its integrator.
    """

    results: Array
    counts: Array
    stopped: IntegrationError | None
    wall_time: float


def integrate_intervals(
    code: Code,
    x: Array,
    options: Options,
    stopped: Sequence[bool] = (),
    times: Array | None = None,
    carry: Carry | None = None,
    room: int = 0,
) -> NativeRun:
    """Run a scene from x (inputs,), which is changed.

    Args:
        stopped, room: as of `Integrator`.
        times: of outputs, s; the scene's if not given.
        carry: called after each interval that was run to its end.
    """
    start = time.perf_counter()
    changes = code.piecewise or code.scene.sampled  # else nothing here depends on parameters
    scene = code.parametrized(x) if changes else code.scene
    parts: list[Array] = []
    total = np.zeros(COUNTS)
    error: IntegrationError | None = None
    controllers, integrators = Controllers(scene), dict[int, Integrator]()
    end = (code.scene.times if times is None else times)[-1]
    for interval in intervals(scene, scene.knots, times):
        values: dict[str, Any] = pieces(scene, interval.middle)
        if interval.due:
            readings = code.function("measured")(x).reshape(2, -1).T
            try:
                values |= controllers.sample(interval.due, float(interval.times[0]), readings)
            except IntegrationError as failed:
                error = failed
                break
        for name, value in values.items():
            place = code.place(name)
            x[place : place + np.size(value)] = value
        if len(interval.times) not in integrators:
            integrators[len(interval.times)] = Integrator(code, interval.times, options, stopped, room)
        integrator = integrators[len(interval.times)]
        integrator.times[:] = interval.times
        if not values:  # one integrator for all of the run, which others make once for many
            start = time.perf_counter()
        results, error = integrator.attempt(x)
        excess = max(total[EXCESS], integrator.counts[EXCESS])
        total += integrator.counts
        total[EXCESS] = excess
        wanted = interval.wanted[: len(results)]
        parts.append(results if wanted.all() else results[wanted])
        if error:
            break
        if carry:
            carry(integrator, x, interval)
        x[:] = integrator.x
        if code.projects and x[code.size] < end and code.pivot_ratio(x) < UNSAFE:
            where = f"a singular configuration, where joint {singular_joint(code, x)!r} loses rank"
            error = IntegrationError(float(x[code.size]), f"a knot or sample of a law is at {where}")
            break
    none = np.zeros((0, code.function("output").outputs))
    results = parts[0] if len(parts) == 1 else np.concatenate([none, *parts])
    return NativeRun(results, total, error, time.perf_counter() - start)


class ControllerModel:
    """Inverse dynamics of the laws of a scene's computers that know the mechanism, in one run.

    Attributes:
        roles: of the laws.
        encoders: forward kinematics of the coordinates of all control laws.
    """

    def __init__(self, scene: Scene) -> None:
        """Compile.

        Raises:
            MechanismError: naming a coordinate that its law cannot give any acceleration, and for encoders
                that do not determine the pose.
        """
        self.roles, self._models, code = _compiled(scene)
        if code is None:
            problem = "coordinates of control laws do not determine its pose, which encoders are to tell"
            needed = "as many independent ones as degrees of freedom"
            raise MechanismError(f"scene {scene.name!r}", problem, needed)
        self.encoders = Encoders(code, scene)

    def forces(self, readings: Readings, accelerations: Sequence[float], time: float) -> dict[Key, float]:
        """Compute forces (N or N m) by coordinates.

        Args:
            readings: of encoders.
            accelerations: that laws of computed torque command, in order.
            time: s.

        Raises:
            MechanismError: for readings that no pose has.
            SingularityError: where the coordinates do not determine the motion.
        """
        found: dict[Key, float] = {}
        own_q, own_v = self.encoders.coordinates(readings, time)
        wanted = accelerations, [0.0] * len(self.roles.holding)
        for model, own_wanted, moves in zip(self._models, wanted, (1.0, 0.0), strict=True):
            if model is None:
                continue
            q = model.system.coordinates_from(self.encoders.system, own_q)
            knots = pieces(model.scene, time).values()
            flags = model.flags(q[None])[0]
            values = model.forces(np.concatenate([q, moves * own_v, flags, own_wanted, [time], *knots]))
            keys = model.servos.actuators
            if not (values[-2] > 0.0 and np.isfinite(values[:-2]).all()):
                raise SingularityError(keys[0][0], "control laws cannot choose the accelerations there")
            found = dict(zip(keys, values[:-2].tolist(), strict=True)) | found
        return found


@lru_cache(maxsize=KEPT)
def _compiled(
    scene: Scene,
) -> tuple[Roles, tuple[InverseDynamics | None, InverseDynamics | None], Code | None]:
    """Return roles, inverse dynamics of computed torque and of holding, and what encoders move."""
    found = roles(scene, digital=True)
    known = known_scene(scene, found.model)
    still = tuple(motion.held() for motion in scene.motions)
    torque, holding = (
        InverseDynamics(each, keys, keys) if keys else None
        for each, keys in ((known, found.torque), (replace(known, motions=still), found.holding))
    )
    return found, (torque, holding), _driven(known)


def _driven(scene: Scene) -> Code | None:
    """Return code of the mechanism with a motion of each coordinate of the control laws; None if it is loose.

    The motions' numbers are inputs: the first two are the coordinate and its rate.
    """
    keys = [law.key for law in scene.control]
    if len(keys) != mobility(scene).degrees_of_freedom:
        return None
    at = [measured_coordinate(scene, initial_state(scene), key)[0] for key in keys]
    functions = [Spline((0.0, scene.duration), (x, x)) for x in at]
    motions = [PrescribedMotion(joint, f, k) for (joint, k), f in zip(keys, functions, strict=True)]
    driven = replace(scene.without_forces(), motions=(*scene.motions, *motions))
    return Code(driven, "relative") if mobility(driven).degrees_of_freedom == 0 else None


class Encoders:
    """Forward kinematics of readings in one run, each from the pose before.

    Attributes:
        system: whose coordinates are found.
    """

    def __init__(self, code: Code, scene: Scene) -> None:
        """Begin at the start of the scene, whose coordinates the last motions in the code move."""
        keys = [law.key for law in scene.control]
        self.system: Formulation = code.system
        self._code, self._project = code, Projection(code)
        self._x = code.packed(*code.system.coordinates(initial_state(scene)))
        first = len(code.scene.motions) - len(keys)
        names = [numbered("motions", first + k, "function") + PIECE for k in range(len(keys))]
        self._places = {key: code.place(name) for key, name in zip(keys, names, strict=True)}
        self._others = [name for name in code.parameters if name not in names]

    def coordinates(self, readings: Readings, time: float) -> tuple[Array, Array]:
        """Return q (nq,) and v (nv,) of the pose with these coordinates and rates, at a time in s.

        Raises:
            MechanismError: if there is none near the pose before.
        """
        x, code, nq = self._x, self._code, self.system.nq
        x[code.size] = time
        if self._others:
            values = pieces(code.scene, time)
            for name in self._others:
                x[code.place(name) :][: len(values[name])] = values[name]
        for key, place in self._places.items():
            angle, rate = readings[key][:2]
            x[place : place + 3] = time, angle, rate
        if not self._project(x):
            read = ", ".join(f"{key[0]} {float(readings[key][0]):.6g}" for key in self._places)
            raise MechanismError("encoders", f"no pose is near with {read}", "coordinates within reach")
        return x[:nq], x[nq : code.size]
