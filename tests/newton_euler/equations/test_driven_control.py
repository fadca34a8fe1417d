"""Control laws that depend on time: an oscillator against its closed form, in all engines, and in files."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mechanisms import mass_on_rail

import mjcf
import newton_euler
import urdf
from crosscheck.compare.coverage import covered_by
from crosscheck.engines.energy import energy_balance
from crosscheck.library import load
from crosscheck.library.scene_file import write_scene
from crosscheck.loading.convert import scene_report, write_as
from mjcf.benchmark_kernels import Rollout, Stepper, compiled, physics_states
from mjcf.rigid import RigidMuJoCo
from newton_euler.equations.parameters import parameter_values, with_values
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import at_time
from newton_euler.errors import MechanismError
from newton_euler.model.control import PD
from newton_euler.model.motions import Sum
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.runs.assemble import initial_state
from urdf.dynamics import PinocchioSystem

MASS, STIFFNESS, DAMPING, TARGET = 2.0, 50.0, 4.0, 0.1
"""kg of `mass_on_rail`, N/m, N s/m and m of the law."""

CONSTANT, SLOPE, AMPLITUDE, FREQUENCY = 1.5, -0.8, 6.0, 7.0
"""N, N/s, N and rad/s of what drives it."""

PUSH = Sum((Polynomial((CONSTANT, SLOPE)), Sine(AMPLITUDE, FREQUENCY)))


REFERENCE = Sum(
    (
        Polynomial((TARGET + (CONSTANT - DAMPING * SLOPE / STIFFNESS) / STIFFNESS, SLOPE / STIFFNESS)),
        Sine(
            AMPLITUDE / np.hypot(STIFFNESS, DAMPING * FREQUENCY),
            FREQUENCY,
            -np.arctan2(DAMPING * FREQUENCY, STIFFNESS),
        ),
    )
)
"""m, the target r with K_p r + K_d dr/dt = K_p TARGET + PUSH."""

LAWS = {
    "feedforward": PD("rail", STIFFNESS, DAMPING, TARGET, feedforward=PUSH),
    "target": PD("rail", STIFFNESS, DAMPING, REFERENCE),
}


@pytest.fixture(params=LAWS)
def scene(request):
    return driven(LAWS[request.param])


def driven(law):
    return replace(mass_on_rail(duration=2.0, control=(law,)), output_period=0.05)


def expected(time):
    """m, from rest: m x'' + d x' + k x = k x_t + c + s t + a sin(w t)."""
    answer = AMPLITUDE / (STIFFNESS - MASS * FREQUENCY**2 + 1j * DAMPING * FREQUENCY)
    slope = SLOPE / STIFFNESS
    constant = TARGET + (CONSTANT - DAMPING * slope) / STIFFNESS
    start = constant + answer.imag  # of what is forced, and its rate
    rate = slope + FREQUENCY * answer.real
    decay = DAMPING / (2.0 * MASS)
    own = np.sqrt(STIFFNESS / MASS - decay**2)
    free = -start * np.cos(own * time) - (rate + decay * start) / own * np.sin(own * time)
    forced = constant + slope * time + (answer * np.exp(1j * FREQUENCY * time)).imag
    return forced + np.exp(-decay * time) * free


def gap(run):
    """m, the largest distance from the closed form."""
    return np.abs(run.position[:, 1, 2] - expected(run.time)).max()


def share(scene, run):
    balance = energy_balance(scene, run)
    return np.abs(balance.residual).max() / balance.scale


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_newton_euler(scene, formulation):
    """1e-9 m: the tolerance of 1e-10 a step."""
    run = newton_euler.simulate(scene, formulation)
    assert gap(run) < 1e-9
    assert share(scene, run) < 1e-9
    u = [PUSH.value(float(t)) for t in run.time] - STIFFNESS * (run.position[:, 1, 2] - TARGET)
    u -= DAMPING * run.linear_velocity[:, 1, 2]
    assert run.actuator_force[:, 0] == pytest.approx(u, abs=1e-9)


