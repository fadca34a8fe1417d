"""Angles of more than half a revolution in states and trajectories: wound springs about fixed axes.

A rod turns about a fixed axis z at x, with a torsion spring at the axis and gravity across it:

    J x'' = -k x - m g l cos(x) + u,    V = k x^2 / 2 + m g l sin(x)
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mjcf
import newton_euler
import urdf
from newton_euler import (
    PD,
    Body,
    Gear,
    JointSpring,
    Mechanism,
    ParallelHinges,
    Polynomial,
    PolynomialCoupling,
    PrescribedMotion,
    Prismatic,
    Revolute,
    Scene,
    Sine,
    State,
    equilibrium,
    initial_state,
    inverse_dynamics,
    linearize,
    lqr,
    sensitivities,
    simulate,
    simulate_batch,
    solve_poses,
    start,
    statics,
    with_parameters,
)
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.errors import MechanismError, OptionError
from newton_euler.model.scene import MAXIMUM_ANGLE
from newton_euler.model.source_file import SourceError
from newton_euler.model.trajectory import load_arrays

K = 0.3  # N m/rad
ARM, MASS, G = 0.1, 1.0, 9.81  # m, kg, m/s^2
J = 0.02 + MASS * ARM**2  # kg m^2 about the axis
KEY = ("hinge", 0)
WOUND = 20.0  # rad, 3.18 revolutions
ROUND_OFF = 1e-12  # of torques of 6 N m
RUN = 1e-7  # rad: error of runs at the default rtol


def rod(name: str = "rod", arm: float = ARM, y: float = 0.0) -> Body:
    return Body(name, MASS, [arm, y, 0.0], np.diag([0.01, 0.01, 0.02]))


def pivot(name: str = "hinge", second: str = "rod", y: float = 0.0) -> Revolute:
    return Revolute(name, "ground", second, [0.0, y, 0.0], axis=[0.0, 0.0, 1.0], actuated=True)


def spring_scene(arm: float = ARM, **more) -> Scene:
    """The rod on its spring; about its center of mass for an arm of 0."""
    mechanism = Mechanism([Body.ground(), rod(arm=arm)], [pivot()])
    given = {"forces": [JointSpring("hinge", stiffness=K)], **more}
    return Scene("wound", mechanism, 2.0, 0.5, (0.0, -G, 0.0), **given)


def torque(x):
    """What the spring and gravity take to hold the rod at x."""
    return K * x + MASS * G * ARM * np.cos(x)


def wound(scene: Scene, angle: float = WOUND, rate: float = 0.0) -> State:
    return initial_state(start(scene, hinge=(angle, rate)))


# Trajectories


@pytest.mark.parametrize("period", [0.05, 0.5])
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_trajectory_has_the_angles_of_its_run_however_far_outputs_are_apart(formulation, period) -> None:
    """Between outputs of 0.5 s x = 20 sin(3 t) turns by up to 4.5 revolutions, and back."""
    motion = PrescribedMotion("hinge", Sine(20.0, 3.0))
    scene = replace(spring_scene(motions=[motion]), output_period=period)
    run = simulate(scene, formulation)
    exact = 20.0 * np.sin(3.0 * run.time)
    assert run.angle_names == ("hinge",)
    assert np.allclose(run.joint_angle[:, 0], exact, rtol=0.0, atol=ROUND_OFF)
    assert np.allclose(run.joint("hinge").coordinates[:, 0], exact, rtol=0.0, atol=ROUND_OFF)
    potential = 0.5 * K * exact**2 + MASS * G * ARM * np.sin(exact)
    assert np.allclose(run.potential_energy, potential, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("engine", [newton_euler, mjcf, urdf])
def test_all_engines_oscillate_about_the_unwound_spring(engine) -> None:
    scene = start(spring_scene(arm=0.0), hinge=(WOUND, 0.0))
    run = engine.simulate(scene)
    exact = WOUND * np.cos(np.sqrt(K / 0.02) * run.time)
    assert np.allclose(run.joint_angle[:, 0], exact, rtol=0.0, atol=1e-6)  # MuJoCo's steps of RK4
    assert np.allclose(run.joint("hinge").coordinates[:, 0], exact, rtol=0.0, atol=1e-6)
    assert run.potential_energy[0] == pytest.approx(0.5 * K * WOUND**2, rel=ROUND_OFF)


def test_batches_have_the_same_angles_as_single_runs() -> None:
    values = {"start.hinge": [WOUND, -7.0], "start.hinge.rate": [0.0, 60.0]}
    batch = simulate_batch(spring_scene(), parameters=values)
    motion = batch.joint("hinge")
    for k, run in enumerate(batch):
        own = {name: each[k] for name, each in values.items()}
        single = simulate(with_parameters(spring_scene(), own))
        assert np.allclose(run.joint_angle, single.joint_angle, rtol=0.0, atol=RUN)
        assert np.array_equal(motion.coordinates[k], run.joint("hinge").coordinates)
        assert single.joint_angle[0, 0] == own["start.hinge"]


def test_geometry_that_varies_has_the_carried_angles() -> None:
    heights = [0.0, 0.1]
    values = {"hinge.point_on_second": [[0.0, 0.0, z] for z in heights], "start.hinge": [WOUND, WOUND]}
    batch = simulate_batch(spring_scene(arm=0.0), parameters=values)
    exact = WOUND * np.cos(np.sqrt(K / 0.02) * batch.scene.times)
    assert np.allclose(batch.joint("hinge").coordinates[:, :, 0], exact, rtol=0.0, atol=RUN)


def test_a_run_goes_on_from_a_state_of_a_trajectory() -> None:
    scene = start(spring_scene(), hinge=(WOUND, 5.0))
    run = simulate(scene)
    for state in (run.state(1), run.state(-4)):
        assert state.angles == {KEY: run.joint_angle[1, 0]}
        again = simulate(replace(scene, initial_state=state, duration=1.5))
        assert np.allclose(again.joint_angle, run.joint_angle[1:], rtol=0.0, atol=RUN)
    (batch,) = simulate_batch(replace(scene, duration=1.5), [run.state(1)])
    assert np.array_equal(batch.joint_angle, again.joint_angle)


@pytest.mark.parametrize("output", [5, -6, True, 1.0, "1"])
def test_outputs_that_a_run_does_not_have_are_refused(output) -> None:
    with pytest.raises(OptionError):
        simulate(spring_scene()).state(output)


def test_trajectories_without_carried_angles_have_no_arrays_of_them() -> None:
    run = simulate(spring_scene(forces=[]))
    assert run.angle_names == ()
    assert run.joint_angle is None
    assert not {"angle_names", "joint_angle"} & run.arrays().keys()


def test_files_and_tables_hold_the_carried_angles(tmp_path) -> None:
    run = simulate(start(spring_scene(), hinge=(WOUND, 0.0)))
    run.save(tmp_path / "run.npz")
    arrays = load_arrays(tmp_path / "run.npz")
    assert arrays["angle_names"].tolist() == ["hinge"]
    assert np.array_equal(arrays["joint_angle"], run.joint_angle)
    assert np.array_equal(run.to_dataframe()["joint_angle.hinge"], run.joint_angle[:, 0])
    assert len(run.first(2).joint_angle) == 2


@pytest.mark.parametrize(
    "change",
    [
        {"angle_names": None},
        {"joint_angle": None},
        {"angle_names": np.array(["other"])},
        {"angle_names": np.array(["hinge.x"])},
        {"angle_names": np.array(["hinge", "hinge"]), "joint_angle": np.zeros((5, 2))},
    ],
)
def test_files_with_angles_of_no_coordinates_are_refused(tmp_path, change) -> None:
    arrays = {**simulate(spring_scene()).arrays(), **change}
    np.savez(tmp_path / "run.npz", **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(SourceError, match="angle_names"):
        load_arrays(tmp_path / "run.npz")


# States


@pytest.mark.parametrize("angle", [WOUND, -WOUND, 1.0])
def test_a_start_has_the_angle_that_is_asked_for_whatever_the_one_before(angle) -> None:
    for scene in (spring_scene(), start(spring_scene(), hinge=(-50.0, 3.0))):
        state = wound(scene, angle, 2.0)
        assert state.angles == {KEY: angle}
        for formulation in FORMULATIONS:
            run = simulate(replace(scene, initial_state=state), formulation)
            assert run.joint_angle[0, 0] == pytest.approx(angle, abs=ROUND_OFF)


def test_a_rate_alone_keeps_the_revolutions() -> None:
    scene = with_parameters(start(spring_scene(), hinge=(WOUND, 0.0)), {"start.hinge.rate": 2.0})
    assert initial_state(scene).angles == {KEY: pytest.approx(WOUND, abs=ROUND_OFF)}


def geared(*couplings, **more) -> Scene:
    """Two rods about fixed axes, the second one coupled to the first."""
    bodies = [Body.ground(), rod(), rod("other", y=1.0)]
    mechanism = Mechanism(bodies, [pivot(), pivot("follower", "other", 1.0)], couplings)
    springs = [JointSpring("hinge", stiffness=K), JointSpring("follower", stiffness=2.0 * K)]
    return Scene("geared", mechanism, 1.0, 0.25, forces=springs, **more)


@pytest.mark.parametrize("angle", [WOUND, -3.0])
@pytest.mark.parametrize(
    ("coupling", "follows"),
    [
        (Gear("pair", "hinge", "follower", 0.3), lambda x: 0.3 * x),
        (PolynomialCoupling("cam", "hinge", "follower", (0.3, 0.05)), lambda x: 0.3 * x + 0.05 * x**2),
    ],
)
def test_coupled_angles_follow_a_start_with_their_revolutions(coupling, follows, angle) -> None:
    """At 20 rad the gear is at 6 rad and the cam at 26 rad, which poses within half a revolution are not."""
    scene = start(geared(coupling), hinge=(angle, 0.0))
    exact = follows(angle)
    angles = initial_state(scene).angles
    assert angles == {KEY: pytest.approx(angle, abs=1e-9), ("follower", 0): pytest.approx(exact, abs=1e-9)}
    energy = 0.5 * K * angle**2 + K * exact**2
    for formulation in FORMULATIONS:
        run = simulate(scene, formulation)
        assert run.potential_energy[0] == pytest.approx(energy, rel=1e-9)
        held = inverse_dynamics(scene, run, {"hinge": 0.0}, rates={"hinge": 0.0}).actuator_force[:, 0]
        x = run.joint("hinge").coordinates[:, 0]
        slope = follows(x + 0.5) - follows(x - 0.5)  # exact for polynomials of degree 2
        assert np.allclose(held, K * x + 2.0 * K * follows(x) * slope, rtol=0.0, atol=1e-7)


def test_an_angle_decides_between_the_branches_of_a_polynomial() -> None:
    """With c x^2 the follower is at the same pose at x and at -x, and at others a revolution further."""
    scene = geared(PolynomialCoupling("cam", "hinge", "follower", (0.0, 0.05)))
    for angle in (WOUND, -WOUND):
        state = initial_state(start(scene, hinge=(angle, 0.0)))
        torque_there = statics(scene, state, ["hinge"]).actuator_force[0]
        exact = K * angle + 2.0 * K * 0.05 * angle**2 * 0.1 * angle
        assert torque_there == pytest.approx(exact, rel=1e-8)


def test_the_initial_state_completes_the_angles_that_runs_begin_with() -> None:
    scene = geared(Gear("pair", "hinge", "follower", 3.0))
    pose = replace(initial_state(start(scene, hinge=(2.5, 0.0))), angles={})
    found = initial_state(replace(scene, initial_state=pose)).angles
    assert found == {KEY: pytest.approx(2.5), ("follower", 0): pytest.approx(7.5)}
    bare = initial_state(replace(scene, initial_state=replace(pose, angles={("follower", 0): 7.5})))
    assert bare.angles == {KEY: pytest.approx(2.5), ("follower", 0): 7.5}


@pytest.mark.parametrize(
    ("angles", "element"),
    [
        ({KEY: 1.1}, "joint 'hinge'"),
        ({KEY: 2.0 * np.pi + 1e-3}, "joint 'hinge'"),
        ({KEY: np.nan}, "scene"),
        ({KEY: 10.0 * MAXIMUM_ANGLE}, "scene"),
        ({KEY: "1"}, "scene"),
        ({("other", 0): 0.0}, "scene"),
        ({("hinge", 1): 0.0}, "scene"),
        ({"hinge": 0.0}, "scene"),
        ([1.0], "scene"),
    ],
)
def test_angles_that_the_poses_do_not_have_are_refused(angles, element) -> None:
    scene = spring_scene()
    state = replace(State.initial(scene.mechanism), angles=angles)
    for evaluate in (
        lambda: initial_state(replace(scene, initial_state=state)),
        lambda: linearize(scene, state),
        lambda: statics(scene, state, ["hinge"]),
        lambda: inverse_dynamics(scene, state, {"hinge": 0.0}),
    ):
        with pytest.raises(MechanismError) as caught:
            evaluate()
        assert element in caught.value.element
    assert list(simulate_batch(scene, [State.initial(scene.mechanism), state]).errors) == [1]


def test_a_slide_has_no_revolutions() -> None:
    guide = Prismatic("guide", "ground", "rod", [0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0])
    scene = Scene("slide", Mechanism([Body.ground(), rod()], [guide]), 1.0, 0.5)
    state = replace(State.initial(scene.mechanism), angles={("guide", 0): 0.0})
    with pytest.raises(MechanismError) as caught:
        replace(scene, initial_state=state)
    assert "guide" in caught.value.problem


def test_a_moving_base_keeps_springs_wound() -> None:
    scene = newton_euler.on_moving_base(start(spring_scene(), hinge=(WOUND, 0.0)), {"surge": Sine(0.1, 1.0)})
    assert initial_state(scene).angles == {KEY: pytest.approx(WOUND, abs=ROUND_OFF)}


def test_a_scene_described_at_another_pose_keeps_springs_wound() -> None:
    """Its joint counts from the new initial pose, its spring has its rest as far back."""
    scene = start(geared(), hinge=(WOUND, 0.0), follower=(-9.0, 0.0))
    moved = with_parameters(scene, {"hinge.point_on_second": [0.01, 0.0, 0.0]})
    energy = 0.5 * K * WOUND**2 + K * 81.0
    assert simulate(moved).potential_energy[0] == pytest.approx(energy, rel=1e-9)


# Inverse dynamics, statics, linear models


@pytest.mark.parametrize("rate", [2.0, 0.0])
def test_inverse_dynamics_of_a_run_is_the_torque_of_its_motion(rate: float) -> None:
    """At constant rate the motion's torque holds the spring and the weight."""
    driven = spring_scene(motions=[PrescribedMotion("hinge", Polynomial((WOUND, rate)))])
    run = simulate(driven)
    x = WOUND + rate * run.time
    loads = inverse_dynamics(spring_scene(), run, {"hinge": 0.0})
    assert np.allclose(loads.actuator_force[:, 0], torque(x), rtol=0.0, atol=ROUND_OFF)
    assert np.allclose(loads.actuator_force[:, 0], run.reaction_torque[:, 0, 2], rtol=0.0, atol=1e-9)
    for row, angle in enumerate(x):
        alone = inverse_dynamics(spring_scene(), run.state(row), {"hinge": 0.0})
        assert alone.actuator_force[0] == pytest.approx(torque(angle), abs=ROUND_OFF)


