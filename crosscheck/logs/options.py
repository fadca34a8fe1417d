"""Options of a measured log (table of motions): order of quaternions, units, time offset, quantities of
columns.

A log is compared with a simulation of a scene, which is a mechanism with its forces, controls and start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import ClassVar, Literal

from crosscheck.logs.names import Origin
from newton_euler.errors import OptionError, check_choices, choices, plain_number

QuaternionOrder = Literal["names", "wxyz", "xyzw"]


@dataclass(frozen=True)
class LogOptions:
    """Properties of a log that the names of its columns do not show.

    Attributes:
        quaternion: order of the four numbers of quaternions, in the order of the columns. "names" takes the
            order from the names; numbered columns then are w, x, y, z.
        angle: unit of angles without a unit in the name of the column, "rad" or "deg"; also of their rates.
        length: unit of lengths without a unit in the name of the column, "m", "mm" or "cm"; also of rates.
        time: unit of times without a unit in the name of the column, "s", "ms", "us" or "ns".
        offset: time of the log, s, at which the time of the simulation is zero; earlier rows are left out.
            None stands for 0 and all rows.
        position: point of a body that positions are of: "center" of mass or origin of the body "frame". ""
            chooses the point for which the poses in the first row close the joints better.
        zero: where joint coordinates in the log are zero: as in the model "file", or at the "start" of the
            scene.
        inputs: "log" takes inputs of actuators and joints from the log if it has some. Each of them holds
            until the next row; with "before", from the row before. "scene" takes those of the scene.
        columns: quantity by the name of a column, such as `coordinate.crank` or `quaternion.rod.w`.
    """

    quaternion: QuaternionOrder = "names"
    angle: Literal["rad", "deg"] = "rad"
    length: Literal["m", "mm", "cm"] = "m"
    time: Literal["s", "ms", "us", "ns"] = "s"
    offset: float | None = None
    position: Origin = ""
    zero: Literal["file", "start"] = "file"
    inputs: Literal["log", "before", "scene"] = "log"
    columns: Mapping[str, str] = field(default_factory=dict)

    ALLOWED: ClassVar = {
        "quaternion": ("names", "wxyz", "xyzw"),
        "angle": ("rad", "deg"),
        "length": ("m", "mm", "cm"),
        "time": ("s", "ms", "us", "ns"),
        "position": ("", "center", "frame"),
        "zero": ("file", "start"),
        "inputs": ("log", "before", "scene"),
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
