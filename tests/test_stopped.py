"""Runs that end before their time: when, where, why, and everything that was computed by then."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from command_line import run as command
from test_singular import STARTS, crank, parallelogram

import mjcf
import newton_euler
import urdf
from crosscheck import limit, run_all
from crosscheck.engines import ENGINES as ENGINES_BY_NAME
from crosscheck.errors import CrosscheckError
from crosscheck.faults import plant
from crosscheck.partial import PARTIAL_SUMMARY, partial_runs_saved
from crosscheck.run_all import outcome
from crosscheck.scenes import load
from crosscheck.scenes.write_file import write_scene
from newton_euler import PD, Body, Mechanism, Sampled, Scene
from newton_euler.errors import IntegrationError, StoppedError
from newton_euler.forces import Wrench
from newton_euler.integrate import Options
from newton_euler.joints import Prismatic
from newton_euler.limits import VARIABLE
from newton_euler.relative import Relative
from newton_euler.simulate import run
from newton_euler.trajectory import Trajectory, load_arrays

GROWTH = 1000.0
"""1/s: a speed of 1 m/s, cosh(1000 t), is 1e300 after 0.7 s."""

DOP853 = {"rtol": 1e-6, "atol": 1e-8}
INTEGRATORS = {
    "DOP853": DOP853,
    "Radau": {"integrator": "Radau", "rtol": 1e-6, "atol": 1e-8},
    "RK4": {"integrator": "RK4", "step": 1e-3},
    "Euler": {"integrator": "Euler", "step": 1e-3},
}

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
    state = replace(scene.initial_state, linear_velocity=np.array([[0.0] * 3, [1.0, 0.0, 0.0]]))
    return replace(scene, initial_state=state)


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
    if "RK4" in engine or "Euler" in engine or engine == "mujoco":  # the same steps up to there
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


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_the_joint_that_loses_rank_is_named(formulation):
    """Without projection no step near flat bars is exact; the run up to there is."""
    scene = parallelogram(*STARTS[0])
    with pytest.raises(
        IntegrationError, match=r"near a singular configuration, where joint '[A-D]' loses"
    ) as caught:
        newton_euler.simulate(scene, formulation, stabilization="none")
    found = caught.value.partial
    assert len(found.time) > 1
    # rtol 1e-10 where accelerations lose digits
    assert np.abs(found.position[:, 1] - crank(scene)[: len(found.time)]).max() < 1e-6


def test_crosscheck_run_saves_what_each_engine_computed(capsys, tmp_path):
    path, folder = tmp_path / "runaway.yaml", tmp_path / "out"
    write_scene(runaway(("velocities", "reactions", "violation")), path)
    folder.mkdir()
    for name in ("mujoco.partial.npz", "mujoco.npz", "pinocchio.npz", "summary.json"):
        (folder / name).write_text("of an earlier run")  # which a summary that cannot be read is too
    status, _, err = command(capsys, "run", path, "--engines", "newton_euler,mujoco", "--output", folder)
    assert status == 2
    assert err.count("\n") == 1
    assert "newton_euler: integration stopped at t = " in err
    assert "'rail'" in err
    assert "mujoco: MuJoCo diverged at t = " in err
    partial = [folder / "newton_euler.partial.npz", folder / "mujoco.partial.npz"]
    assert all(f"wrote {path}, up to t = " in err for path in partial)
    assert set(folder.iterdir()) == {*partial, folder / PARTIAL_SUMMARY}
    arrays, others = map(load_arrays, partial)
    assert arrays["linear_velocity"][:, 1, 0] == pytest.approx(np.cosh(GROWTH * arrays["time"]), rel=1e-4)
    assert len(others["time"]) > 1
    assert np.isfinite(others["linear_velocity"]).all()


def stopping(scene: Scene) -> Trajectory:
    """An engine that stops half way."""
    error = IntegrationError(0.5 * scene.duration, "by joint 'crank'")
    error.partial = newton_euler.simulate(replace(scene, duration=0.5 * scene.duration))
    raise error


def endless(scene: Scene) -> Trajectory:
    while True:
        pass


def breaking(scene: Scene) -> Trajectory:
    raise np.linalg.LinAlgError("SVD did not\nconverge")


def leave_earlier(folder) -> None:
    """What a crosscheck of the pendulum left that agreed, and recordings of the user's own."""
    for name in ("newton_euler.npz", "pinocchio.npz", "pendulum.rrd", "mine.rrd"):
        (folder / name).write_text("of an earlier run")
    (folder / "summary.json").write_text('{"scene": "pendulum", "agrees": true}')


