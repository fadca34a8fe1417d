"""Nearly redundant loops, whose equations are independent by noise alone, in every formulation and engine."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from mechanisms import scaled

import newton_euler
import urdf
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.note import Note
from crosscheck.engines.registry import ENGINES
from crosscheck.report.run import redundancy_lines
from crosscheck.studies.stress.noise import MECHANISMS, NOISE_SENSITIVITY, flat_four_bar
from mjcf import read
from mjcf.rigid import RigidMuJoCo
from newton_euler.analysis.identification.measurements import Measurements
from newton_euler.equations import redundancy
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.independence import independent
from newton_euler.equations.redundancy import constraint_rank, mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.sparse import sparse_vector
from newton_euler.errors import NearlyRedundantWarning
from newton_euler.model.couplings import Gear
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import assemble, initial_state
from urdf import read as read_urdf
from urdf.dynamics import PinocchioSystem

FREEDOMS = {"flat_four_bar": 1, "sarrus": 1, "double_wishbone": 2, "bricard": 1}
FORMS = list(product(["relative", "cartesian"], ["projection", "baumgarte", "none"]))

pytestmark = pytest.mark.filterwarnings("ignore::newton_euler.errors.NearlyRedundantWarning")


def run(scene: Scene, formulation: str = "relative", stabilization: str = "projection") -> np.ndarray:
    return newton_euler.simulate(scene, formulation, stabilization=stabilization).position


@pytest.mark.parametrize("name", MECHANISMS)
@pytest.mark.parametrize("noise", [1e-12, 1e-9, 1e-6])
def test_one_row_of_the_size_of_the_noise_is_taken_as_redundant(name, noise):
    clean, decided = mobility(MECHANISMS[name](0.0)), mobility(MECHANISMS[name](noise))
    assert clean.nearly == ()
    assert decided.degrees_of_freedom == clean.degrees_of_freedom == FREEDOMS[name]
    assert [weak.taken for weak in decided.nearly] == ["redundant"]
    assert 0.1 * noise < decided.residual < 10.0 * noise


@pytest.mark.parametrize(
    "name",
    [
        # 4 s each; other mechanisms are as noisy
        pytest.param(name, marks=pytest.mark.slow) if name in ("sarrus", "bricard") else name
        for name in MECHANISMS
    ],
)
def test_noise_of_files_moves_bodies_by_its_own_size(name):
    """In every form the flat four-bar; the others as they are run unless one asks for something else."""
    noise, design = 1e-9, run(MECHANISMS[name](0.0))
    assert np.abs(design[-1] - design[0]).max() > 0.05
    for form in FORMS if name == "flat_four_bar" else FORMS[::3]:
        # the rest is the error of the runs, at rtol 1e-10 and with gains of 10 1/s
        found = run(MECHANISMS[name](noise), *form)
        assert np.abs(found - design).max() < NOISE_SENSITIVITY * noise + 1e-10, form


@pytest.mark.parametrize("tilt", [1e-12, 1e-5])
def test_a_parallelogram_passes_its_flat_configuration(tilt):
    """Where a second singular value vanishes beside the one that noise has left."""
    wanted = run(flat_four_bar(0.0, 0.5))
    scene = flat_four_bar(tilt, 0.5)
    # without projection runs stop there, tilted or not
    runs = {formulation: run(scene, formulation) for formulation in ("relative", "cartesian")}
    runs["pinocchio"] = urdf.simulate(scene).position
    for name, found in runs.items():
        # the tilt has no effect to first order; at a bifurcation round-off is magnified
        assert np.abs(found - wanted).max() < 1e-7 + NOISE_SENSITIVITY * tilt, name


def test_an_offset_of_a_file_does_not_keep_it_from_passing(tmp_path):
    """Steps next to the flat configuration are judged by the noise: by less, round-off decides."""
    tilt, runs = 1e-6, []
    for noise in (0.0, tilt):
        path = tmp_path / f"finger_{noise:g}.xml"
        path.write_text(finger(1.0, noise))
        runs.append([run(read(path, duration=0.5).scene, form) for form in ("relative", "cartesian")])
    assert np.abs(np.array(runs[1]) - runs[0][0]).max() < NOISE_SENSITIVITY * tilt


@pytest.mark.parametrize("name", MECHANISMS)
def test_engines_omit_the_same_constraint(name):
    scene = MECHANISMS[name](1e-6)
    allowed = 100.0 * mobility(scene).residual  # condition of the loops, below 100
    for state in random_states(scene, 2):
        wanted = evaluated(Relative, scene, state)
        for system in (Cartesian, RigidMuJoCo, PinocchioSystem):
            gap = np.abs(evaluated(system, scene, state) - wanted).max()
            assert gap < allowed * np.abs(wanted).max(), system.__name__


def evaluated(system, scene: Scene, state: State) -> np.ndarray:
    equations = system(scene)
    found = equations.evaluate(*equations.coordinates(state))
    return np.concatenate([found.linear_acceleration, found.angular_acceleration])


def test_a_crosscheck_says_what_was_taken_how():
    scene = replace(flat_four_bar(1e-6), duration=0.1)
    result = crosscheck(scene, list(ENGINES.values()), lambda told: None, "flat_four_bar", {})
    assert result.agrees, result.verdict
    (line,) = redundancy_lines(scene)
    assert line == (
        f"nearly redundant, joint 'wrist': singular value {mobility(scene).residual:.1e}, taken redundant; "
        "redundancy_tolerance=0 takes it literally"
    )


def test_taken_literally_the_mechanism_is_locked_and_says_so():
    scene = replace(flat_four_bar(1e-6), redundancy_tolerance=0.0)
    assert mobility(scene).degrees_of_freedom == 0
    with pytest.warns(NearlyRedundantWarning, match=r"joint 'wrist': singular value .*, taken literally"):
        found = run(scene)
    assert np.abs(found - found[0]).max() < 1e-9
    first, last = redundancy_lines(scene)
    assert first.endswith("redundancy_tolerance=1e-06 takes it as redundant")
    assert last.startswith(Note.NO_FREEDOM)


def identified(scene: Scene) -> None:
    run = newton_euler.simulate(scene)
    angle = run.joint("motor").coordinates[:, 0]
    newton_euler.identify(scene, ["crank.mass"], Measurements(run.time, {"coordinate.motor": angle}))


@pytest.mark.parametrize(
    ("call", "times"),
    [
        (lambda scene: newton_euler.compile_scene(scene).simulate(), 1),
        (lambda scene: newton_euler.simulate_batch(scene, parameters={"crank.mass": [1.0, 2.0]}), 1),
        (lambda scene: newton_euler.sensitivities(scene, ["crank.mass"]), 1),
        (identified, 2),  # by the run that it measures, too
    ],
)
def test_each_call_warns_once_where_it_is(call, times):
    scene = replace(flat_four_bar(1e-6), duration=0.1)
    with pytest.warns(NearlyRedundantWarning, match=r"joint 'wrist': .*, taken redundant") as heard:
        call(scene)
    assert [Path(each.filename) for each in heard] == [Path(__file__)] * times


def test_what_is_below_round_off_is_never_taken_literally():
    scene = replace(flat_four_bar(1e-11), redundancy_tolerance=0.0)
    assert [weak.taken for weak in mobility(scene).nearly] == ["redundant"]
    for formulation in ("relative", "cartesian"):
        assert np.abs(run(scene, formulation) - run(flat_four_bar(0.0))).max() < 1e-9, formulation


@pytest.mark.parametrize("tilt", [1e-3, 2e-3, 1.2e-2])
def test_the_advice_of_the_report_is_true(tilt):
    scene = flat_four_bar(tilt)
    line, _ = redundancy_lines(scene)
    advised = float(line.split("redundancy_tolerance=")[1].split()[0])
    assert mobility(scene).degrees_of_freedom == 0
    assert mobility(replace(scene, redundancy_tolerance=advised)).degrees_of_freedom == 1


def test_a_state_that_noise_leaves_open_may_be_a_start_and_others_not():
    scene = flat_four_bar(1e-6)
    state = random_states(scene, 1)[0]
    assert initial_state(replace(scene, initial_state=assemble(scene, state))) is not None
    shifted = replace(state, position=state.position + 1e-6 * np.eye(5, 3))
    with pytest.raises(newton_euler.NewtonEulerError, match="in the initial state"):
        initial_state(replace(scene, initial_state=shifted))


def rows_of(matrix, tolerance=1e-4):
    return independent([sparse_vector(row) for row in np.array(matrix, dtype=float)], tolerance).rows


def test_ranks_lie_at_gaps():
    assert rows_of(np.diag([2.0, 1.0, 1e-8])) == [0, 1]
    assert rows_of(np.diag([2.0, 1e-1, 1e-2, 1e-3, 2e-4, 5e-5])) == [0, 1, 2, 3, 4, 5]  # no gap
    assert rows_of(np.zeros((2, 2))) == []


def test_round_off_is_no_constraint_however_literally_others_are_taken():
    for size, independents in ((1e-9, [0, 1]), (1e-11, [0])):
        assert rows_of(np.diag([1.0, size]), tolerance=0.0) == independents


def finger(size: float, tilt: float = 1e-6) -> str:
    """A flat four-bar of a size, m; at its keyframe a tilt keeps the ball that closes it from the plane."""
    inertia = " ".join(3 * [f"{0.01 * size**2:.9g}"])

    def at(x: float, z: float) -> str:
        return f'"{x * size:.9g} 0 {z * size:.9g}"'

    return f"""
