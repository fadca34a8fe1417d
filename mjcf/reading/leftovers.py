"""Report the elements of an MJCF file that imported scenes do not simulate, and watch these elements in runs.

Scenes have no contacts, limits, dry friction, fluids and deformable bodies. The import report lists these
elements as left out. A watch tests, after a run of any engine, whether an element would have acted. For
contacts and tendons, MuJoCo evaluates collisions and lengths at the poses of the run.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from mjcf.loops import fixed_tendon_weights
from mjcf.reading.bodies import Bodies
from mjcf.reading.joints import Joints
from mjcf.reading.start import PASSIVE_FEATURES, ModelAtStart
from newton_euler.model.euler_parameters import rotations
from newton_euler.reading.activity import (
    POINTS_PER_INTERVAL,
    UNSETTLED,
    Activity,
    Bounds,
    FrictionWatch,
    SampledMotion,
    Watch,
)
from newton_euler.reading.import_report import CONTACTS, FRICTION, LIMITS, ImportReport
from newton_euler.scalars import Array

PASSIVE_ELEMENTS = {
    "sensor": "sensors",
    "cam": "cameras",
    "light": "lights",
    "skin": "skins",
    "text": "texts",
    "numeric": "numbers",
    "tuple": "tuples",
}
"""Kinds of elements that move nothing, as in MuJoCo's counts (`ncam`, ...), and their plurals in reports."""

MAX_LISTED_PAIRS = 3
"""Largest number of touching pairs of geoms that a report names."""

MIN_PENETRATION = 1e-6
"""Depth, m, of two geoms within their margin above which they are in contact: MuJoCo's `ccd_tolerance`, the
accuracy of collision distances."""

BODY_ARRAYS = (("geom_xpos", "geom_xmat"), ("site_xpos", "site_xmat"), ("xipos", "ximat"), ("xpos", "xmat"))
"""Pairs of arrays in `MjData` that move with bodies: points and rotation matrices."""

POSES_AT_ONCE = 64
"""Number of times whose arrays of points and rotations are computed together: 2 MB per 100 geoms."""


def report_leftovers(start: ModelAtStart, bodies: Bodies, joints: Joints, report: ImportReport) -> None:
    """Report all elements that the other modules of the reader do not report.

    Limits and dry friction of joints are reported by `mjcf.reading.friction_and_limits`.

    Args:
        start: MuJoCo's model and data at the start state.
        bodies: imported bodies.
        joints: imported joints of the tree.
        report: report that receives the entries.
    """
    model = start.model
    poses = Poses(start, bodies)
    # gravity, springs and dampers that the file disables; contacts; meshes
    _report_flags(start, report)
    _report_contacts(start, poses, report)
    mesh_count = int(np.sum(model.geom_dataid >= 0))
    if mesh_count:
        report.imported(
            f"{mesh_count} geoms of meshes", "drawn where visible; their masses are in the bodies"
        )
    # limits and dry friction of tendons
    for tendon in range(model.ntendon):
        element = element_name(model, "tendon", tendon)
        if model.tendon_limited[tendon]:
            why, switched_off = "its limits: limits are one-sided and not simulated", start.disabled("LIMIT")
            watches = [_tendon_watch(start, joints, poses, tendon)]
            report.left_out(element, why, topic=LIMITS, switched_off=switched_off, watches=watches)
        if model.tendon_frictionloss[tendon]:
            friction = float(model.tendon_frictionloss[tendon])
            why = f"its dry friction {friction:g}"
            switched_off = start.disabled("FRICTIONLOSS")
            report.left_out(
                element,
                why,
                topic=FRICTION,
                switched_off=switched_off,
                watches=_tendon_friction_watches(start, joints, tendon),
            )
    # fluids, flexes and plugins
    option = model.opt
    no_passive_forces = all(start.disabled(feature) for feature in PASSIVE_FEATURES)
    for name, value in (("density", option.density), ("viscosity", option.viscosity)):
        if value:
            why = f"{value:g}: fluid forces are not simulated"
            report.left_out(f"option {name}", why, topic=name, switched_off=no_passive_forces)
    if np.any(option.wind):
        why = "fluid forces are not simulated"
        report.left_out("option wind", why, topic="wind", switched_off=no_passive_forces)
    if model.nflex:
        why = "deformable bodies are not simulated"
        report.left_out(f"{model.nflex} flexes", why)
    if model.nplugin:
        report.left_out(f"{model.nplugin} plugins", "their effect is unknown")
    # elements that move nothing
    if model.nkey > 1:
        names = ", ".join(repr(model.key(k).name or str(k)) for k in range(model.nkey))
        why = f"one is the start; --set key=NAME for another of {names}"
        report.left_out("other keyframes", why, moves_nothing=True)
    for prefix, plural in PASSIVE_ELEMENTS.items():
        count = int(getattr(model, f"n{prefix}"))
        if count:
            report.left_out(f"{count} {plural}", "they move nothing", moves_nothing=True)
    report.left_out("options of solver and integrator", "every engine has its own", moves_nothing=True)


