"""Load envelopes for design: ranges of joint and actuator loads over several runs (load cases).

`load_envelope` takes trajectories with reactions, computes loads at all output times, and returns their
smallest and largest values with the time and the load case.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from newton_euler.arguments import checked
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.model.elements import OnCoordinate
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.joint import Joint, perpendicular_pair
from newton_euler.model.joint_parts import are_parallel
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import coordinate_name
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array, Floats

REQUIRED_ARRAYS = ("linear_velocity", "angular_velocity", "reaction_force", "reaction_torque")
"""Attributes of trajectories that loads are computed from."""


class Load(NamedTuple):
    """Identity of a load: name of the joint or joint coordinate, quantity (see `load_envelope`), and unit."""

    element: str
    quantity: str
    unit: str


@dataclass(frozen=True)
class LoadRange:
    """The range of one load over all cases.

    Attributes:
        element: name of the joint, or of the joint coordinate that an actuator acts on.
        quantity: name such as "shear force", see `load_envelope`.
        unit: unit of the values.
        minimum, maximum: smallest and largest value, with signs.
        minimum_time, maximum_time: times, s, at which these values are first reached.
        minimum_case, maximum_case: names of the cases with these values.
        rms: root of the mean square over time, of the case with the largest one.
        rms_case: name of this case.

    Examples:
        >>> scene = load("pendulum")
        >>> shear: LoadRange = load_envelope(scene, {"swing": simulate(scene)}).of("pivot", "shear force")
        >>> print(round(shear.peak, 2), shear.unit, shear.governing)  # the case, and the time in s
        39.24 N ('swing', 2.96)
    """

    element: str
    quantity: str
    unit: str
    minimum: float
    minimum_time: float
    minimum_case: str
    maximum: float
    maximum_time: float
    maximum_case: str
    rms: float
    rms_case: str

    @property
    def peak(self) -> float:
        """The largest magnitude."""
        return max(abs(self.minimum), abs(self.maximum))

    @property
    def governing(self) -> tuple[str, float]:
        """The case and the time, s, of `peak`."""
        if abs(self.minimum) > abs(self.maximum):
            return self.minimum_case, self.minimum_time
        return self.maximum_case, self.maximum_time


@dataclass(frozen=True)
class LoadEnvelope:
    """Ranges of loads over cases; see `load_envelope`.

    Attributes:
        cases: names of the cases.
        joints: ranges of joint loads.
        actuators: ranges of forces, speeds, powers, work and energy of actuators.

    Examples:
        >>> scene = load("pendulum")
        >>> envelope: LoadEnvelope = load_envelope(scene, {"swing": simulate(scene)})
        >>> for each in envelope.joints[:4]:
        ...     print(each.element, each.quantity, round(each.minimum, 2), round(each.maximum, 2), each.unit)
        pivot force x -14.71 14.71 N
        pivot force y 9.81 39.24 N
        pivot force z 0.0 0.0 N
        pivot force 9.81 39.24 N
    """

    cases: tuple[str, ...]
    joints: tuple[LoadRange, ...]
    actuators: tuple[LoadRange, ...]

    def __repr__(self) -> str:
        ranges = len(self.joints) + len(self.actuators)
        return f"<LoadEnvelope of {', '.join(map(str, self.cases))}: {ranges} ranges>"

    @checked
    def of(self, element: str, quantity: str) -> LoadRange:
        """Return the range of a load; raises `UnknownNameError`."""
        ranges = {(each.element, each.quantity): each for each in (*self.joints, *self.actuators)}
        if (element, quantity) not in ranges:
            known = tuple(dict.fromkeys(name for name, _ in ranges))
            if element not in known:
                raise UnknownNameError("joint or actuator", element, known)
            raise UnknownNameError("load", quantity, tuple(q for name, q in ranges if name == element))
        return ranges[element, quantity]

    def to_csv(self) -> str:
        """Return all ranges as CSV: one row each, with the attributes of `LoadRange` as columns."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        names = [field.name for field in fields(LoadRange)]
        writer.writerow(names)
        for each in (*self.joints, *self.actuators):
            writer.writerow([getattr(each, name) for name in names])
        return text.getvalue()


