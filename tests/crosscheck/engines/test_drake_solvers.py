"""Runs by Drake's own solvers: errors and orders, what they refuse, and that nothing ends the process."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from elements import COUPLED, ELEMENTS
from mechanisms import GRAVITY, bar, pendulum

pytest.importorskip("pydrake")

from crosscheck.engines.drake import ENGINE
from crosscheck.engines.drake.equations import DrakeSystem
from crosscheck.engines.drake.solvers import limits_of_solver, simulate_with
from crosscheck.engines.limits import CannotExpressError
from crosscheck.library import load
from newton_euler import simulate as reference
from newton_euler.errors import OptionError, SingularityError, UnknownNameError
from newton_euler.model.control import PD
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.trajectory import IntegrationError, distance
from newton_euler.reading.switched_loads import SwitchedLoad

TREES = {"pendulum", "free_top", "heavy_top", "chain", "flyball_governor"}
"""Scenes of the library without loops, couplings and prescribed motions."""


COARSE = ({"solver": "SAP", "step": 0.01}, {"solver": "runge_kutta5", "accuracy": 1e-4})
"""Settings of runs whose errors do not matter."""


def errors(scene, *settings):
    """Return how far runs are from newton_euler's, m or rad."""
    exact = reference(scene, rtol=1e-12, atol=1e-14)
    return [distance(ENGINE.simulate(scene, each), exact) for each in settings]


def short(name, duration, outputs=5):
    """Return a scene of the library with another duration."""
    return replace(load(name), duration=duration, output_period=duration / outputs)


@pytest.mark.parametrize(
    ("name", "duration", "step"),
    [
        ("pendulum", 0.5, 2e-3),
        ("chain", 0.2, 2e-3),
        ("four_bar", 0.5, 2e-3),  # a ball
        ("bricard", 0.2, 2e-3),  # a weld
        ("flyball_governor", 0.012, 2e-4),  # stiff springs
        ("tracker", 0.1, 1e-2),  # forces from Python
    ],
)
def test_sap_is_of_order_1(name, duration, step):
    scene = short(name, duration)
    coarse, fine = errors(scene, *({"solver": "SAP", "step": each} for each in (step, 0.5 * step)))
    assert 1e-6 < fine < 0.05  # the reference is accurate to 1e-11
    assert coarse / fine == pytest.approx(2.0, rel=0.15)


def test_sap_holds_loops():
    """Drake's constraints are nearly rigid: their compliance grows with the square of the step."""
    violations = [
        np.max(simulate_with(short("four_bar", 0.2), "SAP", step=step).constraint_violation)
        for step in (1e-2, 1e-3)
    ]
    assert violations[1] < 1e-7
    assert violations[0] / violations[1] == pytest.approx(100.0, rel=0.3)


@pytest.mark.parametrize(("name", "duration"), [("pendulum", 1.0), ("chain", 0.2)])
def test_runge_kutta_follows_its_accuracy(name, duration):
    scene = short(name, duration)
    coarse, fine = errors(scene, *({"solver": "runge_kutta5", "accuracy": each} for each in (1e-7, 1e-11)))
    # the accuracy is that of a step: errors of a run are the sum of those of some hundred steps
    assert fine < 1e-8
    assert coarse > 100.0 * fine


def test_balls_pass_the_singular_pitch_of_their_angles():
    """The top is at a pitch of 90 degrees after 0.75 s, where the rates of Drake's angles are singular."""
    (error,) = errors(short("heavy_top", 0.8), {"solver": "runge_kutta5", "accuracy": 1e-10})
    assert error < 1e-5  # at 157 rad/s; 7000 steps


@pytest.mark.parametrize(
    ("name", "solver", "largest"),
    [
        ("rods", "SAP", 1e-2),  # a body on a rod to the ground, where Drake's distance ends the process
        ("rods only", "SAP", 1e-2),
        ("wind, cut at a ball", "SAP", 1e-2),
        ("spring without length", "runge_kutta5", 1e-7),
    ],
)
def test_elements(name, solver, largest):
    scene = replace(ELEMENTS[name], duration=0.05, output_period=0.025)
    (error,) = errors(scene, {"solver": solver})
    assert error < largest


@pytest.mark.slow
@pytest.mark.parametrize("name", [*ELEMENTS, *COUPLED])
def test_all_elements_run_or_are_refused(name):
    scene = replace((ELEMENTS | COUPLED)[name], duration=0.01, output_period=0.005)
    for settings in ({"solver": "SAP", "step": 1e-4}, {"solver": "runge_kutta5"}):
        with suppress(CannotExpressError):
            # SAP is of order 1: forced elements reach 360 rad/s here
            assert errors(scene, settings)[0] < (0.1 if settings["solver"] == "SAP" else 1e-6)


def swing() -> Scene:
    """A bar on a hinge that follows a sine by a PD controller."""
    hinge = Revolute("hinge", "ground", "bar", np.zeros(3), axis=[0.0, 1.0, 0.2], actuated=True)
    mechanism = Mechanism([Body.ground(), bar("bar", [0.0, 0.0, 0.0], [0.4, 0.1, 0.0])], [hinge])
    law = PD("hinge", 5.0, 0.5, Sine(0.3, 2.0))
    return Scene("swing", mechanism, 0.4, 0.1, GRAVITY, control=(law,))


