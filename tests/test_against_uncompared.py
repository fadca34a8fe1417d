"""Two models that differ in what no figure is about: a difference where it moves the mechanism."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import run

LINKAGE = Path(__file__).parents[1] / "examples" / "linkage.xml"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            'stiffness="0.5"',
            'stiffness="0.5" frictionloss="0.3"',
            "joint 'pivot': left out: its dry friction 0.3",
        ),
        (
            'stiffness="0.5"',
            'stiffness="0.5" limited="true" range="-5 5"',
            "joint 'pivot': left out: its limits -0.08727 to 0.08727: limits are no bilateral constraints",
        ),
        ('conaffinity="0"', 'conaffinity="1"', "3 geoms that can touch: left out: contacts are no"),
    ],
)
def test_what_is_left_out_of_one_model_only_is_a_difference(capsys, tmp_path, old, new, told) -> None:
    text = LINKAGE.read_text()
    assert old in text
    other = tmp_path / "other.xml"
    other.write_text(text.replace(old, new))
    for pair, where in (((LINKAGE, other), "there"), ((other, LINKAGE), "here")):
        status, out, err = run(capsys, "run", pair[0], "--against", pair[1], "--output", tmp_path / "out")
        assert (status, err) == (1, "")
        assert out.splitlines()[-1].startswith(f"DIFFERENT in what is not compared: only {where}: {told}")
        assert f"not compared, and not the same: only {where}: {told}" in out
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["agrees"] is False
    # it is no difference between a model and itself under other names
    renamed = tmp_path / "renamed.xml"
    renamed.write_text(other.read_text().replace("pivot", "hinge"))
    status, out, _ = run(capsys, "run", other, "--against", renamed, "--output", tmp_path / "out")
    assert status == 0
    assert out.splitlines()[-1].startswith("SAME: ")


GEARED = """<mujoco><compiler angle="radian"/>
<default><geom size="0.1" contype="0" conaffinity="0"/></default>
<worldbody><body name="left"><joint name="a" axis="0 1 0"/><geom pos="0 0 0.2"/></body>
<body name="right"><joint name="d" axis="0 1 0"/><geom pos="1 0 1"/></body></worldbody>
<equality><joint name="je" joint1="a" joint2="d" polycoef="0 1 {} 0 0"/></equality></mujoco>"""


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [
        ("0", "0.01", "only there: equality 'je': approximated: gear 'je' of ratio 1, its polynomial"),
        ("0.02", "0.01", "polynomial of equality 'je' 0 1 0.02 0 0 here, 0 1 0.01 0 0 there"),
    ],
)
def test_approximations_that_differ_are_a_difference(capsys, tmp_path, first, second, told) -> None:
    paths = [tmp_path / "one.xml", tmp_path / "two.xml"]
    for path, square in zip(paths, (first, second), strict=True):
        path.write_text(GEARED.format(square))
    arguments = ("run", paths[0], "--against", paths[1], "--output", tmp_path / "out")
    status, out, _ = run(capsys, *arguments)
    assert status == 1
    assert out.splitlines()[-1].startswith(f"DIFFERENT in what is not compared: {told}")


def test_softness_and_stepping_inform(capsys, tmp_path) -> None:
    other = tmp_path / "other.xml"
    text = LINKAGE.read_text().replace('timestep="0.002"', 'timestep="0.01" integrator="RK4"')
    other.write_text(text.replace("<connect ", '<connect solref="0.1 1" '))
    status, out, _ = run(capsys, "run", LINKAGE, "--against", other, "--output", tmp_path / "out")
    assert status == 0
    *_, verdict = out.splitlines()
    assert verdict.startswith("SAME: ")
    assert verdict.endswith("; not compared and different: 3 elements, first timestep 0.002 here, 0.01 there")
    for told in ("timestep 0.002 here, 0.01 there", "solref of equality 'loop' 0.02 1 here, 0.1 1 there"):
        assert f"differs in softness or stepping only: {told}" in out


def test_one_file_against_itself_is_told(capsys, tmp_path) -> None:
    status, out, _ = run(capsys, "run", LINKAGE, "--against", LINKAGE, "--output", tmp_path / "out")
    assert status == 0
    assert f"both are {LINKAGE}: one model against itself" in out
