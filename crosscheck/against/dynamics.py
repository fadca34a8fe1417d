"""The level of forces and inertias: term by term, then all together as the allowed motions see them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from crosscheck.against.align import Aligned
from crosscheck.against.balls import ball_rotors, ball_torques, balls_apart
from crosscheck.against.worst import worst_row
from crosscheck.comparison.dynamics import motion_rows
from crosscheck.comparison.rows import Row, round_off
from crosscheck.comparison.samples import Samples, Scales
from newton_euler.equations.applied_forces import body_wrenches
from newton_euler.equations.cartesian import Cartesian
from newton_euler.model.armature import Armature
from newton_euler.model.control import Law
from newton_euler.model.forces import BallSpring, JointSpring
from newton_euler.model.joints import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

LEVEL = "dynamics"


def dynamics_rows(pair: tuple[str, str], aligned: Aligned, first: Samples, second: Samples) -> Iterator[Row]:
    """Gravity, rotors, what acts at joints and on bodies, each blamed on itself; energies, effective inertia
    and force after them. Tolerances are round-off times the condition of the constraints."""
    share = round_off(max(first.condition, second.condition), first.states.noise)
    scenes = (first.system.scene, second.system.scene)
    scales = Scales(first)
    failed: list[str] = []

    def noted(quantity: str, gaps: Mapping[str, float]) -> Row:
        found = worst_row(LEVEL, quantity, pair, np.array(list(gaps.values())), share, tuple(gaps))
        if not found.agrees:
            failed.append(found.where)
        return found

    gravity = [scene.gravity for scene in scenes]
    strength = float(np.max(np.linalg.norm(gravity, axis=1)))
    yield noted(
        "gravity, rel",
        {"gravity": float(np.linalg.norm(gravity[1] - gravity[0])) / strength if strength else 0.0},
    )
    rotors, of_balls = [_rotors(scene) for scene in scenes], [ball_rotors(scene) for scene in scenes]
    if any(rotors) or any(of_balls):
        largest = max(a.inertia for scene in scenes for a in scene.armatures)
        gaps = _apart(aligned, rotors, lambda _: largest, sensed=False)
        more = balls_apart(aligned, of_balls, largest, sensed=False)
        yield noted("rotor inertia, rel", _largest(gaps, more))
    none = [dict[str, Array]()] * 2
    for quantity, acting, torques in (
        ("actuator force, rel", [_forces(scene, scene.control, first) for scene in scenes], none),
        (
            "spring force, rel",
            [_forces(scene, _springs(scene), first) for scene in scenes],
            [ball_torques(scene, first.states.all) for scene in scenes],
        ),
    ):
        if any(acting) or any(torques):
            values = [value for found in acting for value in found.values()]
            values += [value for found in torques for value in found.values()]
            largest = max(float(np.max(np.abs(value))) for value in values)
            gaps = _apart(aligned, acting, _units(scenes[0], scales, largest))
            unit = max(scales.force * scales.size, largest)
            yield noted(quantity, _largest(gaps, balls_apart(aligned, torques, unit)))
    wrenches = np.array([_wrenches(scene, first.states.all) for scene in scenes])
    if np.any(wrenches):
        wrenches[..., 3:] /= scales.size
        unit = max(scales.force, float(np.max(np.abs(wrenches))))
        gap = np.abs(wrenches[1] - wrenches[0]).max(axis=(0, 2)) / unit
        yield noted(
            "forces on bodies, rel", dict(zip(scenes[0].mechanism.body_names, gap.tolist(), strict=True))
        )
    yield from motion_rows(pair, first, second, lambda _: failed[0] if failed else None)


def _rotors(scene: Scene) -> dict[Key, Array]:
    """(1,) kg m^2 or kg by joint coordinate."""
    return {a.key: np.array([a.inertia]) for a in scene.armatures if isinstance(a, Armature)}


def _springs(scene: Scene) -> list[JointSpring]:
    return [force for force in scene.forces if isinstance(force, JointSpring)]


def _forces(scene: Scene, laws: Iterable[Law | JointSpring], samples: Samples) -> dict[Key, Array]:
    """(n,) N or N m of each of some laws at the samples' states, by the joint coordinate that it acts on."""
    equations, found = Cartesian(scene), dict[Key, list[float]]()
    for state in samples.states.all:
        q, _ = equations.coordinates(state)
        frames = state.frames()
        for law in laws:
            key = law.joint, law.coordinate
            seen = equations.measured[key].measure(q, frames)
            found.setdefault(key, []).append(float(law.force(seen.x, seen.rate, 0.0)))
    return {key: np.array(values) for key, values in found.items()}


def _wrenches(scene: Scene, states: Iterable[State]) -> Array:
    """(n, b, 6) N and N m of springs between points and wrenches.

    None on the ground, which takes anything.
    """
    poses = [body.pose for body in scene.mechanism.bodies]
    others = tuple(force for force in scene.forces if not isinstance(force, BallSpring))
    without = replace(scene, forces=others)
    found = np.array([body_wrenches(without, poses, state.frames()) for state in states])
    found[:, 0] = 0.0
    return found


def _largest(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, float]:
    """The larger gap of each joint."""
    names = dict.fromkeys((*one, *other))
    return {name: max(one.get(name, 0.0), other.get(name, 0.0)) for name in names}


def _apart(
    aligned: Aligned,
    acting: Sequence[Mapping[Key, Array]],
    unit: Callable[[Key], float],
    sensed: bool = True,
) -> dict[str, float]:
    """By joint the largest difference of what the first and the second model have on a coordinate.

    Joints of the second model alone go by its name. What does not depend on the sense is not `sensed`.
    """
    here, there = acting
    found, partners = dict[str, float](), set()
    for key, other in aligned.coordinates.items():
        partners.add(other.key)
        nothing = np.zeros(1)
        sense = other.sense if sensed else 1.0
        gap = np.abs(sense * there.get(other.key, nothing) - here.get(key, nothing))
        found[key[0]] = max(found.get(key[0], 0.0), float(gap.max()) / unit(key))
    alone = [(key, here[key]) for key in here if key not in aligned.coordinates]
    alone += [(key, there[key]) for key in there if key not in partners]
    for key, values in alone:
        found[key[0]] = max(found.get(key[0], 0.0), float(np.abs(values).max()) / unit(key))
    return found


def _units(scene: Scene, scales: Scales, largest: float) -> Callable[[Key], float]:
    """What forces are relative to: the largest of the mechanism, at its size for torques, or of their own."""
    mechanism = scene.mechanism

    def unit(key: Key) -> float:
        if key[0] not in mechanism.joint_names:
            return max(scales.force, largest)
        joint = mechanism.joints[mechanism.joint_index(key[0])]
        turns = joint.coordinate_kinds[key[1]] == "hinge"
        return max(scales.force * (scales.size if turns else 1.0), largest)

    return unit
