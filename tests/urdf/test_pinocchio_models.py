"""Pinocchio models in memory with their constraints: read, verified, and run as Pinocchio runs them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import newton_euler
import urdf
from newton_euler import NewtonEulerError
from newton_euler.model.euler_parameters import rotation
from newton_euler.reading.activity import Bounds
from newton_euler.scalars import Array
from urdf.reading.given import KNOWN_JOINT_MODELS

Q = np.array([-1.2, 0.9, -1.5])
"""rad, near to where the four-bar is closed."""


def at(*place: float) -> Any:
    return pin.SE3(np.eye(3), np.array(place))


def bar(length: float) -> Any:
    """A slender bar of 1 kg along x."""
    return pin.Inertia(1.0, np.array([length / 2.0, 0.0, 0.0]), np.diag([1e-4, *[length**2 / 12.0] * 2]))


def chain(*joints: tuple[Any, Any, str, int, Any]) -> Any:
    """A model of bodies that hang on (joint, inertia, name, parent, placement)."""
    model = pin.Model()
    for joint, inertia, name, parent, placement in joints:
        model.appendBodyToJoint(model.addJoint(parent, joint, placement, name), inertia, pin.SE3.Identity())
    return model


@pytest.fixture
def four_bar() -> tuple[Any, list[Any]]:
    """Crank, coupler and rocker with a damper and a rotor, and the ball at which coupler and rocker meet."""
    hinge = pin.JointModelRY()
    model = chain(
        (hinge, bar(0.2), "crank", 0, at(0.0, 0.0, 0.0)),
        (hinge, bar(0.4), "coupler", 1, at(0.2, 0.0, 0.0)),
        (hinge, bar(0.3), "rocker", 0, at(0.4, 0.0, 0.0)),
    )
    model.name, model.armature, model.damping = "four_bar", np.array([0.01, 0.0, 0.0]), np.array([0, 0.1, 0])
    ends = (model, 2, at(0.4, 0.0, 0.0), 3, at(0.3, 0.0, 0.0))
    tip = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, *ends, pin.ReferenceFrame.LOCAL)
    tip.name = "tip"
    return model, [tip]


def pinocchio_run(model: Any, constraints: list[Any], q: Array, duration: float) -> list[Any]:
    """Placements of all joints after Pinocchio's own constrained dynamics from rest."""
    data, several = model.createData(), pin.StdVec_RigidConstraintModel(constraints)
    datas = pin.StdVec_RigidConstraintData([each.createData() for each in constraints])
    pin.initConstraintDynamics(model, data, several, datas)
    settings = pin.ProximalSettings(1e-14, 1e-10, 20)

    def rates(t: float, y: Array) -> Array:
        now, v = pin.integrate(model, q, y[: model.nv]), y[model.nv :]
        tau = -model.damping * v
        return np.concatenate([v, pin.constraintDynamics(model, data, now, v, tau, several, datas, settings)])

    found = solve_ivp(rates, (0.0, duration), np.zeros(2 * model.nv), "DOP853", rtol=1e-10, atol=1e-12)
    pin.forwardKinematics(model, data, pin.integrate(model, q, found.y[: model.nv, -1]))
    return list(data.oMi)[1:]


