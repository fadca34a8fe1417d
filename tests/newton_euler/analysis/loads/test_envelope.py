"""Loads of joints and actuators: equilibrium with weight and wind, other engines, and ranges over cases."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import mass_on_rail, pendulum

import newton_euler
import urdf
from crosscheck.library import SCENES, load
from mjcf.rigid import RigidMuJoCo
from newton_euler import (
    PD,
    Compound,
    Mechanism,
    Polynomial,
    Sine,
    Spline,
    Steps,
    Sum,
    WindLoad,
    load_envelope,
    rest_case,
    statics,
)
from newton_euler.analysis.loads.envelope import Load, joint_loads
from newton_euler.analysis.loads.rest import wind_at_peak
from newton_euler.equations.system import at_time
from newton_euler.equations.undetermined import determined, undetermined
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.reading.wrenches import Wrenches
from urdf.dynamics import PinocchioSystem

TURNED = np.array([[0.5, 0.5, 0.5, 0.5], [1.0, 0.0, 0.0, 0.0], [0.0, 0.6, 0.8, 0.0]])


def on_the_ground(scene, state, held):
    """Sums of the force, and of the moment about the world's origin, that the ground exerts."""
    mechanism, force, moment = scene.mechanism, np.zeros(3), np.zeros(3)
    pushes = list(zip(mechanism.joints, held.reaction_force, held.reaction_torque, strict=True))
    for name, u in zip(held.actuators, held.actuator_force, strict=True):
        joint = mechanism.joint(name)
        pushes.append((joint, u * joint.axis, np.zeros(3)))  # slides of the ground along z, which stays
    for joint, push, torque in pushes:
        if joint.first == mechanism.body_names[0]:
            body = mechanism.body_index(joint.second)
            arm = mechanism.bodies[body].pose.point_to_body(joint.point_on_second)
            point = state.position[body] + rotation(state.quaternion[body]) @ arm
            force += push
            moment += torque + np.cross(point, push)
    return force, moment


def test_static_reactions_of_the_ground_are_weight_and_wind():
    """At poses all over the workspace; the wind by its own writing. 1e-10 of the weight of 14.5 N."""
    scene = load("tracker_wind", wind="steady", speed=15, wind_from=70)
    for state in random_states(scene, 6):
        still = State.initial(scene.mechanism)
        still = replace(still, position=state.position, quaternion=state.quaternion)
        acting = Wrenches(scene.mechanism, still)
        acting.add_forces(replace(scene, control=()))
        wind, torque = np.split(acting.total[6], 2)
        assert np.linalg.norm(wind) > 0.1
        forces = np.outer([body.mass for body in scene.mechanism.bodies], scene.gravity)
        forces[0] = 0.0  # the ground's own weight
        forces[6] += wind
        force, moment = on_the_ground(scene, still, statics(scene, still))
        assert force == pytest.approx(-forces.sum(axis=0), abs=1e-10)
        moments = np.cross(still.position, forces).sum(axis=0) + torque
        assert moment == pytest.approx(-moments, abs=1e-10)


def states_of(run, rows):
    """Times, s, and states at some outputs; the last a little before, when functions jump at the end."""
    for k in rows.tolist():
        yield min(run.time[k], run.time[-1] * (1.0 - 1e-11)), run.state(k)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SCENES if name != "free_top"])  # it has no reactions
def test_reactions_of_three_engines_are_the_same_along_whole_runs(name):
    """At 51 states from the start of newton_euler's run to its end, by each engine's own equations.

    Of the largest force they differ by 5e-12 at most, in the four-bar and the governor, by less than 5e-14 in
    all trackers. What redundant constraints leave open is left out.
    """
    scene = load(name)
    run, size = newton_euler.simulate(scene), scene.mechanism.size
    rows = np.unique(np.linspace(0, len(run.time) - 1, 51).astype(int))
    free = [undetermined(scene, state) for _, state in states_of(run, rows)]
    largest = np.abs(run.reaction_force).max()
    for engine in (PinocchioSystem(scene), RigidMuJoCo(scene)):
        at_times = [(at_time(engine, float(time)), state) for time, state in states_of(run, rows)]
        found = [now.evaluate(*now.coordinates(state)) for now, state in at_times]
        force = [each.reaction_force for each in found] - run.reaction_force[rows]
        torque = [each.reaction_torque for each in found] - run.reaction_torque[rows]
        force, torque = determined(force, torque, free, size)
        assert np.abs(force).max() < 1e-10 * largest
        assert np.abs(torque).max() < 1e-10 * largest * size


