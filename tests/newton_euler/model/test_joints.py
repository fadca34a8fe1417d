"""Phi, Phi_q and gamma of every joint kind, by finite differences along exact motions."""

from __future__ import annotations

import numpy as np
import pytest
from finite_difference import derivative, jacobian

from newton_euler.errors import MechanismError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.joint import Pose, perpendicular_pair
from newton_euler.model.joint_kinds import JOINT_KINDS, Revolute, Rod, Screw, Universal

AXIS = np.array([0.48, -0.6, 0.64])
AXES = {
    "axis": AXIS,
    "axis_on_first": AXIS,
    "axis_on_second": perpendicular_pair(AXIS)[0],
}
ACROSS = perpendicular_pair(AXIS)
COUNTS = {
    "spherical": 3,
    "universal": 4,
    "revolute": 5,
    "cylindrical": 4,
    "screw": 4,
    "planar": 3,
    "point_on_line": 2,
    "parallel_hinges": 4,
    "rod": 1,
    "translational": 5,
    "prismatic": 5,
    "fixed": 6,
    "free": 0,
}
HINGES = np.array([[0.8, 0.1, 0.3], [-0.2, 0.9, 0.1], [0.1, -0.3, 1.0]])
SLIDES = np.array([[0.2, 0.7, -0.4], [1.0, 0.1, 0.3]])
OFFSETS = np.array([[0.3, -0.4, 0.7], [-0.5, 0.2, 0.1]])
SKEW = {
    f"{slides} slides and {hinges} skew hinges": {
        "slides": SLIDES[:slides],
        "hinges": HINGES[:hinges],
        "offsets": OFFSETS[: hinges - 1],
    }
    for slides in (0, 1, 2)
    for hinges in (2, 3)
}
"""Options of compound joints, by name."""


@pytest.mark.parametrize("axis", [[0.0, 0.0, 1.0], [1.0, 1.0, 1.0], [1.0, -1.0, 0.0], [0.6, 0.6, 0.8]])
@pytest.mark.parametrize("place", range(3))
def test_the_last_digits_of_an_axis_choose_no_other_perpendiculars(axis, place):
    """Processors round products of rotations differently."""
    wanted = perpendicular_pair(np.array(axis) / np.linalg.norm(axis))
    for change in (-2e-16, 2e-16):
        other = np.array(axis) / np.linalg.norm(axis)
        other[place] += change
        assert np.abs(np.array(perpendicular_pair(other)) - wanted).max() < 1e-15


def turn(vector):
    return rotation(from_rotation_vector(np.asarray(vector)))


def make(kind, rng):
    """A joint of that kind between two bodies at random reference poses."""
    cls = Compound if kind in SKEW else JOINT_KINDS[kind]
    more = {"screw": {"pitch": 0.3}, "rod": {"point_on_second": rng.standard_normal(3)}} | SKEW
    more["parallel_hinges"] = {"offset": OFFSETS[0], "opposed": True}
    more = more.get(kind, {})
    joint = cls("j", "a", "b", rng.standard_normal(3), **{n: AXES[n] for n in cls.axis_names}, **more)
    first, second = (Pose(rng.standard_normal(3), turn(rng.standard_normal(3))) for _ in "ab")
    return joint.attach(0, first, 1, second), first, second


class Path:
    """An exact motion of a body: r + v s + a s^2/2, and R(w s + ...) with steady world rates."""

    def __init__(self, rng, pose):
        self.r, self.rotation = pose.position + 0.3 * rng.standard_normal(3), None
        self.v, self.a = rng.standard_normal((2, 3))
        self.start = turn(0.4 * rng.standard_normal(3)) @ pose.rotation
        self.one, self.two = rng.standard_normal((2, 3))

    def frame(self, s):
        """Two turns about fixed axes, one in the world and one in the body: angular velocity known."""
        left, right = turn(s * self.one), turn(s * self.two)
        a = left @ self.start @ right
        omega = self.one + left @ self.start @ self.two
        return Frame(self.r + s * self.v + 0.5 * s**2 * self.a, a, self.v + s * self.a, omega)

    def angular_acceleration(self):
        return np.cross(self.one, self.start @ self.two)


@pytest.fixture(params=[*sorted(set(JOINT_KINDS) - {"free"}), *SKEW])
def moving(request):
    rng = np.random.default_rng(sum(map(ord, request.param)))
    equations, first, second = make(request.param, rng)
    return equations, Path(rng, first), Path(rng, second)


def rate_by_jacobian(block, i, j):
    return (
        block.r_first @ i.velocity
        + block.theta_first @ i.angular_velocity
        + block.r_second @ j.velocity
        + block.theta_second @ j.angular_velocity
    )


