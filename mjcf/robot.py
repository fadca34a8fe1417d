"""Describe the robot of an MJCF file in the terms of the file: bodies, joints, loops, couplings and drives.

`describe` compiles the file with MuJoCo in this process and reads the numbers of the compiled model. It loads
no meshes unless a body gets its mass from them, and imports no scene. `crosscheck diff` compares two robots.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.reading.compile import compile_spec
from mjcf.reading.source import FREE_TEXT, SourceError, copy_model, model_name, read_texts
from newton_euler.model.source_file import path_text
from newton_euler.reading.digits import VARIANTS, NumbersOfText
from newton_euler.reading.robot import (
    FileBody,
    FileJoint,
    JointKind,
    Placement,
    Robot,
    RobotFile,
)
from newton_euler.scalars import Array

JOINT_KINDS = {
    mujoco.mjtJoint.mjJNT_HINGE: JointKind.HINGE,
    mujoco.mjtJoint.mjJNT_SLIDE: JointKind.SLIDE,
    mujoco.mjtJoint.mjJNT_BALL: JointKind.BALL,
    mujoco.mjtJoint.mjJNT_FREE: JointKind.FREE,
}
"""Kind of a joint by MuJoCo's type."""

JOINT_TRANSMISSIONS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
"""Transmissions of an actuator that acts on one joint."""


def describe(source: str | os.PathLike[str] | mujoco.MjModel | mujoco.MjSpec) -> RobotFile:
    """Describe the robot of a model.

    Args:
        source: path of an MJCF file, or of a URDF as MuJoCo reads it; or a model in memory, which has no
            text and so no uncertainty.

    Raises:
        SourceError: for a file that cannot be read, and a model that MuJoCo refuses.

    Examples:
        >>> linkage = describe("examples/linkage.xml")
        >>> linkage.robot.bodies[0].name, linkage.robot.bodies[0].joints[0].kind.value
        ('crank', 'hinge')
    """
    if isinstance(source, str | os.PathLike):
        return _describe_file(path_text(source, SourceError))
    _, model, _ = copy_model(source)
    return RobotFile(_robot(model), format="MJCF")


def _describe_file(path: str) -> RobotFile:
    """Describe the robot of a file."""
    texts = read_texts(path)
    numbers = {file: NumbersOfText(text, _is_number) for file, text in texts.items()}
    with collected_warnings():
        try:
            model = _compiled(mujoco.MjSpec.from_file(path))
        except (ValueError, mujoco.FatalError) as error:
            raise SourceError(path, f"MuJoCo refuses it: {' '.join(str(error).split()):.500}") from error
        variants = tuple(_variants(path, numbers))
    return RobotFile(
        _robot(model),
        variants=variants,
        source=path,
        format="URDF" if path.lower().endswith(".urdf") else "MJCF",
        lines=numbers[os.path.realpath(path)].lines,
    )


def _is_number(attribute: str) -> bool:
    """Return False for attributes with names and other text."""
    return attribute not in FREE_TEXT


def _variants(path: str, numbers: dict[str, NumbersOfText]) -> Iterator[Robot]:
    """Yield the robots of texts whose numbers are changed within the rounding of their digits.

    Args:
        path: path of the file.
        numbers: numbers in the texts of the file and of the files that it includes, by real path.
    """
    root = os.path.commonpath([os.path.dirname(file) for file in numbers])
    random = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(VARIANTS):
            for file, numbers_of_file in numbers.items():
                copy = Path(folder) / os.path.relpath(file, root)
                copy.parent.mkdir(parents=True, exist_ok=True)
                copy.write_text(numbers_of_file.variant(random), encoding="utf-8")
            changed = Path(folder) / os.path.relpath(os.path.realpath(path), root)
            yield _robot(_compiled(mujoco.MjSpec.from_file(str(changed))))


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """Compile a specification without the meshes and images that do not matter for masses and joints."""
    for geom in [geom for geom in spec.geoms if geom.meshname]:
        spec.delete(geom)
    for unused in (*spec.meshes, *spec.sensors, *spec.pairs, *spec.keys, *spec.skins):
        spec.delete(unused)
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for texture in spec.textures:
        spec.delete(texture)
    return compile_spec(spec)


def _rotation(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _robot(model: mujoco.MjModel) -> Robot:
    """Describe the robot of a compiled model."""
    return Robot(
        name=model_name(model),
        bodies=tuple(_body(model, number) for number in range(1, model.nbody)),
        gravity=model.opt.gravity.copy(),
    )


def _body(model: mujoco.MjModel, number: int) -> FileBody:
    """Describe body `number` of a compiled model; body 0 is the ground."""
    first = int(model.body_jntadr[number])
    axes = _rotation(model.body_iquat[number])  # principal axes of inertia
    return FileBody(
        name=model.body(number).name,
        parent=int(model.body_parentid[number]) - 1,
        placement=Placement(model.body_pos[number].copy(), _rotation(model.body_quat[number])),
        joints=tuple(_joint(model, k) for k in range(first, first + int(model.body_jntnum[number]))),
        mass=float(model.body_mass[number]),
        center=model.body_ipos[number].copy(),
        inertia=(axes * model.body_inertia[number]) @ axes.T,
    )


def _joint(model: mujoco.MjModel, number: int) -> FileJoint:
    """Describe joint `number` of a compiled model; a ball and a free joint have no zero and no rest."""
    kind = JOINT_KINDS[mujoco.mjtJoint(model.jnt_type[number])]
    has_axis = kind in (JointKind.HINGE, JointKind.SLIDE)
    in_q, in_v = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
    low, high = model.jnt_range[number] if model.jnt_limited[number] else (-math.inf, math.inf)
    is_driven_within = model.jnt_actfrclimited[number]
    return FileJoint(
        name=model.joint(number).name,
        kind=kind,
        axis=model.jnt_axis[number].copy() if has_axis else np.zeros(3),
        point=model.jnt_pos[number].copy(),
        zero=float(model.qpos0[in_q]) if has_axis else 0.0,
        damping=float(model.dof_damping[in_v]),
        armature=float(model.dof_armature[in_v]) + _rotors(model, number),
        friction=float(model.dof_frictionloss[in_v]),
        stiffness=float(model.jnt_stiffness[number]),
        rest=float(model.qpos_spring[in_q]) if has_axis else 0.0,
        limits=(float(low), float(high)),
        effort=float(np.max(np.abs(model.jnt_actfrcrange[number]))) if is_driven_within else math.inf,
    )


def _rotors(model: mujoco.MjModel, joint: int) -> float:
    """Return the inertia, seen at a joint, of the rotors that actuators of the joint have."""
    acting = np.isin(model.actuator_trntype, JOINT_TRANSMISSIONS) & (model.actuator_trnid[:, 0] == joint)
    return float(np.sum(model.actuator_armature[acting] * model.actuator_gear[acting, 0] ** 2))
