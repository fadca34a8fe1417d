"""Recordings for the Rerun viewer as streams of data: make one, write values over time, and get its bytes.

A recording is a tree of entities. An entity is a path with data: constant ones, or values over time. Poses
and arrows are stored in single precision, scalars in double precision. Rerun's quaternions have the order (x,
y, z, w); `crosscheck.recording.shapes.xyzw` converts them.

All recordings of a scene have the same application id, and each has a different recording id. A viewer that
opens several recordings of a scene shows them in the same layout, and the user can switch between them.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rerun as rr
from rerun import bindings

from crosscheck.recording.blueprint import TIME
from crosscheck.recording.shapes import xyzw
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

RERUN_SWITCH = "RERUN"
"""Environment variable by which users turn off Rerun's logging; it has no effect on these recordings."""


def application_id(scene: Scene) -> str:
    """Return the application id that all recordings of a scene share."""
    return f"crosscheck_{scene.name}"


def new_recording(scene: Scene) -> rr.RecordingStream:
    """Make an empty recording of a scene, with a new recording id."""
    rr.set_strict_mode(True)  # errors raise instead of printing a warning
    users_switch = os.environ.pop(RERUN_SWITCH, None)
    try:
        return rr.RecordingStream(application_id(scene), recording_id=uuid.uuid4())
    finally:
        if users_switch is not None:
            os.environ[RERUN_SWITCH] = users_switch


def recorded(log: Callable[..., None], scene: Scene, *args: Any, **more: Any) -> bytes:
    """Make a recording of a scene, and return the content of its file (.rrd).

    Args:
        log: function that writes to the recording, such as `crosscheck.recording.log.log_run`; called with
            the recording, the scene and the further arguments.
        scene: the scene.
        args, more: further arguments of `log`.
    """
    # Rerun starts two threads for each recording. Only the three steps in `finally` end the threads and free
    # the memory: disconnect, drop all references to the recording, clean up.
    recording = new_recording(scene)
    try:
        memory = recording.memory_recording()
        log(recording, scene, *args, **more)
        return bytes(memory.drain_as_bytes())
    finally:
        recording.disconnect()
        memory = None
        del recording
        bindings.flush_and_cleanup_orphaned_recordings()


def send_columns(
    recording: rr.RecordingStream,
    path: str,
    time: Array,
    columns: Callable[..., Any],
    **values: Array | Sequence[str],
) -> None:
    """Record values over time.

    Args:
        recording: recording to write to.
        path: path of the entity.
        time: times (n,), s.
        columns: Rerun's function for this kind of entity, such as `rr.Scalars.columns`.
        values: arguments of that function, each of length n.
    """
    nanoseconds = np.round(time * 1e9).astype("timedelta64[ns]")
    recording.send_columns(path, [rr.TimeColumn(TIME, duration=nanoseconds)], columns(**values))


def send_pose(
    recording: rr.RecordingStream, path: str, time: Array, position: Array, quaternion: Array
) -> None:
    """Record positions (n, 3), m, and quaternions (n, 4), (w, x, y, z), of an entity at times (n,), s."""
    pose = rr.Transform3D.columns
    send_columns(recording, path, time, pose, translation=position, quaternion=xyzw(quaternion))


def log_text(recording: rr.RecordingStream, path: str, text: str) -> None:
    """Record a text, Markdown, that does not change over time."""
    recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
