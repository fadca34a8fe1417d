"""Consistent states: find them, and check that the initial states of runs are consistent.

A consistent state has poses that close all joints and velocities that keep them closed. `assemble` finds one
near a guess; `initial_state` gives the state from which runs of a scene start.

Couplings are constraints between joint coordinates: gears, screws and prescribed motions. A key (joint,
number) names a joint coordinate. Some forces and couplings depend on the full revolutions of an angle, which
poses do not show; a state therefore has these angles in addition (`State.angles`, by key).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from newton_euler.arguments import checked
from newton_euler.equations.applied_forces import surroundings
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.coupling_equations import residuals
from newton_euler.equations.couplings import counted_angles, couplings
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.revolutions import revolutions
from newton_euler.errors import AssemblyError, MechanismError
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.geometry import UNIT_TOLERANCE
from newton_euler.model.joint import JointEquations, Key
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.scene import Scene
from newton_euler.model.state import State, stacked, whole_revolutions
from newton_euler.scalars import Array, unstacked

VELOCITY_TOLERANCE = 1e-9
"""Largest rate of a constraint residual at the start, divided by the speed of the state (`_speed`).

Rates in rad/s are multiplied by the mechanism's size before the division."""

CONSISTENT_STARTS: WeakKeyDictionary[Scene, State] = WeakKeyDictionary()
"""Checked initial states that `initial_state` has returned, by scene."""


@checked
def assemble(scene: Scene, guess: State) -> State:
    """Find a consistent state near a guess: positions first, then velocities, by minimum-norm Newton steps.

    Args:
        scene: the mechanism; its prescribed motions have their values at time 0.
        guess: a state of the scene's bodies; its loops may be open.

    Raises:
        AssemblyError: if a joint stays open, naming the joint.
        MechanismError: for a guess with other bodies, or numbers that are not finite.

    Examples:
        >>> scene = load("four_bar")
        >>> rough = State.initial(scene.mechanism).position + 0.01  # m: all loops are open
        >>> state = assemble(scene, replace(State.initial(scene.mechanism), position=rough))
        >>> run = simulate(replace(scene, initial_state=state))
        >>> print(bool(np.asarray(run.constraint_violation)[0].max() < 1e-12))  # m, rad: they are closed
        True
    """
    scene.check_numbers(guess, f"guess for scene {scene.name!r}")
    system = Cartesian(scene)
    q, v = system.coordinates(guess)
    q = project_position(system, q)
    return system.state(q, project_velocity(system, q, v))


@checked
@np.errstate(all="ignore")  # states that overflow are rejected, here or by a run
def initial_state(scene: Scene) -> State:
    """Return the consistent state from which runs of a scene start.

    If the scene has an initial state, it is checked and returned. Else the state is the initial pose of the
    mechanism, at rest or with the prescribed motions. The result contains all angles whose full revolutions
    matter (`State.angles`).

    Raises:
        MechanismError: naming the joint, gear, motion or force that the scene's initial state violates.
        AssemblyError: if no state near the initial pose follows the prescribed motions.

    Examples:
        >>> initial_state(load("four_bar")).quaternion.shape
        (6, 4)
    """
    if scene not in CONSISTENT_STARTS:
        state = scene.initial_state
        if state is None:
            state = State.initial(scene.mechanism)
            if scene.motions:
                state = assemble(scene, state)
        else:
            _check_joints(scene, state)
            check_revolutions(scene, state)
            _check_couplings(scene, state)
        state = with_angles(scene, state)
        force_inputs = surroundings(scene, state)  # the quantities that forces depend on
        for force in scene.forces:
            force.check_start(force_inputs)
        CONSISTENT_STARTS[scene] = state
    return CONSISTENT_STARTS[scene]


