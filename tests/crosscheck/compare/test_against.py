"""Two models against each other: one mechanism in two forms is the same, and what differs is named."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run, verdict_of
from mechanisms import GRAVITY, bar, pendulum
from test_two_ways import DURATION, PERIOD, whole, written_mjcf, written_urdf

import mjcf
import urdf
from crosscheck.cli.run import _distinct_name
from crosscheck.compare.check import LEVELS_OF_EQUATIONS, LEVELS_OF_RUNS, START
from crosscheck.compare.two_models import compare
from crosscheck.compare.two_models.align import alignments
from crosscheck.compare.two_models.compare import TwoModelComparison, compare_models
from crosscheck.compare.two_models.levels import functions_apart
from crosscheck.compare.two_models.unsimulated import Model
from crosscheck.library.scene_file import write_scene
from crosscheck.studies.faults import injection
from crosscheck.studies.faults.injection import Injection
from newton_euler import Body, Mechanism, Scene
from newton_euler.equations.couplings import Coupling
from newton_euler.equations.undetermined import undetermined, undetermined_in_both
from newton_euler.errors import AssemblyError
from newton_euler.model.control import ComputedTorque
from newton_euler.model.couplings import Gear
from newton_euler.model.forces import Armature, PointSpring, Wrench
from newton_euler.model.joint_kinds import Fixed, Revolute, Spherical
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.trajectory import IntegrationError, Trajectory
from newton_euler.runs.assemble import initial_state

LINKAGE = Path(__file__).parents[3] / "examples" / "linkage.xml"

FAULT = 1e-4
"""Relative, or m or rad."""

ROUND_OFF = 1e-11
"""Relative: what levels 1 to 4 may differ by in one mechanism of condition 30; measured are 6e-15."""


def compared(first: Scene, second: Scene) -> TwoModelComparison:
    models = (Model(name, name, {}, scene, None) for name, scene in (("a", first), ("b", second)))
    return compare_models(*models, lambda _: None)


def read_mjcf(folder: Path, text: str) -> Scene:
    (folder / "model.xml").write_text(text)
    return mjcf.read(folder / "model.xml", duration=DURATION, output_period=PERIOD).scene


def read_urdf(folder: Path, cut: str) -> Scene:
    text, loops = written_urdf(cut)
    (folder / "model.urdf").write_text(text)
    (folder / "model.yaml").write_text(loops)
    return urdf.read(
        folder / "model.urdf", folder / "model.yaml", duration=DURATION, output_period=PERIOD
    ).scene


@pytest.fixture(scope="module")
def cut_at_b(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return read_urdf(tmp_path_factory.mktemp("b"), "b")


@pytest.fixture(scope="module")
def linkage(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    return read_mjcf(tmp_path_factory.mktemp("linkage"), LINKAGE.read_text())


def first_failing(result: TwoModelComparison) -> tuple[str, str, str]:
    """Level, quantity and place of what the verdict names."""
    row = next(row for row in result.checks if not row.agrees)
    assert f"differ at level '{row.level}': {row.quantity}: " in result.verdict
    assert f"worst at {row.place} (" in result.verdict
    assert {r.level for r in result.checks if not r.agrees} == {row.level}  # none after it
    return row.level, row.quantity.removesuffix(", rel"), row.where


@pytest.mark.parametrize(
    ("one", "other"),
    [("a", "c"), ("b", "coupler"), ("coupler", "crank"), ("rocker", "a")],
)
def test_one_mechanism_cut_in_two_ways_is_the_same(tmp_path: Path, one: str, other: str) -> None:
    result = compared(read_mjcf(tmp_path, written_mjcf(one, sites=False)), read_urdf(tmp_path, other))
    assert result.verdict.startswith("SAME: a and b agree in all ")
    assert {row.level for row in result.checks} == {*LEVELS_OF_EQUATIONS, *LEVELS_OF_RUNS, START} - {"drift"}
    reactions = [row for row in result.checks if row.quantity.startswith("reaction")]
    assert len(reactions) == 2
    judged = [row for row in result.checks if row.judged]
    assert all(row.value < ROUND_OFF for row in judged if row.level in LEVELS_OF_EQUATIONS)


def test_notes_tell_what_is_not_the_same_by_name(tmp_path: Path) -> None:
    result = compared(whole()[0], read_mjcf(tmp_path, written_mjcf("coupler", sites=True)))
    assert result.notes == ("body coupler is coupler_1 and coupler_2 there", "counted the other way there: c")
    result = compared(whole()[0], read_mjcf(tmp_path, written_mjcf("c", False).replace('"c" b', '"loop" b')))
    assert result.agrees
    assert "joint c is loop there, the only one left between coupler and rocker" in result.notes
    assert "joint c is revolute here and spherical there" in result.notes


def edited(text: str, element: str, attribute: str, entry: int) -> str:
    """One number after a name larger by `FAULT`, of the largest of its attribute."""
    start = text.index(element)
    found = re.compile(rf'(?<= {attribute}=")[^"]*').search(text, start)
    assert found is not None
    values = np.array([float(x) for x in found[0].split()])
    values[entry] += FAULT * (np.abs(values).max() or 1.0)
    return text[: found.start()] + " ".join(f"{x:.17g}" for x in values) + text[found.end() :]


@pytest.mark.parametrize(
    ("element", "attribute", "entry", "quantity", "where"),
    [
        ('body name="coupler"', "mass", 0, "mass", "coupler"),
        ('joint name="a"', "pos", 1, "center of mass, m", "crank"),
        ('joint name="d"', "fullinertia", 3, "inertia", "rocker"),
        ('joint name="d"', "axis", 0, "joint constraint violation, rad", "d"),
        ('joint name="a"', "axis", 2, "joint constraint violation, rad", "a"),
        ('body name="crank"', "pos", 0, "joint constraint violation, m", "a"),
        ('site name="s1"', "pos", 0, "joint constraint violation, m", "c"),
        ('body name="rocker"', "pos", 2, "joint constraint violation, m", "d"),
    ],
)
def test_one_number_of_the_file_is_found(
    cut_at_b: Scene, tmp_path: Path, element: str, attribute: str, entry: int, quantity: str, where: str
) -> None:
    """In an MJCF against a URDF cut elsewhere; as sites close the loop, all bodies start elsewhere by it."""
    wrong = edited(written_mjcf("c", sites=True), element, attribute, entry)
    result = compared(cut_at_b, read_mjcf(tmp_path, wrong))
    assert first_failing(result) == ("model", quantity, where)
    values = re.search(r": a ([-\d. e]+), b ([-\d. e]+) (m|kg|in) ", result.verdict)
    assert values is not None
    assert values[1] != values[2]


def rotor(scene: Scene) -> Scene:
    return replace(scene, armatures=[Armature("motor", 2e-4)])


@pytest.mark.parametrize(
    ("fault", "quantity", "where", "detail"),
    [
        (
            injection.entry_values("control", 0, damping=0.0501),
            "actuator force",
            "motor",
            "damping a 0.05, b 0.0501",
        ),
        (
            injection.entry_values("control", 0, target=1.0001),
            "actuator force",
            "motor",
            "target a 1, b 1.0001",
        ),
        (
            injection.entry_values("forces", 1, damping=0.00201),
            "spring force",
            "elbow",
            "damping a 0.002, b 0.00201",
        ),
        (
            injection.gravity(np.array([0.0, 0.0, -9.82])),
            "gravity",
            "gravity",
            "a 0 0 -9.81, b 0 0 -9.82 m/s^2",
        ),
        (rotor, "rotor momentum", "motor", "inertia a 0.0001, b 0.0002"),
        (lambda s: replace(s, forces=s.forces[:2]), "spring force", "pivot", "spring only in a"),
    ],
)
def test_terms_are_told_by_their_joint_with_their_values(
    linkage: Scene, fault: Injection, quantity: str, where: str, detail: str
) -> None:
    assert [force.joint for force in linkage.forces] == ["motor", "elbow", "pivot"]  # type: ignore[union-attr]
    result = compared(linkage, fault(linkage))
    assert first_failing(result) == ("dynamics", quantity, where)
    assert f"worst at {where}: {detail} (" in result.verdict


def test_laws_with_a_model_are_told_by_their_joint_with_their_values(linkage: Scene) -> None:
    law = ComputedTorque("motor", stiffness=100.0, damping=20.0, target=0.1)
    own, other = (replace(linkage, control=(one,)) for one in (law, replace(law, damping=25.0)))
    result = compared(own, other)
    assert first_failing(result) == ("dynamics", "actuator force", "motor")
    assert "worst at motor: damping a 20, b 25 (" in result.verdict
    assert compared(own, own).agrees


def test_an_axis_that_points_the_other_way_is_the_same_hinge(linkage: Scene, tmp_path: Path) -> None:
    """But for what drives it."""
    text = LINKAGE.read_text()
    result = compared(
        linkage, read_mjcf(tmp_path, text.replace('name="pivot"', 'name="pivot" axis="0 -1 0"'))
    )
    assert result.agrees
    assert result.notes == ("counted the other way there: pivot",)
    result = compared(
        linkage, read_mjcf(tmp_path, text.replace('name="motor"', 'name="motor" axis="0 -1 0"', 1))
    )
    assert first_failing(result) == ("dynamics", "actuator force", "motor")


def test_angles_of_the_second_run_are_counted_as_in_the_first(linkage: Scene, tmp_path: Path) -> None:
    """From another zero, and the other way round."""
    text = LINKAGE.read_text()
    for old, new in (("elbow", 'ref="0.5"'), ("pivot", 'axis="0 -1 0"')):
        text = text.replace(f'name="{old}"', f'name="{old}" {new}', 1)
    runs = compared(linkage, read_mjcf(tmp_path, text)).trajectories
    first, second = (runs[name] for name in ("a", "b"))
    assert first.angle_names == second.angle_names
    # rad: both runs are good to 1e-8
    assert second.joint_angle == pytest.approx(first.joint_angle, abs=1e-7)


def test_a_ball_at_another_point_is_another_joint_though_all_moves_alike(linkage: Scene) -> None:
    """Beside the plane of the linkage, where the ball turns as before and loads its bodies otherwise."""
    beside = injection.joint_point("loop", np.array([0.0, FAULT, 0.0]))(linkage)
    assert first_failing(compared(linkage, beside)) == ("model", "joint Jacobians", "loop")


def test_the_point_of_a_hinge_may_be_anywhere_on_its_axis() -> None:
    """Its reaction is told at another point then, where the same force has another torque."""
    result = compared(pendulum(), injection.joint_point("pivot", np.array([0.0, 0.3, 0.0]))(pendulum()))
    assert result.verdict.startswith("SAME")
    (torque,) = (row for row in result.checks if row.quantity == "reaction torque, rel")
    assert torque.value < ROUND_OFF


@pytest.mark.parametrize(
    "change",
    [
        lambda force: replace(force, stiffness=(1.0 + FAULT) * force.stiffness),
        lambda force: replace(force, point_on_second=force.point_on_second + FAULT),
    ],
)
def test_forces_between_points_are_told_by_their_body(change) -> None:
    spring = PointSpring(
        "band", "ground", "rod", [0.3, 0.2, 1.0], [0.8, 0.0, 0.1], stiffness=9.0, rest_length=0.2
    )
    push = Wrench("push", "rod", [0.5, 0.0, 0.0], force=[0.0, 0.0, 1.0])
    scene = replace(pendulum(), forces=(spring, push))
    assert compared(scene, scene).agrees
    result = compared(scene, replace(scene, forces=(change(spring), push)))
    assert first_failing(result) == ("dynamics", "forces on bodies", "rod")
    result = compared(scene, replace(scene, forces=(spring, replace(push, torque=[0.0, FAULT, 0.0]))))
    assert first_failing(result) == ("dynamics", "forces on bodies", "rod")


def test_joints_of_another_kind_are_judged_by_the_motions_they_allow() -> None:
    scene = pendulum()
    hinge = scene.mechanism.joints[0]
    ball = injection.joint_kind(hinge, "spherical")(scene)
    assert first_failing(compared(scene, ball))[::2] == ("kinematics", "pivot")
    assert first_failing(compared(ball, scene)) == ("model", "joint constraint violation, rad", "pivot")


def test_gears_are_compared_by_what_they_couple() -> None:
    def geared(ratio: float, sign: float = 1.0) -> Scene:
        bodies = [Body.ground(), bar("left", [0, 0, 0], [0, 0, 1]), bar("right", [1, 0, 0], [1, 0, 1])]
        joints = [
            Revolute("on_left", "ground", "left", [0, 0, 0], axis=[0, 1, 0]),
            Revolute("on_right", "ground", "right", [1, 0, 0], axis=[0, sign, 0]),
        ]
        gear = Gear("wheels", "on_left", "on_right", ratio)
        return Scene("geared", Mechanism(bodies, joints, [gear]), 0.2, 0.1, GRAVITY)

    assert compared(geared(-2.0), geared(2.0, -1.0)).agrees
    result = compared(geared(-2.0), geared(-2.0 * (1.0 + FAULT)))
    assert first_failing(result) == ("model", "couplings", "wheels")


def test_functions_of_coupled_coordinates_are_compared_whatever_they_are_multiplied_by() -> None:
    scene, keys = pendulum(), (("on_left", 0), ("on_right", 0))

    def coupling(scale: float, speed: float) -> Coupling:
        factors = dict(zip(keys, (scale, -2.0 * scale), strict=True))
        return Coupling("gear", "wheels", "on_left", factors, Polynomial((0.0, scale * speed)), False)

    one, two, faster = coupling(1.0, 0.7), coupling(-3.0, 0.7), coupling(-3.0, 0.7 * (1.0 + FAULT))
    scale = -1.0 / 3.0
    assert functions_apart(scene, one, two, scale) < ROUND_OFF
    assert functions_apart(scene, one, faster, scale) == pytest.approx(FAULT, rel=1e-9)


def test_bodies_without_partner_are_named() -> None:
    other = pendulum()
    names = {"ground": "ground", "rod": "stick"}
    bodies = [replace(body, name=names[body.name]) for body in other.mechanism.bodies]
    joint = replace(other.mechanism.joints[0], second="stick")
    renamed = replace(other, mechanism=Mechanism(bodies, [joint]), initial_state=None)
    assert compared(other, renamed).agrees  # told by its joint
    stranger = replace(
        renamed, mechanism=Mechanism(bodies, [replace(joint, name="axle")]), initial_state=None
    )
    result = compared(other, stranger)
    assert first_failing(result) == ("model", "bodies without partner", "rod, stick")
    assert list(result.trajectories) == ["a"]
    assert result.notes == ("bodies are paired by their names, and what is left by the names of its joints",)


def test_bodies_fixed_to_each_other_are_one_rigid_body() -> None:
    """Two uniform bars end to end are a bar twice as long: m l^2 / 12 across it, and no fixed joint."""
    mass, length = 2.0, 0.5
    own = mass * length**2 / 12.0 * np.diag([1.0, 1.0, 1e-3])
    upper, lower = (Body(name, mass, [0.0, 0.0, z], own) for name, z in (("upper", -0.25), ("lower", -0.75)))
    joints = [
        Spherical("top", "ground", "upper", [0, 0, 0]),
        Fixed("glue", "lower", "upper", [0, 0, -0.5]),
    ]
    scene = Scene("bars", Mechanism([Body.ground(), upper, lower], joints), 1.0, 0.1, GRAVITY)
    found = next(alignments(scene, scene)).first
    (body,) = found.mechanism.bodies[1:]
    assert found.mechanism.joint_names == ("top",)
    assert body.mass == 2.0 * mass
    np.testing.assert_allclose(body.center_of_mass, [0.0, 0.0, -0.5], atol=1e-15)
    across = 2.0 * mass * (2.0 * length) ** 2 / 12.0
    np.testing.assert_allclose(np.diag(body.inertia), [across, across, 2.0 * own[2, 2]], rtol=1e-14)


def test_reactions_that_either_model_leaves_open_are_not_compared() -> None:
    """Of a plane loop of four hinges three rows are redundant; against one with a ball the same three."""
    scene = whole()[0]
    state = initial_state(scene)
    weaker = injection.joint_kind(scene.mechanism.joints[2], "spherical")(scene)
    joints = {name: name for name in scene.mechanism.joint_names}
    alone = undetermined(scene, state)
    assert alone.shape == (24, 3)
    assert undetermined(weaker, state).shape == (24, 1)
    for first, second in ((scene, scene), (scene, weaker), (weaker, scene)):
        both = undetermined_in_both(first, second, joints, (state, state))
        np.testing.assert_allclose(both @ both.T, alone @ alone.T, atol=1e-12)


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path, Path]:
    """The example's linkage without what a URDF cannot hold, as MJCF, and paths to convert it to."""
    text = LINKAGE.read_text()
    text = re.sub(r"<actuator>.*</keyframe>", "", text, flags=re.DOTALL)
    text = re.sub(r' (armature|stiffness|damping)="[^"]*"', "", text)
    text = text.replace('<body name="rocker"', '<body name="rocker" euler="0 20 0"')
    text = text.replace(
        '<site name="rocker_end" pos="0 0 0.25"/>', '<site name="rocker_end" pos="-0.0855 0 0.2349"/>'
    )
    (tmp_path / "linkage.xml").write_text(text)
    return tmp_path / "linkage.xml", tmp_path / "converted.urdf", tmp_path / "converted.loops.yaml"


