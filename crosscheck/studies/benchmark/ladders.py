"""Settings of each engine for benchmarks, and functions that run the engine at a setting.

A setting is a method (equations of motion and integrator) with its step or tolerance. A ladder is a list of
settings of one method, from coarse to fine. The time of a run includes everything until the poses of all
bodies at all outputs are known in the engine's own form:

- newton_euler: integration, positions and quaternions of all bodies (`Trajectory.wall_time`).
- MuJoCo (`mjcf.benchmark_kernels`): all steps, kinematics at every output, and copies of positions and
  quaternions there. The steps from one output to the next run inside one call.
- Pinocchio (`urdf.benchmark_kernels`): integration, forward kinematics at every output, and copies of the
  translations and rotation matrices of all joints there.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

from crosscheck.support.errors import CrosscheckError
from newton_euler import compile_scene
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.compiled.run import load_code
from newton_euler.integrators.options import STABILIZATIONS, FormulationName, StabilizationName
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

BASELINE_ENGINE = "newton_euler"
"""Name of the engine that the others are compared with."""

Options = dict[str, Any]
"""Options of a run by name, such as the integrator, the step or the tolerance."""

Poses = tuple[Array, Array]
"""Positions (n, b, 3), m, and quaternions (n, b, 4) of the bodies, ground first, at the output times."""


class Run(NamedTuple):
    """One timed run.

    Attributes:
        seconds: duration of the run, s.
        evaluations: number of evaluations of the equations of motion.
        poses: converts the results to `Poses`, which is not part of the timed run.
    """

    seconds: float
    evaluations: int
    poses: Callable[[], Poses]


class Ladder(NamedTuple):
    """Settings of one method, from the coarsest to the finest.

    Attributes:
        method: name of the method.
        make_setting: returns the name and the options of setting n. The larger n, the smaller the step or
            tolerance.
        numbers: the values of n that are run, ascending.
        common: options that all settings share.
    """

    method: str
    make_setting: Callable[[int], tuple[str, Options]]
    numbers: Sequence[int]
    common: Options

    def setting(self, number: int) -> tuple[str, Options]:
        """Return the full name and all options of setting n."""
        name, options = self.make_setting(number)
        return f"{self.method}, {name}", self.common | options


class Model(NamedTuple):
    """A scene, loaded into an engine with one variant of its equations.

    Attributes:
        ladders: settings of each method.
        run: simulates the scene with given options; raises an exception if the engine fails.
    """

    ladders: Sequence[Ladder]
    run: Callable[[Options], Run]


Models = Mapping[str, Callable[[], Model]]
"""Functions that load a scene into an engine, one for each variant of its equations, by name."""


def poses_only(scene: Scene) -> Scene:
    """Return the scene with the poses of its bodies as its only outputs.

    Raises:
        CrosscheckError: for a scene with a sampled controller, whose Python code would take most of the time.
    """
    if scene.sampled:
        raise CrosscheckError(
            f"scene {scene.name!r} has a sampled controller; bench needs native control laws"
        )
    return replace(scene, outputs=frozenset())


def _tolerance_ladder(
    method: str, coarsest: float, finest: float, atol_per_rtol: float, per_decade: int = 2, **options: Any
) -> Ladder:
    """Make a ladder of relative tolerances (rtol).

    Args:
        method: name of the method.
        coarsest: the largest rtol is 10^-coarsest.
        finest: the smallest rtol is 10^-finest.
        atol_per_rtol: ratio of absolute and relative tolerance.
        per_decade: number of tolerances per factor of ten.
        **options: options that all settings share.
    """

    def make_setting(number: int) -> tuple[str, Options]:
        rtol = 10.0 ** (-number / per_decade)
        return f"rtol {rtol:.2g}", {"rtol": rtol, "atol": atol_per_rtol * rtol}

    numbers = range(round(coarsest * per_decade), round(finest * per_decade) + 1)
    return Ladder(f"{method}, atol = {atol_per_rtol:g} rtol", make_setting, numbers, options)


def _step_ladder(method: str, option: str, interval: float, numbers: Sequence[int], **options: Any) -> Ladder:
    """Make a ladder of fixed steps.

    Args:
        method: name of the method.
        option: name of the option that sets the step. The option "number" takes the number of steps per
            output interval, any other option takes the step in s.
        interval: time between outputs, s.
        numbers: numbers of steps from one output to the next.
        **options: options that all settings share.
    """

    def make_setting(number: int) -> tuple[str, Options]:
        step = interval / number
        return f"step {step:.3g} s", {option: number if option == "number" else step}

    return Ladder(method, make_setting, numbers, options)


def output_interval(scene: Scene) -> float:
    """Return the time between the first two outputs, s."""
    return float(scene.times[1] - scene.times[0])


# newton_euler

ATOL_PER_RTOL = (1.0, 1e-2)
"""Ratios of absolute tolerance (SI units) and relative tolerance (rtol) that are run."""

FINEST_DECADE = 13.5
"""Negative decimal logarithm of the finest rtol, 3e-14. At finer tolerances round-off dominates."""

FINEST_RADAU_DECADE = 9.5
"""Negative decimal logarithm of Radau's finest rtol, 3e-10. Radau has order 5, and would need too many steps
at finer tolerances."""

RADAU_VARIANT = ("relative", "projection")
"""Formulation and stabilization with which the integrator Radau runs.

