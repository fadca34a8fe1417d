"""Report on design loads: tables of the loads of every case and of the envelope over all cases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from crosscheck.compare.activity import reduced_model_text
from crosscheck.design.load_cases import UNNAMED_CASE
from crosscheck.design.wind_validity import WindRange
from crosscheck.report.chart import Measure, linear_chart
from crosscheck.report.run import undetermined_lines
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
from newton_euler.analysis.loads.envelope import LoadEnvelope, LoadRange
from newton_euler.analysis.loads.rest import HeldWind
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportedElement

LOAD_ROUND_OFF = 1e-9
"""Loads below this fraction of the largest load and of the weight on Earth are printed as 0."""

STANDARD_GRAVITY = 9.81
"""m/s^2, rounded acceleration of gravity on Earth, for the weight that scales `LOAD_ROUND_OFF`."""

NOT_UNIQUE = "stiffness decides how these joints share loads: the tables show one solution of many"
"""Note on joints whose reactions redundant constraints leave undetermined."""

EXCITE = "; --set excitation=on moves joints of model files and drives their actuators"
"""Advice to the user if nothing moves in a model file."""

AT_REST = (
    "at rest: actuators hold the initial pose; control laws, velocities and accelerations do not act, and "
    "prescribed motions hold their values at time 0"
)
"""Note on the meaning of loads at rest."""

GOVERNS = "*"
"""Mark in front of the load of the case that governs: the largest in magnitude over all cases."""

GOVERNED_BY = Column("governed by", below=True)
"""Column of tables with the load case and time of the largest load; below the others on narrow screens."""

MAX_COORDINATES = 4
"""Largest number of joint coordinates in the sentence about the initial pose."""

LOAD_COMPONENTS = {"force": ("axial force", "shear force"), "torque": ("axial torque", "bending torque")}
"""Components of forces and torques along and across the axis, for joints with one axis, by quantity."""


class CoarsePeak(NamedTuple):
    """A joint whose peak force depends on the output period.

    Attributes:
        joint: name of the joint.
        excess: estimate of the relative excess of the force between outputs over its largest output.
    """

    joint: str
    excess: float


class CaseNotes(NamedTuple):
    """Facts about load cases that the report mentions, by the name of the case.

    Attributes:
        options: values of all options of each case that have an effect, given or by default.
        starts: coordinates of the initial pose that control laws act on, m or rad, with their units.
        motionless: names of cases in which nothing moves.
        held_winds: winds that vary in time and have a constant speed at rest.
        winds: flow on the plates of wind loads.
        acting: elements of the model file that would have acted and are not simulated.
        coarse: joints with peaks that the output period may cut off.
        singular: singular configurations of the run, in words.
        from_model_file: True for a model file, which has the option `excitation`.
    """

    options: Mapping[str, Mapping[str, str | float]]
    starts: Mapping[str, Mapping[str, tuple[float, str]]]
    motionless: Sequence[str]
    held_winds: Mapping[str, Sequence[HeldWind]]
    winds: Mapping[str, Sequence[WindRange]]
    acting: Mapping[str, Sequence[ImportedElement]]
    coarse: Mapping[str, CoarsePeak]
    singular: Mapping[str, str]
    from_model_file: bool


def load_report(
    scene: Scene,
    envelope: LoadEnvelope,
    envelopes: Mapping[str, LoadEnvelope],
    at_rest: bool,
    notes: CaseNotes,
) -> Report:
    """Make the report on design loads.

    Args:
        scene: scene of the first case.
        envelope: largest loads over all cases.
        envelopes: loads of each case.
        at_rest: True if the mechanism is held at rest.
        notes: further facts about the cases.
    """
    # Title, and verdict with the largest force
    named = envelope.cases != (UNNAMED_CASE,)
    cases = f"cases {', '.join(envelope.cases)}" if named else "initial pose" if at_rest else "its run"
    title = f"{scene.name}: loads {'at rest,' if at_rest else 'over'} {cases}"
    largest = max(_loads_of(envelope, "force"), key=lambda each: each.peak)
    negligible = negligible_force(scene, envelope)
    verdict = f"largest force {largest.peak:.3g} N at joint {largest.element!r}, {_when(largest, at_rest)}"
    if largest.peak <= negligible:
        verdict = "no joint carries a force"
    for case, entries in notes.acting.items():
        verdict += f"; {f'case {case}: ' if named else ''}{reduced_model_text(entries)}"
    if notes.acting:
        verdict = f"REDUCED MODEL: {verdict}"
    # Tables of all cases, then of the envelope
    tables = _Tables(envelope, at_rest, negligible, negligible * scene.mechanism.size)
    parts: list[Part] = list(_case_lines(notes, named, at_rest))
    if len(envelopes) > 1:
        parts.append(tables.of_cases("Peak force of every case", "force", "N", envelopes))
        parts.append(tables.of_cases("Peak torque of every case", "torque", "N m", envelopes))
        if envelope.actuators:
            parts.append(tables.of_cases("Peak actuator load of every case", "actuator force", "", envelopes))
        parts.append(Lines("", [f"{GOVERNS} the case that governs"]))
    over_all = "Envelope: " if len(envelopes) > 1 else ""
    parts.append(tables.of_joints(f"{over_all}forces of joints" if over_all else "", "force", "N"))
    parts.append(tables.of_joints(f"{over_all}torques of joints" if over_all else "", "torque", "N m"))
    if envelope.actuators:
        parts.append(tables.of_actuators(f"{over_all}actuators" if over_all else ""))
    # Notes
    if notes.motionless:
        where = f"cases {', '.join(notes.motionless)}" if named else "the run"
        advice = EXCITE if notes.from_model_file else ""
        parts.append(Lines("", [f"nothing moves in {where}: these are loads at rest{advice}"]))
    if notes.coarse:
        joint, excess = max(notes.coarse.values(), key=lambda each: each.excess)
        larger = f"the force of {joint!r} is about {100.0 * excess:.2g} % larger between outputs"
        warning = f"outputs are too far apart for the peaks: {larger}; use a shorter output_period"
        parts.append(Lines("", [warning], verdict="doubtful"))
    parts.extend(Lines("", [line, NOT_UNIQUE]) for line in undetermined_lines(scene))
    judged = Cell(text="", verdict="doubtful" if notes.acting else "")  # the color of the verdict
    forces = [
        Measure(each.element, each.peak, f"{each.peak:.3g} N", verdict="")
        for each in sorted(_loads_of(envelope, "force"), key=lambda each: -each.peak)
        if each.peak > negligible
    ]
    chart = linear_chart("Forces at joints", "Largest force at each joint over all cases", forces)
    steps = ["Multiply the loads by your safety factors; they have none."]
    if notes.acting:
        steps.insert(0, "Do not use the loads of times at which elements act that are not simulated.")
    if at_rest:
        steps.append("Run the cases in motion, too, if accelerations matter: these are loads at rest.")
    steps.append("Bearings, tubes and actuators: `loads.csv` has every component, `cases.csv` each case.")
    return Report(
        title,
        verdict,
        judged,
        parts,
        summary=parts,
        charts=chart,
        captions={"loads.png": "Forces and torques at joints, and forces of actuators"},
        next_steps=steps,
    )


def _case_lines(notes: CaseNotes, named: bool, at_rest: bool) -> list[Lines]:
    """Describe the cases: options, what stands for inputs that vary in time at rest, and the flow on plates,
    with warnings where the coefficients are not valid, and of singular configurations."""

    def where(name: str) -> str:
        return f"case {name}: " if named else ""

    lines = []
    for name, options in notes.options.items():
        texts = {key: f"{value:g}" if isinstance(value, float) else value for key, value in options.items()}
        if texts:
            settings = ", ".join(f"{option}={text}" for option, text in texts.items())
            lines.append(f"{where(name)}{settings}")
        if start := notes.starts[name]:
            shown = [f"{label} {x + 0.0:.4g} {unit}" for label, (x, unit) in start.items()][:MAX_COORDINATES]
            more = ", ..." if len(start) > MAX_COORDINATES else ""
            lines.append(f"{where(name)}{'held' if at_rest else 'starts'} at {', '.join(shown)}{more}")
    if at_rest:
        lines.append(AT_REST)
    for name, winds in notes.held_winds.items():
        for held in winds:
            speeds = f"{held.speed:.4g} m/s, reached at {held.time:.4g} s; the mean is {held.mean:.4g} m/s"
            component = held.component.replace("_", " ")
            lines.append(f"{where(name)}wind {held.load!r} has the largest {component} of its run, {speeds}")
    lines += [f"{where(name)}{each.line}" for name, found in notes.winds.items() for each in found]
    warnings = [
        f"{where(name)}{each.warning}"
        for name, found in notes.winds.items()
        for each in found
        if each.warning
    ]
    warnings += [f"{where(name)}{found}" for name, found in notes.singular.items()]
    parts = [Lines("", lines)] if lines else []
    return [*parts, Lines("", warnings, verdict="doubtful")] if warnings else parts


def _loads_of(envelope: LoadEnvelope, quantity: str) -> list[LoadRange]:
    """Return the load ranges of a quantity, such as "force", for all joints and actuators that have it."""
    return [each for each in (*envelope.joints, *envelope.actuators) if each.quantity == quantity]


def _when(load: LoadRange, at_rest: bool) -> str:
    """Format the load case of the largest load, and its time in a run."""
    case, time = load.governing
    return case if at_rest else f"{case} at {time:.4g} s"


def negligible_force(scene: Scene, envelope: LoadEnvelope) -> float:
    """Compute the force, N, below which a force is round-off."""
    size = scene.mechanism.size
    weight = STANDARD_GRAVITY * sum(body.mass for body in scene.mechanism.bodies[1:])
    peaks = [each.peak for each in _loads_of(envelope, "force")]
    peaks += [each.peak / size for each in _loads_of(envelope, "torque")]
    return LOAD_ROUND_OFF * max(weight, *peaks)


class _Tables(NamedTuple):
    """Makes the tables of loads.

    Attributes:
        envelope: largest loads over all cases.
        at_rest: True if the mechanism is held at rest; loads then have no time.
        negligible_force, negligible_torque: values up to these limits, N and N m, are printed as 0.
    """

    envelope: LoadEnvelope
    at_rest: bool
    negligible_force: float
    negligible_torque: float

    def of_cases(self, title: str, quantity: str, unit: str, envelopes: Mapping[str, LoadEnvelope]) -> Table:
        """Tabulate the peaks of a quantity in every case; the case that governs has the mark `GOVERNS`.

        Args:
            title: title of the table.
            quantity: "force", "torque" or "actuator force".
            unit: unit of all rows; "" if each row has its own unit.
            envelopes: loads of each case.
        """
        first = f"joint, {unit}" if unit else "actuator"
        rows: Rows = []
        for load in _loads_of(self.envelope, quantity):
            peaks = {name: each.of(load.element, quantity).peak for name, each in envelopes.items()}
            governing, _ = load.governing
            is_load = load.peak > self._negligible(load)
            marks = [GOVERNS if is_load and name == governing else "" for name in peaks]
            texts = [self._text(peak, load) for peak in peaks.values()]
            name = load.element if unit else f"{load.element}, {load.unit}"
            rows.append([name, *(mark + text for mark, text in zip(marks, texts, strict=True))])
        return Table(title, [*text_columns(first), *(Column(name, numeric=True) for name in envelopes)], rows)

    def of_joints(self, title: str, quantity: str, unit: str) -> Table:
        """Tabulate peak forces or torques of joints, and their components along and across the axis.

        Args:
            title: title of the table.
            quantity: "force" or "torque".
            unit: unit of the quantity.
        """
        names = [part.removesuffix(f" {quantity}") for part in LOAD_COMPONENTS[quantity]]
        if not self.at_rest:
            names.append("rms")
        columns = [*text_columns("joint"), *number_columns(f"{quantity}, {unit}", *names), GOVERNED_BY]
        known = {(each.element, each.quantity): each for each in self.envelope.joints}
        rows: Rows = []
        for load in _loads_of(self.envelope, quantity):
            components = [known.get((load.element, name)) for name in LOAD_COMPONENTS[quantity]]
            values = [load.peak, *(each.peak if each else None for each in components), load.rms]
            cells = ["" if value is None else self._text(value, load) for value in values[: len(names) + 1]]
            when = _when(load, self.at_rest) if load.peak > self._negligible(load) else ""
            rows.append([load.element, *cells, when])
        return Table(title, columns, rows)

    def of_actuators(self, title: str) -> Table:
        """Tabulate peak and rms forces of actuators, their peak speeds and powers, and their energies.

        At rest there are only forces.
        """
        names = ("force",) if self.at_rest else ("force", "rms", "speed", "power, W", "energy, J")
        rows: Rows = []
        for load in _loads_of(self.envelope, "actuator force"):
            speed, power, energy = (self.envelope.of(load.element, q) for q in ("speed", "power", "energy"))
            forces = [f"{value:.3g} {load.unit}" for value in (load.peak, load.rms)]
            motion = [f"{speed.peak:.3g} {speed.unit}", f"{power.peak:.3g}", f"{energy.peak:.3g}"]
            cells = [*forces, *motion][: len(names)]
            rows.append([load.element, *cells, _when(load, self.at_rest)])
        return Table(title, [*text_columns("actuator"), *number_columns(*names), GOVERNED_BY], rows)

    def _negligible(self, load: LoadRange) -> float:
        """Return the value up to which a load is round-off."""
        return self.negligible_torque if load.unit == "N m" else self.negligible_force

    def _text(self, value: float, load: LoadRange) -> str:
        """Format a value of a load, round-off as 0."""
        return f"{value if value > self._negligible(load) else 0.0:.3g}"