def with_angles(scene: Scene, state: State) -> State:
    """Return a state with all angles whose full revolutions forces or couplings of a scene depend on.

    Angles that the state does not have follow from couplings, or are between -pi and pi.
    """
    keys = counted_angles(scene)
    if state.angles.keys() >= set(keys):
        return state
    frames, scene_couplings = state.frames(), couplings(scene)
    needed = dict.fromkeys([*keys, *(key for coupling in scene_couplings for key in coupling.factors)])
    x = {key: float(scene.mechanism.measure(key, frames)[0]) for key in needed}  # angles of the poses
    turned = revolutions(scene_couplings, x, keys, time=0.0, known=state.angles)
    angles = {key: x[key] + turned.get(key, 0.0) for key in keys}
    return replace(state, angles={**angles, **state.angles})


def check_revolutions(scene: Scene, state: State) -> None:
    """Raise `MechanismError` for an angle of a state that does not match the poses up to full revolutions."""
    frames = state.frames() if state.angles else []
    for key, angle in state.angles.items():
        x = float(scene.mechanism.measure(key, frames)[0])
        if not _matches_pose(angle, x):
            problem = f"coordinate {key[1]} is {angle:.9g} rad in a state whose poses have it at {x:.9g} rad"
            needed = "the same angle up to whole revolutions, 2 pi each"
            raise MechanismError(f"joint {key[0]!r}", problem, needed)


def _matches_pose(angle: Any, x: Any) -> Any:
    """Return True if an angle and the angle x of the poses, rad, differ by full revolutions.

    For arrays (n,) of angles, the result is an array (n,).
    """
    gap = np.abs(x + whole_revolutions(angle - x) - angle)
    return gap <= CLOSURE_TOLERANCE + 4.0 * np.finfo(float).eps * np.abs(angle)


def measured_coordinate(scene: Scene, state: State, key: Key) -> tuple[float, float]:
    """Measure a joint coordinate (joint, number) and its rate at a state, m or rad, and per s.

    Angles include the full revolutions of `State.angles`.
    """
    x, rate = map(float, scene.mechanism.measure(key, state.frames()))
    return x + state.revolutions(key, x), rate


def inherit_initial_state(scene: Scene, of: Scene) -> None:
    """Use for a scene the initial state of another scene with the same geometry, without checks."""
    CONSISTENT_STARTS[scene] = initial_state(of)


def coordinates_of(system: Formulation, states: Sequence[State]) -> Array:
    """Compute coordinates and velocities of n states at once.

    The result of a state is the same, bit for bit, whatever the other states are. Its round-off may differ
    from that of `system.coordinates`.

    Args:
        system: gives the form of the equations.
        states: the states.

    Returns:
        (n, nq + nv): q and v of each state.
    """
    if system.couplings:
        return np.array([np.concatenate(system.coordinates(state)) for state in states])
    rows = unstacked(np.concatenate(system.coordinates(stacked(states))), len(states))
    for key, place in system.angles.items():  # `place`: column of the angle
        # an angle that a state does not have is NaN, for which `whole_revolutions` returns 0
        angles = np.array([state.angles.get(key, np.nan) for state in states])
        rows[:, place] += whole_revolutions(angles - rows[:, place])
    return rows


def _check_joints(scene: Scene, state: State) -> None:
    """Raise `MechanismError` for a joint that is open or opening.

    Dimensions in files are rounded, so that redundant constraints may contradict each other slightly. Joints
    with such constraints may be open by the amount that the rounding causes.
    """
    try:
        scene.mechanism.check_closed(state.frames(), "in the initial state")
        _check_velocities(scene, state)
    except MechanismError:
        if not _is_closed_but_for_rounding(scene, state):
            raise


