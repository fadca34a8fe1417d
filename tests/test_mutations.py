"""The tests notice mistakes: each is made on purpose in a copy of the source, and a test must fail."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("newton_euler", "mjcf", "urdf", "crosscheck")

MISTAKES = {
    "swapped axes of a universal joint": (
        "newton_euler/model/joint_kinds.py",
        "first.vector_to_body(self.axis_on_first), second.vector_to_body(self.axis_on_second)",
        "first.vector_to_body(self.axis_on_second), second.vector_to_body(self.axis_on_first)",
        "newton_euler/equations/test_systems.py",
    ),
    "swapped hinges of a universal joint in the tree": (
        "newton_euler/model/joint_kinds.py",
        'Motion("hinge", self.axis_on_first), Motion("hinge", self.axis_on_second)',
        'Motion("hinge", self.axis_on_second), Motion("hinge", self.axis_on_first)',
        "newton_euler/equations/test_systems.py",
    ),
    "a sign in gamma of the ball": (
        "newton_euler/model/constraints.py",
        "return _centripetal(second.angular_velocity, s_j) - _centripetal(",
        "return _centripetal(second.angular_velocity, s_j) + _centripetal(",
        "newton_euler/model/test_joints.py",
    ),
    "a sign in gamma of perpendicular axes": (
        "newton_euler/model/constraints.py",
        "+ 2.0 * (cross(wi, a) @ cross(wj, b))",
        "- 2.0 * (cross(wi, a) @ cross(wj, b))",
        "newton_euler/model/test_joints.py",
    ),
    "a missing Coriolis term of slides": (
        "newton_euler/equations/kinematics.py",
        "acceleration = acceleration + coriolis",
        "acceleration = acceleration + 0.0 * coriolis",
        "newton_euler/equations/test_systems.py",
    ),
    "accelerations of coordinates without their velocity terms": (
        "newton_euler/equations/formulation.py",
        "gamma + np.array(accelerations)",
        "0.0 * gamma + np.array(accelerations)",
        "newton_euler/analysis/test_inverse_dynamics.py",
    ),
    "a sign in how velocities change along a coordinate": (
        "newton_euler/analysis/linearization.py",
        "on_v = -still[:, 2 * d : -1]",
        "on_v = still[:, 2 * d : -1]",
        "newton_euler/analysis/test_linearization.py",
    ),
    "a ball whose small rotations do not turn with it": (
        "newton_euler/analysis/linearization.py",
        "row[:d] -= (tilde(v[place])",
        "row[:d] -= 0.0 * (tilde(v[place])",
        "newton_euler/analysis/test_linearization.py",
    ),
    "a center of pressure behind the plate's center": (
        "newton_euler/model/wind.py",
        "lead = (LEAD * 2.0 / math.pi)",
        "lead = -(LEAD * 2.0 / math.pi)",
        "newton_euler/equations/test_wind.py",
    ),
    "wind that does not know the motion of its plate": (
        "mjcf/model.py",
        "load.velocity(data.time) - velocity[3:]",
        "load.velocity(data.time) - 0.0 * velocity[3:]",
        "newton_euler/equations/test_systems.py",
    ),
    "products that fold a constant wrongly": (
        "newton_euler/codegen/expression.py",
        "return _scaled(self, x * known, second)",
        "return _scaled(self, x / known, second)",
        "newton_euler/codegen/test_expression.py",
    ),
    "a piece of rolled code that keeps too little": (
        "newton_euler/codegen/rolled.py",
        "used: set[int] = set(program.outputs)",
        "used: set[int] = set(program.outputs[1:])",
        "newton_euler/codegen/test_rolled.py",
    ),
    "rows of round-off taken for constraints": (
        "newton_euler/equations/independence.py",
        "ROUND_OFF = 1e-10",
        "ROUND_OFF = 1e-18",
        "newton_euler/equations/test_nearly_redundant.py::"
        "test_round_off_is_no_constraint_however_literally_others_are_taken",
    ),
    "a missing gyroscopic torque": (
        "newton_euler/equations/relative.py",
        "inertia @ alpha + cross(omega, inertia @ omega)",
        "inertia @ alpha",
        "newton_euler/equations/test_systems.py",
    ),
    "a missing gyroscopic torque in the paper's form": (
        "newton_euler/equations/cartesian.py",
        "return cross(omega, momentum)",
        "return 0.0 * cross(omega, momentum)",
        "newton_euler/equations/test_systems.py",
    ),
    "inertia left in the body's frame": (
        "newton_euler/equations/relative.py",
        "return a @ self.inertias[body] @ a.T",
        "return self.inertias[body]",
        "newton_euler/equations/test_systems.py",
    ),
    "inertia of a URDF in the wrong frame": (
        "urdf/write.py",
        "turned = rotation @ body.inertia @ rotation.T",
        "turned = rotation.T @ body.inertia @ rotation",
        "urdf/test_urdf_write.py",
    ),
    "a transposed rotation": (
        "newton_euler/model/euler_parameters.py",
        "return matrix_g(p) @ matrix_l(p).T",
        "return matrix_l(p) @ matrix_g(p).T",
        "newton_euler/model/test_euler_parameters.py",
    ),
    "MuJoCo's quaternions read w-last": (
        "mjcf/model.py",
        "self.data.xquat[bodies]",
        "np.roll(self.data.xquat[bodies], -1, axis=1)",
        "newton_euler/equations/test_systems.py",
    ),
    "Pinocchio's quaternions written w-first": (
        "urdf/model.py",
        "columns = np.roll(columns, -1)",
        "columns = np.roll(columns, 0)",
        "newton_euler/equations/test_systems.py",
    ),
    "Rerun's quaternions written w-first": (
        "crosscheck/recording/shapes.py",
        "return quaternion[..., [1, 2, 3, 0]]",
        "return quaternion",
        "crosscheck/recording/test_rerun_log.py",
    ),
    "positive feedback, erratum 2": (
        "newton_euler/model/control.py",
        "force = force - (k_p",
        "force = force + (k_p",
        "newton_euler/equations/test_systems.py",
    ),
    "Baumgarte's gains swapped, erratum 1": (
        "newton_euler/equations/formulation.py",
        "self.K_D, self.K_P = 2.0 * alpha, alpha * alpha",
        "self.K_P, self.K_D = 2.0 * alpha, alpha * alpha",
        "newton_euler/equations/test_formulations.py",
    ),
    "Euler parameters left to drift, erratum 11": (
        "newton_euler/equations/cartesian.py",
        "-self.c(qdot) - self.K_D * (P @ qdot) - self.K_P * self.norms(q)",
        "-self.c(qdot)",
        "newton_euler/equations/test_formulations.py",
    ),
    "reactions on the first body": (
        "newton_euler/equations/reactions.py",
        "sign = 1.0 if kept.forward else -1.0",
        "sign = -1.0 if kept.forward else 1.0",
        "newton_euler/equations/test_systems.py",
    ),
    "a slide before skew hinges with the wrong sign in gamma": (
        "newton_euler/model/hinge_angles.py",
        "gamma = gamma - self._spare(first, second) @",
        "gamma = gamma + self._spare(first, second) @",
        "newton_euler/equations/test_systems.py",
    ),
    "a coupling's acceleration with the wrong sign": (
        "newton_euler/equations/couplings.py",
        "self.function.acceleration(time) if self.function else 0.0",
        "-self.function.acceleration(time) if self.function else 0.0",
        "newton_euler/equations/test_couplings.py",
    ),
    "a point spring that pushes when it is long": (
        "newton_euler/model/forces.py",
        "tension = self.stiffness * (length - self.rest_length)",
        "tension = self.stiffness * (self.rest_length - length)",
        "newton_euler/equations/test_forces.py",
    ),
    "stages at a singular configuration": (
        "newton_euler/integrators/dop853.py",
        "if near == 1 and hops < HOPS:",
        "if near == 1 and hops < 0:",
        "crosscheck/scenes/test_scene_families.py",
    ),
    "weak constraints that correct velocities": (
        "newton_euler/integrators/singular.py",
        "WEAK = 3e-5",
        "WEAK = 0.0",
        "crosscheck/scenes/test_scene_families.py",
    ),
    "turns that are never taken off": (
        "newton_euler/integrators/stepper.py",
        "if system.marks[i] == ANGLE and abs(x[i]) > pi:",
        "if system.marks[i] < 0.0 and abs(x[i]) > pi:",
        "newton_euler/integrators/test_integrate.py",
    ),
    "no look between the nodes of Radau": (
        "newton_euler/integrators/radau.py",
        "error = max(error, error_within(",
        "error = max(error, 0.0 * error_within(",
        "newton_euler/integrators/test_radau.py",
    ),
    "an own error that excuses anything": (
        "crosscheck/comparison/runs.py",
        "min(OWN_ERROR * own_change(engine, apart), UNRESOLVED * unit)",
        "OWN_ERROR * own_change(engine, apart)",
        "crosscheck/comparison/test_unsettled.py",
    ),
    "a residual of energy in J under the heading of a share": (
        "crosscheck/comparison/runs.py",
        "value / shown,",
        "value,",
        "crosscheck/comparison/test_compare.py::test_mechanisms_agree",
    ),
    "the engine that is near blamed for the one that is far": (
        "crosscheck/comparison/diagnosis.py",
        "all(_is_nearer(other, odd, third, parted[0], rows) for third in between)",
        "all(_is_nearer(odd, other, third, parted[0], rows) for third in between)",
        "crosscheck/comparison/test_diagnosis.py::test_one_of_two_is_odd_that_is_far_from_a_third_whose_tolerance_is_wide",
    ),
    "a figure that is not a number agrees": (
        "crosscheck/comparison/figure.py",
        "bool(self.value <= self.tolerance)",
        "not self.value > self.tolerance",
        "crosscheck/comparison/test_compare.py::test_a_figure_that_informs_is_not_judged",
    ),
    "an error of one part of a comparison swallowed": (
        "crosscheck/comparison/figure.py",
        "    if errors:\n        raise errors[0]",
        "    if len(errors) > 1:\n        raise errors[0]",
        "newton_euler/integrators/test_stopped.py::test_figures_that_need_no_finer_run_are_had_without_it",
    ),
    "drift that is told of the joint before": (
        "newton_euler/integrators/projection.py",
        "owner = row_owners(mechanism.equations, coupled)[worst]",
        "owner = row_owners(mechanism.equations, coupled)[worst - 1]",
        "newton_euler/integrators/test_singular.py::test_the_joint_that_has_come_open_is_named",
    ),
    "coverage that counts elements twice": (
        "crosscheck/comparison/coverage.py",
        "found = tuple(elements(scene))",
        "found = 2 * tuple(elements(scene))",
        "crosscheck/comparison/test_coverage.py::test_joints_that_do_not_move_are_untested",
    ),
    "joints of two models compared by residuals alone": (
        "crosscheck/against/levels.py",
        "if (joint := equations.joint.name) in alike:",
        "if (joint := equations.joint.name) in ():",
        "crosscheck/comparison/test_against.py::test_a_ball_at_another_point_is_another_joint_though_all_moves_alike",
    ),
    "a baseline compared with itself": (
        "crosscheck/regress/compare.py",
        "_check(figure, now.get(figure.name), problem)",
        "_check(figure, figure, problem)",
        "crosscheck/test_regress.py::test_a_figure_moves_where_it_leaves_its_tolerance",
    ),
    "a stale result read back": (
        "crosscheck/report/page.py",
        "if results.files[path.name] != digest(path):",
        "if not digest(path):",
        "crosscheck/test_hostile_results.py::test_a_damaged_run_is_refused",
    ),
    "a damaged entry of the cache taken for code": (
        "newton_euler/codegen/cache.py",
        "return code if _digest(key, code) == digest else None",
        "return code if digest else None",
        "newton_euler/codegen/test_compile.py::test_a_truncated_file_is_not_trusted",
    ),
    "the program of a scene with other numbers": (
        "newton_euler/codegen/fingerprint.py",
        "yield value.tobytes()",
        "yield b''",
        "newton_euler/codegen/test_fingerprint.py::test_whatever_changes_the_equations_changes_it",
    ),
    "the code of the same scene with other gains": (
        "newton_euler/simulate.py",
        "_compiled(scene, formulation, stabilization, baumgarte_alpha(stabilization, alpha))",
        '_compiled(scene, formulation, "projection", 0.0)',
        "newton_euler/integrators/test_simulate.py::test_drift_is_bounded_with_baumgarte_and_grows_without",
    ),
    "outputs at the time of the first of several rows": (
        "newton_euler/integrators/outputs.py",
        "taken[lanes * n] = rows.times[source]",
        "taken[lanes * n] = rows.times[row]",
        "newton_euler/equations/test_driven_control.py::test_newton_euler",
    ),
    "one row too many of a run that stopped": (
        "newton_euler/simulate.py",
        "stopped or error, int(np.searchsorted(scene.times, error.time))",
        "stopped or error, 1 + int(np.searchsorted(scene.times, error.time))",
        "newton_euler/integrators/test_stopped.py::test_outputs_that_no_double_holds_end_a_run_too",
    ),
    "a warning swallowed": (
        "newton_euler/simulate.py",
        "for weak in self.nearly_redundant:",
        "for weak in self.nearly_redundant[1:]:",
        "newton_euler/equations/test_nearly_redundant.py::test_taken_literally_the_mechanism_is_locked_and_says_so",
    ),
    "a setting of a limit that does not suffice": (
        "newton_euler/limits.py",
        "math.ceil(value)",
        "math.floor(value)",
        "newton_euler/model/test_limits.py::test_limits_are_changed_for_a_while_and_in_processes_that_are_started",
    ),
    "quaternions that change their sign": (
        "newton_euler/model/euler_parameters.py",
        "if np.any(dots < 0.0):",
        "if np.all(dots < 0.0):",
        "newton_euler/model/test_euler_parameters.py",
    ),
    "an angle of the long way round": (
        "newton_euler/model/euler_parameters.py",
        "np.abs(relative[0])",
        "relative[0]",
        "newton_euler/model/test_euler_parameters.py",
    ),
    "a kinetic energy without rotors": (
        "newton_euler/equations/formulation.py",
        "kinetic + rotors_energy(self.scene, at)",
        "kinetic",
        "newton_euler/equations/test_armature.py::test_a_mass_on_a_spring_swings_slower_and_keeps_its_energy",
    ),
    "the energy of a spring twice": (
        "newton_euler/model/forces.py",
        "0.5 * self.stiffness * ((x - self.rest) * (x - self.rest))",
        "self.stiffness * ((x - self.rest) * (x - self.rest))",
        "newton_euler/equations/test_forces.py::test_a_mass_on_a_spring_oscillates_about_where_it_would_hang",
    ),
    "splines held for a piece too long": (
        "newton_euler/model/splines.py",
        "return self._pieces[bisect_right(self.knots, time + ROUND_OFF * abs(time))]",
        "return self._pieces[max(bisect_right(self.knots, time + ROUND_OFF * abs(time)) - 1, 0)]",
        "newton_euler/integrators/test_knots.py::test_a_spline_is_the_one_of_scipy_and_smooth_at_its_knots",
    ),
    "set-points that jump an interval early": (
        "newton_euler/sampling.py",
        "return float(0.5 * (self.times[0] + self.times[-1]))",
        "return float(self.times[-1])",
        "newton_euler/integrators/test_knots.py::test_targets_jump",
    ),
    "a boat that rolls before it yaws": (
        "newton_euler/moving_base.py",
        'HINGES = {"yaw": Z, "pitch": Y, "roll": X}',
        'HINGES = {"roll": X, "pitch": Y, "yaw": Z}',
        "newton_euler/test_moving_base.py::test_poses_of_a_file_are_those_of_the_motion",
    ),
    "a boat that starts without its spin": (
        "newton_euler/moving_base.py",
        "velocity + np.cross(omega, arms) + own_velocities",
        "velocity + own_velocities",
        "newton_euler/test_moving_base.py::test_the_base_follows_its_motions_and_carries_the_start",
    ),
    "prescribed motions that do no work": (
        "newton_euler/equations/formulation.py",
        "return total - sum(rate * multipliers",
        "return total - 0.0 * sum(rate * multipliers",
        "newton_euler/test_elements.py::test_runs_of_pinocchio",
    ),
    "revolutions counted backwards": (
        "newton_euler/equations/formulation.py",
        "q[self.angles[key]] += angle",
        "q[self.angles[key]] -= angle",
        "newton_euler/equations/test_revolutions.py",
    ),
    "a held force that outlives its run": (
        "newton_euler/sampling.py",
        "changed = copy.copy(system)",
        "changed = system",
        "newton_euler/integrators/test_sampled.py::test_a_run_leaves_the_system_as_it_was",
    ),
    "a batch whose runs start from the first state": (
        "newton_euler/batch.py",
        "own(starts[k])",
        "own(starts[0])",
        "newton_euler/test_batch.py::test_runs_are_those_one_by_one",
    ),
    "a JUnit file without failures": (
        "crosscheck/report/render.py",
        'failed = sum(any(cell.verdict == "fails" for cell in row) for _, row in rows)',
        "failed = 0",
        "crosscheck/report/test_render.py",
    ),
    "a unit lost from a heading": (
        "crosscheck/report/table.py",
        'return f"{self.name}, {self.unit}" if self.unit else self.name',
        "return self.name",
        "crosscheck/report/test_render.py",
    ),
    "an element left out that is reported as carried over": (
        "newton_euler/verification/import_report.py",
        'self.entries.append(ImportedElement(element, "left out", why, "", topic, inert))',
        'self.entries.append(ImportedElement(element, "exactly", why, "", topic, inert))',
        "mjcf/test_mjcf_read.py::test_what_is_left_out_and_what_is_approximated",
    ),
    "a file that is written in its place": (
        "newton_euler/model/trajectory.py",
        "        temporary.replace(target)\n",
        "        target.write_bytes(temporary.read_bytes())\n",
        "newton_euler/model/test_scene.py::test_a_file_appears_whole_or_not_at_all",
    ),
    "a mimic joint that turns the other way": (
        "urdf/reading/start.py",
        "(mimic.driver, -mimic.multiplier)",
        "(mimic.driver, mimic.multiplier)",
        "urdf/test_urdf_read.py::test_mimics_start_at_their_offsets_with_their_drivers_at_zero",
    ),
    "a run that is not finished and counts as agreement": (
        "crosscheck/cli/run.py",
        "return UNFINISHED  #",
        "return AGREE  #",
        "newton_euler/integrators/test_stopped.py::test_crosscheck_run_compares_what_each_engine_computed",
    ),
    "a tolerance of trajectories without the mechanism's reach": (
        "crosscheck/comparison/runs.py",
        "value, tolerance = float(np.max(gaps)), fixed * unit",
        "value, tolerance = float(np.max(gaps)), fixed",
        "crosscheck/comparison/test_unsettled.py::"
        "test_lengths_are_held_to_the_reach_of_the_mechanism_and_angles_to_a_radian",
    ),
    "the joint that is least open blamed": (
        "crosscheck/comparison/blame.py",
        "return mechanism.joint_names[int(np.argmax(openings))]",
        "return mechanism.joint_names[int(np.argmin(openings))]",
        "crosscheck/comparison/test_blame.py",
    ),
    "a limit that is not checked": (
        "crosscheck/scenes/size.py",
        '{"terms": terms, "cycles": cycles, "knots": knots}',
        '{"cycles": cycles, "knots": knots}',
        "crosscheck/scenes/test_size.py",
    ),
    "a unit lost from a known figure": (
        "crosscheck/report/run.py",
        'f"{first.known.quantity}, {first.known.unit}"',
        "first.known.quantity",
        "crosscheck/report/test_run_tables.py",
    ),
    "a reference value in the column of what was found": (
        "crosscheck/report/run.py",
        'f"{first.result:.12g}"',
        'f"{first.known.value:.12g}"',
        "crosscheck/report/test_run_tables.py",
    ),
}
"""File, what is there, what is made of it, and the tests that see it: a file or a function."""


def copy_source(folder):
    for name in (*PACKAGES, "tests", "examples", "docs"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def run_tests(folder, *tests):
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    command += [f"tests/{each}" for each in tests]
    # the copy comes first on the path, before an installed project
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_noticed(tmp_path, mistake):
    source, right, wrong, tests = MISTAKES[mistake]
    folder = copy_source(tmp_path / "project")
    text = (folder / source).read_text()
    assert text.count(right) == 1, "the line to break has changed"
    (folder / source).write_text(text.replace(right, wrong))
    done = run_tests(folder, tests)
    assert done.returncode == 1 or done.returncode < 0, done.stdout[-2000:]  # failed, or broke down


@pytest.mark.slow
def test_the_copy_passes_when_nothing_is_broken(tmp_path):
    done = run_tests(
        copy_source(tmp_path / "project"), *sorted({mistake[3] for mistake in MISTAKES.values()})
    )
    assert done.returncode == 0, done.stdout[-2000:]
