"""Find out from the name of a column which quantity of a scene the column has.

A column belongs to the joint, body or actuator whose name it contains. Upper and lower case, and separators
such as `/`, `.` and `_`, count as equal. The other words of the name select the quantity: `crank_velocity` is
the rate of joint `crank`, `/poses/rod/orientation/w` the first number of the quaternion of body `rod`. A
column whose name has other words, such as a prefix of a topic, is used if no column has fewer of them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Literal, NamedTuple

import numpy as np

from crosscheck.support.units import ANGLES, LENGTHS, TIME_UNITS
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.reading.file_names import FileFrame, FileNames

_MOTION_UNITS = {
    **{unit: ("length", size) for unit, size in LENGTHS.items()},
    **{unit: ("angle", size) for unit, size in ANGLES.items()},
}

UNITS: Mapping[str, tuple[str, float]] = {
    **{unit: ("time", size) for unit, size in TIME_UNITS.items()},
    **_MOTION_UNITS,
    **{f"{unit}/s": found for unit, found in _MOTION_UNITS.items()},
    **dict.fromkeys(("N", "N m", "Nm", "N*m"), ("force", 1.0)),
    **dict.fromkeys(("1", "-"), ("number", 1.0)),
}
"""Dimension and factor to SI of units in names of columns. Rates have the dimension of their quantity."""

UNIT_WORDS = (*TIME_UNITS, *_MOTION_UNITS)
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

COMPONENTS_OF = {
    "position": "xyz",
    "quaternion": "wxyz",
    "linear_velocity": "xyz",
    "angular_velocity": "xyz",
}
"""Quantities of bodies, with the names of their components."""

JOINT_LETTERS = {"x": "position", "w": "velocity"}
"""Last letters of Drake's names for coordinates of slides and rates of hinges, with words that mean the same.
Its other letters, `q` and `v`, are such words."""

COMPONENT = re.compile(r"(q|p|pos|t|v|w)?([wxyz]|[0-3])")
"""Last word of a column of a vector or quaternion: a component, with a letter for the quantity in front."""

KNOWN_WORDS = frozenset().union(
    RATE_WORDS,
    FORCE_WORDS,
    INPUT_WORDS,
    COORDINATE_WORDS,
    ANGULAR_WORDS,
    LINEAR_WORDS,
    QUATERNION_WORDS,
    POSITION_WORDS,
    UNUSED_WORDS,
)
"""Words that are no units if they stand in brackets."""

Origin = Literal["", "center", "frame", "scene"]
"""Point of a body whose position a log has: "center" of mass of the file's body, origin of the body "frame",
or center of mass of the "scene"'s body, which merges bodies of the file that are fixed to each other. "" if
nothing states the point."""


class Target(NamedTuple):
    """Quantity that a column has.

    Attributes:
        kind: "time", "coordinate", "rate", "force", "input", or a key of `COMPONENTS_OF`.
        element: name of the joint, body or actuator; "" for the time.
        component: index of the component of a vector or quaternion.
        point: point of the body that the name of the column states; "" if the name states none, so that
            `LogOptions.position` decides.
    """

    kind: str
    element: str
    component: int = 0
    point: Origin = ""

    @property
    def text(self) -> str:
        """The quantity as `LogOptions.columns` names it, such as `quaternion.rod.w`."""
        parts = [self.kind, self.element]
        if self.kind in COMPONENTS_OF:
            parts.append(COMPONENTS_OF[self.kind][self.component])
        return ".".join(filter(None, parts))


class FoundColumn(NamedTuple):
    """Quantity of a column, as its name shows.

    Attributes:
        name: name of the column.
        target: the quantity.
        unit: unit in the name, or a text in brackets that is none of `UNITS`; "" for none.
        mismatch: twice the number of words in the name that say nothing about the quantity; one more if upper
            and lower case differ from the name of the element.
    """

    name: str
    target: Target
    unit: str
    mismatch: int


class Elements:
    """Elements of a scene that columns of a log can belong to, by name.

    Names are those of the scene, and those of the model file if the scene was read from one.

    Attributes:
        coordinates: joint coordinate of the scene by name, and its value in the file at the scene's zero.
        frames: frames by name, with the body that carries them and their fixed pose in it. They are the
            bodies of the scene, and links or bodies of the file that are parts of these bodies.
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
            name: FileFrame(name, np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
            for name in mechanism.body_names[1:]  # without the ground
        }
        self.inputs: tuple[str, ...] = ()
        if names is not None:
            moving = {name: frame for name, frame in names.frames.items() if frame.body in self.frames}
            self.frames |= moving
            known = {name: found for name, found in names.coordinates.items() if found.key in self._keys}
            self.coordinates |= {name: (found.key, found.start) for name, found in known.items()}
            self.inputs = tuple(names.inputs)

    @property
    def labels(self) -> dict[Key, str]:
        """Name of each joint coordinate for messages: that of the file if there is one."""
        return {key: name for name, (key, _) in self.coordinates.items()}

    def joint_letter(self, name: str) -> str:
        """Return the key of `JOINT_LETTERS` for a coordinate; "" for a slide with the name of a body."""
        slides = self.mechanism.is_slide(*self.coordinates[name][0])
        return "w" if not slides else "x" if name not in self.frames else ""

    @property
    def _keys(self) -> set[Key]:
        return set(self.mechanism.coordinate_labels)


