"""Limits, contacts and dry friction of a file in a run without them: whether they act, by closed forms."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from crosscheck.compare.activity import watched
from mjcf import read
from newton_euler import simulate
from newton_euler.model.trajectory import IntegrationError
from newton_euler.reading.activity import UNSETTLED, SampledMotion
from newton_euler.reading.import_report import ImportReport
from urdf import read as read_urdf

FALL = """<mujoco><option gravity="0 0 -10"/><worldbody>
<geom name="floor" type="plane" size="9 9 1"/>{above}
<body name="ball" pos="0 0 1.3"><freejoint/><geom name="ball" size="0.1" margin="{margin}"/></body>
</worldbody></mujoco>"""

SWING = """<mujoco><option gravity="0 0 {gravity}"/><worldbody><site name="wall" pos="1 0 0"/>
<body><joint name="j" axis="0 1 0" {joint}/><geom type="box" size="0.5 0.1 0.1" pos="0.5 0 0" mass="1"/>
<site name="tip" pos="1 0 0"/></body></worldbody>{more}</mujoco>"""
"""A bar, level at the start."""


def after(path: Path, duration: float) -> ImportReport:
    found = (read_urdf if path.suffix == ".urdf" else read)(path, duration=duration, output_period=0.01)
    return found.report.after(SampledMotion(found.scene, simulate(found.scene)))


def told(report: ImportReport, start: str) -> tuple[str, str]:
    (entry,) = (e for e in report.entries if f"{e.element}: {e.account}".startswith(start))
    return entry.fate, entry.account


def mjcf(folder: Path, text: str) -> Path:
    path = folder / "model.xml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("duration", "margin", "fate", "how"),
    [
        (0.48, 0.0, "inactive", "inactive at all 49 output times and at 15 time points between each two"),
        # it has 1.2 m to fall, sqrt(2 * 1.2 / 10) = 0.4899 s
        (
            0.5,
            0.0,
            "left out",
            "active at 17 of 801 time points, first at 0.49 s: geom 'floor' and geom 'ball'",
        ),
        # 0.2 m earlier: sqrt(2 * 1.0 / 10) = 0.4472 s
        (0.48, 0.2, "left out", "active at 53 of 769 time points, first at 0.4475 s"),
    ],
)
def test_contacts_are_seen_by_their_margin(duration, margin, fate, how, tmp_path):
    report = after(mjcf(tmp_path, FALL.format(margin=margin, above="")), duration)
    found = told(report, "2 geoms that can touch")
    assert found[0] == fate
    assert how in found[1]
    assert report.counts() == f"1 element is {fate} (2 geoms that can touch: contacts)"


def test_contacts_are_seen_on_all_parts_of_a_body(tmp_path):
    """A ball on an arm that is fixed to a turning body, which MuJoCo has as a body of its own."""
    text = """<mujoco><option gravity="0 0 0"/><worldbody>
    <geom name="post" type="sphere" size="0.1" pos="0 1 0"/>
    <body><joint name="j" axis="0 0 1"/><geom type="sphere" size="0.1" contype="0" conaffinity="0"/>
    <body pos="1 0 0" euler="30 20 10"><geom name="hand" size="0.1"/></body></body></worldbody>
    <keyframe><key qvel="1"/></keyframe></mujoco>"""
    fate, how = told(after(mjcf(tmp_path, text), 1.6), "2 geoms that can touch")
    # the centers are 0.2 m apart at a chord of 2 sin(angle / 2): from pi/2 - 0.2003 = 1.3705 s on
    assert fate == "left out"
    assert "first at 1.371 s: geom 'post' and geom 'hand'" in how


def test_limits_are_seen_with_how_near_they_came(tmp_path):
    """Without gravity the angle is the rate times time."""
    text = SWING.format(gravity=0, joint='range="-20 {}"', more='<keyframe><key qvel="1"/></keyframe>')
    fate, how = told(after(mjcf(tmp_path, text.format(60)), 1.0), "joint 'j': its limits")
    assert (fate, how.split("; ")[-1]) == ("inactive", "closest 0.0472 rad at 1 s")  # pi/3 - 1
    fate, how = told(after(mjcf(tmp_path, text.format(45)), 1.0), "joint 'j': its limits")
    assert (fate, how.split("; ")[-1]) == ("left out", "passed from 0.7856 s on, by up to 0.215 rad")


def test_turns_are_counted(tmp_path):
    text = SWING.format(gravity=0, joint='range="-20 720"', more='<keyframe><key qvel="10"/></keyframe>')
    fate, how = told(after(mjcf(tmp_path, text), 1.5), "joint 'j': its limits")
    assert (fate, how.split("; ")[-1]) == ("left out", "passed from 1.257 s on, by up to 2.43 rad")


def test_dry_friction_does_nothing_where_nothing_moves(tmp_path):
    text = SWING.format(gravity="{}", joint='frictionloss="0.1"', more="")
    assert told(after(mjcf(tmp_path, text.format(0)), 0.1), "joint 'j': its dry")[0] == "inactive"
    fate, how = told(after(mjcf(tmp_path, text.format(-10)), 0.1), "joint 'j': its dry")
    assert (fate, how.split("; ")[-1]) == ("left out", "moves from 0.000625 s on")


@pytest.mark.parametrize(("limit", "fate"), [(0.9, "left out"), (1.0, "inactive")])
def test_limits_of_tendons_through_sites(limit, fate, tmp_path):
    """The tip of the bar goes around a circle of 1 m: the chord is 2 sin(t / 2), 0.9589 at 1 s."""
    sites = '<site site="wall"/><site site="tip"/>'
    more = f'<tendon><spatial name="t" range="-1 {limit}">{sites}</spatial></tendon>'
    text = SWING.format(gravity=0, joint="", more=more + '<keyframe><key qvel="1"/></keyframe>')
    found, how = told(after(mjcf(tmp_path, text), 1.0), "tendon 't': its limits")
    assert found == fate
    assert ("0.0411 m at 1 s" if fate == "inactive" else "passed from 0.9338 s on, by up to 0.0589 m") in how


SHOT = """<mujoco><option gravity="0 0 0"/><worldbody><geom type="box" size="1 1 0.001" pos="0 0 {plate}"/>
<body pos="{x} 0 1.5"><freejoint/><geom type="sphere" size="0.02" mass="1"/></body></worldbody>
<keyframe><key qpos="{x} 0 1.5 1 0 0 0" qvel="0 0 -100 0 0 0"/></keyframe></mujoco>"""
"""A ball that moves by 1 m from output to output, with a plate in its way, 0.5 m from the nearest of them."""


PLATE, BALL = '<geom type="box" size="1 1 0.001" pos="0 0 0"/>', '<geom type="sphere" size="0.02" mass="1"/>'

PLATES = "".join(f'<geom type="box" size="1 0.1 0.001" pos="0 {0.2 * k} 0"/>' for k in range(8))

ROWS = [
    (PLATE, f'<body><joint type="slide"/>{PLATES}</body>'),
    (BALL, "".join(f'<geom type="sphere" size="0.02" pos="0 {0.2 * k} 0" mass="1"/>' for k in range(8))),
    ('qpos="', 'qpos="0 '),
    ('qvel="', 'qvel="0 '),
]
"""Several geoms on each of two moving bodies, between which MuJoCo looks for contacts in another way."""

OVERRIDDEN = [("<worldbody>", '<option o_margin="0"><flag override="enable"/></option><worldbody>')]


@pytest.mark.parametrize(("x", "fate"), [(0, "left out"), (1.1, "inactive")])
@pytest.mark.parametrize(
    ("changes", "geoms"), [([], 2), (ROWS, 16), (OVERRIDDEN, 2)], ids=["plain", "several geoms", "override"]
)
def test_contacts_between_outputs_are_seen(x, fate, changes, geoms, tmp_path):
    text = SHOT.format(x=x, plate=0)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    found, how = told(after(mjcf(tmp_path, text), 0.03), f"{geoms} geoms that can touch")
    assert found == fate
    assert ("active at 1 of 49 time points, first at 0.015 s" in how) == (fate == "left out")


@pytest.mark.parametrize(
    ("rate", "how"), [(100.0 * np.pi, "passed from 0.00375 s on"), (200.0 * np.pi, UNSETTLED)]
)
def test_limits_between_outputs_are_seen_or_not_settled(rate, how, tmp_path):
    """Half a period of a swing of 1 rad, or a whole one, from output to output, where it is at its middle."""
    inertia = 1e3 + (0.5**2 + 0.1**2) / 3.0 + 0.5**2
    joint = f'range="-40 40" stiffness="{inertia * rate**2!r}" armature="1e3"'
    text = SWING.format(gravity=0, joint=joint, more=f'<keyframe><key qvel="{rate!r}"/></keyframe>')
    post = '<geom size="0.05" pos="1.2 0 0"/></worldbody>'  # beyond the bar's reach
    report = after(mjcf(tmp_path, text.replace("</worldbody>", post)), 0.1)
    fate, said = told(report, "joint 'j': its limits")
    assert fate == "left out"
    assert how in said
    assert UNSETTLED in told(report, "2 geoms that can touch")[1]
    assert report.unsettled == {n for n, entry in enumerate(report.entries) if n in report.watches}


@pytest.mark.parametrize("rate", [100.0 * np.pi, 200.0 * np.pi])
def test_what_acts_between_outputs_is_settled_by_closer_ones(rate, tmp_path):
    """The swing of the test above: sin(rate t) passes 40 degrees first at asin(0.698) / rate."""
    inertia = 1e3 + (0.5**2 + 0.1**2) / 3.0 + 0.5**2
    joint = f'range="-40 40" stiffness="{inertia * rate**2!r}" armature="1e3"'
    text = SWING.format(gravity=0, joint=joint, more=f'<keyframe><key qvel="{rate!r}"/></keyframe>')
    found = read(mjcf(tmp_path, text), duration=0.1, output_period=0.01)
    report = watched(found.scene, found.report, simulate(found.scene))
    (entry,) = (entry for entry in report.entries if entry.topic == "limits")
    assert not report.unsettled
    # the first of the moments between closer outputs after it: 16 to each 1/8 of 10 ms
    assert 0.0 <= entry.since - np.arcsin(np.radians(40.0)) / rate < 0.01 / 8 / 16


def test_a_repeated_run_that_stops_early_settles_nothing(tmp_path, monkeypatch):
    """The run of 1 s is too coarse for contacts; the repeated run ends at 0.24 s."""
    text = SWING.format(gravity=-10, joint='range="-80 80"', more="")
    found = read(mjcf(tmp_path, text), duration=1.0, output_period=0.1)
    run = simulate(found.scene)
    unsettled = found.report.after(SampledMotion(found.scene, run)).unsettled
    (contacts,) = unsettled

    def stop_at_a_quarter(scene, **options):
        error = IntegrationError(0.25, "stopped")
        error.partial = simulate(scene, **options).first(20)
        raise error

    monkeypatch.setattr("crosscheck.compare.activity.simulate", stop_at_a_quarter)
    report = watched(found.scene, found.report, run)
    assert (report.entries[contacts].seen, report.unsettled) == (UNSETTLED, unsettled)


def limited(tmp_path, low, velocity, gravity=0):
    """Read a bar that starts with a velocity, rad/s, its joint limited from `low` degrees on."""
    text = SWING.format(
        gravity=gravity,
        joint=f'range="{low} 80"',
        more=f'<keyframe><key qvel="{velocity}"/></keyframe>',
    )
    found = read(mjcf(tmp_path, text), duration=0.2, output_period=0.01)
    report = watched(found.scene, found.report, simulate(found.scene))
    return next(entry for entry in report.entries if entry.topic == "limits")


@pytest.mark.parametrize("low", [0, 1e-5, -1e-5])
def test_a_joint_that_starts_at_its_limit_and_moves_inwards_needs_no_force(low, tmp_path):
    """1e-5 degrees is less than the sixth digit of 1 rad."""
    entry = limited(tmp_path, low, 0.5)
    assert (entry.fate, entry.since) == ("inactive", None)


def test_a_joint_that_leaves_its_limit_outwards_acts_from_the_start(tmp_path):
    entry = limited(tmp_path, 0, -0.5)
    assert entry.fate == "left out"
    assert 0.0 < entry.since <= 0.01 / 16


def test_a_joint_that_starts_outside_of_its_limits_acts_from_the_start(tmp_path):
    assert limited(tmp_path, 0.01, 0.5).since == 0.0


@pytest.mark.parametrize(("limit", "fate"), [(2.9, "left out"), (3.1, "inactive")])
def test_limits_of_the_force_of_an_actuator(limit, fate, tmp_path):
    """A position servo on a heavy wheel of constant rate 1: kp (0 - x) is -3 at 1 s."""
    text = SWING.format(
        gravity=0,
        joint='armature="1e6"',
        more=f'<actuator><position name="servo" joint="j" kp="3" forcerange="-{limit} {limit}"/></actuator>'
        + '<keyframe><key qvel="1"/></keyframe>',
    )
    found, how = told(after(mjcf(tmp_path, text), 1.0), "actuator 'servo': its limit of the force")
    assert found == fate
    assert "0.1 N m" in how


@pytest.mark.parametrize(
    ("speed", "upper", "fate"), [(2, 2, "inactive"), (1, 2, "left out"), (2, 0.3, "left out")]
)
def test_limits_of_a_urdf(speed, upper, fate, tmp_path):
    """A point mass on a slide falls by 10 / 2 * 0.12^2 = 0.07 m, at 1.2 m/s in the end; from 0.25 m."""
    path = tmp_path / "robot.urdf"
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    path.write_text(
        f"""<robot name="r"><link name="base"/>
        <link name="m"><inertial><mass value="1"/>{inertia}</inertial></link>
        <joint name="j" type="prismatic"><parent link="base"/><child link="m"/><axis xyz="0 0 -1"/>
        <limit lower="-1" upper="{upper - 0.25}" velocity="{speed}" effort="1"/></joint></robot>"""
    )
    report = after(path, 0.12)
    limits = [entry for entry in report.entries if entry.topic in ("limits", "limit of velocity")]
    assert fate == ("left out" if any(entry.fate == "left out" for entry in limits) else "inactive")
    passed, how = told(report, "joint 'j': its limits")
    assert passed == ("left out" if upper == 0.3 else "inactive")  # that of velocity is one of its own
    if upper == 0.3:
        assert "passed from 0.1013 s on" in how  # 9.81 / 2 t^2 > 0.05


def test_an_element_counts_once_as_the_worst_of_it(tmp_path):
    joint = 'range="-90 90" frictionloss="0.1"'
    report = after(mjcf(tmp_path, SWING.format(gravity=-10, joint=joint, more="")), 0.1)
    fates = {e.topic: e.fate for e in report.entries if e.element == "joint 'j'" and e.topic}
    assert fates == {"limits": "inactive", "dry friction": "left out"}
    # the bar's geom touches nothing
    pattern = r"1 element is inactive \([^()]*: contacts\), 1 left out \(joint 'j': dry friction\)"
    assert re.fullmatch(pattern, report.counts()), report.counts()
