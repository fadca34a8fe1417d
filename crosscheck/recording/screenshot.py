"""Pictures of a recording, taken without a display."""

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

PATIENCE = 30.0
"""s that the viewer may take to start, and again to load a recording."""

WINDOW = "1280x940"
SETTLE = 2.0
"""s until the notices that a starting viewer shows over its views are gone."""

POLL = 0.1
"""s between questions to the viewer."""


MECHANISM = "3D"
"""Class of the view of the mechanism."""


def screenshots(
    rrd: str | os.PathLike[str], moments: Sequence[float], view_class: str | None = None
) -> list[bytes]:
    """Take PNGs of what the viewer shows of a recording at times, s, on its timeline `time`.

    Args:
        view_class: of the view that is wanted alone; all that the viewer shows if None.

    Raises:
        CrosscheckError: if the viewer does not start or does not get as far as a picture.
    """
    try:
        if not RrdReader(Path(rrd)).recordings():
            raise CrosscheckError(f"no recording in {os.fspath(rrd)}")
        with _viewer() as viewer, tempfile.TemporaryDirectory() as folder:
            viewer.open(str(Path(rrd).resolve()))
            _wait_until_loaded(viewer, rrd)
            viewer.run_command("ui.toggle_top_panel")
            time.sleep(SETTLE)
            views = [view.view_id for view in viewer.get_state().views if view.view_class == view_class]
            picture, taken = Path(folder) / "picture.png", []
            for moment in moments:
                viewer.set_time("time", duration=moment, play_state="paused")
                viewer.save_screenshot(str(picture), next(iter(views), None))
                taken.append(picture.read_bytes())
            return taken
    except (RuntimeError, OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise CrosscheckError(f"no picture of {os.fspath(rrd)}: {reason}") from error


@contextmanager
def _viewer() -> Iterator[ViewerClient]:
    """A viewer without a window that listens to this machine only; ended on the way out.

    It has a process group of its own, because Rerun's program may start the viewer as a child.
    """
    with socket.create_server((LOOPBACK, 0)) as probe:
        port = int(probe.getsockname()[1])
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
    try:
        process.wait(timeout=1.0)  # it breaks the connection a little before it is gone
    except subprocess.TimeoutExpired:
        return False
    return True


def _connect(process: subprocess.Popen[bytes], port: int) -> ViewerClient:
    deadline = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < deadline:
        try:
            client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            client.get_state()
        except (RuntimeError, ConnectionError):
            time.sleep(POLL)
        else:
            return client
    raise ConnectionError(f"no answer from the Rerun viewer within {PATIENCE:g} s")


def _wait_until_loaded(viewer: ViewerClient, rrd: str | os.PathLike[str]) -> None:
    deadline = time.monotonic() + PATIENCE
    state = viewer.get_state()
    while state.loading or state.active_recording is None:
        if time.monotonic() > deadline:
            raise CrosscheckError(f"the Rerun viewer did not load {os.fspath(rrd)}")
        time.sleep(POLL)
        state = viewer.get_state()
