"""The command line: what it writes, its exit statuses, and twenty-odd kinds of bad input."""

from __future__ import annotations

import copy
import json
import os
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from crosscheck.cli import main
from crosscheck.scenes import load
from newton_euler.trajectory import load_arrays

EXAMPLE = Path(__file__).parents[1] / "examples" / "four_bar.yaml"


@pytest.fixture(scope="module")
def good():
    """The example's content, cut to a short run."""
    content = yaml.safe_load(EXAMPLE.read_text())
    content["duration"] = 0.05
    return content


def run(capsys, *arguments):
    """Exit status, standard output and standard error of a command line."""
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return caught.value.code or 0, captured.out, captured.err


class _NoAliases(yaml.SafeDumper):
    """Scene files may not hold aliases, which PyYAML writes for a list that is there twice."""

    def ignore_aliases(self, data):
        return True


def scene_file(folder, content, name="scene.yaml"):
    path = folder / name
    path.write_text(content if isinstance(content, str) else yaml.dump(content, Dumper=_NoAliases))
    return path


def test_run_writes_everything_and_agrees(capsys, tmp_path, good):
    path = scene_file(tmp_path, good)
    status, out, err = run(capsys, "run", path, "--output", tmp_path / "out")
    assert (status, err) == (0, "")
    assert out.splitlines()[-1].startswith("AGREE: newton_euler, mujoco, pinocchio agree on four_bar")
    names = {p.name for p in (tmp_path / "out").iterdir()}
    assert names == {"newton_euler.npz", "mujoco.npz", "pinocchio.npz", "summary.json", "four_bar.rrd"}
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["agrees"] is True
    assert {"model", "kinematics", "accelerations and reactions", "trajectories", "drift", "energy"} == {
        figure["level"] for figure in summary["figures"]
    }
    assert set(summary["engines"]) == {"newton_euler", "mujoco", "pinocchio"}
    assert summary["versions"]["mujoco"].split(".")[0].isdigit()
    arrays = load_arrays(tmp_path / "out" / "mujoco.npz")
    assert arrays["position"].shape == (6, 4, 3)
    assert list(arrays["body_names"]) == ["frame", "crank", "coupler", "rocker"]


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


def test_a_disagreement_is_status_1_and_names_the_place(capsys, tmp_path, good, monkeypatch):
    import mjcf
    from crosscheck import engines
    from newton_euler.scene import Scene

    def heavier(scene: Scene):
        bodies = list(scene.mechanism.bodies)
        bodies[2] = replace(bodies[2], mass=1.001 * bodies[2].mass)
        return replace(
            scene, mechanism=type(scene.mechanism)(bodies, scene.mechanism.joints), initial_state=None
        )

    mujoco = engines.ENGINES["mujoco"]
    wrong = replace(
        mujoco,
        simulate=lambda scene: mjcf.simulate(heavier(scene)),
        systems=lambda scene: mujoco.systems(heavier(scene)),
        soft_start=None,
    )
    monkeypatch.setitem(engines.ENGINES, "mujoco", wrong)
    path = scene_file(tmp_path, good)
    status, out, _ = run(capsys, "run", path, "--output", tmp_path / "out")
    assert status == 1
    verdict = out.splitlines()[-1]
    assert verdict.startswith(
        "DISAGREE: newton_euler and mujoco part on four_bar at level 'model': mass, rel: 0.001"
    )
    assert "worst at coupler" in verdict
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["agrees"] is False


def test_list_names_scenes_options_and_engines(capsys):
    status, out, _ = run(capsys, "list")
    assert status == 0
    assert "tracker: dual-axis solar tracker" in out
    assert "--set panel_inertia=realisable|literal" in out
    assert "engines: newton_euler, mujoco, pinocchio" in out


