"""Reading MJCF: what limits, flags and groups make of forces, and what reports say of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from mjcf_models import ELEMENTS, PAIR, model, reading, verified

from mjcf.errors import MjcfError


@pytest.mark.parametrize("limit", [3, 30], ids=["beyond", "within"])
def test_the_limit_of_a_force_is_left_out(limit: int, tmp_path: Path) -> None:
    text = ELEMENTS["actuators"].replace('kp="20"', f'kp="20" forcerange="-{limit} {limit}"')
    found = reading(tmp_path, text)
    assert verified(found)
    (entry,) = (e for e in found.report.of("left out") if e.topic == "limit of the force")
    assert entry.how == f"its limit of the force, -{limit} to {limit}"
    assert entry.element in [e.element for e in found.report.of("exactly")]


def test_a_control_is_reported_within_its_range(tmp_path: Path) -> None:
    report = reading(tmp_path, ELEMENTS["actuators"]).report
    (held,) = (
        e.how for e in report.of("exactly") if "control law of joint 'p', its control held at 1" in e.how
    )
    assert "its control 5 is clipped to 1" in held


LIMITED = model(
    PAIR.replace('name="p"', 'name="p" actuatorfrcrange="-2 1" damping="0.1"'),
    '<tendon><fixed name="t" actuatorfrcrange="-9 3"><joint joint="q" coef="2"/></fixed>'
    '<fixed name="unlimited"><joint joint="q" coef="1"/></fixed></tendon>'
    '<actuator><motor name="one" joint="p"/><position name="two" joint="p" kp="20" kv="5"/>'
    '<motor name="three" tendon="t" gear="0.5"/><motor name="four" tendon="t"/></actuator>'
    '<keyframe><key qpos="0.1 0 0" qvel="{qvel} 0 0" ctrl="1 0.4 4 8"/></keyframe>',
)


@pytest.mark.parametrize("qvel", ["0", "1.3"])
def test_joints_and_tendons_with_limits_of_actuator_forces(qvel: str, tmp_path: Path) -> None:
    found = reading(tmp_path, LIMITED.format(qvel=qvel))
    assert verified(found)
    laws = {(law.joint, law.coordinate): law for law in found.scene.control}
    assert laws["p", 0].force(0.0, 0.2, 0.0) == pytest.approx(1.0 + 20.0 * (0.4 - 0.1) - 5.0 * 0.2, rel=1e-14)
    assert laws["two_joints", 1].force(0.1, 0.2, 0.0) == pytest.approx(2.0 * (0.5 * 4.0 + 8.0), rel=1e-14)
    entries = {str(entry) for entry in found.report.of("left out")}
    assert "joint 'p': left out: its limit of actuator forces, -2 to 1" in entries
    for name in ("three", "four"):
        assert f"actuator {name!r}: left out: its tendon's limit of actuator forces, -9 to 3" in entries


GROUP = '<option actuatorgroupdisable="1 30"/>'
FLAG = '<option><flag actuation="disable"/></option>'


@pytest.mark.parametrize(
    ("option", "why"),
    [(GROUP, "the file disables actuators of group 1"), (FLAG, "the file disables actuators")],
)
def test_disabled_actuators(option: str, why: str, tmp_path: Path) -> None:
    motors = (
        '<actuator><motor name="off" group="1" joint="p" armature="0.2" gear="2"/>'
        '<motor name="on" joint="q"/></actuator><keyframe><key ctrl="3 4"/></keyframe>'
    )
    found = reading(tmp_path, model(PAIR, motors, option))
    assert verified(found)
    assert f"actuator 'off': left out: {why}" in [str(entry) for entry in found.report.of("left out")]
    assert {law.joint: law.force(0.0, 0.0, 0.0) for law in found.scene.control} == (
        {"two_joints": 4.0} if option == GROUP else {}
    )
    # MuJoCo has the rotor all the same
    (rotor,) = found.scene.armatures
    assert (rotor.joint, rotor.inertia) == ("p", pytest.approx(0.8))


@pytest.mark.parametrize(("spring", "damper"), [("disable", "disable"), ("enable", "disable")])
def test_gravity_compensation_with_flags(spring: str, damper: str, tmp_path: Path) -> None:
    flags = f'<option><flag spring="{spring}" damper="{damper}"/></option>'
    found = reading(tmp_path, model(PAIR.replace('name="two"', 'name="two" gravcomp="0.4"'), "", flags))
    assert verified(found)
    assert len(found.scene.forces) == (spring == "enable")


def test_only_what_is_left_out_is_taken_away(tmp_path: Path) -> None:
    """A spring's part that is not linear, but neither its linear one nor the armature of the joint."""
    text = ELEMENTS["springs and dampers"].replace('stiffness="20"', 'stiffness="20 99" armature="0.3"')
    found = reading(tmp_path, text)
    assert verified(found)
    damped = reading(tmp_path, ELEMENTS["springs and dampers"].replace('damping="2"', 'damping="2 3"'))
    assert [e for e in damped.report.of("left out") if e.topic == "not linear"]


