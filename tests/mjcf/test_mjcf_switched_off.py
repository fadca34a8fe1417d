"""What an MJCF file itself switches off is counted, and no engine simulates it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import pytest

from mjcf import read

BODIES = """<body name="a">
    <joint name="a" axis="0 1 0" {joint}/><geom name="g" size="0.1" pos="0 0 0.3" {geom}/>
    <body name="b" pos="0.5 0 0"><joint name="b" axis="0 1 0"/><geom size="0.1" pos="0.3 0 0"/></body>
    </body>"""
EQUALITY = '<equality><connect name="close" body1="b" anchor="0.3 0 0" {equality}/></equality>'
ACTUATOR = '<actuator><motor name="m" joint="a" group="2" {actuator}/></actuator>'
TENDON = '<tendon><fixed name="t" {tendon}><joint joint="a" coef="1"/></fixed></tendon>'
TENDON_AND_GEOMS = {"tendon 't'", "2 geoms that can touch"}
FLUID = {"option density", "option wind"}


@pytest.mark.parametrize(
    ("option", "parts", "elements"),
    [
        ('<flag equality="disable"/>', {}, {"equality 'close'"}),
        ('<flag constraint="disable"/>', {}, {"equality 'close'", "2 geoms that can touch"}),
        ("", {"equality": 'active="false"'}, {"equality 'close'"}),
        ('<flag gravity="disable"/>', {}, {"gravity"}),
        ('<flag spring="disable"/>', {"joint": 'stiffness="3"'}, {"spring"}),
        ('<flag damper="disable"/>', {"joint": 'damping="3"'}, {"damper"}),
        ('<flag spring="disable" damper="disable"/>', {}, set()),
        ('<flag limit="disable"/>', {"joint": 'limited="true" range="-1 1"'}, {"joint 'a'"}),
        ('<flag frictionloss="disable"/>', {"joint": 'frictionloss="1"'}, {"joint 'a'"}),
        ('<flag contact="disable"/>', {}, {"2 geoms that can touch"}),
        ('<flag constraint="disable"/>', {"tendon": 'range="-1 1" limited="true"'}, TENDON_AND_GEOMS),
        ('<flag constraint="disable"/>', {"tendon": 'frictionloss="1"'}, TENDON_AND_GEOMS),
        ('<flag limit="disable"/>', {"tendon": 'range="-1 1" limited="true"'}, {"tendon 't'"}),
        (
            '<flag spring="disable" damper="disable"/></option><option density="9" wind="1 0 0">',
            {},
            FLUID,
        ),
        ('<flag damper="disable"/>', {"actuator": 'damping="3"'}, {"actuator 'm'"}),
        ('<flag spring="disable"/>', {"joint": 'stiffness="3" damping="1" springyield="1"'}, {"spring"}),
        ('<flag spring="disable"/>', {"tendon": 'stiffness="3" damping="1" springyield="1"'}, {"spring"}),
        ('<flag spring="disable"/>', {"tendon": 'stiffness="3"'}, {"spring"}),
        ('<flag actuation="disable"/>', {}, {"actuator 'm'"}),
    ],
)
def test_what_the_file_switches_off_is_counted(
    option: str, parts: dict[str, str], elements: set[str], tmp_path: Path
) -> None:
    words = {"joint": "", "geom": "", "equality": "", "actuator": "", "tendon": ""} | parts
    equality = EQUALITY if "equality 'close'" in elements else ""
    path = tmp_path / "model.xml"
    tendon = TENDON if "tendon" in parts else ""
    text = f"{BODIES}</worldbody>{equality}{tendon}{ACTUATOR}".format(**words)
    path.write_text(f"<mujoco><option>{option}</option><worldbody>{text}</mujoco>")
    report = read(path).report
    off = {entry.element for entry in report.entries if entry.is_off}
    assert off == elements
    assert not any(entry.is_off for entry in report.unsimulated())


def test_actuators_of_disabled_groups_and_contact_exclusions_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    text = f"{BODIES}</worldbody>{ACTUATOR}".format(joint="", geom="", actuator="")
    exclude = '<contact><exclude body1="a" body2="b"/></contact>'
    path.write_text(f'<mujoco><option actuatorgroupdisable="2"/><worldbody>{text}{exclude}</mujoco>')
    entries = {entry.element: entry for entry in read(path).report.entries}
    assert entries["actuator 'm'"].is_off
    assert entries["1 contact exclusion"].moves_nothing


def test_dampings_of_disabled_actuators_act(tmp_path: Path) -> None:
    """MuJoCo has them among the passive forces of the joint: 3 N m s/rad times 1 rad/s."""
    path = tmp_path / "model.xml"
    text = f"{BODIES}</worldbody>{ACTUATOR}".format(joint="", geom="", actuator='damping="3"')
    path.write_text(f'<mujoco><option><flag actuation="disable"/></option><worldbody>{text}</mujoco>')
    model: Any = mujoco.MjModel.from_xml_path(str(path))
    data: Any = mujoco.MjData(model)
    data.qvel[0] = 1.0
    mujoco.mj_forward(model, data)
    assert data.qfrc_passive[0] == -3.0
    (damping,) = (entry for entry in read(path).report.unsimulated() if entry.topic == "damping")
    assert damping.element == "actuator 'm'"


@pytest.mark.parametrize("name", ["inf", "nan", "-Infinity"])
def test_names_are_free_text(name: str, tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(
        f'<mujoco><worldbody><body name="{name}"><joint name="{name}"/>'
        f'<geom name="{name}" size="0.1"/></body>'
        f'</worldbody><actuator><motor name="{name}" joint="{name}"/></actuator></mujoco>'
    )
    assert len(read(path).scene.mechanism.bodies) == 2


def test_a_motor_of_two_inputs_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "motor.xml"
    motor = '<dcmotor name="m" joint="a" motorconst="1" resistance="2" input="pos vel" controller="8 0 3"/>'
    path.write_text(
        '<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/></body>'
        f"</worldbody><actuator>{motor}</actuator></mujoco>"
    )
    assert (
        next(entry.element for entry in read(path).report.of("left out") if not entry.moves_nothing)
        == "actuator 'm'"
    )
