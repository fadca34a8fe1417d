"""Small motions of an MJCF model in MuJoCo: linearized accelerations, and the map of one `mj_step`.

A small motion x about a state of a run has n = 2 nv + na elements: changes of position (nv,), velocity (nv,)
and activations (na,). Two matrices describe small motions: the rates A of dx/dt = A x, and the map M of one
time step, x_next = M x. Both are central differences of MuJoCo's own functions, with the soft constraints,
the integrator and the time step of the run. `crosscheck.own_run.stability` finds from them the mode of a
model that is too fast for a time step, and the force element that causes the mode. Contacts, limits and dry
friction are switched off, as in the scene that is imported from the file. Fields of the model, such as
`nactuator` and `dof_dampingpoly`, have the names of MuJoCo 4.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.layout import element_name
from mjcf.run_settings import MujocoSettings
from newton_euler.reading.small_motions import ForceElement, ModelChange, MovingBody, SmallMotions
from newton_euler.scalars import Array

DIFFERENCE = 1e-6
"""Change of a coordinate or velocity in central differences, rad, m, rad/s or m/s.

The relative truncation error, the square of the change, is 1e-12, far below the round-off, about 1e-10."""

KINEMATIC_TIME = 1e-4
"""Time, s, over which velocities move a configuration, for a difference that gives the rate of a position."""

CONVERGED_ITERATIONS = 100
"""Iterations that MuJoCo's Newton solver may use; without contacts it needs one or two."""

_Entries = tuple[tuple[str, Any], ...]
"""Pairs of the name of an array of the model, and an index of entries of the array."""


@dataclass(frozen=True)
class _RemovableElement:
    """A force element, and how to remove or weaken the element in a model.

    Attributes:
        element: name and value of the element.
        entries: entries of the model's arrays to which the force is proportional.
        equality: number of an equality, which is switched off; -1 for other elements.
        is_motion: True for the forces that depend on the velocity of the state; they are removed by setting
            velocities to zero.
    """

    element: ForceElement
    entries: _Entries = ()
    equality: int = -1
    is_motion: bool = False


def _actuator_elements(model: Any, k: int) -> Iterator[_RemovableElement]:
    """Yield the dynamics of the activation, the gains by position and velocity, and the damping, of actuator
    number `k`.

    An actuator whose force is not affine in length and velocity is one element.
    """
    name = element_name(model, "actuator", k)
    dynamics = mujoco.mjtDyn(model.actuator_dyntype[k])
    if dynamics != mujoco.mjtDyn.mjDYN_NONE:
        # without dynamics, an activation is constant
        fixed: _Entries = (("actuator_dyntype", k),)
        if dynamics in (mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT):
            what, value = "time constant", float(model.actuator_dynprm[k, 0])
        else:
            what, value = "dynamics", math.nan
        yield _RemovableElement(ForceElement(f"{what} of {name}", value, can_be_scaled=False), fixed)
    gain, bias = model.actuator_gainprm[k], model.actuator_biasprm[k]
    affine_gains = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE
    affine_biases = mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE
    gain_kind = mujoco.mjtGain(model.actuator_gaintype[k])
    bias_kind = mujoco.mjtBias(model.actuator_biastype[k])
    if gain_kind not in affine_gains or bias_kind not in affine_biases:
        yield _RemovableElement(ForceElement(name, can_be_scaled=False), (("actuator_gear", k),))
        return
    # elements 0, 1, 2 of gain and bias are the factors of 1, length and velocity
    has_bias = bias_kind == mujoco.mjtBias.mjBIAS_AFFINE
    by_position = gain[1] != 0.0 or (has_bias and bias[1] != 0.0)
    by_velocity = gain[2] != 0.0 or (has_bias and bias[2] != 0.0)
    # scaling a gain also scales the factor of the control, element 0, so that the actuator still pulls
    # towards the same position or velocity; if there are both gains, element 0 belongs to the position
    entries: _Entries
    if by_position:
        entries = (("actuator_gainprm", (k, slice(0, 2))), ("actuator_biasprm", (k, slice(0, 2))))
        yield _RemovableElement(ForceElement(f"kp of {name}", abs(float(bias[1] or gain[1]))), entries)
    if by_velocity:
        factors = (k, 2) if by_position else (k, slice(0, 3))
        entries = (("actuator_gainprm", factors), ("actuator_biasprm", (k, 2)))
        yield _RemovableElement(ForceElement(f"kv of {name}", abs(float(bias[2] or gain[2]))), entries)
    if np.any(model.actuator_damping[k]) or np.any(model.actuator_dampingpoly[k]):
        entries = (("actuator_damping", k), ("actuator_dampingpoly", k))
        yield _RemovableElement(
            ForceElement(f"damping of {name}", float(np.max(model.actuator_damping[k]))), entries
        )


