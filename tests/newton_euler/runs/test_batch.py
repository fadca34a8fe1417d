"""Many runs at once: the same as one by one, whatever the number of threads."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import line_spring, mass_on_rail

import newton_euler
from crosscheck.library import load
from newton_euler import simulate, simulate_batch, with_parameters
from newton_euler.equations.parameters import parameter_values
from newton_euler.errors import MechanismError, OptionError, UnknownNameError
from newton_euler.model.armatures import Armature
from newton_euler.model.control import PD, ComputedTorque
from newton_euler.model.digital_control import Digital, Sampled
from newton_euler.model.motions import Sum
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.batch import thread_count


@pytest.fixture(scope="module")
def short(tracker):
    return replace(tracker, duration=0.5, output_period=0.1)


def same(a, b) -> bool:
    """Compare two trajectories to the last bit."""
    return all(np.array_equal(x, b.arrays()[name]) for name, x in a.arrays().items())


def test_runs_are_those_one_by_one(short, tracker_states):
    """To the last bit: the same native code from the same numbers."""
    batch = simulate_batch(short, tracker_states[:3])
    assert len(batch) == 3
    for run, state in zip(batch[:2], tracker_states, strict=False):  # a scene of its own is compiled for each
        assert same(run, newton_euler.simulate(replace(short, initial_state=state)))
    assert batch[-1].settings["steps"] > 0


def test_a_run_from_the_scenes_own_state_is_the_scenes_own_run(short):
    """To the last bit, too."""
    batch = simulate_batch(short, parameters={"gravity": [short.gravity, short.gravity]}, threads=2)
    compiled = newton_euler.compile_scene(short, parameters=["gravity"])
    assert same(batch[0], batch[1])
    assert same(batch[1], compiled.simulate())


def test_stacked_arrays_are_those_of_the_runs(short, tracker_states):
    batch = simulate_batch(short, tracker_states[:3], threads=1)
    assert batch.stacked("position").base is not None  # a view: nothing is copied
    for k, run in enumerate(batch):
        assert np.array_equal(batch.stacked("position")[k], run.position)
        assert np.array_equal(np.abs(batch.stacked("quaternion")[k]), np.abs(run.quaternion))
    with pytest.raises(UnknownNameError, match="unknown array 'speed'"):
        batch.stacked("speed")


def test_a_state_that_is_open_ends_its_run_alone(short, tracker_states):
    moved = tracker_states[1].position.copy()
    moved[6] += 1e-6
    bad = replace(tracker_states[1], position=moved)
    batch = simulate_batch(short, [tracker_states[0], tracker_states[1], bad])
    assert list(batch.errors) == [2]
    with pytest.raises(MechanismError, match=r"run 2: joint '.*': is open by"):
        batch[2]


def test_settings_are_those_of_a_run_alone():
    scene = replace(load("pendulum"), duration=0.1)
    (run,) = simulate_batch(scene, [initial_state(scene)], None, 1, stabilization="baumgarte", alpha=3.0)
    alone = simulate(scene, stabilization="baumgarte", alpha=3.0)
    for time in ("trace_time", "compile_time"):  # of code, which all runs share
        del alone.settings[time]
    assert run.settings == alone.settings | {"threads": 1}


def test_threads_change_nothing(short, tracker_states):
    one, three = (simulate_batch(short, tracker_states[:10], threads=n) for n in (1, 3))
    assert all(same(a, b) for a, b in zip(one, three, strict=True))


# 5 s to compile the tracker in Cartesian form; test_varied_geometry.py has smaller scenes
@pytest.mark.parametrize("formulation", ["relative", pytest.param("cartesian", marks=pytest.mark.slow)])
def test_parameters_are_those_of_a_scene_made_with_them(short, formulation):
    inertia = 1.5 * short.mechanism.bodies[6].inertia
    values = {"panel_7.mass": 30.0, "panel_7.inertia": inertia, "gravity": [0.0, 0.5, -9.0]}
    values |= {"slide_12.stiffness": 70.0, "slide_13.damping": 40.0, "slide_13.target": 0.01}
    batch = simulate_batch(short, parameters={k: [v] for k, v in values.items()}, formulation=formulation)
    bodies = list(short.mechanism.bodies)
    bodies[6] = replace(bodies[6], mass=30.0, inertia=inertia)
    law_12, law_13 = short.control
    control = (replace(law_12, stiffness=70.0), replace(law_13, damping=40.0, target=0.01))
    mechanism = newton_euler.Mechanism(bodies, short.mechanism.joints)
    other = replace(
        short, mechanism=mechanism, gravity=values["gravity"], control=control, initial_state=None
    )
    expected = newton_euler.simulate(other, formulation)
    # other constants are folded, so rounding differs; it grows a hundredfold in half a second
    assert np.abs(batch[0].position - expected.position).max() < 1e-11
    force = np.abs(expected.reaction_force).max()
    # the tolerance of both runs; their steps are not the same to the last digit
    assert np.abs(batch[0].reaction_force - expected.reaction_force).max() < 1e-10 * force


def test_a_run_that_fails_does_not_end_the_others(short):
    batch = simulate_batch(short, parameters={"slide_12.damping": [50.0, -1e6, 60.0]})
    assert list(batch.errors) == [1]
    with pytest.raises(IntegrationError, match="stopped at t = "):
        batch[1]
    assert np.all(np.isfinite(batch[2].position))
    assert np.all(np.isnan(batch.stacked("position")[1]))


def test_every_parameter_has_the_scenes_own_value(short):
    values = parameter_values(short)
    assert values["panel_7.mass"] == short.mechanism.bodies[6].mass
    assert values["slide_13.target"] == short.control[1].target
    run = simulate_batch(short, parameters={name: [value] for name, value in values.items()})[0]
    assert np.abs(run.position - newton_euler.simulate(short).position).max() < 1e-11  # as above


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({}, OptionError, "one state or value per run"),
        ({"states": [{"slide_12": 0.1}]}, OptionError, "coordinates are parameters: {'start.JOINT': "),
        ({"states": np.zeros((2, 3))}, OptionError, "needed: State objects, one per run; "),
        ({"states": []}, OptionError, "states is []; needed: one value per run, of one run or more"),
        ({"parameters": {"gravity": [[0, 0, 1]], "panel_7.mass": [1.0, 2.0]}}, OptionError, "of one length"),
        ({"parameters": {"panel_7.color": [1.0]}}, UnknownNameError, "unknown parameter 'panel_7.color'"),
        ({"parameters": {"panel_7.mass": [[1.0, 2.0]]}}, MechanismError, "has values of shape (2,)"),
        ({"parameters": {"gravity": [[0.0, 0.0, 0.0]]}, "threads": 0}, OptionError, "threads is 0"),
        ({"parameters": {"panel_7.mass": np.array(3.0)}}, OptionError, "is array(3.); needed: a list"),
        ({"parameters": {"panel_7.mass": "12"}}, OptionError, "parameters['panel_7.mass'] is '12'"),
        ({"parameters": {"panel_7.mass": {1.0, 2.0}}}, OptionError, "needed: a list of numbers"),
        ({"parameters": {"panel_7.mass": np}}, OptionError, "parameters['panel_7.mass'] is <module"),
        ({"parameters": {"panel_7.mass": range(10**12)}}, OptionError, " MB per run, or crosscheck.sweep"),
        (
            {"parameters": {"start.slide_13": [0.0], "start.slide_13.0": [0.1]}},
            MechanismError,
            "'start.slide_13' and 'start.slide_13.0' are one number of the start",
        ),
    ],
)
def test_bad_batches_are_refused(short, options, error, message):
    with pytest.raises(error) as caught:
        simulate_batch(short, **options)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "law",
    [Sampled("rail", lambda t, x, v: -x[0], 0.02), Digital(ComputedTorque("rail", 1.0, 1.0, 0.0), 0.02)],
)
def test_some_controllers_are_refused_by_the_name_of_their_joint(law):
    with pytest.raises(MechanismError) as caught:
        simulate_batch(mass_on_rail(control=(law,)), parameters={"mass.mass": [1.0]})
    needed = "its law without sampling, or `simulate` run by run"
    problem = "has a controller that calls Python, or knows the mechanism, at its instants"
    assert str(caught.value) == f"joint 'rail': {problem}; needed: {needed}"


def test_digital_laws_vary_with_all_else():
    """As in runs of scenes with these values; a period that cannot be is an error of its run."""
    law = Digital(PD("rail", 40.0, 3.0, 0.2), 0.02, delay=1)
    scene = mass_on_rail(duration=1.0, control=(law,))
    values = {
        "mass.mass": [1.0, 2.0, 1.0],
        "rail.stiffness": [40.0, 60.0, 40.0],
        "rail.period": [0.01, 0.03, -1.0],
        "rail.resolution": [1e-3, 0.0, 0.0],
    }
    batch = simulate_batch(scene, parameters=values)
    assert list(batch.errors) == [2]
    for k in range(2):
        alone = simulate(with_parameters(scene, {name: value[k] for name, value in values.items()}))
        # round-off of masses that are inputs of the code or constants there
        assert np.abs(batch[k].position - alone.position).max() < 1e-13
    assert np.abs(batch[0].position - batch[1].position).max() > 0.01


@pytest.mark.parametrize("name", ["gravity.z", "ball.point_on_first.z"])
def test_joint_coordinates_of_all_runs_are_those_of_each(name):
    """Also where each run measures them by geometry of its own; a run that cannot begin has none."""
    scene = replace(load("slider_crank"), duration=1.0, output_period=0.1)
    batch = simulate_batch(scene, parameters={name: [0.0, 1e-3, 9.0], "rod.mass": [0.5, 0.6, -1.0]})
    for joint in scene.mechanism.joint_names:
        together = batch.joint(joint)
        assert np.isnan(together.coordinates[2]).all()
        for run in range(2):
            alone = batch[run].joint(joint)
            assert together.names == alone.names
            assert np.array_equal(together.coordinates[run], alone.coordinates)
            assert np.array_equal(together.rates[run], alone.rates)


@pytest.mark.slow
def test_the_mechanism_of_a_run_is_its_own(short):
    """Of a run of a batch and of one with its derivatives, varied by geometry or by masses alone."""
    inertia = 1.5 * short.mechanism.body("panel_7").inertia
    for values in (
        {"panel_7.mass": 5.0, "panel_7.inertia": inertia},
        {"panel_7.mass": 5.0, "panel_7.center_of_mass": [0.1, 0.2, 0.3]},
    ):
        batch = simulate_batch(short, parameters={name: [value] for name, value in values.items()})
        for run in (batch[0], newton_euler.sensitivities(short, values).run):
            for name, value in values.items():
                assert np.array_equal(getattr(run.mechanism.body("panel_7"), name.split(".")[1]), value)


def test_there_are_as_many_threads_as_processors_for_this_process(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 2, 5}, raising=False)
    assert thread_count() == 3
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: 7)
    assert thread_count() == 7


def test_functions_of_time_and_rotors_have_parameters():
    """All that a function is linear in; numbers tell elements of one name apart."""
    push = Sum((Sine(1.0, 7.0, offset=0.5), Polynomial((0.2, -1.0))))
    law = PD("rail", 5.0, 0.1, 0.0, feedforward=push)
    spring = replace(line_spring(rest_length=2.0), name="rail")
    scene = mass_on_rail(spring, duration=0.5, control=(law,), armatures=(Armature("rail", 0.3),))
    assert parameter_values(scene, ["rail.feedforward"])["rail.feedforward"].tolist() == [1.0, 0.5, 0.2, -1.0]
    values = {
        "rail.feedforward": [2.0, 0.25, 0.4, -3.0],
        "rail.rotor.inertia": 0.6,
        "forces[0].stiffness": 70.0,
    }
    batch = simulate_batch(scene, parameters={name: [value] for name, value in values.items()})
    other = Sum((Sine(2.0, 7.0, offset=0.25), Polynomial((0.4, -3.0))))
    expected = newton_euler.simulate(
        replace(
            scene,
            control=(replace(law, feedforward=other),),
            forces=(replace(spring, stiffness=70.0),),
            armatures=(Armature("rail", 0.6),),
        )
    )
    # both are integrated to 1e-10, their code is not the same
    assert np.abs(batch[0].position - expected.position).max() < 1e-9
