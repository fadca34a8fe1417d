"""Benchmark kernels of Pinocchio: right-hand sides and runs with as little Python as possible.

States y = (q, v) have Pinocchio's order, SI units, so that nothing is converted during a run. The kernels
store poses at output times only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
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
"""Regularizations (mu, iterations) of `constraintDynamics`, cheapest first, for redundant closures."""

MAX_REGULARIZATION_ERROR = 1e-9
"""Largest relative error of accelerations by a regularization."""

MAX_LSODA_STEPS = 1000
"""Largest number of steps of LSODA per output interval."""

Rates = Callable[[float, Array], Array]


class Equations(NamedTuple):
    """Equations of motion for many calls.

    Attributes:
        system: Pinocchio's system of the scene.
        acceleration: function without arguments, one right-hand side at the initial state.
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
    """Make the equations of motion by `constraintDynamics` or `lcaba`.

    Args:
        scene: scene to simulate.
        alpha: 1/s, of Baumgarte's gains.
        lcaba: (mu, iterations) of `lcaba`; None for `constraintDynamics`.

    Raises:
        UrdfError: for a scene with elements that `lcaba` does not support.
    """
    scene = replace(scene, outputs=frozenset())  # no work in the coordinates
    system = PinocchioSystem(scene, alpha)
    outside = _outside(scene)
    if outside and lcaba:
        known = "gravity, forces on joint coordinates, and loops that balls or welds close"
        raise UrdfError(f"{outside[0]}: Pinocchio's lcaba supports only {known}")
    if outside:
        return _checked_equations(system)
    model, constraints = system.closed.model, system.closed.constraints
    # arrays that every call reuses
    data = model.createData()
    nq, nv = model.nq, model.nv
    gains, constant = _laws(scene, system)
    tau, rates = np.zeros(nv), np.empty(nq + nv)
    qdot, vdot = rates[:nq], rates[nq:]
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
        return solve(model, data, start[:nq], start[nq:], tau, constraints, datas, settings)

    # the regularization, and the places of balls and single coordinates
    proximal = _proximal(*lcaba) if lcaba else _chosen(system, accelerate)
    joints = list(model.joints)[1:]
    balls = [(joint.idx_q, joint.idx_v) for joint in joints if joint.nq == 4]
    plain_q = [joint.idx_q for joint in joints if joint.nq == 1]
    plain_v = [joint.idx_v for joint in joints if joint.nq == 1]
    actuated = bool(scene.joint_forces)
    dot, add = np.dot, np.add

    def rates_at(t: float, y: Array) -> Array:
        v = y[nq:]
        if actuated:
            dot(gains, y, tau)
            add(tau, constant, tau)
        if balls:
            qdot[plain_q] = v[plain_v]
            for on_q, on_v in balls:
                qdot[on_q : on_q + 4] = _turned(y[on_q : on_q + 4].tolist(), v[on_v : on_v + 3].tolist())
        else:
            qdot[:] = v
        vdot[:] = solve(model, data, y[:nq], v, tau, constraints, datas, proximal)
        return rates

    q0, v0, tau0 = start[:nq].copy(), start[nq:].copy(), tau.copy()
    arguments = (model, data, q0, v0, tau0, constraints, datas, proximal)
    return Equations(system, partial(solve, *arguments), rates_at, start, nq)


def articulated_bodies(scene: Scene) -> Callable[[], Array]:
    """Make a call of no arguments that computes accelerations at the initial state by Pinocchio's `aba`.

    Raises:
        UrdfError: for a scene with loops, and for a force that `lcaba` does not know.
    """
    equations = equations_of(scene, 0.0, (0.0, 1))
    system, start, nq = equations.system, equations.start, equations.nq
    if system.closed.constraints:
        raise UrdfError(f"scene {scene.name!r}: Pinocchio's aba knows no loops")
    gains, constant = _laws(system.scene, system)
    model, tau = system.closed.model, gains @ start + constant
    return partial(pin.aba, model, model.createData(), start[:nq].copy(), start[nq:].copy(), tau)


def _checked_equations(system: PinocchioSystem) -> Equations:
    """Make the equations from `PinocchioSystem`, for elements that `constraintDynamics` does not support."""
    to, nq = system.map, system.closed.model.nq
    rates = np.empty(nq + system.nv)
    q, v = system.coordinates(initial_state(system.scene))

    def rates_at(t: float, y: Array) -> Array:
        q, v = to.q_from_pinocchio(y[:nq]), to.v_from_pinocchio(y[nq:])
        now = at_time(system, t)
        rates[:nq], rates[nq:] = to.q_to_pinocchio(now.rate(q, v)), to.v_to_pinocchio(now.acceleration(q, v))
        return rates

    start = np.concatenate([to.q_to_pinocchio(q), to.v_to_pinocchio(v)])
    return Equations(system, partial(system.acceleration, q, v), rates_at, start, nq)


