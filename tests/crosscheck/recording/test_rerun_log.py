"""A recording read back: what is in it, and that it holds what the trajectories hold."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recordings import (
    AXIS,
    LID_BAR,
    LID_BOX,
    VERDICT,
    N,
    Recording,
    motion,
    read_recording,
    write_recording,
)
from rerun.chunk import RrdReader

from crosscheck.compare.check import CONSTRAINT_VIOLATION
from crosscheck.recording.blueprint import TIME
from crosscheck.recording.entities import LONGEST_ARROW, MIN_VISIBLE_DISTANCE
from crosscheck.recording.log import log_run
from crosscheck.recording.plots import MIN_LOG_DIFFERENCE, plots
from crosscheck.recording.stream import application_id, recorded
from newton_euler.model.euler_parameters import angle_between, rotation
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array


@pytest.fixture(scope="module")
def recording(
    scene: Scene, runs: dict[str, Trajectory], tmp_path_factory: pytest.TempPathFactory
) -> Recording:
    path = tmp_path_factory.mktemp("recording") / "lid.rrd"
    write_recording(path, scene, runs, tolerances=TOLERANCES)
    return read_recording(path)


def of_engines(*paths: str) -> set[str]:
    return {path.replace("*", engine) for path in paths for engine in ("zeta", "alpha")}


MOVING = of_engines(
    "/mechanism/*/slider",
    "/mechanism/*/lid",
    "/joints/*/rail",
    "/joints/*/hinge",
    "/reactions/*/rail",
    "/reactions/*/hinge",
    "/plots/coordinate/rail/*",
    "/plots/control/rail/*",
    "/plots/energy/kinetic/*",
    "/plots/energy/potential/*",
    "/plots/agreement/drift/*",
) | {
    "/plots/agreement/position/alpha",
    "/plots/agreement/angle/alpha",
    "/labels/slider",
    "/labels/lid",
}

PLACED = {"/ground", "/labels/ground"}
"""Where they are at the start."""

TOLERANCES = {
    ("positions, m", "zeta", "alpha"): 1e-3,
    (CONSTRAINT_VIOLATION, "zeta"): 1e-8,
    (CONSTRAINT_VIOLATION, "alpha"): 1e-7,
}

LEVELS = {
    "/plots/coordinate/rail/target": 0.1,
    "/plots/agreement/position/alpha_tolerance": -3.0,
    "/plots/agreement/drift/zeta_tolerance": -8.0,
    "/plots/agreement/drift/alpha_tolerance": -7.0,
}
"""Constant lines."""


def test_holds_these_entities_and_no_others(recording: Recording) -> None:
    assert recording.entities == MOVING | LEVELS.keys() | PLACED | {"/", "/verdict", "/__properties"}


def test_every_moving_entity_has_every_output_time(recording: Recording) -> None:
    expected = [0, 300_000_000, 600_000_000, 900_000_000, 1_200_000_000]
    still = {path: [0] for path in PLACED} | dict.fromkeys(LEVELS, expected[::4])
    assert recording.times == dict.fromkeys(MOVING, expected) | still


def test_targets_and_tolerances_are_lines(recording: Recording) -> None:
    for path, value in LEVELS.items():
        np.testing.assert_allclose(recording.scalars(path), [value, value], rtol=1e-15, err_msg=path)


def test_scalars_are_exact(recording: Recording, runs: dict[str, Trajectory]) -> None:
    first, other = runs["zeta"], runs["alpha"]
    for engine, run in runs.items():
        drift = np.log10(run.constraint_violation.max(axis=1))
        for path, expected in {
            f"/plots/control/rail/{engine}": run.actuator_force[:, 0],
            f"/plots/energy/kinetic/{engine}": run.kinetic_energy,
            f"/plots/energy/potential/{engine}": run.potential_energy,
            f"/plots/agreement/drift/{engine}": drift,
        }.items():
            np.testing.assert_array_equal(recording.scalars(path), expected, err_msg=path)
    distance = np.linalg.norm(other.position - first.position, axis=2).max(axis=1)
    angle = angle_between(first.quaternion, other.quaternion).max(axis=1)
    for quantity, values in {"position": distance, "angle": angle}.items():
        logarithm = recording.scalars(f"/plots/agreement/{quantity}/alpha")
        np.testing.assert_array_equal(logarithm, np.log10(values))


def test_no_difference_is_drawn_at_the_floor(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    write_recording(tmp_path / "same.rrd", scene, {"one": runs["zeta"], "two": runs["zeta"]})
    values = read_recording(tmp_path / "same.rrd").scalars("/plots/agreement/position/two")
    np.testing.assert_array_equal(values, np.full(N, np.log10(MIN_LOG_DIFFERENCE)))


def test_poses_are_x_y_z_w(recording: Recording, runs: dict[str, Trajectory]) -> None:
    for engine, run in runs.items():
        path = f"/mechanism/{engine}/lid"
        e0, e1, e2, e3 = run.quaternion[:, 2].T
        quaternion = np.array(recording.columns[path, "Transform3D:quaternion"])[:, 0]
        np.testing.assert_array_equal(quaternion, np.column_stack([e1, e2, e3, e0]).astype("float32"))
        translation = np.array(recording.columns[path, "Transform3D:translation"])[:, 0]
        np.testing.assert_array_equal(translation, run.position[:, 2].astype("float32"))


def rotation_of(xyzw: Array) -> Array:
    x, y, z, w = xyzw
    return rotation(np.array([w, x, y, z]))


def test_shapes_in_the_body_frame_stand_where_the_mechanism_has_them(
    scene: Scene, recording: Recording
) -> None:
    lid = scene.mechanism.bodies[2]
    to_world = rotation(lid.quaternion)
    drawn = {
        component: np.array(value)
        for (path, component), value in recording.static.items()
        if path == "/mechanism/zeta/lid" and "fill_mode" not in component
    }
    center = to_world @ drawn["Boxes3D:centers"][0] + lid.center_of_mass
    np.testing.assert_allclose(center, LID_BOX.center, atol=1e-7)
    turned = to_world @ rotation_of(drawn["Boxes3D:quaternions"][0])
    np.testing.assert_allclose(turned, rotation(LID_BOX.quaternion), atol=1e-6)
    np.testing.assert_allclose(drawn["Boxes3D:half_sizes"][0], LID_BOX.half_sizes, rtol=1e-6)
    start = to_world @ drawn["Capsules3D:translations"][0] + lid.center_of_mass
    np.testing.assert_allclose(start, LID_BAR.start, atol=1e-7)
    along_z = [0.0, 0.0, drawn["Capsules3D:lengths"][0]]
    end = start + to_world @ rotation_of(drawn["Capsules3D:quaternions"][0]) @ along_z
    np.testing.assert_allclose(end, LID_BAR.end, atol=1e-6)
    assert drawn["Capsules3D:radii"][0] == pytest.approx(LID_BAR.radius)


def test_the_first_engine_is_solid_and_others_are_ghosts_of_the_same_size(recording: Recording) -> None:
    path, other = "/mechanism/zeta/lid", "/mechanism/alpha/lid"
    for component in ("Boxes3D:colors", "Boxes3D:fill_mode", "Capsules3D:fill_mode"):
        assert recording.static[path, component] != recording.static[other, component]
    for component in ("Boxes3D:half_sizes", "Capsules3D:radii", "Capsules3D:lengths"):
        assert recording.static[path, component] == recording.static[other, component]


@pytest.mark.parametrize(("share", "seen"), [(0.5, False), (2.0, True)])
def test_a_ghost_is_shown_if_it_parts_from_the_first(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path, share: float, seen: bool
) -> None:
    """By a share of a pixel, of the body that moves least alone and at one output only."""
    position = runs["zeta"].position.copy()
    position[3, 1] += share * MIN_VISIBLE_DISTANCE * scene.mechanism.size * AXIS
    parted = {"zeta": runs["zeta"], "alpha": replace(runs["zeta"], position=position)}
    write_recording(tmp_path / "parted.rrd", scene, parted)
    found = layout(tmp_path / "parted.rrd")
    assert ("mechanism/alpha" in found["hidden"]) is not seen
    assert (
        {"joints/alpha", "reactions"}
        <= set(found["hidden"])
        <= {"mechanism/alpha", "joints/alpha", "reactions"}
    )
    distance = share * MIN_VISIBLE_DISTANCE * scene.mechanism.size
    how = f"alpha ghost, up to {distance:.2g} m" if seen else f"alpha hidden, within {distance:.0e} m"
    assert any(
        name.startswith(f"lid_scene: zeta solid; {how}") for name in found["ViewBlueprint:display_name"]
    )


def test_bodies_are_labeled_where_the_first_engine_has_them(
    runs: dict[str, Trajectory], recording: Recording
) -> None:
    assert recording.static["/labels/ground", "Points3D:labels"] == ["ground"]
    for k, name in enumerate(("slider", "lid"), start=1):
        assert recording.static[f"/labels/{name}", "Points3D:labels"] == [name]
        translation = np.array(recording.columns[f"/labels/{name}", "Transform3D:translation"])[:, 0]
        np.testing.assert_array_equal(translation, runs["zeta"].position[:, k].astype("float32"))


def test_an_engine_has_one_color_and_its_name_in_every_plot(recording: Recording) -> None:
    for engine in ("zeta", "alpha"):
        color = recording.static[f"/mechanism/{engine}/lid", "Boxes3D:colors"]
        lines = [p for p in MOVING if p.startswith("/plots/") and p.endswith(f"/{engine}")]
        assert len(lines) >= 5
        for path in lines:
            assert recording.static[path, "SeriesLines:colors"] == color
            assert recording.static[path, "SeriesLines:names"] == [engine]


def test_joint_points_and_reactions_follow_the_second_body(
    scene: Scene, runs: dict[str, Trajectory], recording: Recording
) -> None:
    lid = scene.mechanism.bodies[2]
    arm = rotation(lid.quaternion).T @ ([0.4, 0.1, 0.3] - lid.center_of_mass)
    force = max(np.linalg.norm(run.reaction_force, axis=2).max() for run in runs.values())
    scale = LONGEST_ARROW * scene.mechanism.size / force
    for engine, run in runs.items():
        expected = [
            r + rotation(p) @ arm for r, p in zip(run.position[:, 2], run.quaternion[:, 2], strict=True)
        ]
        points = np.array(recording.columns[f"/joints/{engine}/hinge", "Points3D:positions"])[:, 0]
        np.testing.assert_allclose(points, expected, atol=1e-6)
        path = f"/reactions/{engine}/hinge"
        origins = np.array(recording.columns[path, "Arrows3D:origins"])[:, 0]
        np.testing.assert_array_equal(origins, points)
        vectors = np.array(recording.columns[path, "Arrows3D:vectors"])[:, 0]
        np.testing.assert_allclose(vectors, scale * run.reaction_force[:, 1], rtol=1e-5)


def test_worst_moments_are_lines_at_their_times(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    path = tmp_path / "moments.rrd"
    moments = [(0.3, "drift: hinge"), (1.2, "energy")]
    path.write_bytes(recorded(log_run, scene, runs, "", "lid_scene", None, moments))
    found = read_recording(path)
    assert found.times["/worst"] == [300_000_000, 1_200_000_000]
    assert found.columns["/worst", "TextLog:text"] == [["drift: hinge"], ["energy"]]
    assert "/worst" in layout(path)["ViewBlueprint:space_origin"]


def test_recordings_leave_no_thread_behind(scene: Scene, runs: dict[str, Trajectory]) -> None:
    """Rerun starts two threads for a recording and two for its layout."""

    def threads() -> int:
        return len(list(Path("/proc/self/task").iterdir()))

    recorded(log_run, scene, runs, "", "first")  # starts the threads that all recordings share
    before = threads()
    for number in range(5):
        recorded(log_run, scene, runs, "", f"{number}")
    assert threads() <= before + 2  # of the last recording, which may still be ending


def test_verdict_is_markdown(recording: Recording) -> None:
    (text,) = recording.static["/verdict", "TextDocument:text"]
    assert text.startswith(VERDICT)
    assert "\nOf reactions 1 N is " in text.removeprefix(VERDICT)
    assert recording.static["/verdict", "TextDocument:media_type"] == ["text/markdown"]


def test_runs_open_side_by_side(scene: Scene, runs: dict[str, Trajectory], tmp_path: Path) -> None:
    """Two runs of one scene: one application, whose layout fits both, and two recordings."""
    one, two = tmp_path / "one.rrd", tmp_path / "two.rrd"
    write_recording(one, scene, runs)
    write_recording(two, scene, {engine: motion(scene, 7) for engine in runs}, "a second run")
    together = tmp_path / "together.rrd"
    merge = [sys.executable, "-m", "rerun", "rrd", "merge", one, two, "-o", together]
    subprocess.run(merge, check=True, capture_output=True)
    a, b = RrdReader(together).recordings()
    assert a.application_id == b.application_id == "crosscheck_lid_scene"
    assert a.recording_id != b.recording_id
    assert {x.application_id for x in RrdReader(together).blueprints()} == {a.application_id}
    first, second = read_recording(one), read_recording(two)
    assert first.entities == second.entities
    assert first.static["/__properties", "RecordingInfo:name"] == ["lid_scene"]
    assert second.static["/__properties", "RecordingInfo:name"] == ["a second run"]
    for component in ("ViewBlueprint:space_origin", "TimePanelBlueprint:timeline"):
        assert layout(one)[component] == layout(two)[component]


def test_other_scenes_have_a_layout_of_their_own(scene: Scene) -> None:
    assert application_id(replace(scene, name="other")) != application_id(scene)


def layout(path: Path) -> dict[str, list[str]]:
    """What the views of a file's blueprint show and hide, and the timeline that it plays."""
    reader = RrdReader(path)
    (entry,) = reader.blueprints()
    components = ("ViewBlueprint:space_origin", "ViewBlueprint:display_name", "TimePanelBlueprint:timeline")
    values: dict[str, list[str]] = {component: [] for component in components} | {"hidden": []}
    for chunk in reader.stream(store=entry):
        batch = chunk.to_record_batch()
        for component in values.keys() & set(batch.schema.names):
            values[component] += batch.column(component).to_pylist()[0]
        if "EntityBehavior:visible" in batch.schema.names:
            values["hidden"].append(
                chunk.entity_path.partition("/overrides/")[2].removesuffix("/visualizers")
            )
    return {component: sorted(entries) for component, entries in values.items()}


