"""`crosscheck diff` and `crosscheck.diff`: exit status, JSON result and table of two model files."""

from __future__ import annotations

import json
import re
from pathlib import Path

import mujoco
import pytest
from command_line import run, scene_file, short_example

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.report.diff import verdict
from crosscheck.support.errors import CrosscheckError

ROOT = Path(__file__).parents[3]

ARM = """<mujoco model="arm"><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="0.2"/>
  <inertial pos="0.1 0 0" mass="{mass}" diaginertia="0.002 0.01 0.01"/>
  <body name="lower" pos="0.3 0 0"><joint name="elbow" axis="0 1 0"/>
    <inertial pos="0.1 0 0" mass="0.8" diaginertia="0.001 0.004 0.004"/></body></body></worldbody>
  <actuator><motor name="drive" joint="elbow" gear="{gear}"/></actuator></mujoco>"""


@pytest.fixture
def arm(tmp_path):
    def write(name, mass="1.5", gear="10"):
        path = tmp_path / f"{name}.xml"
        path.write_text(ARM.format(mass=mass, gear=gear))
        return str(path)

    return write


@pytest.mark.parametrize(
    ("values", "outcome", "status"),
    [
        ({}, "SAME", 0),
        ({"mass": "1.50001"}, "SAME TO ROUNDING", 0),  # of 1.5, written with two digits
        ({"mass": "1.52"}, "DIFFERENT", 1),
        ({"gear": "-10"}, "DIFFERENT", 1),
    ],
)
def test_exit_status_and_outcome(capsys, arm, tmp_path, values, outcome, status):
    other = arm("other", **values)
    status_found, _, _ = run(capsys, "diff", arm("first"), other, "--output", tmp_path / "out")
    assert status_found == status
    result = json.loads((tmp_path / "out" / "diff.json").read_text())
    assert result["outcome"] == outcome
    assert result["report"]["verdict"].startswith(f"{outcome}: ")


def test_numbers_of_a_difference(arm):
    found = crosscheck.diff(arm("first"), arm("other", mass="1.8"))
    assert not found.same
    assert found.outcome is Outcome.DIFFERENT
    [row] = found.differences
    assert (row.element, row.quantity, row.first, row.second) == ("upper", "mass", 1.5, 1.8)
    assert row.size == pytest.approx(0.2)


def test_models_in_memory(arm):
    first = mujoco.MjModel.from_xml_path(arm("first"))
    assert crosscheck.diff(first, mujoco.MjSpec.from_file(arm("second"))).same
    assert [each.element for each in crosscheck.diff(first, arm("other", gear="12")).differences] == ["drive"]


def test_tolerance_replaces_the_digits(arm):
    assert not crosscheck.diff(arm("first"), arm("other", mass="1.52"), tolerance=0.01).same
    assert crosscheck.diff(arm("first"), arm("other", mass="1.52"), tolerance=0.02).same


def test_folders_tell_equal_file_names_apart(capsys, arm, tmp_path):
    (tmp_path / "old").mkdir()
    before, now = arm("old/arm"), arm("arm", mass="1.8")
    _, text, _ = run(capsys, "diff", before, now, "--verbose", "--output", tmp_path / "out")
    assert f"old/arm.xml (MJCF) and {tmp_path.name}/arm.xml (MJCF)\n" in text
    assert re.search(r"element +quantity +first +second", text)  # the names are too long for columns
    (tmp_path / "old" / "robots").mkdir()
    (tmp_path / "new" / "robots").mkdir(parents=True)
    before, now = arm("old/robots/arm"), arm("new/robots/arm", mass="1.8")
    _, text, _ = run(capsys, "diff", before, now, "--verbose", "--output", tmp_path / "both")
    assert "old/.../arm.xml (MJCF) and new/.../arm.xml (MJCF)\n" in text
    assert re.search(r"element +quantity +old/\.\.\./arm\.xml +new/\.\.\./arm\.xml", text)


