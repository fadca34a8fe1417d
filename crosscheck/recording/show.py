"""Show a recording on the screen: in a window of the Rerun viewer, or below the cell of a notebook."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

from rerun import bindings

from crosscheck.recording.stream import new_recording
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.processes import safe_path
from newton_euler.model.scene import Scene

SENDING_TIMEOUT_S = 60.0
"""Time, s, that the viewer may take to receive a recording."""


def show(log: Callable[..., None], scene: Scene, *args: Any) -> None:
    """Make a recording of a scene, and show it.

    Args:
        log: function that writes to the recording, such as `crosscheck.recording.log.log_run`; called with
            the recording, the scene and the further arguments.
        scene: the simulated mechanism, with its forces and initial state.
        args: further arguments of `log`.

    Raises:
        CrosscheckError: if no viewer can be opened.
    """
    notebook = in_notebook()
    if not (notebook or has_display()):
        raise CrosscheckError("no display to open a viewer on; save a recording and look with view --web")
    try:
        if notebook:
            recording = new_recording(scene)
            log(recording, scene, *args)
            recording.notebook_show()  # not disconnected: the cell continues to read it
        else:
            _show_in_window(log, scene, *args)
    except (ImportError, RuntimeError) as error:
        raise CrosscheckError(f"no viewer: {' '.join(str(error).split())}") from error


def _show_in_window(log: Callable[..., None], scene: Scene, *args: Any) -> None:
    """Open a viewer, send a recording to it, and end the two threads that Rerun starts for each recording.

    The arguments are those of `show`.
    """
    recording = new_recording(scene)
    try:
        with safe_path():  # the viewer must not import modules from the current folder
            recording.spawn()
        log(recording, scene, *args)
        recording.flush(timeout_sec=SENDING_TIMEOUT_S)
    finally:
        # only these three steps end the threads: disconnect, drop all references, clean up
        recording.disconnect()
        del recording
        bindings.flush_and_cleanup_orphaned_recordings()


def has_display() -> bool:
    """Return True if there is a screen on which a viewer can open a window."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def in_notebook() -> bool:
    """Return True if this process is the kernel of a Jupyter notebook."""
    shell = sys.modules.get("IPython")
    return shell is not None and hasattr(shell.get_ipython(), "kernel")
