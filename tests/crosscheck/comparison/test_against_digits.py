"""Files of other units and fewer digits against each other: no difference as far as their digits go."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import run

DEGREES = """<mujoco><worldbody><body name="rod"><joint name="a" axis="0 1 0" limited="true" range="-5 90"/>
<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody></mujoco>"""

RADIANS = """<robot name="arm"><link name="base"/><link name="rod"><inertial><origin xyz="0.1 0 0"/>
<mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="a" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="{}" upper="{}" effort="5" velocity="3"/></joint></robot>"""


@pytest.mark.parametrize(
    ("lower", "upper", "same"),
    [
        ("-0.0872665", "1.5708", True),  # six digits of pi / 36 and of pi / 2, 4e-6 rad above that
        ("-0.0872665", "1.5709", False),
        ("-0.0873665", "1.5708", False),
    ],
)
def test_limits_in_degrees_are_those_in_radians_to_six_digits(capsys, tmp_path: Path, lower, upper, same):
    first, second = tmp_path / "degrees.xml", tmp_path / "radians.urdf"
    first.write_text(DEGREES)
    second.write_text(RADIANS.format(lower, upper))
    settings = ("--set", "duration=0.1", "--output", tmp_path / "out")
    status, out, err = run(capsys, "run", first, "--against", second, *settings)
    assert (status, err) == (0 if same else 1, "")
    told = "" if same else " in what is not compared: joint 'a', limits: range from the start -0.08726"
    assert out.splitlines()[-1].startswith("SAME: " if same else f"DIFFERENT{told}")
