"""Numbers of a scene that may change from run to run without a new compilation.

A parameter has a name and a value of the shape that the scene has there:

- `gravity`, `BODY.mass`, `BODY.inertia`;
- `JOINT.stiffness`, `JOINT.damping`, `JOINT.target`, `JOINT.feedforward` of the control law at a joint,
  `JOINT.1.target` for its second coordinate; of a target or a feedforward that is a function of time, all
  that it is linear in: coefficients of polynomials, amplitude and offset of sines, values of splines and
  steps, one after the other;
- `JOINT.gains` of the state feedback at a joint, (K_p, K_d) of each coordinate that it reads, in their order;
- `JOINT.spring.stiffness`, `JOINT.spring.damping`, `JOINT.spring.rest` of the spring at a joint,
  `JOINT.1.spring.rest` for its second coordinate;
- `JOINT.ball.stiffness`, `JOINT.ball.damping`, `JOINT.ball.rest` of the spring of a joint's ball;
- `NAME.stiffness`, `NAME.damping`, `NAME.rest_length` of a spring between points;
- `NAME.force`, `NAME.torque` of a wrench;
- `NAME.direction`, `NAME.speed`, `NAME.air_density` of a wind load;
- `JOINT.rotor.inertia`, `JOINT.1.rotor.inertia`, `JOINT.ball.rotor.inertia` of the armatures of a joint.

A name that stands for two of these cannot be used; numbers say which is meant, as in `bodies[2].mass`,
`control[0].target`, `forces[1].stiffness` and `armatures[0].inertia`. Geometry is not among them: it moves
the closed configurations, so that a run would need another start. How near a configuration is to a singular
one is judged by the scene's own values: masses that are many orders away from them make runs slower, not
wrong.

Functions of time with knots are parameters of the code that runs from one knot to the next: the numbers of
the piece between them are, as `motions[0].function.piece`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from newton_euler.equations.redundancy import inherit_mobility
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.model.digital_control import Law
from newton_euler.model.mechanism import Body
from newton_euler.model.motions import Piecewise, Sine, Sum, TimeFunction, functions_of
from newton_euler.model.scene import Scene
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

T = TypeVar("T")

PIECE = ".piece"
"""Suffix of names of what a function with knots is between two of them."""


Owner = tuple[str, int, str]
"""Where a parameter is: "bodies", "control", "forces", "armatures" or "motions", which of them, and the
attribute."""


def _parts(scene: Scene) -> dict[str, list[Any]]:
    """Yield what has parameters."""
    return {
        "bodies": list(scene.mechanism.bodies),
        "control": list(scene.control),
        "forces": list(scene.forces),
        "armatures": list(scene.armatures),
        "motions": list(scene.motions),
    }


def _owners(scene: Scene) -> dict[str, list[Owner]]:
    """Find what a name stands for; all but gravity."""
    found: dict[str, list[Owner]] = {}
    for what, elements in _parts(scene).items():
        for k, element in enumerate(elements):
            if what == "motions" or (what == "bodies" and k == 0):
                continue  # motions have none, and nor has the ground
            place = element.name if what == "bodies" else element.prefix
            for attribute in ("mass", "inertia") if what == "bodies" else element.parameters or ("held",):
                found.setdefault(f"{place}.{attribute}", []).append((what, k, attribute))
                found[numbered(what, k, attribute)] = [(what, k, attribute)]
    with_pieces = (owner for owner, functions in scene.functions.items() if any(f.numbers for f in functions))
    return found | {numbered(*owner) + PIECE: [owner] for owner in with_pieces}


def pieces(scene: Scene, time: float, smooth: bool = True) -> dict[str, Array]:
    """Return the numbers of functions with knots between those around a time in s, by name.

    Without smooth ones only those of attributes that have functions which jump.
    """
    found = {}
    for owner, functions in scene.functions.items():
        if any(f.numbers and (smooth or f.jumps) for f in functions):
            found[numbered(*owner) + PIECE] = _piece(functions, time)
    return found


def _piece(functions: Iterable[TimeFunction], time: float) -> Array:
    return np.array([number for function in functions for number in function.piece(time)])


def _on_piece(value: Any, numbers: list[Any]) -> Any:
    """Return a function, or a mapping with functions, with what they are where they have these numbers."""
    if isinstance(value, TimeFunction):
        return value.on_piece(numbers)
    changed = dict(value)
    for key, each in value.items():
        if isinstance(each, TimeFunction):
            changed[key] = each.on_piece(numbers[: each.numbers])
            numbers = numbers[each.numbers :]
    return changed


def numbered(what: str, k: int, attribute: str) -> str:
    """The name of a parameter that no other one can have: brackets are in no element's name."""
    return f"{what}[{k}].{attribute}"


def unambiguous(scene: Scene, name: str) -> str:
    """Return the name of a parameter that stays its own if more elements are added behind the others.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a name that stands for two.
    """
    return name if name == "gravity" else numbered(*_owner(_owners(scene), name))


def _owner(owners: dict[str, list[Owner]], name: str) -> Owner:
    """Find a parameter; raises `UnknownNameError`, or `MechanismError` if the name stands for two."""
    if name not in owners:
        raise UnknownNameError("parameter", name, ("gravity", *_named(owners)))
    if len(owners[name]) > 1:
        needed = " or ".join(numbered(*owner) for owner in owners[name])
        raise MechanismError(f"parameter {name!r}", "stands for two values", needed)
    return owners[name][0]


