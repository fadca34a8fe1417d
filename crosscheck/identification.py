"""Tables and files of parameters that were fitted to measured motion."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from crosscheck.report.table import Column, Lines, Part, Rows, Table, figures
from newton_euler.analysis.identification import Identification
from newton_euler.scalars import Array

MOST_CORRELATED = 0.99
"""Correlation of two parameters that is told."""

MOST_TOLD = 5
"""Pairs of such parameters, the most correlated first."""

POOR = 2.0
"""Misfit from which on the scene cannot move as was measured, noise being known; of a good fit it is below
1.5, but for less than 20 numbers."""


def headline(found: Identification) -> str:
    """Say what was fitted to what."""
    numbers = sum(len(column) for run in found.residuals for column in run.values())
    runs = f"{len(found.residuals)} run{'s' * (len(found.residuals) != 1)}"
    fitted = f"{len(found.parameters)} parameter{'s' * (len(found.parameters) != 1)}"
    return f"{found.scene.name}: {fitted} fitted to {numbers:,} numbers of {runs}"


def parts(found: Identification) -> list[Part]:
    """Return tables of parameters and columns, and what is to be known about them."""
    rows: Rows = []
    for k, name in enumerate(found.parameters):
        rows.append([name, f"{found.before[k]:.6g}", f"{found.values[k]:.6g}", found.deviation(k)])
    columns = [Column("parameter"), *figures("before", "fitted", "deviation")]
    tables: list[Part] = [Table("", columns, rows), _columns(found)]
    fit = f"residuals are {found.misfit:.3g} times the noise"
    if found.misfit > POOR:
        fit += ": the scene cannot move as was measured, or there is more noise"
    return [*tables, Lines("", [fit, *found.doubts, *_correlated(found)])]


def _columns(found: Identification) -> Table:
    """Return a table of measured columns: noise and residuals."""
    rows: Rows = []
    for name, noise in found.noise.items():
        residuals = np.concatenate([run[name] for run in found.residuals if name in run])
        rms, peak = np.sqrt(np.mean(residuals**2)), np.abs(residuals).max()
        rows.append([name, f"{noise:.3g}", f"{rms:.3g}", f"{peak:.3g}"])
    return Table("", [Column("measured"), *figures("noise", "residual", "largest")], rows)


def _correlated(found: Identification) -> Iterator[str]:
    """Name the pairs of parameters that the data hardly tell apart."""
    correlation = found.correlation
    pairs = [
        (abs(correlation[a, b]), a, b)
        for a, b in combinations(range(len(found.parameters)), 2)
        if abs(correlation[a, b]) > MOST_CORRELATED
    ]
    for _, a, b in sorted(pairs, reverse=True)[:MOST_TOLD]:
        names = f"{found.parameters[a]} and {found.parameters[b]}"
        yield f"{names} are hardly told apart: correlation {correlation[a, b]:.4f}"


def as_json(found: Identification) -> bytes:
    """Write the numbers of a fit; deviations that are infinite are null."""
    deviations = found.standard_deviations
    content = {
        "scene": found.scene.name,
        "parameters": {
            name: {"before": b, "fitted": x, "deviation": finite(s)}
            for name, b, x, s in zip(
                found.parameters, found.before.tolist(), found.values.tolist(), deviations, strict=True
            )
        },
        "covariance": finite(found.covariance),
        "noise": found.noise,
        "misfit": found.misfit,
        "undetermined": list(found.undetermined),
        "stopped": found.stopped,
    }
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def finite(values: Array) -> object:
    """Return numbers as plain lists, None for those that are not finite."""
    if values.ndim:
        return [finite(each) for each in values]
    return float(values) if np.isfinite(values) else None
