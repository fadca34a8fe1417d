"""Small scenes for every joint, coupling, motion and force beyond hinges, slides and balls."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from mechanisms import GRAVITY, REGULAR, ball_loop, bar, planar_four_bar, wheel

from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear, JointCoupling, PolynomialCoupling
from newton_euler.model.forces import Force, JointSpring, PointSpring, Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import (
    Cylindrical,
    Fixed,
    Free,
    Planar,
    PointOnLine,
    Revolute,
    Rod,
    Screw,
    Spherical,
    Translational,
    Universal,
)
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum
from newton_euler.model.parallel_hinges import ParallelHinges
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.wind import WindLoad, vertical_turbulence, wind_turbulence


def _scene(
    name: str, bodies: list[Body], joints: list[Joint], couplings: tuple[JointCoupling, ...] = ()
) -> Scene:
    mechanism = Mechanism([Body.ground(), *bodies], joints, couplings)
    return Scene(name, mechanism, duration=0.2, output_period=0.05, gravity=GRAVITY)


def planar_chain(forward: bool = True) -> Scene:
    """A plate on an inclined plane, and an arm on it; the plate is the joint's second body, or first."""
    ends = ("ground", "plate") if forward else ("plate", "ground")
    bodies = [bar("plate", [0.1, 0.0, 0.0], [0.4, 0.2, 0.1]), bar("arm", [0.4, 0.2, 0.1], [0.8, 0.3, 0.5])]
    joints: list[Joint] = [
        Planar("table", *ends, [0.1, 0.0, 0.0], axis=[0.2, -0.3, 1.0]),
        Universal(
            "elbow", "plate", "arm", [0.4, 0.2, 0.1], axis_on_first=[1, 0, 0], axis_on_second=[0, 1, 0]
        ),
    ]
    return _scene("planar_chain", bodies, joints)


def planar_loop() -> Scene:
    """A loop that is closed by the plane: 2 hinges, a ball and 3 freedoms of the plane, less 6."""
    a, b, c = [0.0, 0.0, 0.0], [0.1, 0.1, 0.5], [0.9, 0.3, 0.3]
    bodies = [bar("crank", a, b), bar("coupler", b, c, 2.0)]
    joints: list[Joint] = [
        Universal("at_a", "ground", "crank", a, axis_on_first=[0, 1, 0], axis_on_second=[1, 0, 0]),
        Universal("at_b", "crank", "coupler", b, axis_on_first=[0, 1, 0], axis_on_second=[0.6, 0, 0.8]),
        Planar("at_c", "ground", "coupler", c, axis=[0.1, 0.2, 1.0]),
    ]
    return _scene("planar_loop", bodies, joints)


def line_chain(forward: bool = True) -> Scene:
    """A stick with one point on a line, and another stick on it with one point on a line of the first."""
    bodies = [bar("stick", [0.0, 0.1, 0.0], [0.5, 0.2, 0.1]), bar("bead", [0.4, 0.1, 0.1], [0.8, 0.3, 0.5])]
    ends = ("ground", "stick") if forward else ("stick", "ground")
    joints: list[Joint] = [
        PointOnLine("wire", *ends, [0.0, 0.1, 0.0], axis=[1.0, 0.3, 0.2]),
        PointOnLine("string", "bead", "stick", [0.4, 0.1, 0.1], axis=[0.2, 0.3, -1.0]),
    ]
    return _scene("line_chain", bodies, joints)


def line_loop() -> Scene:
    """A crank, a rocker whose tip stays on a line of the crank: 1 + 2 + 4 - 6 freedoms."""
    a, c, d = [0.0, 0.0, 0.0], [0.5, 0.2, 0.4], [1.0, 0.2, 0.1]
    bodies = [bar("crank", a, [0.4, 0.1, 0.5]), bar("rocker", d, c, 1.5)]
    joints: list[Joint] = [
        Revolute("at_a", "ground", "crank", a, axis=[0.2, 1.0, 0.1]),
        PointOnLine("at_c", "crank", "rocker", c, axis=[0.8, 0.1, 0.6]),
        Universal("at_d", "ground", "rocker", d, axis_on_first=[0, 1, 0], axis_on_second=[1, 0, 0]),
    ]
    return _scene("line_loop", bodies, joints)