def test_all_elements_of_a_row_are_listed(capsys, tmp_path):
    damped = ARM.replace('name="elbow"', 'name="elbow" damping="0.3"').format(mass="1.5", gear="10")
    (tmp_path / "damped.xml").write_text(damped)
    (tmp_path / "free.xml").write_text(damped.replace('damping="0.3"', "").replace('damping="0.2"', ""))
    out = tmp_path / "out"
    _, text, _ = run(
        capsys, "diff", tmp_path / "damped.xml", tmp_path / "free.xml", "--verbose", "--output", out
    )
    assert re.search(r"^1  damping: (shoulder, elbow|elbow, shoulder)$", text, re.MULTILINE)
    # a range of values has a unit, too
    assert re.search(r"0\.2 to 0\.3\s+N m\s+s/rad", text)
    assert "<b>1</b> damping: " in (out / "report.html").read_text()


@pytest.mark.parametrize("value", ["nan", "1", "100%", "-0.1", "abc", "1 %%"])
def test_bad_tolerances_are_refused(capsys, arm, value):
    status, _, error = run(capsys, "diff", arm("first"), arm("other"), "--tolerance", value)
    assert status == 2
    needed = "a number from 0 on and below 1, such as 1e-3 or 0.1%"
    assert f"'--tolerance': {value!r}; needed: {needed}" in " ".join(error.split())


@pytest.mark.parametrize(("value", "status"), [("1%", 1), ("2%", 0), ("0.02", 0)])
def test_a_tolerance_may_be_a_percentage(capsys, arm, tmp_path, value, status):
    # 1.52 kg against 1.5 kg: 1.33 %
    paths = arm("first"), arm("other", mass="1.52")
    assert run(capsys, "diff", *paths, "--tolerance", value, "--output", tmp_path / "out")[0] == status


def test_names_that_the_user_pairs(capsys, arm, tmp_path):
    other = arm("other")
    with open(other) as file:
        renamed = file.read().replace("elbow", "q2").replace("shoulder", "q1")
    (tmp_path / "other.xml").write_text(renamed)
    pairs = tmp_path / "names.yaml"
    pairs.write_text("elbow: q2\n")
    status_found, _, _ = run(
        capsys, "diff", arm("first"), other, "--names", pairs, "--output", tmp_path / "out"
    )
    assert status_found == 0
    assert run(capsys, "diff", arm("first"), other, "--names", tmp_path / "none.yaml")[0] == 2
    pairs.write_text("wrist: q2\n")
    assert run(capsys, "diff", arm("first"), other, "--names", pairs)[0] == 2


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "no names"),
        ("- elbow\n- shoulder\n", "['elbow', 'shoulder']"),
        ("elbow\n", "'elbow'"),
        ("elbow: {shoulder: 1}\n", "'elbow'"),
        ("elbwo: elbow\n", "'elbwo'; closest: elbow"),
        ("elbow: elbwo\n", "'elbwo'; closest: elbow"),
        ("elbow: shoulder\nshoulder: shoulder\n", "'elbow': 'shoulder' and 'shoulder': 'shoulder'"),
        ("elbow: elbow\nelbow: shoulder\n", "'elbow'"),
    ],
)
def test_names_that_cannot_be_paired_are_one_line_with_the_file(capsys, arm, tmp_path, text, named):
    pairs = tmp_path / "names.yaml"
    pairs.write_text(text)
    status_found, _, error = run(capsys, "diff", arm("first"), arm("other"), "--names", pairs)
    assert status_found == 2
    (line,) = error.strip().splitlines()
    assert f"{pairs}: " in line
    assert named in line


def test_a_scene_and_its_file():
    assert crosscheck.diff("tracker", ROOT / "mjcf" / "tracker.xml").outcome is Outcome.SAME


