"""Put a scene on a moving base, such as a boat, a vehicle or a shaking table; read base motions from files.

The ground of a scene becomes a body, the base, together with everything that was attached to the ground. A
joint connects the base to a new ground, the world. The base has a reference point c at the initial pose; its
position r and rotation A in the world are

    r = c + surge x + sway y + heave z,    A = R_z(yaw) R_y(pitch) R_x(roll)

in the world's axes x, y, z of the scene's initial pose: yaw about the world's z, then pitch about the base's
y, then roll about the base's x. If z is up and x is ahead, y is to the left, and positive pitch lowers the
bow.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from newton_euler.arguments import checked
from newton_euler.errors import MechanismError, choices, finite_array, listed, quoted
from newton_euler.model.compound_joint import Compound
from newton_euler.model.euler_parameters import from_rotation, from_rotation_vector, product, rotation
from newton_euler.model.joint_kinds import Free
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import PrescribedMotion, TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import SourceError, TimeTable, check_names, csv_rows, path_text, read_text
from newton_euler.model.splines import Spline
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array, Floats

X, Y, Z = np.eye(3)
"""Unit vectors of the axes."""

SLIDES = {"surge": X, "sway": Y, "heave": Z}
"""World axis of each translation of the base, by name of the motion."""

HINGES = {"yaw": Z, "pitch": Y, "roll": X}
"""Axis of each rotation of the base, by name of the motion, in the order from the world to the base."""


@checked
def on_moving_base(
    scene: Scene,
    motions: Mapping[str, TimeFunction] | None = None,
    hull: Body | None = None,
    point: ArrayLike = (0.0, 0.0, 0.0),
    world: str = "world",
    joint: str = "base_motion",
) -> Scene:
    """Return a scene whose ground has become a body, the base, that moves as prescribed or floats.

    Joints, forces, control and shapes stay on the body with the ground's name. The base starts with the pose
    and the velocity of its motion at time 0, and the mechanism with its initial state relative to the base.

    Args:
        scene: the scene on the base.
        motions: functions of time by name: surge, sway, heave (m along x, y, z of the world) and roll, pitch,
            yaw (rad); others stay 0. The rotation is R_z(yaw) R_y(pitch) R_x(roll). If None, the base floats
            freely.
        hull: body with the mass, center of mass, inertia and shapes of the base at the scene's initial pose.
            If None, the base has the mass of the ground. If the ground has no mass, the base of a prescribed
            motion gets the mass of the mechanism, which affects only the forces that move the base.
        point: (3,) reference point c, m, in the world at the initial pose.
        world: name of the new ground.
        joint: name of the joint between world and base, with a coordinate for each given motion: slides in
            the order surge, sway, heave, then hinges in the order yaw, pitch, roll.

    Returns:
        The scene on the base, with a body more and a joint more.

    Raises:
        MechanismError: for an unknown motion, a name in use, or a floating base without a mass.

    Examples:
        >>> waves = {"heave": Sine(0.3, 1.1), "roll": Sine(0.1, 1.1, phase=0.5)}
        >>> scene = on_moving_base(load("pendulum"), waves)
        >>> scene.mechanism.body_names, scene.mechanism.joint("base_motion").coordinate_kinds
        (('world', 'ground', 'dumbbell'), ('slide', 'hinge'))
        >>> simulate(scene).joint("base_motion").coordinates.shape  # m and rad over time
        (1001, 2)
    """
    # check the reference point and the names
    where = f"moving base of scene {quoted(scene.name)}"
    center: Any = finite_array(where, "point", point, (3,))
    mechanism = scene.mechanism
    for what, name in (("world", world), ("joint", joint)):
        if name in mechanism.body_names + mechanism.joint_names:
            raise MechanismError(where, f"{what} is {quoted(name)}, a name that is in use", "another name")
    # the base, and its joint with the world
    base = _base(where, mechanism, hull, center, floats=motions is None)
    base_joint: Free | Compound
    ordered = {} if motions is None else _in_order(where, motions)
    if motions is None:
        base_joint = Free(joint, world, base.name, center)
    else:
        axes: dict[str, Any] = {
            "slides": [axis for name, axis in SLIDES.items() if name in ordered],
            "hinges": [axis for name, axis in HINGES.items() if name in ordered],
        }
        base_joint = Compound(joint, world, base.name, center, **axes)
    # the scene with two more elements and the motions of the joint
    prescribed = [PrescribedMotion(joint, function, k) for k, function in enumerate(ordered.values())]
    bodies = [Body.ground(world), base, *mechanism.bodies[1:]]
    return replace(
        scene,
        mechanism=Mechanism(bodies, [*mechanism.joints, base_joint], mechanism.couplings),
        motions=(*scene.motions, *prescribed),
        initial_state=_in_world(initial_state(scene), base, ordered, center),
    )


def _in_order(where: str, motions: Mapping[str, TimeFunction]) -> dict[str, TimeFunction]:
    """Check the names of motions, and return the motions in the order of the joint's coordinates.

    `where` is the beginning of error messages.
    """
    names = (*SLIDES, *HINGES)
    if not motions:
        needed = f"functions of time by {', '.join(names)}"
        raise MechanismError(where, f"motions is {quoted(motions)}", needed)
    for name in motions:
        if name not in names:
            raise MechanismError(where, f"unknown motion {quoted(name)}", choices(name, names))
    return {name: motions[name] for name in names if name in motions}


def _base(where: str, mechanism: Mechanism, hull: Body | None, center: Floats, floats: bool) -> Body:
    """Return the body that replaces the ground.

    Args:
        where: beginning of error messages.
        mechanism: the mechanism with the ground.
        hull: mass properties and shapes of the base; None for those of the ground.
        center: (3,) reference point, m, world frame at the initial pose.
        floats: True for a base without prescribed motion, which needs a mass.
    """
    ground = mechanism.bodies[0]
    if hull is not None:
        shapes, meshes = (*ground.shapes, *hull.shapes), (*ground.meshes, *hull.meshes)
        return replace(hull, name=ground.name, shapes=shapes, meshes=meshes)
    if ground.mass > 0.0:
        return ground
    if floats:
        problem = f"floats, and ground {quoted(ground.name)} has no mass"
        raise MechanismError(where, problem, "hull=Body(...), whose mass it takes")
    mass = sum(body.mass for body in mechanism.bodies[1:])
    inertia = mass * mechanism.size**2 * np.eye(3)
    return replace(ground, mass=mass, center_of_mass=center, inertia=inertia)


def _in_world(state: State, base: Body, motions: Mapping[str, TimeFunction], center: Floats) -> State:
    """Convert a state relative to the base to a state in the world, with the motion of the base at time 0.

    Args:
        state: state of the scene, whose first body is the ground.
        base: body that replaces the ground.
        motions: motions of the base by name, slides first, in the order of the joint's coordinates.
        center: (3,) reference point of the base, m.

    Returns:
        State of the world (at rest), the base and the other bodies.
    """
    # translation, velocity, angular velocity and rotation matrix of the base, in the world
    shift, velocity, omega, turn = np.zeros(3), np.zeros(3), np.zeros(3), np.eye(3)
    for name, function in motions.items():
        x, rate = float(function.value(0.0)), float(function.rate(0.0))
        if name in SLIDES:
            shift, velocity = shift + x * SLIDES[name], velocity + rate * SLIDES[name]
        else:
            omega = omega + rate * (turn @ HINGES[name])
            turn = turn @ rotation(from_rotation_vector(x * HINGES[name]))
    # the base and all bodies on it, in the world: arms are the vectors from the reference point to the
    # centers of mass; relative velocities are those of the given state
    zero, quaternion = np.zeros(3), from_rotation(turn)
    arms = (np.vstack([base.center_of_mass, state.position[1:]]) - center) @ turn.T
    relative_velocities = np.vstack([zero, state.linear_velocity[1:]]) @ turn.T
    relative_spins = np.vstack([zero, state.angular_velocity[1:]]) @ turn.T
    quaternions = [product(quaternion, p) for p in (base.quaternion, *state.quaternion[1:])]
    # the world, at rest, comes first; the hinge angles of the scene's joints do not depend on the base
    return State(
        position=np.vstack([zero, center + shift + arms]),
        quaternion=np.vstack([[1.0, 0.0, 0.0, 0.0], *quaternions]),
        linear_velocity=np.vstack([zero, velocity + np.cross(omega, arms) + relative_velocities]),
        angular_velocity=np.vstack([zero, omega + relative_spins]),
        angles=state.angles,
    )


# Files of poses

POSITION_COLUMNS = {"x": "surge", "y": "sway", "z": "heave"}
"""Motion that each position column of a file gives."""

QUATERNION_COLUMNS = ("qw", "qx", "qy", "qz")
"""Columns of a file with the rotation of the base as a quaternion."""

ANGLE_COLUMNS = ("roll", "pitch", "yaw")
"""Columns of a file with the rotation of the base as angles, rad."""

MIN_ROWS = 6
"""Smallest number of poses in a file: a polynomial of the spline of degree 5 has 6 coefficients."""

MAX_GAP = 5.0
"""Largest time between two rows, divided by the median time; a longer gap means that poses are missing."""

MAX_NORM_ERROR = 1e-3
"""Largest deviation of a quaternion's norm from 1, because files round numbers to a few digits."""