In Cartesian coordinates, the Jacobian that Radau needs would compile for half a minute.
"""


def adaptive_ladders(formulation: str, stabilization: str, per_decade: int = 2) -> list[Ladder]:
    """Make the ladders of newton_euler's integrators with error control, all from rtol 10^-2 on.

    Args:
        formulation: coordinates of the equations: "relative" (of joints) or "cartesian" (of bodies).
        stabilization: method that keeps constraint violations small.
        per_decade: number of tolerances per factor of ten.
    """
    prefix = f"{formulation}, {stabilization}"
    kinds = [("DOP853", FINEST_DECADE, ratio) for ratio in ATOL_PER_RTOL]
    if (formulation, stabilization) == RADAU_VARIANT:
        kinds.append(("Radau", FINEST_RADAU_DECADE, ATOL_PER_RTOL[1]))
    return [
        _tolerance_ladder(
            f"{prefix}, {name}",
            coarsest=2.0,
            finest=finest,
            atol_per_rtol=ratio,
            per_decade=per_decade,
            integrator=name,
        )
        for name, finest, ratio in kinds
    ]


def _newton_euler(scene: Scene) -> Models:
    """Return functions that load a scene with each formulation and stabilization of newton_euler."""
    variants = product(FORMULATIONS, STABILIZATIONS)
    return {", ".join(variant): partial(_load_newton_euler, scene, *variant) for variant in variants}


def _load_newton_euler(scene: Scene, formulation: FormulationName, stabilization: StabilizationName) -> Model:
    """Compile a scene with one formulation and stabilization of newton_euler."""
    compiled = compile_scene(scene, formulation=formulation, stabilization=stabilization)
    # compile before runs are timed; Euler needs all functions that DOP853 and RK4 need, and one more
    load_code(compiled, "Euler")
    if (formulation, stabilization) == RADAU_VARIANT:
        load_code(compiled, "Radau")
    ladders, interval = adaptive_ladders(formulation, stabilization), output_interval(scene)
    for integrator in ("RK4", "Euler"):
        method, numbers = f"{formulation}, {stabilization}, {integrator}", (1, 2, 5, 10, 20, 50)
        ladders.append(_step_ladder(method, "step", interval, numbers, integrator=integrator))

    def run(options: Options) -> Run:
        found = compiled.simulate(**options)
        return Run(found.wall_time, found.settings["evaluations"], lambda: (found.position, found.quaternion))

    return Model(ladders, run)


# MuJoCo

STEPS_PER_OUTPUT = (1, 2, 3, 5, 7, 10, 20, 50, 100, 200)
"""Numbers of MuJoCo's steps from one output to the next; MuJoCo has outputs only at its steps."""

MUJOCO_METHODS = (("RK4", 1.0), ("RK4", 0.6), ("implicitfast", 1.0), ("implicit", 1.0), ("Euler", 1.0))
"""MuJoCo's integrators, each with the damping ratio of the constraints, the second number of `solref`.

The time constant of the constraints, the first number of `solref`, is two steps, the stiffest stable value.
With the scene `tracker`, softer constraints, constraints with negative `solref` (stiffness and damping), and
other damping ratios were tried. A ratio of 0.6 makes RK4 a third more accurate at every step. Other
integrators depend on the ratio only at a step of 10 ms, where RK4 is faster.
"""