<mujoco>
  <worldbody>
    <body name="crank"><joint name="motor" axis="0 1 0"/>
      <inertial pos={at(0.0, 0.1)} mass="1" diaginertia="{inertia}"/>
      <body name="coupler" pos={at(0.0, 0.2)}><joint name="elbow" axis="0 1 0"/>
        <inertial pos={at(0.2, 0.0)} mass="1" diaginertia="{inertia}"/>
        <body name="rocker" pos={at(0.4, 0.0)}><joint name="wrist" axis="0 1 {tilt:g}"/>
          <inertial pos={at(0.0, -0.1)} mass="1" diaginertia="{inertia}"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><connect body1="rocker" anchor={at(0.0, -0.2)}/></equality>
  <keyframe><key name="open" qpos="0.3 -0.3 0.3000001"/></keyframe>
</mujoco>
"""


URDF = """
<robot name="finger">
  <link name="base"/>{links}
  <joint name="motor" type="continuous"><parent link="base"/><child link="crank"/><axis xyz="0 1 0"/></joint>
  <joint name="elbow" type="continuous"><parent link="crank"/><child link="coupler"/>
    <origin xyz="0 0 {crank:.9g}"/><axis xyz="0 1 0"/></joint>
  <joint name="wrist" type="continuous"><parent link="coupler"/><child link="rocker"/>
    <origin xyz="{coupler:.9g} 0 0"/><axis xyz="0 1 1e-6"/></joint>
  <joint name="tip" type="fixed"><parent link="rocker"/><child link="toe"/>
    <origin xyz="0 0 -{crank:.9g}"/></joint>
  <joint name="foot" type="fixed"><parent link="base"/><child link="ground"/>
    <origin xyz="{coupler:.9g} {gap:.9g} {open:.9g}"/></joint>
