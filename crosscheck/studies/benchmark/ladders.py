"""The engines of a benchmark, each in its cheapest ways: ladders of settings, ever finer.

A run's time is what it takes to have the poses of all bodies at all outputs, as the engine has them:

- newton_euler: `Trajectory.wall_time`, the integration and positions and quaternions of all bodies.
- MuJoCo, see `mjcf.benchmark_kernels`: all steps, its kinematics at every output and copies of the
  positions and quaternions of its bodies then. Steps from one output to the next run inside one call.
- Pinocchio, see `urdf.benchmark_kernels`: the integration, forward kinematics at every output and a copy
  of translations and rotation matrices of all joints then.
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
from newton_euler.compiled.run import load
from newton_euler.integrators.options import STABILIZATIONS, FormulationName, StabilizationName
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

JUDGED = "newton_euler"
"""The engine that the others are compared with."""

Options = dict[str, Any]

Poses = tuple[Array, Array]
"""Positions (n, b, 3), m, and quaternions (n, b, 4) of the bodies, ground first, at the output times."""


class Run(NamedTuple):
    """One timed run.

    Attributes:
        seconds: what it took, by its own clock.
        evaluations: of the equations of motion.
        poses: works them out; not timed.
    """

    seconds: float
    evaluations: int
    poses: Callable[[], Poses]


class Ladder(NamedTuple):
    """Settings of one method.

    Attributes:
        method: name.
        finer: the name of the n-th setting, and its own options; errors fall with n.
        numbers: those that are run, from the coarsest to the finest.
        common: options of all settings.
    """

    method: str
    finer: Callable[[int], tuple[str, Options]]
    numbers: Sequence[int]
    common: Options

    def setting(self, number: int) -> tuple[str, Options]:
        """Return the n-th setting's full name, and its options."""
        name, options = self.finer(number)
        return f"{self.method}, {name}", self.common | options


class Model(NamedTuple):
    """A scene as loaded by an engine.

    Attributes:
        ladders: its methods.
        run: a run at a setting's options; raises an exception that says why if it cannot.
    """

    ladders: Sequence[Ladder]
    run: Callable[[Options], Run]


Models = Mapping[str, Callable[[], Model]]
"""Loads a scene in each of the ways that an engine knows, by name."""


def poses_only(scene: Scene) -> Scene:
    """Return the scene without outputs but the poses of its bodies.

    Raises:
        CrosscheckError: for a scene with a sampled controller, whose Python all engines would wait for.
    """
    if scene.sampled:
        raise CrosscheckError(
            f"scene {scene.name!r} has a sampled controller; bench needs native control laws"
        )
    return replace(scene, outputs=frozenset())


def _by_tolerance(
    method: str, coarsest: float, finest: float, share: float, per_decade: int = 2, **options: Any
) -> Ladder:
    """A ladder of rtol from 10^-coarsest to 10^-finest, atol being a share of it."""

    def finer(number: int) -> tuple[str, Options]:
        rtol = 10.0 ** (-number / per_decade)
        return f"rtol {rtol:.2g}", {"rtol": rtol, "atol": share * rtol}

    numbers = range(round(coarsest * per_decade), round(finest * per_decade) + 1)
    return Ladder(f"{method}, atol = {share:g} rtol", finer, numbers, options)


def _by_step(method: str, option: str, interval: float, numbers: Sequence[int], **options: Any) -> Ladder:
    """A ladder of numbers of steps from one output to the next, `interval` s later; `option` sets them."""

    def finer(number: int) -> tuple[str, Options]:
        step = interval / number
        return f"step {step:.3g} s", {option: number if option == "number" else step}

    return Ladder(method, finer, numbers, options)


def output_interval(scene: Scene) -> float:
    """Return the s between the first two outputs."""
    return float(scene.times[1] - scene.times[0])


# newton_euler

SHARES = (1.0, 1e-2)
"""atol, in units of rtol."""

FINEST = 13.5
"""Decades of rtol, 3e-14; the limit of DOP853, scipy's and newton_euler's, is 2.2e-14."""

STIFF = ("relative", "projection")
"""What Radau runs. The Jacobian of Cartesian coordinates would take half a minute to compile."""


def adaptive_ladders(formulation: str, stabilization: str, per_decade: int = 2) -> list[Ladder]:
    """newton_euler's methods with error control, at so many tolerances per decade."""
    prefix = f"{formulation}, {stabilization}"
    kinds = [("DOP853", FINEST, share) for share in SHARES]
    if (formulation, stabilization) == STIFF:
        kinds.append(("Radau", 9.5, SHARES[1]))
    return [
        _by_tolerance(f"{prefix}, {name}", 2.0, finest, share, per_decade, integrator=name)
        for name, finest, share in kinds
    ]


