"""Starts of many runs whose geometry, prescribed motions or initial coordinates vary, in native code.

Each run begins at the start that the scene has of its own, closed with its own numbers, and goes from these
to the run's in small steps, each followed by Newton's steps of least length in the coordinates of the
spanning tree (`newton_euler.integrators.projection`). Velocities follow at the end: of all that the
constraints let, the nearest to the own ones. Runs know nothing of each other: it does not matter how they are
grouped.

Names of initial coordinates are `start.JOINT`, m or rad from the initial pose, and `start.JOINT.rate`, m/s or
rad/s; `start.JOINT.1` and `start.JOINT.1.rate` are those of a joint's second coordinate. A joint with one of
the two given has both, the other one as the scene's own start has it; own rates give way where loops do not
allow all of them beside the given ones.

Angles have revolutions (`newton_euler.model.state.State.angles`). A given angle is reached with its own
revolutions, on the shorter way if no coupling ties it to other joints. Other angles that forces or couplings
depend on move on from the scene's own start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from newton_euler.codegen.compile import NativeFunction, Traced
from newton_euler.codegen.expression import Graph
from newton_euler.codegen.fingerprint import fingerprint
from newton_euler.codegen.native import Record, Vector, native
from newton_euler.compiled.callbacks import raise_fatal
from newton_euler.compiled.equations import CACHED_SCENES, NEUTRAL, Code
from newton_euler.compiled.formulations import formulate
from newton_euler.compiled.outputs import at_rows
from newton_euler.compiled.run import Fallback, equations, native_method
from newton_euler.equations.couplings import counted_angles, couplings
from newton_euler.equations.driven import DrivenMechanism, driven
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.independence import independent
from newton_euler.equations.kinematics import TreeKinematics
from newton_euler.equations.parameters import (
    PIECE,
    is_kinematic,
    numbered,
    parameter_layout,
    pieces,
    places,
    unambiguous,
    with_values,
)
from newton_euler.equations.redundancy import loosely_closed, mobility
from newton_euler.errors import MechanismError, listed
from newton_euler.integrators import stepper as m
from newton_euler.integrators.projection import project, worst_joint
from newton_euler.integrators.stepper import DONE, OPEN, Equations
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.state import State, whole_revolutions
from newton_euler.model.variable import UNITS
from newton_euler.runs.assemble import coordinates_of, initial_state, measured_coordinate, with_angles
from newton_euler.scalars import Array, Scalar

START_PREFIX, RATE_SUFFIX = "start.", ".rate"
"""Beginning of names of initial coordinates and rates, and end of names of rates."""

MAX_STEP = 0.1
"""Longest step of a joint on the path to a start, rad or sizes of the mechanism."""

MAX_STEPS = 1000
"""Number of steps on the path. Longer paths have longer steps."""

RETRY_FACTOR = 16
"""Factor of the number of steps with which runs that stayed open are tried again."""

SHOWN_VALUES = 3
"""Number of a run's values that messages show."""


class Initial(NamedTuple):
    """A number of the start.

    Attributes:
        key: the joint coordinate.
        order: 0 for the coordinate, 1 for its rate.
    """

    key: Key
    order: int


def initial_numbers(scene: Scene, names: Iterable[str]) -> dict[str, Initial]:
    """Find the initial coordinates and rates among names of parameters.

    Raises:
        UnknownNameError: for an unknown joint.
        MechanismError: for a joint that has no such coordinate, one that follows a prescribed motion, and two
            names of one number.
    """
    found: dict[str, Initial] = {}
    for name in names:
        if not isinstance(name, str) or not name.startswith(START_PREFIX):
            continue
        place = name.removeprefix(START_PREFIX).removesuffix(RATE_SUFFIX)
        joint, _, index = place.rpartition(".")
        mechanism, key = scene.mechanism, (place, 0)
        if place not in mechanism.joint_names and joint and index.isdecimal():
            key = joint, int(index)
        if key[0] not in mechanism.joint_names and _is_element(scene, name):
            continue
        key = mechanism.coordinate(key)
        if key in {motion.key for motion in scene.motions}:
            where = f"joint {key[0]!r}"
            raise MechanismError(where, "follows a prescribed motion", "a joint that none prescribes")
        number = Initial(key, int(name.endswith(RATE_SUFFIX)))
        if twin := next((other for other, known in found.items() if known == number), None):
            problem = f"{twin!r} and {name!r} are one number of the start"
            raise MechanismError(f"joint {key[0]!r}", problem, "one of the two")
        found[name] = number
    return found


