"""Tables and files of parameters that were fitted to measured motion."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import combinations

import numpy as np

from crosscheck.report.table import Column, Lines, Part, Rows, Table, figures, texts
from newton_euler.analysis.identification import Identification
from newton_euler.scalars import Array

MOST_CORRELATED = 0.99
"""Correlation of two parameters that is told."""

MOST_TOLD = 5
"""Pairs of such parameters, the most correlated first."""


def headline(found: Identification) -> str:
    """Say what was fitted to what."""
    numbers = sum(len(column) for run in found.residuals for column in run.values())
    runs = f"{len(found.residuals)} run{'s' * (len(found.residuals) != 1)}"
    fitted = f"{len(found.parameters)} parameter{'s' * (len(found.parameters) != 1)}"
    return f"{found.scene.name}: {fitted} fitted to {numbers:,} numbers of {runs}"


def parts(found: Identification) -> list[Part]:
    """Return tables of parameters and columns, and what is to be known about them."""
    heads, *rows = found.table
    names = [*texts(*heads[:2]), *figures(*heads[2:])]
    tables: list[Part] = [Table("", names, [list(row) for row in rows]), _columns(found)]
    return [*tables, Lines("", [found.fit, *found.doubts, *found.notes, *_correlated(found)])]


def _columns(found: Identification) -> Table:
    """Return a table of measured columns: noise and residuals."""
    rows: Rows = []
    for name, misfit in found.misfits.items():
        levels = [run[name] for run in found.noise if name in run]
        noise = " to ".join(dict.fromkeys(f"{level:.3g}" for level in (min(levels), max(levels))))
        residuals = np.concatenate([run[name] for run in found.residuals if name in run])
        rms, peak = np.sqrt(np.mean(residuals**2)), np.abs(residuals).max()
        rows.append([name, noise, f"{rms:.3g}", f"{peak:.3g}", f"{misfit:.3g}"])
    return Table("", [Column("measured"), *figures("noise", "residual", "largest", "by noise")], rows)


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
    """Write the numbers of a fit; what is not finite is null."""
    deviations = found.standard_deviations
    content = {
        "scene": found.scene.name,
        "parameters": {
            name: {"unit": unit, "before": b, "fitted": x, "deviation": finite(s)}
            for name, unit, b, x, s in zip(
                found.parameters,
                found.units,
                found.before.tolist(),
                found.values.tolist(),
                deviations,
                strict=True,
            )
        },
        "covariance": finite(found.covariance),
        "noise": found.noise,
        "misfit": found.misfit,
        "misfits": found.misfits,
        "degrees_of_freedom": found.degrees_of_freedom,
        "probability": finite(np.array(found.probability)),
        "is_wrong": found.is_wrong,
        "undetermined": list(found.undetermined),
        "stopped": found.stopped,
        "curvature": finite(np.array(found.curvature)),
    }
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def finite(values: Array) -> object:
    """Return numbers as plain lists, None for those that are not finite."""
    if values.ndim:
        return [finite(each) for each in values]
    return float(values) if np.isfinite(values) else None
