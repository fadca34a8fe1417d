"""Compare poses, energies and accelerations of equations of motion with the file's reference model.

Accelerations are substituted into the equations of the reference model, M a = f + J^T lambda and
J a = -dJ/dt v. The checks are the residual of the first equation along the free motions of the file, and the
residual of the second equation. Solutions of the two models are not compared, because a solution depends on a
decision on the rank of J.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from newton_euler.equations.dense import least_squares, singular_values
from newton_euler.equations.system import Evaluation
from newton_euler.model.euler_parameters import angle_between
from newton_euler.reading.checks import ReadingCheck, closest_to_failing, worst_entry
from newton_euler.reading.forces import row_check, row_scales
from newton_euler.reading.placement import SamplePlacement, ScenePlacement
from newton_euler.reading.quantities import FORCE_KINDS, FREE_SINGULAR_VALUE, HELD_SINGULAR_VALUE
from newton_euler.reading.reference import READING_ROUND_OFF, Sample
from newton_euler.scalars import Array

SAMPLE_RATE = 1.0
"""Typical speed of the samples, rad/s and sizes/s: the smallest scale of rates."""

ACCELERATION_LOSS = 100.0
"""Error of accelerations that are computed from accelerations of bodies, as a multiple of round-off."""

LIGHT_BODY_LOSS = 1000.0
"""Error of accelerations, as a multiple of round-off, if inertias of bodies differ by a factor of 1e9."""


def system_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check poses, energies and accelerations of equations of motion at the samples."""
    coordinates = [placed.system.coordinates(place.state) for place in placed.places]
    found = [placed.system.evaluate(q, v) for q, v in coordinates]
    reach = placed.reference.size
    reach += max(float(np.max(np.abs(place.state.position))) for place in placed.places)
    yield from _pose_checks(placed, found, reach)
    yield from _energy_checks(placed, found, reach)
    yield from _acceleration_checks(placed, found)


def _pose_checks(placed: ScenePlacement, found: Sequence[Evaluation], reach: float) -> Iterator[ReadingCheck]:
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
    yield worst_entry("positions, rel", np.array(shift), limits, names)
    yield worst_entry("orientations, rad", np.array(turn), limits, names)
    yield worst_entry("velocities, rel", np.array(speed), limits, names)


def _energy_checks(
    placed: ScenePlacement, found: Sequence[Evaluation], reach: float
) -> Iterator[ReadingCheck]:
    """Check kinetic energies, and potential energies relative to the start.

    Files and scenes have different zeros of the potential energy.
    """
    samples = placed.reference.samples
    wanted = np.array([sample.energies for sample in samples])
    energies = np.array([[each.kinetic_energy, each.potential_energy] for each in found])
    mass = sum(body.mass for body in placed.mechanism.bodies)
    usual = 0.5 * mass * (placed.reference.size * SAMPLE_RATE) ** 2
    weight = mass * float(np.linalg.norm(placed.scene.gravity)) * reach
    limits = np.array([sample.tolerance_of_motion for sample in samples])
    names = [f"state {k}" for k in range(len(found))]
    scales = np.max(np.abs([energies, wanted]), axis=(0, 1)) + np.array([usual, usual + weight])
    gaps = energies - wanted
    gaps[:, 1] -= gaps[0, 1]
    for k, quantity in enumerate(("kinetic energy, rel", "potential energy, rel")):
        yield worst_entry(quantity, np.abs(gaps[:, k]) / scales[k], limits, names)


