"""Stress cases (e) and (f): initial states that violate the constraints, and singular configurations.

A case measures one value of one engine, such as MuJoCo, at one setting, an integrator with
its options; a bound judges the value. `full` selects all cases rather than the short form of continuous
integration. At a singular configuration a mechanism has more degrees of freedom than elsewhere, or its drive
cannot move it, as at the dead centers of a slider-crank.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import SOLVER
from crosscheck.library import load
from crosscheck.studies.stress.cases import (
    ANGLE_BOUND,
    ENERGY_BOUND,
    Bound,
    Case,
    Measurement,
    refusal,
    simulate_and_measure,
)
from crosscheck.studies.stress.runs import (
    STANDARD_GRAVITY,
    Setting,
    largest_drift,
    largest_energy_error,
    parallelogram_error,
    settings_of,
    with_duration,
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

# (e) Initial states (starts) that violate the constraints. The mechanism is the solar tracker, in which two
# sliders tilt a panel by legs. The cases measure the state after assembly, which moves bodies until the
# constraints hold, and the run of each engine from the violating state.

START_OFFSETS = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
"""Displacements, m, and rotations, rad, of each body in random directions."""

START_DURATION = 5.0
"""Duration of runs from a violating start, s."""

START_OUTPUTS = 50
"""Number of output periods of runs from a violating start."""

ASSEMBLED = Bound(
    "constraint violation after assembly",
    "m or rad",
    survives=1e-14,
    degrades=CLOSURE_TOLERANCE,
    reason="round-off of residuals on a machine of 0.1 m",
)
"""Bound on the constraint violation of the state after assembly: a value up to `survives` is accurate, a
value up to `degrades` still useful."""

VIOLATED_START = refusal("constraint violation at the start", "m or rad")
"""Bound of scenes whose initial state violates the constraints by more than `CLOSURE_TOLERANCE`, the largest
violation (m or rad) that newton_euler accepts at a start: the engine must raise an error."""


def violated_start_cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (e), all of them or (unless `full`) the short form."""
    for offset in START_OFFSETS if full else START_OFFSETS[1::2]:
        name = f"tracker, bodies {offset:.0e} m and rad off"
        # The assembly of a violating state
        if SOLVER in engines:
            setting = Setting(SOLVER.name, {"function": "assemble"})
            yield Case(name, setting, ASSEMBLED, partial(measure_assembled_violation, offset))
        # A scene with a violating initial state, which must raise an error before any engine runs
        if offset > CLOSURE_TOLERANCE:
            setting = Setting("all", {"argument": "Scene(initial_state=...)"})
            yield Case(
                name,
                setting,
                VIOLATED_START,
                partial(measure_rejected_start, offset),
                required_texts=("joint", "initial state"),  # in the message of the error
            )
        # Runs from the violating state, without the check of initial states
        degraded = 10.0 * max(offset, CLOSURE_TOLERANCE)
        reason = "the violation decreases, or at least does not grow"
        bound = Bound(
            "constraint violation at the end",
            "m or rad",
            survives=CLOSURE_TOLERANCE,
            degrades=degraded,
            reason=reason,
        )
        for setting in settings_of(engines, "starts"):
            run = partial(measure_end_violation, offset)
            yield Case(f"{name}, unchecked, {START_DURATION:g} s", setting, bound, run, time_limit=40.0)


def displaced_state(scene: Scene, offset: float) -> State:
    """Return the initial state with each moving body shifted and rotated by `offset` (m, rad).

    The directions are pseudorandom, and the same in each call.
    """
    rng = np.random.default_rng(0)
    state = copy.deepcopy(initial_state(scene))
    for body in range(1, len(state.position)):
        shift, rotation_vector = (offset * d / np.linalg.norm(d) for d in rng.standard_normal((2, 3)))
        state.position[body] += shift
        state.quaternion[body] = product(from_rotation_vector(rotation_vector), state.quaternion[body])
    return state


