"""Recordings on the screen: in a viewer's window, or below the cell of a notebook."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

import rerun as rr

from crosscheck.errors import CrosscheckError
from crosscheck.recording.log import new_recording
from newton_euler.model.scene import Scene


def show(scene: Scene, log: Callable[[rr.RecordingStream], None]) -> None:
    """Show a recording of a scene that a function logs to.

    Raises:
        CrosscheckError: where no viewer can be opened.
    """
    notebook = in_notebook()
    if not (notebook or has_display()):
        raise CrosscheckError("no display to open a viewer on; save a recording and look with view --web")
    recording = new_recording(scene)
    try:
        if notebook:
            log(recording)
            recording.notebook_show()
        else:
            recording.spawn()
            log(recording)
    except (ImportError, RuntimeError) as error:
        raise CrosscheckError(f"no viewer: {' '.join(str(error).split())}") from error


def has_display() -> bool:
    """Return whether there is a screen that a viewer can open a window on."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


def in_notebook() -> bool:
    """Return whether the interpreter is the kernel of a notebook."""
    shell = sys.modules.get("IPython")
    return shell is not None and hasattr(shell.get_ipython(), "kernel")