def _outside(scene: Scene) -> list[str]:
    """List elements other than gravity, closures of Pinocchio and affine laws of joint coordinates."""
    found = [force.element for force in scene.forces if not isinstance(force, JointSpring)]
    found += [law.element for law in scene.control if not isinstance(law, PD) or law.is_driven]
    found += [f"joint {joint.name!r}" for joint in scene.mechanism.joints if isinstance(joint, Rod)]
    return found + [f"{coupling.what} {coupling.name!r}" for coupling in couplings(scene)]


def _laws(scene: Scene, system: PinocchioSystem) -> tuple[Array, Array]:
    """Return control laws and joint springs as an affine function of y: (nv, nq + nv) and (nv,)."""
    order_q = list(system.map.q_to_pinocchio(np.arange(system.nq)))
    order_v = list(system.map.v_to_pinocchio(np.arange(system.nv)))
    tree = weld_loops(scene.mechanism, loaded=scene.loaded_balls).tree
    gains, constant = np.zeros((tree.nv, tree.nq + tree.nv)), np.zeros(tree.nv)
    for law in scene.joint_forces:
        place = tree.place(law.joint, law.coordinate)
        assert place is not None  # only balls close loops
        assert isinstance(law, PD | JointSpring)
        row = order_v.index(place[1])
        gains[row, order_q.index(place[0])] -= law.stiffness
        gains[row, tree.nq + row] -= law.damping
        if isinstance(law, PD):
            constant[row] += law.force(0.0, 0.0, 0.0)
        else:
            constant[row] += law.stiffness * law.rest
    return gains, constant


def _proximal(mu: float, iterations: int) -> Any:
    return pin.ProximalSettings(0.0, 1e-13, mu, iterations)


def _chosen(system: PinocchioSystem, accelerate: Callable[[Any], Array]) -> Any:
    """Choose the cheapest accurate regularization; none for independent closures."""
    q, v = system.coordinates(initial_state(system.scene))
    exact = system.map.v_to_pinocchio(system.acceleration(q, v))
    for mu, iterations in REGULARIZATIONS:  # plain elimination returns NaN for redundant closures
        settings = _proximal(mu, iterations)
        error = np.max(np.abs(accelerate(settings) - exact))
        if error <= MAX_REGULARIZATION_ERROR * max(float(np.max(np.abs(exact))), 1e-6):
            break
    return settings


def _turned(p: list[float], omega: list[float]) -> tuple[float, float, float, float]:
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
    """Integrate by LSODA, Adams and BDF methods of variable order, with interpolated outputs.

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
        raise IntegrationError(float(info["tcur"].max()), f"LSODA: {info['message']}")
    return rows, int(info["nfe"][-1])


class Kinematics:
    """Poses of joints at every output, through a view of Pinocchio's placements.

    A placement has 12 numbers: the columns of the rotation matrix and the translation, m, world frame.
    """

    def __init__(self, equations: Equations) -> None:
        self._equations = equations
        self._model = equations.system.closed.model
        self._data = self._model.createData()
        first, size = self._data.oMi[1], pin.SE3.Identity().homogeneous[:3].nbytes
        # Pinocchio stores placements contiguously, each as rotation and translation
        self._placements = as_strided(first.rotation, (self._model.njoints - 1, 12), (size, 8))
        joints = list(self._model.joints)[1:]
        self._balls = [slice(joint.idx_q, joint.idx_q + 4) for joint in joints if joint.nq == 4]

    def __call__(self, rows: Array) -> Array:
        """Return placements (n, joints, 12) of all joints except the universe, for y (n, nq + nv)."""
        for ball in self._balls:
            rows[:, ball] /= np.linalg.norm(rows[:, ball], axis=1, keepdims=True)
        model, data, view, nq = self._model, self._data, self._placements, self._equations.nq
        forward = pin.forwardKinematics
        found = np.empty((len(rows), *view.shape))
        for placements, q in zip(found, rows[:, :nq], strict=True):
            forward(model, data, q)
            placements[...] = view
        return found

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
        found = np.empty((len(placements), len(bodies), 7))
        for k, body in enumerate(bodies):
            frame = self._model.frames[self._model.getFrameId(f"{body.name}_body", pin.FrameType.OP_FRAME)]
            if frame.parentJoint == 0:
                found[:, k] = pin.SE3ToXYZQUAT(frame.placement)
                continue
            for pose, placement in zip(found[:, k], placements[:, frame.parentJoint - 1], strict=True):
                joint = pin.SE3(placement[:9].reshape(3, 3).T, placement[9:])
                pose[:] = pin.SE3ToXYZQUAT(joint * frame.placement)
        return found[..., :3], found[..., [6, 3, 4, 5]]
