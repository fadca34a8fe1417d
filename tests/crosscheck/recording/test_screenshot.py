"""Pictures of recordings, taken by the viewer without a display."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

import pytest
from recordings import write_recording

from crosscheck.recording.screenshot import MECHANISM, WINDOW, screenshots
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory


def test_screenshot_of_no_recording(tmp_path: Path) -> None:
    with pytest.raises(CrosscheckError, match=r"absent\.rrd"):
        screenshots(tmp_path / "absent.rrd", [0.0])


def test_screenshot_without_a_working_viewer(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "lid.rrd", scene, runs)
    viewer = tmp_path / "viewer"
    viewer.write_text("#!/bin/sh\necho panicked for want of an adapter\nexit 101\n")
    viewer.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(viewer))
    with pytest.raises(CrosscheckError, match=r"mesa-vulkan-drivers and libvulkan1 \(panicked for"):
        screenshots(tmp_path / "lid.rrd", [0.0])


@pytest.mark.skipif(not list(Path("/usr/share/vulkan/icd.d").glob("*.json")), reason="needs a Vulkan driver")
def test_screenshots(scene: Scene, runs: dict[str, Trajectory], tmp_path: Path) -> None:
    write_recording(tmp_path / "lid.rrd", scene, runs)
    pictures = screenshots(tmp_path / "lid.rrd", [0.0, 0.6])
    assert len({*pictures}) == 2
    (part,) = screenshots(tmp_path / "lid.rrd", [0.6], MECHANISM)
    sizes = [struct.unpack(">II", png[16:24]) for png in (*pictures, part)]
    assert sizes[:2] == [tuple(map(int, WINDOW.split("x")))] * 2
    assert all(whole > less for whole, less in zip(sizes[0], sizes[2], strict=True))