def _report_flags(start: ModelAtStart, report: ImportReport) -> None:
    """Report the flags of the file that disable gravity, springs or dampers that the file has."""
    model = start.model
    springs = model.jnt_stiffness, model.jnt_stiffnesspoly, model.tendon_stiffness, model.tendon_stiffnesspoly
    dampers = model.dof_damping, model.dof_dampingpoly, model.tendon_damping, model.tendon_dampingpoly
    has_springs, has_dampers = (any(np.any(each) for each in arrays) for arrays in (springs, dampers))
    for flag, has_elements, effect in (
        ("GRAVITY", True, "bodies have no weight"),
        ("SPRING", has_springs, "its springs exert nothing"),
        ("DAMPER", has_dampers, "its dampers exert nothing"),
    ):
        if has_elements and start.disabled(flag):
            report.left_out(flag.lower(), f'<flag {flag.lower()}="disable"/>: {effect}', switched_off=True)


def _tendon_friction_watches(start: ModelAtStart, joints: Joints, tendon: int) -> list[FrictionWatch]:
    """Return the watch of a tendon's dry friction: a fixed tendon rests if all its joint coordinates rest.

    Other tendons, and fixed tendons of a joint without a coordinate, have no watch.
    """
    keys = [joints.coordinate_keys.get(joint) for joint in fixed_tendon_weights(start.model, tendon) or ()]
    known = tuple(key for key in keys if key)
    return [FrictionWatch(known)] if keys and len(known) == len(keys) else []


def _tendon_watch(start: ModelAtStart, joints: Joints, poses: Poses, tendon: int) -> Watch:
    """Return the watch of a tendon's limits of length.

    The length of a fixed tendon is a weighted sum of joint coordinates, which `Bounds` watches. MuJoCo
    computes the lengths of all other tendons.
    """
    model, weights = start.model, fixed_tendon_weights(start.model, tendon)
    if weights is None or any(joint not in joints.coordinate_keys for joint in weights):
        return TendonWatch(poses, tendon)
    low, high = (float(x) for x in model.tendon_range[tendon])
    # MuJoCo's limit acts from `margin` inside the range on; `length` is the length at the start
    margin, length = float(model.tendon_margin[tendon]), float(start.data.ten_length[tendon])
    terms = tuple((joints.coordinate_keys[joint], weight) for joint, weight in weights.items())
    are_slides = [bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE) for joint in weights]
    unit = "m" if all(are_slides) else "m or rad" if any(are_slides) else "rad"
    return Bounds(terms, low + margin, high - margin, unit, constant=length)


