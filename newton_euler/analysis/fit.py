"""Least squares of residuals between measured and computed motion, by numbers of a scene.

A fit has three steps, each by scipy's trust-region method:

1. All numbers are pulled to where they were, by as much as a residual that is its noise for a change by the
   scale of the number. So combinations that the data say nothing about stay, and steps are bounded. Numbers
   that become larger nevertheless have larger scales from then on: the first guess may be far too small.
2. Residuals that are larger than their noise, of a scene that cannot move as was measured, count as noise
   from then on, as do those of columns whose noise is not known. 1 is repeated with them.
3. Combinations that are determined, those beyond this noise, are fitted without the pull; what noise has
   changed of the others is taken back.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from newton_euler.analysis.measurements import (
    Column,
    Measurements,
    Places,
    column_of,
    column_places,
    compared,
)
from newton_euler.analysis.tangent_run import ALONG, Followed, FollowedRun, Starts, own_numbers, tangent_code
from newton_euler.equations.parameters import own_value, places
from newton_euler.errors import MechanismError, NewtonEulerError, UnknownNameError
from newton_euler.integrators.options import FormulationName, Options
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.source_file import SourceError
from newton_euler.model.trajectory import QUANTITIES
from newton_euler.scalars import Array, Floats
from newton_euler.starts import initial_numbers
from newton_euler.variation import units_of

WEAK = 1.0
"""Standard deviation of a combination of parameters, in units of their scales, from which on it is not
determined."""

LOST = 1e-7
"""Singular value of the Jacobian, as a share of the largest, below which there are no digits left of it."""

NOTHING = 1e-12
"""Below which a coordinate of a start, m or rad, or a change, in units of its scale, is round-off."""

ROUNDS = 8
"""Fits at most, each with the noise, or the scales, that the last one left."""

LARGER = 2.0
"""Factor by which numbers may outgrow their scales."""

NEAR = 1e-6
"""Change, in units of its scale, within which a number is at the edge of what the scene can have."""

SAME = 0.1
"""Share by which noise that is taken from residuals may differ from that of the fit before."""

FINE = 1e-3
"""Noise of columns whose noise is not known, as a share of their standard deviation, to begin with: so little
that first guesses which are far off are left."""

EXACT = 1e-9
"""Noise of columns whose noise is not known, as a share of their standard deviation, that runs may have
themselves."""

ROUND_OFF = 1e-8
"""Changes in units of scales that runs to 1e-10 do not tell from none."""

CONVERGED = {"xtol": 1e-9, "ftol": 1e-10, "gtol": 1e-12}
"""Of changes in units of scales, of the sum of squares, and of its slope."""

SETTLED = 0.1
"""Standard deviations by which a further step would move parameters at most where a fit has converged."""

CLEARLY = 0.1
"""Share of an angle's residuals that is left at most if it is in degrees; without other errors 1 / 57.3."""

EXPLAINED = 0.5
"""Share of an angle that residuals are at most if the scene moves like it; one at rest explains nothing."""

MOST_EVALUATIONS = 200
"""Of a fit."""

FAR = 1e3
"""Stands for residuals of numbers that make no sense, times those at the beginning."""


class Evaluated(NamedTuple):
    """All runs at the same numbers: residuals (n, m) of each, and their derivatives (n, m, p)."""

    residuals: list[Array]
    jacobians: list[Array]


