"""Check the size of a scene against the limits within which all engines can run and be compared.

The limits are in `newton_euler.limits.LIMITS`; the user
can raise each with `--set NAME=VALUE`.
"""

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
from newton_euler.model.splines import Moves, Spline, Steps
from newton_euler.model.variable import functions_of

MIN_DURATION = 1e-6
"""Shortest duration of a scene, s. In less time, gravity moves a body by less than 5e-12 m, and the engines'
loop-closure errors are of that size."""


def check_scene(scene: Scene, file: str = "") -> None:
    """Raise `CrosscheckError` for a scene that is too large or too short for a comparison of engines.

    Args:
        scene: the scene.
        file: file that the scene was read from, which the error message names; the scene's name if empty.
    """
    where = file or f"scene {scene.name!r}"
    if scene.duration < MIN_DURATION:
        least = f"{MIN_DURATION:g} s, in which bodies move by more than round-off"
        raise CrosscheckError(f"{where}: duration is {scene.duration!r} s; needed: at least {least}")
    # steps are those of MuJoCo with crosscheck's timestep, states are poses of bodies at output times
    force_count = len(scene.control) + len(scene.forces) + len(scene.armatures)
    bodies = len(scene.mechanism.bodies)
    check_counts(where, {"bodies": bodies, "forces": force_count})
    check_counts(where, {"steps": scene.duration / TIMESTEP, "states": bodies * len(scene.times)})
    check_mechanism(where, scene.mechanism)
    forces = (*scene.control, *scene.forces)
    check_functions(where, scene.mechanism, scene.motions, forces, scene.duration)


def check_mechanism(where: str, mechanism: Mechanism) -> None:
    """Raise `CrosscheckError` for a mechanism that cannot move, is too large, or has too different masses.

    Args:
        where: file or scene that the error message names.
        mechanism: the mechanism.
    """
    # joints outside the spanning tree (cuts) close loops
    tree = SpanningTree(mechanism)
    if tree.nv == 0:
        raise CrosscheckError(f"{where}: no body can move; needed: a joint that lets one")
    loops = len(tree.cuts) + len(mechanism.couplings)
    check_counts(where, {"closures": loops, "velocities": tree.nv})
    # the first body is the ground
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
    """Raise `CrosscheckError` if functions of time have too many terms, knots or cycles.

    Every term adds to the compiled equations. A knot is a time at which a spline or a step function begins a
    new piece; a run restarts there. Cycles are periods and revolutions of the fastest function, which
    determines the time steps.

    Args:
        where: file or scene that the error message names.
        mechanism: the mechanism that is moved.
        motions: prescribed motions of joint coordinates.
        forces: control laws and forces, which may depend on functions of time.
        duration: duration of the run, s.
    """
    terms = cycles = knots = 0.0
    for motion in motions:
        kinds = mechanism.joint(motion.joint).coordinate_kinds
        # a slice, since an index out of range is reported elsewhere
        is_angle = kinds[motion.coordinate : motion.coordinate + 1] == ("hinge",)
        per_cycle = 2.0 * math.pi if is_angle else math.inf
        terms, knots = terms + _count_terms(motion.function), knots + len(motion.function.knots)
        cycles = float(np.maximum(cycles, _max_cycles(motion.function, duration, per_cycle)))
    for acting in forces:
        for attribute in acting.functions:  # names of the attributes that may be functions of time
            for function in functions_of(getattr(acting, attribute)):
                terms, knots = terms + _count_terms(function), knots + len(function.knots)
                cycles = float(np.maximum(cycles, _max_cycles(function, duration, math.inf)))
    check_counts(where, {"terms": terms, "cycles": cycles, "knots": knots})


def check_counts(where: str, counts: Mapping[str, float]) -> None:
    """Raise `CrosscheckError` for the first count that exceeds its limit.

    Args:
        where: file or scene that the error message names.
        counts: counts by the names of `newton_euler.limits.LIMITS`.
    """
    for name, count in counts.items():
        if problem := exceeded(name, count):
            raise CrosscheckError(f"{where}: {problem}")


def _count_terms(function: TimeFunction) -> int:
    """Count the sines and polynomial coefficients of a function of time; of a spline, those of one piece."""
    if isinstance(function, Sum):
        return sum(map(_count_terms, function.terms))
    if isinstance(function, Polynomial):
        return len(function.coefficients)
    if isinstance(function, Moves | Sine | Spline | Steps):
        # `piece_size`: numbers of one piece, its start and coefficients; 0 for a sine
        return max(1, function.piece_size)
    assert_never(function)


def _max_cycles(function: TimeFunction, duration: float, per_cycle: float) -> float:
    """Compute an upper bound on the periods and revolutions of a function from time 0 to `duration`.

    Args:
        function: function of time.
        duration: s.
        per_cycle: change of the function that is one revolution: 2 pi rad for an angle, infinite otherwise.
    """
    if isinstance(function, Polynomial):
        with np.errstate(all="ignore"):  # an overflow to infinity is above the limit, too
            powers = np.float64(duration) ** np.arange(len(function.coefficients))
            changes = np.abs(function.coefficients) * powers
        return float(np.sum(np.where(np.equal(function.coefficients, 0.0), 0.0, changes))) / per_cycle
    if isinstance(function, Sine):
        # periods, and revolutions: in each period an angle goes up and down by twice the amplitude
        periods = abs(function.angular_frequency) * duration / (2.0 * math.pi)
        return periods * (1.0 + 4.0 * abs(function.amplitude) / per_cycle) + abs(function.offset) / per_cycle
    if isinstance(function, Sum):
        return sum(_max_cycles(term, duration, per_cycle) for term in function.terms)
    if isinstance(function, Moves | Spline | Steps):
        return float(np.sum(np.abs(np.diff(function.values)))) / per_cycle
    assert_never(function)
