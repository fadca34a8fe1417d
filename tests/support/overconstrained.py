"""Overconstrained loops of hinges with one freedom in every configuration, and their motion by another way.

A loop of n hinges has n - 6 freedoms unless its dimensions are special. Dimensions of the loops of Bennett,
Myard and Goldberg: J. E. Baker, The Bennett, Goldberg and Myard linkages - in perspective, Mechanism and
Machine Theory 14, 1979. Schatz's: J. Phillips, Freedom in Machinery, volume 2, Cambridge 1990, section 20.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.runs.variation import start
from newton_euler.scalars import Array

GRAVITY = np.array([0.3, -0.5, -1.0])
SPEED = 7.0  # rad/s of the first hinge: enough for full revolutions
DURATION = 1.2  # s
PERIOD = 0.05  # s


class Dimensions(NamedTuple):
    """Denavit-Hartenberg parameters of n hinges in a row, (n,) each, and random angles to close them from."""

    lengths: Sequence[float]
    """m."""
    twists: Sequence[float]
    """rad."""
    offsets: Sequence[float]
    """m."""
    seed: int


class Loop(NamedTuple):
    """Hinges of a closed loop, in a row from the ground back to the ground."""

    points: Array
    """(n, 3) m."""
    axes: Array
    """(n, 3) unit vectors."""

    @property
    def screws(self) -> Array:
        """Velocities (6, n) of the body past all hinges, at the origin, for the rates of these."""
        return np.hstack([np.cross(self.points, self.axes), self.axes]).T


def _sides(*twists: float) -> list[float]:
    """Lengths, m, of the sides of linkages that consist of Bennett's: proportional to sines."""
    return [0.6 * np.sin(twist) for twist in twists]


RIGHT = 0.5 * np.pi
LOOPS = {
    "bennett": Dimensions(_sides(0.6, 1.1, 0.6, 1.1), (0.6, 1.1, 0.6, 1.1), (0.0,) * 4, 0),
    "goldberg": Dimensions(
        [sum(_sides(0.6, 0.8)), *_sides(1.0, 0.8, 0.6, 1.0)], (1.4, 1.0, 0.8, 0.6, 1.0), (0.0,) * 5, 0
    ),
    "myard": Dimensions(
        _sides(0.7, RIGHT, 0.0, RIGHT, 0.7), (0.7, RIGHT, np.pi - 1.4, RIGHT, np.pi - 0.7), (0.0,) * 5, 0
    ),
    "schatz": Dimensions(
        (0.0, 0.4, 0.4, 0.4, 0.0, 0.4 * np.sqrt(3.0)), (RIGHT,) * 5 + (0.0,), (0.3, 0, 0, 0, 0, -0.3), 1
    ),
}


def closed(dimensions: Dimensions) -> Loop:
    """Close a loop by Newton's method."""
    angles = np.random.default_rng(dimensions.seed).uniform(-np.pi, np.pi, len(dimensions.lengths))
    for _ in range(200):
        loop, end = _row(dimensions, angles)
        turn = end[:3, :3] - end[:3, :3].T
        residual = 0.5 * np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
        screws, moved = loop.screws, end[:3, 3]
        screws[:3] -= np.cross(moved, loop.axes).T
        step = np.linalg.lstsq(screws, np.concatenate([moved, residual]), rcond=1e-6)[0]
        angles -= step * min(1.0, 0.3 / np.abs(step).max())
    assert np.abs(end - np.eye(4)).max() < 1e-14
    return loop


def _row(dimensions: Dimensions, angles: Array) -> tuple[Loop, Array]:
    """Compute the hinges in a row from the ground, and the frame (4, 4) past the last."""
    frame, points, axes = np.eye(4), [], []
    for a, twist, d, angle in zip(*dimensions[:3], angles, strict=True):
        points.append(frame[:3, 3])
        axes.append(frame[:3, 2])
        about = np.eye(4)
        about[:3, :3] = _turn(np.array([0.0, 0.0, 1.0]), angle) @ _turn(np.array([1.0, 0.0, 0.0]), twist)
        about[:3, 3] = [a * np.cos(angle), a * np.sin(angle), d]
        frame = frame @ about
    return Loop(np.array(points), np.array(axes)), frame


def _turn(axis: Array, angle: float) -> Array:
    """Compute the rotation (3, 3) about a unit axis."""
    k = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)


