"""Tables of a crosscheck: which figure stands where, with its unit."""

from __future__ import annotations

from support.results import crosscheck_of

from crosscheck.compare.check import Check
from crosscheck.compare.reference_values import ReferenceCheck
from crosscheck.library.references import ReferenceValue
from crosscheck.report.run import tables


def test_reference_values_stand_beside_what_was_found():
    known = ReferenceValue(2.0, "angle", "rad", 0.25, 1e-9)
    offsets = (("a", 1e-9), ("b", 0.5))
    checks = [ReferenceCheck.of(name, known, 0.25 + off, 1e-8) for name, off in offsets]
    (table,) = tables(crosscheck_of(reference_checks=checks))
    assert [column.heading.replace("\n", " ") for column in table.columns] == [
        "",
        "value, a",
        "reference",
        "a",
        "b",
    ]
    ((heading, cells),) = table.sections()
    assert heading == "at 2 s"
    texts = [cell.text for cell in cells]
    assert texts == ["angle, rad", "0.250000001", "0.25", "1.0e-09 < 1e-08", "5.0e-01 > 1e-08"]
    assert [cell.verdict for cell in cells] == ["", "", "", "holds", "fails"]


def test_a_figure_stands_under_the_engines_that_it_is_of():
    def figure(between, value):
        return Check("model", "mass, rel", between, value, 1e-12, "rod")

    pair = figure(("newton_euler", "mujoco"), 1e-3)
    found = tables(
        crosscheck_of([pair, figure(("mujoco",), 2e-13), figure(("relative", "cartesian"), 3e-13)])
    )
    placed = {}
    for table in found:
        for _, (quantity, *cells) in table.sections():
            for column, cell in zip(table.columns[1:], cells, strict=True):
                placed[column.heading, quantity.text] = (cell.text, cell.verdict, cell.about)
    assert placed == {
        ("newton_euler\nmujoco", "mass, rel"): ("1.0e-03 > 1e-12", "fails", "worst at rod"),
        ("mujoco", "mass, rel"): ("2.0e-13 < 1e-12", "holds", "worst at rod"),
        ("relative\ncartesian", "mass, rel"): ("3.0e-13 < 1e-12", "holds", "worst at rod"),
    }
