"""An MJCF file is compiled in a process of its own, given time by its size."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest
from mjcf_models import PAIR, model

import mjcf
import mjcf.reading.source as source
import urdf
from mjcf.reading.source import compile_file
from newton_euler.limits import ENVIRONMENT_VARIABLE, changed, size_in_bytes
from newton_euler.model.source_file import SourceError

MESH = model(
    '<body><joint/><geom type="mesh" mesh="wedge"/></body>',
    '<asset><mesh name="wedge" file="wedge.obj"/></asset>',
)
WEDGE = "v 0 0 0\nv {0} 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Those that compile."""
    found: list[list[str]] = []
    run = subprocess.run

    def heard(command: list[str], **options: Any) -> Any:
        found.append(command)
        # each thread of BLAS sets 40 MB aside, which count as memory of the compiler
        assert options["env"]["OPENBLAS_NUM_THREADS"] == "1"
        return run(command, **options)

    monkeypatch.setattr(source.subprocess, "run", heard)  # type: ignore[attr-defined]
    return found


def test_a_file_with_assets_may_take_longer(
    tmp_path: Path, commands: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Meshes a hundred times as small here, of which each byte counts a hundred times as much."""
    largest = 1_000_000
    monkeypatch.setenv(ENVIRONMENT_VARIABLE, "asset_size=1")
    monkeypatch.setattr(source, "SECONDS_PER_ASSET_BYTE", 100.0 * source.SECONDS_PER_ASSET_BYTE)
    path, mesh = tmp_path / "model.xml", tmp_path / "wedge.obj"
    path.write_text(MESH)
    for size in (0, 200_000, largest):
        text = WEDGE.format("1")
        mesh.write_text("#" * max(0, size - len(text) - 1) + "\n" + text)
        compile_file(str(path))
    assert [int(command[-2]) for command in commands] == [2, 6, 22]
    path.write_text(model(PAIR))
    compile_file(str(path))
    assert int(commands[-1][-2]) == 2


@pytest.mark.parametrize("path", [None, 3, b"model.xml", "a\0b.xml"])
@pytest.mark.parametrize("read", [mjcf.read, urdf.read])
def test_what_is_no_path_is_refused(path: Any, read: Any) -> None:
    with pytest.raises(
        SourceError,
        match=r"cannot be read; needed: a path of a file(, (a mujoco.MjSpec|a pinocchio.Model) or .+)?$",
    ):
        read(path)


@pytest.mark.parametrize(("used", "lacks"), [(0.1, False), (0.8, True)])
def test_lack_of_memory_is_told_from_a_crash_by_what_was_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, used: float, lacks: bool
) -> None:
    """Rows times columns of this height field overflow in MuJoCo, at any memory."""
    field = '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>'
    path = tmp_path / "model.xml"
    path.write_text(model(PAIR, field))
    monkeypatch.setattr(source, "_peak_memory", lambda: used * size_in_bytes("memory"))
    with changed({"memory": 900}), pytest.raises(SourceError) as error:
        compile_file(str(path))
    assert ("--set memory=3600" in str(error.value)) == lacks
    assert ("unknown exception" in str(error.value)) != lacks


@pytest.mark.parametrize(("actuators", "copies"), [("", 2), ('<motor joint="p"/>', 3)])
def test_copies_of_a_model_that_exceed_the_free_memory_are_refused(
    actuators: str, copies: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before they are made; a run that takes all memory is ended by the system without a word.

    The copies are those beside the compiled model, which is no part of the free memory.
    """
    path = tmp_path / "model.xml"
    path.write_text(model(PAIR, f"<actuator>{actuators}</actuator>"), encoding="utf-8")
    made, _ = compile_file(str(path))
    monkeypatch.setattr(source, "free_memory", lambda: copies * made.nbuffer)
    mjcf.read(path)
    monkeypatch.setattr(source, "free_memory", lambda: copies * made.nbuffer - 1)
    with pytest.raises(SourceError, match="MB more, 0 MB are free"):
        mjcf.read(path)
