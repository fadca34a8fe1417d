"""Report elements that scenes do not simulate, and watch them in runs.

Contacts and tendons are evaluated by MuJoCo at the poses of a run of any engine.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from mjcf.reading.bodies import Bodies
from mjcf.reading.joints import Joints
from mjcf.reading.loops import fixed_tendon_weights
from mjcf.reading.start import ModelAtStart
from newton_euler.model.euler_parameters import rotations
from newton_euler.reading.activity import (
    POINTS_PER_INTERVAL,
    UNSETTLED,
    Activity,
    Bounds,
    Rest,
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
"""Elements that move nothing, and their plurals in reports."""

MAX_LISTED_PAIRS = 3
"""Largest number of touching pairs of geoms that a report names."""

MIN_PENETRATION = 1e-6
"""Smallest penetration of the margin, m, that counts as contact: MuJoCo's default `ccd_tolerance`."""

BODY_ARRAYS = (("geom_xpos", "geom_xmat"), ("site_xpos", "site_xmat"), ("xipos", "ximat"), ("xpos", "xmat"))
"""Arrays of points and rotation matrices in MuJoCo's data that move with bodies."""


def report_leftovers(start: ModelAtStart, bodies: Bodies, joints: Joints, report: ImportReport) -> None:
    """Report all elements that other parts of the reader do not report."""
    model = start.model
    poses = Poses(start, bodies)
    _report_flags(start, report)
    _report_contacts(start, poses, report)
    meshes = int(np.sum(model.geom_dataid >= 0))
    if meshes:
        report.imported(f"{meshes} geoms of meshes", "drawn where visible; their masses are in the bodies")
    # limits and dry friction of joints and tendons
    for number in range(model.njnt):
        _report_joint(start, joints, number, report)
    for tendon in range(model.ntendon):
        element = element_name(model, "tendon", tendon)
        if model.tendon_limited[tendon]:
            why, switched_off = "its limits: limits are one-sided and not simulated", start.disabled("LIMIT")
            watches = [_tendon_watch(start, joints, poses, tendon)]
            bounds = model.tendon_range[tendon].tolist()
            report.left_out(
                element, why, topic=LIMITS, switched_off=switched_off, watches=watches, numbers=bounds
            )
        if model.tendon_frictionloss[tendon]:
            friction = float(model.tendon_frictionloss[tendon])
            why = f"its dry friction {friction:g}"
            switched_off = start.disabled("FRICTIONLOSS")
            keys = [
                joints.coordinate_keys.get(joint)
                for joint in fixed_tendon_weights(start, tendon) or {-1: 0.0}
            ]
            watches_of = [Rest(tuple(key for key in keys if key))] if all(keys) else []
            report.left_out(
                element,
                why,
                topic=FRICTION,
                switched_off=switched_off,
                watches=watches_of,
                numbers=[friction],
            )
    # fluids, flexes and plugins
    option = model.opt
    for name, number in (("density", option.density), ("viscosity", option.viscosity)):
        if number:
            why = f"{number:g}: fluid forces are not simulated"
            report.left_out(f"option {name}", why, topic=name, numbers=[number])
    if np.any(option.wind):
        wind = option.wind.tolist()
        report.left_out("option wind", "fluid forces are not simulated", topic="wind", numbers=wind)
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
    for prefix, what in PASSIVE_ELEMENTS.items():
        count = int(getattr(model, f"n{prefix}"))
        if count:
            report.left_out(f"{count} {what}", "they move nothing", moves_nothing=True)
    report.left_out("options of solver and integrator", "every engine has its own", moves_nothing=True)


def _report_flags(start: ModelAtStart, report: ImportReport) -> None:
    """Report flags of the file that disable forces of its elements."""
    model = start.model
    stiff, damped = (
        any(np.any(getattr(model, name)) for name in names)
        for names in (("jnt_stiffness", "tendon_stiffness"), ("dof_damping", "tendon_damping"))
    )
    for flag, acts, effect in (
        ("GRAVITY", True, "bodies have no weight"),
        ("SPRING", stiff, "its springs exert nothing"),
        ("DAMPER", damped, "its dampers exert nothing"),
    ):
        if acts and start.disabled(flag):
            report.left_out(flag.lower(), f'<flag {flag.lower()}="disable"/>: {effect}', switched_off=True)


