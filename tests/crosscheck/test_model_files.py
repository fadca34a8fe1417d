"""Model files on the command line: what they convert to, and what is left out of them."""

from __future__ import annotations

import pytest
from command_line import run

from crosscheck.cli.shared import warn_about_import
from crosscheck.library import load
from crosscheck.support.errors import CrosscheckError
from newton_euler.reading.import_report import ImportReport

CLOSED_LOOP = "closed_loop: []\ntype: []\nname_mot: []\n"


PENDULUM_URDF = """<robot name="pendulum"><link name="base"/><link name="bob"><inertial>
<origin xyz="0 0 -0.5"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="continuous"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
<dynamics damping="0.5" friction="0.2"/></joint></robot>"""


@pytest.mark.parametrize("link", [False, True])
def test_convert_does_not_overwrite_what_it_reads(capsys, tmp_path, link):
    model, loops, other = tmp_path / "m.urdf", tmp_path / "o.loops.yaml", tmp_path / "o.urdf"
    model.write_text(PENDULUM_URDF)
    loops.write_text(CLOSED_LOOP)
    target = model
    if link:
        target = tmp_path / "link.urdf"
        target.symlink_to(model)
    for arguments, named in (
        ((model, target), model),
        ((model, "--set", f"loops={loops}", other), loops),  # a URDF's loop file is written beside it
    ):
        status, out, err = run(capsys, "convert", *arguments)
        assert (status, out) == (2, "")
        assert f"would overwrite the input file {named}" in err
    assert (model.read_text(), loops.read_text()) == (PENDULUM_URDF, CLOSED_LOOP)
    assert run(capsys, "convert", model, other)[0] == 0


def test_convert_files_each_element_once(capsys, tmp_path):
    """What reading carries over exactly and a URDF cannot hold is left out, not both."""
    model = tmp_path / "m.xml"
    model.write_text(
        '<mujoco><worldbody><body name="bob"><joint name="pivot" axis="0 1 0" armature="0.3" stiffness="2" '
        'damping="0.1"/><geom size="0.1" pos="0 0 -1"/><site name="tip" pos="0 0 -1"/></body></worldbody>'
        '<actuator><motor name="drive" joint="pivot" ctrllimited="false"/><position name="hold" '
        'joint="pivot" kp="3"/><motor name="push" site="tip" gear="1 0 0 0 0 0"/></actuator>'
        '<keyframe><key ctrl="1 0.2 3"/></keyframe></mujoco>'
    )
    assert "exactly:" not in run(capsys, "convert", model, tmp_path / "m.urdf")[1]
    status, out, _ = run(capsys, "convert", model, tmp_path / "m.urdf", "-v")
    assert status == 0
    carried, left = out[out.index("exactly:\n") : out.index("left out:\n")], out[out.index("left out:\n") :]
    for words in ("armature", "spring", "control law", "wrench"):
        assert words not in carried
    assert "  joint 'pivot': revolute joint 'pivot'" in carried
    assert "its stiffness 2 and damping 0.1 as a spring: a URDF has no forces but friction" in left
    assert "  armature of joint 'pivot': a URDF has no rotors" in left
    for name in ("drive", "hold"):
        assert left.count(f"actuator '{name}'") == 1
    assert "a URDF has no control laws" in left
    assert left.count("actuator 'push'") == 1
    assert "control of joint" not in left


@pytest.mark.parametrize(
    ("arguments", "target"),
    [
        (["bench"], "crosscheck.studies.benchmark.run.bench"),
        (["faults"], "crosscheck.studies.faults.find.find_faults"),
        (["regress"], "crosscheck.regress.run.check_baselines"),
    ],
)
def test_what_a_model_file_loses_is_told(capsys, tmp_path, monkeypatch, arguments, target):
    """Before anything is measured, which here is nothing."""

    def stops(*_, **__):
        raise CrosscheckError("reached")

    monkeypatch.setattr(target, stops)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.urdf").write_text(PENDULUM_URDF)
    status, _, err = run(capsys, *arguments, "m.urdf")
    told, stopped = err.splitlines()
    assert (status, stopped) == (2, "crosscheck: error: reached")
    assert told == "m.urdf: joint 'pivot': left out: its dry friction 0.2"


def test_of_many_elements_the_first_are_told(capsys):
    report = ImportReport()
    for number in range(9):
        report.left_out(f"joint '{number}'", "its dry friction 0.2")
    warn_about_import("m.xml", report, load("pendulum"))
    *told, last = capsys.readouterr().err.splitlines()
    assert told == [f"m.xml: joint '{n}': left out: its dry friction 0.2" for n in range(4)]
    assert last == "m.xml: 5 more elements are not as in the file; crosscheck run -v names all"


@pytest.mark.parametrize("name", ["robot.sdf", "arena.world", "robot.urdf.xacro", "robot.usda"])
def test_other_formats_are_refused_with_what_to_do(name: str) -> None:
    with pytest.raises(CrosscheckError, match=r"sdf2mjcf|xacro FILE|export a URDF"):
        load(name)
