"""Singular configurations that a run starts in or passes.

In a singular configuration the constraints lose rank: the mechanism gains freedoms (independent velocities)
there, and could continue on another branch of motion. In: a scene (a mechanism with its forces and initial
state) and a run of it. Out: the times, and the bodies that the gained freedoms move.

The distance from a singular configuration is measured by the margin: the smallest singular value of the
dimensionless Jacobian of the independent constraints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from crosscheck.compare.allowed_motions import body_units
from crosscheck.compare.note import Note
from crosscheck.engines.adaptive import newton_euler_options
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.redundancy import constraint_rank
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import at_time, dimensionless_jacobian
from newton_euler.errors import AssemblyError, listed
from newton_euler.integrators.projection import project_position
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.runs.simulate import simulate
from newton_euler.scalars import Array

SINGULAR_RATIO = 1e-3
"""Largest margin of a configuration that is reported as singular, divided by the largest margin along the
run. Example: a four-bar with bars of 0.5 and 1 m that misses a singular configuration by 1e-7 m has a ratio
of 3.5e-4. If it misses the configuration by 1e-6 m, the ratio is 1.1e-3."""

EVALUATION_BUDGET = 600
"""Number of outputs at which the constraints of a run are evaluated, times the number of joint velocities."""

MIN_EVALUATED_OUTPUTS = 30
"""Smallest number of outputs at which the constraints of a run are evaluated."""

MAX_JACOBIAN_ELEMENTS = 2000
"""Largest number of elements of the constraint Jacobian of a mechanism that is searched; it takes about 2
s."""

DIP_RATIO = 0.5
"""Largest margin at a local minimum, divided by the larger margin of its neighbors, at which the run is
repeated with closer outputs. If the run crosses a singular configuration between outputs, the ratio is a
third or less."""

REFINEMENT = 32
"""Factor on the number of outputs of the repeated run."""

NARROWING = 4
"""Factor by which the interval around the minimum shrinks in each iteration."""

MAX_REFINED_OUTPUTS = 100_000
"""Largest number of outputs of the repeated run."""

GAINED_RATIO = 10.0
"""Largest ratio of another singular value to the smallest one at which both belong to gained freedoms."""

NAMED_MOTION_FRACTION = 0.3
"""Smallest velocity of a body in the gained freedoms at which the report names the body, divided by the
largest velocity of any body."""


@dataclass(frozen=True)
class SingularConfigurations:
    """Singular configurations of a run.

    Attributes:
        times: times, s, at which the run is in a singular configuration or close to it; 0 is the start.
        distance: margin at the first of these times, divided by the largest margin along the run.
        freedoms: number of freedoms that the mechanism gains at the first time.
        bodies: names of the bodies that these freedoms move.
    """

    times: tuple[float, ...]
    distance: float
    freedoms: int
    bodies: tuple[str, ...]

    def __str__(self) -> str:
        first, *others = self.times
        begins = Note.STARTS_SINGULAR if first == 0.0 else Note.PASSES_SINGULAR
        when = f"at {first:.4g} s{' and at other times' if others else ''}"
        gained = f"{self.freedoms} freedom{'s' * (self.freedoms > 1)}"
        return (
            f"{begins} {when}: bodies {listed(self.bodies)} gain {gained} there and "
            f"may go over to another branch"
        )


class Configuration(NamedTuple):
    """Time, s, and joint coordinates q (nq,) of a configuration of a run."""

    time: float
    q: Array


def find_singular_configurations(scene: Scene, run: Trajectory) -> SingularConfigurations | None:
    """Find the singular configurations that a run starts in or passes; None if there are none.

    The margin is evaluated at some outputs of the run. Near a singular configuration the square of the margin
    is a parabola of time whose minimum is 0. At a local minimum the run is repeated with closer outputs, and
    the time of the minimum is computed from parabolas through three outputs. If the repeated run stops before
    that time, the output with the minimum is used.

    Args:
        scene: the scene.
        run: its run in one engine.

    Raises:
        CrosscheckError: for a mechanism that is too large to search.
    """
    system = Relative(scene)  # the equations in joint coordinates
    count = constraint_rank(system)
    if not count:
        return None
    if count * system.nv > MAX_JACOBIAN_ELEMENTS:
        size = f"{count} independent constraints of {system.nv} velocities are {count * system.nv} elements"
        raise CrosscheckError(f"left out, as {size}; at most {MAX_JACOBIAN_ELEMENTS} are searched")

    def margin(q: Array) -> float:
        values, _ = _spectrum(system, q, count)
        return float(values[-1])

    def at_output(run: Trajectory, output: int) -> Configuration:
        q, _ = system.coordinates(run.state(output))
        return Configuration(float(run.time[output]), q)

    def margins_at(run: Trajectory, outputs: Sequence[int]) -> list[float]:
        return [margin(at_output(run, output).q) for output in outputs]

    # The margin along the run
    number = max(MIN_EVALUATED_OUTPUTS, EVALUATION_BUDGET // system.nv)
    outputs = np.unique(np.linspace(0, len(run.time) - 1, number).astype(int)).tolist()
    margins = margins_at(run, outputs)
    largest = max(margins)
    # Candidates: the start, and all local minima that are deep enough
    candidates = [at_output(run, 0)]
    closer: Trajectory | None = None  # the repeated run with closer outputs
    for k in range(1, len(outputs) - 1):
        if margins[k] > min(margins[k - 1], DIP_RATIO * max(margins[k - 1], margins[k + 1]), margins[k + 1]):
            continue
        closer = closer or _repeat_with_closer_outputs(scene, len(run.time))
        if closer.time[-1] < run.time[outputs[k + 1]]:  # the repeated run stopped before
            candidates.append(at_output(run, outputs[k]))
            continue
        # Compute the time of the minimum from three outputs of the repeated run, closer and closer together
        time = _time_of_minimum(run.time[outputs[k - 1 : k + 2]], margins[k - 1 : k + 2])
        spacing = min(REFINEMENT * (outputs[k + 1] - outputs[k - 1]), len(closer.time) - 1)
        while spacing > 1:
            spacing = max(1, spacing // NARROWING)
            middle = int(np.clip(np.searchsorted(closer.time, time), spacing, len(closer.time) - 1 - spacing))
            near = [middle - spacing, middle, middle + spacing]
            time = _time_of_minimum(closer.time[near], margins_at(closer, near))
        candidates.append(Configuration(time, _coordinates_at(system, closer, time)))
    singular = [each for each in candidates if margin(each.q) < SINGULAR_RATIO * largest]
    if not singular:
        return None
    # The freedoms gained at the first singular configuration: directions of the smallest singular values
    q = singular[0].q
    values, directions = _spectrum(system, q, count)
    gained = int(np.sum(values < max(GAINED_RATIO * values[-1], SINGULAR_RATIO * largest)))
    # The units below, (nv,) and (6 b,), make velocities of joints and bodies comparable: the mechanism's size
    # for linear ones, 1 for angular ones
    gained_velocities = directions[count - gained :] / system.velocity_units
    # The bodies that these freedoms move
    motion = np.abs(system.velocity_transformation(q) @ gained_velocities.T / body_units(scene)[:, None])
    largest_motion = np.max(motion.reshape(len(scene.mechanism.bodies), -1), axis=1)
    is_named = largest_motion > NAMED_MOTION_FRACTION * np.max(largest_motion)
    names = np.array(scene.mechanism.body_names)[is_named]
    return SingularConfigurations(
        times=tuple(each.time for each in singular),
        distance=margin(q) / largest,
        freedoms=gained,
        bodies=tuple(names.tolist()),
    )


def _spectrum(system: Relative, q: Array, count: int) -> tuple[Array, Array]:
    """Compute the `count` largest singular values of the dimensionless constraint Jacobian.

    Returns:
        Singular values (count,), largest first, and their directions in joint velocities (count, nv).
    """
    _, values, directions = np.linalg.svd(dimensionless_jacobian(system, q))
    return values[:count], directions[:count]


def _coordinates_at(system: Relative, run: Trajectory, time: float) -> Array:
    """Compute the joint coordinates (nq,) of a run at a time, s, between two outputs.

    The coordinates are extrapolated from the nearest output, by its velocity and by the acceleration between
    its neighbors. Then the loops are closed. If they cannot be closed, the nearest output is returned.
    """
    nearest = int(np.argmin(np.abs(run.time - time)))
    before, after = max(nearest - 1, 0), min(nearest + 1, len(run.time) - 1)
    (_, earlier), (q, v), (_, later) = (system.coordinates(run.state(k)) for k in (before, nearest, after))
    acceleration = (later - earlier) / (run.time[after] - run.time[before])
    step = time - run.time[nearest]
    system = at_time(system, time)
    try:
        return project_position(system, system.retract(q, step * v + 0.5 * step**2 * acceleration))
    except AssemblyError:
        return q


def _repeat_with_closer_outputs(scene: Scene, outputs: int) -> Trajectory:
    """Simulate a scene again with closer outputs; the run is partial if it stops.

    Args:
        scene: the scene.
        outputs: number of outputs of the original run.
    """
    factor = max(1, min(REFINEMENT, MAX_REFINED_OUTPUTS // outputs))
    finer = replace(scene, output_period=scene.output_period / factor, outputs=frozenset(["velocities"]))
    # crosscheck's usual integrator and tolerances for the scene, not the tighter ones of a refined run
    options = newton_euler_options(finer)
    try:
        return simulate(finer, **options)
    except StoppedError as error:
        if error.partial is None:
            raise
        return error.partial


def _time_of_minimum(times: Array, values: Sequence[float]) -> float:
    """Compute the time, s, of the minimum of the parabola through the squares of three values.

    The result is limited to the interval of the three times. It is the middle time if the parabola has no
    minimum.
    """
    a, b, _ = np.polyfit(times - times[1], np.square(values), 2)
    if a <= 0.0:
        return float(times[1])
    return float(times[1] + np.clip(-0.5 * b / a, times[0] - times[1], times[2] - times[1]))