def initial_names(scene: Scene) -> list[str]:
    """Return the names of all initial coordinates and rates that no motion prescribes."""
    prescribed = {motion.key for motion in scene.motions}
    free = [name for key, name in scene.mechanism.coordinate_labels.items() if key not in prescribed]
    return list(
        initial_numbers(scene, [f"{START_PREFIX}{name}{end}" for name in free for end in ("", RATE_SUFFIX)])
    )


def _is_element(scene: Scene, name: str) -> bool:
    """Tell if a name begins with that of an element, and so is none of an initial coordinate."""
    mechanism = scene.mechanism
    named = (*mechanism.body_names, *mechanism.joint_names, *(force.where for force in scene.forces))
    return any(name.startswith(f"{element}.") for element in named)


def own_initial(scene: Scene, number: Initial) -> float:
    """Return the scene's own value of an initial coordinate or rate."""
    return measured_coordinate(scene, initial_state(scene), number.key)[number.order]


@dataclass(frozen=True, eq=False)
class HomotopyRecord(Record):
    """The ways of n runs from the scene's own numbers to theirs.

    Attributes:
        count: n.
        passing: 1 if some coordinates follow from others and need not fit them on the way, else 0.
        steps: (n,) numbers of steps.
        own, states: (n, inputs) states with their parameters, at the beginning and at the end of the way;
            states are replaced by those that the parameters at the end let.
        x: (inputs,) scratch.
        statuses: (n,) of projections.
    """

    count: int
    passing: int
    steps: Vector
    own: Vector
    states: Vector
    x: Vector
    statuses: Vector


@native
def assemble_all(system: Equations, course: HomotopyRecord) -> None:
    """Move the states of all runs to where their parameters let them be."""
    n = system.n
    inputs = system.inputs
    x = course.x
    for run in range(course.count):
        own = course.own[inputs * run :]
        target = course.states[inputs * run :]
        steps = int(course.steps[run])
        status = DONE
        for i in range(n + 1):
            x[i] = own[i]
        for step in range(steps):
            last = 1 if step + 1 == steps else 0
            for i in range(n + 1, inputs):
                x[i] = target[i]
                if last == 0:
                    x[i] = own[i] + (target[i] - own[i]) * (float(step + 1) / float(steps))
            if system.projecting == 1:
                status = project(system, last, x)
            if status != DONE and (status != OPEN or course.passing == 0):
                break
        if status == DONE and system.projecting == 1:
            status = project(system, 1, x)  # once more, for digits of velocities far below the own ones
        for i in range(n):
            target[i] = x[i]
        course.statuses[run] = float(status)


@lru_cache(maxsize=CACHED_SCENES)
def assembly_of(scene: Scene, names: tuple[str, ...]) -> Assembly:
    """Return the assembly for parameters of a scene, the same one each time: LLVM keeps all that it makes."""
    return Assembly(scene, names)


