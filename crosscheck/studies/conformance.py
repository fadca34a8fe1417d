"""Does an engine follow the contract of `crosscheck.engines.engine.Engine`? The answer, point by point.

Each point runs the engine on a small scene and compares one convention, such as the order of quaternions or
the body that a reaction acts on, with newton_euler's run at tight tolerances. The scene has no symmetries
that would hide a wrong convention: a bar on a skew hinge, with skew gravity and a turned body frame, that
swings already at the start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from crosscheck.compare.levels import compare_pair
from crosscheck.compare.outcome import Verdict
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.engine import Engine
from crosscheck.engines.limits import CannotExpressError
from crosscheck.report.table import Cell, Report, Rows, Table, text_columns
from crosscheck.support.errors import CrosscheckError, reason_of
from newton_euler.equations.relative import Relative
from newton_euler.errors import NewtonEulerError
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector, rotation
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import OUTPUTS, OutputName, Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import QUANTITIES, Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate
from newton_euler.scalars import Array

TOLERANCE = 1e-3
"""Largest difference from the reference, relative to the largest value. Runs of half a second are nearer in
every engine; with a wrong convention they are not."""

EXACT = 1e-9
"""Largest relative difference of values that no integration changes, such as the start."""


GRAVITY = np.array([0.0, 0.0, -9.81])
"""Gravity of scenes that need not be skew, m/s^2."""


class Result(StrEnum):
    """Result of a point."""

    HOLDS = "HOLDS"
    FAILS = "FAILS"
    REFUSED = "REFUSED"
    """The engine refuses the scene of the point, by an error with a reason."""


VERDICTS: dict[Result, Verdict] = {Result.HOLDS: "holds", Result.FAILS: "fails", Result.REFUSED: "doubtful"}
"""Color of each result."""


@dataclass(frozen=True)
class Finding:
    """Result of one point.

    Attributes:
        point: name of the point, a key of `POINTS`.
        result: whether the engine follows the contract there.
        why: what is wrong, or the reason of the refusal; "" if the point holds.
    """

    point: str
    result: Result
    why: str


def swing(swapped: bool = False, outputs: frozenset[OutputName] = frozenset(OUTPUTS)) -> Scene:
    """Return a bar on a skew hinge, 0.4 s of its motion from a start with velocity.

    Args:
        swapped: True if the ground is the second body of the hinge.
        outputs: outputs of the scene.
    """
    quaternion = from_rotation_vector(np.array([0.7, -0.4, 0.9]))
    turn = rotation(quaternion)
    inertia = turn.T @ np.diag([0.1, 0.3, 0.25]) @ turn
    bar = Body("bar", 2.0, np.array([0.5, 0.2, -0.1]), 0.5 * (inertia + inertia.T), quaternion)
    first, second = ("bar", "ground") if swapped else ("ground", "bar")
    hinge = Revolute("hinge", first, second, np.array([0.1, 0.0, 0.1]), axis=np.array([0.2, 1.0, 0.1]))
    mechanism = Mechanism([Body.ground(), bar], [hinge])
    state = State.initial(mechanism)
    state.angular_velocity[1] = 1.5 * hinge.axis
    state.linear_velocity[1] = np.cross(state.angular_velocity[1], bar.center_of_mass - hinge.point)
    gravity = np.array([0.5, 0.3, -9.81])
    return Scene("swing", mechanism, 0.4, 0.1, gravity, initial_state=state, outputs=outputs)


def geared() -> Scene:
    """Return two bars on parallel hinges that a gear couples."""
    places = {"left": np.zeros(3), "right": np.array([1.0, 0.0, 0.0])}
    down, beside = np.array([0.0, 0.0, -0.3]), np.array([0.2, 0.0, 0.0])
    bars = [Body(name, 1.0, place + down, 0.02 * np.eye(3)) for name, place in places.items()]
    axis = np.array([0.0, 1.0, 0.0])
    hinges = [
        Revolute(f"at_{name}", "ground", name, place - beside, axis=axis) for name, place in places.items()
    ]
    mechanism = Mechanism([Body.ground(), *bars], hinges, [Gear("mesh", "at_left", "at_right", -2.0)])
    return Scene("geared", mechanism, 0.3, 0.1, GRAVITY)


def parallelogram() -> Scene:
    """Return a four-bar linkage of three unequal bars, which a loop closes, released at rest."""
    y = np.array([0.0, 1.0, 0.0])
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.4], [0.9, 0.0, 0.6], [1.0, 0.0, 0.0]])
    names, bodies = ("crank", "coupler", "rocker"), [Body.ground()]
    for k, name in enumerate(names):
        bodies.append(Body(name, 1.0, 0.5 * (corners[k] + corners[k + 1]), 0.02 * np.eye(3)))
    around = ("ground", *names, "ground")
    hinges = [Revolute(f"hinge_{k}", around[k], around[k + 1], corners[k], axis=y) for k in range(4)]
    return Scene("linkage", Mechanism(bodies, hinges), 0.3, 0.1, GRAVITY)


def double() -> Scene:
    """Return two bars that hang from each other on parallel hinges, with inertias about skew axes."""
    skew = rotation(from_rotation_vector(np.array([0.2, 0.5, -0.3])))
    inertia = skew @ np.diag([0.02, 0.05, 0.06]) @ skew.T
    y = np.array([0.0, 1.0, 0.0])
    centers = {"upper": np.array([0.3, 0.0, 0.0]), "lower": np.array([0.6, 0.05, -0.2])}
    turned = from_rotation_vector(np.array([0.4, 0.1, -0.6]))
    bars = [Body(name, 1.5, center, 0.5 * (inertia + inertia.T), turned) for name, center in centers.items()]
    hinges = [
        Revolute("shoulder", "ground", "upper", np.zeros(3), axis=y),
        Revolute("elbow", "upper", "lower", np.array([0.6, 0.0, 0.0]), axis=-y),
    ]
    return Scene("double", Mechanism([Body.ground(), *bars], hinges), 0.3, 0.1, GRAVITY)


def driven() -> Scene:
    """Return the swing with a PD law on its hinge, whose force a reaction does not include."""
    scene = swing()
    (hinge,) = scene.mechanism.joints
    mechanism = Mechanism(scene.mechanism.bodies, [replace(hinge, actuated=True)])
    return replace(scene, name="driven", mechanism=mechanism, control=(PD("hinge", 30.0, 4.0, 0.5),))


def _both(engine: Engine, scene: Scene) -> tuple[Trajectory, Trajectory]:
    """Return the engine's run of a scene, and the reference."""
    return engine.simulate(scene), simulate(scene, rtol=1e-12, atol=1e-14)


