"""Sampled controllers of a run, and the mechanism model of digital computed-torque control.

At each sampling instant a controller gets the readings of its sensors and returns a force. This held force
acts until the next instant. A digital law with computed torque or gravity compensation uses a model of the
mechanism.
Encoders give the actuated joint coordinates and their rates. Forward kinematics finds the pose, starting from
the pose at the previous instant. Inverse dynamics then gives the forces. A key (joint, number) names a joint
coordinate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from newton_euler.compiled.equations import CACHED_SCENES, CompiledEquations
from newton_euler.compiled.inverse_dynamics import InverseDynamics
from newton_euler.compiled.run import Projection
from newton_euler.equations.driven import DrivenMechanism, driven
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.model_control import Roles, known_scene, roles
from newton_euler.equations.parameter_names import PIECE
from newton_euler.equations.parameters import pieces
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import MechanismError, SingularityError, is_finite_number
from newton_euler.model.control import Readings
from newton_euler.model.digital_control import HeldLaw
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.splines import Spline
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.assemble import initial_state, measured_coordinate
from newton_euler.scalars import Array


class Controllers:
    """The sampled controllers of a scene in one run, with their internal states."""

    def __init__(self, scene: Scene) -> None:
        """Create the controllers, and the model of the mechanism if one of them needs it."""
        model = ControllerModel(scene).forces if roles(scene, digital=True) else None
        self._controllers = {law.key: law.controller_of(scene.control, model) for law in scene.sampled}

    def sample(self, due: tuple[HeldLaw, ...], time: float, readings: Array) -> dict[str, float]:
        """Call controllers at a sampling instant.

        Args:
            due: control laws whose controllers are called.
            time: s.
            readings: (s, 2) joint coordinates of `Scene.sensed`, m or rad, and their rates.

        Returns:
            Forces, N or N m, by the parameter names of held forces, such as `crank.held`.

        Raises:
            IntegrationError: if a controller fails or does not return a finite number; names its joint.
        """
        forces = {}
        for law in due:
            try:
                force = self._controllers[law.key](time, *readings.T.copy())
            except Exception as error:
                reason = f"controller of joint {law.joint!r} failed: {type(error).__name__}: {error}"
                raise IntegrationError(time, _one_line(reason)) from error
            if not is_finite_number(force):
                reason = f"controller of joint {law.joint!r} returned {force!r:.200}"
                raise IntegrationError(time, _one_line(reason))
            forces[f"{law.prefix}.held"] = float(force)
        return forces


def _one_line(text: str) -> str:
    """Replace line breaks and repeated spaces in an error message of a user's controller by single spaces."""
    return " ".join(text.split())


class ControllerModel:
    """Inverse dynamics for digital control laws that use a model of the mechanism, in one run.

    Attributes:
        roles: joint coordinates of these control laws: `torque` under computed torque, `holding` under
            gravity compensation.
        encoders: forward kinematics from the joint coordinates of all control laws.
    """

    def __init__(self, scene: Scene) -> None:
        """Compile the inverse dynamics and the forward kinematics.

        Raises:
            MechanismError: naming a coordinate to which its control law cannot give any acceleration; or
                naming the scene, if the coordinates of its control laws do not determine the pose.
        """
        self.roles, self._models, compiled = _compiled(scene)
        if compiled is None:
            freedoms = mobility(scene).degrees_of_freedom
            problem = "coordinates of control laws do not determine the pose"
            needed = f"control laws of {freedoms} independent coordinates, one for each degree of freedom"
            raise MechanismError(f"scene {scene.name!r}", problem, needed)
        self.encoders = Encoders(*compiled, scene)

    def forces(self, readings: Readings, accelerations: Sequence[float], time: float) -> dict[Key, float]:
        """Compute the forces of the control laws, N or N m, by key.

        Args:
            readings: encoder readings by key.
            accelerations: accelerations that the computed-torque laws command, in their order, m/s^2 or
                rad/s^2.
            time: s.

        Raises:
            MechanismError: for readings without a matching pose.
            SingularityError: if the coordinates do not determine the motion at this pose.
        """
        forces_by_key: dict[Key, float] = {}
        encoder_q, v = self.encoders.coordinates(readings, time)
        # computed torque at the measured velocities, then gravity compensation at rest (zero velocities and
        # accelerations)
        both_keys = self.roles.torque, self.roles.holding
        desired = accelerations, [0.0] * len(self.roles.holding)
        cases = zip(self._models, both_keys, desired, (1.0, 0.0), strict=True)
        for model, keys, model_accelerations, speed_factor in cases:
            if model is None:
                continue
            # inputs of the native function, see `InverseDynamics.forces`
            q = model.system.coordinates_from(self.encoders.system, encoder_q)
            flags = model.flags(q[None])[0]  # 1 for a redundant constraint row that is left out, else 0
            functions = pieces(model.scene, time).values()
            x = np.concatenate([q, speed_factor * v, flags, model_accelerations, [time], *functions])
            # the pivot ratio of the elimination is at most 0 if the coordinates do not determine the motion
            *model_forces, pivot_ratio, _squared_loop_error = model.forces(x).tolist()
            if not (pivot_ratio > 0.0 and np.isfinite(model_forces).all()):
                raise SingularityError(keys[0][0], "control laws cannot choose the accelerations there")
            forces_by_key = dict(zip(keys, model_forces, strict=True)) | forces_by_key
        return forces_by_key


