"""`crosscheck workspace`: its table, its files, and ranges that cannot be."""

from __future__ import annotations

import csv

import numpy as np
import pytest
from command_line import run

from mjcf.clearance import clearances
from newton_euler import Body, Capsule, Free, Mechanism, Revolute, Sphere

VARY = "--vary", "slide_12=0.0:0.06:7", "--vary", "slide_13=0.0:0.06:5"


def test_workspace_prints_a_table_and_writes_a_picture_and_rows(capsys, tmp_path):
    arguments = ("workspace", "tracker", *VARY, "--axis", "panel_7=0,0,1", "--output", tmp_path)
    status, out, _ = run(capsys, *arguments)
    assert status == 0
    assert "reachable" in out
    assert "without collision" in out
    assert (tmp_path / "workspace.png").read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader((tmp_path / "workspace.csv").open()))
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
