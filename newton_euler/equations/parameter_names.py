"""Names of parameters, and where in a scene the numbers of each parameter are.

Parameters are numbers of a scene that may vary from run to run without a new compilation;
`newton_euler.equations.parameters` describes their names and reads and changes their values.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from newton_euler.errors import MAX_PROPOSED_NAMES, MechanismError, UnknownNameError, nearest
from newton_euler.model.fields import NumberField
from newton_euler.model.motions import TimeFunction, piece_numbers, terms
from newton_euler.model.scene import Scene
from newton_euler.model.variable import functions_of
from newton_euler.scalars import Array

PIECE = ".piece"
"""Suffix of the name of a parameter that holds the polynomial of a function of time between two knots."""


Owner = tuple[str, int, str]
"""The attribute that owns the numbers of a parameter, such as ("bodies", 2, "mass").

The tuple is (field of the scene or mechanism, number of the element in this field, name of the attribute)."""

MECHANICAL = ("bodies", "joints", "couplings")
"""Fields with elements that belong to the mechanism; the other fields belong to the scene."""

GRAVITY: Owner = ("scene", 0, "gravity")
"""The attribute with the gravity of a scene."""


class Place(NamedTuple):
    """Location of the numbers of a parameter in a scene.

    Attributes:
        owner: the attribute with these numbers.
        component: index of one number in the attribute's value; None if the parameter is the whole value.
        field: declaration of the attribute: unit, shape, bounds, and what a change affects.
    """

    owner: Owner
    component: tuple[int, ...] | None
    field: NumberField


def elements_by_field(scene: Scene) -> dict[str, list[Any]]:
    """Return all elements that may have parameters, by the field of the scene or mechanism.

    The scene itself is the only element of the field "scene".
    """
    return {
        "scene": [scene],
        "bodies": list(scene.mechanism.bodies),
        "joints": list(scene.mechanism.joints),
        "couplings": list(scene.mechanism.couplings),
        "control": list(scene.control),
        "forces": list(scene.forces),
        "armatures": list(scene.armatures),
        "motions": list(scene.motions),
    }


@lru_cache(maxsize=8)  # the most recently used scenes
def _owners(scene: Scene) -> dict[str, list[Owner]]:
    """List, by parameter name without component, the attributes that the name stands for.

    Each attribute has a plain name, such as `crank.mass`, and a unique numbered name, such as
    `bodies[2].mass`. A plain name may stand for several attributes.
    """
    found: dict[str, list[Owner]] = {"gravity": [GRAVITY]}
    for what, elements in elements_by_field(scene).items():
        for k, element in enumerate(elements):
            if what == "scene" or (what == "bodies" and k == 0):
                continue  # the ground has no parameters
            for attribute in element.variables:
                found.setdefault(f"{_name_prefix(what, element)}.{attribute}", []).append(
                    (what, k, attribute)
                )
                found[numbered(what, k, attribute)] = [(what, k, attribute)]
    # attributes (keys of `scene.functions`) whose functions of time have knots; `piece_size` is the count of
    # numbers of a piece, 0 without knots
    with_pieces = (
        owner for owner, functions in scene.functions.items() if any(f.piece_size for f in functions)
    )
    return found | {numbered(*owner) + PIECE: [owner] for owner in with_pieces}


def numbered(what: str, k: int, attribute: str) -> str:
    """Return the unique numbered name of a parameter, such as `bodies[2].mass`.

    Names of elements have no brackets, so that a numbered name is never a plain name.
    """
    return f"{what}[{k}].{attribute}"


def unambiguous(scene: Scene, name: str) -> str:
    """Return the name of a parameter that remains unique if elements are appended to the scene.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a name that stands for two parameters.
    """
    (place,) = places(scene, [name]).values()
    base, _ = _split_name(elements_by_field(scene), _owners(scene), name)
    return name if place.owner == GRAVITY else numbered(*place.owner) + name[len(base) :]


def places(scene: Scene, names: Iterable[str]) -> dict[str, Place]:
    """Find where the numbers of parameters are in a scene, by name.

    Raises:
        UnknownNameError: for a name that is no parameter of the scene.
        MechanismError: for a name that stands for two parameters, and for two names of the same number.
    """
    elements, owners = elements_by_field(scene), _owners(scene)
    found: dict[str, Place] = {}
    named: dict[Owner, list[tuple[int, ...] | None]] = {}  # components that have been named
    for name in names:
        base, component = _split_name(elements, owners, name)
        if len(owners[base]) > 1:
            needed = " or ".join(numbered(*owner) for owner in owners[base])
            raise MechanismError(f"parameter {name!r}", "stands for two values", needed)
        what, k, attribute = owners[base][0]
        field = elements[what][k].field_of(attribute)
        found[name] = place = Place(owners[base][0], component, field)
        if name.endswith(PIECE):
            continue  # samples of the same function may be parameters as well
        others = named.setdefault(place.owner, [])
        if others and (component is None or None in others or component in others):
            raise MechanismError(f"parameter {name!r}", "has another value by another name", "one of them")
        others.append(component)
    return found


def _split_name(
    elements: dict[str, list[Any]], owners: dict[str, list[Owner]], name: str
) -> tuple[str, tuple[int, ...] | None]:
    """Split a parameter name into the name of the whole parameter and the index of the component.

    Args:
        elements: elements of the scene by field, see `elements_by_field`.
        owners: attributes by parameter name, see `_owners`.
        name: the parameter name, such as `gravity.z`.

    Returns:
        Name of the whole parameter; index of the component, None for the whole value.

    Raises:
        UnknownNameError: for a name that is no parameter.
        MechanismError: for the name of a number that cannot vary.
    """
    if name in owners:
        return name, None
    # a component has one or two parts at the end of the name: .z, .xy, .0 or .1.0
    for dots in (1, 2) if isinstance(name, str) else ():
        base, *ending = name.rsplit(".", dots)
        if base in owners:
            shape = attribute_value(elements, owners[base][0]).shape
            component = _component_index(shape, ending)
            if component is not None:
                return base, component
    _check_constant(elements, name)
    near = _names_of_numbers(elements, owners, name) or _similar_names(owners, name)
    raise UnknownNameError("parameter", name, near, proposed=True)


def _check_constant(elements: dict[str, list[Any]], name: str) -> None:
    """Raise `MechanismError`, with the reason, for the name of a number that cannot vary between runs."""
    for what, of_field in elements.items():
        for k, element in enumerate(of_field):
            prefixes = (f"{_name_prefix(what, element)}.", numbered(what, k, ""))
            for attribute, reason in element.constants.items():
                if name in {(prefix if what != "scene" else "") + attribute for prefix in prefixes}:
                    needed = "a number that may vary from run to run"
                    raise MechanismError(f"parameter {name!r}", f"is {reason}", needed)


def _name_prefix(what: str, element: Any) -> str:
    """Return the beginning of an element's parameter names, such as the name of a body or `hinge.spring`."""
    return element.name if what in ("scene", *MECHANICAL) else element.prefix