class Assembly:
    """Assembly of a scene's starts for other values of some of its parameters.

    Attributes:
        scene: whose start it is.
        initial: initial coordinates among the parameters, by name.
        kinematic: names of the parameters of geometry and motions.
    """

    def __init__(self, scene: Scene, names: Sequence[str]) -> None:
        """`names` are of parameters; those that move no start are left out."""
        self.scene, self.initial = scene, initial_numbers(scene, names)
        self._begin: dict[str, NativeFunction] = {}
        others = [name for name in names if name not in self.initial]
        self.kinematic = [name for name, place in places(scene, others).items() if is_kinematic(place)]
        self._names = {name: unambiguous(scene, name) for name in self.kinematic}
        self._rates = {number.key for number in self.initial.values() if number.order == 1}
        keys = dict.fromkeys(number.key for number in self.initial.values())
        ordered = sorted(keys, key=lambda key: key not in self._rates)
        self._keys = tuple(ordered)

    @cached_property
    def _driven(self) -> DrivenMechanism:
        """The mechanism driven at the initial coordinates, which also carries the angles of the scene."""
        start = initial_state(self.scene)
        functions = {key: self._held(start, key) for key in self._keys}
        coupled = {key for coupling in couplings(self.scene) for key in coupling.factors}
        others = [key for key in counted_angles(self.scene) if key not in coupled.union(self._keys)]
        carrying = [JointSpring(joint, coordinate=k) for joint, k in others]  # without stiffness
        return driven(self.scene, functions, forces=carrying, initial_state=self._completed(start))

    @cached_property
    def code(self) -> Code:
        """Equations of the constraints of the driven mechanism."""
        held = self._driven.scene
        parameters = (*self._names.values(), *self._driven.functions.values())
        code = Code(held, "relative", parameters=parameters)
        if not self._is_overdetermined(code):
            return code
        at = max(mobility(held).configurations, key=lambda at: at.rank)

        def selected(numbers: Collection[int]) -> list[int]:
            rows = [row if k in numbers else {} for k, row in enumerate(at.rows)]
            return independent(rows, held.redundancy_tolerance).rows

        moved = self._driven.rows(code.system)
        used = selected(set(range(len(at.rows))) - set(moved))
        for row in moved:  # those of given rates are the first
            used = max(used, selected({*used, row}), key=len)
        return Code(held, "relative", parameters=parameters, independent=used)

    def _free_rows(self, code: Code) -> range:
        """Return the constraint rows of motions whose rates are not given, which yield to all others."""
        return self._driven.rows(code.system)[len(self._rates) :]

    def _is_overdetermined(self, code: Code) -> bool:
        """True if some initial coordinates follow from the others: then rates may contradict each other."""
        left = code.system.nv - code.rank
        return bool(self._keys) and left > mobility(self.scene).degrees_of_freedom - len(self._keys)

    @property
    def is_needed(self) -> bool:
        """True if one of the parameters moves the start."""
        return bool(self.initial or self.kinematic)

    def _held(self, state: State, key: Key) -> Polynomial:
        return Polynomial(measured_coordinate(self.scene, state, key))

    def __call__(
        self, values: Mapping[str, Array], states: Sequence[State] | None = None
    ) -> tuple[Array, dict[int, MechanismError]]:
        """Assemble the starts of n runs.

        Args:
            values: (n, ...) by name; those of other parameters are left alone.
            states: of the runs, closed with the scene's own numbers; the scene's own start if None.

        Returns:
            x (n, inputs) of `code`, and what cannot be assembled by number of the run.
        """
        count = len(next(iter(values.values())))
        own = np.tile(self._own_start, (count, 1)) if states is None else self._begun(states)
        targets = self._targets(own, values)
        steps = self._steps(own, targets)
        found, statuses = self._assembled(own, targets, steps)
        lost = np.flatnonzero(statuses != DONE)
        if lost.size:
            again = self._assembled(
                own[lost], targets[lost], np.minimum(RETRY_FACTOR * steps[lost], MAX_STEPS)
            )
            found[lost], statuses[lost] = again
        lost = np.flatnonzero(statuses != DONE)
        begun = "the scene's own start" if states is None else "the state given"
        errors = {run: self._error(run, found[run], values, begun) for run in lost.tolist()}
        given = {name: values[name] for name, number in self.initial.items() if number.order == 1}
        for run in self._contradictory(found):
            problem = f"loops do not let joints move with {self._shown(run, given)}"
            error = MechanismError(f"run {run}", problem, "rates that loops and couplings allow")
            errors.setdefault(run, error)
        self._set_revolutions(found, values)
        on_v, units = slice(self.code.system.nq, self.code.size), self.code.system.velocity_units
        begun, speeds = (np.abs(x[:, on_v] / units).max(axis=1, initial=0.0) for x in (own, found))
        found[speeds < np.finfo(float).eps * begun, on_v] = 0.0  # round-off of what is to rest
        return found, errors

    @cached_property
    def _own_start(self) -> Array:
        """The scene's own start, x (inputs,) of `code`."""
        return self._begun([initial_state(self.scene)])[0]

    def _begun(self, states: Sequence[State]) -> Array:
        """Return x (n, inputs) of n states, with the scene's own parameters."""
        code = self.code
        own = np.tile(code.packed(np.zeros(code.size), np.zeros(0)), (len(states), 1))
        states = [self._completed(state) for state in states]
        own[:, : code.size] = coordinates_of(code.system, states)
        for row, state in zip(own, states, strict=True):
            for key, name in self._driven.functions.items():
                row[code.place(name) :][:2] = self._held(state, key).coefficients
        return own

    def _completed(self, state: State) -> State:
        """Return a state with the angles that the scene depends on, and those that are to move."""
        state = with_angles(self.scene, state)
        angles = [key for key in self._keys if not self.scene.mechanism.is_slide(*key)]
        moved = {key: measured_coordinate(self.scene, state, key)[0] for key in angles}
        return replace(state, angles={**state.angles, **moved})

    def _targets(self, own: Array, values: Mapping[str, Array]) -> Array:
        """Return the same states with the parameters of the runs."""
        targets = own.copy()
        for name, place in self._names.items():
            flat = values[name].reshape(len(own), -1)
            targets[:, self.code.place(place) :][:, : flat.shape[1]] = flat
        self._set_pieces(targets)
        for name, (key, order) in self.initial.items():
            column = self.code.place(self._driven.functions[key]) + order
            targets[:, column] = values[name]
            if order == 0 and key in self._free_angles:
                targets[:, column] -= whole_revolutions(values[name] - own[:, column])  # the shorter way
        return targets

    @cached_property
    def _free_angles(self) -> set[Key]:
        """Initial coordinates that are angles which no coupling of the scene ties to others."""
        coupled = {key for coupling in couplings(self.scene) for key in coupling.factors}
        angles = {key for key in self._keys if not self.scene.mechanism.is_slide(*key)}
        return angles - coupled

    def _set_revolutions(self, x: Array, values: Mapping[str, Array]) -> None:
        """Give angles in x (n, inputs) the revolutions of the values (n,) that were asked for."""
        for name, (key, order) in self.initial.items():
            if order == 0 and key in self._free_angles:
                place, column = self.code.system.angles[key], self.code.place(self._driven.functions[key])
                turned = whole_revolutions(values[name] - x[:, place])
                x[:, place] += turned
                x[:, column] += turned

    def _set_pieces(self, targets: Array) -> None:
        """Set the numbers of motions' functions between the first knots by their samples."""
        code = self.code
        sampled = [
            name
            for name, place in places(code.scene, self._names.values()).items()
            if numbered(*place.owner) + PIECE in code.parameters
        ]
        for row in targets if sampled else ():
            moved = with_values(code.scene, code.values(row, sampled))
            for name, numbers in pieces(moved, 0.0).items():
                row[code.place(name) :][: len(numbers)] = numbers

    def _steps(self, own: Array, targets: Array) -> Array:
        """Return how many steps (n,) each run takes."""
        code, size = self.code, self.scene.mechanism.size
        units = np.ones(code.inputs)
        for name in self._names.values():
            count = max(1, math.prod(code.parameters[name]))
            attribute = name.partition("].")[2].partition(".")[0]
            units[code.place(name) :][:count] = size if UNITS.get(attribute) == "m" else 1.0
        for key, name in self._driven.functions.items():
            units[code.place(name)] = size if self.scene.mechanism.is_slide(*key) else 1.0
            units[code.place(name) + 1] = np.inf  # rates move nothing
        longest = np.max(np.abs(targets - own) / units, axis=1)
        return np.clip(np.ceil(longest / MAX_STEP), 1, MAX_STEPS)

    def _assembled(self, own: Array, targets: Array, steps: Array) -> tuple[Array, Array]:
        """Return the states that are reached, and statuses (n,)."""
        code, python = self.code, Fallback(self.code, np.zeros(m.COUNTS))
        # nothing here calls derivatives, and compiling them takes time
        system = equations(code, python, python.derivative, np.zeros(code.size))
        found, statuses, x = targets.copy(), np.zeros(len(own)), np.zeros(code.inputs)
        passing = int(self._is_overdetermined(code))
        ways = np.ascontiguousarray(steps), np.ascontiguousarray(own), found
        course = HomotopyRecord(len(own), passing, *ways, x, statuses)
        native_method(assemble_all).bind(assemble_all, system, course)()
        raise_fatal(python)
        return found, statuses

    def _error(self, run: int, x: Array, values: Mapping[str, Array], begun: str) -> MechanismError:
        """Say which joint stays open in a run, on the way from where it begins in words."""
        system = self.code.float_system(x)
        q, v = x[: system.nq], x[system.nq : self.code.size]
        with np.errstate(all="ignore"):
            joint, residual = worst_joint(system, system.state(q, v))
        way = f"on the way from {begun} to {self._shown(run, values)}"
        problem = f"joint {joint!r} stays open by {residual:.3g} (m or rad) {way}"
        given = {number.key for number in self.initial.values() if number.order == 0}
        labels = self.scene.mechanism.coordinate_labels
        held = listed(START_PREFIX + labels[key] for key in self._keys if key not in given)
        problem += f", where {held} is the own one of the scene" if held else ""
        return MechanismError(f"run {run}", problem, "values that loops let joints move to")

    def _shown(self, run: int, values: Mapping[str, Array]) -> str:
        """Word the values of a run that move its start."""
        moving = [name for name in values if name in self._names or name in self.initial]
        shown = ", ".join(f"{name} = {values[name][run].tolist()!r:.60}" for name in moving[:SHOWN_VALUES])
        return shown + (", ..." if len(moving) > SHOWN_VALUES else "")

    def _contradictory(self, x: Array) -> list[int]:
        """Return the runs in which constraints do not let joints move at the given rates in x (n, inputs)."""
        code, free = self.code, self._free_rows(self.code)
        if not self._rates or not self._is_overdetermined(code):
            return []

        def computed(system: Formulation, values: Mapping[str, Any], q: Array, v: Array) -> list[Scalar]:
            rates = np.delete(system.phi_rate(q, v) / code.system.phi_units, free)
            return [*rates, *(v / code.system.velocity_units), *(system.phi_t() / code.system.phi_units)]

        found = np.abs(at_rows(self._function("rates", computed, len(free)), x))
        rates, speeds = np.split(found, [len(code.system.phi_units) - len(free)], axis=1)
        allowed = loosely_closed(code.noise) * speeds.max(axis=1, initial=0.0)
        return np.flatnonzero(rates.max(axis=1, initial=0.0) > allowed).tolist()

    @np.errstate(all="ignore")  # what overflows is refused by a run
    def state(self, x: Array) -> State:
        """Return the state of the bodies at x (inputs,)."""
        system = self.code.float_system(x)
        return system.state(x[: system.nq], x[system.nq : self.code.size])

    def starts(self, compiled: Code, x: Array) -> Array:
        """Return the states (n, size) of a formulation of the scene at x (n, inputs)."""
        if compiled.formulation not in self._begin:
            self._begin[compiled.formulation] = self._native(compiled)
        found, system = at_rows(self._begin[compiled.formulation], x), compiled.system
        if isinstance(system, TreeKinematics):
            free = system.uncounted_angles
            found[:, free] -= whole_revolutions(found[:, free])
        return found

    def _native(self, compiled: Code) -> NativeFunction:
        """Return the function that gives (q, v) of a formulation at x (inputs,) of the assembly's."""

        def computed(system: Formulation, values: Mapping[str, Any], q: Array, v: Array) -> list[Scalar]:
            inputs = {name: values[place] for name, place in self._names.items()}
            other = formulate(with_values(self.scene, inputs), compiled.formulation)
            if isinstance(other, TreeKinematics):
                own, rates = q[: other.tree.nq], v
            else:
                own, rates = other.own_coordinates(system.state(q, v))
            seen = system.measured(q, v)
            angles = [seen[key].x for key, each in other.between.items() if each.carried is not None]
            work = [0.0] * (other.nq - len(own) - len(angles))
            return [*own, *angles, *work, *rates]

        # work, an element of the state, depends on the outputs
        return self._function("starts", computed, compiled.formulation, compiled.size, tuple(self._names))

    def _function(
        self,
        name: str,
        compute: Callable[[Formulation, Mapping[str, Any], Array, Array], list[Scalar]],
        *chosen: object,
    ) -> NativeFunction:
        """Return a native function of x (inputs,).

        Args:
            compute: from the equations, the values of their parameters, q and v.
            chosen: all that it depends on beside the scene and its parameters.
        """
        code = self.code
        moving = code.scene.motions, parameter_layout(code.scene, code.parameters)
        known = fingerprint(self.scene, *chosen, *moving, neutral=NEUTRAL | {"outputs"})

        def traced() -> Traced:
            graph = Graph()
            x = graph.variables(code.inputs)
            values = code.values(x)
            system = formulate(with_values(code.scene, values), code.formulation)
            return Traced(graph.prune(compute(system, values, x[: system.nq], x[system.nq : code.size])))

        return NativeFunction(traced, known and f"{known} {name}")
