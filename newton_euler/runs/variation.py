"""Change parameters of a scene: the scene with other values, and checks of the values of many runs.

Parameters are numbers of a scene with names such as `crank.mass` (`newton_euler.equations.parameters`).
The constructor of an element, such as a body, decides which values the element may have. For a single number,
a constructor accepts an interval of values. Bisection with a few constructions therefore checks the values of
all runs. Inertias and directions of all runs are first tested by array operations, and only suspicious values
are passed to the constructor.

An assembly (`newton_euler.runs.starts.Assembly`) closes the loops at the initial states of runs. It is needed
if one of the values changes the geometry, a prescribed motion or an initial coordinate.

The decorator `checked` makes a public function check its arguments against their type hints, except those
marked `UNCHECKED`.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, NamedTuple, TypeAlias, assert_never

import numpy as np

from newton_euler.arguments import UNCHECKED, checked
from newton_euler.equations.parameter_names import Owner, Place, element_of, places
from newton_euler.equations.parameters import own_value, parameter_values, rebuilt, refusal, with_values
from newton_euler.errors import MechanismError, finite_array, quoted, real_array
from newton_euler.model.elements import Element, OnBall
from newton_euler.model.fields import NumberField
from newton_euler.model.initial_pose import coordinates_at, described_at
from newton_euler.model.mechanism import MIN_INERTIA, REALISABLE_TOLERANCE
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.variable import functions_of
from newton_euler.runs.initial_coordinates import RATE_SUFFIX, START_PREFIX, initial_numbers, own_initial
from newton_euler.runs.starts import Assembly, assembly_of
from newton_euler.scalars import Array, Floats

MIN_DIRECTION_LENGTH = 1e-100
"""Length of a direction vector (its largest component) below which the constructor has to check it."""

MAX_DIRECTION_LENGTH = 1e100
"""Length of a direction vector (its largest component) above which the constructor has to check it."""

INERTIA_MARGIN = 1e-9
"""Ratio of the smallest principal inertia to the largest element of an inertia matrix, below which the
constructor has to check the matrix."""

Start: TypeAlias = Sequence[float] | Sequence[Sequence[float] | None] | Floats
"""Coordinate and rate of a joint with one coordinate; a list of such pairs for a joint with several."""


class RunValues(NamedTuple):
    """Values of parameters in n runs.

    Attributes:
        arrays: (n, ...) values by name; a run with an error has the scene's own values.
        errors: error for the first invalid value of a run, by number of the run.
    """

    arrays: dict[str, Array]
    errors: dict[int, MechanismError]


@checked
def with_parameters(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """Return the scene with other values of some parameters, checked, with closed loops.

    `simulate_batch` with these values gives the same motion. If `point_on_first`, `point_on_second` or
    `length` of a joint changes, the result has another initial pose, at which the joints are closed. Joint
    coordinates are zero at this new pose, whereas a batch measures them from the pose of the given scene.
    If constraints are redundant, `simulate` of the result selects the independent ones at the new values; a
    batch keeps the selection of the given scene.

    Args:
        scene: the scene to change.
        values: by name, see `newton_euler.equations.parameters`, and initial coordinates, see
            `newton_euler.runs.initial_coordinates`.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a value that the scene cannot have, and for values with which a loop cannot close.

    Examples:
        >>> heavy = with_parameters(load("pendulum"), {"dumbbell.mass": 3.0})
        >>> force = np.linalg.norm(np.asarray(simulate(heavy).reaction_force)[:, 0], axis=1)
        >>> print(force.max().round(2), "N")
        64.75 N
    """
    given = checked_values(scene, values)
    assembly = assembly_of(scene, tuple(given))
    if assembly.is_needed:
        # a single run; x begins with the coordinates and velocities of its initial state
        (x,), errors = assembly({name: value[None] for name, value in given.items()})
        for error in errors.values():
            raise of_single_run(scene, error)
    numbers = {name: value for name, value in given.items() if name not in assembly.initial}
    # joints stay closed at the initial pose: change the values, and start at the assembled state
    if not any(place.field.opens_joints for place in places(scene, numbers).values()):
        changed = rebuilt(scene, numbers) if numbers else scene
        return replace(changed, initial_state=assembly.state(x)) if assembly.is_needed else changed
    # joints open at the initial pose: describe the scene at another one, where its joint coordinates are zero
    varied, state = with_values(scene, numbers), assembly.state(x)
    pose = _assembled_pose(scene, numbers) or state
    zeros = coordinates_at(varied.mechanism, pose)
    angles = {key: angle - zeros[key] for key, angle in state.angles.items()}
    return replace(described_at(varied, pose), initial_state=replace(state, angles=angles))


def checked_values(scene: Scene, values: Mapping[str, Any]) -> dict[str, Array]:
    """Check values of parameters, by name, and return them as arrays.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a value that the scene cannot have.
    """
    checked_runs = run_values(scene, {name: [value] for name, value in values.items()})
    for error in checked_runs.errors.values():
        raise of_single_run(scene, error)
    return {name: array[0] for name, array in checked_runs.arrays.items()}


def of_single_run(scene: Scene, error: MechanismError) -> MechanismError:
    """Return an error of run 0 without the text "run 0", for a caller with a single run."""
    element = error.element.removeprefix("run 0").removeprefix(": ") or f"scene {scene.name!r}"
    return MechanismError(element, error.problem, error.needed)


@checked
def start(scene: Scene, /, **joints: Annotated[Start, UNCHECKED]) -> Scene:
    """Return the scene with another start: given coordinates of joints and their rates.

    All other coordinates start as close to the scene's own start as the loops allow.

    Args:
        scene: the scene to start.
        joints: for each joint by name, (coordinate, rate) from the initial pose, in rad and rad/s or m and
            m/s. A joint of several coordinates needs a list of such pairs, with None for a coordinate that is
            not given. Angles include full revolutions, because these wind up a spring.

    Raises:
        UnknownNameError: for an unknown joint.
        MechanismError: naming a joint that has no coordinate, follows a prescribed motion, or cannot reach
            the start because of loops and couplings.

    Examples:
        >>> scene = start(load("pendulum"), pivot=(0.5, -2.0))
        >>> motion = simulate(scene).joint("pivot")
        >>> print(motion.coordinates[:2].round(3).tolist())
        [[0.5], [0.48]]
    """
    labels, values = scene.mechanism.coordinate_labels, dict[str, float]()
    for name, given in joints.items():
        kinds, where = scene.mechanism.joint(name).coordinate_kinds, f"joint {name!r}"
        if not kinds:
            raise MechanismError(where, "has no coordinate to start at", "a joint with a hinge or a slide")
        pairs: Any = [given] if len(kinds) == 1 else given
        if not isinstance(pairs, list | tuple | np.ndarray) or len(pairs) != len(kinds):
            needed = f"a list of {len(kinds)} pairs or None, {', '.join(kinds)}"
            raise MechanismError(where, f"start is {quoted(given)}", needed)
        for k, pair in enumerate(pairs):
            if pair is not None:
                x, rate = finite_array(where, "start", pair, (2,)).tolist()
                values |= {
                    f"{START_PREFIX}{labels[name, k]}": x,
                    f"{START_PREFIX}{labels[name, k]}{RATE_SUFFIX}": rate,
                }
    if not values:
        raise MechanismError(f"scene {scene.name!r}", "has no joint to start", "one joint or more by name")
    return with_parameters(scene, values)


def _assembled_pose(scene: Scene, numbers: Mapping[str, Array]) -> State | None:
    """Assemble the initial pose of a scene, at rest, with other parameter values.

    Args:
        scene: the scene.
        numbers: values by parameter name; those of prescribed motions are ignored.

    Returns:
        The pose; None if the loops cannot be closed.
    """
    still = replace(scene, motions=(), initial_state=None)
    named = places(scene, numbers)
    # the owner of a parameter begins with the field of the scene, here the list of prescribed motions
    values = {name: value[None] for name, value in numbers.items() if named[name].owner[0] != "motions"}
    assembly = Assembly(still, tuple(values))
    (x,), errors = assembly(values)
    return None if errors else assembly.state(x)


def own_values(scene: Scene, names: Iterable[str]) -> dict[str, Array]:
    """Return the scene's own values of parameters and initial coordinates, by name.

    Raises:
        UnknownNameError: for any other name.
        MechanismError: for a name of two parameters, and for two names of the same number.
    """
    names = list(names)
    initial = initial_numbers(scene, names)
    own = parameter_values(scene, [name for name in names if name not in initial])
    own |= {name: np.array(own_initial(scene, number)) for name, number in initial.items()}
    return {name: own[name] for name in names}


def units_of(scene: Scene, names: Iterable[str]) -> dict[str, str]:
    """Return the SI units of parameters and initial coordinates; empty for pure numbers and mixed units.

    Raises:
        UnknownNameError: for any other name.
        MechanismError: for a name of two parameters, and for two names of the same number.
    """
    names = list(names)
    found = {}
    for name, number in initial_numbers(scene, names).items():
        length = "m" if scene.mechanism.is_slide(*number.key) else "rad"
        found[name] = f"{length}/s" if number.order else length
    named = places(scene, [name for name in names if name not in found])
    found |= {name: _unit(scene, place) for name, place in named.items()}
    return {name: found[name] for name in names}


def _unit(scene: Scene, place: Place) -> str:
    """Return the SI unit of a parameter.

    For elements that act on a joint coordinate, such as springs, the unit depends on whether the coordinate
    is a length or an angle.
    """
    element, field = element_of(scene, place.owner), place.field
    _, _, attribute = place.owner
    if functions_of(getattr(element, attribute, None)):  # numbers of a function of time: mixed units
        return ""
    key = element.unit_key if isinstance(element, Element) else None
    is_rotation = isinstance(element, OnBall) or (key is not None and not scene.mechanism.is_slide(*key))
    return field.unit_about if is_rotation and field.unit_about else field.unit


def run_values(scene: Scene, given: Mapping[str, Sequence[Any] | Array]) -> RunValues:
    """Check values of parameters for many runs.

    Args:
        scene: the scene.
        given: values by name, one per run.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a name of two parameters, two names of the same number, and values whose shape
            is wrong in all runs.
    """
    # finite numbers of the right shape
    initial, own, runs = initial_numbers(scene, given), own_values(scene, given), RunValues({}, {})
    for name, values in given.items():
        array, unusable = _as_array(name, values, own[name])
        runs.arrays[name] = array
        for k, value in unusable.items():
            _store_error(runs, k, name, f"is {quoted(value)}", f"finite numbers of shape {own[name].shape}")
    # values that the element can have; parameters of one element are checked together
    by_element: dict[tuple[str, int], dict[str, Place]] = {}
    for name, place in places(scene, [name for name in given if name not in initial]).items():
        element = place.owner[:2]  # field of the scene, and number of the element there
        by_element.setdefault(element, {})[name] = place
    for element_places in by_element.values():
        _check_element(scene, element_places, runs)
    # runs with errors have the scene's own values
    for k in runs.errors:
        for name, value in own.items():
            runs.arrays[name][k] = value
    return runs


def _as_array(name: str, values: Sequence[Any] | Array, own: Array) -> tuple[Array, dict[int, Any]]:
    """Convert the values of a parameter in n runs to an array.

    Args:
        name: name of the parameter.
        values: one value per run.
        own: the scene's own value.

    Returns:
        (n, ...) floats, with the own value in place of unusable ones; the unusable values by run number.
    """
    rows = list(values) if isinstance(values, Sequence) else np.asanyarray(values)
    try:
        array = real_array(rows)
    except (TypeError, ValueError, OverflowError):
        converted = [_as_row(value, own) for value in rows]
        usable = np.array([row is not None for row in converted])
        array = np.array([own if row is None else row for row in converted])
    else:
        if array.shape[1:] != own.shape:
            needed = f"finite numbers of shape {own.shape}"
            raise MechanismError(f"parameter {name!r}", f"has values of shape {array.shape[1:]}", needed)
        usable = np.isfinite(array).reshape(len(array), -1).all(axis=1)
        array[~usable] = own
    return array, {k: rows[k] for k in np.flatnonzero(~usable).tolist()}


def _as_row(value: Any, own: Array) -> Array | None:
    """Convert the value of one run to floats; None for another shape than `own` or infinite numbers."""
    try:
        row = real_array(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return row if row.shape == own.shape and np.isfinite(row).all() else None


def _store_error(runs: RunValues, run: int, name: str, problem: str, needed: str) -> None:
    """Store an error for a value of a run, unless the run already has an error."""
    runs.errors.setdefault(run, MechanismError(f"run {run}: parameter {name!r}", problem, needed))


def _check_element(scene: Scene, element_places: Mapping[str, Place], runs: RunValues) -> None:
    """Check the values of the parameters of one element in all runs.

    Args:
        scene: the scene with the element.
        element_places: location of the parameters of the element, by name. The `owner` of a parameter is an
            attribute of the element, `component` the index in the attribute's value, None for the whole.
        runs: values of all runs; receives the errors.
    """
    # values of whole attributes in all runs, (n, ...)
    stacks: dict[Owner, Array] = {}
    fields: dict[Owner, NumberField] = {}
    for name, (owner, component, field) in element_places.items():
        fields[owner] = field
        array = runs.arrays[name]
        if component is None:
            stacks[owner] = array
            continue
        if owner not in stacks:
            stacks[owner] = np.repeat(own_value(scene, owner)[None], len(array), axis=0)
        columns = np.moveaxis(stacks[owner], 0, -1)  # a view
        columns[component] = array
        if stacks[owner].shape[1:] == (3, 3):  # symmetric matrices
            columns[component[::-1]] = array
    # runs whose values the constructor may refuse
    suspicious = np.zeros(0, dtype=int)
    for owner, stack in stacks.items():
        suspicious = np.union1d(suspicious, _suspicious(scene, owner, fields[owner], stack))
    for k in suspicious.tolist():
        error = refusal(scene, {owner: stack[k] for owner, stack in stacks.items()})
        if error is None:
            continue
        # attribute the error to a parameter that the constructor refuses without the others, if there is one
        refused_alone = [
            name for name, (owner, *_) in element_places.items() if refusal(scene, {owner: stacks[owner][k]})
        ]
        name = next(iter([*refused_alone, *element_places]))
        value = runs.arrays[name][k]
        problem = f"is {value.tolist()!r:.100}"
        if element_places[name].component is not None or value.ndim:
            problem += f": {error.problem}"
        _store_error(runs, k, name, problem, error.needed)


def _suspicious(scene: Scene, owner: Owner, field: NumberField, stack: Array) -> Array:
    """Find the runs whose value of an attribute the constructor of the element may refuse.

    Args:
        scene: the scene.
        owner: the attribute.
        field: declaration of the attribute, which states the allowed values.
        stack: (n, ...) values in n runs.

    Returns:
        Numbers of the runs.
    """
    own, outside = own_value(scene, owner), np.zeros(len(stack), dtype=bool)
    match field.allowed:
        case "inertia":
            return np.flatnonzero(~_realisable(stack, element_of(scene, owner).allow_unrealisable_inertia))
        case "constructor":  # the allowed values depend on other numbers: check every changed value
            return np.flatnonzero(np.any(stack != own, axis=1))
        case "direction" | "axis":
            lengths = np.max(np.abs(stack), axis=1)
            outside |= (lengths < MIN_DIRECTION_LENGTH) | (lengths > MAX_DIRECTION_LENGTH)
            # a joint chooses vectors perpendicular to its axis by the index of the axis's smallest component;
            # with another index these vectors could jump, and the constructor may refuse the axis
            if field.allowed == "axis":
                units = np.abs(stack) / np.maximum(
                    np.linalg.norm(stack, axis=1, keepdims=True), MIN_DIRECTION_LENGTH
                )
                outside |= np.argmin(units.round(6), axis=1) != np.argmin(np.abs(own).round(6))
            return np.flatnonzero(outside)
        case "nonzero":
            outside |= np.any(stack.reshape(len(stack), -1) == 0.0, axis=1)
        case "interval":
            pass
        case _:
            assert_never(field.allowed)
    for component in np.ndindex(own.shape):
        column = np.moveaxis(stack, 0, -1)[component]
        low, high = _interval(scene, owner, own, component, np.unique(column))
        outside |= (column < low) | (column > high)
    return np.flatnonzero(outside)


def _interval(
    scene: Scene, owner: Owner, own: Array, component: tuple[int, ...], values: Array
) -> tuple[float, float]:
    """Find the lowest and the highest value that the constructor accepts for a component, by bisection.

    Args:
        scene: the scene.
        owner: the attribute.
        own: the scene's own value of the attribute.
        component: index of the component.
        values: ascending values to choose from.

    Returns:
        Lowest and highest accepted value; the own value on a side without an accepted value.
    """

    def refused(value: float) -> bool:
        """Return True if the constructor refuses a value of the component."""
        changed = own.copy()
        changed[component] = value
        return refusal(scene, {owner: changed}) is not None

    def farthest(candidates: Array) -> float:
        """Return the last accepted value among values in the order of distance from the own value."""
        if len(candidates) and not refused(candidates[-1]):
            return float(candidates[-1])
        count = bisect_left(candidates, True, key=refused)
        return float(candidates[count - 1] if count else own[component])

    above = int(np.searchsorted(values, own[component]))
    return farthest(values[:above][::-1]), farthest(values[above:])


def _realisable(inertia: Array, allow_unrealisable: bool) -> Array:
    """Return (n,) True for inertias (n, 3, 3), kg m^2, that the constructor of a body certainly accepts.

    A rigid body's principal inertias a <= b <= c satisfy the triangle inequality a + b >= c. If
    `allow_unrealisable` is True, they may violate it.
    """
    scale = np.max(np.abs(inertia), axis=(1, 2))
    asymmetry = np.max(np.abs(inertia - np.swapaxes(inertia, 1, 2)), axis=(1, 2))
    usable = (scale > MIN_INERTIA) & (scale < 1.0 / MIN_INERTIA)
    a, b, c = np.linalg.eigvalsh(np.where(usable[:, None, None], inertia, np.eye(3))).T  # ascending
    positive = usable & (asymmetry == 0.0) & (a > INERTIA_MARGIN * scale) & (a > 2.0 * MIN_INERTIA)
    return np.asarray(positive & (allow_unrealisable | (a + b >= c * (1.0 + REALISABLE_TOLERANCE))))