@checked
def load_envelope(scene: Scene, runs: Trajectory | Mapping[str, Trajectory]) -> LoadEnvelope:
    """Compute the ranges of the loads of joints and actuators over runs.

    Loads of a joint are the reactions on its second body, with torques about the joint point. Their names,
    such as `force`, `shear force` and `bending torque`, are the values of `LoadRange.quantity`.

    Values between output times are not examined. Control laws and prescribed motions are actuators. An
    actuator has the name of its joint coordinate, and the loads `actuator force`, `speed`, `power`, `work`
    and `energy`. The force of a control law is not part of a joint's load. The force of a prescribed motion
    is the axial load of its joint, so that joints with axes that are not parallel have no such actuator.

    Args:
        scene: the mechanism and its control laws.
        runs: one trajectory, of newton_euler, MuJoCo, Pinocchio or `rest_case`, or several by names of cases.
            The scenes of the cases have the same bodies, joints and controlled joint coordinates.

    Raises:
        MechanismError: for a run of another mechanism, or one without reactions or velocities.

    Examples:
        >>> calm, storm = (load("tracker_wind", wind="gust", speed=speed) for speed in (0, 20))
        >>> envelope = load_envelope(storm, {"calm": simulate(calm), "storm": simulate(storm)})
        >>> envelope.of("hinge_14", "bending torque").governing[0]
        'storm'
        >>> envelope.of("slide_12", "power").unit
        'W'
    """
    # loads of all cases over time
    cases = {"run": runs} if isinstance(runs, Trajectory) else dict(runs)
    if not cases:
        raise MechanismError("load envelope", "has no cases", "one run or more")
    loads_of_joints: list[dict[Load, Array]] = []
    for name, run in cases.items():
        _check_run(scene, name, run)
        loads_of_joints.append(joint_loads(scene, run))
    loads_of_actuators = [actuator_loads(scene, run) for run in cases.values()]
    # their ranges
    joints = tuple(_range(load, cases, loads_of_joints) for load in loads_of_joints[0])
    actuators = tuple(_range(load, cases, loads_of_actuators) for load in loads_of_actuators[0])
    return LoadEnvelope(tuple(cases), joints, actuators)


def _check_run(scene: Scene, case: str, run: Trajectory) -> None:
    """Raise `MechanismError` for a run of another mechanism, or without the arrays that loads need."""
    where = f"case {case!r}"
    mechanism = scene.mechanism
    if (run.body_names, run.joint_names) != (mechanism.body_names, mechanism.joint_names):
        raise MechanismError(where, "has other bodies or joints", "a run of the scene's mechanism")
    arrays = (*REQUIRED_ARRAYS, "actuator_force") if scene.control else REQUIRED_ARRAYS
    for name in arrays:
        if getattr(run, name) is None:
            raise MechanismError(where, f"has no {name}", "a run of a scene with all outputs")


def joint_loads(scene: Scene, run: Trajectory) -> dict[Load, Array]:
    """Compute the loads (n,) of all joints over a run, see `load_envelope`."""
    loads: dict[Load, Array] = {}
    for joint in scene.mechanism.joints:
        loads |= _loads_of_joint(scene, joint, run)
    return loads


def _loads_of_joint(scene: Scene, joint: Joint, run: Trajectory) -> dict[Load, Array]:
    """Compute the loads (n,) of one joint over a run, see `load_envelope`."""
    assert run.reaction_force is not None
    assert run.reaction_torque is not None
    k = scene.mechanism.joint_index(joint.name)
    axes = _axes(scene, joint, run)
    loads: dict[Load, Array] = {}
    for what, unit, perpendicular, vectors in (
        ("force", "N", "shear force", run.reaction_force[:, k]),
        ("torque", "N m", "bending torque", run.reaction_torque[:, k]),
    ):
        components = dict(zip((f"{what} x", f"{what} y", f"{what} z"), vectors.T, strict=True))
        components[what] = np.linalg.norm(vectors, axis=1)
        if axes is not None:
            u, w, axial = np.einsum("nij,ni->jn", axes, vectors)
            components |= {
                f"axial {what}": axial,
                perpendicular: np.hypot(u, w),
                f"{what} u": u,
                f"{what} w": w,
            }
        loads |= {Load(joint.name, quantity, unit): values for quantity, values in components.items()}
    return loads


