"""Test whether dry friction that a scene does not have explains the residuals of a fit.

The test has two steps:

1. Friction of zero strength is added to all joints without dry friction. Derivatives show by how much the
   squared residuals decrease, to first order, if the friction grows and the fitted parameters change with it.
   The joints with the largest decrease are the candidates.
2. The fit is repeated with friction of one candidate, then of two. Friction explains the residuals if the
   misfit falls to less than a half. Another fit has as many parameters of other kinds, such as masses, in
   place of friction, chosen in the same way. Friction is reported only if it fits much better.

A constant force acts like dry friction on a joint that always moves in one direction. The second step then
reports nothing, unless the motion after the stop shows the difference.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from newton_euler.analysis.identification.fit import RANK_TOL, Fit
from newton_euler.analysis.identification.measurements import Measurements
from newton_euler.analysis.identification.noise import MIN_PROBABILITY
from newton_euler.analysis.identification.residuals import Residuals, ResidualValues
from newton_euler.analysis.sensitivity.tangent_starts import own_numbers
from newton_euler.equations.parameter_names import element_of, parameter_names, places
from newton_euler.equations.parameters import own_value
from newton_euler.errors import NewtonEulerError, SensitivityError
from newton_euler.integrators.options import FormulationName, Options
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction
from newton_euler.scalars import Array

TRANSITION_FRACTION = 0.002
"""Transition speed of the friction that is tested, divided by the largest rate of the joint."""

TEST_TOLERANCE = 1e-6
"""Relative tolerance of the runs of these fits; the absolute one is a hundredth of it."""

MAX_STEPS = 3000
"""Largest number of steps of a run of these fits. A joint that friction stops makes the equations stiff; such
a run would take long and counts as impossible."""

MAX_EVALUATIONS = 40
"""Largest number of evaluations of the residuals in one of these fits; a longer fit has no result."""

MAX_JOINTS = 2
"""Largest number of joints whose friction is tested together."""

MAX_FIRST_ORDER = 0.9
"""Sum of squared residuals after the first-order decrease, divided by the sum before, up to which fits with
friction are made. The decrease is far larger than first order where a joint sticks."""

EXPLAINED = 0.5
"""Misfit with friction, divided by the misfit without, up to which friction explains the residuals."""

ADVANTAGE = 0.7
"""Misfit with friction, divided by the misfit with as many other parameters, up to which friction is the
better explanation. The same ratio decides whether friction of a second joint is needed."""


@dataclass(frozen=True)
class MissingFriction:
    """Dry friction that would explain the residuals of a fit.

    Attributes:
        coulomb: fitted Coulomb friction, N or N m, by label of the joint coordinate.
        misfit: root of reduced chi-squared of the fit with this friction.
    """

    coulomb: dict[str, float]
    misfit: float

    def report(self) -> list[str]:
        """Return a line of text for each joint."""
        return [
            f"residuals change with the direction of joint {joint}, as with dry friction: "
            f"add a JointFriction (coulomb {value:.3g}; reduced chi-squared {self.misfit**2:.3g})"
            for joint, value in self.coulomb.items()
        ]


@dataclass(frozen=True)
class FitInputs:
    """Scene, measurements and formulation of a fit, for fits with additional parameters.

    Attributes:
        scene: scene with the initial values.
        runs: measurements by the name of their file or run.
        formulation: formulation of the runs.
    """

    scene: Scene
    runs: Mapping[str, Measurements]
    formulation: FormulationName | None

    def residuals(self, scene: Scene, names: Sequence[str]) -> Residuals:
        """Compile a changed scene for the measured runs."""
        options = Options(rtol=TEST_TOLERANCE, atol=0.01 * TEST_TOLERANCE, most_steps=MAX_STEPS)
        return _LimitedResiduals(scene, tuple(names), self.runs, self.formulation, options)


class _LimitedResiduals(Residuals):
    """Residuals that can be evaluated `MAX_EVALUATIONS` times; then all calls raise `SensitivityError`."""

    def __call__(self, values: Array) -> ResidualValues:
        if self.evaluations >= MAX_EVALUATIONS:
            raise SensitivityError(f"more than {MAX_EVALUATIONS} evaluations")
        return super().__call__(values)


def missing_friction(
    inputs: FitInputs,
    fitted: Mapping[str, float],
    rates: Mapping[Key, Array],
    deviations: Array,
    misfit: float,
) -> MissingFriction | None:
    """Find joints whose dry friction would explain the residuals of a fit.

    Args:
        inputs: scene and measurements of the fit.
        fitted: values of the p fitted parameters by name, SI.
        rates: rates (k,) of the joint coordinates in all fitted runs.
        deviations: (n,) standard deviations of the measured numbers, SI.
        misfit: root of reduced chi-squared of the fit.

    Returns:
        The friction; None if friction does not explain the residuals, or if other parameters explain them
        nearly as well.
    """
    # friction, and springs with dampers, of zero strength on all joints that move and have none
    scene = inputs.scene
    speeds = {key: float(np.abs(each).max()) for key, each in rates.items()}
    moving = [key for key, speed in speeds.items() if speed > 0.0]
    of_kind = {
        kind: {force.key for force in scene.forces if isinstance(force, kind)}
        for kind in (JointFriction, JointSpring)
    }
    frictions = [
        JointFriction(joint, 0.0, transition_speed=TRANSITION_FRACTION * speeds[joint, k], coordinate=k)
        for joint, k in moving
        if (joint, k) not in of_kind[JointFriction]
    ]
    springs = [JointSpring(*key[:1], coordinate=key[1]) for key in moving if key not in of_kind[JointSpring]]
    sprung = replace(scene, forces=(*scene.forces, *springs))
    # candidates, by the first-order decrease of the squared residuals
    coulomb = [f"{friction.prefix}.coulomb" for friction in frictions]
    others = [name for name in _other_causes(sprung) if name not in fitted]
    target, of_friction, of_others = _unfitted_part(
        inputs, replace(sprung, forces=(*sprung.forces, *frictions)), fitted, coulomb, others, deviations
    )
    # joints with control laws first, because friction of their drives is the most likely
    driven = {key for law in scene.control for key in law.keys}
    is_driven = np.array([friction.key in driven for friction in frictions])
    tried = list[Sequence[int]]()
    for columns in (np.where(is_driven, of_friction, 0.0), of_friction):
        chosen, least = _forward_selection(target, columns, is_positive=True)
        if least <= MAX_FIRST_ORDER * float(target @ target) and chosen not in tried:
            tried.append(chosen)
            best = _with_friction(inputs, fitted, [frictions[k] for k in chosen], misfit)
            if best is not None:
                break
    else:
        return None
    # a fit with as many other parameters
    alternative, _ = _forward_selection(target, of_others, is_positive=False)
    rival = _fit(inputs, sprung, fitted, [others[k] for k in alternative[: len(best.coulomb)]])
    return best if best.misfit < ADVANTAGE * rival.misfit else None


def _with_friction(
    inputs: FitInputs, fitted: Iterable[str], frictions: Sequence[JointFriction], misfit: float
) -> MissingFriction | None:
    """Repeat a fit with friction of the first joint, then of the first two, and so on.

    Args:
        inputs, fitted: scene and measurements of the fit, and names of the fitted parameters.
        frictions: elements to add to the scene, the most likely one first.
        misfit: root of reduced chi-squared of the fit without friction.

    Returns:
        The friction that explains the residuals, of no more joints than necessary; None if it does not.
    """
    best, limit, scene = None, EXPLAINED * misfit, inputs.scene
    for count in range(1, 1 + len(frictions)):
        added = frictions[:count]
        names = [f"{friction.prefix}.coulomb" for friction in added]
        found = _fit(inputs, replace(scene, forces=(*scene.forces, *added)), fitted, names)
        if found.misfit < limit:
            labels = [scene.mechanism.coordinate_labels[friction.key] for friction in added]
            best = MissingFriction(dict(zip(labels, found.values, strict=True)), found.misfit)
            limit = ADVANTAGE * found.misfit
        if found.probability >= MIN_PROBABILITY:
            break
    return best


class _Fitted(NamedTuple):
    """Result of a fit with additional parameters.

    Attributes:
        values: values of the additional parameters, SI.
        misfit, probability: see `Noise`; infinite and 0 if a run of the fit is impossible.
    """

    values: list[float]
    misfit: float
    probability: float


def _fit(inputs: FitInputs, scene: Scene, fitted: Iterable[str], added: Sequence[str]) -> _Fitted:
    """Repeat a fit with additional parameters of a changed scene."""
    names = (*fitted, *added)
    try:
        fit = Fit(scene, names, inputs.residuals(scene, names))
        values = fit.values(fit.solve())
    except NewtonEulerError:
        return _Fitted([], np.inf, 0.0)
    return _Fitted(values[len(names) - len(added) :].tolist(), fit.noise.misfit, fit.noise.probability)


def _unfitted_part(
    inputs: FitInputs,
    scene: Scene,
    fitted: Mapping[str, float],
    coulomb: Sequence[str],
    others: Sequence[str],
    deviations: Array,
) -> tuple[Array, Array, Array]:
    """Compute the part of residuals and of their derivatives that the fitted parameters cannot change.

    Args:
        inputs: measurements of the fit.
        scene: scene with the initial values and all candidates.
        fitted: values of the p fitted parameters by name.
        coulomb, others: names of the f and g candidates.
        deviations: (n,) standard deviations of the measured numbers, SI.

    Returns:
        Residuals (n,), and their derivatives with respect to the candidates, (n, f) and (n, g); in standard
        deviations.
    """
    added, count = (*coulomb, *others), len(fitted)
    values = np.array([*fitted.values(), *own_numbers(scene, added)])
    residuals, jacobian = inputs.residuals(scene, (*fitted, *added))(values)
    columns = jacobian / deviations[:, None]
    basis, singular, _ = np.linalg.svd(columns[:, :count], full_matrices=False)
    basis = basis[:, singular > RANK_TOL * singular.max()]
    left = np.column_stack([residuals / deviations, columns[:, count:]])
    left -= basis @ (basis.T @ left)
    return left[:, 0], left[:, 1 : 1 + len(coulomb)], left[:, 1 + len(coulomb) :]


def _other_causes(scene: Scene) -> list[str]:
    """Return names of parameters whose errors may look like friction.

    They are masses, and the numbers of forces and control laws that are not dry friction.
    """
    names = []
    for name in parameter_names(scene):
        (place,) = places(scene, [name]).values()
        is_force = place.owner[0] in ("forces", "control")
        is_friction = isinstance(element_of(scene, place.owner), JointFriction)
        is_cause = place.owner[-1] == "mass" or (is_force and not is_friction)
        if is_cause and own_value(scene, place.owner).shape == ():
            names.append(name)
    return names


def _forward_selection(target: Array, columns: Array, is_positive: bool) -> tuple[list[int], float]:
    """Choose the columns that explain residuals best, one after the other.

    Args:
        target: (n,) residuals.
        columns: (n, k) derivatives of the residuals with respect to parameters.
        is_positive: True if no parameter may become smaller.

    Returns:
        Indices of up to `MAX_JOINTS` columns, best first, and the sum of squares that they leave.
    """
    chosen, least = list[int](), float(target @ target)
    for _ in range(MAX_JOINTS):
        sums = np.full(columns.shape[1], np.inf)
        for k in set(np.flatnonzero(columns.any(axis=0)).tolist()) - set(chosen):
            used = columns[:, [*chosen, k]]
            change, *_ = np.linalg.lstsq(used, -target)
            if not is_positive or change.min() > 0.0:
                sums[k] = np.sum((target + used @ change) ** 2)
        if not np.isfinite(sums).any():
            break
        chosen, least = [*chosen, int(np.argmin(sums))], float(sums.min())
    return chosen, least
