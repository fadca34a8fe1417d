"""Parameters: numbers of a scene that may vary from run to run without a new compilation.

`crosscheck list SCENE` lists the parameters of a scene with units and values; in Python
`newton_euler.equations.parameters.parameter_values` returns the values. Each parameter has a name, and a
value of the same shape as in the scene:

- `gravity`, `BODY.mass`, `BODY.inertia` about the center of mass, in the body's frame;
- `BODY.center_of_mass`, in the world at the initial pose: the center moves in the body, and joint points stay
  where they are on the body; `BODY.quaternion` (w, x, y, z) of the body's frame at the initial pose, of any
  length: the inertia turns with the frame;
- `JOINT.point`, a displacement of the joint on both bodies, in the world at the initial pose, m;
  `JOINT.point_on_first` and `JOINT.point_on_second` displace the point on one body alone, such as a hole that
  is not where the drawing has the hole. Displacements add up, and the scene's own value is 0;
- `JOINT.axis`, `JOINT.axis_on_first`, `JOINT.axis_on_second`, of any length, in the world at the initial
  pose; `JOINT.1.axis` of a compound joint's second coordinate;
- `JOINT.pitch` of a screw, `JOINT.length` of a rod, whose points stay on their bodies, `JOINT.offsets`
  between the hinges of a compound joint, `JOINT.offset` between parallel hinges. With other offsets a joint
  stays closed at the initial pose;
- `GEAR.ratio`, `COUPLING.terms`, the factors of a coupling's terms in their order, and
  `COUPLING.coefficients` of a polynomial coupling, for the powers 1, 2, ...;
- `JOINT.motion.function` of a prescribed motion;
- `JOINT.stiffness`, `JOINT.damping`, `JOINT.target`, `JOINT.feedforward` of the control law at a joint,
  `JOINT.1.target` for the joint's second coordinate;
- `JOINT.gains` of the state feedback at a joint: (K_p, K_d) of each coordinate that the law reads, in their
  order, and `JOINT.targets` of other coordinates, one after the other;
- `JOINT.period`, `JOINT.resolution`, `JOINT.force_limit`, `JOINT.slew_limit` and `JOINT.stroke` of a digital
  law, in addition to the parameters of the law that the computer executes;
- `JOINT.spring.stiffness`, `JOINT.spring.damping`, `JOINT.spring.rest` of the spring at a joint,
  `JOINT.1.spring.rest` for the joint's second coordinate;
- `JOINT.friction.coulomb`, `JOINT.friction.stribeck`, `JOINT.friction.stribeck_speed`,
  `JOINT.friction.transition_speed` and `JOINT.friction.load_coefficient` of the dry friction at a joint;
- `JOINT.low_stop.limit`, `JOINT.low_stop.stiffness` and `JOINT.low_stop.dissipation` of the stop at the low
  end of a joint coordinate; high_stop in place of low_stop for the other end;
- `NAME.ratio`, `NAME.stiffness`, `NAME.play`, `NAME.dissipation`, `NAME.forward_efficiency`,
  `NAME.backward_efficiency`, `NAME.transition_speed` and `NAME.rest` of an elastic gear;
- `JOINT.ball.stiffness`, `JOINT.ball.damping`, `JOINT.ball.rest` of the spring of a joint's ball;
- `NAME.stiffness`, `NAME.damping`, `NAME.rest_length` of a spring between points, and displacements
  `NAME.point_on_first`, `NAME.point_on_second` of the two points;
- `NAME.force`, `NAME.torque` of a wrench, and `NAME.point`, a displacement;
- `NAME.direction`, `NAME.speed`, `NAME.vertical_speed`, `NAME.air_density` of a wind load,
  `NAME.first_side` and `NAME.second_side` of the plate, and `NAME.point`, a displacement;
- `JOINT.rotor.inertia`, `JOINT.1.rotor.inertia`, `JOINT.ball.rotor.inertia` of the armatures of a joint.

If an attribute is a function of time, the parameter's value is all numbers in which the function is
linear, one after the other: coefficients of polynomials, amplitude and offset of sines, values of splines
and steps at their knots (breakpoints). Names such as `JOINT.target.angular_frequency` and
`NAME.speed.phase` are the frequencies and phases of the sines; the value is a number if there is one sine.
Sample times, indices, counts, shapes of bodies, settings of a run and a controller's model of the mechanism
do not vary: their names are refused with the reason.

In batches, sweeps, sensitivities and fits, a joint keeps the zero of its coordinates. At the zero, the
relative orientation of its two bodies and the vector between its two points are those of the scene's initial
pose. In contrast, `newton_euler.with_parameters` with `point_on_first`, `point_on_second` or
`length` returns a scene with another initial pose, at which joint coordinates are zero.

Parameters of bodies' centers and frames, joints, couplings and motions change the configurations in which
loops are closed. A start is therefore assembled for each run; initial joint coordinates
(`newton_euler.runs.initial_coordinates`) are additional parameters. All runs use the independent constraints
that are chosen at the scene's own values, and omit the redundant ones. At other values, a loop may violate
omitted constraints, and move although all constraints together would lock the loop.

A name may end in one component of the value, which is then a number: `gravity.z`, `BODY.inertia.xy` (the same
as `yx`), `JOINT.point.z`; other values are indexed from 0, as in `JOINT.target.0` and `JOINT.gains.1.0`.

A name that stands for two parameters is rejected. Numbered names distinguish them: `bodies[2].mass`,
`joints[3].point`, `couplings[0].ratio`, `control[0].target`, `forces[1].stiffness`, `armatures[0].inertia`
and `motions[0].function`. Masses that differ from the scene's by orders of magnitude make runs slower, not
wrong.
"""