def test_pinocchio(scene):
    run = urdf.simulate(scene)
    assert gap(run) < 1e-8  # m, at rtol 1e-10
    assert share(scene, run) < 1e-8


def test_mujocos_rk4_is_of_order_four(scene):
    """Each stage has the controls of its own time."""
    runs = [mjcf.simulate(scene, timestep=step) for step in (0.05, 0.025)]
    assert 14.0 < gap(runs[0]) / gap(runs[1]) < 20.0
    assert share(scene, mjcf.simulate(scene)) < 1e-9  # Simpson's rule at 1 ms


@pytest.mark.parametrize("integrator", ["Euler", "implicit"])
def test_mujocos_other_integrators_are_of_order_one(scene, integrator):
    runs = [mjcf.simulate(scene, timestep=step, integrator=integrator) for step in (1e-3, 5e-4)]
    assert 1.9 < gap(runs[0]) / gap(runs[1]) < 2.1
    assert max(share(scene, run) for run in runs) < 1e-12  # of the forces that were applied


def test_the_controls_are_those_of_the_time(scene):
    """At a single state, in all systems."""
    for system in (RigidMuJoCo(scene), PinocchioSystem(scene), Relative(scene)):
        now = at_time(system, 0.3)
        q, v = now.coordinates(initial_state(scene))
        wanted = (PUSH.value(0.3) + STIFFNESS * TARGET) / MASS
        assert now.acceleration(q, v)[0] == pytest.approx(wanted, rel=1e-14)


def test_mujocos_tight_loops(scene):
    """A whole run is that of `simulate`; of many at once the controls of a step are those of its middle."""
    intervals, errors = [(40, 0.05)], []
    stepper = Stepper(compiled(scene), "RK4", intervals, 2, 1.0)
    stepper.reset()
    stepper.run()
    assert gap_of(stepper.poses()[0], scene) == pytest.approx(gap(mjcf.simulate(scene, timestep=0.025)))
    for number in (2, 4):
        rollout = Rollout(compiled(scene), "RK4", number, 1.0, 1)
        q, v = compiled(scene).coordinates(initial_state(scene))
        starts = physics_states(compiled(scene), q[None], v[None])
        errors.append(gap_of(rollout.poses(rollout(starts)[0])[0], scene))
    assert 3.8 < errors[0] / errors[1] < 4.2  # order 2


def gap_of(position, scene):
    return np.abs(position[:, 1, 2] - expected(scene.times)).max()


def test_scene_files_hold_the_function(scene, tmp_path):
    path = tmp_path / "driven.yaml"
    write_scene(scene, path)
    assert load(str(path)).control == scene.control


def test_an_mjcf_holds_the_control_of_the_start(scene, tmp_path):
    path, report = tmp_path / "driven.xml", scene_report(scene)
    write_as(scene, path, report)
    assert any("rail" in entry.element for entry in report.of("left out"))
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    assert data.actuator_force == pytest.approx([CONSTANT + STIFFNESS * TARGET])


@pytest.mark.parametrize("name", ["target", "feedforward"])
def test_only_numbers_and_functions_are_taken(name):
    with pytest.raises(MechanismError, match=name):
        PD(**{"joint": "rail", "stiffness": 0.0, "damping": 0.0, "target": 0.0, name: "sin(t)"})


def test_parameters_of_a_target_are_what_it_is_linear_in():
    scene = driven(LAWS["target"])
    values = parameter_values(scene, ["rail.target"])
    assert len(values["rail.target"]) == 4
    run = newton_euler.simulate(with_values(scene, {"rail.target": 2.0 * values["rail.target"]}))
    assert run.position[:, 1, 2] == pytest.approx(2.0 * expected(run.time), abs=1e-9)  # rtol 1e-10 a step


def test_coverage_sees_a_law_that_begins_at_zero():
    law = PD("rail", 0.0, 0.0, 0.0, feedforward=Sine(1.0, 7.0))
    scene = mass_on_rail(duration=1.0, control=(law,))
    covered = covered_by(scene, 1e-8, 1e-8)
    assert {each.element for each in covered.untested} == {"inertia of body 'mass'"}
