"""What a run is said to test shows when it is changed by 10 %, and nothing else does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import pendulum

import newton_euler
from crosscheck.comparison.changes import CHANGE
from crosscheck.comparison.coverage import covered_by
from crosscheck.scenes import load
from crosscheck.stress.noise import flat_four_bar
from newton_euler.armature import Armature
from newton_euler.control import Sampled
from newton_euler.euler_parameters import angle_between
from newton_euler.forces import JointSpring
from newton_euler.mechanism import Mechanism
from newton_euler.scene import Scene

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


SCENES = {
    "tracker": lambda: replace(load("tracker"), duration=0.5),
    "slider_crank": lambda: replace(load("slider_crank"), duration=0.5),
    "free_top": lambda: replace(load("free_top"), duration=0.5),
    "heavy_top": lambda: replace(load("heavy_top"), duration=0.5),
    "four_bar": lambda: replace(load("four_bar"), duration=0.5),
    "flyball_governor": lambda: replace(load("flyball_governor"), duration=0.5),
    "loaded": lambda: loaded(0.0),
    "in equilibrium": lambda: replace(loaded(0.0), gravity=np.zeros(3)),
}


@pytest.mark.parametrize("name", SCENES)
def test_tested_elements_show_and_untested_ones_do_not(name):
    scene = SCENES[name]()
    found = {covered.element: covered for covered in covered_by(scene, *[TOLERANCE] * 2).elements}
    for element, other in changed(scene):
        assert (moved(scene, other) > 1.0) == found[element].tested, element


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
    assert [each.tested for each in held.elements] == [each.tested for each in declared.elements]


def test_welds_are_no_elements():
    """Where two bodies are one, another point of the joint between them is the same mechanism."""
    found = covered_by(flat_four_bar(0.0), TOLERANCE, TOLERANCE)
    assert not [each for each in found.elements if "'weld'" in each.element]
