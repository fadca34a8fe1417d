"""Initial states of many runs whose geometry, prescribed motions or initial joint coordinates vary.

Loops must be closed at the start of each run. The initial state of the scene is closed with the scene's own
parameters. From there, a homotopy changes the parameters in small steps to those of the run and keeps the
loops closed (`newton_euler.runs.homotopy`). The velocities at the end are the nearest to the scene's
velocities that the constraints allow. The result of a run does not depend on the other runs.

Initial joint coordinates (`newton_euler.runs.initial_coordinates`) are driving constraints on this path: each
such coordinate follows a linear function of time (`newton_euler.equations.driven`). If only the coordinate or
only the rate of a joint is given, the other one has the value of the scene's initial state. If loops do not
allow all rates together, given rates have priority. Joint coordinates have keys (joint, number).

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
from newton_euler.compiled.records import equations
from newton_euler.compiled.run import Fallback, native_method
from newton_euler.equations.couplings import counted_angles, couplings
from newton_euler.equations.driven import DrivenMechanism, driven
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.independence import independent
from newton_euler.equations.kinematics import TreeKinematics
from newton_euler.equations.parameter_names import PIECE, numbered, places, unambiguous
from newton_euler.equations.parameters import parameter_layout, pieces, with_values
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
        self._start_functions: dict[str, NativeFunction] = {}  # by formulation, see `_native`
        others = [name for name in names if name not in self.initial]
        self.kinematic = [name for name, place in places(scene, others).items() if place.field.moves_loops]
        self._unique_names = {name: unambiguous(scene, name) for name in self.kinematic}
        # joint coordinates with a given value or rate; those with a given rate first
        self._rate_keys = {number.key for number in self.initial.values() if number.order == 1}
        keys = dict.fromkeys(number.key for number in self.initial.values())
        self._keys = tuple(sorted(keys, key=lambda key: key not in self._rate_keys))

    @cached_property
    def _driven(self) -> DrivenMechanism:
        """The mechanism with driving constraints for the initial coordinates.

        Springs without stiffness make sure that full revolutions of the scene's angles are counted, because
        revolutions are counted only for angles that a force or a coupling depends on.
        """
        start = initial_state(self.scene)
        functions = {key: self._linear_function(start, key) for key in self._keys}
        coupled = {key for coupling in couplings(self.scene) for key in coupling.factors}
        others = [key for key in counted_angles(self.scene) if key not in coupled.union(self._keys)]
        springs = [JointSpring(joint, coordinate=k) for joint, k in others]
        return driven(self.scene, functions, forces=springs, initial_state=self._with_all_angles(start))

    @cached_property
    def code(self) -> CompiledEquations:
        """Compiled constraints of the driven mechanism, with the parameters as inputs."""
        scene = self._driven.scene
        parameters = (*self._unique_names.values(), *self._driven.function_names.values())
        code = CompiledEquations(scene, "relative", parameters=parameters)
        if not self._is_overdetermined(code):
            return code
        # select independent constraint rows by priority: all other constraints, then driving constraints with
        # given rates, then the rest of the driving constraints
        configuration = max(mobility(scene).configurations, key=lambda each: each.rank)

        def independent_among(numbers: Collection[int]) -> list[int]:
            """Return independent rows among those with the given numbers."""
            rows = [row if k in numbers else {} for k, row in enumerate(configuration.rows)]
            return independent(rows, scene.redundancy_tolerance).rows

        driving_rows = self._driven.rows(code.system)
        selected = independent_among(set(range(len(configuration.rows))) - set(driving_rows))
        for row in driving_rows:  # those with given rates come first; add a row if it is independent
            selected = max(selected, independent_among({*selected, row}), key=len)
        return CompiledEquations(scene, "relative", parameters=parameters, independent=selected)

    def _rows_without_rate(self, code: CompiledEquations) -> range:
        """Return the rows of driving constraints without a given rate, which have the lowest priority."""
        return self._driven.rows(code.system)[len(self._rate_keys) :]

    def _is_overdetermined(self, code: CompiledEquations) -> bool:
        """Return True if some initial coordinates follow from others, so that rates may be contradictory."""
        remaining_freedoms = code.system.nv - code.rank
        expected = mobility(self.scene).degrees_of_freedom - len(self._keys)
        return bool(self._keys) and remaining_freedoms > expected

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
            Vectors x (n, inputs) of `code`: state, time, flags (1 for a constraint row that is left out as
            redundant, else 0), parameters; errors by number of the run.
        """
        # follow the homotopy from the scene's parameters; retry runs that stay open in smaller steps
        count = len(next(iter(values.values())))
        begins = np.tile(self._scene_start, (count, 1)) if states is None else self._start_vectors(states)
        targets = self._targets(begins, values)
        steps = self._steps(begins, targets)
        ends, statuses = self._follow_paths(begins, targets, steps)
        is_open = statuses != Status.DONE
        if is_open.any():
            more_steps = np.minimum(RETRY_FACTOR * steps[is_open], MAX_STEPS)
            retried = self._follow_paths(begins[is_open], targets[is_open], more_steps)
            ends[is_open], statuses[is_open] = retried
        # errors of runs that stay open or have contradictory rates
        open_runs = np.flatnonzero(statuses != Status.DONE).tolist()
        begin_text = "the scene's own start" if states is None else "the state given"
        errors = {run: self._error(run, ends[run], values, begin_text) for run in open_runs}
        given_rates = {name: values[name] for name, number in self.initial.items() if number.order == 1}
        for run in self._contradictory_runs(ends):
            problem = f"loops do not allow {self._format_values(run, given_rates)}"
            error = MechanismError(f"run {run}", problem, "rates that loops and couplings allow")
            errors.setdefault(run, error)
        # revolutions of given angles; velocities that are round-off become zero
        self._set_revolutions(ends, values)
        on_v, units = slice(self.code.system.nq, self.code.size), self.code.system.velocity_units
        first_speeds, last_speeds = (
            np.abs(x[:, on_v] / units).max(axis=1, initial=0.0) for x in (begins, ends)
        )
        ends[last_speeds < np.finfo(float).eps * first_speeds, on_v] = 0.0
        return ends, errors

    @cached_property
    def _scene_start(self) -> Array:
        """Vector x (inputs,) of `code` at the initial state of the scene, with the scene's parameters."""
        return self._start_vectors([initial_state(self.scene)])[0]

    def _start_vectors(self, states: Sequence[State]) -> Array:
        """Return vectors x (n, inputs) of `code` at n states, with the scene's parameters."""
        code = self.code
        x = np.tile(code.packed(np.zeros(code.size), np.zeros(0)), (len(states), 1))
        states = [self._with_all_angles(state) for state in states]
        x[:, : code.size] = coordinates_of(code.system, states)
        for row, state in zip(x, states, strict=True):
            for key, name in self._driven.function_names.items():
                row[code.place(name) :][:2] = self._linear_function(state, key).coefficients
        return x

    def _with_all_angles(self, state: State) -> State:
        """Return a state with all angles whose revolutions matter, those of initial coordinates included."""
        state = with_angles(self.scene, state)
        keys = [key for key in self._keys if not self.scene.mechanism.is_slide(*key)]
        angles = {key: measured_coordinate(self.scene, state, key)[0] for key in keys}
        return replace(state, angles={**state.angles, **angles})

    def _targets(self, begins: Array, values: Mapping[str, Array]) -> Array:
        """Return vectors x (n, inputs) with the parameters of the runs at the end of their paths.

        Args:
            begins: (n, inputs) vectors at the beginning of the paths.
            values: (n, ...) values by parameter name.
        """
        # geometry and prescribed motions
        targets = begins.copy()
        for name, unique_name in self._unique_names.items():
            flat = values[name].reshape(len(begins), -1)
            targets[:, self.code.place(unique_name) :][:, : flat.shape[1]] = flat
        self._set_pieces(targets)
        # initial coordinates (order 0) and rates (order 1): coefficients of the driving linear functions
        for name, (key, order) in self.initial.items():
            column = self.code.place(self._driven.function_names[key]) + order
            targets[:, column] = values[name]
            if order == 0 and key in self._free_angles:  # without full revolutions, which have no effect
                targets[:, column] -= whole_revolutions(values[name] - begins[:, column])
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
                # the angle itself, and the function that drives the angle
                angle = self.code.system.angles[key]
                function = self.code.place(self._driven.function_names[key])
                turned = whole_revolutions(values[name] - x[:, angle])
                x[:, angle] += turned
                x[:, function] += turned

    def _set_pieces(self, targets: Array) -> None:
        """Set the polynomial pieces of splines at time 0 in x (n, inputs), in place.

        The samples of these splines are parameters that vary. The equations use only the current polynomial
        piece, whose coefficients are separate parameters, such as "motions[0].function.piece".
        """
        code = self.code
        splines = [
            name
            for name, place in places(code.scene, self._unique_names.values()).items()
            if numbered(*place.owner) + PIECE in code.parameters
        ]
        for row in targets if splines else ():
            scene_of_run = with_values(code.scene, code.values(row, splines))
            for name, coefficients in pieces(scene_of_run, 0.0).items():
                row[code.place(name) :][: len(coefficients)] = coefficients

    def _steps(self, begins: Array, targets: Array) -> Array:
        """Compute the number of homotopy steps of each run, (n,), from the distance of the parameters.

        Args:
            begins, targets: (n, inputs) vectors at the beginning and at the end of the paths.
        """
        code, size = self.code, self.scene.mechanism.size
        units = np.ones(code.inputs)
        for name, place in places(code.scene, self._unique_names.values()).items():
            count = max(1, math.prod(code.parameters[name]))
            units[code.place(name) :][:count] = size if place.field.unit == "m" else 1.0
        for key, name in self._driven.function_names.items():
            units[code.place(name)] = size if self.scene.mechanism.is_slide(*key) else 1.0
            units[code.place(name) + 1] = np.inf  # a change of a rate does not move the configuration
        longest = np.max(np.abs(targets - begins) / units, axis=1)
        return np.clip(np.ceil(longest / MAX_STEP), 1, MAX_STEPS)

    def _follow_paths(self, begins: Array, targets: Array, steps: Array) -> tuple[Array, Array]:
        """Follow the paths of n runs.

        Args:
            begins, targets: (n, inputs) vectors at the beginning and at the end of the paths.
            steps: (n,) numbers of steps.

        Returns:
            Vectors x (n, inputs) at the end; statuses (n,), `Status.DONE` for closed loops.
        """
        # Python callbacks for singular states and interrupts, with the counters of a run
        code, python = self.code, Fallback(self.code, counts=np.zeros(COUNTS))
        # the homotopy never evaluates derivatives, so that the Python callback stands for them uncompiled; it
        # wraps no angles and normalizes no quaternions, so that none are marked
        system = equations(code, python, python.derivative, marked=np.zeros(code.size))
        ends, statuses = targets.copy(), np.zeros(len(begins))
        paths = HomotopyRecord(
            count=len(begins),
            may_open=int(self._is_overdetermined(code)),  # redundant coordinates may agree only at the end
            steps=np.ascontiguousarray(steps),
            begins=np.ascontiguousarray(begins),
            ends=ends,
            x=np.zeros(code.inputs),
            statuses=statuses,
        )
        native_method(assemble_all).bind(assemble_all, system, paths)()
        raise_fatal(python)
        return ends, statuses

    def _error(self, run: int, x: Array, values: Mapping[str, Array], begin_text: str) -> MechanismError:
        """Return the error of a run whose loops stay open, naming the joint and the values of the run.

        Args:
            run: number of the run.
            x: (inputs,) where the path of the run ended.
            values: (n, ...) values by parameter name.
            begin_text: text for the beginning of the path.
        """
        system = self.code.float_system(x)
        q, v = x[: system.nq], x[system.nq : self.code.size]
        with np.errstate(all="ignore"):
            joint, residual = worst_joint(system, system.state(q, v))
        path = f"on the way from {begin_text} to {self._format_values(run, values)}"
        problem = f"joint {joint!r} stays open by {residual:.3g} (m or rad) {path}"
        # a joint with a given rate and no given coordinate keeps the coordinate of the scene
        given = {number.key for number in self.initial.values() if number.order == 0}
        labels = self.scene.mechanism.coordinate_labels
        kept = listed(START_PREFIX + labels[key] for key in self._keys if key not in given)
        problem += f", with {kept} of the scene itself" if kept else ""
        return MechanismError(f"run {run}", problem, "values that joints can reach with closed loops")

    def _format_values(self, run: int, values: Mapping[str, Array]) -> str:
        """Format the values that change the initial state of a run, for messages."""
        moving = [name for name in values if name in self._unique_names or name in self.initial]
        shown = ", ".join(f"{name} = {values[name][run].tolist()!r:.60}" for name in moving[:SHOWN_VALUES])
        return shown + (", ..." if len(moving) > SHOWN_VALUES else "")

    def _contradictory_runs(self, x: Array) -> list[int]:
        """Return the numbers of the runs whose given rates violate constraints at their x (n, inputs)."""
        code, ignored = self.code, self._rows_without_rate(self.code)
        if not self._rate_keys or not self._is_overdetermined(code):
            return []

        def compute(system: Formulation, values: Mapping[str, Any], q: Array, v: Array) -> list[Scalar]:
            """Compute dimensionless rates of the residuals, velocities and prescribed rates."""
            rates = np.delete(system.phi_rate(q, v) / code.system.phi_units, ignored)
            return [*rates, *(v / code.system.velocity_units), *(system.phi_t() / code.system.phi_units)]

        magnitudes = np.abs(at_rows(self._function("rates", compute, len(ignored)), x))
        rates, speeds = np.split(magnitudes, [len(code.system.phi_units) - len(ignored)], axis=1)
        # `noise` is the largest singular value of constraints that are ignored as almost redundant
        allowed = loose_tolerance(code.noise) * speeds.max(axis=1, initial=0.0)
        return np.flatnonzero(rates.max(axis=1, initial=0.0) > allowed).tolist()

    @np.errstate(all="ignore")  # a run rejects numbers that overflow
    def state(self, x: Array) -> State:
        """Return the state of the bodies at a vector x (inputs,) of `code`."""
        system = self.code.float_system(x)
        return system.state(x[: system.nq], x[system.nq : self.code.size])

    def starts(self, compiled: CompiledEquations, x: Array) -> Array:
        """Convert vectors x (n, inputs) of `code` to states (n, size) of the equations of runs."""
        if compiled.formulation not in self._start_functions:
            self._start_functions[compiled.formulation] = self._native(compiled)
        states, system = at_rows(self._start_functions[compiled.formulation], x), compiled.system
        if isinstance(system, TreeKinematics):  # joint coordinates
            uncounted = system.uncounted_angles
            states[:, uncounted] -= whole_revolutions(states[:, uncounted])
        return states

    def _native(self, compiled: CompiledEquations) -> NativeFunction:
        """Return the native function from x (inputs,) of `code` to (q, v) of the equations of runs.

        q holds the formulation's own coordinates (joint coordinates or poses), then angles with counted
        revolutions, then the work of forces if the scene integrates it.
        """

        def compute(system: Formulation, values: Mapping[str, Any], q: Array, v: Array) -> list[Scalar]:
            """Compute q and v of the equations of runs."""
            scene_values = {name: values[unique_name] for name, unique_name in self._unique_names.items()}
            of_run = formulate(with_values(self.scene, scene_values), compiled.formulation)
            if isinstance(of_run, TreeKinematics):  # joint coordinates, as in `code`
                own, rates = q[: of_run.tree.nq], v
            else:
                own, rates = of_run.own_coordinates(system.state(q, v))
            # angles that the formulation has to carry behind its own coordinates to count their revolutions
            measured = system.measured(q, v)
            angles = [measured[key].x for key, each in of_run.between.items() if each.carried is not None]
            work = [0.0] * (of_run.nq - len(own) - len(angles))
            return [*own, *angles, *work, *rates]

        # the size belongs to the key in the cache: with work as an output the state is longer
        return self._function(
            "starts", compute, compiled.formulation, compiled.size, tuple(self._unique_names)
        )

    def _function(
        self,
        name: str,
        compute: Callable[[Formulation, Mapping[str, Any], Array, Array], list[Scalar]],
        *depends_on: object,
    ) -> NativeFunction:
        """Compile a function of x (inputs,) of `code`.

        Args:
            name: distinguishes the functions of a scene in the cache.
            compute: computes the results from the equations, the values of their parameters by name, q and v.
            depends_on: everything that `compute` depends on in addition to the scene and its parameters.
        """
        code = self.code
        inputs = code.scene.motions, parameter_layout(code.scene, code.parameters)
        neutral = NOT_COMPILED_FIELDS | {"outputs"}  # fields that compiled code does not depend on

        def trace(x: Array) -> tuple[list[Scalar], None]:
            """Evaluate the results over symbolic scalars x (inputs,); they need no description."""
            values = code.values(x)
            system = formulate(with_values(code.scene, values), code.formulation)
            return compute(system, values, x[: system.nq], x[system.nq : code.size]), None

        return native_program(name, code.inputs, trace, self.scene, *depends_on, *inputs, neutral=neutral)
