"""Rests that are skipped: a mechanism that its laws hold stays where it is until a set-point jumps."""

from dataclasses import replace

import numpy as np
import pytest

import urdf
from crosscheck.library import load
from newton_euler import Sine, Steps, simulate, simulate_batch
from newton_euler.errors import OptionError


@pytest.fixture(scope="module")
def stepped():
    """The tracker, its sliders sent to other heights every minute."""
    scene, times = load("tracker"), np.arange(0.0, 600.0, 60.0)
    heights = np.linspace(1.0, 0.2, len(times))
    control = tuple(replace(law, target=Steps(times, law.target * heights)) for law in scene.control)
    return replace(scene, control=control, duration=600.0, output_period=7.0)


@pytest.mark.parametrize("rest", [1e-6, 1e-9])
def test_a_rest_that_is_skipped_moves_bodies_by_less_than_its_rate_times_the_time_constant(stepped, rest):
    whole, skipped = simulate(stepped), simulate(stepped, rest=rest)
    assert skipped.settings["steps"] < 0.25 * whole.settings["steps"]
    # modes of the sliders die away in 0.5 s; bodies move up to twice as far as these; 1e-11 m of both runs
    assert np.max(np.abs(skipped.position - whole.position)) < 2.0 * 0.5 * rest + 1e-11
    assert np.max(np.abs(skipped.work - whole.work)) < 1e-9  # J, of some 1e-2


def test_batches_skip_rests_too(stepped):
    (run,) = simulate_batch(stepped, parameters={"panel_7.mass": [0.07]}, rest=1e-6)
    assert run.settings["steps"] < 10_000


def test_rests_are_skipped_only_where_nothing_depends_on_time(stepped):
    moving = tuple(replace(law, feedforward=Sine(1.0, 2.0)) for law in stepped.control)
    scene = replace(stepped, control=moving)
    with pytest.raises(OptionError, match=r"rest is 1e-06.*other than Steps and Moves"):
        simulate(scene, rest=1e-6)
    moving = tuple(replace(law, target=Sine(1.0, 2.0)) for law in load("tracker").control)
    with pytest.raises(OptionError, match=r"rest is 1e-06.*other than Steps and Moves"):
        simulate_batch(replace(scene, control=moving), parameters={"panel_7.mass": [0.07]}, rest=1e-6)


@pytest.mark.parametrize(
    ("options", "message"), [({"rest": -1.0}, "0 or more"), ({"rest": 1.0, "integrator": "Radau"}, "Radau")]
)
def test_what_rest_cannot_be(stepped, options, message):
    with pytest.raises(OptionError, match=message):
        simulate(stepped, **options)
    with pytest.raises(OptionError, match=r"rest is 1e-06.*pinocchio"):
        urdf.simulate(stepped, rest=1e-6)