def _axes(scene: Scene, joint: Joint, run: Trajectory) -> Floats | None:
    """Return the axes along which loads of a joint are resolved, at all output times.

    Returns:
        (n, 3, 3), with the unit vectors u, w and the axis of the joint as columns, world frame; None for a
        joint without an axis or with axes that are not parallel.
    """
    axes = [motion.axis for motion in joint.motions if motion.kind != "ball"]
    if joint.axis_names == ("axis",):
        axes = [getattr(joint, "axis")]  # noqa: B009 (kinds with one axis)
    if not axes or not all(are_parallel(axes[0], axis) for axis in axes):
        return None
    # columns u, w and axis: world frame at the initial pose, then frame of the first body, then world frame
    first = scene.mechanism.body_index(joint.first)
    initial_axes = np.column_stack([*perpendicular_pair(axes[0]), axes[0]])
    to_body_frame = scene.mechanism.bodies[first].pose.rotation.T
    return np.asarray(rotations(run.quaternion[:, first]) @ to_body_frame @ initial_axes)


def actuator_loads(scene: Scene, run: Trajectory) -> dict[Load, Array]:
    """Compute the loads (n,) of control laws and prescribed motions over a run, see `load_envelope`."""
    forces: list[tuple[OnCoordinate, Array]] = []
    for k, law in enumerate(scene.control):
        assert run.actuator_force is not None
        forces.append((law, run.actuator_force[:, k]))
    for motion in scene.motions:
        what, unit = ("force", "N") if scene.mechanism.is_slide(*motion.key) else ("torque", "N m")
        of_joint = _loads_of_joint(scene, scene.mechanism.joint(motion.joint), run)
        axial = of_joint.get(Load(motion.joint, f"axial {what}", unit))
        if axial is not None:
            forces.append((motion, axial))
    loads: dict[Load, Array] = {}
    for actuator, force in forces:
        joint = scene.mechanism.joint(actuator.joint)
        name, is_slide = coordinate_name(joint, actuator.coordinate), scene.mechanism.is_slide(*actuator.key)
        # a trajectory measures joint coordinates by its mechanism, which a run of another engine may lack
        measured = replace(run, mechanism=scene.mechanism).joint(joint.name)
        assert measured.rates is not None
        speed = measured.rates[:, actuator.coordinate]
        work, energy = work_and_energy(force, measured.coordinates[:, actuator.coordinate])
        for quantity, unit, values in (
            ("actuator force", "N" if is_slide else "N m", force),
            ("speed", "m/s" if is_slide else "rad/s", speed),
            ("power", "W", force * speed),
            ("work", "J", work),
            ("energy", "J", energy),
        ):
            loads[Load(name, quantity, unit)] = values
    return loads


def work_and_energy(force: Array, coordinate: Array) -> tuple[Array, Array]:
    """Compute the work and the energy of an actuator up to each output (n,), J, by the trapezoidal rule.

    The energy is the positive mechanical work. Negative work (braking) is neither recovered nor consumed.

    Args:
        force: (n,) N or N m.
        coordinate: (n,) m or rad.
    """
    work_steps = _trapezoids(force, coordinate)
    energy_steps = np.maximum(work_steps, 0.0)
    work, energy = (np.concatenate([[0.0], np.cumsum(steps)]) for steps in (work_steps, energy_steps))
    return work, energy


def _trapezoids(values: Array, x: Array) -> Array:
    """Compute the integral of values (n,) over each interval of x (n,), by the trapezoidal rule: (n - 1,)."""
    return 0.5 * (values[1:] + values[:-1]) * np.diff(x)


def _range(load: Load, cases: Mapping[str, Trajectory], loads_of_cases: list[dict[Load, Array]]) -> LoadRange:
    """Compute the range of a load over all cases.

    Args:
        load: the load.
        cases: runs by names of cases.
        loads_of_cases: for each case, values (n,) of all loads.
    """
    # smallest and largest value of each case: (value, time, case); mean square of each case
    extremes: list[tuple[float, float, str]] = []
    squares: list[tuple[float, str]] = []
    for (case, run), loads in zip(cases.items(), loads_of_cases, strict=True):
        values = loads[load]
        for k in (int(np.argmin(values)), int(np.argmax(values))):
            extremes.append((float(values[k]), float(run.time[k]), case))
        squares.append((_mean(values**2, run.time), case))
    # of all cases
    mean_square, rms_case = max(squares, key=itemgetter(0))
    minimum, maximum = min(extremes, key=itemgetter(0)), max(extremes, key=itemgetter(0))
    return LoadRange(*load, *minimum, *maximum, float(np.sqrt(mean_square)), rms_case)


def _mean(values: Array, time: Array) -> float:
    """Average values (n,) over time, s, by the trapezoidal rule; a single value is its own average."""
    if len(time) == 1:
        return float(values[0])
    integral = np.cumsum(_trapezoids(values, time))[-1]
    return float(integral / (time[-1] - time[0]))