def test_module_and_version():
    command = [sys.executable, "-m", "crosscheck", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("crosscheck, version ")


def changed(content, path, value):
    """A copy of nested content with one element replaced (or removed, for value ...)."""
    content = copy.deepcopy(content)
    at = content
    for key in path[:-1]:
        at = at[key]
    if value is ...:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return content


BAD_SCENES = {
    "negative mass": (("bodies", 1, "mass"), -1.0, "body 'coupler': mass is -1 kg; needed: a positive"),
    "zero mass": (("bodies", 1, "mass"), 0.0, "body 'coupler': mass is 0 kg"),
    "NaN": (("bodies", 0, "mass"), float("nan"), "bodies.0.mass: Input should be a valid number"),
    "infinite point": (("joints", 0, "point"), [0.0, float("inf"), 0.0], "joints.0.point.1"),
    "huge point": (("joints", 0, "point"), [0.0, 1e308, 0.0], "point.1: Input should be at most 1e+100"),
    "truth for a number": (("bodies", 0, "mass"), True, "bodies.0.mass: Input should be a valid number"),
    "truth for an index": (("control", 0, "coordinate"), True, "control.0.coordinate: Input should be a"),
    "asymmetric inertia": (("bodies", 1, "inertia", 0, 1), 0.001, "body 'coupler': inertia differs from"),
    "indefinite inertia": (("bodies", 1, "inertia", 0, 0), -0.004, "a positive definite inertia"),
    "unrealisable inertia": (("bodies", 1, "inertia", 0, 0), 0.9, "body 'coupler': principal moments"),
    "quaternion not of unit norm": (("bodies", 1, "quaternion"), [1.0, 0.1, 0, 0], "quaternion has norm"),
    "quaternion of three": (("bodies", 1, "quaternion"), [1.0, 0.0, 0.0], "bodies.1.quaternion"),
    "zero axis": (("joints", 0, "axis"), [0.0, 0.0, 0.0], "joint 'motor': axis is [0.0, 0.0, 0.0]; needed"),
    "missing axis": (("joints", 0, "axis"), ..., "joint 'motor': a revolute joint needs axis, got none"),
    "slanted universal": (("joints", 2, "axis_on_second"), [1.0, 1.0, 0.0], "perpendicular axes"),
    "unknown body": (("joints", 1, "second"), "piston", "connects an unknown body 'piston'; needed: one of"),
    "joint to itself": (("joints", 1, "second"), "crank", "connects 'crank' to itself"),
    "unknown joint kind": (("joints", 1, "kind"), "rubber", "unknown kind 'rubber'; choose from: fixed,"),
    "open loop": (("joints", 1, "point_on_second"), [0, 0, 0.201], "joint 'elbow': is open by 0.001 m"),
    "duplicate body": (("bodies", 1, "name"), "crank", "body 'crank': 2 of that name; needed: unique"),
    "duplicate joint": (("joints", 1, "name"), "motor", "joint 'motor': 2 of that name"),
    "unusable name": (("bodies", 1, "name"), "a/b <c>", "has an unusable name"),
    "control of a passive joint": (("joints", 0, "actuated"), False, "the joint is not actuated"),
    "control of an unknown joint": (("control", 0, "joint"), "engine", "unknown joint 'engine'; choose"),
    "zero duration": (("duration",), 0.0, "duration is 0.0; needed: a positive number of seconds"),
    "a million outputs and more": (("output_period",), 1e-9, "more than 1000000 outputs"),
    "endless duration": (("duration",), 1e90, "at most 1e+07"),
    "name that leaves the folder": (("name",), "../../evil", "scene: name is '../../evil'"),
    "name of markup": (("name",), "[/red]", "scene: name is '[/red]'"),
    "name with a null": (("name",), "a\0b", "scene: name is 'a\\x00b'"),
    "description that is no line": (("description",), "a\x1b[31m", "description is 'a\\x1b[31m'"),
    "unknown output": (("outputs",), ["heat"], "unknown output 'heat'; choose from: velocities,"),
    "outputs that are not compared": (
        ("outputs",),
        ["velocities"],
        "does not ask for the output 'reactions'",
    ),
    "state of an unknown body": (("initial_state",), {"moon": {}}, "unknown body 'moon'"),
    "state of an open joint": (
        ("initial_state",),
        {"crank": {"position": [0.0, 0.0, 0.11]}},
        "joint 'motor': is open by 0.01 m in the initial state",
    ),
    "state of a joint that opens": (
        ("initial_state",),
        {"crank": {"linear_velocity": [0.0, 0.5, 0.0]}},
        "joint 'motor': opens at 0.5 m/s in the initial state",
    ),
    "flat box": (
        ("bodies", 0, "shapes"),
        [{"kind": "box", "half_sizes": [0.1, 0.1, 0.0], "center": [0, 0, 0]}],
        "body 'crank': box: half_sizes is [0.1, 0.1, 0.0]; needed",
    ),
    "misspelt key": (("gravitty",), [0, 0, 0], "gravitty: Extra inputs are not permitted"),
    "missing key": (("joints",), ..., "joints: Field required"),
    "text for a number": (("duration",), "long", "duration: Input should be a valid number"),
}


@pytest.mark.parametrize("kind", BAD_SCENES)
def test_bad_scene_files(capsys, tmp_path, good, kind):
    path, value, message = BAD_SCENES[kind]
    check_refused(capsys, tmp_path, scene_file(tmp_path, changed(good, path, value)), message=message)


def check_refused(capsys, tmp_path, *arguments, message):
    """One line on standard error, status 2, nothing written."""
    before = set(tmp_path.rglob("*"))
    status, out, err = run(capsys, "run", *arguments, "--output", tmp_path / "results" / "out")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert err.startswith("crosscheck: error: ")
    assert message in err
    assert not [p for p in set(tmp_path.rglob("*")) - before if p.is_file()]


def test_a_body_that_nothing_holds(capsys, tmp_path, good):
    lonely = copy.deepcopy(good)
    lonely["bodies"].append(copy.deepcopy(lonely["bodies"][0]) | {"name": "moon"})
    check_refused(capsys, tmp_path, scene_file(tmp_path, lonely), message="body 'moon': no joint leads to it")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not YAML"),
        ("", "Input should be a valid dictionary"),
        ("- 1\n- 2\n", "Input should be a valid dictionary"),
        ("[" * 5000, "nested too deeply"),
        ("a: !!python/object/apply:os.system [true]", "not YAML: line 1: tags are not allowed"),
        ("name: a\nduration: !!int abc", "not YAML: line 2: tags are not allowed"),
        ("duration: !!float abc", "not YAML: line 1: tags are not allowed"),
        ("name: 2001-99-99", "duration: Field required"),
        (f"duration: {'9' * 5000}", "name: Field required (got {'duration': '99"),
        ("name: a\nground: b\nname: c", "not YAML: line 3: key 'name' is given twice"),
        ("? [a]\n: b", "not YAML: line 1: a key is not a text"),
        ('name: "a\\ud800b"', "duration: Field required"),
        ("a: " + "x" * 1_000_000, "larger than 1000000 bytes"),
        # each line doubles the one before: 2^40 numbers
        ("a: &a0 1\n" + "".join(f"b{k}: &a{k + 1} [*a{k}, *a{k}]\n" for k in range(40)), "aliases are not"),
    ],
)
def test_files_that_are_no_scenes(capsys, tmp_path, text, message):
    check_refused(capsys, tmp_path, scene_file(tmp_path, text), message=message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{\n"a":,\n}', "not JSON: line 2: Expecting value"),
        ('{"name": "a", "name": "b"}', "key 'name' is given twice"),
        ('{"a": ' + "9" * 5000 + "}", "not JSON: Exceeds the limit"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_json_files_that_are_no_scenes(capsys, tmp_path, text, message):
    check_refused(capsys, tmp_path, scene_file(tmp_path, text, "scene.json"), message=message)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (True, "a number, not a truth value (got True)"),
        (10**400, "duration: Input should be a"),
        (float("nan"), "duration: Input should be a finite number"),
    ],
)
def test_json_numbers(capsys, tmp_path, good, value, message):
    text = json.dumps(good | {"duration": value})
    check_refused(capsys, tmp_path, scene_file(tmp_path, text, "scene.json"), message=message)


