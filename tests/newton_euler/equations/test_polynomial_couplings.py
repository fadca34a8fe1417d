"""Joint coordinates that are polynomials of others: closed forms, engines, files, starts and parameters."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import yaml
from elements import JOINTS
from finite_difference import derivative
from mechanisms import GRAVITY, ORIGIN, X, Y, Z, bar
from scipy.integrate import solve_ivp

import crosscheck
import mjcf
import newton_euler
import urdf
from crosscheck import check
from crosscheck.compare.outcome import Outcome
from crosscheck.library.scene_file import read_scene, write_scene
from crosscheck.studies.faults.misreadings import misreadings
from mjcf import read
from mjcf.rigid import RigidMuJoCo
from newton_euler import (
    Body,
    Mechanism,
    Polynomial,
    PolynomialCoupling,
    PrescribedMotion,
    Prismatic,
    Revolute,
    Scene,
)
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.couplings import couplings
from newton_euler.equations.relative import Relative
from newton_euler.equations.revolutions import revolutions
from newton_euler.errors import MechanismError
from newton_euler.model.initial_pose import described_at
from newton_euler.model.state import State
from newton_euler.runs.assemble import assemble, initial_state, measured_coordinate
from urdf import read as read_urdf
from urdf.dynamics import PinocchioSystem
from urdf.errors import LoopFileError
from urdf.loops import parse_loops

FORMULATIONS = ("relative", "cartesian")
CURVE = (0.0, 0.8, 0.0, 0.3)
"""z = 0.8 x^2 + 0.3 x^4, m."""
CART, BEAD = 0.5, 1.7
"""Masses, kg."""


def curve(x):
    """z, dz/dx and d2z/dx2 of the curve at x."""
    polynomial = np.polynomial.Polynomial((0.0, *CURVE))
    return polynomial(x), polynomial.deriv()(x), polynomial.deriv(2)(x)


def bead(coefficients=CURVE) -> Scene:
    """A bead on a curve: a cart along x, and on it the bead along z."""
    bodies = [Body.ground(), Body("cart", CART, ORIGIN, np.eye(3)), Body("bead", BEAD, ORIGIN, np.eye(3))]
    joints = [
        Prismatic("x", "ground", "cart", ORIGIN, axis=X),
        Prismatic("z", "cart", "bead", ORIGIN, axis=Z),
    ]
    mechanism = Mechanism(bodies, joints, [PolynomialCoupling("wire", "x", "z", coefficients)])
    return Scene("bead", mechanism, 2.0, 0.1, gravity=[0.0, 0.0, -9.81])


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_bead_on_a_curve_moves_as_lagrange_says(formulation):
    """(m_c + m + m z'^2) x'' + m z' z'' x'^2 + m g z' = 0, where primes of z are derivatives by x.

    The wire pushes the bead up with m (d2z/dt2 + g), and the rail with z' times that.
    """

    def rates(_, state):
        x, v = state
        _, slope, bend = curve(x)
        return [v, -BEAD * slope * (9.81 + bend * v**2) / (CART + BEAD + BEAD * slope**2)]

    scene = newton_euler.start(bead(), x=(0.4, 0.2))
    run = newton_euler.simulate(scene, formulation, rtol=1e-12, atol=1e-13)
    wanted = solve_ivp(rates, (0.0, 2.0), [0.4, 0.2], "DOP853", run.time, rtol=1e-13, atol=1e-13).y
    x, v = wanted
    z, slope, bend = curve(x)
    assert np.ptp(x) > 0.7  # it swings through the bottom, where the slope vanishes
    # both integrate to 1e-12
    assert np.max(np.abs(run.position[:, 1, 0] - x)) < 1e-10
    assert np.max(np.abs(run.position[:, 2, 2] - z)) < 1e-10
    assert np.max(np.abs(run.linear_velocity[:, 2, 2] - slope * v)) < 1e-9
    lift = BEAD * (slope * np.array([rates(0.0, each)[1] for each in wanted.T]) + bend * v**2 + 9.81)
    assert np.max(np.abs(run.reaction_force[:, 1, 2] - lift)) < 1e-8  # of up to 50 N
    push = (CART + BEAD) * np.array([rates(0.0, each)[1] for each in wanted.T])
    assert np.max(np.abs(run.reaction_force[:, 0, 0] - push)) < 1e-8
    assert np.max(np.abs(push + slope * lift)) < 1e-8
    energy = run.kinetic_energy + run.potential_energy
    assert np.ptp(energy) < 1e-9
    assert np.max(run.constraint_violation) < 1e-12


def hinged(*more, coefficients=(-1.5, 0.4, 0.0, 0.3)) -> Scene:
    """Two bars on hinges and a slide: the second angle follows the first, what is more follows these."""
    bodies = [Body.ground(), bar("a", [0, 0, 0], [0.3, 0, 0.1]), bar("b", [0, 0.5, 0], [0.2, 0.5, 0.1])]
    bodies.append(bar("c", [0, 1, 0], [0.2, 1, 0.3]))
    joints = [
        Revolute("ja", "ground", "a", [0, 0, 0], axis=Y),
        Revolute("jb", "ground", "b", [0, 0.5, 0], axis=Y),
        Prismatic("jc", "ground", "c", [0, 1, 0], axis=Z),
    ]
    found = [PolynomialCoupling("cam", "ja", "jb", coefficients), *more]
    return Scene("hinged", Mechanism(bodies, joints, found), 0.5, 0.1, gravity=GRAVITY)


IN_LOOPS = ("polynomials", "polynomial, follower cut", "polynomial, driver cut")
LIFT = PolynomialCoupling("lift", "jb", "jc", (0.1, 0.2, -0.05))


SCENES = {"slides": bead(), "hinges": hinged(), "chain": hinged(LIFT), **{k: JOINTS[k] for k in IN_LOOPS}}


def moving(scene: Scene) -> Scene:
    """The scene from a closed state of its own away from the initial pose, its first joint moving."""
    joint = scene.mechanism.joints[0]
    rest = [None] * (len(joint.coordinate_kinds) - 1)
    return newton_euler.start(scene, **{joint.name: [*rest, (0.12, 0.8)] if rest else (0.37, 0.8)})


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
@pytest.mark.parametrize("form", [Relative, Cartesian, RigidMuJoCo, PinocchioSystem])
def test_the_jacobian_is_the_derivative_of_the_residuals(form, scene):
    system = form(scene)
    q, v = system.coordinates(initial_state(moving(scene)))
    assert np.max(np.abs(system.coupling_phi(q))) < 1e-9  # a start is closed
    rate = derivative(lambda s: system.phi(system.retract(q, s * v)), 1e-3)
    # round-off and truncation of the difference
    assert np.allclose(system.phi_jacobian(q) @ v, rate, atol=1e-10)


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_all_engines_have_the_same_accelerations_and_reactions(scene):
    scene, found, reactions = moving(scene), [], []
    for form in (Relative, Cartesian, RigidMuJoCo, PinocchioSystem):
        system = form(scene)
        e = system.evaluate(*system.coordinates(initial_state(scene)))
        found.append(np.hstack([e.linear_acceleration, e.angular_acceleration]))
        reactions.append(np.hstack([e.reaction_force, e.reaction_torque]))
    for each, forces in zip(found, reactions, strict=True):
        assert np.allclose(each, found[0], rtol=1e-9, atol=1e-9)
        assert np.allclose(forces, reactions[0], rtol=1e-9, atol=1e-8)


@pytest.mark.parametrize("name", IN_LOOPS)
def test_engines_agree_on_curves_in_trees_and_loops(name):
    result = check(replace(JOINTS[name], duration=0.3))
    assert result.outcome == Outcome.AGREE


def test_a_start_off_the_curve_is_closed():
    """Next to the guess, on the curve, with rates along it."""
    scene = bead()
    off = replace(State.initial(scene.mechanism))
    off.position[1:, 0] = 0.5
    off.linear_velocity[1:, 0] = 1.0
    with pytest.raises(MechanismError, match="polynomial coupling 'wire'"):
        initial_state(replace(scene, initial_state=off))
    closed = assemble(scene, off)
    (x, v), (z, rate) = (measured_coordinate(scene, closed, (name, 0)) for name in "xz")
    assert z == pytest.approx(curve(x)[0], abs=1e-12)
    assert rate == pytest.approx(curve(x)[1] * v, abs=1e-12)
    assert abs(x - 0.5) < 0.3


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("turns", [-4, -1, 0, 2])
def test_revolutions_are_those_that_agree_with_the_curves(order, turns):
    """The driver in another revolution than its pose shows, and its followers, a slide among them."""
    scene = hinged(LIFT)
    found = [couplings(scene)[k] for k in order]
    a = 0.4 + 2.0 * np.pi * turns
    b = np.polynomial.Polynomial((0.0, -1.5, 0.4, 0.0, 0.3))(a)
    c = np.polynomial.Polynomial((0.0, 0.1, 0.2, -0.05))(b)
    seen = {("ja", 0): 0.4, ("jb", 0): float(np.arctan2(np.sin(b), np.cos(b))), ("jc", 0): float(c)}
    angles = revolutions(found, seen, {("ja", 0), ("jb", 0)}, 0.0, {})
    assert seen["ja", 0] + angles["ja", 0] == pytest.approx(a, abs=1e-9)
    assert seen["jb", 0] + angles["jb", 0] == pytest.approx(b, abs=1e-6)


def test_revolutions_of_what_agrees_with_no_curve_are_none():
    scene = hinged()
    found = revolutions(couplings(scene), {("ja", 0): 0.4, ("jb", 0): 2.0}, {("ja", 0), ("jb", 0)}, 0.0, {})
    assert found["ja", 0] == 0.0


def test_many_turns_are_followed():
    """A crank of constant speed: its follower is where the polynomial puts it after three revolutions."""
    scene = hinged(coefficients=(0.5, 0.03, -0.002))
    motion = PrescribedMotion("ja", Polynomial((0.0, 40.0)))
    scene = replace(scene, motions=(motion,), gravity=(0.0, 0.0, 0.0))
    a = 40.0 * scene.duration
    b = 0.5 * a + 0.03 * a**2 - 0.002 * a**3
    for formulation in FORMULATIONS:
        found = newton_euler.simulate(scene, formulation)
        turned = found.joint("jb").coordinates[-1, 0]
        assert np.sin(0.5 * (turned - b)) == pytest.approx(0.0, abs=1e-8)


def test_described_at_another_pose_it_is_the_same_motion():
    scene = newton_euler.start(bead(), x=(0.4, 0.2))
    state = initial_state(scene)
    other = described_at(replace(scene, initial_state=None), state)
    (moved,) = other.mechanism.couplings
    assert moved.coefficients == pytest.approx([curve(0.4)[1], curve(0.4)[2] / 2.0, 1.2 * 0.4, 0.3])
    first, second = (
        newton_euler.simulate(replace(each, initial_state=state), rtol=1e-12) for each in (scene, other)
    )
    assert np.max(np.abs(first.position - second.position)) < 1e-10


MODEL = """<mujoco><compiler angle="radian"/><worldbody>
<body name="a"><joint name="ja" axis="0 1 0" ref="0.3"/>
<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body>
<body name="b" pos="0 0.5 0"><joint name="jb" axis="0 1 0" ref="-0.1"/>
<inertial pos="0.1 0 0" mass="0.8" diaginertia="0.01 0.012 0.014"/></body>
<body name="c" pos="0 1 0"><joint name="jc" type="slide" axis="0 0.6 0.8"/>
<inertial pos="0.1 0 0" mass="0.8" diaginertia="0.01 0.012 0.014"/></body></worldbody>
<equality><joint joint1="jb" joint2="ja" polycoef="0.02 -1.5 0.4 0.1 0.3"/>
<joint joint1="jc" joint2="jb" polycoef="0.05 0 0.6 0 0"/></equality></mujoco>"""
"""Curves that are open at qpos0, with coordinates that do not start at 0."""


def test_equalities_of_an_mjcf_are_read_exactly(tmp_path):
    (tmp_path / "curves.xml").write_text(MODEL)
    found = read(tmp_path / "curves.xml", duration=0.3, output_period=0.1)
    assert {entry.fate for entry in found.report.entries if entry.element.startswith("equality")} == {
        "exactly"
    }
    # MuJoCo's own start: x counted from ref
    model = mujoco.MjModel.from_xml_string(MODEL)
    a, b, c = (found.start.data.qpos[k] - model.qpos0[k] for k in range(3))
    assert b == pytest.approx(0.02 - 1.5 * a + 0.4 * a**2 + 0.1 * a**3 + 0.3 * a**4, abs=1e-9)
    assert c == pytest.approx(0.05 + 0.6 * b**2, abs=1e-9)
    assert check(found.scene).outcome == Outcome.AGREE


def test_files_keep_a_curve(tmp_path):
    scene = hinged(LIFT)
    mjcf.write(scene, tmp_path / "again.xml")
    urdf.write(scene, tmp_path / "again.urdf")
    write_scene(scene, tmp_path / "again.yaml")
    others = [
        read(tmp_path / "again.xml").scene,
        read_urdf(tmp_path / "again.urdf", loops=tmp_path / "again.loops.yaml").scene,
        read_scene(tmp_path / "again.yaml"),
    ]
    assert [each.name for each in others[0].mechanism.couplings] == ["cam", "lift"]
    for other in others:
        for found, wanted in zip(other.mechanism.couplings, scene.mechanism.couplings, strict=True):
            assert isinstance(found, PolynomialCoupling)
            assert (found.driver, found.follower) == (wanted.driver, wanted.follower)
            assert found.coefficients == pytest.approx(wanted.coefficients, abs=1e-12)


def test_a_loop_file_with_polynomials_of_three_joints_is_left_out_and_listed(tmp_path):
    urdf.write(hinged(), tmp_path / "m.urdf")
    loops = tmp_path / "m.loops.yaml"
    text = yaml.safe_load(loops.read_text())
    text["coupled"] = [{"ja": [1.0, 0.5], "jb": 1.0, "jc": 1.0}]
    loops.write_text(yaml.safe_dump(text))
    found = read_urdf(tmp_path / "m.urdf", loops=loops)
    (entry,) = (each for each in found.report.entries if each.element.startswith("coupled"))
    assert entry.fate == "left out"
    assert not found.scene.mechanism.couplings


@pytest.mark.parametrize("factors", [[], [1.0] * 5, ["x"], [float("nan")]])
def test_factors_of_a_loop_file_are_checked(factors):
    text = yaml.safe_dump(
        {"closed_loop": [], "type": [], "name_mot": [], "coupled": [{"ja": factors, "jb": 1.0}]}
    )
    with pytest.raises(LoopFileError) as caught:
        parse_loops(text, "m.loops.yaml")
    assert caught.value.key == "coupled"


def test_models_are_compared_by_their_curves():
    def of(coefficients, sign=1.0):
        scene = bead(coefficients)
        x, z = scene.mechanism.joints
        mechanism = Mechanism(
            scene.mechanism.bodies, [replace(x, axis=sign * x.axis), z], scene.mechanism.couplings
        )
        return newton_euler.start(replace(scene, mechanism=mechanism), x=(0.3 * sign, 0.1 * sign))

    bent = (0.3, 0.8, 0.1, 0.3)
    assert crosscheck.diff(of(bent), of((-0.3, 0.8, -0.1, 0.3), -1.0)).same
    (row,) = crosscheck.diff(of(bent), of((0.3, 0.8, 0.1, 0.3001))).differences
    assert (row.element, row.quantity) == ("wire", "coupling")
    # the same curve of a model that is described at another pose of it
    there = of(bent)
    moved = described_at(replace(there, initial_state=None), initial_state(there))
    assert crosscheck.diff(there, replace(moved, initial_state=initial_state(there))).same


def test_coverage_and_faults_know_its_powers():
    scene = newton_euler.start(bead(), x=(0.4, 0.2))
    result = check(scene)
    tested = {each.element for each in result.crosscheck.coverage.elements if each.tested}
    assert "polynomial coupling 'wire'" in tested
    found = {fault.detail for fault in misreadings(scene) if fault.element == "wire"}
    assert "dropped" in found
    assert {detail.split()[1] for detail in found if detail.startswith("power")} == {"2", "4"}


def test_small_oscillations_know_how_the_curve_bends():
    """At the bottom w^2 = m g z'' / (m_c + m), the weight times the curvature: no spring acts."""
    (mode,) = newton_euler.linearize(bead()).modes().frequencies
    assert 2.0 * np.pi * mode == pytest.approx(np.sqrt(BEAD * 9.81 * 1.6 / (CART + BEAD)), rel=1e-9)


# 15 s to compile the derivatives in Cartesian form
@pytest.mark.parametrize("formulation", ["relative", pytest.param("cartesian", marks=pytest.mark.slow)])
def test_sensitivities_by_its_coefficients(formulation):
    scene = newton_euler.start(replace(bead(), duration=0.3), x=(0.4, 0.2))
    tight = {"rtol": 1e-12, "atol": 1e-13}
    found = newton_euler.sensitivities(scene, ["wire.coefficients"], formulation, **tight)

    def moved(s, k):
        values = np.array(CURVE)
        values[k] += s
        other = newton_euler.with_parameters(scene, {"wire.coefficients": values})
        return newton_euler.simulate(other, formulation, **tight).position

    for k in range(4):
        wanted = derivative(lambda s, k=k: moved(s, k))
        # runs to 1e-12 leave 1e-9 in differences by 1e-3
        assert np.allclose(found.position[..., k], wanted, atol=1e-8)


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"coefficients": ()}, "coefficients is ()"),
        ({"coefficients": (0.0, 0.0)}, "coefficients is (0.0, 0.0)"),
        ({"coefficients": (1.0,) * 5}, "coefficients is (1.0, 1.0, 1.0, 1.0, 1.0)"),
        ({"coefficients": (1.0, float("nan"))}, "coefficients is (1.0, nan)"),
        ({"coefficients": "12"}, "coefficients is '12'"),
        ({"driver": "b"}, "couples joint 'b' to itself"),
    ],
)
def test_its_numbers_are_checked(change, problem):
    given = {"name": "p", "driver": "a", "follower": "b", "coefficients": (1.0, 2.0)}
    with pytest.raises(MechanismError) as caught:
        PolynomialCoupling(**given | change)
    assert (caught.value.element, caught.value.problem) == ("polynomial coupling 'p'", problem)
