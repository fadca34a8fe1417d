"""Small motions of an MJCF model in MuJoCo: linearized accelerations, and the map of one `mj_step`.

Both matrices are central differences of MuJoCo's own functions, with the soft constraints, the integrator and
the time step of the run. They show which mode of a model is too fast for a time step, see
`crosscheck.own_run.stability`. Contacts, limits and dry friction are switched off, as in the imported scene.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.layout import element_name
from newton_euler.reading.small_motions import ForceElement, ModelChange, MovingBody, SmallMotions
from newton_euler.scalars import Array

DIFFERENCE = 1e-6
"""Change of a coordinate or velocity in central differences, rad, m, rad/s or m/s: the square, the relative
error of a difference, is far below the round-off of a difference, 1e-10."""

KINEMATIC_TIME = 1e-4
"""Time, s, over which velocities move a configuration in the differences of its rate."""

CONVERGED_ITERATIONS = 100
"""Iterations of MuJoCo's Newton solver, which needs one or two without contacts."""


_Entries = tuple[tuple[str, Any], ...]


@dataclass(frozen=True)
class _Part:
    """A force element, and the entries of the model's arrays that it is proportional to.

    Attributes:
        element: name and value.
        entries: arrays of the model, and the index of the entries in each.
        equality: number of the equality, which is switched off instead; -1 for other elements.
        stops: whether the element is the motion itself: velocities are set to zero.
    """

    element: ForceElement
    entries: _Entries = ()
    equality: int = -1
    stops: bool = False


def _actuator_parts(model: Any, k: int) -> Iterator[_Part]:
    """Yield the gains of an actuator by position and by velocity; an actuator of another kind as a whole."""
    name = element_name(model, "actuator", k)
    gain, bias = model.actuator_gainprm[k], model.actuator_biasprm[k]
    known_gains = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE
    known_biases = mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE
    gain_kind = mujoco.mjtGain(model.actuator_gaintype[k])
    bias_kind = mujoco.mjtBias(model.actuator_biastype[k])
    if gain_kind not in known_gains or bias_kind not in known_biases:
        yield _Part(ForceElement(name, can_be_scaled=False), (("actuator_gear", k),))
        return
    has_bias = bias_kind == mujoco.mjtBias.mjBIAS_AFFINE
    by_position = gain[1] != 0.0 or (has_bias and bias[1] != 0.0)
    by_velocity = gain[2] != 0.0 or (has_bias and bias[2] != 0.0)
    # the factor of the control belongs to the gain that pulls toward the control
    entries: _Entries
    if by_position:
        entries = (("actuator_gainprm", (k, slice(0, 2))), ("actuator_biasprm", (k, slice(0, 2))))
        yield _Part(ForceElement(f"kp of {name}", abs(float(bias[1] or gain[1]))), entries)
    if by_velocity:
        factors = (k, 2) if by_position else (k, slice(0, 3))
        entries = (("actuator_gainprm", factors), ("actuator_biasprm", (k, 2)))
        yield _Part(ForceElement(f"kv of {name}", abs(float(bias[2] or gain[2]))), entries)
    if np.any(model.actuator_damping[k]) or np.any(model.actuator_dampingpoly[k]):
        entries = (("actuator_damping", k), ("actuator_dampingpoly", k))
        yield _Part(ForceElement(f"damping of {name}", float(np.max(model.actuator_damping[k]))), entries)


