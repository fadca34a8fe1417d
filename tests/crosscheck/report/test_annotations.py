"""Differences at lines of files: workflow commands of GitHub, SARIF, and the summary in Markdown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import pytest
from command_line import run

import crosscheck
from crosscheck.report.annotations import MOTION, annotate, sarif, workflow_commands

FIRST = """<mujoco>
<worldbody>
<body name="upper">
<joint name="shoulder" axis="0 1 0" damping="0.2"/>
<inertial pos="0.1 0 0" mass="1.5" diaginertia="0.002 0.01 0.01"/>
</body>
</worldbody>
</mujoco>"""

SECOND = """<robot name="arm">
<link name="base"/>


<link name="upper">
<inertial><origin xyz="0.1 0 0"/><mass value="1.8"/>
<inertia ixx="0.002" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="q1" type="continuous">
<parent link="base"/><child link="upper"/><axis xyz="0 1 0"/><dynamics damping="0.5"/></joint>
</robot>"""

REQUIRED = {
    "": ("version", "runs"),
    "runs": ("tool",),
    "tool": ("driver",),
    "driver": ("name",),
    "rules": ("id",),
    "results": ("message",),
    "locations": (),
    "relatedLocations": (),
    # of a message and of an artifact's location, one of several is required: these are in use
    "message": ("text",),
    "shortDescription": ("text",),
    "artifactLocation": ("uri",),
    # GitHub needs these
    "physicalLocation": ("artifactLocation", "region"),
    "region": ("startLine",),
}
"""Required fields of the schema of SARIF 2.1.0, by the field whose value they are in."""


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    monkeypatch.chdir(tmp_path)
    Path("first.xml").write_text(FIRST)
    Path("second.urdf").write_text(SECOND)
    return "first.xml", "second.urdf"


def test_lines_are_those_of_the_elements(files: tuple[str, str]) -> None:
    """The joint has another name in the second file."""
    found = {each.rule: each for each in annotate(crosscheck.diff(*files).comparison)}
    assert set(found) == {"mass", "damping"}
    assert [(Path(line.path).name, line.line) for line in found["mass"].lines] == [
        ("second.urdf", 5),
        ("first.xml", 3),
    ]
    assert [line.line for line in found["damping"].lines] == [8, 4]
    assert "1.5 against 1.8 kg" in found["mass"].text


def test_lines_are_those_of_partners_if_names_are_exchanged(files: tuple[str, str]) -> None:
    """A joint has the name of a body, and names of joints are exchanged; lines are counted by hand."""
    text = """<mujoco><worldbody>
<body name="a"><joint name="{0}" axis="0 1 0" damping="{2}"/>
<inertial pos="0.1 0 0" mass="{3}" diaginertia="0.02 0.1 0.1"/>
<body name="b" pos="0.3 0 0.1"><joint name="{1}" axis="1 0 0"/>
<inertial pos="0.1 0.2 0" mass="0.8" diaginertia="0.01 0.04 0.03"/></body>
</body></worldbody></mujoco>"""
    Path(files[0]).write_text(text.format("q", "a", 0.2, 1.5))
    Path("second.xml").write_text(text.format("a", "q", 0.3, 1.8))
    found = {each.rule: each for each in annotate(crosscheck.diff(files[0], "second.xml").comparison)}
    assert [line.line for line in found["damping"].lines] == [2, 2]
    assert [line.line for line in found["mass"].lines] == [2, 2]


UNNAMED = """<mujoco><worldbody>
<body name="upper">
<joint name="fore" axis="0 1 0"/>
<inertial pos="0.1 0 0" mass="1.5" diaginertia="0.02 0.1 0.1"/>
<body name="fore" pos="0.3 0 0.1">
<joint axis="1 0 0" {damping}/>
<inertial pos="0.1 0.2 0" mass="0.8" diaginertia="0.01 0.04 0.03"/></body>
</body></worldbody>
<actuator>
<motor {name} joint="fore" gear="{gear}"/>
</actuator></mujoco>"""


@pytest.mark.parametrize(
    ("name", "change", "quantity", "line"),
    [
        ("", {"damping": 'damping="0.7"'}, "damping", 5),
        ("", {"gear": 11}, "gear", 10),
        ('name="upper"', {"gear": 11}, "gear", 10),
    ],
)
def test_lines_of_elements_without_name(
    files: tuple[str, str], name: str, change: dict[str, Any], quantity: str, line: int
) -> None:
    """A joint has the name of a body, and a drive that of its joint or of a body; lines counted by hand."""
    given = {"name": name, "damping": "", "gear": 10}
    Path(files[0]).write_text(UNNAMED.format(**given))
    Path("second.xml").write_text(UNNAMED.format(**given | change))
    (found,) = annotate(crosscheck.diff(files[0], "second.xml").comparison)
    assert (found.rule, [each.line for each in found.lines]) == (quantity, [line, line])


def test_files_in_the_current_folder_come_first(
    files: tuple[str, str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Only the first file is part of the checkout: its lines are shown."""
    outside = tmp_path_factory.mktemp("before") / "second.urdf"
    outside.write_text(SECOND)
    comparison = crosscheck.diff(files[0], outside).comparison
    assert all(each.lines[0].path.endswith("first.xml") for each in annotate(comparison))
    first, second = json.loads(sarif(comparison))["runs"][0]["results"][0], outside.as_uri()
    (location,) = first["relatedLocations"]
    assert location["physicalLocation"]["artifactLocation"]["uri"] == second