</robot>
"""
LOOP = "closed_loop: [[toe, ground]]\ntype: [3d]\nname_mot: []\njoint_name: []\njoint_type: []\n"


def urdf_finger(size: float) -> str:
    """The same as a URDF, out of the plane by 9e-8 of its size, and open by 1e-8."""
    inertia = " ".join(f'i{k}{k}="{0.01 * size**2:.9g}"' for k in "xyz") + ' ixy="0" ixz="0" iyz="0"'
    links = "".join(
        f'<link name="{name}"><inertial><mass value="1"/><inertia {inertia}/></inertial></link>'
        for name in ("crank", "coupler", "rocker")
    )
    links += '<link name="toe"/><link name="ground"/>'
    lengths = {"crank": 0.2 * size, "coupler": 0.4 * size, "gap": 9e-8 * size, "open": 1e-8 * size}
    return URDF.format(links=links, **lengths)


def read_finger(kind: str, size: float, folder: Path, **options: float):
    path = folder / f"finger.{'xml' if kind == 'mjcf' else kind}"
    if kind == "mjcf":
        path.write_text(finger(size))
        return read(path, **options)
    path.write_text(urdf_finger(size))
    (folder / "finger.yaml").write_text(LOOP)
    return read_urdf(path, folder / "finger.yaml", gravity=(3.0, 0.0, -9.81), **options)


@pytest.mark.parametrize("kind", ["mjcf", "urdf"])
@pytest.mark.parametrize("size", [1e-4, 1.0, 1e4])
def test_loops_of_a_file_of_any_size_close_as_far_as_its_digits_go(kind, size, tmp_path):
    """MuJoCo takes the anchor in the world at qpos0; at another pose it is out of the plane by a tilt."""
    found = read_finger(kind, size, tmp_path, duration=0.25)  # before it lies flat
    (kept,) = (line for line in found.report.start if line.startswith("loops keep an offset of"))
    assert 5e-9 < float(kept.split()[5]) / size < 1e-7
    decided = mobility(found.scene)
    assert decided.degrees_of_freedom == 1
    assert [weak.taken for weak in decided.nearly] == ["redundant"]
    if size == 1.0:
        moved = run(found.scene)
        assert np.abs(moved[-1] - moved[0]).max() > 0.05


def test_closing_takes_constraints_literally_where_the_scene_does(tmp_path):
    """The only pose without an offset has the tilted hinge where it was at qpos0, 0.3 rad away."""
    found = read_finger("mjcf", 1.0, tmp_path, redundancy_tolerance=0.0, verified=False)
    assert not any("loops keep an offset" in line for line in found.report.start)
    assert any("joint 'wrist' moved most, by -0.3" in line for line in found.report.start)


def test_what_no_motion_closes_is_an_offset_however_constraints_are_taken(tmp_path):
    """In the pose of the URDF the tilt does nothing, so that no hinge moves the loop out of the plane."""
    found = read_finger("urdf", 1.0, tmp_path, redundancy_tolerance=0.0, verified=False)
    assert any("loops keep an offset of 9.0e-08" in line for line in found.report.start)


@pytest.mark.parametrize("build", MECHANISMS.values(), ids=list(MECHANISMS))
def test_decisions_do_not_depend_on_the_size_of_a_mechanism(build):
    scene = build(1e-6)
    wanted = mobility(scene)
    for factor in (1e-4, 1e4):
        found = mobility(scaled(scene, factor))
        assert found.degrees_of_freedom == wanted.degrees_of_freedom
        assert found.residual == pytest.approx(wanted.residual, rel=1e-3)


@pytest.mark.parametrize("tolerance", [0.0, 1e-4])
def test_scenes_too_large_for_singular_values_say_how_constraints_are_taken(tolerance, monkeypatch):
    monkeypatch.setattr(redundancy, "DENSE_LIMIT", 0)
    decided = mobility(replace(flat_four_bar(1e-6), redundancy_tolerance=tolerance))
    (weak,) = decided.nearly
    assert weak.taken == ("redundant" if tolerance else "literally")
    assert 1e-7 < weak.singular_value < 1e-5
    assert decided.degrees_of_freedom == (1 if tolerance else 0)


@pytest.mark.parametrize("tilt", [0.0, 1e-6, 5e-5])
def test_a_gear_that_a_loop_implies_does_not_count(tilt):
    """Cranks of a parallelogram turn alike, geared or not."""
    scene = flat_four_bar(tilt)
    bodies, joints = scene.mechanism.bodies, scene.mechanism.joints
    mechanism = Mechanism(bodies, joints, [Gear("mimic", "motor", "pivot", 1.0)])
    geared = replace(scene, mechanism=mechanism, initial_state=None)
    systems = [PinocchioSystem(each) for each in (scene, geared)]
    assert constraint_rank(systems[1]) == constraint_rank(systems[0])
    for state in random_states(geared, 2):
        wanted, found = (system.evaluate(*system.coordinates(state)) for system in systems)
        gap = np.abs(found.linear_acceleration - wanted.linear_acceleration).max()
        assert gap < (1e-9 + 100.0 * tilt) * np.abs(wanted.linear_acceleration).max()
