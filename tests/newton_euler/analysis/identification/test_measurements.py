"""Measured motion: files, units, and what makes no sense of a scene."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms import Z, bolted, pendulum, planar_four_bar

from newton_euler import (
    Measurements,
    NewtonEulerError,
    Revolute,
    identify,
    measurements_from_csv,
    sensitivities,
    simulate,
)
from newton_euler.equations.undetermined import is_undetermined
from newton_euler.errors import OptionError

CSV = "time,coordinate.pivot\n0.0,0.1\n0.1,0.2\n0.2,0.3\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "needed: a column time"),
        ("t,coordinate.pivot\n0,1\n1,2\n", "needed: a column time"),
        (CSV.replace(",", ";"), "line 1: columns are separated by ';'; needed: commas, and decimal points"),
        (CSV.replace(",", "\t"), "line 1: columns are separated by tabs; needed: commas, and decimal points"),
        (CSV.replace("0.1,0.2", "0,1,0,2"), "line 3: has 4 cells; needed: 2, and decimal points"),
        (
            CSV.replace("0.3", '"0,3"'),
            "line 4: coordinate.pivot is '0,3'; needed: a finite number with a decimal",
        ),
        (CSV.replace("pivot", "pivot [grad]"), "unit of 'coordinate.pivot' is 'grad'; needed: s, m, rad"),
        ("time\n0\n1\n", "at least one of measurements"),
        (CSV.replace("0.2\n0.2", "\n0.2"), "line 3: coordinate.pivot is missing"),
        (CSV.replace("0.3", "nan"), "line 4: coordinate.pivot is 'nan'"),
        (CSV.replace("0.2,0.3", "0.05,0.3"), "line 4: time is 0.05; needed: times in ascending order"),
        (CSV.replace("0.1,0.2\n0.2,0.3\n", ""), "has 1 rows of measurements"),
        (CSV.replace("0.0,", "-1.0,"), "line 2: time is -1; needed: times from 0 on"),
        (CSV.replace("time,coordinate.pivot", "time,time"), "column 'time' is there twice"),
        (CSV + "0.3\n", "line 5: has 1 cells; needed: 2"),
        (
            CSV.replace("\n0.0", "\nnoise,-1\n0.0"),
            "noise of 'coordinate.pivot' is -1.0; needed: a positive number",
        ),
        (CSV.replace("\n0.0", "\nnoise,x\n0.0"), "line 2: coordinate.pivot is 'x'"),
        (
            "time,work\nstart,1\n0,1\n1,2\n",
            "the start is given by column 'work'; needed: coordinates and rates",
        ),
    ],
)
def test_files_that_make_no_sense_are_refused(tmp_path, text, message):
    path = tmp_path / "data.csv"
    path.write_text(text)
    with pytest.raises(NewtonEulerError) as caught:
        measurements_from_csv(path)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")


def test_files_have_noise_and_the_start_of_some_columns(tmp_path):
    path = tmp_path / "data.csv"
    lines = [
        "coordinate.pivot, time, rate.pivot",
        ", noise, 1e-2",
        "0.1, start,",
        "0.1, 0, 0.2",
        "0.2, 0.5, 0.3",
    ]
    path.write_text("\n".join(lines))
    found = measurements_from_csv(path)
    assert found.noise == {"rate.pivot": 0.01}
    assert found.start == {"start.pivot": 0.1}
    assert found.time.tolist() == [0.0, 0.5]
    assert found.columns["rate.pivot"].tolist() == [0.2, 0.3]


def test_columns_may_be_in_other_units(tmp_path):
    path = tmp_path / "data.csv"
    lines = ["time [ms],coordinate.pivot [deg]", "noise,2", "start,90", "0,90", "500,-180"]
    path.write_text("\n".join(lines))
    found = measurements_from_csv(path)
    assert found.time.tolist() == [0.0, 0.5]
    assert found.columns["coordinate.pivot"] == pytest.approx([np.pi / 2.0, -np.pi])
    assert found.noise == pytest.approx({"coordinate.pivot": np.pi / 90.0})
    assert found.start == pytest.approx({"start.pivot": np.pi / 2.0})


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("coordinate.pivot [mm]", "column 'coordinate.pivot' is in m; needed: a unit of rad"),
        ("coordinate.pivto", "unknown column 'coordinate.pivto'; did you mean 'coordinate.pivot'"),
    ],
)
def test_files_with_columns_of_another_scene_are_named(tmp_path, name, message):
    path = tmp_path / "data.csv"
    path.write_text(CSV.replace("coordinate.pivot", name))
    with pytest.raises(NewtonEulerError) as caught:
        identify(pendulum(), ["rod.mass"], path)
    assert f"{path}: {message}" in str(caught.value)


TIMES = np.array([0.0, 0.5, 1.0])


@pytest.mark.parametrize(
    ("parameters", "columns", "message"),
    [
        (["rod.color"], {"coordinate.pivot": TIMES}, "unknown parameter 'rod.color'"),
        (["rod.mass"], {"coordinate.pivto": TIMES}, "did you mean 'coordinate.pivot'"),
        (
            ["rod.mass", "gravity.x", "gravity.z"],
            {"coordinate.pivot": TIMES},
            "are 3 numbers; needed: at least 4, one for each that is fitted, and for the noise of each",
        ),
        (["rod.mass"], {"coordinate.pivot": [0.0, np.nan, 1.0]}, "needed: finite numbers in a row"),
        (["rod.mass"], {"coordinate.pivot": [0.0, 1.0]}, "has 2 numbers; needed: 3, one for each time"),
        (["rod.mass"], {}, "columns are {}"),
        ([], {"coordinate.pivot": TIMES}, "names of parameters"),
    ],
)
def test_impossible_fits_are_refused(parameters, columns, message):
    with pytest.raises(NewtonEulerError) as caught:
        identify(pendulum(), parameters, Measurements(TIMES, columns))
    assert message in str(caught.value)


def test_reactions_that_nothing_determines_are_no_measurements():
    scene = bolted(Revolute, axis=Z)
    run = simulate(scene)
    lifted = Measurements(run.time, {"reaction_force.pivot.z": run.reaction_force[:, 0, 2]})
    assert identify(scene, ["a.mass"], lifted).values == pytest.approx(1.0)
    for name in ("reaction_force.second_bolt.z", "reaction_torque.bolt.x"):
        with pytest.raises(NewtonEulerError) as caught:
            identify(scene, ["a.mass"], Measurements(TIMES, {name: TIMES}))
        joint = f"reactions of joint {name.split('.')[1]!r} are not unique"
        assert f"column {name!r}: {joint}, 5 redundant constraints at joints bolt, second_bolt" in str(
            caught.value
        )
    by = sensitivities(scene, ["a.mass"])
    assert by.reaction_force is None
    assert by.reaction_torque is None


def test_reactions_in_the_plane_of_a_mechanism_are_measurements():
    scene = planar_four_bar()
    run = simulate(scene)
    x, y = (
        Measurements(run.time, {f"reaction_force.at_a.{axis}": run.reaction_force[:, 0, k]})
        for k, axis in enumerate("xy")
    )
    assert identify(scene, ["crank.mass"], x).values == pytest.approx(1.0)
    with pytest.raises(NewtonEulerError, match="reactions of joint 'at_a' are not unique"):
        identify(scene, ["crank.mass"], y)
    assert is_undetermined(scene)[0].tolist() == [[False, True, False], [True, False, True]]


def test_times_beyond_the_scene_are_refused():
    late = Measurements([0.0, 3.0], {"coordinate.pivot": [0.0, 0.0]})
    with pytest.raises(
        NewtonEulerError,
        match=r"times go on to 3 s; needed: at most the scene's duration, 2 s; longer: --set duration=3",
    ):
        identify(pendulum(), ["rod.mass"], late)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "start.pivot",
            r"measurements of run 1: give 'start.pivot', which is fitted; needed: one of the two",
        ),
        ("start.pivto", "measurements of run 1: unknown joint 'pivto'; did you mean 'pivot'"),
    ],
)
def test_starts_that_are_fitted_or_unknown_are_refused(name, message):
    given = [Measurements(TIMES, {"coordinate.pivot": TIMES}, start=start) for start in ({}, {name: 0.1})]
    with pytest.raises(NewtonEulerError, match=message):
        identify(pendulum(), ["start.pivot"], given)


def test_measurements_are_those_of_runs():
    with pytest.raises(OptionError, match="measurements is 5; needed: a Measurements or text or a path"):
        identify(pendulum(), ["rod.mass"], 5)


@pytest.mark.parametrize("what", ["noise", "start", "units"])
def test_numbers_without_names_are_refused(what):
    with pytest.raises(NewtonEulerError, match=f"{what} is None; needed: a mapping of names"):
        Measurements([0.0, 1.0], {"work": [0.0, 0.0]}, **{what: None})


def test_times_have_units_of_time():
    with pytest.raises(NewtonEulerError, match="unit of time is 'deg'; needed: s or ms"):
        Measurements([0.0, 1.0], {"work": [0.0, 0.0]}, units={"time": "deg"})
