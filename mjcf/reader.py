"""Read an MJCF file as a scene, with an import report on every element.

MuJoCo compiles the file and resolves its defaults, includes, angles and inertias. The scene is made from the
compiled model at its start: a keyframe or qpos0, with closed loops. Bodies that are fixed to each other
become one body.

The scene is verified against the compiled model, see `newton_euler.reading` and `mjcf.reference`. A model
with actuators is read and verified a second time, with random controls, so that wrong actuators show.
Excitation adds sines to controls and start velocities to joints, see `mjcf.reading.laws`.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping as Given
from collections.abc import Sequence, Sized
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeAlias, Unpack

import mujoco
import numpy as np

from mjcf.errors import heard_warnings
from mjcf.reading.actuators import Actuators, driven_joints
from mjcf.reading.bodies import Bodies
from mjcf.reading.forces import Forces, armatures
from mjcf.reading.joints import Joints, Ties
from mjcf.reading.laws import Drive, excite
from mjcf.reading.leftovers import report_leftovers
from mjcf.reading.loops import Loops
from mjcf.reading.plausibility import key_findings, mesh_findings
from mjcf.reading.source import UNNAMED, SourceError, check_memory, compiled, given, model_name
from mjcf.reading.start import Start
from mjcf.reference import MjcfReference
from newton_euler.arguments import UNCHECKED, checked
from newton_euler.errors import NewtonEulerError, OptionError
from newton_euler.model.forces import Armature, BallArmature
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.source_file import ReadOptions, Request, path_text
from newton_euler.model.spanning_tree import unweld_loops
from newton_euler.model.state import State
from newton_euler.reading import plausibility
from newton_euler.reading.activity import REST_SPEED
from newton_euler.reading.excitation import MAX_FREQUENCY, MIN_FREQUENCY, with_start_velocities
from newton_euler.reading.import_report import ChangedVelocities, ImportReport, unique_name
from newton_euler.reading.reference import ReferenceModel
from newton_euler.reading.verify import verify_report
from newton_euler.runs.assemble import assemble
from newton_euler.scalars import Array

MAX_LISTED_NAMES = 5
"""Largest number of names of actuators in one line of a report."""

DEFAULT_SOLIMP = (0.9, 0.95, 0.001)
"""MuJoCo's default for the first three numbers of `solimp`."""


MujocoModel: TypeAlias = mujoco.MjSpec | mujoco.MjModel
"""Model in memory."""


@dataclass(frozen=True, eq=False)
class Reading:
    """Scene imported from an MJCF file.

    Attributes:
        scene: imported scene.
        report: fate of every element.
        start: MuJoCo's model at the start, without contacts, limits and dry friction.
        drives: actuators that excitation can drive, by number.
    """

    scene: Scene
    report: ImportReport
    start: Start
    drives: dict[int, Drive] = field(default_factory=dict)


@checked
def read(
    model: Annotated[str | os.PathLike[str] | MujocoModel, UNCHECKED],
    key: str | None = None,
    root: str | None = None,
    **options: Unpack[ReadOptions],
) -> Reading:
    """Read an MJCF file, or a model that MuJoCo has in memory.

    Args:
        model: path of the file, or an `MjSpec` or `MjModel` in its present state.
        key: name of the keyframe to start from, or "qpos0". None means the first keyframe, or "qpos0" if the
            model has no keyframe.
        root: folder that must contain all files that the file refers to, see `mjcf.reading.source`.
        options: see `newton_euler.model.source_file.Request`.

    Raises:
        MjcfError: for a model that cannot be read or verified, with file or model name and element.
        OptionError: for a `root` with a model in memory.

    Examples:
        >>> found = mjcf.read("examples/linkage.xml", key="go", duration=2.0)
        >>> found.scene.duration, len(found.report.of("exactly")) > 0
        (2.0, True)
    """
    request = Request.of(options)
    with heard_warnings() as warnings:
        # compile, or copy, and read
        if isinstance(model, str | os.PathLike):
            where = path_text(model, SourceError)
            made, sizes = compiled(where, None if root is None else path_text(root, SourceError))
        else:
            where, made, sizes = given(model)
            if root is not None:
                raise OptionError("root", root, "no root for a model in memory, which refers to no files")
        check_memory(where, made)
        found_of_file = [*mesh_findings(made), *key_findings(made, sizes)]
        found = _reading(where, copy.copy(made), key, request)
        # reference models, excitation, likely mistakes and verification
        try:
            references = [_reference(copy.copy(made), key, found)]
            if made.nu:
                references.append(_driven(where, made, key, request))
            if request.excitation:  # the last use of the model, so no copy is needed
                found = _excited(where, made, key, request, found)
            report = found.report
            report.references.extend(references)
            report.findings.extend(plausibility.findings(found.scene.mechanism))
            report.findings.extend(plausibility.grouped(found_of_file))
            if request.verified:
                report.start.append(verify_report(report))
        except SourceError:
            raise
        except (NewtonEulerError, np.linalg.LinAlgError) as error:
            raise SourceError(where, str(error)) from error
    report.start.extend(f"MuJoCo warns: {warning}" for warning in warnings)
    return found


