"""Coverage: which elements of a scene its run tests, as code coverage does for lines.

Engines that agree on a run tell nothing of what the run does not depend on: the mass of a body in free fall,
a spring that stays at rest, a hinge that does not turn. For each element the motion that a change of 10 %
would make is estimated along the run and held against the tolerance of trajectories:

- what acts as a force (inertia, springs, dampers, rotors, actuators) changes the accelerations that the
  constraints leave free by W (W^T M W)^-1 W^T df, with W a basis of the free velocities and df the change of
  the generalized force (J. Garcia de Jalon, E. Bayo, Kinematic and Dynamic Simulation of Multibody Systems,
  1994, section 5.2); their double integral over time is how far bodies would be from where they are;
- what constrains (axes and points of joints, gears) is opened by the run's own motion as far as that cannot
  happen with the change.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np

from crosscheck.comparison.rows import POSES, Row
from newton_euler.armature import BallArmature
from newton_euler.constraints import Frame
from newton_euler.control import Law, Sampled
from newton_euler.errors import MechanismError
from newton_euler.force_terms import body_wrenches
from newton_euler.forces import BallSpring, Force, JointSpring, Wrench
from newton_euler.joints import Fixed, Joint
from newton_euler.mechanism import Mechanism
from newton_euler.parameters import place_of
from newton_euler.redundancy import rows_left_out, without
from newton_euler.relative import Relative
from newton_euler.sampling import holding
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.solve import orthonormal_null
from newton_euler.state import State
from newton_euler.system import at_time, dimensionless_jacobian
from newton_euler.trajectory import Trajectory

CHANGE = 0.1
"""Relative change of an element; of a joint's axes in rad, of its points in sizes of the longest body."""

SAMPLES = 16
"""Times of the run at which changes are worked out."""


@dataclass(frozen=True)
class Covered:
    """How much of an element shows in a run.

    Attributes:
        element: kind and name, such as "mass of body 'crank'".
        share: change of the motion by a change of 10 %, in units of the tolerance of trajectories.
    """

    element: str
    share: float

    @property
    def tested(self) -> bool:
        """Whether a change of 10 % would be seen."""
        return self.share > 1.0


@dataclass(frozen=True)
class Coverage:
    """Coverage of all elements of a scene."""

    elements: tuple[Covered, ...]

    @cached_property
    def untested(self) -> tuple[Covered, ...]:
        """Elements that a change of 10 % would not show of."""
        return tuple(covered for covered in self.elements if not covered.tested)

    def summary(self) -> list[dict[str, object]]:
        """All elements, for JSON."""
        return [asdict(covered) | {"tested": covered.tested} for covered in self.elements]

    def __str__(self) -> str:
        tested = len(self.elements) - len(self.untested)
        return f"motion covers {tested} of {len(self.elements)} elements"


def coverage(scene: Scene, runs: Mapping[str, Trajectory], rows: Sequence[Row]) -> Coverage | None:
    """Work out what compared runs cover, of the first one, to the least tolerance of trajectories.

    None where no trajectories were compared.
    """
    compared = [row for row in rows if row.level == "trajectories" and not row.informs]
    length, angle = (
        min((row.tolerance for row in compared if row.quantity == quantity), default=None)
        for quantity in POSES
    )
    if length is None or angle is None:
        return None
    return covered_by(scene, next(iter(runs.values())), length, angle)


def covered_by(scene: Scene, run: Trajectory, length: float, angle: float) -> Coverage:
    """Work out the coverage of a run.

    Args:
        scene: what was run.
        run: with velocities.
        length, angle: tolerances of trajectories, m and rad.
    """
    rows = np.unique(np.linspace(0, len(run.time) - 1, SAMPLES).astype(int))
    moments = [_Moment(scene, run, row) for row in rows]
    units = np.tile([length] * 3 + [angle] * 3, len(scene.mechanism.bodies))
    forces = [list(_forces(scene, moment)) for moment in moments]
    names = [name for name, _ in forces[0]]
    changed = np.array(
        [moment.change(np.array([df for _, df in of])) for moment, of in zip(moments, forces, strict=True)]
    )
    moved = _twice_integrated(run.time[rows], changed) / units
    found = [
        Covered(name, float(share)) for name, share in zip(names, np.abs(moved).max(axis=(0, 2)), strict=True)
    ]
    found += [Covered(name, share) for name, share in _constraints(scene, moments, length, angle)]
    return Coverage(tuple(found))


