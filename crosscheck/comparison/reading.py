"""The level before all others: equations of motion of each engine against the model file's own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from crosscheck.comparison.figure import FILE, LEVELS, Figure
from crosscheck.engines import Engine
from newton_euler.verification.import_report import ImportReport
from newton_euler.verification.verify import verify


def reading_rows(engines: Sequence[Engine], report: ImportReport | None) -> Iterator[Figure]:
    """Figures of `newton_euler.verification.verify` for each engine; none for a scene that is from no file.

    Of the scene as the file says and with controls at random the one that is worst for its tolerance.
    """
    for engine in engines if report else ():
        found: dict[str, Figure] = {}
        for original, scene in report.originals if report else ():
            for quantity, value, tolerance, where in verify(original, engine.systems(scene)[0]):
                row = Figure(LEVELS[0], quantity, (engine.name, FILE), value, tolerance, where)
                known = found.setdefault(quantity, row)
                if not value / tolerance <= known.value / known.tolerance:
                    found[quantity] = row
        yield from found.values()
