"""Advice on redundant constraints: it appears where it is due, and it works."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mechanisms import GRAVITY, ball_loop, pendulum, planar_four_bar

import mjcf
import newton_euler
from crosscheck.compare.advice import Advice, redundancy_advice
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.runs import nothing_moves_in_rigid_runs
from crosscheck.engines.registry import ENGINES, choose
from crosscheck.report.render import terminal
from crosscheck.report.table import Lines
from newton_euler.equations.relative import Relative
from newton_euler.equations.undetermined import undetermined_joints
from newton_euler.errors import NewtonEulerError
from newton_euler.model.joint_kinds import Cylindrical, Fixed, Spherical
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state


@pytest.fixture(scope="module")
def loop() -> Scene:
    return replace(planar_four_bar(), duration=1.0, output_period=0.05, gravity=GRAVITY, initial_state=None)


def only(pieces: Any) -> Advice:
    (advice,) = pieces
    return advice


SOFTER: dict[str, Callable[..., Any]] = {"cylindrical": Cylindrical, "spherical": Spherical}


def test_what_is_redundant_can_be_replaced_as_advised(loop: Scene) -> None:
    advice = only(redundancy_advice(loop))
    assert advice.text.startswith("3 redundant constraints")
    assert advice.text.endswith("then all reactions are determined")
    joints = {joint.name: joint for joint in loop.mechanism.joints}
    changes = re.findall(r"a (\w+) joint for the (?:\w+) '(\w+)'", advice.text)
    assert changes
    for kind, name in changes:
        joint: Any = joints[name]
        axis = {"axis": joint.axis} if kind == "cylindrical" else {}
        joints[name] = SOFTER[kind](name, joint.first, joint.second, joint.point, **axis)
    changed = replace(loop, mechanism=Mechanism(loop.mechanism.bodies, joints.values()), initial_state=None)
    assert undetermined_joints(changed, initial_state(changed)) == (0, [])
    one, two = (
        system.evaluate(*system.coordinates(initial_state(scene))).linear_acceleration
        for scene, system in ((scene, Relative(scene)) for scene in (loop, changed))
    )
    assert one == pytest.approx(two, abs=1e-12 * np.max(np.abs(one)))  # round-off: it moves as it did


LINKAGE = Path(__file__).parents[3] / "examples" / "linkage.xml"


def test_a_redundant_closure_is_left_out_and_a_driven_joint_slides(tmp_path: Path) -> None:
    """A user's file with a loop closed twice, changed as advised: joints with forces keep their hinges."""
    closure = '<connect name="loop" site1="coupler_end" site2="rocker_end"/>'
    twice = LINKAGE.read_text().replace(closure, closure + closure.replace("loop", "spare"))
    (tmp_path / "twice.xml").write_text(twice)
    scene = mjcf.read(tmp_path / "twice.xml").scene
    assert undetermined_joints(scene, initial_state(scene))[0] == 4
    advice = only(redundancy_advice(scene))
    assert advice.text == (
        "4 redundant constraints; the motion is the same with joint 'loop' left out, a cylindrical "
        "joint for the revolute 'elbow': then all reactions are determined"
    )
    once = twice.replace(closure, "")
    sliding = once.replace('<joint name="elbow"/>', '<joint name="elbow"/><joint type="slide" damping="0"/>')
    for text, rows in ((once, 1), (sliding, 0)):
        (tmp_path / "changed.xml").write_text(text)
        changed = mjcf.read(tmp_path / "changed.xml").scene
        assert undetermined_joints(changed, initial_state(changed))[0] == rows
        one, two = (
            system.evaluate(*system.coordinates(initial_state(s))).linear_acceleration
            for s, system in ((s, Relative(s)) for s in (scene, changed))
        )
        assert one == pytest.approx(two, abs=1e-12 * np.max(np.abs(one)))  # round-off: it moves as it did


def test_nothing_is_redundant_in_a_loop_of_balls() -> None:
    assert not list(redundancy_advice(ball_loop()))