def _apart(one: Array | None, two: Array | None) -> float:
    """Return the largest difference of two arrays relative to the largest value of the second."""
    if one is None or two is None or np.shape(one) != np.shape(two):
        return float("inf")
    scale = float(np.max(np.abs(two), initial=0.0))
    return float(np.max(np.abs(one - two), initial=0.0)) / max(scale, 1e-300)


def _motion_apart(engine: Engine, scene: Scene) -> str:
    """Return how far poses are from the reference; "" within `TOLERANCE`."""
    run, other = _both(engine, scene)
    apart = _apart(run.position, other.position)
    if not apart <= TOLERANCE:
        return f"positions differ by {apart:.2g} of the reach"
    turned = float(np.max(angle_between(run.quaternion, other.quaternion)))
    return f"orientations differ by {turned:.2g} rad" if not turned <= TOLERANCE else ""


def _values_apart(engine: Engine, scene: Scene, *names: str) -> str:
    """Return which output of some names differs first from the reference; "" within `TOLERANCE`."""
    run, other = _both(engine, scene)
    for name in names:
        if not (apart := _apart(getattr(run, name), getattr(other, name))) <= TOLERANCE:
            return f"{name} differs by {apart:.2g}"
    return ""


def start(engine: Engine) -> str:
    """The first row of a run is the initial state of the scene, with its velocities."""
    run, state = engine.simulate(swing()), initial_state(swing())
    for name in ("position", "linear_velocity", "angular_velocity"):
        found = getattr(run, name)
        if not _apart(None if found is None else found[0], getattr(state, name)) <= EXACT:
            return f"{name} of the first row is not that of the initial state"
    return ""


