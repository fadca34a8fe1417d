"""Reading MJCF: against MuJoCo's own model of the file, element by element, and what reports say."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjcf_models import ELEMENTS, FLOATING, FOUR_BARS, PAIR, arm, model, reading, verified

from mjcf import read
from mjcf.errors import MjcfError
from mjcf.model import MujocoScene
from mjcf.reader import Reading
from mjcf.reading.joints import GearGroups
from newton_euler import NewtonEulerError
from newton_euler.compiled.formulations import FORMULATIONS, formulate
from newton_euler.model.compound_joint import Compound
from newton_euler.model.couplings import Gear
from newton_euler.model.joint_kinds import (
    Cylindrical,
    Fixed,
    Free,
    Prismatic,
    Revolute,
    Rod,
    Spherical,
    Universal,
)
from newton_euler.runs.assemble import initial_state


@pytest.mark.parametrize("name", ELEMENTS)
def test_readings_are_verified(name: str, tmp_path: Path) -> None:
    found = reading(tmp_path, ELEMENTS[name])
    assert verified(found)
    for formulation in FORMULATIONS:
        system = formulate(found.scene, formulation)
        evaluation = system.evaluate(*system.coordinates(initial_state(found.scene)))
        assert np.all(np.isfinite(evaluation.linear_acceleration))


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("hinge", {Revolute}),
        ("slide", {Revolute, Prismatic}),
        ("ball", {Revolute, Spherical}),
        ("fixed", {Revolute}),
        ("free", {Free, Revolute}),
        ("universal", {Revolute, Universal}),
        ("cylindrical", {Revolute, Cylindrical}),
        ("planar", {Revolute, Compound}),
        ("weld of sites", {Free, Revolute, Fixed}),
        ("connect to the world", {Free, Revolute, Spherical}),
        ("rod", {Revolute, Compound, Rod}),
    ],
)
def test_kinds_of_joints(name: str, kinds: set[type], tmp_path: Path) -> None:
    joints = reading(tmp_path, ELEMENTS[name]).scene.mechanism.joints
    assert {type(joint) for joint in joints} == kinds


def test_a_control_law_has_the_target_and_the_gains_of_the_file(tmp_path: Path) -> None:
    scene = reading(tmp_path, ELEMENTS["actuators"]).scene
    laws = {(law.joint, law.coordinate): law for law in scene.control}
    # gear 3, control 5 clamped to 1; and gain 2 of 0.3, bias 0.5 - 3 q - 0.1 dq/dt; q = 0.2 at the start
    first = laws["p", 0]
    assert (first.stiffness, first.damping) == pytest.approx((3.0, 0.1))
    assert first.force(0.0, 0.0, 0.0) == pytest.approx(3.0 + 0.6 + 0.5 - 0.6)
    # gear 0.5: g (kp ctrl - kp g q) at q = -0.3
    assert laws["two_joints", 1].force(0.0, 0.0, 0.0) == pytest.approx(0.5 * (20 * 0.4 - 20 * 0.5 * -0.3))


def test_an_open_start_is_closed_and_reported(tmp_path: Path) -> None:
    key = '<keyframe><key name="bent" qpos="0.3 -0.2 0.1"/></keyframe></mujoco>'
    found = reading(tmp_path, FOUR_BARS["cut at C by a connect"].replace("</mujoco>", key))
    first, second, *_ = found.report.start
    assert first.startswith("open at bent, in m or rad: equality 'c' 0.")
    assert "assembled next to bent: closed to" in second
    assert verified(found)
    other = reading(tmp_path, FOUR_BARS["cut at C by a connect"].replace("</mujoco>", key), key="qpos0")
    assert other.report.start[0] == "starts from qpos0: all loops closed, to 0.0e+00 m or rad"


ELBOW = FOUR_BARS["cut at C by a connect"].replace("</mujoco>", "<keyframe>{0}</keyframe></mujoco>")
UP, DOWN, ACROSS = "0.02 0.01 0", "0.02 1.55 -2.0", "-0.5 -1.2 0.5"


def test_each_keyframe_is_assembled_the_way_its_elbow_bends(tmp_path: Path) -> None:
    keys = (("up", UP), ("down", DOWN), ("across", ACROSS))
    text = ELBOW.format("".join(f'<key name="{name}" qpos="{qpos}"/>' for name, qpos in keys))
    up, down, across = (reading(tmp_path, text, key=name) for name, _ in keys)

    def bend(found: Reading) -> float:
        """Of the coupler against the rocker: no longer positive beyond where they are in line."""
        data, body = found.start.data, found.start.model.body("coupler").id
        b, c = data.xpos[body], data.xpos[body] + data.xmat[body].reshape(3, 3) @ [0.8, 0.0, 0.3]
        return float(np.cross(c - b, [1.0, 0.0, 0.0] - c)[1])

    assert np.max(np.abs(up.start.data.qpos - [float(x) for x in UP.split()])) < 0.05
    assert np.max(np.abs(down.start.data.qpos - [float(x) for x in DOWN.split()])) < 0.1
    assert bend(up) * bend(down) < 0.0
    assert "open at across, in m or rad: equality 'c' 1.75" in across.report.start


def test_velocities_of_a_keyframe(tmp_path: Path) -> None:
    text = model(PAIR, '<keyframe><key qvel="1 2 3"/></keyframe>')
    scene = reading(tmp_path, text).scene
    assert initial_state(scene).angular_velocity[1:] == pytest.approx(np.array([[0, 1, 0], [0, 2, 0]]))


def test_what_is_left_out(tmp_path: Path) -> None:
    text = model(
        PAIR.replace('name="p"', 'name="p" range="-1 1" limited="true" frictionloss="0.2"'),
        "<equality>"
        '<connect name="off" active="false" body1="one" body2="two" anchor="0 0 0"/></equality>'
        '<tendon><fixed name="sum" stiffness="2"><joint joint="p" coef="1"/><joint joint="r" coef="1"/>'
        '</fixed></tendon><actuator><muscle name="pull" joint="p" lengthrange="0 1"/></actuator>'
        "<sensor><clock/></sensor>",
    )
    report = reading(tmp_path, text).report
    lines = [str(entry) for entry in report.of("left out")]
    for expected in (
        "equality 'off': left out: active=",
        "joint 'p': left out: its limits",
        "joint 'p': left out: its dry friction 0.2",
        "tendon 'sum': left out: its stiffness 2",
        "actuator 'pull': left out: its gain has the type muscle",
        "2 geoms that can touch: left out",
        "1 sensors: left out",
    ):
        assert any(line.startswith(expected) for line in lines), expected


def test_names_that_are_not_for_scenes(tmp_path: Path) -> None:
    text = model(PAIR.replace('"one"', '"robot/left foot"').replace('"p"', '"é 1"').replace('name="two"', ""))
    mechanism = reading(tmp_path, text).scene.mechanism
    assert mechanism.body_names == ("ground", "robot_left_foot", "body_2")
    assert mechanism.joint_names == ("__1", "body_2_joints")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (model(""), "no body can move"),
        (
            model(arm('<joint name="x" axis="1 0 0"/><joint name="y" axis="1 0 0" pos="0.1 0 0"/>')),
            "joint 'lower_joints': its hinges",
        ),
        (
            model(arm('<joint type="slide"/><joint axis="0 1 0"/><joint type="slide" axis="1 0 0"/>')),
            "body 'lower': has slides between its hinges",
        ),
        (
            ELEMENTS["connect of sites"].replace("-0.5 0 0", "-0.5 3 0"),
            "equality 0 cannot be closed from qpos0: open by",
        ),
    ],
)
def test_what_cannot_be_read(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(MjcfError) as caught:
        reading(tmp_path, text)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / "model.xml"))


TIED = model(
    PAIR,
    '<tendon><fixed name="t" stiffness="30" damping="2" springlength="0.2" armature="0.4">'
    '<joint joint="p" coef="2"/><joint joint="q" coef="-0.5"/></fixed></tendon>'
    '<equality><joint joint1="p" joint2="q" polycoef="0 -1.5 0 0 0"/></equality>'
    '<actuator><position tendon="t" kp="40" kv="3" gear="2" armature="0.01"/></actuator>'
    '<keyframe><key qpos="0.3 -0.2 0.1" ctrl="0.5"/></keyframe>',
)


OPPOSED = TIED.replace('coef="2"', 'coef="1"').replace('coef="-0.5"', 'coef="2"').replace("-1.5", "-1.2")


def test_gains_of_a_tendon_of_tied_joints_are_not_negative(tmp_path: Path) -> None:
    """A law on the joint that leads, where one on each of them would have damping below 0."""
    found = reading(tmp_path, OPPOSED)
    assert verified(found)
    (law,) = found.scene.control
    # p = -1.2 q, so that the actuator's length is 2 (p + 2 q) = 2 (1 - 2 / 1.2) p
    slope = 2.0 * (1.0 - 2.0 / 1.2)
    assert (law.joint, law.coordinate) == ("p", 0)
    assert (law.stiffness, law.damping) == pytest.approx((40.0 * slope**2, 3.0 * slope**2))
    MujocoScene(found.scene)
    # a joint with a limit keeps its own share, to be watched
    limited = reading(tmp_path, OPPOSED.replace('name="q"', 'name="q" actuatorfrcrange="-9 9"'))
    assert verified(limited)
    own = {law.joint: law.stiffness for law in limited.scene.control}
    assert own == pytest.approx({"p": 40.0 * 2.0 * slope, "two_joints": 40.0 * 4.0 * slope * -1.2})


def test_a_tendon_that_equalities_keep_does_no_work(tmp_path: Path) -> None:
    kept = OPPOSED.replace('polycoef="0 -1.2', 'polycoef="0 -2')
    found = reading(tmp_path, kept)
    assert verified(found)
    assert not found.scene.control
    (entry,) = (entry for entry in found.report.of("left out") if entry.element == "actuator 0")
    assert str(entry) == "actuator 0: left out: equalities keep its length constant, so that it does no work"


def test_springs_of_a_joint_and_of_a_tendon_add_up(tmp_path: Path) -> None:
    """Also through a gear: 30 at 2 p - 0.5 q = 0.2, with p = -1.5 q, and 7 at p = 20 degrees."""
    own = TIED.replace('name="p"', 'name="p" stiffness="7" damping="5" springref="20"')
    found = reading(tmp_path, own)
    assert verified(found)
    (spring,) = (force for force in found.scene.forces if force.joint == "p")
    slope = 2.0 + 0.5 / 1.5
    assert spring.stiffness == pytest.approx(7.0 + 30.0 * slope**2)
    assert spring.damping == pytest.approx(5.0 + 2.0 * slope**2)
    p, q = found.start.data.qpos[:2]
    pull = 30.0 * slope * (2.0 * p - 0.5 * q - 0.2) + 7.0 * (p - np.radians(20.0))
    assert spring.stiffness * spring.rest == pytest.approx(-pull)


def test_springs_and_actuators_on_joints_that_a_gear_ties(tmp_path: Path) -> None:
    """A sum of joint coordinates of which one tells the others needs no left-out line."""
    found = reading(tmp_path, TIED)
    assert verified(found)
    assert not [e for e in found.report.of("left out") if e.element.startswith(("tendon", "actuator"))]


def test_an_actuator_on_a_sum_of_independent_joint_coordinates_is_state_feedback(tmp_path: Path) -> None:
    """Its length is 2 (2 p - 0.5 q): kp 40 and kv 3 act on p and q with the moments 4 and -1."""
    found = reading(tmp_path, TIED.replace("<equality>", "<!--").replace("</equality>", "-->"))
    assert verified(found)
    laws = {(law.joint, law.coordinate): law.feedback for law in found.scene.control}
    p, q = ("p", 0), ("two_joints", 1)
    assert laws == {
        p: {p: (640.0, 48.0), q: (-160.0, -12.0)},
        q: {p: (-160.0, -12.0), q: (40.0, 3.0)},
    }
    # no engine has one rotor on two independent coordinates
    topics = {entry.topic for entry in found.report.of("left out") if entry.element == "actuator 0"}
    assert topics == {"armature"}


def test_limits_of_an_actuator_on_independent_joint_coordinates(tmp_path: Path) -> None:
    """The force of the actuator and that at each joint are watched as the file has them."""
    servo = '<actuator><position name="pull" tendon="t" kp="40" kv="3" forcerange="-5 5"/></actuator>'
    text = model(
        PAIR.replace('name="q"', 'name="q" actuatorfrcrange="-1 1"'),
        '<tendon><fixed name="t"><joint joint="p" coef="2"/><joint joint="q" coef="-0.5"/></fixed></tendon>'
        + servo,
    )
    found = reading(tmp_path, text)
    assert verified(found)
    watched = {found.report.entries[n].element: watches for n, watches in found.report.watches.items()}
    (of_joint,), (of_actuator,) = watched["joint 'q'"], watched["actuator 'pull'"]
    assert (of_actuator.low, of_actuator.high, of_joint.low, of_joint.high) == (-5.0, 5.0, -1.0, 1.0)
    # q gets -0.5 of the force -40 (2 p - 0.5 q)
    gains = {key: of_joint.by_value * factor for key, factor in of_joint.terms}
    assert gains == pytest.approx({("p", 0): 40.0, ("two_joints", 1): -10.0})


@pytest.mark.parametrize(
    "actuator",
    [
        '<motor name="pull" tendon="cord" forcerange="-1 1"/>',
        '<position name="pull" site="s1" refsite="s2" gear="1 0 0 0 0 0" forcerange="-1 1"/>',
    ],
    ids=["spatial tendon", "servo at a site"],
)
def test_an_actuator_that_is_not_simulated_has_no_limit_to_watch(actuator: str, tmp_path: Path) -> None:
    cord = '<tendon><spatial name="cord"><site site="s1"/><site site="s2"/></spatial></tendon>'
    text = model(PAIR, f'{cord}<actuator>{actuator}</actuator><keyframe><key ctrl="3"/></keyframe>')
    found = reading(tmp_path, text)
    assert verified(found)
    assert [e.topic for e in found.report.of("left out") if e.element == "actuator 'pull'"] == [""]


def test_ties_through_several_gears() -> None:
    gear_groups = GearGroups(
        [Gear("one", "p", "q", 2.0), Gear("two", "r", "s", 3.0), Gear("three", "s", "p", -0.5)]
    )
    p, q, r, s, other = (("p", 0), ("q", 0), ("r", 0), ("s", 0), ("q", 1))
    assert gear_groups.rates([r, s, p, q]) == {r: 1.0, s: 3.0, p: -1.5, q: -3.0}
    # 4 r - q is 7 r, and -7/3 q
    assert gear_groups.slopes({r: 4.0, q: -1.0}) == pytest.approx({r: 7.0, q: -7.0 / 3.0})
    assert gear_groups.rates([p, other]) is None
    assert gear_groups.rates([other]) == {other: 1.0}
    assert gear_groups.rates([]) is None


@pytest.mark.parametrize("torque_scale", ["1e-9", "0.01", "1", "40", "-2"])
def test_an_open_weld_is_closed_whatever_its_torquescale(torque_scale: str, tmp_path: Path) -> None:
    """MuJoCo scales what it says of angles by that."""
    turned = '0.1 0 -0.5 0.8 0.1 0.6 0" torquescale="' + torque_scale
    text = ELEMENTS["weld at another pose"].replace("0.1 0 -0.5 0.8 0 0.6 0", turned)
    found = reading(tmp_path, text)
    assert verified(found)
    first, second = found.report.start[:2]
    # the places are the same for all, and so is the axis times the sine of half the angle
    assert first == reading(tmp_path, text.replace(torque_scale, "1")).report.start[0]
    assert first.startswith("open at qpos0, in m or rad: equality 0 0.")
    assert second.startswith("assembled next to qpos0: closed to ")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (
            model(arm('<joint name="ball" type="ball"/>'), '<actuator><motor joint="ball"/></actuator>'),
            "no control law acts on a ball joint, as joint 'ball' is",
        ),
        (
            model(FLOATING, '<actuator><motor joint="root"/></actuator>'),
            "no control law acts on a free joint, as joint 'root' is",
        ),
        (
            model(
                PAIR,
                '<tendon><spatial name="t"><site site="s1"/><site site="s2"/></spatial></tendon>'
                '<actuator><motor tendon="t"/></actuator>',
            ),
            "no control law acts through its transmission, tendon",
        ),
    ],
)
def test_what_no_control_law_acts_on(text: str, why: str, tmp_path: Path) -> None:
    pushed = text.replace("</mujoco>", '<keyframe><key ctrl="3"/></keyframe></mujoco>')
    (entry,) = (e for e in reading(tmp_path, pushed).report.of("left out") if e.element == "actuator 0")
    assert entry.how == why


def test_a_keyframe_without_a_name(tmp_path: Path) -> None:
    keys = '<keyframe><key qpos="0.3 -0.2 0.1"/><key qpos="0.1 -0.2 0.1"/></keyframe></mujoco>'
    text = FOUR_BARS["cut at C by a connect"].replace("</mujoco>", keys)
    for key, called in ((None, "keyframe 0"), ("1", "keyframe 1")):
        found = reading(tmp_path, text, key=key)
        assert found.report.start[0].startswith(f"open at {called}, in m or rad: ")
        assert found.scene.description == f"model.xml from {called}"


def test_an_unknown_keyframe(tmp_path: Path) -> None:
    with pytest.raises(MjcfError, match="no keyframe 'up'; choose from: qpos0, go"):
        reading(tmp_path, ELEMENTS["actuators"], key="up")


TWO_BARS = """
<mujoco model="two_bars"><worldbody><body name="a"><joint name="first" axis="0 1 0"/>
  <geom type="capsule" size="0.02" fromto="0 0 0 0.1234567890123 0 -0.7654321098765"/>
  <body name="b" pos="0.1234567890123 0 -0.7654321098765"><joint name="second" axis="0 1 0"/>
    <geom type="capsule" size="0.02" fromto="0 0 0 0.5 0 0"/></body></body></worldbody></mujoco>