MAX_PITCH = np.radians(80.0)
"""Largest pitch, rad. At 90 degrees, yaw and roll have the same axis and are not unique."""


@checked
def base_motion_from_csv(path: str | os.PathLike[str]) -> dict[str, Spline]:
    """Read poses of a base over time, for `on_moving_base`.

    A file with a heave and a roll begins like this:

        time,z,roll
        0.0,0.000,0.000
        0.1,0.012,0.010

    The first line names the columns in any order: `time`, s; any of `x`, `y`, `z`, m, for surge, sway and
    heave; any of `roll`, `pitch`, `yaw`, rad, or a quaternion `qw`, `qx`, `qy`, `qz`, which is converted to
    these angles. Time 0 of the motion is the first row. Angles continue through full revolutions.

    Splines of degree 5 interpolate each column, see `newton_euler.Spline`. For a wave of period T with rows
    every T / 20, the relative error is 1e-7 of the motion and 1.4e-5 of the acceleration; near the first and
    the last row 1e-5 and 5e-3. The second derivative amplifies the noise of the poses.

    Args:
        path: path of the CSV file.

    Returns:
        A function for each column but the time, by `surge`, `sway`, `heave`, `roll`, `pitch` or `yaw`.

    Raises:
        SourceError: naming the file and the line (the first line is 1): missing cells, cells without a
            number, times that do not ascend or leave gaps, quaternions without norm 1, a pitch beyond 80
            degrees, too few rows, and unknown columns.

    Examples:
        >>> time = np.arange(0.0, 10.05, 0.1)
        >>> rows = np.column_stack([time, 0.1 * np.sin(time)])
        >>> np.savetxt("boat.csv", rows, delimiter=",", header="time,roll", comments="")
        >>> boat = on_moving_base(load("pendulum"), base_motion_from_csv("boat.csv"))
        >>> print(simulate(boat).joint("base_motion").coordinates[125].round(4))  # rad, 0.1 sin 1.25
        [0.0949]
    """
    table = _read(path_text(path), path)
    time = table.columns["time"]
    motions = {
        POSITION_COLUMNS[name]: table.columns[name] for name in POSITION_COLUMNS if name in table.columns
    }
    if QUATERNION_COLUMNS[0] in table.columns:
        angles = _angles(table)
    else:
        angles = {name: table.columns[name] for name in ANGLE_COLUMNS if name in table.columns}
    if "pitch" in angles:
        too_large = np.abs(angles["pitch"]) > MAX_PITCH
        table.refuse(too_large, "pitch", angles["pitch"], f"at most {MAX_PITCH:.4g} rad, 80 degrees")
    motions |= {name: np.unwrap(column) for name, column in angles.items()}
    return {name: Spline(time - time[0], column) for name, column in motions.items()}


