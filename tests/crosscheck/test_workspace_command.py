"""`crosscheck workspace`: its table, its files, and ranges that cannot be."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from command_line import csv_rows, run
from PIL import Image

from crosscheck.design import workspace as design
from crosscheck.design import workspace_map, workspace_plots
from crosscheck.library import load
from crosscheck.report.table import Lines
from mjcf.clearance import clearances
from newton_euler import (
    Body,
    Capsule,
    Cylindrical,
    Fixed,
    Free,
    Mechanism,
    Point,
    Revolute,
    Scene,
    Sphere,
    singular_poses,
    workspace,
)

VARY = "--vary", "slide_12=0.0:0.06:7", "--vary", "slide_13=0.0:0.06:5"


@pytest.fixture
def few_searches(monkeypatch):
    monkeypatch.setattr(workspace_map, "SINGULAR_SEARCHES", 200)


def test_workspace_prints_a_table_and_writes_a_picture_and_rows(capsys, tmp_path, few_searches):
    arguments = ("workspace", "tracker", *VARY, "--axis", "panel_7=0,0,1", "--output", tmp_path)
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    assert "reachable" in out
    assert json.loads((tmp_path / "workspace.json").read_text())["without_collision"] == 35
    assert (tmp_path / "workspace.png").read_bytes().startswith(b"\x89PNG")
    rows = csv_rows(tmp_path / "workspace.csv")
    assert f"{len(rows)} of 35" in out
    assert {"slide_12, m", "elevation, deg", "azimuth, deg", "distance from singular", "clearance, m"} <= set(
        rows[0]
    )
    elevations = [float(row["elevation, deg"]) for row in rows]
    assert f"{min(elevations):.1f} .. {max(elevations):.1f}" in out


def test_one_coordinate_without_shapes_has_rows_alone(capsys, tmp_path):
    status, out, _ = run(capsys, "workspace", "pendulum", "--vary", "pivot=-1:1:5", "--output", tmp_path)
    assert status == 0
    assert "5 of 5" in out
    assert "no picture" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["workspace.csv", "workspace.json"]


def test_points_out_of_reach_are_told(capsys, tmp_path):
    status, out, _ = run(capsys, "workspace", "slider_crank", "--vary", "guide=5:6:6", "--output", tmp_path)
    assert status == 0
    assert "none of 6 points is reachable on the branch of the initial pose" in " ".join(out.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--vary", "slide_12=0:1"), "as many as degrees of freedom, 2"),
        (("--vary", "slide_12=1:0"), "JOINT=LOW:HIGH[:POINTS]"),
        (("--vary", "slide_12=0:1:1"), "JOINT=LOW:HIGH[:POINTS]"),
        (("--vary", "slide_12=0:x"), "JOINT=LOW:HIGH[:POINTS]"),
        (("--vary", "slide_21=0:1"), "unknown joint 'slide_21'"),
        ((*VARY, "--axis", "panel_7"), "BODY=X,Y,Z"),
        ((*VARY, "--axis", "panel=0,0,1"), "unknown body 'panel'"),
        ((*VARY, "--axis", "panel_7=0,0,0"), "not all of them 0"),
        ((*VARY, "--point", "panel_7"), "BODY=X,Y,Z"),
        ((*VARY, "--point", "panel_7=0,0"), "BODY=X,Y,Z"),
        ((*VARY, "--point", "panel=0,0,1"), "unknown body 'panel'"),
        ((*VARY, "--point", "base=0,0,1"), "a body that moves"),
        (("--vary", "slide_12=0:1:2000", "--vary", "slide_13=0:1:2000"), "more than 1000000 points"),
    ],
)
def test_impossible_ranges_are_one_line(capsys, tmp_path, arguments, words):
    status, out, err = run(capsys, "workspace", "tracker", *arguments, "--output", tmp_path)
    assert (status, out) == (2, "")
    assert words in " ".join(err.split())
    assert not list(tmp_path.iterdir())


def test_clearance_of_spheres_and_bars_is_their_distance():
    moments = 0.01 * np.eye(3)
    ball = Body("ball", 1.0, [0.0, 0.0, 1.0], moments, shapes=(Sphere([0.0, 0.0, 1.0], 0.1),))
    bar = Capsule([1.0, -1.0, 1.0], [1.0, 1.0, 1.0], 0.05)
    rod = Body("rod", 1.0, [1.0, 0.0, 1.0], moments, shapes=(bar,))
    joints = [
        Free("ball_floats", "ground", "ball", [0.0, 0.0, 0.0]),
        Revolute("hinge", "ground", "rod", [1.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0]),
    ]
    mechanism = Mechanism([Body.ground(), ball, rod], joints)
    position = np.array([[[0.0, 0.0, 0.0], [x, 0.3, 1.0], [1.0, 0.0, 1.0]] for x in (0.0, 0.5, 0.95)])
    quaternion = np.tile([1.0, 0.0, 0.0, 0.0], (3, 3, 1))
    found = clearances(mechanism, position, quaternion)
    np.testing.assert_allclose(found, [0.85, 0.35, -0.10], rtol=0.0, atol=1e-6)  # MuJoCo's tolerance
    joined = Mechanism([Body.ground(), ball, rod], [*joints, Free("both", "ball", "rod", [0.0, 0.0, 0.0])])
    assert np.isinf(clearances(joined, position, quaternion)).all()


FLAT = "--vary", "pivot_0=-2.0:2.0:9"


def test_a_point_in_a_plane_has_extents_extremes_and_results_to_take_away(capsys, tmp_path, few_searches):
    """The middle of a coupler of 1 m moves on a circle of 1 m about (0.5, 0)."""
    arguments = ("workspace", "four_bar", "--set", "N=1", *FLAT, "--point", "coupler_0=0.5,1,0")
    status, out, _ = run(capsys, *arguments, "--output", tmp_path)
    assert status == 0
    assert (tmp_path / "workspace.png").read_bytes().startswith(b"\x89PNG")
    angles = np.linspace(-2.0, 2.0, 9)
    expected = {"x, m": 0.5 - np.sin(angles), "y, m": np.cos(angles), "z, m": np.zeros(9)}
    rows = csv_rows(tmp_path / "workspace.csv")
    for name, values in expected.items():
        np.testing.assert_allclose([float(row[name]) for row in rows], values, atol=1e-8)
    beyond = [float(row["beyond singular"]) for row in rows]
    np.testing.assert_array_equal(beyond, np.abs(angles) > 0.5 * np.pi)
    found = json.loads((tmp_path / "workspace.json").read_text())
    assert (found["source"], found["options"], found["branch"]) == ("four_bar", {"N": "1"}, "initial pose")
    assert (found["points"], found["reachable"], found["beyond_singular"]) == (9, 9, sum(beyond))
    assert found["point"] == {"body": "coupler_0", "point": [0.5, 1.0, 0.0]}
    extremes = {each["position"]: each for each in found["extremes"]}
    assert extremes.keys() == {f"{end} {axis}" for end in ("minimum", "maximum") for axis in "xy"}
    highest = extremes["maximum y"]
    assert (highest["x, m"], highest["y, m"]) == pytest.approx((0.5, 1.0), abs=1e-12)
    assert highest["coordinates"]["pivot_0"] == pytest.approx(0.0, abs=1e-12)
    assert "2 of 9 poses are reached through a singular configuration" in " ".join(out.split())
    # the page has the tables and the picture
    assert run(capsys, "report", tmp_path)[0] == 0
    page = (tmp_path / "report.html").read_text()
    assert all(text in page for text in ("workspace over pivot_0", "maximum y", "data:image/png;base64,"))


def test_coordinates_of_joints_with_several_have_numbers(few_searches):
    """A bead that slides along a shaft and turns about it; a point of its surface."""
    bead = Body("bead", 1.0, [0.0, 0.0, 0.0], np.eye(3))
    shaft = Cylindrical("shaft", "ground", "bead", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0])
    scene = Scene("bead", Mechanism([Body.ground(), bead], [shaft]), duration=1.0, output_period=0.1)
    grid = dict(design.range_of(scene, text) for text in ("shaft.0=-1:1:3", "shaft.1=-1:1:5"))
    found = design.measure(scene, grid, None, Point("bead", [0.2, 0.0, 0.0]), print)
    table = design.report(found).parts[0]
    names = ["points", "shaft.0, m", "shaft.1, rad", "x, m", "y, m", "z, m"]
    assert [row[0] for row in table.rows[:6]] == names


@pytest.mark.slow
def test_maps_show_every_kind_of_point():
    """No map on a line; one in a plane, of a curve; two of an area over three coordinates; three in space."""
    strokes = {
        name: np.array([-0.2, 0.0, 0.2]) for name in ("boom_cylinder", "stick_cylinder", "bucket_cylinder")
    }
    cases = [
        ("slider_crank", {"pivot": np.linspace(-1.0, 1.0, 3)}, Point("slider", [0.2, 0.0, 0.0]), 0),
        ("four_bar", {"pivot_0": np.linspace(-1.0, 1.0, 3)}, Point("coupler_0", [0.5, 1.0, 0.0]), 1),
        ("excavator", strokes, Point("bucket", [8.34, 0.0, -0.1]), 2),
        ("slider_crank", {"pivot": np.linspace(-1.0, 1.0, 3)}, Point("rod", [0.1, 0.1, 0.1]), 3),
    ]
    for name, grid, point, count in cases:
        scene = load(name)
        space = workspace(scene, grid, point=point)
        singular = singular_poses(scene, list(grid), 20)
        found = workspace_map.WorkspaceMap(
            scene, space, singular, np.full(len(space.poses), np.inf), None, point
        )
        drawn = workspace_plots.picture(found)
        if not count:
            assert drawn is None
            continue
        width = workspace_plots.PANEL_WIDTH * count * 110  # pixels
        assert Image.open(io.BytesIO(drawn)).width == pytest.approx(width, abs=1)


@pytest.mark.parametrize(("gap", "free", "named"), [(-0.01, 5, True), (0.01, 3, False)])
def test_bodies_that_overlap_at_the_start_are_named_and_others_are_examined(few_searches, gap, free, named):
    """Balls on a crank of 1 m and on a post: their distance is 2 sin(angle / 2) less both radii. They overlap
    at the start, or with a gap at the start where the crank has turned towards the post.
    """
    start = 0.3  # rad, of the crank from the post
    radius = np.sin(0.5 * start) - 0.5 * gap
    bodies = [
        Body.ground(),
        Body.solid("crank", Sphere([np.cos(start), 0.0, np.sin(start)], radius), density=100.0),
        Body.solid("post", Sphere([1.0, 0.0, 0.0], radius), density=100.0),
    ]
    joints = [
        Revolute("pivot", "ground", "crank", [0.0, 0.0, 0.0], axis=[0.0, -1.0, 0.0]),
        Fixed("foot", "ground", "post", [1.0, 0.0, 0.0]),
    ]
    scene = Scene("crank", Mechanism(bodies, joints), 1.0, 0.1)
    angles = np.linspace(-0.2, 0.2, 5)
    found = design.measure(scene, {"pivot": angles}, None, None, lambda _: None)
    assert found.left_out == ({frozenset(("crank", "post"))} if named else set())
    assert int(np.sum(~found.collides)) == free
    if not named:
        np.testing.assert_allclose(found.clearance, 2.0 * np.sin(0.5 * (start + angles)) - 2.0 * radius)
    notes = [line for part in design.report(found).parts if isinstance(part, Lines) for line in part.lines]
    assert any("crank and post" in line for line in notes) == named
