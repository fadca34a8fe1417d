"""The figures of a scene, measured in groups: equations and runs of each engine.

newton_euler runs the whole scene in joint coordinates and a tenth of it in Cartesian ones, at tight
tolerances. Its other integrators, MuJoCo and Pinocchio make a few dozen steps of one size: that takes all of
their code, costs the same for every scene, and lets round-off grow little, so that bands are narrow. The
equations of all engines are evaluated at the initial state and at one that the scene passes through, those of
newton_euler also with the joints open, where Baumgarte's gains act.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.engines import ENGINES
from crosscheck.regress.baseline import GroupName, Plan
from crosscheck.regress.values import (
    Value,
    balance,
    count,
    counts,
    end_of_run,
    equations,
    poses_over_time,
)
from newton_euler import compile_scene
from newton_euler.assemble import initial_state
from newton_euler.equations.system import System, at_time
from newton_euler.integrators.compiled import FORMULATIONS, PAPER_ALPHA, formulate
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array
from newton_euler.simulate import CompiledScene

OUTPUT_COUNT = 25
"""Output times of a whole run beside the start: enough to tell when it parts from the baseline."""

STEPS = {"newton_euler": 40, "mujoco": 40, "pinocchio": 10}
"""Of runs at fixed steps. Pinocchio is called from Python four times in each."""

SHARE, MOST_STEPS = 0.1, 1000
"""Of the scene's duration, and in fixed steps at most, that the run in Cartesian coordinates takes. Where
constraints are redundant or nearly singular it costs a hundred times as much as in joint coordinates, and the
two have the integrator in common."""

MOST_OPERATIONS = 1500
"""Of a right-hand side whose traced derivatives, for Radau, and whose Cartesian form with gains are compiled
too. They take longer than all else in a scene of more, and show no code that smaller ones do not."""

RADAU_RTOL = 1e-10
"""Of the method of order 5, which takes a few hundred steps for as long as the others' short runs."""

COUNT_RTOL = 1e-6
"""Of the runs whose steps are counted. At the tolerances of the others steps follow round-off, which differs
from one processor to the next."""

OPEN = 1e-3
"""Distance of coordinates from the constraints, sizes of the mechanism or rad; of velocities the same a
second."""


@dataclass(frozen=True)
class Variant:
    """A change to a measurement that alters nothing but its errors.

    Attributes:
        nudge: by what share of their sizes the states that it starts from are moved.
        tighten: factor on the tolerances of adaptive integrators.
    """

    nudge: float = 0.0
    tighten: float = 1.0


PLAIN = Variant()

Group = Callable[[Scene, Plan, Variant], Iterator[Value]]


def regress_scene(scene: Scene) -> Scene:
    """The scene with all outputs at `OUTPUT_COUNT` times.

    Reactions at an output of a mechanism with redundant constraints are worked out in Python, so that
    hundreds of outputs would take longer than all else.
    """
    return replace(scene, output_period=scene.duration / OUTPUT_COUNT, outputs=frozenset(OUTPUTS))


def measure_group(group: GroupName, scene: Scene, plan: Plan, variant: Variant = PLAIN) -> list[Value] | str:
    """The figures of one group, or why there are none.

    Whatever goes wrong in it is a result, as figures are: that of the code which is guarded.
    """
    try:
        return list(GROUPS[group](scene, plan, variant))
    except Exception as error:
        return " ".join(f"{type(error).__name__}: {error}".split())


def main_run(scene: Scene, rtol: float) -> Trajectory:
    """The run that a recording shows: newton_euler in joint coordinates."""
    return compile_scene(scene).simulate(rtol=rtol, atol=0.01 * rtol)


def part(scene: Scene, formulation: str, step: float) -> Scene:
    """The part of a scene that is run in a formulation: all output times, or the end of a part."""
    if formulation == MAIN:
        return scene
    duration = min(SHARE * scene.duration, MOST_STEPS * step)
    return replace(scene, duration=duration, output_period=duration)


def nudged(state: State, size: float, share: float) -> State:
    """All bodies but the ground moved and turned by a share of what they measure, in all directions."""
    if share == 0.0:
        return state

    def pattern(array: Array) -> Array:
        waves = np.cos(1.0 + np.arange(array.size)).reshape(array.shape)
        waves[0] = 0.0
        return waves

    quaternion = state.quaternion + share * pattern(state.quaternion)
    speed = float(np.max(np.abs(state.linear_velocity))) + size * float(
        np.max(np.abs(state.angular_velocity))
    )
    return State(
        state.position + share * size * pattern(state.position),
        quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True),
        state.linear_velocity + share * speed * pattern(state.linear_velocity),
        state.angular_velocity + share * speed / size * pattern(state.angular_velocity),
    )


def _moved(scene: Scene, variant: Variant) -> Scene:
    """The scene from its nudged start."""
    start = nudged(initial_state(scene), scene.mechanism.size, variant.nudge)
    return replace(scene, initial_state=start)


