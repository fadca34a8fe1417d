"""`crosscheck view` and `figures`: what is shown, and what cannot be."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
from contextlib import suppress

import pytest
from command_line import run

PYTHON = sys.executable


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
    assert viewer.read_text() == "-P -m rerun --bind 127.0.0.1 one.rrd two.rrd\n"


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
    assert arguments[:6] == ["-P", "-m", "rerun", "--bind", "127.0.0.1", "--serve-web"]
    assert arguments[6::2] == ["--web-viewer-port", "--port", "one.rrd"]
    assert address == arguments[7] != "9090"
    assert ports == f"rerun%2Bhttp%3A%2F%2Flocalhost%3A{arguments[9]}%2Fproxy"


@pytest.mark.parametrize(
    "number", [signal.SIGINT, signal.SIGTERM, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)]
)
def test_a_viewer_and_its_children_end_with_the_command(viewer, number):
    (viewer.parent / "viewer").write_text("#!/bin/sh\nsleep 60 &\nsleep 2\necho shown\nwait\n")
    code = (
        "import signal, sys; signal.signal(signal.SIGHUP, signal.SIG_DFL); "  # also if tests run with nohup
    )
    code += f"from crosscheck.cli import main; sys.executable = {sys.executable!r}"
    code += "; main(['view', 'one.rrd'])"
    command = subprocess.Popen([PYTHON, "-c", code], stdout=subprocess.PIPE, text=True)
    assert command.stdout.readline() == "shown\n"
    command.send_signal(number)
    command.communicate(timeout=30.0)  # until no process has its output any more
    assert command.returncode == 0


@pytest.mark.slow
def test_figures_draws_five_pictures(tmp_path, capsys):
    status, out, _ = run(capsys, "figures", "--output", tmp_path)
    assert status == 0
    for number in range(5, 10):
        path = tmp_path / f"figure_{number}.png"
        assert path.read_bytes().startswith(b"\x89PNG")
        assert str(path) in out


def test_figures_checks_its_folder_first(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("crosscheck.studies.paper_figures.load", lambda *_: pytest.fail("simulates first"))
    (tmp_path / "file").write_text("")
    status, _, err = run(capsys, "figures", "--output", tmp_path / "file")
    assert status == 2
    assert err.startswith("crosscheck: error: cannot write ")