def test_a_scene_moves_as_pinocchio_moves_the_model(four_bar):
    model, constraints = four_bar
    reading = urdf.read(four_bar, q=Q, duration=0.5)
    scene = reading.scene
    assert scene.name == "four_bar"
    assert scene.mechanism.body_names == ("ground", "crank", "coupler", "rocker")
    assert scene.mechanism.joint_names == ("crank", "coupler", "rocker", "tip")
    start = reading.report.references[0][0].start
    run = newton_euler.simulate(scene)
    for k, pose in enumerate(pinocchio_run(model, constraints, start, 0.5), start=1):
        center = pose.act(model.inertias[k].lever)
        # both runs to rtol 1e-10, over some hundred steps
        np.testing.assert_allclose(run.position[-1, k], center, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(rotation(run.quaternion[-1, k]), pose.rotation, rtol=0.0, atol=1e-7)


def test_anchors_are_rigid_constraints(four_bar):
    model, (tip,) = four_bar
    ends = tip.joint1_id, tip.joint1_placement, tip.joint2_id, tip.joint2_placement
    for anchor, kind in (
        (pin.PointAnchorConstraintModel, "spherical"),
        (pin.FrameAnchorConstraintModel, "fixed"),
    ):
        found = anchor(model, *ends)
        found.name = "tip"
        if kind == "fixed":  # the bodies are held as they are at the start
            found = anchor(model, 3, at(0.3, 0.0, 0.0))
        joint = urdf.read((model, [found]), q=Q).scene.mechanism.joints[-1]
        assert (joint.name, joint.kind) == ("tip" if kind == "spherical" else "constraint_1", kind)


def test_a_model_is_left_as_it_was(four_bar):
    before = four_bar[0].saveToString()
    urdf.read(four_bar, q=Q, gravity=[0.0, 0.0, -1.62])
    assert four_bar[0].saveToString() == before


def test_gravity_and_start_are_the_models_own_unless_others_are_given():
    model = chain((pin.JointModelRY(), bar(1.0), "swing", 0, at(0.0, 0.0, 0.0)))
    model.gravity.linear = np.array([0.0, 0.0, -3.7])
    found = urdf.read(model)
    assert found.scene.gravity.tolist() == [0.0, 0.0, -3.7]
    np.testing.assert_array_equal(found.scene.mechanism.body("swing").center_of_mass, [0.5, 0.0, 0.0])
    moon = urdf.read(model, gravity=(0.0, 0.0, -1.62), q=[0.5]).scene
    assert moon.gravity.tolist() == [0.0, 0.0, -1.62]
    center = [0.5 * np.cos(0.5), 0.0, -0.5 * np.sin(0.5)]
    np.testing.assert_allclose(moon.mechanism.body("swing").center_of_mass, center, atol=1e-16)


AXIS = np.array([0.6, 0.0, 0.8])


def continuous() -> Any:
    """A joint whose axis Python cannot set, of a URDF."""
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
    )
    text += '<child link="b"/><axis xyz="0.6 0 0.8"/></joint></robot>'
    return pin.buildModelFromXML(text).joints[1]


MADE: dict[str, Callable[[], Any]] = {
    "RevoluteUnaligned": lambda: pin.JointModelRevoluteUnaligned(AXIS),
    "RevoluteUnboundedUnaligned": continuous,
    "PrismaticUnaligned": lambda: pin.JointModelPrismaticUnaligned(AXIS),
    "Universal": lambda: pin.JointModelUniversal(np.eye(3)[0], np.eye(3)[1]),
}
"""Joints that have to be told their axes."""


@pytest.mark.parametrize("kind", KNOWN_JOINT_MODELS)
def test_joint_kinds_are_verified_from_other_places_than_neutral(kind):
    joint = MADE.get(kind, getattr(pin, f"JointModel{kind}"))()
    turn = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.5), np.array([0.1, 0.2, 0.3]))
    model = chain((joint, bar(0.4), "first", 0, turn), (pin.JointModelRX(), bar(0.3), "second", 1, turn))
    q = pin.integrate(model, pin.neutral(model), np.linspace(0.2, 0.6, model.nv))
    assert model.joints[1].shortname() == f"JointModel{kind}"
    assert "verified against the file's own model" in urdf.read(model, q=q).report.start[-1]


def test_a_constraint_at_the_default_placement_holds_where_it_starts():
    model = chain(
        (pin.JointModelFreeFlyer(), bar(0.4), "base", 0, at(0.0, 0.0, 0.0)),
        (pin.JointModelRY(), bar(0.5), "leg", 1, at(0.1, 0.0, 0.0)),
    )
    foot = pin.RigidConstraintModel(pin.ContactType.CONTACT_6D, model, 2, at(0.5, 0.0, 0.0))
    q = np.array([0.0, 0.0, 0.7, 0.0, 0.0, 0.0, 1.0, 1.2])
    found = urdf.read((model, [foot]), q=q)
    assert "all loops closed" in found.report.start[0]
    assert found.scene.mechanism.joints[-1].name == "constraint_1"
    assert found.scene.mechanism.joints[-1].kind == "fixed"


def test_limits_and_friction_are_reported_and_watched(four_bar):
    model, _ = four_bar
    model.upperPositionLimit, model.lowerPositionLimit = np.full(3, 2.0), np.full(3, -2.0)
    model.friction = np.array([0.2, 0.0, 0.0])
    report = urdf.read(four_bar, q=Q).report
    left = [str(each) for each in report.of("left out")]
    assert left[0] == "joint 'crank': left out: its dry friction 0.2"
    assert left[1].startswith("joint 'crank': left out: its limits -2 to 2: ")
    assert sum(isinstance(watch, Bounds) for watches in report.watches.values() for watch in watches) == 3


