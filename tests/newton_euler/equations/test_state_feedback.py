"""Feedback of several joint coordinates: a pole balanced on a cart, in all engines, and its parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import mass_on_rail

import mjcf
import newton_euler
import urdf
from crosscheck.compare.coverage import covered_by
from crosscheck.engines.energy import energy_balance
from mjcf.benchmark_kernels import compiled
from mjcf.errors import MjcfError
from mjcf.rigid import RigidMuJoCo
from mjcf.soft import SoftMuJoCo
from mjcf.write import to_xml
from newton_euler.equations.parameters import parameter_values, with_values
from newton_euler.equations.relative import Relative
from newton_euler.errors import MechanismError
from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.joint_kinds import Revolute, Translational
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.runs.assemble import initial_state
from urdf.dynamics import PinocchioSystem

GAINS = {"rail": (-2.0, -4.0), "pole": (-60.0, -16.0)}
"""N/m, N s/m, N/rad and N s/rad that keep the pole upright."""


def cart_pole(**settings) -> Scene:
    """A pole of 0.2 kg, 0.5 m up to its center, on a cart of 1 kg; the cart alone is driven."""
    cart = Body("cart", 1.0, [0.0, 0.0, 0.0], 0.01 * np.eye(3))
    pole = Body("pole", 0.2, [0.0, 0.0, 0.5], np.diag([0.02, 0.02, 1e-4]))
    rail = Translational("rail", "ground", "cart", [0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0], actuated=True)
    hinge = Revolute("pole", "cart", "pole", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
    mechanism = Mechanism([Body.ground(), cart, pole], [rail, hinge])
    law = StateFeedback("rail", GAINS, **settings)
    scene = Scene("cart_pole", mechanism, 1.0, 0.01, (0.0, 0.0, -9.81), control=(law,))
    return newton_euler.start(scene, pole=(0.1, 0.0))


def test_a_pole_stays_up_in_all_engines():
    scene = cart_pole(target=Sine(0.05, 3.0), targets={"pole": Sine(0.01, 5.0)}, feedforward=Sine(0.1, 8.0))
    runs = [newton_euler.simulate(scene), urdf.simulate(scene), mjcf.simulate(scene)]
    runs.append(newton_euler.simulate(scene, "cartesian"))
    for run in runs:
        assert np.max(np.abs(run.joint("pole").coordinates)) < 0.15  # rad: it stays up
        # m: rtol 1e-10, and MuJoCo's RK4 at 1 ms without loops, whose controls are those of each stage
        assert np.max(np.abs(run.position - runs[0].position)) < 1e-9
        assert np.max(np.abs(run.actuator_force - runs[0].actuator_force)) < 1e-7  # N, by gains of 60
        balance = energy_balance(scene, run)
        assert np.abs(balance.residual).max() / balance.scale < 1e-8  # of rtol, and of Simpson's rule


@pytest.mark.parametrize("build", [Relative, PinocchioSystem, RigidMuJoCo, SoftMuJoCo])
def test_single_states_have_the_force_of_their_time(build):
    scene = cart_pole(target=Sine(0.05, 3.0))
    now = build(scene)
    now.time = 0.3
    found = now.evaluate(*now.coordinates(initial_state(scene)))
    target = Sine(0.05, 3.0)
    expected = -2.0 * target.value(0.3) - 4.0 * target.rate(0.3) + 60.0 * 0.1
    assert found.actuator_force[0] == pytest.approx(expected, rel=1e-13)


def test_gains_of_its_own_coordinate_are_a_pd_law():
    own = PD("rail", 50.0, 4.0, 0.1, feedforward=2.0)
    feedback = StateFeedback("rail", {"rail": (50.0, 4.0)}, 0.1, feedforward=2.0)
    first, second = (
        newton_euler.simulate(mass_on_rail(duration=1.0, control=(law,))) for law in (own, feedback)
    )
    assert np.array_equal(first.position, second.position)


def test_gains_are_parameters():
    scene = cart_pole()
    values = parameter_values(scene, ["rail.gains"])
    assert values["rail.gains"].tolist() == [[-2.0, -4.0], [-60.0, -16.0]]
    code = newton_euler.compile_scene(scene, parameters=["rail.gains"])
    stronger = with_values(scene, {"rail.gains": 1.1 * values["rail.gains"]})
    run, expected = code.with_scene(stronger).simulate(), newton_euler.simulate(stronger)
    assert np.max(np.abs(run.position - expected.position)) < 1e-9  # m, at rtol 1e-10
    assert not np.array_equal(run.position, newton_euler.simulate(scene).position)
    assert covered_by(scene, 1e-8, 1e-8).elements[4].element == "actuator of joint 'rail'"


def test_targets_of_other_coordinates_are_parameters():
    """Numbers and what functions of time are linear in, one after the other."""
    scene = cart_pole()
    law = replace(scene.control[0], targets={"pole": Sine(0.1, 3.0, offset=0.02)})
    scene = replace(scene, control=(law,))
    assert parameter_values(scene, ["rail.targets"])["rail.targets"].tolist() == [0.1, 0.02]
    changed = with_values(scene, {"rail.targets": np.array([0.2, 0.02])})
    assert changed.control[0].targets == {("pole", 0): Sine(0.2, 3.0, offset=0.02)}


def test_mujocos_file_has_a_motor_with_the_force_of_the_start():
    assert '<motor name="rail" joint="rail" />' in to_xml(cart_pole())
    assert 'ctrl="5.99999999' in to_xml(cart_pole())
    with pytest.raises(MjcfError, match=r"control of joint 'rail': .*MuJoCo"):
        compiled(cart_pole())


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"gains": 3.0}, "gains is 3.0"),
        ({"gains": {"rail": (1.0,)}}, "gains of joint 'rail' is"),
        ({"gains": {"rail": (1.0, "x")}}, "gains of joint 'rail' is"),
        ({"gains": {3: (1.0, 1.0)}}, "joint is 3"),
        ({"targets": {"rail": 1.0}}, "targets has 'rail'"),
        ({"targets": {"door": 1.0}}, "targets has 'door'"),
        ({"target": "x"}, "target is 'x'"),
    ],
)
def test_what_is_no_feedback_is_refused(settings, words):
    with pytest.raises(MechanismError) as caught:
        StateFeedback(**({"joint": "rail", "gains": GAINS} | settings))
    assert words in str(caught.value)


@pytest.mark.parametrize("name", ["door", ("pole", 1)])
def test_coordinates_that_the_mechanism_lacks_are_refused(name):
    law = StateFeedback("rail", {name: (1.0, 0.0)})
    with pytest.raises(MechanismError, match="control of joint 'rail'"):
        replace(cart_pole(), control=(law,))
