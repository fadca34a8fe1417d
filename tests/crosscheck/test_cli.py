"""The command line: what it writes, its exit statuses, and twenty-odd kinds of bad input."""

from __future__ import annotations

import json
import os
import re
import shlex
import socket
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace

import pytest
from command_line import check_refused, command, run, scene_file, short_example, verdict_of
from urdf_files import CHAIN

from crosscheck.cli import shared
from crosscheck.cli.shared import progress_shown, tell
from crosscheck.comparison.figure import LEVELS, READING, Figure
from crosscheck.errors import CrosscheckError
from crosscheck.scenes import load
from newton_euler.model.trajectory import load_arrays
from newton_euler.verification.import_report import ImportReport


def test_run_writes_everything_and_agrees(capsys, tmp_path, good):
    path = scene_file(tmp_path, good)
    status, out, err = run(capsys, "run", path, "--output", tmp_path / "out")
    assert (status, err) == (0, "")
    assert verdict_of(out).startswith("AGREE: newton_euler, mujoco, pinocchio agree on four_bar")
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {"newton_euler.npz", "mujoco.npz", "pinocchio.npz", "summary.json", "scene.rrd"}
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["agrees"] is True
    assert {figure["level"] for figure in summary["figures"]} == {*LEVELS} - {READING}
    assert set(summary["engines"]) == {"newton_euler", "mujoco", "pinocchio"}
    assert summary["versions"]["mujoco"].split(".")[0].isdigit()
    arrays = load_arrays(tmp_path / "out" / "mujoco.npz")
    assert arrays["position"].shape == (6, 4, 3)
    assert list(arrays["body_names"]) == ["frame", "crank", "coupler", "rocker"]


@pytest.mark.parametrize("chosen", [None, "7"])
def test_matrices_have_one_thread_unless_the_user_says_otherwise(chosen):
    # NumPy reads it as it is imported
    code = "import os, sys, crosscheck.cli\nassert 'numpy' not in sys.modules\n"
    code += "try: crosscheck.cli.main(['--version'])\nfinally: print(os.environ['OPENBLAS_NUM_THREADS'])"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {"OPENBLAS_NUM_THREADS": chosen} if chosen else {}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.splitlines()[1:] == [chosen or "1"], done.stderr


def test_engines_can_be_chosen_and_the_recording_put_elsewhere(capsys, tmp_path, good):
    path, recording = scene_file(tmp_path, good), tmp_path / "deep" / "run.rrd"
    arguments = ("--engines", "newton_euler,pinocchio", "--output", tmp_path / "out", "--save", recording)
    status, _, _ = run(capsys, "run", path, *arguments)
    assert status == 0
    assert recording.exists()
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "newton_euler.npz",
        "pinocchio.npz",
        "summary.json",
    }


def test_list_names_scenes_options_and_engines(capsys):
    status, out, _ = run(capsys, "list")
    assert status == 0
    assert "tracker: dual-axis solar tracker" in out
    assert "--set panel_inertia=realisable|literal" in out
    assert "engines: newton_euler, mujoco, pinocchio" in out


def test_list_of_a_scene_has_its_parameters_with_units_and_values(capsys):
    status, out, _ = run(capsys, "list", "tracker_on_boat")
    rows = [line.split() for line in out.splitlines()]
    assert (status, rows[0]) == (0, ["gravity", "m/s^2", "0", "0", "-9.81"])
    assert ["panel_7.mass", "kg", "0.8905"] in rows
    assert ["base_motion.2.motion.function.angular_frequency", "rad/s", "1.5708"] in rows
    assert ["start.slide_13.rate", "m/s", "0"] in rows


def test_list_of_a_scene_fits_80_columns(capsys):
    _, out, _ = run(capsys, "list", "tracker")
    lines = out.splitlines()
    assert max(map(len, lines)) <= 80
    place = next(k for k, line in enumerate(lines) if line.startswith("leg_5.inertia"))
    rows = [line.split()[-3:] for line in lines[place : place + 3]]
    assert rows == [["5.827e-05", "0", "-8.24e-06"], ["0", "5.94e-05", "0"], ["-8.24e-06", "0", "1.72e-06"]]


def test_list_of_a_scene_has_no_round_off(capsys, tmp_path):
    path = scene_file(tmp_path, short_example() | {"gravity": [-1.2e-20, 0.0, -9.81]})
    _, out, _ = run(capsys, "list", path)
    assert out.splitlines()[0].split() == ["gravity", "m/s^2", "0", "0", "-9.81"]