def test_json_is_read_as_json(tmp_path, good):
    # YAML forbids tabs at the beginning of a line
    path = scene_file(tmp_path, json.dumps(good, indent="\t"), "scene.json")
    scene, same = load(str(path)), load(str(scene_file(tmp_path, good)))
    assert scene.name == same.name == "four_bar"
    assert [body.mass for body in scene.mechanism.bodies] == [0.0, 0.5, 1.0, 0.8]
    assert scene.control == same.control


def test_everything_that_a_scene_file_can_hold(tmp_path, good):
    content = copy.deepcopy(good)
    box = {"kind": "box", "half_sizes": [0.01, 0.02, 0.1], "center": [0.0, 0.0, 0.1]}
    bar = {"kind": "capsule", "start": [0.0, 0.0, 0.0], "end": [0.0, 0.0, 0.2], "radius": 0.01}
    content["bodies"][0]["shapes"] = [box, bar]
    content["bodies"][0]["inertia"][2][2] = 0.01
    content["bodies"][0]["allow_unrealisable_inertia"] = True
    content["outputs"] = ["energy", "velocities"]
    # the coupler may turn about the line from elbow to wrist; both of them and its centre stay in place
    line = [0.6, 0.1, 0.1]
    content["bodies"][1]["center_of_mass"] = [0.3, 0.05, 0.25]
    content["joints"][2] |= {"kind": "spherical"}
    del content["joints"][2]["axis_on_first"], content["joints"][2]["axis_on_second"]
    content["initial_state"] = {"coupler": {"angular_velocity": line}}
    scene = load(str(scene_file(tmp_path, content)))
    assert [type(shape).__name__ for shape in scene.mechanism.bodies[1].shapes] == ["Box", "Capsule"]
    assert scene.outputs == {"energy", "velocities"}
    assert scene.initial_state.angular_velocity.tolist() == [[0.0] * 3, [0.0] * 3, line, [0.0] * 3]
    assert scene.initial_state.position[2].tolist() == [0.3, 0.05, 0.25]


