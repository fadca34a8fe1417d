"""Sums of three joint coordinates that stay 0: tendon equalities of an MJCF, `coupled` of a URDF."""

from __future__ import annotations

import numpy as np
import pytest

import mjcf
import urdf
from crosscheck.library.scene_file import read_scene, write_scene
from mjcf import read
from mjcf.rigid import RigidMuJoCo
from newton_euler import LinearCoupling, simulate
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.errors import MechanismError
from newton_euler.runs.assemble import initial_state
from urdf import read as read_urdf
from urdf.dynamics import PinocchioSystem

LINK = """<body name="{0}" pos="{1}"><joint name="{0}" axis="0 1 0" {2}/>
<geom type="box" size="0.2 0.05 0.1" pos="0.2 0 0"/>"""
ARM = (
    '<mujoco><option gravity="1 0 -9.81"/><worldbody>'
    + LINK.format("a", "0 0 0", 'stiffness="2"')
    + LINK.format("b", "0.4 0 0", 'damping="0.1"')
    + LINK.format("c", "0.4 0 0", 'armature="0.01"')
    + """</body></body></body></worldbody><tendon><fixed name="sum">
    <joint joint="a" coef="{0}"/><joint joint="b" coef="{1}"/><joint joint="c" coef="{2}"/></fixed></tendon>
    <equality><tendon name="level" tendon1="sum"/></equality></mujoco>"""
)


def scene_of(folder, *factors):
    path = folder / "arm.xml"
    path.write_text(ARM.format(*factors))
    found = read(path, duration=0.3, output_period=0.1)
    (line,) = [e for e in found.report.entries if e.element == "equality 'level'"]
    assert line.fate == "exactly"
    assert line.how.startswith("coupling 'level' of 3 joint coordinates")
    return found


def test_angles_that_add_up_to_nothing_keep_the_last_body_level(tmp_path):
    scene = scene_of(tmp_path, 0.5, 0.5, 0.5).scene
    for run in (
        simulate(scene),
        simulate(scene, formulation="cartesian"),
        urdf.simulate(scene),
    ):
        assert np.max(np.abs(run.position[-1, 3] - run.position[0, 3])) > 0.1
        assert np.max(np.abs(run.angular_velocity[:, 3])) < 1e-9  # tolerances of runs
        assert np.max(np.abs(run.angular_velocity[:, 1])) > 0.1
    soft = mjcf.simulate(scene, timestep=2e-4)
    assert np.max(np.abs(soft.position - simulate(scene).position)) < 1e-5  # of its constraints


def test_accelerations_and_reactions_are_the_same_in_all_engines(tmp_path):
    scene = scene_of(tmp_path, 0.7, -1.3, 0.4).scene
    found, wrenches = [], []
    for kind in (Relative, Cartesian, PinocchioSystem, RigidMuJoCo):
        system = kind(scene)
        e = system.evaluate(*system.coordinates(initial_state(scene)))
        found.append(np.hstack([e.linear_acceleration, e.angular_acceleration]))
        wrenches.append(np.hstack([e.reaction_force, e.reaction_torque]))
        assert np.allclose(found[-1], found[0], atol=1e-11)
        assert np.allclose(wrenches[-1], wrenches[0], atol=1e-10)
    # what the equality asks for, from the accelerations themselves
    alpha = np.diff(found[0][:, 4])
    assert abs(alpha @ [0.7, -1.3, 0.4]) < 1e-12 * np.max(np.abs(alpha)) + 1e-12


def test_other_formats_keep_it(tmp_path):
    scene = scene_of(tmp_path, 0.7, -1.3, 0.4).scene
    mjcf.write(scene, tmp_path / "again.xml")
    urdf.write(scene, tmp_path / "again.urdf")
    write_scene(scene, tmp_path / "again.yaml")
    others = [
        read(tmp_path / "again.xml").scene,
        read_urdf(tmp_path / "again.urdf", loops=tmp_path / "again.loops.yaml").scene,
        read_scene(tmp_path / "again.yaml"),
    ]
    for other in others:
        (coupling,) = other.mechanism.couplings
        assert coupling.factors() == {("a", 0): 0.7, ("b", 0): -1.3, ("c", 0): 0.4}


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ([("a", 0, 1.0)], "two joint coordinates or more"),
        ([("a", 0, 1.0), ("a", 0, 2.0)], "two joint coordinates or more"),
        ([("a", 0, 1.0), ("b", 0, 0.0)], "factor of 'b' is 0.0"),
        (5, "terms is 5"),
    ],
)
def test_terms_are_checked(terms, message):
    with pytest.raises(MechanismError, match=message):
        LinearCoupling("sum", terms)


@pytest.mark.parametrize(
    ("dynamics", "act", "ctrl", "force"),
    [
        ("filter", 0.4, 0.4, 1.2),
        ("integrator", 0.4, 0.0, 1.2),
        ("filter", 0.4, 0.5, None),
        ("integrator", 0.4, 0.1, None),
    ],
)
def test_actuators_whose_activation_rests_are_the_laws_that_they_are_then(
    dynamics, act, ctrl, force, tmp_path
):
    """A gain of 3 makes 1.2 N m of an activation of 0.4; MuJoCo's own acceleration of the file has it too."""
    actuator = f'<actuator><general joint="a" dyntype="{dynamics}" dynprm="0.1" gainprm="3"/></actuator>'
    key = f'<keyframe><key act="{act}" ctrl="{ctrl}"/></keyframe>'
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(0.7, -1.3, 0.4).replace("</mujoco>", f"{actuator}{key}</mujoco>"))
    found = read(path)
    laws = [law.feedforward for law in found.scene.control]
    if force is None:
        assert not laws
        return
    assert laws == [pytest.approx(force)]
    assert [line for line in found.report.start if line.startswith("verified against the file's own model")]
