"""Planar joints, points on lines and rods against closed forms, and redundant joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from elements import planes_and_rods, rod_platform
from mechanisms import GRAVITY, bar, planar_four_bar
from scipy.integrate import solve_ivp

import newton_euler
from newton_euler import Body, Mechanism, Scene, State
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.relative import Relative
from newton_euler.errors import MechanismError
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Planar, PointOnLine, Revolute, Rod, Spherical
from newton_euler.model.joint_parts import Part, combine_motions
from newton_euler.model.parallel_hinges import ParallelHinges
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.reading.excitation import random_states

ORIGIN = [0.0, 0.0, 0.0]
INTEGRATED = 2e-8
"""m, error of positions of order 1 m after 2 s at rtol = 1e-10."""


@pytest.fixture(params=["relative", "cartesian"])
def formulation(request):
    return request.param


def launched(scene: Scene, body: int, velocity, omega) -> Scene:
    """The scene with one body in motion at its initial pose."""
    start = State.initial(scene.mechanism)
    linear, angular = start.linear_velocity.copy(), start.angular_velocity.copy()
    linear[body], angular[body] = velocity, omega
    return replace(scene, initial_state=State(start.position, start.quaternion, linear, angular))


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("gravity", [(0.0, 0.0, 0.0), GRAVITY])
def test_a_puck_on_a_slanted_plane(formulation, swapped, gravity):
    """It slides on a straight line or a parabola and spins steadily; the plane carries m g n."""
    normal = np.array([0.48, -0.6, 0.64])
    puck = Body(
        "puck", 2.0, [0.3, 0.1, 0.2], np.diag([0.02, 0.02, 0.03]), from_rotation_vector([0.4, 0.2, 0.1])
    )
    pair = ("puck", "ground") if swapped else ("ground", "puck")
    mechanism = Mechanism([Body.ground(), puck], [Planar("table", *pair, puck.center_of_mass, axis=normal)])
    scene = Scene("puck", mechanism, 2.0, 0.2, gravity)
    v = np.cross(normal, [1.0, 0.5, -0.2])
    run = newton_euler.simulate(launched(scene, 1, v, 5.0 * normal), formulation)
    g = np.asarray(gravity)
    inside = g - normal * (normal @ g)
    t = run.time[:, None]
    assert np.abs(run.position[:, 1] - puck.center_of_mass - t * v - 0.5 * t**2 * inside).max() < INTEGRATED
    assert np.abs(run.angular_velocity[:, 1] - 5.0 * normal).max() < INTEGRATED
    sign = -1.0 if swapped else 1.0
    assert np.abs(run.reaction_force[:, 0] + sign * 2.0 * normal * (normal @ g)).max() < 1e-10
    # the normal is no principal axis: the plane has to hold the puck
    tensor = rotation(puck.quaternion) @ puck.inertia @ rotation(puck.quaternion).T
    held = np.cross(5.0 * normal, tensor @ (5.0 * normal))
    assert sign * run.reaction_torque[0, 0] == pytest.approx(held, abs=1e-12)
    assert run.constraint_violation.max() < 1e-12


def test_a_bead_on_an_inclined_wire(formulation):
    """a = g . e along the wire, and a free spin; the wire carries the rest of the weight."""
    along, omega = np.array([0.6, 0.0, -0.8]), np.array([1.0, -2.0, 3.0])
    bead = Body("bead", 0.5, [0.1, 0.2, 0.3], 0.001 * np.eye(3))
    joint = PointOnLine("wire", "ground", "bead", bead.center_of_mass, axis=along)
    scene = Scene("bead", Mechanism([Body.ground(), bead], [joint]), 2.0, 0.2, GRAVITY)
    run = newton_euler.simulate(launched(scene, 1, 0.3 * along, omega), formulation)
    t = run.time[:, None]
    wanted = bead.center_of_mass + (0.3 * t + 0.5 * t**2 * (9.81 * 0.8)) * along
    assert np.abs(run.position[:, 1] - wanted).max() < INTEGRATED
    assert np.abs(run.angular_velocity[:, 1] - omega).max() < INTEGRATED
    g = np.asarray(GRAVITY)
    assert np.abs(run.reaction_force[:, 0] + 0.5 * (g - along * (along @ g))).max() < 1e-10
    assert np.abs(run.reaction_torque).max() < 1e-10


def spherical_pendulum(t, start, velocity):
    """Positions (n, 3) of a point mass at a fixed distance from the origin, by another integrator."""

    def rate(_, y):
        r, v = y[:3], y[3:]
        g = np.asarray(GRAVITY)
        return np.concatenate([v, g - r * ((v @ v + g @ r) / (r @ r))])

    y = np.concatenate([start, velocity])
    return solve_ivp(rate, (0.0, t[-1]), y, "DOP853", t, rtol=1e-12, atol=1e-13).y[:3].T


def test_a_spherical_pendulum_on_a_rod(formulation):
    """A body on a rod at its center moves as a point; so does a tiny one on a ball joint far away."""
    start, velocity = np.array([0.6, 0.0, -0.8]), np.array([0.4, 1.5, 0.3])
    swing = np.cross(start, velocity)
    wanted = None
    for joint, moment, omega in (
        (Rod("rod", "ground", "bob", ORIGIN, point_on_second=start), 0.05, np.array([3.0, 1.0, 2.0])),
        (Spherical("ball", "ground", "bob", ORIGIN), 1e-10, swing),
    ):
        bob = Body("bob", 1.5, start, moment * np.eye(3))
        scene = Scene("pendulum", Mechanism([Body.ground(), bob], [joint]), 2.0, 0.1, GRAVITY)
        run = newton_euler.simulate(launched(scene, 1, velocity, omega), formulation)
        wanted = spherical_pendulum(run.time, start, velocity) if wanted is None else wanted
        assert np.abs(run.position[:, 1] - wanted).max() < INTEGRATED  # the tiny inertia is 1e-10 of m l^2
        if joint.kind == "rod":
            tension = 1.5 * (velocity @ velocity + np.asarray(GRAVITY) @ start)
            assert run.reaction_force[0, 0] == pytest.approx(-tension * start, rel=1e-10)
            assert np.abs(run.reaction_torque).max() < 1e-12  # a rod has none about its own point
            assert np.abs(run.angular_velocity[:, 1] - omega).max() < INTEGRATED
            assert run.constraint_violation.max() < 1e-13


@pytest.mark.parametrize("opposed", [False, True])
def test_a_bar_that_hangs_on_a_massless_link(formulation, opposed):
    """A double pendulum whose first link has no mass, by Lagrange's equations in absolute angles a and b.

    With link length l, distance c from the second axis to the center of mass, and moment J about the latter:
    m l^2 a'' + m l c (cos(a - b) b'' + sin(a - b) b'^2) = -m g l sin a
    m l c cos(a - b) a'' + (J + m c^2) b'' - m l c sin(a - b) a'^2 = -m g c sin b
    """
    m, length, c, moment, g = 1.5, 0.3, 0.25, 0.02, 9.81
    start = np.array([0.4, -0.9])  # angles from the vertical, about y: (-sin, 0, -cos) points down the link
    down = np.stack([-np.sin(start), np.zeros(2), -np.cos(start)], axis=1)
    axis, elbow = np.array([0.0, 1.0, 0.0]), length * down[0] + [0.0, 0.1, 0.0]
    rod = Body("rod", m, elbow + c * down[1], moment * np.eye(3))
    joint = ParallelHinges("j", "ground", "rod", ORIGIN, axis=axis, offset=elbow, opposed=opposed)
    scene = Scene("pendulum", Mechanism([Body.ground(), rod], [joint]), 2.0, 0.1, (0.0, 0.0, -g))
    run = newton_euler.simulate(scene, formulation)

    def rate(_, y):
        (a, b), (u, v) = y[:2], y[2:]
        mass = [[m * length**2, m * length * c * np.cos(a - b)], [0.0, moment + m * c**2]]
        mass[1][0] = mass[0][1]
        turning = m * length * c * np.sin(a - b)
        force = [
            -m * g * length * np.sin(a) - turning * v**2,
            -m * g * c * np.sin(b) + turning * u**2,
        ]
        return np.concatenate([[u, v], np.linalg.solve(mass, force)])

    angles = (
        solve_ivp(rate, (0.0, 2.0), [*start, 0.0, 0.0], "DOP853", run.time, rtol=1e-12, atol=1e-13).y[:2].T
    )
    moved = angles - start
    wanted = np.stack([moved[:, 0], (moved[:, 1] - moved[:, 0]) * (-1.0 if opposed else 1.0)], axis=1)
    found = np.unwrap(run.joint("j").coordinates, axis=0)
    assert np.abs(found - wanted).max() < INTEGRATED
    assert run.constraint_violation.max() < 1e-12
    # the massless link is a two-force member: at rest only its tension, along the link, acts on the rod
    pull = run.reaction_force[0, 0]
    assert np.abs(np.cross(pull, down[0])).max() < 1e-10
    with pytest.raises(MechanismError, match="apart"):
        ParallelHinges("j", "ground", "rod", ORIGIN, axis=axis, offset=[0.0, 0.3, 0.0])


def hung(count: int, *more: Joint) -> Scene:
    """A bar hung by parallel rods of length 0.5 m in the plane x-z."""
    ends = [[0.1, 0.0, 0.0], [0.9, 0.0, 0.0], [0.4, 0.0, 0.0]]
    swing = 0.5 * np.array([np.sin(0.7), 0.0, -np.cos(0.7)])
    body = bar("coupler", list(ends[0] + swing), list(ends[1] + swing), 3.0)
    rods = [Rod(f"rod_{k}", "ground", "coupler", p, point_on_second=p + swing) for k, p in enumerate(ends)]
    mechanism = Mechanism([Body.ground(), body], [*rods[:count], *more])
    return Scene("hung", mechanism, 2.0, 0.1, GRAVITY)


def test_a_coupler_on_parallel_rods_is_a_simple_pendulum(formulation):
    """It does not turn, whether a plane guides it or it floats; pinned links of no mass do the same."""
    plane = Planar("plane", "ground", "coupler", [0.5, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
    start = 0.5 * np.array([np.sin(0.7), 0.0, -np.cos(0.7)])
    wanted = None
    for scene in (hung(2), hung(2, plane)):
        run = newton_euler.simulate(scene, formulation)
        wanted = spherical_pendulum(run.time, start, np.zeros(3)) if wanted is None else wanted
        moved = run.position[:, 1] - run.position[0, 1] + start
        assert np.abs(moved - wanted).max() < INTEGRATED
        assert np.abs(run.angular_velocity).max() < INTEGRATED
        # both rods carry half of the weight at the start
        tension = 3.0 * 9.81 * np.cos(0.7)
        forces = run.reaction_force[0, :2]
        assert forces.sum(axis=0) == pytest.approx(-tension * start / 0.5, abs=1e-10)


@pytest.mark.parametrize("swapped", [False, True])
def test_joint_coordinates_come_back_from_states(swapped):
    system = Relative(planes_and_rods(swapped))
    for state in random_states(system.scene, 3):
        q, v = system.coordinates(state)
        again = system.state(q, v)
        for name in ("position", "linear_velocity", "angular_velocity"):
            assert np.abs(getattr(again, name) - getattr(state, name)).max() < 1e-12


def test_bodies_that_only_rods_reach_float(formulation):
    scene = rod_platform()
    tree = SpanningTree(scene.mechanism)
    assert [joint.name for joint in tree.floating] == ["block_floats"]
    assert [tree.joint(kept.joint).name for kept in tree.joints] == ["block_floats", "hinge"]
    assert (tree.nq, tree.nv, len(tree.cuts)) == (8, 7, 5)
    run = newton_euler.simulate(scene, formulation)
    energy = run.kinetic_energy + run.potential_energy
    assert np.abs(energy - energy[0]).max() < 1e-8
    assert np.ptp(run.kinetic_energy) > 0.1
    assert run.constraint_violation.max() < 1e-12
    assert run.reaction_force.shape[1] == len(scene.mechanism.joints)


# Redundant joints


def door(hinges: int) -> Scene:
    body = bar("leaf", [0.0, 0.0, 0.5], [0.8, 0.0, 0.5], 10.0)
    axis = [0.05, 0.0, 1.0]
    joints: list[Joint] = [
        Revolute(name, "ground", "leaf", np.multiply(height, axis), axis=axis)
        for name, height in (("upper", 1.0), ("lower", 0.0))
    ][:hinges]
    return Scene("door", Mechanism([Body.ground(), body], joints), 1.0, 0.1, GRAVITY)


def unused(code: CompiledEquations) -> set[str]:
    """Joints with rows that are not in use."""
    return {name for k, name in enumerate(code.system.row_owners) if k not in set(code.rows.numbers)}


def test_a_door_on_two_hinges_uses_the_rows_of_one(formulation):
    assert not unused(CompiledEquations(door(1), formulation))
    found = unused(CompiledEquations(door(2), formulation))
    assert found
    assert found <= {"upper", "lower"}
    if formulation == "relative":
        assert found == {"lower"}
    one, two = (newton_euler.simulate(door(n), formulation) for n in (1, 2))
    assert np.abs(one.position - two.position).max() < INTEGRATED


def test_of_parallel_rods_one_is_redundant(formulation):
    plane = Planar("plane", "ground", "coupler", [0.5, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
    assert not unused(CompiledEquations(hung(2, plane), formulation))
    code = CompiledEquations(hung(3, plane), formulation)
    (found,) = unused(code)
    assert found in ("rod_0", "rod_1", "rod_2")
    assert code.redundant
    one, two = (newton_euler.simulate(hung(n, plane), formulation) for n in (2, 3))
    assert np.abs(one.position - two.position).max() < INTEGRATED


def test_rows_have_owners(formulation):
    for scene in (rod_platform(), planar_four_bar()):
        system = FORMULATIONS[formulation](scene)
        assert len(system.row_owners) == len(system.phi_units)
        assert set(system.row_owners) <= {*scene.mechanism.joint_names, *scene.mechanism.body_names}
    system = FORMULATIONS[formulation](rod_platform())
    assert system.row_owners[:2] == ("rod_0", "rod_1")


def test_bodies_out_of_reach_are_refused():
    with pytest.raises(MechanismError, match="body 'b': no joint leads to it"):
        Mechanism(
            [Body.ground(), *(bar(n, ORIGIN, [1.0, 0, 0]) for n in "ab")],
            [Rod("rod", "ground", "a", ORIGIN, point_on_second=[1.0, 0, 0])],
        )


def test_three_parallel_hinges_in_a_row_are_refused_by_their_names() -> None:
    """Poses of the bodies do not determine the angles of three, of which two reach a point in two ways."""
    axis = np.array([0.0, 1.0, 0.0])
    row = [Part(f"j{k}", "hinge", axis, np.array([0.1 * k, 0.0, 0.01 * k])) for k in range(3)]
    with pytest.raises(MechanismError) as caught:
        combine_motions("knee", "thigh", "shin", row, actuated=False)
    assert "'shin'" in str(caught.value)
    assert "3 parallel hinges" in str(caught.value)
    assert "j0, j1, j2" in str(caught.value)


@pytest.mark.parametrize("kinds", [("ball", "hinge"), ("hinge", "ball"), ("ball", "ball")])
def test_a_ball_in_a_row_with_other_rotations_is_refused(kinds: tuple[str, str]) -> None:
    axis = np.array([0.0, 1.0, 0.0])
    row = [Part(f"j{k}", kind, axis, np.zeros(3)) for k, kind in enumerate(kinds)]
    with pytest.raises(MechanismError, match=r"'shin': has a ball and other rotations .*: j0, j1"):
        combine_motions("knee", "thigh", "shin", row, actuated=False)


def test_gaps_of_displaced_points_add_up() -> None:
    """A variation of a variation has the gap of both displacements."""
    joint = Spherical("joint", "ground", "body", np.zeros(3))
    once = joint.varied({"point_on_second": np.array([0.3, 0.0, 0.0])})
    twice = once.varied({"point_on_first": np.array([0.1, 0.0, 0.0])})
    assert np.allclose(twice.point_gap, twice.point_on_second - twice.point)
