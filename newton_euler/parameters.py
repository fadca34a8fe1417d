"""Numbers of a scene that may change from run to run without a new compilation.

A parameter has a name, `gravity`, `BODY.mass`, `BODY.inertia`, `JOINT.stiffness`, `JOINT.damping` or
`JOINT.target` (of the control law at a joint; `JOINT.1.target` for its second coordinate), and a value
of the shape that the scene has there. Geometry is not among them: it moves the closed configurations,
so that a run would need another start. How near a configuration is to a singular one is judged by the
scene's own values: masses that are many orders away from them make runs slower, not wrong.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from newton_euler.control import Law
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.mechanism import Body
from newton_euler.scalars import Array
from newton_euler.scene import Scene

T = TypeVar("T")


def place_of(law: Law) -> str:
    """What names of a control law's parameters begin with."""
    return law.joint if law.coordinate == 0 else f"{law.joint}.{law.coordinate}"


def parameter_values(scene: Scene) -> dict[str, Array]:
    """All parameters of a scene with its own values: () or (3,) or (3, 3) floats each."""
    values: dict[str, Any] = {"gravity": scene.gravity}
    for body in scene.mechanism.bodies[1:]:
        values[f"{body.name}.mass"], values[f"{body.name}.inertia"] = body.mass, body.inertia
    for law in scene.control:
        for name in law.parameters:
            values[f"{place_of(law)}.{name}"] = getattr(law, name)
    return {name: np.asarray(value, dtype=float) for name, value in values.items()}


def checked(scene: Scene, values: Mapping[str, object]) -> dict[str, Array]:
    """Parameter values as arrays of floats.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a value that the scene itself would refuse.
    """
    own = parameter_values(scene)
    arrays = {}
    for name, value in values.items():
        if name not in own:
            raise UnknownNameError("parameter", name, tuple(own))
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
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
    return _substitute(scene, values, _altered)


def _substitute(scene: Scene, values: Mapping[str, Any], change: Callable[..., Any]) -> Scene:
    bodies, control = list(scene.mechanism.bodies), list(scene.control)
    fields: dict[str, Any] = {}
    for name, value in values.items():
        if name == "gravity":
            fields["gravity"] = value
            continue
        owner, attribute = name.rsplit(".", 1)
        if attribute in ("mass", "inertia"):
            k = scene.mechanism.body_index(owner)
            bodies[k] = change(bodies[k], **{attribute: value})
        else:
            k = next(k for k, law in enumerate(control) if owner == place_of(law))
            control[k] = change(control[k], **{attribute: value})
    mechanism = _altered(scene.mechanism, bodies=tuple(bodies))
    return _altered(scene, mechanism=mechanism, control=tuple(control), **fields)


def _altered(thing: T, **fields: Any) -> T:
    """A copy of a frozen object with other values, whatever they are."""
    changed = copy.copy(thing)
    for name, value in fields.items():
        object.__setattr__(changed, name, value)
    return changed


def _rebuilt(thing: T, **fields: Any) -> T:
    """A copy of a body or control law that has checked its new values."""
    made = replace(thing, **fields)  # type: ignore[type-var]
    if isinstance(made, Body):
        made.check()
    return made
