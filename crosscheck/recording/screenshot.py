"""Take pictures (PNG) of a recording with the Rerun viewer, without a display.

A recording is a file (.rrd) of the motion of a mechanism. The viewer runs as a separate program without a
window ("headless"); this module tells it over a local network port which time to show.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from crosscheck.support.errors import CrosscheckError

LOOPBACK = "127.0.0.1"
"""Network address at which the viewer listens: only programs of this machine reach it."""

TIMEOUT_S = 30.0
"""Time, s, that the viewer may take to start, and again to load a recording."""

WINDOW = "1280x940"
"""Width and height of the viewer's window, pixels."""

NOTICES_S = 2.0
"""Time, s, after which the viewer's start-up notices no longer cover its views."""

POLL_S = 0.1
"""Time, s, between two queries to the viewer."""

MECHANISM = "3D"
"""Rerun's class of the 3-D view, which shows the mechanism."""


def screenshots(
    rrd: str | os.PathLike[str], times: Sequence[float], view_class: str | None = None
) -> list[bytes]:
    """Take pictures of a recording in the viewer.

    Args:
        rrd: path of the recording.
        times: times, s, on the recording's timeline `time`.
        view_class: Rerun's class of the view to show, such as `MECHANISM`; one that no tab covers is shown.
            None, or a class without a view, shows the whole window.

    Returns:
        The content of a PNG for each time.

    Raises:
        CrosscheckError: if the viewer does not start, or cannot show the recording.
    """
    try:
        if not RrdReader(Path(rrd)).recordings():
            raise CrosscheckError(f"no recording in {os.fspath(rrd)}")
        with _viewer() as viewer, tempfile.TemporaryDirectory() as folder:
            viewer.open(str(Path(rrd).resolve()))
            _wait_until_loaded(viewer, rrd)
            viewer.run_command("ui.toggle_top_panel")  # hide it
            time.sleep(NOTICES_S)
            picture, pictures = Path(folder) / "picture.png", []
            view = _view_on_top(viewer, view_class, picture)
            for seconds in times:
                viewer.set_time("time", duration=seconds, play_state="paused")
                viewer.save_screenshot(str(picture), view)
                pictures.append(picture.read_bytes())
            return pictures
    except (RuntimeError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise CrosscheckError(f"no picture of {os.fspath(rrd)}: {reason}") from error


def _view_on_top(viewer: ViewerClient, view_class: str | None, picture: Path) -> str | None:
    """Return the first view of a class that is not in a tab behind another one; None if there is none.

    The viewer lists the views of all tabs, and takes no picture of those behind others.

    Args:
        viewer: the viewer.
        view_class: Rerun's class of the view.
        picture: path of a picture that may be overwritten.
    """
    for view in viewer.get_state().views:
        if view.view_class == view_class:
            with suppress(ConnectionError):
                viewer.save_screenshot(str(picture), view.view_id)
                return view.view_id
    return None


@contextmanager
def _viewer() -> Iterator[ViewerClient]:
    """Start a viewer without a window, connect to it, and end it after the block.

    The viewer gets a separate process group, because Rerun's program may start the viewer as a child process.
    """
    with socket.create_server((LOOPBACK, 0)) as probe:  # finds a free port
        port = int(probe.getsockname()[1])
    # -P: do not import modules from the current folder
    command = [sys.executable, "-P", "-m", "rerun_cli", "--bind", LOOPBACK, "--hide-welcome-screen"]
    command += ["--headless", "--port", str(port), "--window-size", WINDOW]
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        try:
            yield _connect(process, port)
        except (RuntimeError, ConnectionError):
            if not _has_died(process):
                raise
            log.seek(0)
            output = log.read().decode(errors="replace").splitlines()
            # the viewer is a Rust program: the line that gives the reason of a crash has the word "panicked"
            reason = next((line for line in output if "panicked" in line), "no reason given")
            raise CrosscheckError(
                "the Rerun viewer died; it needs a Vulkan driver, on Debian the packages "
                f"mesa-vulkan-drivers and libvulkan1 ({reason})"
            ) from None
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _has_died(process: subprocess.Popen[bytes]) -> bool:
    """Return True if the viewer's process has ended or ends within a second."""
    try:
        process.wait(timeout=1.0)  # the connection breaks shortly before the process ends
    except subprocess.TimeoutExpired:
        return False
    return True


def _connect(process: subprocess.Popen[bytes], port: int) -> ViewerClient:
    """Connect to a starting viewer; raise `ConnectionError` if it ends or does not answer in `TIMEOUT_S`."""
    deadline = time.monotonic() + TIMEOUT_S
    while process.poll() is None and time.monotonic() < deadline:
        try:
            client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            client.get_state()
        except (RuntimeError, ConnectionError):
            time.sleep(POLL_S)
        else:
            return client
    raise ConnectionError(f"no answer from the Rerun viewer within {TIMEOUT_S:g} s")


def _wait_until_loaded(viewer: ViewerClient, rrd: str | os.PathLike[str]) -> None:
    """Wait until the viewer has loaded a recording; raise `CrosscheckError` after `TIMEOUT_S`."""
    deadline = time.monotonic() + TIMEOUT_S
    state = viewer.get_state()
    while state.loading or state.active_recording is None:
        if time.monotonic() > deadline:
            raise CrosscheckError(f"the Rerun viewer did not load {os.fspath(rrd)}")
        time.sleep(POLL_S)
        state = viewer.get_state()
