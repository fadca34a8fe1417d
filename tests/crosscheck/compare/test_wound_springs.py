"""Springs wound by more than half a revolution in comparisons of engines and of models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mjcf
from crosscheck import diff
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.registry import ENGINES
from crosscheck.regress.baseline import StoredState
from newton_euler import (
    Body,
    JointSpring,
    Mechanism,
    PrescribedMotion,
    Revolute,
    Scene,
    Sine,
    initial_state,
    simulate,
    start,
)
from newton_euler.reading.activity import SampledMotion

K, WOUND = 0.3, 20.0  # N m/rad and rad
KEY = ("hinge", 0)


def swing(sense: float = 1.0, angle: float = 0.0, **more) -> Scene:
    """A rod that hangs off its axis with a torsion spring, described where it is turned by an angle."""
    center, rest = 0.1 * np.array([np.cos(angle), np.sin(angle), 0.0]), -sense * angle
    rod = Body("rod", 1.0, center, np.diag([0.01, 0.01, 0.02]))
    hinge = Revolute("hinge", "ground", "rod", [0.0, 0.0, 0.0], axis=[0.0, 0.0, sense])
    mechanism = Mechanism([Body.ground(), rod], [hinge])
    spring = JointSpring("hinge", stiffness=K, rest=rest)
    return Scene("wound", mechanism, 0.5, 0.05, (0.0, -9.81, 0.0), forces=[spring], **more)


@pytest.fixture(scope="module")
def wound() -> Scene:
    return start(swing(), hinge=(WOUND, 1.0))


def test_all_engines_have_the_wound_spring_in_equations_and_runs(wound: Scene) -> None:
    result = crosscheck(wound, list(ENGINES.values()), lambda _: None, "wound", {})
    assert result.agrees
    height = 0.1 * np.sin(WOUND)
    for engine in ENGINES.values():
        (first,) = (
            Samples(system, States(wound, (initial_state(wound),))).evaluations[0]
            for system in engine.systems(wound)[:1]
        )
        exact = 0.5 * K * WOUND**2 + 9.81 * height
        assert first.potential_energy == pytest.approx(exact, rel=1e-12)
        torque = -K * WOUND - 9.81 * 0.1 * np.cos(WOUND)
        assert first.angular_acceleration[1, 2] == pytest.approx(torque / 0.03, rel=1e-10)


def test_a_model_that_counts_the_other_way_is_the_same(wound) -> None:
    assert diff(wound, start(swing(-1.0), hinge=(-WOUND, -1.0))).outcome is Outcome.SAME


def test_a_written_model_is_wound_in_mujoco(wound: Scene, tmp_path) -> None:
    mjcf.write(wound, tmp_path / "wound.xml")
    read = mjcf.read(tmp_path / "wound.xml", duration=0.5, output_period=0.05).scene
    run, again = simulate(wound), simulate(read)
    assert np.allclose(again.position, run.position, rtol=0.0, atol=1e-7)
    assert again.potential_energy[0] == pytest.approx(run.potential_energy[0], rel=1e-12)


def test_stored_states_keep_revolutions(wound: Scene) -> None:
    stored = StoredState.of(initial_state(wound))
    assert StoredState.model_validate_json(stored.model_dump_json()).state().angles == {KEY: WOUND}


def test_activity_is_judged_by_the_angle_of_the_run() -> None:
    """Outputs every 0.5 s of x = 20 sin(3 t)."""
    motion = PrescribedMotion("hinge", Sine(20.0, 3.0))
    scene = replace(swing(motions=[motion]), duration=3.0, output_period=0.5)
    run = simulate(scene)
    x, rate, _ = SampledMotion(scene, run).coordinate(KEY)
    shown = np.isin(SampledMotion(scene, run).time, run.time)
    assert np.allclose(x[shown], 20.0 * np.sin(3.0 * run.time), rtol=0.0, atol=1e-10)
    assert np.allclose(rate[shown], 60.0 * np.cos(3.0 * run.time), rtol=0.0, atol=1e-9)
