"""Dry friction and limits of MuJoCo's joints as forces, against MuJoCo's own simulation of the files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from crosscheck.compare.activity import watched_in_new_run
from crosscheck.own_run.judge import judge
from mjcf.errors import collected_warnings
from mjcf.reader import Reading, read
from newton_euler.errors import UnknownNameError, VerificationError
from newton_euler.model.switched_forces import JointFriction, JointStop
from newton_euler.reading.activity import Bounds
from newton_euler.reading.import_report import FRICTION, LIMITS
from newton_euler.reading.verify import verify_report
from newton_euler.runs.simulate import simulate

BLOCK = """<mujoco model="block"><compiler angle="radian"/>
<option timestep="0.0005" integrator="RK4" {option}/><default><geom contype="0" conaffinity="0"/></default>
<worldbody><body><joint name="rail" type="slide" axis="1 0 0" {joint}/><geom size="0.1" mass="3"/></body>
</worldbody><actuator><motor joint="rail"/></actuator>
<keyframe><key qvel="{speed}" ctrl="{push}"/></keyframe></mujoco>"""

SOFT = (
    "",
    'solreffriction="0.01 1" solimpfriction="0.8 0.9 1" solreflimit="0.03 0.7" solimplimit="0.7 0.97 1e-2"',
    'solreffriction="-500 -60" solreflimit="-4000 -80" solimplimit="0.7 0.7 0.01"',
    'solreffriction="0.01 -1" solreflimit="0.03 0"',
    'solreffriction="-1 20" solreflimit="0 0.7"',
)
"""Softness of friction and limits: the default, by time constants, by stiffness and damping, and by one
positive number, for which MuJoCo has the default. With stops the depth is larger than the width of the
impedance."""


def block(tmp_path: Path, joint: str, option: str = "", **state: float) -> str:
    """Write a block of 3 kg on a slide, and return the path."""
    path = tmp_path / "block.xml"
    numbers = {"speed": 0.0, "push": 0.0} | state
    path.write_text(BLOCK.format(joint=joint, option=option, **numbers))
    return str(path)


def as_forces(path: str, **options: Any) -> Reading:
    """Read a file with its friction and limits as forces."""
    return read(path, **{"friction": "regularized", "limits": "compliant"} | options)


def mujocos(path: str, seconds: float) -> Any:
    """Return the data of MuJoCo's run of a file from its keyframe."""
    model: Any = mujoco.MjModel.from_xml_path(path)
    data: Any = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    with collected_warnings(data):  # of a `solref` that MuJoCo replaces
        mujoco.mj_step(model, data, round(seconds / model.opt.timestep))
    return data


@pytest.mark.parametrize("soft", SOFT)
def test_a_joint_that_sticks_creeps_as_in_mujoco(soft: str, tmp_path: Path) -> None:
    path = block(tmp_path, f'frictionloss="2" {soft}', push=1.5)
    (friction,) = as_forces(path).scene.forces
    assert isinstance(friction, JointFriction)
    assert friction.coulomb == 2.0
    creep = 1.5 / 2.0 * friction.transition_speed  # the force balances the push
    assert mujocos(path, 0.5).qvel[0] == pytest.approx(creep, rel=1e-6)


@pytest.mark.parametrize("soft", SOFT)
def test_a_joint_that_rests_on_its_limit_has_the_depth_of_mujoco(soft: str, tmp_path: Path) -> None:
    path = block(tmp_path, f'range="-0.2 0.1" {soft}', push=3e3)
    low, high = as_forces(path).scene.forces
    assert isinstance(low, JointStop)
    assert isinstance(high, JointStop)
    assert (low.side, low.limit, high.side, high.limit) == ("low", -0.2, "high", 0.1)
    assert low.stiffness == high.stiffness
    assert mujocos(path, 2.0).qpos[0] - 0.1 == pytest.approx(3e3 / high.stiffness, rel=1e-4)


def test_the_numbers_are_those_of_the_default_softness(tmp_path: Path) -> None:
    """MuJoCo's default: time constant 0.02 s, damping ratio 1, impedances 0.9 and 0.95, inertia 3 kg."""
    path = block(tmp_path, 'frictionloss="2" range="-0.2 0.1"')
    low, _, friction = as_forces(path).scene.forces
    damping, stiffness = 2.0 / (0.95 * 0.02), 0.95 / (0.95 * 0.02) ** 2
    assert friction.transition_speed == pytest.approx(2.0 / 3.0 * (0.1 / 0.9) / damping)
    assert low.stiffness == pytest.approx(3.0 * 0.95 / 0.05 * stiffness)
    assert low.dissipation * 1e-3 == pytest.approx(damping / stiffness)  # at a depth of 1 mm