# Classes of elements declare the numbers that vary (`newton_euler.model.fields`). Compiled code has two more
# kinds of parameters: `JOINT.held`, the force that a sampled controller holds, and the polynomial piece of a
# function of time between two of its knots, such as `motions[0].function.piece`. The reference magnitudes
# that detect singular configurations (`newton_euler.equations.sparse`) are those of the scene's own values.

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from newton_euler.equations.parameter_names import (
    MECHANICAL,
    PIECE,
    Owner,
    Place,
    attribute_value,
    element_of,
    elements_by_field,
    numbered,
    parameter_names,
    places,
)
from newton_euler.equations.redundancy import inherit_mobility
from newton_euler.errors import MechanismError
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Law
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import on_piece, piece_numbers, terms
from newton_euler.model.scene import Scene
from newton_euler.model.variable import altered
from newton_euler.scalars import NUMBERS, Array


def check_dynamic(scene: Scene, names: Iterable[str], where: str) -> None:
    """Check that parameters do not change the closed configurations of a scene.

    Args:
        scene: the scene.
        names: names of parameters.
        where: beginning of the error message.

    Raises:
        MechanismError: for a parameter of geometry, couplings or prescribed motions.
    """
    for name, place in places(scene, names).items():
        if place.field.moves_loops:  # a change moves the configurations in which loops are closed
            needed = "one that leaves the closed configurations where they are"
            raise MechanismError(where, f"has the parameter {name!r}", needed)


def pieces(scene: Scene, time: float, include_smooth: bool = True) -> dict[str, Array]:
    """Return the polynomial piece around a time of each function of time with knots, by parameter name.

    Args:
        scene: the scene with the functions.
        time: s; a piece is valid between the two knots around this time.
        include_smooth: False to leave out functions without jumps (splines).

    Returns:
        Numbers of each piece: its start, s, then coefficients in ascending powers of the time since the
        start.
    """
    found = {}
    for owner, functions in scene.functions.items():
        if any(f.piece_size and (include_smooth or f.jumps) for f in functions):
            found[numbered(*owner) + PIECE] = piece_numbers(functions, time)
    return found


def pieces_along(
    scene_at: Callable[[Array], Scene], x: Array, directions: Array, time: float
) -> dict[str, Array]:
    """Compute the directional derivatives of `pieces`, which depend linearly on the parameters.

    Args:
        scene_at: returns the scene with the parameter values of a vector x (inputs,).
        x: (inputs,) the parameter values.
        directions: (inputs, p) directions in the space of x.
        time: s.

    Returns:
        (k, p) for each piece of k numbers, by parameter name.
    """
    # the difference for a whole direction is exact, because pieces are linear
    at_x = pieces(scene_at(x), time)
    moved = [pieces(scene_at(x + direction), time) for direction in directions.T]
    return {name: np.array([each[name] - piece for each in moved]).T for name, piece in at_x.items()}