@pytest.mark.slow  # Pinocchio's equations are called from Python: some seconds a run
@pytest.mark.parametrize("name", ["tracker", "tracker_gravity", "tracker_wind", "tracker_on_boat", "stewart"])
def test_reactions_of_whole_runs_of_two_engines(name):
    """1e-8 of the largest at rtol 1e-12, where each engine integrates by itself; MuJoCo's loops are soft."""
    run, other = (
        simulate(load(name), rtol=1e-12, atol=1e-14) for simulate in (newton_euler.simulate, urdf.simulate)
    )
    for array in ("reaction_force", "reaction_torque"):
        own = getattr(run, array)
        assert np.abs(getattr(other, array) - own).max() < 1e-8 * np.abs(own).max()


def test_axes_of_joints_turn_with_their_first_bodies():
    scene = load("slider_crank")
    run = replace(newton_euler.simulate(replace(scene, duration=0.2, output_period=0.1)))
    turns = np.repeat(TURNED[:, None], len(run.body_names), axis=1)
    run = replace(run, quaternion=turns)
    found = joint_loads(scene, run)
    joint = next(joint for joint in scene.mechanism.joints if joint.kind == "prismatic")
    k = scene.mechanism.joint_index(joint.name)
    first = scene.mechanism.body(joint.first)
    for row, p in enumerate(TURNED):
        axis = rotation(p) @ first.pose.vector_to_body(joint.axis)
        force, torque = run.reaction_force[row, k], run.reaction_torque[row, k]
        parts = {
            "axial force": axis @ force,
            "shear force": np.linalg.norm(force - axis @ force * axis),
            "axial torque": axis @ torque,
            "bending torque": np.linalg.norm(torque - axis @ torque * axis),
        }
        for quantity, value in parts.items():
            unit = "N" if "force" in quantity else "N m"
            assert found[Load(joint.name, quantity, unit)][row] == pytest.approx(value, abs=1e-12)
        across = [found[Load(joint.name, f"force {axis}", "N")][row] for axis in "uw"]
        assert np.hypot(*across) == pytest.approx(parts["shear force"], abs=1e-12)
    assert all(load.quantity != "axial force" for load in found if load.element == "universal")


@pytest.mark.parametrize(("angle", "resolved"), [(1e-14, True), (1e-6, False)])
def test_axes_that_are_parallel_to_round_off_resolve_loads(angle, resolved):
    scene = mass_on_rail(duration=0.1)
    up, about = np.array([0.0, 0.0, 1.0]), np.array([np.sin(angle), 0.0, np.cos(angle)])
    joint = Compound("rail", "ground", "mass", [0.0, 0.0, 0.0], slides=[up], hinges=[about])
    scene = replace(scene, mechanism=Mechanism(scene.mechanism.bodies, [joint]))
    loads = {load.quantity for load in joint_loads(scene, newton_euler.simulate(scene))}
    assert ("axial force" in loads) is resolved


