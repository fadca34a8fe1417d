"""Report on a solar tracker's day, or on days at several places and dates: tables, plots and files.

A `Day` is a simulated day of a tracker, a mechanism whose controllers follow set-points so that its panel
faces the sun. `day.light` is the irradiation of panels in W h/m^2, by name. `THIS` is the tracker's panel,
`FIXED` is fixed at the latitude's tilt, `ONE_AXIS` turns about a horizontal north-south axis, and `FACING`
always faces the sun. `day.faces` is True while no limit of tilt or reach, no shadow and no wind keeps the
tracker's panel from facing the sun.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

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
from crosscheck.solar.day import MAX_DEVIATION, Day
from crosscheck.solar.energy import FACING, FIXED, ONE_AXIS, THIS
from crosscheck.solar.place import angles
from crosscheck.solar.reach import Reach, reach_table
from crosscheck.solar.tables import (
    actuators_table,
    error_table,
    joints_table,
    largest_at,
    obstacles_table,
)
from newton_euler.model.euler_parameters import rotation
from newton_euler.scalars import Array

MAX_PRINTED_HOURS = 9
"""Largest number of rows of the table of a day in the terminal, so that the report has about 25 lines."""

SURVEY_HEADINGS = (
    "on sun\nh",
    "off\ndeg",
    "fixed\nkWh/m^2",
    "this\n%",
    "1 axis\n%",
    "facing\n%",
    "energy\nmWh",
)
"""Headings of the columns of a survey, the table of several days.