def _newton_euler(scene: Scene) -> Models:
    """Return a model for each formulation and stabilization."""
    return {", ".join(how): partial(_load_own, scene, *how) for how in product(FORMULATIONS, STABILIZATIONS)}


def _load_own(scene: Scene, formulation: FormulationName, stabilization: StabilizationName) -> Model:
    compiled = compile_scene(scene, formulation=formulation, stabilization=stabilization)
    load(compiled, "Euler")
    if (formulation, stabilization) == STIFF:
        load(compiled, "Radau")
    ladders, interval = adaptive_ladders(formulation, stabilization), output_interval(scene)
    for integrator in ("RK4", "Euler"):
        method, numbers = f"{formulation}, {stabilization}, {integrator}", (1, 2, 5, 10, 20, 50)
        ladders.append(_by_step(method, "step", interval, numbers, integrator=integrator))

    def run(options: Options) -> Run:
        found = compiled.simulate(**options)
        return Run(found.wall_time, found.settings["evaluations"], lambda: (found.position, found.quaternion))

    return Model(ladders, run)


# MuJoCo

STEPS = (1, 2, 3, 5, 7, 10, 20, 50, 100, 200)
"""MuJoCo's steps from one output to the next. It has no outputs between its steps."""

METHODS = (("RK4", 1.0), ("RK4", 0.6), ("implicitfast", 1.0), ("implicit", 1.0), ("Euler", 1.0))
"""Integrators, and the constraints' damping ratio with the stiffest time constant, two steps.

Of softer, direct (negative) and less damped constraints on the tracker, a ratio of 0.6 makes RK4 most
exact, at every step: by a third. The others hardly depend on it, and RK4 is cheaper than they are at the one
step (10 ms) where they do."""


def mujoco_ladders(interval: float, numbers: Sequence[int] = STEPS) -> list[Ladder]:
    """MuJoCo's methods, with outputs `interval` s apart."""
    return [
        _by_step(
            f"{integrator}, solref (2 steps, {ratio:g})",
            "number",
            interval,
            numbers,
            integrator=integrator,
            damping_ratio=ratio,
        )
        for integrator, ratio in METHODS
    ]


def _mujoco(scene: Scene) -> Models:
    return {"MJCF": partial(_load_mujoco, scene)}


def _load_mujoco(scene: Scene) -> Model:
    from mjcf.benchmark_kernels import Stepper, compiled

    system = compiled(scene)
    outputs = intervals(scene.times)

    def run(options: Options) -> Run:
        stepper = Stepper(system, intervals=outputs, **options)
        stepper.reset()
        start = time.perf_counter()
        stepper.run()
        seconds = time.perf_counter() - start
        stages = 4 if options["integrator"] == "RK4" else 1
        return Run(seconds, stages * options["number"] * (len(scene.times) - 1), stepper.poses)

    return Model(mujoco_ladders(output_interval(scene)), run)


def intervals(times: Array) -> list[tuple[int, float]]:
    """Count equal intervals, s, between outputs, and then the last if it is shorter."""
    first, last = float(times[1] - times[0]), float(times[-1] - times[-2])
    if abs(first - last) <= 1e-9 * first:
        return [(len(times) - 1, first)]
    return [(len(times) - 2, first), (1, last)]


# Pinocchio

ALPHAS = (0.0, 3.0, 10.0)
"""1/s, of Baumgarte's gains. On the tracker 30 is no better than 10, and 100 is stiff."""


def _pinocchio(scene: Scene) -> Models:
    """Return a model for each Baumgarte gain.

    Its accelerations are those of `constraintDynamics`: those of `lcaba` are no smoother than 1e-9, and
    methods with error control stall on the noise.
    """
    return {
        f"constraintDynamics, alpha {alpha:g}": partial(_load_pinocchio, scene, alpha) for alpha in ALPHAS
    }


def _load_pinocchio(scene: Scene, alpha: float) -> Model:
    from urdf.benchmark_kernels import Kinematics, equations_of, lsoda

    equations = equations_of(scene, alpha, None)
    kinematics = Kinematics(equations)

    def run(options: Options) -> Run:
        start = time.perf_counter()
        rows, evaluations = lsoda(equations, **options)
        placements = kinematics(rows)
        seconds = time.perf_counter() - start
        return Run(seconds, evaluations, partial(kinematics.poses, placements))

    method = f"constraintDynamics, alpha {alpha:g}, LSODA"
    ladders = [_by_tolerance(method, 1.0, FINEST, share) for share in SHARES]
    return Model(ladders, run)


ENGINES: dict[str, Callable[[Scene], Models]] = {
    "newton_euler": _newton_euler,
    "mujoco": _mujoco,
    "pinocchio": _pinocchio,
}
