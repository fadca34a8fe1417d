"""Compare poses, energies and accelerations of an imported scene with the file's reference model.

The reference model is the model file as an independent parser compiles it; *samples* are the states at which
scene and file are compared. `ScenePlacement` has the scene's bodies at the poses of the samples.
Accelerations of the scene are substituted into the equations of the reference model, M a = f + J^T lambda and
J a = -dJ/dt v. The checks are the residual of the first equation along the free motions of the file, and the
residual of the second equation. The accelerations of the two models are not compared directly, because they
depend on a decision on the rank of the constraint Jacobian J. If a singular value of J is round-off, its
motion is certainly *free*; if it is large, its motion is *held* by the constraints. Values between are in
doubt, because rounded digits of the file cause such values.

Sizes: b bodies of the scene; g rigid groups of the file, which are links that fixed joints hold together; nv
velocities of the file, of which d are independent.
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

SAMPLE_SPEED = 1.0
"""Typical speed of the samples, rad/s, or sizes of the mechanism per second. It is the smallest scale by
which differences of velocities are divided, its square that of accelerations."""

ACCELERATION_LOSS = 100.0
"""Allowed error of joint accelerations that are computed from accelerations of bodies, as a multiple of the
tolerance of motions."""

LIGHT_BODY_LOSS = 1000.0
"""Allowed error of accelerations, as a multiple of the componentwise round-off: enough for bodies whose
inertias differ by a factor of 1e9."""


def system_checks(placed: ScenePlacement) -> Iterator[ReadingCheck]:
    """Check poses, energies and accelerations of the scene's equations of motion at the samples."""
    coordinates = [placed.system.coordinates(place.state) for place in placed.placements]
    found = [placed.system.evaluate(q, v) for q, v in coordinates]
    # Length that scales positions, m: size of the mechanism and distance from the origin
    reach = placed.reference.size
    reach += max(float(np.max(np.abs(place.state.position))) for place in placed.placements)
    yield from _pose_checks(placed, found, reach)
    yield from _energy_checks(placed, found, reach)
    yield from _acceleration_checks(placed, found)


def _pose_checks(placed: ScenePlacement, found: Sequence[Evaluation], reach: float) -> Iterator[ReadingCheck]:
    """Check that the scene's joint coordinates reproduce the poses and velocities of the file.

    Args:
        placed: bodies of the scene at the poses of the file.
        found: evaluation of the scene's equations of motion at each sample.
        reach: length by which differences of positions are divided, m.
    """
    distances, angles, speeds = [], [], []
    for each, place in zip(found, placed.placements, strict=True):
        state, wanted = each.state, place.state
        distances.append(np.linalg.norm(state.position - wanted.position, axis=1) / reach)
        angles.append(angle_between(state.quaternion, wanted.quaternion))
        linear = np.linalg.norm(state.linear_velocity - wanted.linear_velocity, axis=1) / reach
        angular = np.linalg.norm(state.angular_velocity - wanted.angular_velocity, axis=1)
        speeds.append(np.maximum(linear, angular))
    tolerances = np.array([place.sample.tolerance_of_motion for place in placed.placements])[:, None]
    names = placed.mechanism.body_names
    yield worst_entry("positions, rel", np.array(distances), tolerances, names)
    yield worst_entry("orientations, rad", np.array(angles), tolerances, names)
    yield worst_entry("velocities, rel", np.array(speeds), tolerances, names)


def _energy_checks(
    placed: ScenePlacement, found: Sequence[Evaluation], reach: float
) -> Iterator[ReadingCheck]:
    """Check kinetic energies, and potential energies relative to the first sample, the start.

    Files and scenes have different zeros of the potential energy.

    Args:
        placed: bodies of the scene at the poses of the file.
        found: evaluation of the scene's equations of motion at each sample.
        reach: height that scales the potential energy of gravity, m.
    """
    samples = placed.reference.samples
    # Columns: kinetic and potential energy, J
    wanted = np.array([sample.energies for sample in samples])
    energies = np.array([[each.kinetic_energy, each.potential_energy] for each in found])
    mass = sum(body.mass for body in placed.mechanism.bodies)
    typical_kinetic = 0.5 * mass * (placed.reference.size * SAMPLE_SPEED) ** 2
    of_gravity = mass * float(np.linalg.norm(placed.scene.gravity)) * reach
    tolerances = np.array([sample.tolerance_of_motion for sample in samples])
    names = [f"state {k}" for k in range(len(found))]
    scales = np.max(np.abs([energies, wanted]), axis=(0, 1)) + np.array(
        [typical_kinetic, typical_kinetic + of_gravity]
    )
    gaps = energies - wanted
    gaps[:, 1] -= gaps[0, 1]  # the zeros of the potential energies differ
    for k, quantity in enumerate(("kinetic energy, rel", "potential energy, rel")):
        yield worst_entry(quantity, np.abs(gaps[:, k]) / scales[k], tolerances, names)