def rolling_chain(forward: bool = True) -> Scene:
    """A finger on two parallel hinges, apart along their axes too, and a fingertip on two more."""
    ends = ("ground", "finger") if forward else ("finger", "ground")
    bodies = [
        bar("finger", [0.2, 0.1, 0.1], [0.6, 0.2, 0.3]),
        bar("tip", [0.65, 0.2, 0.35], [0.9, 0.3, 0.5]),
    ]
    offset = np.array([0.2, 0.1, 0.1]) if forward else np.array([-0.2, -0.1, -0.1])
    joints: list[Joint] = [
        ParallelHinges(
            "root", *ends, np.zeros(3) if forward else -offset, axis=[0.3, 1.0, 0.2], offset=offset
        ),
        ParallelHinges(
            "knuckle",
            "finger",
            "tip",
            [0.6, 0.2, 0.3],
            axis=[0.0, 1.0, 0.3],
            offset=[0.05, 0.0, 0.05],
            opposed=True,
        ),
    ]
    return _scene("rolling_chain", bodies, joints)


CORNERS = ([0, 0, 0], [0.1, 0.1, 0.5], [0.9, 0.3, 0.8], [1.0, 0.2, 0.1])
"""m, ends of the bars of a four-bar linkage in space."""


def _spatial_loop(name: str, at_a: Joint, at_c: Joint) -> Scene:
    """A crank on joint `at_a`, a coupler and a rocker on universal joints, closed by joint `at_c`."""
    bodies = [
        bar("crank", CORNERS[0], CORNERS[1]),
        bar("coupler", CORNERS[1], CORNERS[2], 2.0),
        bar("rocker", CORNERS[3], CORNERS[2], 1.5),
    ]
    across = {"axis_on_first": [0, 1, 0]}
    at_b = Universal("at_b", "coupler", "crank", CORNERS[1], **across, axis_on_second=[0.6, 0, 0.8])
    at_d = Universal("at_d", "ground", "rocker", CORNERS[3], **across, axis_on_second=[1, 0, 0])
    return _scene(name, bodies, [at_a, at_b, at_c, at_d])


def rolling_loop() -> Scene:
    """Two universal joints, a hinge and two parallel hinges, where the loop is cut: 7 - 6 = 1 freedom."""
    return _spatial_loop(
        "rolling_loop",
        Revolute("at_a", "ground", "crank", CORNERS[0], axis=[0.2, 1.0, 0.1]),
        ParallelHinges(
            "at_c", "rocker", "coupler", CORNERS[2], axis=[0.3, 0.2, 1.0], offset=[0.1, -0.1, 0.05]
        ),
    )


def screw_press() -> Scene:
    """A nut on a spindle on a slide, in the tree both ways round."""
    bodies = [
        bar("nut", [0.0, 0.0, 0.2], [0.2, 0.1, 0.3]),
        bar("ram", [0.2, 0.1, 0.3], [0.5, 0.1, 0.4]),
        bar("cap", [0.3, 0.1, 0.3], [0.5, 0.3, 0.3]),
    ]
    joints: list[Joint] = [
        Screw("spindle", "ground", "nut", [0.0, 0.0, 0.2], axis=[0.1, 0.0, 1.0], pitch=0.1),
        Revolute("pin", "nut", "ram", [0.2, 0.1, 0.3], axis=[0.0, 1.0, 0.3]),
        Screw("lid", "cap", "ram", [0.3, 0.1, 0.3], axis=[1.0, 0.2, 0.0], pitch=-0.05),
    ]
    return _scene("screw_press", bodies, joints)


def screw_loop() -> Scene:
    """Three joints of two freedoms and a screw, which is where the loop is cut: 6 + 1 - 6 = 1."""
    return _spatial_loop(
        "screw_loop",
        Cylindrical("at_a", "ground", "crank", CORNERS[0], axis=[0.2, 1.0, 0.1]),
        Screw("at_c", "rocker", "coupler", CORNERS[2], axis=[0.3, 0.2, 1.0], pitch=0.2),
    )


