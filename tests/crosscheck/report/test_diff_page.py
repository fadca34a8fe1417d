"""Page of a comparison of two model files: ellipsoids, marks, filters, bars, and what it refuses."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import run

import crosscheck
from crosscheck.differences.shapes import Shapes, shapes
from crosscheck.report.diff_page import bar_charts
from crosscheck.report.page import write_report
from crosscheck.report.robot_view import MARGIN, WIDTH, robot_views
from crosscheck.support.checksum import with_checksum
from crosscheck.support.errors import CrosscheckError

EVIL = "</td><script>alert(1)</script>"

ARM = """<mujoco><worldbody><body name="{name}"><joint name="shoulder" axis="0 1 0"/>
  <inertial pos="0.1 0 0" mass="{mass}" diaginertia="{inertia}"/>
  <body name="lower" pos="{place} 0 0"><joint name="elbow" axis="0 1 0"/>
    <inertial pos="0.1 0 0" mass="0.8" diaginertia="0.001 0.004 0.004"/></body></body></worldbody></mujoco>"""

# a homogeneous ellipsoid of 1.5 kg with semi-axes of 0.3, 0.2 and 0.1 m: mass / 5 times sums of two squares
SEMI_AXES = np.array([0.3, 0.2, 0.1])
MOMENTS = 1.5 / 5.0 * (np.sum(SEMI_AXES**2) - SEMI_AXES**2)
EQUAL = {"name": "upper", "mass": "1.5", "inertia": " ".join(map(repr, MOMENTS.tolist())), "place": "0.3"}


def shapes_of(folder: Path, **changes: str) -> Shapes:
    """Compare the arm with a changed one."""
    paths = folder / "first.xml", folder / "second.xml"
    for path, values in zip(paths, (EQUAL, EQUAL | changes), strict=True):
        path.write_text(ARM.format(**values))
    found = crosscheck.diff(*paths).comparison
    return shapes((found.first, found.second), found.alignment, found.states, found.differences)


def test_spread_has_the_squares_of_the_semi_axes(tmp_path: Path) -> None:
    found = shapes_of(tmp_path)
    # 1e-9: round-off of MuJoCo's principal axes
    assert np.array(found.first[0].spread) == pytest.approx(np.diag(SEMI_AXES**2), abs=1e-9)
    assert found.first[0].center == pytest.approx((0.1, 0.0, 0.0), abs=1e-12)
    assert [shape.parent for shape in found.first] == [-1, 0]
    assert not any(shape.differs or shape.displaced for shape in (*found.first, *found.second))
    assert found.marks == ()


def test_ellipses_have_the_size_of_the_ellipsoid(tmp_path: Path) -> None:
    """Seen from the right, the semi-axes along x and z are 0.3 and 0.1 m."""
    right = robot_views(shapes_of(tmp_path))[2]
    upper = next(each for each in right.ellipses if each.title.startswith("upper"))
    assert upper.kind == "both"
    # 0.05: lengths are rounded to a tenth
    assert upper.ry == pytest.approx(upper.rx / 3.0, abs=0.05)
    assert upper.angle % 180.0 == pytest.approx(0.0, abs=0.1)
    assert all(MARGIN - 1.0 <= each.x <= WIDTH - MARGIN + 1.0 for each in right.ellipses)


def test_a_body_that_differs_is_drawn_twice_and_marked(tmp_path: Path) -> None:
    found = shapes_of(tmp_path, mass="1.8")
    assert [shape.differs for shape in found.first] == [True, False]
    assert [shape.differs for shape in found.second] == [True, False]
    (mark,) = found.marks
    assert (mark.row, mark.point) == (0, pytest.approx((0.1, 0.0, 0.0), abs=1e-12))
    for view in robot_views(found):
        assert sorted(each.kind for each in view.ellipses) == ["both", "first", "second"]
        assert [label.row for label in view.labels] == [1]


def test_bodies_after_a_moved_joint_are_displaced(tmp_path: Path) -> None:
    found = shapes_of(tmp_path, place="0.4")
    assert [shape.displaced for shape in found.second] == [False, True]
    assert found.second[1].point == pytest.approx((0.4, 0.0, 0.0), abs=1e-12)
    assert [shape.joint_differs for shape in found.first] == [False, True]


def test_bars_are_logarithmic(tmp_path: Path) -> None:
    paths = tmp_path / "first.xml", tmp_path / "second.xml"
    for path, mass in zip(paths, ("1.5", "1.8"), strict=True):
        path.write_text(ARM.format(**EQUAL | {"mass": mass}))
    found = crosscheck.diff(*paths)
    effects, changes = bar_charts(found.comparison.rows, found.motion)
    (bar,) = effects.bars
    assert bar.label == "1  mass of upper"
    effect = found.differences[0].effect
    assert effect is not None
    low, high = (float(text) / 100.0 for text in re.findall(r"from (\S+) % to (\S+) %", effects.caption)[0])
    # 0.05: places are rounded to a tenth of a percent
    assert bar.length == pytest.approx(100.0 * np.log(effect / low) / np.log(high / low), abs=0.05)
    assert {each.label for each in changes.bars} == {"upper", "lower"}


@pytest.fixture
def folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """Result of a comparison of files with a name that is HTML."""
    name = EVIL.replace("<", "&lt;")
    for file, mass in (("first", "1.5"), ("second", "1.8")):
        (tmp_path / f"{file}.xml").write_text(ARM.format(**EQUAL | {"name": name, "mass": mass}))
    paths = tmp_path / "first.xml", tmp_path / "second.xml"
    assert run(capsys, "diff", *paths, "--output", tmp_path / "out")[0] == 1
    return tmp_path / "out"


def test_the_page_has_one_script_and_texts_are_escaped(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    assert EVIL not in text
    (script,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    checksum = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{checksum}'"
        in text
    )
    assert text.count("<svg") == 3
    assert not re.search(r'(?:src|href)="(?!data:|#)', text)


def test_the_table_has_all_rows_without_script(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    table = text[text.index('<table class="filtered">') :]
    table = table[: table.index("</table>")]
    assert table.count('data-heading="quantity"') == 1
    assert '<th scope="col" class="choice">quantity</th>' in table
    assert "1.5 kg" in table
    assert "1.8 kg" in table


@pytest.mark.parametrize(("key", "value"), [("parent", 5), ("mass", "inf"), ("point", [0.0, 0.0])])
def test_damaged_shapes_are_refused(folder: Path, key: str, value: object) -> None:
    path = folder / "diff.json"
    content = json.loads(path.read_text())
    content["shapes"]["first"][0][key] = value
    path.write_text(json.dumps(with_checksum(content)))
    with pytest.raises(CrosscheckError, match="shapes"):
        write_report(folder, lambda _: None)