# Differences of order 6 are good to 1e-11 here: residuals and their derivatives are of order 10.
DIFFERENCE = 1e-10


def test_count_of_equations_and_rank():
    rng = np.random.default_rng(3)
    skew = {name: 6 - len(more["slides"]) - len(more["hinges"]) for name, more in SKEW.items()}
    for kind, count in (COUNTS | skew).items():
        equations, first, second = make(kind, rng)
        frames = [Frame(p.position, p.rotation, np.zeros(3), np.zeros(3)) for p in (first, second)]
        stacked = np.hstack(equations.jacobian(*frames))
        assert equations.count == count == len(equations.is_length)
        assert np.allclose(equations.phi(*frames), 0.0, atol=1e-14)  # closed where it is described
        if count:
            assert np.linalg.matrix_rank(stacked) == count
        # the motions that are left are as many as the joint says it has
        freedoms = sum(3 if m.kind == "ball" else 1 for m in equations.joint.motions)
        assert count + freedoms == 6 or kind == "rod"  # which has no motions of its own


def test_jacobian_times_velocity_is_the_rate_of_phi(moving):
    equations, one, two = moving
    rate = derivative(lambda s: equations.phi(one.frame(s), two.frame(s)))
    i, j = one.frame(0.0), two.frame(0.0)
    assert np.allclose(rate_by_jacobian(equations.jacobian(i, j), i, j), rate, atol=DIFFERENCE)


def test_jacobian_column_by_column(moving):
    equations, one, two = moving
    i, j = one.frame(0.0), two.frame(0.0)

    def shifted(frame, x):
        return frame._replace(position=frame.position + x[:3], rotation=turn(x[3:]) @ frame.rotation)

    first = jacobian(lambda x: equations.phi(shifted(i, x), j), 6)
    second = jacobian(lambda x: equations.phi(i, shifted(j, x)), 6)
    blocks = equations.jacobian(i, j)
    assert np.allclose(np.hstack(blocks[:2]), first, atol=DIFFERENCE)
    assert np.allclose(np.hstack(blocks[2:]), second, atol=DIFFERENCE)


def test_gamma_completes_the_second_derivative(moving):
    """d2 Phi / dt2 = Phi_q qddot - gamma."""
    equations, one, two = moving
    i, j = one.frame(0.0), two.frame(0.0)
    second_rate = derivative(
        lambda s: rate_by_jacobian(equations.jacobian(one.frame(s), two.frame(s)), one.frame(s), two.frame(s))
    )
    block = equations.jacobian(i, j)
    from_accelerations = (
        block.r_first @ one.a
        + block.theta_first @ one.angular_acceleration()
        + block.r_second @ two.a
        + block.theta_second @ two.angular_acceleration()
    )
    assert np.allclose(from_accelerations - equations.gamma(i, j), second_rate, atol=DIFFERENCE)


COORDINATES = [
    ("revolute", lambda x: (np.zeros(3), x[0] * AXIS), 1),
    ("translational", lambda x: (x[0] * AXIS, np.zeros(3)), 1),
    ("cylindrical", lambda x: (x[0] * AXIS, x[1] * AXIS), 2),
    ("screw", lambda x: (x[0] * AXIS, x[1] * AXIS), 2),
    ("planar", lambda x: (x[0] * ACROSS[0] + x[1] * ACROSS[1], x[2] * AXIS), 3),
    ("point_on_line", lambda x: (x[0] * AXIS, np.array([0.3, -0.8, 0.5])), 1),
]


@pytest.mark.parametrize(("kind", "motion", "count"), COORDINATES)
def test_coordinates_measure_the_motion_of_the_second_body(kind, motion, count):
    rng = np.random.default_rng(5)
    equations, first, second = make(kind, rng)
    values = np.array([0.7, -1.9, 2.8])[:count]
    shift, angle = motion(values)
    point = equations.joint.point
    a = turn(angle)
    frames = (
        Frame(first.position, first.rotation, np.zeros(3), np.zeros(3)),
        Frame(point + a @ (second.position - point) + shift, a @ second.rotation, np.zeros(3), np.zeros(3)),
    )
    measured = np.concatenate([c.phi(*frames) for c in equations.coordinates])
    assert np.allclose(measured, values, atol=1e-14)  # exact up to round-off
    assert np.allclose(equations.phi(*frames), 0.0, atol=1e-14)