def test_work_of_a_control_law():
    scene = swing()
    exact = reference(scene, rtol=1e-12, atol=1e-14)
    by_accuracy, by_step = simulate_with(scene, "runge_kutta5", accuracy=1e-10), simulate_with(scene, "SAP")
    scale = np.max(np.abs(exact.work))
    np.testing.assert_allclose(by_accuracy.work, exact.work, atol=1e-7 * scale)
    np.testing.assert_allclose(by_step.work, exact.work, atol=1e-2 * scale)  # of order 1
    for quantity in ("actuator_force", "reaction_force"):
        needed = getattr(exact, quantity)
        found = getattr(by_accuracy, quantity)
        np.testing.assert_allclose(found, needed, atol=1e-6 * np.max(np.abs(needed)), err_msg=quantity)


def test_steps_divide_the_output_intervals():
    run = simulate_with(replace(pendulum(), duration=0.5, output_period=0.2), "SAP", step=0.03)
    assert run.settings["step"] == pytest.approx(0.025)  # 0.1 s remain for the last interval
    np.testing.assert_allclose(run.time, [0.0, 0.2, 0.4, 0.5])


@pytest.mark.parametrize("name", [*sorted(TREES), "four_bar", "tracker_on_boat"])
def test_runge_kutta_runs_trees_only(name):
    assert (not limits_of_solver(load(name), "runge_kutta5")) == (name in TREES)


@pytest.mark.parametrize("name", ["tracker_on_boat", "gear, cut", "motion, cut", "screw, cut"])
@pytest.mark.parametrize("solver", ["SAP", "runge_kutta5"])
def test_limits_of_solvers_are_refused(name, solver):
    scene = ELEMENTS[name] if name in ELEMENTS else load(name)
    with pytest.raises(CannotExpressError) as caught:
        ENGINE.simulate(scene, {"solver": solver})
    assert caught.value.engine == "drake"
    assert list(caught.value.limits) == limits_of_solver(scene, solver)


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        ({"solver": "cenic"}, UnknownNameError),
        ({"solver": "SAP", "accuracy": 1e-6}, OptionError),
        ({"solver": "SAP", "step": 0.0}, OptionError),
        ({"solver": "SAP", "step": 1e-12}, OptionError),
        ({"solver": "SAP", "step": np.nan}, OptionError),
        ({"solver": "runge_kutta5", "step": 1e-3}, OptionError),
        ({"solver": "runge_kutta5", "accuracy": 1e-20}, OptionError),
        ({"solver": "runge_kutta5", "accuracy": np.nan}, OptionError),
    ],
)
def test_impossible_settings(settings, error):
    with pytest.raises(error):
        ENGINE.simulate(pendulum(), settings)


def test_states_that_are_not_finite_do_not_end_the_process():
    """Drake would end the process (another one here, should it happen), also for states of diverging runs."""
    code = (
        "import numpy as np\n"
        "from dataclasses import replace\n"
        "from crosscheck.engines.drake.equations import DrakeSystem\n"
        "from crosscheck.engines.drake.solvers import simulate_with\n"
        "from crosscheck.library import load\n"
        "from newton_euler.errors import SingularityError\n"
        "from newton_euler.model.trajectory import IntegrationError\n"
        "from newton_euler.runs.assemble import initial_state\n"
        "for name in ('pendulum', 'heavy_top'):\n"
        "    system = DrakeSystem(load(name))\n"
        "    q, v = system.coordinates(initial_state(system.scene))\n"
        "    for bad in ((q + np.nan, v), (q, v + np.inf), (0.0 * q, v)):\n"
        "        try:\n"
        "            system.acceleration(*bad)\n"
        "        except SingularityError as error:\n"
        "            print(error.reason)\n"
        "top = replace(load('heavy_top'), duration=5.0, output_period=0.5)\n"
        "governor = replace(load('flyball_governor'), duration=2.0, output_period=0.5)\n"
        "for scene, step in ((top, 0.05), (governor, 0.1)):\n"
        "    try:\n"
        "        print('completed', simulate_with(scene, 'SAP', step=step).time[-1])\n"
        "    except IntegrationError as error:\n"
        "        print('stopped', error.time, len(error.partial.time))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.count("the state is not finite") >= 5
    assert done.stdout.count("completed") + done.stdout.count("stopped") == 2


def test_a_state_that_cannot_be_evaluated_ends_the_trajectory(monkeypatch):
    right = DrakeSystem.evaluate

    def evaluate(self, q, v):
        if self.time > 0.25:
            raise SingularityError("hinge", "no solution")
        return right(self, q, v)

    monkeypatch.setattr(DrakeSystem, "evaluate", evaluate)
    for settings in COARSE:
        with pytest.raises(IntegrationError, match="no solution") as caught:
            simulate_with(swing(), **settings)
        np.testing.assert_allclose(caught.value.partial.time, [0.0, 0.1, 0.2])


def test_a_force_that_is_not_finite_stops_the_run(monkeypatch):
    scene = swing()
    monkeypatch.setattr(
        "crosscheck.engines.drake.equations.coordinate_load",
        lambda element, motions, time, given: SwitchedLoad([np.nan if time > 0.25 else 0.0], [0.0], 0.0),
    )
    for solver in ("SAP", "runge_kutta5"):
        with pytest.raises(IntegrationError) as caught:
            simulate_with(scene, solver)
        assert caught.value.partial is not None
        assert 0.2 <= caught.value.partial.time[-1] <= 0.3