def pendulum_run(capsys, monkeypatch, folder, **changes) -> tuple[int, str, set[str]]:
    """`crosscheck run` with a changed newton_euler, before MuJoCo: status, error and files."""
    monkeypatch.setitem(ENGINES_BY_NAME, "newton_euler", replace(ENGINES_BY_NAME["newton_euler"], **changes))
    names = "newton_euler,mujoco"
    status, _, err = command(capsys, "run", "pendulum", "--engines", names, "--output", folder)
    assert err.count("\n") == 1
    return status, err, {path.name for path in folder.iterdir()}


def test_the_other_engines_run_when_one_stops(capsys, monkeypatch, tmp_path):
    status, err, files = pendulum_run(capsys, monkeypatch, tmp_path, simulate=stopping)
    assert status == 2
    assert "newton_euler: integration stopped at t = 5 s: by joint 'crank'; all " in err
    assert "figures that need no run agree, up to level 'accelerations and reactions'; wrote " in err
    assert f"wrote {tmp_path / 'newton_euler.partial.npz'}, up to t = 5 s" in err
    assert files == {"newton_euler.partial.npz", "mujoco.npz", PARTIAL_SUMMARY}
    time = load_arrays(tmp_path / "mujoco.npz")["time"]
    assert time[-1] == load("pendulum").duration


def test_what_stops_on_other_equations_says_where_they_part(capsys, monkeypatch, tmp_path):
    def systems(scene):
        return real(plant.mass(scene.mechanism.bodies[1].name, 1e-3)(scene))

    real = ENGINES_BY_NAME["newton_euler"].systems
    status, err, _ = pendulum_run(capsys, monkeypatch, tmp_path, simulate=stopping, systems=systems)
    assert status == 2
    assert "by joint 'crank'; without runs newton_euler and mujoco part at level 'model': mass, rel: " in err


