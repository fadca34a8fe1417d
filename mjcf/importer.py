"""Describe a model file as MuJoCo's own importer of MJCF and URDF reads it, for a comparison of importers."""

from __future__ import annotations

import os
from dataclasses import replace

import mujoco

from mjcf.errors import collected_warnings
from mjcf.reading.xml_scan import SourceError
from mjcf.robot import describe
from newton_euler.model.source_file import path_text
from newton_euler.reading.robot import RobotFile

MISSING_FILE = "opening file"
"""Words of MuJoCo's message about a mesh, texture or height field that it cannot open."""


def describe_as_imported(source: str | os.PathLike[str]) -> RobotFile:
    """Describe the robot of an MJCF or URDF file as MuJoCo imports it, with meshes and all other elements.

    If a mesh is missing, MuJoCo refuses the file. The description is then that of the file without its
    meshes, and a note has MuJoCo's message.

    Raises:
        SourceError: for a file that MuJoCo refuses for another reason, with its message.
    """
    path = path_text(source, SourceError)
    with collected_warnings() as warnings:
        try:
            robot = describe(mujoco.MjModel.from_xml_path(path))
        except (ValueError, mujoco.FatalError) as error:
            refusal = " ".join(str(error).split())
            if MISSING_FILE not in refusal:
                raise SourceError(path, refusal) from error
        else:
            return replace(robot, source=path, notes=(*map("warns: {}".format, warnings), *robot.notes))
    try:
        reduced = describe(path, root=os.path.abspath(os.sep))  # MuJoCo follows all references
    except SourceError as error:
        raise SourceError(path, refusal) from error
    note = f"refuses the file as it is ({refusal:.200}); it is compared without its meshes"
    return replace(reduced, format="MJCF", notes=(note, *reduced.notes))
