"""Scenes that are too large: each limit is checked, and its problem names the setting that allows it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from mechanisms import bar, mass_on_rail, pendulum

from crosscheck.library import load
from crosscheck.library.size import check_functions, check_scene
from crosscheck.support.errors import CrosscheckError
from newton_euler import PD, Body, JointSpring, Mechanism, PrescribedMotion, Scene
from newton_euler.limits import changed
from newton_euler.model.joint_kinds import Fixed
from newton_euler.model.motions import Sum
from newton_euler.model.smooth_functions import Polynomial, Sine

RAIL = mass_on_rail(duration=1.0)


def driven(*terms):
    return replace(RAIL, motions=(PrescribedMotion("rail", Sum(terms)),), initial_state=None)


def turned(*coefficients):
    """A hinge in motion for 1 s, 2 pi rad a cycle."""
    motion = PrescribedMotion("pivot", Polynomial(coefficients))
    return replace(pendulum(), duration=1.0, motions=(motion,), initial_state=None)


def test_what_cannot_move_is_refused():
    shelf = bar("shelf", [0.0, 0.0, 1.0], [0.5, 0.0, 1.0])
    mechanism = Mechanism([Body.ground(), shelf], [Fixed("screws", "ground", "shelf", [0.0, 0.0, 1.0])])
    with pytest.raises(CrosscheckError, match="no body can move"):
        check_scene(Scene("shelf", mechanism, 1.0, 0.5))


@pytest.mark.parametrize(
    ("name", "most", "scene"),
    [
        ("bodies", 1, RAIL),
        ("velocities", 2, load("chain", N=3)),
        ("closures", 1, load("tracker")),
        ("mass_ratio", 1.5, load("tracker")),
        ("forces", 1, replace(RAIL, forces=(JointSpring("rail", 1.0),), control=(PD("rail", 1, 1, 0),))),
        ("terms", 2, driven(Sine(1.0, 1.0), Polynomial((0.0, 1.0)))),
        ("cycles", 3, driven(Sine(0.1, 30.0))),
        ("cycles", 15915, turned(1e5)),
        ("cycles", 15915, turned(0.0, 1e5)),
        ("steps", 999, RAIL),
        ("states", 21, RAIL),
    ],
)
def test_a_scene_at_a_limit_is_taken_and_one_above_it_refused(name, most, scene):
    with (
        changed({name: most}),
        pytest.raises(CrosscheckError, match=rf"to allow it: --set {name}=") as caught,
    ):
        check_scene(scene)
    needed = float(str(caught.value).rpartition("=")[2])
    with changed({name: needed}):
        check_scene(scene)


def test_many_slow_laws_are_not_many_cycles():
    """As a humanoid that is excited has: steps are as short as the fastest of them needs."""
    law = PD("rail", 0.0, 0.0, 0.0, feedforward=Sine(1.0, 10.0))
    check_functions("here", RAIL.mechanism, (), [law] * 300, duration=10.0)
    fast = replace(law, feedforward=Sine(1.0, 1e14))
    with pytest.raises(CrosscheckError, match="cycles"):
        check_functions("here", RAIL.mechanism, (), [fast], duration=10.0)
