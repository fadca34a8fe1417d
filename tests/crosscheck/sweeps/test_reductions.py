"""Reductions of runs: against those of trajectories, in any chunks, and texts that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from crosscheck.library import load
from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.expressions import Outputs
from crosscheck.sweeps.reductions import pruned, reductions
from newton_euler import simulate_batch
from newton_euler.model.euler_parameters import rotations

EXAMPLES = Path(__file__).parents[3] / "examples"

MASSES = {"dumbbell.mass": np.linspace(1.0, 2.0, 7)}

EXPRESSIONS = {
    "tilt": "final:angle(direction(dumbbell.quaternion, [1, 0, 0]), [1, 0, 0])",
    "below": "at(1; 2.5):-dumbbell.position.y / norm(dumbbell.position)",
    "falls": "when:dumbbell.position.y < -0.25",
    "never": "when:dumbbell.position.y > 100",
    "power": "mean:dot('dumbbell.linear_velocity', [0, 1, 0]) * 9.81",
}


@pytest.fixture(scope="module")
def runs():
    """A batch of pendulums, and its outputs."""
    batch = simulate_batch(load("pendulum"), parameters=MASSES)
    return batch, Outputs.of_batch(batch.scene, batch)


def value(runs, text):
    """Reduce all runs."""
    batch, outputs = runs
    (reduction,) = reductions({"it": text}, batch.scene)
    return reduction.of(outputs)


def tilt(run):
    """Compute the angle of the rod from the world's x axis at the end, rad."""
    x, y, z = rotations(run.quaternion[-1, 1])[:, 0]
    return np.arctan2(np.hypot(y, z), x)


@pytest.mark.parametrize(
    ("text", "reference"),
    [
        ("final:dumbbell.quaternion", lambda run: run.quaternion[-1, 1]),
        ("at(0.5; 10):position", lambda run: run.position[[50, -1]]),
        ("at():kinetic_energy", lambda run: run.kinetic_energy),
        ("peak:reaction_force", lambda run: np.linalg.norm(run.reaction_force, axis=2).max(axis=0)),
        ("final:coordinate", lambda run: run.joint("pivot").coordinates[-1]),
        ("range:dumbbell.position.z", lambda run: np.ptp(run.position[:, 1, 2])),
        ("maximum:pivot.coordinate", lambda run: run.joint("pivot").coordinates.max()),
        ("peak:pivot.rate", lambda run: np.abs(run.joint("pivot").rates).max()),
        ("peak:pivot.reaction_force.x", lambda run: np.abs(run.reaction_force[:, 0, 0]).max()),
        ("minimum:dumbbell.position.y", lambda run: run.position[:, 1, 1].min()),
        ("maximum:dumbbell.position", lambda run: run.position[:, 1].max(axis=0)),
        ("mean:kinetic_energy", lambda run: np.trapezoid(run.kinetic_energy, run.time) / 10.0),
        (
            "rms:dumbbell.linear_velocity",
            lambda run: np.sqrt(np.trapezoid((run.linear_velocity[:, 1] ** 2).sum(axis=1), run.time) / 10.0),
        ),
        (EXPRESSIONS["tilt"], tilt),
        (
            EXPRESSIONS["below"],
            lambda run: -run.position[[100, 250], 1, 1] / np.linalg.norm(run.position[[100, 250], 1], axis=1),
        ),
        (EXPRESSIONS["power"], lambda run: np.trapezoid(run.linear_velocity[:, 1, 1], run.time) * 0.981),
    ],
)
def test_reductions_are_those_of_trajectories(runs, text, reference):
    # the same numbers, summed in another order
    expected = [reference(run) for run in runs[0]]
    assert value(runs, text) == pytest.approx(np.array(expected), rel=1e-12, abs=1e-12)


def test_events_are_between_the_outputs_around_them(runs):
    found = value(runs, EXPRESSIONS["falls"])
    for time, run in zip(found, runs[0], strict=True):
        k = int(np.searchsorted(run.time, time))
        assert run.position[k - 1, 1, 1] >= -0.25 > run.position[k, 1, 1]
        assert np.interp(time, run.time, run.position[:, 1, 1]) == pytest.approx(-0.25, abs=1e-12)
    assert np.all(np.isnan(value(runs, EXPRESSIONS["never"])))


@pytest.mark.parametrize(
    "text", ["rms:reaction_force", "at(5):quaternion", "rms:coordinate", *EXPRESSIONS.values()]
)
def test_reductions_do_not_depend_on_chunks(runs, text):
    batch, outputs = runs
    (reduction,) = reductions({"it": text}, batch.scene)
    parts = [
        reduction.of(Outputs.of_batch(batch.scene, simulate_batch(batch.scene, parameters={name: [value]})))
        for name, values in MASSES.items()
        for value in values
    ]
    assert np.array_equal(np.concatenate(parts), reduction.of(outputs), equal_nan=True)


