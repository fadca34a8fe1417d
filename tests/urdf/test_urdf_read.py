"""Reading URDF and loop files: against Pinocchio's own model, and there and back."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from elements import JOINTS
from mechanisms import GRAVITY, REGULAR, at_rest, planar_four_bar
from urdf_files import CHAIN, LOOPS, TIPS, joint, link, reading, robot

import urdf
from newton_euler import simulate
from newton_euler.model.compound_joint import Compound
from newton_euler.model.joint_kinds import Fixed, Free, Prismatic, Revolute, Spherical
from urdf import read
from urdf.errors import UrdfError


def test_links_and_joints_become_bodies_and_joints(tmp_path: Path) -> None:
    found = reading(tmp_path, CHAIN)
    mechanism = found.scene.mechanism
    assert [type(joint) for joint in mechanism.joints] == [Revolute, Prismatic, Revolute]
    assert mechanism.body_names == ("ground", "a", "b", "d")
    assert any(line.startswith("verified against the file's own model") for line in found.report.start)
    assert found.scene.forces[0].damping == 0.5
    lines = [str(entry) for entry in found.report.entries]
    assert "joint 'first': left out: its dry friction 0.1" in lines
    assert "joint 'second': left out: its limits -1 to 1: limits are one-sided and not simulated" in lines
    assert "link 'c': exactly: part of 'b'" in lines


def test_round_off_of_a_singular_inertia_is_not_named_as_the_fault(tmp_path: Path) -> None:
    """Of six equal numbers two principal moments are zero; one of them is computed as -2e-22."""
    row = " ".join(f'{name}="1e-6"' for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    plate = f'<link name="plate"><inertial><mass value="1e-3"/><inertia {row}/></inertial></link>'
    joints = joint("first", "revolute", "base", "a") + joint("weld", "fixed", "a", "plate")
    (body,) = reading(tmp_path, robot(link("a"), plate, joints)).scene.mechanism.bodies[1:]
    assert body.mass == pytest.approx(1.001)
    negative = link("a").replace('ixx="0.02"', 'ixx="-0.02"')
    with pytest.raises(UrdfError, match=r"link 'a': principal moments of inertia are -0\.02"):
        reading(tmp_path, robot(plate, negative, joints))


def test_free_and_planar_joints_and_mimics(tmp_path: Path) -> None:
    text = robot(
        link("a"), link("b"), link("c"), link("d"),
        joint("floats", "floating", "base", "a"),
        joint("slides", "planar", "base", "b"),
        joint("leads", "revolute", "b", "c"),
        joint("follows", "prismatic", "c", "d", '<mimic joint="leads" multiplier="0.5" offset="0.1"/>'),
    )  # fmt: skip
    found = reading(tmp_path, text)
    kinds = {joint.name: type(joint) for joint in found.scene.mechanism.joints}
    assert kinds == {"floats": Free, "slides": Compound, "leads": Revolute, "follows": Prismatic}
    (gear,) = found.scene.mechanism.couplings
    assert (gear.driver, gear.follower, gear.ratio) == ("leads", "follows", 0.5)
    where = "followers of mimics start at these coordinates, with drivers at 0, m or rad: "
    assert found.report.start[:2] == [
        where + "'follows' 0.1",
        "starts from coordinates 0 and mimics at their offsets: all loops closed, to 0.0e+00 m or rad",
    ]


@pytest.mark.parametrize("axis", ["0 0 1", "0 0 -1", "0 2 0", "0.2 1 0.1", ""])
def test_a_planar_joint_moves_in_the_plane_across_its_axis(axis: str, tmp_path: Path) -> None:
    """Its body, which starts at rest, falls along the plane without a turn, by half of g in the plane t^2."""
    planar = joint("glides", "planar", "base", "a").replace('xyz="0.2 1 0.1"', f'xyz="{axis}"')
    text = robot(link("a"), planar if axis else planar.replace('<axis xyz=""/>', ""))
    (tmp_path / "robot.urdf").write_text(text)
    found = read(tmp_path / "robot.urdf", duration=0.5, output_period=0.1, excitation=False)
    given = np.array([float(number) for number in (axis or "1 0 0").split()])  # x is URDF's default
    normal = pin.rpy.rpyToMatrix(0.3, -0.2, 0.5) @ (given / np.linalg.norm(given))
    run = simulate(found.scene)
    body = run.body_names.index("a")
    fallen = run.position[:, body] - run.position[0, body]
    in_plane = GRAVITY - (GRAVITY @ normal) * normal
    assert fallen == pytest.approx(0.5 * np.outer(run.time**2, in_plane), abs=1e-9)
    assert run.quaternion[:, body] == pytest.approx(np.tile(run.quaternion[0, body], (6, 1)), abs=1e-9)
    # a loop with Pinocchio, which ignores the axis, runs another robot
    assert (found.report.simulation is None) == (axis != "0 0 1")


def test_an_axis_of_a_planar_joint_without_direction_is_refused(tmp_path: Path) -> None:
    planar = joint("glides", "planar", "base", "a").replace("0.2 1 0.1", "0 0 0")
    with pytest.raises(UrdfError, match="joint 'glides': its axis is 0 0 0"):
        reading(tmp_path, robot(link("a"), planar))


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
@pytest.mark.parametrize("order", [1, -1])
def test_mimics_start_at_their_offsets_with_their_drivers_at_zero(
    tmp_path: Path, kind: str, order: int
) -> None:
    """Against Pinocchio's forward kinematics, with a follower that another one follows, in either order."""
    # 4 rad are more than half a turn
    followers = (
        joint("second", kind, "a", "b", '<mimic joint="first" multiplier="2" offset="0.4"/>'),
        joint("third", kind, "b", "c", '<mimic joint="second" multiplier="-0.5" offset="4"/>'),
    )
    links = (link("a"), link("b"), link("c"))
    text = robot(*links, joint("first", "revolute", "base", "a"), *followers[::order])
    found = reading(tmp_path, text)
    assert found.report.start[0].endswith(": " + ", ".join(["'second' 0.4", "'third' 3.8"][::order]))
    model = pin.buildModelFromXML(text.replace("<mimic", "<ignored"))
    data = model.createData()
    q = pin.integrate(model, pin.neutral(model), np.array([0.0, 0.4, 4.0 - 0.5 * 0.4]))
    pin.forwardKinematics(model, data, q)
    for index, body in enumerate(found.scene.mechanism.bodies[1:], start=1):
        center = data.oMi[index].act(model.inertias[index].lever)
        assert body.center_of_mass == pytest.approx(center, abs=1e-14)  # three rotations of order 1
    gears = [(gear.driver, gear.follower, gear.ratio) for gear in found.scene.mechanism.couplings]
    assert sorted(gears) == [("first", "second", 2.0), ("second", "third", -0.5)]