def test_the_other_engines_run_when_one_does_not_end(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv(VARIABLE, "time=1")
    monkeypatch.setattr(limit, "PERIOD", 0.1)
    quick = replace(ENGINES_BY_NAME["mujoco"], simulate=ENGINES_BY_NAME["newton_euler"].simulate)
    monkeypatch.setitem(ENGINES_BY_NAME, "mujoco", quick)
    status, err, files = pendulum_run(capsys, monkeypatch, tmp_path, simulate=endless)
    assert status == 2
    assert "newton_euler: 10 s of pendulum: given up after 1 s of processor time" in err
    assert files == {"mujoco.npz", PARTIAL_SUMMARY}


def test_runs_that_cannot_be_compared_are_kept(capsys, monkeypatch, tmp_path):
    """Where the finer run that errors are measured by stops."""
    quick = replace(ENGINES_BY_NAME["newton_euler"], trajectory_error=0.0, drift=0.0, energy_error=0.0)
    monkeypatch.setitem(ENGINES_BY_NAME, "newton_euler", quick)
    status, err, files = pendulum_run(capsys, monkeypatch, tmp_path, refined=stopping)
    assert status == 2
    assert "newton_euler, in a finer run for comparison: integration stopped at t = 5 s" in err
    assert files == {"newton_euler.npz", "mujoco.npz", PARTIAL_SUMMARY}


def test_the_other_engines_run_when_one_breaks(capsys, monkeypatch, tmp_path):
    leave_earlier(tmp_path)
    status, err, files = pendulum_run(capsys, monkeypatch, tmp_path, simulate=breaking)
    assert status == 2
    assert "error: newton_euler: internal error: LinAlgError: SVD did not converge; all " in err
    assert f"wrote {tmp_path / 'mujoco.npz'}" in err
    assert files == {"mujoco.npz", "mine.rrd", PARTIAL_SUMMARY}


def test_runs_are_kept_when_their_comparison_breaks(capsys, monkeypatch, tmp_path):
    leave_earlier(tmp_path)
    quick = replace(ENGINES_BY_NAME["newton_euler"], trajectory_error=0.0, drift=0.0, energy_error=0.0)
    monkeypatch.setitem(ENGINES_BY_NAME, "newton_euler", quick)
    status, err, files = pendulum_run(capsys, monkeypatch, tmp_path, refined=breaking)
    assert status == 2
    assert "newton_euler, in a finer run for comparison: internal error: LinAlgError: SVD did not conv" in err
    assert files == {"newton_euler.npz", "mujoco.npz", "mine.rrd", PARTIAL_SUMMARY}
    assert len(load_arrays(tmp_path / "newton_euler.npz")["time"]) == len(load("pendulum").times)


@pytest.mark.parametrize(("first", "rows"), [(400, 400), (0, None)])
def test_what_comes_before_numbers_that_are_not_finite_is_kept(capsys, monkeypatch, tmp_path, first, rows):
    def overflowing(scene):
        found = newton_euler.simulate(scene)
        # reactions later than positions: the first time counts, not the first array
        position, force = found.position.copy(), found.reaction_force.copy()
        force[first:], position[first + 1 :] = np.inf, np.nan
        return replace(found, position=position, reaction_force=force)

    times = load("pendulum").times
    status, err, files = pendulum_run(capsys, monkeypatch, tmp_path, simulate=overflowing)
    assert status == 2
    assert f"newton_euler: integration stopped at t = {times[first]:.6g} s: reaction_force is not" in err
    if rows is None:
        assert files == {"mujoco.npz", PARTIAL_SUMMARY}
        return
    assert files == {"newton_euler.partial.npz", "mujoco.npz", PARTIAL_SUMMARY}
    arrays = load_arrays(tmp_path / "newton_euler.partial.npz")
    assert np.array_equal(arrays["time"], times[:rows])
    assert {len(array) for name, array in arrays.items() if "names" not in name} == {rows}
    assert all(np.isfinite(array).all() for name, array in arrays.items() if "names" not in name)


@pytest.mark.parametrize("scene", ['"../outside"', "17", "null"])
def test_no_file_elsewhere_is_taken_for_the_earlier_recording(tmp_path, scene):
    outside, folder = tmp_path / "outside.rrd", tmp_path / "out"
    folder.mkdir()
    outside.write_text("the user's own")
    (folder / "summary.json").write_text(f'{{"scene": {scene}}}')
    with (
        pytest.raises(CrosscheckError, match="internal error: ZeroDivisionError: nothing"),
        partial_runs_saved(folder, ["pendulum"]),
    ):
        raise ZeroDivisionError("nothing")
    assert list(folder.iterdir()) == []
    assert outside.exists()


def test_run_all_leaves_no_earlier_verdict_where_a_scene_breaks(monkeypatch, tmp_path):
    def breaks(*_):
        raise ZeroDivisionError("nothing there")

    leave_earlier(tmp_path)
    monkeypatch.setattr(run_all, "crosscheck", breaks)
    found = outcome("pendulum", ("newton_euler", "mujoco"), tmp_path)
    assert found.verdict == "pendulum did not run: internal error: ZeroDivisionError: nothing there"
    assert {path.name for path in tmp_path.iterdir()} == {"mine.rrd"}


def test_run_all_keeps_what_each_scene_computed(monkeypatch, tmp_path):
    monkeypatch.setitem(
        ENGINES_BY_NAME, "newton_euler", replace(ENGINES_BY_NAME["newton_euler"], simulate=stopping)
    )
    found = outcome("pendulum", ("newton_euler", "mujoco"), tmp_path)
    assert not found.agrees
    assert "newton_euler: integration stopped at t = 5 s" in found.verdict
    names = {"newton_euler.partial.npz", "mujoco.npz", PARTIAL_SUMMARY}
    assert {path.name for path in tmp_path.iterdir()} == names


def test_pinocchio_stops_before_the_first_output():
    """Forces beyond all numbers: there is nothing to keep, and the reason is told."""
    cart = Body("cart", 1e-3, np.zeros(3), np.eye(3))
    rail = Prismatic("rail", "ground", "cart", np.zeros(3), axis=[1.0, 0.0, 0.0])
    push = Wrench("push", "cart", np.zeros(3), force=np.full(3, 1e308))
    scene = Scene("pushed", Mechanism([Body.ground(), cart], [rail]), 1.0, 0.1, forces=(push,))
    with pytest.raises(IntegrationError, match=r"t = 0 s: .*not finite") as caught:
        urdf.simulate(scene)
    assert caught.value.partial is None
