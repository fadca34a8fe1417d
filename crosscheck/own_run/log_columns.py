"""Find joint coordinates, body poses and inputs among the columns of a log, by the names of the columns.

A column belongs to the joint, body or actuator whose name it contains. Upper and lower case, and separators
such as `/`, `.` and `_`, count as equal. The other words of the name select the quantity: `crank_velocity` is
the rate of joint `crank`, `/poses/rod/orientation/w` the first number of the quaternion of body `rod`. A
column whose name has other words, such as a prefix of a topic, is used if no column has fewer of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from crosscheck.own_run.log_table import LogTable
from newton_euler.errors import OptionError, check_choices, choices, listed, plain_number, quoted
from newton_euler.model.euler_parameters import continuous
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.reading.file_names import FileFrame, FileNames
from newton_euler.scalars import Array

DEGREE = np.pi / 180.0

UNITS: Mapping[str, tuple[str, float]] = {
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
    "m": ("length", 1.0),
    "mm": ("length", 1e-3),
    "cm": ("length", 1e-2),
    "m/s": ("length", 1.0),
    "mm/s": ("length", 1e-3),
    "rad": ("angle", 1.0),
    "deg": ("angle", DEGREE),
    "rad/s": ("angle", 1.0),
    "deg/s": ("angle", DEGREE),
    "N": ("force", 1.0),
    "N m": ("force", 1.0),
    "Nm": ("force", 1.0),
    "1": ("number", 1.0),
}
"""Dimension and factor to SI of units in names of columns."""

UNIT_WORDS = ("s", "ms", "us", "ns", "m", "mm", "cm", "rad", "deg")
"""Units that the last word of a column's name can be, as in `crank_deg`; rates add the word `s`."""

UNIT_IN_BRACKETS = re.compile(r"(.*?)\s*[\[(]([^\])]*)[\])]\s*")
"""A column's name with a unit in brackets, as in `crank [deg]`."""


def _words(text: str) -> frozenset[str]:
    """Return the words of a text."""
    return frozenset(text.split())


RATE_WORDS = _words("rate rates vel velocity velocities qvel qd dq qdot speed omega v")
FORCE_WORDS = _words("effort efforts force torque tau")
INPUT_WORDS = _words("ctrl control controls u input action command cmd")
COORDINATE_WORDS = _words("coordinate coordinates pos position positions qpos q angle angles joint joints")
ANGULAR_WORDS = _words("angular omega gyro angvel")
LINEAR_WORDS = _words("linear velocity vel linvel v twist speed")
QUATERNION_WORDS = _words("quaternion quat orientation rotation rot xquat q")
POSITION_WORDS = _words("position pos xpos xipos translation p pose com center cog origin body link frame")
"""Words in names of columns that select a quantity of a joint or body."""

UNUSED_WORDS = _words(
    "acceleration acc accel qacc qdd ddq reaction violation energy power work target reference desired"
    " setpoint des ref error temperature current voltage roll pitch yaw euler covariance"
)
"""Words in names of columns that are no measured joint coordinates, poses or inputs."""

CENTER_WORDS, ORIGIN_WORDS = _words("com center cog xipos"), _words("origin xpos frame link")
"""Words that state which point of a body a position is of: center of mass, or origin of the body frame."""

TIME_NAMES = ("time", "t", "timestamp", "sim_time", "simtime", "stamp", "clock")
"""Names of the column of times, without units."""

SECONDS_NAME = re.compile(r"(?:.*_)?(?:secs?|seconds)")
NANOSECONDS_NAME = re.compile(r"(?:.*_)?(?:nsecs?|nanosecs?|nanoseconds)")
"""Names of the two columns of a time stamp of ROS."""

COMPONENTS_OF = {
    "position": "xyz",
    "quaternion": "wxyz",
    "linear_velocity": "xyz",
    "angular_velocity": "xyz",
}
"""Quantities of bodies, with the names of their components."""

