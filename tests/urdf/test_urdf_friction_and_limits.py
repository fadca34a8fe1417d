"""Dry friction and limits of URDFs and Pinocchio models as forces, against inertias in closed form."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from crosscheck.compare.activity import watched_in_new_run
from newton_euler.errors import VerificationError
from newton_euler.model.switched_forces import JointFriction, JointStop
from newton_euler.reading.import_report import FRICTION, LIMITS, VELOCITY_LIMITS
from newton_euler.reading.verify import verify_report
from newton_euler.runs.simulate import simulate
from urdf.reader import Reading, read

STICK_TIME, STOP_RATE = 1e-3, 5e4
"""Softness of URDFs: s, and 1/s^2."""


def link(name: str, mass: float, moment: float, x: float = 0.0) -> str:
    """Return the XML of a link with its center of mass at x, m."""
    moments = " ".join(f'{axis}="{moment}"' for axis in ("ixx", "iyy", "izz"))
    return (
        f'<link name="{name}"><inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/>'
        f'<inertia {moments} ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def joint(name: str, kind: str, parent: str, child: str, inside: str) -> str:
    """Return the XML of a joint along or about z."""
    ends = f'<parent link="{parent}"/><child link="{child}"/><axis xyz="0 0 1"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside}</joint>'


LIMIT = '<limit lower="-0.2" upper="0.3" effort="1" velocity="{}"/>'
CHAIN = (
    '<robot name="r"><link name="base"/>',
    link("a", 3.0, 0.1),
    link("b", 1.0, 0.02, x=0.4),
    joint("lift", "prismatic", "base", "a", '<dynamics friction="2"/>' + LIMIT.format(9)),
    joint("turn", "continuous", "a", "b", '<dynamics friction="0.5" damping="0.1"/>'),
    "</robot>",
)
GRIPPER = (
    '<robot name="g"><link name="base"/>',
    link("a", 0.1, 0.03),
    link("b", 0.1, 0.05),
    joint("driver", "revolute", "base", "a", LIMIT.format(1e300)),
    joint(
        "follower", "revolute", "base", "b", LIMIT.format(1e300) + '<mimic joint="driver" multiplier="2"/>'
    ),
    "</robot>",
)
"""Follower at twice the rate: both coordinates move 0.03 + 4 * 0.05 kg m^2, as the driver feels it."""


def as_forces(tmp_path: Path, parts: tuple[str, ...], **options: Any) -> Reading:
    """Write and read a URDF with its friction and limits as forces."""
    path = tmp_path / "robot.urdf"
    path.write_text("".join(parts))
    return read(path, **{"friction": "regularized", "limits": "compliant"} | options)


def test_forces_have_the_inertias_of_their_joints(tmp_path: Path) -> None:
    found = as_forces(tmp_path, CHAIN)
    forces = [force for force in found.scene.forces if isinstance(force, JointFriction | JointStop)]
    lift, low, high, turn = forces
    assert isinstance(lift, JointFriction)
    assert isinstance(turn, JointFriction)
    assert (lift.coulomb, turn.coulomb) == (2.0, 0.5)
    assert lift.transition_speed == pytest.approx(STICK_TIME * 2.0 / (3.0 + 1.0))
    assert turn.transition_speed == pytest.approx(STICK_TIME * 0.5 / (0.02 + 0.4**2))
    assert isinstance(low, JointStop)
    assert isinstance(high, JointStop)
    assert (low.limit, high.limit) == (-0.2, 0.3)
    assert low.stiffness == high.stiffness == pytest.approx(STOP_RATE * 4.0)


def test_an_inertia_is_that_of_all_that_constraints_move(tmp_path: Path) -> None:
    of_driver, _, of_follower, _ = as_forces(tmp_path, GRIPPER).scene.forces
    assert isinstance(of_driver, JointStop)
    assert isinstance(of_follower, JointStop)
    inertia = 0.03 + 2.0**2 * 0.05
    assert of_driver.stiffness == pytest.approx(STOP_RATE * inertia)
    assert of_follower.stiffness == pytest.approx(STOP_RATE * inertia / 2.0**2)


def test_a_weight_rests_on_its_stop(tmp_path: Path) -> None:
    """With the weight alone, the depth is that of the stop's angular frequency, whatever the mass."""
    found = as_forces(tmp_path, CHAIN, friction="off", duration=2.0)
    end = simulate(found.scene).joint("lift").coordinates[-1, 0]
    assert end == pytest.approx(-0.2 - 9.81 / STOP_RATE, abs=1e-5)


def test_the_report_calls_them_approximated_and_limits_of_velocity_left_out(tmp_path: Path) -> None:
    report = as_forces(tmp_path, CHAIN).report
    lift, turn = "joint 'lift'", "joint 'turn'"
    assert report.approximated_topics == {(lift, FRICTION), (lift, LIMITS), (turn, FRICTION)}
    assert {(entry.element, entry.topic) for entry in report.unsimulated()} == {(lift, VELOCITY_LIMITS)}
    assert report.simulation is None  # no user's loop with Pinocchio has them
    assert any("dry friction" in line for line in report.start)
    # as the file is read without the options
    default = as_forces(tmp_path, CHAIN, friction="off", limits="off")
    assert not default.report.of("approximated")
    assert default.report.simulation is not None
    assert {entry.topic for entry in watched_in_new_run(default.scene, default.report).acting} >= {LIMITS}


def test_a_range_without_width_is_no_stop(tmp_path: Path) -> None:
    parts = tuple(part.replace('upper="0.3"', 'upper="-0.2"') for part in CHAIN)
    found = as_forces(tmp_path, parts)
    assert not [force for force in found.scene.forces if isinstance(force, JointStop)]
    assert LIMITS in {entry.topic for entry in found.report.unsimulated()}


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"coulomb": 2.1}, "joint 'lift': dry friction"),
        ({"dissipation": 0.0}, "joint 'lift'"),
        ({"stiffness": 1e5}, "state 3"),  # the energy of the stop
    ],
)
def test_wrong_numbers_of_the_scene_are_found(change: dict[str, float], where: str, tmp_path: Path) -> None:
    report = as_forces(tmp_path, CHAIN).report
    ((reference, scene),) = report.references
    forces = tuple(
        replace(force, **change)
        if isinstance(force, JointFriction | JointStop)
        and force.joint == "lift"
        and set(change) <= set(vars(force))
        else force
        for force in scene.forces
    )
    report.references = [(reference, replace(scene, forces=forces))]
    with pytest.raises(VerificationError) as caught:
        verify_report(report)
    assert caught.value.where == where


def test_a_model_in_memory_has_them_too(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text("".join(CHAIN))
    model = pin.buildModelFromUrdf(str(path))
    forces = read(model, friction="regularized", limits="compliant").scene.forces
    assert [force for force in forces if isinstance(force, JointFriction | JointStop)] == [
        force
        for force in as_forces(tmp_path, CHAIN).scene.forces
        if isinstance(force, JointFriction | JointStop)
    ]
    assert np.all([force.key[1] == 0 for force in forces])  # type: ignore[union-attr]