def _component_index(shape: tuple[int, ...], ending: list[str]) -> tuple[int, ...] | None:
    """Convert the ending of a parameter name to an index.

    Args:
        shape: shape of the attribute's value.
        ending: last parts of the name, such as ["z"], ["xy"] or ["1", "0"].

    Returns:
        The index; None if the ending is no component of such a value.
    """
    letters = ending[0] if len(ending) == 1 else ""
    if set(shape) == {3} and len(letters) == len(shape) and set(letters) <= set("xyz"):
        return tuple(sorted("xyz".index(letter) for letter in letters))  # matrices are symmetric
    if shape and len(ending) == len(shape) and all(text.isdecimal() for text in ending):
        component = tuple(map(int, ending))
        return component if all(k < n for k, n in zip(component, shape, strict=True)) else None
    return None


def _names_of_numbers(
    elements: dict[str, list[Any]], owners: dict[str, list[Owner]], name: object
) -> tuple[str, ...]:
    """Return the valid names for a misnamed number of a function of time.

    An example is `pivot.target.amplitude`, whose valid name is `pivot.target.0`; empty for other names.
    """
    base, _, wanted = str(name).rpartition(".")
    found = list[str]()
    for what, k, attribute in owners.get(base, ()):
        function = getattr(elements[what][k], attribute, None)
        index = 0
        for term in terms(function) if isinstance(function, TimeFunction) else ():
            for field in term.parts[""]:  # fields with the numbers in which the term is linear, in order
                count = np.size(getattr(term, field))
                found += [f"{base}.{index + i}" for i in range(count) if field == wanted]
                index += count
    return tuple(found[:MAX_PROPOSED_NAMES])


def _similar_names(owners: dict[str, list[Owner]], name: object) -> tuple[str, ...]:
    """Return the parameter names that are most similar to an unknown name.

    If the name begins with the name of an element, only parameters of this element are compared.
    """
    element, _, _ = str(name).partition(".")
    of_element = [each for each in owners if each.startswith(f"{element}.")]
    known = of_element or [each for each in owners if "[" not in each]  # without numbered names
    return nearest(name, known)


def attribute_value(elements: dict[str, list[Any]], owner: Owner, piece: bool = False) -> Array:
    """Return the value that an attribute has in the scene, as an array of floats.

    The value of a function of time is the vector of its numbers; with `piece`, the numbers of its polynomial
    piece at time 0.
    """
    what, k, attribute = owner
    if piece:
        return piece_numbers(functions_of(getattr(elements[what][k], attribute)), 0.0)
    return elements[what][k].number(attribute)


def parameter_names(scene: Scene) -> list[str]:
    """Return the names of all parameters of a scene; parameters that share a name have numbered names.

    Forces held by sampled controllers are not listed, because the controllers set them during a run.
    """
    names: list[str] = []
    for name, owners in _owners(scene).items():
        if "[" not in name and owners[0][-1] != "held":
            names += [name] if len(owners) == 1 else [numbered(*owner) for owner in owners]
    return names


def element_of(scene: Scene, owner: Owner) -> Any:
    """Return the element with an attribute, such as the body whose mass it is."""
    what, k, _ = owner
    return elements_by_field(scene)[what][k]
