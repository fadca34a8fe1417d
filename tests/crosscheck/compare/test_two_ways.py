"""One four-bar linkage written in many ways: whatever is cut, and in whatever format, it is one mechanism.

    ground -a- crank -b- coupler -c- rocker -d- ground

A hinge is cut by a connect (MJCF) or 3d (URDF), of bodies or of sites, a body by a weld or 6d.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import mjcf
import newton_euler
import urdf
from mjcf.rigid import RigidMuJoCo
from newton_euler import Body, Mechanism, Scene
from newton_euler.equations.system import Evaluation
from newton_euler.equations.undetermined import determined, undetermined
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

SAME = 1e-9
"""m, rad and m/s, and relative for accelerations and reactions: what the ways are asked to have in common.
Runs are at rtol 1e-12; measured are 2e-12 at most."""

DURATION, PERIOD = 0.5, 0.05
"""s, in which the crank swings through about a radian."""

POINTS = {
    name: np.array(point)
    for name, point in {"a": (0, 0, 0), "b": (0.1, 0, 0.4), "c": (0.9, 0, 0.7), "d": (1, 0, 0)}.items()
}
"""m, of the hinges; their axes are y."""


class Part(NamedTuple):
    """A body or a half of one.

    Attributes:
        mass: kg.
        center: (3,) of mass, m, world frame.
        inertia: (3, 3) about it, kg m^2, world frame.
    """

    name: str
    mass: float
    center: Array
    inertia: Array


PARTS = {
    name: Part(name, mass, np.array(center), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    for name, mass, center, (xx, yy, zz, xy, xz, yz) in (
        ("crank", 1.0, (0.05, 0.02, 0.2), (0.02, 0.03, 0.015, 0.001, -0.002, 0.003)),
        ("coupler", 2.0, (0.5, -0.05, 0.6), (0.03, 0.04, 0.025, 0.004, 0.002, -0.001)),
        ("rocker", 1.5, (0.95, 0.04, 0.35), (0.02, 0.035, 0.03, -0.002, 0.001, 0.002)),
    )
}
"""None of them symmetric, their centers of mass out of the plane: no reaction is zero by itself."""

RING = ("a", "crank", "b", "coupler", "c", "rocker", "d")

Chain = list[tuple[str, Part]]
"""Joints with the bodies that hang on them, from the ground."""


def halves(part: Part) -> tuple[Part, Part]:
    """Two bodies that welded together are the part."""
    apart = np.array([0.06, 0.02, -0.04])
    first, second = 0.3 * part.mass, 0.7 * part.mass
    own = part.inertia - first * second / part.mass * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    return (
        Part(f"{part.name}_1", first, part.center + 0.7 * apart, 0.4 * own),
        Part(f"{part.name}_2", second, part.center - 0.3 * apart, 0.6 * own),
    )


def chains(cut: str) -> tuple[Chain, Chain]:
    """What hangs on hinge a and what on hinge d, the ring cut at a hinge or through a body."""
    at = RING.index(cut)
    before, after = list(RING[:at]), list(RING[:at:-1])
    left = [(joint, PARTS[body]) for joint, body in zip(before[::2], before[1::2], strict=False)]
    right = [(joint, PARTS[body]) for joint, body in zip(after[::2], after[1::2], strict=False)]
    if cut in PARTS:
        one, two = halves(PARTS[cut])
        left.append((before[-1], one))
        right.append((after[-1], two))
    return left, right


def text(values: Array) -> str:
    return " ".join(f"{float(x):.17g}" for x in values)


def six(inertia: Array) -> Array:
    return inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def written_mjcf(cut: str, sites: bool) -> str:
    """An MJCF; all body frames are at hinges, parallel to the world."""
    left, right = chains(cut)
    point = POINTS.get(cut, np.array([0.4, 0.0, 0.5]))

    def nested(chain: Chain, origin: Array, site: str) -> str:
        if not chain:
            return f'<site name="{site}" pos="{text(point - origin)}"/>'
        (joint, part), rest = chain[0], chain[1:]
        here = POINTS[joint]
        return (
            f'<body name="{part.name}" pos="{text(here - origin)}"><joint name="{joint}" axis="0 1 0"/>'
            f'<inertial pos="{text(part.center - here)}" mass="{part.mass:.17g}" '
            f'fullinertia="{text(six(part.inertia))}"/>{nested(rest, here, site)}</body>'
        )

    bodies = nested(left, np.zeros(3), "s1") + nested(right, np.zeros(3), "s2")
    kind = "weld" if cut in PARTS else "connect"
    ends = 'site1="s1" site2="s2"'
    if not sites:
        first, second = (chain[-1] if chain else None for chain in (left, right))
        first, second = (first, second) if first else (second, None)
        assert first is not None
        ends = f'body1="{first[1].name}"' + (f' body2="{second[1].name}"' if second else "")
        ends += "" if cut in PARTS else f' anchor="{text(point - POINTS[first[0]])}"'
    return (
        f'<mujoco><compiler boundmass="0"/><worldbody>{bodies}</worldbody>'
        f'<equality><{kind} name="{cut}" {ends}/></equality></mujoco>'
    )


def written_urdf(cut: str) -> tuple[str, str]:
    """A URDF and its loop file."""
    parts, ends = ['<link name="base"/>'], []
    point = POINTS.get(cut, np.array([0.4, 0.0, 0.5]))

    def add(joint: str, kind: str, parent: str, child: str, place: Array, inertial: str = "") -> None:
        parts.append(
            f'<link name="{child}">{inertial}</link><joint name="{joint}" type="{kind}">'
            f'<parent link="{parent}"/><child link="{child}"/><origin xyz="{text(place)}"/>'
            '<axis xyz="0 1 0"/></joint>'
        )

    for chain in chains(cut):
        parent, origin = "base", np.zeros(3)
        for joint, part in chain:
            here = POINTS[joint]
            xx, yy, zz, xy, xz, yz = six(part.inertia)
            inertial = (
                f'<inertial><origin xyz="{text(part.center - here)}"/><mass value="{part.mass:.17g}"/>'
                f'<inertia ixx="{xx:.17g}" iyy="{yy:.17g}" izz="{zz:.17g}" ixy="{xy:.17g}" ixz="{xz:.17g}" '
                f'iyz="{yz:.17g}"/></inertial>'
            )
            add(joint, "continuous", parent, part.name, here - origin, inertial)
            parent, origin = part.name, here
        ends.append(f"{cut}_on_{parent}")
        add(f"to_{ends[-1]}", "fixed", parent, ends[-1], point - origin)
    kind = "6d" if cut in PARTS else "3d"
    loops = (
        f"closed_loop: [[{', '.join(ends)}]]\ntype: [{kind}]\nname_mot: []\njoint_name: []\njoint_type: []\n"
    )
    return f'<robot name="four_bar">{"".join(parts)}</robot>', loops


WAYS = {
    **{f"MJCF, hinge {cut} cut by a connect": ("bodies", cut) for cut in POINTS},
    **{f"MJCF, hinge {cut} cut by a connect of sites": ("sites", cut) for cut in ("a", "c")},
    **{f"MJCF, {cut} cut by a weld": ("bodies", cut) for cut in PARTS},
    "MJCF, coupler cut by a weld of sites": ("sites", "coupler"),
    **{f"URDF, hinge {cut} cut by 3d": ("urdf", cut) for cut in POINTS},
    **{f"URDF, {cut} cut by 6d": ("urdf", cut) for cut in PARTS},
}


def read(folder: Path, way: str) -> Scene:
    written, cut = WAYS[way]
    if written == "urdf":
        urdf_text, loops = written_urdf(cut)
        (folder / "four_bar.urdf").write_text(urdf_text)
        (folder / "four_bar.yaml").write_text(loops)
        asked = {"duration": DURATION, "output_period": PERIOD}
        return urdf.read(folder / "four_bar.urdf", folder / "four_bar.yaml", **asked).scene
    (folder / "four_bar.xml").write_text(written_mjcf(cut, written == "sites"))
    return mjcf.read(folder / "four_bar.xml", duration=DURATION, output_period=PERIOD).scene


def run(scene: Scene) -> Trajectory:
    return newton_euler.simulate(scene, rtol=1e-12, atol=1e-14)


@cache
def whole() -> tuple[Scene, Trajectory, list[State], list[Evaluation]]:
    """The mechanism without any cut: its run, with its states and MuJoCo's accelerations there, rigid."""
    bodies = [Body(part.name, part.mass, part.center, part.inertia) for part in PARTS.values()]
    joints = [
        Revolute(name, first, second, POINTS[name], axis=np.array([0.0, 1.0, 0.0]))
        for name, first, second in (
            ("a", "ground", "crank"),
            ("b", "crank", "coupler"),
            ("c", "coupler", "rocker"),
            ("d", "ground", "rocker"),
        )
    ]
    scene = Scene(
        "four_bar", Mechanism([Body.ground("ground"), *bodies], joints), DURATION, PERIOD, [0.0, 0.0, -9.81]
    )
    found = run(scene)
    states = states_of(found)
    return scene, found, states, rigid(scene, states)


