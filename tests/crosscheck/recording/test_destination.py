"""Where a run's recording goes: a file, a viewer, a server, standard output."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import rerun as rr
from command_line import check_refused, command, run, scene_file
from recordings import lid_scene, read_recording
from rerun.chunk import RrdReader

from crosscheck.errors import CrosscheckError
from crosscheck.recording import server
from crosscheck.recording.destination import Sent
from crosscheck.recording.log import new_recording
from crosscheck.recording.server import LOOPBACK, end, free_port, start

ENGINE = ("--engines", "pinocchio")


@pytest.fixture
def viewer(tmp_path):
    """Rerun's program as a server that keeps what it is sent: its port, and the file once it has ended."""
    port, file = free_port(LOOPBACK), tmp_path / "received.rrd"
    with (tmp_path / "viewer.log").open("wb") as log:
        process = start(["--serve-grpc", "--port", str(port), "--save", str(file)], LOOPBACK, log)
    server.wait(process, LOOPBACK, port)
    yield port, file
    end(process)


def sent_recording(file: Path) -> None:
    """Wait until a file holds all of a recording of the four-bar."""
    deadline = time.monotonic() + 60.0
    while True:
        try:
            entities = read_recording(file).entities
        except (RuntimeError, OSError, ValueError):
            entities = set()
        if "/plots/drift_log10/pinocchio" in entities and "/verdict" in entities:
            return
        assert time.monotonic() < deadline, entities
        time.sleep(0.2)


def test_a_viewer_is_sent_the_recording(tmp_path, capsys, good, viewer):
    port, file = viewer
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    arguments = (scene_file(tmp_path, good), *ENGINE, "--output", tmp_path / "out", "--connect", url)
    status, out, err = run(capsys, "run", *arguments)
    assert (status, err) == (0, "")
    assert f"sent the recording to {url}" in out.splitlines()[-2]
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"pinocchio.npz", "summary.json"}
    sent_recording(file)


def test_spawn_takes_the_viewer_that_runs(tmp_path, capsys, good, viewer, monkeypatch):
    port, file = viewer
    monkeypatch.setattr(server, "GRPC_PORT", port)
    monkeypatch.setenv("DISPLAY", ":0")
    status, out, err = run(
        capsys, "run", scene_file(tmp_path, good), *ENGINE, "--output", tmp_path / "out", "--spawn"
    )
    assert (status, err) == (0, "")
    assert f"sent the recording to the viewer at rerun+http://127.0.0.1:{port}/proxy" in out
    sent_recording(file)