def test_prescribed_motions_determine_revolutions_at_the_time_of_a_state() -> None:
    """The states have no angles; the motion is at 25 rad at 2.5 s."""
    scene = spring_scene(motions=[PrescribedMotion("hinge", Polynomial((WOUND, 2.0)))])
    run = simulate(scene)
    poses = replace(run.state(2), angles={})
    loads = inverse_dynamics(scene, poses, {}, time=1.0)
    assert loads.reaction_torque[0, 2] == pytest.approx(torque(22.0), abs=1e-9)


def test_angles_that_a_run_does_not_carry_follow_their_rates() -> None:
    """No force of the run depends on its angle; a spring is looked at afterwards."""
    run = simulate(replace(start(spring_scene(0.0, forces=[]), hinge=(0.0, 5.0)), output_period=0.1))
    assert run.joint_angle is None
    loads = inverse_dynamics(spring_scene(0.0), run, {"hinge": 0.0})
    assert np.allclose(loads.actuator_force[:, 0], 5.0 * K * run.time, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_inverse_dynamics_returns_the_forces_of_a_run_with_two_wound_hinges_in_a_row(formulation) -> None:
    """The run's own accelerations ask for no force beside the springs, both wound beyond a revolution."""
    hinges = ParallelHinges(
        "toe", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0], offset=[0.05, 0, 0]
    )
    springs = [JointSpring("toe", stiffness=K), JointSpring("toe", stiffness=2.0 * K, coordinate=1)]
    scene = Scene("toe", Mechanism([Body.ground(), rod()], [hinges]), 0.2, 0.05, forces=springs)
    scene = start(scene, toe=[(8.0, 1.0), (-9.0, 0.0)])
    run = simulate(scene, formulation, rtol=1e-10, atol=1e-12)
    assert run.angle_names == ("toe.0", "toe.1")
    assert run.joint_angle[0] == pytest.approx([8.0, -9.0], abs=1e-9)
    assert run.potential_energy[0] == pytest.approx(0.5 * K * 64.0 + K * 81.0, rel=1e-9)
    step = 1e-5  # s: the error of the central difference of rates is 1e-7 of the largest
    fine = simulate(
        replace(scene, duration=2.0 * step, output_period=step), formulation, rtol=1e-12, atol=1e-14
    )
    rates = fine.joint("toe").rates
    accelerations = (rates[2] - rates[0]) / (2.0 * step)
    keys = {("toe", k): accelerations[k] for k in range(2)}
    forces = inverse_dynamics(scene, fine.state(1), keys).actuator_force
    assert np.allclose(forces, 0.0, rtol=0.0, atol=1e-6 * K * 9.0)


