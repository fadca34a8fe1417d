"""Articulated bodies: the cost of long branches, and the formulation that long loops choose."""

from __future__ import annotations

import numpy as np
import pytest
from random_chains import TREES

from crosscheck.library.chain import HINGE_AXES, X, Y, Z, chain, rod
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.formulations import cheaper_formulation
from newton_euler.equations import articulated
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import rows_in_use
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Revolute, Spherical, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state


def arch(rods: int) -> Scene:
    """Rods on hinges in a half circle, both ends on the ground: one loop along all of them."""
    angles = np.linspace(0.0, np.pi, rods + 1)
    points = 0.5 / np.sin(0.5 * np.pi / rods) * np.array([np.cos(angles), np.sin(angles), 0.0 * angles]).T
    names = ["ground", *(f"rod_{k}" for k in range(rods))]
    bodies, joints = [Body.ground()], list[Joint]()
    for k in range(rods):
        bodies.append(rod(names[k + 1], points[k], points[k + 1] - points[k]))
        joints.append(Revolute(f"hinge_{k}", names[k], names[k + 1], points[k], axis=HINGE_AXES[k % 2]))
    joints.append(Spherical("end", names[-1], "ground", points[-1]))
    return Scene("arch", Mechanism(bodies, joints), 1.0, 0.1, gravity=-9.81 * Z)


def ladder(rungs: int) -> Mechanism:
    """Two ropes of rods that rungs connect: every loop is as long as the ropes above."""
    bodies, joints = [Body.ground()], list[Joint]()
    for side, start in enumerate((0.0 * Y, Y)):
        for k in range(rungs):
            name, before = f"rod_{side}_{k}", f"rod_{side}_{k - 1}" if k else "ground"
            bodies.append(rod(name, start + k * X, X))
            axes = {"axis_on_first": Y, "axis_on_second": Z}
            joints.append(Universal(f"joint_{side}_{k}", before, name, start + k * X, **axes))
    for k in range(rungs):
        bodies.append(rod(f"rung_{k}", (k + 1) * X, Y))
        axes = {"axis_on_first": X, "axis_on_second": Z}
        joints.append(Universal(f"left_{k}", f"rod_0_{k}", f"rung_{k}", (k + 1) * X, **axes))
        joints.append(Spherical(f"right_{k}", f"rung_{k}", f"rod_1_{k}", (k + 1) * X + Y))
    return Mechanism(bodies, joints)


@pytest.mark.parametrize("build", [chain, arch])
def test_operations_grow_with_the_number_of_joints(build) -> None:
    counts = [
        CompiledEquations(build(n), "relative").program("derivative").operation_count for n in (20, 30, 40)
    ]
    # 1.4 where operations grow with the square; rods in some directions have a few zeros more
    assert counts[2] - counts[1] < 1.05 * (counts[1] - counts[0])


@pytest.mark.parametrize("name", TREES)
def test_pivots_are_the_same_in_joint_coordinates(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """L D L^T of a matrix in a given order is unique, however it is found."""
    system = Relative(TREES[name])
    q, v = system.coordinates(initial_state(TREES[name]))
    found = []
    for depth in (0, 6, system.nv):
        monkeypatch.setattr(articulated, "MAX_JOINT_SPACE_DEPTH", depth)
        found.append(system.sparse_equations(q, v, rows_in_use(system)).factor.pivots)
    for pivots in found[:2]:
        assert pivots == pytest.approx(found[2], rel=1e-10)  # condition 1e5 of M on round-off


def test_joint_coordinates_unless_loops_share_long_paths() -> None:
    mechanisms = chain(200).mechanism, arch(200).mechanism, ladder(5), ladder(20)
    assert [cheaper_formulation(each) for each in mechanisms] == ["relative"] * 3 + ["cartesian"]
