"""The command `loads`: cases, its table, and what it writes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from command_line import run

EXAMPLE = str(Path(__file__).parents[2] / "examples" / "four_bar.yaml")


def ranges(folder: Path) -> dict[tuple[str, str], dict[str, str]]:
    with (folder / "loads.csv").open() as file:
        return {(row["element"], row["quantity"]): row for row in csv.DictReader(file)}


def test_cases_of_a_scene(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "80")
    cases = ("--case", "calm:speed=0", "--case", "windy:speed=15,direction=90")
    status, out, err = run(
        capsys, "loads", "tracker_wind", "--set", "wind=steady", *cases, "--output", tmp_path
    )
    assert (status, err) == (0, "")
    assert out.startswith("tracker_wind: loads over cases calm, windy\nlargest force ")
    assert max(map(len, out.splitlines())) <= 80 + len(str(tmp_path)) * 4
    found = ranges(tmp_path)
    assert {row["most_case"] for row in found.values()} == {"calm", "windy"}
    row = found["universal_47", "force"]
    (line,) = [line for line in out.splitlines() if line.startswith("universal_47") and "N" not in line][:1]
    assert line.split()[1] == f"{float(row['most']):.3g}"
    assert f"{row['most_case']} at {float(row['most_time']):.4g} s" in line
    assert (tmp_path / "loads.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "loads.rrd").stat().st_size > 10_000
    assert run(capsys, "report", tmp_path)[0] == 0
    page = (tmp_path / "report.html").read_text()
    assert "largest force" in page
    assert "data:image/png" in page


def test_round_off_is_no_load_and_rest_is_told(capsys, tmp_path):
    """A planar linkage, whose torques across its plane are 1e-15 N m, and one that nothing moves."""
    linkage = Path(EXAMPLE).with_name("linkage.xml")
    _, out, _ = run(capsys, "loads", linkage, "--set", "duration=0.1", "--output", tmp_path)
    assert "nothing moves" not in out
    (line,) = [line.split() for line in out.splitlines() if line.startswith("elbow") and "e-" not in line][1:]
    assert line == ["elbow", "0", "0", "0", "0"]
    still = tmp_path / "still.xml"
    still.write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody><body name="a"><joint name="j" axis="0 1 0"/>'
        '<geom size="0.1" pos="0.5 0 0"/></body></worldbody></mujoco>'
    )
    _, out, _ = run(capsys, "loads", still, "--output", tmp_path)
    assert "no joint carries a force" in out
    assert "nothing moves in the run: these are loads at rest; --set excitation=on moves" in " ".join(
        out.split()
    )


def test_a_file_at_rest_has_one_case(capsys, tmp_path):
    status, out, _ = run(capsys, "loads", EXAMPLE, "--at-rest", "--output", tmp_path)
    assert status == 0
    assert out.startswith("four_bar: loads at rest, initial pose\n")
    assert {row["most_time"] for row in ranges(tmp_path).values()} == {"0.0"}


@pytest.mark.parametrize(
    ("scene", "told"),
    [
        ("bricard", "1 redundant constraint at joints hinge_1,"),
        ("four_bar", "2 redundant constraints at joints pivot_0, "),  # of the plane, zero in the tree
    ],
)
def test_loads_that_are_not_determined_are_told(capsys, tmp_path, scene, told):
    _, out, _ = run(capsys, "loads", scene, "--output", tmp_path)
    assert f"reactions not unique: {told}" in " ".join(out.split())
    assert "stiffness decides how these joints share loads" in out


def test_elements_that_act_and_are_not_simulated_are_named(capsys, tmp_path):
    """A pendulum that falls from the horizontal past its limit, with a case whose run ends before."""
    model = tmp_path / "falls.xml"
    model.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body><joint name="j" axis="0 1 0" range="-1 0.1"/>'
        '<inertial pos="1 0 0" mass="1" diaginertia="0.001 0.001 0.001"/></body></worldbody></mujoco>'
    )
    output = ("--output", tmp_path / "out")
    cases = ("--case", "long:duration=0.5", "--case", "short:duration=0.1")
    status, out, _ = run(capsys, "loads", model, *cases, *output)
    assert status == 4
    told = " ".join(out.split())
    assert "REDUCED MODEL: largest force " in told
    assert "; case long: not simulated: limits of joint 'j' passed from " in told
    assert "case short: not" not in told
    content = json.loads((tmp_path / "out" / "loads.json").read_text())
    ((case, (entry,)),) = content["not_simulated"].items()
    assert (case, entry["element"], entry["topic"]) == ("long", "joint 'j'", "limits")
    # x = g t^2 / 2 l as long as x is small
    assert entry["since"] == pytest.approx((2.0 * 0.1 * 1.001 / 9.81) ** 0.5, rel=0.05)
    assert run(capsys, "loads", model, *cases, *output, "--allow-reduced")[0] == 0
    status, out, _ = run(capsys, "loads", model, "--set", "duration=0.1", *output)
    assert (status, "REDUCED" in out) == (0, False)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--case", "a b:speed=3"), "--case 'a b:speed=3' is not of the form NAME:OPTION=VALUE"),
        (("--case", "a", "--case", "a"), "--case a is given twice"),
        (("--case", "a:speed"), "--case a: 'speed' is not of the form OPTION=VALUE"),
        (("--case", "a:sped=1"), "unknown option 'sped' of scene 'tracker_wind'; did you mean 'speed'?"),
        (
            ("--case", "a:speed=99"),
            "speed of scene 'tracker_wind' is '99'; choose a number from 0 to 60 m/s",
        ),
    ],
)
def test_bad_cases_are_one_line(capsys, tmp_path, arguments, message):
    status, out, err = run(capsys, "loads", "tracker_wind", *arguments, "--output", tmp_path / "out")
    assert (status, out, len(err.splitlines())) == (2, "", 1)
    assert message in err
    assert not (tmp_path / "out").exists()


def test_what_nothing_holds_is_named(capsys, tmp_path):
    status, _, err = run(capsys, "loads", "pendulum", "--at-rest", "--output", tmp_path)
    assert status == 2
    assert "needed: actuators that hold it" in err
