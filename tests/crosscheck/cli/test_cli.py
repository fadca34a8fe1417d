"""The command line: lists and help, options that nobody has, streams that are closed, and what takes long."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import textwrap
import time
from importlib.metadata import version

import pytest
from command_line import command, run, scene_file, short_example
from urdf_files import CHAIN

from crosscheck.cli import shared
from crosscheck.cli.shared import progress_shown
from crosscheck.library import load


@pytest.mark.parametrize("chosen", [None, "7"])
def test_matrices_have_one_thread_unless_the_user_says_otherwise(chosen):
    # NumPy reads it as it is imported
    code = "import os, sys, crosscheck.cli\nassert 'numpy' not in sys.modules\n"
    code += "try: crosscheck.cli.main(['--version'])\nfinally: print(os.environ['OPENBLAS_NUM_THREADS'])"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    environment |= {"OPENBLAS_NUM_THREADS": chosen} if chosen else {}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.splitlines()[1:] == [chosen or "1"], done.stderr


@pytest.mark.slow
def test_a_run_spends_no_time_on_pandas_or_the_search_for_cycles(tmp_path):
    code = """
        import atexit, gc, sys
        atexit.register(lambda: print(gc.get_freeze_count() > 100_000))  # first registered, called last
        import crosscheck.cli
        before = [each["collections"] for each in gc.get_stats()]
        try:
            crosscheck.cli.main(["run", "pendulum"])
        finally:
            print("rerun" in sys.modules, "pandas" in sys.modules)
            print(sum(each["collections"] for each in gc.get_stats()[1:]) - sum(before[1:]))
    """
    command = [sys.executable, "-P", "-c", textwrap.dedent(code)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.splitlines()[-3:] == ["True False", "0", "True"], done.stderr


def test_list_names_scenes_options_and_engines(capsys):
    status, out, _ = run(capsys, "list")
    assert status == 0
    assert "tracker: dual-axis solar tracker" in out
    assert "--set panel_inertia=realisable|literal" in out
    assert f"    mujoco: mujoco {version('mujoco')}, runs by default" in out.split("engines:")[1].splitlines()


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


def test_list_of_a_scene_says_which_points_offsets_start_from(capsys):
    _, out, _ = run(capsys, "list", "slider_crank")
    rows = [" ".join(line.split()) for line in out.splitlines()]
    crank = load("slider_crank").mechanism.joints[1]
    point, other = (" ".join(f"{x:.6g}" for x in each) for each in (crank.point, crank.point_on_second))
    assert f"ball.point_on_first m 0 0 0 offset from {point}" in rows
    assert f"ball.point_on_second m 0 0 0 offset from {other}" in rows
    assert sum("offset from" in row for row in rows) == 12


def test_list_of_a_scene_has_no_round_off(capsys, tmp_path):
    path = scene_file(tmp_path, short_example() | {"gravity": [-1.2e-20, 0.0, -9.81]})
    _, out, _ = run(capsys, "list", path)
    assert out.splitlines()[0].split() == ["gravity", "m/s^2", "0", "0", "-9.81"]


def test_module_and_version():
    command = [sys.executable, "-m", "crosscheck", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("crosscheck, version ")


def test_options_that_are_misspelt_are_told_their_neighbors_alone(capsys):
    for option, told in (("--latitud", " Did you mean '--latitude'?"), ("--city", "")):
        status, _, err = run(capsys, "sun", option, "1", "--date", "2026-03-21")
        assert status == 2
        assert err == f"crosscheck: error: No such option '{option}'.{told}\n"


def test_unknown_command(capsys):
    status, _, err = run(capsys, "simulate")
    assert status == 2
    assert err == "crosscheck: error: No such command 'simulate'.\n"


@pytest.mark.parametrize("arguments", [["list"], ["--help"]])
def test_output_that_cannot_be_written(tmp_path, good, arguments):
    scene_file(tmp_path, good)
    with open("/dev/full", "w") as full:
        done = command(tmp_path, *arguments, stdout=full)
    line = "crosscheck: error: cannot write standard output: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, line)


def test_output_that_nobody_reads(tmp_path):
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "w") as closed:
        done = command(tmp_path, "list", stdout=closed)
    assert (done.returncode, done.stderr) == (141, "")  # as of head


@pytest.mark.slow
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


def test_a_log_is_told_now_and_then_of_many_short_stages(capsys, monkeypatch):
    monkeypatch.setattr(shared, "PROGRESS_DELAY_S", 0.05)
    told, stages = "", 0
    with progress_shown() as progress:
        while told.count("\n") < 2 and stages < 5000:
            progress(f"stage {stages}")
            stages += 1
            time.sleep(0.002)
            told += capsys.readouterr().err
    assert re.fullmatch(r"(stage \d+ \.\.\.\n){2}", told)
    assert stages > 10