COMPONENT = re.compile(r"(q|p|pos|t|v|w)?([wxyz]|[0-3])")
"""Last word of a column of a vector or quaternion: a component, with a letter for the quantity in front."""

MAX_NORM_ERROR = 0.02
"""Largest deviation of the norm of a quaternion from 1: numbers with two digits are still accepted."""

QuaternionOrder = Literal["names", "wxyz", "xyzw"]
Origin = Literal["", "center", "frame"]


@dataclass(frozen=True)
class LogOptions:
    """Statements on a log that the names of the columns do not make.

    Attributes:
        quaternion: order of the four numbers of quaternions, in the order of the columns. "names" takes the
            order from the names; numbered columns then are w, x, y, z.
        angle: unit of angles without a unit in the name of the column, "rad" or "deg"; also of their rates.
        length: unit of lengths without a unit in the name of the column, "m", "mm" or "cm"; also of rates.
        time: unit of times without a unit in the name of the column, "s", "ms", "us" or "ns".
        offset: time of the log, s, at which the time of the scene is zero.
        position: point of a body that positions are of: "center" of mass or origin of the body "frame". ""
            chooses the point for which the joints of the first row fit better.
        zero: zero of joint coordinates: that of the "file", or the "start" of the scene.
        inputs: "log" takes inputs from the log if it has some, "scene" takes those of the scene.
        columns: quantity by the name of a column, such as `coordinate.crank` or `quaternion.rod.w`.
    """

    quaternion: QuaternionOrder = "names"
    angle: Literal["rad", "deg"] = "rad"
    length: Literal["m", "mm", "cm"] = "m"
    time: Literal["s", "ms", "us", "ns"] = "s"
    offset: float = 0.0
    position: Origin = ""
    zero: Literal["file", "start"] = "file"
    inputs: Literal["log", "scene"] = "log"
    columns: Mapping[str, str] = field(default_factory=dict)

    ALLOWED: ClassVar = {
        "quaternion": ("names", "wxyz", "xyzw"),
        "angle": ("rad", "deg"),
        "length": ("m", "mm", "cm"),
        "time": ("s", "ms", "us", "ns"),
        "position": ("", "center", "frame"),
        "zero": ("file", "start"),
        "inputs": ("log", "scene"),
    }

    def __post_init__(self) -> None:
        for name, allowed in self.ALLOWED.items():
            if getattr(self, name) not in allowed:
                raise OptionError(name, getattr(self, name), choices(getattr(self, name), allowed))

    @classmethod
    def parsed(cls, texts: Mapping[str, str], columns: Mapping[str, str]) -> LogOptions:
        """Parse options as text, as on the command line.

        Raises:
            UnknownNameError, OptionError: for an unknown option or value.
        """
        names = [each.name for each in fields(cls) if each.name != "columns"]
        check_choices("option of a log", texts, names)
        given: dict[str, str | float] = dict(texts)
        if "offset" in given:
            try:
                given["offset"] = plain_number(texts["offset"])
            except ValueError as error:
                raise OptionError("offset", texts["offset"], "a number of s") from error
        return cls(**given, columns=dict(columns))  # type: ignore[arg-type]


class Target(NamedTuple):
    """Quantity that a column has.

    Attributes:
        kind: "time", "coordinate", "rate", "force", "input", or a key of `COMPONENTS_OF`.
        element: name of the joint, body or actuator; "" for the time.
        component: index of the component of a vector or quaternion.
        point: point of the body that the name of the column states, see `LogOptions.position`.
    """

    kind: str
    element: str
    component: int = 0
    point: Origin = ""


class FoundColumn(NamedTuple):
    """Quantity of a column, as its name shows.

    Attributes:
        name: name of the column.
        target: the quantity.
        unit: unit in the name; "" for none.
        others: twice the number of words in the name that say nothing about the quantity; one more if upper
            and lower case differ from the name of the element.
    """

    name: str
    target: Target
    unit: str
    others: int


