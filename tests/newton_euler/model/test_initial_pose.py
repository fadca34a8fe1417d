"""Scenes described at another initial pose: the same accelerations, reactions and controllers' forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS
from ball_scenes import with_balls
from elements import COUPLED, ELEMENTS
from mechanisms import ball_loop, bar, carts

from newton_euler.compiled.formulations import formulate
from newton_euler.errors import MechanismError
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.digital_control import Digital, Sampled
from newton_euler.model.geometry import Box, Cylinder, Mesh, Sphere
from newton_euler.model.initial_pose import described_at
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Spline, Steps
from newton_euler.reading.excitation import random_states
from newton_euler.runs.simulate import simulate

TURNING = {"forces, slider_tree", "forces, planar, reversed", "forces, motions of a tree"}
"""Scenes with forces along slides that turn with a body."""

SCENES = {**ELEMENTS, **COUPLED, **COMPOUNDS, "balls": with_balls(ball_loop())}


@pytest.mark.parametrize("title", [title for title in SCENES if title not in TURNING])
def test_accelerations_are_those_of_the_scene(title):
    scene = SCENES[title]
    there, state = random_states(scene, 2, seed=5)
    system, other = (formulate(each, "relative") for each in (scene, described_at(scene, there)))
    expected = system.evaluate(*system.coordinates(state))
    found = other.evaluate(*other.coordinates(state))
    for quantity in ("linear_acceleration", "angular_acceleration", "reaction_force"):
        needed = getattr(expected, quantity)
        # dense linear algebra of matrices of condition 1e4
        assert np.abs(getattr(found, quantity) - needed).max() < 1e-11 * max(1.0, np.abs(needed).max())


@pytest.mark.parametrize("title", sorted(TURNING))
def test_slides_that_turn_are_refused(title):
    scene = SCENES[title]
    (there,) = random_states(scene, 1, seed=5)
    with pytest.raises(MechanismError, match="has slides that turn with its first body"):
        described_at(scene, there)


LAWS = {
    "sine": PD("rail_0", 50.0, 5.0, Sine(0.2, 5.0)),
    "polynomial": PD("rail_0", 50.0, 5.0, Polynomial((0.1, 0.5))),
    "spline": PD("rail_0", 50.0, 5.0, Spline((0.0, 0.1, 0.2, 0.3), (0.0, 0.1, 0.0, 0.1))),
    "steps": PD("rail_0", 50.0, 5.0, Steps((0.0, 0.1), (0.1, 0.2))),
    "feedback": StateFeedback("rail_0", {"rail_0": (20.0, 3.0), "rail_1": (5.0, 1.0)}, target=0.1),
    "computed torque": ComputedTorque("rail_0", 100.0, 20.0, 0.1),
    "digital": Digital(PD("rail_0", 50.0, 5.0, 0.3), period=0.01, stroke=(-0.1, 0.2)),
    "sampled": Sampled("rail_0", lambda time, x, x_rate: -5.0 * float(x[0]) - x_rate[0], 0.01),
}


@pytest.mark.parametrize("name", LAWS)
def test_laws_have_the_same_forces(name):
    scene = carts(LAWS[name])
    (start,) = random_states(scene, 1, seed=2)
    scene = replace(scene, initial_state=start)
    other = replace(described_at(scene, start), initial_state=start)
    expected, found = simulate(scene), simulate(other)
    # both are integrated to 1e-10
    assert np.abs(found.position - expected.position).max() < 1e-9
    assert np.abs(found.actuator_force - expected.actuator_force).max() < 1e-7


@pytest.mark.parametrize(
    ("law", "message"),
    [
        (Digital(PD("rail_0", 1.0, 1.0, 0.0), period=0.01, resolution=1e-3), "has an encoder with marks"),
        (
            ComputedTorque("rail_0", 1.0, 1.0, 0.0, model={"push.force": [1.0, 0.0, 0.0]}),
            "knows 'push.force'",
        ),
    ],
)
def test_what_cannot_be_said_is_refused(law, message):
    (there,) = random_states(carts(LAWS["feedback"]), 1, seed=2)
    with pytest.raises(MechanismError, match=message):
        described_at(carts(law), there)


def test_shapes_move_with_their_bodies():
    """A quarter of a revolution about z takes x to y."""
    corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    rod = replace(
        bar("rod", [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]),
        shapes=(Cylinder([0, 0, 0], [1, 0, 0], 0.1), Sphere([1, 0, 0], 0.2), Box([0.3, 0.2, 0.1], [1, 0, 0])),
        meshes=(Mesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),),
    )
    hinge = Revolute("pivot", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0])
    scene = Scene("rod", Mechanism([Body.ground(), rod], [hinge]), 1.0, 0.1)
    system = formulate(scene, "relative")
    moved = described_at(scene, system.state(np.array([0.5 * np.pi]), np.zeros(1))).mechanism.bodies[1]
    bar_, ball, box = moved.shapes
    ends = [bar_.end, ball.center, box.center, moved.meshes[0].vertices[1]]
    assert np.allclose(ends, [0.0, 1.0, 0.0], atol=1e-15)  # sines of a right angle
    assert np.allclose(box.quaternion, [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], atol=1e-15)
