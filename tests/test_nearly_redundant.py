"""Loops that noise in a file keeps from being redundant move as the design does, in every form and engine."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import newton_euler
import urdf
from crosscheck.engines import ENGINES
from crosscheck.report import redundancy_lines
from crosscheck.run import crosscheck
from crosscheck.stress.noise import MECHANISMS, SENSITIVITY, flat_four_bar
from mjcf.read import read
from mjcf.rigid import RigidMuJoCo
from newton_euler.assemble import assemble, random_states
from newton_euler.cartesian import Cartesian
from newton_euler.errors import IntegrationError, NearlyRedundantWarning
from newton_euler.redundancy import apparent_rank, mobility
from newton_euler.relative import Relative
from newton_euler.scene import Scene
from newton_euler.state import State
from newton_euler.trajectory import Trajectory
from urdf.dynamics import PinocchioSystem

FREEDOMS = {"flat_four_bar": 1, "sarrus": 1, "double_wishbone": 2, "bricard": 1}
FORMS = list(product(["relative", "cartesian"], ["projection", "baumgarte", "none"]))

pytestmark = pytest.mark.filterwarnings("ignore::newton_euler.errors.NearlyRedundantWarning")


def run(scene: Scene, formulation: str = "relative", stabilization: str = "projection") -> np.ndarray:
    return newton_euler.simulate(scene, formulation, stabilization=stabilization).position


@pytest.mark.parametrize("name", MECHANISMS)
@pytest.mark.parametrize("noise", [1e-12, 1e-9, 1e-6])
def test_noise_of_files_moves_bodies_by_its_own_size(name, noise):
    clean, scene = MECHANISMS[name](0.0), MECHANISMS[name](noise)
    design, decided = run(clean), mobility(scene)
    assert mobility(clean).nearly == ()
    assert decided.degrees_of_freedom == mobility(clean).degrees_of_freedom == FREEDOMS[name]
    assert [weak.taken for weak in decided.nearly] == ["redundant"]
    assert 0.1 * noise < decided.residual < 10.0 * noise  # one row, of the order of what disturbs it
    assert np.abs(design[-1] - design[0]).max() > 0.05
    for form in FORMS if noise == 1e-9 else FORMS[::3]:
        # the rest is the error of the runs, at rtol 1e-10 and with gains of 10 1/s
        assert np.abs(run(scene, *form) - design).max() < SENSITIVITY * noise + 1e-10, form


def test_a_parallelogram_passes_its_flat_configuration():
    """Where a second singular value vanishes beside the one that noise has left."""
    wanted = run(flat_four_bar(0.0, 0.5))
    for formulation in ("relative", "cartesian"):  # without projection runs stop there, tilted or not
        # the tilt has no effect to first order; at a bifurcation round-off is magnified
        assert np.abs(run(flat_four_bar(1e-7, 0.5), formulation) - wanted).max() < 1e-7, formulation


@pytest.mark.parametrize("tilt", [1e-9, 1e-7, 1e-6, 1e-5, 2e-5, 5e-5])
def test_pinocchio_stops_next_to_a_bifurcation_rather_than_go_astray(tilt):
    """It regularizes what is left out, by more than the design's own constraint counts there."""
    scene = flat_four_bar(tilt, 0.5)
    partial: Trajectory | None = None
    try:
        partial = urdf.simulate(scene)
    except IntegrationError as stopped:
        partial = stopped.partial
    assert partial is not None
    assert partial.time[-1] > 0.36
    found = partial.position
    wanted = run(flat_four_bar(0.0, 0.5))
    # errors of the regularization, magnified next to the bifurcation
    assert np.abs(found - wanted[: len(found)]).max() < 1e-4


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


@pytest.mark.parametrize("tilt", [1e-8, 1e-6])
def test_a_crosscheck_says_what_was_taken_how(tilt):
    scene = replace(flat_four_bar(tilt), duration=0.1)
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
    assert last == "the mechanism has no degree of freedom"


@pytest.mark.parametrize("tilt", [1e-12, 1e-11])
def test_what_is_below_round_off_is_never_taken_literally(tilt):
    scene = replace(flat_four_bar(tilt), redundancy_tolerance=0.0)
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


def test_larger_tilts_are_taken_literally_unless_told_otherwise():
    assert mobility(flat_four_bar(1e-3)).degrees_of_freedom == 0
    loose = replace(flat_four_bar(1e-3), redundancy_tolerance=1e-2)
    assert mobility(loose).degrees_of_freedom == 1
    assert np.abs(run(loose) - run(flat_four_bar(0.0))).max() < SENSITIVITY * 1e-3


def test_a_state_that_noise_leaves_open_may_be_a_start_and_others_not():
    scene = flat_four_bar(1e-6)
    state = random_states(scene, 1)[0]
    assert replace(scene, initial_state=assemble(scene, state)).initial_state is not None
    shifted = replace(state, position=state.position + 1e-6 * np.eye(5, 3))
    with pytest.raises(newton_euler.NewtonEulerError, match="in the initial state"):
        replace(scene, initial_state=shifted)


def test_ranks_lie_at_gaps():
    assert apparent_rank(np.array([2.0, 1.0, 1e-8, 1e-17]), 1e-4) == 2
    assert apparent_rank(np.array([2.0, 1.0, 1e-8, 1e-17]), 0.0) == 3
    assert apparent_rank(np.array([2.0, 1e-1, 1e-2, 1e-3, 2e-4, 5e-5]), 1e-4) == 6  # no gap
    assert apparent_rank(np.zeros(2), 1e-4) == 0


FINGER = """
<mujoco>
  <worldbody>
    <body name="crank"><joint name="motor" axis="0 1 0"/>
      <inertial pos="0 0 .1" mass="1" diaginertia=".01 .01 .01"/>
      <body name="coupler" pos="0 0 .2"><joint name="elbow" axis="0 1 0"/>
        <inertial pos=".2 0 0" mass="1" diaginertia=".01 .01 .01"/>
        <body name="rocker" pos=".4 0 0"><joint name="wrist" axis="0 1 {tilt}"/>
          <inertial pos="0 0 -.1" mass="1" diaginertia=".01 .01 .01"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><connect body1="rocker" anchor="0 {gap} -.2"/></equality>
  <keyframe><key name="open" qpos="0.3 -0.3 0.3000001"/></keyframe>
</mujoco>
"""


def test_loops_of_a_file_close_as_far_as_its_digits_go(tmp_path):
    """MuJoCo takes the anchor in the world at qpos0; at another pose it is out of the plane by a tilt."""
    path = tmp_path / "finger.xml"
    path.write_text(FINGER.format(tilt=1e-6, gap=0.0))
    found = read(path, duration=0.25)  # before it lies flat, where an offset decides how it goes on
    assert any("loops keep an offset of" in line for line in found.report.start)
    assert mobility(found.scene).degrees_of_freedom == 1
    moved = run(found.scene)
    assert np.abs(moved[-1] - moved[0]).max() > 0.05