def measure_assembled_violation(offset: float, setting: Setting) -> Measurement:
    """Measure the constraint violation of the tracker after assembly from a displaced state.

    The note has the largest distance by which the assembly moved a body.

    Args:
        offset: displacement of each body, m and rad.
        setting: not used; all functions that measure a case have this argument.
    """
    scene = load("tracker")
    guess = displaced_state(scene, offset)
    state = assemble(scene, guess)
    moved = float(np.max(np.linalg.norm(state.position - guess.position, axis=1)))
    violation = float(np.max(joint_violations(scene.mechanism, state)))
    return Measurement(
        violation, f"bodies moved by {moved:.1e} m, {moved / offset:.1f} times as far as they were off"
    )


def measure_rejected_start(offset: float, setting: Setting) -> Measurement:
    """Measure the constraint violation of the tracker's initial state if it is displaced by `offset`, m and
    rad.

    `initial_state` should raise an error, so that nothing is measured. `setting` is not used.
    """
    scene = load("tracker")
    changed = replace(scene, initial_state=displaced_state(scene, offset))
    return Measurement(float(np.max(joint_violations(scene.mechanism, initial_state(changed)))))


def measure_end_violation(offset: float, setting: Setting) -> Measurement:
    """Measure the constraint violation at the end of a run of the tracker from a displaced state.

    Each body is displaced by `offset`, m and rad. The note has the largest violation during the run.
    """
    scene = with_duration(load("tracker"), START_DURATION, START_OUTPUTS, "violation")
    # `CONSISTENT_STARTS` caches checked initial states. The entry bypasses the check, so that the run shows
    # the behavior of the engine.
    state = displaced_state(scene, offset)
    scene = replace(scene, initial_state=state)
    CONSISTENT_STARTS[scene] = state
    run = setting.simulate(scene)
    assert run.constraint_violation is not None
    violation = np.max(run.constraint_violation, axis=1)
    return Measurement(float(violation[-1]), f"at most {np.max(violation):.1e} in between")


# (f) Singular configurations: runs that pass one, runs that start in one, and the ends of a slider's travel

SLIDER_BOUND = Bound(
    "position error",
    "m",
    survives=1e-6,
    degrades=1e-2,
    reason="1e-6 m is invisible in a plot; a centimeter of 0.4 m of travel is visible",
)
"""Bound on the error of the slider's position in the slider-crank."""

WINDOWS = (1, 2, 10)
"""Numbers of windows (parallelograms in a row) of the scene `four_bar`. If all bars lie flat, each window can
fold as a parallelogram or as an antiparallelogram: the configuration is singular."""

FLAT_SPEED = 4.0
"""Initial angular velocity of bars that start flat, rad/s."""

CRANK_LENGTH, ROD_LENGTH, CRANK_SPEED = 0.2, 0.7, 12.0
"""Lengths, m, and prescribed angular velocity of the crank, rad/s, of `centered_slider_crank`."""

UNREACHABLE_TARGETS = (-0.2, 0.2)
"""Targets of the sliders of the solar tracker, m from the initial pose. The sliders can travel less than half
as far."""


