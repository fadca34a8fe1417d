"""Describe a model file as Pinocchio's own importers of URDF and MJCF read it, to compare importers."""

from __future__ import annotations

import os
from dataclasses import replace

import pinocchio as pin

from newton_euler.model.source_file import path_text
from newton_euler.reading.robot import RobotFile
from urdf.model_robot import describe_model
from urdf.reading.parser_messages import collected_messages
from urdf.reading.source import SourceError

PLACE_IN_SOURCE = "message:\n"
"""End of the lines about Pinocchio's source code, with which some of its messages begin."""


def describe_as_imported(source: str | os.PathLike[str]) -> RobotFile:
    """Describe the robot of a URDF or MJCF file as Pinocchio imports it, by the defaults of its functions.

    By default, the root link of a URDF is fixed, and joints do not mimic others.

    Args:
        source: path of the file. A file whose name ends in .urdf is a URDF.

    Raises:
        SourceError: for a file that Pinocchio refuses, with its message; with the path "pinocchio.Model" for
            a model that cannot be described, such as one with numbers that are not finite.
    """
    path = path_text(source, SourceError)
    messages: list[str] = []  # of the XML parser, which name the element
    try:
        with collected_messages(messages):
            if path.lower().endswith(".urdf"):
                model, constraints = pin.buildModelFromUrdf(path), []
            else:
                model, points, frames = pin.buildModelAndConstraintsFromMJCF(path)
                constraints = [*points, *frames]
    except Exception as error:  # Pinocchio translates several C++ exceptions
        refusal = str(error).rpartition(PLACE_IN_SOURCE)[2]
        raise SourceError(path, " ".join(" ".join([refusal, *messages]).split())) from error
    warnings = tuple(f"prints: {' '.join(message.split())}" for message in messages)
    return replace(describe_model((model, constraints)), source=path, notes=warnings)
