"""The size of a scene, checked against the limits of what can be run and compared."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import assert_never

import numpy as np

from crosscheck.support.errors import CrosscheckError
from mjcf.write import TIMESTEP
from newton_euler.limits import exceeded
from newton_euler.model.digital_control import Law
from newton_euler.model.forces import Force
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import PrescribedMotion, Sum, TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.splines import Spline, Steps
from newton_euler.model.variable import functions_of

LEAST_DURATION = 1e-6
"""s; in less, gravity moves a body by less than 5e-12 m, which engines hold joints closed to."""


def check_scene(scene: Scene, file: str = "") -> None:
    """Raise `CrosscheckError` for a scene too large, or too short, to be run by all engines and compared.

    Args:
        file: that it was read from, to be named instead of the scene.
    """
    where = file or f"scene {scene.name!r}"
    if scene.duration < LEAST_DURATION:
        least = f"{LEAST_DURATION:g} s, in which bodies move by more than round-off"
        raise CrosscheckError(f"{where}: duration is {scene.duration!r} s; needed: at least {least}")
    count = len(scene.control) + len(scene.forces) + len(scene.armatures)
    bodies = len(scene.mechanism.bodies)
    check_counts(where, {"bodies": bodies, "forces": count})
    check_counts(where, {"steps": scene.duration / TIMESTEP, "states": bodies * len(scene.times)})
    check_mechanism(where, scene.mechanism)
    forces = (*scene.control, *scene.forces)
    check_functions(where, scene.mechanism, scene.motions, forces, scene.duration)


def check_mechanism(where: str, mechanism: Mechanism) -> None:
    """Raise `CrosscheckError` for a mechanism that cannot move, is too large, or has too different masses."""
    tree = SpanningTree(mechanism)
    if tree.nv == 0:
        raise CrosscheckError(f"{where}: no body can move; needed: a joint that lets one")
    loops = len(tree.cuts) + len(mechanism.couplings)
    check_counts(where, {"closures": loops, "velocities": tree.nv})
    bodies = sorted(mechanism.bodies[1:], key=lambda body: body.mass)
    light, heavy = bodies[0], bodies[-1]
    check_counts(f"{where}: {heavy.name!r} to {light.name!r}", {"mass_ratio": heavy.mass / light.mass})


def check_functions(
    where: str,
    mechanism: Mechanism,
    motions: Iterable[PrescribedMotion],
    forces: Iterable[Law | Force],
    duration: float,
) -> None:
    """Raise `CrosscheckError` for functions of too many terms, knots, or cycles in `duration` (s).

    Terms add to what is compiled; steps are as short as the fastest function and the knots ask for.
    """
    terms = cycles = knots = 0.0
    for motion in motions:
        joint = mechanism.joint(motion.joint)
        kinds = joint.coordinate_kinds
        per_cycle = (
            2.0 * math.pi if kinds[motion.coordinate : motion.coordinate + 1] == ("hinge",) else math.inf
        )
        terms, knots = terms + _terms(motion.function), knots + len(motion.function.knots)
        cycles = float(np.maximum(cycles, _cycles(motion.function, duration, per_cycle)))
    for acting in forces:
        for attribute in acting.functions:
            for function in functions_of(getattr(acting, attribute)):
                terms, knots = terms + _terms(function), knots + len(function.knots)
                cycles = float(np.maximum(cycles, _cycles(function, duration, math.inf)))
    check_counts(where, {"terms": terms, "cycles": cycles, "knots": knots})


def check_counts(where: str, counts: Mapping[str, float]) -> None:
    """Raise `CrosscheckError` for the first of some numbers that is above the limit of its name."""
    for name, count in counts.items():
        if problem := exceeded(name, count):
            raise CrosscheckError(f"{where}: {problem}")


def _terms(function: TimeFunction) -> int:
    """The number of sines and coefficients, those of one piece of splines and steps."""
    if isinstance(function, Sum):
        return sum(map(_terms, function.terms))
    if isinstance(function, Polynomial):
        return len(function.coefficients)
    if isinstance(function, Sine | Spline | Steps):
        return max(1, function.numbers)
    assert_never(function)


def _cycles(function: TimeFunction, duration: float, per_cycle: float) -> float:
    """Return a bound on the number of cycles of a motion from 0 to `duration` (s).

    Args:
        per_cycle: rad, or infinite for a slide.
    """
    if isinstance(function, Polynomial):
        with np.errstate(all="ignore"):  # what overflows is too large as well
            powers = np.float64(duration) ** np.arange(len(function.coefficients))
            ways = np.abs(function.coefficients) * powers
        return float(np.sum(np.where(np.equal(function.coefficients, 0.0), 0.0, ways))) / per_cycle
    if isinstance(function, Sine):
        periods = abs(function.angular_frequency) * duration / (2.0 * math.pi)
        return periods * (1.0 + 4.0 * abs(function.amplitude) / per_cycle) + abs(function.offset) / per_cycle
    if isinstance(function, Sum):
        return sum(_cycles(term, duration, per_cycle) for term in function.terms)
    if isinstance(function, Spline | Steps):
        return float(np.sum(np.abs(np.diff(function.values)))) / per_cycle
    assert_never(function)
