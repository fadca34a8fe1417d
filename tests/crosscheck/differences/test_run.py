"""How far apart two robots get from the same start: closed forms, and MuJoCo's own runs."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mujoco_robots import to_mujoco
from paired_robots import pairs_by_name
from test_dynamics import TREE

from crosscheck.differences.common_states import PHASES, CommonStates, Phase
from crosscheck.differences.motion import compare_motions
from crosscheck.differences.run import INTEGRATION_ERROR, Run, run_both
from crosscheck.report.diff import no_run_text
from mjcf.robot import describe
from newton_euler.reading.robot import RobotFile
from newton_euler.scalars import Array

SLIDER = """
<mujoco><worldbody><body name="block"><joint name="lift" type="slide" axis="0 0 1" armature="0"/>
  <inertial pos="0 0 .5" mass="2" diaginertia=".1 .1 .1"/></body></worldbody></mujoco>"""

STIFF = SLIDER.replace("armature", 'damping="1e7" armature')

HALVES = """
<mujoco><worldbody><body name="a"><joint name="ja" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
  <body name="b" pos=".3 0 0"><joint name="jb" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/></body></body></worldbody>
<equality>EQUALITY</equality></mujoco>"""


def of_text(text: str) -> RobotFile:
    return describe(mujoco.MjModel.from_xml_string(text))


def run_of(first: RobotFile, second: RobotFile) -> tuple[CommonStates, Run | None]:
    states = CommonStates(first, second, pairs_by_name(first.robot, second.robot))
    return states, run_both(states, compare_motions(states))


def test_falling_blocks_have_the_closed_form() -> None:
    """With armature J the block of mass m falls with m g / (m + J), from the same height and velocity."""
    first, second = of_text(SLIDER), of_text(SLIDER.replace('armature="0"', 'armature=".5"'))
    _, run = run_of(first, second)
    assert run is not None
    # the block is as long as its center is high; it falls by this length
    assert run.duration == pytest.approx(np.sqrt(2 * 0.5 / 9.81), rel=1e-12)
    assert (run.body, run.time) == ("block", run.duration)
    # 9.81 (1 - 2 / 2.5) t^2 / 2 with t^2 = 2 * 0.5 / 9.81; polynomials of degree 2 have no integration error
    assert run.distance == pytest.approx(0.5 * (1 - 2 / 2.5), rel=1e-12)
    assert run.uncertainty == pytest.approx(INTEGRATION_ERROR * 0.5, rel=1e-12)


def places_by_mujoco(
    text: str, file: RobotFile, states: CommonStates, duration: float
) -> tuple[Array, Array]:
    """Return centers of mass (2, bodies, 3) and rotations (2, bodies, 3, 3) at the start and at the end."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.integrator, steps = mujoco.mjtIntegrator.mjINT_RK4, 2000
    model.opt.timestep = duration / steps
    data = mujoco.MjData(model)
    at = PHASES.index(Phase.DRIVEN)
    start = states.coordinates[0, at], states.velocities[0, at]
    data.qpos, data.qvel = to_mujoco(model, file.robot, *start)
    data.ctrl = states.controls[0, at]
    mujoco.mj_forward(model, data)
    found = [(data.xipos[1:].copy(), data.xmat[1:].reshape(-1, 3, 3).copy())]
    mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)
    found.append((data.xipos[1:].copy(), data.xmat[1:].reshape(-1, 3, 3).copy()))
    return np.array([place for place, _ in found]), np.array([turn for _, turn in found])


def test_distance_is_that_of_runs_by_mujoco() -> None:
    """A floating robot with a ball, springs and drives; the leg of the second one has more mass."""
    texts = TREE, TREE.replace('mass=".3"', 'mass=".33"')
    files = of_text(texts[0]), of_text(texts[1])
    states, run = run_of(*files)
    assert run is not None
    runs = [places_by_mujoco(*each, states, run.duration) for each in zip(texts, files, strict=True)]
    distances = {}
    for number, body in enumerate(files[0].robot.bodies):
        moved, turned = [], []
        for place, turn in runs:
            back = turn[0, number].T
            moved.append(back @ (place[1, number] - place[0, number]))
            turned.append(back @ turn[1, number])
        cosine = (np.trace(turned[0].T @ turned[1]) - 1) / 2
        radius = np.sqrt(np.trace(body.inertia) / 2 / body.mass)
        distances[body.name] = np.hypot(np.linalg.norm(moved[0] - moved[1]), radius * np.arccos(cosine))
    farthest = max(distances, key=lambda name: distances[name])
    assert (run.body, run.time) == (farthest, run.duration)
    # below the tolerance of a step; MuJoCo's own error at these steps is about 1e-9
    assert run.distance == pytest.approx(distances[farthest], rel=1e-5)