@dataclass(frozen=True, eq=False)
class Measured:
    """Numbers of one quantity with the names of their columns."""

    values: Array
    columns: tuple[str, ...]

    def at(self, rows: Array) -> Measured:
        """Return the numbers of chosen rows."""
        return Measured(self.values[rows], self.columns)


@dataclass
class FrameColumns:
    """Motion of one body frame: columns of the log, SI; None for what the log does not have.

    Attributes:
        position: (n, 3) m.
        quaternion: (n, 4), (w, x, y, z).
        linear_velocity: (n, 3) m/s, of the same point as the position.
        angular_velocity: (n, 3) rad/s, world frame.
        point: point of the body that the names of columns state; "" if they do not.
    """

    position: Measured | None = None
    quaternion: Measured | None = None
    linear_velocity: Measured | None = None
    angular_velocity: Measured | None = None
    point: Origin = ""


@dataclass(frozen=True, eq=False)
class LogData:
    """Numbers of a log by quantity, SI units, rows with all numbers only.

    Attributes:
        where: file or name of the run, for messages.
        time: (n,) times as the log has them, s.
        coordinates: joint coordinates of the scene; angles are continuous.
        rates: rates of joint coordinates.
        frames: motion of body frames by name.
        inputs: controls by the name of an actuator of the file.
        forces: forces on joint coordinates, N or N m.
        without_unit: names of columns whose unit an option decides, by dimension, such as "angle".
        unused: names of columns that belong to no quantity.
        dropped: number of rows without some of the numbers.
    """

    where: str
    time: Array
    coordinates: dict[Key, Measured]
    rates: dict[Key, Measured]
    frames: dict[str, FrameColumns]
    inputs: dict[str, Measured]
    forces: dict[Key, Measured]
    without_unit: dict[str, list[str]]
    unused: tuple[str, ...]
    dropped: int