def test_blueprint_is_in_the_file_and_shows_every_plot(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    path = tmp_path / "lid.rrd"
    write_recording(path, scene, runs)
    found = layout(path)
    expected = {"/plots/" + "/".join(plot.path) for plot in plots(scene, runs, {})}
    assert len(expected) == 7
    assert found["ViewBlueprint:space_origin"] == sorted(expected | {"/", "/verdict"})
    assert found["TimePanelBlueprint:timeline"] == [TIME]


def test_outputs_that_were_not_asked_for_are_left_out(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    bare = replace(
        runs["zeta"],
        reaction_force=None,
        reaction_torque=None,
        actuator_force=None,
        constraint_violation=None,
        kinetic_energy=None,
        potential_energy=None,
    )
    write_recording(tmp_path / "bare.rrd", scene, {"zeta": bare, "alpha": bare})
    kinds = ("/reactions/", "/plots/control/", "/plots/agreement/drift/", "/plots/energy/")
    skipped = {path for path in MOVING if path.startswith(kinds)}
    assert len(skipped) == 12
    target = "/plots/coordinate/rail/target"
    assert set(read_recording(tmp_path / "bare.rrd").times) == (MOVING - skipped) | PLACED | {target}
    assert len(plots(scene, {"zeta": bare}, {})) == 1  # without the lines there is no empty plot either


def test_one_engine_alone_has_no_differences(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    write_recording(tmp_path / "one.rrd", scene, {"zeta": runs["zeta"]})
    moving = set(read_recording(tmp_path / "one.rrd").times)
    labels = PLACED | {path for path in MOVING if path.startswith("/labels/")}
    assert moving == {path for path in MOVING if "zeta" in path} | labels | {"/plots/coordinate/rail/target"}
