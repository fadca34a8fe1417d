"""Advice after a crosscheck: it appears where it is due, it follows from the figures, and it works."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mechanisms import GRAVITY, ball_loop, pendulum, planar_four_bar

import mjcf
import newton_euler
from crosscheck.compare.advice import WANTED_ERROR, Advice, redundancy_advice, rounded_step, soft_advice
from crosscheck.compare.check import Check
from crosscheck.compare.crosscheck import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.runs import nothing_moves_in_rigid_runs
from crosscheck.engines.engine import ENGINES, choose
from crosscheck.report.render import terminal
from crosscheck.report.table import Lines
from mjcf.write import SOLIMP
from newton_euler.equations.relative import Relative
from newton_euler.equations.undetermined import undetermined_joints
from newton_euler.errors import NewtonEulerError
from newton_euler.model.joint_kinds import Cylindrical, Fixed, Spherical
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory, distance
from newton_euler.runs.assemble import initial_state

AGREED = Check("model", "mass, rel", ("newton_euler", "mujoco"), 0.0, 1e-12, "bar")
MODEL_APART = replace(AGREED, value=1.0)
RUNS_APART = Check("trajectories", "positions, m", ("newton_euler", "mujoco"), 1.0, 1e-9, "bar at 1 s")


@pytest.fixture(scope="module")
def loop() -> Scene:
    return replace(planar_four_bar(), duration=1.0, output_period=0.05, gravity=GRAVITY, initial_state=None)


@pytest.fixture(scope="module")
def runs(loop: Scene) -> dict[str, Trajectory]:
    return {engine.name: engine.simulate(loop) for engine in choose(["newton_euler", "mujoco"])}


def softness(scene: Scene, runs: dict[str, Trajectory], *rows: Check) -> list[Advice]:
    return list(soft_advice(scene, [ENGINES[name] for name in runs], runs, rows or (AGREED,)))


def only(pieces: Any) -> Advice:
    (advice,) = pieces
    return advice


def followed_by_hand(advice: Advice) -> tuple[str, ...]:
    """Integrator, timestep, the two numbers of solref, and solimp, as texts."""
    match = re.search(
        r'(\w+) with timestep (\S+) s, solref "(\S+) (\S+)" and solimp "([^"]+)" of all equalities',
        advice.text,
    )
    assert match
    return match.groups()


def test_the_advised_step_of_mujoco_reaches_the_error(loop: Scene, runs: dict[str, Trajectory]) -> None:
    advice = only(softness(loop, runs))
    integrator, step, *solref, solimp = followed_by_hand(advice)
    assert [float(x) for x in solimp.split()] == list(SOLIMP)
    followed = mjcf.simulate(loop, float(step), integrator, [float(x) for x in solref])
    # a factor 2: the order of two steps does not hold exactly for a third, and 0.9 of the step is taken
    assert distance(followed, runs["newton_euler"]) < 2.0 * WANTED_ERROR
    # and it is not short for nothing: four times as long a step misses the error
    longer = rounded_step(loop, 4.0 * float(step))
    assert distance(mjcf.simulate(loop, longer), runs["newton_euler"]) > WANTED_ERROR


OWN_FILE = """
<mujoco>
  <compiler angle="degree"/>
  <option gravity="0 0 -9.81"/>
  <default>
    <joint axis="0 1 0"/><geom type="capsule" size="0.02" density="800" contype="0" conaffinity="0"/>
  </default>
  <worldbody>
    <body name="crank">
      <joint name="a" damping="0.05" stiffness="2" springref="30"/><geom fromto="0 0 0 0 0 0.5"/>
      <body name="coupler" pos="0 0 0.5"><joint name="b"/><geom fromto="0 0 0 1 0 0.2"/></body>
    </body>
    <body name="rocker" pos="1 0 0"><joint name="d"/><geom fromto="0 0 0 0 0 0.7"/></body>
  </worldbody>
  <equality><connect name="c" body1="coupler" body2="rocker" anchor="1 0 0.2"/></equality>
