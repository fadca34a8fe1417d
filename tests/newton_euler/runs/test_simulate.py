"""The paper's simulation, run by newton_euler."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mjcf
import newton_euler
import urdf
from crosscheck.library import load
from newton_euler.errors import NewtonEulerError, OptionError
from newton_euler.model.euler_parameters import angle_between, rotation
from newton_euler.model.trajectory import load_arrays
from newton_euler.runs.assemble import initial_state

TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def test_formulations_agree_over_the_papers_five_seconds(tracker_run):
    a = tracker_run(**TIGHT)
    b = tracker_run(formulation="cartesian", **TIGHT)
    # the project's promise; at rtol 1e-11 either run is good to about 1e-10
    assert np.abs(a.position - b.position).max() < 1e-9
    assert angle_between(a.quaternion, b.quaternion).max() < 1e-9
    assert np.abs(a.reaction_force - b.reaction_force).max() < 1e-8
    assert np.abs(a.reaction_torque - b.reaction_torque).max() < 1e-8


def test_at_rest_the_panel_is_horizontal_with_a_yaw_of_45_degrees(tracker):
    """After 60 s the slowest mode, exp(-2 t), is gone."""
    run = newton_euler.simulate(replace(tracker, duration=60.0, output_period=10.0))
    assert run.position[-1, 1:3, 2] == pytest.approx([0.046, 0.046], abs=1e-9)
    normal = rotation(run.quaternion[-1, 6])[:, 2]
    assert np.hypot(normal[0], normal[1]) < 1e-6
    half = np.radians(45.0) / 2
    assert run.quaternion[-1, 6] == pytest.approx([np.cos(half), 0, 0, np.sin(half)], abs=1e-6)
    assert run.kinetic_energy[-1] < 1e-20


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_projection_keeps_drift_at_round_off_for_a_minute(tracker, formulation):
    scene = replace(tracker, duration=60.0, output_period=0.5)
    run = newton_euler.simulate(scene, formulation=formulation)
    assert run.constraint_violation.max() < 1e-13  # the project's promise
    assert np.abs(np.linalg.norm(run.quaternion, axis=2) - 1.0).max() < 1e-13


def test_drift_is_bounded_with_baumgarte_and_grows_without(tracker):
    """Fixed steps of 10 ms, where the drift is well above round-off."""
    scene = replace(tracker, duration=10.0, output_period=0.1)
    drift = {}
    for stabilization in ("baumgarte", "none"):
        run = newton_euler.simulate(scene, integrator="RK4", step=0.01, stabilization=stabilization)
        drift[stabilization] = run.constraint_violation.max(axis=1)
    late = run.time > 5.0
    assert drift["baumgarte"][late].max() < 0.01 * drift["baumgarte"].max()
    assert drift["baumgarte"].max() < 1e-6
    assert drift["none"][late].min() > 0.9 * drift["none"][~late].max()
    assert drift["none"][-1] > 10 * drift["baumgarte"][late].max()


def test_trajectory_has_the_promised_arrays(tracker_run, tmp_path):
    run = tracker_run(**TIGHT)
    n, b, j, a = 501, 7, 8, 2
    shapes = {
        "time": (n,),
        "body_names": (b,),
        "joint_names": (j,),
        "position": (n, b, 3),
        "quaternion": (n, b, 4),
        "linear_velocity": (n, b, 3),
        "angular_velocity": (n, b, 3),
        "reaction_force": (n, j, 3),
        "reaction_torque": (n, j, 3),
        "actuator_force": (n, a),
        "constraint_violation": (n, j),
        "kinetic_energy": (n,),
        "potential_energy": (n,),
        "work": (n,),
    }
    run.save(tmp_path / "run.npz")
    arrays = load_arrays(tmp_path / "run.npz")
    assert {name: value.shape for name, value in arrays.items()} == shapes
    assert np.array_equal(arrays["position"], run.position)
    assert list(arrays["body_names"]) == list(run.body_names)
    assert [path.name for path in tmp_path.iterdir()] == ["run.npz"]


def test_outputs_that_are_not_asked_for_are_absent(tracker):
    scene = replace(tracker, duration=0.05, outputs=frozenset({"energy"}))
    run = newton_euler.simulate(scene)
    assert set(run.arrays()) == {
        "time",
        "body_names",
        "joint_names",
        "position",
        "quaternion",
        "kinetic_energy",
        "potential_energy",
        "work",
    }


@pytest.mark.parametrize("integrator", ["DOP853", "Radau"])
@pytest.mark.parametrize("name", ["tracker", "four_bar"])  # the second passes where its rank drops
def test_poses_do_not_depend_on_what_else_is_asked_for(name, integrator):
    """Whoever asks for poses alone gets outputs whose velocities are left open."""
    scene = replace(load(name), duration=1.0, outputs=frozenset({"velocities"}))
    whole = newton_euler.simulate(scene, integrator=integrator, rtol=1e-8)
    poses = newton_euler.simulate(replace(scene, outputs=frozenset()), integrator=integrator, rtol=1e-8)
    # the same steps and the same positions; one more Newton step or none leaves round-off
    assert poses.settings["steps"] == whole.settings["steps"]
    assert np.abs(poses.position - whole.position).max() < 1e-13
    assert angle_between(poses.quaternion, whole.quaternion).max() < 1e-13


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04broken"])
def test_a_broken_trajectory_file_is_named(tmp_path, content):
    path = tmp_path / "bad.npz"
    path.write_bytes(content)
    with pytest.raises(NewtonEulerError, match=r"bad\.npz"):
        load_arrays(path)


@pytest.mark.parametrize("integrator", ["RK4", "Euler"])
@pytest.mark.parametrize(
    "run",
    [
        newton_euler.simulate,
        urdf.simulate,
        lambda scene, **control: newton_euler.simulate_batch(scene, [initial_state(scene)], **control),
    ],
)
def test_steps_too_small_to_end_are_refused(run, integrator):
    """Before the first of them; a number of steps that is given allows them."""
    scene = replace(load("pendulum"), duration=1e-3, output_period=1e-3)
    with pytest.raises(OptionError, match=r"step is 1e-12; needed: at least 5e-11 s, 20000000 steps"):
        run(scene, integrator=integrator, step=1e-12)
    with pytest.raises(OptionError, match=r"step is 1e-05; needed: at least 0.001 s, 1 steps; most_steps"):
        run(scene, integrator=integrator, step=1e-5, most_steps=1)
    run(scene, integrator=integrator, step=1e-5, most_steps=100)


def test_mujoco_steps_too_small_to_end_are_refused():
    scene = replace(load("pendulum"), duration=1e-3, output_period=1e-3)
    with pytest.raises(OptionError, match=r"timestep is 1e-12; needed: at least 5e-11 s, 20000000 steps"):
        mjcf.simulate(scene, timestep=1e-12)


def test_a_run_without_sampled_controllers_makes_none(monkeypatch):
    monkeypatch.setattr("newton_euler.runs.intervals.Controllers", None)
    assert newton_euler.simulate(replace(load("pendulum"), duration=0.1)).time[-1] == 0.1
