"""Sampled controllers in all engines: exact motions under held forces, who is called when, and refusals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from mechanisms import CART, carts, slider_tree
from simulations import SIMULATIONS

import mjcf
import newton_euler
import urdf
from mjcf.model import MujocoScene
from mjcf.rigid import RigidMuJoCo
from mjcf.soft import SoftMuJoCo
from mjcf.write import to_xml
from newton_euler.equations.relative import Relative
from newton_euler.errors import OptionError
from newton_euler.integrators.options import Options
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Sampled
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError, Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import run
from urdf.dynamics import PinocchioSystem

FIXED: dict[str, Callable[[Scene], Trajectory]] = {
    # 4 ms fit neither between outputs nor between samples
    "relative": partial(newton_euler.simulate, integrator="RK4", step=4e-3),
    "pinocchio": partial(urdf.simulate, integrator="RK4", step=4e-3),
}

FORCES = np.array([3.0, -2.0, 0.0, 5.0, -7.0, 1.0, 2.5, -4.0])
"""N, held in turn, again and again."""


class Recorder:
    """A controller that plays `FORCES` and keeps what it was called with."""

    def __init__(self) -> None:
        self.calls: list[tuple[float, np.ndarray, np.ndarray]] = []

    def __call__(self, time: float, x: np.ndarray, x_rate: np.ndarray) -> float:
        self.calls.append((time, x.copy(), x_rate.copy()))
        x[:], x_rate[:] = np.nan, np.nan  # what it does to its own copies is nobody's business
        return FORCES[(len(self.calls) - 1) % len(FORCES)]


def exact(times: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, speed and force (n,) of a cart under `FORCES` at a period; new forces hold at instants."""
    k = np.floor(times / period + 1e-9).astype(int)
    forces = np.resize(FORCES, k.max() + 1)
    speeds = np.concatenate([[0.0], np.cumsum(forces / CART * period)])
    positions = np.concatenate(
        [[0.0], np.cumsum(speeds[:-1] * period + 0.5 * forces / CART * period**2)],
    )
    rest = times - k * period
    a = forces[k] / CART
    return positions[k] + speeds[k] * rest + 0.5 * a * rest**2, speeds[k] + a * rest, forces[k]


@pytest.mark.parametrize(
    "simulate", [*SIMULATIONS.values(), *FIXED.values()], ids=[*SIMULATIONS, *map("{} RK4".format, FIXED)]
)
@pytest.mark.parametrize("period", [0.02, 0.0075, 0.028, 0.6])
def test_a_cart_under_held_forces(simulate, period):
    """Periods that divide the time between outputs, that do not, and one that is longer than the run."""
    scene = carts(Sampled("rail_0", Recorder(), period))
    found = simulate(scene)
    x, x_rate, force = exact(scene.times, period)
    # constant accelerations: exact up to round-off of centimeters and of 250 steps
    assert np.max(np.abs(found.position[:, 1, 0] - x)) < 1e-14
    assert np.max(np.abs(found.linear_velocity[:, 1, 0] - x_rate)) < 1e-13
    assert np.array_equal(found.time, scene.times)
    # at the end of the run no controller is called
    assert np.array_equal(found.actuator_force[:-1, 0], force[:-1])
    assert np.max(np.abs(found.position[:, 2, 0])) == 0.0


@pytest.mark.parametrize("simulate", SIMULATIONS.values(), ids=SIMULATIONS)
def test_who_is_called_when_with_what(simulate):
    """3 * 0.1 is not 0.3 to the last bit: one instant all the same, and the output's own time."""
    fast, slow = Recorder(), Recorder()
    scene = carts(PD("rail_1", 0.0, 0.0, 0.0), Sampled("rail_0", fast, 0.1), duration=1.0, output_period=0.05)
    scene = replace(scene, control=(Sampled("rail_1", slow, 0.3), Sampled("rail_0", fast, 0.1)))
    simulate(scene)
    assert [time for time, _, _ in slow.calls] == [scene.times[k] for k in (0, 6, 12, 18)]
    assert [time for time, _, _ in fast.calls] == [scene.times[k] for k in range(0, 20, 2)]
    for recorder in (fast, slow):
        for time, x, x_rate in recorder.calls:
            of_slow, of_fast = (exact(np.array([time]), period) for period in (0.3, 0.1))
            # round-off of a meter and of a thousand steps
            assert x == pytest.approx([of_slow[0][0], of_fast[0][0]], abs=1e-13)
            assert x_rate == pytest.approx([of_slow[1][0], of_fast[1][0]], abs=1e-13)


def driven_tree(*recorders: Recorder) -> Scene:
    """Laws on joints of one and of two coordinates, in both directions, against the tree's order."""
    tree = slider_tree()
    driven = ("rail", "sleeve_on_cart", "collar_on_sleeve")
    joints = [replace(joint, actuated=joint.name in driven) for joint in tree.mechanism.joints]
    control = (
        Sampled("collar_on_sleeve", recorders[0], 0.05),
        Sampled("sleeve_on_cart", recorders[1], 0.1, coordinate=1),
        PD("rail", 200.0, 5.0, 0.1),
        Sampled("sleeve_on_cart", recorders[2], 0.1),
    )
    mechanism = Mechanism(tree.mechanism.bodies, joints)
    return replace(tree, mechanism=mechanism, control=control, initial_state=None, duration=0.5)


