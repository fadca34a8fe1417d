"""newton_euler for benchmarks: both formulations, every integrator and stabilisation.

The time of a run is `Trajectory.wall_time`: the integration and the poses of all bodies at all outputs.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from crosscheck.studies.benchmark.work_precision import Ladder, Model, Models, Run, Setting
from newton_euler import compile_scene
from newton_euler.integrators.compiled import FORMULATIONS, STABILIZATIONS
from newton_euler.integrators.run import load
from newton_euler.model.scene import Scene
from newton_euler.simulate import CompiledScene

TIGHTEST = 3e-14
"""Tightest rtol: DOP853's own limit is 2.2e-14."""

SHARES = (1.0, 1e-2)
"""atol, in units of rtol."""

STIFF = ("relative", "projection")
"""What Radau runs. The Jacobian of Cartesian coordinates would take half a minute to compile."""

STEPS = (1, 2, 5, 10, 20, 50)
"""Fixed steps from one output to the next."""


def models(scene: Scene) -> Models:
    """One for each formulation and stabilisation."""
    return {
        f"{formulation}, {stabilization}": partial(_load, scene, formulation, stabilization)
        for formulation in FORMULATIONS
        for stabilization in STABILIZATIONS
    }


def _load(scene: Scene, formulation: str, stabilization: str) -> Model:
    compiled = compile_scene(scene, formulation=formulation, stabilization=stabilization)
    load(compiled, "Euler")
    stiff = (formulation, stabilization) == STIFF
    if stiff:
        load(compiled, "Radau")
    prefix = f"{formulation}, {stabilization}"
    ladders = [_adaptive(compiled, prefix, "DOP853", range(2, 14), share) for share in SHARES]
    if stiff:
        ladders.append(_adaptive(compiled, prefix, "Radau", range(2, 10), SHARES[1]))
    ladders += [_fixed(compiled, prefix, integrator) for integrator in ("RK4", "Euler")]
    source = "loaded from the cache" if compiled.from_cache else "compiled"
    return Model(
        tuple(ladders), f"traced {compiled.trace_time:.2f} s, {source} {compiled.compile_time:.2f} s"
    )


def _adaptive(compiled: CompiledScene, prefix: str, integrator: str, powers: range, share: float) -> Ladder:
    settings = []
    for rtol in (base * 10.0**-power for power in powers for base in (1.0, 0.3)):
        if rtol >= TIGHTEST:
            options = {"integrator": integrator, "rtol": rtol, "atol": share * rtol}
            settings.append(_setting(compiled, f"rtol {rtol:.0e}", options))
    return Ladder(f"{prefix}, {integrator}, atol = {share:g} rtol", tuple(settings))


def _fixed(compiled: CompiledScene, prefix: str, integrator: str) -> Ladder:
    times = compiled.scene.times
    settings = []
    for number in STEPS:
        step = float(times[1] - times[0]) / number
        options = {"integrator": integrator, "step": step}
        settings.append(_setting(compiled, f"step {step:.3g} s", options))
    return Ladder(f"{prefix}, {integrator}", tuple(settings))


def _setting(compiled: CompiledScene, name: str, options: dict[str, Any]) -> Setting:
    def run() -> Run:
        trajectory = compiled.simulate(**options)
        poses = trajectory.position, trajectory.quaternion
        return Run(trajectory.wall_time, trajectory.settings["evaluations"], lambda: poses)

    whole = {"formulation": compiled.formulation, "stabilization": compiled.stabilization}
    return Setting(name, run, whole | options)
