"""Import an MJCF file as a scene of newton_euler, with an import report on every element of the file.

A scene is a mechanism with its forces, control laws and initial state. MuJoCo compiles the file and resolves
its defaults, includes, angles and inertias. The scene is built from the compiled model at its start state: a
keyframe or qpos0, moved slightly so that all loops are closed. Bodies that are fixed to each other become one
body.

The scene is then verified: its masses, motions and forces are compared with those of the compiled model
(`newton_euler.reading`, `mjcf.reference`). A model with actuators is imported and verified a second time with
random controls, because a wrong actuator has no effect while its control is zero. On request, the scene is
excited, because a run of a model at rest tests little: controls follow sines and joints get start velocities,
see `mjcf.reading.laws`.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping as ReadOnlyMapping
from collections.abc import Sequence, Sized
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias, Unpack

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.file_run import MujocoFile
from mjcf.reading.actuators import Actuators, driven_joints
from mjcf.reading.bodies import Bodies
from mjcf.reading.forces import Forces, armatures
from mjcf.reading.friction_and_limits import friction_and_limits
from mjcf.reading.joints import GearGroups, Joints
from mjcf.reading.laws import Drive, choose_excitation
from mjcf.reading.leftovers import report_leftovers
from mjcf.reading.loops import Loops
from mjcf.reading.plausibility import key_findings, mesh_findings
from mjcf.reading.softness import equalities_with_own_softness
from mjcf.reading.source import UNNAMED, check_memory, compile_file, copy_model, model_name
from mjcf.reading.start import ModelAtStart, ModelToImport
from mjcf.reading.xml_scan import SourceError
from mjcf.reference import MjcfReference
from mjcf.run_settings import Inputs
from newton_euler.arguments import UNCHECKED, checked
from newton_euler.errors import NewtonEulerError, OptionError
from newton_euler.model.armatures import Armature, BallArmature
from newton_euler.model.euler_parameters import conjugate, product, rotation
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.source_file import ReadOptions, Request, path_text
from newton_euler.model.spanning_tree import unweld_loops
from newton_euler.model.state import State
from newton_euler.reading import plausibility
from newton_euler.reading.activity import REST_SPEED
from newton_euler.reading.excitation import with_start_velocities
from newton_euler.reading.file_names import FileCoordinate, FileFrame, FileInput, FileNames
from newton_euler.reading.import_report import EXCITED, ChangedVelocities, ImportReport, unique_name
from newton_euler.reading.reference import ReferenceModel
from newton_euler.reading.verify import verify_report
from newton_euler.runs.assemble import assemble
from newton_euler.scalars import Array

MAX_LISTED_NAMES = 5
"""Largest number of names of actuators in one line of a report."""

MjcfInMemory: TypeAlias = mujoco.MjSpec | mujoco.MjModel
"""MuJoCo model in memory: an editable specification, or a compiled model."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Result of importing an MJCF file.

    Attributes:
        scene: imported scene.
        report: import report: for each element of the file, what the element became or why it is left out,
            see `ImportReport`.
        start: MuJoCo's model and data at the start state, without contacts, limits and dry friction.
        drives: actuators whose controls excitation can vary, by number of the actuator, with the range in
            which no limit is exceeded.
    """

    scene: Scene
    report: ImportReport
    start: ModelAtStart
    drives: dict[int, Drive] = field(default_factory=dict)


@checked
def read(
    model: Annotated[str | os.PathLike[str] | MjcfInMemory, UNCHECKED],
    key: str | None = None,
    root: str | None = None,
    **options: Unpack[ReadOptions],
) -> Reading:
    """Import an MJCF file, or a model that MuJoCo has in memory, as a scene.

    Args:
        model: path of the file, or an `MjSpec` or `MjModel` in its present state.
        key: name of the keyframe to start from, or "qpos0". None means the first keyframe, or "qpos0" if the
            model has no keyframe.
        root: folder that must contain all files that the file refers to. None means the file's own folder for
            included files, and the parent of this folder for meshes and textures.
        options: `duration`, `output_period`, `excitation`, `friction`, `limits` and other options of the
            scene, see `ReadOptions`.

    Raises:
        MjcfError: for a model that cannot be read or verified, with file or model name and element.
        OptionError: for a `root` with a model in memory.

    Examples:
        >>> found = mjcf.read("examples/linkage.xml", key="go", duration=2.0)
        >>> found.scene.duration, len(found.report.of("exactly")) > 0
        (2.0, True)
    """
    request = Request.of(options)
    with collected_warnings() as warnings:
        # compile the file, or copy the model in memory; `source_name` is the path or the name for messages
        if isinstance(model, str | os.PathLike):
            source_name = path_text(model, SourceError)
            root_folder = None if root is None else path_text(root, SourceError)
            compiled_model, keyframe_sizes = compile_file(source_name, root_folder)
        else:
            source_name, compiled_model, keyframe_sizes = copy_model(model)
            if root is not None:
                raise OptionError("root", root, "no root for a model in memory, which refers to no files")
        check_memory(source_name, compiled_model)
        # likely mistakes in the file: inertias of meshes, and keyframes with too few numbers
        file_findings = [*mesh_findings(compiled_model), *key_findings(compiled_model, keyframe_sizes)]
        # import; every reference model changes its own copy of the compiled model
        to_import = ModelToImport.of(compiled_model)
        reading = _import(source_name, to_import, key, request)
        try:
            # reference models for verification, with the controls of the file and with random controls
            reference = _reference_model(copy.copy(compiled_model), key, reading)
            references: list[tuple[ReferenceModel, Scene]] = [reference]
            if compiled_model.nu:
                driven_model = copy.copy(compiled_model)
                references.append(
                    _reference_with_random_controls(source_name, driven_model, to_import, key, request)
                )
            # constant controls, or on request the sines of the excitation
            start = reading.start.data
            inputs = Inputs(compiled_model, np.array(start.ctrl), np.array(start.act), sines={})
            if request.excitation:
                reading, inputs = _excite(source_name, to_import, key, request, reading)
            # the file as MuJoCo simulates it with the file's own settings, likely mistakes, and verification
            report = reading.report
            simulation = MujocoFile(compiled_model, reference[0], reading.scene, report, inputs)
            if compiled_model.neq and isinstance(model, str | os.PathLike):
                # equalities that the `solref` and `solimp` of <default> do not reach
                simulation.own_softness = equalities_with_own_softness(source_name)
            report.simulation = simulation
            report.references.extend(references)
            report.findings.extend(plausibility.findings(reading.scene.mechanism))
            report.findings.extend(plausibility.grouped(file_findings))
            if request.verified:
                report.start.append(verify_report(report))
        except SourceError:
            raise
        except (NewtonEulerError, np.linalg.LinAlgError) as error:
            raise SourceError(source_name, str(error)) from error
    report.start.extend(f"MuJoCo warns: {warning}" for warning in warnings)
    return reading


@np.errstate(all="ignore")  # numbers that overflow are refused later
def _reference_model(
    model: Any, key: str | None, reading: Reading, controls: tuple[Array, Array] | None = None
) -> tuple[MjcfReference, Scene]:
    """Build the reference model of an imported scene, and return the model with the scene.

    Args:
        model: compiled model, which is changed.
        key: name of the keyframe, see `read`.
        reading: imported scene and its report.
        controls: controls (nu,) and activations (na,); None for the controls of the keyframe.
    """
    return MjcfReference(model, key, reading.report, reading.scene, controls), reading.scene


@np.errstate(all="ignore")  # numbers that overflow are refused later
def _reference_with_random_controls(
    source_name: str, model: Any, to_import: ModelToImport, key: str | None, request: Request
) -> tuple[ReferenceModel, Scene]:
    """Import the file with random controls; return its reference model and its scene.

    Args:
        source_name: path or name of the model, for messages.
        model: compiled model, which is changed.
        to_import: the same model, for the import.
        key: name of the keyframe, see `read`.
        request: options of the scene.
    """
    control = _random_control(model)
    reading = _import(source_name, to_import, key, request, control)
    return _reference_model(model, key, reading, (control, np.array(reading.start.data.act)))


def _random_control(model: Any) -> Array:
    """Draw random controls (nu,) within their ranges, or between -1 and 1 for controls without range."""
    low, high = np.full((2, model.nu), [[-1.0], [1.0]])
    limited = model.actuator_ctrllimited.astype(bool)
    for actuator in np.flatnonzero(limited):
        # in MuJoCo 4 an actuator may have several controls
        first = model.actuator_ctrladr[actuator]
        controls = slice(first, first + model.actuator_ctrlnum[actuator])
        low[controls], high[controls] = model.actuator_ctrlrange[actuator].reshape(-1, 2).T
    largest = mujoco.mjMAXVAL  # MuJoCo refuses larger controls
    low, high = np.clip([low, high], -largest, largest)
    fraction = np.random.default_rng(0).uniform(0.1, 0.9, model.nu)
    return np.asarray(low + fraction * (high - low))


@np.errstate(all="ignore")  # numbers that overflow are refused later
def _excite(
    source_name: str, to_import: ModelToImport, key: str | None, request: Request, reading: Reading
) -> tuple[Reading, Inputs]:
    """Import the model again with sines of the controls, and with start velocities if the file has none.

    Args:
        source_name: path or name of the model, for messages.
        to_import: model of the file.
        key: name of the keyframe, see `read`.
        request: options of the scene.
        reading: scene with the controls of the file, and its report.

    Returns:
        The new reading, and its controls for a run in MuJoCo.
    """
    start, model = reading.start, to_import.model
    excitation = choose_excitation(
        reading.scene,
        reading.drives,
        np.array(start.data.ctrl),
        model.actuator_ctrladr,
        reading.report.bounds,  # limits of coordinates and forces
    )
    excited = _import(source_name, to_import, key, request, excitation.control, excitation.sines)
    # describe the excitation in one line of the report
    names = [model.actuator(k).name or repr(k) for k in range(model.nactuator)]
    phrases = []
    if excitation.sines:
        sines = excitation.sines.values()
        frequencies = [sine.angular_frequency / (2.0 * np.pi) for sine in sines]
        least, most = f"{min(frequencies):.2g}", f"{max(frequencies):.2g}"
        range_of_frequencies = least if least == most else f"{least} to {most}"
        amplitude = max(abs(sine.amplitude) for sine in sines)
        driven = _count(excitation.sines, "actuator")
        # largest part of the range of a control that its sine uses
        parts = [
            abs(sine.amplitude) / float(np.max(np.abs(model.actuator_ctrlrange[k])))
            for k, sine in excitation.sines.items()
            if model.actuator_ctrllimited[k]
        ]
        of_range = f" ({100.0 * max(parts):.2g} % of ctrlrange)" if parts else ""
        phrases.append(
            f"{driven} driven at {range_of_frequencies} Hz, amplitudes up to {amplitude:.2g}{of_range}"
        )
    if excitation.moved:
        moves = [f"{names[k]} from {old:g} to {new:g}" for k, (old, new) in excitation.moved.items()]
        phrases.append(
            f"{_count(moves, 'control')} moved inside the ranges of control and force ({_join_first(moves)})"
        )
    if constant := [names[k] for k in range(model.nactuator) if k not in excitation.sines]:
        phrases.append(
            f"{_count(constant, 'actuator')} with the controls of the file ({_join_first(constant)})"
        )
    if not np.any(start.data.qvel):
        moving_scene, largest_speeds = with_start_velocities(excited.scene, excited.report.bounds)
        excited = replace(excited, scene=moving_scene)
        phrases.append(largest_speeds)
    description = ", ".join(phrases) or "the velocities of the start are enough"
    excited.report.start.append(f"{EXCITED}{description}")
    return excited, Inputs(model, excitation.control, np.array(start.data.act), excitation.sines)


def _join_first(texts: Sequence[str]) -> str:
    """Join the first `MAX_LISTED_NAMES` texts by commas, with dots at the end if there are more."""
    return ", ".join(texts[:MAX_LISTED_NAMES]) + (", ..." if texts[MAX_LISTED_NAMES:] else "")


def _count(elements: Sized, noun: str) -> str:
    """Return the number of elements with a noun, such as "3 actuators"."""
    return f"{len(elements)} {noun}{'' if len(elements) == 1 else 's'}"


def _import(
    source_name: str,
    to_import: ModelToImport,
    key: str | None,
    request: Request,
    control: Array | None = None,
    sines: ReadOnlyMapping[int, Sine] = MappingProxyType({}),
) -> Reading:
    """Import a compiled model, without verification.

    Args:
        source_name: path or name of the model, for messages.
        to_import: model of the file.
        key: name of the keyframe, see `read`.
        request: options of the scene.
        control: (nu,) controls; None for the controls of the keyframe.
        sines: sines of the excitation that are added to controls, by number of the actuator.
    """
    report = ImportReport()
    start = ModelAtStart(source_name, to_import, key, report, request.redundancy_tolerance, control)
    try:
        bodies = Bodies(start, report)
        scene, drives = _build_scene(start, bodies, report, request, sines)
    except SourceError:
        raise
    except NewtonEulerError as error:
        raise SourceError(source_name, str(error)) from error
    return Reading(scene, report, start, drives)


def _build_scene(
    start: ModelAtStart,
    bodies: Bodies,
    report: ImportReport,
    request: Request,
    sines: ReadOnlyMapping[int, Sine],
) -> tuple[Scene, dict[int, Drive]]:
    """Build the scene from all elements of the model, and fill the report.

    Args:
        start: MuJoCo's model and data at the start state.
        bodies: imported bodies.
        report: report that receives one entry for each element.
        request: options of the scene.
        sines: sines of the excitation that are added to controls, by number of the actuator.

    Returns:
        The scene, and the actuators whose controls excitation can vary, by number.
    """
    path, model = start.path, start.model
    if len(bodies.bodies) < 2:  # the ground is the first body
        raise SourceError(path, "no body can move")
    # Each of these classes imports one kind of element, and reports it. Gear groups are joint coordinates
    # that gears make proportional to each other; a tendon on such coordinates acts as a force on one of them
    joints = Joints(start, bodies, driven_joints(model), report)
    loops = Loops(start, bodies, joints, report)
    gravity = np.array(model.opt.gravity)
    gear_groups = GearGroups(loops.couplings)
    forces = Forces(start, bodies, joints, gear_groups, gravity, report)
    actuators = Actuators(start, bodies, joints, gear_groups, forces, report, sines)
    coordinate_armatures, ball_armatures = armatures(start, joints, gear_groups, report)
    for key, inertia in actuators.armatures.items():
        coordinate_armatures[key] = coordinate_armatures.get(key, 0.0) + inertia
    switched = tuple(friction_and_limits(start, joints, request, report))
    report_leftovers(start, bodies, joints, report)  # contacts and other elements not simulated
    report.names = _file_names(start, bodies, joints, actuators.drives)
    # the name of the scene is the name of the model, or of the file
    given_name = model_name(model)
    name = unique_name(
        Path(path).stem if given_name in ("", UNNAMED) else given_name, fallback="model", taken=()
    )
    # `unweld_loops` merges the body halves by which `mjcf.write` closes loops in exported files
    mechanism = unweld_loops(Mechanism(bodies.bodies, [*joints.joints, *loops.joints], loops.couplings))
    scene = Scene(
        name[:100].strip(".") or "model",
        mechanism,
        request.duration,
        request.output_period,
        gravity,
        actuators.laws,
        forces=(*forces.forces, *switched),
        motions=tuple(loops.held_motions),  # of coordinates that an equality holds constant
        armatures=(
            *(Armature(joint, inertia, k) for (joint, k), inertia in coordinate_armatures.items()),
            *(BallArmature(joint, inertia) for joint, inertia in ball_armatures.items()),
        ),
        description=f"{Path(path).name} from {start.key}",
        redundancy_tolerance=request.redundancy_tolerance,
    )
    return _with_file_velocities(scene, start, bodies, report), actuators.drives


def _file_names(
    start: ModelAtStart, bodies: Bodies, joints: Joints, drives: ReadOnlyMapping[int, Drive]
) -> FileNames:
    """Record how joints, body frames and actuators of the file correspond to the scene.

    Logs of MuJoCo's runs use the file's names and zeros; the record translates them to the scene.
    """
    model, data = start.model, start.data
    names = FileNames()
    for joint, key in joints.coordinate_keys.items():
        if name := model.joint(joint).name:
            value = float(data.qpos[model.jnt_qposadr[joint]])
            names.coordinates[name] = FileCoordinate(key, value)
    bodies_by_name = {body.name: body for body in bodies.bodies}
    for k in range(1, model.nbody):
        if not (name := model.body(k).name):
            continue
        # frame of the file's body in the frame of the scene's body
        body = bodies_by_name[bodies.names[k]]
        point, center = (
            rotation(body.quaternion).T @ (place - body.center_of_mass)
            for place in (data.xpos[k], data.xipos[k])
        )
        turn = product(conjugate(body.quaternion), data.xquat[k] / np.linalg.norm(data.xquat[k]))
        names.frames[name] = FileFrame(body.name, point, center, turn)
    # actuators whose force is proportional to the control: `gains` are forces on joint coordinates per unit;
    # with activation dynamics, the force depends on earlier controls
    for actuator, drive in drives.items():
        name, gain = model.actuator(actuator).name, float(model.actuator_gainprm[actuator, 0])
        low, high = -np.inf, np.inf
        if model.actuator_ctrllimited[actuator]:
            low, high = model.actuator_ctrlrange[actuator].tolist()
        # a limit of a force that depends on the control alone is one of the control
        is_motor = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
        if model.actuator_forcelimited[actuator] and is_motor:
            ends = model.actuator_forcerange[actuator] / gain
            low, high = max(low, float(np.min(ends))), min(high, float(np.max(ends)))
        if name and drive.has_dynamics:
            names.activated.append(name)
        elif name:
            names.inputs[name] = FileInput(drive.control, gain, drive.gains, (low, high))
    return names


def _with_file_velocities(scene: Scene, start: ModelAtStart, bodies: Bodies, report: ImportReport) -> Scene:
    """Return the scene with the velocities of the start state, adjusted to satisfy the constraints.

    The scene stays at rest if the file has no velocities or if the constraints leave none. The report
    receives the size of the adjustment.
    """
    if not np.any(start.data.qvel):
        return scene
    mechanism = scene.mechanism
    linear, angular = np.zeros((2, len(mechanism.bodies), 3))
    for k, body in enumerate(mechanism.bodies[1:], start=1):
        root = bodies.root(body.name)  # MuJoCo's number of the body that the others were merged into
        linear[k], angular[k] = bodies.velocity(root, body.center_of_mass)
    at_rest = State.initial(mechanism)
    # the nearest state that satisfies the constraints
    state = assemble(scene, replace(at_rest, linear_velocity=linear, angular_velocity=angular))
    # report the adjustment: largest change of linear and of angular velocities, and the change as a fraction
    # of the largest velocity
    pairs = ((state.linear_velocity, linear), (state.angular_velocity, angular))
    changes = [float(np.max(np.abs(adjusted - given))) for adjusted, given in pairs]
    largest = [float(np.max(np.abs(given))) for _, given in pairs]
    fractions = [change / size for change, size in zip(changes, largest, strict=True) if size]
    linear_change, angular_change = changes
    report.changed_velocities = ChangedVelocities(
        start.key, linear_change, angular_change, max(fractions, default=0.0)
    )
    report.start.append(
        f"velocities of {start.key}, changed by at most {linear_change:.2e} m/s and "
        f"{angular_change:.2e} rad/s to fit"
    )
    if max(np.max(np.abs(state.linear_velocity)), np.max(np.abs(state.angular_velocity))) < REST_SPEED:
        return scene
    return replace(scene, initial_state=state)