def test_help_is_not_cut_off(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    status, out, _ = run(capsys, "--help")
    assert status == 0
    assert [line for line in out.splitlines() if line.startswith("  ") and line.endswith("...")] == []


def test_module_and_version():
    command = [sys.executable, "-m", "crosscheck", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("crosscheck, version ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["trakcer"], "unknown scene 'trakcer'; did you mean 'tracker'? choose from: tracker, "),
        (["tracker", "--engines", "bullet"], "unknown engine 'bullet'; choose from: newton_euler, mujoco"),
        (["tracker", "--engines", "mujoco,mujoco"], "engine 'mujoco' is named 2 times"),
        (["tracker", "--engines", ","], "no engine named"),
        (["tracker", "--set", "panel_inertia"], "--set 'panel_inertia' is not of the form OPTION=VALUE"),
        (["tracker", "--set", "panel_inertia=round"], "choose from: realisable, literal"),
        (["tracker", "--set", "color=red"], "unknown option 'color'"),
        (["tracker", "--set", "name=red"], "unknown option 'name'"),
        (["tracker", "--set", "panel_inertia=literal", "--set", "panel_inertia=realisable"], "given twice"),
        (["tracker", "--fast"], "No such option"),
        (["tracker", "four_bar"], "unexpected extra argument"),
    ],
)
def test_bad_usage(capsys, tmp_path, arguments, message):
    check_refused(capsys, tmp_path, *arguments, message=message)


def test_options_that_are_misspelt_are_told_their_neighbors_alone(capsys):
    for option, told in (("--latitud", " Did you mean '--latitude'?"), ("--city", "")):
        status, _, err = run(capsys, "sun", option, "1", "--date", "2026-03-21")
        assert status == 2
        assert err == f"crosscheck: error: No such option '{option}'.{told}\n"


def test_unknown_command(capsys):
    status, _, err = run(capsys, "simulate")
    assert status == 2
    assert err == "crosscheck: error: No such command 'simulate'.\n"


def test_paths_that_cannot_be_written(capsys, tmp_path, good):
    path = scene_file(tmp_path, good)
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.rrd").mkdir()
    for option, target in (("--output", "file/out"), ("--save", "file/run.rrd"), ("--save", "folder.rrd")):
        status, out, err = run(capsys, "run", path, "--output", tmp_path / "o", option, tmp_path / target)
        assert (status, out) == (2, "")
        assert err.startswith("crosscheck: error: cannot write ")
        assert len(err.splitlines()) == 1


@pytest.mark.parametrize("content", [None, b"", b"RRF", b"a picture"])
def test_view_refuses_what_is_no_recording(capsys, tmp_path, content):
    path = tmp_path / "run.rrd"
    if content is not None:
        path.write_bytes(content)
    status, _, err = run(capsys, "view", path)
    assert status == 2
    assert "run.rrd" in err
    assert len(err.splitlines()) == 1


def test_view_without_a_display_says_what_to_do(capsys, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    path = tmp_path / "run.rrd"
    path.write_bytes(b"RRF2")
    status, _, err = run(capsys, "view", path)
    assert status == 2
    assert (
        err == "crosscheck: error: no display to open a viewer on; --web shows the recordings in a browser\n"
    )


@pytest.fixture
def viewer(tmp_path, monkeypatch):
    """Has a script in the place of Rerun's viewer write what it is called with to this file."""
    script, called = tmp_path / "viewer", tmp_path / "arguments"
    script.write_text(f'#!/bin/sh\necho "$@" > {called}\n')
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    monkeypatch.setenv("DISPLAY", ":0")
    for name in ("one.rrd", "two.rrd"):
        (tmp_path / name).write_bytes(b"RRF2")
    monkeypatch.chdir(tmp_path)
    return called


def test_view_opens_recordings_side_by_side(capsys, viewer):
    """In one viewer that listens to this machine only."""
    assert run(capsys, "view", "one.rrd", "two.rrd") == (0, "", "")
    assert viewer.read_text() == "-m rerun --bind 127.0.0.1 one.rrd two.rrd\n"


def test_view_in_a_browser_says_where_and_takes_ports_that_are_free(capsys, viewer):
    with socket.socket() as taken:
        with suppress(OSError):  # taken already
            taken.bind(("127.0.0.1", 9090))
            taken.listen()
        status, out, err = run(capsys, "view", "--web", "one.rrd")
    said = re.fullmatch(r"Ctrl\+C ends it; open http://127\.0\.0\.1:(\d+)\?url=(\S+)\n", out)
    assert said is not None
    address, ports = said.groups()
    arguments = viewer.read_text().split()
    assert (status, err) == (0, "")
    assert arguments[:5] == ["-m", "rerun", "--bind", "127.0.0.1", "--serve-web"]
    assert arguments[5::2] == ["--web-viewer-port", "--port", "one.rrd"]
    assert address == arguments[6] != "9090"
    assert ports == f"rerun%2Bhttp%3A%2F%2Flocalhost%3A{arguments[8]}%2Fproxy"


def test_figures_draws_five_pictures(tmp_path, capsys):
    status, out, _ = run(capsys, "figures", "--output", tmp_path)
    assert status == 0
    for number in range(5, 10):
        path = tmp_path / f"figure_{number}.png"
        assert path.read_bytes().startswith(b"\x89PNG")
        assert str(path) in out


@pytest.mark.parametrize("arguments", [["list"], ["--help"]])
def test_output_that_cannot_be_written(tmp_path, good, arguments):
    scene_file(tmp_path, good)
    with open("/dev/full", "w") as full:
        done = command(tmp_path, *arguments, stdout=full)
    line = "crosscheck: error: cannot write standard output: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, line)


def test_output_that_nobody_reads(tmp_path, good):
    scene_file(tmp_path, good)
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "w") as closed:
        done = command(tmp_path, "run", "scene.yaml", "--engines", "pinocchio", stdout=closed)
    assert (done.returncode, done.stderr) == (141, "")  # as of head


@pytest.mark.parametrize("closed", ["1>&-", "0<&- 2>&-", "1>&- 2>&-"])
def test_streams_that_are_closed(tmp_path, closed):
    """The run is the same without them; errors are on standard output where standard error is closed."""
    (tmp_path / "robot.urdf").write_text(CHAIN)
    program = f"{shlex.quote(sys.executable)} -m crosscheck convert robot.urdf"
    done, refused = (
        subprocess.run(
            ["sh", "-c", f"{program} {target} {closed}"], cwd=tmp_path, capture_output=True, text=True
        )
        for target in ("out.json", "out.stl")
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "out.json").is_file()
    assert refused.returncode == 2
    if closed != "1>&- 2>&-":
        assert (refused.stdout + refused.stderr).startswith("crosscheck: error: cannot convert to out.stl")


def test_an_interrupt_is_one_line(tmp_path, capsys, good, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("crosscheck.run.stages", interrupted)
    check_refused(capsys, tmp_path, scene_file(tmp_path, good), message="interrupted")


def test_what_nobody_foresaw_is_one_line_and_what_there_is_is_kept(tmp_path, capsys, good, monkeypatch):
    def broken(_):
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.setattr("crosscheck.run.stages", lambda *_: {"comparing": broken})
    path, out = scene_file(tmp_path, good), tmp_path / "out"
    status, said, err = run(capsys, "run", path, "--engines", "newton_euler,mujoco", "--output", out)
    assert (status, err) == (3, "")
    reason = "comparing: internal error: ZeroDivisionError: division by zero"
    assert verdict_of(said).startswith(f"UNFINISHED: {reason}; ")
    files = {"newton_euler.npz", "mujoco.npz", "summary.json", "scene.rrd"}
    assert {path.name for path in out.iterdir()} == files


def test_a_figure_that_is_not_a_number_is_none(tmp_path, capsys, good, monkeypatch):
    row = Figure("drift", "open joints", ("mujoco",), float("nan"), 1.0, "elbow")
    monkeypatch.setattr(
        "crosscheck.run.stages", lambda *_: {"comparing": lambda _: [row, replace(row, value=0.5)]}
    )
    path, out = scene_file(tmp_path, good), tmp_path / "out"
    status, said, err = run(capsys, "run", path, "--engines", "newton_euler,mujoco", "--output", out)
    assert (status, err) == (3, "")
    assert "no figure for open joints at level 'drift' between mujoco: nan at elbow; as far" in said
    figures = json.loads((out / "summary.json").read_text())["figures"]
    assert [figure["value"] for figure in figures] == [0.5]


def test_markup_in_texts_is_text(tmp_path, capsys, good):
    path = scene_file(tmp_path, good | {"description": "[/red] [bold]b :smile:"})
    folder = tmp_path / "[b]"
    status, out, err = run(capsys, "run", path, "--engines", "pinocchio,newton_euler", "--output", folder)
    assert (status, err) == (0, "")
    assert out.startswith("four_bar: [/red] [bold]b :smile:")
    assert f"crosscheck report '{folder}'" in out


def test_one_engine_alone_agrees_with_nobody(tmp_path, capsys, good):
    path = scene_file(tmp_path, good)
    status, out, _ = run(capsys, "run", path, "--engines", "mujoco", "--output", tmp_path / "out")
    assert status == 0
    verdict = "ran mujoco alone on four_bar: nothing to compare it with; its own figures hold, all "
    assert verdict_of(out).startswith(verdict)
    assert "AGREE" not in out
    assert "agree" not in verdict_of(out)


def test_one_engine_alone_can_fail(tmp_path, capsys, good, monkeypatch):
    row = Figure("drift", "open joints, m or rad", ("mujoco",), 2.0, 1.0, "elbow at 0 s")
    monkeypatch.setattr("crosscheck.run.stages", lambda *_: {"comparing": lambda _: [row]})
    path = scene_file(tmp_path, good)
    status, out, _ = run(capsys, "run", path, "--engines", "mujoco", "--output", tmp_path / "out")
    assert status == 1
    verdict = "its own figures fail at level 'drift': open joints, m or rad: 2 > 1, worst at elbow at 0 s"
    assert verdict in verdict_of(out)


def test_a_second_run_leaves_nothing_of_the_first(tmp_path, capsys, good):
    path, folder = scene_file(tmp_path, good), tmp_path / "out"
    run(capsys, "run", path, "--engines", "mujoco,pinocchio", "--output", folder)
    (folder / "notes.npz").write_text("somebody's own")
    run(capsys, "run", path, "--engines", "pinocchio", "--output", folder)
    assert {p.name for p in folder.iterdir()} == {
        "pinocchio.npz",
        "summary.json",
        "scene.rrd",
        "notes.npz",
    }


def test_a_recording_is_named_as_one(tmp_path, capsys, good):
    path = scene_file(tmp_path, good)
    check_refused(capsys, tmp_path, path, "--save", tmp_path / "x.npz", message="name ends in .rrd")


def test_summary_tells_what_was_run(tmp_path, capsys, monkeypatch, good):
    short = replace(load("tracker", panel_inertia="literal"), duration=0.02)
    monkeypatch.setattr("crosscheck.scenes.load", lambda *_, **__: short)
    arguments = ("--set", "panel_inertia=literal", "--engines", "pinocchio", "--output", tmp_path)
    _, out, _ = run(capsys, "run", "tracker", *arguments)
    summary = json.loads((tmp_path / "summary.json").read_text())
    told = {name: summary[name] for name in ("scene", "source", "options")}
    assert told == {"scene": "tracker", "source": "tracker", "options": {"panel_inertia": "literal"}}
    assert set(summary["versions"]) == {"python", "numpy", "scipy", "rerun-sdk", "pin"}
    assert summary["verdict"] == verdict_of(out)
    assert "alone on tracker (panel_inertia=literal)" in summary["verdict"]


def test_figures_checks_its_folder_first(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("crosscheck.figures.load", lambda *_: pytest.fail("simulates first"))
    (tmp_path / "file").write_text("")
    status, _, err = run(capsys, "figures", "--output", tmp_path / "file")
    assert status == 2
    assert err.startswith("crosscheck: error: cannot write ")


CLOSED_LOOP = "closed_loop: []\ntype: []\nname_mot: []\n"


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
        assert f"would overwrite {named}, which it reads" in err
    assert (model.read_text(), loops.read_text()) == (PENDULUM_URDF, CLOSED_LOOP)
    assert run(capsys, "convert", model, other)[0] == 0


PENDULUM_URDF = """<robot name="pendulum"><link name="base"/><link name="bob"><inertial>
<origin xyz="0 0 -0.5"/><mass value="1"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="continuous"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
<dynamics damping="0.5" friction="0.2"/></joint></robot>"""


@pytest.mark.parametrize(
    ("arguments", "target"),
    [
        (["bench"], "crosscheck.studies.benchmark.run.bench"),
        (["faults"], "crosscheck.studies.faults.find.find_faults"),
        (["regress"], "crosscheck.regress.run.check"),
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


def test_a_log_is_told_now_and_then_of_many_short_stages(capsys, monkeypatch):
    monkeypatch.setattr(shared, "LONG", 0.05)
    told, stages = "", 0
    with progress_shown() as progress:
        while told.count("\n") < 2 and stages < 5000:
            progress(f"stage {stages}")
            stages += 1
            time.sleep(0.002)
            told += capsys.readouterr().err
    assert re.fullmatch(r"(stage \d+ \.\.\.\n){2}", told)
    assert stages > 10


def test_of_many_elements_the_first_are_told(capsys):
    report = ImportReport()
    for number in range(9):
        report.left_out(f"joint '{number}'", "its dry friction 0.2")
    tell("m.xml", report)
    *told, last = capsys.readouterr().err.splitlines()
    assert told == [f"m.xml: joint '{n}': left out: its dry friction 0.2" for n in range(4)]
    assert last == "m.xml: 5 more elements are not as in the file; crosscheck run -v names all"


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
    assert "its stiffness 2 and damping 0.1 as a spring: a URDF has no forces but damping" in left
    assert "  armature of joint 'pivot': a URDF has no rotors" in left
    for name in ("drive", "hold"):
        assert left.count(f"actuator '{name}'") == 1
    assert "a URDF has no control laws" in left
    assert left.count("actuator 'push'") == 1
    assert "control of joint" not in left