@pytest.mark.slow
def test_controllers_of_a_tree_see_the_same_in_all_engines():
    seen, ends = {}, {}
    for name, simulate in SIMULATIONS.items():
        recorders = [Recorder() for _ in range(3)]
        ends[name] = simulate(driven_tree(*recorders)).position[-1]
        assert [len(recorder.calls) for recorder in recorders] == [10, 5, 5], name
        seen[name] = np.array([[*x, *x_rate] for _, x, x_rate in recorders[0].calls])
    wanted = seen["relative"]
    assert np.min(np.max(np.abs(wanted), axis=0)) > 0.05  # m, rad, m/s, rad/s: all of them move
    for name, found in seen.items():
        # meters and radians at rtol 1e-10; MuJoCo's RK4 at 1 ms without loops
        assert np.max(np.abs(found - wanted)) < 1e-8, name
        assert np.max(np.abs(ends[name] - ends["relative"])) < 1e-8, name


@pytest.mark.parametrize("simulate", SIMULATIONS.values(), ids=SIMULATIONS)
@pytest.mark.parametrize(
    ("result", "words"),
    [
        (ZeroDivisionError("no\nluck"), "failed: ZeroDivisionError: no luck"),
        (float("nan"), "returned nan"),
        (None, "returned None"),
        (np.ones((3, 1)), "returned array([[1.], [1.], [1.]])"),
    ],
)
def test_controllers_that_fail_are_named(simulate, result, words):
    def controller(time: float, x: np.ndarray, x_rate: np.ndarray) -> float:
        if time < 0.05:
            return 0.0
        if isinstance(result, Exception):
            raise result
        return result

    scene = carts(Sampled("rail_0", Recorder(), 0.03), Sampled("rail_1", controller, 0.02))
    with pytest.raises(IntegrationError) as caught:
        simulate(scene)
    assert str(caught.value) == f"integration stopped at t = 0.06 s: controller of joint 'rail_1' {words}"
    assert caught.value.time == pytest.approx(0.06, abs=1e-15)  # a multiple up to round-off


@pytest.mark.parametrize("build", [Relative, PinocchioSystem, RigidMuJoCo])
def test_a_run_leaves_the_system_as_it_was(build):
    """Held forces of one run are not those of the next, nor those of the scene."""
    system = build(carts(Sampled("rail_0", Recorder(), 0.02)))
    run(system, system.name, Options(), {})
    evaluation = system.evaluate(*system.coordinates(initial_state(system.scene)))
    assert np.array_equal(evaluation.actuator_force, [0.0])
    assert not np.any(evaluation.linear_acceleration)


@pytest.mark.parametrize("system", [Relative, PinocchioSystem, RigidMuJoCo, SoftMuJoCo])
def test_single_states_have_the_force_that_is_held(system):
    built = system(carts(Sampled("rail_1", Recorder(), 0.02, held=3.0)))
    evaluation = built.evaluate(*built.coordinates(initial_state(built.scene)))
    assert np.array_equal(evaluation.actuator_force, [3.0])
    assert evaluation.linear_acceleration[2] == pytest.approx([3.0 / CART, 0.0, 0.0], abs=1e-15)


def test_mjcf_has_a_motor_with_the_held_force():
    scene = carts(PD("rail_0", 5.0, 1.0, 0.25), Sampled("rail_1", Recorder(), 0.02, held=3.0))
    assert '<motor name="rail_1" joint="rail_1" />' in to_xml(scene)
    assert 'ctrl="0.25 3"' in to_xml(scene)
    assert np.array_equal(MujocoScene(scene).data.ctrl, [0.25, 3.0])


@pytest.mark.parametrize(
    ("output_period", "duration", "periods", "timestep"),
    [
        (0.01, 0.2, (0.007,), 1e-3),
        (0.01, 0.2, (0.0075,), 2.5e-3 / 3),
        (0.01, 0.2, (0.0075, 0.0004), 1e-4),
        (0.01, 0.2, (1.0 / 30.0,), 1.0 / 1200.0),
        (0.01, 0.2, (0.2 / np.pi, np.pi), None),  # pi s are not over within the run
        (1.0, 0.2, (0.007,), 1e-3),
        (5e-7, 1e-6, (1e-6,), 5e-7),  # no shorter than what the scene asks for
    ],
)
def test_steps_divide_outputs_and_periods(output_period, duration, periods, timestep):
    laws = (Sampled(f"rail_{k}", Recorder(), period) for k, period in enumerate(periods))
    scene = carts(*laws, duration=duration, output_period=output_period)
    if timestep is None:
        with pytest.raises(OptionError, match=r"^period of joint 'rail_0' is 0\.0636.* 0\.01 s"):
            mjcf.simulate(scene)
        return
    found = mjcf.simulate(scene)
    assert found.settings["timestep"] == pytest.approx(timestep, rel=1e-9)
    x, _, _ = exact(scene.times, periods[0])
    assert np.max(np.abs(found.position[:, 1, 0] - x)) < 1e-14  # round-off of centimeters


@pytest.mark.parametrize(
    ("timestep", "words"),
    [
        (2e-3, "timestep is 0.002; needed: a divisor of the 0.007 s period of joint 'rail_0', such as 0.001"),
        (3e-3, "timestep is 0.003; needed: a divisor of the 0.01 s between outputs, such as 0.001"),
    ],
)
def test_a_step_that_does_not_divide_is_refused(timestep, words):
    scene = carts(Sampled("rail_0", Recorder(), 0.007))
    with pytest.raises(OptionError) as caught:
        mjcf.simulate(scene, timestep=timestep)
    assert str(caught.value) == words