def _acceleration_checks(placed: ScenePlacement, found: Sequence[Evaluation]) -> Iterator[ReadingCheck]:
    """Check accelerations of bodies by the equations of motion and of constraints of the reference model."""
    reference = placed.reference
    joint_checks, loop_checks, residuals, scales = [], [], [], []
    for place, each in zip(placed.placements, found, strict=True):
        accelerations = np.hstack([each.linear_acceleration, each.angular_acceleration]).ravel()
        dimensionless, joint_check = _file_acceleration(placed, place, accelerations)
        joint_checks.append(joint_check)
        loop_checks += _loop_check(place.sample, dimensionless, reference.units)
        # Residual of M a = f along the motions that are certainly free (singular values of round-off), in
        # independent velocities. `basis` (nv, d) also has the motions in doubt
        basis, a = place.sample.freedom.basis, reference.units * dimensionless
        # M is the sum of the mass matrices of bodies and of armatures; forces (kinds, nv) by kind
        mass, forces = np.sum(place.sample.mass_matrices, axis=0), np.array(place.sample.forces)
        total_force = forces[: len(FORCE_KINDS)].sum(axis=0) - forces[-1]  # the last row is the bias
        certain_basis = place.sample.freedom.certain_basis  # (d, c) the c motions that are certainly free
        projection = certain_basis @ np.linalg.pinv(certain_basis)
        residuals.append(projection.T @ (basis.T @ (mass @ a - total_force)))
        typical = np.abs(a) + SAMPLE_SPEED**2 * reference.units  # a scale also where no force acts
        scales.append(np.abs(basis).T @ (np.abs(mass) @ typical + np.abs(forces).sum(axis=0)))
    yield closest_to_failing(joint_checks)
    if loop_checks:
        yield closest_to_failing(loop_checks)
    # Constraint rows in doubt may have large multipliers, inverse to their singular values. The round-off of
    # these multipliers, relative to the `READING_ROUND_OFF` of the tolerance, shows along the free motions
    doubtful_values = [sample.freedom.doubtful_value for sample in reference.samples]
    of_multipliers = max(
        (
            np.finfo(float).eps / (READING_ROUND_OFF * value)
            for value in doubtful_values
            if value > FREE_SINGULAR_VALUE
        ),
        default=0.0,
    )
    scale = (ACCELERATION_LOSS + of_multipliers) * row_scales(reference, scales)
    tolerances = [sample.tolerance_of_motion for sample in reference.samples]
    yield row_check(reference, "accelerations, as forces, rel", residuals, scale, tolerances)


def _file_acceleration(
    placed: ScenePlacement, place: SamplePlacement, accelerations: Array
) -> tuple[Array, ReadingCheck]:
    """Fit accelerations of the file's coordinates to accelerations of the scene's bodies.

    Args:
        placed: bodies of the scene at the poses of the file.
        place: the same bodies at one sample.
        accelerations: (6 b,) linear and angular accelerations of the bodies, m/s^2 and rad/s^2.

    Returns:
        Dimensionless accelerations (nv,), and a check of the part of the body accelerations that no joint of
        the file allows.
    """
    # Dimensionless accelerations of the rigid groups: rows @ (accelerations of coordinates) + drift
    rows = place.group_transformation / placed.group_units[:, None] * placed.reference.units
    reached, drift = placed.group_rows(accelerations), place.group_drift / placed.group_units
    fitted = least_squares(rows, reached - drift)
    scale = max(SAMPLE_SPEED**2, float(np.max(np.abs([reached, drift]))))
    gaps = np.abs(rows @ fitted - (reached - drift)).reshape(-1, 6).max(axis=1) / scale
    tolerance, names = place.sample.tolerance_of_motion, placed.reference.names
    return fitted, worst_entry("accelerations across joints, rel", gaps, tolerance, names)


def _loop_check(sample: Sample, acceleration: Array, units: Array) -> list[ReadingCheck]:
    """Check the second time derivatives J a + dJ/dt v of the file's constraints, which must be zero.

    The tolerance includes the componentwise round-off of the solution of M a = f (N. J. Higham, Accuracy and
    Stability of Numerical Algorithms, 2002, section 7.2). The componentwise bound matters for light bodies at
    the end of a heavy chain.

    Args:
        sample: state of the reference model.
        acceleration: (nv,) dimensionless accelerations a.
        units: (nv,) units of velocities: the size of the model, m, or 1 for angles.

    Returns:
        One check; none for a file without constraints.
    """
    _, jacobian, owners = sample.constraints
    if not len(owners):
        return []
    fine, coarse = sample.velocity_products  # dJ/dt v by a small and a large difference step
    scale = float(np.max(np.abs(jacobian))) * max(SAMPLE_SPEED**2, float(np.max(np.abs(acceleration))))
    # Only the part of the residual in the range of the rows that certainly hold is judged. No acceleration
    # changes the rest: redundant rows, rows in doubt, loops that rounded digits of the file leave open, rows
    # that lose rank in a singular configuration
    u, s, _ = singular_values(jacobian)
    held = u[:, s > HELD_SINGULAR_VALUE * max(1.0, float(s[0]))]
    second_rates = held @ (held.T @ (jacobian @ acceleration + fine))
    difference_error = held @ (held.T @ (coarse - fine))
    scale = max(scale, SAMPLE_SPEED**2)
    # Componentwise round-off: |J| |M^-1| (|M| |a| + |f|)
    mass, forces = np.abs(np.sum(sample.mass_matrices, axis=0)), np.abs(np.array(sample.forces)).sum(axis=0)
    inverse = np.abs(np.linalg.inv(np.sum(sample.mass_matrices, axis=0)))
    bound = inverse @ (mass @ (units * (np.abs(acceleration) + SAMPLE_SPEED**2)) + forces) / units
    round_off = LIGHT_BODY_LOSS * np.finfo(float).eps * float(np.max(np.abs(jacobian) @ bound))
    gaps = np.maximum(np.abs(second_rates) - np.abs(difference_error) - round_off, 0.0) / scale
    return [worst_entry("accelerations across loops, rel", gaps, sample.tolerance_of_motion, owners)]
