"""Consistent states: bodies moved the least until every joint closes, and the one that a run starts from."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from newton_euler.equations.applied_forces import surroundings
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.couplings import couplings, residuals
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import AssemblyError, MechanismError, check_type
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

VELOCITY_TOLERANCE = 1e-9
"""How fast a joint may open at the start, as a share of the largest speed: as exact as
`CLOSURE_TOLERANCE` leaves the positions, in sizes of the mechanism."""

CHECKED: WeakKeyDictionary[Scene, State] = WeakKeyDictionary()
"""Consistent states that scenes start from."""


def assemble(scene: Scene, guess: State) -> State:
    """The consistent state near a guess: positions first, then velocities, by steps of least length.

    Raises:
        AssemblyError: with the joint that stays open.
        MechanismError: for a guess that is no state of the scene's bodies.
    """
    check_type("scene", scene, Scene)
    scene.check_numbers(guess, f"guess for scene {scene.name!r}")
    system = Cartesian(scene)
    q, v = system.coordinates(guess)
    q = project_position(system, q)
    return system.state(q, project_velocity(system, q, v))


@np.errstate(all="ignore")  # what overflows is refused, here or by a run
def initial_state(scene: Scene) -> State:
    """The consistent state that runs of a scene start from: the given one, or what it stands for if none is.

    Raises:
        MechanismError: naming the joint, gear, motion or force that the given state does not meet.
        AssemblyError: for prescribed motions that no state near the initial pose follows.
    """
    check_type("scene", scene, Scene)
    if scene not in CHECKED:
        state = scene.initial_state
        if state is None:
            state = State.initial(scene.mechanism)
            if scene.motions:
                state = assemble(scene, state)
        else:
            _check_joints(scene, state)
            _check_couplings(scene, state)
        at = surroundings(scene, state)
        for force in scene.forces:
            force.check_start(at)
        CHECKED[scene] = state
    return CHECKED[scene]


def inherit_initial_state(scene: Scene, of: Scene) -> None:
    """Give a scene the state that another one of the same geometry and the same given state starts from."""
    CHECKED[scene] = initial_state(of)


def _check_joints(scene: Scene, state: State) -> None:
    """Raise `MechanismError` for a joint that is open, or opens, by more than noise."""
    try:
        scene.mechanism.check_closed(state.frames(), "in the initial state")
        _check_velocities(scene, state)
    except MechanismError:
        if not _is_closed_but_for_noise(scene, state):
            raise


def _check_velocities(scene: Scene, state: State) -> None:
    """Raise `MechanismError` for the first joint that opens, |Phi_q qdot| > `VELOCITY_TOLERANCE`."""
    mechanism, frames = scene.mechanism, state.frames()
    size, speed = mechanism.size, _speed(scene, state)
    for equations in mechanism.equations:
        first, second = frames[equations.first], frames[equations.second]
        rates = np.abs(equations.jacobian(first, second).rate(first, second))
        allowed = VELOCITY_TOLERANCE * speed * np.where(equations.is_length, 1.0, 1.0 / size)
        if np.any(rates > allowed):
            worst = int(np.argmax(rates - allowed))
            unit = "m/s" if equations.is_length[worst] else "rad/s"
            raise MechanismError(
                f"joint {equations.joint.name!r}",
                f"opens at {rates[worst]:.3g} {unit} in the initial state",
                f"at most {allowed[worst]:.3g} {unit}, as newton_euler.assemble(scene, guess) makes it",
            )


def _is_closed_but_for_noise(scene: Scene, state: State) -> bool:
    """True if a state opens nearly redundant joints alone, and no more than it has to."""
    if mobility(scene).residual == 0.0:
        return False
    try:
        closed = assemble(scene, state)
    except AssemblyError:
        return False
    apart = (
        (closed.position - state.position, 1.0),
        (closed.quaternion - state.quaternion, 1.0),
        (closed.linear_velocity - state.linear_velocity, _speed(scene, state)),
    )
    return all(np.max(np.abs(gap)) <= CLOSURE_TOLERANCE * max(1.0, unit) for gap, unit in apart)


def _check_couplings(scene: Scene, state: State) -> None:
    """Raise `MechanismError` for the first coupling or motion that the state does not follow."""
    found = couplings(scene)
    phi, rates = residuals(scene.mechanism, found, state.frames(), 0.0)
    speed, size = _speed(scene, state), scene.mechanism.size
    for coupling, gap, opening in zip(found, phi, rates, strict=True):
        unit = "m" if coupling.is_length else "rad"
        allowed = VELOCITY_TOLERANCE * speed * (1.0 if coupling.is_length else 1.0 / size)
        allowed *= sum(abs(factor) for factor in coupling.factors.values())
        if abs(gap) > CLOSURE_TOLERANCE:
            problem, needed = f"is off by {gap:.3g} {unit}", f"at most {CLOSURE_TOLERANCE:g} {unit}"
        elif abs(opening) > allowed:
            problem, needed = f"is off by {opening:.3g} {unit}/s", f"at most {allowed:.3g} {unit}/s"
        else:
            continue
        raise MechanismError(
            f"{coupling.what} {coupling.name!r}",
            f"{problem} in the initial state",
            f"{needed}, as newton_euler.assemble(scene, guess) makes it",
        )


def _speed(scene: Scene, state: State) -> float:
    """The largest speed of a state, m/s."""
    spin = float(np.max(np.linalg.norm(state.angular_velocity, axis=1)))
    return float(np.max(np.linalg.norm(state.linear_velocity, axis=1))) + scene.mechanism.size * spin
