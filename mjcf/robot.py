"""Describe the robot of an MJCF file in the terms of the file: bodies, joints, loops, couplings and drives.

`describe` compiles the file with MuJoCo in this process and reads the numbers of the compiled model. It loads
no meshes unless a body gets its mass from them, and imports no scene. `crosscheck diff` compares two robots.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.keyframes import starts
from mjcf.loops import fixed_tendon_weights
from mjcf.mesh_masses import with_hulls, with_mesh_masses
from mjcf.placements import rotation_of, site_placement
from mjcf.point_springs import point_springs
from mjcf.reading.compile import compile_spec
from mjcf.reading.essentials import NO_MASS, Essentials, essential_texts
from mjcf.reading.source import UNNAMED, copy_model, model_name
from mjcf.reading.xml_scan import FREE_TEXT, SourceError, read_texts
from mjcf.settings import Names, settings
from mjcf.transmission_places import Numbers, numbered, transmission_numbers
from newton_euler.model.source_file import element_lines, path_text
from newton_euler.reading.approximations import NO_LIMIT
from newton_euler.reading.digits import VARIANTS, NumbersOfText
from newton_euler.reading.robot import (
    FileBody,
    FileCoupling,
    FileDrive,
    FileJoint,
    FileLoop,
    JointKind,
    LoopKind,
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

TRANSMISSION, GAIN, BIAS, DYNAMICS = mujoco.mjtTrn, mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtDyn
EQUALITY = mujoco.mjtEq
"""MuJoCo's types of the parts of actuators, and of equality constraints."""

JOINT_TRANSMISSIONS = (TRANSMISSION.mjTRN_JOINT, TRANSMISSION.mjTRN_JOINTINPARENT)
"""Transmissions of an actuator that acts on one joint."""

NO_LIMITS = (-math.inf, math.inf)
"""Smallest and largest value of a quantity without limits."""


def describe(
    source: str | os.PathLike[str] | mujoco.MjModel | mujoco.MjSpec, root: str | None = None
) -> RobotFile:
    """Describe the robot of a model.

    Args:
        source: path of an MJCF file, or of a URDF as MuJoCo reads it; or a model in memory, which has no
            text and so no uncertainty.
        root: folder that must contain all files that a file refers to. None means the folder of the file, and
            for meshes the folder above.

    Raises:
        SourceError: for a file that cannot be read, and a model that MuJoCo refuses.

    Examples:
        >>> linkage = describe("examples/linkage.xml")
        >>> linkage.robot.bodies[0].name, linkage.robot.bodies[0].joints[0].kind.value
        ('crank', 'hinge')
    """
    if isinstance(source, str | os.PathLike):
        return _describe_file(path_text(source, SourceError), root)
    _, model, _ = copy_model(source)
    description = _Description(model)
    return RobotFile(description.robot, format="MJCF", notes=tuple(description.notes))


def _describe_file(path: str, root: str | None) -> RobotFile:
    """Describe the robot of a file; `root` as in `describe`."""
    files = read_texts(path, root)
    essentials = essential_texts(files)
    random = np.random.default_rng(0)
    variants = []
    with collected_warnings():
        try:
            model = compiled(essentials.texts, is_variant=False)
        except (ValueError, mujoco.FatalError) as error:
            raise SourceError(path, f"MuJoCo refuses it: {' '.join(str(error).split()):.500}") from error
        description = _Description(model)
        described = _without_missing(description.robot, essentials.missing)
        texts, of_hulls = essentials.texts, description.robot
        if essentials.loaded:
            with suppress(ValueError, mujoco.FatalError):  # of vertices that have no hull
                hulls = with_hulls(essentials.texts, model)
                of_hulls = _Description(compiled(hulls, is_variant=False)).robot
                texts = hulls
        numbers = {name: numbers_of(text) for name, text in texts.items()}
        for _ in range(VARIANTS):
            changed = {name: each.variant(random) for name, each in numbers.items()}
            with suppress(ValueError, mujoco.FatalError):  # for example of limits that change places
                variant = _Description(compiled(changed, is_variant=True)).robot
                variant = with_mesh_masses(variant, description.robot, of_hulls)
                variants.append(_without_missing(variant, essentials.missing))
    if len(variants) < VARIANTS:
        refused = f"MuJoCo refuses {VARIANTS - len(variants)} of {VARIANTS} variants within the digits"
        description.notes.append(f"{refused}; uncertainties come from the others")
    return RobotFile(
        replace(described, name=described.name or Path(path).stem),
        variants=tuple(variants),
        source=path,
        format="URDF" if path.lower().endswith(".urdf") else "MJCF",
        lines=element_lines(files.texts, SourceError),
        notes=(*_notes_of_meshes(essentials), *description.notes),
        missing_meshes=essentials.missing,
    )


