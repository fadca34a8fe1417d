"""Initial states of runs, and their derivatives with respect to parameters of the scene.

A parameter such as a joint point changes the pose in which loops close, and so the initial state. `Starts`
assembles the initial state for given parameter values and differentiates the assembly by finite differences.
A parameter that is an array, such as a matrix of inertia, has several numbers; each number is one of the p
parameters here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from newton_euler.analysis.sensitivity.tangent_run import NEAR_SINGULAR
from newton_euler.equations.parameter_names import places
from newton_euler.errors import MechanismError, SensitivityError
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.scene import Scene
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.simulate import CompiledScene
from newton_euler.runs.starts import assembly_of
from newton_euler.runs.variation import of_single_run, own_values, run_values, units_of
from newton_euler.scalars import Array

RELATIVE_STEP = 1e-4
"""Step of difference quotients of initial states, as a fraction of the size of the parameter (see `_sizes`)
times the larger of 1 and the parameter's magnitude."""

SIXTH_ORDER = {-3: -1 / 60, -2: 9 / 60, -1: -45 / 60, 1: 45 / 60, 2: -9 / 60, 3: 1 / 60}
"""Weights of the central difference of order 6, by the offset in steps."""

FOURTH_ORDER = np.array([0.0, 1.0, -8.0, 8.0, -1.0, 0.0]) / 12.0
"""Weights of the central difference of order 4, at the same six offsets."""

MAX_ORDER_DIFFERENCE = 5e-6
"""Largest relative difference between the two orders; the error of order 6 is then about 5e-6^(6/4) = 1e-8.

Near a singular configuration, the errors of order 4 and 6 grow with the fourth and the sixth power of the
step divided by the distance.
"""

DIRECTION_ATTRIBUTES = frozenset(
    {"axis", "quaternion", *(name for kind in JOINT_KINDS.values() for name in kind.axis_names)}
)
"""Attributes of elements that are directions or orientations, without a unit."""

MIN_COMPARED = 1e-3
"""Smallest scale by which the difference of two derivatives is divided, SI."""


def components(scene: Scene, names: Sequence[str]) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Find the p numbers of parameters that may be arrays; an inertia, (3, 3), has each number once.

    Returns:
        For each number, by its name such as `gravity.z`: the name of the parameter, and the index in its
        value.
    """
    numbers: dict[str, tuple[str, tuple[int, ...]]] = {}
    for name, value in own_values(scene, names).items():
        for index in np.ndindex(*value.shape):
            if value.shape == (3, 3) and index[0] > index[1]:  # below the diagonal of an inertia
                continue
            is_spatial = set(value.shape) == {3}  # vector or matrix, with components x, y, z
            component = "".join("xyz"[k] for k in index) if is_spatial else ".".join(map(str, index))
            numbers[f"{name}.{component}" if component else name] = name, index
    return numbers


def own_numbers(scene: Scene, names: Sequence[str]) -> Array:
    """Return the scene's own values (p,) of numbers, including initial coordinates."""
    return np.array([float(value) for value in own_values(scene, names).values()])


def _sizes(scene: Scene, names: Sequence[str]) -> Array:
    """Return the typical sizes (p,) of parameters, for steps of difference quotients.

    1 for angles, their rates and directions of axes. The size of the mechanism, m, at most 1, for lengths and
    for numbers of mixed units, for example of functions of time.
    """
    units, initial = units_of(scene, names), initial_numbers(scene, names)
    angular = {name for name in names if units[name].startswith("rad")}
    for name, place in places(scene, [name for name in names if name not in initial]).items():
        _, _, attribute = place.owner  # field of the scene, number of the element there, attribute
        if {*attribute.split(".")} & DIRECTION_ATTRIBUTES:
            angular.add(name)
    return np.array([1.0 if name in angular else min(1.0, scene.mechanism.size) for name in names])