def composite() -> Any:
    joint = pin.JointModelComposite(pin.JointModelRX())
    joint.addJoint(pin.JointModelRY())
    return joint


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m, c: (m, 3), "pinocchio.Model or a pair of one and its RigidConstraintModels"),
        (
            lambda m, c: (m, c, 3),
            "needed: a path of a file, a pinocchio.Model or a pair of one and its Rigid",
        ),
        (
            lambda m, c: (m, [*c, None]),
            "four_bar': constraint 1 is a NoneType; needed: a RigidConstraintModel",
        ),
        (
            lambda m, c: chain((composite(), bar(1.0), "wrist", 0, at(0.0, 0.0, 0.0))),
            "pinocchio.Model: joint 'wrist' is a JointModelComposite; needed: one of RX, RY, ",
        ),
        (lambda m, c: pin.Model(), "pinocchio.Model: no joint can move"),
        (
            lambda m, c: chain((pin.JointModelRX(), pin.Inertia.Zero(), "air", 0, at(0.0, 0.0, 0.0))),
            "pinocchio.Model: no joint moves any mass",
        ),
    ],
)
def test_what_cannot_be_read_is_named(change, message, four_bar):
    with pytest.raises(NewtonEulerError, match=message):
        urdf.read(change(*four_bar))


def test_options_of_files_are_not_of_models(four_bar, tmp_path):
    for options, message in (
        ({"q": [0.0, np.nan, 0.0]}, r"q\[1\] is nan; needed: a finite number"),
        ({"q": [0.0]}, r"q has shape \(1,\), or"),
        ({"loops": "loops.yaml"}, "loops is 'loops.yaml'; needed: no loops for a model in memory"),
        ({"base": "free"}, "base is 'free'; needed: no base for a model in memory"),
        ({"base": "floating"}, "unknown base 'floating'"),
    ):
        with pytest.raises(NewtonEulerError, match=message):
            urdf.read(four_bar, **options)
    with pytest.raises(NewtonEulerError, match="needed: no q for a URDF"):
        urdf.read(tmp_path / "robot.urdf", q=[0.0])


def test_constraints_with_offsets_and_broken_placements_are_named(four_bar):
    model, (tip,) = four_bar
    tip.desired_contact_placement = at(0.0, 0.0, 0.1)
    with pytest.raises(NewtonEulerError, match="constraint 0 has a desired offset; needed: none"):
        urdf.read(four_bar)
    broken = pin.SE3(2.0 * np.eye(3), np.zeros(3))
    anchor = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, 1, broken)
    with pytest.raises(NewtonEulerError, match="constraint 0 has a placement that is no rotation"):
        urdf.read((model, [anchor]))


@pytest.mark.parametrize(
    ("field", "topics"),
    [
        ("rotorInertia", {"rotor"}),
        ("friction", {"dry friction"}),
        ("upperDryFrictionLimit", {"dry friction"}),
        ("damping", set()),
        ("armature", set()),
    ],
)
def test_every_number_of_a_joint_is_in_the_report(field: str, topics: set[str]) -> None:
    model = pin.buildSampleModelManipulator()
    values = np.zeros(model.nv)
    values[2] = 0.3
    setattr(model, field, values)
    scene, report = (found := urdf.read(model)).scene, found.report
    name = str(model.names[3])
    own = [entry for entry in report.entries if entry.element == f"joint {name!r}"]
    found_topics = {entry.topic for entry in own if entry.is_unsimulated}
    assert {topic for topic in found_topics if not topic.startswith("limit")} == topics
    if not topics:
        element = scene.forces[0].damping if field == "damping" else scene.armatures[0].inertia
        assert element == 0.3


def test_a_rotor_is_reported_with_the_square_of_its_gear_ratio() -> None:
    model = pin.buildSampleModelManipulator()
    model.rotorInertia, model.rotorGearRatio = 0.3 * np.eye(model.nv)[2], np.full(model.nv, 2.0)
    (rotor,) = [entry for entry in urdf.read(model).report.entries if entry.topic == "rotor"]
    assert rotor.element == f"joint {str(model.names[3])!r}"
    assert rotor.is_unsimulated
    assert "1.2" in rotor.how  # 0.3 times 2 squared, kg m^2