def states_of(found: Trajectory) -> list[State]:
    assert found.linear_velocity is not None
    assert found.angular_velocity is not None
    rows = zip(found.position, found.quaternion, found.linear_velocity, found.angular_velocity, strict=True)
    return [State(*row) for row in rows]


def rigid(scene: Scene, states: Sequence[State]) -> list[Evaluation]:
    system = RigidMuJoCo(scene)
    return [system.evaluate(*system.coordinates(state)) for state in states]


def reactions(scene: Scene, force: Array, torque: Array) -> tuple[Array, Array]:
    """(n, 4, 3) on the second bodies that `whole` has, as far as the equations of motion determine them.

    A ball in place of a hinge takes no torque: of a planar loop's reactions some balance each other.
    """
    reference, _, states, _ = whole()
    mechanism = reference.mechanism
    places = [scene.mechanism.joint_index(name) for name in mechanism.joint_names]
    seconds = [scene.mechanism.joints[k].second.split("_")[0] for k in places]  # of halves, the whole
    signs = np.array(
        [1.0 if own == joint.second else -1.0 for own, joint in zip(seconds, mechanism.joints, strict=True)]
    )
    force, torque = (signs[:, None] * array[:, places] for array in (force, torque))
    free = [undetermined(reference, state) for state in states]
    return determined(force, torque, free, mechanism.size)