def quaternion_order(engine: Engine) -> str:
    """Quaternions are (w, x, y, z), from the body frame to the world frame."""
    found, exact = engine.simulate(swing()).quaternion[0], initial_state(swing()).quaternion
    if np.max(angle_between(found, exact)) <= EXACT:
        return ""
    wrong = {"(x, y, z, w)": np.roll(exact, -1, axis=1), "inverse": exact * [1.0, -1.0, -1.0, -1.0]}
    fits = [f": it is its {name}" for name, q in wrong.items() if np.max(np.abs(found[1] - q[1])) <= EXACT]
    return f"the first quaternion is not the initial one{''.join(fits)}"


def motion(engine: Engine) -> str:
    """Masses, inertias, gravity and axes are those of the scene."""
    return _motion_apart(engine, swing())


def outputs(engine: Engine) -> str:
    """A run has the output times and the outputs of the scene, and no others."""
    for wanted in (frozenset[OutputName](), frozenset(OUTPUTS)):
        scene = swing(outputs=wanted)
        run, other = engine.simulate(scene), simulate(scene)
        if not np.array_equal(run.time, scene.times):
            return "times are not those of the scene"
        for name in (*QUANTITIES, "constraint_violation"):
            found, needed = getattr(run, name), getattr(other, name)
            if (found is None) != (needed is None):
                return f"{name} is {'missing' if found is None else 'there, though not asked for'}"
            if found is not None and np.shape(found) != np.shape(needed):
                return f"{name} has the shape {np.shape(found)}; needed: {np.shape(needed)}"
    return ""


def reaction_sign(engine: Engine) -> str:
    """A reaction acts on the second body of its joint, also if the ground is the second."""
    for swapped in (False, True):
        run, other = _both(engine, swing(swapped))
        assert other.reaction_force is not None
        if run.reaction_force is None or not np.sum(run.reaction_force * other.reaction_force) > 0.0:
            return f"the reaction acts on the first body{', if the ground is the second' if swapped else ''}"
    return ""


def reaction_frame(engine: Engine) -> str:
    """Reaction forces are in the world frame, without the weight of the body."""
    run, other = _both(engine, swing())
    force = other.reaction_force
    assert force is not None
    apart = min(_apart(run.reaction_force, sign * force) for sign in (1.0, -1.0))
    if apart <= TOLERANCE:
        return ""
    local = np.array([[rotation(q[1]).T @ f[0]] for q, f in zip(other.quaternion, force, strict=True)])
    hint = ": it is in the frame of the body" if _apart(run.reaction_force, local) <= TOLERANCE else ""
    return f"the reaction force differs by {apart:.2g}{hint}"


def reaction_point(engine: Engine) -> str:
    """Reaction torques are about the joint's point on its second body."""
    run, other = _both(engine, swing())
    torque = other.reaction_torque
    assert torque is not None
    apart = min(_apart(run.reaction_torque, sign * torque) for sign in (1.0, -1.0))
    if apart <= TOLERANCE:
        return ""
    return f"the reaction torque differs by {apart:.2g}: it may be about another point"


def drive_force(engine: Engine) -> str:
    """The force of a control law is an actuator force, and no part of the reaction."""
    return _values_apart(engine, driven(), "actuator_force", "reaction_torque")


def energy(engine: Engine) -> str:
    """Energies are absolute: the potential energy of a weight is zero at the origin of the world."""
    return _values_apart(engine, swing(), "kinetic_energy", "potential_energy")


def chain(engine: Engine) -> str:
    """Bodies that hang from each other, and the reactions of their joints, are those of the reference."""
    return _motion_apart(engine, double()) or _values_apart(
        engine, double(), "reaction_force", "reaction_torque"
    )


def loops(engine: Engine) -> str:
    """A joint that closes a loop holds."""
    return _motion_apart(engine, parallelogram())