</mujoco>"""


def plain_mujoco(text: str, scene: Scene) -> np.ndarray:
    """(n, bodies, 3) centers of mass at the outputs by MuJoCo, of a file as it is."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    bodies = [model.body(name).id for name in scene.mechanism.body_names[1:]]
    rows = []
    for time in scene.times:
        while data.time < time - 0.5 * model.opt.timestep:
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        rows.append(data.xipos[bodies].copy())
    return np.array(rows)


def test_the_advice_holds_in_the_file_that_it_is_given_for(tmp_path: Path) -> None:
    (tmp_path / "own.xml").write_text(OWN_FILE)
    scene = mjcf.read(tmp_path / "own.xml", duration=1.0, output_period=0.05).scene
    runs = {engine.name: engine.simulate(scene) for engine in choose(["newton_euler", "mujoco"])}
    integrator, step, *solref, solimp = followed_by_hand(only(softness(scene, runs)))
    stepped = OWN_FILE.replace("<option", f'<option timestep="{step}" integrator="{integrator}"')
    stiff = f'<connect solref="{" ".join(solref)}"'

    def error(text: str) -> float:
        gap = plain_mujoco(text, scene) - runs["newton_euler"].position[:, 1:]
        return float(np.max(np.linalg.norm(gap, axis=-1)))

    assert error(stepped.replace("<connect", f'{stiff} solimp="{solimp}"')) < WANTED_ERROR
    assert error(stepped.replace("<connect", stiff)) > 10.0 * WANTED_ERROR  # MuJoCo's own solimp


def test_mujoco_needs_rigid_company_and_the_same_model(loop: Scene, runs: dict[str, Trajectory]) -> None:
    assert not softness(loop, {"mujoco": runs["mujoco"]})
    assert not softness(loop, {"newton_euler": runs["newton_euler"]})
    assert not softness(loop, runs, MODEL_APART, RUNS_APART)


def test_no_step_is_advised_where_the_error_does_not_follow_it(
    loop: Scene, runs: dict[str, Trajectory]
) -> None:
    shifted = replace(runs["newton_euler"], position=runs["newton_euler"].position + 0.1)
    advice = only(softness(loop, runs | {"newton_euler": shifted}))
    assert advice.text.startswith("its error does not follow its step")


def test_softness_is_told_apart_from_another_model(loop: Scene, runs: dict[str, Trajectory]) -> None:
    topics = [advice.topic for advice in softness(loop, runs, AGREED, RUNS_APART)]
    assert topics == ["softness", "mujoco"]
    assert [advice.topic for advice in softness(loop, runs)] == ["mujoco"]


def test_nothing_is_soft_without_equalities() -> None:
    scene = replace(pendulum(), duration=0.2)
    runs = {name: ENGINES[name].simulate(scene) for name in ("newton_euler", "mujoco")}
    off = replace(runs["mujoco"], position=runs["mujoco"].position + 1e-4)
    advice = only(softness(scene, runs | {"mujoco": off}, AGREED, RUNS_APART))
    assert advice.topic == "mujoco"
    assert "solref" not in advice.text
    text = only(softness(scene, runs)).text
    assert "solref" not in text


def test_steps_can_be_written_down(loop: Scene) -> None:
    assert rounded_step(loop, 0.3) == 0.05
    assert rounded_step(loop, 0.05 / 6.5) == 0.05 / 8
    assert rounded_step(loop, 0.05 / 21) == 0.05 / 25


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
    assert topics == ["mujoco", "redundancy"]
    assert [entry["topic"] for entry in result.summary()["advice"]] == topics
    lines = [*notes(result), *(f"advice, {advice}" for advice in result.advice)]
    assert any(lines == part.lines for part in report(result).parts if isinstance(part, Lines))
