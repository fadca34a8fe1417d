"""`crosscheck controllers`: its figures against closed forms, its table, and its scene."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import csv_rows, run
from mechanisms import mass_on_rail

from crosscheck.design.controllers import compared, performance
from crosscheck.library import load
from newton_euler import simulate
from newton_euler.model.control import PD, ComputedTorque, StateFeedback
from newton_euler.model.digital_control import Digital
from newton_euler.model.smooth_functions import Sine


def test_figures_of_a_mass_that_follows_a_sine():
    """2 kg on 0.1 sin(5 t) m, a constant 0.01 m off by a wrong feedforward, over one period."""
    w, period = 5.0, 2.0 * np.pi / 5.0
    law = ComputedTorque("rail", 100.0, 20.0, Sine(0.1, w), feedforward=2.0)
    scene = mass_on_rail(duration=period, control=(law,))
    scene = replace(scene, gravity=np.zeros(3), output_period=period / 1000)
    found = performance(scene, simulate(scene))["slides"]
    # e'' + 20 e' + 100 e = 1 from e' = -0.5 m/s: the start at rest is off the reference
    time = np.linspace(0.0, period, 100_001)
    decay = np.exp(-10.0 * time)
    error = 0.01 - 0.01 * decay - 0.6 * time * decay
    rate = -0.5 * decay + 6.0 * time * decay
    force = 2.0 * (-2.5 * np.sin(w * time) - 20.0 * rate - 100.0 * error) + 2.0
    power = np.maximum(force * (0.5 * np.cos(w * time) + rate), 0.0)
    expected = [
        np.sqrt(np.trapezoid(error**2, time) / period),
        np.abs(error).max(),
        np.sqrt(np.trapezoid(force**2, time) / period),
        np.abs(force).max(),
        np.trapezoid(power, time),
    ]
    assert found == pytest.approx(expected, rel=1e-4)  # the trapezoidal rule at a thousand outputs


@pytest.mark.slow
def test_the_table_has_a_row_per_controller_and_engine(capsys, tmp_path):
    arguments = ("--engines", "newton_euler", "--output", tmp_path)
    status, out, err = run(capsys, "controllers", *arguments)
    assert (status, err) == (0, "")
    assert max(len(line) for line in out.splitlines() if str(tmp_path) not in line) <= 80
    table = out[out.index("controller  ") :].split("wrote")[0]
    rows = [line.split() for line in table.splitlines()[1:] if line]
    assert [row[0] for row in rows[::2]] == ["computed_torque", "pd", "pd_gravity", "lqr"]
    errors = dict(zip([row[0] for row in rows[::2]], [float(row[1]) for row in rows[1::2]], strict=True))
    assert errors["computed_torque"] < 1e-12 < errors["pd_gravity"] < errors["lqr"] < errors["pd"]
    assert f"smallest tracking error {errors['computed_torque']:.3g} m: computed_torque" in out
    # the same numbers in both files, with all digits
    content = json.loads((tmp_path / "controllers.json").read_text())
    assert (content["source"], content["options"]) == ("tracker_computed_torque", {})
    written = csv_rows(tmp_path / "controllers.csv")
    assert [{name: str(value) for name, value in row.items()} for row in content["runs"]] == written
    assert {row["controller"]: f"{float(row['error_rms']):.3g}" for row in written} == {
        name: f"{error:.3g}" for name, error in errors.items()
    }
    # the page has the table
    status, out, err = run(capsys, "report", tmp_path)
    assert (status, err) == (0, "")
    page = (tmp_path / "report.html").read_text()
    assert all(f"{error:.3g}" in page for error in errors.values())


def test_every_period_of_a_digital_law_is_judged():
    """The largest force is between outputs every 2 ms, the default of the command."""
    given = {"controller": "computed_torque", "period": 0.0005, "delay": 1, "resolution": 1e-5}
    (found,), _ = compared("tracker_computed_torque", given, ["newton_euler"], lambda _: None)
    scene = replace(load("tracker_computed_torque", **given), outputs=frozenset({"actuation"}))
    runs = (simulate(replace(scene, output_period=period)) for period in (0.0005, 0.002))
    fine, coarse = (np.max(np.abs(each.actuator_force)) for each in runs)
    assert coarse < 0.96 * fine
    assert found.performance.force_peak == pytest.approx(fine, rel=1e-9)


def test_hinges_have_their_units(capsys, tmp_path):
    example = Path(__file__).parents[2] / "examples" / "linkage.xml"
    arguments = ("--engines", "newton_euler", "--output", tmp_path)
    status, out, _ = run(capsys, "controllers", example, *arguments)
    assert status == 0
    assert "error, rad" in out
    assert "force, N m" in out
    (only,) = json.loads((tmp_path / "controllers.json").read_text())["runs"]
    assert (only["controller"], only["kind"]) == ("as declared", "hinges")


def test_motors_without_gains_follow_nothing():
    scene = mass_on_rail(duration=0.1, control=(PD("rail", 0.0, 0.0, 0.0, feedforward=1.0),))
    assert performance(scene, simulate(scene)) == {}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["four_bar"], "has no control law that follows a target"),
        (["--engines", "newton"], "unknown engine 'newton'"),
        (
            ["--set", "delay=2"],
            "delay of scene 'tracker_computed_torque' has no effect with period=0.0",
        ),
    ],
)
def test_what_cannot_be_compared_is_refused(capsys, arguments, words):
    status, out, err = run(capsys, "controllers", *arguments)
    assert (status, out) == (2, "")
    assert words in err


def test_the_scene_has_the_controller_that_is_asked_for():
    kinds = {"computed_torque": ComputedTorque, "pd": PD, "pd_gravity": PD, "lqr": StateFeedback}
    for name, kind in kinds.items():
        scene = load("tracker_computed_torque", controller=name)
        assert all(type(law) is kind for law in scene.control)
    assert all(
        law.gravity_compensation for law in load("tracker_computed_torque", controller="pd_gravity").control
    )
    scene = load("tracker_computed_torque", period=0.01, delay=2, resolution=1e-5, force_limit=30)
    for law in scene.control:
        assert isinstance(law, Digital)
        assert (law.period, law.delay, law.resolution, law.force_limit) == (0.01, 2, 1e-5, 30.0)
    heavier = load("tracker_computed_torque", mass_error=0.1)
    assert heavier.control[0].model == {"panel_7.mass": pytest.approx(1.1 * 0.8905)}
