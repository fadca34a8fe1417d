"""Sampled controllers of a run, and the model of the mechanism that digital control laws compute with.

At each sampling instant a controller gets the readings of its sensors and returns a force, which acts until
the next instant. A digital law with computed torque or gravity compensation knows the mechanism: encoders
give the actuated coordinates and their rates, forward kinematics finds the pose from the pose at the previous
instant, and inverse dynamics gives the forces.
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
from newton_euler.equations.parameters import PIECE, pieces
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
    """The sampled controllers of a scene in one run, with their memories."""

    def __init__(self, scene: Scene) -> None:
        model = ControllerModel(scene).forces if roles(scene, digital=True) else None
        self._controllers = {law.key: law.controller_of(scene.control, model) for law in scene.sampled}

    def sample(self, due: tuple[HeldLaw, ...], time: float, readings: Array) -> dict[str, float]:
        """Call controllers; return their forces, N or N m, by the names of `equations.parameters`.

        Args:
            due: control laws whose controllers are called.
            time: s.
            readings: (s, 2) coordinates of `Scene.sensed`, m or rad, and their rates.

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
    return " ".join(text.split())


class ControllerModel:
    """Inverse dynamics of the digital control laws that know the mechanism, in one run.

    Attributes:
        roles: the coordinates of these control laws.
        encoders: forward kinematics of the coordinates of all control laws.
    """

    def __init__(self, scene: Scene) -> None:
        """Compile.

        Raises:
            MechanismError: naming a coordinate to which its control law cannot give any acceleration, or the
                scene if the coordinates of its control laws do not determine the pose.
        """
        self.roles, self._models, compiled = _compiled(scene)
        if compiled is None:
            freedoms = mobility(scene).degrees_of_freedom
            problem = "coordinates of control laws do not determine the pose"
            needed = f"control laws of {freedoms} independent coordinates, one for each degree of freedom"
            raise MechanismError(f"scene {scene.name!r}", problem, needed)
        self.encoders = Encoders(*compiled, scene)

    def forces(self, readings: Readings, accelerations: Sequence[float], time: float) -> dict[Key, float]:
        """Compute the forces of the control laws, N or N m, by joint coordinate.

        Args:
            readings: of encoders.
            accelerations: commands of the computed-torque laws, in their order.
            time: s.

        Raises:
            MechanismError: for readings that no pose has.
            SingularityError: if the coordinates do not determine the motion at this pose.
        """
        found: dict[Key, float] = {}
        own_q, own_v = self.encoders.coordinates(readings, time)
        wanted = accelerations, [0.0] * len(self.roles.holding)
        for model, own_wanted, moves in zip(self._models, wanted, (1.0, 0.0), strict=True):
            if model is None:
                continue
            q = model.system.coordinates_from(self.encoders.system, own_q)
            knots = pieces(model.scene, time).values()
            flags = model.flags(q[None])[0]
            values = model.forces(np.concatenate([q, moves * own_v, flags, own_wanted, [time], *knots]))
            keys = model.servos.actuators
            if not (values[-2] > 0.0 and np.isfinite(values[:-2]).all()):
                raise SingularityError(keys[0][0], "control laws cannot choose the accelerations there")
            found = dict(zip(keys, values[:-2].tolist(), strict=True)) | found
        return found


@lru_cache(maxsize=CACHED_SCENES)
def _compiled(
    scene: Scene,
) -> tuple[
    Roles,
    tuple[InverseDynamics | None, InverseDynamics | None],
    tuple[CompiledEquations, DrivenMechanism] | None,
]:
    """Compile the models of a scene's digital control laws.

    Returns:
        Coordinates of the laws; inverse dynamics of computed torque and of gravity compensation; the
        mechanism driven at the coordinates of all control laws, None if they do not determine its pose.
    """
    found = roles(scene, digital=True)
    known = known_scene(scene, found.model)
    still = tuple(motion.held() for motion in scene.motions)
    torque, holding = (
        InverseDynamics(each, keys, keys) if keys else None
        for each, keys in ((known, found.torque), (replace(known, motions=still), found.holding))
    )
    return found, (torque, holding), _driven(known)


def _driven(scene: Scene) -> tuple[CompiledEquations, DrivenMechanism] | None:
    """Drive the coordinates of all control laws by splines; None if they do not determine the pose."""
    keys = [law.key for law in scene.control]
    if len(keys) != mobility(scene).degrees_of_freedom:
        return None
    start = initial_state(scene)
    at = {key: measured_coordinate(scene, start, key)[0] for key in keys}
    found = driven(scene, {key: Spline((0.0, scene.duration), (x, x)) for key, x in at.items()})
    return (
        (CompiledEquations(found.scene, "relative"), found)
        if mobility(found.scene).degrees_of_freedom == 0
        else None
    )


class Encoders:
    """Forward kinematics of encoder readings in one run, each solved from the pose before.

    Attributes:
        system: equations whose coordinates are found.
    """

    def __init__(self, code: CompiledEquations, mechanism: DrivenMechanism, scene: Scene) -> None:
        """Begin at the start of a scene.

        Args:
            code: compiled equations of the driven mechanism.
            mechanism: the mechanism driven at the coordinates of the scene's control laws.
            scene: gives the start.
        """
        self.system: Formulation = code.system
        self._code, self._project = code, Projection(code)
        self._x = code.packed(*code.system.coordinates(initial_state(scene)))
        names = {key: name + PIECE for key, name in mechanism.functions.items()}
        self._places = {key: code.place(name) for key, name in names.items()}
        self._others = [name for name in code.parameters if name not in names.values()]

    def coordinates(self, readings: Readings, time: float) -> tuple[Array, Array]:
        """Find q (nq,) and v (nv,) of the pose with these coordinates and rates at a time, s.

        Raises:
            MechanismError: if no pose near the one before has these coordinates.
        """
        x, code, nq = self._x, self._code, self.system.nq
        x[code.size] = time
        if self._others:
            values = pieces(code.scene, time)
            for name in self._others:
                x[code.place(name) :][: len(values[name])] = values[name]
        for key, place in self._places.items():
            angle, rate = readings[key][:2]
            x[place : place + 3] = time, angle, rate
        if not self._project(x):
            read = ", ".join(f"{key[0]} {float(readings[key][0]):.6g}" for key in self._places)
            raise MechanismError("encoders", f"read {read}, with no pose nearby", "coordinates within reach")
        return x[:nq], x[nq : code.size]
