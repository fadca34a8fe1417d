"""A scene (a mechanism with forces, control laws and initial state) compiled by MuJoCo.

`MujocoScene` writes a scene as MJCF and compiles it. The class sets states and controls in MuJoCo's data,
and reads poses, velocities and energies from the data. Subclasses in `mjcf.rigid` and `mjcf.soft` add the
equations of motion with rigid and with soft constraints.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import mujoco
import numpy as np

from mjcf.errors import ModelError
from mjcf.forces import WIND_MOTORS, wind_loads, wind_site
from mjcf.layout import Layout
from mjcf.loops import body_velocity
from mjcf.write import controls, welded_to_xml
from newton_euler.equations.coupling_equations import TreeCouplings
from newton_euler.equations.load_friction import EngineFriction, HeldFriction, loaded_frictions
from newton_euler.equations.model_control import EngineControl, roles
from newton_euler.equations.system import MassProperties, Observation
from newton_euler.model.control import NO_FORCES, Readings, commands
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import coordinate_name, weld_loops
from newton_euler.model.state import State
from newton_euler.reading.switched_loads import SwitchedLoads
from newton_euler.reading.wrenches import wind_on_plate
from newton_euler.scalars import Array, Scalar

MIN_MUJOCO_MASS = 1e-14
"""Mass, kg, and principal moment, kg m^2, up to which MuJoCo's compiler refuses a body."""


def _reason_of_refusal(mechanism: Mechanism, error: ValueError) -> str:
    """Return the reason why MuJoCo refuses a mechanism: a body that is too light, or MuJoCo's message."""
    for body in mechanism.bodies[1:]:
        least_moment = float(np.linalg.eigvalsh(body.inertia)[0])
        if min(body.mass, least_moment) <= MIN_MUJOCO_MASS:
            values = f"mass {body.mass:g} kg, least principal moment {least_moment:g} kg m^2"
            return f"body {body.name!r}: {values}; needed: more than {MIN_MUJOCO_MASS:g} of both"
    return " ".join(str(error).split())