class _Moment:
    """A time of a run: what bodies do then, and how they answer to generalized forces."""

    def __init__(self, scene: Scene, run: Trajectory, row: int) -> None:
        assert run.linear_velocity is not None
        assert run.angular_velocity is not None
        self.state = State(
            run.position[row], run.quaternion[row], run.linear_velocity[row], run.angular_velocity[row]
        )
        system = at_time(Relative(scene), float(run.time[row]))
        if scene.sampled and run.actuator_force is not None:
            laws = zip(scene.control, run.actuator_force[row], strict=True)
            held = {f"{place_of(law)}.held": float(u) for law, u in laws if isinstance(law, Sampled)}
            system = holding(system, held)
        q, v = system.coordinates(self.state)
        self.system, self.links = system, system.links(q, v)
        self.measured = system.measured(q, v, self.links)
        acceleration = system.acceleration(q, v)
        mass, _ = system.mass_and_force(q, v, self.links)
        jacobian = without(dimensionless_jacobian(system, q), rows_left_out(system))
        free = system.velocity_units[:, None] * orthonormal_null(jacobian)
        self._free, self._inertia = free, free.T @ mass @ free
        self.motions = system.velocity_transformation(q).reshape(-1, 6, system.nv)
        self.linear = np.array([k.acceleration + k.linear @ acceleration[k.path] for k in self.links])
        self.angular = np.array(
            [k.angular_acceleration + k.angular @ acceleration[k.path] for k in self.links]
        )
        self.acceleration = acceleration
        self.rotors = list(system.rotor_terms(q, v, self.links))

    def change(self, forces: Array) -> Array:
        """(n, 6 b) change of the bodies' accelerations by changes (n, nv) of the generalized force."""
        answer = self._free @ np.linalg.solve(self._inertia, self._free.T @ forces.T)
        return (self.motions.reshape(-1, self.system.nv) @ answer).T

    def frames(self) -> list[Frame]:
        return [link.frame for link in self.links]


def _twice_integrated(time: Array, rates: Array) -> Array:
    """The double integral (n, ...) over time (n,) of rates (n, ...), from rest."""
    steps = np.diff(time).reshape(-1, *([1] * (rates.ndim - 1)))
    once, twice = np.zeros_like(rates), np.zeros_like(rates)
    once[1:] = np.cumsum(0.5 * steps * (rates[1:] + rates[:-1]), axis=0)
    twice[1:] = np.cumsum(0.5 * steps * (once[1:] + once[:-1]), axis=0)
    return twice


def _forces(scene: Scene, moment: _Moment) -> Iterator[tuple[str, Array]]:
    """Names of elements that act as forces, and changes (nv,) of the generalized force."""
    system, links = moment.system, moment.links
    for k, body in enumerate(scene.mechanism.bodies[1:], start=1):
        inertia, omega = system.world_inertia(k, links[k]), links[k].frame.angular_velocity
        force = body.mass * (moment.linear[k] - scene.gravity)
        torque = inertia @ moment.angular[k] + np.cross(omega, inertia @ omega)
        yield f"mass of body {body.name!r}", -CHANGE * (force @ moment.motions[k, :3])
        yield f"inertia of body {body.name!r}", -CHANGE * (torque @ moment.motions[k, 3:])
    for law in system.scene.control:
        yield f"actuator of joint {law.joint!r}", CHANGE * _along(moment, law)
    for force in scene.forces:
        for what, part in _parts(force):
            yield f"{what} {_where(force)}", CHANGE * _pushed(scene, moment, part)
    number = 0
    for armature in scene.armatures:
        total = np.zeros(system.nv)
        for _ in range(3 if isinstance(armature, BallArmature) else 1):
            inertia, row, gamma = moment.rotors[number]
            number += 1
            rate = sum(x * moment.acceleration[k] for k, x in row.items()) - gamma
            for k, x in row.items():
                total[k] -= CHANGE * inertia * rate * x
        yield f"rotor of joint {armature.joint!r}", total


