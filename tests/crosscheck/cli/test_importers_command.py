"""`crosscheck importers` and `crosscheck.importers`: the robots that importers read in one file.

The files are minimal ones of faults that users reported to MuJoCo and Pinocchio. Expected numbers are written
by hand; that the plain engines have them is asserted, too.
"""

from __future__ import annotations

import json
import math
import os
import sys

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from command_line import run

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.importers import _compared
from crosscheck.loading import importers as loading
from crosscheck.loading.importers import OWN, Failure, read_by_all
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.source_file import SourceError
from urdf.model_robot import describe_model

LINK = """<link name="{name}"><inertial><origin xyz="{center}" rpy="{rpy}"/><mass value="1"/>
  <inertia ixx="{ixx}" iyy="2" izz="2.5" ixy="0" ixz="0" iyz="0"/></inertial></link>"""

HINGE = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><origin xyz="0 0 0" rpy="{4}"/>
  <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""

QUARTER = math.pi / 2.0


def urdf(rpy=f"0 0 {QUARTER!r}", ixx="1"):
    """Write a URDF of one link on a hinge about x, 0.5 m below its center of mass."""
    link = LINK.format(name="link", center="0 0 0.5", rpy=rpy, ixx=ixx)
    hinge = HINGE.format("j", "revolute", "base", "link", "0 0 0")
    return f'<robot name="r"><link name="base"/>{link}{hinge}</robot>'


@pytest.fixture
def file(tmp_path):
    def write(text):
        path = tmp_path / ("robot.urdf" if text.startswith("<robot") else "robot.xml")
        path.write_text(text)
        return str(path)

    return write


def hinge_inertia(path):
    """Inertia about the only joint in plain MuJoCo, kg m^2."""
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    dense = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, dense)
    [[inertia]] = dense
    return inertia


def results(found):
    return {each.reading.importer: each.result.value for each in found.comparison.others}


@pytest.mark.slow
def test_rotated_inertia_of_a_urdf_is_mended_in_mujoco(file):
    # google-deepmind/mujoco#3559: MuJoCo 3.12 lost the rotation; 4.0 has 2 kg m^2 about x, as the file says,
    # and m r^2 = 0.25 kg m^2. The tolerance is round-off of an eigenvalue decomposition.
    path = file(urdf())
    assert hinge_inertia(path) == pytest.approx(2.25, rel=1e-12)
    found = crosscheck.importers(path)
    assert results(found) == {"MuJoCo": "SAME", "Pinocchio": "SAME"}
    # the reading of MuJoCo 3.12 is that of a file without the rotation
    own = read_by_all(path)[0]
    old = {each.importer: each for each in read_by_all(file(urdf(rpy="0 0 0")))}["MuJoCo"]
    compared = _compared(own, old, None)
    assert compared.result is Outcome.DIFFERENT
    [row] = [row for row in compared.differences if row.element_kind == "body"]
    assert row.element == "link"
    # 1.25 kg m^2 instead of 2.25: angular accelerations by gravity change by 80 %, the squares of velocities
    # in the accelerations do not
    assert row.effect is not None
    assert 0.4 < row.effect < 0.8 * (1.0 + 1e-9)


@pytest.mark.slow
def test_fused_inertia_of_a_rotated_link_is_mended_in_mujoco(file):
    # google-deepmind/mujoco#2982: MuJoCo 3.3.7 added a fused link's inertia without the rotation of the link
    links = LINK.format(name="link", center="0 0 0", rpy="0 0 0", ixx="1") + LINK.format(
        name="part", center="0 0 0", rpy="0 0 0", ixx="1"
    )
    joints = HINGE.format("j", "revolute", "base", "link", "0 0 0")
    joints += HINGE.format("f", "fixed", "link", "part", f"0 0 {QUARTER!r}")
    path = file(f'<robot name="r"><link name="base"/>{links}{joints}</robot>')
    # 1 kg m^2 of the link and 2 kg m^2 of the part, whose y axis is the hinge
    assert hinge_inertia(path) == pytest.approx(3.0, rel=1e-12)
    assert results(crosscheck.importers(path)) == {"MuJoCo": "SAME", "Pinocchio": "SAME"}


