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

PRODUCTS_PER_BODY = 270
"""Of `SpanningTree.products`, at which runs take as long in either form: those of a chain of 40, which has
57,000 operations in joint coordinates and 66,000 in the Cartesian form, but a fifth more steps."""


def cheaper_formulation(mechanism: Mechanism) -> str:
    """Choose the form of the equations whose code is made sooner: "relative", except along long paths."""
    tree = SpanningTree(mechanism)
    return "cartesian" if tree.products > PRODUCTS_PER_BODY * len(mechanism.bodies) else "relative"


def check_formulation(formulation: str | None) -> None:
    """Raise `UnknownNameError` for what is neither one of the `FORMULATIONS` nor None, the cheaper one."""
    if formulation is not None:
        check_choice("formulation", formulation, FORMULATIONS)


def formulate(scene: Scene, formulation: str, alpha: float = 0.0) -> Formulation:
    """Return the equations of motion of a scene in one of the `FORMULATIONS`; alpha is Baumgarte's, 1/s."""
    if formulation not in FORMULATIONS:
        raise UnknownNameError("formulation", formulation, tuple(FORMULATIONS))
    return FORMULATIONS[formulation](scene, alpha)
