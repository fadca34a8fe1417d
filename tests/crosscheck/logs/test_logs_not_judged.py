"""Logs of motions that are chaotic, or have an event, before the second row: nothing of them is compared."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import crosscheck
from crosscheck.logs.judge import Log
from crosscheck.own_run.allowed import AllowedError, ErrorKind
from crosscheck.own_run.errors import Band
from crosscheck.report.log import log_lines

BALL_PENDULUM = """<mujoco><option timestep="0.0005"/><worldbody>
  <body name="a" pos="0 0 1"><joint type="ball"/>
    <geom type="capsule" fromto="0 0 0 .5 0 0" size=".03" mass="1"/>
    <body name="c" pos=".5 0 0"><joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5"/></body></body></worldbody></mujoco>"""


@pytest.mark.slow  # 20 s: the rows are read in other units, over 5 s and 5000 s
def test_a_log_without_a_row_before_chaos_is_not_judged(tmp_path):
    """In s, the rows in ms are 5 s apart, and the motion is chaotic from about 2 s on; the geoms touch."""
    path = tmp_path / "chaotic.xml"
    path.write_text(BALL_PENDULUM)
    model = mujoco.MjModel.from_xml_string(BALL_PENDULUM)
    data = mujoco.MjData(model)
    rows = []
    for _ in range(100):
        mujoco.mj_kinematics(model, data)
        rows.append([1000.0 * data.time, *data.xpos[1:].ravel(), *data.xquat[1:].ravel()])
        mujoco.mj_step(model, data, 10)
    names = [f"{body}.{c}" for body in "ac" for c in "xyz"]
    names += [f"{body}.q{c}" for body in "ac" for c in "wxyz"]
    table = dict(zip(["time", *names], np.array(rows).T, strict=True))
    options = {"excitation": "off", "duration": 0.3}
    verdict = crosscheck.check(str(path), ["newton_euler"], runs={"log": table}, **options)
    found = verdict.logs["log"]
    assert (found.band, found.error.outputs, found.other_inputs) == (Band.NOT_JUDGED, 0, None)
    lines = log_lines(found, [AllowedError(ErrorKind.RELATIVE, 0.5)]).lines
    assert lines[0].startswith("log  NOT JUDGED: the motion is chaotic or unstable before its first output")
    assert not any(line.startswith("  allowed") for line in lines)
    assert found.mistakes[0].option == "--log-set time=ms"
    with pytest.raises(AssertionError, match=r"UNFINISHED: log: not judged: .*the log log is judged without"):
        verdict.assert_accurate(0.5)
    right = Log(table, time="ms")
    verdict = crosscheck.check(str(path), ["newton_euler"], runs={"log": right}, **options)
    assert verdict.logs["log"].band is not Band.NOT_JUDGED
    verdict.assert_accurate(0.02, allow_reduced=True)


HINGE = """<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody>
  <body name="arm"><joint name="hinge" axis="0 1 0" range="-1 .22" limited="true"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/></body></worldbody></mujoco>"""


def test_a_log_without_a_row_before_an_event_is_not_judged(tmp_path):
    """The hinge reaches its limit of 0.22 rad 0.016 s after the start, before the second row at 0.05 s."""
    path = tmp_path / "limit.xml"
    path.write_text(HINGE)
    model = mujoco.MjModel.from_xml_string(HINGE)
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = 0.2, 1.0
    rows = []
    for _ in range(10):
        rows.append([data.time, data.qpos[0], data.qvel[0]])
        mujoco.mj_step(model, data, 50)
    table = dict(zip(["time", "hinge", "hinge_vel"], np.array(rows).T, strict=True))
    verdict = crosscheck.check(str(path), ["newton_euler"], runs={"log": table}, excitation="off")
    found = verdict.logs["log"]
    assert (found.band, found.error.outputs, found.rows) == (Band.NOT_JUDGED, 0, 1)
    assert found.until == pytest.approx(0.016, abs=0.002)
    assert "limits of joint 'hinge'" in found.why_not_judged
    assert log_lines(found, []).lines[0] == f"log  NOT JUDGED: {found.why_not_judged}"
    with pytest.raises(AssertionError, match=r"UNFINISHED: log: not judged: no row before"):
        verdict.assert_accurate(0.5)
