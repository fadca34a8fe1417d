"""Poses, energies and accelerations of a system against those of a file's own model.

Accelerations are put into the file's own equations, M a = f + J^T lambda and J a = -dJ/dt v: what is left of
the first along motions that are free in the file, and of the second. No solution of these equations is
compared, so that no decision on a rank is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from newton_euler.equations.dense import least_squares, singular_values
from newton_euler.equations.system import Evaluation
from newton_euler.model.euler_parameters import angle_between
from newton_euler.reading.figure import Figure, figure, worst
from newton_euler.reading.forces import largest, row_figure
from newton_euler.reading.placed import Place, Placed
from newton_euler.reading.quantities import DOUBT, FREE, KINDS
from newton_euler.reading.reference import ROUND_OFF, Sample
from newton_euler.scalars import Array

RATE = 1.0  # rad/s and sizes per s, of the samples' velocities: what mechanisms do at least
LOSS = 100.0  # times as large as round-off accelerations are that went through those of bodies
ROW_LOSS = (
    1000.0  # the same of rows whose bodies have 1e-9 of the inertia of others: an elimination mixes them
)


def system_figures(placed: Placed) -> Iterator[Figure]:
    """Poses, energies and accelerations of a system at the samples."""
    coordinates = [placed.system.coordinates(place.state) for place in placed.places]
    found = [placed.system.evaluate(q, v) for q, v in coordinates]
    reach = placed.reference.size
    reach += max(float(np.max(np.abs(place.state.position))) for place in placed.places)
    yield from _pose_figures(placed, found, reach)
    yield from _energy_figures(placed, found, reach)
    yield from _acceleration_figures(placed, found)


def _pose_figures(placed: Placed, found: Sequence[Evaluation], reach: float) -> Iterator[Figure]:
    shift, turn, speed = [], [], []
    for each, place in zip(found, placed.places, strict=True):
        state, wanted = each.state, place.state
        shift.append(np.linalg.norm(state.position - wanted.position, axis=1) / reach)
        turn.append(angle_between(state.quaternion, wanted.quaternion))
        linear = np.linalg.norm(state.linear_velocity - wanted.linear_velocity, axis=1) / reach
        angular = np.linalg.norm(state.angular_velocity - wanted.angular_velocity, axis=1)
        speed.append(np.maximum(linear, angular))
    limits = np.array([place.sample.tolerance_of_motion for place in placed.places])[:, None]
    names = placed.mechanism.body_names
    yield figure("positions, rel", np.array(shift), limits, names)
    yield figure("orientations, rad", np.array(turn), limits, names)
    yield figure("velocities, rel", np.array(speed), limits, names)


def _energy_figures(placed: Placed, found: Sequence[Evaluation], reach: float) -> Iterator[Figure]:
    """Potential energies are compared less those at the start: files and scenes have different zeros."""
    samples = placed.reference.samples
    wanted = np.array([sample.energies for sample in samples])
    energies = np.array([[each.kinetic_energy, each.potential_energy] for each in found])
    mass = sum(body.mass for body in placed.mechanism.bodies)
    usual = 0.5 * mass * (placed.reference.size * RATE) ** 2
    weight = mass * float(np.linalg.norm(placed.scene.gravity)) * reach
    limits = np.array([sample.tolerance_of_motion for sample in samples])
    names = [f"state {k}" for k in range(len(found))]
    scales = np.max(np.abs([energies, wanted]), axis=(0, 1)) + np.array([usual, usual + weight])
    gaps = energies - wanted
    gaps[:, 1] -= gaps[0, 1]
    for k, quantity in enumerate(("kinetic energy, rel", "potential energy, rel")):
        yield figure(quantity, np.abs(gaps[:, k]) / scales[k], limits, names)


def _acceleration_figures(placed: Placed, found: Sequence[Evaluation]) -> Iterator[Figure]:
    """Accelerations of bodies in the file's own equations of motion and of constraints."""
    reference, across, loops, left, scales = placed.reference, [], [], [], []
    for place, each in zip(placed.places, found, strict=True):
        accelerations = np.hstack([each.linear_acceleration, each.angular_acceleration]).ravel()
        own, strange = _own_acceleration(placed, place, accelerations)
        across.append(strange)
        loops += _loop_figures(place.sample, own, reference.units)
        basis, a = place.sample.freedom.basis, reference.units * own
        mass, forces = np.sum(place.sample.mass_matrices, axis=0), np.array(place.sample.forces)
        push = forces[: len(KINDS)].sum(axis=0) - forces[-1]
        certain = place.sample.freedom.certain
        onto = certain @ np.linalg.pinv(certain)
        left.append(onto.T @ (basis.T @ (mass @ a - push)))
        usual = np.abs(a) + RATE**2 * reference.units  # where nothing pushes, the rest is round-off
        scales.append(np.abs(basis).T @ (np.abs(mass) @ usual + np.abs(forces).sum(axis=0)))
    yield worst(across)
    if loops:
        yield worst(loops)
    # multipliers of rows in doubt are large, and what round-off lets them do to free motions is too
    doubts = [sample.freedom.doubt for sample in reference.samples if sample.freedom.doubt > FREE]
    spread = max((np.finfo(float).eps / (ROUND_OFF * doubt) for doubt in doubts), default=0.0)
    scale = (LOSS + spread) * largest(reference, scales)
    limits = [sample.tolerance_of_motion for sample in reference.samples]
    yield row_figure(reference, "accelerations, as forces, rel", left, scale, limits)


