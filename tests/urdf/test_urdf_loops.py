"""Loop files as Gepetto's example-parallel-robots has them: what entries name, and joint types."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mechanisms import at_rest
from urdf_files import LOOPS, joint, link, reading, robot

from newton_euler.equations.relative import Relative
from newton_euler.errors import UnknownNameError
from newton_euler.model.joint_kinds import Fixed, Free, Revolute, Spherical, Universal
from newton_euler.model.scene import Scene
from newton_euler.reading.excitation import random_states
from urdf.dynamics import PinocchioSystem
from urdf.errors import LoopFileError
from urdf.reader import Reading

ENDS = (
    link("a"), link("b"), link("ball"), link("end"),
    joint("ja", "revolute", "base", "a", xyz="0 0 0"),
    joint("jb", "floating", "base", "b", xyz="0.5 0 0"),
    joint("at_a", "revolute", "a", "ball", xyz="0.3 0 0.4"),
    joint("at_b", "fixed", "b", "end", xyz="-0.2 0 0.4"),
)  # fmt: skip
"""Two arms that end in frames of joints; the second arm floats, so that it can meet the first."""


def with_types(**types: str) -> str:
    names, kinds = ", ".join(types), ", ".join(types.values())
    return f"closed_loop: []\ntype: []\nname_mot: []\njoint_name: [{names}]\njoint_type: [{kinds}]\n"


def same_motion(one: Reading, two: Reading) -> None:
    first, second = at_rest(one.scene), at_rest(two.scene)
    # 1e-11: accelerations of order 10 through two factorizations
    assert first.linear_acceleration == pytest.approx(second.linear_acceleration, abs=1e-11)
    assert first.angular_acceleration == pytest.approx(second.angular_acceleration, abs=1e-11)


@pytest.mark.parametrize(("kind", "closing"), [("3D", Spherical), ("6D", Fixed)])
def test_loops_close_between_frames_of_joints(kind: str, closing: type, tmp_path: Path) -> None:
    by_joint = LOOPS.format(pairs="[[at_a, at_b]]", types=f"[{kind}]", motors="[]")
    by_link = LOOPS.format(pairs="[[ball, end]]", types=f"[{kind.lower()}]", motors="[]")
    found = reading(tmp_path, robot(*ENDS), by_joint)
    (loop,) = [j for j in found.scene.mechanism.joints if isinstance(j, closing)]
    assert loop.point == pytest.approx(loop.point_on_second, abs=1e-12)
    same_motion(found, reading(tmp_path, robot(*ENDS), by_link))


def test_a_link_and_a_joint_of_one_name_must_not_differ(tmp_path: Path) -> None:
    loops = LOOPS.format(pairs="[[twice, end]]", types="[3d]", motors="[]")
    parts = [*ENDS, link("twice"), joint("to_twice", "fixed", "base", "twice")]
    reading(tmp_path, robot(*parts), loops)
    parts = [*parts, link("other"), joint("twice", "revolute", "a", "other")]
    with pytest.raises(LoopFileError, match="closed_loop: 'twice' is a link and a joint in different places"):
        reading(tmp_path, robot(*parts), loops)


@pytest.mark.parametrize(
    ("kind", "axes"), [("UJOINT_XY", "XY"), ("UJOINT_ZX", "ZX"), ("UJOINT_ZY", "ZY"), ("CARDAN", "XY")]
)
def test_universal_joints_turn_about_axes_of_the_joints_own_frame(
    kind: str, axes: str, tmp_path: Path
) -> None:
    parts = (link("a"), link("b"), joint("ja", "revolute", "base", "a"))
    found = reading(tmp_path, robot(*parts, joint("hip", "revolute", "a", "b")), with_types(hip=kind))
    hip = found.scene.mechanism.joints[1]
    assert isinstance(hip, Universal)
    assert hip.name == "hip"
    vectors = {"X": "1 0 0", "Y": "0 1 0", "Z": "0 0 1"}
    one, two = (
        f'<joint name="hip_{k}" type="continuous">{origin}<parent link="{up}"/><child link="{down}"/>'
        f'<axis xyz="{vectors[axis]}"/></joint>'
        for k, axis, origin, up, down in (
            (1, axes[0], '<origin xyz="0.3 0.1 0" rpy="0.3 -0.2 0.5"/>', "a", "cross"),
            (2, axes[1], "", "cross", "b"),
        )
    )
    wanted = reading(tmp_path, robot(*parts, '<link name="cross"/>', one, two), with_types())
    same_motion(found, wanted)


def test_fixed_joints_are_held(tmp_path: Path) -> None:
    more = '<dynamics damping="0.4"/>'
    parts = (link("a"), link("b"), joint("ja", "revolute", "base", "a"))
    found = reading(
        tmp_path, robot(*parts, joint("lock", "revolute", "a", "b", more)), with_types(lock="FIXED")
    )
    assert [type(j) for j in found.scene.mechanism.joints] == [Revolute]
    same_motion(found, reading(tmp_path, robot(*parts, joint("lock", "fixed", "a", "b")), with_types()))
    lines = [str(entry) for entry in found.report.entries]
    assert "joint 'lock': exactly: held at 0 by the loop file" in lines
    assert "joint 'lock': left out: its damping 0.4: the joint is not a moving hinge or slide" in lines


def test_a_joint_has_one_type(tmp_path: Path) -> None:
    loops = with_types(ja="FIXED").replace("[ja]", "[ja, ja]").replace("[FIXED]", "[FIXED, SPHERICAL]")
    with pytest.raises(LoopFileError, match="joint_name: names a joint twice"):
        reading(tmp_path, robot(link("a"), joint("ja", "revolute", "base", "a")), loops)


def test_a_free_base_falls(tmp_path: Path) -> None:
    text = robot(joint("ja", "revolute", "base", "a"), link("a"))
    text = text.replace('<link name="base"/>', link("base", 3.0))
    found = reading(tmp_path, text, with_types(), base="free")
    mechanism = found.scene.mechanism
    assert [type(j) for j in mechanism.joints] == [Free, Revolute]
    masses = np.array([body.mass for body in mechanism.bodies[1:]])
    falling = masses @ at_rest(found.scene).linear_acceleration[1:] / masses.sum()
    assert falling == pytest.approx([0.0, 0.0, -9.81], abs=1e-13)
    assert found.report.start[-1].endswith("its root link floats")
    with pytest.raises(UnknownNameError, match="unknown base 'loose'; choose from: fixed, free"):
        reading(tmp_path, text, with_types(), base="loose")


@pytest.mark.parametrize("name", ["robot.yaml", "robot.loops.yaml"])
def test_a_loop_file_beside_a_urdf_that_is_not_read_is_named(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(with_types())
    found = reading(tmp_path, robot(link("a"), joint("ja", "revolute", "base", "a"))).report.findings
    assert [(each.name, each.element) for each in found if each.name == "unread-loops"] == [
        ("unread-loops", name)
    ]


def test_elements_that_nobody_knows_are_listed(tmp_path: Path) -> None:
    def unknown(more: str) -> list[str]:
        found = reading(tmp_path, robot(link("a"), joint("ja", "revolute", "base", "a", more)), with_types())
        return [entry.element for entry in found.report.entries if not entry.is_understood]

    assert unknown('<joint_properties friction="0.2"/>') == ["<joint_properties> of joint 'ja'"]
    assert unknown('<joint_properties play="0"/>') == ["<joint_properties> of joint 'ja'"]
    assert not unknown('<joint_properties friction="0.0"/>')


def bar(name: str, length: float) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="{0.5 * length} 0 0"/><mass value="1"/>'
        '<inertia ixx="0.01" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def about_y(name: str, parent: str, child: str, x: float, turn: float) -> str:
    return (
        f'<joint name="{name}" type="continuous"><origin xyz="{x} 0 0" rpy="0 {turn} 0"/>'
        f'<parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 1 0"/></joint>'
    )


@pytest.fixture
def parallelogram(tmp_path: Path) -> Scene:
    return parallelogram_with(1e-3, tmp_path)


def parallelogram_with(pin_mass: float, tmp_path: Path) -> Scene:
    """Its last hinge is a light pin, kg, that is welded in: redundant, and so regularized."""
    moments = " ".join(f'{name}="{1e-3 * pin_mass}"' for name in ("ixx", "iyy", "izz"))
    pin_link = (
        f'<link name="pin"><inertial><mass value="{pin_mass}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )
    text = robot(
        bar("crank", 0.4), bar("coupler", 1.0), bar("rocker", 0.4), pin_link, '<link name="tip"/>',
        about_y("A", "base", "crank", 0.0, 1.2), about_y("B", "crank", "coupler", 0.4, -1.2),
        about_y("C", "coupler", "pin", 1.0, 1.2), about_y("D", "base", "rocker", 1.0, 1.2),
        '<joint name="to_tip" type="fixed"><origin xyz="0.4 0 0"/><parent link="rocker"/>'
        '<child link="tip"/></joint>',
    )  # fmt: skip
    loops = LOOPS.format(pairs="[[pin, tip]]", types="[6d]", motors="[]")
    return reading(tmp_path, text, loops).scene


def test_redundant_closures_of_bodies_without_much_inertia(tmp_path: Path) -> None:
    """1e-8: the pin has 1e-12 of the inertia of the bars. A regularized solution is off by 3e-7."""
    scene = parallelogram_with(1e-10, tmp_path)
    system, own = PinocchioSystem(scene), Relative(scene)
    for state in random_states(scene, 20):
        wanted, found = own.evaluate(*own.coordinates(state)), system.evaluate(*system.coordinates(state))
        scale = np.max(np.abs(wanted.angular_acceleration))
        apart = np.abs(found.angular_acceleration - wanted.angular_acceleration)
        assert np.max(apart) < 1e-8 * scale


@pytest.mark.parametrize("start", [1.2, 0.0])
def test_redundant_closures_are_solved_next_to_a_singular_pose(parallelogram: Scene, start: float) -> None:
    """Whether a run starts in that or not: there one row more follows from the others."""
    system, own = PinocchioSystem(parallelogram), Relative(parallelogram)
    names = [str(name) for name in system.closed.model.names][1:]
    turned = {"A": 1.0, "B": -1.0, "C": 1.0, "D": 1.0}
    direction = system.map.v_from_pinocchio(np.array([turned[name] for name in names]))
    initial = system.state((start - 1.2) * direction, np.zeros(system.nv))
    system = PinocchioSystem(replace(parallelogram, initial_state=initial))
    for angle in (1.2, 3e-3):  # the bars lie flat at 0
        q = (angle - 1.2) * direction
        assert np.max(np.abs(system.phi(q))) < 1e-15
        state = system.state(q, direction)
        wanted, found = own.evaluate(*own.coordinates(state)), system.evaluate(q, direction)
        unit = np.max(np.abs(wanted.linear_acceleration))
        # 1e-6: round-off of constraints whose smallest singular value is 3e-3, squared
        assert found.linear_acceleration == pytest.approx(wanted.linear_acceleration, abs=1e-6 * unit), angle
