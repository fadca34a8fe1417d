"""Singular configurations that a run starts in or passes, where a mechanism could change its branch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.compare.samples import body_units
from crosscheck.engines.engine import native_method
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

SINGULAR = 1e-3
"""Smallest singular value of the constraints next to a singular configuration, divided by the largest one
along the run. A four-bar with bars of 0.5 and 1 m that misses the configuration by 1e-7 m comes to 3.5e-4,
one that misses it by 1e-6 m to 1.1e-3."""

EVALUATIONS = 600
"""Number of outputs at which the constraints of a run are evaluated, times the number of velocities."""

FEWEST_OUTPUTS = 30

MOST_ELEMENTS = 2000
"""Elements of the constraint Jacobian of the largest mechanism that is searched, which takes about 2 s."""

DIP = 0.5
"""Smallest singular value at an output, divided by the larger one at its neighbors, below which the run is
repeated with closer outputs. At a crossing between outputs it is a third or less."""

CLOSER = 32
"""Factor by which outputs of the repeated run are closer."""

NARROWER = 4
"""Factor by which the three outputs move together from which the vertex is computed anew."""

MOST_CLOSER = 100_000
"""Number of outputs of the repeated run, at most."""

GAINED = 10.0
"""Other singular values that vanish with the smallest one are at most so many times as large beside it."""

LARGE_SHARE = 0.3
"""Motion of a body in the freedoms that are gained, divided by the largest one, from which it is named."""


@dataclass(frozen=True)
class SingularConfigurations:
    """Singular configurations of a run.

    Attributes:
        times: (k,) s, at which the run is in a singular configuration or next to it; 0 is the start.
        distance: smallest singular value of the constraints at the first time, divided by the largest one
            along the run.
        freedoms: number of freedoms that the mechanism gains there.
        bodies: names of the bodies that these freedoms move.
    """

    times: tuple[float, ...]
    distance: float
    freedoms: int
    bodies: tuple[str, ...]

    def __str__(self) -> str:
        first, *others = self.times
        begins = "starts in" if first == 0.0 else "passes"
        when = f"at {first:.4g} s{' and at other times' if others else ''}"
        gained = f"{self.freedoms} freedom{'s' * (self.freedoms > 1)}"
        return (
            f"{begins} a singular configuration {when}: bodies {listed(self.bodies)} gain {gained} there and "
            f"may go over to another branch"
        )


def find_singular_configurations(scene: Scene, run: Trajectory) -> SingularConfigurations | None:
    """Find the singular configurations that a run starts in or passes; None if there are none.

    The smallest singular value of the independent constraints is evaluated at some outputs. Near a singular
    configuration its square is a parabola of time, with a vertex at 0. Where it dips, the run is repeated
    with closer outputs, and the time of the vertex computed from three of them. The value there is that of
    the run's configuration at this time. If the repeated run stops before, it is that of the output.

    Raises:
        CrosscheckError: for a mechanism that is too large to search.
    """
    system = Relative(scene)
    count = constraint_rank(system)
    if not count:
        return None
    if count * system.nv > MOST_ELEMENTS:
        size = f"{count} independent constraints of {system.nv} velocities are {count * system.nv} elements"
        raise CrosscheckError(f"left out, as {size}; at most {MOST_ELEMENTS} are searched")

    def margin(q: Array) -> float:
        return float(_spectrum(system, q, count)[0][-1])

    def margins_at(run: Trajectory, outputs: Sequence[int]) -> list[float]:
        return [margin(system.coordinates(run.state(k))[0]) for k in outputs]

    number = max(FEWEST_OUTPUTS, EVALUATIONS // system.nv)
    outputs = np.unique(np.linspace(0, len(run.time) - 1, number).astype(int)).tolist()
    margins = margins_at(run, outputs)
    largest = max(margins)
    candidates = [(float(run.time[0]), system.coordinates(run.state(0))[0])]
    closer: Trajectory | None = None
    for k in range(1, len(outputs) - 1):
        if margins[k] > min(margins[k - 1], DIP * max(margins[k - 1], margins[k + 1]), margins[k + 1]):
            continue
        closer = closer or _closer(scene, len(run.time))
        if closer.time[-1] < run.time[outputs[k + 1]]:  # it stopped before
            candidates.append((float(run.time[outputs[k]]), system.coordinates(run.state(outputs[k]))[0]))
            continue
        time = _vertex(run.time[outputs[k - 1 : k + 2]], margins[k - 1 : k + 2])
        apart = min(CLOSER * (outputs[k + 1] - outputs[k - 1]), len(closer.time) - 1)
        while apart > 1:
            apart = max(1, apart // NARROWER)
            middle = int(np.clip(np.searchsorted(closer.time, time), apart, len(closer.time) - 1 - apart))
            near = [middle - apart, middle, middle + apart]
            time = _vertex(closer.time[near], margins_at(closer, near))
        candidates.append((time, _configuration(system, closer, time)))
    found = [(time, q) for time, q in candidates if margin(q) < SINGULAR * largest]
    if not found:
        return None
    _, q = found[0]
    values, directions = _spectrum(system, q, count)
    gained = int(np.sum(values < max(GAINED * values[-1], SINGULAR * largest)))
    turned = directions[count - gained :] / system.velocity_units
    motion = np.abs(system.velocity_transformation(q) @ turned.T / body_units(scene)[:, None])
    share = np.max(motion.reshape(len(scene.mechanism.bodies), -1), axis=1)
    names = np.array(scene.mechanism.body_names)[share > LARGE_SHARE * np.max(share)]
    return SingularConfigurations(
        tuple(time for time, _ in found), margin(q) / largest, gained, tuple(names.tolist())
    )


def _spectrum(system: Relative, q: Array, count: int) -> tuple[Array, Array]:
    """Compute the largest singular values of the constraints (count,) and their directions (count, nv)."""
    _, values, directions = np.linalg.svd(dimensionless_jacobian(system, q))
    return values[:count], directions[:count]


def _configuration(system: Relative, run: Trajectory, time: float) -> Array:
    """Compute the configuration of a run between two outputs, (nq,).

    The nearest output is moved by its velocity and by the acceleration between its neighbors, and its loops
    are closed. If they do not close, the result is the nearest output.
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


def _closer(scene: Scene, outputs: int) -> Trajectory:
    """Repeat a run with closer outputs, as far as it comes."""
    factor = max(1, min(CLOSER, MOST_CLOSER // outputs))
    finer = replace(scene, output_period=scene.output_period / factor, outputs=frozenset(["velocities"]))
    try:
        return simulate(finer, **native_method(finer, refined=False))
    except StoppedError as error:
        if error.partial is None:
            raise
        return error.partial


def _vertex(times: Array, values: Sequence[float]) -> float:
    """Compute the time of the vertex of the parabola through three squares, within the three times."""
    a, b, _ = np.polyfit(times - times[1], np.square(values), 2)
    if a <= 0.0:
        return float(times[1])
    return float(times[1] + np.clip(-0.5 * b / a, times[0] - times[1], times[2] - times[1]))
