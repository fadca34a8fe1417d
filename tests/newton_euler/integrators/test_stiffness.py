"""Choice of integrators by stiffness, on a damped hinge whose motion has a closed form."""

from __future__ import annotations

import re
import signal
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mechanisms import pendulum

import mjcf
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.engines import adaptive
from crosscheck.engines.registry import ENGINES, choose
from crosscheck.engines.stiffness import (
    DOP853_STABILITY,
    explicit_steps,
    fastest_decay,
    is_stable_in_rk4,
    modes_of_run,
)
from crosscheck.report.run import notes
from crosscheck.support import time_limits as limit
from mjcf.errors import DivergenceError
from newton_euler import simulate
from newton_euler.limits import changed
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.forces import JointSpring, PointSpring
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

REST = 0.5
"""rad, where the spring pulls the hinge to."""


def damped(rate: float) -> tuple[Scene, float, float]:
    """A pendulum without gravity on a damped spring; the two rates of its decay, 1/s."""
    scene = replace(pendulum(), gravity=np.zeros(3), duration=1.0, output_period=0.1)
    (hinge,), body = scene.mechanism.joints, scene.mechanism.bodies[1]
    turn, arm = rotation(body.quaternion), body.center_of_mass - hinge.point
    about_center = hinge.axis @ turn @ body.inertia @ turn.T @ hinge.axis
    inertia = float(about_center + body.mass * np.sum(np.cross(hinge.axis, arm) ** 2))
    damping, stiffness = inertia * rate, 2.0 * inertia * rate
    spring = JointSpring(scene.mechanism.joint_names[0], stiffness, damping, REST)
    root = np.sqrt(rate * rate - 8.0 * rate)
    return replace(scene, forces=(spring,)), 0.5 * (rate + root), 4.0 * rate / (rate + root)


def test_the_fastest_decay_is_that_of_a_damped_hinge() -> None:
    for rate in (50.0, 1e5):
        scene, fast, _ = damped(rate)
        # central differences by 1e-7 lose half of the digits
        assert fastest_decay(scene) == pytest.approx(fast, rel=1e-6)


def test_dop853_takes_as_many_steps_as_stability_asks_for() -> None:
    scene, _, _ = damped(1e5)
    steps = simulate(scene).settings["steps"]
    # where DOP853_STABILITY comes from: the least steps, and some more while the fast motion dies out
    assert steps == pytest.approx(explicit_steps(scene), rel=0.05), DOP853_STABILITY


@pytest.mark.parametrize(("rate", "integrator"), [(1e5, "DOP853"), (1e7, "Radau")])
def test_newton_euler_takes_radau_for_what_is_stiff(rate: float, integrator: str) -> None:
    scene, fast, slow = damped(rate)
    run = ENGINES["newton_euler"].simulate(scene)
    assert run.settings["integrator"] == integrator
    angle = np.arctan2(run.position[:, 1, 0], -run.position[:, 1, 2])
    decays = (fast * np.exp(-slow * run.time) - slow * np.exp(-fast * run.time)) / (fast - slow)
    wanted = REST * (1.0 - decays)
    # Radau at rtol 1e-8 over some tens of steps
    assert np.abs(angle - angle[0]) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(("steps", "integrator"), [(50, "DOP853"), (200, "DOP853"), (2000, "Radau")])
def test_pinocchio_integrates_stiff_scenes_implicitly(steps: int, integrator: str) -> None:
    """Above 60 steps that stability alone costs, if Radau needs less than a quarter of the evaluations."""
    scene = damped(1000.0)[0]
    scene = replace(scene, duration=steps * DOP853_STABILITY / fastest_decay(scene), output_period=0.1)
    assert explicit_steps(scene) == pytest.approx(steps)
    run = ENGINES["pinocchio"].simulate(scene)
    assert run.settings["integrator"] == integrator
    wanted = simulate(scene, rtol=1e-12, atol=1e-14)
    # Radau at rtol 1e-8 leaves about 1e-11 m, projection keeps the joints closed
    assert np.abs(run.position - wanted.position).max() < 1e-9


def test_rk4_is_stable_within_its_own_limits() -> None:
    """2.785 for decay and 2 sqrt(2) for oscillation (Hairer and Wanner, table IV.2.1 and figure IV.2.1)."""
    for mode, most in ((-1.0, 2.785293563), (1j, np.sqrt(8.0))):
        assert is_stable_in_rk4(np.array([mode]), most * (1.0 - 1e-4))
        assert not is_stable_in_rk4(np.array([mode]), most * (1.0 + 1e-4))
    assert is_stable_in_rk4(np.array([5.0]), 1.0)  # what grows by itself is no matter of the step


def test_motions_are_looked_at_on_the_way_too() -> None:
    """A damper whose line passes through the hinge at first: nothing dies out there."""
    damper = PointSpring(
        "damper", "ground", "rod", [-0.5, 0.0, 0.0], [1.0, 0.0, 0.0],
        stiffness=0.0, rest_length=1.0, damping=200.0,
    )  # fmt: skip
    scene = replace(pendulum(), forces=(damper,))
    assert fastest_decay(scene) < 1e-3  # round-off of differences
    run = simulate(scene)
    found = -np.min(modes_of_run(scene, run).real)
    # the arm a of the damper's line gives d a^2 / I, of a rod of 1 kg and 1 m about its end
    tip = 2.0 * run.position[:, 1]
    line = tip - [-0.5, 0.0, 0.0]
    arm = np.abs(tip[:, 0] * line[:, 2] - tip[:, 2] * line[:, 0]) / np.linalg.norm(line, axis=1)
    largest = 200.0 * np.max(arm**2) * 3.0
    assert 0.1 * largest < found < 1.1 * largest  # at some times only, and gravity beside it


