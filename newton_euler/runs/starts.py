"""Initial states of many runs whose geometry, prescribed motions or initial joint coordinates vary.

Loops must be closed at the start of each run. The initial state of the scene is closed with the scene's own
parameters. From there, a homotopy changes the parameters in small steps to those of the run and keeps the
loops closed (`newton_euler.runs.homotopy`). The velocities at the end are the nearest to the scene's
velocities that the constraints allow. The result of a run does not depend on the other runs.

Initial joint coordinates (`newton_euler.runs.initial_coordinates`) are driving constraints on this path
(`newton_euler.equations.driven`). If only the coordinate or only the rate of a joint is given, the other one
has the value of the scene's initial state. If loops do not allow all rates together, given rates have
priority.

Angles are counted with full revolutions (`newton_euler.model.state.State.angles`). A given angle is reached
with its revolutions. The path to an angle without couplings to other joints leaves out full revolutions.
Other angles that forces or couplings depend on continue from the initial state.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.program import native_program
from newton_euler.compiled.callbacks import raise_fatal
from newton_euler.compiled.equations import CACHED_SCENES, NOT_COMPILED_FIELDS, CompiledEquations
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
    numbered,
    parameter_layout,
    pieces,
    places,
    unambiguous,
    with_values,
)
from newton_euler.equations.redundancy import loose_tolerance, mobility
from newton_euler.errors import MechanismError, listed
from newton_euler.integrators.projection import worst_joint
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.state import State, whole_revolutions
from newton_euler.runs.assemble import coordinates_of, initial_state, measured_coordinate, with_angles
from newton_euler.runs.homotopy import HomotopyRecord, assemble_all
from newton_euler.runs.initial_coordinates import START_PREFIX, initial_numbers
from newton_euler.scalars import Array, Scalar

MAX_STEP = 0.1
"""Longest step of a parameter on the path, rad, or a length divided by the mechanism's size."""

MAX_STEPS = 1000
"""Largest number of steps on the path. Longer paths have longer steps."""

RETRY_FACTOR = 16
"""Factor by which the number of steps is increased when a run whose loops stayed open is tried again."""

SHOWN_VALUES = 3
"""Largest number of a run's parameter values in an error message."""


@lru_cache(maxsize=CACHED_SCENES)
def assembly_of(scene: Scene, names: tuple[str, ...]) -> Assembly:
    """Return the assembly for parameters of a scene; recent ones are kept, because LLVM frees no code."""
    return Assembly(scene, names)


