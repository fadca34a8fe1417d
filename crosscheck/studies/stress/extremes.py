"""Stress cases (e), (f) and (k): stiff gains, extreme mass ratios, and numbers at the limits of floating
point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial

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
    ONE_EACH,
    Setting,
    distance,
    formulations,
    largest_energy_error,
    lasting,
    mujoco,
    newton_euler,
    parallelogram_error,
    pinocchio,
    symmetric_top,
    top_error,
)
from newton_euler.model.control import PD
from newton_euler.model.digital_control import Controller, Sampled
from newton_euler.model.forces import JointSpring, Wrench
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory

# (e) Stiff gains: control of the tracker's sliders

GAINS = ((50.0, 20.0), (1e4, 1e2), (1e6, 1e3), (1e6, 1e6), (1e2, 1e6), (1e6, 1e2))
"""K_p in N/m and K_d in N s/m: the paper's gains, then stiffer ones; the last pair has little damping."""

STIFF_BOUND = Bound(
    "position error",
    "m",
    1e-5,
    1e-3,
    "a hundredth of a millimeter on a machine of 0.1 m; a millimeter is visible",
)

STIFF_SETTINGS: tuple[Setting, ...] = (
    *formulations(),
    newton_euler("relative", "baumgarte"),
    newton_euler(integrator="Radau", rtol=1e-6, atol=1e-9),
    newton_euler(integrator="RK4", step=1e-3),
    newton_euler(integrator="Euler", step=1e-3),
    *(mujoco(integrator) for integrator in ("RK4", "Euler", "implicit", "implicitfast")),
    pinocchio(),
    pinocchio(integrator="Radau", rtol=1e-6, atol=1e-9),
)


def stiff_gains(full: bool) -> Iterator[Case]:
    """Yield the cases of (e). The short form simulates 0.1 s, long enough for the stiff part of the
    motion."""
    duration, limit = (0.5, 9.0) if full else (0.1, 5.0)
    for stiffness, damping in GAINS if full else GAINS[2:4]:
        for setting in STIFF_SETTINGS:
            name = f"tracker, {duration:g} s, K_p {stiffness:g}, K_d {damping:g}"
            measure = partial(measure_stiff, stiffness, damping, duration)
            yield Case(name, setting, STIFF_BOUND, measure, limit=limit)


@lru_cache
def stiff_tracker(stiffness: float, damping: float, duration: float) -> tuple[Scene, Trajectory]:
    """Return the tracker with gains of both sliders, N/m and N s/m, and its reference motion.

    The reference is Radau's run at rtol 1e-8, whose error is far below the bound.
    """
    scene = load("tracker")
    control = tuple(
        PD(law.joint, stiffness, damping, law.target) for law in scene.control if isinstance(law, PD)
    )
    scene = lasting(replace(scene, control=control), duration, round(duration / 0.01))
    return scene, newton_euler(integrator="Radau", rtol=1e-8, atol=1e-11).simulate(scene)


def measure_stiff(stiffness: float, damping: float, duration: float, setting: Setting) -> Measurement:
    """Measure the largest distance from the reference motion."""
    scene, reference = stiff_tracker(stiffness, damping, duration)
    run = setting.simulate(scene)
    return Measurement(distance(run, reference), f"{run.settings['steps']} steps")


# (f) Extreme mass ratios, and inertias at the limit of realizable ones

MASS_RATIOS = (1e-8, 1e-4, 1.0, 1e4, 1e8)
"""Mass of the coupler divided by the mass of a bar; mass of the last rod of a chain divided by the
first's."""

MASS_SETTINGS = (
    *ONE_EACH,
    newton_euler("relative", "baumgarte"),
    newton_euler("cartesian", "baumgarte"),
    mujoco("implicitfast"),
)

LIMIT_INERTIAS = {
    "thin rod, A = 1e-8 C": (1e-8, 1.0),
    "thin rod, A = 1e-4 C": (1e-4, 1.0),
    "plate, A + B = C": (2.0, 1.0),
    "plate, A + B = C (1 + 1e-9)": (2.0 - 1e-9, 1.0),
}
"""Axial and transverse moments of inertia of symmetric tops, kg m^2."""

TOP_ANGULAR_VELOCITY = np.array([0.3, -0.7, 1.1])
"""rad/s, initial angular velocity of the tops, body frame."""