def test_statics_holds_a_wound_spring_with_its_weight() -> None:
    scene = spring_scene()
    for angle in (WOUND, -8.0, 1.0):
        held = statics(scene, wound(scene, angle), ["hinge"])
        assert held.actuator_force[0] == pytest.approx(torque(angle), abs=ROUND_OFF)
    started = start(scene, hinge=(WOUND, 0.0))
    assert statics(started, actuators=["hinge"]).actuator_force[0] == pytest.approx(torque(WOUND))


def test_poses_have_the_revolutions_of_their_goals() -> None:
    scene, angles = spring_scene(), np.array([WOUND, 1.0, -7.0])
    poses = solve_poses(scene, {"hinge": angles})
    assert np.allclose(statics(scene, poses, ["hinge"]).actuator_force[:, 0], torque(angles), atol=1e-9)
    for k, angle in enumerate(angles):
        assert poses.state(k).angles == {KEY: pytest.approx(angle, abs=1e-9)}
        assert statics(scene, poses.state(k), ["hinge"]).actuator_force[0] == pytest.approx(torque(angle))


def test_poses_without_a_goal_for_an_angle_have_it_within_half_a_revolution() -> None:
    scene = geared()
    poses = solve_poses(scene, {"hinge": [WOUND]}, start=initial_state(start(scene, follower=(3.0, 0.0))))
    held = statics(scene, poses, ["hinge", "follower"]).actuator_force
    assert np.allclose(held, [[K * WOUND, 2.0 * K * 3.0]], rtol=0.0, atol=1e-9)


