"""Equilibrium: the pose in which the run of a mechanism comes to rest, found without leaving its branch.

The search follows a motion that the mechanism can make, so that its poses belong to one assembly branch
unless the motion itself passes a singular configuration, which is counted. If damping brings the run to
rest, the motion is the run. Otherwise it is slow motion: each pose moves as its accelerations show, without
inertia. Slow motion loses potential energy all the time, like motion with much damping. Newton's method ends
the search; near an equilibrium it is slow motion of any duration.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from newton_euler.analysis.kinematics.crossings import Passage, passage
from newton_euler.analysis.kinematics.freedoms import chosen_freedoms
from newton_euler.analysis.linear.linear_model import RIGID_MODE, LinearModel
from newton_euler.analysis.linear.linearization import linearize
from newton_euler.arguments import caller_level, checked
from newton_euler.equations.dense import largest, least_squares
from newton_euler.equations.relative import Relative
from newton_euler.errors import BranchWarning, NoEquilibriumError, OptionError, SingularityError
from newton_euler.integrators.projection import project_position
from newton_euler.model.digital_control import Digital
from newton_euler.model.motions import PrescribedMotion, TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError, Trajectory
from newton_euler.model.variable import Function, functions_of
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import compile_scene
from newton_euler.scalars import Array

MAX_EQUILIBRIUM_STEP = 0.1
"""Longest step of slow motion, rad or sizes of the mechanism."""

MAX_CORRECTION = 0.3
"""Largest change of a step by closing the loops, as a fraction of the step. A step with a larger one may have
left its branch, and is halved."""

MIN_EQUILIBRIUM_STEP = 1e-4
"""Step, rad or sizes of the mechanism, that is taken although closing the loops changes it much."""

MAX_ITERATIONS = 300
"""Largest number of steps towards an equilibrium."""

CONVERGED_STEP = 1e-10
"""Length of the last step, rad or sizes of the mechanism, towards an equilibrium. Newton's method converges
quadratically: the remaining error is about the square of the step."""

ROUND_OFF_STEP = 1e-14
"""Length of a step, rad or sizes of the mechanism, below which the step is round-off and is not taken."""

REST_SPEED = 1e-3
"""Speed, as a fraction of the largest one in the run, below which a run is at rest."""

SETTLING_RUNS = 6
"""Largest number of runs, each twice as long as the one before, in which a mechanism may come to rest."""

SLOWER = 0.9
"""Fraction of the largest speed of a run that the next run does not reach if damping brings it to rest."""

MAX_SETTLING_STEPS = 20_000
"""Largest number of time steps of a run in which a mechanism may come to rest."""

RUN_OUTPUTS = 200
"""Number of outputs of such a run. Between two outputs the mechanism moves little."""

MAX_END_CHANGE = 1e-6
"""Largest change of a function of time per duration of the run, as a fraction of its largest value, with
which the function counts as constant at the end of the run. Samples of splines have about 9 digits."""

MAX_EXPONENT = 200.0
"""Largest exponent of a growing displacement in slow motion; longer spans are halved anyway."""


@dataclass(frozen=True, eq=False)
class Rest:
    """An equilibrium, and how it was found.

    Attributes:
        state: pose at rest.
        scene: the scene at rest whose equilibrium the pose is; its functions of time are constant.
        settles: True if the run comes to rest there; False if slow motion was followed.
        passage: singular configurations on the way from the initial pose.
        passing_times: times, s, at which the run has just passed them; NaN in slow motion.
        time: s, at which functions of time are held.

    Examples:
        >>> rest = settle(load("tracker_gravity"))
        >>> print(rest.settles, rest.passage.beyond, rest.passing_times)
        True True (0.125,)
    """

    state: State
    scene: Scene
    settles: bool
    passage: Passage
    passing_times: tuple[float, ...]
    time: float


def at_rest(scene: Scene) -> Scene:
    """Return the scene with a start at rest, and with functions of time that hold their values at time 0.

    Functions of time are set-points, feedforwards, wind speeds and prescribed motions.
    """
    start = initial_state(scene)
    return replace(_held(scene, time=0.0), initial_state=_without_velocities(start))


def _without_velocities(state: State) -> State:
    """Return a state at rest in the same pose."""
    zero = np.zeros_like(state.position)
    return replace(state, linear_velocity=zero, angular_velocity=zero)


def _held(scene: Scene, time: float) -> Scene:
    """Return the scene with functions of time that hold their values at a time, s."""
    control = [
        replace(law, law=_constant(law.law, time)) if isinstance(law, Digital) else _constant(law, time)
        for law in scene.control
    ]
    forces, motions = ([_constant(each, time) for each in group] for group in (scene.forces, scene.motions))
    return replace(scene, control=tuple(control), forces=tuple(forces), motions=tuple(motions))


def _constant(element: Any, time: float) -> Any:
    """Return an element of a scene with functions of time that hold their values at a time, s."""

    def held(value: Any) -> Any:
        """Return the value of a function; other numbers as they are."""
        return float(value.value(time)) if isinstance(value, Function) else value

    changes: dict[str, Any] = {}
    for name in element.functions:
        value = getattr(element, name)
        if not functions_of(value):
            continue
        if isinstance(element, PrescribedMotion):  # its function cannot be a number
            changes[name] = Polynomial((held(value),))
        elif isinstance(value, Function):
            changes[name] = held(value)
        else:
            changes[name] = {key: held(each) for key, each in value.items()}
    return replace(element, **changes) if changes else element


def resting_time(scene: Scene) -> float:
    """Return the time, s, at which functions of time are held for an equilibrium: the end of the run, if all
    of them are constant there, else 0."""
    functions = [function for group in scene.functions.values() for function in group]
    return scene.duration if functions and all(_ends_still(f, scene.duration) for f in functions) else 0.0


def _ends_still(function: TimeFunction, end: float) -> bool:
    """Return True if rate and acceleration of a function are round-off at the end of a run, s."""
    scale = max(abs(float(function.value(time))) for time in np.linspace(0.0, end, RUN_OUTPUTS))
    changes = abs(function.rate(end)) * end, abs(function.acceleration(end)) * end**2
    return max(changes) <= MAX_END_CHANGE * scale


@checked
def equilibrium(scene: Scene, state: State | None = None) -> State:
    """Find the pose in which a mechanism comes to rest.

    Control laws, springs, wrenches and gravity balance in this pose. If damping brings the run of the scene
    to rest, the pose is the end of the run. Otherwise the pose is where slow motion from the start ends: a
    motion without inertia that follows the forces. The pose is unstable only if no force leads away from the
    start. Functions of time, such as set-points, hold their values at time 0, as in the scene that `at_rest`
    returns.

    Args:
        scene: the mechanism with its forces and control laws.
        state: state to begin at, its velocities ignored; the scene's initial state if None.

    Raises:
        NoEquilibriumError: if the mechanism does not come to rest.
        NewtonEulerError: see `linearize`.

    Warns:
        BranchWarning: if the pose lies on another assembly branch than the start.

    Examples:
        >>> scene = load("stewart")
        >>> linearize(scene, equilibrium(scene)).is_equilibrium
        True
    """
    if state is not None:
        scene.check_numbers(state, f"state of scene {scene.name!r}")
        scene = replace(_held(scene, time=0.0), initial_state=_without_velocities(state))
    found = settle(scene, time=0.0)
    if found.passage.beyond:
        warnings.warn(BranchWarning(scene.name, found.passage.coordinates), stacklevel=caller_level())
    return found.state


def settle(scene: Scene, time: float | None = None) -> Rest:
    """Find the equilibrium of `equilibrium`, and report how it was found.

    Args:
        scene: the mechanism with its forces and control laws.
        time: s, of functions of time: the scene runs until then, and its functions of time hold their values
            from then on. If None, the end of the run if all of them are constant there, else 0.

    Raises:
        OptionError: for a time that is not within the run.
        NoEquilibriumError: if the mechanism does not come to rest.
        NewtonEulerError: see `linearize`, and `simulate` for the run until `time`.

    Examples:
        >>> settle(load("tracker_gravity")).settles
        True
    """
    path, time = _Path([0.0], [initial_state(scene)]), resting_time(scene) if time is None else time
    if not 0.0 <= time <= scene.duration:
        raise OptionError("time", time, f"a time of the run, 0 to {scene.duration:g} s")
    if time > 0.0:
        path.append_run(compile_scene(_with_outputs(scene, time)).simulate())
    # velocities are those of the run, unless prescribed motions stop
    begin = _without_velocities(path.states[-1]) if scene.motions else path.states[-1]
    scene = replace(_held(scene, time), initial_state=begin)
    settles = linearize(scene, begin).is_equilibrium
    if not settles:
        run_path, settles = _run_to_rest(scene)
        # slow motion begins at the start; in the run if the start is an unstable equilibrium that it leaves
        if settles or linearize(scene, _without_velocities(begin)).is_equilibrium:
            path.extend(run_path)
    slow = _slow_motion(scene, _without_velocities(path.states[-1]))
    path.extend(_Path([np.nan] * len(slow), slow))
    found = passage(scene, path.states)
    return Rest(
        state=path.states[-1],
        scene=replace(scene, initial_state=_without_velocities(begin)),
        settles=settles,
        passage=found,
        passing_times=tuple(path.times[row] for row in found.rows),
        time=time,
    )


class _Path:
    """States on the way to rest, with times, s; NaN in slow motion."""

    def __init__(self, times: list[float], states: list[State]) -> None:
        """Begin a path with states and their times, s."""
        self.times, self.states = times, states

    def extend(self, other: _Path) -> None:
        """Append another path, whose times begin at the end of this one."""
        end = self.times[-1] if self.times else 0.0
        self.times += [end + time for time in other.times]
        self.states += other.states

    def append_run(self, run: Trajectory) -> None:
        """Append the states of a run, whose times begin at the end of this path."""
        self.extend(_Path(run.time.tolist(), [run.state(k) for k in range(len(run.time))]))

    def until(self, count: int) -> _Path:
        """Return the first states of this path."""
        return _Path(self.times[:count], self.states[:count])


def _with_outputs(scene: Scene, duration: float) -> Scene:
    """Return a scene that runs for a time, s, with `RUN_OUTPUTS` outputs of poses and velocities only."""
    return replace(
        scene, duration=duration, output_period=duration / RUN_OUTPUTS, outputs=frozenset({"velocities"})
    )


def _run_to_rest(scene: Scene) -> tuple[_Path, bool]:
    """Run a scene until it comes to rest.

    Returns:
        If the mechanism comes to rest, the states on the way, and True. Otherwise the states of the first run
        until the mechanism has the largest kinetic energy, and False; no states if the run stops early.
    """
    compiled, path, peaks = compile_scene(_with_outputs(scene, scene.duration)), _Path([], []), list[float]()
    mass = np.array([body.mass for body in scene.mechanism.bodies])
    inertia = np.array([np.linalg.norm(body.inertia, 2) for body in scene.mechanism.bodies])
    fastest = 0
    for k in range(SETTLING_RUNS):
        try:
            run = compiled.simulate(most_steps=MAX_SETTLING_STEPS)
        except IntegrationError:
            break
        assert run.linear_velocity is not None
        assert run.angular_velocity is not None
        linear = np.linalg.norm(run.linear_velocity, axis=2)
        angular = np.linalg.norm(run.angular_velocity, axis=2)
        speed = np.maximum(linear / scene.mechanism.size, angular).max(axis=1)
        if not k:
            fastest = int(np.argmax((mass * linear**2 + inertia * angular**2).sum(axis=1)))
        path.append_run(run)
        peaks.append(float(speed.max()))
        if speed[-len(speed) // 10 :].max() < REST_SPEED * max(peaks):
            return path, True
        if k and peaks[-1] > SLOWER * peaks[-2]:
            break
        following = replace(compiled.scene, initial_state=path.states[-1])
        compiled = compiled.with_scene(_with_outputs(following, 2.0 * following.duration))
    return path.until(fastest + 1), False


def _slow_motion(scene: Scene, state: State) -> list[State]:
    """Move a pose as its accelerations show, without inertia, until it is an equilibrium.

    Args:
        scene: a scene without functions of time.
        state: pose at rest to begin at.

    Returns:
        Poses on the way, each near the one before; the last one is the equilibrium.

    Raises:
        NoEquilibriumError: if the mechanism does not come to rest.
    """
    # d independent joint coordinates, and the linear model of their deviations; x = (deviations, rates)
    names = [freedom.name for freedom in chosen_freedoms(scene, state, names=None)]
    system, path, d = Relative(scene), [state], len(names)
    for _ in range(MAX_ITERATIONS):
        try:
            model = linearize(scene, path[-1], names, inputs=[], outputs=[])
        except SingularityError:  # of the coordinates, or of the mechanism
            names = [freedom.name for freedom in chosen_freedoms(scene, path[-1], names=None)]
            model = linearize(scene, path[-1], names, inputs=[], outputs=[])
        step = _slow_step(model)
        converged = model.is_equilibrium and largest(step) < CONVERGED_STEP
        if converged and largest(step) < ROUND_OFF_STEP:
            return path
        # take the step and close the loops; `twists` (b, 6, d) are derivatives of the linear and angular
        # displacements of the b bodies with respect to the coordinates
        q, _ = system.coordinates(path[-1])
        transformation, twists = system.velocity_transformation(q), model.twists.reshape(-1, d)
        tree_step = least_squares(transformation, twists @ (model.units * step))
        length = largest(tree_step / system.velocity_units)
        tree_step *= min(1.0, MAX_EQUILIBRIUM_STEP / max(length, MAX_EQUILIBRIUM_STEP))
        path.append(_moved(system, q, tree_step))
        if converged:
            return path
    worst = names[int(np.argmax(np.abs(model.f[d:] / model.units)))]
    raise NoEquilibriumError(scene.name, worst)


def _slow_step(model: LinearModel) -> Array:
    """Compute the dimensionless step (d,) of slow motion, at most `MAX_EQUILIBRIUM_STEP` long.

    Slow motion follows dz/ds = f + A z, with the accelerations f (d,) of the coordinates z at the state, and
    their derivatives A = -M^-1 K with mass matrix M and stiffness matrix K. After s the displacement is
    (exp(A s) - 1) / A f, along each eigenvector of A. For a stable mode and large s this is Newton's step.
    """
    d = len(model.units)
    values, vectors = np.linalg.eig(model.A[d:, :d] * model.units / model.units[:, None])
    along = least_squares(vectors, model.f[d:] / model.units)
    # at an equilibrium f is round-off, which an unstable mode must not amplify
    factors = 1.0 / np.maximum(np.abs(values), RIGID_MODE)
    span = 1.0 / RIGID_MODE
    step = (vectors @ (along * factors)).real
    while not model.is_equilibrium and span > 0.0:
        growth = np.minimum(values.real * span, MAX_EXPONENT) + 1j * values.imag * span
        is_flat = np.abs(values * span) < RIGID_MODE
        factors = np.where(is_flat, span, np.expm1(growth) / np.where(is_flat, 1.0, values))
        step = (vectors @ (along * factors)).real
        if largest(step) <= MAX_EQUILIBRIUM_STEP:
            break
        span *= 0.5
    return step


def _moved(system: Relative, q: Array, tree_step: Array) -> State:
    """Move a configuration along a step of its tree velocities, close the loops, return the state at rest.

    The step is halved while closing the loops changes it so much that it may have left its branch.
    """
    at_rest_velocity = np.zeros(system.nv)
    while True:
        predicted = system.retract(q, tree_step)
        closed = system.state(project_position(system, predicted), at_rest_velocity)
        open_state = system.state(predicted, at_rest_velocity)
        shift = largest(closed.position - open_state.position) / system.mechanism.size
        turn = 2.0 * (1.0 - np.min(np.abs(np.sum(closed.quaternion * open_state.quaternion, axis=1))))
        length = largest(tree_step / system.velocity_units)
        correction = max(shift, np.sqrt(max(turn, 0.0)))
        if correction <= MAX_CORRECTION * length or length <= MIN_EQUILIBRIUM_STEP:
            return closed
        tree_step = 0.5 * tree_step
