"""Identification from this package's own motions, and what these do not determine."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import line_spring, mass_on_rail, pendulum, planar_four_bar
from scipy.stats import binom

from crosscheck.library import load
from newton_euler import (
    Body,
    IdentificationWarning,
    JointSpring,
    Measurements,
    Mechanism,
    identify,
    simulate,
    start,
    with_parameters,
)
from newton_euler.analysis.identification.fit import split
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.model.control import PD
from newton_euler.model.motions import Steps


def sprung():
    """A mass on a spring, whose motion is that of stiffness by mass."""
    return replace(mass_on_rail(line_spring(rest_length=1.8)), duration=2.0, output_period=0.05)


def measured(scene, *joints, begun=None, noise=0.0, seed=0):
    """Measurements of joint coordinates of a run."""
    run, rng = simulate(scene), np.random.default_rng(seed)
    columns = {}
    for joint in joints:
        motion = run.joint(joint)
        columns[f"coordinate.{joint}"] = motion.coordinates[:, 0]
        columns[f"rate.{joint}"] = motion.rates[:, 0]
    columns = {name: column + noise * rng.normal(size=len(column)) for name, column in columns.items()}
    return Measurements(run.time, columns, dict.fromkeys(columns, noise) if noise else {}, begun or {})


def test_exact_measurements_give_exact_parameters():
    """As far as runs to 1e-10 tell, times 1e4 for parameters that hardly differ in what they do."""
    truth = start(replace(load("slider_crank"), duration=1.0, output_period=0.05), pivot=(0.2, 3.0))
    wrong = with_parameters(truth, {"crank.mass": 0.13, "slider.mass": 1.5, "ball.point.z": 1e-3})
    names = ["crank.mass", "slider.mass", "ball.point.z", "start.pivot", "start.pivot.rate"]
    found = identify(wrong, names, measured(truth, "pivot", "guide"))
    true = [truth.mechanism.body(name).mass for name in ("crank", "slider")]
    assert found.values == pytest.approx([*true, -1e-3, 0.2, 3.0], rel=1e-6)
    assert found.scene.mechanism.body("slider").mass == found.values[1]
    assert found.undetermined == ()
    assert found.notes == []
    assert "slider.mass" in "\n".join(found.report())


def test_a_scene_that_is_fitted_again_is_not_loaded_again(monkeypatch):
    given = measured(sprung(), "rail")
    wrong = with_parameters(sprung(), {"line.stiffness": 45.0})
    first = identify(wrong, ["line.stiffness"], given)
    monkeypatch.setattr(CompiledEquations, "__init__", None)
    again = identify(wrong, ["line.stiffness"], given)
    assert np.array_equal(again.values, first.values)


def test_small_numbers_are_fitted():
    """Those of a mechanism of a millimeter and a milligram, of 1e-13 SI and less."""
    scene = pendulum(length=1e-3)
    rod, spring = scene.mechanism.body("rod"), JointSpring("pivot", damping=1e-12)
    light = Body("rod", 1e-6, rod.center_of_mass, 1e-6 * rod.inertia, rod.quaternion)
    mechanism = Mechanism([Body.ground(), light], scene.mechanism.joints)
    truth = replace(scene, mechanism=mechanism, forces=(spring,), duration=0.2, output_period=0.01)
    names = ["rod.inertia.yy", "pivot.spring.damping"]
    right = [light.inertia[1, 1], 1e-12]
    wrong = with_parameters(truth, {names[0]: 1.1 * right[0], names[1]: 0.9e-12})
    found = identify(wrong, names, measured(truth, "pivot"))
    assert found.values == pytest.approx(right, rel=1e-6, abs=0.0)
    assert found.undetermined == ()


def test_several_runs_have_starts_of_their_own():
    truth = replace(planar_four_bar(), duration=0.5, output_period=0.05)
    other = start(truth, at_a=(0.3, 0.5))
    runs = [
        measured(truth, "at_a"),
        measured(other, "at_d", begun={"start.at_a": 0.3, "start.at_a.rate": 0.5}),
    ]
    names = ["coupler.mass", "coupler.center_of_mass.x"]
    wrong = with_parameters(truth, dict(zip(names, (2.5, 0.52), strict=True)))
    assert identify(wrong, names, runs).values == pytest.approx([2.0, 0.5], rel=1e-6)


def test_poses_may_be_measured_with_either_sign_of_quaternions():
    truth = replace(pendulum(), outputs=frozenset())
    run = simulate(truth)
    columns = {f"quaternion.rod.{axis}": run.quaternion[:, 1, k].copy() for k, axis in enumerate("wxyz")}
    columns["position.rod.x"] = run.position[:, 1, 0]
    for name in columns:
        if name.startswith("quaternion"):
            columns[name][::2] *= -1.0
    wrong = with_parameters(truth, {"gravity.z": -9.0})
    found = identify(wrong, ["gravity.z"], Measurements(run.time, columns))
    assert found.values == pytest.approx([-9.81], rel=1e-7)


@pytest.mark.parametrize("jumps", [(), (0.3, 0.7)])
def test_poses_may_be_measured_later_than_the_start(jumps):
    """Alone, and beside an encoder from 0 s on; of a force that never jumps, and of one that does twice."""
    push = PD("rail", 0.0, 0.0, 0.0, feedforward=Steps((0.0, *jumps), (5.0, -5.0, 10.0)[: 1 + len(jumps)]))
    truth = mass_on_rail(line_spring(rest_length=1.8), control=(push,))
    truth = replace(truth, duration=2.0, output_period=0.05)
    run = simulate(truth)
    coordinate = {"coordinate.rail": run.joint("rail").coordinates[:, 0]}
    camera = Measurements(run.time[1:], {"position.mass.z": run.position[1:, 1, 2]})
    wrong = with_parameters(truth, {"mass.mass": 2.2})
    for data in (camera, [camera, Measurements(run.time, coordinate)]):
        found = identify(wrong, ["mass.mass"], data)
        assert found.values == pytest.approx([2.0], rel=1e-7)
        for residuals in found.residuals:
            assert all(np.abs(column).max() < 1e-7 for column in residuals.values())


def test_work_alone_may_be_measured():
    truth = with_parameters(sprung(), {"line.damping": 2.0})
    run = simulate(truth)
    found = identify(sprung(), ["line.damping"], Measurements(run.time, {"work": run.work}))
    assert found.values == pytest.approx([2.0], rel=1e-7)


def test_initial_coordinates_are_fitted():
    truth = start(pendulum(), pivot=(0.1, -0.4))
    wrong = start(pendulum(), pivot=(0.0, 0.0))
    found = identify(wrong, ["start.pivot", "start.pivot.rate"], measured(truth, "pivot"))
    assert found.values == pytest.approx([0.1, -0.4], rel=1e-7)


def test_noise_that_is_not_known_is_that_of_the_residuals():
    truth = pendulum()
    data = measured(truth, "pivot", noise=1e-3)
    found = identify(truth, ["rod.mass", "start.pivot"], replace(data, noise={}))
    # 21 numbers tell their deviation to 1 / sqrt(2 * 21) = 15 %, of which five are allowed
    (noise,) = found.noise
    assert noise["rate.pivot"] == pytest.approx(1e-3, rel=0.75)
    known = identify(truth, ["rod.mass", "start.pivot"], data)
    assert found.standard_deviations == pytest.approx(known.standard_deviations, rel=0.75)


def test_noise_is_taken_from_residuals_by_degrees_of_freedom():
    """Twelve numbers and three parameters leave nine."""
    scene = replace(with_parameters(sprung(), {"line.damping": 1.0}), duration=1.0, output_period=0.2)
    names, data = ["line.stiffness", "line.damping", "line.rest_length"], measured(scene, "rail", noise=1e-4)
    found = identify(scene, names, replace(data, noise={}))
    squares = sum(np.sum((found.residuals[0][name] / level) ** 2) for name, level in found.noise[0].items())
    # noise is that of the fit before, whose noise differs by less than 1 %
    assert squares == pytest.approx(9.0, rel=0.02)
    assert np.isnan(found.misfit)


def test_noise_that_residuals_do_not_tell_is_named():
    """Of six numbers four parameters leave two, of one column less than one."""
    scene = replace(with_parameters(sprung(), {"line.damping": 1.0}), duration=1.2, output_period=0.6)
    names = ["line.stiffness", "line.damping", "line.rest_length", "start.rail"]
    data = replace(measured(scene, "rail", noise=1e-3), noise={})
    with pytest.warns(IdentificationWarning, match="the noise of coordinate.rail is not identifiable"):
        found = identify(scene, names, data)
    assert np.isinf(found.standard_deviations).all()


def test_noise_of_a_column_is_that_of_each_run():
    """A run of a hundred times the noise tells a ten-thousandth as much."""
    scene = sprung()
    better, worse = (measured(scene, "rail", noise=noise) for noise in (1e-3, 1e-1))
    alone, both = (identify(scene, ["line.stiffness"], runs) for runs in (better, [better, worse]))
    assert both.standard_deviations == pytest.approx(alone.standard_deviations, rel=1e-3)
    # the same noise, a hundred times as large, moves the value by a hundredth as much
    assert np.all(np.abs(both.values - alone.values) < 0.05 * alone.standard_deviations)


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize("guess", [1e-4, 0.01, 5.0])
def test_what_is_determined_does_not_depend_on_the_guess(is_known, guess):
    data = measured(with_parameters(sprung(), {"line.damping": 1.0}), "rail", noise=1e-2)
    data = data if is_known else replace(data, noise={})
    found = identify(with_parameters(sprung(), {"line.damping": guess}), ["line.damping"], data)
    assert found.doubts == []
    # its deviation from 82 numbers of this noise; five of them once in two million times
    (deviation,) = found.standard_deviations
    assert deviation == pytest.approx(0.0115, rel=0.1)
    assert abs(found.values[0] - 1.0) < 5.0 * deviation


RATIO = "only mass.mass / line.stiffness is identifiable"


@pytest.mark.parametrize(
    ("scene", "joint", "parameters", "lines"),
    [
        (
            sprung(),
            "rail",
            ["mass.mass", "line.stiffness"],
            ["only mass.mass / line.stiffness is identifiable"],
        ),
        (sprung(), "rail", ["line.stiffness", "gravity.x"], ["gravity.x is not identifiable"]),
        (
            sprung(),
            "rail",
            ["mass.mass", "line.stiffness", "line.rest_length", "gravity.y"],
            [RATIO, "gravity.y is not identifiable"],
        ),
    ],
)
def test_what_the_data_do_not_determine_is_named(scene, joint, parameters, lines):
    with pytest.warns(IdentificationWarning, match=r"is (not )?identifiable"):
        found = identify(scene, parameters, measured(scene, joint, noise=1e-4))
    # ten deviations of what is determined, the frequency
    assert found.values == pytest.approx(found.before, rel=1e-4, abs=1e-12)
    assert sorted(found.undetermined) == sorted(lines)
    is_known = np.isfinite(found.standard_deviations)
    named = " ".join(lines)
    assert [name for name, known in zip(parameters, is_known, strict=True) if not known] == [
        name for name in parameters if name in named
    ]


def test_noise_does_not_move_what_is_not_determined():
    """Damping of a third of its deviation, and mass and stiffness by one factor."""
    scene = with_parameters(sprung(), {"line.damping": 0.01})
    with pytest.warns(IdentificationWarning):
        found = identify(
            scene,
            ["line.damping", "mass.mass", "line.stiffness"],
            measured(scene, "rail", noise=0.03, seed=4),
        )
    assert np.isinf(found.standard_deviations).all()
    # the frequency is known to 1e-3, of which ten are allowed
    assert found.values == pytest.approx(found.before, rel=1e-2)


@pytest.mark.parametrize("guess", [2.6, 4.0])
def test_a_ratio_is_fitted_by_the_least_change(guess):
    """From (m, k): the nearest of k / m = 25 1/s^2, each in units of its own."""
    data = measured(sprung(), "rail", noise=1e-4)
    wrong = with_parameters(sprung(), {"mass.mass": guess})
    with pytest.warns(IdentificationWarning):
        found = identify(wrong, ["mass.mass", "line.stiffness"], data)
    assert found.undetermined == (RATIO,)
    slope = 25.0 * guess / 50.0
    shares = (1.0 + slope) / (1.0 + slope**2) * np.array([1.0, slope])
    # ten deviations of the ratio
    assert found.values == pytest.approx(shares * found.before, rel=1e-4)
    assert np.isnan(found.correlation).all()
    assert np.isinf(found.standard_deviations).all()


def test_deviations_are_those_along_combinations_that_are_not_determined_too():
    """Of the second parameter, a hundredth of what is known to 100 units of the first."""
    jacobian = np.array([[-100.0, 1e4], [1e-2, 1e-4]])
    covariance = split(jacobian).covariance
    assert covariance == pytest.approx(np.linalg.inv(jacobian.T @ jacobian), rel=1e-6)
    assert covariance[1, 1] == pytest.approx(1.0, rel=1e-3)


def test_parameters_at_the_edge_of_what_may_be_have_no_deviation():
    """No damping, which the noise would have less than nothing."""
    scene = with_parameters(sprung(), {"line.damping": 0.1})
    found = identify(scene, ["line.damping", "mass.mass"], measured(sprung(), "rail", noise=1e-4))
    assert found.doubts == []
    assert found.values == pytest.approx([0.0, 2.0], abs=1e-4)
    assert found.values[0] == 0.0
    assert found.at_bound == ("line.damping",)
    assert np.isnan(found.standard_deviations).tolist() == [True, False]
    assert [row[-1] == "at edge" for row in found.table] == [False, True, False]


def test_a_mass_that_a_wrong_scene_makes_nothing_of_has_no_deviation():
    scene = replace(load("slider_crank"), duration=1.0, output_period=0.02)
    data = measured(with_parameters(scene, {"ball.point.z": 2e-2}), "pivot", "guide", noise=1e-5)
    with pytest.warns(IdentificationWarning, match="cannot move as measured"):
        found = identify(scene, ["crank.mass"], data)
    assert found.values[0] < 1e-6
    assert np.isnan(found.covariance).all()


@pytest.mark.slow
def test_combinations_of_many_parameters_are_named_by_their_shares():
    """All masses, stiffnesses and dampings of the tracker by one factor: nothing else pulls."""
    scene = replace(load("tracker"), duration=1.0, output_period=0.05)
    bodies = [body.name for body in scene.mechanism.bodies[1:]]
    laws = [f"{law.joint}.{kind}" for law in scene.control for kind in ("stiffness", "damping")]
    parameters = [*(f"{name}.mass" for name in bodies), *laws]
    data = measured(scene, "slide_12", "slide_13", "hinge_14", noise=1e-9)
    fixed = [f"{name}.inertia" for name in bodies]
    with pytest.warns(IdentificationWarning, match="together change nothing that was measured"):
        found = identify(scene, [*parameters, *fixed], data)
    assert any("panel_7.mass" in line and "slide_12.stiffness" in line for line in found.undetermined)


@pytest.mark.slow
def test_columns_of_unknown_noise_do_not_hide_that_a_scene_is_wrong():
    """A joint point is elsewhere by 0.15 mm: residuals of an angle are twice its noise, 0.1 mrad."""
    scene = replace(load("slider_crank"), duration=1.0, output_period=0.02)
    motion = simulate(with_parameters(scene, {"ball.point.z": 1.5e-4, "slider.mass": 2.2}))
    rng = np.random.default_rng(1)
    angle = motion.joint("pivot").coordinates[:, 0]
    columns = {"coordinate.pivot": angle + 1e-4 * rng.normal(size=len(angle))}
    alone = Measurements(motion.time, columns, {"coordinate.pivot": 1e-4})
    for quantity in ("position", "linear_velocity"):
        for body in (1, 2, 3):
            name = motion.mechanism.body_names[body]
            for k, axis in enumerate("xyz"):
                exact = getattr(motion, quantity)[:, body, k]
                columns[f"{quantity}.{name}.{axis}"] = exact + 0.1 * rng.normal(size=len(exact))
    with pytest.warns(IdentificationWarning, match="cannot move as measured"):
        verdicts = [
            identify(scene, ["slider.mass"], each) for each in (alone, replace(alone, columns=columns))
        ]
    assert [found.is_wrong for found in verdicts] == [True, True]
    # noise of the others is a thousand times as large
    assert verdicts[1].misfit == pytest.approx(verdicts[0].misfit, rel=1e-4)
    assert verdicts[1].degrees_of_freedom == pytest.approx(50.0, abs=1e-2)


@pytest.mark.slow
def test_probabilities_of_a_right_scene_are_uniform_beside_columns_of_unknown_noise():
    """Half of them are between a quarter and three, as far as 40 draws tell.

    Nearly all would be if residuals counted that noise is estimated from.
    """
    scene, rng = with_parameters(sprung(), {"line.damping": 1.0}), np.random.default_rng(5)
    motion, names = simulate(scene), ["line.stiffness", "line.damping", "line.rest_length"]
    exact = {"coordinate.rail": motion.joint("rail").coordinates[:, 0]}
    for quantity in ("position", "linear_velocity", "angular_velocity"):
        exact |= {
            f"{quantity}.mass.{axis}": getattr(motion, quantity)[:, 1, k] for k, axis in enumerate("xyz")
        }

    def probability():
        columns = {name: column + 0.01 * rng.normal(size=len(column)) for name, column in exact.items()}
        measurements = Measurements(motion.time, columns, {"coordinate.rail": 0.01})
        return identify(scene, names, measurements).probability

    middle = sum(0.25 < probability() < 0.75 for _ in range(40))
    assert binom.ppf(1e-6, 40, 0.5) <= middle <= binom.isf(1e-6, 40, 0.5)


@pytest.mark.slow
def test_a_scene_that_is_wrong_is_said_to_be():
    """Joint points that are elsewhere: what masses do together stays, whatever else they could hide."""
    scene = replace(load("slider_crank"), duration=1.0, output_period=0.02)
    names = ["crank.mass", "slider.mass", "rod.mass"]
    data = measured(with_parameters(scene, {"ball.point.z": 2e-3}), "pivot", "guide", noise=1e-5)
    with pytest.warns(IdentificationWarning, match="cannot move as measured"):
        found = identify(scene, names, data)
    assert found.misfit > 50.0
    assert np.isnan(found.covariance).all()
    assert {row[-1] for row in found.table[1:]} == {"-"}
    assert found.degrees_of_freedom == pytest.approx(4 * 51 - 2)
    assert found.probability < 1e-100
    worst = max(found.misfits, key=found.misfits.get)
    assert f"largest residuals: {worst}, {found.misfits[worst]:.3g} times its noise" in found.report()
    (line,) = found.undetermined
    assert line.startswith("not identifiable: crank.mass +0.0012 kg, rod.mass -0.0012 kg together")
    assert found.values == pytest.approx(found.before, rel=0.1)
    exact = identify(scene, names[1:2], measured(scene, "pivot", noise=1e-5))
    assert not exact.is_wrong
    assert f"reduced chi-squared {exact.misfit**2:.3g}, expected 1" in exact.fit


def test_columns_that_the_scene_does_not_move_like_are_named():
    """At rest, where a mass was seen to swing: no noise was given that says so."""
    data = replace(measured(sprung(), "rail", noise=1e-3), noise={})
    still = with_parameters(sprung(), {"line.rest_length": 2.0})
    with pytest.warns(IdentificationWarning, match="coordinate.rail: a constant fits better"):
        found = identify(still, ["line.stiffness"], data)
    assert found.unlike == ("coordinate.rail",)
    assert identify(sprung(), ["line.stiffness"], data).unlike == ()


@pytest.mark.slow
@pytest.mark.parametrize("given", [True, False])
def test_a_start_that_the_first_row_contradicts_is_named(given):
    """Off by 5 mrad, fifty times the noise, whether that is given or seen in the data alone."""
    truth = start(replace(load("slider_crank"), duration=1.0, output_period=0.01), pivot=(0.2, 3.0))
    data = measured(truth, "pivot", noise=1e-4)
    data = data if given else replace(data, noise={})
    off = start(truth, pivot=(0.205, 3.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentificationWarning)
        found = identify(off, ["slider.mass"], data)
        first = data.columns["coordinate.pivot"][0]
        line = f"coordinate.pivot starts at 0.205 rad, held, but is {first:.6g} in the first row"
        assert found.notes == [f"{line}: fit start.pivot?"]
        # with noise it may be off by, where it is fitted, and where it was given right
        assert identify(truth, ["slider.mass"], data).contradiction == ""
        assert identify(off, ["slider.mass", "start.pivot"], data).contradiction == ""
        held = replace(data, start={"start.pivot": 0.2, "start.pivot.rate": 3.0})
        assert identify(off, ["slider.mass"], held).contradiction == ""
        held = replace(data, start={"start.pivot": 0.205, "start.pivot.rate": 3.0})
        assert identify(off, ["slider.mass"], held).contradiction == f"{line}: is the line start right?"


@pytest.mark.parametrize("noise", [1e-5, 0.0])
@pytest.mark.parametrize("others", [[], ["guide"]])
def test_angles_in_degrees_without_their_unit_are_pointed_out(noise, others):
    scene = start(replace(load("slider_crank"), duration=1.0, output_period=0.02), pivot=(0.2, 3.0))
    data = measured(scene, "pivot", *others, noise=noise)
    wrong = with_parameters(scene, {"slider.mass": 1.9})
    assert not identify(wrong, ["slider.mass"], data).in_degrees
    degrees = {
        name: np.rad2deg(column) if "pivot" in name else column for name, column in data.columns.items()
    }
    with pytest.warns(IdentificationWarning, match=r"coordinate\.pivot fits in degrees: add \[deg\]"):
        found = identify(wrong, ["slider.mass"], replace(data, columns=degrees))
    assert found.in_degrees == ("coordinate.pivot", "rate.pivot")