def singular_cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (f), all of them or (unless `full`) the short form."""
    settings = settings_of(engines, "singular" if full else None)
    for windows in WINDOWS if full else WINDOWS[:2]:
        for setting in settings if windows < 10 else settings_of(engines):
            limit = 15.0 if full else 11.0
            passing = with_duration(load("four_bar", N=windows), 5.0, 100, "violation")  # about six passages
            starting = with_flat_start(with_duration(passing, 2.0, 50, "violation"), windows)
            for scene, how in ((passing, "through"), (starting, "from")):
                name = f"four_bar N = {windows}, {scene.duration:g} s, {how} flat bars"
                yield Case(
                    name,
                    setting,
                    ANGLE_BOUND,
                    partial(simulate_and_measure, scene, angle_of_bars),
                    time_limit=limit,
                )
    for setting in settings:
        name = "slider-crank, 2 s, its crank driven through seven dead centers"
        measure = partial(simulate_and_measure, centered_slider_crank(), position_of_slider)
        yield Case(name, setting, SLIDER_BOUND, measure, time_limit=12.0)
    for target in UNREACHABLE_TARGETS:
        for setting in settings:
            name = f"tracker, 2 s, drawn to {target:+g} m, past its dead centers"
            measure = partial(simulate_and_measure, overdrawn_tracker(target), energy_at_ends)
            yield Case(name, setting, ENERGY_BOUND, measure, time_limit=20.0)


def centered_slider_crank() -> Scene:
    """Return a slider-crank with a prescribed angular velocity of the crank about y, for 2 s.

    Crank and rod are outstretched at first. The slider moves on a line through the crank's axis. Crank and
    rod are in line twice per revolution. These dead centers are singular for a drive at the slider, and
    regular for the drive at the crank.
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
        "slider_crank",
        mechanism,
        duration=2.0,
        output_period=0.02,
        gravity=-STANDARD_GRAVITY * z,
        motions=(motion,),
        outputs=outputs,
    )


def position_of_slider(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the largest error of the slider's position in `centered_slider_crank`, m.

    The exact position is r cos a + sqrt(l^2 - r^2 sin^2 a), with the angle a and the length r of the crank
    and the length l of the rod. The note has the constraint drift.
    """
    angle = CRANK_SPEED * run.time
    exact = CRANK_LENGTH * np.cos(angle) + np.sqrt(ROD_LENGTH**2 - (CRANK_LENGTH * np.sin(angle)) ** 2)
    slider_x = run.position[:, 3, 0]  # body 3 is the slider
    error = float(np.max(np.abs(slider_x - exact)))
    return Measurement(error, f"drift {largest_drift(run):.1e} m or rad")


def angle_of_bars(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the largest error of the bars' angle in a run of `four_bar`, rad; note the constraint drift."""
    return Measurement(parallelogram_error(scene, run), f"drift {largest_drift(run):.1e} m or rad")


def with_flat_start(scene: Scene, windows: int) -> Scene:
    """Return the scene `four_bar` with another start: all bars lie flat to the right and move down.

    Args:
        scene: scene `four_bar` with upright bars.
        windows: number of windows of the scene.
    """
    x, y, z = np.eye(3)
    state = State.initial(scene.mechanism)
    # order of the bodies: ground, windows + 1 bars, windows couplers
    bars, couplers = slice(1, windows + 2), slice(windows + 2, None)
    state.position[bars] += 0.5 * (x - y)
    state.quaternion[bars] = [np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]
    state.position[couplers] += x - y
    state.linear_velocity[bars] = -0.5 * FLAT_SPEED * y
    state.angular_velocity[bars] = -FLAT_SPEED * z
    state.linear_velocity[couplers] = -FLAT_SPEED * y
    return replace(scene, initial_state=state)


def overdrawn_tracker(target: float) -> Scene:
    """Return the tracker with an unreachable target of both sliders, m from the initial pose.

    The sliders oscillate at the ends of their travel.
    """
    scene = load("tracker")
    control = tuple(replace(law, target=target) for law in scene.control if isinstance(law, PD))
    return with_duration(replace(scene, control=control), 2.0, 100, "violation", "energy", "velocities")


def energy_at_ends(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the largest energy error of the tracker's run; note the travel of the sliders and the drift."""
    # bodies 1 and 2 are the sliders, which move along z
    travel = run.position[:, 1:3, 2] - run.position[0, 1:3, 2]
    note = f"sliders travel {travel.min():+.3f} to {travel.max():+.3f} m; drift {largest_drift(run):.1e}"
    return Measurement(largest_energy_error(scene, run), note)