class Elements:
    """Names of a scene, and of the model file that it was read from, that columns can belong to.

    Attributes:
        coordinates: joint coordinate of the scene by name, and its value in the file at the scene's zero.
        frames: body frames by name.
        inputs: names of actuators.
        mechanism: mechanism of the scene.
    """

    def __init__(self, mechanism: Mechanism, names: FileNames | None) -> None:
        """Collect the names of a mechanism, and of a model file if the scene was read from one."""
        self.mechanism = mechanism
        self.coordinates: dict[str, tuple[Key, float]] = {}
        for key, label in mechanism.coordinate_labels.items():
            self.coordinates[label] = key, 0.0
        self.frames: dict[str, FileFrame] = {
            name: FileFrame(name, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
            for name in mechanism.body_names[1:]
        }
        self.inputs: tuple[str, ...] = ()
        if names is not None:
            moving = {name: frame for name, frame in names.frames.items() if frame.body in self.frames}
            self.frames |= moving
            known = {name: found for name, found in names.coordinates.items() if found.key in self._keys}
            self.coordinates |= {name: (found.key, found.start) for name, found in known.items()}
            self.inputs = tuple(names.inputs)

    @property
    def _keys(self) -> set[Key]:
        return set(self.mechanism.coordinate_labels)


def normalized(text: str) -> str:
    """Return a name in lower case, with `_` for all other characters than letters and digits."""
    return re.sub(r"[^0-9a-z]+", "_", text.lower()).strip("_")


def read_columns(table: LogTable, elements: Elements, options: LogOptions) -> LogData:
    """Find the quantities of a log and convert them to SI units.

    Raises:
        SourceError: naming the column: missing or repeated columns, cells without numbers, and times that do
            not ascend, with the remedy.
    """
    found, unused = _found_columns(table, elements, options)
    if not found:
        problem = f"no column is a joint coordinate or a pose: {listed(table.columns):.300}"
        names = listed([*elements.coordinates, *elements.frames])
        needed = f"names of joints or bodies ({names:.300}), or --log-map COLUMN=coordinate.JOINT"
        raise table.error(f"{problem}; needed: {needed}")
    for each in found.values():
        if each.name in table.texts:
            problem = f"column {quoted(each.name)}: {table.texts[each.name]}; needed: a finite number"
            raise table.error(problem)
    time_names, time = _times(table, options)
    # rows with all numbers; exports of several topics leave cells empty
    used = [time, *(table.columns[each.name] for each in found.values())]
    complete = np.asarray(np.isfinite(used).all(axis=0))
    if np.sum(complete) < 3:
        fewest = min([*found.values()], key=lambda each: np.isfinite(table.columns[each.name]).sum())
        count = int(np.isfinite(table.columns[fewest.name]).sum())
        problem = f"column {quoted(fewest.name)} has {count} numbers in {len(time)} rows"
        raise table.error(f"{problem}; needed: rows with a number in every used column")
    time = time[complete]
    backward = np.flatnonzero(np.diff(time) <= 0.0)
    if len(backward):
        row = int(backward[0])
        problem = f"column {quoted(time_names)}: {time[row + 1]:.9g} s after {time[row]:.9g} s"
        needed = "ascending times; sort the rows, or remove repeated rows and all runs but one"
        raise table.error(f"{problem} (row {row + 2} of {len(time)}); needed: {needed}")
    reader = _Reader(table, complete, options, found)
    data = LogData(
        table.where,
        time,
        *reader.coordinates(elements),
        reader.frames(),
        {each.target.element: reader.measured(each) for each in reader.of("input")},
        {elements.coordinates[each.target.element][0]: reader.measured(each) for each in reader.of("force")},
        reader.without_unit,
        tuple(name for name in unused if name not in time_names.split(" and ")),
        int(np.sum(~complete)),
    )
    if options.inputs == "scene":
        data.inputs.clear()
        data.forces.clear()
    if not (data.coordinates or data.frames):
        problem = f"no column is a joint coordinate or a pose: {listed(table.columns):.300}"
        raise table.error(f"{problem}; needed: columns such as coordinate.JOINT, or --log-map")
    return data


class _Reader:
    """Converts the columns of a log to SI units, and collects columns whose unit an option decides."""

    def __init__(
        self, table: LogTable, rows: Array, options: LogOptions, found: Mapping[Target, FoundColumn]
    ) -> None:
        """Take a log.

        Args:
            table: the log.
            rows: (n,) True for the rows to use.
            options: statements on the log.
            found: columns by quantity.
        """
        self._table, self._rows, self._options, self._found = table, rows, options, found
        self.without_unit: dict[str, list[str]] = {}

    def of(self, kind: str) -> list[FoundColumn]:
        """Return the columns of a kind of quantity."""
        return [each for each in self._found.values() if each.target.kind == kind]

    def measured(self, column: FoundColumn, dimension: str = "") -> Measured:
        """Convert a column; `dimension` is "length" or "angle", or "" for numbers that no option scales."""
        factor = 1.0
        if column.unit:
            of, factor = UNITS[column.unit]
            if dimension and of != dimension:
                problem = f"column {quoted(column.name)} has the unit {column.unit!r}, no unit of {dimension}"
                raise self._table.error(f"{problem}; needed: another unit, or --log-map for another quantity")
        elif dimension:
            self.without_unit.setdefault(dimension, []).append(column.name)
            factor = UNITS[getattr(self._options, dimension)][1]
        return Measured(factor * self._table.columns[column.name][self._rows], (column.name,))

    def coordinates(self, elements: Elements) -> tuple[dict[Key, Measured], dict[Key, Measured]]:
        """Return joint coordinates of the scene, and their rates."""
        values, rates = dict[Key, Measured](), dict[Key, Measured]()
        for kind, into in (("coordinate", values), ("rate", rates)):
            for column in self.of(kind):
                key, start = elements.coordinates[column.target.element]
                slides = elements.mechanism.is_slide(*key)
                measured = self.measured(column, "length" if slides else "angle")
                numbers = measured.values
                if kind == "coordinate":
                    numbers = numbers if slides else np.unwrap(numbers)
                    numbers = numbers - (start if self._options.zero == "file" else 0.0)
                into[key] = Measured(numbers, measured.columns)
        return values, rates

    def frames(self) -> dict[str, FrameColumns]:
        """Return the motion of body frames.

        Raises:
            SourceError: for a vector or quaternion without all components, and for quaternions that are no
                rotations.
        """
        frames: dict[str, FrameColumns] = {}
        for kind, components in COMPONENTS_OF.items():
            for name in dict.fromkeys(each.target.element for each in self.of(kind)):
                columns = {
                    each.target.component: each for each in self.of(kind) if each.target.element == name
                }
                missing = [letter for k, letter in enumerate(components) if k not in columns]
                if missing:
                    have = next(iter(columns.values())).name
                    problem = f"column {kind}.{name}.{missing[0]} is missing beside {quoted(have)}"
                    needed = f"all of {', '.join(components)}, or --log-map COLUMN={kind}.{name}.{missing[0]}"
                    raise self._table.error(f"{problem}; needed: {needed}")
                frame = frames.setdefault(name, FrameColumns())
                parts = [columns[k] for k in range(len(components))]
                if kind == "quaternion":
                    measured = self._quaternion(parts)
                else:
                    dimension = "angle" if kind == "angular_velocity" else "length"
                    each = [self.measured(part, dimension) for part in parts]
                    numbers = np.stack([one.values for one in each], axis=1)
                    measured = Measured(numbers, tuple(one.columns[0] for one in each))
                setattr(frame, kind, measured)
                if kind == "position":
                    frame.point = parts[0].target.point
        return frames

    def _quaternion(self, parts: list[FoundColumn]) -> Measured:
        """Return quaternions (n, 4), normalized, w first, with continuous signs."""
        names = [part.name for part in parts]
        if self._options.quaternion != "names":
            # the order of the columns in the log counts, whatever their names are
            order = list(self._table.columns)
            names.sort(key=order.index)
            if self._options.quaternion == "xyzw":
                names = [names[3], *names[:3]]
        numbers = np.stack([self._table.columns[name][self._rows] for name in names], axis=1)
        norms = np.linalg.norm(numbers, axis=1)
        row = int(np.argmax(np.abs(norms - 1.0)))
        if abs(norms[row] - 1.0) > MAX_NORM_ERROR:
            problem = f"columns {', '.join(map(quoted, names))} have norm {norms[row]:.3g} in row {row + 1}"
            raise self._table.error(f"{problem}; needed: quaternions of norm 1")
        numbers = numbers / norms[:, None]
        return Measured(continuous(numbers, numbers[0]), tuple(names))


def _times(table: LogTable, options: LogOptions) -> tuple[str, Array]:
    """Return the name of the column of times, or of two columns joined by " and ", and the times (n,), s."""
    mapped = [name for name, target in options.columns.items() if target == "time"]
    for name in mapped or table.columns:
        core, unit, words = _split_unit(name)
        if mapped or normalized(core) in TIME_NAMES or "_".join(words) in TIME_NAMES:
            if name in table.texts:
                problem = f"column {quoted(name)}: {table.texts[name]}; needed: a finite number"
                raise table.error(problem)
            dimension, factor = UNITS[unit or options.time]
            if dimension != "time":
                raise table.error(f"column {quoted(name)} has the unit {unit!r}; needed: s, ms, us or ns")
            return name, factor * table.columns[name]
    names = {name: normalized(name) for name in table.columns}
    seconds = [name for name, text in names.items() if SECONDS_NAME.fullmatch(text)]
    fractions = [name for name, text in names.items() if NANOSECONDS_NAME.fullmatch(text)]
    if seconds and fractions:
        whole = table.columns[seconds[0]]
        start = np.nanmin(whole)  # of large numbers, so that nanoseconds keep their digits
        stamp = (whole - start) + 1e-9 * table.columns[fractions[0]]
        return f"{seconds[0]} and {fractions[0]}", stamp if start > 1e6 else stamp + start
    problem = f"no column of times among {listed(table.columns):.300}"
    raise table.error(f"{problem}; needed: a column time, s, or --log-map COLUMN=time")


def _found_columns(
    table: LogTable, elements: Elements, options: LogOptions
) -> tuple[dict[Target, FoundColumn], list[str]]:
    """Find the column of each quantity.

    Returns:
        Columns by quantity, and the names of other columns.

    Raises:
        SourceError: for an unknown column or quantity in `LogOptions.columns`, and for two columns with equal
            claims to one quantity.
    """
    claims: dict[Target, list[FoundColumn]] = {}
    for name, text in options.columns.items():
        if name not in table.columns:
            raise table.error(f"has no column {quoted(name)}; needed: one of {listed(table.columns):.300}")
        if text != "time":
            column = _canonical(text, name, elements)
            if column is None:
                needed = (
                    "time, coordinate.JOINT, rate.JOINT, position.BODY.x, quaternion.BODY.w or input.NAME"
                )
                raise table.error(f"column {quoted(name)} has no quantity {quoted(text)}; needed: {needed}")
            claims.setdefault(column.target._replace(point=""), []).append(column)
    for name in table.columns:
        if name not in options.columns and (column := identified(name, elements)) is not None:
            claims.setdefault(column.target._replace(point=""), []).append(column)
    found: dict[Target, FoundColumn] = {}
    for key, columns in claims.items():
        columns.sort(key=lambda column: column.others)
        if len(columns) > 1 and columns[0].others == columns[1].others:
            both = " and ".join(quoted(column.name) for column in columns[:2])
            what = ".".join(filter(None, [key.kind, key.element, _letter(key)]))
            needed = f"one of the two; --log-map COLUMN={what} chooses it"
            raise table.error(f"columns {both} are both {what}; needed: {needed}")
        found[key] = columns[0]
    used = {column.name for column in found.values()}
    return found, [name for name in table.columns if name not in used]


def _letter(target: Target) -> str:
    """Return the letter of a component; "" for a quantity without components."""
    return COMPONENTS_OF[target.kind][target.component] if target.kind in COMPONENTS_OF else ""


def _canonical(text: str, name: str, elements: Elements) -> FoundColumn | None:
    """Return the quantity that a text such as `quaternion.rod.w [deg]` names; None for another text.

    Args:
        text: kind, element and component, separated by dots, with an optional unit in brackets.
        name: name of the column that has the quantity.
        elements: names of joints, bodies and actuators.
    """
    core, unit, _ = _split_unit(text, words=False)
    kind, _, rest = core.partition(".")
    known = {
        "coordinate": elements.coordinates,
        "rate": elements.coordinates,
        "force": elements.coordinates,
        "input": elements.inputs,
    }
    if kind in known and rest in known[kind]:
        return FoundColumn(name, Target(kind, rest), unit, 0)
    element, _, letter = rest.rpartition(".")
    if kind in COMPONENTS_OF and element in elements.frames and letter and letter in COMPONENTS_OF[kind]:
        # as in tables of trajectories, positions are those of centers of mass
        point: Origin = "center" if kind == "position" and text == name else ""
        return FoundColumn(name, Target(kind, element, COMPONENTS_OF[kind].index(letter), point), unit, 0)
    return None


def _split_unit(name: str, words: bool = True) -> tuple[str, str, list[str]]:
    """Split the unit from the name of a column.

    Args:
        name: name of the column.
        words: True to find a unit that is the last word of the name, too.

    Returns:
        The name without a unit in brackets, the unit or "", and the words of the name without the unit.
    """
    match = UNIT_IN_BRACKETS.fullmatch(name)
    if match and match[2].strip() in UNITS:
        return match[1], match[2].strip(), normalized(match[1]).split("_")
    parts = normalized(name).split("_")
    if words and len(parts) > 2 and parts[-1] == "s" and f"{parts[-2]}/s" in UNITS:
        return name, f"{parts[-2]}/s", parts[:-2]
    if words and len(parts) > 1 and parts[-1] in UNIT_WORDS:
        return name, parts[-1], parts[:-1]
    return name, "", parts


def identified(name: str, elements: Elements) -> FoundColumn | None:
    """Find out from its name which quantity a column has; None for a column that has none."""
    if (column := _canonical(name, name, elements)) is not None:
        return column
    _, unit, parts = _split_unit(name)
    text = f"_{'_'.join(parts)}_"
    best: FoundColumn | None = None
    longest = 0
    kinds: tuple[tuple[Iterable[str], Callable[[str, list[str]], tuple[Target, int] | None]], ...] = (
        (elements.inputs, _input_target),
        (elements.coordinates, _joint_target),
        (elements.frames, _body_target),
    )
    for known, find in kinds:
        for element in known:
            own = normalized(element)
            before, match, after = text.rpartition(f"_{own}_")
            rest = [part for part in f"{before}_{after}".split("_") if part]
            if not own or not match or UNUSED_WORDS & set(rest):
                continue
            found = find(element, rest)
            # the longest name counts, `left_leg` before `leg`; among equal ones that with equal case
            length = 2 * len(own) + (element in name)
            if found is not None and length > longest:
                others = 2 * found[1] + (element not in name)
                best, longest = FoundColumn(name, found[0], unit, others), length
    return best


def _input_target(element: str, rest: list[str]) -> tuple[Target, int] | None:
    """Return the control of an actuator, and the number of meaningless words; None without a fitting word."""
    if rest and not INPUT_WORDS & set(rest):
        return None
    return Target("input", element), len(set(rest) - INPUT_WORDS)


def _joint_target(element: str, rest: list[str]) -> tuple[Target, int] | None:
    """Return a quantity of a joint coordinate, and the number of meaningless words; None for a vector."""
    words = set(rest)
    if INPUT_WORDS & words or (rest and COMPONENT.fullmatch(rest[-1])):
        return None
    for kind, of_kind in (("rate", RATE_WORDS), ("force", FORCE_WORDS)):
        if words & of_kind:
            return Target(kind, element), len(words - of_kind - COORDINATE_WORDS)
    return Target("coordinate", element), len(words - COORDINATE_WORDS)


def _body_target(element: str, rest: list[str]) -> tuple[Target, int] | None:
    """Return a quantity of a body, and the number of meaningless words; None without a component."""
    match = COMPONENT.fullmatch(rest[-1]) if rest else None
    if match is None:
        return None
    prefix, letter = match[1] or "", match[2]
    words = set(rest[:-1])
    if FORCE_WORDS & words:
        return None
    if words & ANGULAR_WORDS or prefix == "w":
        kind, of_kind = "angular_velocity", ANGULAR_WORDS | LINEAR_WORDS
    elif words & LINEAR_WORDS or prefix == "v":
        kind, of_kind = "linear_velocity", LINEAR_WORDS
    elif words & QUATERNION_WORDS or prefix == "q" or letter == "w":
        kind, of_kind = "quaternion", QUATERNION_WORDS | POSITION_WORDS
    else:
        kind, of_kind = "position", POSITION_WORDS
    letters = COMPONENTS_OF[kind]
    number = int(letter) if letter.isdecimal() else letters.find(letter)
    if not 0 <= number < len(letters) or (letter.isdecimal() and not words & of_kind):
        return None
    point: Origin = ""
    if kind == "position":
        point = "center" if words & CENTER_WORDS else "frame" if words & ORIGIN_WORDS else ""
    return Target(kind, element, number, point), len(words - of_kind)
