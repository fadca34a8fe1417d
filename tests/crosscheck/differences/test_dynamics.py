"""Accelerations of described robots are those of MuJoCo and Pinocchio, with loops and couplings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from mujoco_robots import to_mujoco

import mjcf
import mjcf.robot
from crosscheck.differences.dynamics import Dynamics
from crosscheck.differences.joint_tree import size_of
from crosscheck.differences.vectors import rotation_matrix, rotation_vector
from newton_euler import initial_state
from newton_euler.equations.relative import Relative
from newton_euler.reading.robot import (
    FileBody,
    FileCoupling,
    FileJoint,
    FileLoop,
    JointKind,
    LoopKind,
    Placement,
    Robot,
)
from newton_euler.scalars import Array
from urdf.robot import describe

GRAVITY = np.array([0.0, 0.0, -9.81])

TREE = """
<mujoco model="model"><option gravity="1 -2 -9"><flag contact="disable"/></option>
<worldbody><body name="trunk" pos="0 0.1 1" euler="10 20 30"><freejoint name="free"/>
    <inertial pos=".1 .02 0" mass="2" diaginertia=".02 .03 .04" euler="20 30 10"/>
  <body name="arm" pos=".2 0 .1" euler="0 30 0">
    <joint name="a1" axis="1 2 0" pos=".01 .02 .03"
      damping=".3" armature=".02" stiffness="2" springref="40" ref="9"/>
    <joint name="a2" type="slide" axis="0 1 1" ref=".1"/>
    <inertial pos=".1 .02 0" mass="1" diaginertia=".002 .003 .004" euler="20 0 10"/>
    <body name="hand" pos=".2 0 .1" euler="0 30 0">
      <joint name="ball" type="ball" pos=".03 0 .1" damping=".1"/>
      <inertial pos=".1 .02 0" mass="1" diaginertia=".002 .003 .004" euler="20 0 10"/></body></body>
  <body name="leg" pos="-.2 0 .1"><joint name="l1" axis="0 0 1"/>
    <inertial pos=".1 .02 0" mass=".3" diaginertia=".002 .003 .004" euler="20 0 10"/></body>
</body></worldbody>
<actuator><motor name="m" joint="a1" gear="3"/>
  <position name="p" joint="l1" kp="2" kv=".3" gear="-2"/></actuator>
</mujoco>"""

GRIPPER = """
<mujoco><option jacobian="dense"><flag contact="disable"/></option>
<default><geom density="2700" size=".004"/><joint axis="0 1 0" damping=".01"/></default>
<worldbody><body name="palm"><joint name="lift" type="slide" axis="0 0 1" damping="5"/>
    <geom type="box" size=".05 .03 .01"/>
  <body name="driver" pos="-.03 0 0"><joint name="drive"/>
    <geom type="capsule" fromto="0 0 0 -.02 0 -.06"/>
    <body name="pad" pos="-.02 0 -.06"><joint name="knuckle"/>
      <geom type="capsule" fromto="0 0 0 .02 0 0"/></body>
  </body>
  <body name="follower" pos="-.01 0 0"><joint name="follow"/>
    <geom type="capsule" fromto="0 0 0 -.02 0 -.06"/></body>
  <body name="other" pos=".03 0 0"><joint name="mirror"/>
    <geom type="capsule" fromto="0 0 0 .02 .01 -.06"/></body>
</body></worldbody>
<equality><connect body1="pad" body2="follower" anchor=".02 0 0"/>
  <joint joint1="mirror" joint2="drive" polycoef="0 -1 .3 .1 0"/></equality>
