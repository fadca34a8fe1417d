"""Tables of a solar tracker's day: forces of actuators, pointing errors, blocked directions, joint loads."""

from __future__ import annotations

import numpy as np

from crosscheck.report.table import Cell, Column, Rows, Table, number_columns, text_columns
from crosscheck.solar.day import Day
from crosscheck.solar.obstacles import Cause, Checks
from crosscheck.solar.place import angles
from newton_euler.scalars import Array

NEGLIGIBLE_ERROR = 5e-5
"""Largest pointing error, degrees, that is printed as 0.0000: causes below it have no row."""


def actuators_table(day: Day) -> Table:
    """Tabulate forces of actuators at rest and in motion with their times, largest speeds and powers, and
    energies."""
    rows: Rows = []
    for name, actuator in day.actuators.items():
        row: list[str | Cell] = [name]
        for forces in (actuator.holding, actuator.moving):
            k = largest_at(forces)
            row += ["", ""] if k is None else [f"{abs(forces[k]):.4g}", f"{day.sun.times[k]:%H:%M}"]
        speed, power = (float(np.max(np.abs(values))) for values in (actuator.speed, actuator.power))
        rows.append(
            [
                *row,
                actuator.unit,
                f"{day.scale(name)[0] * speed:.3g}",
                f"{1e3 * power:.3g}",
                f"{actuator.energy:.3g}",
            ]
        )
    columns = [
        *text_columns("actuator"),
        *number_columns("holding"),
        *text_columns("at"),
        *number_columns("moving"),
        *text_columns("at", "unit"),
        *number_columns("speed\n" + " or ".join(speed_units(day)), "power\nmW", "energy\nJ"),
    ]
    return Table("largest forces of actuators at rest and in motion", columns, rows)


def speed_units(day: Day) -> list[str]:
    """Return the units of the speeds of actuators, those of their set-points per second."""
    return sorted({f"{day.scale(name)[1]}/s" for name in day.set_points})


def largest_at(forces: Array) -> int | None:
    """Return the index of the largest magnitude of forces (n,), some of which are NaN; None if all are."""
    return None if np.isnan(forces).all() else int(np.nanargmax(np.abs(forces)))


def error_table(day: Day) -> Table:
    """Tabulate the pointing error while the panel faces the sun, and its parts by cause."""
    rows: Rows = []
    for name, part in {"total": day.errors, **day.error_parts}.items():
        values = np.degrees(part[day.faces])
        if len(values) and (not rows or values.max() > NEGLIGIBLE_ERROR):
            k = np.flatnonzero(day.faces)[np.argmax(values)]
            rows.append([name, f"{values.max():.4f}", f"{day.sun.times[k]:%H:%M}", f"{values.mean():.4f}"])
    columns = [
        *text_columns("cause"),
        *number_columns("maximum, deg"),
        *text_columns("at"),
        *number_columns("mean, deg"),
    ]
    if not rows:
        rows.append(["the panel never may", "", "", ""])
    return Table("pointing error just before each set-point, while the panel may face the sun", columns, rows)


def joints_table(day: Day) -> Table:
    """Tabulate the largest static reaction forces of joints over the day, and when they occur."""
    reactions = np.linalg.norm(day.loads.reaction_force, axis=2)  # (n, joints) at the set-points
    rows: Rows = []
    for name, force in zip(day.loads.joint_names, reactions.T, strict=True):
        k = int(np.argmax(force))
        rows.append([name, f"{force[k]:.3f}", f"{np.min(force):.3f}", f"{day.sun.times[k]:%H:%M}"])
    columns = [*text_columns("joint"), *number_columns("maximum, N", "minimum, N"), Column("maximum at")]
    return Table("forces of joints at rest, weight alone", columns, rows)


def obstacles_table(day: Day) -> Table:
    """Tabulate the wanted directions that are blocked, by cause, and long moves that are.

    A row of directions has the minutes with the first and last time, the bodies that come closest if the
    wanted direction is faced, their clearance, the distance from singular configurations, and the largest
    angle between the wanted direction and the one that is faced instead.
    """
    faced = day.faced
    rows: Rows = []
    turned = np.degrees(angles(faced.directions, day.wanted))
    for cause in Cause:
        which = np.flatnonzero(faced.wanted_checks.cause == cause)
        if cause != Cause.FREE and len(which):
            times = day.sun.times[which[[0, -1]]]
            start_and_end = [f"{time:%H:%M}" for time in times]
            minutes = f"{len(which) * day.period / 60.0:g}"
            worst = worst_of(day, faced.wanted_checks.rows(which))
            rows.append([cause.text, minutes, *start_and_end, *worst, f"{turned[which].max():.2f}"])
    for begin, *each in zip(day.ways.begin, *day.ways.checks, strict=True):
        checks = Checks(*(np.array([value]) for value in each))
        if checks.cause[0] != Cause.FREE:
            time = f"{day.sun.times[int(begin // day.period)]:%H:%M}"
            rows.append([f"move: {Cause(checks.cause[0]).text}", "", time, "", *worst_of(day, checks), ""])
    columns = [
        *text_columns("cause"),
        *number_columns("minutes"),
        *text_columns("from", "to", "closest bodies"),
        *number_columns("clearance\nmm", "to\nsingular", "turned\ndeg"),
    ]
    return Table("blocked directions, and the turn to the nearest free ones", columns, rows)


def worst_of(day: Day, checks: Checks) -> list[str]:
    """Return the closest bodies of poses, their clearance in mm, and the distance from singular poses."""
    k, names = int(np.argmin(checks.clearance)), day.scene.mechanism.body_names
    distance = f"{np.min(checks.to_singular):.3f}"
    if np.isinf(checks.clearance[k]):
        return ["", "", distance]
    bodies = ", ".join(names[body] for body in checks.bodies[k])
    return [bodies, f"{1e3 * checks.clearance[k]:.1f}", distance]
