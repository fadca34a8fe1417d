"""Coverage: which elements of a scene its run tests, as code coverage does for lines.

Engines that agree on a run tell nothing of what the run does not depend on: the mass of a body in free fall,
a spring that stays at rest, a hinge that does not turn. Each element is therefore changed by 10 % and the
scene run with it: how far that run parts from the scene's own is held against the tolerance of trajectories,
and against what both may be off by themselves.

Changes of parameters run in code that is compiled once, until they show; those of bodies of a tree are not
run where the accelerations that they cause show. Changes of constraints have equations of their own, and
are run only where nothing else tells: poses that violate the changed constraints by more than they could
within the tolerance are the poses of no run of the changed scene, nor are those along which a changed joint
of a tree does not carry the reactions; where it does, or where the changed equations give the same
accelerations all along the run, it is theirs too.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from crosscheck.compare.changes import CHANGE, Element, Moment, elements
from crosscheck.compare.check import OWN_ERROR, POSES, ROUND_OFF, UNRESOLVED, Check, reach
from crosscheck.compare.joint_loads import JointLoads
from crosscheck.compare.runs import orientations_apart, positions_apart
from crosscheck.engines.engine import native_method, native_refined, native_run
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System, at_time
from newton_euler.errors import AssemblyError, NearlyRedundantWarning, NewtonEulerError, SingularityError
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.runs.simulate import CompiledScene, simulate
from newton_euler.scalars import Array

MOMENTS = 16
"""Number of times of the run at which changed constraints are evaluated."""

SURELY_UNSEEN, SURELY_SEEN = 0.1, 10.0
"""Bounds on the estimated effect of a change, below and above which the changed scene is not simulated. Each
changed joint would need a compilation."""

RUN_FRACTIONS = (1 / 64, 1 / 16, 1 / 4, 1)
"""Fractions of the run that are simulated one after the other; most changes are visible in the first."""


@dataclass(frozen=True)
class Covered:
    """Coverage of an element: how much a change of it shows in a run.

    Attributes:
        element: kind and name, such as "mass of body 'crank'".
        effect: by how much a change of 10 % changes the motion, in units of what engines may differ by: at
            least, where it shows; infinite where the scene does not run to its end with it, 0 if shared.
        shared: see `Element`: controllers that are called at a period, and the computers of digital laws.
    """

    element: str
    effect: float
    shared: bool = False

    @property
    def tested(self) -> bool:
        """True if a change of 10 % in one engine would be seen, and is not the same in all of them."""
        return self.effect > 1.0 and not self.shared


@dataclass(frozen=True)
class Coverage:
    """Coverage of all elements of a scene."""

    elements: tuple[Covered, ...]

    @cached_property
    def untested(self) -> tuple[Covered, ...]:
        """Elements that the agreement of the engines does not test."""
        return tuple(covered for covered in self.elements if not covered.tested)

    def summary(self) -> list[dict[str, object]]:
        """All elements, for JSON; an infinite share is null."""
        return [
            {
                "element": each.element,
                "effect": each.effect if np.isfinite(each.effect) else None,
                "tested": each.tested,
                "shared": each.shared,
            }
            for each in self.elements
        ]

    def __str__(self) -> str:
        tested = len(self.elements) - len(self.untested)
        return f"motion covers {tested} of {len(self.elements)} elements"


def coverage(scene: Scene, runs: Mapping[str, Trajectory], rows: Sequence[Check]) -> Coverage | None:
    """Work out what compared runs cover, until the shortest ends, to the least tolerance of trajectories.

    None where no trajectories were compared.

    Raises:
        NewtonEulerError: for a scene that newton_euler does not run.
    """
    compared = [row for row in rows if row.level == "trajectories" and row.judged]
    length, angle = (
        min((row.tolerance for row in compared if row.quantity == quantity), default=None)
        for quantity in POSES
    )
    if length is None or angle is None:
        return None
    end = min(len(run.time) for run in runs.values())
    return covered_by(scene, length, angle, end)


def covered_by(scene: Scene, length: float, angle: float, end: int | None = None) -> Coverage:
    """Work out the coverage of a scene's run.

    Args:
        scene: what is run.
        length, angle: tolerances of trajectories, m and rad.
        end: how many of the output times count; all if None.

    Raises:
        NewtonEulerError: for a scene that cannot be run.
    """
    found = tuple(elements(scene))
    runs = _Runs(scene, found, length, angle, end)
    return Coverage(tuple(Covered(element.name, runs.effect(element), element.shared) for element in found))


class _Runs:
    """The run of a scene, and of the scene with changes."""

    def __init__(
        self, scene: Scene, found: Sequence[Element], length: float, angle: float, end: int | None
    ) -> None:
        self._elements, self._settings = found, native_method(scene, refined=False)
        if "velocities" not in scene.outputs:
            scene = replace(scene, outputs=scene.outputs | {"velocities"})
        run, finer = (_run_or_partial(each, scene) for each in (native_run, native_refined))
        self.run = run if end is None else run.first(end)
        # states with the work or without it, as those that code has been made for
        wanted = scene.outputs & {"velocities", "energy"}
        self._scene = _until(replace(scene, outputs=wanted), self.run.time[-1])
        units = max(1.0, reach(scene, self.run.position)), 1.0
        own = (float(np.max(apart(self.run, finer))) for apart in (positions_apart, orientations_apart))
        # both of two engines may be off by their own errors, as in comparisons
        self._length, self._angle = (
            tolerance + 2.0 * min(OWN_ERROR * error, UNRESOLVED * unit)
            for tolerance, error, unit in zip((length, angle), own, units, strict=True)
        )

    def _of(self, scene: Scene) -> Trajectory | None:
        """The run to its end of a scene with other parameters; None where there is none."""
        return _run(lambda: self._parametrized.with_scene(scene).simulate(**self._settings))

    @cached_property
    def _parametrized(self) -> CompiledScene:
        """The code of all changes of parameters."""
        names = dict.fromkeys(name for element in self._elements for name in element.parameters or ())
        return CompiledScene(self._scene, parameters=tuple(names))

    @cached_property
    def _states(self) -> list[tuple[float, State]]:
        rows = np.unique(np.linspace(0, len(self.run.time) - 1, MOMENTS).astype(int))
        return [(float(self.run.time[row]), self.run.state(row)) for row in rows]

    @cached_property
    def _moments(self) -> list[Moment]:
        return [Moment(time, state.frames(), state.angles) for time, state in self._states]

    @cached_property
    def _parts(self) -> list[Scene]:
        """The scene until shares of its run."""
        count = len(self.run.time)
        ends = sorted({max(2, round(share * count)) for share in RUN_FRACTIONS if count > 1} | {count})
        return [_until(self._scene, self.run.time[end - 1]) for end in ends]

    def effect(self, element: Element) -> float:
        """See `Covered.effect`."""
        if element.shared:
            return 0.0
        if element.parameters is not None:
            found = 0.0
            if element.body is not None and self._loads is not None:
                found = self._loads.share_of_body(*element.body, CHANGE, self._length, self._angle)
                if found > SURELY_SEEN:
                    return found
            for part in self._parts:
                found = self._apart(self._of(element.changed(part)))
                if found > 1.0:
                    break
            return found
        violated = element.violated(self._moments, self._length, self._angle)
        if violated > 1.0:
            return violated
        if element.displaced is not None and self._loads is not None:
            least, most = self._loads.parting(element.displaced)
            units = self._length, self._angle * self._scene.mechanism.longest
            if least > SURELY_SEEN * max(units):
                return least / max(units)
            if max(violated, most / min(units)) < SURELY_UNSEEN:
                return max(violated, most / min(units))
        try:
            changed = element.changed(self._scene)
        except AssemblyError:
            return np.inf  # with the change it cannot even begin
        if self._has_same_motion(changed):
            return 0.0
        return self._apart(_run(lambda: simulate(changed, **self._settings)))

    @cached_property
    def _loads(self) -> JointLoads | None:
        """Reactions at the moments; None where there are none, or no function of the states."""
        if not self._scene.sampled:
            with suppress(NewtonEulerError):
                return JointLoads(self._scene, self._states)
        return None

    def _apart(self, run: Trajectory | None) -> float:
        """Measure a run's distance from the scene's own, in what engines may differ by; infinite for none."""
        if run is None:
            return np.inf
        gaps = positions_apart(self.run, run) / self._length, orientations_apart(self.run, run) / self._angle
        return float(np.max(gaps))

    def _has_same_motion(self, changed: Scene) -> bool:
        """True if accelerations along the run are the same under the equations of a changed scene."""
        if changed.sampled:
            return False  # their forces are no function of the states
        own, other = Relative(self._scene), Relative(changed)
        with np.errstate(all="ignore"):  # numbers are compared
            try:
                return all(
                    _is_same(
                        _motion(at_time(own, time), state), _motion(at_time(other, time), state), changed
                    )
                    for time, state in self._states
                )
            except NewtonEulerError:
                return False


Motion = tuple[Array, Array, Array]
"""Poses (b, 7), velocities (b, 6) and accelerations (b, 6) of all bodies."""


def _motion(system: System, state: State) -> Motion:
    """Evaluate a system at the state that it can be in next to a given one."""
    found = system.evaluate(*system.coordinates(state))
    own = found.state
    return (
        np.hstack([own.position, own.quaternion]),
        np.hstack([own.linear_velocity, own.angular_velocity]),
        np.hstack([found.linear_acceleration, found.angular_acceleration]),
    )


def _is_same(own: Motion, other: Motion, scene: Scene) -> bool:
    """True if two motions are one but for round-off."""
    floors = max(1.0, scene.mechanism.size), 0.0, float(np.max(np.abs(scene.gravity)))
    return all(
        bool(np.max(np.abs(x - y)) <= ROUND_OFF * max(floor, float(np.max(np.abs(x)))))
        for x, y, floor in zip(own, other, floors, strict=True)
    )


def _run_or_partial(engine: Callable[[Scene], Trajectory], scene: Scene) -> Trajectory:
    """Run the scene; return the partial run if the engine stops after the start."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NearlyRedundantWarning)
            return engine(scene)
    except StoppedError as error:
        if error.partial is None or len(error.partial.time) == 1:
            raise
        return error.partial


def _until(scene: Scene, end: float) -> Scene:
    """The scene until one of its output times, s."""
    return scene if end == scene.duration else replace(scene, duration=end)


def _run(simulated: Callable[[], Trajectory]) -> Trajectory | None:
    """A run to its end; None where there is none."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NearlyRedundantWarning)  # told of the scene itself
        with suppress(StoppedError, SingularityError):
            return simulated()
    return None
