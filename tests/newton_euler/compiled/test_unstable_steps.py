"""Fixed steps that are too long for the rates of a motion: the limit is stated, and no singular joint."""

from __future__ import annotations

import signal
from dataclasses import replace

import numpy as np
import pytest

from crosscheck.library import load
from newton_euler.compiled.callbacks import Callbacks
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.failures import STABILITY_LIMITS, fastest_rate, first_above
from newton_euler.compiled.run import Integrator
from newton_euler.integrators.options import Options
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Prismatic, Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate
from newton_euler.runs.variation import start

FORMULATIONS = ("relative", "cartesian")

G = 9.81


def stiff_slides():
    """Return two slides in a row with a spring between them, and its rate sqrt(2 k / m), 1/s."""
    bodies = [Body(name, 1.0, [x, 0.0, 0.0], 0.01 * np.eye(3)) for name, x in (("a", 0.0), ("b", 0.3))]
    along = {"axis": np.array([1.0, 0.0, 0.0])}
    slides = [
        Prismatic("p", "ground", "a", np.zeros(3), **along),
        Prismatic("q", "a", "b", np.array([0.3, 0.0, 0.0]), **along),
    ]
    springs = [JointSpring("p", stiffness=50.0), JointSpring("q", stiffness=1e8)]
    scene = Scene("slides", Mechanism([Body.ground(), *bodies], slides), 1.0, 0.02, forces=springs)
    return start(scene, p=(0.1, 0.0), q=(1e-6, 0.0)), np.sqrt(2e8)


def stiff_windows():
    """Return two four-bar windows of bars of 1 kg and 1 m with a spring at a pivot, and its rate, 1/s.

    Kinetic energy is that of three bars about their ends and of two couplers, all of 1 rad/s.
    """
    scene, stiffness = load("four_bar"), 1e8
    inertia, weight = 3.0 / 3.0 + 2.0, 3.0 / 2.0 + 2.0
    spring = JointSpring("pivot_0", stiffness=stiffness)
    return replace(scene, forces=[spring]), np.sqrt((stiffness - weight * G) / inertia)


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("make", [stiff_slides, stiff_windows])
def test_the_fastest_rate_is_that_of_the_stiff_spring(make, formulation):
    scene, rate = make()
    code = CompiledEquations(scene, formulation)
    x = code.packed(*code.system.coordinates(scene.initial_state))
    assert fastest_rate(code, x) == pytest.approx(rate, rel=1e-3)


@pytest.mark.parametrize("stabilization", ["projection", "baumgarte", "none"])
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("make", [stiff_slides, stiff_windows])
@pytest.mark.parametrize("integrator", ["RK4", "Euler"])
def test_a_step_that_is_too_long_is_no_singular_configuration(make, integrator, formulation, stabilization):
    scene, rate = make()
    with pytest.raises(IntegrationError) as caught:
        simulate(scene, formulation, integrator, step=1e-3, stabilization=stabilization)
    assert "singular" not in str(caught.value)
    assert f"{STABILITY_LIMITS[integrator] / rate:.2g} s" in str(caught.value)
    assert len(str(caught.value)) < 600


def snapping_links():
    """Return four bars from the ground to a ball: two heavy ones, and two light ones that snap straight."""
    angles = np.linspace(np.pi, -0.6, 5)
    ring = 0.5 * np.column_stack([np.cos(angles) + 1.0, np.zeros(5), np.sin(angles)])
    bodies, joints = [Body.ground()], []
    for k, mass in enumerate([1.0, 1e-6, 1e-6, 1.0]):
        center, inertia = 0.5 * (ring[k] + ring[k + 1]), mass * np.diag([0.01, 0.011, 0.009])
        joints.append(Revolute(f"j{k}", bodies[k].name, f"b{k}", ring[k], axis=np.array([0.0, 1.0, 0.0])))
        bodies.append(Body(f"b{k}", mass, center, inertia))
    joints.append(Spherical("end", "b3", "ground", ring[4]))
    return Scene("snap", Mechanism(bodies, joints), 0.5, 0.05, gravity=[0.0, 0.0, -G])


@pytest.mark.parametrize(
    ("rates", "found"),
    [
        ([1.0] * 150 + [3.0] * 59, (150, 3.0)),
        ([1.0] * 150 + [3.0] * 58 + [0.0], (150, 3.0)),  # as of a state that has left the motion
        ([1.0] * 208 + [3.0], (208, 3.0)),
        ([3.0] * 209, (0, 3.0)),
        ([1.0] * 209, (0, 0.0)),
        ([1.0], (0, 0.0)),
        ([], (0, 0.0)),
    ],
)
def test_few_states_are_examined_for_the_first_one_whose_rate_is_too_high(rates, found):
    examined = []
    assert first_above(lambda number: examined.append(number) or rates[number], len(rates), 2.0) == found
    assert len(examined) <= 15


@pytest.mark.parametrize("how", ["signal", "other thread"])
def test_an_interrupt_reaches_a_run_that_is_repeated_to_explain_it(monkeypatch, how):
    """Most of the time of a failed run may be that of its explanation."""
    scene = replace(snapping_links(), output_period=0.5)
    code, stopped, made = CompiledEquations(scene), [], []
    pause, make = Callbacks._pause, Integrator.__init__

    def interrupting(self, *arguments):
        if len(made) == 2:
            signal.raise_signal(signal.SIGINT) if how == "signal" else stopped.append(True)
        pause(self, *arguments)

    def counting(self, *arguments):
        made.append(self)
        make(self, *arguments)

    monkeypatch.setattr(Callbacks, "_pause", interrupting)
    monkeypatch.setattr(Integrator, "__init__", counting)
    integrator = Integrator(code, scene.times, Options.of("RK4", {"step": 1e-3}), stopped)
    with pytest.raises(KeyboardInterrupt):
        integrator(code.packed(*code.system.coordinates(initial_state(scene))))
    assert len(made) == 2


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_step_that_becomes_too_long_on_the_way_is_no_singular_configuration(formulation):
    """At the outputs the step is short enough; DOP853 takes shorter ones between two of them."""
    scene = snapping_links()
    run = simulate(scene, formulation, rtol=1e-8, atol=1e-10)
    assert run.time[-1] == pytest.approx(0.5)
    with pytest.raises(IntegrationError) as caught:
        simulate(scene, formulation, "RK4", step=1e-3)
    assert 0.35 < caught.value.time < 0.45
    assert "singular" not in str(caught.value)
    assert "DOP853" in str(caught.value)
