"""Stress cases of topic (g): rotation by half a turn or by whole turns, few or many, and at high speeds.

Topics of stress tests have letters, see `topics.py`. A case measures one value at one setting: an engine
with its options. A bound judges the value. Free symmetric tops and a hinge under PD control are compared with
closed forms of orientation and torque. The heavy top of the scene library is compared with published values.
`full` selects all cases rather than the short form of continuous integration.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product

import numpy as np

from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import SOLVER
from crosscheck.library import REFERENCE_QUANTITIES, load
from crosscheck.library.references import reference_values
from crosscheck.studies.stress.cases import (
    ANGLE_BOUND,
    ENERGY_BOUND,
    Bound,
    Case,
    Measurement,
    simulate_and_measure,
)
from crosscheck.studies.stress.runs import (
    REFERENCE_SETTING,
    Setting,
    settings_of,
    steps_text,
    symmetric_top,
    top_error,
)
from newton_euler.model.control import PD
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import OutputName, Scene
from newton_euler.model.trajectory import Trajectory

SPIN_DIRECTION = np.array([0.3, -0.7, 1.1]) / np.linalg.norm([0.3, -0.7, 1.1])
"""Direction (3,) of the initial angular velocity of free tops, oblique to the top's axis x."""

SPIN_SPEEDS = (1.0, 1e2, 1e3, 1e4)
"""Angular speeds of free tops, rad/s."""

HINGE_TURNS = (0.499, 0.5, 0.501, 1.0, 10.0, 1e3)
"""Numbers of turns by which PD control rotates a hinge; orientations at half a turn are ambiguous."""

TORQUE_BOUND = Bound(
    "torque error",
    "relative",
    survives=1e-6,
    degrades=1e-2,
    reason="1e-6 is invisible in a plot; one miscounted turn of 1000 gives 1e-3",
)
"""Bound on the error of the actuator torque of the driven hinge: up to `survives` an engine passes the case,
up to `degrades` its result is inaccurate but useful, and beyond that it fails."""

REFERENCE_BOUND = Bound(
    "largest error",
    "SI",
    survives=1e-6,
    degrades=1e-2,
    reason="1e-6 is invisible in a plot; 0.01 m of the top's 1 m is visible",
)
"""Bound on the largest absolute error of the heavy top's reference values: positions (m), quaternions and
angular velocities (rad/s)."""

FIXED_STEP_SPEED = 100.0
"""Angular speed of the tops that are simulated with fixed steps, rad/s: 0.1 or 0.01 rad a step."""

HINGE_STIFFNESS, HINGE_DAMPING = 100.0, 20.0
"""PD gains of the driven hinge, N m/rad and N m s/rad. A moment of inertia of 1 kg m^2 is critically damped:
its angle is x(t) = X (1 - (1 + 10 t) exp(-10 t)) for the target X."""


def cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (g), all of them or (unless `full`) the short form."""
    # Free tops, against the closed form. Engines with a fixed step also run with steps of 0.1 rad above
    # 100 rad/s; runs of slow ones are shorter at the highest speed. A free top has no joint to stabilize,
    # only the norm of its quaternion: "baumgarte" controls the norm in the Cartesian equations, all others
    # normalize
    short_duration = 0.1 if full else 0.02
    for speed, engine in product(SPIN_SPEEDS if full else (1.0, 1e4), engines):
        stress = engine.stress()
        settings = stress.topics.get("long tops", stress.typical) if full else stress.typical
        if stress.at_step is not None and speed > 100.0:
            settings = (*settings, stress.at_step(0.1 / speed))
        duration = short_duration if stress.is_slow and speed > 1e3 else 1.0
        turns = speed * duration / (2.0 * np.pi)
        for options in settings:
            yield Case(
                f"free symmetric top, {speed:g} rad/s, {turns:.3g} turns",
                Setting(engine.name, options),
                ANGLE_BOUND,
                partial(simulate_and_measure, top(speed, duration), orientation),
                time_limit=40.0,
            )
    # Free tops with fixed steps: the kinetic energy should stay constant
    for setting in settings_of(engines, "fixed steps"):
        name = f"free symmetric top, {FIXED_STEP_SPEED:g} rad/s, 1 s, fixed steps"
        yield Case(
            name,
            setting,
            ENERGY_BOUND,
            partial(simulate_and_measure, top(FIXED_STEP_SPEED, 1.0), kinetic_energy),
        )
    # A driven hinge, against the closed form of the torque
    for turns in HINGE_TURNS if full else (0.5, 1.0, 1e3):
        for setting in settings_of(engines):
            name = f"hinge turned {turns:g} times by PD, 3 s"
            yield Case(
                name,
                setting,
                TORQUE_BOUND,
                partial(simulate_and_measure, driven_hinge(turns), torque_of_hinge),
            )
    # The heavy top, against published values, also with newton_euler's tightest tolerance
    tightest = [REFERENCE_SETTING] if SOLVER in engines else []
    for setting in (*settings_of(engines), *tightest):
        measure = partial(simulate_and_measure, load("heavy_top"), reference_error)
        yield Case("heavy_top, 150 rad/s, reference values", setting, REFERENCE_BOUND, measure)


def top(speed: float, duration: float) -> Scene:
    """Return the scene of a free symmetric top with an angular speed, rad/s, for `duration`, s.

    The moments of inertia are 1 kg m^2 (axial) and 2 kg m^2 (transverse).
    """
    return symmetric_top(1.0, 2.0, speed * SPIN_DIRECTION, duration)


def orientation(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the largest error of a free top's orientation, rad; note the number of steps."""
    return Measurement(top_error(scene, run), steps_text(run))


def kinetic_energy(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the largest relative change of a free top's kinetic energy, which is constant in the exact
    motion; note the orientation error."""
    energy = run.kinetic_energy
    assert energy is not None
    error = float(np.max(np.abs(energy / energy[0] - 1.0)))
    return Measurement(error, f"orientation error {top_error(scene, run):.1e} rad")


def driven_hinge(turns: float) -> Scene:
    """Return a wheel of 1 kg m^2 on a hinge; PD control drives it from rest by a number of turns, in 3 s."""
    wheel = Body("wheel", 1.0, np.zeros(3), np.diag([0.6, 0.6, 1.0]))
    hinge = Revolute("hinge", "ground", "wheel", np.zeros(3), axis=np.array([0.0, 0.0, 1.0]), actuated=True)
    law = PD("hinge", HINGE_STIFFNESS, HINGE_DAMPING, target=2.0 * np.pi * turns)
    outputs: frozenset[OutputName] = frozenset({"actuation"})
    return Scene(
        "hinge",
        Mechanism([Body.ground(), wheel], [hinge]),
        duration=3.0,
        output_period=0.05,
        control=(law,),
        outputs=outputs,
    )


def torque_of_hinge(scene: Scene, run: Trajectory) -> float:
    """Measure the error of the driven hinge's torque relative to the largest torque.

    An engine that does not count whole turns has a wrong hinge angle, and so a wrong torque.
    """
    assert run.actuator_force is not None
    (law,) = scene.control
    assert isinstance(law, PD)
    assert isinstance(law.target, float)
    t = scene.times
    # K_p (X - x) - K_d x' of the closed form at `HINGE_STIFFNESS`
    torque = law.target * np.exp(-10.0 * t) * (HINGE_STIFFNESS * (1.0 + 10.0 * t) - HINGE_DAMPING * 100.0 * t)
    return float(np.max(np.abs(run.actuator_force[:, 0] - torque))) / (HINGE_STIFFNESS * law.target)


def reference_error(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the largest error of the heavy top's reference values, SI; note the quantity and the time."""
    errors = []
    for known in reference_values("heavy_top"):
        output = int(np.argmin(np.abs(run.time - known.time)))
        simulated = float(REFERENCE_QUANTITIES["heavy_top"][known.quantity](run)[output])
        errors.append((abs(simulated - known.value), f"{known.quantity} at t = {known.time:g} s"))
    return Measurement(*max(errors))
