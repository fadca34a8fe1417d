"""Runs by MuJoCo against this package's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import mjcf
import newton_euler
from crosscheck.library.tracker import tracker as make_tracker
from mjcf.errors import DivergenceError
from mjcf.soft import simpson
from newton_euler.errors import OptionError, UnknownNameError
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state

Runs = Callable[..., Trajectory]


@pytest.fixture(scope="module")
def mujoco_run(tracker: Scene) -> Runs:
    """Runs of the tracker by MuJoCo, each time step and integrator run once."""
    done: dict[tuple[float, str], Trajectory] = {}

    def run(timestep: float, integrator: str = "RK4") -> Trajectory:
        key = (timestep, integrator)
        if key not in done:
            done[key] = mjcf.simulate(tracker, timestep=timestep, integrator=integrator)
        return done[key]

    return run


@pytest.fixture(scope="module")
def short_tracker() -> Scene:
    """The tracker for 0.1 s."""
    return replace(make_tracker(), duration=0.1)


def position_error(found: Trajectory, wanted: Trajectory) -> float:
    return float(np.max(np.linalg.norm(found.position - wanted.position, axis=2)))


def angle_error(found: Trajectory, wanted: Trajectory) -> float:
    return float(np.max(angle_between(found.quaternion, wanted.quaternion)))


def test_rk4_at_one_millisecond(mujoco_run: Runs, tracker_run: Runs) -> None:
    found, wanted = mujoco_run(1e-3), tracker_run()
    # the reference is good to 1e-9; loops that are springs of two steps leave 7e-9 m and 7e-8 rad
    assert position_error(found, wanted) < 1e-6
    assert angle_error(found, wanted) < 1e-6
    # of energies up to 10 mJ
    assert np.max(np.abs(found.kinetic_energy - wanted.kinetic_energy)) < 1e-5 * np.max(wanted.kinetic_energy)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("integrator", "low", "high"),
    [
        # RK4 is limited by the springs, whose time constant of two steps shrinks with the step:
        # dt^2 drift. Semi-implicit Euler has order 1.
        ("RK4", 1.8, 2.2),
        ("Euler", 0.9, 1.1),
    ],
)
def test_order_in_the_step(
    mujoco_run: Runs, tracker_run: Runs, integrator: str, low: float, high: float
) -> None:
    coarse, fine = (angle_error(mujoco_run(h, integrator), tracker_run()) for h in (2e-3, 5e-4))
    assert low < np.log(coarse / fine) / np.log(4.0) < high


def test_drift_falls_with_the_square_of_the_step(mujoco_run: Runs) -> None:
    coarse, fine = (np.max(mujoco_run(h).constraint_violation) for h in (2e-3, 5e-4))
    assert coarse / fine == pytest.approx(16.0, rel=0.15)


def test_what_a_run_records(tracker: Scene, mujoco_run: Runs) -> None:
    run = mujoco_run(1e-3)
    assert run.engine == "mujoco"
    assert run.settings == {
        "timestep": 1e-3,
        "integrator": "RK4",
        "solref": [2e-3, 1.0],
        "solimp": [0.9999, 0.9999, 0.001, 0.5, 2.0],
        "solver": "Newton",
        "iterations": 100,
        "tolerance": 1e-15,
        "backend": "C",
        "steps": 5000,
    }
    assert run.wall_time > 0.0
    assert np.array_equal(run.time, tracker.times)
    count, bodies, joints = len(run.time), len(run.body_names), len(run.joint_names)
    assert run.position.shape == (count, bodies, 3)
    assert run.reaction_torque is not None
    assert run.reaction_torque.shape == (count, joints, 3)
    assert np.max(np.abs(run.position[0] - initial_state(tracker).position)) < 1e-15
    assert np.all(run.position[:, 0] == initial_state(tracker).position[0])
    assert np.min(np.sum(run.quaternion[1:] * run.quaternion[:-1], axis=2)) > 0.99


@pytest.mark.parametrize(
    ("period", "duration", "timestep", "last"),
    [
        (1.0 / 30.0, 0.1, 1.0 / 30.0 / 34.0, None),  # 33 steps of 1 ms would not reach
        (0.0005, 0.01, 0.0005, None),  # outputs closer than 1 ms
        (0.01, 0.05, 1e-3, None),
        (0.01, 0.0505, 1e-3, 0.0005),  # the last output is out of period
        (1.0 / 30.0, 0.04, 1.0 / 30.0 / 34.0, (0.04 - 1.0 / 30.0) / 7.0),
        (1.0, 0.0125, 0.0125 / 13.0, None),
    ],
)
def test_steps_divide_the_time_between_outputs(
    period: float, duration: float, timestep: float, last: float | None
) -> None:
    scene = replace(make_tracker(), duration=duration, output_period=period)
    run = mjcf.simulate(scene)
    assert run.settings["timestep"] == pytest.approx(timestep, rel=1e-12)
    assert run.settings["timestep"] <= 1e-3
    assert run.settings["solref"] == [2.0 * run.settings["timestep"], 1.0]
    assert run.settings.get("last_timestep") == (last and pytest.approx(last, rel=1e-12))
    assert np.array_equal(run.time, scene.times)
    wanted = newton_euler.simulate(scene)
    # as at 1 ms; a step left out or too many shows by 1e-4 rad and more
    assert position_error(run, wanted) < 1e-6
    assert angle_error(run, wanted) < 1e-6


def test_a_shorter_last_step_changes_nothing_before_it() -> None:
    whole = mjcf.simulate(replace(make_tracker(), duration=0.05))
    longer = mjcf.simulate(replace(make_tracker(), duration=0.0505))
    assert np.array_equal(longer.quaternion[:6], whole.quaternion)
    assert longer.reaction_force is not None
    assert np.array_equal(longer.reaction_force[:6], whole.reaction_force)


def test_a_step_may_be_any_real_number(tracker: Scene) -> None:
    scene = replace(tracker, duration=2.0**-4, output_period=2.0**-5)
    run = mjcf.simulate(scene, timestep=np.float32(2.0**-10))  # type: ignore[arg-type]
    assert type(run.settings["timestep"]) is float  # as JSON needs it
    assert run.settings["timestep"] == 2.0**-10
    assert run.settings["steps"] == 64


def test_starts_from_the_initial_state() -> None:
    scene = replace(make_tracker(), duration=0.3)
    whole = newton_euler.simulate(scene)
    assert whole.linear_velocity is not None
    assert whole.angular_velocity is not None
    at = 10
    middle = newton_euler.State(
        whole.position[at],
        whole.quaternion[at],
        whole.linear_velocity[at],
        whole.angular_velocity[at],
    )
    rest = mjcf.simulate(replace(scene, initial_state=middle, duration=0.2))
    # like a run from rest, with a start that fits the springs less well
    assert np.max(np.linalg.norm(rest.position - whole.position[at:], axis=2)) < 1e-6
    assert np.max(angle_between(rest.quaternion, whole.quaternion[at:])) < 1e-6


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"integrator": "rk4"}, ["integrator 'rk4'", "RK4, Euler, implicit, implicitfast"]),
        ({"timestep": 3e-3}, ["timestep is 0.003", "divisor of the 0.01 s", "such as 0.0025"]),
        ({"timestep": 0.02}, ["timestep is 0.02", "such as 0.01"]),
        ({"timestep": 0.0}, ["timestep is 0.0", "positive"]),
        ({"timestep": float("nan")}, ["timestep is nan"]),
        ({"timestep": "fast"}, ["timestep is 'fast'"]),
        ({"timestep": True}, ["timestep is True"]),
        ({"solref": (0.001, 1.0)}, ["solref is (0.001, 1.0)", "(0.002 s) or more"]),
        ({"solref": (-100.0, 1.0)}, ["solref is (-100.0, 1.0)", "two negative numbers"]),
        ({"solref": (0.01,)}, ["solref is (0.01,)", "damping ratio"]),
        ({"solver": "newton"}, ["solver 'newton'", "Newton, CG, PGS"]),
        ({"iterations": 0}, ["iterations is 0", "whole number"]),
        ({"iterations": 10**12}, ["iterations is 1000000000000", "1 to 100000"]),
        ({"tolerance": -1e-9}, ["tolerance is -1e-09", "0.0 or more"]),
        ({"tolerance": float("nan")}, ["tolerance is nan"]),
    ],
)
def test_impossible_options(tracker: Scene, options: dict[str, object], words: list[str]) -> None:
    with pytest.raises((OptionError, UnknownNameError)) as caught:
        mjcf.simulate(tracker, **options)  # type: ignore[arg-type]
    for word in words:
        assert word in str(caught.value)


def test_constraints_may_be_given_stiffness_and_damping() -> None:
    scene = replace(make_tracker(), duration=0.1)
    run = mjcf.simulate(scene, solref=(-1e5, -1e3))
    assert run.settings["solref"] == [-1e5, -1e3]
    softer = mjcf.simulate(scene, solref=(-1e3, -1e2))
    assert np.max(softer.constraint_violation) > 10.0 * np.max(run.constraint_violation)


@pytest.mark.parametrize("solver", ["Newton", "CG", "PGS"])
@pytest.mark.parametrize("integrator", ["RK4", "Euler", "implicit", "implicitfast"])
def test_every_solver_converges_to_the_same_motion(
    short_tracker: Scene, solver: Any, integrator: Any
) -> None:
    run = mjcf.simulate(short_tracker, integrator=integrator, solver=solver)
    newton = mjcf.simulate(short_tracker, integrator=integrator)
    assert (run.settings["solver"], run.settings["integrator"]) == (solver, integrator)
    # positions change by millimeters; another last digit shows that another solver was used
    assert position_error(run, newton) < 1e-9
    assert np.array_equal(run.position, newton.position) == (solver == "Newton")


def test_iterations_that_end_early_leave_an_error(short_tracker: Scene) -> None:
    """The Newton method needs one iteration, as constraints without contacts are linear in accelerations."""
    converged = mjcf.simulate(short_tracker)
    for options, low, high in (
        ({"solver": "Newton", "iterations": 1}, 0.0, 1e-12),
        ({"solver": "PGS", "iterations": 1}, 1e-7, 1e-4),
        ({"solver": "CG", "iterations": 1}, 1e-4, 1.0),
        ({"solver": "CG", "tolerance": 1e-2}, 1e-7, 1.0),
    ):
        run = mjcf.simulate(short_tracker, **options)  # type: ignore[arg-type]
        assert options.items() <= run.settings.items()
        assert low <= position_error(run, converged) <= high, options


@pytest.mark.parametrize(
    ("timestep", "duration"),
    [
        (1e-3, 5.0),
        (1e-2, 1e-2),  # in the only step there is, which begins in good order
    ],
)
def test_a_run_that_diverges_says_when(
    timestep: float, duration: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    paper = make_tracker()
    # springs whose period is far below the step
    control = tuple(PD(law.joint, 1e9, law.damping, law.target) for law in paper.control)
    with pytest.raises(DivergenceError, match=r"QACC|QPOS|QVEL") as caught:
        mjcf.simulate(replace(paper, control=control, duration=duration), timestep=timestep)
    assert 0.0 <= caught.value.time < 0.1
    assert f"t = {caught.value.time:.6g} s" in str(caught.value)
    assert not list(tmp_path.iterdir())  # MuJoCo would leave a log file
    assert mujoco.get_mju_user_warning() is None


def test_a_run_with_a_motion_that_diverges_says_when(locking: Scene) -> None:
    """MuJoCo evaluates a state more where it starts again after a step that diverged."""
    with pytest.raises(DivergenceError, match=r"QACC|QPOS|QVEL"):
        mjcf.simulate(locking, timestep=1e-4)


@pytest.mark.parametrize("steps", [1, 2, 3, 4, 7])
def test_integrals_of_powers(steps: int) -> None:
    """Simpson's rule is exact for cubics over pairs of steps, for parabolas where one is left over."""
    degree = 1 if steps == 1 else 2 + (steps % 2 == 0)
    x = np.linspace(1.0, 2.0, steps + 1)
    exact = (2.0 ** (degree + 1) - 1.0) / (degree + 1)
    assert simpson(x**degree, 1.0 / steps) == pytest.approx(exact, rel=1e-14)
