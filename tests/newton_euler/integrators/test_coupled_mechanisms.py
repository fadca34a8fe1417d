"""Screws, gears and prescribed motions in one mechanism: runs of all integrators."""

from __future__ import annotations

import numpy as np
import pytest
from elements import coupled_loop, coupled_tree

import newton_euler
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.relative import Relative


@pytest.mark.parametrize(
    ("integrator", "options", "allowed"),
    [
        # not one tolerance of lengths of 1 m: 2e-12 is measured, and a tenth of that at a tenth of it
        ("Radau", {"rtol": 1e-8, "atol": 1e-10}, 1e-8),
        # h^4 and h of motions of 10 rad/s
        ("RK4", {"step": 2e-3}, 1e-6),
        ("Euler", {"step": 1e-3}, 1e-2),
    ],
)
def test_all_integrators_follow(integrator, options, allowed):
    reference = newton_euler.simulate(coupled_loop("tip"))
    run = newton_euler.simulate(coupled_loop("tip"), "relative", integrator, **options)
    assert np.abs(run.position - reference.position).max() < allowed
    assert run.constraint_violation.max() < 1e-12


def test_cut_coordinates_are_what_they_are_meant_to_be():
    for cut, count in (("tip", 2), ("thread", 2)):
        system = Relative(coupled_loop(cut))
        assert [system.mechanism.joint_names[k] for k in system.tree.cuts] == [cut]
        assert len(system.between) == count
    assert len(Relative(coupled_tree()).between) == 0


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_baumgarte_follows_the_motion_too(formulation):
    scene = coupled_tree()
    run = newton_euler.simulate(scene, formulation, stabilization="baumgarte")
    wanted = newton_euler.simulate(scene, formulation)
    assert np.abs(run.position - wanted.position).max() < 1e-8  # what rtol = 1e-10 leaves
