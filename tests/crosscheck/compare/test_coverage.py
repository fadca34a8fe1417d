"""What a run is said to test shows when it is changed by 10 %, and nothing else does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mechanisms import MASS, bar, line_spring, mass_on_rail, pendulum
from planted_changes import check, shortened

import newton_euler
from crosscheck.compare import crosscheck as run
from crosscheck.compare.changes import CHANGE
from crosscheck.compare.coverage import covered_by
from crosscheck.compare.note import Note
from crosscheck.engines.registry import choose
from crosscheck.library import load
from crosscheck.report.run import notes
from crosscheck.studies.stress.noise import flat_four_bar
from newton_euler.model.armatures import Armature
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Sampled
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine

TOLERANCE = 2e-9
"""m and rad: of runs of two engines at rtol 1e-10."""


def changed(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """Scenes with one element each of 1.1 times its size."""
    more = 1.0 + CHANGE
    bodies, mechanism = scene.mechanism.bodies, scene.mechanism
    for k, body in enumerate(bodies[1:], start=1):
        for what, other in (
            ("mass", replace(body, mass=more * body.mass)),
            ("inertia", replace(body, inertia=more * body.inertia)),
        ):
            parts = (*bodies[:k], other, *bodies[k + 1 :])
            built = Mechanism(parts, mechanism.joints, mechanism.couplings)
            yield f"{what} of body {body.name!r}", replace(scene, mechanism=built)
    for k, law in enumerate(scene.control):
        gains = {name: more * getattr(law, name) for name in ("stiffness", "damping", "feedforward")}
        laws = (*scene.control[:k], replace(law, **gains), *scene.control[k + 1 :])
        yield f"actuator of joint {law.joint!r}", replace(scene, control=laws)
    for k, spring in enumerate(scene.forces):
        for what, name in (("spring", "stiffness"), ("damper", "damping")):
            if getattr(spring, name):
                other = replace(spring, **{name: more * getattr(spring, name)})
                forces = (*scene.forces[:k], other, *scene.forces[k + 1 :])
                where = f"of joint {spring.joint!r}" if isinstance(spring, JointSpring) else repr(spring.name)
                yield f"{what} {where}", replace(scene, forces=forces)
    for k, rotor in enumerate(scene.armatures):
        rotors = (
            *scene.armatures[:k],
            replace(rotor, inertia=more * rotor.inertia),
            *scene.armatures[k + 1 :],
        )
        yield f"rotor of joint {rotor.joint!r}", replace(scene, armatures=rotors)


def moved(scene: Scene, other: Scene) -> float:
    """How far bodies of two runs are apart, in tolerances."""
    x, y = (newton_euler.simulate(each) for each in (scene, other))
    gaps = np.linalg.norm(x.position - y.position, axis=2), angle_between(x.quaternion, y.quaternion)
    return float(np.max(gaps)) / TOLERANCE


def loaded(start: float) -> Scene:
    """A pendulum with a spring, a damper and a rotor at its hinge, from rest, the spring at an angle."""
    scene = pendulum()
    spring = JointSpring("pivot", stiffness=2.0, damping=0.1, rest=start)
    return replace(scene, forces=(spring,), armatures=(Armature("pivot", 0.01),), duration=0.5)


def driven() -> Scene:
    """A pendulum with a control law at its hinge."""
    scene = pendulum()
    joint = replace(scene.mechanism.joints[0], actuated=True)
    mechanism = Mechanism(scene.mechanism.bodies, [joint])
    law = PD("pivot", 20.0, 5.0, 1.0, feedforward=0.5)
    return replace(scene, mechanism=mechanism, control=(law,), duration=0.5, initial_state=None)


SCENES = {
    "slider_crank": lambda: replace(load("slider_crank"), duration=0.5),
    "free_top": lambda: replace(load("free_top"), duration=0.5),
    "heavy_top": lambda: replace(load("heavy_top"), duration=0.5),
    "flyball_governor": lambda: replace(load("flyball_governor"), duration=0.5),
    "loaded": lambda: loaded(0.0),
    "driven": lambda: driven(),
    "in equilibrium": lambda: replace(loaded(0.0), gravity=np.zeros(3)),
}


@pytest.mark.parametrize("name", SCENES)
def test_tested_elements_show_and_untested_ones_do_not(name):
    scene = SCENES[name]()
    found = {covered.element: covered for covered in covered_by(scene, *[TOLERANCE] * 2).elements}
    for element, other in changed(scene):
        assert (moved(scene, other) > 1.0) == found[element].tested, element


@pytest.mark.slow
def test_joints_that_do_not_move_are_untested():
    scene = replace(load("tracker"), duration=0.5)
    still = replace(scene, control=tuple(replace(law, target=0.0) for law in scene.control))
    for each, tested in ((scene, True), (still, False)):
        found = covered_by(each, TOLERANCE, TOLERANCE).elements
        joints = [covered for covered in found if covered.element.split()[0] in ("joint", "loop")]
        assert len(joints) == len(scene.mechanism.joints)
        assert all(covered.tested == tested for covered in joints)
    assert str(covered_by(still, TOLERANCE, TOLERANCE)) == "motion covers 0 of 22 elements"


def test_sampled_controllers_cover_what_they_move():
    """Discrete controllers that push as the declared laws do where they are sampled."""
    scene = replace(load("tracker"), duration=0.2)
    laws = [
        Sampled(law.joint, lambda t, x, rate, law=law, k=k: law.force(x[k], rate[k], t), 0.01, law.coordinate)
        for k, law in enumerate(scene.control)
    ]
    sampled = replace(scene, control=tuple(laws))
    declared, held = (covered_by(each, TOLERANCE, TOLERANCE) for each in (scene, sampled))
    pairs = zip(held.elements, declared.elements, strict=True)
    assert all(one.tested == other.tested for one, other in pairs if not one.shared)
    # one code for all engines: what it does wrong, it does in each of them
    assert [each.element for each in held.elements if each.shared] == [
        "actuator of joint 'slide_12'",
        "actuator of joint 'slide_13'",
    ]
    assert not any(each.tested for each in held.elements if each.shared)


def test_welds_are_no_elements():
    """Where two bodies are one, another point of the joint between them is the same mechanism."""
    found = covered_by(flat_four_bar(0.0), TOLERANCE, TOLERANCE)
    assert not [each for each in found.elements if "'weld'" in each.element]


def test_stiff_small_oscillations_test_no_spring():
    """5e-10 m at 15 periods: however wrong the spring, the mass is off by less than twice the amplitude."""
    periods, amplitude = 15, 5e-10
    stiffness = MASS * (2.0 * np.pi * periods) ** 2  # so many in 1 s
    spring = JointSpring("rail", stiffness=stiffness, rest=amplitude)
    scene = replace(mass_on_rail(spring, duration=1.0), output_period=0.01)
    found = covered_by(scene, TOLERANCE, TOLERANCE)
    assert len(found.untested) == len(found.elements)
    wider = replace(scene, forces=(replace(spring, rest=100.0 * amplitude),))
    untested = covered_by(wider, TOLERANCE, TOLERANCE).untested
    assert [each.element for each in untested] == ["inertia of body 'mass'"]


def test_axes_of_compound_joints_are_tested():
    """A body on two slides and a hinge, all of which move: tilted, they leave the plane."""
    plate = bar("plate", [0.0, 0.0, 0.0], [0.3, 0.0, 0.2])
    joint = Compound(
        "table", "ground", "plate", [0.0, 0.0, 0.0], slides=np.eye(3)[[0, 2]], hinges=[[0, 1, 0]]
    )
    mechanism = Mechanism([Body.ground(), plate], [joint])
    scene = Scene("table", mechanism, 0.5, 0.05, (1.0, 0.0, -9.81))
    still = replace(scene, gravity=np.zeros(3))
    for each, tested in ((scene, True), (still, False)):
        shares = {one.element: one.tested for one in covered_by(each, TOLERANCE, TOLERANCE).elements}
        assert shares["joint 'table'"] == tested


def test_prescribed_motions_are_elements():
    for function, tested in ((Sine(0.1, 5.0), True), (Polynomial((0.0,)), False)):
        scene = mass_on_rail(duration=0.5, motions=(PrescribedMotion("rail", function),))
        found = {each.element: each.tested for each in covered_by(scene, TOLERANCE, TOLERANCE).elements}
        assert found["motion of joint 'rail'"] == tested


def test_masses_are_untested_where_motions_prescribe_all_poses():
    """A crank at constant speed: masses change reactions and the drive torque, but no pose."""
    scene = replace(load("examples/planar_slider_crank.yaml"), duration=0.02)
    found = covered_by(scene, TOLERANCE, TOLERANCE)
    assert found.is_prescribed
    assert {each.element for each in found.untested} == {
        f"{what} of body {body!r}" for what in ("mass", "inertia") for body in ("crank", "rod", "slider")
    }
    free = replace(scene, motions=(), initial_state=None)
    assert not covered_by(free, TOLERANCE, TOLERANCE).is_prescribed


def test_the_note_on_untested_masses_names_the_cause():
    """Of a driven crank, the note does not ask for more motion."""
    scene = replace(load("examples/planar_slider_crank.yaml"), duration=0.02)
    found = run.crosscheck(scene, choose(["newton_euler", "pinocchio"]), lambda _: None, "crank", {})
    (line,) = [line for line in notes(found) if line.startswith(Note.UNTESTED)]
    assert "prescribed" in line
    assert "at random states" in line


def test_joints_that_carry_a_load_are_tested_where_nothing_moves():
    """An arm that a preloaded spring holds up: at another place of the hinge it would not be in balance."""
    arm = bar("arm", [0.0, 0.0, 0.0], [0.4, 0.0, 0.0])
    hinge = Revolute("hinge", "ground", "arm", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
    mechanism = Mechanism([Body.ground(), arm], [hinge])
    stiffness, moment = 50.0, arm.mass * 9.81 * 0.2
    for scale, tested in ((1.0, True), (0.0, False)):
        spring = JointSpring("hinge", stiffness=stiffness, rest=-scale * moment / stiffness)
        gravity = (0.0, 0.0, -9.81 * scale)
        scene = Scene("arm", mechanism, 0.5, 0.05, gravity, forces=(spring,))
        rest = newton_euler.simulate(scene).position
        assert np.abs(rest - rest[0]).max() < 1e-12
        found = {each.element: each.tested for each in covered_by(scene, TOLERANCE, TOLERANCE).elements}
        assert found["joint 'hinge'"] == tested


def test_elements_of_one_name_are_told_apart():
    """A spring between points may have the name of a joint that has a control law."""
    law = PD("rail", 0.0, 0.0, 0.0, feedforward=Sine(1.0, 7.0))
    scene = mass_on_rail(replace(line_spring(rest_length=2.0), name="rail"), duration=0.5, control=(law,))
    found = covered_by(scene, TOLERANCE, TOLERANCE)
    assert {each.element for each in found.untested} == {"inertia of body 'mass'"}


def test_what_fails_beside_the_comparison_is_a_note(monkeypatch):
    def fail(*_: object) -> None:
        raise ValueError("of its own")

    scene = replace(pendulum(), duration=0.2)
    monkeypatch.setattr(run, "coverage", fail)
    monkeypatch.setattr(run, "redundancy_advice", fail)
    engines = choose(["newton_euler", "pinocchio"])
    found = run.crosscheck(scene, engines, lambda _: None, "a pendulum", {}, advised=True)
    assert found.agrees
    assert not found.unfinished
    assert found.verdict.endswith("; what the motion covers is not known")
    reason = "internal error: ValueError: of its own"
    assert found.notes == (
        f"working out what the motion covers: {reason}",
        f"working out advice: {reason}",
    )
    assert found.summary()["notes"] == list(found.notes)


MODELS = (
    "slider_crank",
    "four_bar",
    "free_top",
    "heavy_top",
    "andrews",
    "bricard",
    "stewart",
    "examples/linkage.xml",
    "mjcf/tracker.xml",
    str(Path(mujoco.__file__).parent / "testdata" / "model.xml"),
)
"""Of the library, of this repository and of an installed package."""


@pytest.mark.slow
@pytest.mark.parametrize("source", MODELS)
def test_what_is_covered_shows_in_comparisons(source):
    assert not check(shortened(source, 0.3)).wrong