def test_a_converted_model_is_the_same_on_the_command_line(capsys, tmp_path, files) -> None:
    model, converted, loops = files
    assert run(capsys, "convert", model, converted)[0] == 0
    folder = tmp_path / "out"
    arguments = ("run", model, "--against", converted, "--against-set", f"loops={loops}", "--output", folder)
    status, out, err = run(capsys, *arguments)
    assert (status, err) == (0, "")
    assert verdict_of(out).startswith(f"SAME: {model} and {converted} (loops={loops}) agree in all ")
    names = {"linkage.npz", "converted.npz", "summary.json", "junit.xml", "linkage_against_converted.rrd"}
    assert {path.name for path in folder.iterdir()} == names
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["agrees"] is True
    assert [part["source"] for part in summary["models"]] == [str(model), str(converted)]
    assert {figure["level"] for figure in summary["checks"]} == {
        *LEVELS_OF_EQUATIONS,
        *LEVELS_OF_RUNS,
        START,
    } - {"drift"}


@pytest.mark.parametrize(
    ("path", "other", "name"),
    [
        ("new/arm.xml", "leg.xml", "arm"),
        ("new/arm.xml", "arm.urdf", "arm.xml"),
        ("new/arm.xml", "arm.xml", "new_arm.xml"),
        ("arm.xml", "new/arm.xml", "arm.xml"),
    ],
)
def test_models_are_named_by_what_tells_them_apart(path: str, other: str, name: str) -> None:
    assert _distinct_name(Path(path), Path(other)) == name


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("tracker", "--against-set", "gravity=off"), "--against-set is for the model of --against"),
        (
            ("tracker", "--against", "tracker", "--engines", "mujoco"),
            "--engines is for one model, without --against",
        ),
        (
            ("tracker", "--against", "tracker", "--against-set", "loops=l.yaml"),
            "unknown option 'loops' of scene 'tracker'",
        ),
        (
            ("tracker", "--against", "tracker", "--against-set", "foo"),
            "--against-set 'foo' is not of the form",
        ),
        (
            ("tracker", "--against", LINKAGE, "--against-set", "duration=0.5"),
            "--against-set duration: both models have the first's, see --set",
        ),
        (("--all", "--against", "tracker"), "--all runs all scenes"),
        (("tracker", "--against", "none.xml"), "none.xml: cannot be read"),
    ],
)
def test_bad_usage(capsys, tmp_path, arguments, message) -> None:
    status, out, err = run(capsys, "run", *arguments, "--output", tmp_path / "out")
    assert (status, out) == (2, "")
    assert message in err
    assert not (tmp_path / "out").exists()


