"""Readings of URDF and loop files against Pinocchio's model: faults planted in them are found and named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from urdf_files import joint, link, robot

import urdf
from crosscheck.studies.faults.find import find_in_reading
from urdf import read
from urdf.errors import UrdfError
from urdf.reader import _scene
from urdf.reading.source import read_loops
from urdf.reading.start import Mimic, RobotAtStart

GEARED = robot(
    link("a"), link("b"), link("c"),
    joint("one", "revolute", "base", "a", '<dynamics damping="0.3"/>'),
    joint("two", "revolute", "a", "b", '<mimic joint="one" multiplier="0.5" offset="0.3"/>'),
    joint("three", "prismatic", "b", "c", '<dynamics damping="2"/>'),
)  # fmt: skip


@pytest.fixture
def geared(tmp_path: Path) -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(GEARED)
    return path


def test_faults_in_the_reading_of_a_urdf_are_found_and_named(geared: Path) -> None:
    report = read(geared).report
    found = find_in_reading(report, lambda _: None).found
    assert not [outcome.fault.name for outcome in found if outcome.is_detectable and not outcome.detection]
    assert not [
        (outcome.fault.name, outcome.detection.where)
        for outcome in found
        if outcome.detection and not outcome.located
    ]
    kinds = {outcome.fault.kind for outcome in found}
    assert kinds >= {"mass", "axis direction", "gear", "damping of JointSpring"}


def started(self: Any, mimics: Any, mimicked: Any = RobotAtStart._mimicked) -> Any:
    moved = mimicked(self, mimics)
    moved[-1] += 2.0
    return moved


def shifted(self: Any, joint: Any, mimic: Any, init: Any = Mimic.__init__) -> None:
    init(self, joint, mimic)
    self.offset += 0.1


@pytest.mark.parametrize(
    ("where", "fault", "named"),
    [
        (
            "urdf.reader.joint_springs",
            lambda *_: iter(()),
            "is not what the file says: dampers, rel: 1 > ",
        ),
        ("urdf.reading.start.RobotAtStart._mimicked", started, "joint 'three': .*start, sizes or rad"),
        ("urdf.reader.Mimic.__init__", shifted, "mimic of joint 'two': .*loops open at the start"),
    ],
    ids=["no dampers", "a joint elsewhere", "another offset"],
)
def test_a_urdf_that_is_not_read_right_is_refused(
    where: str, fault: Any, named: str, geared: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read(geared)
    monkeypatch.setattr(where, fault)
    with pytest.raises(UrdfError, match=named):
        read(geared)


def fewer(path: str, text: str) -> Any:
    loops = read_loops(path, text)
    return replace(loops, closed_loop=loops.closed_loop[:-1], type=loops.type[:-1])


def lighter(*args: Any) -> Any:
    *others, gravity = args
    return _scene(*others, [0.5 * x for x in gravity])


@pytest.mark.parametrize(
    ("where", "fault", "named"),
    [
        ("urdf.reader.read_loops", fewer, "closed_loop .*: elements unaccounted for"),
        ("urdf.reader._scene", lighter, "gravity: .*gravity, rel"),
    ],
    ids=["one loop fewer", "half of gravity"],
)
def test_the_original_of_a_urdf_has_its_own_loops_and_gravity(
    where: str, fault: Any, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(urdf.__file__).parent / "tracker.urdf"
    monkeypatch.setattr(where, fault)
    with pytest.raises(UrdfError, match=named):
        read(path, path.with_name("tracker.loops.yaml"))