class Starts:
    """Function that computes the initial state of a scene for values of p parameters, and its derivatives.

    Loops are closed to round-off. The derivatives are difference quotients of order 6, with an error of about
    1e-11 far from singular configurations. They are refused if difference quotients of order 4 deviate by
    more than `MAX_ORDER_DIFFERENCE`. The caller projects the derivatives onto the linearized constraints.
    """

    def __init__(
        self, code: CompiledScene, names: Sequence[str], held: Mapping[str, float] | None = None
    ) -> None:
        """Prepare the assembly.

        Args:
            code: compiled scene; its input vector x has the state and the parameters.
            names: names of the p parameters.
            held: values, by name, of initial coordinates and rates (`start.JOINT`) that are given, but are
                not among the p parameters.
        """
        self._code, self._held = code, np.array(list((held or {}).values()))
        self._names = (*names, *(held or {}))
        self._assembly = assembly_of(code.scene, self._names)
        self._sizes = _sizes(code.scene, names)
        # indices of the parameters that change the initial state: those of geometry and prescribed motions
        # (`kinematic`), and initial joint coordinates and rates (`initial`)
        moves_start = {*self._assembly.kinematic, *self._assembly.initial}
        self._moving = [k for k, name in enumerate(names) if name in moves_start]

    def __call__(self, numbers: Array) -> tuple[Array, Array]:
        """Compute the initial input vector x (inputs,) and its derivatives (inputs, p) for values (p,).

        Raises:
            MechanismError: for invalid values, and if a loop stays open.
            SensitivityError: for derivatives that do not exist or cannot be computed.
        """
        # parameters that are inputs of the equations
        code, steps = self._code, RELATIVE_STEP * self._sizes * np.maximum(1.0, np.abs(numbers))
        count, numbers = len(numbers), np.concatenate([numbers, self._held])
        x, directions = code.start.copy(), np.zeros((code.inputs, count))
        for k, name in enumerate(self._names[:count]):
            if name in code.parameters:
                x[code.place(name)] = numbers[k]
                directions[code.place(name), k] = 1.0
        # rows of parameter values: the given ones; then, for each parameter that changes the initial state,
        # rows with this parameter changed by -3, -2, -1, 1, 2, 3 steps
        rows = [numbers]
        for k in self._moving:
            for number in SIXTH_ORDER:
                rows.append(numbers.copy())
                rows[-1][k] += number * steps[k]
        values = run_values(code.scene, dict(zip(self._names, np.array(rows).T, strict=True)))
        self._refuse(values.errors)
        if self._assembly.is_needed:
            assembled, errors = self._assembly(values.arrays)
            self._refuse(errors)
            states = self._assembly.starts(code, assembled)
            x[: code.size] = states[0]
            weights, system = np.array(list(SIXTH_ORDER.values())), code.system
            # indices in q of all hinge angles: those whose revolutions are counted, because forces or
            # couplings depend on them, and the others. Differences of full revolutions are removed from all
            angles = [*system.angles.values(), *system.uncounted_angles]
            changed_states = states[1:].reshape(-1, len(weights), code.size)
            for k, changed in zip(self._moving, changed_states, strict=True):
                changes = changed - states[0]
                changes[:, angles] -= 2.0 * np.pi * np.round(changes[:, angles] / (2.0 * np.pi))
                sixth, fourth = weights @ changes / steps[k], FOURTH_ORDER @ changes / steps[k]
                # compare both orders, for coordinates and for velocities
                for part in (slice(system.nq), slice(system.nq, code.size)):
                    scale = np.abs([sixth[part], states[0, part]]).max(initial=MIN_COMPARED)
                    if not np.abs(sixth - fourth)[part].max(initial=0.0) <= MAX_ORDER_DIFFERENCE * scale:
                        unknown = f"the derivative of the start by {self._names[k]} is not known"
                        raise SensitivityError(f"{unknown}: {NEAR_SINGULAR}")
                directions[: code.size, k] = sixth
        return x, directions

    def _refuse(self, errors: Mapping[int, MechanismError]) -> None:
        """Raise the first error: of the start itself (row 0), or of a start with one changed parameter."""
        for row, error in sorted(errors.items()):
            if row == 0:
                raise of_single_run(self._code.scene, error)
            name = self._names[self._moving[(row - 1) // len(SIXTH_ORDER)]]
            raise SensitivityError(f"{name} cannot vary alone: {error.problem}")
