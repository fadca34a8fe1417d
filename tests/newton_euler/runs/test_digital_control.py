"""Declared laws on a computer: each effect against a sequence worked out by hand, limits, and all engines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import mass_on_rail, slider_tree

import mjcf
import newton_euler
import urdf
from crosscheck.compare.coverage import covered_by
from newton_euler.errors import MechanismError
from newton_euler.model.control import PD, StateFeedback
from newton_euler.model.digital_control import Digital
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.trajectory import Trajectory

ENGINES: dict[str, Callable[[Scene], Trajectory]] = {
    "newton_euler": newton_euler.simulate,
    "pinocchio": urdf.simulate,
    "mujoco": mjcf.simulate,
}

PERIOD = 0.1
"""s."""

POSITIONS, RATES = [0.0, 0.13, 0.26, 0.4], [0.0, 0.5, 1.0, 2.0]
"""m and m/s at four instants."""

LAW = PD("rail", stiffness=10.0, damping=2.0, target=1.0)
"""Its force is 10 (1 - x) - 2 dx/dt."""


def forces(law: Digital) -> list[float]:
    """N, of a run on a single rail."""
    controller = law.controller_of([law])
    seen = zip(POSITIONS, RATES, strict=True)
    return [controller(PERIOD * k, np.array([x]), np.array([rate])) for k, (x, rate) in enumerate(seen)]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({}, [10.0, 7.7, 5.4, 2.0]),
        ({"delay": 2}, [0.0, 0.0, 10.0, 7.7]),
        # 0, 0.15, 0.25 and 0.4 m are read, and 0, 1.5, 1 and 1.5 m/s follow
        ({"resolution": 0.05}, [10.0, 5.5, 5.5, 3.0]),
        ({"force_limit": 5.0}, [5.0, 5.0, 5.0, 2.0]),
        ({"slew_limit": 30.0}, [3.0, 6.0, 5.4, 2.4]),
        ({"stroke": (-1.0, 0.5)}, [5.0, 2.7, 0.4, -3.0]),
        ({"stroke": (1.2, 2.0)}, [12.0, 9.7, 7.4, 4.0]),
        # the limit comes before the change, and that before the delay
        ({"force_limit": 5.0, "slew_limit": 30.0, "delay": 1}, [0.0, 3.0, 5.0, 5.0]),
    ],
)
def test_effects_one_by_one(settings, expected):
    law = Digital(LAW, PERIOD, **settings)
    assert forces(law) == pytest.approx(expected, abs=1e-14)  # round-off of 10 N
    assert forces(law) == pytest.approx(expected, abs=1e-14)  # it begins anew


def test_a_set_point_rests_at_the_end_of_the_stroke():
    """r = t, and dr/dt = 1 m/s only within the stroke."""
    law = Digital(replace(LAW, target=Polynomial((0.0, 1.0))), PERIOD, stroke=(0.05, 0.25))
    wanted = np.array([0.05, 0.1, 0.2, 0.25])
    rates = np.array([0.0, 1.0, 1.0, 0.0])
    assert forces(law) == pytest.approx(10.0 * (wanted - POSITIONS) + 2.0 * (rates - RATES), abs=1e-14)


def test_laws_read_others_by_the_encoders_there():
    laws = [
        Digital(StateFeedback("a", {"a": (1.0, 0.0), "b": (0.0, 1.0), "c": (10.0, 0.0)}), PERIOD),
        Digital(PD("b", 0.0, 0.0, 0.0), PERIOD, resolution=0.5),
    ]
    controller = laws[0].controller_of(laws)
    for x, expected in (([0.1, 0.3, 2.0], -20.1), ([0.2, 0.8, 2.0], -20.2 - 0.5 / PERIOD)):
        assert controller(0.0, np.array(x), np.zeros(3)) == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"law": 3.0}, "law is 3.0"),
        ({"period": 0.0}, "period is 0.0"),
        ({"delay": 1.5}, "delay is 1.5"),
        ({"delay": -1}, "delay is -1"),
        ({"delay": 10**9}, "delay is 1000000000; needed: a number of samples, 0 to 1000000"),
        ({"resolution": -1.0}, "resolution is -1.0"),
        ({"resolution": np.inf}, "resolution is inf"),
        ({"force_limit": 0.0}, "force_limit is 0.0"),
        ({"slew_limit": np.nan}, "slew_limit is nan"),
        ({"stroke": (1.0, 0.0)}, "stroke is"),
        ({"stroke": 1.0}, "stroke is 1.0"),
    ],
)
def test_what_no_computer_does_is_refused(settings, words):
    with pytest.raises(MechanismError) as caught:
        Digital(**({"law": LAW, "period": PERIOD} | settings))
    assert words in str(caught.value)


def test_short_periods_are_the_law_itself_to_first_order():
    """A force held for a period is half of it late, so that half the period has half the error."""
    law = PD("rail", 50.0, 4.0, Sine(0.1, 7.0))
    exact = newton_euler.simulate(mass_on_rail(duration=1.0, control=(law,))).position[:, 1, 2]
    errors = []
    for period in (0.01, 0.005, 0.0025):
        run = newton_euler.simulate(mass_on_rail(duration=1.0, control=(Digital(law, period),)))
        errors.append(np.max(np.abs(run.position[:, 1, 2] - exact)))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    # the next order is the period by the oscillator's 0.2 s of it, 5 % and less
    assert orders == pytest.approx(1.0, abs=0.05)


def digital_tree() -> Scene:
    """Laws with all effects on joints of one and of two coordinates."""
    tree = slider_tree()
    driven = ("rail", "sleeve_on_cart", "collar_on_sleeve")
    joints = [replace(joint, actuated=joint.name in driven) for joint in tree.mechanism.joints]
    gains = {"collar_on_sleeve": (20.0, 1.0), ("sleeve_on_cart", 1): (0.5, 0.1)}
    control = (
        Digital(StateFeedback("collar_on_sleeve", gains, target=0.05), 0.01, delay=1, force_limit=1.5),
        Digital(PD("rail", 200.0, 5.0, Sine(0.1, 5.0)), 0.02, resolution=1e-3, slew_limit=300.0),
        Digital(PD("sleeve_on_cart", 3.0, 0.2, 0.3, coordinate=1), 0.01, stroke=(-0.2, 0.2)),
    )
    mechanism = Mechanism(tree.mechanism.bodies, joints)
    return replace(tree, mechanism=mechanism, control=control, initial_state=None, duration=0.5)


def test_all_engines_agree():
    scene = digital_tree()
    runs = {name: simulate(scene) for name, simulate in ENGINES.items()}
    wanted = runs["newton_euler"]
    assert np.ptp(wanted.position[:, 1:], axis=0).max(axis=1).min() > 0.01  # m: all of them move
    for name, run in runs.items():
        # meters at rtol 1e-10, and MuJoCo's RK4 at 1 ms without loops
        assert np.max(np.abs(run.position - wanted.position)) < 1e-8, name
        # N, by the law's gains of some 100 N/m
        assert np.max(np.abs(run.actuator_force - wanted.actuator_force)) < 1e-5, name


def test_coverage_counts_a_digital_law_as_untested():
    """All engines share it, so that their agreement tells nothing of it, whatever it does."""
    scene = mass_on_rail(duration=1.0, control=(Digital(PD("rail", 50.0, 4.0, 0.1), 0.01),))
    covered = covered_by(scene, 1e-8, 1e-8)
    law = next(each for each in covered.elements if each.element == "actuator of joint 'rail'")
    assert law.shared
    assert {each.element for each in covered.untested} == {law.element, "inertia of body 'mass'"}
