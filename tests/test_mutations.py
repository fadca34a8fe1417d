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
        "newton_euler/equations/test_formulations.py",
    ),
    "swapped hinges of a universal joint in the tree": (
        "newton_euler/model/joint_kinds.py",
        'Motion("hinge", self.axis_on_first), Motion("hinge", self.axis_on_second)',
        'Motion("hinge", self.axis_on_second), Motion("hinge", self.axis_on_first)',
        "newton_euler/equations/test_formulations.py",
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
        "newton_euler/equations/test_formulations.py",
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
        "newton_euler/equations/test_nearly_redundant.py",
    ),
    "a missing gyroscopic torque": (
        "newton_euler/equations/relative.py",
        "inertia @ alpha + cross(omega, inertia @ omega)",
        "inertia @ alpha",
        "newton_euler/equations/test_formulations.py",
    ),
    "a missing gyroscopic torque in the paper's form": (
        "newton_euler/equations/cartesian.py",
        "return cross(omega, momentum)",
        "return 0.0 * cross(omega, momentum)",
        "newton_euler/equations/test_formulations.py",
    ),
    "inertia left in the body's frame": (
        "newton_euler/equations/relative.py",
        "return a @ self.inertias[body] @ a.T",
        "return self.inertias[body]",
        "newton_euler/equations/test_formulations.py",
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
        "mjcf/test_mjcf_rigid.py",
    ),
    "Pinocchio's quaternions written w-first": (
        "urdf/model.py",
        "columns = np.roll(columns, -1)",
        "columns = np.roll(columns, 0)",
        "urdf/test_urdf_dynamics.py",
    ),
    "Rerun's quaternions written w-first": (
        "crosscheck/recording/shapes.py",
        "return quaternion[..., [1, 2, 3, 0]]",
        "return quaternion",
        "crosscheck/recording/test_rerun_log.py",
    ),
    "positive feedback, erratum 2": (
        "newton_euler/model/control.py",
        "return self.feedforward_at(time) - (self.stiffness",
        "return self.feedforward_at(time) + (self.stiffness",
        "newton_euler/equations/test_formulations.py",
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
        "newton_euler/equations/test_formulations.py",
    ),
    "a coupling's acceleration with the wrong sign": (
        "newton_euler/equations/couplings.py",
        "self.function.acceleration(time) if self.function else 0.0",
        "-self.function.acceleration(time) if self.function else 0.0",
        "newton_euler/equations/test_couplings.py",
    ),
    "a point spring that pushes when it is long": (
        "newton_euler/model/forces.py",
        "tension = spring.stiffness * (length - spring.rest_length)",
        "tension = spring.stiffness * (spring.rest_length - length)",
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
}


def copy_source(folder):
    for name in (*PACKAGES, "tests", "examples", "docs"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def run_tests(folder, file):
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", f"tests/{file}"]
    # the copy comes first on the path, before an installed project
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_noticed(tmp_path, mistake):
    source, right, wrong, file = MISTAKES[mistake]
    folder = copy_source(tmp_path / "project")
    text = (folder / source).read_text()
    assert text.count(right) == 1, "the line to break has changed"
    (folder / source).write_text(text.replace(right, wrong))
    done = run_tests(folder, file)
    assert done.returncode == 1, done.stdout[-2000:]  # 1: tests ran and failed


@pytest.mark.slow
@pytest.mark.parametrize("file", sorted({mistake[3] for mistake in MISTAKES.values()}))
def test_the_copy_passes_when_nothing_is_broken(tmp_path, file):
    done = run_tests(copy_source(tmp_path / "project"), file)
    assert done.returncode == 0, done.stdout[-2000:]
