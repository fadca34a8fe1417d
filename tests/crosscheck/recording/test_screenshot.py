"""Pictures of recordings, taken by the viewer without a display."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import pytest
from recordings import write_recording

from crosscheck.errors import CrosscheckError
from crosscheck.recording.screenshot import screenshot
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory


def test_screenshot_of_no_recording(tmp_path: Path) -> None:
    with pytest.raises(CrosscheckError, match=r"absent\.rrd"):
        screenshot(tmp_path / "absent.rrd", 0.0)


def test_screenshot_without_a_working_viewer(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "lid.rrd", scene, runs)
    viewer = tmp_path / "viewer"
    viewer.write_text("#!/bin/sh\necho panicked for want of an adapter\nexit 101\n")
    viewer.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(viewer))
    with pytest.raises(CrosscheckError, match=r"mesa-vulkan-drivers and libvulkan1 \(panicked for"):
        screenshot(tmp_path / "lid.rrd", 0.0)


@pytest.mark.skipif(not list(Path("/usr/share/vulkan/icd.d").glob("*.json")), reason="needs a Vulkan driver")
def test_screenshot(scene: Scene, runs: dict[str, Trajectory], tmp_path: Path) -> None:
    write_recording(tmp_path / "lid.rrd", scene, runs)
    png = screenshot(tmp_path / "lid.rrd", 0.6)
    assert png.startswith(b"\x89PNG")
    assert struct.unpack(">II", png[16:24]) == (1600, 900)