class Assembly:
    """Computes closed initial states of a scene for other values of some of its parameters.

    Attributes:
        scene: the scene, whose initial state is the beginning of all paths.
        initial: initial joint coordinates and rates among the parameters, by name.
        kinematic: names of the parameters of geometry and prescribed motions.
    """

    def __init__(self, scene: Scene, names: Sequence[str]) -> None:
        """Select, from names of parameters, those that change the initial state."""
        self.scene, self.initial = scene, initial_numbers(scene, names)
        self._start_functions: dict[str, NativeFunction] = {}
        others = [name for name in names if name not in self.initial]
        self.kinematic = [name for name, place in places(scene, others).items() if place.field.moves_loops]
        self._unique_names = {name: unambiguous(scene, name) for name in self.kinematic}
        self._rate_keys = {number.key for number in self.initial.values() if number.order == 1}
        keys = dict.fromkeys(number.key for number in self.initial.values())
        ordered = sorted(keys, key=lambda key: key not in self._rate_keys)
        self._keys = tuple(ordered)

    @cached_property
    def _driven(self) -> DrivenMechanism:
        """The mechanism with driving constraints for the initial coordinates.

        Springs without stiffness make sure that full revolutions of the scene's angles are counted.
        """
        start = initial_state(self.scene)
        functions = {key: self._linear_function(start, key) for key in self._keys}
        coupled = {key for coupling in couplings(self.scene) for key in coupling.factors}
        others = [key for key in counted_angles(self.scene) if key not in coupled.union(self._keys)]
        carrying = [JointSpring(joint, coordinate=k) for joint, k in others]
        return driven(self.scene, functions, forces=carrying, initial_state=self._with_all_angles(start))

    @cached_property
    def code(self) -> CompiledEquations:
        """Compiled constraints of the driven mechanism, with the parameters as inputs."""
        held = self._driven.scene
        parameters = (*self._unique_names.values(), *self._driven.functions.values())
        code = CompiledEquations(held, "relative", parameters=parameters)
        if not self._is_overdetermined(code):
            return code
        # choose rows by priority: all other constraints, then given rates, then the rest of the driving rows
        at = max(mobility(held).configurations, key=lambda at: at.rank)

        def selected(numbers: Collection[int]) -> list[int]:
            """Return independent rows among those with the given numbers."""
            rows = [row if k in numbers else {} for k, row in enumerate(at.rows)]
            return independent(rows, held.redundancy_tolerance).rows

        moved = self._driven.rows(code.system)
        used = selected(set(range(len(at.rows))) - set(moved))
        for row in moved:  # given rates come first
            used = max(used, selected({*used, row}), key=len)
        return CompiledEquations(held, "relative", parameters=parameters, independent=used)

    def _free_rows(self, code: CompiledEquations) -> range:
        """Return the rows of driving constraints without a given rate, which have the lowest priority."""
        return self._driven.rows(code.system)[len(self._rate_keys) :]

    def _is_overdetermined(self, code: CompiledEquations) -> bool:
        """Return True if some initial coordinates follow from others, so that rates may be contradictory."""
        left = code.system.nv - code.rank
        return bool(self._keys) and left > mobility(self.scene).degrees_of_freedom - len(self._keys)

    @property
    def is_needed(self) -> bool:
        """True if one of the parameters changes the initial state."""
        return bool(self.initial or self.kinematic)

    def _linear_function(self, state: State, key: Key) -> Polynomial:
        """Return the linear function of time with the value and rate of a joint coordinate at a state."""
        return Polynomial(measured_coordinate(self.scene, state, key))

    def __call__(
        self, values: Mapping[str, Array], states: Sequence[State] | None = None
    ) -> tuple[Array, dict[int, MechanismError]]:
        """Assemble the initial states of n runs.

        Args:
            values: (n, ...) values by parameter name; parameters that do not change the initial state are
                ignored.
            states: initial states of the runs, closed with the scene's own parameters; the scene's initial
                state for all runs if None.

        Returns:
            Vectors x (n, inputs) of `code` (state, time, flags, parameters); errors by number of the run.
        """
        # follow the homotopy from the scene's parameters; retry runs that stay open in smaller steps
        count = len(next(iter(values.values())))
        own = np.tile(self._scene_start, (count, 1)) if states is None else self._start_vectors(states)
        targets = self._targets(own, values)
        steps = self._steps(own, targets)
        found, statuses = self._follow_paths(own, targets, steps)
        lost = np.flatnonzero(statuses != Status.DONE)
        if lost.size:
            again = self._follow_paths(
                own[lost], targets[lost], np.minimum(RETRY_FACTOR * steps[lost], MAX_STEPS)
            )
            found[lost], statuses[lost] = again
        # errors of runs that stay open or have contradictory rates
        lost = np.flatnonzero(statuses != Status.DONE)
        begun = "the scene's own start" if states is None else "the state given"
        errors = {run: self._error(run, found[run], values, begun) for run in lost.tolist()}
        given = {name: values[name] for name, number in self.initial.items() if number.order == 1}
        for run in self._contradictory_runs(found):
            problem = f"loops do not allow {self._format_values(run, given)}"
            error = MechanismError(f"run {run}", problem, "rates that loops and couplings allow")
            errors.setdefault(run, error)
        # revolutions of given angles; velocities that are round-off become zero
        self._set_revolutions(found, values)
        on_v, units = slice(self.code.system.nq, self.code.size), self.code.system.velocity_units
        begun, speeds = (np.abs(x[:, on_v] / units).max(axis=1, initial=0.0) for x in (own, found))
        found[speeds < np.finfo(float).eps * begun, on_v] = 0.0
        return found, errors

    @cached_property
    def _scene_start(self) -> Array:
        """Vector x (inputs,) of `code` at the initial state of the scene, with the scene's parameters."""
        return self._start_vectors([initial_state(self.scene)])[0]

    def _start_vectors(self, states: Sequence[State]) -> Array:
        """Return vectors x (n, inputs) of `code` at n states, with the scene's parameters."""
        code = self.code
        own = np.tile(code.packed(np.zeros(code.size), np.zeros(0)), (len(states), 1))
        states = [self._with_all_angles(state) for state in states]
        own[:, : code.size] = coordinates_of(code.system, states)
        for row, state in zip(own, states, strict=True):
            for key, name in self._driven.functions.items():
                row[code.place(name) :][:2] = self._linear_function(state, key).coefficients
        return own

    def _with_all_angles(self, state: State) -> State:
        """Return a state with all angles whose revolutions matter, those of initial coordinates included."""
        state = with_angles(self.scene, state)
        angles = [key for key in self._keys if not self.scene.mechanism.is_slide(*key)]
        moved = {key: measured_coordinate(self.scene, state, key)[0] for key in angles}
        return replace(state, angles={**state.angles, **moved})

    def _targets(self, own: Array, values: Mapping[str, Array]) -> Array:
        """Return vectors x (n, inputs) with the parameters of the runs at the end of their paths.

        Args:
            own: (n, inputs) vectors at the beginning of the paths.
            values: (n, ...) values by parameter name.
        """
        # geometry and prescribed motions, then initial coordinates (order 0) and rates (order 1)
        targets = own.copy()
        for name, place in self._unique_names.items():
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
        """Keys of the initial coordinates that are angles and belong to no coupling of the scene."""
        coupled = {key for coupling in couplings(self.scene) for key in coupling.factors}
        angles = {key for key in self._keys if not self.scene.mechanism.is_slide(*key)}
        return angles - coupled

    def _set_revolutions(self, x: Array, values: Mapping[str, Array]) -> None:
        """Add the full revolutions of the given values to the angles in x (n, inputs), in place."""
        for name, (key, order) in self.initial.items():
            if order == 0 and key in self._free_angles:
                place, column = self.code.system.angles[key], self.code.place(self._driven.functions[key])
                turned = whole_revolutions(values[name] - x[:, place])
                x[:, place] += turned
                x[:, column] += turned

    def _set_pieces(self, targets: Array) -> None:
        """Set polynomial pieces at time 0 in x (n, inputs) from samples of motions that are parameters."""
        code = self.code
        sampled = [
            name
            for name, place in places(code.scene, self._unique_names.values()).items()
            if numbered(*place.owner) + PIECE in code.parameters
        ]
        for row in targets if sampled else ():
            moved = with_values(code.scene, code.values(row, sampled))
            for name, numbers in pieces(moved, 0.0).items():
                row[code.place(name) :][: len(numbers)] = numbers

    def _steps(self, own: Array, targets: Array) -> Array:
        """Compute the number of homotopy steps of each run, (n,), from the distance of the parameters.

        Args:
            own, targets: (n, inputs) vectors at the beginning and at the end of the paths.
        """
        code, size = self.code, self.scene.mechanism.size
        units = np.ones(code.inputs)
        for name, place in places(code.scene, self._unique_names.values()).items():
            count = max(1, math.prod(code.parameters[name]))
            units[code.place(name) :][:count] = size if place.field.unit == "m" else 1.0
        for key, name in self._driven.functions.items():
            units[code.place(name)] = size if self.scene.mechanism.is_slide(*key) else 1.0
            units[code.place(name) + 1] = np.inf  # a change of a rate does not move the configuration
        longest = np.max(np.abs(targets - own) / units, axis=1)
        return np.clip(np.ceil(longest / MAX_STEP), 1, MAX_STEPS)

    def _follow_paths(self, own: Array, targets: Array, steps: Array) -> tuple[Array, Array]:
        """Follow the paths of n runs.

        Args:
            own, targets: (n, inputs) vectors at the beginning and at the end of the paths.
            steps: (n,) numbers of steps.

        Returns:
            Vectors x (n, inputs) at the end; statuses (n,), `Status.DONE` for closed loops.
        """
        code, python = self.code, Fallback(self.code, np.zeros(COUNTS))
        # the assembly never evaluates derivatives: their Python form saves the time of compilation
        system = equations(code, python, python.derivative, np.zeros(code.size))
        found, statuses, x = targets.copy(), np.zeros(len(own)), np.zeros(code.inputs)
        passing = int(self._is_overdetermined(code))
        given = np.ascontiguousarray(steps), np.ascontiguousarray(own), found
        paths = HomotopyRecord(len(own), passing, *given, x, statuses)
        native_method(assemble_all).bind(assemble_all, system, paths)()
        raise_fatal(python)
        return found, statuses

    def _error(self, run: int, x: Array, values: Mapping[str, Array], begun: str) -> MechanismError:
        """Return the error of a run whose loops stay open, naming the joint and the values of the run.

        Args:
            run: number of the run.
            x: (inputs,) where the path of the run ended.
            values: (n, ...) values by parameter name.
            begun: name of the beginning of the path in the message.
        """
        system = self.code.float_system(x)
        q, v = x[: system.nq], x[system.nq : self.code.size]
        with np.errstate(all="ignore"):
            joint, residual = worst_joint(system, system.state(q, v))
        path = f"on the way from {begun} to {self._format_values(run, values)}"
        problem = f"joint {joint!r} stays open by {residual:.3g} (m or rad) {path}"
        given = {number.key for number in self.initial.values() if number.order == 0}
        labels = self.scene.mechanism.coordinate_labels
        held = listed(START_PREFIX + labels[key] for key in self._keys if key not in given)
        problem += f", with {held} of the scene itself" if held else ""
        return MechanismError(f"run {run}", problem, "values that joints can reach with closed loops")

    def _format_values(self, run: int, values: Mapping[str, Array]) -> str:
        """Format the values that change the initial state of a run, for messages."""
        moving = [name for name in values if name in self._unique_names or name in self.initial]
        shown = ", ".join(f"{name} = {values[name][run].tolist()!r:.60}" for name in moving[:SHOWN_VALUES])
        return shown + (", ..." if len(moving) > SHOWN_VALUES else "")

    def _contradictory_runs(self, x: Array) -> list[int]:
        """Return the numbers of the runs whose given rates violate constraints at their x (n, inputs)."""
        code, free = self.code, self._free_rows(self.code)
        if not self._rate_keys or not self._is_overdetermined(code):
            return []

        def computed(system: Formulation, values: Mapping[str, Any], q: Array, v: Array) -> list[Scalar]:
            """Compute dimensionless rates of the residuals, velocities and prescribed rates."""
            rates = np.delete(system.phi_rate(q, v) / code.system.phi_units, free)
            return [*rates, *(v / code.system.velocity_units), *(system.phi_t() / code.system.phi_units)]

        found = np.abs(at_rows(self._function("rates", computed, len(free)), x))
        rates, speeds = np.split(found, [len(code.system.phi_units) - len(free)], axis=1)
        allowed = loose_tolerance(code.noise) * speeds.max(axis=1, initial=0.0)
        return np.flatnonzero(rates.max(axis=1, initial=0.0) > allowed).tolist()

    @np.errstate(all="ignore")  # a run rejects numbers that overflow
    def state(self, x: Array) -> State:
        """Return the state of the bodies at a vector x (inputs,) of `code`."""
        system = self.code.float_system(x)
        return system.state(x[: system.nq], x[system.nq : self.code.size])

    def starts(self, compiled: CompiledEquations, x: Array) -> Array:
        """Convert vectors x (n, inputs) of `code` to states (n, size) of other equations of the scene."""
        if compiled.formulation not in self._start_functions:
            self._start_functions[compiled.formulation] = self._native(compiled)
        found, system = at_rows(self._start_functions[compiled.formulation], x), compiled.system
        if isinstance(system, TreeKinematics):
            free = system.uncounted_angles
            found[:, free] -= whole_revolutions(found[:, free])
        return found

    def _native(self, compiled: CompiledEquations) -> NativeFunction:
        """Return the native function from x (inputs,) of `code` to (q, v) of other compiled equations."""

        def computed(system: Formulation, values: Mapping[str, Any], q: Array, v: Array) -> list[Scalar]:
            """Compute own coordinates, counted angles, zero work and velocities of the other equations."""
            inputs = {name: values[place] for name, place in self._unique_names.items()}
            other = formulate(with_values(self.scene, inputs), compiled.formulation)
            if isinstance(other, TreeKinematics):
                own, rates = q[: other.tree.nq], v
            else:
                own, rates = other.own_coordinates(system.state(q, v))
            seen = system.measured(q, v)
            angles = [seen[key].x for key, each in other.between.items() if each.carried is not None]
            work = [0.0] * (other.nq - len(own) - len(angles))
            return [*own, *angles, *work, *rates]

        # the name depends on the size of the state: with work as an output the state is longer
        return self._function(
            "starts", computed, compiled.formulation, compiled.size, tuple(self._unique_names)
        )

    def _function(
        self,
        name: str,
        compute: Callable[[Formulation, Mapping[str, Any], Array, Array], list[Scalar]],
        *chosen: object,
    ) -> NativeFunction:
        """Compile a function of x (inputs,) of `code`.

        Args:
            name: distinguishes the functions of a scene in the cache.
            compute: computes the results from the equations, the values of their parameters by name, q and v.
            chosen: everything that `compute` depends on in addition to the scene and its parameters.
        """
        code = self.code
        moving = code.scene.motions, parameter_layout(code.scene, code.parameters)
        neutral = NOT_COMPILED_FIELDS | {"outputs"}

        def trace(x: Array) -> tuple[list[Scalar], None]:
            """Evaluate the results over symbolic scalars x (inputs,); they need no layout."""
            values = code.values(x)
            system = formulate(with_values(code.scene, values), code.formulation)
            return compute(system, values, x[: system.nq], x[system.nq : code.size]), None

        return native_program(name, code.inputs, trace, self.scene, *chosen, *moving, neutral=neutral)