def _check_velocities(scene: Scene, state: State) -> None:
    """Raise `MechanismError` for the first joint whose bodies separate faster than `VELOCITY_TOLERANCE`."""
    mechanism, frames = scene.mechanism, state.frames()
    size, speed = mechanism.size, _speed(scene, state)
    for equations in mechanism.equations:
        first, second = frames[equations.first], frames[equations.second]
        rates = np.abs(equations.jacobian(first, second).rate(first, second))
        allowed = _rates_allowed(equations, speed, size)
        if np.any(rates > allowed):
            worst = int(np.argmax(rates - allowed))
            unit = "m/s" if equations.is_length[worst] else "rad/s"
            raise MechanismError(
                f"joint {equations.joint.name!r}",
                f"opens at {rates[worst]:.3g} {unit} in the initial state",
                f"at most {allowed[worst]:.3g} {unit}; see newton_euler.assemble(scene, guess)",
            )


def _rates_allowed(equations: JointEquations, speed: Any, size: float) -> Array:
    """Compute the largest allowed rate of each constraint row of a joint, (k,), m/s or rad/s.

    Args:
        equations: constraint rows of the joint.
        speed: speed of the state (`_speed`), m/s.
        size: size of the mechanism, m.
    """
    return VELOCITY_TOLERANCE * speed * np.where(equations.is_length, 1.0, 1.0 / size)


def check_states(scene: Scene, states: Sequence[State]) -> dict[int, MechanismError]:
    """Check the initial states of many runs of a scene.

    All states are checked together first, which is fast. Those not found consistent are checked one by one.

    Returns:
        Errors by number of the run.
    """
    errors = {}
    for k in np.flatnonzero(~_surely_consistent(scene, states)).tolist():
        try:
            scene.check_numbers(states[k], f"run {k}")
            initial_state(replace(scene, initial_state=states[k]))
        except MechanismError as error:
            names_run = error.element == f"run {k}"  # the error is one of `check_numbers`
            element = error.element if names_run else f"run {k}: {error.element}"
            errors[k] = MechanismError(element, error.problem, error.needed)
    return errors


def _surely_consistent(scene: Scene, states: Sequence[State]) -> Array:
    """Find the states that are certainly consistent; all are examined together.

    Returns:
        (n,) True for a consistent state; all False if the scene has couplings or prescribed motions.
    """
    shape, sure = (len(scene.mechanism.bodies), 3), np.zeros(len(states), dtype=bool)
    # states with the expected arrays and angles
    usable = [
        k for k, state in enumerate(states) if isinstance(state, State) and _has_float_arrays(state, shape)
    ]
    usable = [k for k in usable if _has_angles(scene, states[k])]
    if usable and not couplings(scene):
        sure[usable] = _are_consistent(scene, [states[k] for k in usable])
    return sure


def _has_float_arrays(state: State, shape: tuple[int, int]) -> bool:
    """Return True if the arrays of a state hold floats and have the shape (bodies, 3), or (bodies, 4)."""
    vectors = state.position, state.linear_velocity, state.angular_velocity, state.quaternion[:, 1:]
    return all(vector.dtype == np.float64 and vector.shape == shape for vector in vectors)


def _has_angles(scene: Scene, state: State) -> bool:
    """Return True if all angles of a state belong to joint coordinates of the scene."""
    try:
        scene.check_angles(state.angles, "state")
    except MechanismError:
        return False
    return True