def rod_loop() -> Scene:
    """Crank and rocker that a rod couples, both ways round, and a rod to the ground."""
    a, b, c, d = [0.0, 0.0, 0.0], [0.1, 0.1, 0.5], [0.9, 0.3, 0.7], [1.0, 0.2, 0.1]
    bodies = [bar("crank", a, b), bar("rocker", d, c, 1.5), bar("bob", b, [0.3, 0.3, 0.9])]
    joints: list[Joint] = [
        Revolute("at_a", "ground", "crank", a, axis=[0.2, 1.0, 0.1]),
        Universal("at_d", "ground", "rocker", d, axis_on_first=[0, 1, 0], axis_on_second=[1, 0, 0]),
        Spherical("at_b", "crank", "bob", b),
        Rod("coupler", "rocker", "crank", c, point_on_second=b),
        Rod("stay", "bob", "ground", [0.3, 0.3, 0.9], point_on_second=[0.3, 1.0, 1.2]),
    ]
    return _scene("rod_loop", bodies, joints)


def hanging_plate() -> Scene:
    """A plate on three rods only: 6 - 3 freedoms."""
    plate = bar("plate", [0.0, 0.0, 0.0], [0.5, 0.3, 0.1])
    joints: list[Joint] = [
        Rod("rod_1", "ground", "plate", [0.0, 0.0, 1.0], point_on_second=[0.0, 0.1, 0.0]),
        Rod("rod_2", "plate", "ground", [0.5, 0.3, 0.1], point_on_second=[0.6, 0.3, 1.1]),
        Rod("rod_3", "ground", "plate", [0.0, 0.6, 1.0], point_on_second=[0.1, 0.4, 0.0]),
    ]
    return _scene("hanging_plate", [plate], joints)


def gear_train() -> Scene:
    """Three hinges on an arm that turns, and a rack: gears between hinges, and hinge and slide."""
    bodies = [
        bar("arm", [0.0, 0.0, 0.0], [0.6, 0.0, 0.2]),
        bar("wheel", [0.2, 0.0, 0.1], [0.2, 0.2, 0.1]),
        bar("pinion", [0.5, 0.0, 0.1], [0.5, 0.1, 0.2]),
        bar("rack", [0.5, 0.1, 0.0], [0.7, 0.1, 0.1]),
    ]
    joints: list[Joint] = [
        Revolute("pivot", "ground", "arm", [0, 0, 0], axis=[0.0, 1.0, 0.2]),
        Revolute("axle", "arm", "wheel", [0.2, 0, 0.1], axis=[0.0, 1.0, 0.0]),
        Revolute("shaft", "pinion", "arm", [0.5, 0, 0.1], axis=[0.1, 1.0, 0.0]),
        Translational("guide", "arm", "rack", [0.5, 0.1, 0.0], axis=[1.0, 0.0, 0.3]),
    ]
    gears = (Gear("mesh", "axle", "shaft", -2.5), Gear("teeth", "shaft", "guide", 0.1))
    return _scene("gear_train", bodies, joints, gears)


def geared_loop() -> Scene:
    """A spatial loop with one freedom too many, taken by a gear from its first hinge to where it is cut."""
    scene = REGULAR[2]()
    joints = [replace(joint) for joint in scene.mechanism.joints]
    joints[0] = Cylindrical("at_a", "ground", "crank", joints[0].point, axis=[0.2, 1.0, 0.1])
    gear = Gear("chain", "at_a", "at_c", 0.7, driver_coordinate=1, follower_coordinate=1)
    return _scene("geared_loop", list(scene.mechanism.bodies[1:]), joints, (gear,))


def _coupled(scene: Scene, *couplings: JointCoupling) -> Scene:
    """The scene with other couplings."""
    mechanism = scene.mechanism
    return replace(scene, mechanism=Mechanism(mechanism.bodies, mechanism.joints, couplings))


def cam_train() -> Scene:
    """The gear train with curves in place of its gears: between hinges, and between hinge and slide."""
    rolling = PolynomialCoupling("mesh", "axle", "shaft", (-1.5, 0.4, 0.0, 0.3))
    return _coupled(gear_train(), rolling, PolynomialCoupling("cam", "shaft", "guide", (0.0, 0.2, -0.1)))


def cam_loop() -> Scene:
    """The geared loop with a curve in place of its gear, its follower at the cut."""
    curve = PolynomialCoupling("cam", "at_a", "at_c", (0.5, 0.6, -0.2), 1, 1)
    return _coupled(geared_loop(), curve)