@pytest.mark.parametrize(
    ("text", "dimensions", "unit"),
    [
        ("peak:reaction_force", ("joint",), "N"),
        ("final:reaction_force", ("joint", "axis"), "N"),
        ("at(1):panel_7.quaternion", ("time", "component"), "1"),
        ("peak:actuator_force", ("actuator",), "N"),
        ("peak:coordinate", ("coordinate",), ""),
        ("final:slide_12.coordinate", (), "m"),
        ("peak:ball_57.rate", None, "unknown coordinate 'ball_57'"),
        ("final:hinge_14.rate", (), "rad/s"),
        ("final:panel_7.position - slider_2.position", ("axis",), "m"),
        ("final:angle(panel_7.position, slider_2.position)", (), "rad"),
        ("final:norm(position - panel_7.position)", ("body",), "m"),
        ("final:norm(position - reaction_force)", None, "(body, axis) and (joint, axis) do not combine"),
        ("when:panel_7.position.z > 0.1", (), "s"),
        ("final:panel_7.position.z * kinetic_energy", (), ""),
    ],
)
def test_reductions_know_their_dimensions_and_unit(tracker, text, dimensions, unit):
    if dimensions is None:
        with pytest.raises(CrosscheckError) as caught:
            reductions({"it": text}, tracker)
        assert unit in str(caught.value)
        return
    (found,) = reductions({"it": text}, tracker)
    assert (tuple(found.dimensions), found.unit) == (dimensions, unit)


def test_a_scene_is_asked_for_what_is_kept_alone(tracker):
    lean = pruned(tracker, reductions("final:panel_7.position", tracker), "DOP853")
    assert (lean.outputs, len(lean.times)) == (frozenset(), 2)
    # signs of quaternions follow one another from output to output
    counted = pruned(tracker, reductions("final:hinge_14.coordinate", tracker), "DOP853")
    assert (counted.outputs, len(counted.times)) == ({"velocities"}, len(tracker.times))
    full = pruned(tracker, reductions("final:panel_7.quaternion, peak:actuator_force", tracker), "DOP853")
    assert (full.outputs, len(full.times)) == ({"actuation"}, len(tracker.times))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is not of the form"),
        ("reaction_force", "is not of the form"),
        ("finl:position", "did you mean 'final'?"),
        ("peak:reaction_forse", "did you mean 'reaction_force'?"),
        ("peak:panel.reaction_force", "unknown joint 'panel'"),
        ("final:panel_8.position", "did you mean 'panel_7'?"),
        ("final:panel_7.position.w", "no component 'w'"),
        ("final:panel_7.kinetic_energy", "the whole mechanism"),
        ("peak:panel_7.quaternion", "a quaternion has no magnitude"),
        ("final:norm(panel_7.position)", "give it a name"),
        ("x=final:norm(kinetic_energy)", "(a number) is not a vector"),
        ("x=final:nrm(panel_7.position)", "did you mean 'norm'?"),
        ("x=final:panel_7.position +", "invalid syntax at character"),
        ("x=final:norm(panel_7.position", "'(' was never closed at character 5"),
        ("peak:reaction_force;final:position", "there is a semicolon, where commas are needed"),
        ("at(0.5,1):position", "--keep 'at(0.5,1):position': separate times by semicolons"),
        ("x=final:__import__('os')", "unknown function"),
        ("x=final:[1, 2]", "[...] has 2 numbers; needed: 3"),
        ("at(0.123456):position", "there is no output at 0.123456 s"),
        ("at(x):position", "'x' is no number"),
        ("at:position", "unknown kind of output"),
        ("x=maximum:panel_7.position.x - minimum:panel_7.position.x", "'minimum:' in the expression"),
        ("x=when:kinetic_energy", "when needs a comparison"),
        ("x=when:panel_7.position > 1", "when compares numbers, not (axis)"),
        ("peak:position,peak:position", "'peak:position' is kept twice"),
        ("x=final:" + "-" * 3000 + "1", "is longer than"),
    ],
)
def test_texts_that_are_no_reduction_are_one_line(tracker, text, words):
    with pytest.raises(CrosscheckError) as caught:
        reductions(text, tracker)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("text", ["peak:actuator_force", "peak:motor.actuator_force"])
def test_a_scene_without_actuators_has_no_actuator_force(text):
    with pytest.raises(CrosscheckError, match=r"no actuator; .* motor\.reaction_torque") as caught:
        reductions({"it": text}, load(str(EXAMPLES / "planar_slider_crank.yaml")))
    assert "actuator_force" in str(caught.value)
