"""Stress cases (c), (d) and (i): stiff control gains, extreme mass ratios, and extreme or invalid numbers.

A case measures one value of one engine, such as MuJoCo, at one setting, an integrator with
its options. A bound judges the value: up to `survives` it is accurate, up to `degrades` still useful. Each
function `..._cases` yields the cases of a topic, the `measure_...` functions measure their values. `full`
selects all cases rather than the short form of continuous integration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np

from crosscheck.engines.engine import Engine
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
    Setting,
    largest_distance,
    largest_energy_error,
    parallelogram_error,
    settings_of,
    solver_setting,
    steps_text,
    symmetric_top,
    top_error,
    with_duration,
)
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Controller, Sampled
from newton_euler.model.forces import JointSpring, Wrench
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory

# (c) Stiff gains: control of the tracker's sliders

GAINS = ((50.0, 20.0), (1e4, 1e2), (1e6, 1e3), (1e6, 1e6), (1e2, 1e6), (1e6, 1e2))
"""PD gains K_p, N/m, and K_d, N s/m, of the two sliders of the scene `tracker`, a solar tracker: first the
published gains (see `crosscheck.library.tracker`), then stiffer ones. The last pair has little damping."""

STIFF_BOUND = Bound(
    "position error",
    "m",
    survives=1e-5,
    degrades=1e-3,
    reason="a hundredth of a millimeter on a machine of 0.1 m; a millimeter is visible",
)
"""Bound on the distance from the reference motion."""


def stiff_gain_cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (c), all of them or (unless `full`) the short form.

    The short form has two pairs of gains and simulates 0.1 s, long enough for the stiff part of the motion.
    """
    duration, limit = (0.5, 9.0) if full else (0.1, 5.0)  # s; the limit is CPU time
    for stiffness, damping in GAINS if full else GAINS[2:4]:
        for setting in settings_of(engines, "stiff gains"):
            name = f"tracker, {duration:g} s, K_p {stiffness:g}, K_d {damping:g}"
            measure = partial(measure_distance_from_reference, stiffness, damping, duration)
            yield Case(name, setting, STIFF_BOUND, measure, time_limit=limit)


@lru_cache
def stiff_tracker(stiffness: float, damping: float, duration: float) -> tuple[Scene, Trajectory]:
    """Return the tracker with other PD gains, and its reference motion.

    The reference is a run with Radau at rtol 1e-8, whose error is far below the bound.

    Args:
        stiffness: K_p of both sliders, N/m.
        damping: K_d of both sliders, N s/m.
        duration: duration of the run, s.
    """
    scene = load("tracker")
    control = tuple(
        PD(law.joint, stiffness, damping, law.target) for law in scene.control if isinstance(law, PD)
    )
    scene = with_duration(replace(scene, control=control), duration, periods=round(duration / 0.01))
    return scene, solver_setting(integrator="Radau", rtol=1e-8, atol=1e-11).simulate(scene)


def measure_distance_from_reference(
    stiffness: float, damping: float, duration: float, setting: Setting
) -> Measurement:
    """Measure the largest distance, m, of a run of `stiff_tracker` from its reference motion.

    Gains and duration are those of `stiff_tracker`; `setting` has the engine and its options.
    """
    scene, reference = stiff_tracker(stiffness, damping, duration)
    run = setting.simulate(scene)
    return Measurement(largest_distance(run, reference), steps_text(run))


# (d) Extreme mass ratios, and extreme moments of inertia. No principal moment of a rigid body exceeds the sum
# of the other two; thin rods and plates are at this limit.

MASS_RATIOS = (1e-8, 1e-4, 1.0, 1e4, 1e8)
"""Mass of the coupler divided by the mass of a bar, for a four-bar linkage; mass of the last rod divided by
the mass of the first rod, for a chain of two."""

LIMIT_INERTIAS = {
    "thin rod, A = 1e-8 C": (1e-8, 1.0),
    "thin rod, A = 1e-4 C": (1e-4, 1.0),
    "plate, A + B = C": (2.0, 1.0),
    "plate, A + B = C (1 + 1e-9)": (2.0 - 1e-9, 1.0),
}
"""Axial and transverse moments of inertia of symmetric tops, kg m^2. A, B and C are principal moments."""