def cam_loop_reversed() -> Scene:
    """The same driven from the cut."""
    return _coupled(geared_loop(), PolynomialCoupling("cam", "at_c", "at_a", (0.5, 0.6, -0.2), 1, 1))


def moved(scene: Scene, *motions: PrescribedMotion) -> Scene:
    """The scene with prescribed motions, from where those begin."""
    return replace(scene, motions=motions, initial_state=None)


def driven_four_bar() -> Scene:
    """A crank that is turned, in a flat loop of redundant equations."""
    return moved(planar_four_bar(), PrescribedMotion("at_a", Polynomial((0.0, 1.0, 3.0))))


def driven_loop() -> Scene:
    """A spatial loop of a screw that is turned, where the loop is cut."""
    motion = PrescribedMotion("at_c", Sum((Sine(0.1, 7.0), Polynomial((0.0, 0.2)))), coordinate=1)
    return moved(screw_loop(), motion)


def driven_tree() -> Scene:
    """A slide and a hinge of a tree on the move, one of them the other way round."""
    return moved(
        REGULAR[5](),
        PrescribedMotion("rail", Sine(0.2, 5.0, phase=0.3)),
        PrescribedMotion("sleeve_on_cart", Polynomial((0.1, 2.0)), coordinate=1),
    )


def driven_plate() -> Scene:
    """Two motions of one joint, whose other coordinate is free."""
    return moved(
        planar_chain(),
        PrescribedMotion("table", Sine(0.1, 4.0)),
        PrescribedMotion("table", Polynomial((0.1, 1.0)), coordinate=2),
    )


def driven_gears() -> Scene:
    """A gear train that is turned."""
    return moved(gear_train(), PrescribedMotion("axle", Polynomial((0.2, 3.0, -1.0))))


def forced(scene: Scene) -> Scene:
    """Springs on all joint coordinates and between all neighbors, wrenches of both kinds on all bodies."""
    mechanism, rng = scene.mechanism, np.random.default_rng(3)
    forces: list[Force] = []
    for joint in mechanism.joints:
        for k in range(len(joint.coordinate_kinds)):
            stiffness, damping = rng.uniform(1.0, 10.0), rng.uniform(0.05, 0.1)
            forces.append(JointSpring(joint.name, stiffness, damping, rest=rng.normal(), coordinate=k))
    bodies = mechanism.bodies
    for k, (first, second) in enumerate(pairwise(bodies)):
        ends = [body.center_of_mass + 0.2 * rng.normal(size=3) for body in (second, first)]
        spring = PointSpring(
            f"spring_{k}", second.name, first.name, *ends, stiffness=20.0, rest_length=0.3, damping=2.0
        )
        forces.append(spring)
    for body in bodies[1:]:
        for frame in ("world", "body"):
            point, force, torque = rng.normal(size=(3, 3))
            forces.append(Wrench(f"{frame}_{body.name}", body.name, point, 5.0 * force, torque, frame))
    return replace(scene, forces=tuple(forces))


def rubbed(scene: Scene) -> Scene:
    """Dry friction and stops at both ends on all joint coordinates, and elastic gears between neighbors."""
    rng, forces = np.random.default_rng(4), list[Force]()
    for joint in scene.mechanism.joints:
        for k in range(len(joint.coordinate_kinds)):
            coulomb, stribeck, low, high = rng.uniform(0.05, 0.1, size=4)
            forces.append(JointFriction(joint.name, coulomb, stribeck, 0.1, 0.05, coordinate=k))
            forces.append(JointStop(joint.name, "low", -low, 50.0, 0.2, coordinate=k))
            forces.append(JointStop(joint.name, "high", high, 80.0, 0.1, coordinate=k))
    keys = [(joint.name, k) for joint in scene.mechanism.joints for k in range(len(joint.coordinate_kinds))]
    for n, ((driver, i), (follower, j)) in enumerate(pairwise(keys)):
        efficiencies = {"forward_efficiency": 0.7, "backward_efficiency": 0.4 if n % 2 else -0.2}
        ends = {"driver_coordinate": i, "follower_coordinate": j}
        numbers = {"play": 0.02, "dissipation": 0.3, "transition_speed": 0.05, "rest": 0.01}
        ratio = 0.7 if n % 2 else -0.5
        forces.append(
            ElasticGear(f"gear_{n}", driver, follower, ratio, 30.0, **numbers, **efficiencies, **ends)
        )
    return replace(scene, forces=tuple(forces))