class Fit:
    """Residuals of measurements and their derivatives by p numbers of a scene, and what makes them least.

    Attributes:
        before, scale: (p,) the scene's own numbers, and changes of them that are large.
        units: (p,) of them.
        excess: of residuals over their noise, 1 or more.
        stopped: why the last fit ended if it was too early.
    """

    def __init__(
        self,
        scene: Scene,
        names: tuple[str, ...],
        runs: dict[str, Measurements],
        formulation: FormulationName | None,
        options: Options,
    ) -> None:
        self.evaluations, self.excess, self.stopped, self._refused = 0, 1.0, "", ""
        self._runs = list(runs.values())
        kinds = {name.split(".")[0] for run in self._runs for name in run.columns}
        wanted = {QUANTITIES[kind].output for kind in kinds if kind in QUANTITIES}
        asked = replace(scene, outputs=frozenset(output for output in OUTPUTS if output in wanted))
        code = tangent_code(asked, names, formulation)
        layouts = (code.function(name).layout for name in ("output", "output" + ALONG))
        places = [column_places(scene.mechanism, layout) for layout in layouts]
        self._columns = [_columns(scene, where, run, places) for where, run in runs.items()]
        self._models = []
        for run, columns in zip(self._runs, self._columns, strict=True):
            programs = sorted({column.program for column in columns})
            self._models.append((Starts(code, names, run.start), FollowedRun(code, options, programs)))
        self.before, self.scale, self.units = _scales(scene, names)
        self.some_noise_is_known = any(run.noise for run in self._runs)
        self._unknown: dict[str, float] = {}
        for run in self._runs:
            for name, column in run.columns.items():
                if name not in run.noise:
                    self._unknown.setdefault(name, FINE * (float(np.std(column)) or 1.0))
        self._exact = {name: EXACT / FINE * noise for name, noise in self._unknown.items()}
        self._known: tuple[bytes, Evaluated] | None = None
        self._far = np.inf
        self._suspected: set[str] = set()

    def solve(self) -> Array:
        """Return the changes of the numbers (p,) in units of their scales that make residuals least."""
        change, scale = np.zeros(len(self.before)), self.scale
        self._suspected = self._like_degrees(change)
        for _ in range(ROUNDS):
            change, before = self._pulled(change), self._levels
            self._take_residuals(change)
            growth = [self._levels[name] / level for name, level in before.items()]
            if min(growth) > 1.0 - SAME and max(growth) < 1.0 + SAME:
                break
            if max(growth) > 1.0 + SAME:  # where numbers may have gone too far
                change, self.scale = np.zeros(len(change)), scale
        change, unsettled = self._determined(change), np.inf
        while SETTLED**2 < (now := self.unsettled(change)) < 0.5 * unsettled:
            unsettled = now
            strong = split(self.jacobian(change), self.excess).strong
            change = self._least(change, strong.T / np.linalg.norm(strong, axis=1), pull=0.0)
        return change

    def _pulled(self, change: Array) -> Array:
        """Return the changes (p,) with the least squares of residuals and of themselves."""
        for _ in range(ROUNDS):
            change = self._least(change, np.eye(len(change)), pull=1.0)
            larger = np.maximum(self.scale, np.abs(self.values(change)))
            if np.all(larger <= LARGER * self.scale):
                break
            change, self.scale = change * self.scale / larger, larger
        return change

    def _determined(self, change: Array) -> Array:
        """Return the part of changes (p,) that is determined, or all if the scene cannot be there."""
        strong, weak, _ = split(self.jacobian(change), self.excess)
        if not len(weak):
            return change
        directions = strong / np.linalg.norm(strong, axis=1)[:, None]
        part = np.asarray((directions @ change) @ directions)
        try:
            self._evaluated(part)
        except NewtonEulerError:
            return change
        return part

    def _least(self, begin: Array, basis: Array, pull: float) -> Array:
        """Return the changes (p,) that are `begin` and some of a basis (p, k), with the least squares.

        Of residuals, and of all changes times the pull.
        """
        from scipy.optimize import least_squares

        def changed(z: Array) -> Array:
            return np.asarray(begin + basis @ (z - 1.0))  # from 1 on, which is what tolerances are of

        def residuals(z: Array) -> Array:
            change = changed(z)
            return np.concatenate([self.residuals(change) / self.excess, pull * change])

        def jacobian(z: Array) -> Array:
            return np.vstack([self.jacobian(changed(z)) @ basis / self.excess, pull * basis])

        if not basis.size:
            return begin
        self._refused = ""
        self._far = FAR * max(1.0, float(np.abs(self._weighted(self._evaluated(begin).residuals)).max()))
        solved = least_squares(
            residuals, np.ones(basis.shape[1]), jacobian, max_nfev=MOST_EVALUATIONS, **CONVERGED
        )
        over = f"{MOST_EVALUATIONS} evaluations are over" if solved.status == 0 else "steps are too small"
        self.stopped = f"residuals are not the least: {self._refused or over}"
        return changed(solved.x)

    def unsettled(self, change: Array) -> float:
        """Return by how many standard deviations a further step would move what is determined.

        0 for round-off.
        """
        jacobian = self.jacobian(change)
        strong = split(jacobian, self.excess).strong
        deviations = strong @ (jacobian.T @ self.residuals(change))
        if np.abs(strong.T @ deviations).max() < ROUND_OFF:
            return 0.0
        return float(np.linalg.norm(deviations)) / self.excess

    @property
    def _levels(self) -> dict[str, float]:
        """Noise that is not known by column, and the excess."""
        return self._unknown | {"": self.excess}

    def _take_residuals(self, change: Array) -> None:
        """Take residuals for noise that is not known, and for the excess."""
        squares: dict[str, list[Array]] = {}
        for run, residuals in zip(self._runs, self.by_column(change), strict=True):
            for name, column in residuals.items():
                if name not in run.noise:
                    squares.setdefault(name, []).append(column**2)
        larger = self._share_of_noise(change) ** -0.5
        for name, found in squares.items():
            level = larger * float(np.sqrt(np.mean(np.concatenate(found))))
            self._unknown[name] = max(self._exact[name], level)
        self.excess = max(1.0, float(np.sqrt(np.mean(self.residuals(change) ** 2))))

    def _share_of_noise(self, change: Array) -> float:
        """Return degrees of freedom per number measured, of columns whose noise is not known.

        The others are those of combinations of parameters which these columns determine: the trace of their
        part of the matrix that projects measurements on what the fit can be.
        """
        is_unknown = np.concatenate(
            [np.tile([name not in run.noise for name in run.columns], run.time.size) for run in self._runs]
        )
        count = int(np.count_nonzero(is_unknown))
        if not count:
            return 1.0
        jacobian = self.jacobian(change)
        fitted = np.sum((jacobian[is_unknown] @ split(jacobian, self.excess).strong.T) ** 2)
        return max(1.0, count - float(fitted)) / count

    @property
    def noise(self) -> tuple[dict[str, float], ...]:
        """Standard deviations of columns by name, for each run."""
        return tuple(
            {name: {**self._unknown, **run.noise}[name] for name in run.columns} for run in self._runs
        )

    def is_at_edge(self, change: Array) -> list[bool]:
        """Tell for each number whether the scene cannot have one that is a little larger or smaller."""
        starts, _ = self._models[0]
        found = []
        for number in np.eye(len(change)):
            try:
                for near in (NEAR, -NEAR):
                    starts(self.values(change + near * number))
                found.append(False)
            except NewtonEulerError:
                found.append(True)
        return found

    def curvature(self, change: Array) -> float:
        """Return by how much derivatives two standard deviations away are others, in units of those here.

        Away by equal parts of all combinations that are determined; infinite if the scene cannot be there.
        """
        jacobian = self.jacobian(change)
        strong = split(jacobian, self.excess).strong
        if not len(strong):
            return 0.0
        try:
            away = self.jacobian(change + 2.0 / np.sqrt(len(strong)) * strong.sum(axis=0))
        except NewtonEulerError:
            return np.inf
        return float(np.linalg.norm((away - jacobian) @ strong.T, 2))

    def values(self, change: Array) -> Array:
        """Return the numbers (p,) after a change in units of their scales."""
        return self.before + np.where(np.abs(change) > NOTHING, change, 0.0) * self.scale

    def residuals(self, change: Array) -> Array:
        """Compute all residuals in units of their noise; far ones for numbers that make no sense."""
        try:
            return self._weighted(self._evaluated(change).residuals)
        except NewtonEulerError as error:
            self._refused = f"beyond is what the scene cannot be: {str(error).removeprefix('run 0: ')}"
            return np.full(sum(run.time.size * len(run.columns) for run in self._runs), self._far)

    def jacobian(self, change: Array) -> Array:
        """Compute the derivatives of all residuals by the changes."""
        return self._weighted(self._evaluated(change).jacobians) * self.scale

    def by_column(self, change: Array) -> list[dict[str, Floats]]:
        """Return residuals, measured less computed, by column for each run."""
        found = self._evaluated(change).residuals
        pairs = zip(self._runs, found, strict=True)
        return [dict(zip(run.columns, -each.T, strict=True)) for run, each in pairs]

    def misfits(self, change: Array) -> dict[str, float]:
        """Return the root mean squares of the residuals of columns, in units of their noise."""
        weighted: dict[str, list[Array]] = {}
        for noise, residuals in zip(self.noise, self.by_column(change), strict=True):
            for name, column in residuals.items():
                weighted.setdefault(name, []).append(column / noise[name])
        return {name: float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for name, x in weighted.items()}

    def in_degrees(self, change: Array) -> tuple[str, ...]:
        """Return the names of columns that fit as degrees instead of rad, after the fit or before it."""
        suspected = self._suspected | self._like_degrees(change)
        angles = self._angles(change).items()
        return tuple(n for n, (now, _, angle) in angles if n in suspected and now > EXPLAINED * angle)

    def _like_degrees(self, change: Array) -> set[str]:
        """Return the names of columns whose residuals nearly vanish if their numbers are degrees."""
        return {
            name
            for name, (now, as_degrees, angle) in self._angles(change).items()
            if as_degrees < min(CLEARLY * now, EXPLAINED * angle)
        }

    def _angles(self, change: Array) -> dict[str, tuple[float, float, float]]:
        """Return root mean squares for each column of rad or rad/s, by name.

        Of its residuals, of what these are if its numbers are degrees, and of such numbers in rad; of angles
        at most 1, for residuals are within half a revolution.
        """
        found: dict[str, tuple[float, float, float]] = {}
        evaluated = self._evaluated(change).residuals
        for run, columns, table in zip(self._runs, self._columns, evaluated, strict=True):
            pairs = zip(run.columns.items(), columns, table.T, strict=True)
            for (name, measured), column, residuals in pairs:
                if column.unit in ("rad", "rad/s"):
                    converted = np.deg2rad(measured)
                    left, angle = residuals + measured - converted, _rms(converted)
                    if column.unit == "rad":
                        left -= 2.0 * np.pi * np.round(left / (2.0 * np.pi))
                        angle = min(angle, 1.0)
                    found[name] = _rms(residuals), _rms(left), angle
        return found

    def _weighted(self, tables: list[Array]) -> Array:
        parts = []
        for noise, table in zip(self.noise, tables, strict=True):
            weights = 1.0 / np.array(list(noise.values()))
            weighted = table * weights.reshape(-1, *[1] * (table.ndim - 2))
            parts.append(weighted.reshape(table.shape[0] * table.shape[1], *table.shape[2:]))
        return np.concatenate(parts)

    def _evaluated(self, change: Array) -> Evaluated:
        """Run all with a change, computed less measured; that of the last call if it is the same."""
        values = self.values(change)
        if self._known is None or self._known[0] != values.tobytes():
            self.evaluations += 1
            found = Evaluated([], [])
            for run, columns, (starts, followed) in zip(self._runs, self._columns, self._models, strict=True):
                x, directions = starts(values)
                computed, derivatives = _selected(followed(x, directions, run.time), columns)
                residuals, jacobian = compared(computed, derivatives, run, columns)
                if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
                    raise MechanismError("measurements", "have no finite derivatives", "other columns")
                found.residuals.append(residuals)
                found.jacobians.append(jacobian)
            self._known = values.tobytes(), found
        return self._known[1]