def _report_contacts(start: ModelAtStart, poses: Poses, report: ImportReport) -> None:
    """Report geoms and pairs of geoms that can touch, with the watch of contacts, and contact exclusions."""
    model, switched_off = start.model, start.disabled("CONTACT")
    can_touch = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    geoms, pairs = ("geom that can touch", "geoms that can touch"), ("contact pair", "contact pairs")
    for count, (singular, plural) in ((int(np.sum(can_touch)), geoms), (model.npair, pairs)):
        if count:
            why = "contacts are one-sided and not simulated"
            report.left_out(
                f"{count} {singular if count == 1 else plural}",
                why,
                topic=CONTACTS,
                switched_off=switched_off,
                watches=[ContactWatch(poses)],
            )

    if model.nexclude:
        why = "these pairs of bodies cannot touch; contacts are not simulated anyway"
        what = "contact exclusion" if model.nexclude == 1 else "contact exclusions"
        report.left_out(f"{model.nexclude} {what}", why, moves_nothing=True)


class Poses:
    """Compiled model with its contacts, whose geoms, sites and bodies are placed at the poses of a run.

    A run has the poses of the scene's bodies: any engine may have simulated them.
    """

    def __init__(self, start: ModelAtStart, bodies: Bodies) -> None:
        """Store positions and orientations of geoms, sites and bodies relative to the scene's bodies.

        Args:
            start: MuJoCo's model and data at the start state.
            bodies: imported bodies, at the same state.
        """
        self._model_at_start = start.model
        model, data = start.model, start.data
        # number of the scene's body for each of MuJoCo's bodies, and for each row of the arrays of points
        numbers = {body.name: k for k, body in enumerate(bodies.bodies)}
        scene_body = np.array([numbers[name] for name in bodies.names])
        self._scene_bodies = {
            "geom_xpos": scene_body[model.geom_bodyid],
            "site_xpos": scene_body[model.site_bodyid],
            "xipos": scene_body,
            "xpos": scene_body,
        }
        centers = np.array([body.center_of_mass for body in bodies.bodies])
        body_axes = rotations(np.array([body.quaternion for body in bodies.bodies]))
        # offset (n, 3) from the center of mass and rotation (n, 3, 3), in the frame of the scene's body
        self._local: dict[str, tuple[Array, Array]] = {}
        for points, axes in BODY_ARRAYS:
            to_body = body_axes[self._scene_bodies[points]].transpose(0, 2, 1)
            arms = getattr(data, points) - centers[self._scene_bodies[points]]
            offsets = (to_body @ arms[:, :, None])[:, :, 0]
            self._local[points] = offsets, to_body @ getattr(data, axes).reshape(-1, 3, 3)

    @cached_property
    def model(self) -> Any:
        """Copy of the model at the start, which has no contacts, with contacts and constraints enabled."""
        model = copy.copy(self._model_at_start)
        for bit in ("CONTACT", "CONSTRAINT"):
            model.opt.disableflags &= ~int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{bit}"))
        return model

    def along(self, motion: SampledMotion) -> Iterator[tuple[float, Any]]:
        """Yield each time, s, of a run with MuJoCo's data, in which only the poses of that time are set.

        The caller computes collisions or lengths of tendons from the poses.
        """
        data = mujoco.MjData(self.model)
        all_centers, quaternions = motion.poses
        for first in range(0, len(motion.time), POSES_AT_ONCE):
            chunk = slice(first, first + POSES_AT_ONCE)
            centers, body_axes = all_centers[chunk], rotations(quaternions[chunk])
            # for each array of MuJoCo's data, its values (t, n, k) at the t times of the chunk
            moved: list[tuple[Array, Array]] = []
            for points, axes in BODY_ARRAYS:
                bodies, (offsets, local_axes) = self._scene_bodies[points], self._local[points]
                turned = body_axes[:, bodies]
                places = centers[:, bodies] + (turned @ offsets[:, :, None])[..., 0]
                moved.append((getattr(data, points), places))
                moved.append((getattr(data, axes), (turned @ local_axes).reshape(*places.shape[:2], 9)))
            for k, time in enumerate(motion.time[chunk].tolist()):
                for array, values in moved:
                    array[:] = values[k]
                yield time, data