def normalized(text: str) -> str:
    """Return a name in lower case, with `_` for all other characters than letters and digits."""
    return re.sub(r"[^0-9a-z]+", "_", text.lower()).strip("_")


def identified(name: str, elements: Elements) -> FoundColumn | None:
    """Find out from its name which quantity a column has; None for a column that has none."""
    if (column := stated(name, name, elements)) is not None:
        return column
    _, unit, parts = split_unit(name)
    if not unit and (unknown := unknown_unit(name, elements)):
        core, unit = unknown
        parts = normalized(core).split("_")
    text = f"_{'_'.join(parts)}_"
    best: FoundColumn | None = None
    longest = 0
    kinds: tuple[tuple[Iterable[str], Callable[[str, list[str]], tuple[Target, int] | None]], ...] = (
        (elements.coordinates, _joint_target),  # before an actuator of the same name
        (elements.inputs, _input_target),
        (elements.frames, _body_target),
    )
    for known, find in kinds:
        for element in known:
            own = normalized(element)
            before, match, after = text.rpartition(f"_{own}_")
            if known is elements.coordinates and after == f"{elements.joint_letter(element)}_":
                after = JOINT_LETTERS[after[0]]
            rest = [part for part in f"{before}_{after}".split("_") if part]
            if not own or not match or UNUSED_WORDS & set(rest):
                continue
            found = find(element, rest)
            # the longest name counts, `left_leg` before `leg`; among equal ones that with equal case
            length = 2 * len(own) + (element in name)
            if found is not None and length > longest:
                mismatch = 2 * found[1] + (element not in name)
                best, longest = FoundColumn(name, found[0], unit, mismatch), length
    return best


def stated(text: str, name: str, elements: Elements) -> FoundColumn | None:
    """Return the quantity that a text such as `quaternion.rod.w [deg]` names; None for another text.

    Args:
        text: kind, element and component, separated by dots, with an optional unit in brackets.
        name: name of the column that has the quantity: `text` itself, unless the user assigns the text to
            the column.
        elements: names of joints, bodies and actuators.
    """
    core, unit, _ = split_unit(text, words=False)
    if not unit and (unknown := unknown_unit(text, elements)):
        core, unit = unknown
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
        # columns named as in tables of trajectories have centers of mass; a text of the user states no point
        point: Origin = "scene" if kind == "position" and text == name else ""
        return FoundColumn(name, Target(kind, element, COMPONENTS_OF[kind].index(letter), point), unit, 0)
    return None


def split_unit(name: str, words: bool = True) -> tuple[str, str, list[str]]:
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


def unknown_unit(name: str, elements: Elements | None = None) -> tuple[str, str] | None:
    """Find a unit in brackets, as in `crank [rev]`, that is none of `UNITS`.

    Args:
        name: name of the column.
        elements: elements whose names can stand in brackets, too, as in `qpos[crank]`.

    Returns:
        The name without the brackets, and the unit. None without brackets, and if they have an index, a
        component, a word for a quantity or the name of an element.
    """
    match = UNIT_IN_BRACKETS.fullmatch(name)
    if match is None or not match[1] or not match[2].strip():
        return None
    text = normalized(match[2])
    if match[2].strip() in UNITS or text.isdecimal() or COMPONENT.fullmatch(text):
        return None
    if KNOWN_WORDS & set(text.split("_")):
        return None
    if elements is not None:
        named = [*elements.coordinates, *elements.frames, *elements.inputs]
        if any(f"_{normalized(element)}_" in f"_{text}_" for element in named):
            return None
    return match[1], match[2].strip()


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
    elif words & QUATERNION_WORDS or prefix == "q":
        kind, of_kind = "quaternion", QUATERNION_WORDS | POSITION_WORDS
    else:
        kind, of_kind = "position", POSITION_WORDS
    letters = COMPONENTS_OF[kind]
    number = int(letter) if letter.isdecimal() else letters.find(letter)
    if not 0 <= number < len(letters) or (letter.isdecimal() and prefix != "q" and not words & of_kind):
        return None
    point: Origin = ""
    if kind == "position":
        point = "center" if words & CENTER_WORDS else "frame" if words & ORIGIN_WORDS else ""
    return Target(kind, element, number, point), len(words - of_kind)