def test_workflow_commands(
    files: tuple[str, str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "::error" not in run(capsys, "diff", *files, "--output", "out")[1]
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    status, output, _ = run(capsys, "diff", *files, "--output", "out")
    assert status == 1
    commands = [line for line in output.splitlines() if line.startswith("::")]
    heads = {command.split("::")[1] for command in commands}
    assert heads == {f"error file=second.urdf,line={line},title=crosscheck diff" for line in (5, 8)}
    assert all("%25" in command and "%\n" not in command for command in commands)


def test_texts_of_strangers_end_no_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name = "upper&#10;::error::100 %"
    Path("a,b:c.xml").write_text(FIRST.replace('"upper"', f'"{name}"'))
    Path("first.xml").write_text(FIRST.replace('"upper"', f'"{name}"').replace('"1.5"', '"1.8"'))
    (command,) = workflow_commands(crosscheck.diff("first.xml", "a,b:c.xml").comparison)
    assert "\n" not in command
    assert command.startswith("::error file=a%2Cb%3Ac.xml,line=3,title=crosscheck diff::mass of upper")
    assert "100 %25" in command


def fields(value: Any, name: str = "") -> list[tuple[str, dict[str, Any]]]:
    """Return all objects of a JSON value, each with the name of the field that it is in."""
    if isinstance(value, list):
        return [found for entry in value for found in fields(entry, name)]
    if not isinstance(value, dict):
        return []
    return [(name, value), *(found for key, entry in value.items() for found in fields(entry, key))]


def test_sarif_has_the_required_fields(files: tuple[str, str]) -> None:
    log = json.loads(sarif(crosscheck.diff(*files).comparison))
    assert log["version"] == "2.1.0"
    found = fields(log)
    assert {name for name, _ in found} >= set(REQUIRED)
    for name, value in found:
        assert set(REQUIRED.get(name, ())) <= set(value), name
    (results,) = (each["results"] for each in log["runs"])
    rules = log["runs"][0]["tool"]["driver"]["rules"]
    for result in results:
        assert rules[result["ruleIndex"]]["id"] == result["ruleId"]
        assert result["level"] == "error"
        (location,) = result["locations"]
        assert location["physicalLocation"]["artifactLocation"]["uri"] == "second.urdf"
    assert [each["locations"][0]["physicalLocation"]["region"]["startLine"] for each in results] == [8, 5]


def test_equal_files_have_no_annotations(files: tuple[str, str]) -> None:
    comparison = crosscheck.diff(files[0], files[0]).comparison
    assert annotate(comparison) == []
    assert json.loads(sarif(comparison))["runs"][0]["results"] == []


def test_models_in_memory_have_no_lines() -> None:
    models = [mujoco.MjModel.from_xml_string(FIRST.replace("1.5", mass)) for mass in ("1.5", "1.8")]
    comparison = crosscheck.diff(*models).comparison
    (found,) = annotate(comparison)
    assert (found.rule, found.lines) == ("mass", ())
    assert json.loads(sarif(comparison))["runs"][0]["results"][0]["locations"] == []
    assert list(workflow_commands(comparison)) == [
        f"::error title=crosscheck diff::{found.text.replace('%', '%25')}"
    ]


def test_summary_is_markdown(files: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    run(capsys, "diff", *files, "--output", "out")
    lines = Path("out/summary.md").read_text().splitlines()
    assert lines[0] == "# first.xml (MJCF) and second.urdf (URDF)"
    assert lines[2].startswith("**DIFFERENT: 2 differences; ")
    assert lines[4] == "| motion | difference | what differs |"
    assert sum("mass of upper: 1.5 against 1.8 kg" in line for line in lines) == 1
    assert MOTION not in {each.rule for each in annotate(crosscheck.diff(*files).comparison)}