def test_results_of_other_files_are_not_overwritten(capsys, arm, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = arm("first")
    assert run(capsys, "diff", first, first)[0] == 0
    (tmp_path / "folder").mkdir()
    other = tmp_path / "folder" / "first.xml"
    other.write_text(ARM.format(mass="2", gear="1"))
    assert run(capsys, "diff", str(other), first)[0] == 2


def test_scene_files_are_compared_again_into_the_default_folder(capsys, tmp_path, monkeypatch):
    """The second comparison replaces the results of the first one; one of other files does not."""
    monkeypatch.chdir(tmp_path)
    for name in ("one.yaml", "two.yaml", "folder/one.yaml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        scene_file((tmp_path / name).parent, short_example(), Path(name).name)
    assert run(capsys, "diff", "one.yaml", "two.yaml")[0] == 0
    assert run(capsys, "diff", "one.yaml", "two.yaml")[0] == 0
    written = json.loads((tmp_path / "output/diff/one_two/diff.json").read_text())
    assert [model["source"] for model in written["models"]] == ["one.yaml", "two.yaml"]
    assert run(capsys, "diff", "folder/one.yaml", "two.yaml")[0] == 2


def test_an_option_that_a_file_does_not_have_is_refused(capsys, arm, tmp_path):
    urdf = tmp_path / "one.urdf"
    urdf.write_text('<robot name="one"><link name="base"/></robot>')
    for option in ("key=go", "gravity=0"):
        assert run(capsys, "diff", urdf, arm("first"), "--set-first", option)[0] == 2
        assert run(capsys, "diff", arm("first"), urdf, "--set-first", option)[0] == 2
    with pytest.raises(CrosscheckError):
        crosscheck.diff(urdf, arm("first"), first_options={"gravity": "0"})


@pytest.mark.slow
def test_a_converted_model_with_its_loop_file_moves_alike(capsys, tmp_path):
    text = (ROOT / "examples" / "linkage.xml").read_text()
    text = re.sub(r"<actuator>.*</keyframe>", "", text, flags=re.DOTALL)  # no URDF has drives
    text = re.sub(r' (armature|stiffness|damping)="[^"]*"', "", text)
    model, converted = tmp_path / "linkage.xml", tmp_path / "converted.urdf"
    model.write_text(text)
    assert run(capsys, "convert", model, converted)[0] == 0
    loops = f"loops={tmp_path / 'converted.loops.yaml'}"
    arguments = "diff", model, converted, "--set-second", loops, "--output", tmp_path / "out"
    assert run(capsys, *arguments)[0] == 0
    found = json.loads((tmp_path / "out" / "diff.json").read_text())
    assert [each["source"] for each in found["models"]] == [str(model), str(converted)]
    assert found["outcome"] == "SAME"
    assert found["motion"]["change"] < 1e-12  # round-off of a mechanism of condition 30
    assert found["run"]["distance"] <= found["run"]["uncertainty"]


FLOATING = """<mujoco model="leg"><worldbody><body name="hip" pos="0 0 1"><freejoint name="free"/>
    <inertial pos="0 0 0.1" mass="2" diaginertia="0.02 0.01 0.03"/>
  <body name="shank" pos="0 0 -0.4"><joint name="knee" axis="0 1 0"/>
    <inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.004 0.005 0.001"/></body></body></worldbody>
</mujoco>"""

FIXED = """<robot name="leg">
  <link name="hip"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.03"/></inertial></link>
  <link name="shank"><inertial><origin xyz="0 0 -0.2"/><mass value="0.5"/>
    <inertia ixx="0.004" ixy="0" ixz="0" iyy="0.005" iyz="0" izz="0.001"/></inertial></link>
  <joint name="knee" type="continuous"><parent link="hip"/><child link="shank"/>
    <origin xyz="0 0 -0.4"/><axis xyz="0 1 0"/></joint></robot>"""


def test_the_option_that_lets_a_base_float(tmp_path):
    """A URDF does not say whether its root link floats; the difference goes with the option that is named."""
    (tmp_path / "leg.xml").write_text(FLOATING)
    (tmp_path / "leg.urdf").write_text(FIXED)
    files = str(tmp_path / "leg.xml"), str(tmp_path / "leg.urdf")
    held = crosscheck.diff(*files)
    [row] = held.differences
    assert (row.quantity, held.same) == ("base", False)
    assert verdict(held.comparison) == "DIFFERENT: 1 difference; what both have moves alike"
    assert any("base=free lets the second float" in note for note in held.comparison.motion.notes)
    assert crosscheck.diff(*files, second_options={"base": "free"}).outcome is Outcome.SAME
    with pytest.raises(CrosscheckError, match="it has loops and base"):
        crosscheck.diff(*files, second_options={"root": "free"})


@pytest.mark.parametrize(("tolerance", "words"), [([], "digits"), (["--tolerance", "1%"], "tolerance")])
def test_rounding_names_what_allows_it(capsys, arm, tmp_path, tolerance, words):
    mass = "1.51" if tolerance else "1.500001"
    folder = tmp_path / "out"
    _, printed, _ = run(capsys, "diff", arm("first"), arm("other", mass=mass), *tolerance, "--output", folder)
    allowed = {"digits": "within their digits", "tolerance": "within the tolerance"}[words]
    assert f"SAME TO ROUNDING: 1 number differs {allowed};" in " ".join(printed.split())
    [row] = json.loads((folder / "diff.json").read_text())["differences"]
    assert row["cause"] == {"digits": "digits of the files", "tolerance": "within the tolerance"}[words]


def test_one_of_a_kind_is_singular(capsys, tmp_path):
    text = """<mujoco><option gravity="0 0 {}"/><worldbody><body name="link"><joint name="turn"/>
      <inertial pos="0.1 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></worldbody></mujoco>"""
    paths = [tmp_path / "earth.xml", tmp_path / "moon.xml"]
    for path, gravity in zip(paths, (-9.81, -1.62), strict=True):
        path.write_text(text.format(gravity), encoding="utf-8")
    _, printed, _ = run(capsys, "diff", *paths, "--output", tmp_path / "out")
    words = " ".join(printed.split())
    assert "paired: 1 body and 1 joint " in words
    # the file has no name of its own: it is not MuJoCo's default, "MuJoCo Model"
    assert "gravity of earth: 0 0 -9.81 against 0 0 -1.62 m/s^2" in words


FUSED = """<mujoco><compiler fusestatic="{}"/><worldbody><body name="stand" pos="0 0 1">
  <inertial pos="0 0 0" mass="3" diaginertia="0.1 0.1 0.1"/>
  <body name="arm"><joint name="turn" axis="0 1 0"/>
    <inertial pos="0.1 0 0" mass="1" diaginertia="0.1 0.1 0.1"/></body></body></worldbody></mujoco>"""


def test_a_body_fixed_to_the_ground_that_only_one_file_has_is_no_difference(tmp_path):
    paths = [tmp_path / "parts.xml", tmp_path / "fused.xml"]
    for path, fuses in zip(paths, ("false", "true"), strict=True):
        path.write_text(FUSED.format(fuses), encoding="utf-8")
    # MuJoCo's own accelerations are equal to the last bit, and only one model has the body
    models = [mujoco.MjModel.from_xml_path(str(path)) for path in paths]
    states = [mujoco.MjData(model) for model in models]
    for model, state in zip(models, states, strict=True):
        mujoco.mj_forward(model, state)
    assert [model.nbody for model in models] == [3, 2]
    assert states[0].qacc.tolist() == states[1].qacc.tolist()
    found = crosscheck.diff(*paths)
    assert (found.outcome, found.same) == (Outcome.SAME, True)
    [row] = found.comparison.rows
    assert (row.element, row.quantity, row.first, row.second) == ("stand", "presence", 3.0, None)
    assert (row.standing, row.cause) == ("convention", "fixed to the ground")


OPEN = """<mujoco><worldbody><site name="far" pos="{x} 0.3 0.2"/><body name="arm">
  <joint name="turn" axis="0 1 0"/><inertial pos="0.1 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>
  <site name="tip" pos="0.3 0 0"/></body></worldbody>
  <equality><connect site1="tip" site2="far"/></equality></mujoco>"""


@pytest.mark.parametrize(
    ("x", "comment", "outcome", "status"),
    [
        ("5", "", "SAME", 0),  # the same text
        ("5", "<!-- second -->", "UNFINISHED", 3),
        ("5.0000001", "", "UNFINISHED", 3),  # rounding
        ("6", "", "DIFFERENT", 1),
    ],
)
def test_loops_that_do_not_close_are_not_the_same(capsys, tmp_path, x, comment, outcome, status):
    """No pose brings the tip, 0.3 m from the joint, to a point 5 m away, so that no motions are compared."""
    paths = [tmp_path / "first.xml", tmp_path / "second.xml"]
    paths[0].write_text(OPEN.format(x="5"), encoding="utf-8")
    paths[1].write_text(OPEN.format(x=x) + comment, encoding="utf-8")
    found, printed, _ = run(capsys, "diff", *paths, "--output", tmp_path / "out")
    assert found == status
    assert f"{outcome}: " in printed
    assert "motions were not compared" in " ".join(printed.split())
    assert crosscheck.diff(*paths).same == (status == 0)


LEGS = """<mujoco><worldbody><body name="trunk" pos="0 0 1"><freejoint name="float"/>
  <inertial pos="0 0 0" mass="3" diaginertia="0.1 0.1 0.1"/>
  <body name="{0}" pos="0 0.2 0"><joint name="{0}_hip" axis="0 1 0"/>
    <inertial pos="0 0.02 -0.2" mass="1" diaginertia="0.01 0.01 0.003"/></body>
  <body name="{1}" pos="0 -0.2 0"><joint name="{1}_hip" axis="0 1 0"/>
    <inertial pos="0 -0.02 -0.2" mass="1" diaginertia="0.01 0.01 0.003"/></body></body>
  </worldbody></mujoco>"""


def test_names_that_are_exchanged_are_one_difference(tmp_path):
    paths = [tmp_path / "first.xml", tmp_path / "second.xml"]
    for path, names in zip(paths, (("left", "right"), ("right", "left")), strict=True):
        path.write_text(LEGS.format(*names), encoding="utf-8")
    # MuJoCo's own models: the joint of one name is at other places
    places = [mujoco.MjModel.from_xml_path(str(path)).body("left").pos.tolist() for path in paths]
    assert places == [[0.0, 0.2, 0.0], [0.0, -0.2, 0.0]]
    found = crosscheck.diff(*paths)
    [row] = found.differences
    assert (row.quantity, row.first, row.second) == ("name", "left", "right")
    assert set(row.elements) == {"left", "right", "left_hip", "right_hip"}
    assert found.motion.likeness == "equal to round-off"
    # pairs that the user names are meant
    names = {"left": "right", "right": "left", "left_hip": "right_hip", "right_hip": "left_hip"}
    assert crosscheck.diff(*paths, names=names).same


def test_other_names_are_no_difference(tmp_path):
    paths = [tmp_path / "first.xml", tmp_path / "second.xml"]
    for path, names in zip(paths, (("left", "right"), ("L", "R")), strict=True):
        path.write_text(LEGS.format(*names), encoding="utf-8")
    assert crosscheck.diff(*paths).outcome is Outcome.SAME


def test_notes_name_one_of_like_elements_and_are_there_once(capsys, tmp_path):
    text = '<robot name="arm"><link name="l0"/>'
    for k in range(3):
        text += f"""<link name="l{k + 1}"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
          <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
          <joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="0 1 0"/>
          <limit lower="-1" upper="1" effort="9" velocity="9" other:rate="5"/></joint>"""
    text = text.replace('name="arm"', 'name="arm" xmlns:other="http://other"') + "{}</robot>"
    paths = [tmp_path / "one.urdf", tmp_path / "two.urdf"]
    for path, more in zip(paths, ("", "<odd/>"), strict=True):
        path.write_text(text.replace("{}", more))
    _, out, _ = run(capsys, "diff", paths[0], paths[0], "--output", tmp_path / "out")
    (note,) = (line for line in out.splitlines() if line.startswith("note: "))
    assert note.startswith("note: both files: ")
    assert note.count("joint 'j") == 1
    assert " and 2 more: " in note
    _, out, _ = run(capsys, "diff", *paths, "--output", tmp_path / "out")
    assert sum(line.startswith("note: ") for line in out.splitlines()) == 2
