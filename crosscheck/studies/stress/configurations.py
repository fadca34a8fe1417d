"""Stress cases (g) and (h): starts that violate the constraints, and singular configurations."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from crosscheck.library import load
from crosscheck.studies.stress.cases import (
    ANGLE_BOUND,
    ENERGY_BOUND,
    Bound,
    Case,
    Measurement,
    of_run,
    refusal,
)
from crosscheck.studies.stress.runs import (
    COMBINATIONS,
    ONE_EACH,
    STANDARD_GRAVITY,
    Setting,
    largest_drift,
    largest_energy_error,
    lasting,
    mujoco,
    newton_euler,
    parallelogram_error,
    pinocchio,
)
from newton_euler.integrators.projection import joint_violations
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import from_rotation_vector, product
from newton_euler.model.joint_kinds import Prismatic, Revolute, Spherical, Universal
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Body, Mechanism
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.scene import OutputName, Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import CONSISTENT_STARTS, assemble, initial_state

# (g) Starts that violate the constraints: the result of the assembly, and the run of each engine

START_OFFSETS = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
"""m and rad, offset of each body, in a random direction."""

START_DURATION = 5.0
START_OUTPUTS = 50

ASSEMBLED = Bound(
    "constraint violation after assembly",
    "m or rad",
    1e-14,
    CLOSURE_TOLERANCE,
    "round-off of residuals on a machine of 0.1 m",
)

VIOLATED_START = refusal("constraint violation at the start", "m or rad")

START_SETTINGS: tuple[Setting, ...] = (
    *COMBINATIONS,
    mujoco(),
    mujoco("implicitfast"),
    pinocchio(),
    pinocchio(stabilization="projection"),
    pinocchio(stabilization="none"),
)


def starts(full: bool) -> Iterator[Case]:
    """Yield the cases of (g)."""
    for offset in START_OFFSETS if full else START_OFFSETS[1::2]:
        name = f"tracker, bodies {offset:.0e} m and rad off"
        setting = Setting("newton_euler", {"function": "assemble"})
        yield Case(name, setting, ASSEMBLED, partial(measure_assembly, offset))
        if offset > CLOSURE_TOLERANCE:
            setting = Setting("all", {"argument": "Scene(initial_state=...)"})
            names = ("joint", "initial state")
            yield Case(name, setting, VIOLATED_START, partial(measure_scene, offset), names=names)
        most = 10.0 * max(offset, CLOSURE_TOLERANCE)
        reason = "the violation decreases, or at least does not grow"
        bound = Bound("constraint violation at the end", "m or rad", CLOSURE_TOLERANCE, most, reason)
        for setting in START_SETTINGS:
            run = partial(measure_start, offset)
            yield Case(f"{name}, unchecked, {START_DURATION:g} s", setting, bound, run, limit=40.0)


def off_state(scene: Scene, offset: float) -> State:
    """Return the initial state with each moving body shifted and rotated by `offset` (m, rad).

    The directions are pseudorandom, and the same in each call.
    """
    rng = np.random.default_rng(0)
    state = copy.deepcopy(initial_state(scene))
    for body in range(1, len(state.position)):
        shift, turn = (offset * d / np.linalg.norm(d) for d in rng.standard_normal((2, 3)))
        state.position[body] += shift
        state.quaternion[body] = product(from_rotation_vector(turn), state.quaternion[body])
    return state


def measure_assembly(offset: float, setting: Setting) -> Measurement:
    """Measure the constraint violation after assembly; note how far bodies were moved."""
    scene = load("tracker")
    guess = off_state(scene, offset)
    state = assemble(scene, guess)
    moved = float(np.max(np.linalg.norm(state.position - guess.position, axis=1)))
    figure = float(np.max(joint_violations(scene.mechanism, state)))
    return Measurement(
        figure, f"bodies moved by {moved:.1e} m, {moved / offset:.1f} times as far as they were off"
    )


def measure_scene(offset: float, setting: Setting) -> Measurement:
    """Measure the constraint violation of a scene with an offset initial state, which should raise an
    error."""
    scene = load("tracker")
    changed = replace(scene, initial_state=off_state(scene, offset))
    return Measurement(float(np.max(joint_violations(scene.mechanism, initial_state(changed)))))


def measure_start(offset: float, setting: Setting) -> Measurement:
    """Measure the constraint violation at the end of a run from an offset state."""
    scene = lasting(load("tracker"), START_DURATION, START_OUTPUTS, "violation")
    # bypass the check of initial states, to see the behavior of the engines
    state = off_state(scene, offset)
    scene = replace(scene, initial_state=state)
    CONSISTENT_STARTS[scene] = state
    run = setting.simulate(scene)
    assert run.constraint_violation is not None
    openings = np.max(run.constraint_violation, axis=1)
    return Measurement(float(openings[-1]), f"at most {np.max(openings):.1e} in between")


# (h) Singular configurations: passing them, starting in them, and the ends of travel

SLIDER_BOUND = Bound(
    "position error",
    "m",
    1e-6,
    1e-2,
    "1e-6 m is invisible in a plot; a centimeter of 0.4 m of travel is visible",
)

WINDOWS = (1, 2, 10)
"""Numbers of windows of the four-bar mechanisms."""

FLAT_SPEED = 4.0
"""rad/s, angular velocity of bars that start flat."""

SINGULAR_SETTINGS: tuple[Setting, ...] = (
    *COMBINATIONS,
    newton_euler("relative", integrator="Radau", rtol=1e-8, atol=1e-10),
    newton_euler("relative", integrator="RK4", step=1e-3),
    mujoco("RK4"),
    mujoco("implicitfast"),
    pinocchio(),
    pinocchio(stabilization="projection"),
)

CRANK_LENGTH, ROD_LENGTH, CRANK_SPEED = 0.2, 0.7, 12.0
"""m, m and rad/s, of `centered_slider_crank`."""

UNREACHABLE_TARGETS = (-0.2, 0.2)
"""m from the initial pose, targets of the tracker's sliders, which can travel less than half as far."""


