"""Choice between the two forms of the equations of motion: joint coordinates or Cartesian coordinates.

"relative" uses joint coordinates of a spanning tree and closes loops by constraints. "cartesian" uses the
poses of all bodies, with constraints for every joint.
"""

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
"""Classes of the equations of motion by name; each takes a scene and Baumgarte's parameter (1/s)."""

MAX_PRODUCTS_PER_BODY = 270
"""Number of products in J M^-1 J^T per body, ground included, above which the Cartesian form is cheaper.

J is the constraint Jacobian, M the mass matrix in joint coordinates, see `cheaper_formulation`. Measured with
ladders of rods and ball joints. With 10 rungs there are 234 products per body, and both forms take
2,100 operations per body. With 20 rungs there are 864 products per body; joint coordinates take 5,100
operations, the Cartesian form takes 2,100."""


def cheaper_formulation(mechanism: Mechanism) -> FormulationName:
    """Choose the form with fewer operations: joint coordinates, unless many closed loops share joint axes.

    The cost of joint coordinates is estimated by the number of products in J M^-1 J^T, with the constraint
    Jacobian J and the mass matrix M. Two constraint rows have one product for each joint axis that lies on
    the paths of both, from the ground to the bodies that they connect.
    """
    # joint axes between the ground (body 0) and each body
    tree = SpanningTree(mechanism)
    paths: dict[int, list[int]] = {0: []}
    for joint in tree.joints:
        paths[joint.child] = [*paths[joint.parent], *range(joint.v.start, joint.v.stop)]
    # number of constraint rows whose paths contain each axis; a cut is a joint outside the tree, which
    # closes a loop
    rows = [0] * tree.nv
    for cut in tree.cuts:
        closure = tree.equations(cut)
        for k in {*paths[closure.first], *paths[closure.second]}:
            rows[k] += closure.count
    products = sum(count * count for count in rows) // 2  # half of the symmetric matrix
    return "cartesian" if products > MAX_PRODUCTS_PER_BODY * len(mechanism.bodies) else "relative"


def check_formulation(formulation: str | None) -> None:
    """Check the name of a formulation; None stands for the cheaper one.

    Raises:
        UnknownNameError: for a name that is not in `FORMULATIONS`.
    """
    if formulation is not None:
        check_choice("formulation", formulation, FORMULATIONS)


def formulate(scene: Scene, formulation: str, alpha: float = 0.0) -> Formulation:
    """Return the equations of motion of a scene in one form.

    Args:
        scene: the scene.
        formulation: a name in `FORMULATIONS`.
        alpha: 1/s, Baumgarte's parameter; 0 for no stabilization.
    """
    if formulation not in FORMULATIONS:
        raise UnknownNameError("formulation", formulation, tuple(FORMULATIONS))
    return FORMULATIONS[formulation](scene, alpha)
