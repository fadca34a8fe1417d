"""Control laws that use a model of the mechanism: forces of computed torque and of gravity compensation.

Both laws use inverse dynamics of the controller's model
(`newton_euler.equations.formulation.Formulation.servo_forces`). The controller's model is the scene without
control laws and without wind, because a controller cannot know the wind. Its parameters may differ from those
of the scene. Computed torque computes the forces for the accelerations that the law commands. Gravity
compensation computes the forces at rest for zero accelerations. `ModelControl` does this for the equations of
this package, `EngineControl` for other engines, which have their own mass matrices and Jacobians
(`newton_euler.equations.engine_solution.servo_forces`). A key (joint, number) names a joint coordinate.

The equations of this package have two forms (`Formulation`): joint coordinates or the poses of all bodies.
They may be evaluated over floats, or over symbolic scalars when they are traced for compilation.

If constraints are redundant, the equations use independent rows of the constraint Jacobian. A row is
exchangeable if a run may replace it by another one; its flag is 1 while it is left out, else 0
(`newton_euler.equations.row_choice`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from newton_euler.equations.coupling_equations import TreeCouplings
from newton_euler.equations.formulation import Formulation, Servos
from newton_euler.equations.parameter_names import element_of, places
from newton_euler.equations.parameters import check_dynamic, checked, measuring, with_values
from newton_euler.equations.redundancy import inherit_mobility
from newton_euler.equations.row_choice import (
    exchangeable_rows,
    in_use_alone,
    regular_choices,
    rows_in_use,
)
from newton_euler.equations.sparse import solve_constrained
from newton_euler.equations.system import at_time
from newton_euler.errors import MechanismError, SingularityError
from newton_euler.model.control import PD, ComputedTorque, ControlLaw, DeclaredLaw
from newton_euler.model.digital_control import Digital
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.variable import altered
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array, Scalar, Stack


class Roles(NamedTuple):
    """Joint coordinates whose control laws use a model of the mechanism.

    Attributes:
        torque: keys of the coordinates with computed torque.
        holding: keys of the coordinates with gravity compensation.
        model: values, by parameter name, in which the controller's model differs from the scene.
    """

    torque: tuple[Key, ...]
    holding: tuple[Key, ...]
    model: Mapping[str, Any]

    def __bool__(self) -> bool:
        return bool(self.torque or self.holding)


def roles(scene: Scene, digital: bool = False) -> Roles:
    """Find the control laws of a scene that use a model of the mechanism.

    Args:
        scene: the scene with the laws.
        digital: True to find only laws that a computer executes at sampling instants (`Digital`), False to
            find only laws in continuous time.

    Raises:
        MechanismError: for computed-torque laws with different models, because all such laws solve one
            problem together.
    """
    laws: list[DeclaredLaw] = []
    for law in scene.control:
        if isinstance(law, Digital) and digital:
            laws.append(law.law)
        elif isinstance(law, DeclaredLaw) and not digital:
            laws.append(law)
    torque = [law for law in laws if isinstance(law, ComputedTorque)]
    for law in torque[1:]:
        if law.model != torque[0].model:
            problem = (
                f"model is {law.model!r:.100}, and {torque[0].model!r:.100} at joint {torque[0].joint!r}"
            )
            raise MechanismError(law.element, problem, "one model of the mechanism for all laws")
    holding = tuple(law.key for law in laws if isinstance(law, PD) and law.gravity_compensation)
    return Roles(tuple(law.key for law in torque), holding, torque[0].model if torque else {})


def known_scene(scene: Scene, model: Mapping[str, Any]) -> Scene:
    """Return the controller's model: the scene with other parameter values, without wind.

    Args:
        scene: the scene.
        model: values of the model by parameter name.

    Raises:
        NewtonEulerError: for an unknown parameter, a parameter of wind or of a control law, or a value that
            the scene cannot have.
    """
    # the model must have the geometry of the scene, so that both have the same coordinates
    check_dynamic(scene, model, "the model of control laws")
    values = checked(scene, model)
    for name, place in places(scene, model).items():
        element = element_of(scene, place.owner)
        if isinstance(element, WindLoad | ControlLaw):
            problem = f"has {name!r} of {element.element}, which it is without"
            raise MechanismError("model of control laws", problem, "parameters of bodies and other forces")
    given = {name: value if value.ndim else float(value) for name, value in values.items()}
    return without_wind(with_values(scene, given))


def without_wind(scene: Scene) -> Scene:
    """Return a copy of the scene without wind loads, not checked, for equations of motion only."""
    calm = tuple(force for force in scene.forces if not isinstance(force, WindLoad))
    if len(calm) == len(scene.forces):
        return scene
    changed = altered(scene, forces=calm)
    inherit_mobility(changed, scene)  # the copy has the same redundant constraints
    return changed


class ModelControl:
    """Inverse dynamics for the control laws of a form of the equations, in the coordinates of this form.

    Attributes:
        roles: joint coordinates of the laws.
        torque: inverse dynamics data of computed torque; None without such laws.
        holding: inverse dynamics data of gravity compensation; None without such laws.
    """

    def __init__(self, system: Formulation, known: ModelControl | None = None) -> None:
        """Build the controller's model in the form of a system.

        Args:
            system: equations of the scene with the control laws.
            known: the object for the same laws over floats, if the system is evaluated over symbolic scalars.
                Its rank decisions and checks are reused, because they need floats.
        """
        self.roles: Roles = known.roles if known else roles(system.scene)
        # equations of the controller's model for computed torque and for gravity compensation, without
        # stabilization; `measuring` returns a scene whose equations allow forces on the coordinates `keys`
        form: Any = type(system)
        if known:
            scene = without_wind(with_values(system.scene, self.roles.model))
        else:
            scene = known_scene(system.scene, self.roles.model)
        self._moving, self._resting = (
            form(measuring(scene, keys), 0.0) if keys else None
            for keys in (self.roles.torque, self.roles.holding)
        )
        # gravity compensation is at rest: prescribed motions stand still
        if self._resting:
            still = tuple(replace(each, function=None) for each in self._resting.couplings)
            self._resting.couplings = still
        self.torque: Servos | None = known.torque if known else _servos(self._moving, self.roles.torque)
        self.holding: Servos | None = known.holding if known else _servos(self._resting, self.roles.holding)
        # the last state, objects that keep its identities alive, and the forces in this state
        self._last: tuple[Any, Any, dict[Key, Scalar]] = (None, None, {})

    def forces(self, system: Formulation, q: Array, v: Array) -> dict[Key, Scalar]:
        """Compute the forces of the laws, N or N m, by key; the result for the last state is reused.

        Args:
            system: equations of the scene with the control laws.
            q, v: (nq,) and (nv,), the state of the system.

        Raises:
            SingularityError: over floats, at a state where the coordinates do not determine the motion.
        """
        # the bytes of an array of symbolic scalars are the identities of these objects; the copies keep the
        # objects alive, so that no identity is used again
        state = q.dtype, q.tobytes(), v.tobytes(), id(system.time), id(system.scene)
        last = self._last  # other threads may replace it
        if last[0] != state:
            kept_alive = q.copy(), v.copy(), system.time, system.scene
            self._last = last = state, kept_alive, self._forces(system, q, v)
        return last[2]

    def _forces(self, system: Formulation, q: Array, v: Array) -> dict[Key, Scalar]:
        """Compute the forces of the laws, N or N m, by key."""
        readings, time = system.measured(q, v), system.time
        laws = [law for law in system.scene.control if isinstance(law, ComputedTorque)]
        commands = [law.command(law.references(time), readings) for law in laws]
        moving = _solve(system, self._moving, self.torque, q, v, commands)
        no_motion, no_accelerations = np.zeros(len(v)), [0.0] * len(self.roles.holding)
        resting = _solve(system, self._resting, self.holding, q, no_motion, no_accelerations)
        return resting | moving


def _servos(model: Formulation | None, keys: tuple[Key, ...]) -> Servos | None:
    """Return inverse dynamics data for a model with actuators on given coordinates; None without a model."""
    if model is None:
        return None
    return scaled(Servos(coordinates=keys, actuators=keys, rows=rows_in_use(model)), model)


def scaled(servos: Servos, system: Formulation) -> Servos:
    """Return inverse dynamics data for a form of the equations, with reference magnitudes of the pivots.

    The reference magnitude of a pivot is its largest value in the elimination at the states that the mobility
    analysis has examined (`newton_euler.equations.redundancy`). The magnitudes are None if the elimination
    fails at all of these states.

    Args:
        servos: coordinates and actuators.
        system: the form of the equations, which gives the constraint rows in use.
    """
    # rows in use and exchangeable rows; then the pivots at each examined state, for each choice of
    # independent rows, with 0 for the rows that the choice leaves out
    exchangeable = exchangeable_rows(system)
    used, pivots = rows_in_use(system, exchangeable=exchangeable), []
    for state, rows in regular_choices(system, exchangeable=exchangeable):
        q, at_rest = system.coordinates(state)[0], np.zeros(system.nv)
        equations = system.sparse_equations(q, at_rest, rows)
        coordinate_rows, gamma = system.sparse_coordinates(q, at_rest, servos.coordinates)
        all_gamma = np.concatenate([equations.gamma, gamma])
        extended = equations.extended(coordinate_rows, all_gamma, scales=None)
        with suppress(ZeroDivisionError), np.errstate(all="ignore"):
            solution = solve_constrained(extended)
            if solution.pivot_ratio > 0.0:
                pivots.append(in_use_alone(solution.pivots, rows))
    scales = [float(max(column)) or 1.0 for column in zip(*pivots, strict=True)] or None
    return servos._replace(rows=used, scales=scales)


def _solve(
    system: Formulation,
    model: Formulation | None,
    servos: Servos | None,
    q: Array,
    v: Array,
    accelerations: Sequence[Scalar],
) -> dict[Key, Scalar]:
    """Compute the actuator forces that cause given accelerations, N or N m, by key.

    Args:
        system: equations of the scene with the control laws, which give the time and the flags of
            exchangeable rows.
        model: equations of the controller's model; without a model there are no forces.
        servos: coordinates and actuators.
        q: (nq,) coordinates of the system.
        v: (nv,) velocities of the model.
        accelerations: m/s^2 or rad/s^2, one for each coordinate of `servos`.
    """
    if model is None or servos is None:
        return {}
    model = at_time(model, system.time)
    if system.in_use is not None:
        servos = servos.with_flags(system.in_use.flags)
    forces, pivot_ratio = model.servo_forces(model.coordinates_from(system, q), v, servos, accelerations)
    smallest = np.min(pivot_ratio.numbers) if isinstance(pivot_ratio, Stack) else pivot_ratio
    if isinstance(smallest, float) and not smallest > 0.0:
        joint = servos.coordinates[0][0]
        raise SingularityError(joint, "control laws cannot choose the accelerations there")
    return dict(zip(servos.coordinates, forces, strict=True))


def model_control(system: Formulation) -> ModelControl:
    """Return the inverse dynamics for the control laws of a system, built once for all of its copies."""
    if not system.model_control:
        system.model_control.append(ModelControl(system))
    found: ModelControl = system.model_control[0]
    return found


def share_model_control(system: Formulation, floats: Formulation) -> None:
    """Build the inverse dynamics of a system over symbolic scalars from decisions that need floats.

    Such decisions are the choice of constraint rows and the reference magnitudes of pivots.

    Args:
        system: receives the inverse dynamics of its control laws.
        floats: the same equations over floats.
    """
    if roles(floats.scene):
        system.model_control.append(ModelControl(system, model_control(floats)))


class EngineModel(Protocol):
    """Equations of motion of the controller's model in another engine.

    Attributes:
        time: s, of prescribed motions.
        couplings: gears and prescribed motions.
    """

    time: float
    couplings: TreeCouplings

    def servo_forces(self, q: Array, v: Array, keys: Sequence[Key], accelerations: Array) -> Array:
        """Compute the forces on joint coordinates, N or N m, that cause given accelerations of them."""


class EngineControl:
    """Inverse dynamics of the controller's model by the equations of another engine."""

    def __init__(self, scene: Scene, build: Callable[[Scene], EngineModel]) -> None:
        """Build the controller's models for computed torque and for gravity compensation.

        Args:
            scene: the scene with the control laws.
            build: returns the engine's model of a scene.
        """
        self._torque, self._holding, values = roles(scene)
        model_scene = known_scene(scene, values)
        self._moving = build(measuring(model_scene, self._torque)) if self._torque else None
        self._resting = build(measuring(model_scene, self._holding)) if self._holding else None
        # gravity compensation is at rest: prescribed motions stand still
        if self._resting:
            coupled = self._resting.couplings
            coupled.couplings = tuple(replace(each, function=None) for each in coupled.couplings)
        self._last: tuple[Any, Mapping[Key, float]] = None, {}

    def forces(self, q: Array, v: Array, time: float, accelerations: Sequence[float]) -> Mapping[Key, float]:
        """Compute the forces of the laws, N or N m, by key; the result for the last state is reused.

        Args:
            q, v: (nq,) and (nv,) tree coordinates and velocities.
            time: s.
            accelerations: accelerations that the computed-torque laws command, in their order, m/s^2 or
                rad/s^2.
        """
        state = q.tobytes(), v.tobytes(), time, tuple(accelerations)
        if self._last[0] != state:
            found: dict[Key, float] = {}
            if self._resting:
                self._resting.time = time
                no_motion, no_accelerations = np.zeros(len(v)), np.zeros(len(self._holding))
                forces = self._resting.servo_forces(q, no_motion, self._holding, no_accelerations)
                found |= dict(zip(self._holding, forces.tolist(), strict=True))
            if self._moving:
                self._moving.time = time
                forces = self._moving.servo_forces(q, v, self._torque, np.array(accelerations))
                found |= dict(zip(self._torque, forces.tolist(), strict=True))
            self._last = state, found
        return self._last[1]