def test_universal_coordinates_are_its_two_angles_and_their_rates():
    rng = np.random.default_rng(6)
    equations, first, second = make("universal", rng)
    a, b, point = AXIS, AXES["axis_on_second"], equations.joint.point
    rates = np.array([0.8, -1.3])

    def frames(s):
        q = np.array([2.5, -0.6]) + s * rates
        one = turn(q[0] * a)
        r = one @ turn(q[1] * b)
        omega = rates[0] * a + rates[1] * (one @ b)
        return (
            Frame(first.position, first.rotation, np.zeros(3), np.zeros(3)),
            Frame(
                point + r @ (second.position - point),
                r @ second.rotation,
                np.cross(omega, r @ (second.position - point)),
                omega,
            ),
        )

    values = np.concatenate([c.phi(*frames(0.0)) for c in equations.coordinates])
    assert np.allclose(values, [2.5, -0.6], atol=1e-14)
    measured = [rate_by_jacobian(c.jacobian(*frames(0.0)), *frames(0.0))[0] for c in equations.coordinates]
    assert np.allclose(measured, rates, atol=1e-13)
    # d2/dt2 = 0 along this motion, so gamma of the coordinate is what its angular acceleration gives
    for coordinate in equations.coordinates:
        alpha = derivative(lambda s: frames(s)[1].angular_velocity)
        acceleration = derivative(lambda s: frames(s)[1].velocity)
        block = coordinate.jacobian(*frames(0.0))
        total = block.r_second @ acceleration + block.theta_second @ alpha - coordinate.gamma(*frames(0.0))
        assert np.allclose(total, 0.0, atol=DIFFERENCE)


def test_coordinates_of_parallel_hinges_are_their_two_angles_and_their_rates():
    """The link turns by 2.5 about the first axis, the body by -0.6 about minus the second one."""
    rng = np.random.default_rng(7)
    equations, first, second = make("parallel_hinges", rng)
    point, offset, rates = equations.joint.point, OFFSETS[0], np.array([0.8, -1.3])

    def frames(s):
        q = np.array([2.5, -0.6]) + s * rates
        link, body = turn(q[0] * AXIS), turn((q[0] - q[1]) * AXIS)
        elbow, beyond = link @ offset, body @ (second.position - point - offset)
        omega = (rates[0] - rates[1]) * AXIS
        return (
            Frame(first.position, first.rotation, np.zeros(3), np.zeros(3)),
            Frame(
                point + elbow + beyond,
                body @ second.rotation,
                np.cross(rates[0] * AXIS, elbow) + np.cross(omega, beyond),
                omega,
            ),
        )

    assert np.allclose(equations.phi(*frames(0.0)), 0.0, atol=1e-14)
    values = np.concatenate([c.phi(*frames(0.0)) for c in equations.coordinates])
    assert np.allclose(values, [2.5, -0.6], atol=1e-14)
    measured = [rate_by_jacobian(c.jacobian(*frames(0.0)), *frames(0.0))[0] for c in equations.coordinates]
    assert np.allclose(measured, rates, atol=1e-13)
    # rates are steady, so that gamma is what the body's acceleration gives
    acceleration = derivative(lambda s: frames(s)[1].velocity)
    for coordinate in equations.coordinates:
        total = coordinate.jacobian(*frames(0.0)).r_second @ acceleration - coordinate.gamma(*frames(0.0))
        assert np.allclose(total, 0.0, atol=DIFFERENCE)


def test_zero_axis_and_slanted_universal_are_refused():
    with pytest.raises(MechanismError, match=r"axis is .*non-zero"):
        Revolute("j", "a", "b", [0, 0, 0], axis=[0, 0, 0])
    assert Revolute("j", "a", "b", [0, 0, 0], axis=[0, 3e300, 4e300]).axis == pytest.approx([0, 0.6, 0.8])
    with pytest.raises(MechanismError, match="perpendicular"):
        Universal("j", "a", "b", [0, 0, 0], axis_on_first=[1, 0, 0], axis_on_second=[1, 1, 0])
    with pytest.raises(MechanismError, match="three finite numbers"):
        Revolute("j", "a", "b", [0, float("nan"), 0], axis=[0, 0, 1])


@pytest.mark.parametrize("pitch", [0.0, float("inf"), "1", True])
def test_a_screw_needs_a_pitch(pitch):
    with pytest.raises(MechanismError, match=r"joint 'j': pitch is .*meters per radian"):
        Screw("j", "a", "b", [0, 0, 0], axis=[0, 0, 1], pitch=pitch)


def test_a_rod_needs_two_points():
    with pytest.raises(MechanismError, match="joint 'j': its two points are 0 m apart"):
        Rod("j", "a", "b", [1, 2, 3])
    assert Rod("j", "a", "b", [1, 2, 3], point_on_second=[1, 5, 7]).length == 5.0