def test_digits_make_the_uncertainty() -> None:
    """The same robot, and a variant with another armature: twice what the variant changes."""
    first, variant = of_text(SLIDER), of_text(SLIDER.replace('armature="0"', 'armature="1e-3"'))
    _, run = run_of(replace(first, variants=(variant.robot,)), first)
    assert run is not None
    assert run.distance == 0.0
    # at the start both are in one place; the body is named by its distance, and its uncertainty counts there
    _, apart = run_of(replace(first, variants=(variant.robot,)), variant)
    assert apart is not None
    assert apart.distance == pytest.approx(0.5 * (1 - 2 / 2.001), rel=1e-9)
    assert apart.uncertainty == pytest.approx(2 * apart.distance + INTEGRATION_ERROR * 0.5, rel=1e-9)


def test_stiff_robots_run_for_a_shorter_time() -> None:
    """At 1e7 N s/m on 2 kg, explicit steps cannot be much longer than 1e-6 s."""
    _, run = run_of(of_text(STIFF), of_text(STIFF.replace('mass="2"', 'mass="3"')))
    assert run is not None
    assert 0.0 < run.duration < 1e-3


def ends_by_mujoco(text: str, coordinates: Array, velocities: Array, duration: float) -> tuple[Array, Array]:
    """Return how the last body moves and turns in a run by MuJoCo, along its axes at the start."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.integrator, steps = mujoco.mjtIntegrator.mjINT_RK4, 2000
    model.opt.timestep = duration / steps
    data = mujoco.MjData(model)
    data.qpos, data.qvel = coordinates[: model.nq], velocities[: model.nv]
    mujoco.mj_forward(model, data)
    start, turn = data.xipos[-1].copy(), data.xmat[-1].reshape(3, 3).copy()
    mujoco.mj_step(model, data, steps)
    mujoco.mj_forward(model, data)
    return turn.T @ (data.xipos[-1] - start), turn.T @ data.xmat[-1].reshape(3, 3)


def test_a_coupling_of_one_robot_holds_at_the_start_of_both() -> None:
    """A joint that one file holds at zero and the other leaves free; without it, the bodies are one."""
    free, held = (of_text(HALVES.replace("EQUALITY", each)) for each in ("", '<joint joint1="jb"/>'))
    states, run = run_of(held, free)
    assert run is not None
    # the state of the robot with the coupling serves both, whichever file is the first
    assert run_of(free, held)[1] == run
    at = PHASES.index(Phase.DRIVEN)
    start = states.coordinates[0, at], states.velocities[0, at]
    assert start[0][1] == pytest.approx(0.0, abs=1e-9)  # rad, where the closing of couplings ends
    two_bodies = HALVES.replace("EQUALITY", "")
    one_body = two_bodies.replace('<joint name="jb" axis="0 1 0"/>', "")
    moved = [ends_by_mujoco(text, *start, run.time) for text in (two_bodies, one_body)]
    body = free.robot.bodies[1]
    cosine = (np.trace(moved[0][1].T @ moved[1][1]) - 1) / 2
    radius = np.sqrt(np.trace(body.inertia) / 2 / body.mass)
    distance = np.hypot(np.linalg.norm(moved[0][0] - moved[1][0]), radius * np.arccos(cosine))
    assert run.body == "b"
    # the tolerance of a step, 1e-6, of some steps
    assert run.distance == pytest.approx(distance, rel=1e-5)


def test_each_robot_starts_from_its_own_pose_if_none_fits_both() -> None:
    """The files hold joint jb 0.2 rad apart: body b starts turned by 0.2 rad about its end."""
    held = '<joint joint1="jb" polycoef="{} 0 0 0 0"/>'
    one, other = (of_text(HALVES.replace("EQUALITY", held.format(each))) for each in (0, 0.2))
    _, run = run_of(one, other)
    assert run is not None
    body = one.robot.bodies[1]
    # about its end b turns by the angle, its center moves on a chord
    radius = np.sqrt(np.trace(body.inertia) / 2 / body.mass)
    expected = np.hypot(0.15 * 2 * np.sin(0.1), 0.2 * radius)
    assert run.start_distance == pytest.approx(expected, rel=1e-6)
    assert run.distance > 100 * run.uncertainty
    same = run_of(one, one)[1]
    assert same is not None
    assert same.start_distance == 0.0


def test_no_run_if_the_second_robot_has_no_closed_pose() -> None:
    """Bars of 0.3 m from the origin reach a point at 0.5 m, and not one at 5 m."""
    sites = '<site name="end" pos=".3 0 0"/></body></body><site name="point" pos="{} 0 0"/></worldbody>'
    model = HALVES.replace("</body></body></worldbody>", sites)
    model = model.replace("EQUALITY", '<connect name="loop" site1="end" site2="point"/>')
    states, run = run_of(of_text(model.format(0.5)), of_text(model.format(5)))
    assert run is None
    assert "constraint 'loop' is violated by 4.5 m" in no_run_text(compare_motions(states))


def test_no_run_without_states() -> None:
    assert run_both(None, compare_motions(None)) is None