def _acceleration_checks(placed: ScenePlacement, found: Sequence[Evaluation]) -> Iterator[ReadingCheck]:
    """Check accelerations of bodies by the equations of motion and of constraints of the reference model."""
    reference, across, loops, left, scales = placed.reference, [], [], [], []
    for place, each in zip(placed.places, found, strict=True):
        accelerations = np.hstack([each.linear_acceleration, each.angular_acceleration]).ravel()
        own, strange = _own_acceleration(placed, place, accelerations)
        across.append(strange)
        loops += _loop_check(place.sample, own, reference.units)
        # residual of M a = f along the motions that are certainly free, in independent velocities
        basis, a = place.sample.freedom.basis, reference.units * own
        mass, forces = np.sum(place.sample.mass_matrices, axis=0), np.array(place.sample.forces)
        push = forces[: len(FORCE_KINDS)].sum(axis=0) - forces[-1]
        certain = place.sample.freedom.certain
        onto = certain @ np.linalg.pinv(certain)
        left.append(onto.T @ (basis.T @ (mass @ a - push)))
        usual = np.abs(a) + SAMPLE_RATE**2 * reference.units  # the scale where no force acts
        scales.append(np.abs(basis).T @ (np.abs(mass) @ usual + np.abs(forces).sum(axis=0)))
    yield closest_to_failing(across)
    if loops:
        yield closest_to_failing(loops)
    # constraint rows in doubt have large multipliers, whose round-off shows along the free motions
    doubts = [
        sample.freedom.doubt for sample in reference.samples if sample.freedom.doubt > FREE_SINGULAR_VALUE
    ]
    spread = max((np.finfo(float).eps / (READING_ROUND_OFF * doubt) for doubt in doubts), default=0.0)
    scale = (ACCELERATION_LOSS + spread) * row_scales(reference, scales)
    limits = [sample.tolerance_of_motion for sample in reference.samples]
    yield row_check(reference, "accelerations, as forces, rel", left, scale, limits)


def _own_acceleration(
    placed: ScenePlacement, place: SamplePlacement, accelerations: Array
) -> tuple[Array, ReadingCheck]:
    """Fit dimensionless accelerations (nv,) of the file's coordinates to accelerations of the bodies.

    The check is the part of the body accelerations that no joint of the file allows.
    """
    rows = place.of_parts / placed.part_units[:, None] * placed.reference.units
    reached, drift = placed.of_parts(accelerations), place.drift / placed.part_units
    own = least_squares(rows, reached - drift)
    scale = max(SAMPLE_RATE**2, float(np.max(np.abs([reached, drift]))))
    gaps = np.abs(rows @ own - (reached - drift)).reshape(-1, 6).max(axis=1) / scale
    limit, names = place.sample.tolerance_of_motion, placed.reference.names
    return own, worst_entry("accelerations across joints, rel", gaps, limit, names)


def _loop_check(sample: Sample, own: Array, units: Array) -> list[ReadingCheck]:
    """Check the second rates of the file's constraints at accelerations (nv,); no check without constraints.

    Accelerations have the componentwise round-off of M a = f (N. J. Higham, Accuracy and Stability of
    Numerical Algorithms, 2002, section 7.2). The componentwise bound matters for light bodies at the end of a
    heavy chain.
    """
    _, jacobian, owners = sample.constraints
    if not len(owners):
        return []
    fine, coarse = sample.velocity_products
    scale = float(np.max(np.abs(jacobian))) * max(SAMPLE_RATE**2, float(np.max(np.abs(own))))
    # Only the range of rows that certainly hold is judged. No acceleration changes the rest: redundant rows,
    # rows in doubt, loops that keep an offset, rows that lose rank in a singular configuration.
    u, s, _ = singular_values(jacobian)
    held = u[:, s > HELD_SINGULAR_VALUE * max(1.0, float(s[0]))]
    opened, unsure = (held @ (held.T @ each) for each in (jacobian @ own + fine, coarse - fine))
    scale = max(scale, SAMPLE_RATE**2)
    mass, forces = np.abs(np.sum(sample.mass_matrices, axis=0)), np.abs(np.array(sample.forces)).sum(axis=0)
    inverse = np.abs(np.linalg.inv(np.sum(sample.mass_matrices, axis=0)))
    unknown = inverse @ (mass @ (units * (np.abs(own) + SAMPLE_RATE**2)) + forces) / units
    lost = LIGHT_BODY_LOSS * np.finfo(float).eps * float(np.max(np.abs(jacobian) @ unknown))
    gaps = np.maximum(np.abs(opened) - np.abs(unsure) - lost, 0.0) / scale
    limit = sample.tolerance_of_motion
    return [worst_entry("accelerations across loops, rel", gaps, limit, owners)]