def _parts(model: Any) -> Iterator[_Part]:
    """Yield the elements of a model that make forces by position or velocity."""
    for k in range(model.nactuator):
        yield from _actuator_parts(model, k)
    for k in range(model.njnt):
        name, dofs = element_name(model, "joint", k), model.dof_jntid == k
        if model.jnt_stiffness[k] or np.any(model.jnt_stiffnesspoly[k]):
            entries: _Entries = (("jnt_stiffness", k), ("jnt_stiffnesspoly", k))
            yield _Part(ForceElement(f"stiffness of {name}", float(model.jnt_stiffness[k])), entries)
        if np.any(model.dof_damping[dofs]) or np.any(model.dof_dampingpoly[dofs]):
            entries = (("dof_damping", dofs), ("dof_dampingpoly", dofs))
            yield _Part(ForceElement(f"damping of {name}", float(np.max(model.dof_damping[dofs]))), entries)
    for k in range(model.ntendon):
        name = element_name(model, "tendon", k)
        for what in ("stiffness", "damping"):
            fields = f"tendon_{what}", f"tendon_{what}poly"
            if any(np.any(getattr(model, field)[k]) for field in fields):
                value = float(getattr(model, fields[0])[k])
                yield _Part(ForceElement(f"{what} of {name}", value), tuple((field, k) for field in fields))
    for k in range(model.neq):
        name = element_name(model, "equality", k)
        yield _Part(ForceElement(name, can_be_scaled=False, is_constraint=True), equality=k)
    for what in ("viscosity", "density"):
        if getattr(model.opt, what):
            yield _Part(ForceElement(f"{what} of the medium", getattr(model.opt, what)), (("opt", what),))
    yield _Part(ForceElement("gyroscopic forces of the motion", can_be_scaled=False), stops=True)


def _scale(model: Any, part: _Part, factor: float) -> None:
    """Multiply the forces of an element by a factor, in a model that is changed."""
    for array, index in part.entries:
        if array == "opt":
            setattr(model.opt, index, factor * getattr(model.opt, index))
        else:
            getattr(model, array)[index] *= factor


