"""Revolutions of coupled angles, whatever the order of the couplings."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from mechanisms import ORIGIN, X, Y, Z, wheel

import newton_euler
from newton_euler import Body, Gear, Mechanism, Polynomial, PrescribedMotion, Scene, State
from newton_euler.compiled.formulations import formulate
from newton_euler.equations.couplings import Coupling
from newton_euler.equations.revolutions import revolutions
from newton_euler.errors import MechanismError
from newton_euler.model.euler_parameters import from_rotation_vector
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Revolute, Screw, Translational
from newton_euler.runs.assemble import initial_state

ANGLES = {"shaft_0": 1.0, "shaft_1": -2.5, "shaft_2": -7.5, "shaft_3": -30.0}
"""Of the four wheels of `train`, in angles of the first."""

GEARS = (
    Gear("first", "shaft_0", "shaft_1", -2.5),
    Gear("second", "shaft_2", "shaft_1", 1.0 / 3.0),
    Gear("third", "shaft_2", "shaft_3", 4.0),
)

ORDERS = list(permutations(range(3)))


def train(order, *motions: PrescribedMotion) -> Scene:
    """Four wheels in a row, with their gears in some order."""
    names = [f"wheel_{k}" for k in range(4)]
    bodies = [Body.ground(), *(wheel(name, [float(k), 0.0, 0.0], 0.5) for k, name in enumerate(names))]
    joints = [
        Revolute(f"shaft_{k}", "ground", name, [float(k), 0.0, 0.0], axis=Z) for k, name in enumerate(names)
    ]
    mechanism = Mechanism(bodies, joints, [GEARS[k] for k in order])
    return Scene("train", mechanism, 1.0, 0.1, motions=motions)


def turned(scene: Scene, angle: float, error: float = 0.0) -> State:
    """Its state with the first wheel at an angle, rad, and the last one off by an error."""
    state = State.initial(scene.mechanism)
    for k, ratio in enumerate(ANGLES.values()):
        off = ratio * angle + error * (k == 3)
        state.quaternion[k + 1] = from_rotation_vector(np.array([0.0, 0.0, off]))
    return state


def angles(scene: Scene, formulation: str) -> dict[str, float]:
    """Of the wheels, as a formulation begins with them."""
    system = formulate(scene, formulation)
    q, v = system.coordinates(initial_state(scene))
    return {key[0]: float(values[0]) for key, values in system.surroundings(q, v).measured.items()}


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
@pytest.mark.parametrize("angle", [0.0, 1.0, -3.0, 5.0, 20.0, -77.7])
def test_gears_start_in_the_fewest_revolutions_that_agree_with_all_poses(angle, formulation):
    """After two of the first wheel, five of the second and so on, all poses are the same again."""
    fewest = float(np.remainder(angle + 2.0 * np.pi, 4.0 * np.pi) - 2.0 * np.pi)
    for order in ORDERS:
        scene = train(order)
        scene = replace(scene, initial_state=turned(scene, angle))
        found = angles(scene, formulation)
        # round-off of poses times 30
        assert found == pytest.approx({name: ratio * fewest for name, ratio in ANGLES.items()}, abs=1e-12)


@pytest.mark.parametrize("order", ORDERS, ids=str)
def test_wheels_that_do_not_mesh_are_refused_in_any_order(order):
    scene = train(order)
    with pytest.raises(MechanismError, match=r"has an error of .* rad in the initial state"):
        initial_state(replace(scene, initial_state=turned(scene, 5.0, error=1e-3)))


@pytest.mark.parametrize("order", ORDERS, ids=str)
@pytest.mark.parametrize("joint", ["shaft_0", "shaft_1", "shaft_3"])
@pytest.mark.parametrize("start", [3.1, 7.0, -55.5, 700.0])
def test_a_motion_that_starts_revolutions_away_moves_all_wheels(order, joint, start):
    scene = train(order, PrescribedMotion(joint, Polynomial([start, 1.0])))
    expected = {name: ratio / ANGLES[joint] * start for name, ratio in ANGLES.items()}
    # what assembly leaves open, of the largest angle
    assert angles(scene, "relative") == pytest.approx(
        expected, abs=1e-12 * max(1.0, *map(abs, expected.values()))
    )


def test_a_motion_that_starts_revolutions_away_runs():
    scene = train((2, 0, 1), PrescribedMotion("shaft_0", Polynomial([-55.5, 1.0])))
    for formulation in ("relative", "cartesian"):
        run = newton_euler.simulate(scene, formulation)
        expected = -30.0 * (-55.5 + run.time)
        turn = 2.0 * np.arctan2(run.quaternion[:, 4, 3], run.quaternion[:, 4, 0])
        assert np.abs(np.sin(0.5 * (turn - expected))).max() < 1e-11  # round-off of 1700 rad
        assert run.constraint_violation.max() < 1e-11


def test_a_slide_determines_the_revolutions_of_all_that_it_drives():
    """A rack, a pinion, a wheel that the pinion drives, and a nut that moves with the rack."""
    joints: list[Joint] = [
        Translational("guide", "ground", "rack", ORIGIN, axis=Y),
        Revolute("shaft", "ground", "pinion", X, axis=Z),
        Revolute("axle", "ground", "wheel", [2.0, 0.0, 0.0], axis=Z),
        Screw("thread", "ground", "nut", [3.0, 0.0, 0.0], axis=Y, pitch=0.01),
    ]
    centers = {"rack": ORIGIN, "pinion": X, "wheel": [2.0, 0.0, 0.0], "nut": [3.0, 0.0, 0.0]}
    bodies = [Body.ground(), *(wheel(name, center, 0.1) for name, center in centers.items())]
    gears = [
        Gear("mesh", "axle", "shaft", 0.5),
        Gear("rack", "shaft", "guide", 0.05),
        Gear("link", "guide", "thread", 1.0),
    ]
    for order in ORDERS:
        mechanism = Mechanism(bodies, joints, [gears[k] for k in order])
        motion = PrescribedMotion("guide", Polynomial([1.3]))
        scene = Scene("rack", mechanism, 1.0, 0.5, motions=(motion,))
        moved = replace(scene, motions=(), initial_state=initial_state(scene))
        for found in (scene, moved):
            q, v = formulate(found, "relative").coordinates(initial_state(found))
            seen = formulate(found, "relative").surroundings(q, v).measured
            at = {key: float(values[0]) for key, values in seen.items()}
            expected = {"guide": 1.3, "shaft": 26.0, "axle": 52.0, "thread": 1.3}
            assert {name: at[name, 0] for name in expected} == pytest.approx(expected, abs=1e-8)
            assert at["thread", 1] == pytest.approx(130.0, abs=1e-8)


def test_poses_that_nothing_agrees_with_stay_within_half_a_revolution():
    """A guess, which assembly moves; the slowest wheel stays where it is."""
    gear = Coupling("gear", "mesh", "b", {("b", 0): 1.0, ("a", 0): -np.sqrt(2.0)}, None, False)
    found = revolutions([gear], {("a", 0): 3.0, ("b", 0): 0.2}, {("a", 0), ("b", 0)}, 0.0, {})
    assert found == {("a", 0): 0.0, ("b", 0): pytest.approx(2.0 * np.pi)}  # 4.24 is nearest to 6.48


DIFFERENTIAL = Coupling("equality", "difference", "a", {("a", 0): 1.0, ("b", 0): -2.0}, None, False)


def test_a_coordinate_that_a_fixed_difference_holds_at_zero_tells_no_revolutions():
    """A slide and an angle are driven by a - 2 b = 0: the fewest turns have a and b only."""
    driven = [
        Coupling("equality", name, name, {(name, 0): 1.0, ("a", 0): -0.5, ("b", 0): 1.0}, None, False)
        for name in ("slide", "wheel")
    ]
    # poses of a = 8 - 4 pi and b = 4 - 2 pi, where a is between -pi and pi
    x = {("a", 0): 8.0 - 2.0 * np.pi, ("b", 0): 4.0 - 2.0 * np.pi, ("slide", 0): 0.0, ("wheel", 0): 0.0}
    for order in ORDERS:
        couplings = [[DIFFERENTIAL, *driven][k] for k in order]
        found = revolutions(couplings, x, {("a", 0), ("b", 0), ("wheel", 0)}, 0.0, {})
        # multiples of 2 pi, up to round-off
        assert found == {("a", 0): pytest.approx(-2.0 * np.pi), ("b", 0): 0.0, ("wheel", 0): 0.0}


def test_a_slide_that_moves_with_the_sum_of_two_angles_determines_their_revolutions():
    total = Coupling("equality", "sum", "s", {("s", 0): 1.0, ("a", 0): -1.0, ("b", 0): -1.0}, None, False)
    # a = 20 and b = 10, which differ from the poses by whole turns
    x = {("s", 0): 30.0, ("a", 0): 20.0 - 6.0 * np.pi, ("b", 0): 10.0 - 4.0 * np.pi}
    for couplings in ([DIFFERENTIAL, total], [total, DIFFERENTIAL]):
        found = revolutions(couplings, x, {("a", 0), ("b", 0)}, 0.0, {})
        assert found == {("a", 0): pytest.approx(6.0 * np.pi), ("b", 0): pytest.approx(4.0 * np.pi)}