TRUNK = """<mujoco><worldbody><body name="trunk" pos="0 0 0.4"><freejoint name="root"/>
  <inertial pos="0 0 0" mass="5" diaginertia="1 1 1"/>
  <body name="hip" pos="0.2 0 0"><joint name="hip_joint" axis="1 0 0"/>
    <inertial pos="0 0 -0.1" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>"""


@pytest.mark.slow
def test_parent_of_a_hip_is_mended_in_pinocchio(file):
    # stack-of-tasks/pinocchio#2460: hips hung on the universe; Pinocchio 4.1 hangs them on the trunk
    path = file(TRUNK)
    model = pin.buildModelFromMJCF(path)
    assert model.parents[model.getJointId("hip_joint")] == model.getJointId("root")
    assert results(crosscheck.importers(path)) == {"MuJoCo": "SAME", "Pinocchio": "SAME"}


BASE = """<mujoco><worldbody><body name="base" quat="0 1 0 0"><body name="arm"><joint name="j" axis="0 1 0"/>
  <inertial pos="1 0 0" mass="1" diaginertia="1 1 1"/></body></body></worldbody></mujoco>"""


@pytest.mark.slow
def test_pose_of_a_fixed_root_body_is_lost_in_pinocchio(file, capsys, tmp_path):
    # stack-of-tasks/pinocchio#2782: the base of the file is turned by 180 degrees about x, so that gravity
    # acts along its z axis; Pinocchio places the base at the identity
    path = file(BASE)
    model = pin.buildModelFromMJCF(path)
    zero = np.zeros(1)
    in_pinocchio = pin.rnea(model, model.createData(), zero, zero, zero)
    in_mujoco = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(in_mujoco)
    mujoco.mj_forward(in_mujoco, data)
    if in_pinocchio == pytest.approx(data.qfrc_bias):
        pytest.skip("this version of Pinocchio contains the correction")
    # m g l = 9.81 N m, with the other sign
    assert (in_pinocchio[0], data.qfrc_bias[0]) == pytest.approx((-9.81, 9.81))

    status, output, _ = run(capsys, "importers", path, "--output", tmp_path / "out")
    assert status == 1
    assert "Pinocchio reads another robot" in output
    result = json.loads((tmp_path / "out" / "importers.json").read_text())
    assert result["outcome"] == "DIFFERENT"
    assert result["reference"] == "crosscheck"
    others = {each["importer"]: each for each in result["importers"]}
    assert others["MuJoCo"]["result"] == "SAME"
    assert others["Pinocchio"]["result"] == "DIFFERENT"
    # gravity of the other sign: accelerations at rest change by twice their size
    assert others["Pinocchio"]["motion"]["change"] == pytest.approx(2.0, rel=1e-6)


def test_a_refusal_is_a_row_with_the_message_of_the_importer(file, capsys, tmp_path):
    # 5 > 2 + 2.5: MuJoCo refuses moments of inertia that no rigid body can have, Pinocchio reads them
    path = file(urdf(rpy="0 0 0", ixx="5"))
    with pytest.raises(ValueError, match="A \\+ B >= C"):
        mujoco.MjModel.from_xml_path(path)
    status, output, _ = run(capsys, "importers", path, "--output", tmp_path / "out")
    assert status == 1
    assert "REFUSED" in output
    found = crosscheck.importers(path)
    assert results(found) == {"MuJoCo": "REFUSED", "Pinocchio": "SAME"}
    assert "A + B >= C" in found["MuJoCo"].reading.message
    assert "\n" not in found["MuJoCo"].reading.message
    assert found["MuJoCo"].differences == ()
    assert not found.same