def masses(full: bool) -> Iterator[Case]:
    """Yield the cases of (f)."""
    for ratio in MASS_RATIOS if full else (1e-8, 1.0, 1e8):
        for setting in MASS_SETTINGS if full else ONE_EACH:
            # the bars never lie flat within 0.5 s
            loop = lasting(_changed(load("four_bar", N=1), "coupler_0", ratio), 0.5, 10)
            angle = partial(of_run, loop, parallelogram_error)
            yield Case(
                f"four_bar N = 1, 0.5 s, coupler/bar = {ratio:.0e}", setting, ANGLE_BOUND, angle, limit=20.0
            )
            chain = lasting(_changed(load("chain", N=2), "rod_1", ratio), 2.0, 20, "energy", "velocities")
            energy = partial(of_run, chain, largest_energy_error)
            yield Case(
                f"chain of 2, 2 s, last/first = {ratio:.0e}", setting, ENERGY_BOUND, energy, limit=20.0
            )
    duration = 10.0 if full else 2.0
    for name, moments in LIMIT_INERTIAS.items():
        for setting in ONE_EACH:
            measure = partial(of_run, symmetric_top(*moments, TOP_ANGULAR_VELOCITY, duration), top_error)
            yield Case(f"free top, {duration:g} s, {name}", setting, ANGLE_BOUND, measure)


def _changed(scene: Scene, name: str, factor: float) -> Scene:
    """Return the scene with the mass and inertia of a body multiplied by a factor."""
    bodies = [
        replace(body, mass=body.mass * factor, inertia=body.inertia * factor) if body.name == name else body
        for body in scene.mechanism.bodies
    ]
    return replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints))


# (k) Floating-point limits: numbers that overflow, underflow, or are not finite

PUSH_DIRECTION = np.array([1.0, 0.0, 0.0])

PUSH_DURATION = 1.0

FLOATING_POINT_SETTINGS: tuple[Setting, ...] = (
    *formulations(),
    newton_euler("cartesian", "baumgarte"),
    newton_euler(integrator="Radau"),
    newton_euler(integrator="RK4", step=1e-2),
    newton_euler(integrator="Euler", step=1e-2),
    mujoco("RK4"),
    mujoco("implicitfast"),
    pinocchio(),
)

VELOCITY_BOUND = Bound(
    "velocity error", "rel", 1e-6, 1e-2, "as accurate as for usual numbers; underflow to zero gives 1"
)

NO_END_POSITION = refusal("end position", "m")


def block(mass: float = 1.0, **more: object) -> Scene:
    """Return a block of a mass, kg, on a rail along x; `more` are arguments of `Scene`."""
    body = Body("block", mass, np.zeros(3), mass * np.eye(3))
    rail = Prismatic("rail", "ground", "block", np.zeros(3), axis=PUSH_DIRECTION, actuated=True)
    return Scene("block", Mechanism([Body.ground(), body], [rail]), PUSH_DURATION, 0.1, **more)  # type: ignore[arg-type]


def _sampled(wrong: Callable[[float], object]) -> Scene:
    """Return a block with a controller that returns 1 N, and an invalid value from 0.3 s on."""

    def control(time: float, x: object, rate: object) -> float:
        return 1.0 if time < 0.25 else wrong(time)  # type: ignore[return-value]

    law: Controller = control
    return block(control=(Sampled("rail", law, 0.1),))


def _pushed(force: float, mass: float = 1.0) -> Scene:
    return block(mass, forces=(Wrench("push", "block", np.zeros(3), force=np.array([force, 0.0, 0.0])),))


def _moving(speed: float) -> Scene:
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
"""Scenes without an answer, and texts that the error must contain."""

WITH_ANSWER: dict[str, tuple[float, float]] = {
    "a denormal force, 1e-310 N on 1 kg": (1e-310, 1.0),
    "a tiny body, 1e-150 N on 1e-150 kg": (1e-150, 1e-150),
    "a denormal body, 1e-310 N on 1e-310 kg": (1e-310, 1e-310),
    "a huge body, 1e150 N on 1e150 kg": (1e150, 1e150),
    "a huge body, 1e300 N on 1e300 kg": (1e300, 1e300),
    "a huge force, 1e150 N on 1 kg": (1e150, 1.0),
}
"""Force F (N) and mass m (kg) of a block, whose velocity after t = 1 s is F t / m."""


def traps(full: bool) -> Iterator[Case]:
    """Yield the cases of (k)."""
    few = (*FLOATING_POINT_SETTINGS[:2], *FLOATING_POINT_SETTINGS[-3::2])
    for setting in FLOATING_POINT_SETTINGS if full else few:
        for name, (_, names) in WITHOUT_ANSWER.items():
            yield Case(name, setting, NO_END_POSITION, partial(measure_trap, name), names=names)
        for name in WITH_ANSWER:
            yield Case(name, setting, VELOCITY_BOUND, partial(measure_push, name))


def measure_trap(name: str, setting: Setting) -> Measurement:
    """Measure the end position of the block, if the engine raises no error."""
    run = setting.simulate(WITHOUT_ANSWER[name][0]())
    return Measurement(float(run.position[-1, 1, 0]))


def measure_push(name: str, setting: Setting) -> Measurement:
    """Measure the relative error of the velocity at the end."""
    force, mass = WITH_ANSWER[name]
    scene = replace(_pushed(force, mass), outputs=frozenset({"velocities"}))
    run = setting.simulate(scene)
    assert run.linear_velocity is not None
    expected = force * PUSH_DURATION / mass
    return Measurement(abs(float(run.linear_velocity[-1, 1, 0]) / expected - 1.0))