def _removable_elements(model: Any) -> Iterator[_RemovableElement]:
    """Yield the elements of a model whose forces depend on position or velocity."""
    for k in range(model.nactuator):
        yield from _actuator_elements(model, k)
    for k in range(model.njnt):
        name, dofs = element_name(model, "joint", k), model.dof_jntid == k
        if model.jnt_stiffness[k] or np.any(model.jnt_stiffnesspoly[k]):
            entries: _Entries = (("jnt_stiffness", k), ("jnt_stiffnesspoly", k))
            yield _RemovableElement(
                ForceElement(f"stiffness of {name}", float(model.jnt_stiffness[k])), entries
            )
        if np.any(model.dof_damping[dofs]) or np.any(model.dof_dampingpoly[dofs]):
            entries = (("dof_damping", dofs), ("dof_dampingpoly", dofs))
            yield _RemovableElement(
                ForceElement(f"damping of {name}", float(np.max(model.dof_damping[dofs]))), entries
            )
    for k in range(model.ntendon):
        name = element_name(model, "tendon", k)
        for what in ("stiffness", "damping"):
            fields = f"tendon_{what}", f"tendon_{what}poly"
            if any(np.any(getattr(model, field)[k]) for field in fields):
                value = float(getattr(model, fields[0])[k])
                yield _RemovableElement(
                    ForceElement(f"{what} of {name}", value), tuple((field, k) for field in fields)
                )
    for k in range(model.neq):
        name = element_name(model, "equality", k)
        yield _RemovableElement(ForceElement(name, can_be_scaled=False, is_constraint=True), equality=k)
    for what in ("viscosity", "density"):
        if getattr(model.opt, what):
            yield _RemovableElement(
                ForceElement(f"{what} of the medium", getattr(model.opt, what)), (("opt", what),)
            )
    yield _RemovableElement(
        ForceElement("gyroscopic effect of the motion", can_be_scaled=False), is_motion=True
    )


def _scale(model: Any, removable: _RemovableElement, factor: float) -> None:
    """Multiply the forces of an element by a factor; the model is changed."""
    for array, index in removable.entries:
        if array == "opt":
            setattr(model.opt, index, factor * getattr(model.opt, index))
        else:
            getattr(model, array)[index] *= factor