</mujoco>"""


def random_states(dynamics: Dynamics, count: int, seed: int) -> tuple[Array, Array]:
    """Return coordinates and velocities that fulfill the constraints."""
    random = np.random.default_rng(seed)
    coordinates, error = dynamics.closed(0.5 * random.normal(size=(1, count, dynamics.size)))
    assert error.max() < 1e-12
    return coordinates, dynamics.admissible(coordinates, random.normal(size=coordinates.shape))


def test_tree_moves_as_in_mujoco() -> None:
    model = mujoco.MjModel.from_xml_string(TREE)
    data, robot = mujoco.MjData(model), mjcf.robot.describe(model).robot
    dynamics = Dynamics([robot], size_of(robot))
    coordinates, velocities = random_states(dynamics, 5, 0)
    controls = np.random.default_rng(1).normal(size=(1, 5, 2))
    driven = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    centers = np.array([[body.center for body in robot.bodies]])
    found = dynamics.accelerations(coordinates, velocities, controls, driven, centers)
    for k in range(5):
        data.qpos[:], data.qvel[:] = to_mujoco(model, robot, coordinates[0, k], velocities[0, k])
        data.ctrl[:] = controls[0, k]
        model.opt.disableflags = 0 if driven[k] else mujoco.mjtDisableBit.mjDSBL_ACTUATION
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        for body in range(model.nbody - 1):
            expected = np.zeros(6)
            mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_BODY, body + 1, expected, 0)
            turn = data.xmat[body + 1].reshape(3, 3)
            # MuJoCo counts the acceleration of a free fall as zero; 1e-10: round-off in inertias of 1e-3
            linear = turn @ found.linear[0, k, body] - model.opt.gravity
            assert linear == pytest.approx(expected[3:], abs=1e-10)
            assert turn @ found.angular[0, k, body] == pytest.approx(expected[:3], abs=1e-10)


def test_constrained_robot_moves_as_mujoco_with_rigid_constraints() -> None:
    model = mujoco.MjModel.from_xml_string(GRIPPER)
    data, robot = mujoco.MjData(model), mjcf.robot.describe(model).robot
    dynamics = Dynamics([robot], size_of(robot))
    coordinates, velocities = random_states(dynamics, 4, 2)
    points = np.zeros((1, len(robot.bodies), 3))
    found = dynamics.accelerations(coordinates, velocities, np.zeros((1, 4, 0)), np.ones(4), points)
    for k in range(4):
        qpos, qvel = coordinates[0, k], velocities[0, k]
        matrix = np.zeros((model.nv, model.nv))

        def jacobian(at: Array) -> Array:
            data.qpos[:], data.qvel[:] = at, qvel  # noqa: B023
            mujoco.mj_forward(model, data)
            return data.efc_J.reshape(data.nefc, model.nv).copy()

        step = 1e-6
        rate = (jacobian(qpos + step * qvel) - jacobian(qpos - step * qvel)) / (2 * step)
        rows = jacobian(qpos)
        assert np.abs(rows @ qvel).max() < 1e-12
        mujoco.mj_fullM(model, data, matrix)
        count = len(rows)
        system = np.block([[matrix, rows.T], [rows, np.zeros((count, count))]])
        right = np.concatenate([data.qfrc_passive - data.qfrc_bias, -rate @ qvel])
        expected = np.linalg.lstsq(system, right, rcond=1e-12)[0][: model.nv]
        # central differences of the Jacobian are exact to about 1e-10 of its rate
        assert found.coordinates[0, k] == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_loop_and_coupling_move_as_in_newton_euler() -> None:
    """The imported scene has other frames, coordinates and equations, and starts at the same state."""
    robot = mjcf.robot.describe(mujoco.MjModel.from_xml_string(GRIPPER)).robot
    dynamics = Dynamics([robot], size_of(robot))
    coordinates, velocities = random_states(dynamics, 1, 2)
    qpos, qvel = (" ".join(map(repr, each[0, 0].tolist())) for each in (coordinates, velocities))
    start = f'<keyframe><key qpos="{qpos}" qvel="{qvel}"/></keyframe></mujoco>'
    scene = mjcf.read(mujoco.MjModel.from_xml_string(GRIPPER.replace("</mujoco>", start))).scene
    system = Relative(scene)
    expected = system.evaluate(*system.coordinates(initial_state(scene)))
    names = [body.name for body in scene.mechanism.bodies]
    centers = np.array([[body.center for body in robot.bodies]])
    found = dynamics.accelerations(coordinates, velocities, np.zeros((1, 1, 0)), np.ones(1), centers)
    turns = dynamics.kinematics(coordinates, velocities).rotation[0, 0]
    for k, body in enumerate(robot.bodies):
        number = names.index(body.name)
        # round-off at 20 m/s^2 and 1e3 rad/s^2
        linear, angular = turns[k] @ found.linear[0, 0, k], turns[k] @ found.angular[0, 0, k]
        assert linear == pytest.approx(expected.linear_acceleration[number], abs=1e-11)
        assert angular == pytest.approx(expected.angular_acceleration[number], abs=1e-9)


def two_chains(kind: LoopKind, length: float = 0.0, couplings: tuple[FileCoupling, ...] = ()) -> Robot:
    """Describe two chains on the ground, each with slides and a ball, that a loop of a kind connects."""
    random = np.random.default_rng(5)

    def turned() -> Array:
        return rotation_matrix(random.normal(size=3))

    bodies = []
    for chain in range(2):
        for k in range(3):
            joints = [
                FileJoint(f"hinge{chain}{k}", JointKind.HINGE, turned()[0], 0.1 * random.normal(size=3))
            ]
            if k == 0:
                joints.insert(0, FileJoint(f"slide{chain}", JointKind.SLIDE, turned()[0], np.zeros(3)))
            if k == 1:
                joints = [FileJoint(f"ball{chain}", JointKind.BALL, np.zeros(3), 0.1 * random.normal(size=3))]
            place = Placement(0.2 * random.normal(size=3), turned())
            parent = len(bodies) - 1 if k else -1
            inertia = 0.01 * np.eye(3) + 0.004 * np.diag(random.uniform(size=3))
            bodies.append(
                FileBody(
                    f"{chain}{k}", parent, place, tuple(joints), 1.0, 0.1 * random.normal(size=3), inertia
                )
            )
    frames = (
        Placement(0.1 * random.normal(size=3), turned()),
        Placement(0.1 * random.normal(size=3), turned()),
    )
    return Robot(
        "chains", tuple(bodies), (FileLoop("loop", kind, 2, 5, *frames, length),), couplings, gravity=GRAVITY
    )


@pytest.mark.parametrize("kind", LoopKind)
def test_constraint_rows_are_derivatives_of_the_residual(kind: LoopKind) -> None:
    polynomial = FileCoupling("coupling", "hinge10", "hinge00", (0.1, -0.7, 0.3, 0.2))
    robot = two_chains(kind, 0.4, (polynomial, FileCoupling("held", "slide1", "", (0.05,))))
    dynamics = Dynamics([robot], 0.3)
    coordinates, velocities = random_states(dynamics, 3, 1)

    def at(time: float) -> tuple[Array, Array]:
        """Return the residual and its rate after a motion with these velocities."""
        after = dynamics.moved(coordinates, time * velocities)
        found = dynamics.constraints(after, velocities, dynamics.kinematics(after, velocities))
        return found.residual, np.einsum("...ij,...j->...i", found.jacobian, velocities)

    step = 1e-4
    (before, rate_before), (after, rate_after) = at(-step), at(step)
    found = dynamics.constraints(coordinates, velocities, dynamics.kinematics(coordinates, velocities))
    rows = {LoopKind.POINT: 3, LoopKind.WELD: 6, LoopKind.HINGE: 5, LoopKind.SLIDE: 5, LoopKind.ROD: 1}[kind]
    assert found.residual.shape == (1, 3, rows + 2)
    # the third derivatives, of size 10, times step^2
    assert (after - before) / (2 * step) == pytest.approx(at(0.0)[1], abs=1e-6)
    assert (rate_after - rate_before) / (2 * step) == pytest.approx(found.bias, abs=1e-6)
    # the Jacobian in other directions than admissible ones
    other = np.random.default_rng(3).normal(size=velocities.shape)
    ahead, behind = (dynamics.moved(coordinates, s * step * other) for s in (1, -1))
    difference = (
        dynamics.constraints(ahead, other, dynamics.kinematics(ahead, other)).residual
        - dynamics.constraints(behind, other, dynamics.kinematics(behind, other)).residual
    ) / (2 * step)
    assert difference == pytest.approx(np.einsum("...ij,...j->...i", found.jacobian, other), abs=1e-6)


@pytest.mark.parametrize(
    ("kind", "contact"),
    [(LoopKind.POINT, pin.ContactType.CONTACT_3D), (LoopKind.WELD, pin.ContactType.CONTACT_6D)],
)
def test_loops_move_as_in_pinocchio(kind: LoopKind, contact: pin.ContactType) -> None:
    robot = two_chains(kind)
    dynamics = Dynamics([robot], 0.3)
    model = pin.Model()
    joints = []
    for body in robot.bodies:
        placement = pin.SE3(body.placement.rotation, body.placement.position)
        parent = 0
        if body.parent >= 0:
            parent = joints[body.parent]
            placement = pin.SE3(np.eye(3), -robot.bodies[body.parent].joints[-1].point) * placement
        for joint in body.joints:
            # the point of the joint is the origin of Pinocchio's frame
            placement = placement * pin.SE3(np.eye(3), joint.point)
            of_kind = {
                JointKind.HINGE: lambda axis: pin.JointModelRevoluteUnaligned(axis),
                JointKind.SLIDE: lambda axis: pin.JointModelPrismaticUnaligned(axis),
                JointKind.BALL: lambda axis: pin.JointModelSpherical(),
            }[joint.kind]
            parent = model.addJoint(parent, of_kind(joint.axis), placement, joint.name)
            placement = pin.SE3(np.eye(3), -joint.point)
        joints.append(parent)
        model.appendBodyToJoint(parent, pin.Inertia(body.mass, body.center, body.inertia), placement)
    loop = robot.loops[0]
    ends = [
        pin.SE3(frame.rotation, frame.position - robot.bodies[index].joints[-1].point)
        for index, frame in ((loop.first, loop.first_frame), (loop.second, loop.second_frame))
    ]
    constraint = pin.RigidConstraintModel(
        contact, model, joints[loop.first], ends[0], joints[loop.second], ends[1], pin.ReferenceFrame.LOCAL
    )
    constraints = pin.StdVec_RigidConstraintModel()
    constraints.append(constraint)
    data = model.createData()
    datas = pin.StdVec_RigidConstraintData()
    datas.append(constraint.createData())
    pin.initConstraintDynamics(model, data, constraints, datas)
    coordinates, velocities = random_states(dynamics, 3, 4)
    points = np.zeros((1, len(robot.bodies), 3))
    found = dynamics.accelerations(coordinates, velocities, np.zeros((1, 3, 0)), np.ones(3), points)
    for k in range(3):
        q = []
        start = 0
        for body in robot.bodies:
            for joint in body.joints:
                if joint.kind is JointKind.BALL:
                    q.extend(pin.Quaternion(pin.exp3(coordinates[0, k, start : start + 3])).coeffs())
                    start += 3
                else:
                    q.append(coordinates[0, k, start])
                    start += 1
        settings = pin.ProximalSettings(1e-14, 1e-12, 20)
        expected = pin.constraintDynamics(
            model, data, np.array(q), velocities[0, k], np.zeros(model.nv), constraints, datas, settings
        )
        # Pinocchio's proximal iterations end at 1e-10
        assert found.coordinates[0, k] == pytest.approx(expected, rel=1e-8, abs=1e-8)


def test_urdf_moves_as_in_pinocchio() -> None:
    """The tree of a URDF with fixed links, without its loops."""
    path = Path(__file__).parents[3] / "urdf/tracker.urdf"
    robot = replace(describe(path).robot, loops=(), couplings=(), gravity=GRAVITY)
    dynamics = Dynamics([robot], size_of(robot))
    coordinates, velocities = random_states(dynamics, 3, 6)
    points = np.zeros((1, len(robot.bodies), 3))
    found = dynamics.accelerations(coordinates, velocities, np.zeros((1, 3, 0)), np.ones(3), points)
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    joints = [joint for body in robot.bodies for joint in body.joints]
    order = [model.joints[model.getJointId(joint.name)].idx_v for joint in joints]
    assert len(order) == model.nv == model.nq == dynamics.size
    damping = np.array([joint.damping for joint in joints])
    for k in range(3):
        q, v, force = np.zeros(model.nv), np.zeros(model.nv), np.zeros(model.nv)
        q[order], v[order] = coordinates[0, k], velocities[0, k]
        force[order] = -damping * velocities[0, k]
        expected = pin.aba(model, data, q, v, force)[order]
        # round-off times the condition of the mass matrix, 1e4
        assert found.coordinates[0, k] == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_rotation_vectors() -> None:
    vectors = np.random.default_rng(0).normal(size=(50, 3))
    vectors *= np.linspace(0, np.pi - 1e-9, 50)[:, None] / np.linalg.norm(vectors, axis=-1, keepdims=True)
    for vector in vectors:
        assert rotation_matrix(vector) == pytest.approx(pin.exp3(vector), abs=1e-14)
    # round-off of 1e-16 in the matrix
    assert rotation_vector(rotation_matrix(vectors)) == pytest.approx(vectors, abs=1e-14)


def test_double_pendulum_by_hand() -> None:
    """Two point masses of 2 and 3 kg on rods of 0.5 and 0.8 m, released at rest with both rods level."""
    m1, m2, l1, l2 = 2.0, 3.0, 0.5, 0.8
    hinge = (FileJoint("h", JointKind.HINGE, np.array([0.0, 1.0, 0.0]), np.zeros(3)),)
    bodies = (
        FileBody(
            "one", -1, Placement(np.zeros(3), np.eye(3)), hinge, m1, np.array([l1, 0, 0]), np.zeros((3, 3))
        ),
        FileBody(
            "two",
            0,
            Placement(np.array([l1, 0, 0]), np.eye(3)),
            hinge,
            m2,
            np.array([l2, 0, 0]),
            np.zeros((3, 3)),
        ),
    )
    dynamics = Dynamics([Robot("pendulum", bodies, gravity=GRAVITY)], 1.0)
    rest = np.zeros((1, 1, 2))
    found = dynamics.accelerations(rest, rest, np.zeros((1, 1, 0)), np.ones(1), np.zeros((1, 2, 3)))
    # inertias and moments of gravity about the two hinges
    matrix = [[m1 * l1**2 + m2 * (l1 + l2) ** 2, m2 * (l1 + l2) * l2], [m2 * (l1 + l2) * l2, m2 * l2**2]]
    force = 9.81 * np.array([m1 * l1 + m2 * (l1 + l2), m2 * l2])
    assert found.coordinates[0, 0] == pytest.approx(np.linalg.solve(matrix, force), rel=1e-12)


def test_joints_that_together_move_no_mass_rest() -> None:
    """Two hinges with one axis, and a link without mass between: the arm falls like one on a single hinge."""
    hinges = (FileJoint(name, JointKind.HINGE, np.array([0.0, 1.0, 0.0]), np.zeros(3)) for name in ("a", "b"))
    bodies = tuple(
        FileBody(
            name, parent, Placement(np.zeros(3), np.eye(3)), (hinge,), mass, center, 0.005 * mass * np.eye(3)
        )
        for name, parent, mass, center, hinge in zip(
            ("link", "arm"), (-1, 0), (0.0, 2.0), np.array([[0.0] * 3, [0.1, 0.0, 0.0]]), hinges, strict=True
        )
    )
    dynamics = Dynamics([Robot("arm", bodies, gravity=GRAVITY)], 0.3)
    points = np.array([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]])
    states, still = np.zeros((1, 1, 2)), np.zeros((1, 1, 0))
    found = dynamics.accelerations(states, states, still, np.zeros(1, bool), points)
    # m g l / (I + m l^2) l downwards at the center of mass
    assert np.allclose(found.linear[0, 0, 1], [0.0, 0.0, -9.81 * 0.1**2 / (0.005 + 0.1**2)], atol=1e-12)