def linkage(name: str) -> Scene:
    """Return the scene of one of the `LOOPS`: bodies of no symmetry, hinges h0, h1, ..."""
    loop = closed(LOOPS[name])
    names = ["ground", *(f"b{k}" for k in range(len(loop.points) - 1))]
    bodies = [Body.ground()]
    for k, own in enumerate(names[1:]):
        center = 0.5 * (loop.points[k] + loop.points[k + 1]) + 0.05 * np.array([1.0, -1.0, 0.5]) * (k + 1)
        inertia = 0.01 * np.diag([2.0, 1.5 + 0.2 * k, 2.5]) + 0.002 * np.ones((3, 3))
        bodies.append(Body(own, 0.5 + 0.2 * k, center, inertia))
    hinges = [
        Revolute(f"h{k}", names[k], names[(k + 1) % len(names)], point, axis=axis, actuated=k == 0)
        for k, (point, axis) in enumerate(zip(*loop, strict=True))
    ]
    scene = Scene(name, Mechanism(bodies, hinges), DURATION, PERIOD, tuple(GRAVITY))
    return start(scene, h0=(0.0, SPEED))


def side_by_side(names: Sequence[str]) -> Scene:
    """Return a scene of several of the `LOOPS`, whose bodies and hinges have a number behind their names."""
    bodies, hinges = [Body.ground()], []
    for k, name in enumerate(names):
        alone = linkage(name).mechanism
        bodies += [replace(body, name=f"{body.name}_{k}") for body in alone.bodies[1:]]
        for hinge in alone.joints:
            first, second = (
                each if each == "ground" else f"{each}_{k}" for each in (hinge.first, hinge.second)
            )
            hinges.append(replace(hinge, name=f"{hinge.name}_{k}", first=first, second=second))
    scene = Scene("several", Mechanism(bodies, hinges), DURATION, PERIOD, tuple(GRAVITY))
    return start(scene, **{f"h0_{k}": (0.0, SPEED) for k in range(len(names))})


@cache
def centers(name: str) -> Array:
    """Compute the centers of mass (n, b, 3) of all bodies at the output times, m, to 1e-12.

    By other means than the equations of motion: angles follow the null space of the hinges' screws, at the
    speed that the conserved energy leaves to the only freedom. Poses are products of exponentials.
    """
    loop, scene = closed(LOOPS[name]), linkage(name)
    bodies = scene.mechanism.bodies[1:]

    def poses(angles: Array) -> tuple[Loop, list[Array], list[Array]]:
        """The hinges, and centers and rotations of the bodies."""
        turn, shift, now, middle, turns = np.eye(3), np.zeros(3), [], [], []
        for k, (point, axis) in enumerate(zip(*loop, strict=True)):
            now.append((turn @ point + shift, turn @ axis))
            if k < len(bodies):
                about = _turn(axis, angles[k])
                shift = shift + turn @ (point - about @ point)
                turn = turn @ about
                middle.append(turn @ bodies[k].center_of_mass + shift)
                turns.append(turn)
        return Loop(*map(np.array, zip(*now, strict=True))), middle, turns

    def at_unit_speed(angles: Array, before: Array) -> tuple[Array, float, float]:
        """Rates of the hinges, of length 1 and directed as others, twice the energy with them, and potential
        energy."""
        now, middle, turns = poses(angles)
        rates = np.linalg.svd(now.screws)[2][-1]
        rates *= np.sign(rates @ before)
        twice, potential, spin, speed = 0.0, 0.0, np.zeros(3), np.zeros(3)
        for k, body in enumerate(bodies):
            spin = spin + rates[k] * now.axes[k]
            speed = speed + rates[k] * np.cross(now.points[k], now.axes[k])
            own, velocity = turns[k].T @ spin, speed + np.cross(spin, middle[k])
            twice += body.mass * velocity @ velocity + own @ body.inertia @ own
            potential -= body.mass * GRAVITY @ middle[k]
        return rates, twice, potential

    directed = np.eye(len(loop.points))[0]  # the first hinge begins forward
    rates, twice, potential = at_unit_speed(np.zeros(len(loop.points)), directed)
    energy = 0.5 * twice * (SPEED / rates[0]) ** 2 + potential

    def derivative(time: float, angles: Array) -> Array:
        nonlocal directed
        rates, twice, potential = at_unit_speed(angles, directed)
        directed = rates
        return rates * np.sqrt(2.0 * (energy - potential) / twice)

    found = solve_ivp(
        derivative, (0.0, DURATION), np.zeros(len(loop.points)), "DOP853", scene.times, rtol=1e-13, atol=1e-14
    )
    return np.array([poses(angles)[1] for angles in found.y.T])