"""


def test_models_in_memory_are_read_as_their_file_is(tmp_path):
    path = tmp_path / "two_bars.xml"
    path.write_text(TWO_BARS)
    spec = mujoco.MjSpec.from_string(TWO_BARS)
    scenes = [read(each).scene for each in (path, spec, mujoco.MjModel.from_xml_string(TWO_BARS))]
    assert [scene.description for scene in scenes] == [
        "two_bars.xml from qpos0",
        "MjSpec 'two_bars' from qpos0",
        "MjModel 'two_bars' from qpos0",
    ]
    for scene in scenes:
        assert scene.name == "two_bars"
        for body, other in zip(scene.mechanism.bodies, scenes[0].mechanism.bodies, strict=True):
            assert body.mass == other.mass
            np.testing.assert_array_equal(body.center_of_mass, other.center_of_mass)
            np.testing.assert_array_equal(body.inertia, other.inertia)
        points = [joint.point for joint in scene.mechanism.joints]
        np.testing.assert_array_equal(points, [joint.point for joint in scenes[0].mechanism.joints])


@pytest.mark.parametrize(("mass", "problem"), [(0.0, "has no mass"), (-1.0, "has a mass of -1 kg")])
def test_models_in_memory_without_a_positive_mass(mass: float, problem: str) -> None:
    compiled = mujoco.MjModel.from_xml_string(TWO_BARS)
    compiled.body_mass[1] = mass
    with pytest.raises(NewtonEulerError, match=f"body 'a' {problem}"):
        read(compiled)


def test_models_in_memory_are_read_with_their_changes_and_stay_as_they_are():
    spec = mujoco.MjSpec.from_string(TWO_BARS)
    spec.body("b").pos[2] = -0.5
    text = spec.to_xml()
    assert read(spec).scene.mechanism.joint("second").point[2] == -0.5
    assert spec.to_xml() == text
    compiled = mujoco.MjModel.from_xml_string(TWO_BARS)
    compiled.body_mass[1] = 3.0
    size = mujoco.mj_sizeModel(compiled)
    before, after = np.empty((2, size), np.uint8)
    mujoco.mj_saveModel(compiled, None, before)
    assert read(compiled, excitation=True).scene.mechanism.body("a").mass == 3.0
    mujoco.mj_saveModel(compiled, None, after)
    np.testing.assert_array_equal(after, before)


def test_inertia_that_no_mass_has_is_marked_and_none_other():
    compiled = mujoco.MjModel.from_xml_string(TWO_BARS)
    compiled.body_inertia[1] = 1.0, 1.0, 2.5
    marked = {
        body.name: body.allow_unrealisable_inertia for body in read(compiled).scene.mechanism.bodies[1:]
    }
    assert marked == {"a": True, "b": False}


def test_models_in_memory_that_cannot_be_read_are_named():
    spec = mujoco.MjSpec()
    spec.worldbody.add_body(name="bare").add_joint()
    with pytest.raises(MjcfError, match=r"^MjSpec: MuJoCo refuses it: .*mass and inertia"):
        read(spec)
    with pytest.raises(MjcfError, match=r"^MjSpec 'two_bars': no keyframe 'home'"):
        read(mujoco.MjSpec.from_string(TWO_BARS), "home")
    with pytest.raises(NewtonEulerError, match=r"root is '\.'; needed: no root for a model in memory"):
        read(mujoco.MjSpec.from_string(TWO_BARS), root=".")
    with pytest.raises(MjcfError, match=r"needed: a path of a file, a mujoco.MjSpec or a mujoco.MjModel"):
        read(5)


def test_a_force_through_the_axis_of_a_hinge_is_verified(tmp_path):
    """The moment about the hinge is round-off of two terms that cancel, and no difference of the file."""
    path = tmp_path / "thruster.xml"
    path.write_text(
        """<mujoco><worldbody><body name="a">
        <joint name="j" axis="0 1 0"/><geom size=".1" mass="1"/><site name="s" pos=".1 0 0"/>
        <body name="b" pos=".5 0 0"><joint name="k" axis="0 1 0"/><geom size=".1" mass="1"/></body>
        </body></worldbody>
        <actuator><motor name="u" site="s" gear="1 0 0 0 0 0"/></actuator>
        <keyframe><key name="on" ctrl="1"/></keyframe></mujoco>"""
    )
    (wrench,) = read(str(path), key="on").scene.forces
    np.testing.assert_allclose(wrench.force, [1.0, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize(
    ("actuator", "reason"),
    [
        ('<motor joint="p" delay="0.01" nsample="9"/>', "its control is delayed"),
        ('<muscle joint="p" lengthrange="0 1"/>', "its gain has the type muscle"),
        (
            '<general joint="p" biastype="muscle" biasprm="0.75 1.05 -1 200 0.5 1.6 1.5 1.3 1.2" '
            'lengthrange="0 1"/>',
            "its bias has the type muscle",
        ),
        ('<intvelocity joint="p" kp="1" actrange="-1 1"/>', "its activation changes from the start on"),
    ],
)
def test_why_an_actuator_is_left_out(tmp_path: Path, actuator: str, reason: str) -> None:
    text = model(PAIR, f'<actuator>{actuator}</actuator><keyframe><key ctrl="1"/></keyframe>')
    found = reading(tmp_path, text)
    assert reason in [each.how for each in found.report.of("left out")]
    assert not found.scene.control