def test_a_linear_model_has_the_spring_and_the_weight_at_the_wound_angle() -> None:
    scene = spring_scene()
    model = linearize(scene, wound(scene), inputs=["hinge"])
    stiffness = K - MASS * G * ARM * np.sin(WOUND)
    assert model.A[1, 0] == pytest.approx(-stiffness / J, rel=1e-9)
    assert model.B[1, 0] == pytest.approx(1.0 / J, rel=1e-9)
    assert model.f[1] == pytest.approx(-torque(WOUND) / J, rel=1e-9)


def test_a_wound_equilibrium_is_found_where_spring_and_weight_balance() -> None:
    """k x + m g l cos(x) = 0 has roots up to |x| = m g l / k only: a weaker spring has them wound."""
    weak = spring_scene(forces=[JointSpring("hinge", stiffness=0.03)])
    found = equilibrium(weak, wound(weak, 17.0)).angles[KEY]
    assert abs(found - 17.0) < np.pi
    assert 0.03 * found + MASS * G * ARM * np.cos(found) == pytest.approx(0.0, abs=1e-9)


def test_a_regulator_about_a_wound_angle_is_that_of_the_closed_form() -> None:
    """For J d'' = -s d + u Riccati's equation has k_p = -s + sqrt(s^2 + q_1/r), k_d^2 = 2 J k_p + q_2/r."""
    scene, q, r = spring_scene(), (2.0, 0.1), 0.5
    (law,) = lqr(scene, q, r, wound(scene), actuators=["hinge"])
    s = K - MASS * G * ARM * np.sin(WOUND)
    k_p = -s + np.sqrt(s**2 + q[0] / r)
    k_d = np.sqrt(2.0 * J * k_p + q[1] / r)
    assert law.gains[KEY] == pytest.approx((k_p, k_d), rel=1e-8)
    assert law.target == pytest.approx(WOUND, abs=ROUND_OFF)
    assert law.feedforward == pytest.approx(torque(WOUND), abs=ROUND_OFF)
    run = simulate(replace(start(scene, hinge=(WOUND + 0.1, 0.0)), control=(law,), duration=5.0))
    assert run.joint_angle[-1, 0] == pytest.approx(WOUND, abs=1e-3)  # the slowest mode is gone by e^-9