def couplings(engine: Engine) -> str:
    """A gear turns its second joint by the ratio times its first one."""
    return _motion_apart(engine, geared())


def refinement(engine: Engine) -> str:
    """A refined run is as near to the exact motion as the default run, or nearer."""
    run, exact = _both(engine, swing())
    default, refined = (_apart(each.position, exact.position) for each in (run, engine.refined(swing())))
    if refined > max(default, engine.trajectory_error):
        return f"the refined run is off by {refined:.2g} of the reach, the default run by {default:.2g}"
    return ""


def equations(engine: Engine) -> str:
    """The equations of motion agree with newton_euler's at every level of `crosscheck run`."""
    scene = swing()
    if not (systems := engine.systems(scene)):
        raise CrosscheckError(f"{engine.name} has no equations of motion: comparisons are of its runs only")
    states = States(scene, (initial_state(scene),))
    reference = [Samples(Relative(scene), states)]
    for system in systems:
        for check in compare_pair(("reference", engine.name), reference, [Samples(system, states)]):
            if check.judged and not check.agrees:
                return f"{check.level}: {check.quantity} differs by {check.value:.2g} at {check.where}"
    return ""


def limits(engine: Engine) -> str:
    """Scenes for which `limits` lists something are refused by an error; all others run."""
    for scene in (swing(), driven(), geared(), parallelogram()):
        found = engine.limits(scene)
        try:
            engine.simulate(scene)
        except CannotExpressError as error:
            if not found:
                return f"{scene.name} is refused though `limits` lists nothing: {error}"
        except NewtonEulerError as error:
            return f"{scene.name} is refused, but not by a CannotExpressError: {error}"
        else:
            if found:
                return f"{scene.name} runs though `limits` lists {found[0]}"
    return ""


def settings(engine: Engine) -> str:
    """A setting that the engine does not have is refused, not ignored."""
    try:
        engine.simulate(swing(), {"no_such_setting": 1.0})
    except (NewtonEulerError, CrosscheckError, TypeError, ValueError):
        return ""
    return "a setting that does not exist is ignored"


POINTS: dict[str, Callable[[Engine], str]] = {
    each.__name__: each
    for each in (
        *(start, quaternion_order, motion, outputs, reaction_sign, reaction_frame, reaction_point),
        *(drive_force, energy, chain, loops, couplings, refinement, equations, limits, settings),
    )
}
"""Points of the contract by name: functions that return what is wrong with an engine, or ""."""


def check_point(engine: Engine, point: str) -> Finding:
    """Check one point, a key of `POINTS`; an error that is no refusal is a failure."""
    try:
        why = POINTS[point](engine)
    except (NewtonEulerError, CrosscheckError) as error:
        return Finding(point, Result.REFUSED, str(error))
    except Exception as error:  # code of another package
        return Finding(point, Result.FAILS, reason_of(error))
    return Finding(point, Result.FAILS if why else Result.HOLDS, why)


def report(engine: Engine, findings: Sequence[Finding]) -> Report:
    """Make the report of the points of an engine."""
    counts = {result: sum(each.result is result for each in findings) for result in Result}
    verdict = f"{engine.name} follows the contract in {counts[Result.HOLDS]} of {len(findings)} points"
    if counts[Result.REFUSED]:
        verdict += f"; {counts[Result.REFUSED]} need what it refuses to simulate"
    judged = Cell("conforms", "holds") if not counts[Result.FAILS] else Cell("does not conform", "fails")
    rows: Rows = [[each.point, Cell(each.result, VERDICTS[each.result]), each.why] for each in findings]
    table = Table("", text_columns("point", "result", "why"), rows)
    return Report(f"contract of the engine {engine.name}", verdict, judged, [table], summary=[table])


def check_engine(engine: Engine, progress: Callable[[str], None]) -> Sequence[Finding]:
    """Check all points of an engine; `progress` is called with the name of each."""
    found = []
    for point in POINTS:
        progress(f"{engine.name}: {point}")
        found.append(check_point(engine, point))
    return found