@pytest.mark.slow
def test_negative_moments_of_a_link_that_pinocchio_merges(file):
    # a part with -0.5 kg m^2, as public files have, and the link without it
    links = LINK.format(name="link", center="0 0 0", rpy="0 0 0", ixx="1")
    links += LINK.format(name="part", center="0 0 0", rpy="0 0 0", ixx="-0.5")
    joints = HINGE.format("j", "revolute", "base", "link", "0 0 0")
    joints += HINGE.format("f", "fixed", "link", "part", "0 0 0")
    path = file(f'<robot name="r"><link name="base"/>{links}{joints}</robot>')
    # the sum of both moments
    assert pin.buildModelFromUrdf(path).inertias[1].inertia[0, 0] == pytest.approx(0.5)
    assert results(crosscheck.importers(path)) == {"MuJoCo": "REFUSED", "Pinocchio": "SAME"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "words"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "Segmentation fault (SIGSEGV)"),
        ("sys.exit(7)", "exit status 7"),
        ("sys.exit('last words')", "exit status 1: last words"),
    ],
)
@pytest.mark.skipif(os.name == "nt", reason="Windows has no signals of processes")
def test_a_crash_of_an_importer_is_one_line(file, tmp_path, monkeypatch, end, words):
    # a process that does what the real one does, except that the importer of Pinocchio ends it
    (tmp_path / "crashing.py").write_text(
        f"import os, signal, sys\nif sys.argv[1] == 'Pinocchio':\n    {end}\n"
        "from crosscheck.loading.importer_process import main\nmain()\n"
    )
    monkeypatch.setattr(loading, "PROCESS", "crashing")
    monkeypatch.syspath_prepend(str(tmp_path))
    found = crosscheck.importers(file(urdf()))
    assert found["Pinocchio"].result is Failure.CRASHED
    assert words in found["Pinocchio"].reading.message
    assert "\n" not in found["Pinocchio"].reading.message
    assert found["MuJoCo"].result is Outcome.SAME
    assert found.outcome.exit_status() == 1


def test_a_package_that_is_not_installed(file, tmp_path, monkeypatch):
    folder = tmp_path / "broken"
    folder.mkdir()
    (folder / "pinocchio.py").write_text("raise ModuleNotFoundError('no pinocchio', name='pinocchio')\n")
    path = file(TRUNK)
    monkeypatch.setattr(sys, "path", [str(folder), *sys.path])
    found = crosscheck.importers(path)
    assert found["Pinocchio"].result is Failure.NOT_INSTALLED
    assert found["Pinocchio"].reading.message == "the package pinocchio is not installed"
    assert found["MuJoCo"].result is Outcome.SAME


@pytest.mark.slow
def test_what_an_importer_leaves_out_by_its_documentation(file):
    path = file(TRUNK.replace("</mujoco>", '<actuator><motor joint="hip_joint"/></actuator></mujoco>'))
    found = crosscheck.importers(path)
    assert results(found) == {"MuJoCo": "SAME", "Pinocchio": "SAME"}
    assert found["Pinocchio"].drives_left_out == 1
    # a spring changes the motion: it is listed as left out, and the robot is another one
    found = crosscheck.importers(file(TRUNK.replace('name="hip_joint"', 'name="hip_joint" stiffness="30"')))
    assert results(found) == {"MuJoCo": "SAME", "Pinocchio": "DIFFERENT"}
    assert found["Pinocchio"].differences == ()
    [row] = found["Pinocchio"].left_out
    assert (row.element, row.quantity, row.first) == ("hip_joint", "stiffness", 30.0)


def test_a_file_that_no_importer_reads(file):
    found = crosscheck.importers(file("<mujoco><worldbody><body></mujoco>"))
    assert {each.result for each in found.comparison.others} == {Failure.REFUSED}
    assert len(found.comparison.others) == 3
    assert found.comparison.reference is None
    assert found.outcome is Outcome.DIFFERENT


@pytest.mark.parametrize("name", ["robot.txt", "missing.xml"])
def test_what_is_no_model_file(tmp_path, name):
    (tmp_path / "robot.txt").write_text("x")
    with pytest.raises((CrosscheckError, SourceError), match=name):
        crosscheck.importers(str(tmp_path / name))