def _where(force: Force) -> str:
    if isinstance(force, JointSpring | BallSpring):
        return f"of joint {force.joint!r}"
    return repr(force.name)


def _parts(force: Force) -> Iterator[tuple[str, Force]]:
    """A spring and a damper apart."""
    if isinstance(force, Wrench):
        yield "wrench", force
        return
    if force.stiffness:
        yield "spring", replace(force, damping=0.0)
    if force.damping:
        yield "damper", replace(force, stiffness=0.0)


def _along(moment: _Moment, law: Law | JointSpring) -> Array:
    """(nv,) force on a joint coordinate."""
    seen, force = moment.measured[law.joint, law.coordinate], np.zeros(moment.system.nv)
    for k, x in seen.jacobian.items():
        force[k] += x * law.force(seen.x, seen.rate, moment.system.time)
    return force


def _pushed(scene: Scene, moment: _Moment, force: Force) -> Array:
    """(nv,) of one force of a scene."""
    if isinstance(force, JointSpring):
        return _along(moment, force)
    alone = copy.copy(scene)
    object.__setattr__(alone, "forces", (force,))
    wrenches = body_wrenches(alone, moment.system.tree.poses, moment.frames())
    return np.einsum("bi,bin->n", np.array(wrenches), moment.motions)


def _constraints(
    scene: Scene, moments: Sequence[_Moment], length: float, angle: float
) -> Iterator[tuple[str, float]]:
    """Names of elements that constrain, and how far the run opens them if they are changed, in tolerances."""
    mechanism = scene.mechanism
    tree = {kept.joint for kept in moments[0].system.tree.joints}
    states = [moment.state.frames() for moment in moments]
    for number, joint in enumerate(mechanism.joints):
        changes = list(_moved(joint, CHANGE * mechanism.longest))
        if isinstance(joint, Fixed) or not mechanism.equations[number].count:
            continue  # where two bodies are one, another point or axis changes nothing
        opened = max(_opened(mechanism, number, changed, states, length, angle) for changed in changes)
        yield f"{'joint' if number in tree else 'loop'} {joint.name!r}", opened
    for coupling in mechanism.couplings:
        (first, own), *others = coupling.factors().items()
        kinds = mechanism.joints[mechanism.joint_index(first[0])].coordinate_kinds
        unit = length if kinds[first[1]] == "slide" else angle
        opened = max(
            abs(factor / own) * float(np.ptp([float(moment.measured[key].x) for moment in moments]))
            for key, factor in others
        )
        yield f"{coupling.kind} {coupling.name!r}", CHANGE * opened / unit


def _moved(joint: Joint, distance: float) -> Iterator[Joint]:
    """A joint with each of its axes tilted and its point moved, both ways that differ."""
    for name in joint.axis_names:
        axis = getattr(joint, name)
        for tilt in np.eye(3):
            with suppress(MechanismError):  # of two axes that have to stay perpendicular
                yield replace(joint, **{name: axis + CHANGE * np.cross(axis, tilt)})
    for step in distance * np.eye(3):
        yield replace(joint, point=joint.point + step, point_on_second=joint.reaction_point + step)


def _opened(
    mechanism: Mechanism,
    number: int,
    changed: Joint,
    states: Sequence[Sequence[Frame]],
    length: float,
    angle: float,
) -> float:
    """How far states open a changed joint, in tolerances, less what they do where they begin."""
    own = mechanism.equations[number]
    poses = [mechanism.bodies[k].pose for k in (own.first, own.second)]
    equations = changed.attach(own.first, poses[0], own.second, poses[1])
    phi = np.array([equations.phi(frames[own.first], frames[own.second]) for frames in states])
    return float(np.max(np.abs(phi - phi[0]) / np.where(equations.is_length, length, angle), initial=0.0))