def parameter_values(scene: Scene, names: Iterable[str] | None = None) -> dict[str, Array]:
    """Return the scene's own values of parameters, by name.

    Args:
        scene: the scene.
        names: names of parameters; all parameters if None.

    Returns:
        Arrays of floats, of shape (), (3,), (3, 3) or another shape of the attribute.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a name that stands for two parameters, and for two names of the same number.
    """
    return values_at(scene, places(scene, parameter_names(scene) if names is None else names))


def values_at(scene: Scene, found: Mapping[str, Place]) -> dict[str, Array]:
    """Return the scene's own values of parameters at known places, by name; see `parameter_values`.

    Args:
        scene: the scene.
        found: places of the parameters by name, in this scene or in one that differs only in parameters.
    """
    elements = elements_by_field(scene)
    values: dict[str, Array] = {}
    for name, place in found.items():
        whole = attribute_value(elements, place.owner, piece=name.endswith(PIECE))
        values[name] = whole if place.component is None else np.asarray(whole[place.component])
    return values


def origins(scene: Scene, names: Iterable[str]) -> dict[str, Array]:
    """Return the points from which displacement parameters are measured, by name.

    Names of other parameters are ignored.

    Returns:
        (3,) in the world frame at the initial pose, m; () for one component.
    """
    found: dict[str, Array] = {}
    for name, (owner, component, field) in places(scene, names).items():
        what, _, attribute = owner
        if not field.displaces:  # the parameter is no displacement of a point
            continue
        # a joint has no attribute `point_on_first`: its `point` is the point on the first body
        of_joint = what == "joints" and attribute == "point_on_first"
        point = np.asarray(getattr(element_of(scene, owner), "point" if of_joint else attribute), dtype=float)
        found[name] = point if component is None else np.asarray(point[component])
    return found


def parameter_layout(scene: Scene, names: Iterable[str]) -> tuple[tuple[object, ...], ...]:
    """Describe parameters without their values: compiled code with these inputs depends on this alone.

    Returns:
        For each parameter: name, shape and, for a function of time, the count of numbers of each term.
    """
    names, functions = list(names), scene.functions
    values, found = parameter_values(scene, names), []
    for name, (owner, *_) in places(scene, names).items():
        # pieces need no counts, because all pieces of a function have the same size
        of_owner = () if name.endswith(PIECE) else functions.get(owner, ())
        # part "" of a term: the numbers in which the term is linear
        counts = tuple(len(term.part("")) for function in of_owner for term in terms(function))
        found.append((name, values[name].shape, counts))
    return tuple(found)


def checked(scene: Scene, values: Mapping[str, object]) -> dict[str, Array]:
    """Check values of parameters and convert them to arrays of floats, by name.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a name that stands for two parameters, and for an invalid value.
    """
    present = parameter_values(scene, values)
    arrays = {}
    for name, value in values.items():
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            array = np.full(1, np.nan)  # refused below
        if array.shape != present[name].shape or not np.all(np.isfinite(array)):
            needed = f"finite numbers of shape {present[name].shape}"
            raise MechanismError(f"parameter {name!r}", f"is {value!r:.200}", needed)
        arrays[name] = array
    _substituted(scene, arrays, places(scene, arrays), check=True)
    return arrays


def own_value(scene: Scene, owner: Owner) -> Array:
    """Return the value that an attribute has in the scene, as an array of floats."""
    return attribute_value(elements_by_field(scene), owner)


def refusal(scene: Scene, values: Mapping[Owner, Array]) -> MechanismError | None:
    """Return the error that new values of attributes of one element raise; None for valid values."""
    try:
        element = element_of(scene, next(iter(values)))
        element.rebuilt({attribute: value for (_, _, attribute), value in values.items()})
    except MechanismError as error:
        return error
    return None