class MujocoSmallMotions(SmallMotions[MujocoSettings]):
    """Small motions of an MJCF file about states of a run in MuJoCo.

    Attributes:
        times: (k,) time of each state, s.
        elements: force elements of the model; other methods name them by their number.
        velocities: slice of the velocities in a small motion.
    """

    def __init__(
        self,
        settings: MujocoSettings,
        model: Any,
        active: Array,
        times: Array,
        states: Sequence[tuple[Array, ...]],
    ) -> None:
        """Take a model without contacts, limits and dry friction, which is not changed.

        Args:
            settings: time step, integrator, constraint solver and softness of the run.
            model: compiled model of the run.
            active: (neq,) 1 for equalities that act in the run.
            times: (k,) time of each state, s.
            states: configuration (nq,), velocities (nv,), activations (na,) and controls (nu,) of each state.
        """
        self._settings, self._active = settings, active
        self.times, self._states = times, states
        self._removable = tuple(_removable_elements(model))
        # a model with meshes is large: one copy is changed, and restored before the next change. Settings
        # change its options, and the softness `eq_solref` and `eq_solimp` of equalities
        self._model, self._original_options = copy.copy(model), copy.copy(model.opt)
        arrays = {array for each in self._removable for array, _ in each.entries if array != "opt"}
        self._original_arrays = {
            array: getattr(model, array).copy() for array in {*arrays, "eq_solref", "eq_solimp"}
        }
        self.elements = tuple(each.element for each in self._removable)
        self.velocities = slice(model.nv, 2 * model.nv)

    def at_timestep(self, settings: MujocoSettings, timestep: float) -> MujocoSettings:
        """Return settings with another time step, s."""
        return replace(settings, timestep=timestep)

    def rates(self, state: int, settings: MujocoSettings, without: Collection[int] = ()) -> Array:
        """Return the matrix A (n, n) of dx/dt = A x.

        Args:
            state: number of the state.
            settings: settings; the stiffness of constraints may depend on the time step.
            without: numbers of the elements that are removed.
        """
        model, data = self._prepared(state, settings, without)
        base_q, base_v = data.qpos.copy(), data.qvel.copy()
        moved_base, change = np.zeros(model.nq), np.zeros(model.nv)

        def evaluate(q: Array, v: Array, activation: Array) -> Array:
            """Return the rates (n,) of position relative to the base state, velocity and activations."""
            data.qpos[:], data.qvel[:], data.act[:] = q, v, activation
            mujoco.mj_forward(model, data)
            # rate of the position relative to the base state, which moves, too: central difference over time
            half_differences = []
            for sign in (1.0, -1.0):
                moved_base[:], moved = base_q, q.copy()
                mujoco.mj_integratePos(model, moved_base, base_v, sign * KINEMATIC_TIME)
                mujoco.mj_integratePos(model, moved, v, sign * KINEMATIC_TIME)
                mujoco.mj_differentiatePos(model, change, 2.0 * KINEMATIC_TIME, moved_base, moved)
                half_differences.append(sign * change)
            position_rate = half_differences[0] + half_differences[1]
            return np.concatenate([position_rate, data.qacc, data.act_dot])

        return self._differences(data, evaluate)

    def step(
        self,
        state: int,
        settings: MujocoSettings,
        without: Collection[int] = (),
        start: Array | None = None,
    ) -> Array:
        """Return the map M (n, n) of one time step, x_next = M x, or small motions (n, k) after one step.

        Args:
            state, settings, without: see `rates`.
            start: (n, k) small motions before the step, for the result M start; None for M.
        """
        model, data = self._prepared(state, settings, without)
        base_start, now = (data.qpos.copy(), data.qvel.copy(), data.act.copy()), data.time
        change, base_end = np.zeros(model.nv), None

        def evaluate(q: Array, v: Array, activation: Array) -> Array:
            """Return position relative to the base state's, velocity and activations (n,) after one step."""
            data.time = now
            data.qpos[:], data.qvel[:], data.act[:] = q, v, activation
            data.qacc_warmstart[:] = 0.0
            mujoco.mj_step(model, data)
            if base_end is not None:
                mujoco.mj_differentiatePos(model, change, 1.0, base_end, data.qpos)
            return np.concatenate([change, data.qvel, data.act])

        # configuration to which a step moves the base state
        evaluate(*base_start)
        base_end = data.qpos.copy()
        data.qpos[:], data.qvel[:], data.act[:] = base_start
        return self._differences(data, evaluate, start)

    def _prepared(self, state: int, settings: MujocoSettings, without: Collection[int]) -> tuple[Any, Any]:
        """Return the model with these settings and without some elements, and its data at a state.

        The model keeps the settings, and lacks the elements, until the next call.
        """
        model = self._model
        model.opt = self._original_options
        for array, values in self._original_arrays.items():
            getattr(model, array)[:] = values
        # an exact solution of the constraints, and no reset of states that diverge
        replace(settings, solver="Newton", iterations=CONVERGED_ITERATIONS, tolerance=0.0).apply(model)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        data = mujoco.MjData(model)
        data.time, data.eq_active[:] = self.times[state], self._active
        data.qpos[:], data.qvel[:], data.act[:], data.ctrl[:] = self._states[state]
        for removed in (self._removable[k] for k in without):
            _scale(model, removed, 0.0)
            if removed.equality >= 0:
                data.eq_active[removed.equality] = 0
            if removed.is_motion:
                data.qvel[:] = 0.0
        return model, data

    def _differences(
        self,
        data: Any,
        evaluate: Callable[[Array, Array, Array], Array],
        directions: Array | None = None,
    ) -> Array:
        """Return the derivatives of a function by small motions about the state in `data`.

        Args:
            data: MuJoCo's data at the state.
            evaluate: function (n,) of configuration (nq,), velocities (nv,) and activations (na,).
            directions: (n, k) small motions with elements of order 1; None for the derivatives (n, n) by
                each element of a small motion.
        """
        model = self._model
        q, v, activation = data.qpos.copy(), data.qvel.copy(), data.act.copy()
        if directions is None:
            directions = np.eye(2 * model.nv + model.na)
        columns = []
        with collected_warnings():
            for direction in directions.T:
                values = []
                for sign in (1.0, -1.0):
                    motion = sign * DIFFERENCE * direction
                    moved = q.copy()
                    mujoco.mj_integratePos(model, moved, motion[: model.nv], 1.0)
                    moved_v = v + motion[self.velocities]
                    values.append(evaluate(moved, moved_v, activation + motion[2 * model.nv :]))
                forward, backward = values
                columns.append((forward - backward) / (2.0 * DIFFERENCE))
        return np.array(columns).T

    def moving(self, state: int, velocity: Array) -> MovingBody:
        """Return the body with most kinetic energy, and its heaviest neighbor.

        Args:
            state: number of the state.
            velocity: (nv,) complex amplitudes of the velocities in a mode.
        """
        model, data = self._prepared(state, self._settings, without=())
        mujoco.mj_fwdPosition(model, data)
        # twice the kinetic energy of each body; inertias are about principal axes
        energies = np.zeros(model.nbody)
        linear_jacobian, angular_jacobian = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for body in range(1, model.nbody):
            mujoco.mj_jacBodyCom(model, data, linear_jacobian, angular_jacobian, body)
            angular = data.ximat[body].reshape(3, 3).T @ angular_jacobian @ velocity
            linear = linear_jacobian @ velocity
            energies[body] = model.body_mass[body] * np.sum(np.abs(linear) ** 2)
            energies[body] += np.sum(model.body_inertia[body] * np.abs(angular) ** 2)
        body = int(np.argmax(energies))
        neighbor = max(self._neighbors(body), key=lambda k: float(model.body_mass[k]), default=0)
        return MovingBody(
            name=model.body(body).name or f"body_{body}",
            mass=float(model.body_mass[body]),
            share=float(energies[body] / max(np.sum(energies), 1e-300)),
            neighbor=(model.body(neighbor).name or f"body_{neighbor}") if neighbor else "",
            neighbor_mass=float(model.body_mass[neighbor]) if neighbor else 0.0,
        )

    def _neighbors(self, body: int) -> set[int]:
        """Return the moving bodies that a joint or an acting equality connects to a body, by number."""
        model = self._model
        found = {int(model.body_parentid[body]), *np.flatnonzero(model.body_parentid == body).tolist()}
        for k in np.flatnonzero(self._active).tolist():
            # numbers of two bodies, or of two joints or sites on bodies
            ends: tuple[int, ...] = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            kind = mujoco.mjtEq(model.eq_type[k])
            if kind == mujoco.mjtEq.mjEQ_JOINT:
                ends = tuple(int(model.jnt_bodyid[end]) if end >= 0 else 0 for end in ends)
            elif kind not in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD):
                continue
            elif model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
                ends = tuple(int(model.site_bodyid[end]) for end in ends)
            if body in ends:
                found.update(ends)
        return {k for k in found if k != body and model.body_weldid[k]}  # not fixed to the world

    def scaled(self, elements: Collection[int], factor: float) -> ModelChange:
        """Return a function that multiplies the forces of elements, by number, by a factor in a model."""

        def change(model: Any) -> None:
            """Scale the elements in a compiled model."""
            for k in elements:
                _scale(model, self._removable[k], factor)

        return change

    def with_armature(self, state: int, velocity: Array, factor: float) -> tuple[ModelChange, str]:
        """Add armature (rotor inertia) to the joint that moves most.

        Args:
            state: number of the state.
            velocity: (nv,) complex amplitudes of the velocities in a mode.
            factor: added armature, divided by the inertia of the joint if no other joint moves.

        Returns:
            A function that changes a model, and its words, such as 'armature="0.01" of joint lift'.
        """
        model, data = self._prepared(state, self._settings, without=())
        mujoco.mj_fwdPosition(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        # the joint whose motion alone has most kinetic energy; two digits of armature are enough
        dof = int(np.argmax(np.diag(mass) * np.abs(velocity) ** 2))
        joint = int(model.dof_jntid[dof])
        armature = float(f"{factor * mass[dof, dof]:.2g}")

        def change(model: Any) -> None:
            """Add the armature in a compiled model, and update the constants that depend on it."""
            model.dof_armature[model.dof_jntid == joint] += armature
            mujoco.mj_setConst(model, mujoco.MjData(model))

        total = armature + float(model.dof_armature[dof])
        return change, f'armature="{total:.2g}" of {element_name(model, "joint", joint)}'
