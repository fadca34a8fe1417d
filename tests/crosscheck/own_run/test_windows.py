"""Windows of the comparison of a file's run: until an event, until chaos, or to the end."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from own_runs import judged_run

from crosscheck.loading.load import load_scene
from crosscheck.own_run.allowed import AllowedError, ErrorKind
from crosscheck.own_run.comparison import MIN_OUTPUTS, Comparison
from crosscheck.own_run.errors import Band, run_error
from crosscheck.own_run.judge import horizons, judge, measure_error
from crosscheck.own_run.tune import search_settings
from crosscheck.report.own_run import headline, own_run_lines
from crosscheck.support.errors import CrosscheckError
from newton_euler.reading.file_run import Event

G = 9.81
PERCENT = 0.01
"""Largest difference between a judged error and that by hand, relative."""


def simulation_of(tmp_path, text, **options):
    path = tmp_path / "model.xml"
    path.write_text(text)
    _, report = load_scene(str(path), {"excitation": "off", **{k: str(v) for k, v in options.items()}})
    return report.simulation


def relative(largest):
    return AllowedError(ErrorKind.RELATIVE, largest)


def judged(tmp_path, text, **options):
    path = tmp_path / "model.xml"
    path.write_text(text)
    return judged_run(
        *load_scene(str(path), {"excitation": "off", **{k: str(v) for k, v in options.items()}})
    )


def line_of(judgement, keyword):
    """The lines of a report that begin with a keyword, as one text."""
    lines = [line for part in own_run_lines(judgement) for line in part.lines]
    return " ".join(line for line in lines if line.split()[0] == keyword)


# two links that a limit holds; without the limit they spin faster and faster, until the time step is too long
SPUN = """<mujoco><option timestep="0.002" gravity="0 0 0"/><worldbody><body name="a">
  <joint name="j1" axis="0 1 0" range="-20 20" limited="true"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".2" contype="0"/>
  <body name="b" pos=".3 0 0"><joint name="j2" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .2 0 .1" size=".02" mass=".2" contype="0"/></body></body></worldbody>
  <actuator><motor name="m" joint="j1" gear="1"/></actuator><keyframe><key name="k" ctrl="20"/></keyframe>
  </mujoco>"""


def mujoco_alone(text, step, times, integrator=None, limits=True):
    """Centers of mass (n, b, 3) of a run from the first keyframe by MuJoCo alone, and whether it diverges."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = step
    if integrator is not None:
        model.opt.integrator = integrator
    if not limits:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    centers = []
    for now in times:
        mujoco.mj_step(model, data, round((now - data.time) / step))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        centers.append(data.xipos[1:].copy())
    return np.array(centers), bool(data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number)


