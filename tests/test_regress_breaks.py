"""`crosscheck regress` is quiet while nothing changes, also under load, and notices small breaks."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest
from test_mutations import copy_source

SCENES = ("pendulum", "free_top")
"""Quick ones; one has constraints and gravity, the other turns about all axes."""

RUNS = 10

BREAKS = {
    "a gyroscopic torque off by 1e-6": (
        "newton_euler/equations/relative.py",
        "inertia @ alpha + cross(omega, inertia @ omega)",
        "inertia @ alpha + (1.0 + 1e-6) * cross(omega, inertia @ omega)",
        "free_top",
    ),
    "a gyroscopic torque of the paper's form off by 1e-6": (
        "newton_euler/equations/cartesian.py",
        "return cross(omega, momentum)",
        "return (1.0 + 1e-6) * cross(omega, momentum)",
        "free_top",
    ),
    "a centripetal acceleration off by 1e-6": (
        "newton_euler/equations/kinematics.py",
        "cross(alpha, s) + cross(omega, turning)",
        "cross(alpha, s) + (1.0 + 1e-6) * cross(omega, turning)",
        "pendulum",
    ),
    "gamma off by 1e-6": (
        "newton_euler/model/constraints.py",
        "return cross(omega, cross(omega, s))",
        "return (1.0 + 1e-6) * cross(omega, cross(omega, s))",
        "pendulum",
    ),
    "gamma dropped": (
        "newton_euler/model/constraints.py",
        "return cross(omega, cross(omega, s))",
        "return 0.0 * cross(omega, cross(omega, s))",
        "pendulum",
    ),
    "inertia turned the wrong way": (
        "newton_euler/equations/relative.py",
        "return a @ self.inertias[body] @ a.T",
        "return a.T @ self.inertias[body] @ a",
        "free_top",
    ),
    "gravity off by 1e-7": (
        "crosscheck/scenes/pendulum.py",
        "GRAVITY = np.array([0.0, -9.81, 0.0])",
        "GRAVITY = np.array([0.0, -9.810001, 0.0])",
        "pendulum",
    ),
    "a gain of Baumgarte's off by 1e-6": (
        "newton_euler/equations/formulation.py",
        "self.K_D, self.K_P = 2.0 * alpha, alpha * alpha",
        "self.K_D, self.K_P = 2.000002 * alpha, alpha * alpha",
        "pendulum",
    ),
    "the tenth digit of a coefficient of DOP853": (
        "newton_euler/integrators/dop853_tableau.py",
        "27.94888452941996",
        "27.94888453941996",
        "pendulum",
    ),
    "the tenth digit of a coefficient of the dense output": (
        "newton_euler/integrators/dop853_tableau.py",
        "-25.69393346270375",
        "-25.69393347270375",
        "pendulum",
    ),
    "a weight of RK4 off by 2e-7": (
        "newton_euler/integrators/fixed_step.py",
        "weight = h / 6.0 if",
        "weight = h / 6.000001 if",
        "pendulum",
    ),
    "a projection that leaves joints open by 1e-6": (
        "newton_euler/integrators/dense_projection.py",
        "ROUND_OFF = 16.0 * np.finfo(float).eps",
        "ROUND_OFF = 1e-6",
        "pendulum",
    ),
}
"""File, what is there, what is made of it, and the scene that sees it."""


def regress(folder, *arguments):
    # the copy comes first on the path, before an installed project
    environment = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "crosscheck", "regress", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """A copy of the source with baselines made from it."""
    folder = copy_source(tmp_path_factory.mktemp("unbroken") / "project")
    done = regress(folder, *SCENES, "--update", "test")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("broken", BREAKS)
def test_a_break_is_noticed(tmp_path, unbroken, broken):
    source, right, wrong, scene = BREAKS[broken]
    folder = tmp_path / "project"
    shutil.copytree(unbroken, folder)
    text = (folder / source).read_text()
    assert text.count(right) == 1, "the line to break has changed"
    (folder / source).write_text(text.replace(right, wrong))
    done = regress(folder, scene)
    assert done.returncode == 1, done.stdout + done.stderr
    assert f"{scene}: MOVED" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("busy", [0, 2 * (os.cpu_count() or 1)])
def test_repeated_runs_are_quiet(unbroken, busy):
    load = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
    try:
        for _ in range(RUNS):
            done = regress(unbroken, *SCENES)
            assert done.returncode == 0, done.stdout + done.stderr
    finally:
        for process in load:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_the_library_is_as_its_baselines_say(tmp_path):
    done = regress(copy_source(tmp_path / "project"))
    assert done.returncode == 0, done.stdout + done.stderr