@np.errstate(all="ignore")  # states that are not finite are not consistent
def _are_consistent(scene: Scene, states: Sequence[State]) -> Array:
    """Find the consistent states of a scene without couplings, (n,) True for a consistent state.

    `stacked` combines the states to one, whose numbers are objects that hold an array (n,) each; `unstacked`
    converts such numbers (k,) to an array (n, k).
    """
    count, mechanism, state = len(states), scene.mechanism, stacked(states)
    # ground at its place and at rest (6 velocities), unit quaternions
    ground, frames = mechanism.bodies[0], state.frames()
    expected = np.concatenate([ground.center_of_mass, ground.quaternion, np.zeros(6)])
    actual = np.concatenate([array[0] for array in state.arrays])
    consistent = np.all(np.abs(unstacked(actual, count) - expected) <= np.finfo(float).eps, axis=1)
    norms = [unstacked([p @ p], count)[:, 0] for p in state.quaternion]
    consistent &= np.all(np.abs(np.sqrt(norms) - 1.0) <= UNIT_TOLERANCE, axis=0)
    # joints closed, and not opening
    speed = np.array([_speed(scene, each) for each in states])[:, None]
    for equations in mechanism.equations:
        first, second = frames[equations.first], frames[equations.second]
        phi = unstacked(equations.phi(first, second), count)
        rates = unstacked(equations.jacobian(first, second).rate(first, second), count)
        allowed = _rates_allowed(equations, speed, mechanism.size)
        consistent &= np.all((np.abs(phi) <= CLOSURE_TOLERANCE) & (np.abs(rates) <= allowed), axis=1)
    # given angles match the poses
    for key in {key for each in states for key in each.angles}:
        angles = np.array([each.angles.get(key, np.nan) for each in states])
        x = unstacked([mechanism.measure(key, frames)[0]], count)[:, 0]
        consistent &= np.isnan(angles) | _matches_pose(angles, x)
    # the two end points of a spring differ, so that its force has a direction
    force_inputs = surroundings(scene, state)
    for span in (span for force in scene.forces for span in force.spans(force_inputs)):
        consistent &= unstacked([span @ span], count)[:, 0] > CLOSURE_TOLERANCE**2
    return consistent


def _is_closed_but_for_rounding(scene: Scene, state: State) -> bool:
    """Return True if a state is the one that `assemble` finds near it, although some joints are open.

    Only almost redundant constraints stay open in `assemble`.
    """
    # `residual`: largest residual of almost redundant constraints in a closed pose; 0 if there are none
    if mobility(scene).residual == 0.0:
        return False
    try:
        closed = assemble(scene, state)
    except AssemblyError:
        return False
    differences = (  # each with a scale, m, rad or m/s; a scale below 1 counts as 1
        (closed.position - state.position, 1.0),
        (closed.quaternion - state.quaternion, 1.0),
        (closed.linear_velocity - state.linear_velocity, _speed(scene, state)),
    )
    return all(np.max(np.abs(gap)) <= CLOSURE_TOLERANCE * max(1.0, scale) for gap, scale in differences)


def _check_couplings(scene: Scene, state: State) -> None:
    """Raise `MechanismError` for the first coupling or prescribed motion that the state violates."""
    scene_couplings = couplings(scene)
    errors = residuals(scene.mechanism, scene_couplings, state.frames(), 0.0, state.angles)
    speed, size = _speed(scene, state), scene.mechanism.size
    by_coupling = zip(scene_couplings, errors.phi, errors.rate, errors.sensitivity, strict=True)
    for coupling, error, rate, sensitivity in by_coupling:
        unit = "m" if coupling.is_length else "rad"
        allowed_rate = VELOCITY_TOLERANCE * speed * (1.0 if coupling.is_length else 1.0 / size)
        allowed_rate *= sensitivity  # rate of the residual for unit rates of the joint coordinates
        if abs(error) > CLOSURE_TOLERANCE:
            problem, needed = f"has an error of {error:.3g} {unit}", f"at most {CLOSURE_TOLERANCE:g} {unit}"
        elif abs(rate) > allowed_rate:
            problem = f"has an error of {rate:.3g} {unit}/s"
            needed = f"at most {allowed_rate:.3g} {unit}/s"
        else:
            continue
        raise MechanismError(
            f"{coupling.what} {coupling.name!r}",
            f"{problem} in the initial state",
            f"{needed}; see newton_euler.assemble(scene, guess)",
        )


def _speed(scene: Scene, state: State) -> float:
    """Compute the speed of a state by which velocity tolerances are multiplied, m/s.

    The result is the largest speed of a center of mass, plus the largest angular velocity times the
    mechanism's size.
    """
    spin = float(np.max(np.linalg.norm(state.angular_velocity, axis=1)))
    return float(np.max(np.linalg.norm(state.linear_velocity, axis=1))) + scene.mechanism.size * spin