STOPPED = "integration stopped at t = 0.1 s: steps too small"


def stopping_above(monkeypatch: pytest.MonkeyPatch, mass: float) -> None:
    """Have runs of a first body of more than that mass, kg, stop after a first output."""

    def simulate(scene: Scene) -> Trajectory:
        found = real(scene)
        if scene.mechanism.bodies[1].mass <= mass:
            return found
        error = IntegrationError(0.1, "steps too small")
        error.partial = found
        raise error

    real = compare.ENGINE.simulate
    monkeypatch.setattr(compare, "ENGINE", replace(compare.ENGINE, simulate=simulate))


def test_a_run_that_stops_does_not_hide_where_the_models_part(monkeypatch) -> None:
    stopping_above(monkeypatch, 1.0)
    result = compared(pendulum(), injection.mass("rod", FAULT)(pendulum()))
    assert first_failing(result) == ("model", "mass", "rod")
    assert result.verdict.startswith("DIFFERENT: a and b differ at level 'model': mass, rel: ")
    assert result.verdict.endswith("; not run to the end")
    assert result.notes[0] == f"not run to the end: b: {STOPPED}"
    assert list(result.trajectories) == ["a", "b"]
    assert [stop.what for stop in result.unfinished] == ["b"]


def test_models_without_random_states_are_compared_at_their_start(monkeypatch) -> None:
    def fails(*_) -> None:
        raise AssemblyError("pivot", 1.0, 1e-9)

    monkeypatch.setattr(compare, "random_states", fails)
    result = compared(pendulum(), injection.mass("rod", FAULT)(pendulum()))
    assert first_failing(result) == ("model", "mass", "rod")
    assert compared(pendulum(), pendulum()).verdict.startswith("UNFINISHED: random states: joint 'pivot'")


