"""The forms of the equations of motion, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable

from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.relative import Relative
from newton_euler.errors import UnknownNameError, check_choice
from newton_euler.integrators.options import FormulationName
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree

FORMULATIONS: dict[FormulationName, Callable[[Scene, float], Formulation]] = {
    "relative": Relative,
    "cartesian": Cartesian,
}

MAX_PRODUCTS_PER_BODY = 270
"""Products in J M^-1 J^T per body, beyond which the Cartesian form takes fewer operations.

A ladder of rods and balls with 10 rungs has 234 products and, in both forms, 2,100 operations per body. With
20 rungs it has 864 products, and 5,100 operations in joint coordinates, 2,100 in the Cartesian form."""


def cheaper_formulation(mechanism: Mechanism) -> FormulationName:
    """Choose joint coordinates, unless closed loops share so many axes that the Cartesian form is cheaper.

    Two constraint rows have a product in J M^-1 J^T for each axis between the ground and the bodies of both.
    """
    tree = SpanningTree(mechanism)
    paths: dict[int, list[int]] = {0: []}
    for kept in tree.joints:
        paths[kept.child] = [*paths[kept.parent], *range(kept.v.start, kept.v.stop)]
    rows = [0] * tree.nv  # constraint rows on whose paths each velocity is
    for cut in tree.cuts:
        closure = tree.equations(cut)
        for k in {*paths[closure.first], *paths[closure.second]}:
            rows[k] += closure.count
    products = sum(count * count for count in rows) // 2
    return "cartesian" if products > MAX_PRODUCTS_PER_BODY * len(mechanism.bodies) else "relative"


def check_formulation(formulation: str | None) -> None:
    """Raise `UnknownNameError` for what is neither one of the `FORMULATIONS` nor None, the cheaper one."""
    if formulation is not None:
        check_choice("formulation", formulation, FORMULATIONS)


def formulate(scene: Scene, formulation: str, alpha: float = 0.0) -> Formulation:
    """Return the equations of motion of a scene in one of the `FORMULATIONS`; alpha is Baumgarte's, 1/s."""
    if formulation not in FORMULATIONS:
        raise UnknownNameError("formulation", formulation, tuple(FORMULATIONS))
    return FORMULATIONS[formulation](scene, alpha)