def _read(where: str, path: str | os.PathLike[str]) -> TimeTable:
    """Read a file of poses and check its times.

    Args:
        where: text of the path in error messages.
        path: the file, of limited size ("csv_size" is the name of the limit).

    Raises:
        SourceError: naming the file and the line.
    """
    # rows are pairs (number of the line, cells)
    rows = csv_rows(where, read_text(path, "csv_size"))
    header = [cell.lower() for cell in rows[0].cells] if rows else []
    _check_header(where, header)
    if len(rows) <= MIN_ROWS:
        raise SourceError(where, f"has {len(rows) - 1} rows of poses; needed: {MIN_ROWS} or more")
    table = TimeTable.of(where, header, rows[1:])
    time = table.columns["time"]
    steps = np.diff(time)
    longest = MAX_GAP * float(np.median(steps))
    needed = f"at most {longest:.6g} s after the row before, {MAX_GAP:g} times as usual"
    table.refuse(np.append(False, steps > longest), "time", time, needed)
    return table


def _angles(table: TimeTable) -> dict[str, Array]:
    """Compute roll, pitch and yaw (n,), rad, from the quaternions of a file of n poses."""
    quaternions = np.column_stack([table.columns[name] for name in QUATERNION_COLUMNS])
    norms = np.linalg.norm(quaternions, axis=1)
    table.refuse(
        np.abs(norms - 1.0) > MAX_NORM_ERROR, "the norm of the quaternion", norms, f"1, to {MAX_NORM_ERROR:g}"
    )
    w, x, y, z = (quaternions / norms[:, None]).T
    return {
        "roll": np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        "pitch": np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)),
        "yaw": np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    }


def _check_header(path: str, header: Sequence[str]) -> None:
    """Raise `SourceError` for unknown, repeated, missing or redundant columns."""
    known = ("time", *POSITION_COLUMNS, *ANGLE_COLUMNS, *QUATERNION_COLUMNS)
    for name in header:
        if name not in known:
            raise SourceError(path, f"line 1: unknown column {quoted(name)}; {choices(name, known)}")
    check_names(path, header)
    given = set(header)
    if "time" not in given or len(given) < 2:
        raise SourceError(path, "line 1: needed: a column time, and at least one of poses")
    if given & set(QUATERNION_COLUMNS) and (
        not given >= set(QUATERNION_COLUMNS) or given & set(ANGLE_COLUMNS)
    ):
        needed = f"all of {', '.join(QUATERNION_COLUMNS)}, or any of {', '.join(ANGLE_COLUMNS)}"
        raise SourceError(path, f"line 1: has columns {listed(header)}; needed: {needed}")
