"""Masses that differ by large factors: no constraint loses rank by them, whatever the pivots are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hanging_chains import hanging_chain, lagrange

from newton_euler.analysis.sensitivity.sensitivities import sensitivities
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.run import Integrator
from newton_euler.errors import SensitivityError
from newton_euler.integrators.options import Options
from newton_euler.integrators.singular import NEAR_PIVOT_RATIO
from newton_euler.model.couplings import Gear
from newton_euler.model.digital_control import Sampled
from newton_euler.model.joint_kinds import Revolute, Rod
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.runs.simulate import simulate

G = 9.81


@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
@pytest.mark.parametrize("light", [1e-4, 1e-8])
def test_light_links_around_a_heavy_one_move_by_lagrange(light, integrator):
    masses = [light, 1.0, light]
    scene = hanging_chain(masses, 0.4, 1.0, 1.0)
    run = simulate(scene, "cartesian", integrator, rtol=1e-9, atol=1e-11)
    centers = run.position[:, 1:, [0, 2]].transpose(0, 2, 1)
    # 300 rtol: errors of the last link's angle grow as it swings over; the sparse elimination loses digits
    assert np.abs(centers - lagrange(masses, 0.4, 1.0, run.time)).max() < 3e-7


@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
def test_a_spatial_chain_with_light_ends_moves_as_in_joint_coordinates(integrator):
    """Joint coordinates have no constraints that could lose rank."""
    points = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.4, 0.0], [0.5, 0.4, 0.2]])
    axes = ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.3])
    bodies, joints = [Body.ground()], []
    for k, mass in enumerate([1e-7, 10.0, 1e-7]):
        center = 0.5 * (points[k] + points[k + 1])
        bodies.append(Body(f"b{k}", mass, center, mass * np.diag([7e-4, 8e-4, 9e-4])))
        joints.append(Revolute(f"j{k}", bodies[k].name, f"b{k}", points[k], axis=np.array(axes[k])))
    scene = Scene("three", Mechanism(bodies, joints), 1.0, 0.1, gravity=[0.0, 0.0, -G])
    expected = simulate(scene, "relative", rtol=1e-12, atol=1e-13)
    run = simulate(scene, "cartesian", integrator, rtol=1e-9, atol=1e-11)
    # 1000 rtol: the light end swings on at many times the speed of the heavy link
    assert np.abs(run.position - expected.position).max() < 1e-6


def closed_with_light_links(how, light):
    """Return three skew links, only the middle one heavy, with a constraint besides their hinges."""
    points = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.4, 0.0], [0.5, 0.4, 0.2]])
    axes = ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.3])
    bodies, joints = [Body.ground()], []
    for k, mass in enumerate([light, 10.0, light]):
        center = 0.5 * (points[k] + points[k + 1])
        bodies.append(Body(f"b{k}", mass, center, mass * np.diag([7e-4, 8e-4, 9e-4])))
        joints.append(Revolute(f"j{k}", bodies[k].name, f"b{k}", points[k], axis=np.array(axes[k])))
    couplings = [Gear("gear", "j0", "j2", ratio=1.5)] if how == "gear" else []
    if how == "rod":
        joints.append(Rod("rod", "b2", "ground", points[3], point_on_second=np.array([0.9, 0.2, 0.9])))
    mechanism = Mechanism(bodies, joints, couplings=couplings)
    return Scene(how, mechanism, 0.5, 0.05, gravity=[0.0, 0.0, -G])


@pytest.mark.parametrize(
    ("how", "integrator"),
    [
        ("gear", "DOP853"),
        ("gear", "Radau"),
        ("rod", "DOP853"),
        pytest.param("rod", "Radau", marks=pytest.mark.slow),
    ],
)
def test_light_links_under_further_constraints_move_as_in_joint_coordinates(how, integrator):
    """The pivots of the Cartesian form fall below 1e-8 of the usual ones; the constraints keep their rank."""
    scene = closed_with_light_links(how, 1e-8)
    expected = simulate(scene, "relative", rtol=1e-12, atol=1e-13)
    run = simulate(scene, "cartesian", integrator, rtol=1e-8, atol=1e-10)
    # 100 rtol: light ends move at many times the speed of the heavy link
    assert np.abs(run.position - expected.position).max() < 1e-6


@pytest.mark.parametrize("how", [pytest.param("gear", marks=pytest.mark.slow), "rod"])
def test_a_sampled_law_at_light_links_does_not_stop_the_run(how):
    """The samples are far from singular configurations, although pivots are small."""
    scene = replace(closed_with_light_links(how, 1e-9), duration=0.02, output_period=0.01)
    joints = [replace(joint, actuated=joint.name == "j1") for joint in scene.mechanism.joints]
    mechanism = Mechanism(scene.mechanism.bodies, joints, couplings=scene.mechanism.couplings)
    law = Sampled("j1", lambda time, x, rate: 0.0, 0.01)
    free = simulate(scene, "cartesian", rtol=1e-8, atol=1e-10)
    run = simulate(replace(scene, mechanism=mechanism, control=(law,)), "cartesian", rtol=1e-8, atol=1e-10)
    # 100 rtol, as of the runs above: the light links amplify errors
    assert np.abs(run.position - free.position).max() < 1e-6


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_derivatives_of_light_links_are_refused_for_their_masses(formulation):
    """At the tolerances of this run they are off by half of their size."""
    scene = replace(closed_with_light_links("rod", 1e-8), duration=0.1, output_period=0.05)
    with pytest.raises(SensitivityError, match="masses differ too much"):
        sensitivities(scene, ["gravity.z"], formulation=formulation, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("how", ["gear", "rod"])
def test_the_pivot_ratio_of_constrained_links_has_no_masses(how):
    """At any state of a run that is far from singular configurations, with any mass of the light links."""
    found = []
    for light in (1.0, 1e-4, 1e-9):
        code = CompiledEquations(closed_with_light_links(how, light), "cartesian")
        (state,) = random_states(code.scene, 1)
        x = code.packed(*code.system.coordinates(state))
        found.append((code.pivot_ratio(x), float(code.function("ratio")(x)[0])))
    ratios, alone = np.array(found).T
    np.testing.assert_allclose(alone, alone[0], rtol=1e-9)
    assert (ratios >= np.minimum(alone, NEAR_PIVOT_RATIO)).all()


@pytest.mark.slow
def test_a_cable_with_a_heavy_load_needs_no_dense_projection():
    """Dense projection costs a thousand times as much; the function that it calls is not even compiled."""
    masses = [0.01] * 30 + [1000.0]
    scene = hanging_chain(masses, 0.03, 0.3, 0.02)
    code, times = CompiledEquations(scene, "cartesian"), scene.times
    integrator = Integrator(code, times, Options())
    integrator(code.packed(*code.system.coordinates(State.initial(scene.mechanism))))
    assert "surface" not in code.functions
    q = integrator.table[:, : code.system.nq].reshape(len(times), -1, 7)
    # errors of steps, rtol = 1e-10 of 1 m
    assert np.abs(q[:, :, [0, 2]].transpose(0, 2, 1) - lagrange(masses, 0.03, 0.3, times)).max() < 1e-10
