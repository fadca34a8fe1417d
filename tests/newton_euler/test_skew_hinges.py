"""Hinges of one body whose axes do not meet, in both formulations and in all formats."""

from __future__ import annotations

import numpy as np
import pytest

import crosscheck
import mjcf
import urdf
from crosscheck.library.scene_file import read_scene, write_scene
from mjcf import read
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.errors import MechanismError
from newton_euler.model.compound_joint import Compound
from newton_euler.reading.excitation import random_states
from urdf import read as read_urdf

PAIR = """
<joint name="{0}_a" axis="1 0.2 0" pos="0.05 0.1 -0.02" stiffness="3" damping="0.2" armature="0.03"/>
<joint name="{0}_b" axis="0.1 1 0.3" pos="-0.1 0.02 0.2" stiffness="2" springref="0.3"/>"""
TRIPLE = PAIR + '<joint name="{0}_c" axis="0 0.3 1" pos="0.1 0.15 0.07" damping="0.1" armature="0.01"/>'
SLIDES = '<joint name="{0}_s" type="slide" axis="1 0.1 0.4" stiffness="40" damping="1"/>'
BODY = """<body name="{0}" pos="{1}">{2}
<inertial pos="{3}" mass="{4}" fullinertia="0.02 0.03 0.025 0.002 -0.001 0.003"/>"""


def model(upper: str, lower: str, loop: str = "") -> str:
    """Two bodies in a row, the outer one also held by an equality; `{key}` is left for a keyframe."""
    return (
        '<mujoco><option gravity="1 -2 -9.81"/><worldbody><site name="wall" pos="0.3 0.4 -0.5"/>'
        + BODY.format("upper", "0 0 0.1", upper.format("u"), "0.1 0.05 -0.2", 1.3)
        + BODY.format("lower", "0.2 0.1 -0.4", lower.format("l"), "0.05 0.2 -0.1", 0.7)
        + '<site name="tip" pos="0.1 0.3 -0.2"/></body></body></worldbody>'
        + loop
        + "{key}</mujoco>"
    )


CONNECT = '<equality><connect name="loop" site1="wall" site2="tip"/></equality>'
MODELS = {
    "a pair in a tree": model(PAIR, '<joint name="elbow" axis="0 1 0"/>'),
    "pair after triple": model(TRIPLE, PAIR),
    "slide, then a pair": model(SLIDES + PAIR, TRIPLE),
    "a pair, then a slide": model(PAIR + SLIDES, TRIPLE),
    "triples in a loop": model(TRIPLE, TRIPLE, CONNECT),
    "pair and triple in a loop": model(PAIR, TRIPLE, CONNECT),
    "slide and pair in a loop": model(SLIDES + PAIR, TRIPLE, CONNECT),
}


@pytest.mark.parametrize("name", MODELS)
def test_accelerations_are_those_of_the_file(name, tmp_path):
    """Reading holds the joint-coordinate form to MuJoCo's own model of the file, in motion and at rest."""
    path = tmp_path / "model.xml"
    path.write_text(MODELS[name].format(key=""))
    found = read(path)
    assert any(line.startswith("verified against the file's own model") for line in found.report.start)
    assert len(found.scene.mechanism.bodies) == 3  # no link of its own between the hinges
    relative, cartesian = Relative(found.scene), Cartesian(found.scene)
    for state in random_states(found.scene, 2):
        wanted = relative.evaluate(*relative.coordinates(state))
        here = cartesian.evaluate(*cartesian.coordinates(state))
        for array in ("linear_acceleration", "angular_acceleration"):
            # conditions of 1e4 of accelerations up to 100
            assert getattr(here, array) == pytest.approx(getattr(wanted, array), rel=0.0, abs=1e-10)


def test_other_formats_keep_the_offsets(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(MODELS["slide, then a pair"].format(key=""))
    scene = read(path).scene
    mjcf.write(scene, tmp_path / "again.xml")
    urdf.write(scene, tmp_path / "again.urdf")
    write_scene(scene, tmp_path / "again.yaml")
    others = [
        read(tmp_path / "again.xml").scene,
        read_urdf(tmp_path / "again.urdf").scene,
        read_scene(tmp_path / "again.yaml"),
    ]
    for other in others:
        assert len(other.mechanism.joints) == 2
        for one, two in zip(scene.mechanism.joints, other.mechanism.joints, strict=True):
            assert isinstance(one, Compound)
            assert isinstance(two, Compound)
            assert np.allclose(two.offsets, one.offsets, atol=1e-14)  # round-off of frames
            assert np.linalg.norm(one.offsets) > 0.1


def test_offsets_are_checked():
    ends, hinges = ("j", "a", "b", [0, 0, 0]), [[1, 0, 0], [0, 1, 0]]
    with pytest.raises(MechanismError, match="has 2 offsets between 2 hinges"):
        Compound(*ends, hinges=hinges, offsets=[[0, 0, 1], [0, 0, 1]])
    with pytest.raises(MechanismError, match="offsets is 5"):
        Compound(*ends, hinges=hinges, offsets=5)
    joint = Compound(*ends, hinges=hinges, offsets=[[0, 0, 1]])
    assert joint.point_on_second.tolist() == [0, 0, 1]


def test_where_on_their_axes_the_file_puts_the_hinges_makes_no_difference(tmp_path):
    """Moved along their axes, the anchors of a triple are those of the same joint; moved off, of another."""
    text = MODELS["pair after triple"].format(key="")
    moved = {
        '"0.05 0.1 -0.02"': '"0.25 0.14 -0.02"',
        '"-0.1 0.02 0.2"': '"-0.08 0.22 0.26"',
        '"0.1 0.15 0.07"': '"0.1 0.21 0.27"',
    }
    other = text.replace('"-0.1 0.02 0.2"', '"-0.1 0.03 0.2"')
    for old, new in moved.items():
        assert old in text
        text = text.replace(old, new)
    paths = [tmp_path / name for name in ("one.xml", "two.xml", "three.xml")]
    for path, content in zip(paths, (MODELS["pair after triple"].format(key=""), text, other), strict=True):
        path.write_text(content)
    assert crosscheck.diff(paths[0], paths[1]).same
    assert not crosscheck.diff(paths[0], paths[2]).same