def swinging(amplitude: float, frequency: float = 2.0):
    """A mass whose position and forces are those of a sine."""
    scene = mass_on_rail(control=(PD("rail", 0.0, 0.0, 0.0),), duration=1.0)
    run = newton_euler.simulate(replace(scene, output_period=0.001))
    w, t = 2.0 * np.pi * frequency, run.time
    z = np.outer(np.sin(w * t), [0.0, 0.0, 1.0])
    moved, rates = run.position.copy(), run.linear_velocity.copy()
    moved[:, 1], rates[:, 1] = amplitude * z, amplitude * w * np.outer(np.cos(w * t), [0.0, 0.0, 1.0])
    force = np.full((len(t), 1, 3), [3.0, 0.0, 0.0]) + 5.0 * amplitude * z[:, None]
    arrays = {"position": moved, "linear_velocity": rates, "reaction_force": force}
    return scene, replace(run, **arrays, actuator_force=np.cos(w * t)[:, None])


def test_ranges_of_sines():
    """Peaks, root mean squares, power and energy of F = cos wt at v = A w cos wt; 1 ms of 0.5 s."""
    scene, weak = swinging(0.1)
    _, strong = swinging(0.2)
    envelope = load_envelope(scene, {"weak": weak, "strong": strong})
    axial = envelope.of("rail", "axial force")
    assert axial.maximum == pytest.approx(1.0, abs=1e-4)
    assert (axial.maximum_time, axial.maximum_case) == (0.125, "strong")
    assert (axial.minimum, axial.minimum_time) == (pytest.approx(-1.0, abs=1e-4), 0.375)
    assert (axial.rms, axial.rms_case) == (pytest.approx(np.sqrt(0.5), abs=1e-6), "strong")
    assert envelope.of("rail", "shear force").minimum == 3.0
    total = envelope.of("rail", "force")
    assert (total.peak, total.governing[0]) == (pytest.approx(np.sqrt(10.0), abs=1e-4), "strong")
    peak = 0.2 * 4.0 * np.pi
    assert envelope.of("rail", "speed").peak == pytest.approx(peak)
    assert envelope.of("rail", "power").rms == pytest.approx(peak * np.sqrt(3.0 / 8.0), rel=1e-6)
    angle = 4.0 * np.pi * 0.001  # of an output: the trapezoidal rule has sin(angle) / angle of the integral
    assert envelope.of("rail", "work").maximum == pytest.approx(0.5 * peak * np.sin(angle) / angle, rel=1e-6)
    assert envelope.of("rail", "energy").maximum_time == 1.0


def test_brakes_do_not_give_energy_back():
    scene, run = swinging(0.1)
    run = replace(run, actuator_force=np.sin(4.0 * np.pi * run.time)[:, None])
    envelope = load_envelope(scene, run)
    assert envelope.cases == ("run",)
    # 0.1 w sin wt cos wt: 0.05 J to and fro in each of four quarters of two periods, by steps of 1 ms
    assert envelope.of("rail", "work").maximum == pytest.approx(0.05, rel=1e-4)
    assert envelope.of("rail", "energy").maximum == pytest.approx(0.2, rel=1e-4)


def test_at_rest_all_is_at_time_zero():
    scene = load("tracker_gravity")
    envelope = load_envelope(scene, {"weight": rest_case(scene)})
    held = statics(scene)
    assert envelope.of("slide_12", "actuator force").rms == pytest.approx(held.actuator_force[0])
    assert envelope.of("hinge_14", "force z").maximum == held.reaction_force[2, 2]
    assert {each.maximum_time for each in envelope.joints} == {0.0}


def test_the_csv_has_all_ranges():
    scene = pendulum()
    envelope = load_envelope(scene, newton_euler.simulate(scene))
    rows = list(csv.DictReader(envelope.to_csv().splitlines()))
    assert len(rows) == len(envelope.joints) == 16
    found = next(row for row in rows if row["quantity"] == "bending torque")
    assert (found["element"], found["unit"]) == ("pivot", "N m")
    assert float(found["maximum"]) == envelope.of("pivot", "bending torque").maximum


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda run: {}, "load envelope: has no cases; needed: one run or more"),
        (lambda run: {"a": replace(run, reaction_force=None)}, "case 'a': has no reaction_force"),
        (lambda run: {"a": replace(run, joint_names=("axle",))}, "case 'a': has other bodies or joints"),
    ],
)
def test_runs_that_tell_no_loads(change, message):
    scene = pendulum()
    with pytest.raises(MechanismError, match=message):
        load_envelope(scene, change(newton_euler.simulate(scene)))