class MujocoScene:
    """Scene with its `MjModel` and `MjData`.

    MuJoCo can close a loop by a ball, a rod (a massless link with a ball at each end) or a weld only. At any
    other joint that closes a loop, one of the bodies is cut into two halves, which a weld joins: the welded
    mechanism. Its body frames in MuJoCo have their origins at the centers of mass. Coordinates q (nq,) and
    velocities v (nv,) belong to the spanning tree of this mechanism; quaternions are (w, x, y, z). MuJoCo's
    qpos and qvel stay inside this class.

    Attributes:
        scene: the scene; results are for the bodies and joints of its mechanism.
        mechanism: mechanism of the scene.
        welded: welded mechanism, which MuJoCo models.
        tree: spanning tree of the welded mechanism.
        quaternions: slices of the quaternions in q.
        layout: orthogonal maps between coordinates of the tree and of MuJoCo.
        model: `MjModel`.
        data: `MjData`, which every call may overwrite.
        body_id: MuJoCo's number of each body of `welded.mechanism`; added halves of cut bodies are last.
        couplings: gears, screws and prescribed motions; their equalities are MuJoCo's last ones, in the same
            order.
        time: time, s, of prescribed motions, control laws and wind.
        nq: number of coordinates.
        nv: number of velocities.
        friction: frictions that grow with reactions; None for a scene without.
        held_friction: given frictions in place of those; None to solve for them.
    """

    def __init__(self, scene: Scene) -> None:
        """Compile a scene; raises `ModelError` with MuJoCo's reason."""
        self.scene = scene
        self.mechanism = scene.mechanism
        # a ball with a spring, damper or armature must be a joint of MuJoCo's tree, not a `connect` equality
        self.welded = weld_loops(scene.mechanism, loaded=scene.loaded_balls)
        self.tree = self.welded.tree
        self.quaternions = self.tree.quaternions
        self.couplings = TreeCouplings(scene, self.tree)
        self.time = 0.0
        self.layout = Layout(self.tree)
        self.body_id = self.layout.body_id
        self.nq, self.nv = self.tree.nq, self.tree.nv
        try:
            self.model: Any = mujoco.MjModel.from_xml_string(welded_to_xml(scene, self.welded))
        except ValueError as error:
            raise ModelError(scene.name, _reason_of_refusal(self.welded.mechanism, error)) from error
        self.data: Any = mujoco.MjData(self.model)
        self._restore_inertias()
        self._set_ball_spring_rests()
        # joint coordinates that control laws measure: first those of the actuators, one for each law
        self._sensed, actuated_joints = scene.sensed, self.model.actuator_trnid[: len(scene.control), 0]
        other_joints = [
            self.model.joint(coordinate_name(self.mechanism.joint(joint), k)).id
            for joint, k in self._sensed[len(actuated_joints) :]
        ]
        joints = np.array([*actuated_joints, *other_joints], dtype=int)
        self._sensed_q, self._sensed_v = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]
        # site and motors of each wind load; the motors are MuJoCo's last actuators
        loads, motor_count = wind_loads(scene), len(WIND_MOTORS)
        sites = [self.model.site(wind_site(load)).id for load in loads]
        first_motors = range(self.model.nu - motor_count * len(loads), self.model.nu, motor_count)
        self._winds = [
            (site, slice(first, first + motor_count)) for site, first in zip(sites, first_motors, strict=True)
        ]
        # switched forces, and the indices in MuJoCo's qpos and qvel of their coordinates
        self._switched = SwitchedLoads(scene)
        self.held_friction: HeldFriction | None = None
        self.friction = self.engine_friction(scene) if loaded_frictions(scene) else None
        names = [coordinate_name(self.mechanism.joint(joint), k) for joint, k in self._switched.keys]
        switched_joints = np.array([self.model.joint(name).id for name in names], dtype=int)
        self._switched_q = self.model.jnt_qposadr[switched_joints]
        self._switched_v = self.model.jnt_dofadr[switched_joints]
        self.applied_elastic = np.zeros(len(self._switched_v))  # parts of the forces that were last applied
        # inverse dynamics, if a control law uses a model of the mechanism (`roles` lists such laws)
        self._model_control = self.engine_control(scene) if roles(scene) else None
        self.set_controls()

    def _restore_inertias(self) -> None:
        """Restore moments and products of inertia that the MJCF file or MuJoCo's compiler changed."""
        for body, index in zip(self.welded.mechanism.bodies[1:], self.body_id[1:], strict=True):
            axes = rotation(self.model.body_iquat[index])
            self.model.body_inertia[index] = np.diag(axes.T @ body.inertia @ axes)
        # update the constant parts of the mass matrix
        mujoco.mj_setConst(self.model, self.data)
        # otherwise MuJoCo replaces inertial frames that are nearly the body frame, and drops products of
        # inertia
        self.model.body_sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE

    def _set_ball_spring_rests(self) -> None:
        """Set the rest orientations of ball springs to those of the keyframe in the MJCF text.

        MuJoCo's state has the rests of springs with a yield angle (`springyield`) in `plastic`. A rest in
        `model.qpos_spring`, unlike a rest in the state, stays in every later reset of `data`.
        """
        model = self.model
        for joint in np.flatnonzero(model.jnt_plasticadr >= 0):
            qpos_index, plastic_index = model.jnt_qposadr[joint], model.jnt_plasticadr[joint]
            rest = model.key_plastic[0, plastic_index : plastic_index + 4]
            model.qpos_spring[qpos_index : qpos_index + 4] = rest
        mujoco.mj_resetData(model, self.data)

    def mass_properties(self) -> MassProperties:
        """Return masses and inertias of the compiled model at the initial pose (`qpos0`), in the world frame.

        The halves of cut bodies are combined.
        """
        model, data = self.model, self.data
        data.qpos[:] = model.qpos0
        mujoco.mj_kinematics(model, data)
        # start from the declared values, which remain for the ground; overwrite all others by MuJoCo's values
        properties = MassProperties.of(self.mechanism)
        mass, center, inertia = properties.mass, properties.center_of_mass, properties.inertia
        for body in range(1, len(mass)):
            # `origin` has, for each body of the welded mechanism, the body of the scene that it is a part of
            halves = zip(self.body_id, self.welded.origin, strict=True)
            parts = [index for index, whole in halves if whole == body]
            axes = data.ximat[parts].reshape(-1, 3, 3)
            mass[body] = model.body_mass[parts].sum()
            center[body] = np.average(data.xipos[parts], axis=0, weights=model.body_mass[parts])
            inertia[body] = np.einsum("nik,nk,njk->ij", axes, model.body_inertia[parts], axes)
        return MassProperties(mass, center, inertia)

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Return coordinates q (nq,) and velocities v (nv,) of a state."""
        q, v = self.tree.coordinates(self.welded.state(state))
        # poses give angles up to full revolutions; `turned` adds the revolutions that couplings need
        return self.couplings.turned(q, state, self.time), v

    def set_state(self, q: Array, v: Array) -> None:
        """Set MuJoCo's state to q and v at `time`, and the controls of its actuators."""
        self.data.qpos[:] = self.layout.to_qpos @ q
        self.data.qvel[:] = self.layout.to_qvel @ v
        self.data.time = self.time
        self.set_controls()

    def set_controls(self) -> None:
        """Set the controls of MuJoCo's actuators from the scene's control laws at `time`."""
        readings = self.readings(self.data)
        values = controls(self.scene, self.time, readings, self.model_forces(self.data, readings))
        self.data.ctrl[: len(values)] = values

    def engine_control(self, scene: Scene) -> EngineControl:
        """Return the inverse dynamics for control laws that use a model of the mechanism; subclasses define
        it."""
        raise NotImplementedError

    def engine_friction(self, scene: Scene) -> EngineFriction:
        """Return the equations for friction that grows with reactions; subclasses define them."""
        raise NotImplementedError

    def model_forces(self, data: Any, readings: Readings) -> Mapping[Key, float]:
        """Return the part of control forces that laws compute by inverse dynamics, such as the weight.

        Args:
            data: `MjData` with the state.
            readings: measured coordinates and rates, see `readings`.

        Returns:
            Forces, N or N m, by joint coordinate.
        """
        if self._model_control is None:
            return NO_FORCES
        q, v = self.layout.to_qpos.T @ data.qpos, self.layout.to_qvel.T @ data.qvel
        # accelerations that computed-torque laws command, m/s^2 or rad/s^2
        accelerations = commands(self.scene.control, readings, data.time)
        return self._model_control.forces(q, v, data.time, accelerations)

    def set_wind(self, data: Any) -> None:
        """Set the controls of the motors that apply wind, for the poses and velocities in `data`."""
        if not self._winds:
            return
        velocity = np.zeros(6)  # angular, then linear, in the axes of the site
        for load, (site, motors) in zip(wind_loads(self.scene), self._winds, strict=True):
            axes = data.site_xmat[site].reshape(3, 3)
            in_site_axes = 1
            mujoco.mj_objectVelocity(self.model, data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, in_site_axes)
            # normal force, N, and two moments, N m, of the wind relative to the plate's center
            data.ctrl[motors] = wind_on_plate(load, axes.T @ load.velocity(data.time) - velocity[3:])

    def loaded_friction(self, q: Array, v: Array, factor: float = 1.0) -> HeldFriction:
        """Compute the frictions that grow with reactions, N or N m, by identity of the element, at `time`.

        Args:
            q, v: (nq,) and (nv,) tree coordinates and velocities.
            factor: of the load coefficients.
        """
        return self._frictions(q, v, self.time, factor)

    def _frictions(self, q: Array, v: Array, time: float, factor: float = 1.0) -> HeldFriction:
        """Compute the frictions of `loaded_friction` at a time, s."""
        if self.held_friction is not None or self.friction is None:
            return self.held_friction or {}
        rates = (self.layout.to_qvel @ v)[self._switched_v[self._switched.loaded]].tolist()
        return self.friction.forces(self.scene, q, v, time, rates, factor)

    def set_switched_forces(self, data: Any) -> None:
        """Apply switched forces to MuJoCo's joints, for the coordinates and rates in `data`."""
        if len(self._switched_v):
            q, v = self.layout.to_qpos.T @ data.qpos, self.layout.to_qvel.T @ data.qvel
            friction = partial(self._frictions, q, v, data.time)
            x, rates = data.qpos[self._switched_q], data.qvel[self._switched_v]
            forces, self.applied_elastic = self._switched.forces(x, rates, friction)
            data.qfrc_applied[:] = 0.0
            np.add.at(data.qfrc_applied, self._switched_v, forces)

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Return value, m or rad, and rate of each coordinate that control laws measure (`Scene.sensed`)."""
        self.set_state(q, v)
        return list(self.readings(self.data).values())

    def readings(self, data: Any) -> dict[Key, tuple[float, float]]:
        """Return value, m or rad, and rate of each coordinate that control laws measure (`Scene.sensed`).

        Keys are (joint name, index of the coordinate). `data` has the state.
        """
        x, x_rate = data.qpos[self._sensed_q], data.qvel[self._sensed_v]
        return dict(zip(self._sensed, zip(x, x_rate, strict=True), strict=True))

    def compute_kinematics(self, q: Array, v: Array) -> None:
        """Compute positions, velocities and wind of a state in MuJoCo."""
        self.set_state(q, v)
        mujoco.mj_fwdPosition(self.model, self.data)
        mujoco.mj_fwdVelocity(self.model, self.data)
        self.set_wind(self.data)
        self.set_switched_forces(self.data)

    def state(self, q: Array, v: Array) -> State:
        """Return body poses and velocities by MuJoCo's kinematics."""
        self.compute_kinematics(q, v)
        return self.read_state()

    def coupling_phi(self, q: Array) -> Array:
        """Return residuals (c,) of the c couplings at q (nq,) and `time`, m or rad."""
        return self.couplings.phi(q, self.time)

    def observe(self, q: Array, v: Array) -> Observation:
        """Return poses, velocities and energies of a state by MuJoCo."""
        self.compute_kinematics(q, v)
        return self.observation()

    def observation(self) -> Observation:
        """Return poses, velocities and energies of the state in `data`."""
        mujoco.mj_energyPos(self.model, self.data)
        mujoco.mj_energyVel(self.model, self.data)
        potential, kinetic = self.data.energy
        switched_energy = self._switched.energy(self.data.qpos[self._switched_q])
        return Observation(
            state=self.read_state(),
            kinetic_energy=float(kinetic),
            potential_energy=float(potential) + switched_energy,
        )

    def read_state(self) -> State:
        """Return body poses and velocities of the state in `data`."""
        ground = self.mechanism.bodies[0]
        bodies = self.body_id[1 : len(self.mechanism.bodies)]
        linear, angular = np.zeros((2, len(bodies) + 1, 3))
        for k, index in enumerate(bodies, start=1):
            linear[k], angular[k] = body_velocity(self.model, self.data, index)
        return State(
            np.vstack([ground.center_of_mass, self.data.xpos[bodies]]),
            np.vstack([ground.quaternion, self.data.xquat[bodies]]),
            linear,
            angular,
            # hinge angles with their full revolutions, on which couplings and springs depend
            angles=self.couplings.angles(self.layout.to_qpos.T @ self.data.qpos),
        )