def test_a_run_that_completes_does_not_diverge_because_of_the_run_without_its_limits(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file there
    event = Event(0.0249, "limits of joint 'j1'")
    found = judge(simulation_of(tmp_path, SPUN, key="k", duration=0.5, output_period=0.002), [event])
    assert not mujoco_alone(SPUN, 0.002, [0.5])[1]
    assert mujoco_alone(SPUN, 0.002, [0.5], limits=False)[1]
    assert (found.stopped, found.band) == ("", Band.WRONG)
    assert "QACC" in found.without.stopped
    times = found.run.time
    assert times[-1] == pytest.approx(0.024), "the last output before the event"
    run, _ = mujoco_alone(SPUN, 0.002, times)
    exact, _ = mujoco_alone(SPUN, 1e-5, times, mujoco.mjtIntegrator.mjINT_RK4, limits=False)
    assert found.error.position == pytest.approx(np.max(np.linalg.norm(run - exact, axis=2)), rel=PERCENT)
    assert found.causes, "measured until the event"
    first, second = own_run_lines(found)
    assert first.lines[0].startswith("your settings  WRONG BY")
    assert first.lines[0].endswith(f"until {found.until:.3g} s")
    assert second.lines[0] == "without limits of joint 'j1'  DIVERGED"
    assert ErrorKind.RELATIVE.of(found) == found.error.relative, "the run that diverges is not the user's"


def test_a_run_with_a_limit_that_acts_from_the_start_on_is_not_judged(tmp_path, monkeypatch):
    """There is no motion before the limit that could be judged."""
    limits = "-20 0"
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings into a file there
    text = SPUN.replace('range="-20 20"', f'range="{limits}"')
    event = Event(0.001, "limits of joint 'j1'")
    found = judge(simulation_of(tmp_path, text, key="k", duration=0.5), [event])
    assert not mujoco_alone(text, 0.002, [0.5])[1]
    assert mujoco_alone(text, 0.002, [0.5], limits=False)[1]
    assert [event.element for event in found.events] == ["limits of joint 'j1'"]
    assert (found.until, found.stopped, found.band) == (0.0, "", Band.NOT_JUDGED)
    assert found.without.stopped
    assert found.judged == ()
    assert headline(found).startswith("NOT JUDGED: limits of joint 'j1' act from")
    assert "--set limits=compliant" in headline(found)
    assert "has 0 of the 10 outputs" in headline(found)
    assert "steps of 2 ms are too long for more" in headline(found)


def test_a_limit_that_only_the_inaccurate_run_passes_is_a_part_of_its_error(tmp_path):
    """The reference of a pendulum turns back 0.2 degrees before the limit; Euler's method passes it."""
    text = """<mujoco><option timestep="0.02"/><worldbody><body name="bar" euler="0 40 0">
      <joint name="hinge" axis="0 1 0" range="-81.75 80" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.01" mass="0.4" contype="0"/></body></worldbody>
      <keyframe><key name="k" qvel="-1"/></keyframe></mujoco>"""
    found = judged(tmp_path, text, key="k", duration=1.0)
    assert (found.events, found.until, found.without) == ((), None, None)
    (event,) = found.only_in_run
    assert event.element == "limits of joint 'hinge'"
    # by hand: the run of the file as it stands, and without its limit
    run, _ = mujoco_alone(text, 0.02, found.run.time)
    free, _ = mujoco_alone(text, 0.02, found.run.time, limits=False)
    exact, _ = mujoco_alone(text, 1e-5, found.run.time, mujoco.mjtIntegrator.mjINT_RK4)
    error, without = (np.max(np.linalg.norm(each - exact, axis=2)) for each in (run, free))
    assert found.error.position == pytest.approx(error, rel=PERCENT)
    assert abs(error - without) > 2.0 * PERCENT * error, "the limit makes a difference"
    note = line_of(found, "note")
    assert "limits of joint 'hinge' act from" in note
    assert "in this run only" in note


# an oscillator beside a double pendulum, which is chaotic
BESIDE_CHAOS = """<mujoco><option timestep="0.002" integrator="RK4"/><worldbody>
  <body name="A" pos="0 1 0"><joint type="slide" axis="1 0 0" stiffness="10000" springref="0.01"/>
    <geom type="box" size=".05 .05 .05" mass="1" contype="0"/></body>
  <body name="p1"><joint axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .1 0 .1" size=".01" mass=".1" contype="0"/>
    <body name="p2" pos=".1 0 .1"><joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .14" size=".01" mass=".1" contype="0"/></body></body>
  </worldbody></mujoco>"""


@pytest.mark.slow
def test_a_chaotic_mechanism_ends_the_comparison_of_its_own_bodies_only(tmp_path):
    step, duration, reach, frequency = 0.002, 4.0, 0.01, 100.0
    found = judge(simulation_of(tmp_path, BESIDE_CHAOS, duration=duration, output_period=0.01))
    oscillator, pendulum = found.scale.mechanisms
    assert (oscillator.bodies, oscillator.until) == (("A",), None)
    assert pendulum.bodies == ("p1", "p2")
    assert 0.1 < pendulum.until < 3.0
    # by hand: RK4 of x'' = -w^2 x multiplies x + i x'/w by the series of exp(i w h) to the fourth order
    phase = 1j * frequency * step
    factor = sum(phase**k / [1, 1, 2, 6, 24][k] for k in range(5))
    steps = np.rint(found.reference.time / step).astype(int)
    error = np.max(np.abs(reach * np.real(factor**steps - np.exp(phase * steps))))
    assert found.error.position_at == ("A", pytest.approx(duration, rel=0.1))
    assert found.error.position == pytest.approx(error, rel=PERCENT)
    assert found.error.relative_position == pytest.approx(error / (2.0 * reach), rel=PERCENT)
    assert found.error.rotation_at[1] < pendulum.until
    assert found.until is None
    note = line_of(found, "note")
    assert f"the mechanism of p1 is compared until {pendulum.until:.3g} s" in note
    assert "the mechanism of A moves 20 mm" in line_of(found, "run")


BOX = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 .1"/>
  <body name="box" pos="0 0 {height}"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
  </worldbody></mujoco>"""


def test_a_motion_that_is_too_short_before_a_contact_is_not_judged(tmp_path):
    """Semi-implicit Euler falls g h t/2 too far: h/t of the motion, a large part of a short one."""
    step, duration = 0.002, 1.0
    found = judged(tmp_path, BOX.format(height=0.101), duration=duration)
    assert (found.until, found.band) == (0.0, Band.NOT_JUDGED)
    assert headline(found).startswith("NOT JUDGED: contact of 'world' and 'box' acts from 0.01")
    # the run without the floor
    reduced = found.without
    assert (reduced.until, reduced.band) == (None, Band.OFF)
    assert reduced.error.position == pytest.approx(0.5 * G * step * duration, rel=PERCENT)
    assert ErrorKind.ENERGY.of(found) == reduced.error.energy
    # a tenth of the step removes 90 % of the error, and RK4 all of the same error
    assert reduced.have_one_error
    assert any(
        ", or integrator: " in line or ", or time step: " in line for line in own_run_lines(found)[1].lines
    )
    assert (found.causes, found.remedies) == ((), ())
    first, second = own_run_lines(found)
    assert second.lines[0].startswith("without contact of 'world' and 'box'  OFF BY 9.8")
    # the body moves before the contact; how far it moves without the floor is stated with that run
    assert first.lines[1].endswith(f"({found.engine})")
    assert second.lines[1].split() == ["run", "bodies", "move", f"{0.5 * G * duration**2:.2f}", "m"]


def test_the_output_period_of_a_message_gives_enough_outputs(tmp_path):
    """A box falls 0.1 m in 0.143 s: 3 outputs with a period of 0.04 s."""
    text = BOX.format(height=0.2)
    found = judged(tmp_path, text, duration=0.5, output_period=0.04)
    assert found.band is Band.NOT_JUDGED
    assert "has 3 of the 10 outputs" in headline(found)
    (period,) = re.findall(r"--set output_period=([\d.]+)", headline(found))
    assert float(period) == 0.008  # 4 steps: 7 steps are the most, and more than 2 are rounded to fours
    again = judged(tmp_path, text, duration=0.5, output_period=period)
    assert again.is_judged
    assert again.until == pytest.approx(math.sqrt(2.0 * 0.1 / G), rel=PERCENT)


def test_a_limit_of_a_force_that_acts_from_the_start_on_names_what_helps(tmp_path):
    text = """<mujoco><worldbody><body><joint name="j" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1" contype="0"/></body></worldbody>
      <actuator><position name="p" joint="j" kp="20" kv="1" forcerange="-5 5"/></actuator>
      <keyframe><key name="k" ctrl="0.5"/></keyframe></mujoco>"""
    found = judged(tmp_path, text, key="k", duration=0.2)
    assert found.events[0] == Event(0.0, "limit of the force of actuator 'p'")  # 20 * 0.5 > 5
    assert headline(found).startswith("NOT JUDGED: limit of the force of actuator 'p' acts from the start on")
    assert "a smaller step of the command" in headline(found)
    assert "outputs" not in headline(found)


def test_contacts_of_a_run_and_of_the_reference_are_one_element(tmp_path):
    simulation = simulation_of(tmp_path, BOX.format(height=0.2), duration=0.5)
    found = judge(simulation, [Event(0.13, "contacts")])
    assert found.events == (Event(0.13, "contact of 'world' and 'box'"),)
    assert "contact of 'world' and 'box': it acts from 0.13 s on" in line_of(found, "note")
    event = Event(0.0249, "limits of joint 'j1'")
    limits = judge(simulation_of(tmp_path, SPUN, key="k", duration=0.1, output_period=0.002), [event])
    assert "limits of joint 'j1': they act from" in line_of(limits, "note")


def test_outputs_and_ends_of_comparisons(tmp_path):
    compared = Comparison.of(simulation_of(tmp_path, BOX.format(height=3.0), duration=0.5))
    period, end = compared.reference.time[1], compared.reference.time[-1]
    assert [compared.reaches(time) for time in (period, 1.5 * period, end, 1.1 * end)] == [
        False,
        True,
        True,
        False,
    ]
    run = compared.run_once(compared.simulation.settings)
    assert compared.is_comparable(run)
    assert not compared.ending_at(0.5 * period).is_comparable(run)  # only the start


# ten links of 0.1 m that hang at rest
CHAIN = (
    '<mujoco><worldbody><body name="root" pos="0 0 1">'
    + '<body pos="0 0 -.1">'.join(
        ['<joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.1" size=".01" contype="0"/>'] * 10
    )
    + "</body>" * 10
    + "</worldbody></mujoco>"
)


def test_the_smallest_scale_is_that_of_the_whole_mechanism(tmp_path):
    found = judge(simulation_of(tmp_path, CHAIN, duration=0.2))
    (chain,) = found.scale.mechanisms
    # the last joint is 0.9 m below the first one; each center of mass is 0.05 m from its joint
    assert chain.size == pytest.approx(1.0, rel=1e-9)
    assert chain.length_scale == pytest.approx(0.01, rel=1e-9)
    assert line_of(found, "run").endswith("nothing moves")
    # a run that shows nothing is not accurate
    assert (found.band, found.judged) == (Band.NOT_JUDGED, ())
    assert headline(found).startswith("NOT JUDGED: nothing moves")
    with pytest.raises(CrosscheckError, match="nothing moves"):
        search_settings(simulation_of(tmp_path, CHAIN, duration=0.2), relative(1e-3))


SLOW = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint axis="0 1 0"/>
  <geom size=".1" mass="1"/></body></worldbody><keyframe><key qvel="0.01"/></keyframe></mujoco>"""


def test_a_motion_below_the_smallest_scale_is_shown_as_it_is(tmp_path):
    """A ball turns by 0.01 rad/s for 0.2 s: 0.002 rad, a fifth of the smallest scale."""
    found = judge(simulation_of(tmp_path, SLOW, duration=0.2))
    assert line_of(found, "run").endswith(f"bodies move {math.degrees(0.002):.2g} deg")


# an oscillator, a body on a torsion spring, and a falling body
THREE = """<mujoco><option timestep="0.002"/><worldbody>
  <body name="A"><joint type="slide" axis="1 0 0" stiffness="400" springref="0.01"/>
    <geom type="box" size=".05 .05 .05" mass="1" contype="0"/></body>
  <body name="B" pos="0 1 0"><joint type="hinge" axis="0 1 0" stiffness="1" springref="50"/>
    <geom type="box" size=".05 .05 .05" mass="1" contype="0"/></body>
  <body name="C" pos="0 2 0"><freejoint/><geom type="box" size=".05 .05 .05" mass="100" contype="0"/></body>
  </worldbody></mujoco>"""


def test_each_error_has_the_name_of_its_mechanism(tmp_path):
    found = judge(simulation_of(tmp_path, THREE, duration=1.0))
    assert (found.error.position_at[0], found.error.rotation_at[0]) == ("A", "B")
    assert " of the motion of the mechanism of A and " in headline(found)
    assert headline(found).endswith(" of the motion of the mechanism of B")
    assert line_of(found, "run").endswith("the mechanism of A moves 20 mm; the mechanism of B moves >57 deg")


LINKAGE = """<mujoco><option timestep="0.002"/><default><joint axis="0 1 0" damping="0.002"/>
  <geom type="capsule" size="0.01" density="2700" contype="0"/></default><worldbody>
  <body name="crank"><joint name="motor" armature="1e-4"/><geom fromto="0 0 0 0 0 0.1"/>
    <body name="coupler" pos="0 0 0.1"><joint name="elbow"/><geom fromto="0 0 0 0.3 0 0.15"/>
      <site name="one" pos="0.3 0 0.15"/></body></body>
  <body name="rocker" pos="0.3 0 0"><joint name="pivot" stiffness="0.5" range="-3 3" limited="true"/>
    <geom fromto="0 0 0 0 0 0.25"/><site name="two" pos="0 0 0.25"/></body></worldbody>
  <equality><connect name="loop" site1="one" site2="two"/></equality>
  <actuator><position name="servo" joint="motor" kp="2" kv="0.05"/></actuator>
  <keyframe><key name="go" ctrl="1"/></keyframe></mujoco>"""


@pytest.mark.slow
def test_loop_errors_are_those_of_the_judged_window(tmp_path):
    found = judged(tmp_path, LINKAGE, key="go", duration=0.3, output_period=0.002)
    assert found.until is not None, "a limit acts after more than ten outputs"
    # by hand, until the limit and without it to the end
    model = mujoco.MjModel.from_xml_string(LINKAGE)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    openings = []
    for now in found.without.run.time:
        mujoco.mj_step(model, data, round((now - data.time) / 0.002))
        mujoco.mj_kinematics(model, data)
        openings.append(np.linalg.norm(data.site("one").xpos - data.site("two").xpos))
    until = int(np.searchsorted(found.without.run.time, found.until))
    assert found.loop_error.opening == pytest.approx(max(openings[:until]), rel=PERCENT)
    assert found.without.loop_error.opening == pytest.approx(max(openings), rel=PERCENT)
    assert ErrorKind.OPENING.of(found) == found.without.loop_error.opening > found.loop_error.opening
    first, second = own_run_lines(found)
    assert first.lines[0].endswith(f"until {found.until:.3g} s")
    assert second.lines[0].startswith("without limits of joint 'pivot'  ")
    # JSON, plots and the ghost end with the comparison
    summary = found.summary()
    assert summary["error_over_time"]["time"] == found.run.time.tolist()
    np.testing.assert_allclose(found.reference.time, found.run.time, rtol=1e-14)  # MuJoCo adds up its steps
    assert summary["error_over_time"]["time"][-1] < found.until
    assert summary["without"]["relative"] == found.without.error.relative


# a pendulum on a ball joint with a second link, which is chaotic from about 2 s on
CHAOTIC = """<mujoco><option timestep="0.002"/><worldbody>
  <body name="a" pos="0 0 1"><joint type="ball"/>
    <geom type="capsule" fromto="0 0 0 .5 0 0" size=".03" mass="1" contype="0"/>
    <body name="c" pos=".5 0 0"><joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5" contype="0"/></body></body></worldbody>
  <keyframe><key name="k"/></keyframe></mujoco>"""


@pytest.mark.slow
def test_a_motion_that_is_chaotic_before_the_first_output_of_the_scene_has_closer_outputs(tmp_path):
    found = judge(simulation_of(tmp_path, CHAOTIC, key="k", duration=20, output_period=4))
    (motion,) = found.scale.mechanisms
    assert 1.5 < motion.until < 2.5
    times = found.reference.time[1 : motion.outputs(found.reference.time)]
    assert len(times) == found.error.outputs >= MIN_OUTPUTS
    run, _ = mujoco_alone(CHAOTIC, 0.002, times)
    exact, _ = mujoco_alone(CHAOTIC, 2e-4, times, mujoco.mjtIntegrator.mjINT_RK4)
    assert found.error.position == pytest.approx(np.max(np.linalg.norm(run - exact, axis=2)), rel=PERCENT)
    assert found.band is Band.WRONG


@pytest.mark.slow
def test_outputs_of_a_baseline_are_closer_too(tmp_path):
    simulation = simulation_of(tmp_path, CHAOTIC, key="k", duration=20, output_period=4)
    found = measure_error(simulation, 1e-9, horizons(simulation))
    assert found.error.outputs >= MIN_OUTPUTS
    # the error grows, and the last output before the end of the comparison may be another one
    assert found.error.position == pytest.approx(judge(simulation).error.position, rel=0.1)


def test_a_motion_that_is_chaotic_within_a_time_step_is_not_judged(tmp_path, monkeypatch):
    monkeypatch.setattr("crosscheck.own_run.comparison.comparable_until", lambda *_: (0.001,))
    simulation = simulation_of(tmp_path, CHAOTIC, key="k", duration=0.5)
    found = judge(simulation)
    assert (found.band, found.band.verdict, found.error.outputs) == (Band.NOT_JUDGED, "doubtful", 0)
    assert (found.causes, found.remedies) == ((), ())
    assert headline(found).startswith("NOT JUDGED: the motion is chaotic or unstable before its first output")
    with pytest.raises(CrosscheckError, match=r"not judged: the motion is chaotic .* at 0\.001 s"):
        search_settings(simulation, relative(1e-3))
    with pytest.raises(CrosscheckError, match="not judged"):
        measure_error(simulation, 1e-9, (0.001,))


def test_the_number_of_closer_outputs_is_limited(tmp_path, monkeypatch):
    monkeypatch.setattr("crosscheck.own_run.comparison.comparable_until", lambda *_: (0.1,))
    monkeypatch.setattr("crosscheck.own_run.comparison.MAX_OUTPUTS", 250)
    compared = Comparison.of(simulation_of(tmp_path, CHAOTIC, key="k", duration=20, output_period=4))
    # 10,000 steps of 2 ms: 250 outputs are 40 steps or 80 ms apart, and only one is before 100 ms
    assert compared.every == 40
    assert compared.is_comparable(compared.run_once(compared.simulation.settings))


def test_a_scene_of_half_a_time_step_is_judged_until_four_steps_with_a_note(tmp_path):
    found = judge(simulation_of(tmp_path, CHAOTIC, key="k", duration=0.001))
    assert found.extended_to == pytest.approx(0.008)
    assert line_of(found, "note").startswith("  note    judged until 0.008 s")
    assert judge(simulation_of(tmp_path, CHAOTIC, key="k", duration=0.02)).extended_to is None


def test_energies_of_a_mechanism_at_rest_are_divided_by_those_of_a_small_swing(tmp_path):
    """The chain has 10 links of 1000 kg/m^3; a pendulum of its mass and size that swings by 0.01 rad."""
    found = judge(simulation_of(tmp_path, CHAIN, duration=0.2))
    mass = float(np.sum(mujoco.MjModel.from_xml_string(CHAIN).body_mass))
    assert found.scale.energy == pytest.approx(mass * G * 1.0 * (1.0 - math.cos(0.01)), rel=1e-4)
    # an energy error appears although nothing moves in the reference
    kinetic = found.reference.kinetic_energy.copy()
    kinetic[1:] += 1e-6
    gained = replace(found.reference, kinetic_energy=kinetic)
    error = run_error(gained, found.reference, found.scale)
    assert error.energy == pytest.approx(1e-6 / found.scale.energy)
