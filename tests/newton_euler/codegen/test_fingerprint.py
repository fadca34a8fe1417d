"""Fingerprints of scenes: the same in every process, another for whatever changes the equations."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import newton_euler
import newton_euler.equations.relative
from crosscheck.library import SCENES, load
from newton_euler.codegen.cache import CACHE_VARIABLE
from newton_euler.codegen.fingerprint import PACKAGE, fingerprint
from newton_euler.compiled.equations import NOT_COMPILED_FIELDS, CompiledEquations
from newton_euler.model.digital_control import Sampled
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.smooth_functions import Sine

HEAVIER = 1.0 + 2.0**-52


def with_body(scene, **changes):
    ground, first, *others = scene.mechanism.bodies
    bodies = [ground, replace(first, **changes), *others]
    return replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints, scene.mechanism.couplings))


@pytest.fixture(scope="module")
def tracker():
    return load("tracker")


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_of_the_library_has_one(name):
    assert fingerprint(load(name), neutral=NOT_COMPILED_FIELDS) is not None


@pytest.mark.slow
def test_it_is_the_same_in_every_process(tracker):
    code = "from crosscheck.library import load; from newton_euler.codegen.fingerprint import fingerprint; "
    code += "print(fingerprint(load('tracker'), 'relative', 0.5))"
    expected = fingerprint(tracker, "relative", 0.5)
    for seed in ("1", "2"):  # of the order of sets of text
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONHASHSEED": seed},
            cwd=Path(__file__).parents[3],
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.strip() == expected


def test_the_equations_are_part_of_the_source():
    assert Path(newton_euler.equations.relative.__file__).is_relative_to(PACKAGE)


CHANGES = {
    "mass": lambda s: with_body(s, mass=s.mechanism.bodies[1].mass * HEAVIER),
    "inertia": lambda s: with_body(s, inertia=s.mechanism.bodies[1].inertia * HEAVIER),
    "gravity": lambda s: replace(s, gravity=(0.0, 0.0, -9.81)),
    "gain": lambda s: replace(
        s, control=(replace(s.control[0], stiffness=s.control[0].stiffness * HEAVIER), *s.control[1:])
    ),
    "outputs": lambda s: replace(s, outputs=frozenset({"energy"})),
    "motion": lambda s: replace(
        s,
        control=s.control[1:],
        motions=(PrescribedMotion(s.control[0].joint, Sine(0.1, 1.0)),),
        initial_state=None,
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_whatever_changes_the_equations_changes_it(tracker, change):
    assert fingerprint(CHANGES[change](tracker)) not in (None, fingerprint(tracker))


def test_what_is_known_of_a_mechanism_cannot_change(tracker):
    with pytest.raises(ValueError, match="read-only"):
        tracker.mechanism.joints[0].point[0] = 1.0
    with pytest.raises(AttributeError, match="joints of a mechanism cannot be changed"):
        tracker.mechanism.joints = ()


def test_what_no_equation_sees_does_not(tracker):
    same = replace(tracker, duration=1.0, output_period=0.1, description="another")
    assert fingerprint(same, neutral=NOT_COMPILED_FIELDS) == fingerprint(tracker, neutral=NOT_COMPILED_FIELDS)


def test_controllers_are_called_and_never_compiled(tracker):
    def held(controller):
        law = Sampled(tracker.control[0].joint, controller, 0.1)
        return replace(tracker, control=(law,))

    one, other = (fingerprint(held(lambda *_, x=x: x), neutral=NOT_COMPILED_FIELDS) for x in (0.0, 1.0))
    assert one == other is not None


@dataclass(frozen=True)
class Ramp:
    """A function of time of the user's own."""

    slope: float


def test_what_others_define_has_none(tracker):
    assert fingerprint(tracker, Ramp(1.0)) is None
    assert fingerprint(np.array([Ramp(1.0)])) is None


def test_a_scene_known_from_another_run_is_not_traced(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    scene = replace(load("slider_crank"), duration=0.05)
    first = newton_euler.simulate(scene)

    def untraceable(self, name):
        raise AssertionError(name)

    with monkeypatch.context() as patch:
        patch.setattr(CompiledEquations, "_trace", untraceable)
        again = newton_euler.simulate(replace(scene))
    for name, array in first.arrays().items():
        assert np.array_equal(array, again.arrays()[name]), name


def test_the_same_scene_simulated_again_is_not_loaded_again(monkeypatch):
    scene = replace(load("pendulum"), duration=0.05)
    first = newton_euler.simulate(scene)
    monkeypatch.setattr(CompiledEquations, "__init__", None)
    again = newton_euler.simulate(scene)
    assert np.array_equal(again.position, first.position)
    fixed = newton_euler.simulate(scene, integrator="RK4", step=0.01)
    assert fixed.position.shape == first.position.shape