def test_unknown_loads_are_named():
    scene = pendulum()
    envelope = load_envelope(scene, newton_euler.simulate(scene))
    with pytest.raises(UnknownNameError, match="unknown joint or actuator 'pivoo'; did you mean 'pivot'"):
        envelope.of("pivoo", "force")
    with pytest.raises(UnknownNameError, match="unknown load 'shear'"):
        envelope.of("pivot", "shear")


@pytest.mark.parametrize(
    ("speed", "held", "mean"),
    [
        (Steps([0.0, 0.3, 0.4], [3.0, -12.0, 4.0]), -12.0, 0.3 * 3.0 - 0.1 * 12.0 + 0.6 * 4.0),
        (Spline([0.0, 0.5, 1.0], [0.0, 9.0, 0.0]), 9.0, 6.0),  # the parabola 36 t (1 - t)
        (Sum((Polynomial((5.0,)), Sine(2.0, 40.0 * np.pi))), 7.0, 5.0),
    ],
)
def test_wind_at_rest_is_the_largest_of_the_run(speed, held, mean):
    """Largest in magnitude, within 0.4 % of the amplitude of the fastest sine."""
    x, y, z = np.eye(3)
    wind = WindLoad("wind", "mass", np.zeros(3), first_side=x, second_side=y, direction=z, speed=speed)
    scene = replace(mass_on_rail(), duration=1.0, forces=(wind,))
    constant, (found,) = wind_at_peak(scene)
    assert constant.forces[0].speed == found.speed == pytest.approx(held, rel=2e-3)
    assert speed.value(found.time) == pytest.approx(held, rel=2e-3)
    assert found.mean == pytest.approx(mean, abs=0.02)
    assert wind_at_peak(constant) == (constant, [])
    upward = replace(wind, speed=3.0, vertical_speed=speed)
    constant, (found,) = wind_at_peak(replace(scene, forces=(upward,)))
    assert (found.component, constant.forces[0].speed) == ("vertical_speed", 3.0)
    assert constant.forces[0].vertical_speed == pytest.approx(held, rel=2e-3)


def test_power_of_a_prescribed_drive_is_the_rate_of_energy():
    """A crank at constant speed: the drive's work is the energy that the run gains.

    Work by the trapezoidal rule over 0.05 s has an error of about 1e-5 of the largest energy.
    """
    scene = replace(load("examples/planar_slider_crank.yaml"), duration=0.05, output_period=5e-5)
    run = newton_euler.simulate(scene)
    envelope = load_envelope(scene, run)
    work = newton_euler.analysis.loads.envelope.actuator_loads(scene, run)[Load("motor", "work", "J")]
    energy = run.kinetic_energy + run.potential_energy
    assert work == pytest.approx(energy - energy[0], abs=1e-4 * np.ptp(energy))
    assert envelope.of("motor", "speed").minimum == pytest.approx(30.0, rel=1e-9)
    torque, axial = (envelope.of("motor", quantity) for quantity in ("actuator force", "axial torque"))
    assert (torque.peak, torque.unit) == (axial.peak, "N m")


def test_a_prescribed_slide_is_an_actuator_with_a_force():
    """A mass m that moves by a sin(w t), with no other force along the rail, needs -m a w^2 sin(w t)."""
    scene = mass_on_rail(duration=0.5, motions=(newton_euler.PrescribedMotion("rail", Sine(0.1, 20.0)),))
    run = newton_euler.simulate(scene)
    force = load_envelope(scene, run).of("rail", "actuator force")
    expected = -scene.mechanism.bodies[1].mass * 0.1 * 20.0**2 * np.sin(20.0 * run.time)
    assert force.unit == "N"
    assert (force.minimum, force.maximum) == pytest.approx((expected.min(), expected.max()), rel=1e-9)