def loaded(scene: Scene) -> Scene:
    """Dry friction on all joint coordinates that grows with the reactions of the joints."""
    rng, forces = np.random.default_rng(5), list[Force]()
    for joint in scene.mechanism.joints:
        for k, kind in enumerate(joint.coordinate_kinds):
            coefficient = rng.uniform(0.1, 0.3) * (1.0 if kind == "slide" else 0.05)
            forces.append(JointFriction(joint.name, 0.02, 0.01, 0.1, 0.2, coefficient, coordinate=k))
    return replace(scene, forces=tuple(forces))


def windy(scene: Scene) -> Scene:
    """Turbulent wind on a plate askew and off the center of mass of the last body."""
    body = scene.mechanism.bodies[-1]
    wind = WindLoad(
        "wind",
        body.name,
        body.center_of_mass + np.array([0.1, -0.2, 0.15]),
        first_side=[0.6, 0.3, 0.2],
        second_side=[-0.2, 0.4, 0.0],
        direction=[1.0, -2.0, 0.5],
        speed=wind_turbulence(4.0, 1.0, 10.0, seed=3, lowest=0.1, highest=2.0, count=4),
        vertical_speed=vertical_turbulence(4.0, 2.0, 10.0, seed=3, lowest=0.5, highest=2.0, count=2),
    )
    return replace(scene, forces=(wind,))


def zero_length_spring() -> Scene:
    """A spring of no rest length between points that coincide at first."""
    body = bar("stone", [0.1, 0.0, 0.0], [0.4, 0.2, 0.1])
    scene = _scene("elastic", [body], [Free("floats", "ground", "stone", [0.0, 0.0, 0.0])])
    spring = PointSpring(
        "elastic", "stone", "ground", [0.1, 0, 0], [0.1, 0, 0], stiffness=9.0, rest_length=0.0
    )
    return replace(scene, forces=(spring,))


def controlled_press() -> Scene:
    """Screw, spring, wrench and control law together."""
    scene = screw_press()
    joints = [replace(joint, actuated=joint.name == "pin") for joint in scene.mechanism.joints]
    mechanism = Mechanism(scene.mechanism.bodies, joints)
    return replace(forced(replace(scene, mechanism=mechanism)), control=(PD("pin", 30.0, 0.5, 0.2),))


def offset_slide() -> Scene:
    """A cylindrical joint whose two points are apart; a post fixed to the ground with two hinges."""
    joints: list[Joint] = [
        Cylindrical("tube", "ground", "rod", [0, 0, 0], point_on_second=[0.0, 0.0, 0.4], axis=[0, 0, 1]),
        Fixed("bolt", "post", "ground", [1.0, 0.0, 0.0]),
        Revolute("hinge", "flag", "post", [1.0, 0.0, 0.8], axis=[0.0, 0.6, 0.8]),
        Revolute("hook", "post", "lamp", [1.0, 0.0, 0.5], axis=[0.6, 0.0, 0.8]),
    ]
    bodies = [
        Body.ground(),
        bar("rod", [0, 0, 0.4], [0.3, 0.1, 0.9]),
        bar("post", [1.0, 0.0, 0.0], [1.0, 0.0, 0.8], 3.0),
        bar("flag", [1.0, 0.0, 0.8], [1.4, 0.3, 0.8]),
        bar("lamp", [1.0, 0.0, 0.5], [1.0, 0.4, 0.4], 0.5),
    ]
    return Scene("offset_slide", Mechanism(bodies, joints), 1.0, 0.1, GRAVITY)