TOP_ANGULAR_VELOCITY = np.array([0.3, -0.7, 1.1])
"""Initial angular velocity (3,) of the tops, rad/s, in the body frame."""


def mass_ratio_cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (d), all of them or (unless `full`) the short form."""
    for ratio in MASS_RATIOS if full else (1e-8, 1.0, 1e8):
        for setting in settings_of(engines, "masses" if full else None):
            # Four-bar linkage of N = 1 loop, for 0.5 s: in this time the bars do not reach the singular flat
            # configuration
            loop = with_duration(_changed(load("four_bar", N=1), "coupler_0", ratio), 0.5, periods=10)
            angle = partial(simulate_and_measure, loop, parallelogram_error)
            yield Case(
                f"four_bar N = 1, 0.5 s, coupler/bar = {ratio:.0e}",
                setting,
                ANGLE_BOUND,
                angle,
                time_limit=20.0,
            )
            # Chain of N = 2 rods
            rods = _changed(load("chain", N=2), "rod_1", ratio)
            chain = with_duration(rods, 2.0, 20, "energy", "velocities")  # 20 output periods
            energy = partial(simulate_and_measure, chain, largest_energy_error)
            yield Case(
                f"chain of 2, 2 s, last/first = {ratio:.0e}", setting, ENERGY_BOUND, energy, time_limit=20.0
            )
    # Symmetric tops
    duration = 10.0 if full else 2.0
    for name, moments in LIMIT_INERTIAS.items():
        for setting in settings_of(engines):
            measure = partial(
                simulate_and_measure, symmetric_top(*moments, TOP_ANGULAR_VELOCITY, duration), top_error
            )
            yield Case(f"free top, {duration:g} s, {name}", setting, ANGLE_BOUND, measure)


def _changed(scene: Scene, name: str, factor: float) -> Scene:
    """Return the scene with the mass and inertia of a body multiplied by a factor."""
    bodies = [
        replace(body, mass=body.mass * factor, inertia=body.inertia * factor) if body.name == name else body
        for body in scene.mechanism.bodies
    ]
    return replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints))


# (i) Floating-point limits: numbers that overflow, underflow, or are not finite

PUSH_DIRECTION = np.array([1.0, 0.0, 0.0])
"""Direction (3,) of the rail on which the block moves."""

PUSH_DURATION = 1.0
"""Duration of runs of the block, s."""

VELOCITY_BOUND = Bound(
    "velocity error",
    "relative",
    survives=1e-6,
    degrades=1e-2,
    reason="as accurate as for usual numbers; underflow to zero gives 1",
)
"""Bound on the relative error of the block's final velocity."""

NO_END_POSITION = refusal("end position", "m")
"""Bound of cases in which the engine must raise an error."""


def block(mass: float = 1.0, **options: object) -> Scene:
    """Return the scene of a block on a rail along x without gravity, with an output every 0.1 s.

    Args:
        mass: mass of the block, kg.
        **options: other arguments of `Scene`, such as forces.
    """
    body = Body("block", mass, np.zeros(3), mass * np.eye(3))
    rail = Prismatic("rail", "ground", "block", np.zeros(3), axis=PUSH_DIRECTION, actuated=True)
    return Scene("block", Mechanism([Body.ground(), body], [rail]), PUSH_DURATION, 0.1, **options)  # type: ignore[arg-type]


def _sampled(invalid: Callable[[float], object]) -> Scene:
    """Return a block with a controller that is called every 0.1 s.

    The controller returns 1 N, and from t = 0.3 s the value of `invalid(t)`, which is no finite force.
    """

    def control(time: float, x: object, rate: object) -> float:
        return 1.0 if time < 0.25 else invalid(time)  # type: ignore[return-value]

    law: Controller = control
    return block(control=(Sampled("rail", law, period=0.1),))


def _pushed(force: float, mass: float = 1.0) -> Scene:
    """Return a block of a mass, kg, on which a constant force, N, acts along the rail."""
    return block(mass, forces=(Wrench("push", "block", np.zeros(3), force=np.array([force, 0.0, 0.0])),))


