"""Pinocchio's equations of motion: masses, gains, and states without an answer."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from constrained_motion import states_near_start
from elements import offset_slide
from mechanisms import (
    GRAVITY,
    all_universal_loop,
    ball_loop,
    bar,
    parallel_cranks,
    planar_four_bar,
    seven_hinges,
)

from newton_euler.equations.system import MassProperties
from newton_euler.errors import SingularityError
from newton_euler.model.couplings import Gear
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Cylindrical, Revolute, Spherical, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state
from urdf import to_loops, to_urdf
from urdf.dynamics import PinocchioSystem
from urdf.loops import parse_loops
from urdf.model import build


def cylinder_loop() -> Scene:
    """Cylindrical joint, universal joint, and a ball on the ground that closes: 4 - 3 = 1 freedom."""
    a, b, c = [0.0, 0.0, 0.0], [0.3, 0.1, 0.5], [0.9, 0.2, 0.1]
    joints: list[Joint] = [
        Cylindrical("tube", "sleeve", "ground", a, axis=[0.2, 0.1, 1.0], actuated=True),
        Universal("cross", "sleeve", "arm", b, axis_on_first=[1, 0, 0], axis_on_second=[0, 1, 0]),
        Spherical("foot", "arm", "ground", c),
    ]
    bodies = [Body.ground(), bar("sleeve", a, b), bar("arm", b, c, 2.0)]
    return Scene("cylinder_loop", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def apart(found, wanted, scale=0.0):
    """Largest difference against the largest wanted number, or a scale if that is larger."""
    return np.max(np.abs(found - wanted)) / max(np.max(np.abs(wanted)), scale)


def test_inertias_of_bodies_that_fixed_joints_hold():
    """1e-14: inertias of 3 kg m^2 added up by Pinocchio and taken apart again."""
    scene = offset_slide()
    stated, found = MassProperties.of(scene.mechanism), PinocchioSystem(scene).mass_properties()
    for name in ("mass", "center_of_mass", "inertia"):
        np.testing.assert_allclose(getattr(found, name), getattr(stated, name), rtol=0, atol=1e-14)


def test_drift_of_redundant_loops_does_not_spoil_accelerations():
    """Open by 1e-6, the gains ask for 100 / s^2 times that in equations that contradict each other:
    against accelerations of 10 to 40, with the loops' condition of 1e2 at most, that is 1e-3."""
    scene = parallel_cranks()
    system = PinocchioSystem(scene, alpha=10.0)
    for state in states_near_start(scene, 5):
        q, v = system.coordinates(state)
        closed = system.acceleration(q, v)
        opened = system.acceleration(q + 1e-6 * np.sin(np.arange(system.nq)), v)
        assert apart(opened, closed) < 1e-3


def test_states_without_finite_accelerations_are_refused(tracker):
    system = PinocchioSystem(tracker)
    q, v = system.coordinates(initial_state(tracker))
    v[2] = np.inf
    with pytest.raises(SingularityError, match="ball_67, ball_57"):
        system.acceleration(q, v)


def test_a_state_without_finite_accelerations_leaves_no_trace():
    motions = (PrescribedMotion("at_a", Sine(0.1, 1.0)),)
    system = PinocchioSystem(replace(planar_four_bar(), motions=motions))
    q, v = system.coordinates(initial_state(system.scene))
    before = system.evaluate(q, v).reaction_force
    with pytest.raises(SingularityError):
        system.acceleration(q, np.full(system.nv, np.nan))
    assert np.array_equal(system.evaluate(q, v).reaction_force, before)


@pytest.mark.parametrize("build", [ball_loop, cylinder_loop, all_universal_loop, seven_hinges])
def test_baumgarte_gains_pull_closures_together(build):
    """J (vdot - vdot without gains) = -K_D J v - K_P phi, almost at rest. 1e-3 relative: the rate of
    an opening of 1e-5 in a turning frame, and the logarithm of a weld's, are of second order."""
    scene, alpha = build(), 8.0
    free, corrected = PinocchioSystem(scene), PinocchioSystem(scene, alpha)
    q, _ = free.coordinates(random_states(scene, 1)[0])
    q = free.retract(q, 1e-5 * np.cos(np.arange(free.nv)))
    v = 1e-4 * np.sin(np.arange(free.nv))
    rows = free.phi_jacobian(q)
    found = rows @ (corrected.acceleration(q, v) - free.acceleration(q, v))
    wanted = -2.0 * alpha * (rows @ v) - alpha**2 * free.phi(q)
    assert apart(found, wanted) < 1e-3


def test_motions_and_gears_that_depend_on_each_other():
    """With no closure beside them: nothing is left for Pinocchio to regularize."""
    mechanism = Mechanism(
        [Body.ground(), *(Body(name, 1.0, (0.0, 0.0, 0.0), np.eye(3)) for name in "ab")],
        [Revolute(f"j_{name}", "ground", name, (0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0)) for name in "ab"],
        [Gear("gear", "j_a", "j_b", 2.0)],
    )
    motions = tuple(PrescribedMotion(f"j_{name}", Polynomial((0.0,))) for name in "ab")
    system = PinocchioSystem(Scene("driven_twice", mechanism, 1.0, 0.1, motions=motions))
    assert system.acceleration(*system.coordinates(initial_state(system.scene))) == pytest.approx([0.0, 0.0])


def test_axes_next_to_a_coordinate_axis_are_not_rounded() -> None:
    scene = planar_four_bar()
    text = to_urdf(scene)
    axis = re.search(r'axis xyz="([^"]*)"', text)
    assert axis is not None
    text = text.replace(axis[0], 'axis xyz="6e-13 1.0 0.0"', 1)
    loops = parse_loops(to_loops(scene), "loops")
    for keeps, tilt in ((False, 0.0), (True, 6e-13)):
        model = build(text, loops, keeps_axes=keeps).model
        columns = np.reshape(
            pin.computeJointJacobians(model, model.createData(), pin.neutral(model)), (6, -1)
        )
        assert tilt in np.abs(columns[3])
        assert (6e-13 in np.abs(columns[3])) == keeps