COMPENSATED = PAIR.replace('name="p"', 'name="p" actuatorgravcomp="true" actuatorfrcrange="-1 1"').replace(
    'name="one"', 'name="one" gravcomp="1"'
)
PUSHED = PAIR.replace('name="p"', 'name="p" actuatorfrcrange="-1 1"')


@pytest.mark.parametrize("control", [0, 3], ids=["within", "beyond"])
@pytest.mark.parametrize(
    ("text", "actuators", "others"),
    [
        (COMPENSATED, "", "gravity compensation"),
        (PUSHED, '<motor site="s1" gear="0 0 50 0 0 0"/>', "forces on sites"),
    ],
)
def test_a_limit_that_counts_more_than_a_law_is_left_out_whatever_that_does(
    text: str, actuators: str, others: str, control: int, tmp_path: Path
) -> None:
    key = f'<keyframe><key ctrl="{control}{" 1" * bool(actuators)}"/></keyframe>'
    found = reading(tmp_path, model(text, f'<actuator><motor joint="p"/>{actuators}</actuator>{key}'))
    assert verified(found)
    (number,) = (k for k, e in enumerate(found.report.entries) if e.topic == "limit of actuator forces")
    entry = found.report.entries[number]
    assert (entry.fate, entry.how) == (
        "left out",
        f"its limit of actuator forces, -1 to 1, which includes {others}",
    )
    assert number not in found.report.watches


SHEET = (
    '<flexcomp name="f" type="grid" count="4 1 1" spacing=".1 .1 .1" pos="0 0 3" mass="1" radius="0.01" '
    'dim="1"><edge stiffness="10"/><contact selfcollide="none"/></flexcomp>'
)
STRETCHED = "0 0 0 0 0 0 0.02 0 0 0.01 0.02 0 0.03 0 0.01"
SITED = '<actuator><motor site="s1" gear="0 0 50 0 0 0"/></actuator><keyframe><key ctrl="3"/></keyframe>'
MUSCLE = (
    '<actuator><muscle joint="p" lengthrange="0 1"/></actuator><keyframe><key act="0.5" ctrl="1"/></keyframe>'
)


@pytest.mark.parametrize(
    ("text", "entry"),
    [
        (model(PAIR, "", '<option wind="3 1 2" density="50" viscosity="0.1"/>'), "option wind"),
        (model(PAIR + SHEET, f'<keyframe><key qpos="{STRETCHED}"/></keyframe>'), "1 flexes"),
        (model(PAIR.replace('name="p"', 'name="p" actuatorfrcrange="-1 1"'), SITED), "joint 'p'"),
        (model(PAIR, MUSCLE), "actuator 0"),
    ],
    ids=["wind", "flex", "limit of what a wrench does", "muscle"],
)
def test_what_is_left_out_explains_the_difference(text: str, entry: str, tmp_path: Path) -> None:
    found = reading(tmp_path, text)
    assert entry in [e.element for e in found.report.of("left out")]
    assert verified(found)


def test_what_no_reading_covers_is_refused(tmp_path: Path) -> None:
    """Gravity compensation that counts as an actuator's, in a file that disables actuators."""
    text = PAIR.replace('name="p"', 'name="p" actuatorgravcomp="true"').replace('"one"', '"one" gravcomp="1"')
    with pytest.raises(MjcfError, match=r"joint 'p': the scene is not what the file says: actuators"):
        reading(tmp_path, model(text, "", FLAG))