@pytest.mark.slow
def test_files_of_other_folders_are_read_by_all_importers_and_by_diff_with_their_root(file, tmp_path):
    """A scene of two folders, as in Metaworld: `../scene/basic_scene.xml`."""
    path = file(TRUNK)
    inner = tmp_path / "robots" / "inner"
    inner.mkdir(parents=True)
    (tmp_path / "robots" / "gravity.xml").write_text("<mujoco><option gravity='0 0 -9.81'/></mujoco>")
    scene = inner / "scene.xml"
    scene.write_text(TRUNK.replace("<worldbody>", '<include file="../gravity.xml"/><worldbody>', 1))
    found = crosscheck.importers(scene)
    assert found.comparison.reference.importer == OWN
    assert found["MuJoCo"].result is Outcome.SAME
    with pytest.raises(SourceError, match="leads outside of"):
        crosscheck.diff(path, scene)
    assert crosscheck.diff(path, scene, second_options={"root": str(tmp_path)}).same
    with pytest.raises(CrosscheckError, match="has no option 'loops' in a comparison of files; it has root"):
        crosscheck.diff(path, scene, second_options={"loops": "a.yaml"})


@pytest.mark.slow
def test_an_include_that_is_missing_is_a_refusal(file, tmp_path):
    (tmp_path / "parts.xml").write_text('<mujocoinclude><include file="nothing.xml"/></mujocoinclude>')
    found = crosscheck.importers(file(TRUNK.replace("<worldbody>", '<include file="parts.xml"/><worldbody>')))
    # Pinocchio reads no includes
    assert found.comparison.reference.importer == "Pinocchio"
    assert results(found) == {"crosscheck": "REFUSED", "MuJoCo": "REFUSED"}


def test_numbers_of_pinocchio_that_are_not_finite():
    # Pinocchio 4.1 reads such an inertia for a camera of MuJoCo Menagerie, realsense_d435i/d435i.xml
    model = pin.Model()
    placement = pin.SE3.Identity()
    joint = model.addJoint(0, pin.JointModelRX(), placement, "j")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), placement)
    model.addBodyFrame("b", joint, placement, 0)
    model.inertias[joint].mass = math.nan
    with pytest.raises(SourceError, match="body 'b' has numbers that are not finite"):
        describe_model(model)


CONNECTED = """<mujoco><worldbody><body name="base"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
  <body name="a" pos="1 0 0"><joint name="ja" axis="0 1 0"/>
    <inertial pos="0 0 0.1" mass="1" diaginertia="1 1 1"/>
    <site name="a1"/><site name="a2" pos="0 0.1 0"/></body>
  <body name="b"><joint name="jb" axis="0 1 0"/><inertial pos="0 0 0.1" mass="1" diaginertia="1 1 1"/>
    <site name="b1" pos="1 0 0"/><site name="b2" pos="1 0.1 0"/></body></body></worldbody>
  <equality><connect name="z" site1="a1" site2="b1"/><connect name="y" site1="a2" site2="b2"/></equality>
  </mujoco>"""


@pytest.mark.slow
@pytest.mark.parametrize("names", [("z", "y"), ("", "")])
def test_loops_in_another_order_are_paired_by_their_points(file, names):
    # Pinocchio sorts constraints by name, and gives its own none
    text = CONNECTED.replace('name="z"', f'name="{names[0]}"').replace('name="y"', f'name="{names[1]}"')
    found = crosscheck.importers(file(text))
    assert results(found) == {"MuJoCo": "SAME", "Pinocchio": "SAME"}


@pytest.mark.slow
def test_an_mjcf_and_a_urdf_file_of_one_name_have_folders_of_their_own(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    body = '<body name="link"><joint name="j" axis="1 0 0"/><geom size="0.1"/></body>'
    texts = {"robot.xml": f"<mujoco><worldbody>{body}</worldbody></mujoco>", "robot.urdf": urdf()}
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        status, output, _ = run(capsys, "importers", name)
        assert status == 0
        assert f"wrote output/importers/{name}/importers.json" in output
    for name in texts:
        result = tmp_path / "output" / "importers" / name / "importers.json"
        assert json.loads(result.read_text())["source"] == name