They are: hours in which the panel faces the sun, largest pointing error in these hours, irradiation of a
fixed panel, gains of this tracker and of other panels over the fixed one, and energy of the actuators.
"""

DAY_FILES = ("sun.json", "set_points.csv", "motion.csv", "day.png", "day.rrd")
"""Names of the files of one day: summary, set-points, motion of the actuators, plots and recording."""

REACH_FILES = ("reach.csv", "reach.png")
"""Names of the files of the positions of the sun over a year, in addition to those of a day."""

SURVEY_FILES = ("sun.json", "days.csv")
"""Names of the files of several days: summaries and table."""


def hours(day: Day) -> Iterator[list[str | Cell]]:
    """Yield a table row for each whole hour in which the sun is up.

    A row has the time, azimuth and elevation of the sun, set-points in the units of `Day.scale`, tilt of the
    panel, angle between the panel's normal and the sun, and the wind speed if there is wind.
    """
    factors = {name: day.scale(name)[0] for name in day.set_points}
    is_whole_hour = (day.sun.times.minute == 0) & (day.sun.times.second == 0)
    for k in np.flatnonzero(is_whole_hour & day.sun.is_up):
        yield [
            f"{day.sun.times[k]:%H:%M}",
            f"{np.degrees(day.sun.azimuth[k]):.1f}",
            f"{np.degrees(day.sun.elevation[k]):.1f}",
            *(f"{factors[name] * values[k]:.2f}" for name, values in day.set_points.items()),
            f"{np.degrees(np.arccos(np.clip(day.normals[k, 2], -1.0, 1.0))):.1f}",
            f"{np.degrees(day.errors[k]):.2f}",
            *([] if day.wind is None else [f"{day.wind[k]:.1f}"]),
        ]


def day_report(day: Day, reach: Reach | None = None) -> Report:
    """Report on one day: sun, set-points, irradiation, forces of actuators, and pointing error.

    `reach` has the positions of the sun over the year, if they were computed.
    """
    # Table of the hours: all hours, or (in the terminal) every second or third one. A set-point is named
    # after its joint
    units = {"azimuth": "deg", "elevation": "deg"}
    units |= {name: day.scale(name)[1] for name in day.set_points}
    units |= {"tilt": "deg", "off sun": "deg"} | ({} if day.wind is None else {"wind": "m/s"})
    columns = [
        *text_columns("time"),
        *(Column(f"{name}\n{unit}", numeric=True) for name, unit in units.items()),
    ]
    rows: Rows = list(hours(day))
    step = -(-len(rows) // MAX_PRINTED_HOURS) or 1  # rounded up
    hours_table, short_table = (
        Table("sun, set-points and panel", columns, chosen) for chosen in (rows, rows[::step])
    )
    # Irradiation, loads and assumptions
    irradiation_table = Table(
        "clear sky over the day",
        [*text_columns("panel"), *number_columns("kWh/m^2", "of fixed, %")],
        [
            [name, f"{1e-3 * value:.3f}", f"{100.0 * value / day.light[FIXED]:.1f}"]
            for name, value in day.light.items()
        ],
    )
    obstacles = obstacles_table(day)
    common: list[Part] = [irradiation_table, actuators_table(day), error_table(day)]
    common += [obstacles] if obstacles.rows else []
    common += [reach_table(reach)] if reach else []
    lines = Lines("assumptions", list(assumptions(day)))
    parts: list[Part] = [hours_table, *common, joints_table(day), lines]
    summary: list[Part] = [short_table, *common]
    title = f"{day.scene.name} on {day.sun.times[0]:%Y-%m-%d} at {day.place} ({day.sun.times.tz})"
    judged = Cell("not followed", "fails") if day.off_set_points.any() else Cell("followed", "holds")
    light = [
        Measure(name, value, f"{1e-3 * value:.2f} kWh/m^2, {100.0 * value / day.light[FIXED]:.0f} %")
        for name, value in day.light.items()
    ]
    caption = "Irradiation of the day by clear sky, in kWh/m^2 and in % of a fixed panel"
    return Report(
        title,
        verdict(day),
        judged,
        parts,
        day.run.wall_time,
        summary,
        charts=linear_chart("Light on the panel", caption, light),
        captions={
            "day.png": "Elevations, pointing errors, set-points, forces of actuators, and light over the day",
            "reach.png": "Positions of the sun over the year that the panel can face, by azimuth and tilt",
        },
        next_steps=_next_steps(day),
    )


def _next_steps(day: Day) -> list[str]:
    """List what the reader can do with the day."""
    steps = []
    if day.off_set_points.any():
        steps.append("Increase the gains, shorten the moves, or stow the panel in weaker wind (`--stow`).")
    if day.faced.replaced.any():
        steps.append("Free the blocked directions by another clearance or shape; the details list bodies.")
    return [
        *steps,
        "Send `set_points.csv` to the actuators; the assumptions describe the pose of zero set-points.",
        "Choose the drives: `motion.csv` is the input of `crosscheck drives`.",
    ]


def verdict(day: Day) -> str:
    """Report in one sentence how well the panel followed the sun."""
    faces = day.faces
    best = "faces the sun" if not day.has_one_axis else "comes as near to the sun as one axis allows"
    text = f"{best} for {day.hours(faces):.1f} h"
    if faces.any():
        text += f", within {np.degrees(np.max(day.errors[faces])):.2f} deg"
    limited_hours = day.hours(day.sun.is_up & ~faces & ~day.stowed & ~day.faced.replaced)
    if limited_hours > 0.0:
        max_tilt = f"{day.tracking.max_tilt:g} deg"
        text += f"; for {limited_hours:.1f} h points as close to the sun as a tilt of {max_tilt} allows"
    if day.wind is not None and np.isfinite(day.tracking.stow):
        flat = day.sun.is_up & day.stowed
        flat_hours = day.hours(flat)
        text += f"; lies flat for {flat_hours:.1f} h of daylight, in winds from {day.tracking.stow:g} m/s on"
        if day.wind_acts and not day.wind_up and flat.any() and day.is_level[flat].all():
            text += ", without a load: the wind is horizontal (--wind-up)"
    if day.off_set_points.any():
        text += f"; {deviation_text(day)}"
    if day.faced.replaced.any():
        text += f"; {obstacles_text(day)}"
    return f"{text}; {forces_text(day)}"


def deviation_text(day: Day) -> str:
    """Report in a clause how far and how long the panel is off its set-points."""
    deviations = np.where(day.off_set_points, day.error_parts["motion, control and wind load"], 0.0)
    k = int(np.argmax(deviations))
    return (
        f"for {day.hours(day.off_set_points):.1f} h it is more than {np.degrees(MAX_DEVIATION):g} deg off "
        f"its set-points, up to {np.degrees(deviations[k]):.1f} deg at {day.sun.times[k]:%H:%M}: gains are "
        "too small, moves too long, or the wind turns the panel over"
    )


def obstacles_text(day: Day) -> str:
    """Report in a clause how long wanted directions are blocked, and what is lost."""
    faced, minutes = day.faced, f"{np.sum(day.faced.replaced) * day.period / 60.0:g} min"
    if not faced.obstacles.can_avoid:
        return f"the wanted direction is blocked for {minutes}, and so is the flat panel: nothing is avoided"
    turned = np.degrees(angles(faced.directions, day.wanted).max())
    lost = f"loses {1e-3 * day.lost_light:.3f} kWh/m^2"
    return (
        f"for {minutes} the wanted direction is blocked, and the nearest free one, up to {turned:.1f} deg "
        f"beside it, {lost}"
    )


def forces_text(day: Day) -> str:
    """Report in a clause the largest forces of actuators at rest and in motion."""
    clauses = []
    for unit in sorted({actuator.unit for actuator in day.actuators.values()}):
        chosen = [actuator for actuator in day.actuators.values() if actuator.unit == unit]
        holding, moving = (
            max((abs(each[k]) for each in forces if (k := largest_at(each)) is not None), default=0.0)
            for forces in ([each.holding for each in chosen], [each.moving for each in chosen])
        )
        clauses.append(f"{holding:.4g} {unit} at rest and {moving:.4g} {unit} in motion")
    energy = sum(actuator.energy for actuator in day.actuators.values())
    return f"actuators need up to {', '.join(clauses)}, and {energy / 3.6:.3g} mWh of energy"


def assumptions(day: Day) -> Iterator[str]:
    """Yield the assumptions of the report, one sentence each."""
    if day.base.motions:
        east, north, up = (
            ", ".join(f"{round(x, 3) + 0.0:g}" for x in each) for each in day.base.rotation_at_rest()
        )
        yield (
            f"east, north and up are ({east}), ({north}) and ({up}) in the axes of the base, to which tilts "
            "and the zenith of a flat panel refer"
        )
    else:
        yield "x is east, y north, z up"
    yield "sun by NREL's algorithm, refraction at 12 degrees Celsius included"
    yield (
        f"set-points every {day.period:g} s, held by PD laws with the weight fed forward; tilt at most "
        f"{day.tracking.max_tilt:g} degrees; dead band {day.tracking.deadband:g} degrees"
    )
    yield from zeros(day)
    yield (
        f"between set-points the speed is a trapezoid of at most {day.tracking.speed:g} m/s or rad/s and "
        f"{day.tracking.acceleration:g} m/s^2 or rad/s^2, the same start and end for all actuators"
    )
    yield (
        f"blocked: bodies without a common joint nearer than {1e3 * day.tracking.clearance:g} mm, a distance "
        f"from singular configurations below {day.tracking.to_singular:g}, and what is beyond such a one"
    )
    yield from day.faced.obstacles.notes
    wind = "no wind"
    if day.wind is not None:
        panel = f"the box of {day.axis.body!r}" if day.wind_acts else "no box: there is no load"
        upward = f", {day.wind_up:g} of its speed upward" if day.wind_up else ", horizontal"
        wind = f"wind acts on {panel}{upward}, and each speed lasts until the next set-point"
    yield f"at night the panel waits in the position of the next morning; the base is fixed; {wind}"
    yield "clear sky (Ineichen, pvlib's turbidity), diffuse light of Hay and Davies, ground of albedo 0.2"
    friction = "friction as in the scene" if day.scene.switched_forces else "no friction"
    yield f"energy of actuators is their positive mechanical work; no recuperation, {friction}"


def zeros(day: Day) -> Iterator[str]:
    """Yield sentences on the pose in which each set-point is 0, for homing.

    It is the pose in which the scene is described; of an MJCF file that of its keyframe. A center of mass on
    the axis of a hinge does not determine its angle, so that each sentence has the normal of the face, too.
    """
    mechanism = day.scene.mechanism
    normal = _listed(rotation(mechanism.body(day.axis.body).quaternion) @ day.axis.axis, 5)
    for (name, (driven, coordinate)), (follower, _) in zip(day.keys.items(), day.geared.keys, strict=True):
        motions = mechanism.joint(driven).motions
        axis = [motion.axis for motion in motions if motion.kind != "ball"][coordinate]
        direction = _listed(axis / np.linalg.norm(axis), 6)
        body = mechanism.body(mechanism.joint(follower).second)
        x, y, z = (f"{1e3 * value:.1f}" for value in body.center_of_mass)
        way = "along" if day.is_slide(name) else "about"
        yield (
            f"zero of {name} is the pose in which the scene is described (of an MJCF file: that of its "
            f"keyframe), with the normal of the face {normal} and the center of mass of {body.name!r} at "
            f"({x}, {y}, {z}) mm; positive {way} {direction}"
        )


def _listed(vector: Array, digits: int) -> str:
    """Format a vector (3,) with rounded components."""
    return "(" + ", ".join(f"{round(x, digits) + 0.0:g}" for x in vector) + ")"


def survey_report(days: Sequence[Day]) -> Report:
    """Report on days at several places or dates, one row per day."""
    names = (THIS, ONE_AXIS, FACING)
    columns = [
        *text_columns("place", "date"),
        *(Column(name, numeric=True) for name in SURVEY_HEADINGS),
    ]
    rows: Rows = [
        [
            str(day.place),
            f"{day.sun.times[0]:%Y-%m-%d}",
            f"{day.hours(day.faces):.1f}",
            f"{np.degrees(np.max(day.errors[day.faces], initial=0.0)):.2f}",
            f"{1e-3 * day.light[FIXED]:.2f}",
            *(f"{100.0 * day.light[name] / day.light[FIXED] - 100.0:+.1f}" for name in names),
            f"{sum(actuator.energy for actuator in day.actuators.values()) / 3.6:.2g}",
        ]
        for day in days
    ]
    gains = [100.0 * day.light[FACING] / day.light[FIXED] - 100.0 for day in days]
    parts: list[Part] = [
        Table("days of clear sky, gains over a panel fixed at the latitude's tilt", columns, rows),
        Lines("assumptions", list(assumptions(days[0]))),
    ]
    return Report(
        f"{days[0].scene.name} over {len(days)} days",
        f"always facing the sun gains {min(gains):.0f} to {max(gains):.0f} % over a fixed panel",
        Cell("followed", verdict="holds"),
        parts,
        summary=parts,
        charts=linear_chart(
            "Gain by facing the sun",
            "Gain over a fixed panel at the latitude's tilt, in %",
            [
                Measure(f"{day.place}, {day.sun.times[0]:%Y-%m-%d}", max(gain, 0.0), f"{gain:.0f} %")
                for day, gain in zip(days, gains, strict=True)
            ],
        ),
        next_steps=["For a sum over all days and the weather of a place, run `crosscheck year`."],
    )
