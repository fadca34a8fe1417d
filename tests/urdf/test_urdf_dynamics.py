"""Pinocchio's equations of motion against this package's, and against its own mass matrix."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from finite_difference import jacobian
from mechanisms import (
    GRAVITY,
    REGULAR,
    SLIDER_ACCELERATIONS,
    all_universal_loop,
    ball_loop,
    bar,
    bolted,
    planar_four_bar,
    scaled,
    seven_hinges,
    slider_tree,
    spinning_top,
)

from newton_euler.assemble import initial_state
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import MassProperties
from newton_euler.errors import SingularityError
from newton_euler.exercise import random_states
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Cylindrical, Fixed, Revolute, Spherical, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import Polynomial, PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree, weld_loops
from newton_euler.model.state import State
from urdf.dynamics import PinocchioSystem

"""Published with the scene: three independent formulations agree on them, six digits printed."""


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


def offset_slide() -> Scene:
    """A cylindrical joint whose two points are apart; a post fixed to the ground with two hinges."""
    joints: list[Joint] = [
        Cylindrical("tube", "ground", "rod", [0, 0, 0], point_on_second=[0.0, 0.0, 0.4], axis=[0, 0, 1]),
        Fixed("bolt", "post", "ground", [1.0, 0.0, 0.0]),
        Revolute("hinge", "flag", "post", [1.0, 0.0, 0.8], axis=[0.0, 0.6, 0.8]),
        Revolute("hook", "post", "lamp", [1.0, 0.0, 0.5], axis=[0.6, 0.0, 0.8]),
    ]
    bodies = [
        Body.ground(),
        bar("rod", [0, 0, 0.4], [0.3, 0.1, 0.9]),
        bar("post", [1.0, 0.0, 0.0], [1.0, 0.0, 0.8], 3.0),
        bar("flag", [1.0, 0.0, 0.8], [1.4, 0.3, 0.8]),
        bar("lamp", [1.0, 0.0, 0.5], [1.0, 0.4, 0.4], 0.5),
    ]
    return Scene("offset_slide", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def parallel_cranks() -> Scene:
    """Three equal cranks under one beam: redundant equations that drift can make inconsistent."""
    rise = np.array([0.1, 0.0, 0.3])
    feet = [np.array([x, 0.0, 0.0]) for x in (0.0, 0.3, 0.7)]
    bodies = [Body.ground(), bar("beam", list(feet[0] + rise), list(feet[2] + rise), 2.0)]
    joints: list[Joint] = []
    for k, foot in enumerate(feet):
        bodies.append(bar(f"crank_{k}", list(foot), list(foot + rise)))
        joints.append(Revolute(f"foot_{k}", "ground", f"crank_{k}", foot, axis=[0, 1, 0]))
        joints.append(Revolute(f"head_{k}", f"crank_{k}", "beam", foot + rise, axis=[0, 1, 0]))
    return Scene("parallel_cranks", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def near(scene: Scene, count: int) -> list[State]:
    """Consistent states at random within 0.05 rad: cranks far from flat, where a loop may fold."""
    reference = Relative(scene)
    start, _ = reference.coordinates(initial_state(scene))
    rng = np.random.default_rng(0)
    states = []
    for _ in range(count):
        q = project_position(reference, reference.retract(start, rng.uniform(-0.05, 0.05, reference.nv)))
        v = project_velocity(reference, q, rng.standard_normal(reference.nv))
        states.append(reference.state(q, v))
    return states


def driven(scene: Scene, *laws: PD) -> Scene:
    """The scene with these control laws, their joints actuated."""
    names = {law.joint for law in laws}
    joints = [replace(j, actuated=j.name in names) for j in scene.mechanism.joints]
    return replace(scene, mechanism=Mechanism(scene.mechanism.bodies, joints), control=laws)


def driven_scenes() -> list[Scene]:
    """Every kind of coordinate under control: slides and hinges, tree joints both ways round."""
    return [
        driven(cylinder_loop(), PD("tube", 30.0, 2.0, 0.1), PD("tube", 5.0, 1.0, -0.2, coordinate=1)),
        driven(all_universal_loop(), PD("at_b", 7.0, 0.5, 0.3), PD("at_b", 3.0, 0.2, 0.1, coordinate=1)),
        driven(seven_hinges(), PD("hinge_3", 9.0, 0.7, 0.2), PD("hinge_1", 4.0, 0.3, -0.1)),
        driven(
            slider_tree(),
            PD("rail", 20.0, 1.0, 0.2),
            PD("stone_floats", 11.0, 0.4, 0.1, coordinate=1),
        ),
    ]


def apart(found, wanted, scale=0.0):
    """Largest difference against the largest wanted number, or a scale if that is larger."""
    return np.max(np.abs(found - wanted)) / max(np.max(np.abs(wanted)), scale)


def assert_same_motion(found, wanted):
    """Accelerations to 1e-10: condition numbers of 1e4 to 1e5 times 1e-16."""
    for name in ("linear_acceleration", "angular_acceleration"):
        assert apart(getattr(found, name), getattr(wanted, name)) < 1e-10, name
    for name in ("position", "linear_velocity", "angular_velocity"):
        assert apart(getattr(found.state, name), getattr(wanted.state, name)) < 1e-12, name
    same = np.abs(np.sum(found.state.quaternion * wanted.state.quaternion, axis=1))
    assert np.max(np.abs(same - 1.0)) < 1e-12
    assert found.kinetic_energy == pytest.approx(wanted.kinetic_energy, rel=1e-12)
    assert found.potential_energy == pytest.approx(wanted.potential_energy, rel=1e-12, abs=1e-12)


def assert_same_reactions(found, wanted, size):
    """1e-8: multipliers lose the condition of the constraints once more. Torques also against the
    largest force times the size of the mechanism, for those that vanish."""
    assert apart(found.reaction_force, wanted.reaction_force) < 1e-8
    lever = size * np.max(np.abs(wanted.reaction_force))
    assert apart(found.reaction_torque, wanted.reaction_torque, lever) < 1e-8


def test_slider_accelerations_at_the_start(tracker):
    system = PinocchioSystem(tracker)
    at_start = system.evaluate(*system.coordinates(initial_state(tracker)))
    assert at_start.linear_acceleration[1:3, 2] == pytest.approx(SLIDER_ACCELERATIONS, abs=1e-6)


def test_agrees_with_newton_euler_on_the_tracker(tracker):
    """200 states, joints up to 0.05 (rad, m) from the start before loops close; reactions one by one."""
    reference, system = Relative(tracker), PinocchioSystem(tracker)
    start, _ = reference.coordinates(initial_state(tracker))
    rng = np.random.default_rng(7)
    for _ in range(200):
        q = project_position(reference, reference.retract(start, rng.uniform(-0.05, 0.05, 8)))
        v = project_velocity(reference, q, rng.standard_normal(8))
        wanted = reference.evaluate(q, v)
        found = system.evaluate(*system.coordinates(reference.state(q, v)))
        assert_same_motion(found, wanted)
        forces = np.linalg.norm(wanted.reaction_force, axis=1)
        assert np.all(np.linalg.norm(found.reaction_force - wanted.reaction_force, axis=1) < 1e-8 * forces)
        assert_same_reactions(found, wanted, tracker.mechanism.size)
        np.testing.assert_allclose(found.actuator_force, wanted.actuator_force, rtol=1e-12)


@pytest.mark.parametrize("build", [*REGULAR, cylinder_loop, offset_slide], ids=lambda b: b.__name__)
def test_agrees_with_newton_euler_on_every_joint_kind(build):
    """Balls, chains and fixed joints in the tree both ways round; loops cut at balls, at a hinge and
    at a universal joint."""
    scene = build()
    reference, system = Relative(scene), PinocchioSystem(scene)
    for state in random_states(scene, 10):
        wanted = reference.evaluate(*reference.coordinates(state))
        found = system.evaluate(*system.coordinates(state))
        assert_same_motion(found, wanted)
        assert_same_reactions(found, wanted, scene.mechanism.size)


def test_inertias_of_bodies_that_fixed_joints_hold():
    """1e-14: inertias of 3 kg m^2 added up by Pinocchio and taken apart again."""
    scene = offset_slide()
    stated, found = MassProperties.of(scene.mechanism), PinocchioSystem(scene).mass_properties()
    for name in ("mass", "center_of_mass", "inertia"):
        np.testing.assert_allclose(getattr(found, name), getattr(stated, name), rtol=0, atol=1e-14)


@pytest.mark.parametrize("scene", driven_scenes(), ids=lambda scene: scene.name)
def test_agrees_with_newton_euler_under_control(scene):
    """Actuator forces to 1e-9: of angles and rates good to 1e-12, targets apart from them by chance."""
    reference, system = Relative(scene), PinocchioSystem(scene)
    for state in random_states(scene, 10):
        wanted = reference.evaluate(*reference.coordinates(state))
        found = system.evaluate(*system.coordinates(state))
        assert np.all(np.abs(wanted.actuator_force) > 0.0)
        np.testing.assert_allclose(found.actuator_force, wanted.actuator_force, rtol=1e-9)
        assert_same_motion(found, wanted)
        assert_same_reactions(found, wanted, scene.mechanism.size)


def test_the_mechanisms_above_contain_what_they_are_there_for():
    universal = weld_loops(all_universal_loop().mechanism)
    names = universal.mechanism.joint_names
    assert [k.forward for k in universal.tree.joints if names[k.joint] == "at_b"] == [False]
    assert [names[k] for k in universal.tree.cuts] == ["at_c_weld"]
    hinges = weld_loops(seven_hinges().mechanism)
    assert [hinges.mechanism.joint_names[k] for k in hinges.tree.cuts] == ["hinge_3_weld"]
    loop = cylinder_loop().mechanism
    assert [loop.joint_names[k] for k in SpanningTree(loop).cuts] == ["foot"]
    for scene, kind, forward in (
        (cylinder_loop(), Cylindrical, False),
        (slider_tree(), Cylindrical, True),
        (spinning_top(), Spherical, True),
        (slider_tree(), Spherical, False),
        (slider_tree(), Fixed, False),
    ):
        tree = SpanningTree(scene.mechanism)
        ways = [k.forward for k in tree.joints if isinstance(scene.mechanism.joints[k.joint], kind)]
        assert forward in ways


@pytest.mark.parametrize("build", [planar_four_bar, parallel_cranks])
def test_redundant_loops_have_the_same_accelerations(build):
    scene = build()
    reference, system = Relative(scene), PinocchioSystem(scene)
    q, _ = system.coordinates(initial_state(scene))
    assert np.linalg.matrix_rank(system.phi_jacobian(q), tol=1e-9) < len(system.phi(q))
    for state in near(scene, 5):
        wanted = reference.evaluate(*reference.coordinates(state))
        assert_same_motion(system.evaluate(*system.coordinates(state)), wanted)


@pytest.mark.parametrize("factor", [1e-3, 1e-2, 1.0, 1e2])
@pytest.mark.parametrize("build", [planar_four_bar, parallel_cranks, seven_hinges])
def test_loops_of_any_size_move_alike(build, factor):
    """Regularised or not: angles and lengths weigh alike. 1e-10 as between the engines."""
    scene = build()
    reference, system = Relative(scene), PinocchioSystem(scaled(scene, factor))
    for state in near(scene, 3):
        grown = replace(
            state, position=factor * state.position, linear_velocity=factor * state.linear_velocity
        )
        wanted = reference.evaluate(*reference.coordinates(state))
        found = system.evaluate(*system.coordinates(grown))
        assert apart(found.linear_acceleration / factor, wanted.linear_acceleration) < 1e-10
        assert apart(found.angular_acceleration, wanted.angular_acceleration) < 1e-10


@pytest.mark.parametrize(
    ("kind", "axes"), [(Fixed, {}), (Spherical, {}), (Revolute, {"axis": [0.3, 0.5, -0.2]})]
)
def test_a_second_bolt_changes_nothing(kind, axes):
    """Its closure's Jacobian is round-off, or has one row that says something among six."""
    reference, system = Relative(bolted(None)), PinocchioSystem(bolted(kind, **axes))
    for state in random_states(reference.scene, 5):
        wanted = reference.evaluate(*reference.coordinates(state))
        assert_same_motion(system.evaluate(*system.coordinates(state)), wanted)