class ContactWatch:
    """Watch of contacts: a contact would act if two geoms are nearer than their margin."""

    def __init__(self, poses: Poses) -> None:
        """Watch all contacts of the model of `poses`."""
        self._poses = poses

    def judge(self, motion: SampledMotion) -> Activity:
        """Report whether contacts would have acted in a run, with the first pairs that touch.

        The answer is not settled if the samples of the motion are too coarse to see short contacts.
        """
        model, count = self._poses.model, 0  # number of time points with contact
        # first time, s, and depth at that time, m, of each pair of geoms
        pairs: dict[tuple[int, int], tuple[float, float]] = {}
        for time, data in self._poses.along(motion):
            mujoco.mj_collision(model, data)
            if data.ncon == 0:
                continue
            # depth of each contact within the margin of its geoms; `exclude` is 0 for contacts that act
            depths = np.where(data.contact.exclude == 0, data.contact.includemargin - data.contact.dist, 0.0)
            if not np.any(depths > MIN_PENETRATION):
                continue
            count += 1
            deepest_first = np.argsort(-depths)[: np.sum(depths > MIN_PENETRATION)]
            for number in deepest_first:
                geom_1, geom_2 = map(int, data.contact.geom[number])
                pairs.setdefault((geom_1, geom_2), (time, float(depths[number])))
        if pairs:
            words = f"active at {count} of {len(motion.time)} time points"
            for pair, (time, depth) in list(pairs.items())[:MAX_LISTED_PAIRS]:
                order = "then" if "first" in words else "first"
                names = " and ".join(map(self._describe_geom, pair))
                words += f", {order} at {time:.4g} s: {names}, {depth:.3g} m nearer than their margin"
            if len(pairs) > MAX_LISTED_PAIRS:
                words += f", and {len(pairs) - MAX_LISTED_PAIRS} more pairs"
            first_time, _ = next(iter(pairs.values()))
            return Activity(words, since=first_time, settled=motion.is_fine)
        if not motion.is_fine:
            return Activity(UNSETTLED, since=0.0, settled=False)  # may act from the start on
        between = f"and at {POINTS_PER_INTERVAL - 1} time points between each two"
        return Activity(f"inactive at all {len(motion.run.time)} output times {between}")

    def _describe_geom(self, geom: int) -> str:
        """Describe geom number `geom` by its name or its body; MuJoCo's number of a flex is negative."""
        if geom < 0:
            return "a flex"
        name = self._poses.model.geom(geom).name
        body = self._poses.model.body(int(self._poses.model.geom_bodyid[geom])).name
        return f"geom {name!r}" if name else f"a geom of {body!r}"


class TendonWatch:
    """Watch of the limits of length of a tendon through sites and around geoms."""

    def __init__(self, poses: Poses, tendon: int) -> None:
        """Watch tendon number `tendon` of the model of `poses`."""
        self._poses, self._tendon = poses, tendon

    def judge(self, motion: SampledMotion) -> Activity:
        """Report whether the length, as MuJoCo computes it, would have left its limits in a run."""
        model, lengths = self._poses.model, []
        margin = float(model.tendon_margin[self._tendon])
        low, high = (float(x) for x in model.tendon_range[self._tendon])
        for _, data in self._poses.along(motion):
            mujoco.mj_tendon(model, data)
            lengths.append(float(data.ten_length[self._tendon]))
        # interpolation errors of the length, m, in each output interval: unknown, so that they count as 0 if
        # the samples are fine enough, and as infinite if not
        errors = np.full(len(motion.run.time) - 1, 0.0 if motion.is_fine else np.inf)
        limits = Bounds((), low + margin, high - margin, "m")
        return limits.judge_values(motion.time, np.array(lengths), errors)