def planes_and_rods(swapped: bool) -> Scene:
    """A plate on a plane, a stick whose end is on a line of the plate, held by rods; a floating block."""

    def pair(first, second):
        return (second, first) if swapped else (first, second)

    bodies = [
        Body.ground(),
        bar("plate", [0.1, 0.0, 0.1], [0.8, 0.3, 0.2], 2.0),
        bar("stick", [0.5, 0.2, 0.2], [0.6, 0.4, 1.0]),
        bar("block", [1.2, 0.2, 0.9], [1.4, 0.6, 1.1], 1.3),
        bar("tail", [1.4, 0.6, 1.1], [1.7, 0.9, 1.5], 0.7),
    ]
    joints: list[Joint] = [
        Planar("table", *pair("ground", "plate"), [0.2, 0.1, 0.1], axis=[0.1, -0.2, 1.0]),
        PointOnLine("slot", *pair("plate", "stick"), [0.5, 0.2, 0.2], axis=[1.0, 0.4, 0.1]),
        PointOnLine("guide", *pair("ground", "stick"), [0.6, 0.4, 1.0], axis=[0.3, 1.0, -0.2]),
        Rod("tie", *pair("plate", "block"), [0.8, 0.3, 0.2], point_on_second=[1.2, 0.2, 0.9]),
        Rod("stay", "block", "ground", [1.4, 0.6, 1.1], point_on_second=[1.0, 1.0, 2.0]),
        Revolute("hinge", *pair("block", "tail"), [1.4, 0.6, 1.1], axis=[0.2, 0.9, 0.4]),
        Planar("cover", *pair("tail", "ground"), [1.7, 0.9, 1.5], axis=[0.9, 0.1, 0.3]),
    ]
    if swapped:  # both ends of the rod change places
        joints[3] = Rod("tie", "block", "plate", [1.2, 0.2, 0.9], point_on_second=[0.8, 0.3, 0.2])
    return Scene("assembly", Mechanism(bodies, joints), 0.5, 0.1, GRAVITY)


def rod_platform() -> Scene:
    """A block that six rods hold, and a stick hinged to it: no other joint reaches the ground."""
    corners = np.array([[1, 0, 0], [0, 1, 0], [-1, -1, 0], [1, 1, 0.1], [-1, 0.2, 0], [0.1, -1, 0.0]])
    block = Body("block", 2.0, [0, 0, 1.0], np.diag([0.2, 0.3, 0.4]))
    rods: list[Joint] = [
        Rod(
            f"rod_{k}",
            "ground",
            "block",
            c,
            point_on_second=0.3 * np.roll(corners, 2, axis=0)[k] + [0, 0, 0.9],
        )
        for k, c in enumerate(corners[:5])
    ]
    stick = bar("stick", [0, 0, 1.0], [0.2, 0.1, 1.6])
    hinge = Revolute("hinge", "block", "stick", [0, 0, 1.0], axis=[0.1, 1.0, 0.0])
    return Scene("platform", Mechanism([Body.ground(), block, stick], [*rods, hinge]), 0.5, 0.1, GRAVITY)


def coupled_tree() -> Scene:
    """A tree with a screw, a gear and a motion."""
    bodies = [
        Body.ground(),
        bar("arm", [0.0, 0.0, 0.0], [0.1, 0.1, 0.5]),
        bar("nut", [0.1, 0.1, 0.5], [0.4, 0.3, 0.6]),
        wheel("wheel", [0.5, -0.3, 0.2], 0.2),
    ]
    joints: list[Joint] = [
        Revolute("shoulder", "ground", "arm", [0.0, 0.0, 0.0], axis=[0.2, 1.0, 0.1]),
        Screw("thread", "nut", "arm", [0.1, 0.1, 0.5], axis=[0.6, 0.0, 0.8], pitch=0.15),
        Revolute("shaft", "ground", "wheel", [0.5, -0.3, 0.2], axis=[0.1, 0.2, 1.0]),
    ]
    motion = PrescribedMotion("shaft", Sine(0.4, 2.0, 0.5))
    gears = [Gear("mesh", "shaft", "shoulder", 0.7)]
    return Scene("tree", Mechanism(bodies, joints, gears), 0.5, 0.1, GRAVITY, motions=(motion,))


AXES = {"tip": ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]), "fork": ([0.6, 0.8, 0.0], [0.8, -0.6, 0.0])}