@pytest.mark.parametrize(
    ("path", "value"),
    [(("control", 0, "stiffness"), 1e99), (("gravity",), [0.0, 0.0, -1e99]), (("bodies", 0, "mass"), 1e99)],
)
def test_absurd_magnitudes_are_one_line(tmp_path, good, path, value):
    done = command(tmp_path, "run", scene_file(tmp_path, changed(good, path, value)))
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("crosscheck: error: ")


def test_a_pipe_is_no_scene_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    done = command(tmp_path, "run", "pipe.yaml")
    assert (done.returncode, done.stderr) == (2, "crosscheck: error: pipe.yaml: not a regular file\n")


def test_binary_and_missing_files_and_folders(capsys, tmp_path):
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x80")
    check_refused(capsys, tmp_path, binary, message="binary.yaml: not")
    check_refused(capsys, tmp_path, tmp_path / "missing.yaml", message="No such file")
    (tmp_path / "folder.yaml").mkdir()
    check_refused(capsys, tmp_path, tmp_path / "folder.yaml", message="not a regular file")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["trakcer"], "unknown scene 'trakcer'; choose from: tracker"),
        (["tracker", "--engines", "bullet"], "unknown engine 'bullet'; choose from: newton_euler, mujoco"),
        (["tracker", "--engines", "mujoco,mujoco"], "engine 'mujoco' is named 2 times"),
        (["tracker", "--engines", ","], "no engine named"),
        (["tracker", "--set", "leg_inertia"], "--set 'leg_inertia' is not of the form OPTION=VALUE"),
        (["tracker", "--set", "leg_inertia=round"], "choose from: printed, aligned"),
        (["tracker", "--set", "colour=red"], "unknown option 'colour'"),
        (["tracker", "--set", "name=red"], "unknown option 'name'"),
        (["tracker", "--set", "leg_inertia=aligned", "--set", "leg_inertia=printed"], "given twice"),
        (["tracker", "--fast"], "No such option"),
        (["tracker", "four_bar"], "unexpected extra argument"),
    ],
)
def test_bad_usage(capsys, tmp_path, arguments, message):
    check_refused(capsys, tmp_path, *arguments, message=message)


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
    assert "rerun --bind 127.0.0.1 --serve-web" in err


def test_figures_draws_five_pictures(tmp_path, capsys):
    status, out, _ = run(capsys, "figures", "--output", tmp_path)
    assert status == 0
    for number in range(5, 10):
        path = tmp_path / f"figure_{number}.png"
        assert path.read_bytes().startswith(b"\x89PNG")
        assert str(path) in out


def command(folder, *arguments, **options):
    """`python -m crosscheck` run in a folder, its standard output captured unless told otherwise."""
    return subprocess.run(
        [sys.executable, "-m", "crosscheck", *map(str, arguments)],
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "timeout": 120} | options,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
    )


def test_a_user_sees_no_traceback_from_a_broken_file(tmp_path):
    done = command(tmp_path, "run", scene_file(tmp_path, "bodies: 3"))
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("arguments", [["run", "scene.yaml", "--engines", "pinocchio"], ["list"], ["--help"]])
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
    line = "crosscheck: error: cannot write standard output: Broken pipe\n"
    assert (done.returncode, done.stderr) == (2, line)


@pytest.mark.parametrize("size", [100, 10_000, 30_000])
def test_a_full_disk_leaves_all_files_or_none(tmp_path, good, size):
    """Runs are longer than 100 bytes, the summary than 10 kB, the recording than 30 kB."""
    scene_file(tmp_path, good)
    limit = lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))  # noqa: E731
    done = command(tmp_path, "run", "scene.yaml", "--output", "out", preexec_fn=limit)
    assert done.returncode == 2
    assert done.stderr.startswith("crosscheck: error: cannot write out/")
    assert done.stderr.endswith(": File too large\n")
    assert len(done.stderr.splitlines()) == 1
    assert list((tmp_path / "out").iterdir()) == []


