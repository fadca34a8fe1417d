"""The controller's model of a mechanism in native code, for computers.

Encoders tell the pose: actuated coordinates and their rates, by forward kinematics from the pose before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from newton_euler.analysis.inverse_dynamics import InverseDynamics
from newton_euler.assemble import initial_state, measured_coordinate
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.model_control import Roles, known_scene, roles
from newton_euler.equations.parameters import PIECE, numbered, pieces
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import MechanismError, SingularityError
from newton_euler.integrators.compiled import Code
from newton_euler.integrators.run import Projection
from newton_euler.model.control import Readings
from newton_euler.model.joint import Key
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.splines import Spline
from newton_euler.scalars import Array

KEPT = 8  # scenes, most recently used, whose code stays in memory


class ControllerModel:
    """Inverse dynamics of the laws of a scene's computers that know the mechanism, in one run.

    Attributes:
        roles: of the laws.
        encoders: forward kinematics of the coordinates of all control laws.
    """

    def __init__(self, scene: Scene) -> None:
        """Compile.

        Raises:
            MechanismError: naming a coordinate that its law cannot give any acceleration, and for encoders
                that do not determine the pose.
        """
        self.roles, self._models, code = _compiled(scene)
        if code is None:
            problem = "coordinates of control laws do not determine its pose, which encoders are to tell"
            needed = "as many independent ones as degrees of freedom"
            raise MechanismError(f"scene {scene.name!r}", problem, needed)
        self.encoders = Encoders(code, scene)

    def forces(self, readings: Readings, accelerations: Sequence[float], time: float) -> dict[Key, float]:
        """Compute forces (N or N m) by coordinates.

        Args:
            readings: of encoders.
            accelerations: that laws of computed torque command, in order.
            time: s.

        Raises:
            MechanismError: for readings that no pose has.
            SingularityError: where the coordinates do not determine the motion.
        """
        found: dict[Key, float] = {}
        own_q, own_v = self.encoders.coordinates(readings, time)
        wanted = accelerations, [0.0] * len(self.roles.holding)
        for model, own_wanted, moves in zip(self._models, wanted, (1.0, 0.0), strict=True):
            if model is None:
                continue
            q = model.system.coordinates_from(self.encoders.system, own_q)
            knots = pieces(model.scene, time).values()
            values = model.forces(np.concatenate([q, moves * own_v, own_wanted, [time], *knots]))
            keys = model.servos.actuators
            if not (values[-2] > 0.0 and np.isfinite(values[:-2]).all()):
                raise SingularityError(keys[0][0], "control laws cannot choose the accelerations there")
            found = dict(zip(keys, values[:-2].tolist(), strict=True)) | found
        return found


@lru_cache(maxsize=KEPT)
def _compiled(
    scene: Scene,
) -> tuple[Roles, tuple[InverseDynamics | None, InverseDynamics | None], Code | None]:
    """Return roles, inverse dynamics of computed torque and of holding, and what encoders move."""
    found = roles(scene, digital=True)
    known = known_scene(scene, found.model)
    still = tuple(motion.held() for motion in scene.motions)
    torque, holding = (
        InverseDynamics(each, keys, keys) if keys else None
        for each, keys in ((known, found.torque), (replace(known, motions=still), found.holding))
    )
    return found, (torque, holding), _driven(known)


def _driven(scene: Scene) -> Code | None:
    """Return code of the mechanism with a motion of each coordinate of the control laws; None if it is loose.

    The motions' numbers are inputs: the first two are the coordinate and its rate.
    """
    keys = [law.key for law in scene.control]
    if len(keys) != mobility(scene).degrees_of_freedom:
        return None
    at = [measured_coordinate(scene, initial_state(scene), key)[0] for key in keys]
    functions = [Spline((0.0, scene.duration), (x, x)) for x in at]
    motions = [PrescribedMotion(joint, f, k) for (joint, k), f in zip(keys, functions, strict=True)]
    bare = replace(scene, control=(), forces=(), armatures=(), outputs=frozenset())
    driven = replace(bare, motions=(*scene.motions, *motions))
    return Code(driven, "relative") if mobility(driven).degrees_of_freedom == 0 else None


class Encoders:
    """Forward kinematics of readings in one run, each from the pose before.

    Attributes:
        system: whose coordinates are found.
    """

    def __init__(self, code: Code, scene: Scene) -> None:
        """Begin at the start of the scene, whose coordinates the last motions in the code move."""
        keys = [law.key for law in scene.control]
        self.system: Formulation = code.system
        self._code, self._project = code, Projection(code)
        self._x = code.packed(*code.system.coordinates(initial_state(scene)))
        first = len(code.scene.motions) - len(keys)
        names = [numbered("motions", first + k, "function") + PIECE for k in range(len(keys))]
        self._places = {key: code.place(name) for key, name in zip(keys, names, strict=True)}
        self._others = [name for name in code.parameters if name not in names]

    def coordinates(self, readings: Readings, time: float) -> tuple[Array, Array]:
        """Return q (nq,) and v (nv,) of the pose with these coordinates and rates, at a time in s.

        Raises:
            MechanismError: if there is none near the pose before.
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
            raise MechanismError("encoders", f"no pose is near with {read}", "coordinates within reach")
        return x[:nq], x[nq : code.size]
