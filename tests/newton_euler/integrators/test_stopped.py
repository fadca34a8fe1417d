"""Runs that end before their time: when, where, why, and everything that was computed by then."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import run as command
from command_line import verdict_of

import mjcf
import newton_euler
import urdf
from crosscheck.cli.run_all import run_scene
from crosscheck.cli.shared import UNFINISHED
from crosscheck.engines.registry import ENGINES as ENGINES_BY_NAME
from crosscheck.library import load
from crosscheck.library.scene_file import write_scene
from crosscheck.studies.faults import injection
from crosscheck.support import time_limits as limit
from newton_euler import PD, Body, JointFriction, JointStop, Mechanism, Sampled, Scene, State
from newton_euler.compiled.failures import STABILITY_LIMITS
from newton_euler.equations.relative import Relative
from newton_euler.integrators.options import FIXED, Options
from newton_euler.limits import ENVIRONMENT_VARIABLE
from newton_euler.model.forces import Wrench
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.trajectory import IntegrationError, StoppedError, Trajectory, load_arrays
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import run

GROWTH = 1000.0
"""1/s: a speed of 1 m/s, cosh(1000 t), is 1e300 after 0.7 s."""

DOP853 = {"rtol": 1e-6, "atol": 1e-8}
INTEGRATORS = {
    "DOP853": DOP853,
    "Radau": {"integrator": "Radau", "rtol": 1e-6, "atol": 1e-8},
    "RK4": {"integrator": "RK4", "step": 1e-3},
    "Euler": {"integrator": "Euler", "step": 1e-3},
}

FILES = {"newton_euler.npz", "mujoco.npz", "summary.json", "junit.xml"}

ENGINES = {
    **{
        f"{formulation}, {integrator}": partial(newton_euler.simulate, formulation=formulation, **options)
        for formulation in ("relative", "cartesian")
        for integrator, options in INTEGRATORS.items()
    },
    **{
        f"floats, {integrator}": lambda scene, options=options: run(
            Relative(scene), "newton_euler", Options(**options), {}
        )
        for integrator, options in INTEGRATORS.items()
        if integrator in ("DOP853", "Euler")
    },
    "pinocchio": partial(urdf.simulate, **DOP853),
    "mujoco": mjcf.simulate,
}


def runaway(outputs=("velocities", "actuation"), duration=1.0) -> Scene:
    """A cart of 1 kg on a rail, pushed away from its start by 1e6 N/m, 1 m/s fast at first."""
    cart = Body("cart", 1.0, np.zeros(3), np.eye(3))
    rail = Prismatic("rail", "ground", "cart", np.zeros(3), axis=[1.0, 0.0, 0.0], actuated=True)
    mechanism = Mechanism([Body.ground(), cart], [rail])
    control = (PD("rail", -(GROWTH**2), 0.0, 0.0),)
    scene = Scene("runaway", mechanism, duration, 0.01, control=control, outputs=frozenset(outputs))
    state = replace(initial_state(scene), linear_velocity=np.array([[0.0] * 3, [1.0, 0.0, 0.0]]))
    return replace(scene, initial_state=state)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES)
def test_what_was_computed_is_kept(engine):
    scene = runaway()
    with pytest.raises(StoppedError) as caught:
        ENGINES[engine](scene)
    error, found = caught.value, caught.value.partial
    assert "'rail'" in error.reason
    assert f"at t = {error.time:.6g} s" in str(error)
    rows = len(found.time)
    assert 1 < rows < len(scene.times)
    assert np.array_equal(found.time, scene.times[:rows])
    # what is left out is beyond the time that was reached, which may be that of a stage
    assert found.time[-1] <= error.time <= scene.times[rows] + 2e-3
    assert {len(array) for name, array in found.arrays().items() if "names" not in name} == {rows}
    assert np.isfinite(found.linear_velocity).all()
    if engine == "mujoco" or any(name in engine for name in FIXED):  # the same steps up to there
        early = ENGINES[engine](runaway(duration=found.time[-1]))
        assert np.allclose(found.linear_velocity, early.linear_velocity, rtol=1e-12, atol=0.0)
    else:
        # hundreds of steps of a relative error of 1e-6 each, of one sign
        assert found.linear_velocity[:, 1, 0] == pytest.approx(np.cosh(GROWTH * found.time), rel=1e-2)


@pytest.mark.parametrize("engine", ["relative, RK4", "cartesian, RK4", "floats, Euler"])
def test_outputs_that_no_double_holds_end_a_run_too(engine):
    """v^2 with v = g t is 1.8e308 m^2/s^2 after 0.134 s, while the run itself goes on."""
    scene = replace(runaway(("velocities", "energy")), control=(), gravity=np.array([1e155, 0.0, 0.0]))
    with pytest.raises(IntegrationError, match="kinetic_energy is not finite") as caught:
        ENGINES[engine](scene)
    found = caught.value.partial
    assert np.array_equal(found.time, scene.times[:14])
    assert caught.value.time == scene.times[14]
    assert found.kinetic_energy == pytest.approx(
        (0.5e155 * found.time) * (1e155 * found.time), rel=1e-12, abs=1.0
    )


@pytest.mark.parametrize(
    "engine", ["relative, DOP853", "cartesian, RK4", "floats, Euler", "pinocchio", "mujoco"]
)
def test_what_came_before_a_controllers_mistake_is_kept(engine):
    def control(time, x, rate):
        return 1.0 if time < 0.25 else float("nan")

    scene = replace(runaway(), control=(Sampled("rail", control, 0.05),))
    with pytest.raises(
        IntegrationError, match=r"t = 0.25 s: controller of joint 'rail' returned nan"
    ) as caught:
        ENGINES[engine](scene)
    found = caught.value.partial
    assert np.array_equal(found.time, scene.times[:25])
    # constant acceleration, at MuJoCo's and all others' round-off
    assert found.linear_velocity[:, 1, 0] == pytest.approx(1.0 + found.time, rel=1e-12)


def test_a_stop_at_the_start_leaves_nothing():
    scene = replace(runaway(), control=(Sampled("rail", lambda time, x, rate: None, 0.05),))
    with pytest.raises(IntegrationError, match=r"t = 0 s: .* returned None") as caught:
        newton_euler.simulate(scene)
    assert caught.value.partial is None


def test_crosscheck_run_compares_what_each_engine_computed(capsys, tmp_path):
    path, folder = tmp_path / "runaway.yaml", tmp_path / "out"
    write_scene(runaway(("velocities", "reactions", "violation")), path)
    status, out, err = command(capsys, "run", path, "--engines", "newton_euler,mujoco", "--output", folder)
    assert (status, err) == (UNFINISHED, "")
    verdict = verdict_of(out)
    assert verdict.startswith("UNFINISHED: newton_euler: integration stopped at t = ")
    assert "'rail'" in verdict
    assert "mujoco: MuJoCo diverged at t = " in verdict
    assert {found.name for found in folder.iterdir()} == {*FILES, "runaway.rrd"}
    summary = json.loads((folder / "summary.json").read_text())
    arrays, others = (load_arrays(folder / f"{name}.npz") for name in ("newton_euler", "mujoco"))
    times = {stop["what"]: stop["time"] for stop in summary["unfinished"]}
    assert times == {"newton_euler": arrays["time"][-1], "mujoco": others["time"][-1]}
    assert arrays["linear_velocity"][:, 1, 0] == pytest.approx(np.cosh(GROWTH * arrays["time"]), rel=1e-4)
    assert len(others["time"]) > 1
    assert np.isfinite(others["linear_velocity"]).all()
    assert {"model", "trajectories", "drift"} <= {figure["level"] for figure in summary["checks"]}


def stopping(scene: Scene) -> Trajectory:
    """An engine that stops half way."""
    error = IntegrationError(0.5 * scene.duration, "by joint 'crank'")
    error.partial = newton_euler.simulate(replace(scene, duration=0.5 * scene.duration))
    raise error


def endless(scene: Scene) -> Trajectory:
    while True:
        pass


REASON = "SVD did not\nconverge"


def breaking(scene: Scene) -> Trajectory:
    raise np.linalg.LinAlgError(REASON)


def pendulum_run(capsys, monkeypatch, folder, **changes) -> tuple[int, str, dict]:
    """`crosscheck run` with a changed newton_euler, before MuJoCo: status, verdict and summary."""
    monkeypatch.setitem(ENGINES_BY_NAME, "newton_euler", replace(ENGINES_BY_NAME["newton_euler"], **changes))
    names = "newton_euler,mujoco"
    status, out, err = command(capsys, "run", "pendulum", "--engines", names, "--output", folder)
    assert err == ""
    return status, verdict_of(out), json.loads((folder / "summary.json").read_text())


def levels(summary, *between):
    """The levels that some engines were compared at."""
    return {figure["level"] for figure in summary["checks"] if figure["between"] == [*between]}


def test_an_engine_that_stops_is_compared_until_then(capsys, monkeypatch, tmp_path):
    status, verdict, summary = pendulum_run(capsys, monkeypatch, tmp_path, simulate=stopping)
    assert status == UNFINISHED
    assert verdict.startswith("UNFINISHED: newton_euler: integration stopped at t = 5 s: by joint 'crank'; ")
    (stop,) = summary["unfinished"]
    assert (stop["what"], stop["time"]) == ("newton_euler", 5.0)
    assert levels(summary, "newton_euler", "mujoco") >= {"model", "trajectories", "energy"}
    assert {known["engine"] for known in summary["known_values"]} == {"mujoco"}
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "pendulum.rrd"}
    ends = {name: load_arrays(tmp_path / f"{name}.npz")["time"][-1] for name in ("newton_euler", "mujoco")}
    assert ends == {"newton_euler": 5.0, "mujoco": load("pendulum").duration}


def test_what_stops_on_other_equations_is_the_odd_one(capsys, monkeypatch, tmp_path):
    def systems(scene):
        return real(injection.mass(scene.mechanism.bodies[1].name, 1e-3)(scene))

    real = ENGINES_BY_NAME["newton_euler"].systems
    status, verdict, summary = pendulum_run(capsys, monkeypatch, tmp_path, simulate=stopping, systems=systems)
    assert status == UNFINISHED
    assert "by joint 'crank'; as far as compared newton_euler differs; its own momentum balance" in verdict
    assert "; at level 'model': mass, rel: 0.000999 > 1e-12, worst at dumbbell: " in verdict
    (diagnosis,) = summary["diagnosis"]
    assert (diagnosis["engine"], diagnosis["level"], diagnosis["fault"]) == ("newton_euler", "model", "model")


def test_the_other_engines_run_when_one_does_not_end(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv(ENVIRONMENT_VARIABLE, "time=1")
    monkeypatch.setattr(limit, "CHECK_PERIOD_S", 0.1)
    quick = replace(ENGINES_BY_NAME["mujoco"], simulate=ENGINES_BY_NAME["newton_euler"].simulate)
    monkeypatch.setitem(ENGINES_BY_NAME, "mujoco", quick)
    status, verdict, summary = pendulum_run(capsys, monkeypatch, tmp_path, simulate=endless)
    assert status == UNFINISHED
    assert verdict.startswith("UNFINISHED: newton_euler: 10 s of pendulum: given up after 1 s of processor t")
    assert summary["unfinished"][0]["time"] is None
    assert {path.name for path in tmp_path.iterdir()} == {
        "mujoco.npz",
        "summary.json",
        "junit.xml",
        "pendulum.rrd",
    }
    assert "accelerations and reactions" in levels(summary, "newton_euler", "mujoco")
    assert "drift" in levels(summary, "mujoco")


@pytest.mark.parametrize(
    ("refined", "reason"),
    [
        (stopping, "integration stopped at t = 5 s"),
        (breaking, "internal error: LinAlgError: SVD did not converge"),
    ],
)
def test_figures_that_need_no_finer_run_are_had_without_it(capsys, monkeypatch, tmp_path, refined, reason):
    """Where the finer run that errors are measured by stops."""
    exact = {"trajectory_error": 1e-30, "drift": 1e-30, "energy_error": 1e-30}
    status, verdict, summary = pendulum_run(capsys, monkeypatch, tmp_path, refined=refined, **exact)
    assert status == UNFINISHED
    assert f"newton_euler, in a finer run for comparison: {reason}" in verdict
    assert summary["unfinished"][0]["what"] == "comparing runs"
    assert levels(summary, "mujoco") >= {"drift", "energy"}
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "pendulum.rrd"}


def test_the_other_engines_run_when_one_breaks(capsys, monkeypatch, tmp_path):
    status, verdict, summary = pendulum_run(capsys, monkeypatch, tmp_path, simulate=breaking)
    assert status == UNFINISHED
    assert verdict.startswith("UNFINISHED: newton_euler: internal error: LinAlgError: SVD did not converge; ")
    broken = summary["engines"]["newton_euler"]
    assert (broken["settings"], broken["wall_time"], broken["error"]) == ({}, None, None)


@pytest.mark.parametrize(("first", "rows"), [(400, 400), (0, None)])
def test_what_comes_before_numbers_that_are_not_finite_is_kept(capsys, monkeypatch, tmp_path, first, rows):
    def overflowing(scene):
        found = newton_euler.simulate(scene)
        # reactions later than positions: the first time counts, not the first array
        position, force = found.position.copy(), found.reaction_force.copy()
        force[first:], position[first + 1 :] = np.inf, np.nan
        return replace(found, position=position, reaction_force=force)

    times = load("pendulum").times
    status, verdict, _ = pendulum_run(capsys, monkeypatch, tmp_path, simulate=overflowing)
    assert status == UNFINISHED
    assert f"newton_euler: integration stopped at t = {times[first]:.6g} s: reaction_force is not" in verdict
    assert (tmp_path / "newton_euler.npz").exists() == (rows is not None)
    if rows is None:
        return
    arrays = load_arrays(tmp_path / "newton_euler.npz")
    assert np.array_equal(arrays["time"], times[:rows])
    assert {len(array) for name, array in arrays.items() if "names" not in name} == {rows}
    assert all(np.isfinite(array).all() for name, array in arrays.items() if "names" not in name)


def test_nothing_that_can_be_compared_leaves_an_earlier_run_as_it_is(capsys, monkeypatch, tmp_path):
    earlier = {"newton_euler.npz": "of an earlier run", "summary.json": '{"scene": "pendulum"}'}
    for name, content in earlier.items():
        (tmp_path / name).write_text(content)
    system = Mock()
    system.acceleration.side_effect = system.mass_and_force.side_effect = np.linalg.LinAlgError(REASON)
    broken = replace(
        ENGINES_BY_NAME["newton_euler"], simulate=breaking, systems=lambda scene: (system,)
    )  # it can express the scene, and evaluate nothing
    monkeypatch.setitem(ENGINES_BY_NAME, "newton_euler", broken)
    arguments = ("pendulum", "--engines", "newton_euler", "--output", tmp_path)
    status, out, err = command(capsys, "run", *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("crosscheck: error: newton_euler: internal error: LinAlgError: SVD did not conver")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == earlier


def test_run_all_tells_what_each_scene_computed(monkeypatch, tmp_path):
    monkeypatch.setitem(
        ENGINES_BY_NAME, "newton_euler", replace(ENGINES_BY_NAME["newton_euler"], simulate=stopping)
    )
    found = run_scene("pendulum", ("newton_euler", "mujoco"), tmp_path)
    assert not found.agrees
    assert found.verdict.startswith("UNFINISHED: newton_euler: integration stopped at t = 5 s")
    assert {path.name for path in (tmp_path / "pendulum").iterdir()} == {*FILES, "pendulum.rrd"}


def test_pinocchio_stops_before_the_first_output():
    """Forces beyond all numbers: there is nothing to keep, and the reason is told."""
    cart = Body("cart", 1e-3, np.zeros(3), np.eye(3))
    rail = Prismatic("rail", "ground", "cart", np.zeros(3), axis=[1.0, 0.0, 0.0])
    push = Wrench("push", "cart", np.zeros(3), force=np.full(3, 1e308))
    scene = Scene("pushed", Mechanism([Body.ground(), cart], [rail]), 1.0, 0.1, forces=(push,))
    with pytest.raises(IntegrationError, match=r"t = 0 s: .*not finite") as caught:
        urdf.simulate(scene)
    assert caught.value.partial is None


def test_every_integrator_with_fixed_steps_has_a_limit_of_stability() -> None:
    assert STABILITY_LIMITS.keys() == set(FIXED)


def block(force: JointFriction | JointStop, speed: float) -> Scene:
    """A block of 2 kg on a rail, at a speed, m/s, with a push of 10 N and one force."""
    body = Body("block", 2.0, np.zeros(3), np.eye(3))
    rail = Prismatic("rail", "ground", "block", np.zeros(3), axis=[1.0, 0.0, 0.0])
    mechanism = Mechanism([Body.ground(), body], [rail])
    velocity = np.array([np.zeros(3), [speed, 0.0, 0.0]])
    state = replace(State.initial(mechanism), linear_velocity=velocity)
    return Scene("block", mechanism, 1.0, 0.1, [5.0, 0.0, 0.0], initial_state=state, forces=(force,))


@pytest.mark.parametrize("simulate", [newton_euler.simulate, urdf.simulate])
@pytest.mark.parametrize(
    ("force", "speed", "number"),
    [
        # sticks after 0.2 s: 20 N less 10 N stop 2 kg of 1 m/s
        (JointFriction("rail", 20.0, transition_speed=1e-9), 1.0, "transition_speed of 1e-09 m/s"),
        # oscillates at the stop with 1 / sqrt(k / m) = 1 microsecond
        (JointStop("rail", "high", 0.0, 2e12), 0.0, "stiffness of 2e+12 N/m"),
    ],
)
def test_short_steps_have_the_switched_force_that_makes_them(
    simulate: Callable[..., object], force: JointFriction | JointStop, speed: float, number: str
) -> None:
    with pytest.raises(IntegrationError) as caught:
        simulate(block(force, speed), most_steps=120)
    assert f"{force.element} " in str(caught.value)
    assert number in str(caught.value)
    assert "Radau" in str(caught.value)