@np.errstate(all="ignore")  # numbers that overflow are refused later
def _reference(
    model: Any, key: str | None, found: Reading, controls: tuple[Array, Array] | None = None
) -> tuple[ReferenceModel, Scene]:
    """Make the reference model of an imported scene."""
    return MjcfReference(model, key, found.report, found.scene, controls), found.scene


@np.errstate(all="ignore")  # numbers that overflow are refused later
def _driven(where: str, model: Any, key: str | None, request: Request) -> tuple[ReferenceModel, Scene]:
    """Read the model with random controls, and make its reference model."""
    control = _random_control(model)
    driven = _reading(where, copy.copy(model), key, request, control)
    return _reference(copy.copy(model), key, driven, (control, np.array(driven.start.data.act)))


def _random_control(model: Any) -> Array:
    """Draw random controls (nu,) within their ranges, or between -1 and 1 for controls without range."""
    low, high = np.full((2, model.nu), [[-1.0], [1.0]])
    limited = model.actuator_ctrllimited.astype(bool)
    for k in np.flatnonzero(limited):
        places = slice(model.actuator_ctrladr[k], model.actuator_ctrladr[k] + model.actuator_ctrlnum[k])
        low[places], high[places] = model.actuator_ctrlrange[k].reshape(-1, 2).T
    most = mujoco.mjMAXVAL  # MuJoCo refuses larger controls
    low, high = np.clip([low, high], -most, most)
    share = np.random.default_rng(0).uniform(0.1, 0.9, model.nu)
    return np.asarray(low + share * (high - low))


@np.errstate(all="ignore")  # numbers that overflow are refused later
def _excited(where: str, model: Any, key: str | None, request: Request, found: Reading) -> Reading:
    """Add sines to controls, and start velocities unless the file has some. Changes the model."""
    start = found.start
    control, places = np.array(start.data.ctrl), start.model.actuator_ctrladr
    plan = excite(found.scene, found.drives, control, places, found.report.bounds)
    driven = _reading(where, model, key, request, plan.control, plan.swings)
    names = [model.actuator(k).name or repr(k) for k in range(model.nactuator)]
    said = []
    if plan.swings:
        said.append(f"{_count(plan.swings, 'actuator')} driven at {MIN_FREQUENCY:g} to {MAX_FREQUENCY:g} Hz")
    if plan.moved:
        moves = [f"{names[k]} from {old:g} to {new:g}" for k, (old, new) in plan.moved.items()]
        said.append(
            f"{_count(moves, 'control')} moved inside the ranges of control and force ({_first(moves)})"
        )
    if kept := [names[k] for k in range(model.nactuator) if k not in plan.swings]:
        said.append(f"{_count(kept, 'actuator')} with the controls of the file ({_first(kept)})")
    if not np.any(start.data.qvel):
        moved, fastest = with_start_velocities(driven.scene, driven.report.bounds)
        driven = replace(driven, scene=moved)
        said.append(fastest)
    words = ", ".join(said) or "the velocities of the start are enough"
    driven.report.start.append(f"excited: {words}")
    return driven


def _first(texts: Sequence[str]) -> str:
    """Join the first `MAX_LISTED_NAMES` texts, with dots if there are more."""
    return ", ".join(texts[:MAX_LISTED_NAMES]) + (", ..." if texts[MAX_LISTED_NAMES:] else "")


def _count(elements: Sized, noun: str) -> str:
    return f"{len(elements)} {noun}{'' if len(elements) == 1 else 's'}"


