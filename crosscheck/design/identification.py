"""Report on an identification, a fit of model parameters to measured motion.

The report has the fitted parameters with standard deviations, the residuals (measured minus computed values)
of each measured column, and pairs of parameters that the data do not distinguish. A measured column is one
quantity at many times, such as a coordinate of a body; a fit can use several runs. The noise of a column is
the standard deviation of its measurement errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from itertools import combinations
from typing import Any

import numpy as np

from crosscheck.report.chart import Measure, linear_chart
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    number_columns,
    text_columns,
)
from newton_euler.analysis.identification.identify import Identification

REPORTED_CORRELATION = 0.99
"""Magnitude of the correlation of two parameters above which the report names them."""

MAX_REPORTED_PAIRS = 5
"""Largest number of correlated pairs in a report; the most correlated pairs come first."""


def report(found: Identification) -> Report:
    """Make the report on a fit: a table of parameters, a table of measured columns, and notes."""
    # a run has the residuals of its columns by name
    numbers = sum(len(column) for run in found.residuals for column in run.values())
    runs = f"{len(found.residuals)} run{'s' * (len(found.residuals) != 1)}"
    fitted = f"{len(found.parameters)} parameter{'s' * (len(found.parameters) != 1)}"
    title = f"{found.scene.name}: {fitted} fitted to {numbers:,} numbers of {runs}"
    heads, *rows = found.table
    names = [*text_columns(*heads[:2]), *number_columns(*heads[2:])]
    parts: list[Part] = [Table("", names, [list(row) for row in rows]), _columns(found)]
    if lines := [*found.doubts, *found.notes, *_correlated(found)]:
        parts.append(Lines("", lines))
    # `fit`: line of text with the reduced chi-squared and its p-value
    misfits = [Measure(name, value, f"{value:.3g}", mark=1.0) for name, value in found.misfits.items()]
    caption = "RMS of the residuals of each measured column, divided by its noise; the mark is at 1"
    return Report(
        title,
        found.fit,
        _judged(found),
        parts,
        summary=parts,
        charts=linear_chart("Residuals", caption, misfits, end=1.0),
        next_steps=_next_steps(found),
    )


def _next_steps(found: Identification) -> list[str]:
    """List what the reader can do with the fit."""
    if found.is_wrong:
        worst = max(found.misfits, key=lambda name: found.misfits[name])
        return [
            f"Do not use these values. Begin with {worst}, whose residuals are largest by its noise.",
            "Fit further parameters with `--fit`, or correct the scene, the units or the noise.",
        ]
    steps = ["Do not use values that the notes doubt."] if found.doubts else []
    if found.undetermined:
        steps.append("Fix a parameter that the data do not identify, or measure a motion that excites it.")
    return steps or ["Use the fitted values with their standard deviations; the file has all covariances."]


def _judged(found: Identification) -> Cell:
    """Return the verdict of the fit in one word.

    The scene is wrong if the given noise does not explain the residuals. Other reasons not to trust the fit,
    such as parameters that are not identifiable, make it doubtful. Without given noise it is only "fitted".
    """
    if found.is_wrong:
        return Cell("wrong", "fails")
    if found.doubts:
        return Cell("doubtful", "doubtful")
    return Cell("fits", "holds") if np.isfinite(found.probability) else Cell("fitted")


def _columns(found: Identification) -> Table:
    """Tabulate the noise and the residuals of each measured column.

    The columns are the noise in different runs, the root mean square of the residuals, the largest residual,
    and the root mean square divided by the noise.
    """
    rows: Rows = []
    for name, misfit in found.misfits.items():
        noises = [run[name] for run in found.noise if name in run]
        noise = " to ".join(dict.fromkeys(f"{each:.3g}" for each in (min(noises), max(noises))))
        residuals = np.concatenate([run[name] for run in found.residuals if name in run])
        rms, peak = np.sqrt(np.mean(residuals**2)), np.abs(residuals).max()
        rows.append([name, noise, f"{rms:.3g}", f"{peak:.3g}", f"{misfit:.3g}"])
    return Table("", [Column("measured"), *number_columns("noise", "residual", "largest", "by noise")], rows)


def _correlated(found: Identification) -> Iterator[str]:
    """Yield a line for each pair of parameters whose estimates are almost perfectly correlated."""
    correlation = found.correlation
    pairs = [
        (abs(correlation[a, b]), a, b)
        for a, b in combinations(range(len(found.parameters)), 2)
        if abs(correlation[a, b]) > REPORTED_CORRELATION
    ]
    for _, a, b in sorted(pairs, reverse=True)[:MAX_REPORTED_PAIRS]:
        names = f"{found.parameters[a]} and {found.parameters[b]}"
        yield f"{names} are almost perfectly correlated ({correlation[a, b]:.4f}); fix one of them"


def data(found: Identification) -> dict[str, Any]:
    """Return the result of a fit for JSON; most entries are attributes of `Identification`.

    "unlike" has the columns that a constant fits better than the scene, and "in_degrees" those that fit as
    degrees. "curvature" is the relative change of the derivatives two standard deviations away.
    "contradiction" names a column whose first measurement contradicts the start of its run.
    """
    rows = zip(
        found.units,
        found.before.tolist(),
        found.values.tolist(),
        found.standard_deviations.tolist(),
        strict=True,
    )
    names = ("unit", "before", "fitted", "deviation")
    return {
        "scene": found.scene.name,
        "parameters": {
            parameter: dict(zip(names, row, strict=True))
            for parameter, row in zip(found.parameters, rows, strict=True)
        },
        "covariance": found.covariance.tolist(),
        "noise": found.noise,
        "misfit": found.misfit,
        "misfits": found.misfits,
        "degrees_of_freedom": found.degrees_of_freedom,
        "probability": found.probability,
        "is_wrong": found.is_wrong,
        "unlike": found.unlike,
        "in_degrees": found.in_degrees,
        "undetermined": found.undetermined,
        "at_bound": found.at_bound,
        "missing_friction": found.missing_friction and asdict(found.missing_friction),
        "stopped": found.stopped,
        "curvature": found.curvature,
        "contradiction": found.contradiction,
    }