def _without_missing(robot: Robot, missing: Collection[str]) -> Robot:
    """Return a robot whose bodies with missing meshes have no mass instead of the smallest one for MuJoCo."""

    def without_mass(body: FileBody) -> FileBody:
        if body.name in missing and body.mass < 2.0 * float(NO_MASS["mass"]):
            return replace(body, mass=0.0, center=np.zeros(3), inertia=np.zeros((3, 3)))
        return body

    return replace(robot, bodies=tuple(map(without_mass, robot.bodies)))


def _notes_of_meshes(essentials: Essentials) -> Iterator[str]:
    """Yield sentences about bodies whose masses come from meshes."""
    if essentials.loaded:
        yield f"meshes are loaded because they give masses to bodies: {', '.join(essentials.loaded)}"
    if essentials.missing:
        yield f"masses count as 0 because meshes are missing, of bodies: {', '.join(essentials.missing)}"


def numbers_of(text: str) -> NumbersOfText:
    """Find the numbers in a text of an MJCF file."""
    return NumbersOfText(text, _is_number, is_angle=_is_angle)


def _is_number(attribute: str) -> bool:
    """Return False for attributes with names and other text."""
    return attribute not in FREE_TEXT


def _is_angle(tag: str, attribute: str) -> bool:
    """Return whether an attribute holds angles: of frames, of joints, or the controls of position servos."""
    is_of_joint = tag == "joint" and attribute in ("range", "ref", "springref")
    return attribute in ("euler", "axisangle") or is_of_joint or (tag, attribute) == ("position", "ctrlrange")


def compiled(
    texts: Mapping[str, str],
    is_variant: bool,
    prepare: Callable[[mujoco.MjSpec], None] = lambda spec: None,
) -> mujoco.MjModel:
    """Compile the texts of files.

    Args:
        texts: texts by the names with which they include each other, the top file first.
        is_variant: True to accept moments of inertia that no body can have, which MuJoCo refuses. The moments
            of a thin body become such numbers if their last digits change.
        prepare: changes the model before it is compiled.
    """
    (_, top_text), *included = texts.items()
    spec = mujoco.MjSpec.from_string(top_text, include={name: text.encode() for name, text in included})
    spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE  # lengths of muscles would need simulations
    prepare(spec)
    refused = []
    for body in spec.bodies if is_variant else ():
        if body.explicitinertial:
            principal = _principal_inertia(body)
            smallest, middle, largest = sorted(principal[0])
            if smallest + middle < largest or smallest <= 0.0:
                refused.append((body, *principal))
                body.inertia = np.full(3, max(largest, mujoco.mjMINVAL))
                body.fullinertia = np.full(6, np.nan)
    model = compile_spec(spec)
    for body, moments, axes in refused:
        model.body_inertia[body.id] = moments
        if axes is not None:
            model.body_iquat[body.id] = axes
    return model


def _principal_inertia(body: mujoco.MjsBody) -> tuple[Array, Array | None]:
    """Return the principal moments (3,) of a body's `<inertial>`, and its axes if it has a full matrix.

    The axes are a quaternion (w, x, y, z) in the frame of the body.
    """
    if np.isnan(body.fullinertia[0]):
        return body.inertia.copy(), None
    xx, yy, zz, xy, xz, yz = body.fullinertia
    moments, axes = np.linalg.eigh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, (axes * np.linalg.det(axes)).ravel())
    return moments, quaternion


