"""Public names of the four packages: what they are, the examples in their docstrings, and types of these."""

from __future__ import annotations

import doctest
import importlib
import os
import re
import shutil
import subprocess
import sys
import textwrap
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import crosscheck
import mjcf
import newton_euler
import urdf
from crosscheck.library import load
from newton_euler.analysis.identification.measurements import Measurements
from newton_euler.errors import UnknownNameError
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.runs.simulate import CompiledScene

PACKAGES = {name: importlib.import_module(name) for name in ("newton_euler", "mjcf", "urdf", "crosscheck")}

NAMES = [(package, name) for package, module in PACKAGES.items() for name in module.__all__]

IMPORTS = """
from dataclasses import replace
import numpy as np
import crosscheck, mjcf, newton_euler, urdf
from crosscheck import *
from crosscheck.library import load
from newton_euler import *
"""
"""What examples follow."""

TYPED = """
from typing import assert_type
from numpy.typing import NDArray

def known(run: Trajectory, body: Body, hinge: Revolute) -> None:
    assert_type(run.position, NDArray[np.float64])
    assert_type(run.joint("pivot").coordinates, NDArray[np.float64])
    assert_type(body.inertia, NDArray[np.float64])
    assert_type(hinge.point, NDArray[np.float64])
    swing = Scene("swing", Mechanism([body], [hinge]), 1, 0.1, forces=[JointSpring("hinge", damping=1)])
    assert_type(swing.motions, tuple[PrescribedMotion, ...])
    assert_type(simulate_batch(load("pendulum"))[0], Trajectory)
    assert_type(mjcf.read("arm.xml").scene, Scene)
    assert_type(urdf.read("arm.urdf").scene, Scene)
    assert_type(check("pendulum").trajectories["mujoco"], Trajectory)
    assert_type(tune("arm.xml").own.error.relative, float)

def refused(scene: Scene) -> None:
    newton_euler.simulat(scene)  # type: ignore[attr-defined]
    mjcf.reed("arm.xml")  # type: ignore[attr-defined]
    urdf.reed("arm.urdf")  # type: ignore[attr-defined]
    crosscheck.chek(scene)  # type: ignore[attr-defined]
    simulate(scene, "relativ")  # type: ignore[arg-type]
    simulate(scene, integrator="RK5")  # type: ignore[arg-type]
    simulate(scene, stabilization="glue")  # type: ignore[arg-type]
    simulate(scene, rtoll=1e-6)  # type: ignore[call-arg]
    mjcf.simulate(scene, integrator="RK5")  # type: ignore[arg-type]
    urdf.read("arm.urdf", base="floating")  # type: ignore[arg-type]
    replace(scene, outputs={"velocity"})  # type: ignore[arg-type]
    Revolute("hinge", "ground", "rod", 1.0j, axis=None)  # type: ignore[arg-type]
"""
"""Types that are known, and mistakes that are seen; an ignored error that is none would be one."""


def examples(package: str, name: str, names: dict[str, Any]) -> Iterator[doctest.DocTest]:
    """Those of a public name and of its methods that have some, in a namespace."""
    for found in doctest.DocTestFinder().find(getattr(PACKAGES[package], name), name, extraglobs=names):
        if found.examples:
            yield found


@pytest.mark.parametrize("module", PACKAGES.values(), ids=PACKAGES)
def test_packages_are_typed_and_have_what_they_list(module: ModuleType):
    assert Path(str(module.__file__)).with_name("py.typed").exists()
    for name in module.__all__:
        assert getattr(module, name).__module__ != module.__name__
    with pytest.raises(AttributeError, match="nothing_like_it"):
        _ = module.nothing_like_it


def test_all_joint_kinds_are_public():
    assert {kind.__name__ for kind in JOINT_KINDS.values()} <= set(newton_euler.__all__)


@pytest.mark.parametrize(("package", "name"), NAMES)
def test_names_are_documented_on_one_page(package: str, name: str):
    docs = Path(__file__).parents[1] / "docs" / "reference" / "python"
    found = re.compile(rf"^::: {package}\.(\w+\.)*{name}$", re.MULTILINE)
    assert sum(len(found.findall(page.read_text())) for page in docs.glob("*.md")) == 1


PENDULUM = load("pendulum")
SWING = Measurements([0.0, 1.0], {"coordinate.pivot": [0.0, 0.1]}, {"coordinate.pivot": 0.1})


@pytest.mark.parametrize(
    "call",
    [
        partial(newton_euler.simulate, PENDULUM),
        CompiledScene(PENDULUM).simulate,
        partial(newton_euler.simulate_batch, PENDULUM, parameters={"dumbbell.mass": [1.0]}),
        partial(newton_euler.sensitivities, PENDULUM, ["dumbbell.mass"]),
        partial(newton_euler.identify, PENDULUM, ["dumbbell.mass"], SWING),
        partial(urdf.simulate, PENDULUM),
        partial(mjcf.read, "arm.xml"),
        partial(urdf.read, "arm.urdf"),
        partial(crosscheck.sweep, "pendulum", {"dumbbell.mass": "normal(1, 0.1)"}, 8),
    ],
)
def test_unknown_options_are_named(call):
    with pytest.raises(UnknownNameError, match=r"unknown option 'nix'; choose from: [a-z]"):
        call(nix=1)


@pytest.mark.parametrize(("package", "name"), NAMES)
def test_docstrings_have_examples_that_run(package, name, tmp_path, monkeypatch):
    shutil.copytree(Path(__file__).parents[1] / "examples", tmp_path / "examples")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(IMPORTS, names)
    own, *of_methods = examples(package, name, names)
    assert own.name == name, "no example"
    assert any(re.search(rf"\b{name}\b", each.source) for each in own.examples), "of something else"
    said: list[str] = []
    with warnings.catch_warnings():
        failed = [doctest.DocTestRunner().run(each, out=said.append).failed for each in (own, *of_methods)]
    assert sum(failed) == 0, "".join(said)


@pytest.mark.slow  # 20 s; `make lint` checks the types of the packages
def test_examples_pass_strict_type_checks_where_the_packages_are_installed(tmp_path):
    """Each in a function of a script outside of the repository, from which mypy follows the installation."""
    script = IMPORTS + TYPED
    for package, name in NAMES:
        for found in examples(package, name, {}):
            body = textwrap.indent("".join(each.source for each in found.examples), "    ")
            script += f"\n\ndef {package}_{found.name.replace('.', '_')}() -> None:\n{body}"
    (tmp_path / "user_script.py").write_text(script)
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "user_script.py"]
    environment = os.environ | {"MYPYPATH": ""}
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=environment, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