def rebuilt(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """Construct a scene with other values of some parameters, by name, with all checks."""
    elements = _substituted(scene, values, places(scene, values), check=True)
    (changed,) = elements.pop("scene")
    mechanism = Mechanism(*(elements.pop(field) for field in MECHANICAL))
    return replace(changed, mechanism=mechanism, **{what: tuple(each) for what, each in elements.items()})


def with_values(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """Copy a scene with other values of some parameters, by name, without checks.

    The values may be symbolic scalars, when the equations of the scene are traced for compilation.
    """
    elements = _substituted(scene, values, places(scene, values), check=False)
    (changed,) = elements.pop("scene")
    size = scene.mechanism.size  # the size of the given scene makes residuals dimensionless
    mechanical = {field: tuple(elements.pop(field)) for field in MECHANICAL}
    mechanism = altered(scene.mechanism, size=size, **mechanical)
    changed = altered(changed, mechanism=mechanism, **{what: tuple(each) for what, each in elements.items()})
    inherit_mobility(changed, scene)  # the copy has the same redundant constraints
    return changed


def with_laws(scene: Scene, laws: Iterable[Law]) -> Scene:
    """Copy a scene with other control laws and without outputs, not checked; for equations of motion only."""
    changed = altered(scene, control=tuple(laws), outputs=frozenset())
    inherit_mobility(changed, scene)  # the copy has the same redundant constraints
    return changed


def measuring(scene: Scene, keys: Iterable[Key]) -> Scene:
    """Copy a scene so that its equations measure joint coordinates and allow forces on them.

    The copy has a control law of zero force on each of the coordinates, and no other control laws.

    Args:
        scene: the scene.
        keys: joint coordinates (joint, number).
    """
    laws = (
        PD(joint, stiffness=0.0, damping=0.0, target=0.0, coordinate=k) for joint, k in dict.fromkeys(keys)
    )
    return with_laws(scene, laws)


def _substituted(
    scene: Scene, values: Mapping[str, Any], places: Mapping[str, Place], check: bool
) -> dict[str, list[Any]]:
    """Return the elements of `elements_by_field` with other values of parameters.

    Args:
        scene: the scene.
        values: new values by parameter name.
        places: where these parameters are in the scene, by name.
        check: True to construct changed elements with all checks, False to copy them without checks.
    """
    # whole attributes and their components
    elements = elements_by_field(scene)
    changes: dict[tuple[str, int], dict[str, Any]] = {}
    for (what, k, attribute), value in _assigned(elements, values, places).items():
        changes.setdefault((what, k), {})[attribute] = value
    for (what, k), attributes in changes.items():
        element = elements[what][k]
        elements[what][k] = element.rebuilt(attributes) if check else element.varied(attributes)
    # polynomial pieces replace functions of time
    for name in values:
        if name.endswith(PIECE):
            what, k, attribute = places[name].owner
            value = on_piece(getattr(elements[what][k], attribute), list(values[name]))
            elements[what][k] = altered(elements[what][k], **{attribute: value})
    return elements


def _assigned(
    elements: dict[str, list[Any]], values: Mapping[str, Any], places: Mapping[str, Place]
) -> dict[Owner, Any]:
    """Return the new value of each changed attribute, without polynomial pieces of functions.

    New components replace components of the value that the attribute has in the scene.
    """
    found: dict[Owner, Any] = {}
    for name, (owner, component, _) in places.items():
        if name.endswith(PIECE):
            continue
        if component is None:
            found[owner] = values[name]
            continue
        if owner not in found:
            found[owner] = np.array(attribute_value(elements, owner).tolist(), dtype=object)
        found[owner][component] = _number(values[name])
        if found[owner].shape == (3, 3):  # an inertia is symmetric
            found[owner][component[::-1]] = found[owner][component]
    return {owner: _as_floats(value) for owner, value in found.items()}


def _as_floats(value: Any) -> Any:
    """Convert an array of plain numbers to floats; return any other value unchanged."""
    is_plain = isinstance(value, np.ndarray) and all(isinstance(x, NUMBERS) for x in value.flat)
    return np.asarray(value, dtype=float) if is_plain else value


def _number(value: Any) -> Any:
    """Convert an array () of floats to a float; return any other value unchanged."""
    return float(value) if isinstance(value, np.ndarray) else value