def test_mujoco_takes_a_step_at_which_rk4_is_stable() -> None:
    """At 1 ms an error grows by 1.2 % a step, which MuJoCo does not call divergence within 1 s."""
    scene, fast, slow = damped(2795.0)
    assert 2.785 < 1e-3 * fast < 2.8
    run = ENGINES["mujoco"].simulate(scene)
    assert (run.settings["integrator"], run.settings["timestep"]) == ("RK4", 5e-4)
    angle = np.arctan2(run.position[:, 1, 0], -run.position[:, 1, 2])
    decays = (fast * np.exp(-slow * run.time) - slow * np.exp(-fast * run.time)) / (fast - slow)
    # (h fast)^4 / 120 of the fast part's 4e-4 rad
    assert np.abs(angle - angle[0]) == pytest.approx(REST * (1.0 - decays), abs=1e-5)


def test_rk4_is_kept_while_it_takes_seconds() -> None:
    """An actuated finger's 6.9e4 1/s: an implicit method of order 1 would be off by 1 % of its energy."""
    scene, fast, _ = damped(6.9e4)
    settings = ENGINES["mujoco"].simulate(replace(scene, duration=0.1)).settings
    assert settings["integrator"] == "RK4"
    assert 0.5 * 2.785 < settings["timestep"] * fast < 2.785


def test_mujoco_takes_an_implicit_integrator_where_rk4_diverges() -> None:
    scene, *_ = damped(1e7)
    result = crosscheck(scene, choose(["newton_euler", "mujoco"]), lambda _: None, "x", {})
    assert result.trajectories["mujoco"].settings["integrator"] == "implicitfast"
    assert result.agrees, result.verdict
    (line,) = [line for line in notes(result) if line.startswith("stiff: ")]
    assert line.endswith(", RK4 steps of 2.8e-07 s; implicit: newton_euler, mujoco")


def test_divergence_of_what_is_too_stiff_names_the_step_that_it_needs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def diverging(scene: Scene, timestep: float, integrator: str = "RK4") -> Trajectory:
        raise DivergenceError(1e-3, f"huge value in QACC by {integrator}")

    scene, fast, _ = damped(1e9)
    monkeypatch.setattr(mjcf, "simulate", diverging)
    with pytest.raises(DivergenceError, match="implicitfast") as caught:
        ENGINES["mujoco"].simulate(scene)
    (needed,) = re.findall(r"steps below (\S+) s", caught.value.reason)
    assert float(needed) == pytest.approx(2.785 / fast, rel=0.02)
    assert caught.value.time == 1e-3


def without_end(scene: Scene) -> Trajectory:
    while True:
        pass


@pytest.mark.parametrize("handler", [signal.default_int_handler, signal.SIG_IGN])
def test_a_run_without_end_is_given_up(monkeypatch: pytest.MonkeyPatch, handler: Any) -> None:
    before = signal.signal(signal.SIGINT, handler)  # ignored, as in what shells run in the background
    monkeypatch.setattr(limit, "REPORT_AFTER_S", 0.1)
    monkeypatch.setattr(limit, "CHECK_PERIOD_S", 0.1)
    engine = replace(ENGINES["newton_euler"], simulate=without_end)
    told: list[str] = []
    try:
        with changed({"time": 0.6}):
            found = crosscheck(pendulum(), [engine], told.append, "x", {})
        assert "2 s of pendulum: given up after 0.6 s of processor" in found.verdict
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert any("s so far" in line for line in told)


def test_an_interrupt_is_not_taken_for_the_limit() -> None:
    def interrupted(scene: Scene) -> Trajectory:
        raise KeyboardInterrupt

    engine = replace(ENGINES["newton_euler"], simulate=interrupted)
    with pytest.raises(KeyboardInterrupt):
        crosscheck(pendulum(), [engine], lambda _: None, "x", {})


def test_a_run_that_grinds_is_stopped_with_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adaptive, "NATIVE_MAX_STEPS", 4)
    scene = replace(pendulum(), duration=10.0)
    (stop,) = crosscheck(scene, choose(["newton_euler"]), lambda _: None, "x", {}).unfinished
    assert re.fullmatch("newton_euler: integration stopped at t = .*: more than 4 steps.*", str(stop))


def test_undamped_motions_whose_decay_is_round_off_bound_the_step() -> None:
    """RK4 swings on up to 2.83 / |mode|; a real part of either sign is what an eigenvalue solver leaves."""
    for real in (-1e-3, 0.0, 1e-3):
        swings = np.array([real + 1e4j, real - 1e4j])
        assert not is_stable_in_rk4(swings, 1e-3)
        assert is_stable_in_rk4(swings, 2e-4)
    assert is_stable_in_rk4(np.array([50.0]), 1e-2)  # what grows may


def test_coverage_that_takes_too_long_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def endless(*arguments: Any) -> None:
        without_end(pendulum())

    monkeypatch.setattr("crosscheck.compare.crosscheck.coverage", endless)
    monkeypatch.setattr(limit, "CHECK_PERIOD_S", 0.1)
    with changed({"coverage_time": 0.5}):
        result = crosscheck(pendulum(), choose(["newton_euler", "mujoco"]), lambda _: None, "x", {})
    assert (result.coverage, result.unfinished, result.differs) == (None, (), False)
    (note,) = result.notes
    assert note.endswith("to allow more: --set coverage_time=2")