def test_drift_of_redundant_loops_does_not_spoil_accelerations():
    """Open by 1e-6, the gains ask for 100 / s^2 times that in equations that contradict each other:
    against accelerations of 10 to 40, with the loops' condition of 1e2 at most, that is 1e-3."""
    scene = parallel_cranks()
    system = PinocchioSystem(scene, alpha=10.0)
    for state in near(scene, 5):
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


def test_constraint_dynamics_solves_the_dense_kkt_system(tracker, tracker_states):
    """1e-11: a dense solve of condition 1e4 to 1e5 at 1e-16.

    Everything is Pinocchio's: crba, nonLinearEffects and getConstraintsJacobian; gamma is what the
    closure points' accelerations are at vdot = 0, in the frame of the first.
    """
    system = PinocchioSystem(tracker)
    model, constraints = system.closed.model, system.closed.constraints
    data = model.createData()
    constraint_data = pin.StdVec_RigidConstraintData([c.createData() for c in constraints])
    for state in tracker_states[:50]:
        q, v = system.coordinates(state)
        pin_q, pin_v = system.map.q_to_pinocchio(q), system.map.v_to_pinocchio(v)
        upper = np.triu(pin.crba(model, data, pin_q))
        mass = upper + np.triu(upper, 1).T
        bias = pin.nonLinearEffects(model, data, pin_q, pin_v)
        pin.computeJointJacobians(model, data, pin_q)
        for constraint, its_data in zip(constraints, constraint_data, strict=True):
            constraint.calc(model, data, its_data)  # else the Jacobian is that of no configuration
        rows = pin.getConstraintsJacobian(model, data, constraints, constraint_data)
        pin.forwardKinematics(model, data, pin_q, pin_v, np.zeros(model.nv))
        pin.updateFramePlacements(model, data)
        gamma = []
        for first, second in system.closed.frames:
            a, b = (
                pin.getFrameClassicalAcceleration(model, data, f, pin.LOCAL_WORLD_ALIGNED).linear
                for f in (first, second)
            )
            gamma.append(data.oMf[first].rotation.T @ (b - a))
        force = np.zeros(model.nv)
        for law, u in zip(tracker.control, system.actuation(q, v), strict=True):
            force[model.joints[model.getJointId(law.joint)].idx_v] = u
        kkt = np.block([[mass, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
        solution = np.linalg.solve(kkt, np.concatenate([force - bias, *gamma]))
        wanted = system.map.v_from_pinocchio(solution[: model.nv])
        assert apart(system.acceleration(q, v), wanted) < 1e-11


@pytest.mark.parametrize("build", [ball_loop, all_universal_loop, seven_hinges])
def test_phi_jacobian_is_the_derivative_of_phi(build):
    """At an open configuration. 1e-10: the helper's 1e-12 times third derivatives of some 10."""
    scene = build()
    system = PinocchioSystem(scene)
    q, _ = system.coordinates(initial_state(scene))
    q = system.retract(q, 0.3 * np.sin(1.0 + np.arange(system.nv)))
    assert np.max(np.abs(system.phi(q))) > 0.01
    wanted = jacobian(lambda step: system.phi(system.retract(q, step)), system.nv)
    np.testing.assert_allclose(system.phi_jacobian(q), wanted, rtol=0, atol=1e-10)


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