def _moving(speed: float) -> Scene:
    """Return a block with an initial speed, m/s."""
    scene = block()
    state = State.initial(scene.mechanism)
    state.linear_velocity[1] = speed * PUSH_DIRECTION
    return replace(scene, initial_state=state)


WITHOUT_ANSWER: dict[str, tuple[Callable[[], Scene], tuple[str, ...]]] = {
    "a controller's NaN at 0.3 s": (lambda: _sampled(lambda t: np.nan), ("'rail'", "t = 0.3 s", "nan")),
    "a controller's infinity at 0.3 s": (lambda: _sampled(lambda t: np.inf), ("'rail'", "t = 0.3 s", "inf")),
    "a controller's text at 0.3 s": (lambda: _sampled(lambda t: "1.0"), ("'rail'", "t = 0.3 s", "'1.0'")),
    "a controller that divides by zero at 0.3 s": (
        lambda: _sampled(lambda t: 1.0 / (t - t)),
        ("'rail'", "t = 0.3 s", "ZeroDivisionError"),
    ),
    "a wrench of NaN": (lambda: _pushed(np.nan), ("'push'", "force")),
    "an infinite wrench": (lambda: _pushed(np.inf), ("'push'", "force")),
    "a wrench of 1e308 N on 1 g": (lambda: _pushed(1e308, 1e-3), ("'push'", "t = ")),
    "a joint's spring of 1e308 N/m, 1e3 m off": (
        lambda: block(forces=(JointSpring("rail", stiffness=1e308, rest=1e3),)),
        ("spring of joint 'rail'", "t = "),
    ),
    "PD control with K_p 1e308, 1e3 m off": (
        lambda: block(control=(PD("rail", 1e308, 0.0, 1e3),)),
        ("control of joint 'rail'", "t = "),
    ),
    "a start at 1e200 m/s, its energy asked for": (lambda: _moving(1e200), ("t = ",)),
}
"""Cases without an answer: a function that makes the scene, and texts that the error must contain."""

WITH_ANSWER: dict[str, tuple[float, float]] = {
    "a denormal force, 1e-310 N on 1 kg": (1e-310, 1.0),
    "a tiny body, 1e-150 N on 1e-150 kg": (1e-150, 1e-150),
    "a denormal body, 1e-310 N on 1e-310 kg": (1e-310, 1e-310),
    "a huge body, 1e150 N on 1e150 kg": (1e150, 1e150),
    "a huge body, 1e300 N on 1e300 kg": (1e300, 1e300),
    "a huge force, 1e150 N on 1 kg": (1e150, 1.0),
}
"""Cases with an answer: force F, N, on the block, and mass m, kg. The velocity after t = 1 s is F t / m."""


def floating_point_cases(full: bool, engines: Sequence[Engine]) -> Iterator[Case]:
    """Yield the cases of topic (i), all of them or (unless `full`) those of the typical settings."""
    for setting in settings_of(engines, "numbers" if full else None):
        for name, (_, texts) in WITHOUT_ANSWER.items():
            yield Case(
                name, setting, NO_END_POSITION, partial(measure_end_position, name), required_texts=texts
            )
        for name in WITH_ANSWER:
            yield Case(name, setting, VELOCITY_BOUND, partial(measure_end_velocity, name))


def measure_end_position(name: str, setting: Setting) -> Measurement:
    """Measure the end position, m, of a scene of `WITHOUT_ANSWER`, if the engine raises no error."""
    make_scene, _ = WITHOUT_ANSWER[name]
    run = setting.simulate(make_scene())
    return Measurement(float(run.position[-1, 1, 0]))


def measure_end_velocity(name: str, setting: Setting) -> Measurement:
    """Measure the relative error of the final velocity of a block of `WITH_ANSWER`."""
    force, mass = WITH_ANSWER[name]
    scene = replace(_pushed(force, mass), outputs=frozenset({"velocities"}))
    run = setting.simulate(scene)
    assert run.linear_velocity is not None
    expected = force * PUSH_DURATION / mass
    return Measurement(abs(float(run.linear_velocity[-1, 1, 0]) / expected - 1.0))
