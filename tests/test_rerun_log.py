"""A recording read back: what is in it, and that it holds what the trajectories hold."""

from __future__ import annotations

import struct
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from rerun.chunk import RrdReader

from crosscheck.errors import CrosscheckError
from crosscheck.recording.log import LONGEST_ARROW, SHELL, write_recording
from crosscheck.recording.plots import (
    SMALLEST,
    hinge_angle,
    panel,
    plots,
    rotated,
    rotation_vector,
    slide_position,
)
from crosscheck.recording.screenshot import screenshot
from newton_euler.control import PD
from newton_euler.euler_parameters import (
    angle_between,
    from_rotation_vector,
    product,
    rotation,
)
from newton_euler.joints import Prismatic, Revolute, Spherical, Universal
from newton_euler.mechanism import Body, Mechanism
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.shapes import Box, Capsule
from newton_euler.state import State
from newton_euler.trajectory import Trajectory

N = 5
PERIOD = 0.3  # 3 periods are a little less than 0.9 s in floating point
TILT = from_rotation_vector(np.array([0.3, -0.2, 0.5]))
AXIS = np.array([0.6, 0.0, 0.8])
LID_BOX = Box([0.1, 0.2, 0.01], [0.5, 0.1, 0.3], TILT)
LID_BAR = Capsule([0.4, 0.1, 0.3], [0.6, 0.3, 0.2], 0.02)
VERDICT = "# Verdict\n\n| a | b |\n|---|---|\n| 1 | 2 |\n"


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A slider on an inclined rail, and on it a hinged lid with a body frame that is turned."""
    inertia = np.diag([0.1, 0.1, 0.1])
    bodies = (
        Body.ground(shapes=(Box([0.5, 0.5, 0.01], [0.0, 0.0, -0.01]),)),
        Body("slider", 1.0, [0.3, 0.1, 0.3], inertia),
        Body("lid", 1.0, [0.5, 0.1, 0.35], inertia, TILT, shapes=(LID_BOX, LID_BAR)),
    )
    joints = (
        Prismatic("rail", "ground", "slider", [0.3, 0.1, 0.3], axis=AXIS, actuated=True),
        Revolute("hinge", "slider", "lid", [0.4, 0.1, 0.3], axis=[0.0, 1.0, 0.0]),
    )
    control = (PD("rail", 10.0, 1.0, 0.1),)
    return Scene("lid_scene", Mechanism(bodies, joints), (N - 1) * PERIOD, PERIOD, control=control)


def motion(scene: Scene, seed: int) -> Trajectory:
    """Numbers of the right shapes; quaternions are of unit length, nothing else is physical."""
    random = np.random.default_rng(seed)
    mechanism = scene.mechanism
    b, j = len(mechanism.bodies), len(mechanism.joints)
    state = State.initial(mechanism)
    quaternion = state.quaternion + 0.2 * random.standard_normal((N, b, 4))
    position = state.position + 0.1 * random.standard_normal((N, b, 3))
    quaternion[:, 0], position[:, 0] = state.quaternion[0], state.position[0]
    return Trajectory(
        engine="made up",
        settings={},
        wall_time=0.0,
        time=scene.times,
        body_names=mechanism.body_names,
        joint_names=mechanism.joint_names,
        position=position,
        quaternion=quaternion / np.linalg.norm(quaternion, axis=2, keepdims=True),
        reaction_force=random.standard_normal((N, j, 3)),
        reaction_torque=random.standard_normal((N, j, 3)),
        actuator_force=random.standard_normal((N, 1)),
        constraint_violation=random.random((N, j)) * 1e-9,
        kinetic_energy=random.random(N),
        potential_energy=random.random(N),
    )


@pytest.fixture(scope="module")
def runs(scene: Scene) -> dict[str, Trajectory]:
    return {"zeta": motion(scene, 1), "alpha": motion(scene, 2)}


class Recording(NamedTuple):
    """Values by (entity, component), as rows of instances; times in ns by entity."""

    static: dict[tuple[str, str], Any]
    columns: dict[tuple[str, str], list[Any]]
    times: dict[str, list[int]]

    @property
    def entities(self) -> set[str]:
        return {path for path, _ in self.static} | {path for path, _ in self.columns}

    def scalars(self, path: str) -> Array:
        return np.array(self.columns[path, "Scalars:scalars"])[:, 0]


def read(path: Path) -> Recording:
    static, columns, times = {}, {}, {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        values = {name: batch.column(name) for name in batch.schema.names if ":" in name}
        for component, column in values.items():
            if chunk.is_static:
                static[chunk.entity_path, component] = column.to_pylist()[0]
            else:
                columns[chunk.entity_path, component] = column.to_pylist()
                assert chunk.timeline_names == ["time"]
                times[chunk.entity_path] = batch.column("time").cast("int64").to_pylist()
    return Recording(static, columns, times)


@pytest.fixture(scope="module")
def recording(
    scene: Scene, runs: dict[str, Trajectory], tmp_path_factory: pytest.TempPathFactory
) -> Recording:
    path = tmp_path_factory.mktemp("recording") / "lid.rrd"
    write_recording(path, scene, runs, VERDICT)
    return read(path)


def of_engines(*paths: str) -> set[str]:
    return {path.replace("*", engine) for path in paths for engine in ("zeta", "alpha")}


MOVING = of_engines(
    "/mechanism/*/slider",
    "/mechanism/*/lid",
    "/joints/*/rail",
    "/joints/*/hinge",
    "/reactions/*/rail",
    "/reactions/*/hinge",
    "/plots/slider_position/rail/*",
    "/plots/control/rail/*",
    "/plots/energy/kinetic/*",
    "/plots/energy/potential/*",
    *(f"/plots/rotation_vector/{axis}/*" for axis in "xyz"),
    *(f"/plots/euler_parameters/e{k}/*" for k in range(4)),
    "/plots/drift_log10/*",
) | {
    f"/plots/{kind}/{quantity}/alpha"
    for kind in ("difference", "difference_log10")
    for quantity in ("position", "angle")
}


def test_holds_these_entities_and_no_others(recording: Recording) -> None:
    still = {"/", "/ground", "/verdict", "/__properties"} | of_engines("/mechanism/*/lid/normal")
    assert recording.entities == MOVING | still


def test_every_moving_entity_has_every_output_time(recording: Recording) -> None:
    expected = [0, 300_000_000, 600_000_000, 900_000_000, 1_200_000_000]
    assert recording.times == dict.fromkeys(MOVING, expected)


def test_scalars_are_exact(recording: Recording, runs: dict[str, Trajectory]) -> None:
    first, other = runs["zeta"], runs["alpha"]
    for engine, run in runs.items():
        drift = np.log10(run.constraint_violation.max(axis=1))
        for path, expected in {
            f"/plots/control/rail/{engine}": run.actuator_force[:, 0],
            f"/plots/slider_position/rail/{engine}": run.position[:, 1] @ AXIS,
            f"/plots/energy/kinetic/{engine}": run.kinetic_energy,
            f"/plots/energy/potential/{engine}": run.potential_energy,
            f"/plots/euler_parameters/e0/{engine}": run.quaternion[:, 2, 0],
            f"/plots/euler_parameters/e3/{engine}": run.quaternion[:, 2, 3],
            f"/plots/drift_log10/{engine}": drift,
        }.items():
            np.testing.assert_array_equal(recording.scalars(path), expected, err_msg=path)
    distance = np.linalg.norm(other.position - first.position, axis=2).max(axis=1)
    angle = angle_between(first.quaternion, other.quaternion).max(axis=1)
    for quantity, values in {"position": distance, "angle": angle}.items():
        linear = recording.scalars(f"/plots/difference/{quantity}/alpha")
        np.testing.assert_array_equal(linear, values)
        logarithm = recording.scalars(f"/plots/difference_log10/{quantity}/alpha")
        np.testing.assert_array_equal(logarithm, np.log10(values))


def test_no_difference_is_drawn_at_the_floor(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    write_recording(tmp_path / "same.rrd", scene, {"one": runs["zeta"], "two": runs["zeta"]}, VERDICT)
    values = read(tmp_path / "same.rrd").scalars("/plots/difference_log10/position/two")
    np.testing.assert_array_equal(values, np.full(N, np.log10(SMALLEST)))


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


def test_engines_are_drawn_apart(scene: Scene, recording: Recording) -> None:
    path, other = "/mechanism/zeta/lid", "/mechanism/alpha/lid"
    for component in ("Boxes3D:colors", "Boxes3D:fill_mode", "Capsules3D:fill_mode"):
        assert recording.static[path, component] != recording.static[other, component]
    shell = SHELL * scene.mechanism.size
    half_sizes = recording.static[other, "Boxes3D:half_sizes"][0]
    np.testing.assert_allclose(half_sizes, LID_BOX.half_sizes + shell, rtol=1e-6)
    (radius,) = recording.static[other, "Capsules3D:radii"]
    assert radius == pytest.approx(LID_BAR.radius + shell)
    short, long = (np.linalg.norm(recording.static[f"{p}/normal", "Arrows3D:vectors"]) for p in (path, other))
    assert long > 1.2 * short


def test_an_engine_has_one_colour_and_its_name_in_every_plot(recording: Recording) -> None:
    for engine in ("zeta", "alpha"):
        color = recording.static[f"/mechanism/{engine}/lid", "Boxes3D:colors"]
        lines = [p for p in MOVING if p.startswith("/plots/") and p.endswith(f"/{engine}")]
        assert len(lines) >= 12
        for path in lines:
            assert recording.static[path, "SeriesLines:colors"] == color
            assert recording.static[path, "SeriesLines:names"] == [engine]


def test_normal_is_the_thin_axis_of_the_panel(recording: Recording) -> None:
    # the box is turned like the body, so that its thin axis is the body's z
    path = "/mechanism/zeta/lid/normal"
    vector = np.array(recording.static[path, "Arrows3D:vectors"][0])
    np.testing.assert_allclose(vector / np.linalg.norm(vector), [0.0, 0.0, 1.0], atol=1e-6)


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


def test_verdict_is_markdown(recording: Recording) -> None:
    assert recording.static["/verdict", "TextDocument:text"] == [VERDICT]
    assert recording.static["/verdict", "TextDocument:media_type"] == ["text/markdown"]


def test_name_and_unique_identity(
    scene: Scene, runs: dict[str, Trajectory], recording: Recording, tmp_path: Path
) -> None:
    assert recording.static["/__properties", "RecordingInfo:name"] == ["lid_scene"]
    for name in ("a.rrd", "b.rrd"):
        write_recording(tmp_path / name, scene, runs, VERDICT)
    (a,), (b,) = (RrdReader(tmp_path / name).recordings() for name in ("a.rrd", "b.rrd"))
    assert a.application_id == b.application_id == "crosscheck"
    assert a.recording_id != b.recording_id


def test_blueprint_is_in_the_file_and_shows_every_plot(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    path = tmp_path / "lid.rrd"
    write_recording(path, scene, runs, VERDICT)
    reader = RrdReader(path)
    (entry,) = reader.blueprints()
    assert entry.application_id == "crosscheck"
    values: dict[str, list[str]] = {
        "ViewBlueprint:space_origin": [],
        "TimePanelBlueprint:timeline": [],
    }
    for chunk in reader.stream(store=entry):
        batch = chunk.to_record_batch()
        for component in values.keys() & set(batch.schema.names):
            values[component] += batch.column(component).to_pylist()[0]
    origins, timelines = values.values()
    expected = {"/plots/" + "/".join(plot.path) for plot in plots(scene, runs)}
    assert len(expected) == 16
    assert sorted(origins) == sorted(expected | {"/", "/verdict"})
    assert timelines == ["time"]


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
    write_recording(tmp_path / "bare.rrd", scene, {"zeta": bare, "alpha": bare}, VERDICT)
    kinds = ("/reactions/", "/plots/control/", "/plots/drift_log10/", "/plots/energy/")
    skipped = {path for path in MOVING if path.startswith(kinds)}
    assert len(skipped) == 12
    assert set(read(tmp_path / "bare.rrd").times) == MOVING - skipped
    assert len(plots(scene, {"zeta": bare})) == 8  # without the lines there is no empty plot either


def test_one_engine_alone_has_no_differences(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    write_recording(tmp_path / "one.rrd", scene, {"zeta": runs["zeta"]}, VERDICT)
    moving = set(read(tmp_path / "one.rrd").times)
    assert moving == {path for path in MOVING if "zeta" in path}


def test_a_failing_write_leaves_what_was_there(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path
) -> None:
    # energies are logged after the 3D entities, so this fails in the middle of the file
    short = replace(runs["zeta"], kinetic_energy=np.zeros(N - 1))
    with pytest.raises(ValueError, match="length"):
        write_recording(tmp_path / "new.rrd", scene, {"zeta": short}, VERDICT)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "old.rrd").write_bytes(b"old")
    with pytest.raises(ValueError, match="length"):
        write_recording(tmp_path / "old.rrd", scene, {"zeta": short}, VERDICT)
    assert [path.name for path in tmp_path.iterdir()] == ["old.rrd"]
    assert (tmp_path / "old.rrd").read_bytes() == b"old"


def turning(mechanism: Mechanism, quaternions: dict[int, Array]) -> Trajectory:
    """A motion in which some bodies turn, (n, 4) each, and the others stay."""
    n = len(next(iter(quaternions.values())))
    state = State.initial(mechanism)
    quaternion = np.tile(state.quaternion, (n, 1, 1))
    for body, values in quaternions.items():
        quaternion[:, body] = values
    position = np.tile(state.position, (n, 1, 1))
    names = (mechanism.body_names, mechanism.joint_names)
    return Trajectory("made up", {}, 0.0, np.arange(n) * 0.1, *names, position, quaternion)


def test_hinge_angle_counts_whole_turns_and_ignores_signs(scene: Scene) -> None:
    mechanism = scene.mechanism
    hinge = mechanism.joints[1]
    angles = np.linspace(0.0, 15.0, 40)
    spin = np.array([from_rotation_vector(a * np.array([0.0, 1.0, 0.0])) for a in angles])
    spin *= np.where(np.arange(40) % 3 == 0, -1.0, 1.0)[:, None]
    carried = from_rotation_vector(np.array([0.4, 0.5, -0.6]))
    lid = np.array([product(carried, product(p, TILT)) for p in spin])
    run = turning(mechanism, {1: np.tile(carried, (40, 1)), 2: lid})
    found = hinge_angle(mechanism, hinge, hinge.motions[0], run)
    np.testing.assert_allclose(found, angles, atol=1e-12)


def test_both_angles_of_a_universal_joint() -> None:
    x, y = np.eye(3)[:2]
    cardan = Universal("cardan", "ground", "disc", np.zeros(3), axis_on_first=x, axis_on_second=y)
    disc = Body("disc", 1.0, [0.0, 0.0, 0.1], np.eye(3))
    mechanism = Mechanism((Body.ground(), disc), (cardan,))
    a, b = np.linspace(0.0, 2.0, 9), np.linspace(0.0, -1.2, 9)
    turns = [
        product(from_rotation_vector(s * x), from_rotation_vector(t * y)) for s, t in zip(a, b, strict=True)
    ]
    run = turning(mechanism, {1: np.array(turns)})
    for motion_, expected in zip(cardan.motions, (a, b), strict=True):
        found = hinge_angle(mechanism, cardan, motion_, run)
        np.testing.assert_allclose(found, expected, atol=1e-12)
    titles = [p.path for p in plots(Scene("s", mechanism, 0.8, 0.1), {"e": run})][:2]
    assert titles == [("joint_angle", "cardan:0"), ("joint_angle", "cardan:1")]


def test_slide_position_is_seen_from_a_first_body_that_turns() -> None:
    x, z = np.eye(3)[[0, 2]]
    arm = Body("arm", 1.0, [0.0, 0.0, 0.2], np.eye(3), TILT)
    rod = Body("rod", 1.0, [0.3, 0.0, 0.2], np.eye(3))
    joints = (
        Spherical("ball", "ground", "arm", np.zeros(3)),
        Prismatic("slide", "arm", "rod", [0.1, 0.0, 0.2], axis=x),
    )
    mechanism = Mechanism((Body.ground(), arm, rod), joints)
    turn = from_rotation_vector(0.7 * z)
    run = turning(mechanism, {1: product(turn, TILT)[None]})
    run.position[0, 2] = run.position[0, 1] + rotation(turn) @ [0.5, 0.0, 0.0]
    found = slide_position(mechanism, joints[1], joints[1].motions[0], run)
    np.testing.assert_allclose(found, [0.5], atol=1e-15)


def test_rotated_agrees_with_the_rotation_matrix(runs: dict[str, Trajectory]) -> None:
    vector = np.array([0.3, -0.4, 0.5])
    quaternions = runs["zeta"].quaternion[:, 2]
    expected = [rotation(p) @ vector for p in quaternions]
    np.testing.assert_allclose(rotated(quaternions, vector), expected, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-5, 1.0, np.pi, 4.0, 6.28])
def test_rotation_vector_at_any_angle(angle: float) -> None:
    vector = angle * AXIS
    np.testing.assert_allclose(
        rotation_vector(from_rotation_vector(vector)[None])[0], vector, rtol=1e-12, atol=0.0
    )


def test_panel_is_the_largest_thin_box_of_a_moving_body(scene: Scene) -> None:
    found = panel(scene.mechanism)
    assert found is not None
    assert found[0] == 2
    assert found[1] is LID_BOX
    ground, slider, lid = scene.mechanism.bodies
    both = replace(lid, shapes=(Box([0.1, 0.1, 0.01], [0.5, 0.1, 0.3]), LID_BOX))
    found = panel(Mechanism((ground, slider, both), scene.mechanism.joints))
    assert found is not None
    assert found[1] is LID_BOX
    cube = replace(lid, shapes=(Box([0.1, 0.1, 0.05], [0.5, 0.1, 0.3]),))
    assert panel(Mechanism((ground, slider, cube), scene.mechanism.joints)) is None


def test_screenshot_of_no_recording(tmp_path: Path) -> None:
    with pytest.raises(CrosscheckError, match=r"absent\.rrd"):
        screenshot(tmp_path / "absent.rrd", tmp_path / "out.png", 0.0)
    assert list(tmp_path.iterdir()) == []


def test_screenshot_without_a_working_viewer(
    scene: Scene, runs: dict[str, Trajectory], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "lid.rrd", scene, runs, VERDICT)
    viewer = tmp_path / "viewer"
    viewer.write_text("#!/bin/sh\necho panicked for want of an adapter\nexit 101\n")
    viewer.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(viewer))
    with pytest.raises(CrosscheckError, match=r"mesa-vulkan-drivers and libvulkan1 \(panicked for"):
        screenshot(tmp_path / "lid.rrd", tmp_path / "out.png", 0.0)
    assert not (tmp_path / "out.png").exists()


@pytest.mark.skipif(not list(Path("/usr/share/vulkan/icd.d").glob("*.json")), reason="needs a Vulkan driver")
def test_screenshot(scene: Scene, runs: dict[str, Trajectory], tmp_path: Path) -> None:
    write_recording(tmp_path / "lid.rrd", scene, runs, VERDICT)
    screenshot(tmp_path / "lid.rrd", tmp_path / "out.png", 0.6)
    png = (tmp_path / "out.png").read_bytes()
    assert png.startswith(b"\x89PNG")
    assert struct.unpack(">II", png[16:24]) == (1600, 900)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lid.rrd", "out.png"]