def test_a_run_that_stops_of_models_that_agree_until_then_gives_no_verdict(monkeypatch) -> None:
    stopping_above(monkeypatch, 0.5)
    result = compared(pendulum(), pendulum())
    assert not result.agrees
    stopped, agreed = result.verdict.split("; ")[:2]
    assert stopped == f"UNFINISHED: a, b: {STOPPED}"
    assert agreed.startswith("as far as compared a and b agree in all ")
    assert {row.level for row in result.checks} >= {"model", "trajectories"}


def test_models_that_part_are_different_on_the_command_line_whatever_stops(
    capsys, monkeypatch, tmp_path
) -> None:
    write_scene(pendulum(), tmp_path / "one.yaml")
    write_scene(injection.mass("rod", FAULT)(pendulum()), tmp_path / "other.yaml")
    out = tmp_path / "out"
    arguments = ("run", tmp_path / "one.yaml", "--against", tmp_path / "other.yaml", "--output", out)
    recording = "one_against_other.rrd"
    stopping_above(monkeypatch, 1.0)
    status, printed, err = run(capsys, *arguments)
    assert (status, err) == (1, "")
    assert f": {STOPPED}" in printed
    assert verdict_of(printed).startswith("DIFFERENT: ")
    assert {path.name for path in out.iterdir()} == {
        "one.npz",
        "other.npz",
        "summary.json",
        "junit.xml",
        recording,
    }
