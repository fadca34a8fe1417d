"""Baselines, the action and the guide of `crosscheck regress`: files that people and machines read."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_line import run

from crosscheck.cli.shared import cli
from crosscheck.library import SCENES
from crosscheck.regress import run as regress
from crosscheck.regress.baseline import (
    Baseline,
    MeasurementPlan,
    StoredQuantity,
    StoredState,
    UpdateRecord,
    read_baseline,
)
from crosscheck.regress.plan import OUTPUT_COUNT
from crosscheck.support.checksum import with_checksum
from newton_euler.model.state import State

ROOT = Path(__file__).parents[3]


# Baselines


def small_baseline():
    state = StoredState.of(State(*(np.zeros((2, n)) for n in (3, 4, 3, 3))))
    return Baseline(
        scene="tracker", options={}, history=[UpdateRecord.now("first", [])], left_out={},
        plan=MeasurementPlan(rtol={"relative": 1e-9}, step=0.1, time=0.0, state=state),
        quantities=[
            StoredQuantity(
                group="relative", name="position", unit="m", rows=["bar"], columns=["x"],
                value=[[1.0 / 3.0]], tolerance=[1e-9],
            )
        ],
    )  # fmt: skip


def reseal(content, **changes):
    content.update(with_checksum(content | changes))


def test_a_baseline_survives_its_file(tmp_path):
    measured = read_baseline(regress.usual_path("tracker"))
    path = tmp_path / "b.json"
    path.write_text(measured.text())
    assert read_baseline(path) == measured
    path.write_bytes(measured.text().replace("\n", "\r\n").encode())  # as a checkout on Windows has it
    assert read_baseline(path) == measured
    # a quantity a line, so that changes can be read
    assert sum(line.startswith('  {"group"') for line in measured.text().splitlines()) == len(
        measured.quantities
    )


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda c: c.pop("plan"), "plan: Field required"),
        (lambda c: c.update(format=2), "format: another version of crosscheck wrote the file"),
        (lambda c: c["history"][0].update(reason=""), "history.0.reason"),
        (
            lambda c: c["quantities"][0].update(group="Speed"),
            "quantities.0.group: 'Speed' is no group; ",
        ),
        (lambda c: c["quantities"][0].update(tolerance=[1.0, 1.0]), "quantities.0: tolerance has 2 numbers"),
        (
            lambda c: c["quantities"][0].update(value=[[1.0, 2.0]]),
            "quantities.0: value is not a table",
        ),
        (lambda c: c.update(quantities=c["quantities"] * 2), "file: quantities: 'position'"),
        (lambda c: c["plan"]["state"].update(position=[[0.0]]), "plan.state.position.0.1: Field required"),
        (lambda c: c["quantities"][0].update(tolerance=[1e9]), "sha256: does not fit the other fields"),
        (lambda c: c["quantities"][0].update(value=[[0.5]]), "sha256: does not fit the other fields"),
        (lambda c: c.pop("sha256"), "sha256: does not fit the other fields"),
        (lambda c: reseal(c, scene="four_bar"), "scene: it is of 'four_bar', not of 'tracker'"),
        (
            lambda c: reseal(c, options={"N": "3"}),
            "options: of tracker (N=3), not of tracker; delete it",
        ),
    ],
)
def test_a_corrupt_baseline_is_named_with_its_field(capsys, tmp_path, change, field):
    content = json.loads(small_baseline().text())
    change(content)
    path = tmp_path / "b.json"
    path.write_text(json.dumps(content))
    status, out, err = run(capsys, "regress", "tracker", "--baseline", path)
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert f"{path}: {field}" in err


def test_a_missing_baseline_names_what_makes_it(capsys, tmp_path):
    path = tmp_path / "none.json"
    status, _, err = run(capsys, "regress", "four_bar", "--baseline", path)
    assert (status, err) == (2, f"crosscheck: error: no baseline {path}; create it with --update REASON\n")


def test_the_library_has_a_baseline_for_each_scene():
    for name in SCENES:
        found = read_baseline(regress.usual_path(name))
        assert (found.scene, found.options) == (name, {})
        assert found.groups[:2] == ["model", "relative"]
        assert len(found.find("relative", "position over time").rows) == OUTPUT_COUNT + 1


# The action and the guide


def known_options():
    return {option for parameter in cli.commands["regress"].params for option in parameter.opts}


def test_the_action_runs_a_command_that_exists():
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    assert action["runs"]["using"] == "composite"
    (script,) = [
        step["run"] for step in action["runs"]["steps"] if "crosscheck regress" in step.get("run", "")
    ]
    words = script.replace("(", " ").replace(")", " ").split()
    used = {word for word in words if word.startswith("--") and word != "--"}
    assert used
    assert used <= known_options()
    # inputs reach the shell through variables only, so that none of them is run as a command
    assert not any("${{" in step.get("run", "") for step in action["runs"]["steps"])
    for step in action["runs"]["steps"]:
        assert "shell" in step or "run" not in step


def test_the_inputs_of_the_action_reach_the_command(tmp_path):
    """Options with blanks and models, one a line, and a model that begins with a dash."""
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    (step,) = [step for step in action["runs"]["steps"] if "crosscheck regress" in step.get("run", "")]
    given = {"OPTIONS": "root=my parts\nbodies=3000\n", "BASELINE": "", "MODEL": "-x.xml\nmy arm.urdf\n"}
    given["ALLOW_REDUCED"] = "true"
    assert set(given) == set(step["env"])
    shown = 'crosscheck() { printf "%s\\n" "$@"; }\n' + step["run"]
    command = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", shown]
    done = subprocess.run(command, cwd=tmp_path, env=given, capture_output=True, text=True, check=True)
    words = done.stdout.splitlines()
    assert words[-6:] == ["--set", "bodies=3000", "--allow-reduced", "--", "-x.xml", "my arm.urdf"]
    assert words[-8:-6] == ["--set", "root=my parts"]


def test_the_guide_is_a_workflow_of_ten_lines_that_fits_the_action():
    guide = (ROOT / "docs" / "how_to" / "guard.md").read_text()
    blocks = guide.split("```")[1::2]
    workflow, pipeline = (block.removeprefix("yaml\n") for block in blocks if block.startswith("yaml\n"))
    assert len(workflow.strip().splitlines()) <= 10
    (job,) = yaml.safe_load(workflow)["jobs"].values()
    inputs = yaml.safe_load((ROOT / "action.yml").read_text())["inputs"]
    (step,) = [step for step in job["steps"] if "with" in step]
    assert set(step["with"]) <= set(inputs)
    (job,) = yaml.safe_load(pipeline).values()
    # the folders of `run` and of `regress` with one and with several models have different depths
    assert job["artifacts"]["reports"]["junit"] == "output/**/junit.xml"
    (table,) = re.findall(r"\| input \|.*?\n\n", guide, re.DOTALL)
    assert re.findall(r"^\| `([\w-]+)` \|", table, re.MULTILINE) == list(inputs)


def test_a_model_file_has_the_options_of_its_baseline(tmp_path):
    path = tmp_path / "robot.baseline.json"
    assert regress.stored_options("robot.xml", path, {"key": "go"}) == {"key": "go"}
    content = json.loads(small_baseline().text()) | {"options": {"key": "go", "duration": "2", "root": "/"}}
    path.write_text(json.dumps(with_checksum(content)))
    assert regress.stored_options("robot.xml", path, {"duration": "3"}) == {"key": "go", "duration": "3"}
    assert regress.stored_options("tracker", path, {}) == {}


def test_options_of_one_baseline_are_not_those_of_the_next(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seen = []
    monkeypatch.setattr(regress, "check_baselines", lambda guarded, *_: seen.extend(guarded) or ([], {}, []))
    (tmp_path / "m.xml").write_text(
        '<mujoco><worldbody><body name="bob"><joint/><geom size="1" pos="0 0 9"/></body></worldbody></mujoco>'
    )
    assert run(capsys, "regress", "m.xml", "pendulum")[0] == 0
    assert [each.options for each in seen] == [{"excitation": "on"}, {}]