def test_mimics_that_follow_each_other_are_assembled(tmp_path: Path) -> None:
    text = robot(
        link("a"), link("b"), link("c"),
        joint("free", "revolute", "base", "c"),
        joint("one", "revolute", "base", "a", '<mimic joint="two" multiplier="0.5" offset="0.3"/>'),
        joint("two", "revolute", "a", "b", '<mimic joint="one" multiplier="0.5"/>'),
    )  # fmt: skip
    found = reading(tmp_path, text)
    assert found.report.start[0] == "open at coordinates 0, in m or rad: mimic of one 0.3"
    # one = 0.5 two + 0.3 and two = 0.5 one have the solution 0.4 and 0.2
    assert "joint 'one' moved most, by 0.4" in found.report.start[1]


def test_massless_links_between_joints_make_one_joint(tmp_path: Path) -> None:
    text = robot(
        link("a"),
        '<link name="cross"/>',
        joint("hip_1", "revolute", "base", "cross"),
        joint("hip_2", "revolute", "cross", "a", xyz="0 0 0"),
    )
    (found,) = reading(tmp_path, text).scene.mechanism.joints
    assert isinstance(found, Compound)
    assert (found.name, len(found.hinges)) == ("hip", 2)


def test_a_loop_that_is_open_is_closed_or_refused(tmp_path: Path) -> None:
    tb = joint("tb", "fixed", "slide", "tip_b", xyz="-0.2 0 0.4")
    parts = [*TIPS[:-1], link("slide"), joint("s", "floating", "b", "slide"), tb]
    loops = LOOPS.format(pairs="[[tip_a, tip_b]]", types="[3d]", motors="[ja]")
    found = reading(tmp_path, robot(*parts), loops)
    assert found.report.start[0].startswith("open at coordinates 0, in m or rad: loop of tip_a and tip_b 0.")
    assert "assembled next to coordinates 0" in found.report.start[1]
    (closing,) = [joint for joint in found.scene.mechanism.joints if isinstance(joint, Spherical)]
    assert closing.point == pytest.approx(closing.point_on_second, abs=1e-12)
    assert [joint.name for joint in found.scene.mechanism.joints if joint.actuated] == ["ja"]
    for kind in ("3d", "6d"):
        loops = LOOPS.format(pairs="[[tip_a, tip_b]]", types=f"[{kind}]", motors="[]")
        with pytest.raises(UrdfError, match=r"loop of tip_a and tip_b cannot be closed .* open by .* there"):
            reading(tmp_path, robot(*TIPS), loops)