def test_an_interrupt_is_one_line(tmp_path, capsys, good, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("crosscheck.run.compare", interrupted)
    check_refused(capsys, tmp_path, scene_file(tmp_path, good), message="interrupted")


def test_what_nobody_foresaw_is_one_line_too(tmp_path, capsys, good, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("division\nby zero")

    monkeypatch.setattr("crosscheck.run.compare", broken)
    message = "internal error: ZeroDivisionError: division by zero"
    check_refused(capsys, tmp_path, scene_file(tmp_path, good), message=message)


def test_a_figure_that_is_not_a_number_is_refused(tmp_path, capsys, good, monkeypatch):
    from crosscheck.compare import Row

    row = Row("drift", "open joints", ("mujoco",), float("nan"), 1.0, "elbow")
    monkeypatch.setattr("crosscheck.run.compare", lambda *_: [row])
    check_refused(
        capsys, tmp_path, scene_file(tmp_path, good), message="no figure for open joints at level 'd"
    )


def test_markup_in_texts_is_text(tmp_path, capsys, good):
    path = scene_file(tmp_path, good | {"description": "[/red] [bold]b :smile:"})
    folder = tmp_path / "[b]"
    status, out, err = run(capsys, "run", path, "--engines", "pinocchio,newton_euler", "--output", folder)
    assert (status, err) == (0, "")
    assert out.startswith("four_bar: [/red] [bold]b :smile:")
    assert f"wrote {folder}/pinocchio.npz" in out


def test_one_engine_alone_agrees_with_nobody(tmp_path, capsys, good):
    path = scene_file(tmp_path, good)
    status, out, _ = run(capsys, "run", path, "--engines", "mujoco", "--output", tmp_path / "out")
    assert status == 0
    verdict = "ran mujoco alone on four_bar: nothing to compare it with; its own figures hold, all "
    assert out.splitlines()[-1].startswith(verdict)
    assert "AGREE" not in out
    assert "agree" not in out.splitlines()[-1]


def test_one_engine_alone_can_fail(tmp_path, capsys, good, monkeypatch):
    from crosscheck.compare import Row

    row = Row("drift", "open joints, m or rad", ("mujoco",), 2.0, 1.0, "elbow at 0 s")
    monkeypatch.setattr("crosscheck.run.compare", lambda *_: [row])
    path = scene_file(tmp_path, good)
    status, out, _ = run(capsys, "run", path, "--engines", "mujoco", "--output", tmp_path / "out")
    assert status == 1
    verdict = "its own figures fail at level 'drift': open joints, m or rad: 2 > 1, worst at elbow at 0 s"
    assert verdict in out.splitlines()[-1]


def test_a_second_run_leaves_nothing_of_the_first(tmp_path, capsys, good):
    path, folder = scene_file(tmp_path, good), tmp_path / "out"
    run(capsys, "run", path, "--engines", "mujoco,pinocchio", "--output", folder)
    (folder / "notes.npz").write_text("somebody's own")
    run(capsys, "run", path, "--engines", "pinocchio", "--output", folder)
    assert {p.name for p in folder.iterdir()} == {
        "pinocchio.npz",
        "summary.json",
        "four_bar.rrd",
        "notes.npz",
    }


def test_a_recording_is_named_as_one(tmp_path, capsys, good):
    path = scene_file(tmp_path, good)
    check_refused(capsys, tmp_path, path, "--save", tmp_path / "x.npz", message="name ends in .rrd")


def test_summary_tells_what_was_run(tmp_path, capsys, monkeypatch, good):
    short = replace(load("tracker", leg_inertia="aligned"), duration=0.02)
    monkeypatch.setattr("crosscheck.scenes.load", lambda *_, **__: short)
    arguments = ("--set", "leg_inertia=aligned", "--engines", "pinocchio", "--output", tmp_path)
    _, out, _ = run(capsys, "run", "tracker", *arguments)
    summary = json.loads((tmp_path / "summary.json").read_text())
    told = {name: summary[name] for name in ("scene", "source", "options")}
    assert told == {"scene": "tracker", "source": "tracker", "options": {"leg_inertia": "aligned"}}
    assert set(summary["versions"]) == {"python", "numpy", "scipy", "rerun-sdk", "pin"}
    assert summary["verdict"] == out.splitlines()[-1]
    assert "alone on tracker (leg_inertia=aligned)" in summary["verdict"]


def test_figures_checks_its_folder_first(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("crosscheck.figures.load", lambda *_: pytest.fail("simulates first"))
    (tmp_path / "file").write_text("")
    status, _, err = run(capsys, "figures", "--output", tmp_path / "file")
    assert status == 2
    assert err.startswith("crosscheck: error: cannot write ")


def test_view_of_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "run.rrd")
    done = command(tmp_path, "view", "run.rrd")
    assert (done.returncode, done.stderr) == (2, "crosscheck: error: run.rrd is not a file\n")