def mujoco_ladders(interval: float, numbers: Sequence[int] = STEPS_PER_OUTPUT) -> list[Ladder]:
    """Make the ladders of MuJoCo's integrators.

    Args:
        interval: time between outputs, s.
        numbers: numbers of steps from one output to the next.
    """
    return [
        _step_ladder(
            f"{integrator}, solref (2 steps, {ratio:g})",
            "number",
            interval,
            numbers,
            integrator=integrator,
            damping_ratio=ratio,
        )
        for integrator, ratio in MUJOCO_METHODS
    ]


def _mujoco(scene: Scene) -> Models:
    """Return the function that loads a scene into MuJoCo."""
    return {"MJCF": partial(_load_mujoco, scene)}


def _load_mujoco(scene: Scene) -> Model:
    """Compile a scene for MuJoCo."""
    from mjcf.benchmark_kernels import Stepper, compiled

    system = compiled(scene)
    outputs = intervals(scene.times)

    def run(options: Options) -> Run:
        stepper = Stepper(system, intervals=outputs, **options)
        stepper.reset()
        start = time.perf_counter()
        stepper.run()
        seconds = time.perf_counter() - start
        # one evaluation of the equations per stage of each step; only RK4 has several stages
        stages = 4 if options["integrator"] == "RK4" else 1
        return Run(seconds, stages * options["number"] * (len(scene.times) - 1), stepper.poses)

    return Model(mujoco_ladders(output_interval(scene)), run)


def intervals(times: Array) -> list[tuple[int, float]]:
    """Return the intervals between output times (n,), s, as MuJoCo's stepper takes them.

    All intervals are equally long, except that the last one may be shorter.

    Returns:
        In order of time, pairs of a number of equal intervals and their length, s.
    """
    first, last = float(times[1] - times[0]), float(times[-1] - times[-2])
    if abs(first - last) <= 1e-9 * first:
        return [(len(times) - 1, first)]
    return [(len(times) - 2, first), (1, last)]


# Pinocchio

BAUMGARTE_ALPHAS = (0.0, 3.0, 10.0)
"""Parameters alpha, 1/s, of Baumgarte's stabilization, which feeds back constraint violations with the gains
alpha^2 and their rates with 2 alpha.

With the scene `tracker`, 30 is not better than 10, and 100 makes the equations stiff.
"""


def _pinocchio(scene: Scene) -> Models:
    """Return functions that load a scene into Pinocchio with each of `BAUMGARTE_ALPHAS`.

    Accelerations come from Pinocchio's `constraintDynamics`. Those of `lcaba`, Pinocchio's articulated-body
    algorithm with constraints, have noise of 1e-9, at which integrators with error control stall.
    """
    return {
        f"constraintDynamics, alpha {alpha:g}": partial(_load_pinocchio, scene, alpha)
        for alpha in BAUMGARTE_ALPHAS
    }


def _load_pinocchio(scene: Scene, alpha: float) -> Model:
    """Load a scene into Pinocchio with a Baumgarte parameter alpha, 1/s; the integrator is LSODA."""
    from urdf.benchmark_kernels import Kinematics, equations_of, lsoda

    equations = equations_of(scene, alpha, lcaba=None)  # by `constraintDynamics`
    kinematics = Kinematics(equations)

    def run(options: Options) -> Run:
        start = time.perf_counter()
        states, evaluations = lsoda(equations, **options)  # states at the output times
        placements = kinematics(states)
        seconds = time.perf_counter() - start
        return Run(seconds, evaluations, partial(kinematics.poses, placements))

    method = f"constraintDynamics, alpha {alpha:g}, LSODA"
    ladders = [
        _tolerance_ladder(method, coarsest=1.0, finest=FINEST_DECADE, atol_per_rtol=ratio)
        for ratio in ATOL_PER_RTOL
    ]
    return Model(ladders, run)


ENGINES: dict[str, Callable[[Scene], Models]] = {
    "newton_euler": _newton_euler,
    "mujoco": _mujoco,
    "pinocchio": _pinocchio,
}
"""Functions by engine that take a scene and return `Models`: a loading function for each variant of the
engine's equations."""