def _short(scene: Scene, plan: Plan, variant: Variant, steps: int) -> Scene:
    """A few steps from the moving state; from the start where motions are prescribed from there."""
    start = initial_state(scene) if scene.motions else plan.state.state()
    duration = steps * plan.step
    short = replace(scene, duration=duration, output_period=duration, initial_state=start)
    return _moved(short, variant)


def _at_both_states(scene: Scene, system: System, plan: Plan, variant: Variant) -> Iterator[Value]:
    stored = (("start", 0.0, initial_state(scene)), ("moving", plan.time, plan.state.state()))
    for label, time, state in stored:
        now = at_time(system, time)
        found = now.evaluate(*now.coordinates(nudged(state, scene.mechanism.size, variant.nudge)))
        yield from equations(scene, label, found)


def _open(scene: Scene, formulation: str, plan: Plan, variant: Variant) -> Value:
    """Accelerations where joints are open and opening, under Baumgarte's gains."""
    system = at_time(formulate(scene, formulation, PAPER_ALPHA), plan.time)
    q, v = system.coordinates(nudged(plan.state.state(), scene.mechanism.size, variant.nudge))
    step = OPEN * system.velocity_units * np.cos(1.0 + np.arange(system.nv))
    acceleration = system.acceleration(system.retract(q, step), v + step) / system.velocity_units
    columns = tuple(str(k) for k in range(system.nv))
    scale = float(np.max(np.abs(acceleration)))
    return Value("open joints: acceleration", "1/s^2", ("",), columns, acceleration[None], scale)


def _formulation(scene: Scene, plan: Plan, variant: Variant, formulation: str) -> Iterator[Value]:
    system = formulate(scene, formulation)
    yield from _at_both_states(scene, system, plan, variant)
    yield _open(scene, formulation, plan, variant)
    compiled = compile_scene(part(_moved(scene, variant), formulation, plan.step), formulation)
    for name, operations in compiled.operations.items():
        yield count(f"operations of {name}", operations)
    rtol = plan.rtol[formulation] * variant.tighten
    run = compiled.simulate(rtol=rtol, atol=0.01 * rtol)
    if formulation == "relative":
        yield from poses_over_time(scene, run)
    yield from end_of_run(scene, "DOP853", run)
    yield from balance(scene, "DOP853", run)
    yield from _counts(compiled, "DOP853")


def _steppers(scene: Scene, plan: Plan, variant: Variant) -> Iterator[Value]:
    short = _short(scene, plan, variant, STEPS["newton_euler"])
    compiled = compile_scene(short)
    for integrator in ("RK4", "Euler"):
        yield from end_of_run(scene, integrator, compiled.simulate(integrator, step=plan.step))
    small = compiled.operations["derivative"] <= MOST_OPERATIONS
    for formulation in FORMULATIONS if small else (MAIN,):
        gains = compile_scene(short, formulation, "baumgarte").simulate("RK4", step=plan.step)
        yield from end_of_run(scene, f"RK4, {formulation}, Baumgarte", gains)
    if small:
        rtol = RADAU_RTOL * variant.tighten
        radau = compiled.simulate("Radau", rtol=rtol, atol=0.01 * rtol)
        yield from end_of_run(scene, "Radau", radau)
        yield from _counts(compiled, "Radau")


def _counts(compiled: CompiledScene, integrator: str) -> Iterator[Value]:
    """Steps and evaluations of a run at `COUNT_RTOL`."""
    run = compiled.simulate(integrator, rtol=COUNT_RTOL, atol=0.01 * COUNT_RTOL)
    yield from counts(f"{integrator}, rtol {COUNT_RTOL:g}", run)


def _engine(scene: Scene, plan: Plan, variant: Variant, name: str) -> Iterator[Value]:
    engine = ENGINES[name]
    (system,) = engine.systems(scene)
    yield from _at_both_states(scene, system, plan, variant)
    if engine.soft_start is not None:
        yield from equations(scene, "soft constraints", engine.soft_start(_moved(scene, variant)))
    short = _short(scene, plan, variant, STEPS[name])
    yield from end_of_run(scene, "RK4", _fixed_run(name, short, plan.step))


def _fixed_run(engine: str, scene: Scene, step: float) -> Trajectory:
    if engine == "mujoco":
        import mjcf

        return mjcf.simulate(scene, timestep=step)
    import urdf

    return urdf.simulate(scene, "RK4", step=step)


def _of_formulation(formulation: str) -> Group:
    return lambda scene, plan, variant: _formulation(scene, plan, variant, formulation)


def _of_engine(name: str) -> Group:
    return lambda scene, plan, variant: _engine(scene, plan, variant, name)


MAIN: GroupName = "relative"
"""The formulation and group whose run is stored over time."""

GROUPS: dict[GroupName, Group] = {
    "relative": _of_formulation("relative"),
    "cartesian": _of_formulation("cartesian"),
    "integrators": _steppers,
    "mujoco": _of_engine("mujoco"),
    "pinocchio": _of_engine("pinocchio"),
}
"""Measurements of figures, by name."""