class _Description:
    """Description of the robot of a compiled model.

    Attributes:
        robot: the robot.
        notes: what the model has and the robot has not, one sentence each.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self.notes: list[str] = []
        # names by number
        self._joint_names = [model.joint(k).name for k in range(model.njnt)]
        flags = int(model.opt.disableflags)
        switched_off = {
            name.removeprefix("mjDSBL_").lower()
            for name, flag in mujoco.mjtDisableBit.__members__.items()
            if flags & int(flag)
        }
        if "constraint" in switched_off:
            switched_off |= {"equality", "frictionloss", "limit"}
        is_off = switched_off.__contains__
        # MuJoCo's arrays with one row for each body or joint; lists are faster to read than arrays
        ranges = np.array(model.jnt_range)
        no_limit = np.abs(ranges) >= NO_LIMIT
        ranges[no_limit] = np.copysign(np.inf, ranges[no_limit])
        self._limits = self._ranges(ranges, model.jnt_limited, is_off("limit"))
        self._efforts = self._ranges(model.jnt_actfrcrange, model.jnt_actfrclimited, False)
        dof = model.jnt_dofadr
        self._damping = (model.dof_damping[dof] * (not is_off("damper"))).tolist()
        self._friction = (model.dof_frictionloss[dof] * (not is_off("frictionloss"))).tolist()
        self._stiffness = (model.jnt_stiffness * (not is_off("spring"))).tolist()
        self._armature = self._armatures()
        self._clamps_controls = not is_off("clampctrl")
        equalities = [] if is_off("equality") else [k for k in range(model.neq) if model.eq_active0[k]]
        self._loops: list[FileLoop] = []
        self._couplings: list[FileCoupling] = []
        others = [number for number in equalities if not self._add_equality(number)]
        springs = point_springs(model, has_springs=not is_off("spring"), has_dampers=not is_off("damper"))
        self._names = Names.of(model)
        drives = tuple(self._drive(k) for k in range(model.nactuator))
        self.robot = Robot(
            name="" if model_name(model) == UNNAMED else model_name(model),
            bodies=tuple(self._bodies()),
            loops=tuple(self._loops),
            couplings=tuple(self._couplings),
            drives=drives,
            springs=tuple(springs.values()),
            settings=settings(model, self._names, others, springs, drives, switched_off),
            starts=tuple(starts(model)),
            gravity=np.zeros(3) if is_off("gravity") else model.opt.gravity.copy(),
            time_step=float(model.opt.timestep),
            integrator=mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_"),
        )
        self._note_rest(switched_off, len(equalities))

    @staticmethod
    def _ranges(values: Array, limited: Array, is_off: bool) -> list[tuple[float, float]]:
        """Return ranges by row; infinite ones where they are switched off."""
        return [
            (low, high) if is_limited and not is_off else NO_LIMITS
            for (low, high), is_limited in zip(values.tolist(), limited.tolist(), strict=True)
        ]

    def _armatures(self) -> list[float]:
        """Return the inertia of rotors that each joint feels, also those of its actuators."""
        model = self._model
        armatures = model.dof_armature[model.jnt_dofadr].copy()
        for number in np.flatnonzero(model.actuator_armature):
            if TRANSMISSION(model.actuator_trntype[number]) in JOINT_TRANSMISSIONS:
                gear = model.actuator_gear[number, 0]
                armatures[model.actuator_trnid[number, 0]] += model.actuator_armature[number] * gear**2
        return list(armatures.tolist())

    def _bodies(self) -> Iterator[FileBody]:
        """Yield the bodies but the ground, body 0."""
        model = self._model
        first_joints, counts = model.body_jntadr.tolist(), model.body_jntnum.tolist()
        parents, masses = model.body_parentid.tolist(), model.body_mass.tolist()
        for number in range(1, model.nbody):
            axes = rotation_of(model.body_iquat[number])  # principal axes of inertia
            joints = range(first_joints[number], first_joints[number] + counts[number])
            yield FileBody(
                name=model.body(number).name,
                parent=parents[number] - 1,
                placement=Placement(model.body_pos[number].copy(), rotation_of(model.body_quat[number])),
                joints=tuple(map(self._joint, joints)),
                mass=masses[number],
                center=model.body_ipos[number].copy(),
                inertia=(axes * model.body_inertia[number]) @ axes.T,
            )

    def _joint(self, number: int) -> FileJoint:
        """Describe joint `number`; balls and free joints have no zero and no rest."""
        model = self._model
        kind = JOINT_KINDS[mujoco.mjtJoint(model.jnt_type[number])]
        has_axis = kind in (JointKind.HINGE, JointKind.SLIDE)
        in_q = int(model.jnt_qposadr[number])
        return FileJoint(
            name=self._joint_names[number],
            kind=kind,
            axis=model.jnt_axis[number].copy() if has_axis else np.zeros(3),
            point=model.jnt_pos[number].copy(),
            zero=float(model.qpos0[in_q]) if has_axis else 0.0,
            damping=self._damping[number],
            armature=self._armature[number],
            friction=self._friction[number],
            stiffness=self._stiffness[number],
            rest=float(model.qpos_spring[in_q]) if has_axis else 0.0,
            limits=self._limits[number],
            effort=self._efforts[number],
        )

    def _add_equality(self, number: int) -> bool:
        """Describe equality `number` as a loop or a coupling; return False for equalities of other forms."""
        model, name = self._model, self._model.equality(number).name
        data = model.eq_data[number].tolist()
        objects = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        kind = EQUALITY(model.eq_type[number])
        if kind in (EQUALITY.mjEQ_CONNECT, EQUALITY.mjEQ_WELD):
            self._loops.append(self._closure(name, kind == EQUALITY.mjEQ_WELD, number))
        elif kind == EQUALITY.mjEQ_JOINT:
            follower, leader = (self._joint_names[k] if k >= 0 else "" for k in objects)
            powers = data[:5] if leader else data[:1]
            while len(powers) > 1 and powers[-1] == 0.0:
                powers.pop()
            self._couplings.append(FileCoupling(name, follower, leader, tuple(powers)))
        else:
            is_single = kind == EQUALITY.mjEQ_TENDON and objects[1] < 0
            return is_single and self._add_tendon(name, objects[0], data[0])
        return True

    def _closure(self, name: str, is_weld: bool, number: int) -> FileLoop:
        """Describe a connect or a weld, between two bodies or two sites."""
        model = self._model
        objects = int(model.eq_obj1id[number]), int(model.eq_obj2id[number])
        data = model.eq_data[number]
        if model.eq_objtype[number] == mujoco.mjtObj.mjOBJ_SITE:
            frames = [site_placement(model, site) for site in objects]
            bodies = [int(model.site_bodyid[site]) for site in objects]
        else:
            bodies = list(objects)
            # a connect has the points on body 1 and body 2; a weld has them the other way, and then the
            # quaternion of body 2 in body 1
            points = (data[3:6], data[:3]) if is_weld else (data[:3], data[3:6])
            rotations = (rotation_of(data[6:10]) if is_weld else np.eye(3)), np.eye(3)
            frames = [Placement(*pair) for pair in zip(map(np.copy, points), rotations, strict=True)]
        holds_rotation = is_weld and data[10] != 0.0  # factor of torques
        return FileLoop(
            name,
            LoopKind.WELD if holds_rotation else LoopKind.POINT,
            first=bodies[0] - 1,
            second=bodies[1] - 1,
            first_frame=frames[0],
            second_frame=frames[1],
        )

    def _add_tendon(self, name: str, tendon: int, offset: float) -> bool:
        """Describe a tendon whose length an equality holds; return False for tendons of other forms.

        Args:
            name: name of the equality.
            tendon: number of the tendon.
            offset: length of the tendon minus its length in the pose of the file.
        """
        model = self._model
        weights = fixed_tendon_weights(model, tendon)
        if weights is not None and len(weights) == 2:
            # weight_1 x_1 + weight_2 x_2 = offset, from the zeros of both joints
            (follower, follower_weight), (leader, leader_weight) = weights.items()
            powers = offset / follower_weight, -leader_weight / follower_weight
            names = self._joint_names[follower], self._joint_names[leader]
            self._couplings.append(FileCoupling(name, *names, powers))
            return True
        first, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
        is_line = np.all(model.wrap_type[first : first + count] == mujoco.mjtWrap.mjWRAP_SITE)
        if weights is None and count == 2 and is_line:
            first_site, second_site = (int(site) for site in model.wrap_objid[first : first + 2])
            rod = FileLoop(
                name,
                LoopKind.ROD,
                first=int(model.site_bodyid[first_site]) - 1,
                second=int(model.site_bodyid[second_site]) - 1,
                first_frame=site_placement(model, first_site),
                second_frame=site_placement(model, second_site),
                length=float(model.tendon_length0[tendon]) + offset,
            )
            self._loops.append(rod)
            return True
        return False

    def _drive(self, number: int) -> FileDrive:
        """Describe actuator `number`."""
        model = self._model
        other: Numbers = {}
        gain = model.actuator_gainprm[number]
        gain_type = GAIN(model.actuator_gaintype[number])
        if gain_type == GAIN.mjGAIN_AFFINE:
            other |= {"gain per length": float(gain[1]), "gain per velocity": float(gain[2])}
        elif gain_type != GAIN.mjGAIN_FIXED:
            other |= {"gain type": _word(gain_type), **numbered("gain", gain)}
        bias = model.actuator_biasprm[number]
        bias_type = BIAS(model.actuator_biastype[number])
        if bias_type not in (BIAS.mjBIAS_NONE, BIAS.mjBIAS_AFFINE):
            other |= {"bias type": _word(bias_type), **numbered("bias", bias)}
        dynamics = DYNAMICS(model.actuator_dyntype[number])
        if dynamics != DYNAMICS.mjDYN_NONE:
            other |= {
                "dynamics": _word(dynamics),
                **numbered("dynamics", model.actuator_dynprm[number]),
            }
        for quantity, value in (
            ("damping of the actuator", model.actuator_damping[number]),
            ("delay", model.actuator_delay[number]),
            ("actearly", model.actuator_actearly[number]),
        ):
            if value:
                other[quantity] = float(value)
        other |= numbered("polynomial of the damping", model.actuator_dampingpoly[number])
        if gain_type != GAIN.mjGAIN_FIXED:
            other["inputs"] = float(model.actuator_ctrlspec[number])
        is_at_joint = TRANSMISSION(model.actuator_trntype[number]) in JOINT_TRANSMISSIONS
        if model.actuator_armature[number] and not is_at_joint:  # others are part of the joint's
            other["armature of the actuator"] = float(model.actuator_armature[number])
        if GAIN.mjGAIN_MUSCLE == gain_type or BIAS.mjBIAS_MUSCLE == bias_type:
            other |= numbered("length range", model.actuator_lengthrange[number])
        group = int(model.actuator_group[number])
        if 0 <= group < 31 and model.opt.disableactuator >> group & 1:
            other["switched off"] = "by its group"
        if model.actuator_actlimited[number]:
            low, high = model.actuator_actrange[number].tolist()
            other |= {"smallest activation": low, "largest activation": high}
        gears, transmission = self._transmission(number)
        is_affine = bias_type == BIAS.mjBIAS_AFFINE
        has_control_limits = model.actuator_ctrllimited[number] and self._clamps_controls
        return FileDrive(
            model.actuator(number).name,
            gears,
            gain=float(gain[0]) if gain_type in (GAIN.mjGAIN_FIXED, GAIN.mjGAIN_AFFINE) else 0.0,
            stiffness=float(bias[1]) if is_affine else 0.0,
            damping=float(bias[2]) if is_affine else 0.0,
            constant=float(bias[0]) if is_affine else 0.0,
            control_limits=_pair(model.actuator_ctrlrange[number]) if has_control_limits else NO_LIMITS,
            force_limits=_pair(model.actuator_forcerange[number])
            if model.actuator_forcelimited[number]
            else NO_LIMITS,
            other=transmission | other,
        )

    def _transmission(self, number: int) -> tuple[dict[str, float], Numbers]:
        """Return the gears of an actuator by joint, and other numbers of its transmission by name."""
        model = self._model
        kind = TRANSMISSION(model.actuator_trntype[number])
        target, gear = int(model.actuator_trnid[number, 0]), float(model.actuator_gear[number, 0])
        weights: dict[int, float] | None = None
        if kind in JOINT_TRANSMISSIONS:
            weights = {target: 1.0}
        elif kind == TRANSMISSION.mjTRN_TENDON:
            weights = fixed_tendon_weights(model, target)
        single = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
        if weights is not None and all(mujoco.mjtJoint(model.jnt_type[joint]) in single for joint in weights):
            return {self._joint_names[joint]: weight * gear for joint, weight in weights.items()}, {}
        return {}, transmission_numbers(model, self._names, number)

    def _note_rest(self, switched_off: set[str], active_equalities: int) -> None:
        """Add notes of what the model has and the robot has not."""
        model = self._model
        off = sorted(switched_off & {"limit", "spring", "damper", "frictionloss", "gravity", "actuation"})
        if off:
            self.notes.append(f"option flags switch off: {', '.join(off)}")
        if active_equalities < model.neq:
            count = model.neq - active_equalities
            self.notes.append(f"not described: equalities that are switched off ({count})")


def _word(member: mujoco.mjtGain | mujoco.mjtBias | mujoco.mjtDyn | mujoco.mjtTrn) -> str:
    """Return the word of a member of MuJoCo's enumerations, such as "muscle" of mjGAIN_MUSCLE."""
    return str(member.name).partition("_")[2].lower()


def _pair(limits: Array) -> tuple[float, float]:
    """Return the smallest and largest value of a range (2,)."""
    low, high = limits.tolist()
    return low, high