def test_friction_without_damping_and_limits_without_stiffness_have_default_numbers(tmp_path: Path) -> None:
    """MuJoCo's rows have no damping and no stiffness, and cannot give a transition speed and a stop."""
    soft = 'solreffriction="-1 -0" solreflimit="-0 -0"'
    path = block(tmp_path, f'frictionloss="2" range="-0.2 0.1" {soft}')
    model: Any = mujoco.MjModel.from_xml_path(path)
    data: Any = mujoco.MjData(model)
    data.qpos[0] = 0.3
    mujoco.mj_forward(model, data)
    assert not np.any(data.efc_KBIP[:, :2])
    found = as_forces(path)
    low, _, friction = found.scene.forces
    assert friction.transition_speed == pytest.approx(1e-3 * 2.0 / 3.0)
    assert (low.stiffness, low.dissipation) == (pytest.approx(5e4 * 3.0), 40.0)
    verify_report(found.report)  # raises if the rows of MuJoCo give other numbers


def test_limits_count_from_the_start_and_begin_at_their_margin(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    joint = '<joint name="a" axis="0 1 0" range="-1 2" margin="0.1"/>'
    path.write_text(
        f'<mujoco><compiler angle="radian"/><worldbody><body>{joint}<geom size="0.1" pos="0.5 0 0"/></body>'
        '</worldbody><keyframe><key qpos="0.5"/></keyframe></mujoco>'
    )
    low, high = as_forces(str(path)).scene.forces
    assert (low.limit, high.limit) == (pytest.approx(-1.4), pytest.approx(1.4))


def test_the_report_calls_them_approximated_and_runs_are_not_of_a_reduced_model(tmp_path: Path) -> None:
    path = block(tmp_path, 'frictionloss="2" range="-0.2 0.1"', speed=1.0, option='gravity="0 0 0"')
    found = as_forces(path, duration=0.3)
    assert found.report.approximated_topics == {("joint 'rail'", FRICTION), ("joint 'rail'", LIMITS)}
    assert "1 element is approximated" in found.report.counts()
    assert not found.report.unsimulated()
    assert not watched_in_new_run(found.scene, found.report).acting
    # without the options, both act
    default = read(path, duration=0.3)
    topics = {entry.topic for entry in watched_in_new_run(default.scene, default.report).acting}
    assert topics == {FRICTION, LIMITS}
    assert not default.scene.switched_forces


def test_an_approximated_joint_counts_as_such_although_its_limits_are_inactive(tmp_path: Path) -> None:
    path = block(tmp_path, 'frictionloss="2" range="-9 9"', speed=1.0)
    found = read(path, friction="regularized", duration=0.3)
    report = watched_in_new_run(found.scene, found.report)
    assert [entry.topic for entry in report.of("inactive") if "joint" in entry.element] == [LIMITS]
    assert report.counts() == "1 element is approximated (joint 'rail': dry friction)"


def test_each_option_takes_one_of_both(tmp_path: Path) -> None:
    path = block(tmp_path, 'frictionloss="2" range="-0.2 0.1"')
    (friction,) = read(path, friction="regularized").scene.forces
    assert isinstance(friction, JointFriction)
    assert all(isinstance(force, JointStop) for force in read(path, limits="compliant").scene.forces)
    with pytest.raises(UnknownNameError):
        read(path, friction="coulomb")  # type: ignore[typeddict-item]


@pytest.mark.parametrize("flag", ["limit", "frictionloss", "constraint"])
def test_what_the_file_switches_off_is_no_force(flag: str, tmp_path: Path) -> None:
    path = Path(block(tmp_path, 'frictionloss="2" range="-0.2 0.1"'))
    path.write_text(
        path.read_text().replace("<worldbody>", f'<option><flag {flag}="disable"/></option><worldbody>')
    )
    report = as_forces(str(path)).report
    off = {entry.topic for entry in report.entries if entry.is_off}
    assert off == {"limit": {LIMITS}, "frictionloss": {FRICTION}, "constraint": {FRICTION, LIMITS}}[flag]
    assert not {topic for _, topic in report.approximated_topics} & off


def test_balls_keep_their_limits_and_friction_in_the_report(tmp_path: Path) -> None:
    path = tmp_path / "ball.xml"
    joint = '<joint name="a" type="ball" range="0 1" frictionloss="0.1"/>'
    path.write_text(f"<mujoco><worldbody><body>{joint}<geom size='0.1'/></body></worldbody></mujoco>")
    report = as_forces(str(path)).report
    assert {entry.topic for entry in report.unsimulated()} >= {LIMITS, FRICTION}


def test_excitation_keeps_its_distance_from_stops_and_overcomes_friction(tmp_path: Path) -> None:
    path = block(tmp_path, 'frictionloss="50" range="-0.02 0.01"', option='gravity="0 0 0"')
    found = as_forces(path, excitation=True)
    (bounds,) = found.report.bounds
    assert isinstance(bounds, Bounds)
    assert (bounds.low, bounds.high) == (-0.02, 0.01)
    (law,) = found.scene.control
    assert np.ptp([law.feedforward.value(t) for t in np.linspace(0.0, 2.0, 101)]) > 2.0 * 50.0
    run = simulate(found.scene)
    assert np.all(np.abs(run.joint("rail").coordinates) < 0.021)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"coulomb": 2.1}, "joint 'rail': dry friction"),
        ({"transition_speed": 10.0}, "joint 'rail'"),
        ({"limit": 0.05}, "joint 'rail'"),
        ({"stiffness": 1e5}, "joint 'rail': limits"),
        ({"dissipation": 0.0}, "joint 'rail': limits"),
    ],
)
def test_wrong_numbers_of_the_scene_are_found(change: dict[str, float], where: str, tmp_path: Path) -> None:
    path = block(tmp_path, 'frictionloss="2" range="-0.02 0.01"')
    report = as_forces(path).report
    ((reference, scene), *_) = report.references
    forces = tuple(
        replace(force, **change) if set(change) <= set(vars(force)) else force for force in scene.forces
    )
    report.references = [(reference, replace(scene, forces=forces))]
    with pytest.raises(VerificationError) as caught:
        verify_report(report)
    assert caught.value.where == where
    assert caught.value.quantity == "friction and stops, rel"


