"""(k) Floating-point traps: numbers that are too large, too small or none at all."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from crosscheck.studies.stress.cases import REFUSAL, Bound, Case, Measured
from crosscheck.studies.stress.runs import Setting, mujoco, newton_euler, pinocchio
from newton_euler.model.control import PD, Controller, Sampled
from newton_euler.model.forces import JointSpring, Wrench
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

X = np.array([1.0, 0.0, 0.0])

DURATION = 1.0

SETTINGS: tuple[Setting, ...] = (
    newton_euler("relative"),
    newton_euler("cartesian"),
    newton_euler("cartesian", "baumgarte"),
    newton_euler("relative", integrator="Radau"),
    newton_euler("relative", integrator="RK4", step=1e-2),
    newton_euler("relative", integrator="Euler", step=1e-2),
    mujoco("RK4"),
    mujoco("implicitfast"),
    pinocchio(),
)

EXACT = Bound(1e-6, 1e-2, "as with numbers of any size; flushed to zero it would be 1")


def block(mass: float = 1.0, **more: object) -> Scene:
    """A block of that mass, kg, on a rail along x; `more` as of `Scene`."""
    body = Body("block", mass, np.zeros(3), mass * np.eye(3))
    mechanism = Mechanism(
        [Body.ground(), body], [Prismatic("rail", "ground", "block", np.zeros(3), axis=X, actuated=True)]
    )
    return Scene("block", mechanism, DURATION, 0.1, **more)  # type: ignore[arg-type]


def _nan(time: float) -> float:
    return float("nan")


def _infinite(time: float) -> float:
    return float("inf")


def _text(time: float) -> str:
    return "1.0"


def _dividing(time: float) -> float:
    return 1.0 / (time - time)


def _from_then_on(wrong: Callable[[float], object]) -> Controller:
    """A controller that returns 1 N, and from 0.3 s on something wrong."""

    def control(time: float, x: object, rate: object) -> float:
        return 1.0 if time < 0.25 else wrong(time)  # type: ignore[return-value]

    return control


def _sampled(wrong: Callable[[float], object]) -> Scene:
    return block(control=(Sampled("rail", _from_then_on(wrong), 0.1),))


def _pushed(force: float, mass: float = 1.0) -> Scene:
    return block(mass, forces=(Wrench("push", "block", np.zeros(3), force=np.array([force, 0.0, 0.0])),))


def _moving(speed: float) -> Scene:
    scene = block()
    state = State.initial(scene.mechanism)
    state.linear_velocity[1] = speed * X
    return replace(scene, initial_state=state)


WITHOUT_ANSWER: dict[str, tuple[Callable[[], Scene], tuple[str, ...]]] = {
    "a controller's NaN at 0.3 s": (partial(_sampled, _nan), ("'rail'", "t = 0.3 s", "nan")),
    "a controller's infinity at 0.3 s": (partial(_sampled, _infinite), ("'rail'", "t = 0.3 s", "inf")),
    "a controller's text at 0.3 s": (partial(_sampled, _text), ("'rail'", "t = 0.3 s", "'1.0'")),
    "a controller that divides by zero at 0.3 s": (
        partial(_sampled, _dividing),
        ("'rail'", "t = 0.3 s", "ZeroDivisionError"),
    ),
    "a wrench of NaN": (partial(_pushed, float("nan")), ("'push'", "force")),
    "an infinite wrench": (partial(_pushed, float("inf")), ("'push'", "force")),
    "a wrench of 1e308 N on 1 g": (partial(_pushed, 1e308, 1e-3), ("'push'", "t = ")),
    "a joint's spring of 1e308 N/m, 1e3 m off": (
        partial(block, forces=(JointSpring("rail", stiffness=1e308, rest=1e3),)),
        ("spring of joint 'rail'", "t = "),
    ),
    "PD control with K_p 1e308, 1e3 m off": (
        partial(block, control=(PD("rail", 1e308, 0.0, 1e3),)),
        ("control of joint 'rail'", "t = "),
    ),
    "a start at 1e200 m/s, its energy asked for": (partial(_moving, 1e200), ("t = ",)),
}
"""Scenes, and what a refusal has to name."""

WITH_ANSWER: dict[str, tuple[float, float]] = {
    "a denormal force, 1e-310 N on 1 kg": (1e-310, 1.0),
    "a tiny body, 1e-150 N on 1e-150 kg": (1e-150, 1e-150),
    "a denormal body, 1e-310 N on 1e-310 kg": (1e-310, 1e-310),
    "a huge body, 1e150 N on 1e150 kg": (1e150, 1e150),
    "a huge body, 1e300 N on 1e300 kg": (1e300, 1e300),
    "a huge force, 1e150 N on 1 kg": (1e150, 1.0),
}
"""Force (N) and mass (kg) of a block whose velocity after 1 s is F t / m."""


def cases(full: bool) -> list[Case]:
    """All of (k)."""
    settings = SETTINGS if full else (*SETTINGS[:2], *SETTINGS[-3::2])
    return [
        *(
            Case("k", name, setting.engine, str(setting), "end position", "m", REFUSAL,
                 partial(measure_trap, name, setting), names=names)
            for name, (_, names) in WITHOUT_ANSWER.items()
            for setting in settings
        ),
        *(
            Case("k", name, setting.engine, str(setting), "velocity error", "rel", EXACT,
                 partial(measure_push, name, setting))
            for name in WITH_ANSWER
            for setting in settings
        ),
    ]  # fmt: skip


def measure_trap(name: str, setting: Setting) -> Measured:
    """Where the block ends up, if nothing says that it cannot."""
    run = setting.simulate(WITHOUT_ANSWER[name][0]())
    return Measured(float(run.position[-1, 1, 0]))


def measure_push(name: str, setting: Setting) -> Measured:
    """The velocity at the end against F t / m."""
    force, mass = WITH_ANSWER[name]
    scene = replace(_pushed(force, mass), outputs=frozenset({"velocities"}))
    run = setting.simulate(scene)
    assert run.linear_velocity is not None
    expected = force * DURATION / mass
    return Measured(abs(float(run.linear_velocity[-1, 1, 0]) / expected - 1.0))
