"""Two models that start elsewhere: laid over each other by what their bodies carry."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_against import FAULT, ROUND_OFF, compared, first_failing
from test_two_ways import states_of, whole

import mjcf
from crosscheck.compare.check import START
from crosscheck.studies.faults import injection
from crosscheck.studies.faults.injection import Injection
from newton_euler.runs.assemble import assemble


@pytest.mark.parametrize(
    ("fault", "quantity", "where"),
    [
        (injection.mass("coupler", FAULT), "mass", "coupler"),
        (injection.inertia_entry("rocker", 0, 1, FAULT), "inertia", "rocker"),
        (injection.center_of_mass("crank", np.array([0.0, 0.0, FAULT])), "center of mass, m", "crank"),
        (injection.joint_point("b", np.array([FAULT, 0.0, 0.0])), "joint constraint violation, m", "b"),
        (lambda scene: scene, "positions, m", "coupler"),
    ],
)
def test_models_that_start_elsewhere_are_compared_by_equal_body_frames(
    fault: Injection, quantity: str, where: str
) -> None:
    scene, found, *_ = whole()
    other = replace(fault(scene), initial_state=None)
    result = compared(scene, replace(other, initial_state=assemble(other, states_of(found)[5])))
    assert first_failing(result) == (START if quantity == "positions, m" else "model", quantity, where)
    assert result.notes[0].startswith("starts differ: positions, m: 2.")


STACKS = {
    "planar": '<joint name="s" type="slide" axis="1 0 0"/><joint name="t" type="slide" axis="0 0 1"/>'
    '<joint name="h" axis="0 1 0"/>',
    "three hinges": '<joint name="h" axis="1 0 0"/><joint name="i" axis="0 1 0"/>'
    '<joint name="j" axis="0 0 1"/>',
    "universal in slot": '<joint name="s" type="slide" axis="0 0 1"/><joint name="h" axis="1 0 0"/>'
    '<joint name="i" axis="0 1 0"/>',
    "ball in slot": '<joint name="s" type="slide" axis="1 0 0"/><joint name="b" type="ball"/>',
}
"""Joints of one body, from its parent on."""

BALLS = {0.3: "0.9 0.1 0.3 0.2", -0.8: "0.8 -0.3 0.1 0.4"}
"""Quaternions beside other coordinates."""


def stacked(joints: list[str]) -> str:
    """An arm, a body on it by these joints, and two keyframes of which nothing is zero."""
    poses = []
    for x, ball in BALLS.items():
        own = (ball if "ball" in joint else f"{x / (1.0 + k)}" for k, joint in enumerate(joints))
        poses.append(" ".join([f"{0.4 * x}", *own]))
    return f"""<mujoco><compiler angle="radian"/><worldbody><body name="arm"><joint name="a" axis="0 1 0"/>
    <inertial pos="0.02 0 0.05" mass="0.3" diaginertia="2e-3 2.1e-3 1e-4"/><body name="pin" pos="0 0 0.1">
    {"".join(joints)}<inertial pos="0.05 0.01 0.03" mass="0.5"
    fullinertia="3e-3 4e-3 3.5e-3 1e-4 2e-4 1.5e-4"/></body></body></worldbody>
    <keyframe><key name="k0" qpos="{poses[0]}"/><key name="k1" qpos="{poses[1]}"/></keyframe></mujoco>"""


@pytest.mark.parametrize("kind", STACKS)
@pytest.mark.parametrize("backwards", [False, True])
def test_another_keyframe_of_one_file_is_another_start(tmp_path: Path, kind: str, backwards: bool) -> None:
    joints = re.findall("<joint[^>]*>", STACKS[kind])
    model = tmp_path / "model.xml"
    model.write_text(stacked(joints[::-1] if backwards else joints))
    first, second = (mjcf.read(model, key).scene for key in ("k0", "k1"))
    result = compared(first, second)
    assert first_failing(result)[0] == START
    figures = [row for row in result.checks if row.level == "model" and row.judged]
    assert all(row.value < ROUND_OFF for row in figures)