def test_a_run_in_which_nothing_moves_is_called_so_and_teaches_nothing() -> None:
    from crosscheck.report.run import notes, report

    engines = choose(["newton_euler", "mujoco"])
    loop = replace(planar_four_bar(), duration=0.1, output_period=0.05)
    resting = replace(loop, gravity=np.zeros(3), initial_state=None)
    result = crosscheck(resting, engines, lambda _: None, "a_scene", {}, advised=True)
    assert result.nothing_moves
    assert result.outcome.passes()
    assert result.verdict.endswith("checks; nothing moves; motion covers 0 of 10 elements")
    assert [advice.topic for advice in result.advice] == ["redundancy"]  # of the equations, not the run
    (line,) = (line for line in notes(result) if line.startswith("nothing moves"))
    assert "it starts at rest in equilibrium" in line
    assert "runs test nothing" in line
    assert line in terminal(report(result).parts)

    # one engine that stands still where another moves has not said that nothing does
    falling = newton_euler.simulate(replace(loop, gravity=GRAVITY))
    both = {"newton_euler": result.trajectories["newton_euler"], "pinocchio": falling}
    assert not nothing_moves_in_rigid_runs(resting, choose(list(both)), both)

    moving = crosscheck(loop, engines, lambda _: None, "a_scene", {})
    assert not moving.nothing_moves
    assert "nothing moves" not in "\n".join([moving.verdict, *notes(moving)])


def test_a_mechanism_without_freedom_is_called_so() -> None:
    from crosscheck.report.run import notes

    loop = replace(planar_four_bar(), duration=0.1, output_period=0.05, initial_state=None)
    crank = loop.mechanism.joints[0]
    stuck = Mechanism(
        loop.mechanism.bodies,
        [Fixed(crank.name, crank.first, crank.second, crank.point), *loop.mechanism.joints[1:]],
    )
    result = crosscheck(
        replace(loop, mechanism=stuck, gravity=GRAVITY),
        choose(["newton_euler", "mujoco"]),
        lambda _: None,
        "a_scene",
        {},
        advised=True,
    )
    (line,) = (line for line in notes(result) if line.startswith("nothing moves"))
    assert "the mechanism has no freedom" in line
    assert {advice.topic for advice in result.advice} <= {"redundancy"}


def test_an_engine_that_others_deserted_agrees_with_nobody() -> None:
    scene = replace(pendulum(), duration=0.1, output_period=0.05)

    def refuses(scene: Scene) -> Any:
        raise NewtonEulerError("not in this world")

    unable = [replace(ENGINES[name], systems=refuses) for name in ("mujoco", "pinocchio")]
    result = crosscheck(scene, [ENGINES["newton_euler"], *unable], lambda _: None, "a_scene", {})
    assert not result.agrees
    assert result.verdict.startswith(
        "NOT COMPARED: nothing could be compared on pendulum, ran newton_euler alone"
    )
    assert "; its own checks hold" in result.verdict
    assert "; mujoco left out: not in this world; pinocchio left out: not in this world; " in result.verdict
    asked = crosscheck(scene, [ENGINES["newton_euler"]], lambda _: None, "a_scene", {})
    assert asked.outcome is Outcome.ONE_ENGINE_ALONE
    assert asked.outcome.passes()
    assert not asked.agrees


def test_advice_is_in_reports(loop: Scene) -> None:
    from crosscheck.report.run import notes, report

    engines = choose(["newton_euler", "mujoco"])
    assert not crosscheck(loop, engines, lambda _: None, "a_scene", {}).advice  # unless asked for
    result = crosscheck(loop, engines, lambda _: None, "a_scene", {}, advised=True)
    topics = [advice.topic for advice in result.advice]
    assert topics == ["redundancy"]
    assert [entry["topic"] for entry in result.summary()["advice"]] == topics
    lines = [*notes(result), *(f"advice, {advice}" for advice in result.advice)]
    assert any(lines == part.lines for part in report(result).parts if isinstance(part, Lines))