ALL = JOINTS | {build.__name__: build() for build in (*REGULAR, planar_four_bar)}


@pytest.mark.parametrize("name", ALL)
def test_there_and_back(name: str, tmp_path: Path) -> None:
    scene = replace(ALL[name], gravity=GRAVITY, initial_state=None)
    urdf.write(scene, tmp_path / "robot.urdf")
    back = read(tmp_path / "robot.urdf", tmp_path / "robot.loops.yaml").scene
    fixed = {joint.first for joint in scene.mechanism.joints if isinstance(joint, Fixed)}
    own, found = at_rest(scene), at_rest(back)
    for k, body in enumerate(scene.mechanism.bodies[1:], start=1):
        if body.name in fixed:
            continue  # part of the body that it is fixed to
        i = back.mechanism.body_index(body.name)
        for array in ("linear_acceleration", "angular_acceleration"):
            x, y = getattr(own, array)[k], getattr(found, array)[i]
            # 1e-12 of the largest: seventeen digits in the file, and condition numbers of 1e3
            assert np.max(np.abs(x - y)) < 1e-12 * max(1.0, np.max(np.abs(getattr(own, array)))), body.name
        if not fixed:
            assert back.mechanism.bodies[i].mass == pytest.approx(body.mass, rel=1e-15)
            assert back.mechanism.bodies[i].center_of_mass == pytest.approx(body.center_of_mass, abs=1e-14)


def test_an_inertia_without_a_mass_is_refused(tmp_path: Path) -> None:
    text = robot(link("a"), link("rotor", 0.0), joint("moves", "revolute", "base", "a"),
                 joint("spins", "revolute", "a", "rotor"))  # fmt: skip
    with pytest.raises(UrdfError, match="link 'rotor': a mass of 0 kg with principal moments of inertia"):
        reading(tmp_path, text)
    # a fixed joint lets it be part of a body that has one
    assert reading(tmp_path, text.replace('name="spins" type="revolute"', 'name="spins" type="fixed"'))


def test_joints_that_move_no_mass_are_held_and_reported(tmp_path: Path) -> None:
    text = robot(link("a"), '<link name="tip"/>', joint("moves", "revolute", "base", "a"),
                 joint("idle", "revolute", "a", "tip", '<mimic joint="moves"/>'))  # fmt: skip
    found = reading(tmp_path, text)
    assert found.scene.mechanism.joint_names == ("moves",)
    lines = [str(entry) for entry in found.report.of("left out")]
    assert "joint 'idle': left out: it moves no mass: held where it is" in lines
    assert "mimic of joint 'idle': left out: one of its joints has no moving body" in lines


def test_a_mesh_whose_reading_is_ended_leaves_no_part_of_a_file(tmp_path: Path) -> None:
    """The limits of time and memory may end the process while it writes."""
    (tmp_path / "one.stl").write_text(
        "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        "endloop\nendfacet\nendsolid s\n"
    )
    out = tmp_path / "out"
    out.mkdir()
    script = Path(urdf.__file__).parent / "reading" / "load_meshes.py"
    arguments = [str(script), str(out), "2000000000", str(tmp_path / "one.stl")]
    code = (
        "import numpy, os, runpy, sys\n"
        "def ended(path, **arrays):\n    open(path, 'wb').write(b'PK')\n    os._exit(9)\n"
        f"numpy.savez = ended\nsys.argv = {arguments!r}\nrunpy.run_path(sys.argv[0], run_name='__main__')"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 9
    assert not list(out.glob("[0-9]*.npz"))
