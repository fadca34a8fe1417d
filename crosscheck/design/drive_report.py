"""Report on drives: what each actuator must supply, and how the drives of a catalog suit it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from crosscheck.compare.outcome import Verdict
from crosscheck.report.chart import BarChart, Measure, log_chart
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
from newton_euler.analysis.loads.actuator_motions import ActuatorMotion, Demand, demand
from newton_euler.analysis.loads.drives import Drive, Sized
from newton_euler.errors import listed

MOTOR_LIMITS = ("motor speed", "peak torque", "rms torque")
"""Limits that each drive has; their margins have columns in the report."""

LEAST_MARGIN = -9.99
"""Margin, a fraction, below which the report gives no number."""

ROUND_OFF = 1e-9
"""Powers and works below this fraction of the largest of an actuator are printed as 0."""

HOLDING = "holding"
"""Name of the requirement that the drive holds its load with the motor off."""


class Requirements(NamedTuple):
    """Requirements of the user.

    Attributes:
        margin: least margin to each limit, a fraction.
        must_hold: True if the drive must hold its load with the motor off.
    """

    margin: float = 0.0
    must_hold: bool = False

    def failing(self, sized: Sized) -> str:
        """Return why a drive does not suit an actuator: the first limit that it exceeds; "" if it does."""
        if sized.mismatch:
            return sized.mismatch
        limit = sized.failing(self.margin)
        if limit:
            return limit.name
        return HOLDING if self.must_hold and not sized.holds else ""

    @property
    def text(self) -> str:
        """Requirements in a sentence."""
        margin = (
            f"a margin of {100.0 * self.margin:g} % to each limit" if self.margin else "no margin to limits"
        )
        holding = "the load is held" if self.must_hold else "the load need not be held"
        return f"required: {margin} (--margin); {holding} with the motor off (--must-hold)"


@dataclass(frozen=True, eq=False)
class DriveResults:
    """Drives of a catalog, compared with the motion of each actuator.

    Attributes:
        name: name of the scene or motion.
        catalog: path of the catalog.
        motions: force and motion of each actuator.
        drives: drives of the catalog.
        sized: drive and actuator compared, by name of the drive and name of the actuator.
        requirements: requirements of the user.
        conditions: sentences on what the motion and its forces are.
        notes: sentences on the run.
    """

    name: str
    catalog: str
    motions: Sequence[ActuatorMotion]
    drives: Sequence[Drive]
    sized: Mapping[tuple[str, str], Sized]
    requirements: Requirements
    conditions: Sequence[str] = ()
    notes: Sequence[str] = ()

    @cached_property
    def demands(self) -> dict[str, Demand]:
        """Forces, speeds, powers and works that each actuator must supply, by its name."""
        return {motion.name: demand(motion) for motion in self.motions}

    def suitable(self, actuator: str) -> list[Sized]:
        """Return the drives that suit an actuator: first the one with the least energy, last those without
        a known energy."""
        found = [self.sized[drive.name, actuator] for drive in self.drives]
        suits = [each for each in found if not self.requirements.failing(each)]
        return sorted(suits, key=lambda each: float("inf") if each.energy is None else each.energy)

    @property
    def unserved(self) -> list[str]:
        """Names of the actuators that no drive suits."""
        return [motion.name for motion in self.motions if not self.suitable(motion.name)]


def drive_report(found: DriveResults) -> Report:
    """Make the report on drives: a table of demands, and a table of drives for each actuator."""
    count = len(found.drives)
    title = f"{found.name}: {count} drive{'s' * (count != 1)} of {found.catalog}"
    unserved = found.unserved
    verdict = "each actuator has a suitable drive"
    if unserved:
        verdict = (
            f"no drive suits {listed(unserved)}; needed: other drives in the catalog, or a smaller --margin"
        )
    judged = Cell("", "fails" if unserved else "holds")
    summary: list[Part] = [_forces(found), _powers(found)]
    summary += [_drives(found, motion) for motion in found.motions]
    summary.append(Lines("", [_choice(found, motion.name) for motion in found.motions]))
    friction = "friction of motors, gearboxes and screws: efficiencies and friction_torque of the catalog"
    summary.append(Lines("Conditions", [*found.conditions, friction, found.requirements.text]))
    if found.notes:
        summary.append(Lines("", list(found.notes)))
    in_full: list[Part] = [_limits(found, motion) for motion in found.motions]
    return Report(
        title,
        verdict,
        judged,
        in_full,
        summary=summary,
        charts=[chart for motion in found.motions for chart in _margin_chart(found, motion)],
        captions={"drives.png": "Torque of each motor over time, and its limits of force and speed"},
        next_steps=_next_steps(found),
    )


def _margin_chart(found: DriveResults, motion: ActuatorMotion) -> list[BarChart]:
    """Make the chart of the most loaded limit of each drive for an actuator."""
    measures = []
    for drive in found.drives:
        sized = found.sized[drive.name, motion.name]
        if sized.mismatch or not sized.limits:
            continue
        needed = 1.0 - min(limit.margin for limit in sized.limits)
        judged: Verdict = "fails" if found.requirements.failing(sized) else "holds"
        measures.append(Measure(drive.name, 100.0 * needed, f"{100.0 * needed:.0f} %", 100.0, judged))
    caption = "Load of each drive at its most loaded limit, in % of the limit, which is the mark"
    return log_chart(f"Drives for {motion.name}", caption, measures, "%")


def _next_steps(found: DriveResults) -> list[str]:
    """List what the reader can do with the comparison."""
    steps = []
    if found.unserved:
        steps.append(
            f"Add larger drives for {listed(found.unserved)} to {found.catalog}, or slow the motion down. "
            "The column `verdict` names the first limit that fails."
        )
    if any(found.suitable(motion.name) for motion in found.motions):
        steps.append("Choose among the drives that suit; the notes name the one with the least energy.")
    return [
        *steps,
        "Require a margin with `--margin`, and holding without power with `--must-hold`.",
    ]


def _choice(found: DriveResults, actuator: str) -> str:
    """State how many drives suit an actuator, and which one needs the least energy."""
    suits = found.suitable(actuator)
    count = f"{actuator}: {len(suits)} of {len(found.drives)} drives suit"
    if not suits or suits[0].energy is None:
        return count
    best = suits[0]
    return f"{count}; {best.drive.name!r} needs the least energy, {best.energy:.3g} J"


def _forces(found: DriveResults) -> Table:
    """Tabulate forces and speeds that the actuators must supply."""
    rows: Rows = []
    for motion in found.motions:
        each = found.demands[motion.name]
        force, length = ("N", "m") if motion.is_slide else ("N m", "rad")
        holding = "-" if each.holding_force is None else f"{each.holding_force:.3g} {force}"
        rows.append(
            [
                motion.name,
                f"{each.peak_force:.3g} {force}",
                f"{each.peak_time:.5g}",
                f"{each.rms_force:.3g} {force}",
                holding,
                f"{each.peak_speed:.3g} {length}/s",
                f"{each.stroke:.3g} {length}",
            ]
        )
    columns = number_columns("peak force", "at, s", "rms", "at rest", "speed", "stroke")
    return Table("What the actuators must supply", [*text_columns("actuator"), *columns], rows)


def _powers(found: DriveResults) -> Table:
    """Tabulate power and work that the actuators must supply."""
    rows: Rows = []
    for name, each in found.demands.items():
        powers = (each.peak_power, each.braking_power, each.mean_power, each.work, each.braking_work)
        negligible = ROUND_OFF * max(powers)
        texts = [f"{value if value > negligible else 0.0:.3g}" for value in powers]
        rows.append([name, *texts, f"{100.0 * each.duty:.3g}"])
    columns = number_columns("power, W", "braking, W", "mean, W", "work, J", "braking, J", "duty, %")
    return Table("", [*text_columns("actuator"), *columns], rows)


def _drives(found: DriveResults, motion: ActuatorMotion) -> Table:
    """Tabulate the drives for an actuator: margins, energy, holding, and the first limit that fails."""
    rows: Rows = []
    for drive in found.drives:
        sized = found.sized[drive.name, motion.name]
        failing = found.requirements.failing(sized)
        verdict = Cell(failing, "fails") if failing else Cell("nothing", "holds")
        if sized.mismatch:
            rows.append([drive.name, "", "", "", "", "", verdict])
            continue
        margins = {limit.name: _percent(limit.margin) for limit in sized.limits}
        energy = "" if sized.energy is None else f"{sized.energy:.3g}"
        holding = "locks" if drive.is_self_locking else "friction" if sized.holds else "no"
        rows.append([drive.name, *(margins[name] for name in MOTOR_LIMITS), energy, holding, verdict])
    columns = [
        Column("drive"),
        *number_columns("speed, %", "peak, %", "rms, %", "energy, J"),
        *text_columns("holds", "fails at"),
    ]
    return Table(f"{motion.name}: margins of speed, peak torque and rms torque", columns, rows)


def _limits(found: DriveResults, motion: ActuatorMotion) -> Table:
    """Tabulate all limits of all drives for an actuator."""
    rows: Rows = []
    for drive in found.drives:
        for limit in found.sized[drive.name, motion.name].limits:
            is_met = limit.margin >= found.requirements.margin
            margin = Cell(_percent(limit.margin), "holds" if is_met else "fails")
            values = [f"{value:.4g}" for value in (limit.needed, limit.allowed)]
            rows.append([drive.name, limit.name, *values, limit.unit, margin])
    columns = [
        *text_columns("drive", "limit"),
        *number_columns("needed", "allowed"),
        *text_columns("unit"),
        *number_columns("margin, %"),
    ]
    return Table(f"{motion.name}: all limits", columns, rows)


def _percent(margin: float) -> str:
    """Format a margin in percent."""
    return f"{100.0 * margin:.0f}" if margin > LEAST_MARGIN else f"< {100.0 * LEAST_MARGIN:.0f}"
