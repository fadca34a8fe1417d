"""Evidence on which of two differing values is right: mechanics, the other side of the robot, and its shapes.

In: rows of differences, and both robot files with their alignment. Out: rows with `evidence`. The evidence
changes no verdict: a rule is silent unless one value fits clearly better than the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from crosscheck.differences.alignment import Alignment
from crosscheck.differences.difference import Difference, Evidence, Quantity, Side, Standing
from crosscheck.differences.shape_evidence import Bodies, shape_evidence
from crosscheck.differences.twins import Twins
from newton_euler.model.mechanism import REALISABLE_TOLERANCE
from newton_euler.reading.robot import Robot, RobotFile

NO_MASS = 1e-9
"""kg, mass below which a body counts as one whose mass the file does not tell."""

MAX_UNCERTAINTY = 1e-3
"""Largest relative uncertainty of moments of inertia; that of a difference from moments of 0 is unlimited."""


def with_evidence(
    rows: Sequence[Difference], files: tuple[RobotFile, RobotFile], alignment: Alignment
) -> list[Difference]:
    """Return rows with evidence; only true differences have some.

    Args:
        rows: rows of differences.
        files: both files.
        alignment: their pairs of bodies and joints.
    """
    robots = files[0].robot, files[1].robot
    twins = Twins(robots, alignment)
    different = [row for row in rows if row.standing is Standing.DIFFERENT]
    bodies = [_bodies(robots, alignment, row) for row in different]
    of_shapes = shape_evidence(files, [*zip(different, bodies, strict=True)])
    found = {
        id(row): (*_of_mechanics(row, robots, of_row), *twins.evidence(row, of_row), *by_shape)
        for row, of_row, by_shape in zip(different, bodies, of_shapes, strict=True)
    }
    return [replace(row, evidence=found.get(id(row), ())) for row in rows]


def _bodies(robots: tuple[Robot, Robot], alignment: Alignment, row: Difference) -> Bodies | None:
    """Return the indices, in each robot, of the bodies that a row is about, fixed to each other.

    If both files have the same parts, a row is about one part. None for a row about another element.
    """
    for pair in alignment.bodies if row.element_kind == "body" else ():
        first, second = (
            {robot.bodies[k].name: k for k in bodies}
            for robot, bodies in zip(robots, (pair.first, pair.second), strict=True)
        )
        if row.element in first:
            if first.keys() == second.keys():
                return (first[row.element],), (second[row.element],)
            return pair.first, pair.second
    return None


def _of_mechanics(row: Difference, robots: tuple[Robot, Robot], bodies: Bodies | None) -> Iterator[Evidence]:
    """Yield evidence by principal moments that no rigid body has.

    Args:
        row: a true difference.
        robots: both robots.
        bodies: indices of the bodies that the row is about; None for other elements.
    """
    if row.quantity is not Quantity.INERTIA or bodies is None:
        return
    masses = [sum(robot.bodies[k].mass for k in own) for robot, own in zip(robots, bodies, strict=True)]
    if min(masses) < NO_MASS:
        return
    values = [value if isinstance(value, tuple) else () for value in (row.first, row.second)]
    slack = (
        (REALISABLE_TOLERANCE + min(row.uncertainty, MAX_UNCERTAINTY)) * max(map(max, values))
        if all(values)
        else 0.0
    )
    problems = [_impossible(value, slack) if value else "" for value in values]
    if all(problems):
        yield Evidence(Side.NEITHER, f"no rigid body has these inertias: {' and '.join(problems)}")
    elif problems[0]:
        yield Evidence(Side.SECOND, f"no rigid body has the first inertia: {problems[0]}")
    elif problems[1]:
        yield Evidence(Side.FIRST, f"no rigid body has the second inertia: {problems[1]}")


def _impossible(moments: tuple[float, ...], slack: float) -> str:
    """Return the inequality that principal moments, kg m^2, violate beyond their digits; "" if none.

    Args:
        moments: the moments, smallest first.
        slack: uncertainty of the moments by their digits and by round-off, kg m^2.
    """
    a, b, c = moments
    if c <= slack:
        return "all moments are 0"
    if a < -slack:
        return f"the smallest moment is {a:.4g} kg m^2"
    return f"{a:.4g} + {b:.4g} < {c:.4g} kg m^2" if a + b < c - slack else ""
