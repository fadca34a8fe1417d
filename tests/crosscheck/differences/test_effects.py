"""Effects of rows on the motion: those of one changed number, and numbers carried over to other frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from paired_robots import pairs_by_name
from test_dynamics import TREE, two_chains
from test_motion import ARM, COUPLINGS, LOOP, PARALLELOGRAM, compared, in_other_frames, of_text, pendulum

from crosscheck.differences.common_states import CommonStates, common_states
from crosscheck.differences.difference import Difference, Quantity
from crosscheck.differences.effects import effects
from crosscheck.differences.merged_robot import merged
from crosscheck.differences.motion import relative_changes
from crosscheck.differences.rows import differences
from newton_euler.reading.robot import FileCoupling, LoopKind, RobotFile


def effect_of(
    first: RobotFile, second: RobotFile, flipped: tuple[str, ...] = ()
) -> dict[tuple[str, Quantity], float | None]:
    """Return the effect of each row, by element and quantity."""
    alignment = pairs_by_name(first.robot, second.robot, flipped)
    rows = differences(first, second, alignment, None)
    found = effects(common_states(first, second, alignment), rows)
    return {(row.element, row.quantity): effect for row, effect in zip(rows, found, strict=True)}


CHANGES = {
    ("leg", Quantity.MASS): ('mass=".3"', 'mass=".33"'),
    ("a1", Quantity.DAMPING): ('damping=".3"', 'damping=".2"'),
    ("a1", Quantity.ARMATURE): ('armature=".02"', 'armature=".03"'),
    ("a1", Quantity.STIFFNESS): ('stiffness="2"', 'stiffness="3"'),
    ("a1", Quantity.REST): ('springref="40"', 'springref="30"'),
    ("m", Quantity.GEAR): ('gear="3"', 'gear="2"'),
    ("p", Quantity.KP): ('kp="2"', 'kp="4"'),
    ("p", Quantity.KV): ('kv=".3"', 'kv=".1"'),
    ("l1", Quantity.JOINT_ORIGIN): ('name="leg" pos="-.2 0 .1"', 'name="leg" pos="-.2 0.02 .1"'),
    ("l1", Quantity.JOINT_AXIS): ('name="l1" axis="0 0 1"', 'name="l1" axis="0 0.1 1"'),
    ("model", Quantity.GRAVITY): ('gravity="1 -2 -9"', 'gravity="0 0 -9.81"'),
}


SENSES = ("a1", "a2", "l1")
"""Joints that count the other way in other frames."""

ORIGIN = ("l1", Quantity.JOINT_ORIGIN)
"""In other frames, a moved origin cannot be told from a moved center of mass."""


@pytest.mark.parametrize(
    ("key", "flipped"),
    [*((key, ()) for key in CHANGES), *((key, SENSES) for key in CHANGES if key != ORIGIN)],
    ids=lambda each: "-".join(each),
)
def test_effect_is_the_change_by_this_number_alone(
    key: tuple[str, Quantity], flipped: tuple[str, ...]
) -> None:
    """The second file differs in two numbers, and perhaps in all frames and senses."""
    first = of_text(TREE)
    alone = of_text(TREE.replace(*CHANGES[key]))
    both = of_text(
        TREE.replace(*CHANGES[key]).replace('diaginertia=".02 .03 .04"', 'diaginertia=".02 .03 .045"')
    )
    if flipped:
        both = RobotFile(in_other_frames(both.robot, 3, -1), format="MJCF")
    found = effect_of(first, both, flipped)
    # the same equations at the same states, in other frames
    assert found[key] == pytest.approx(compared(first, alone).change, rel=1e-8)
    inertia = of_text(TREE.replace('diaginertia=".02 .03 .04"', 'diaginertia=".02 .03 .045"'))
    assert found["trunk", Quantity.INERTIA] == pytest.approx(compared(first, inertia).change, rel=1e-8)


def test_mass_by_hand() -> None:
    """At rest the angular acceleration is m g l cos(angle) / (m l^2 + armature)."""
    one, two = (mass * 0.5 / (mass * 0.25 + 0.05) for mass in (1.0, 1.1))
    found = effect_of(RobotFile(pendulum(1.0, 0.05)), RobotFile(pendulum(1.1, 0.08)))
    assert found["rod", Quantity.MASS] == pytest.approx((two - one) / two, rel=1e-12)


def test_numbers_in_other_frames_move_alike() -> None:
    """All numbers of the second robot, written in the terms of the first, move as the second robot."""
    coupling = FileCoupling("coupling", "hinge10", "hinge00", (0.1, -0.7, 0.3, 0.2))
    first = two_chains(LoopKind.HINGE, couplings=(coupling,))
    second = in_other_frames(two_chains(LoopKind.HINGE, couplings=(coupling,)), 7, 1)
    bodies = list(second.bodies)
    bodies[4] = replace(bodies[4], mass=2.0, center=bodies[4].center + 0.05, inertia=2 * bodies[4].inertia)
    # other zeros and, with the reversed joints, another polynomial
    bodies[3] = replace(bodies[3], joints=(bodies[3].joints[0], replace(bodies[3].joints[1], zero=0.3)))
    senses = tuple(joint.name for body in first.bodies for joint in body.joints if "ball" not in joint.name)
    second = replace(
        second, bodies=tuple(bodies), couplings=(replace(coupling, powers=(-0.1, -0.7, -0.3, 0.2)),)
    )
    files = RobotFile(first), RobotFile(second)
    alignment = pairs_by_name(first, second, senses)
    states = CommonStates(*files, alignment)
    terms = merged(states.one.robot, states.two.robot, states.alignment)
    assert terms.loops == terms.couplings == {0}
    one, two = states.of_first([terms.second]), states.of_second([states.two.robot])
    # round-off of inertias about the world's origin, times the condition of the mass matrix
    assert relative_changes(one, two).max() < 1e-9
    assert relative_changes(states.of_first([states.one.robot]), two).max() > 0.1


def test_conventions_and_limits() -> None:
    limited = ARM.replace('"shoulder" axis="0 1 0"', '"shoulder" axis="0 -1 0" range="-10 20"')
    text = ARM.replace('"shoulder" axis="0 1 0"', '"shoulder" axis="0 1 0" range="-20 12"')
    found = effect_of(of_text(text), of_text(limited), ("shoulder",))
    assert found["shoulder", Quantity.SIGN] == 0.0
    assert found["shoulder", Quantity.LIMITS] is None


def test_axis_reversed_by_mistake() -> None:
    text = ARM.replace('"shoulder" axis="0 1 0"', '"shoulder" axis="0 1 0" range="-30 120"')
    first, second = of_text(text), of_text(text.replace('axis="0 1 0" range', 'axis="0 -1 0" range'))
    found = effect_of(first, second, ("shoulder",))
    assert found["shoulder", Quantity.SIGN] == pytest.approx(compared(first, second, ("shoulder",)).change)


def test_part_in_one_file_changes_all_mass_numbers() -> None:
    """One row about the mass stands for the center and the inertia too; with a row each, it does not."""
    part = """<body name="part" pos=".1 0 .1">
      <inertial pos="0 0 0" mass=".2" diaginertia=".001 .001 .001"/></body>"""
    text = TREE.replace('<body name="leg"', f'{part}<body name="leg"')
    first, second = of_text(TREE), of_text(text)
    found = effect_of(first, second)
    rows = [key for key in found if key[0] == "trunk"]
    assert rows == [("trunk", Quantity.MASS)]
    assert found[rows[0]] == pytest.approx(compared(first, second).change, rel=1e-8)
    heavier = of_text(TREE.replace('pos=".1 .02 0" mass="2"', 'pos=".12 .02 0" mass="2.1"'))
    found = effect_of(first, heavier)
    mass_alone = compared(first, of_text(TREE.replace('mass="2"', 'mass="2.1"'))).change
    assert found["trunk", Quantity.MASS] == pytest.approx(mass_alone, rel=1e-8)


def test_presence() -> None:
    """A drive, a loop, couplings and a branch that only one file has."""
    motor = '<motor name="m" joint="shoulder" gear="50"/>'
    for files in ((ARM, ARM.replace(motor, "")), (ARM.replace(motor, ""), ARM)):
        first, second = (of_text(text) for text in files)
        found = effect_of(first, second)
        assert found["m", Quantity.PRESENCE] == pytest.approx(compared(first, second).change)
    loop, none, gears = (
        of_text(PARALLELOGRAM.replace("EQUALITY", text))
        for text in (LOOP, "", COUPLINGS.replace("FACTOR", "1"))
    )
    found = effect_of(loop, gears)
    assert found["loop", Quantity.PRESENCE] == pytest.approx(compared(loop, none).change)
    # the loop stays, and the gears agree with it
    assert found["one", Quantity.PRESENCE] == pytest.approx(0.0, abs=1e-12)
    leg = TREE[TREE.index('<body name="leg"') : TREE.index("</body></worldbody>")]
    servo = TREE[TREE.index("<position") : TREE.index("</actuator>")]
    with_leg, without = of_text(TREE.replace(servo, "")), of_text(TREE.replace(leg, "").replace(servo, ""))
    for files in ((with_leg, without), (without, with_leg)):
        found = effect_of(*files)
        assert 0.05 < found["leg", Quantity.PRESENCE] < 1.0


def test_rows_without_common_joints() -> None:
    robot = pendulum(1.0)
    alignment = replace(pairs_by_name(robot, robot), bodies=(), joints=())
    row = Difference("rod", "body", Quantity.MASS, 1.0, 2.0, "kg", 1.0)
    assert effects(common_states(RobotFile(robot), RobotFile(robot), alignment), [row]) == [None]
    assert np.isfinite(row.size)
