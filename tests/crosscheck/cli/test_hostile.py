"""Some hundred broken and hostile files: each is refused in one line, soon, and leaves no trace.

What is refused has status 2 and one line that names the file and the element. What random damage leaves whole
is converted. Nothing else is accepted.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from hostile_cases import cases
from hostile_files import MJCF, TEXTS, Case
from hostile_process import LONGEST_LINE, MEMORY, PROCESSOR_TIME, Server

from mjcf.errors import collected_warnings

CASES = {case.name: case for case in cases()}

FAST = [name for name in list(CASES)[::6] if not CASES[name].slow]


def files(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if not path.is_dir()}


def check(case: Case, server: Server, tmp_path: Path) -> None:
    folder = tmp_path / "case"
    arguments = case.make(folder)
    before = files(folder)
    outcome = server.run(folder, arguments)
    out, err = ((tmp_path / f"case.{stream}").read_text() for stream in ("stdout", "stderr"))
    assert not outcome["hangs"]
    assert outcome["processor_time"] < PROCESSOR_TIME
    assert outcome["memory"] < MEMORY
    if case.message is None and outcome["status"] == 0:
        assert err == ""
        assert files(folder) - before == {folder / "out.yaml"}
        return
    assert outcome["status"] == 2, err
    assert out == ""
    assert err.endswith("\n")
    line = err.removesuffix("\n")
    assert line.isprintable()
    assert line.startswith("crosscheck: error: ")
    assert len(line) < LONGEST_LINE
    assert "internal error" not in line
    assert case.blames in line
    assert (case.message or "") in line
    assert files(folder) == before


@pytest.mark.parametrize("name", FAST)
def test_broken_files_are_refused_in_one_line(name: str, server: Server, tmp_path: Path) -> None:
    check(CASES[name], server, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CASES if name not in FAST])
def test_more_broken_files_are_refused_in_one_line(name: str, server: Server, tmp_path: Path) -> None:
    check(CASES[name], server, tmp_path)


@pytest.mark.parametrize("file", ["model.xml", "robot.urdf", "loops.yaml", "scene.yaml", "scene.json"])
def test_the_models_before_they_are_broken_are_fine(file: str, server: Server, tmp_path: Path) -> None:
    """So that what is refused is refused for its fault."""
    folder = tmp_path / "case"
    outcome = server.run(folder, Case("whole", file, TEXTS[file].encode()).make(folder))
    assert (outcome["status"], (tmp_path / "case.stderr").read_text()) == (0, "")


def test_an_include_is_found_beside_the_file_that_includes_it(server: Server, tmp_path: Path) -> None:
    """As MuJoCo does where there is none of that name beside the first file."""
    folder = tmp_path / "case"
    included = MJCF.replace("<worldbody>", '<include file="bodies/inner.xml"/><worldbody>')
    arguments = Case("included", "model.xml", included.encode()).make(folder)
    (folder / "bodies").mkdir()
    (folder / "bodies" / "inner.xml").write_text('<mujoco><include file="innermost.xml"/></mujoco>')
    (folder / "bodies" / "innermost.xml").write_text('<mujoco><option gravity="0 0 -7"/></mujoco>')
    assert server.run(folder, arguments)["status"] == 0
    assert yaml.safe_load((folder / "out.yaml").read_text())["gravity"] == [0.0, 0.0, -7.0]


def test_a_model_that_mujoco_warns_of_leaves_no_file_of_warnings(server: Server, tmp_path: Path) -> None:
    """Two hinges on one axis make the inertia matrix singular."""
    again = '<joint name="again" axis="0 1 0"/>'
    text = MJCF.replace('<geom type="mesh"', again + '<geom type="mesh"').replace('"0 0 0"/>', '"0 0 0 0"/>')
    message = "joint 'rocker_joints': its hinges [[0.0, 1.0, 0.0], [0.0, 1.0, 0.0]] depend on each other"
    check(Case("twice", "model.xml", text.encode(), message), server, tmp_path)


def test_warnings_are_heard_once_and_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint/><geom size="1"/></body></worldbody></mujoco>'
    )
    with collected_warnings() as heard:
        for _ in range(2):
            data = mujoco.MjData(model)
            data.qpos[0] = np.nan
            mujoco.mj_step(model, data)
    assert [line.split(" at ")[0] for line in heard] == ["Nan, Inf or huge value in QPOS"]
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr().err == ""
