"""Reactions of redundant constraints at many states at once, against those of each state by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from constrained_motion import states_near_start
from mechanisms import parallel_cranks

import newton_euler
from newton_euler.compiled.outputs import minimum_norm_reactions
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import at_time
from newton_euler.errors import SingularityError
from newton_euler.model.armatures import Armature
from newton_euler.model.control import PD, ComputedTorque
from newton_euler.model.forces import JointSpring, PointSpring, Wrench
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Spline, Steps
from newton_euler.model.trajectory import IntegrationError
from newton_euler.model.wind import WindLoad

TIMES = np.array([0.0, 0.2, 0.5, 0.8])

SPLINE = Spline(np.linspace(0.0, 1.0, 11), np.sin(np.linspace(0.0, 3.0, 11)))
STEPS = Steps([0.0, 0.4, 0.6], [1.0, -2.0, 3.0])

ELEMENTS = {
    "laws": {
        "control": (
            PD("foot_0", 5.0, 0.5, target=SPLINE, feedforward=STEPS, gravity_compensation=True),
            PD("head_1", 2.0, 0.1, target=Sum((Sine(0.1, 30.0), Polynomial((0.0, 1.0))))),
        )
    },
    "computed torque": {"control": (ComputedTorque("foot_0", 100.0, 20.0, target=Sine(0.2, 20.0)),)},
    "motion": {"motions": (PrescribedMotion("foot_1", Sine(0.2, 10.0)),)},
    "forces": {
        "forces": (
            JointSpring("head_2", stiffness=3.0, damping=0.2),
            PointSpring(
                "cord",
                "ground",
                "beam",
                [0.5, 0.2, 0.0],
                [0.6, 0.0, 0.3],
                stiffness=50.0,
                rest_length=0.1,
                damping=1.0,
            ),
            Wrench("push", "beam", [0.3, 0.1, 0.3], force=[1.0, 2.0, 3.0], torque=[0.1, 0.2, 0.3]),
            WindLoad(
                "wind",
                "beam",
                [0.4, 0.0, 0.3],
                first_side=[0.6, 0.0, 0.0],
                second_side=[0.0, 0.4, 0.0],
                direction=[1.0, 0.0, -1.0],
                speed=SPLINE,
            ),
        ),
        "armatures": (Armature("foot_0", 0.02), Armature("head_2", 0.01)),
    },
}


def actuated_cranks(**elements):
    """Three parallel cranks, redundant, with actuators at all joints and these elements."""
    scene = parallel_cranks()
    joints = [replace(joint, actuated=True) for joint in scene.mechanism.joints]
    return replace(scene, mechanism=Mechanism(scene.mechanism.bodies, joints), initial_state=None, **elements)


@pytest.mark.parametrize("form", [Relative, Cartesian])
@pytest.mark.parametrize("elements", ELEMENTS.values(), ids=list(ELEMENTS))
def test_reactions_at_several_states_are_those_of_each_state(form, elements):
    scene = actuated_cranks(**elements)
    system = form(scene)
    coordinates = [system.coordinates(state) for state in states_near_start(scene, len(TIMES))]
    found = minimum_norm_reactions(system, TIMES, np.array([np.concatenate(pair) for pair in coordinates]))
    for k, (time, (q, v)) in enumerate(zip(TIMES, coordinates, strict=True)):
        alone = at_time(system, time).evaluate(q, v)
        for several, one in zip(found, (alone.reaction_force, alone.reaction_torque), strict=True):
            # the same operations in another order: round-off of matrices of condition below 1e5
            assert several[k] == pytest.approx(one, rel=0.0, abs=1e-10 * (1.0 + np.abs(one).max()))


def test_a_state_without_reactions_stops_the_run_at_its_time(monkeypatch):
    scene = parallel_cranks()
    solve = Relative.solve

    def failing(self, q, v):
        if np.any(getattr(self.time, "numbers", self.time) > 0.045):
            raise SingularityError("foot_0", "for this test")
        return solve(self, q, v)

    monkeypatch.setattr(Relative, "solve", failing)
    with pytest.raises(IntegrationError) as raised:
        newton_euler.simulate(replace(scene, outputs=scene.outputs | {"reactions"}))
    first = scene.times[scene.times > 0.045][0]
    assert raised.value.time == first
    assert "foot_0" in raised.value.reason