def singular(full: bool) -> Iterator[Case]:
    """Yield the cases of (h)."""
    settings = SINGULAR_SETTINGS if full else ONE_EACH
    for windows in WINDOWS if full else WINDOWS[:2]:
        for setting in settings if windows < 10 else ONE_EACH:
            limit = 15.0 if full else 11.0
            passing = lasting(load("four_bar", N=windows), 5.0, 100, "violation")  # about six passages
            starting = from_flat(lasting(passing, 2.0, 50, "violation"), windows)
            for scene, how in ((passing, "through"), (starting, "from")):
                name = f"four_bar N = {windows}, {scene.duration:g} s, {how} flat bars"
                yield Case(name, setting, ANGLE_BOUND, partial(of_run, scene, angle_of_bars), limit=limit)
    for setting in settings:
        name = "slider-crank, 2 s, its crank driven through seven dead centers"
        measure = partial(of_run, centered_slider_crank(), position_of_slider)
        yield Case(name, setting, SLIDER_BOUND, measure, limit=12.0)
    for target in UNREACHABLE_TARGETS:
        for setting in settings:
            name = f"tracker, 2 s, drawn to {target:+g} m, past its dead centers"
            measure = partial(of_run, overdrawn_tracker(target), energy_at_ends)
            yield Case(name, setting, ENERGY_BOUND, measure, limit=20.0)


def centered_slider_crank() -> Scene:
    """Return a slider-crank with a crank of 0.2 m at 12 rad/s about y, and a rod of 0.7 m, outstretched at
    first.

    Crank and rod are in line twice per revolution. These dead centers are singular for a drive at the slider,
    and regular for the drive at the crank.
    """
    x, y, z = np.eye(3)
    pin, wrist = CRANK_LENGTH * x, (CRANK_LENGTH + ROD_LENGTH) * x
    bodies = [
        Body.ground(),
        Body("crank", 1.0, 0.5 * pin, 0.01 * np.eye(3)),
        Body("rod", 2.0, 0.5 * (pin + wrist), 0.05 * np.eye(3)),
        Body("slider", 1.5, wrist, 0.01 * np.eye(3)),
    ]
    joints = [
        Revolute("pivot", "ground", "crank", np.zeros(3), axis=y),
        Spherical("ball", "crank", "rod", pin),
        Universal("wrist", "rod", "slider", wrist, axis_on_first=y, axis_on_second=z),
        Prismatic("guide", "ground", "slider", wrist, axis=x),
    ]
    motion = PrescribedMotion("pivot", Polynomial((0.0, CRANK_SPEED)))
    outputs: frozenset[OutputName] = frozenset({"violation"})
    mechanism = Mechanism(bodies, joints)
    return Scene(
        "slider_crank", mechanism, 2.0, 0.02, -STANDARD_GRAVITY * z, motions=(motion,), outputs=outputs
    )


def position_of_slider(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the error of the slider's position r cos a + sqrt(l^2 - r^2 sin^2 a), over seven dead
    centers."""
    angle = CRANK_SPEED * run.time
    wanted = CRANK_LENGTH * np.cos(angle) + np.sqrt(ROD_LENGTH**2 - (CRANK_LENGTH * np.sin(angle)) ** 2)
    error = float(np.max(np.abs(run.position[:, 3, 0] - wanted)))
    return Measurement(error, f"drift {largest_drift(run):.1e} m or rad")


def angle_of_bars(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the error of the bars' angle."""
    return Measurement(parallelogram_error(scene, run), f"drift {largest_drift(run):.1e} m or rad")


def from_flat(scene: Scene, windows: int) -> Scene:
    """Return four-bar windows whose bars lie flat to the right at first, and move down."""
    x, y, z = np.eye(3)
    state = State.initial(scene.mechanism)
    bars, couplers = slice(1, windows + 2), slice(windows + 2, None)
    state.position[bars] += 0.5 * (x - y)
    state.quaternion[bars] = [np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]
    state.position[couplers] += x - y
    state.linear_velocity[bars] = -0.5 * FLAT_SPEED * y
    state.angular_velocity[bars] = -FLAT_SPEED * z
    state.linear_velocity[couplers] = -FLAT_SPEED * y
    return replace(scene, initial_state=state)


def overdrawn_tracker(target: float) -> Scene:
    """Return the tracker with unreachable targets of both sliders; it oscillates at the ends of its
    travel."""
    scene = load("tracker")
    control = tuple(replace(law, target=target) for law in scene.control if isinstance(law, PD))
    return lasting(replace(scene, control=control), 2.0, 100, "violation", "energy", "velocities")


def energy_at_ends(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the energy balance error; note how far the sliders travel."""
    travel = run.position[:, 1:3, 2] - run.position[0, 1:3, 2]
    note = f"sliders travel {travel.min():+.3f} to {travel.max():+.3f} m; drift {largest_drift(run):.1e}"
    return Measurement(largest_energy_error(scene, run), note)