class MujocoSmallMotions(SmallMotions[Any]):
    """Small motions of an MJCF file about states of a run in MuJoCo."""

    def __init__(
        self, settings: Any, model: Any, active: Array, times: Array, states: Sequence[tuple[Array, ...]]
    ) -> None:
        """Take a model without contacts, limits and dry friction, which is not changed.

        Args:
            settings: settings of the file, see `mjcf.file_run.MujocoSettings`.
            model: compiled model of the reduced run.
            active: (neq,) equalities that act in the run.
            times: (k,) time of each state, s.
            states: configuration (nq,), velocities (nv,), activations (na,) and controls (nu,) of each state.
        """
        self._settings, self._model, self._active = settings, model, active
        self.times, self._states = times, states
        self._parts = tuple(_parts(model))
        self.elements = tuple(part.element for part in self._parts)
        self.velocities = slice(model.nv, 2 * model.nv)

    def at_timestep(self, settings: Any, timestep: float) -> Any:
        return replace(settings, timestep=timestep)

    def rates(self, state: int, settings: Any, without: Collection[int] = ()) -> Array:
        model, data = self._prepared(state, settings, without)
        base, moved = data.qpos.copy(), [np.zeros(model.nq), np.zeros(model.nq)]
        own = base.copy(), data.qvel.copy()
        change = np.zeros(model.nv)

        def evaluate(q: Array, v: Array, activation: Array) -> Array:
            """Return the rates of the small motion (n,): of position, velocity and activations."""
            data.qpos[:], data.qvel[:], data.act[:] = q, v, activation
            mujoco.mj_forward(model, data)
            # the distance from the moving base state, just after and just before
            apart = []
            for k, sign in enumerate((1.0, -1.0)):
                moved[k][:], other = own[0], q.copy()
                mujoco.mj_integratePos(model, moved[k], own[1], sign * KINEMATIC_TIME)
                mujoco.mj_integratePos(model, other, v, sign * KINEMATIC_TIME)
                mujoco.mj_differentiatePos(model, change, 2.0 * KINEMATIC_TIME, moved[k], other)
                apart.append(sign * change)
            return np.concatenate([apart[0] + apart[1], data.qacc, data.act_dot])

        return self._differences(data, evaluate)

    def step(self, state: int, settings: Any, without: Collection[int] = ()) -> Array:
        model, data = self._prepared(state, settings, without)
        start, now = (data.qpos.copy(), data.qvel.copy(), data.act.copy()), data.time
        change, reached = np.zeros(model.nv), None

        def evaluate(q: Array, v: Array, activation: Array) -> Array:
            """Return the state after one step (n,), its position relative to the base state's."""
            data.time = now
            data.qpos[:], data.qvel[:], data.act[:] = q, v, activation
            data.qacc_warmstart[:] = 0.0
            mujoco.mj_step(model, data)
            if reached is not None:
                mujoco.mj_differentiatePos(model, change, 1.0, reached, data.qpos)
            return np.concatenate([change, data.qvel, data.act])

        evaluate(*start)
        reached = data.qpos.copy()
        data.qpos[:], data.qvel[:], data.act[:] = start
        return self._differences(data, evaluate)

    def _prepared(self, state: int, settings: Any, without: Collection[int]) -> tuple[Any, Any]:
        """Return a model with these settings and without some elements, and its data at a state."""
        model = copy.copy(self._model)
        replace(settings, solver="Newton", iterations=CONVERGED_ITERATIONS, tolerance=0.0).apply(model)
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        data = mujoco.MjData(model)
        data.time, data.eq_active[:] = self.times[state], self._active
        data.qpos[:], data.qvel[:], data.act[:], data.ctrl[:] = self._states[state]
        for part in (self._parts[k] for k in without):
            _scale(model, part, 0.0)
            if part.equality >= 0:
                data.eq_active[part.equality] = 0
            if part.stops:
                data.qvel[:] = 0.0
        return model, data

    def _differences(self, data: Any, evaluate: Callable[[Array, Array, Array], Array]) -> Array:
        """Return the derivatives (n, n) of a function of configuration, velocities and activations."""
        model = self._model
        q, v, activation = data.qpos.copy(), data.qvel.copy(), data.act.copy()
        columns = []
        with collected_warnings():
            for place in range(2 * model.nv + model.na):
                ends = []
                for sign in (1.0, -1.0):
                    step = np.zeros(2 * model.nv + model.na)
                    step[place] = sign * DIFFERENCE
                    moved = q.copy()
                    mujoco.mj_integratePos(model, moved, step[: model.nv], 1.0)
                    ends.append(evaluate(moved, v + step[self.velocities], activation + step[2 * model.nv :]))
                columns.append((ends[0] - ends[1]) / (2.0 * DIFFERENCE))
        return np.array(columns).T

    def moving(self, state: int, velocity: Array) -> MovingBody:
        model, data = self._prepared(state, self._settings, ())
        mujoco.mj_fwdPosition(model, data)
        energies = np.zeros(model.nbody)
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for body in range(1, model.nbody):
            mujoco.mj_jacBodyCom(model, data, linear, angular, body)
            turn = data.ximat[body].reshape(3, 3).T @ angular @ velocity
            along = linear @ velocity
            energies[body] = model.body_mass[body] * np.sum(np.abs(along) ** 2)
            energies[body] += np.sum(model.body_inertia[body] * np.abs(turn) ** 2)
        body = int(np.argmax(energies))
        neighbor = max(self._neighbors(body), key=lambda k: float(model.body_mass[k]), default=0)
        return MovingBody(
            model.body(body).name or f"body_{body}",
            float(model.body_mass[body]),
            float(energies[body] / max(np.sum(energies), 1e-300)),
            (model.body(neighbor).name or f"body_{neighbor}") if neighbor else "",
            float(model.body_mass[neighbor]) if neighbor else 0.0,
        )

    def _neighbors(self, body: int) -> set[int]:
        """Return the moving bodies that a joint or an acting equality of bodies connects to a body."""
        model = self._model
        found = {int(model.body_parentid[body]), *np.flatnonzero(model.body_parentid == body).tolist()}
        for k in np.flatnonzero(self._active).tolist():
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
        return {k for k in found if k != body and model.body_weldid[k]}

    def scaled(self, elements: Collection[int], factor: float) -> ModelChange:
        def change(model: Any) -> None:
            for k in elements:
                _scale(model, self._parts[k], factor)

        return change

    def with_armature(self, state: int, velocity: Array, factor: float) -> tuple[ModelChange, str]:
        model, data = self._prepared(state, self._settings, ())
        mujoco.mj_fwdPosition(model, data)
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        # the joint whose motion alone would have most energy, and the inertia that it feels
        dof = int(np.argmax(np.diag(mass) * np.abs(velocity) ** 2))
        joint = int(model.dof_jntid[dof])
        armature = float(f"{factor * mass[dof, dof]:.2g}")

        def change(model: Any) -> None:
            model.dof_armature[model.dof_jntid == joint] += armature
            mujoco.mj_setConst(model, mujoco.MjData(model))

        total = armature + float(model.dof_armature[dof])
        return change, f'armature="{total:.2g}" of {element_name(model, "joint", joint)}'