def check_same(found: Array, wanted: Array, scale: float, what: str) -> None:
    gap = float(np.max(np.abs(found - wanted)))
    assert gap < SAME * scale, f"{what} differ by {gap:.2e}, scale {scale:.2e}"


@pytest.fixture(scope="module", params=WAYS)
def way(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Scene, Trajectory]:
    """One of the ways, read and run."""
    scene = read(tmp_path_factory.mktemp("way"), request.param)
    return scene, run(scene)


def test_motion_and_reactions_do_not_depend_on_the_cut(way: tuple[Scene, Trajectory]) -> None:
    reference, wanted, *_ = whole()
    scene, found = way
    common = [name for name in PARTS if name in scene.mechanism.body_names]
    assert len(common) >= 2
    for name in common:
        i, j = scene.mechanism.body_index(name), reference.mechanism.body_index(name)
        for array in ("position", "linear_velocity", "angular_velocity", "quaternion"):
            check_same(getattr(found, array)[:, i], getattr(wanted, array)[:, j], 1.0, f"{array} of {name}")
    pairs = zip(
        reactions(scene, found.reaction_force, found.reaction_torque),
        reactions(reference, wanted.reaction_force, wanted.reaction_torque),
        strict=True,
    )
    for what, (x, y) in zip(("forces", "torques"), pairs, strict=True):
        check_same(x, y, float(np.max(np.abs(wanted.reaction_force))), what)


def test_rigid_mujoco_does_not_depend_on_the_cut(way: tuple[Scene, Trajectory]) -> None:
    reference, _, _, wanted = whole()
    scene, found = way
    evaluations = rigid(scene, states_of(found))
    scale = max(float(np.max(np.abs(e.linear_acceleration))) for e in wanted)
    for name in PARTS:
        if name in scene.mechanism.body_names:
            i, j = scene.mechanism.body_index(name), reference.mechanism.body_index(name)
            for x, y in zip(evaluations, wanted, strict=True):
                check_same(x.linear_acceleration[i], y.linear_acceleration[j], scale, name)
                check_same(x.angular_acceleration[i], y.angular_acceleration[j], scale, name)
    forces = ("reaction_force", "reaction_torque")
    own = reactions(scene, *(np.array([getattr(e, name) for e in evaluations]) for name in forces))
    others = reactions(reference, *(np.array([getattr(e, name) for e in wanted]) for name in forces))
    scale = max(float(np.max(np.abs(e.reaction_force))) for e in wanted)
    for what, x, y in zip(("forces", "torques"), own, others, strict=True):
        check_same(x, y, scale, what)


def test_the_comparison_notices_another_mechanism(tmp_path: Path) -> None:
    """A hinge point off by a micrometer is far outside of what is asserted above."""
    (tmp_path / "four_bar.xml").write_text(
        written_mjcf("c", False).replace('pos="1 0 0"', 'pos="1.000001 0 0"')
    )
    scene = mjcf.read(tmp_path / "four_bar.xml", duration=DURATION, output_period=PERIOD).scene
    body = scene.mechanism.body_index("crank")
    assert np.max(np.abs(run(scene).position[:, body] - whole()[1].position[:, 1])) > 100.0 * SAME