def _own_acceleration(placed: Placed, place: Place, accelerations: Array) -> tuple[Array, Figure]:
    """(nv,) of the file's coordinates, dimensionless, and the part of those of bodies across its joints."""
    rows = place.of_parts / placed.part_units[:, None] * placed.reference.units
    reached, drift = placed.of_parts(accelerations), place.drift / placed.part_units
    own = least_squares(rows, reached - drift)
    scale = max(RATE**2, float(np.max(np.abs([reached, drift]))))
    gaps = np.abs(rows @ own - (reached - drift)).reshape(-1, 6).max(axis=1) / scale
    limit, names = place.sample.tolerance_of_motion, placed.reference.names
    return own, figure("accelerations across joints, rel", gaps, limit, names)


def _loop_figures(sample: Sample, own: Array, units: Array) -> list[Figure]:
    """Rates at which accelerations (nv,) open the file's constraints that hold; none without any.

    Accelerations are known to the round-off of M a = f by component (N. J. Higham, Accuracy and Stability of
    Numerical Algorithms, 2002, section 7.2). This counts for light bodies at the end of a heavy chain.
    """
    _, jacobian, owners = sample.constraints
    if not len(owners):
        return []
    fine, coarse = sample.velocity_products
    scale = float(np.max(np.abs(jacobian))) * max(RATE**2, float(np.max(np.abs(own))))
    # no acceleration changes what lies outside the range of the rows: of those that are redundant, in doubt,
    # of loops that keep an offset, and of those that lose rank in a singular configuration
    u, s, _ = singular_values(jacobian)
    held = u[:, s > DOUBT * max(1.0, float(s[0]))]
    opened, unsure = (held @ (held.T @ each) for each in (jacobian @ own + fine, coarse - fine))
    scale = max(scale, RATE**2)
    mass, forces = np.abs(np.sum(sample.mass_matrices, axis=0)), np.abs(np.array(sample.forces)).sum(axis=0)
    inverse = np.abs(np.linalg.inv(np.sum(sample.mass_matrices, axis=0)))
    unknown = inverse @ (mass @ (units * (np.abs(own) + RATE**2)) + forces) / units
    lost = ROW_LOSS * np.finfo(float).eps * float(np.max(np.abs(jacobian) @ unknown))
    gaps = np.maximum(np.abs(opened) - np.abs(unsure) - lost, 0.0) / scale
    limit = sample.tolerance_of_motion
    return [figure("accelerations across loops, rel", gaps, limit, owners)]
