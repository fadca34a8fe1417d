"""Coverage analysis: which elements of a scene (masses, joints, springs, ...) a run tests.

A run may not depend on an element: the mass of a body in free fall, a spring that stays at rest, a hinge that
does not turn. Agreement of the engines then shows nothing about this element. In: a scene and the tolerances
of its trajectories. Out: for each element, how much a change of 10 % would move the bodies, relative to the
difference that a comparison of engines would detect. The change is visible if this ratio is above 1. A joint
is displaced instead: rotated by 0.1 rad, and moved by a tenth of the longest body.

The scene is simulated again with each element changed. Most simulations are shortened or avoided:

- Changes of parameters (such as masses) use code that is compiled once. The simulation ends as soon as the
  change is visible.
- Changes of bodies in mechanisms without loops: a lower bound from the accelerations may suffice, see
  `joint_loads.py`.
- Changes of constraints need new code, so other evidence is tried first. The change is visible if the poses
  of the original run violate the changed constraints. The change is invisible if the changed equations give
  the same accelerations along the run.
- A displaced joint can transmit forces only in its own constraint directions. The other part of the original
  reaction would accelerate the mechanism. The change is invisible if this part is small, and visible if it is
  large in a mechanism without loops.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from crosscheck.compare.changes import CHANGE, Element, TimePoint, elements
from crosscheck.compare.check import ERROR_PER_CHANGE, POSES, ROUND_OFF, Check, reach
from crosscheck.compare.joint_loads import JointLoads
from crosscheck.compare.run_differences import orientations_apart, positions_apart
from crosscheck.engines.adaptive import native_refined, native_run, newton_euler_options
from crosscheck.engines.engine import MAX_RELATIVE_ERROR
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System, at_time
from newton_euler.errors import AssemblyError, NearlyRedundantWarning, NewtonEulerError, SingularityError
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.runs.simulate import CompiledScene, simulate
from newton_euler.scalars import Array

TIME_POINTS = 16
"""Number of times of the run at which changed constraints are evaluated."""

SURELY_UNSEEN, SURELY_SEEN = 0.1, 10.0
"""Estimates of `Covered.effect` below and above which the changed scene is not simulated, which would need a
compilation for each changed joint."""

RUN_FRACTIONS = (1 / 64, 1 / 16, 1 / 4, 1)
"""Fractions of the run that are simulated one after the other until a change is visible; most changes are
visible in the first."""


@dataclass(frozen=True)
class Covered:
    """Coverage of an element: how much its change would move the bodies in a run.

    Attributes:
        element: kind and name, such as "mass of body 'crank'".
        effect: change of the motion if the element is changed by 10 %, divided by the difference between
            engines that a comparison would detect. A lower bound if it is above 1; infinite if the scene
            cannot be simulated with the change; 0 if `shared`.
        shared: True for digital controllers, whose code is the same in all engines: their agreement does not
            test it.
    """

    element: str
    effect: float
    shared: bool = False

    @property
    def tested(self) -> bool:
        """True if a change of 10 % in one engine would be detected by a comparison of engines."""
        return self.effect > 1.0 and not self.shared


@dataclass(frozen=True)
class Coverage:
    """Coverage of all elements of a scene.

    Attributes:
        elements: the elements.
        is_prescribed: True if prescribed motions determine all poses. Masses and forces then change only
            reactions and the forces of drives, and no motion of bodies tests them.
    """

    elements: tuple[Covered, ...]
    is_prescribed: bool = False

    @cached_property
    def untested(self) -> tuple[Covered, ...]:
        """Elements that the agreement of the engines does not test."""
        return tuple(covered for covered in self.elements if not covered.tested)

    def summary(self) -> list[dict[str, object]]:
        """All elements, for JSON; an infinite effect is null."""
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


def coverage(scene: Scene, runs: Mapping[str, Trajectory], checks: Sequence[Check]) -> Coverage | None:
    """Compute the coverage of runs that were compared; None if no trajectories were compared.

    Args:
        scene: the scene that was simulated.
        runs: run of each engine. Coverage is computed up to the end of the shortest run.
        checks: all checks; the tolerance is the smallest one of the trajectories.

    Raises:
        NewtonEulerError: for a scene that newton_euler does not run.
    """
    compared = [check for check in checks if check.level == "trajectories" and check.judged]
    length, angle = (  # tolerances of positions, m, and orientations, rad
        min((check.tolerance for check in compared if check.quantity == quantity), default=None)
        for quantity in POSES
    )
    if length is None or angle is None:
        return None
    end = min(len(run.time) for run in runs.values())
    return covered_by(scene, length, angle, end)


def covered_by(scene: Scene, length: float, angle: float, end: int | None = None) -> Coverage:
    """Compute the coverage of a scene's run.

    Args:
        scene: the scene.
        length, angle: tolerances of positions and orientations of trajectories, m and rad.
        end: number of output times that are considered; all if None.

    Raises:
        NewtonEulerError: for a scene that cannot be run.
    """
    all_elements = tuple(elements(scene))
    runs = _ChangedRuns(scene, all_elements, length, angle, end)
    return Coverage(
        tuple(Covered(each.name, runs.effect(each), each.shared) for each in all_elements),
        is_prescribed=bool(scene.motions) and mobility(scene).degrees_of_freedom == 0,
    )


class _ChangedRuns:
    """Runs of a scene with changed elements, compared with the run of the scene itself."""

    def __init__(
        self, scene: Scene, all_elements: Sequence[Element], length: float, angle: float, end: int | None
    ) -> None:
        """Simulate the scene itself.

        Args:
            scene, length, angle, end: see `covered_by`.
            all_elements: all elements of the scene, with their changes.
        """
        self._elements, self._settings = all_elements, newton_euler_options(scene)
        if "velocities" not in scene.outputs:
            scene = replace(scene, outputs=scene.outputs | {"velocities"})
        run = _run_or_partial(native_run, scene)
        finer = _run_or_partial(native_refined, scene)
        self.run = run if end is None else run.first(end)
        # Keep the energy output if the scene has it, so that compiled code of the scene can be used again
        wanted = scene.outputs & {"velocities", "energy"}
        self._scene = _until(replace(scene, outputs=wanted), self.run.time[-1])
        # Detectable differences, m and rad: the tolerance plus the integration errors of two engines, each
        # at most `MAX_RELATIVE_ERROR`, as in comparisons
        units = max(1.0, reach(scene, self.run.position)), 1.0
        changes_if_refined = (
            float(np.max(difference(self.run, finer))) for difference in (positions_apart, orientations_apart)
        )
        self._length, self._angle = (
            tolerance + 2.0 * min(ERROR_PER_CHANGE * change, MAX_RELATIVE_ERROR * unit)
            for tolerance, change, unit in zip((length, angle), changes_if_refined, units, strict=True)
        )

    def _simulate_parameters(self, scene: Scene) -> Trajectory | None:
        """Simulate a scene with other parameter values; None if the run does not complete."""
        return _completed_run(lambda: self._parametrized.with_scene(scene).simulate(**self._settings))

    @cached_property
    def _parametrized(self) -> CompiledScene:
        """Compiled code of the scene with all changed parameters as inputs."""
        names = dict.fromkeys(name for element in self._elements for name in element.parameters or ())
        return CompiledScene(self._scene, parameters=tuple(names))

    @cached_property
    def _states(self) -> list[tuple[float, State]]:
        """Times, s, and states of the run at `TIME_POINTS` times."""
        outputs = np.unique(np.linspace(0, len(self.run.time) - 1, TIME_POINTS).astype(int))
        return [(float(self.run.time[output]), self.run.state(output)) for output in outputs]

    @cached_property
    def _time_points(self) -> list[TimePoint]:
        """Times and poses of the run at `TIME_POINTS` times."""
        return [TimePoint(time, state.frames(), state.angles) for time, state in self._states]

    @cached_property
    def _shorter_scenes(self) -> list[Scene]:
        """The scene with shorter durations, see `RUN_FRACTIONS`, and with the full one."""
        count = len(self.run.time)
        ends = sorted({max(2, round(part * count)) for part in RUN_FRACTIONS if count > 1} | {count})
        return [_until(self._scene, self.run.time[end - 1]) for end in ends]

    def effect(self, element: Element) -> float:
        """Compute `Covered.effect` of an element."""
        if element.shared:
            return 0.0
        if element.parameters is not None:
            return self._parameter_effect(element)
        # Poses of the run under the changed constraints
        violation = element.violation(self._time_points, self._length, self._angle)
        if violation > 1.0:
            return violation
        # Reactions of the run at the displaced joint
        if element.displaced is not None and self._loads is not None:
            lower, upper = self._loads.motion_change(element.displaced)  # bounds, m
            detectable = self._length, self._angle * self._scene.mechanism.largest_extent  # m
            if lower > SURELY_SEEN * max(detectable):
                return lower / max(detectable)
            if max(violation, upper / min(detectable)) < SURELY_UNSEEN:
                return max(violation, upper / min(detectable))
        # Accelerations along the run with the changed equations
        try:
            changed = element.changed(self._scene)
        except AssemblyError:
            return np.inf  # the changed mechanism cannot be assembled
        if self._has_same_motion(changed):
            return 0.0
        # A simulation
        return self._difference(_completed_run(lambda: simulate(changed, **self._settings)))

    def _parameter_effect(self, element: Element) -> float:
        """Compute `Covered.effect` of an element whose parameters change."""
        effect = 0.0
        if element.body is not None and self._loads is not None:
            number, mass_or_inertia = element.body
            effect = self._loads.body_effect(number, mass_or_inertia, CHANGE, self._length, self._angle)
            if effect > SURELY_SEEN:
                return effect
        for shorter in self._shorter_scenes:
            effect = self._difference(self._simulate_parameters(element.changed(shorter)))
            if effect > 1.0:
                break
        return effect

    @cached_property
    def _loads(self) -> JointLoads | None:
        """Reactions along the run; None if they cannot be computed from states, as with digital control."""
        if not self._scene.sampled:
            with suppress(NewtonEulerError):
                return JointLoads(self._scene, self._states)
        return None

    def _difference(self, run: Trajectory | None) -> float:
        """Measure the largest difference of a run from the run of the scene itself, in detectable ones.

        The difference is infinite for None, a run that did not complete.
        """
        if run is None:
            return np.inf
        gaps = positions_apart(self.run, run) / self._length, orientations_apart(self.run, run) / self._angle
        return float(np.max(gaps))

    def _has_same_motion(self, changed: Scene) -> bool:
        """Return True if the equations of a changed scene give the same accelerations along the run."""
        if changed.sampled:
            return False  # forces of digital controllers, which sample the motion, do not follow from states
        original, other = Relative(self._scene), Relative(changed)
        with np.errstate(all="ignore"):  # results that are not finite compare as different
            try:
                return all(
                    _is_same(
                        _motion(at_time(original, time), state), _motion(at_time(other, time), state), changed
                    )
                    for time, state in self._states
                )
            except NewtonEulerError:
                return False


class _Motion(NamedTuple):
    """Poses (b, 7), velocities (b, 6) and accelerations (b, 6) of all bodies at one time."""

    poses: Array
    velocities: Array
    accelerations: Array


def _motion(system: System, state: State) -> _Motion:
    """Evaluate a system at the coordinates of a state.

    If the state violates the constraints of the system, its coordinates give other poses than the state has.
    """
    evaluation = system.evaluate(*system.coordinates(state))
    reached = evaluation.state
    return _Motion(
        poses=np.hstack([reached.position, reached.quaternion]),
        velocities=np.hstack([reached.linear_velocity, reached.angular_velocity]),
        accelerations=np.hstack([evaluation.linear_acceleration, evaluation.angular_acceleration]),
    )


def _is_same(one: _Motion, other: _Motion, scene: Scene) -> bool:
    """Return True if two motions differ by round-off only.

    Round-off is relative to the largest value. `scene` gives lower bounds of the largest value: its size (at
    least 1 m) for poses, and gravity for accelerations.
    """
    floors = max(1.0, scene.mechanism.size), 0.0, float(np.max(np.abs(scene.gravity)))
    return all(
        bool(np.max(np.abs(x - y)) <= ROUND_OFF * max(floor, float(np.max(np.abs(x)))))
        for x, y, floor in zip(one, other, floors, strict=True)
    )


def _run_or_partial(simulation: Callable[[Scene], Trajectory], scene: Scene) -> Trajectory:
    """Simulate a scene; return the partial run if the simulation stops after the start."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NearlyRedundantWarning)  # comparisons report it
            return simulation(scene)
    except StoppedError as error:
        if error.partial is None or len(error.partial.time) == 1:
            raise
        return error.partial


def _until(scene: Scene, end: float) -> Scene:
    """Return the scene with a shorter duration: one of its output times, s."""
    return scene if end == scene.duration else replace(scene, duration=end)


def _completed_run(simulation: Callable[[], Trajectory]) -> Trajectory | None:
    """Execute a simulation; return None if it does not complete."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NearlyRedundantWarning)  # the user got it for the scene itself
        with suppress(StoppedError, SingularityError):
            return simulation()
    return None
