"""Benchmark kernels of Pinocchio: right-hand sides and runs with as little Python overhead as possible.

crosscheck's benchmarks measure Pinocchio's speed with these kernels, on scenes (mechanisms with forces,
control laws and initial state). States y = (q, v) have Pinocchio's order and SI units, so that nothing is
converted during a run. The kernels store poses at output times only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from newton_euler.equations.couplings import couplings
from newton_euler.equations.system import at_time
from newton_euler.model.control import PD
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Rod
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import weld_loops
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array
from urdf.dynamics import PinocchioSystem
from urdf.errors import UrdfError

REGULARIZATIONS = ((0.0, 1), (1e-8, 1), (1e-8, 3), (1e-6, 3), (1e-6, 10), (1e-6, 30), (1e-4, 30))
"""Pairs of the regularization mu and a number of iterations of `constraintDynamics`, cheapest first.

Redundant closures need a regularization; the iterations remove its effect (see `urdf.proximal`)."""

MAX_REGULARIZATION_ERROR = 1e-9
"""Largest error of accelerations that a regularization may cause, relative to the largest acceleration."""

SMALLEST_SCALE = 1e-6
"""Smallest scale of this error, m/s^2 or rad/s^2, for a mechanism at rest."""

MAX_LSODA_STEPS = 1000
"""Largest number of steps of LSODA per output interval."""

SMALL_VELOCITY = 1e-9
"""Change of velocities, m/s and rad/s, that makes a state different without changing the work of a call."""

Rates = Callable[[float, Array], Array]
"""Function of time t and state y that returns ydot."""


class Equations(NamedTuple):
    """Equations of motion for many calls.

    Attributes:
        system: Pinocchio's system of the scene.
        acceleration: function without arguments that computes accelerations at, or almost at, the initial
            state.
        rates: function of t and y that returns ydot (nq + nv,), always in the same array.
        start: (nq + nv,) initial y.
        nq: number of coordinates q in y.
    """

    system: PinocchioSystem
    acceleration: Callable[[], Array]
    rates: Rates
    start: Array
    nq: int


def equations_of(scene: Scene, alpha: float, lcaba: tuple[float, int] | None) -> Equations:
    """Return the equations of motion by Pinocchio's `constraintDynamics` or `lcaba`.

    `lcaba` is Pinocchio's articulated-body algorithm for closed loops.

    For elements that `constraintDynamics` does not support, such as wind, the equations are those of
    `PinocchioSystem`, which are slower.

    Args:
        scene: scene to simulate.
        alpha: parameter, 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2.
        lcaba: regularization mu and number of iterations of `lcaba`; None for `constraintDynamics`.

    Raises:
        UrdfError: for a scene with elements that `lcaba` does not support.
    """
    # the output "energy" would add the work of forces without potential to the coordinates
    scene = replace(scene, outputs=frozenset())
    system = PinocchioSystem(scene, alpha)
    unsupported = _unsupported_elements(scene)
    if unsupported and lcaba:
        known = "gravity, forces on joint coordinates, and loops that balls or welds close"
        raise UrdfError(f"{unsupported[0]}: Pinocchio's lcaba supports only {known}")
    if unsupported:
        return _equations_by_system(system)
    model, constraints = system.closed.model, system.closed.constraints
    # arrays that every call reuses; forces of control laws and springs are tau = gains y + constant
    data = model.createData()
    nq, nv = model.nq, model.nv
    gains, constant = _affine_laws(scene, system)
    tau, ydot = np.zeros(nv), np.empty(nq + nv)
    qdot, vdot = ydot[:nq], ydot[nq:]
    q, v = system.coordinates(initial_state(scene))
    start = np.concatenate([system.map.q_to_pinocchio(q), system.map.v_to_pinocchio(v)])
    tau[:] = gains @ start + constant
    if lcaba:
        pin.computeJointMinimalOrdering(model, data, constraints)
    datas = pin.StdVec_RigidConstraintData([constraint.createData() for constraint in constraints])
    if not lcaba:
        pin.initConstraintDynamics(model, data, constraints, datas)
    solve = pin.lcaba if lcaba else pin.constraintDynamics

    def accelerate(settings: Any) -> Array:
        """Return the accelerations at the initial state for `pinocchio.ProximalSettings`."""
        return solve(model, data, start[:nq], start[nq:], tau, constraints, datas, settings)

    # the regularization, and the indices of balls and of other coordinates
    settings = _proximal_settings(*lcaba) if lcaba else _cheapest_accurate_settings(system, accelerate)
    joints = list(model.joints)[1:]
    balls = [(joint.idx_q, joint.idx_v) for joint in joints if joint.nq == 4]  # quaternions
    single_q = [joint.idx_q for joint in joints if joint.nq == 1]
    single_v = [joint.idx_v for joint in joints if joint.nq == 1]
    is_actuated = bool(scene.joint_forces)
    dot, add = np.dot, np.add

    def rates_at(t: float, y: Array) -> Array:
        """Return ydot at a state."""
        v = y[nq:]
        if is_actuated:
            dot(gains, y, tau)
            add(tau, constant, tau)
        if balls:
            qdot[single_q] = v[single_v]
            for i, k in balls:
                qdot[i : i + 4] = _quaternion_rate(y[i : i + 4].tolist(), v[k : k + 3].tolist())
        else:
            qdot[:] = v
        vdot[:] = solve(model, data, y[:nq], v, tau, constraints, datas, settings)
        return ydot

    q0, v0, tau0 = start[:nq].copy(), start[nq:].copy(), tau.copy()
    arguments = (model, data, q0, v0, tau0, constraints, datas, settings)
    return Equations(system, partial(solve, *arguments), rates_at, start, nq)


def articulated_bodies(scene: Scene) -> Callable[[], Array]:
    """Return a function without arguments that computes initial accelerations by Pinocchio's `aba`.

    Raises:
        UrdfError: for a scene with loops, and for a force that `lcaba` does not know.
    """
    # `lcaba` without regularization, because it refuses other forces than gravity and affine laws
    equations = equations_of(scene, alpha=0.0, lcaba=(0.0, 1))
    system, start, nq = equations.system, equations.start, equations.nq
    if system.closed.constraints:
        raise UrdfError(f"scene {scene.name!r}: Pinocchio's aba knows no loops")
    gains, constant = _affine_laws(system.scene, system)
    model, tau = system.closed.model, gains @ start + constant
    return partial(pin.aba, model, model.createData(), start[:nq].copy(), start[nq:].copy(), tau)


def _equations_by_system(system: PinocchioSystem) -> Equations:
    """Return the equations by `PinocchioSystem`, for elements that `constraintDynamics` does not support."""
    map, nq = system.map, system.closed.model.nq
    ydot = np.empty(nq + system.nv)
    q, v = system.coordinates(initial_state(system.scene))

    def rates_at(t: float, y: Array) -> Array:
        """Return ydot at a time and state."""
        q, v = map.q_from_pinocchio(y[:nq]), map.v_from_pinocchio(y[nq:])
        system_at_t = at_time(system, t)
        ydot[:nq] = map.q_to_pinocchio(system_at_t.rate(q, v))
        ydot[nq:] = map.v_to_pinocchio(system_at_t.acceleration(q, v))
        return ydot

    # `PinocchioSystem` keeps its latest solution, so that two states in turn are evaluated at every call
    states = cycle([(q, v), (q, v + SMALL_VELOCITY)])
    start = np.concatenate([map.q_to_pinocchio(q), map.v_to_pinocchio(v)])
    return Equations(system, lambda: system.acceleration(*next(states)), rates_at, start, nq)


def _unsupported_elements(scene: Scene) -> list[str]:
    """Return the names of elements that `constraintDynamics` and `lcaba` do not support.

    They support gravity, loops that balls or welds close, and affine laws of joint coordinates. They do not
    support couplings, which are gears, screws and prescribed motions.
    """
    names = [force.element for force in scene.forces if not isinstance(force, JointSpring)]
    names += [law.element for law in scene.control if not isinstance(law, PD) or law.depends_on_time]
    names += [f"joint {joint.name!r}" for joint in scene.mechanism.joints if isinstance(joint, Rod)]
    return names + [f"{coupling.what} {coupling.name!r}" for coupling in couplings(scene)]


def _affine_laws(scene: Scene, system: PinocchioSystem) -> tuple[Array, Array]:
    """Return gains (nv, nq + nv) and constants (nv,) of all control laws and joint springs.

    The generalized forces are gains @ y + constants, in Pinocchio's order.
    """
    # index in the tree of each of Pinocchio's coordinates and velocities
    tree_q = list(system.map.q_to_pinocchio(np.arange(system.nq)))
    tree_v = list(system.map.v_to_pinocchio(np.arange(system.nv)))
    # tree of joints after the cut of all loops at balls, rods or welds; a ball with a spring is not cut
    tree = weld_loops(scene.mechanism, loaded=scene.loaded_balls).tree
    gains, constant = np.zeros((tree.nv, tree.nq + tree.nv)), np.zeros(tree.nv)
    for law in scene.joint_forces:
        indices = tree.place(law.joint, law.coordinate)
        assert indices is not None  # no hinge or slide closes a loop
        assert isinstance(law, PD | JointSpring)
        q_index, v_index = indices
        row = tree_v.index(v_index)
        gains[row, tree_q.index(q_index)] -= law.stiffness
        gains[row, tree.nq + row] -= law.damping
        if isinstance(law, PD):
            constant[row] += law.force(x=0.0, x_rate=0.0, time=0.0)
        else:
            constant[row] += law.stiffness * law.rest
    return gains, constant


def _proximal_settings(mu: float, iterations: int) -> Any:
    """Return `pinocchio.ProximalSettings` with a regularization mu and a largest number of iterations."""
    absolute_accuracy, relative_accuracy = 0.0, 1e-13
    return pin.ProximalSettings(absolute_accuracy, relative_accuracy, mu, iterations)


def _cheapest_accurate_settings(system: PinocchioSystem, accelerate: Callable[[Any], Array]) -> Any:
    """Return the first of `REGULARIZATIONS` with accurate accelerations at the initial state.

    Without regularization, Pinocchio returns NaN for redundant closures.

    Args:
        system: Pinocchio's system of the scene, whose accelerations are the reference.
        accelerate: computes the initial accelerations for `pinocchio.ProximalSettings`.
    """
    q, v = system.coordinates(initial_state(system.scene))
    exact = system.map.v_to_pinocchio(system.acceleration(q, v))
    for mu, iterations in REGULARIZATIONS:
        settings = _proximal_settings(mu, iterations)
        error = np.max(np.abs(accelerate(settings) - exact))
        if error <= MAX_REGULARIZATION_ERROR * max(float(np.max(np.abs(exact))), SMALLEST_SCALE):
            break
    return settings  # the last pair if no pair is accurate


def _quaternion_rate(p: list[float], omega: list[float]) -> tuple[float, float, float, float]:
    """Return the rate of a quaternion (x, y, z, w) at an angular velocity, rad/s, in the body frame."""
    x, y, z, w = p
    a, b, c = omega
    return (
        0.5 * (w * a + y * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y * a),
        -0.5 * (x * a + y * b + z * c),
    )


def lsoda(equations: Equations, rtol: float, atol: float) -> tuple[Array, int]:
    """Integrate by SciPy's LSODA (Adams and BDF methods of variable order) with interpolated outputs.

    Args:
        equations: equations of motion.
        rtol: relative tolerance.
        atol: absolute tolerance, SI units.

    Returns:
        y (n, nq + nv) at outputs, and the number of evaluations.

    Raises:
        IntegrationError: with LSODA's reason.
    """
    from scipy.integrate import odeint

    rows, info = odeint(
        equations.rates,
        equations.start,
        equations.system.scene.times,
        tfirst=True,
        rtol=rtol,
        atol=atol,
        full_output=True,
        mxstep=MAX_LSODA_STEPS,
    )
    if info["message"] != "Integration successful.":
        # the times reached, s: before the failure at least those of the outputs, after it undefined numbers
        reached = info["tcur"]
        failed = int(np.argmax(reached < equations.system.scene.times[1:]))
        raise IntegrationError(float(reached[failed]), f"LSODA: {info['message']}")
    return rows, int(info["nfe"][-1])


class Kinematics:
    """Poses of joints at all outputs of a run, read through a view of Pinocchio's memory.

    A placement has 12 numbers: the columns of the rotation matrix, then the translation, m, world frame.
    """

    def __init__(self, equations: Equations) -> None:
        """Prepare the view of the placements in a new `pinocchio.Data`."""
        self._equations = equations
        self._model = equations.system.closed.model
        self._data = self._model.createData()
        first, size = self._data.oMi[1], pin.SE3.Identity().homogeneous[:3].nbytes
        # Pinocchio stores placements contiguously, each as rotation and translation
        self._placements = as_strided(first.rotation, (self._model.njoints - 1, 12), (size, 8))
        joints = list(self._model.joints)[1:]
        self._balls = [slice(joint.idx_q, joint.idx_q + 4) for joint in joints if joint.nq == 4]

    def __call__(self, rows: Array) -> Array:
        """Return placements (n, joints, 12) of all joints except the universe, for states y (n, nq + nv).

        Quaternions in `rows` are normalized in place.
        """
        for ball in self._balls:
            rows[:, ball] /= np.linalg.norm(rows[:, ball], axis=1, keepdims=True)
        model, data, view, nq = self._model, self._data, self._placements, self._equations.nq
        forward = pin.forwardKinematics
        placements = np.empty((len(rows), *view.shape))
        for at_output, q in zip(placements, rows[:, :nq], strict=True):
            forward(model, data, q)
            at_output[...] = view
        return placements

    def poses(self, placements: Array) -> tuple[Array, Array]:
        """Return positions (n, b, 3), m, and quaternions (n, b, 4) of the scene's bodies, ground first.

        Raises:
            IntegrationError: for a motion that is not finite.
        """
        finite = np.all(np.isfinite(placements), axis=(1, 2))
        if not np.all(finite):
            reached = float(self._equations.system.scene.times[np.argmin(finite)])
            raise IntegrationError(reached, "its motion is not finite")
        bodies = self._equations.system.mechanism.bodies
        poses = np.empty((len(placements), len(bodies), 7))  # position, then quaternion (x, y, z, w)
        for k, body in enumerate(bodies):
            # frame that `PinocchioSystem` adds at the center of mass of each body
            frame = self._model.frames[self._model.getFrameId(f"{body.name}_body", pin.FrameType.OP_FRAME)]
            if frame.parentJoint == 0:  # fixed to the ground
                poses[:, k] = pin.SE3ToXYZQUAT(frame.placement)
                continue
            for pose, placement in zip(poses[:, k], placements[:, frame.parentJoint - 1], strict=True):
                rotation, translation = placement[:9].reshape(3, 3).T, placement[9:]
                pose[:] = pin.SE3ToXYZQUAT(pin.SE3(rotation, translation) * frame.placement)
        w_x_y_z = [6, 3, 4, 5]
        return poses[..., :3], poses[..., w_x_y_z]