def test_control_laws_read_the_wound_angle() -> None:
    law = PD("hinge", target=WOUND, stiffness=2.0, damping=0.0)
    scene = spring_scene(arm=0.0, control=[law])
    run = simulate(start(scene, hinge=(WOUND, 0.0)))
    assert run.actuator_force[0, 0] == pytest.approx(0.0, abs=ROUND_OFF)


def test_sensitivities_by_a_wound_start() -> None:
    """Of x = x_0 cos(w t): dx/dx_0 = cos(w t), dV/dx_0 = k x_0 cos(w t)^2."""
    scene = start(spring_scene(arm=0.0), hinge=(WOUND, 0.0))
    by = sensitivities(scene, ["start.hinge"])
    c = np.cos(np.sqrt(K / 0.02) * by.run.time)
    assert np.allclose(by.joint("hinge").coordinates[:, 0, 0], c, rtol=0.0, atol=1e-6)
    assert np.allclose(by.potential_energy[:, 0], K * WOUND * c**2, rtol=0.0, atol=1e-6)
    assert np.allclose(by.run.joint("hinge").coordinates[:, 0], WOUND * c, rtol=0.0, atol=RUN)


def test_a_rest_case_has_the_angles_of_its_start() -> None:
    scene = start(spring_scene(control=[PD("hinge", 0.0, 0.0, 0.0)]), hinge=(WOUND, 0.0))
    case = newton_euler.rest_case(scene)
    assert case.actuator_force[0, 0] == pytest.approx(torque(WOUND), abs=ROUND_OFF)
    assert case.joint("hinge").coordinates[0, 0] == pytest.approx(WOUND, abs=ROUND_OFF)
    assert case.state(0).angles == {KEY: WOUND}