def test_a_viewer_that_does_not_start(tmp_path, capsys, good, monkeypatch):
    monkeypatch.setattr(server, "GRPC_PORT", free_port(LOOPBACK))
    monkeypatch.setenv("DISPLAY", ":0")
    program = tmp_path / "viewer"
    program.write_text("#!/bin/sh\nexit 7\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    path = scene_file(tmp_path, good)
    status, _, err = run(capsys, "run", path, *ENGINE, "--output", tmp_path / "out", "--spawn")
    assert status == 2
    assert err == "crosscheck: error: the Rerun viewer did not start; it ended with status 7\n"


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_serve_serves_this_machine_until_interrupted(tmp_path, good, number):
    scene_file(tmp_path, good)
    arguments = ["run", "scene.yaml", *ENGINE, "--serve"]
    process = subprocess.Popen(
        [sys.executable, "-m", "crosscheck", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    try:
        assert process.stdout is not None
        place = next(line for line in process.stdout if line.startswith("serving the recording at "))
        found = re.search(
            r"(http://127\.0\.0\.1:(\d+))\?url=rerun%2Bhttp%3A%2F%2F127\.0\.0\.1%3A(\d+)", place
        )
        assert found is not None
        assert process.stdout.readline().startswith("ran pinocchio alone on four_bar")
        with urllib.request.urlopen(found[1], timeout=60) as page:
            assert page.status == 200
        ports = [int(found[2]), int(found[3])]
        assert listening(ports) == {"0100007F"}  # 127.0.0.1, in the kernel's byte order
        process.send_signal(number)
        assert (process.wait(timeout=60), process.stderr.read()) == (0, "")  # type: ignore[union-attr]
        assert listening(ports) == set()
    finally:
        process.kill()
        process.communicate()


def test_an_interrupt_ends_serving_from_when_it_is_announced():
    """Not only while the server is waited for: the announcement takes time, too."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        with Sent("serving", process).until_interrupted():
            raise KeyboardInterrupt
        assert process.poll() is None


def listening(ports: list[int]) -> set[str]:
    """The addresses at which somebody listens to ports."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    local = [row[1].split(":") for row in rows if row[3] == "0A"]
    return {address for address, port in local if int(port, 16) in ports}


def test_standard_output_holds_the_recording_and_nothing_else(tmp_path, good):
    scene_file(tmp_path, good)
    file = tmp_path / "piped.rrd"
    with file.open("wb") as stream:
        done = command(tmp_path, "run", "scene.yaml", *ENGINE, "--output", "out", "--stdout", stdout=stream)
    assert done.returncode == 0
    assert done.stderr.splitlines()[-1].startswith("ran pinocchio alone on four_bar")
    (entry,) = RrdReader(file).recordings()
    assert entry.application_id == "crosscheck_four_bar"
    assert "/verdict" in read_recording(file).entities
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"pinocchio.npz", "summary.json"}


def test_standard_output_that_is_full(tmp_path, good):
    scene_file(tmp_path, good)
    with open("/dev/full", "w") as full:
        done = command(tmp_path, "run", "scene.yaml", *ENGINE, "--stdout", stdout=full)
    assert done.returncode == 2
    line = "crosscheck: error: cannot write standard output: No space left on device"
    assert done.stderr.splitlines()[-1] == line
    assert "Traceback" not in done.stderr


def test_a_recording_is_no_text_for_a_terminal(tmp_path, good):
    scene_file(tmp_path, good)
    controller, terminal = os.openpty()
    done = command(tmp_path, "run", "scene.yaml", *ENGINE, "--stdout", stdout=terminal)
    os.close(terminal)
    os.close(controller)
    assert done.returncode == 2
    assert done.stderr == (
        "crosscheck: error: --stdout writes a recording; send it to a file or through a pipe\n"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--spawn",), "no display for --spawn to open a viewer on; --serve shows it in a browser"),
        (("--spawn", "--serve"), "--spawn and --serve: a recording goes to one place; choose one"),
        (("--save", "x.rrd", "--stdout"), "--save and --stdout: a recording goes to one place"),
        (("--connect", ""), "the argument after '--connect' is empty; give a value or leave it out"),
        (("--connect", "127.0.0.1:9876"), "is no address of a viewer"),
        (("--connect", "rerun+http://127.0.0.1:9876"), "is no address of a viewer"),
        (("--connect", "rerun+http://127.0.0.1:99999/proxy"), "Port out of range"),
        (("--connect", "rerun+http://[::1/proxy"), "Invalid IPv6 URL"),
        (("--bind", "0.0.0.0"), "--bind 0.0.0.0: only --serve listens"),
        (("--serve", "--bind", "everywhere"), "--bind everywhere: 'everywhere' does not appear to be an IP"),
        (("--serve", "--bind", "192.0.2.1"), "--bind 192.0.2.1: "),
    ],
)
def test_what_cannot_be_is_refused_before_the_run(tmp_path, capsys, good, monkeypatch, arguments, message):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr("crosscheck.run.crosscheck", lambda *_: pytest.fail("runs first"))
    check_refused(capsys, tmp_path, scene_file(tmp_path, good), *arguments, message=message)


def test_nobody_answers(tmp_path, capsys, good):
    url = f"rerun+http://127.0.0.1:{free_port(LOOPBACK)}/proxy"
    message = f"--connect {url}: no viewer answers: Connection refused"
    check_refused(capsys, tmp_path, scene_file(tmp_path, good), "--connect", url, message=message)


@contextmanager
def listener(answer: bytes | None) -> Iterator[str]:
    """The address of somebody who accepts connections and answers so and hangs up, or never says a word."""
    held: list[socket.socket] = []

    def accept(listening: socket.socket) -> None:
        with suppress(OSError):
            while True:
                held.append(listening.accept()[0])
                if answer is not None:
                    held[-1].sendall(answer)
                    held.pop().close()

    with socket.create_server((LOOPBACK, 0)) as listening:
        threading.Thread(target=accept, args=(listening,), daemon=True).start()
        yield f"rerun+http://127.0.0.1:{listening.getsockname()[1]}/proxy"
        listening.shutdown(socket.SHUT_RDWR)
    for connection in held:
        connection.close()


@pytest.mark.parametrize("answer", [None, b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\0\0"])
def test_somebody_answers_who_is_no_viewer(monkeypatch, answer):
    """Rerun's own way out would wait for ever for who never says a word."""
    monkeypatch.setattr(server, "PATIENCE", 1.0)
    monkeypatch.setattr(rr, "unregister_shutdown", lambda: None)
    recording = new_recording(lid_scene())
    with listener(answer) as url, pytest.raises(CrosscheckError, match=r"did not take the recording"):
        server.send(recording, url, lambda: recording.log("/", rr.Clear(recursive=False)))
