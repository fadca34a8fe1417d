"""What is plotted of a run, and from where it is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recordings import read_recording, write_recording
from rerun.chunk import RrdReader

import newton_euler
from crosscheck.engines.palette import LOOKS, palette
from crosscheck.library import load
from crosscheck.recording.blueprint import EYE_DIRECTION, HALF_FIELD_OF_VIEW, MIN_ASPECT_RATIO
from crosscheck.recording.plots import plots, tilt
from crosscheck.recording.shapes import drawn_points
from crosscheck.support.colors import OTHER_COLORS, rgb
from newton_euler.model.euler_parameters import from_rotation_vector

X, Y, Z = np.eye(3)


@pytest.mark.parametrize(
    ("name", "direction", "up"),
    [
        ("four_bar", Z, Y),
        ("andrews", Z, Y),
        ("slider_crank", EYE_DIRECTION, Z),
        ("tracker", EYE_DIRECTION, Z),
    ],
)
def test_all_that_moves_is_seen_and_a_plane_face_on(tmp_path, name, direction, up):
    scene = load(name)
    run = newton_euler.simulate(scene)
    write_recording(tmp_path / "run.rrd", scene, {"newton_euler": run})
    reader = RrdReader(tmp_path / "run.rrd")
    (entry,) = reader.blueprints()
    batches = [chunk.to_record_batch() for chunk in reader.stream(store=entry)]
    (batch,) = [batch for batch in batches if "EyeControls3D:position" in batch.schema.names]
    position, target, upwards = (
        np.array(batch.column(f"EyeControls3D:{part}").to_pylist()[0][0])
        for part in ("position", "look_target", "eye_up")
    )
    seen = (position - target) / np.linalg.norm(position - target)
    np.testing.assert_allclose(seen, direction / np.linalg.norm(direction), atol=1e-6)  # single precision
    np.testing.assert_array_equal(upwards, up)
    right = np.cross(up, seen) / np.linalg.norm(np.cross(up, seen))
    for body in range(len(scene.mechanism.bodies)):
        points = drawn_points(scene.mechanism, body, run) - position
        depth = -points @ seen
        assert np.all(depth > 0.0)
        assert np.all(np.abs(points @ right) < MIN_ASPECT_RATIO * np.tan(HALF_FIELD_OF_VIEW) * depth)
        assert np.all(np.abs(points @ np.cross(seen, right)) < np.tan(HALF_FIELD_OF_VIEW) * depth)


def test_what_neither_moves_nor_parts_is_not_plotted():
    scene = load("pendulum")
    run = newton_euler.simulate(scene)
    titles = [plot.title for plot in plots(scene, {"newton_euler": run}, {}) if not plot.is_judged]
    assert titles == ["pivot [rad]", "kinetic energy [J]", "potential energy [J]"]


def test_springs_say_which_coordinates_are_plotted():
    scene = load("stewart")
    run = newton_euler.simulate(scene)
    found = [plot.title for plot in plots(scene, {"newton_euler": run}, {}) if plot.group == "Motion"]
    assert found == [*(f"leg_{k + 1}_1 [m]" for k in range(5)), "tilt of platform [deg]"]


def test_tilt_is_drawn_beside_the_vertical(tmp_path):
    scene = replace(load("tracker"), duration=0.1)
    run = newton_euler.simulate(scene)
    write_recording(tmp_path / "run.rrd", scene, {"newton_euler": run})
    columns = read_recording(tmp_path / "run.rrd").columns
    for pose in ("Transform3D:translation", "Transform3D:quaternion"):
        assert columns["/tilt/normal", pose] == columns["/labels/panel_7", pose]
    assert columns["/tilt/vertical", "Transform3D:quaternion"] == [[[0.0, 0.0, 0.0, 1.0]]] * len(run.time)


def test_wind_is_an_arrow_upwind_of_the_plate(tmp_path):
    scene = replace(load("tracker_wind", wind="gust"), duration=0.1)
    run = newton_euler.simulate(scene)
    write_recording(tmp_path / "run.rrd", scene, {"newton_euler": run})
    columns = read_recording(tmp_path / "run.rrd").columns
    ends = [np.squeeze(columns["/wind/wind", f"Arrows3D:{part}"]) for part in ("origins", "vectors")]
    (wind,) = scene.forces
    before = 0.5 * np.hypot(0.14, 0.11) * wind.direction  # half the plate's diagonal
    assert sum(ends) == pytest.approx(run.position[:, 6] - before, abs=1e-6)  # single precision
    speeds = np.array([wind.speed.value(time) for time in run.time])
    wanted = scene.mechanism.size * speeds / speeds.max()
    assert np.linalg.norm(ends[1], axis=1) == pytest.approx(wanted, rel=1e-6)


def test_tilt_is_in_degrees():
    turns = [0.0, 1e-9, 0.5, np.pi]
    found = tilt(np.array([from_rotation_vector(angle * (0.6 * X - 0.8 * Y)) for angle in turns]))
    np.testing.assert_allclose(found, np.degrees(turns), rtol=1e-12, atol=1e-15)


def test_engines_keep_their_colors_beside_others():
    found = palette(["one", "mujoco", "two"])
    assert found == {"one": OTHER_COLORS[0], "mujoco": LOOKS["mujoco"].color, "two": OTHER_COLORS[1]}
    beside_drake = palette(["drake", "one", "two", "three"])
    assert len(set(beside_drake.values())) == 4
    many = [*palette([str(k) for k in range(len(OTHER_COLORS) + 1)]).values()]
    assert many[-1] == many[0]
    assert rgb("#0072b2") == (0, 114, 178)
