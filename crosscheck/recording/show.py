"""Recordings on the screen: in a viewer's window, or below the cell of a notebook."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

from rerun import bindings

from crosscheck.recording.log import new_recording
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.processes import safe_path
from newton_euler.model.scene import Scene

LONGEST_SENDING = 60.0
"""s that the viewer may take to receive a recording."""


def show(log: Callable[..., None], scene: Scene, *args: Any) -> None:
    """Show a recording of a scene that `log` logs to with these arguments, see `recorded`.

    Raises:
        CrosscheckError: where no viewer can be opened.
    """
    notebook = in_notebook()
    if not (notebook or has_display()):
        raise CrosscheckError("no display to open a viewer on; save a recording and look with view --web")
    try:
        if notebook:
            recording = new_recording(scene)
            log(recording, scene, *args)
            recording.notebook_show()  # the cell reads the recording as long as the cell is there
        else:
            _show_in_window(log, scene, *args)
    except (ImportError, RuntimeError) as error:
        raise CrosscheckError(f"no viewer: {' '.join(str(error).split())}") from error


def _show_in_window(log: Callable[..., None], scene: Scene, *args: Any) -> None:
    """Open a viewer, send it the recording, and end the threads of the recording, as `recorded` does."""
    recording = new_recording(scene)
    try:
        with safe_path():
            recording.spawn()
        log(recording, scene, *args)
        recording.flush(timeout_sec=LONGEST_SENDING)
    finally:
        recording.disconnect()
        del recording
        bindings.flush_and_cleanup_orphaned_recordings()


def has_display() -> bool:
    """Return whether there is a screen that a viewer can open a window on."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def in_notebook() -> bool:
    """Return whether the interpreter is the kernel of a notebook."""
    shell = sys.modules.get("IPython")
    return shell is not None and hasattr(shell.get_ipython(), "kernel")