def _rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _scales(scene: Scene, names: Sequence[str]) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the own values (p,) of numbers, changes of them (p,) that are large, and their units.

    That by the own value is, or by that of the largest number beside it in an array of one unit; of what is 0
    that by the mechanism's size, m, or else by 1.
    """
    before, units = own_numbers(scene, names), tuple(units_of(scene, names).values())
    before[np.abs(before) < NOTHING] = 0.0
    scale, initial = np.abs(before), initial_numbers(scene, names)
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        if unit and name not in initial:
            (place,) = places(scene, [name]).values()
            scale[k] = np.abs(own_value(scene, place.owner)).max()
        if scale[k] < NOTHING:
            scale[k] = scene.mechanism.size if unit == "m" else 1.0
    return before, scale, units


def _selected(followed: Followed, columns: list[Column]) -> tuple[Array, Array]:
    """Return the columns (n, m) of a run and their derivatives (n, m, p)."""
    values, derivatives = [], []
    for column in columns:
        along = followed.derivatives[column.program]
        if column.program == "coordinates":
            count = along.shape[1] // 2
            values.append(along[:, column.of_value, 0])
            derivatives.append(along[:, count + column.of_derivative])
        else:
            values.append(followed.results[:, column.of_value])
            derivatives.append(along[:, column.of_derivative])
    return np.stack(values, axis=1), np.stack(derivatives, axis=1)


def _columns(scene: Scene, where: str, run: Measurements, places: Sequence[Places]) -> list[Column]:
    """Find the columns of a run; raises `SourceError` for unknown ones and those of other units."""
    columns = []
    for name in run.columns:
        try:
            column = column_of(scene, name, *places)
        except UnknownNameError as error:
            raise SourceError(where, str(error)) from error
        unit = run.units.get(name, column.unit)
        if unit != column.unit:
            raise SourceError(where, f"column {name!r:.100} is in {unit}; needed: a unit of {column.unit}")
        columns.append(column)
    return columns


class Split(NamedTuple):
    """The space of parameters, in units of their scales, by what the data determine.

    Attributes:
        strong: (s, p) orthogonal directions that they determine, of the lengths of standard deviations.
        weak: (p - s, p) a basis of the others, with as many zeros as can be had.
        covariance: (p, p) along all of them.
    """

    strong: Array
    weak: Array
    covariance: Array


def split(jacobian: Array, excess: float) -> Split:
    """Split the space of parameters in what the data determine and what they do not.

    Args:
        jacobian: of residuals in units of their noise, by parameters in units of their scales.
        excess: of residuals over their noise.
    """
    _, values, right = np.linalg.svd(jacobian, full_matrices=False)
    least = LOST * values[0]
    known = (values > least) & (values * WEAK > excess)
    weak = right[~known]
    every = right / np.maximum(values, least or 1.0)[:, None]
    return Split(every[known], _sparse_basis(weak) if len(weak) else weak, every.T @ every)


def _sparse_basis(rows: Array) -> Array:
    """Return a basis of the space of rows (d, p), each of which has a place where all others are 0."""
    from scipy.linalg import qr

    _, _, order = qr(rows, mode="economic", pivoting=True)
    reduced = np.linalg.solve(rows[:, order[: len(rows)]], rows)
    return np.asarray(reduced / np.abs(reduced).max(axis=1)[:, None])