def _tendon_watch(start: ModelAtStart, joints: Joints, poses: Poses, tendon: int) -> Watch:
    """Make the watch of a tendon's limits."""
    model, weights = start.model, fixed_tendon_weights(start, tendon)
    if weights is None or any(joint not in joints.coordinate_keys for joint in weights):
        return TendonWatch(poses, tendon)
    low, high = (float(x) for x in model.tendon_range[tendon])
    margin, length = float(model.tendon_margin[tendon]), float(start.data.ten_length[tendon])
    terms = tuple((joints.coordinate_keys[joint], weight) for joint, weight in weights.items())
    slides = {bool(model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE) for joint in weights}
    unit = {True: "m", False: "rad"}[slides.pop()] if len(slides) == 1 else "m or rad"
    return Bounds(terms, low + margin, high - margin, unit, length)


def _report_contacts(start: ModelAtStart, poses: Poses, report: ImportReport) -> None:
    model, switched_off = start.model, start.disabled("CONTACT")
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    for count, what in ((np.sum(touching), "geoms that can touch"), (model.npair, "contact pairs")):
        if count:
            why = "contacts are one-sided and not simulated"
            report.left_out(
                f"{count} {what}",
                why,
                topic=CONTACTS,
                switched_off=switched_off,
                watches=[ContactWatch(poses)],
            )

    if model.nexclude:
        why = "these pairs of bodies cannot touch; contacts are not simulated anyway"
        report.left_out(f"{model.nexclude} contact exclusions", why, moves_nothing=True)


def _report_joint(start: ModelAtStart, joints: Joints, number: int, report: ImportReport) -> None:
    model, element = start.model, element_name(start.model, "joint", number)
    if model.jnt_limited[number]:
        low, high = model.jnt_range[number]
        where, watches = "", list[Watch]()
        if number in joints.coordinate_keys:
            x = float(start.data.qpos[model.jnt_qposadr[number]])
            where = "" if low <= x <= high else f"; the start is outside of them, at {x:.4g}"
            unit = "m" if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_SLIDE else "rad"
            margin = float(model.jnt_margin[number])
            watches.append(
                Bounds(((joints.coordinate_keys[number], 1.0),), low + margin, high - margin, unit, x)
            )
        why = f"its limits {low:.4g} to {high:.4g}{where}: limits are one-sided and not simulated"
        switched_off = start.disabled("LIMIT")
        report.left_out(
            element, why, topic=LIMITS, switched_off=switched_off, watches=watches, numbers=[low, high]
        )
    dof = int(model.jnt_dofadr[number])
    if friction := float(model.dof_frictionloss[dof]):
        switched_off = start.disabled("FRICTIONLOSS")
        why, key = f"its dry friction {friction:g}", joints.coordinate_keys.get(number)
        resting = [Rest((key,))] if key else []
        report.left_out(
            element, why, topic=FRICTION, switched_off=switched_off, watches=resting, numbers=[friction]
        )