def _reading(
    where: str,
    model: Any,
    key: str | None,
    request: Request,
    control: Array | None = None,
    swings: Given[int, Sine] = MappingProxyType({}),
) -> Reading:
    report = ImportReport()
    report.settings = _own_settings(model)
    start = Start(where, model, key, report, request.redundancy_tolerance, control)
    try:
        bodies = Bodies(start, report)
        scene, drives = _scene(start, bodies, report, request, swings)
    except SourceError:
        raise
    except NewtonEulerError as error:
        raise SourceError(where, str(error)) from error
    return Reading(scene, report, start, drives)


def _own_settings(model: Any) -> str:
    """Describe the file's own simulation settings: integrator, time step, `solref` of equalities.

    The solver and `solimp` are included if they are not MuJoCo's defaults.
    """
    integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_").lower()
    words = [f"{integrator} {1e3 * model.opt.timestep:g} ms"]
    if model.opt.solver != mujoco.mjtSolver.mjSOL_NEWTON:
        words.append(f"solver {mujoco.mjtSolver(model.opt.solver).name.removeprefix('mjSOL_')}")
    if model.neq:
        constants = np.unique(model.eq_solref[:, 0])
        words.append(f"solref {' and '.join(f'{value:g}' for value in constants)}")
        softness = np.unique(model.eq_solimp[:, :3], axis=0)
        if np.any(softness != DEFAULT_SOLIMP):
            words.append(f"solimp {' and '.join(' '.join(f'{x:g}' for x in row) for row in softness)}")
    return ", ".join(words)


def _scene(
    start: Start, bodies: Bodies, report: ImportReport, request: Request, swings: Given[int, Sine]
) -> tuple[Scene, dict[int, Drive]]:
    path, model = start.path, start.model
    if len(bodies.bodies) < 2:
        raise SourceError(path, "no body can move")
    joints = Joints(start, bodies, driven_joints(model), report)
    loops = Loops(start, bodies, joints, report)
    gravity = np.array(model.opt.gravity)
    ties = Ties(loops.gears)
    forces = Forces(start, bodies, joints, ties, gravity, report)
    actuators = Actuators(start, bodies, joints, ties, forces, report, swings)
    rotors, of_balls = armatures(start, bodies, joints, ties, report)
    for key, inertia in actuators.armatures.items():
        rotors[key] = rotors.get(key, 0.0) + inertia
    report_leftovers(start, bodies, joints, report)
    # the model's name, or the file's, as the name of the scene
    own = model_name(model)
    name = unique_name(Path(path).stem if own in ("", UNNAMED) else own, "model", ())
    scene = Scene(
        name[:100].strip(".") or "model",
        unweld_loops(Mechanism(bodies.bodies, [*joints.joints, *loops.joints], loops.gears)),
        request.duration,
        request.output_period,
        gravity,
        actuators.laws,
        forces=tuple(forces.forces),
        motions=tuple(loops.held),
        armatures=(
            *(Armature(joint, a, k) for (joint, k), a in rotors.items()),
            *(BallArmature(joint, a) for joint, a in of_balls.items()),
        ),
        description=f"{Path(path).name} from {start.key}",
        redundancy_tolerance=request.redundancy_tolerance,
    )
    return _moving(scene, start, bodies, report), actuators.drives


def _moving(scene: Scene, start: Start, bodies: Bodies, report: ImportReport) -> Scene:
    """Set the initial state to the velocities of the start, adjusted to the constraints."""
    if not np.any(start.data.qvel):
        return scene
    mechanism = scene.mechanism
    linear, angular = np.zeros((2, len(mechanism.bodies), 3))
    for k, body in enumerate(mechanism.bodies[1:], start=1):
        linear[k], angular[k] = bodies.velocity(bodies.root(body.name), body.center_of_mass)
    rest = State.initial(mechanism)
    state = assemble(scene, replace(rest, linear_velocity=linear, angular_velocity=angular))
    # report the adjustment
    pairs = ((state.linear_velocity, linear), (state.angular_velocity, angular))
    changes = [float(np.max(np.abs(found - given))) for found, given in pairs]
    sizes = [float(np.max(np.abs(given))) for _, given in pairs]
    share = max((change / size for change, size in zip(changes, sizes, strict=True) if size), default=0.0)
    report.changed_velocities = ChangedVelocities(start.key, changes[0], changes[1], share)
    report.start.append(
        f"velocities of {start.key}, changed by at most {changes[0]:.2e} m/s and {changes[1]:.2e} rad/s "
        "to fit"
    )
    if max(np.max(np.abs(state.linear_velocity)), np.max(np.abs(state.angular_velocity))) < REST_SPEED:
        return scene
    return replace(scene, initial_state=state)