def _named(owners: dict[str, list[Owner]]) -> list[str]:
    """The names without those that are numbers."""
    return [name for name in owners if "[" not in name]


def parameter_values(scene: Scene, names: Iterable[str] | None = None) -> dict[str, Array]:
    """The scene's own values of these or of all of its parameters: () or (3,) or (3, 3) floats each.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a name that stands for two.
    """
    parts, owners = _parts(scene), _owners(scene)
    values: dict[str, Array] = {}
    for name in ("gravity", *_named(owners)) if names is None else names:
        if name == "gravity":
            value: Any = scene.gravity
        else:
            what, k, attribute = _owner(owners, name)
            value = getattr(parts[what][k], attribute)
            if name.endswith(PIECE):
                value = _piece(functions_of(value), 0.0)
            elif isinstance(value, TimeFunction):
                value = _linear(value)
            elif isinstance(value, Mapping):
                value = list(value.values())
        values[name] = np.asarray(value, dtype=float)
    return values


def checked(scene: Scene, values: Mapping[str, object]) -> dict[str, Array]:
    """Parameter values as arrays of floats.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a name that stands for two, and for a value that the scene itself would refuse.
    """
    own = parameter_values(scene, values)
    arrays = {}
    for name, value in values.items():
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            array = np.full(1, np.nan)
        if array.shape != own[name].shape or not np.all(np.isfinite(array)):
            needed = f"finite numbers of shape {own[name].shape}"
            raise MechanismError(f"parameter {name!r}", f"is {value!r:.200}", needed)
        arrays[name] = array
    _substitute(
        scene, {name: array if array.ndim else float(array) for name, array in arrays.items()}, _rebuilt
    )
    return arrays


def with_values(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene with other values of some parameters, scalars of any kind, which are not checked."""
    changed = _substitute(scene, values, _altered)
    inherit_mobility(changed, scene)
    return changed


def with_laws(scene: Scene, laws: Iterable[Law]) -> Scene:
    """The scene with other control laws, which are not checked, for equations alone: nothing is output."""
    changed = _altered(scene, control=tuple(laws), outputs=frozenset())
    vars(changed).pop("joint_forces", None)  # kept of the laws that have changed
    inherit_mobility(changed, scene)
    return changed


def without_wind(scene: Scene) -> Scene:
    """The scene without its wind, for equations alone."""
    calm = tuple(force for force in scene.forces if not isinstance(force, WindLoad))
    if len(calm) == len(scene.forces):
        return scene
    changed = _altered(scene, forces=calm)
    inherit_mobility(changed, scene)
    return changed


def _substitute(scene: Scene, values: Mapping[str, Any], change: Callable[..., Any]) -> Scene:
    parts, owners = _parts(scene), _owners(scene)
    fields: dict[str, Any] = {}
    for name, value in sorted(values.items(), key=lambda item: item[0].endswith(PIECE)):
        if name == "gravity":
            fields["gravity"] = value
        else:
            what, k, attribute = _owner(owners, name)
            own = getattr(parts[what][k], attribute)
            if name.endswith(PIECE):
                value = _on_piece(own, list(value))
            elif isinstance(own, TimeFunction):
                value = _with_linear(own, list(value), change)
            elif isinstance(own, Mapping):
                value = dict(zip(own, value, strict=True))
            parts[what][k] = change(parts[what][k], **{attribute: value})
    mechanism = _altered(scene.mechanism, bodies=tuple(parts.pop("bodies")))
    for what, elements in parts.items():
        fields[what] = tuple(elements)
    changed = _altered(scene, mechanism=mechanism, **fields)
    vars(changed).pop("joint_forces", None)  # kept of the elements that have changed
    return changed


def _linear(function: TimeFunction) -> list[float]:
    """Return what a function of time is linear in."""
    if isinstance(function, Sum):
        return [value for term in function.terms for value in _linear(term)]
    if isinstance(function, Sine):
        return [function.amplitude, function.offset]
    return list(function.values if isinstance(function, Piecewise) else function.coefficients)


def _with_linear(function: TimeFunction, values: list[Any], change: Callable[..., Any]) -> TimeFunction:
    """The function with other values of what it is linear in."""
    if isinstance(function, Sum):
        terms: list[TimeFunction] = []
        for term in function.terms:
            count = len(_linear(term))
            terms.append(_with_linear(term, values[:count], change))
            values = values[count:]
        return change(function, terms=tuple(terms))
    if isinstance(function, Sine):
        return change(function, amplitude=values[0], offset=values[1])
    if isinstance(function, Piecewise):
        changed = change(function, values=np.array(values))
        vars(changed).pop("_pieces", None)  # of the samples that have changed
        return changed
    return change(function, coefficients=tuple(values))


def _altered(thing: T, **fields: Any) -> T:
    """A copy of a frozen object with other values, whatever they are."""
    changed = copy.copy(thing)
    for name, value in fields.items():
        object.__setattr__(changed, name, value)
    return changed


def _rebuilt(thing: T, **fields: Any) -> T:
    """A copy of a body, control law or force that has checked its new values."""
    made = replace(thing, **fields)  # type: ignore[type-var]
    if isinstance(made, Body):
        made.check()
    return made