class Poses:
    """Compiled model with its contacts, whose bodies are placed at the poses of a run."""

    def __init__(self, start: ModelAtStart, bodies: Bodies) -> None:
        self._read = start.model
        model, data = start.model, start.data
        numbers = {name: k for k, name in enumerate(body.name for body in bodies.bodies)}
        of_bodies = np.array([numbers[name] for name in bodies.names])
        self._owners = {
            "geom_xpos": of_bodies[model.geom_bodyid],
            "site_xpos": of_bodies[model.site_bodyid],
            "xipos": of_bodies,
            "xpos": of_bodies,
        }
        centers = np.array([body.center_of_mass for body in bodies.bodies])
        turns = rotations(np.array([body.quaternion for body in bodies.bodies]))
        self._local: dict[str, tuple[Array, Array]] = {}
        for points, axes in BODY_ARRAYS:
            into = turns[self._owners[points]].transpose(0, 2, 1)
            arms = getattr(data, points) - centers[self._owners[points]]
            local = into @ arms[:, :, None], into @ getattr(data, axes).reshape(-1, 3, 3)
            self._local[points] = local[0][:, :, 0], local[1]

    @cached_property
    def model(self) -> Any:
        """Copy of the model with contacts and constraints enabled."""
        model = copy.copy(self._read)
        for bit in ("CONTACT", "CONSTRAINT"):
            model.opt.disableflags &= ~int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{bit}"))
        return model

    def along(self, motion: SampledMotion) -> Iterator[tuple[float, Any]]:
        """Yield the times of a run and MuJoCo's data with the poses, before collisions and tendons."""
        data = mujoco.MjData(self.model)
        all_centers, quaternions = motion.poses
        for time, centers, turns in zip(
            motion.time.tolist(), all_centers, rotations(quaternions), strict=True
        ):
            for points, axes in BODY_ARRAYS:
                owners, (arms, local) = self._owners[points], self._local[points]
                getattr(data, points)[:] = centers[owners] + (turns[owners] @ arms[:, :, None])[:, :, 0]
                getattr(data, axes)[:] = (turns[owners] @ local).reshape(-1, 9)
            yield time, data


class ContactWatch:
    """Watch of contacts: a contact acts if two geoms are nearer than their margin."""

    def __init__(self, poses: Poses) -> None:
        self._poses = poses

    def judge(self, motion: SampledMotion) -> Activity:
        model, count = self._poses.model, 0
        pairs: dict[tuple[int, int], tuple[float, float]] = {}  # first time, s, and depth, m
        for time, data in self._poses.along(motion):
            mujoco.mj_collision(model, data)
            depths = np.where(data.contact.exclude == 0, data.contact.includemargin - data.contact.dist, 0.0)
            if not np.any(depths > MIN_PENETRATION):
                continue
            count += 1
            for number in np.argsort(-depths)[: np.sum(depths > MIN_PENETRATION)]:
                one, two = map(int, data.contact.geom[number])
                pairs.setdefault((one, two), (time, float(depths[number])))
        if pairs:
            words = f"active at {count} of {len(motion.time)} time points"
            for pair, (time, depth) in list(pairs.items())[:MAX_LISTED_PAIRS]:
                order = "then" if "first" in words else "first"
                names = " and ".join(map(self._name, pair))
                words += f", {order} at {time:.4g} s: {names}, {depth:.3g} m nearer than their margin"
            if len(pairs) > MAX_LISTED_PAIRS:
                words += f", and {len(pairs) - MAX_LISTED_PAIRS} more pairs"
            return Activity(words, next(iter(pairs.values()))[0], settled=motion.is_fine)
        if not motion.is_fine:
            return Activity(UNSETTLED, 0.0, settled=False)
        between = f"and at {POINTS_PER_INTERVAL - 1} time points between each two"
        return Activity(f"inactive at all {len(motion.run.time)} output times {between}")

    def _name(self, geom: int) -> str:
        if geom < 0:
            return "a flex"
        name = self._poses.model.geom(geom).name
        body = self._poses.model.body(int(self._poses.model.geom_bodyid[geom])).name
        return f"geom {name!r}" if name else f"a geom of {body!r}"


class TendonWatch:
    """Watch of the limits of a spatial tendon, with lengths by MuJoCo."""

    def __init__(self, poses: Poses, tendon: int) -> None:
        self._poses, self._tendon = poses, tendon

    def judge(self, motion: SampledMotion) -> Activity:
        model, lengths = self._poses.model, []
        margin = float(model.tendon_margin[self._tendon])
        low, high = (float(x) for x in model.tendon_range[self._tendon])
        for _, data in self._poses.along(motion):
            mujoco.mj_tendon(model, data)
            lengths.append(float(data.ten_length[self._tendon]))
        doubt = np.full(len(motion.run.time) - 1, 0.0 if motion.is_fine else np.inf)
        return Bounds((), low + margin, high - margin, "m").judge_values(
            motion.time, np.array(lengths), doubt
        )