@lru_cache(maxsize=CACHED_SCENES)
def _compiled(
    scene: Scene,
) -> tuple[
    Roles,
    tuple[InverseDynamics | None, InverseDynamics | None],
    tuple[CompiledEquations, DrivenMechanism] | None,
]:
    """Compile the models of a scene's digital control laws; results of recent scenes are kept.

    Returns:
        Joint coordinates of the laws; inverse dynamics of computed torque and of gravity compensation, None
        if no law needs it; forward kinematics, None if the coordinates do not determine the pose.
    """
    law_roles = roles(scene, digital=True)
    model_scene = known_scene(scene, law_roles.model)  # without wind, with the laws' own parameter values
    # gravity compensation computes the forces at rest, with prescribed motions that stand still
    scene_at_rest = replace(model_scene, motions=tuple(motion.held_at_start() for motion in scene.motions))
    torque, holding = (
        InverseDynamics(each, coordinates=keys, actuators=keys) if keys else None
        for each, keys in ((model_scene, law_roles.torque), (scene_at_rest, law_roles.holding))
    )
    return law_roles, (torque, holding), _forward_kinematics(model_scene)


def _forward_kinematics(scene: Scene) -> tuple[CompiledEquations, DrivenMechanism] | None:
    """Build the forward kinematics: a mechanism whose controlled joint coordinates follow splines.

    Encoder readings later replace the numbers of the splines. The result is None if the coordinates do not
    determine the pose.
    """
    keys = [law.key for law in scene.control]
    if len(keys) != mobility(scene).degrees_of_freedom:
        return None
    # driving constraints hold the coordinates at their initial values until readings replace these
    start = initial_state(scene)
    values = {key: measured_coordinate(scene, start, key)[0] for key in keys}
    mechanism = driven(scene, {key: Spline((0.0, scene.duration), (x, x)) for key, x in values.items()})
    if mobility(mechanism.scene).degrees_of_freedom > 0:
        return None
    return CompiledEquations(mechanism.scene, "relative"), mechanism


class Encoders:
    """Forward kinematics of encoder readings in one run, each solved from the pose before.

    Attributes:
        system: equations that define the coordinates q and v of the pose.
    """

    def __init__(self, code: CompiledEquations, mechanism: DrivenMechanism, scene: Scene) -> None:
        """Set the pose to the initial state of a scene.

        Args:
            code: compiled equations of the driven mechanism.
            mechanism: the mechanism whose controlled joint coordinates follow splines.
            scene: gives the initial state.
        """
        self.system: Formulation = code.system
        self._code, self._project = code, Projection(code)
        self._x = code.packed(*code.system.coordinates(initial_state(scene)))
        # parameters of the code: the current polynomial piece of each spline, at index `_places` of x, and of
        # prescribed motions
        names = {key: name + PIECE for key, name in mechanism.function_names.items()}
        self._places = {key: code.place(name) for key, name in names.items()}
        self._others = [name for name in code.parameters if name not in names.values()]

    def coordinates(self, readings: Readings, time: float) -> tuple[Array, Array]:
        """Find q (nq,) and v (nv,) of the pose that matches encoder readings.

        Args:
            readings: joint coordinate, m or rad, and rate, by key.
            time: s.

        Raises:
            MechanismError: if no pose near the previous one matches the readings.
        """
        x, code, nq = self._x, self._code, self.system.nq
        x[code.size] = time
        # other parameters: polynomial pieces of prescribed motions at this time
        if self._others:
            values = pieces(code.scene, time)
            for name in self._others:
                x[code.place(name) :][: len(values[name])] = values[name]
        # the polynomial piece of a driving spline: a straight line from this time, with value and slope
        for key, place in self._places.items():
            angle, rate = readings[key][:2]
            x[place : place + 3] = time, angle, rate
        if not self._project(x):
            read = ", ".join(f"{key[0]} {float(readings[key][0]):.6g}" for key in self._places)
            raise MechanismError("encoders", f"read {read}, with no pose nearby", "coordinates within reach")
        return x[:nq], x[nq : code.size]