def coupled_loop(cut: str) -> Scene:
    """A loop with the same, and the joint that the tree cuts: a universal joint or the screw."""
    points = [[0.0, 0.0, 0.0], [0.1, 0.1, 0.5], [0.4, 0.3, 0.6], [0.9, 0.3, 0.8], [1.0, 0.0, 0.0]]
    names = ["ground", "arm", "nut", "strut", "link", "ground"]
    bodies = [Body.ground()] + [
        bar(name, a, b) for name, a, b in zip(names[1:-1], points[:-1], points[1:], strict=True)
    ]
    bodies.append(wheel("wheel", [0.5, -0.3, 0.2], 0.2))
    order = ["thread", "tip", "fork"] if cut == "tip" else ["tip", "thread", "fork"]
    joints: list[Joint] = [
        Universal(
            "shoulder",
            "ground",
            "arm",
            [0.0, 0.0, 0.0],
            axis_on_first=[0.0, 1.0, 0.0],
            axis_on_second=[0.6, 0.0, -0.8],
        ),
        Revolute("shaft", "ground", "wheel", [0.5, -0.3, 0.2], axis=[0.1, 0.2, 1.0]),
        Cylindrical("foot", "ground", "link", [1.0, 0.0, 0.0], axis=[0.0, 0.6, 0.8]),
    ]
    for k, name in enumerate(order, start=1):
        ends = (name, names[k], names[k + 1], points[k])
        joints.append(
            Screw(*ends, axis=[0.6, 0.0, 0.8], pitch=0.15)
            if name == "thread"
            else Universal(*ends, axis_on_first=AXES[name][0], axis_on_second=AXES[name][1])
        )
    motion = PrescribedMotion(cut, Sine(0.2, 3.0, 0.1), coordinate=1)
    gears = [Gear("mesh", "shaft", "tip", 0.7), Gear("rack", "fork", "foot", 0.3)]
    return Scene(f"{cut}_loop", Mechanism(bodies, joints, gears), 0.5, 0.1, GRAVITY, motions=(motion,))


JOINTS = {
    "planar": planar_chain(),
    "planar, reversed": planar_chain(forward=False),
    "planar, cut": planar_loop(),
    "point on line": line_chain(),
    "point on line, reversed": line_chain(forward=False),
    "point on line, cut": line_loop(),
    "parallel hinges": rolling_chain(),
    "parallel hinges, reversed": rolling_chain(forward=False),
    "parallel hinges, cut": rolling_loop(),
    "screw": screw_press(),
    "screw, cut": screw_loop(),
    "rods": rod_loop(),
    "rods only": hanging_plate(),
    "gears": gear_train(),
    "gear, cut": geared_loop(),
    "polynomials": cam_train(),
    "polynomial, follower cut": cam_loop(),
    "polynomial, driver cut": cam_loop_reversed(),
}
"""Joints and couplings."""

MOTIONS = {
    "motion of a loop, redundant": driven_four_bar(),
    "motion, cut": driven_loop(),
    "motions of a tree": driven_tree(),
    "motions of one joint": driven_plate(),
    "motion of gears": driven_gears(),
}

FORCED = (
    "planar, reversed",
    "point on line, cut",
    "parallel hinges",
    "parallel hinges, reversed",
    "parallel hinges, cut",
    "screw, cut",
    "rods",
    "rods only",
    "gear, cut",
    "polynomials",
    "polynomial, driver cut",
    "motion, cut",
    "motions of a tree",
)

FORCES = {
    **{f"forces, {build.__name__}": forced(build()) for build in REGULAR},
    "spring without length": zero_length_spring(),
    "control and forces": controlled_press(),
    "wind, cut at a ball": windy(ball_loop()),
    "friction and stops": rubbed(screw_press()),
    "friction and stops, cut at a ball": rubbed(ball_loop()),
    "friction of loaded joints": loaded(screw_press()),
    "friction of loaded joints, cut at a ball": loaded(ball_loop()),
    **{f"forces, {name}": forced((JOINTS | MOTIONS)[name]) for name in FORCED},
}
"""Springs, wrenches and wind, on joints that are cut among others."""

ELEMENTS = JOINTS | MOTIONS | FORCES

COUPLED = {
    "screw, gear and motion": coupled_tree(),
    "screw, gear and motion, cut at a universal joint": coupled_loop("tip"),
    "screw, gear and motion, cut at the screw": coupled_loop("thread"),
    "planes, lines and rods": planes_and_rods(swapped=False),
    "planes, lines and rods, reversed": planes_and_rods(swapped=True),
    "platform on rods": rod_platform(),
    "slide of two points, fixed post": offset_slide(),
}
"""Several elements in one mechanism."""