def test_a_file_is_judged_with_its_friction(tmp_path: Path) -> None:
    """MuJoCo's friction and the regularized one stop the block, of 1 m/s, at the same place.

    MuJoCo's constraint begins to stick at the speed at which (a + b v) D is the friction F, with D = 9 m and
    b = 105 / s. From there on, the speed falls by a factor of e in 1 / (0.9 b).
    """
    path = block(tmp_path, 'frictionloss="6"', speed=1.0, option='gravity="0 0 0"')
    found = as_forces(path, duration=0.8)
    assert found.report.simulation is not None
    judgement = judge(found.report.simulation)
    assert judgement.events == ()
    assert judgement.approximated == ("dry friction of joint 'rail'",)
    assert np.ptp(judgement.reference.position[:, 1, 0]) == pytest.approx(0.25, rel=0.01)  # v^2 / (2 F / m)
    b, deceleration = 2.0 / (0.95 * 0.02), 6.0 / 3.0
    speed = deceleration * (1.0 + 1.0 / 9.0) / b
    expected = speed / (0.9 * b) - speed**2 / (2.0 * deceleration)  # longer than by friction alone
    assert judgement.error.position == pytest.approx(expected, rel=0.05)


def test_a_run_without_what_the_scene_lacks_keeps_what_it_has(tmp_path: Path) -> None:
    """Limits of joints act; the limit and the friction of a tendon, and contacts, do not."""
    path = Path(block(tmp_path, 'frictionloss="2" range="-0.2 0.1"', push=100.0))
    tendon = (
        '<tendon><fixed range="-0.01 0.01" frictionloss="3"><joint joint="rail" coef="1"/></fixed></tendon>'
    )
    path.write_text(path.read_text().replace("<actuator>", f"{tendon}<actuator>"))
    found = as_forces(str(path), duration=0.5)
    assert found.report.simulation is not None
    simulation = found.report.simulation
    events = simulation.run(simulation.settings, 1000, 10).events
    assert {event.element.partition(" of ")[0] for event in events} == {LIMITS, FRICTION}
    reduced = simulation.run(simulation.settings, 1000, 10, reduced=True).trajectory
    assert reduced.position[-1, 1, 0] == pytest.approx(0.1, abs=2e-3)


def test_small_motions_are_those_without_friction_and_limits(tmp_path: Path) -> None:
    """MuJoCo's constraints would be modes of a file at rest that springs and dampers do not make."""
    path = block(tmp_path, 'frictionloss="2" range="-0.2 0" stiffness="50" damping="3"')
    rates = []
    for found in (read(path), as_forces(path)):
        simulation = found.report.simulation
        assert simulation is not None
        run = simulation.run(simulation.settings, 1, 1, reduced=True)
        motions = simulation.small_motions(run, [0])
        assert motions is not None
        rates.append(motions.rates(0, simulation.settings))
    assert rates[1] == pytest.approx(rates[0])
    assert rates[0][1] == pytest.approx(np.array([-50.0, -3.0]) / 3.0, rel=1e-6)
