"""Plan of a sweep: everything that its runs depend on, and the functions that execute runs.

A sweep simulates one scene many times with sampled values of some parameters, and stores kept outputs,
numbers or arrays, of each run. The plan is sent to all threads and processes that execute runs. A chunk is a
range of consecutive runs that are stored together. `make_runs` executes such a range in a worker process.
"""

from __future__ import annotations

import json
import pickle
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from importlib.metadata import version
from math import prod
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from crosscheck.engines.registry import SOLVER
from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.expressions import DIMENSIONS, Outputs, labels
from crosscheck.sweeps.reductions import Reduction, pruned, reductions
from crosscheck.sweeps.sampling import SweepSamples
from newton_euler.codegen.compile import lane_count, llvm_binding
from newton_euler.codegen.fingerprint import SOURCE, fingerprint
from newton_euler.equations.parameters import parameter_values, with_values
from newton_euler.errors import DISTRIBUTION, NewtonEulerError
from newton_euler.integrators.options import Options
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import QUANTITIES
from newton_euler.runs.batch import Batch, make_batch
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.variation import with_parameters
from newton_euler.scalars import Array

MAX_OUTPUT_BYTES = 48_000_000
"""Largest memory, bytes, of the outputs of runs that are simulated together."""

SCENE_FIELDS_WITHOUT_EFFECT = frozenset({"description", "shapes", "meshes"})
"""Fields of scenes and bodies that do not affect a run."""

RECORDED_PACKAGES = ("numpy", "scipy", "xarray", "zarr")
"""Packages whose versions are stored with a sweep."""

CONDITION_DIFFERENCES = {
    "solver": f"another version of {SOLVER.name}",
    "crosscheck": "another version of crosscheck",
    "processor": "another kind of processor",
    "samples": "other samples by the same seed, of other versions of packages,",
}
"""Conditions besides the plan on which the last bits of results depend (see `SweepPlan.conditions`), and
texts that name a difference."""

CACHED_PLANS = 4
"""Number of unpickled plans that a worker process keeps in memory."""

UNPICKLING_LOCK = Lock()
"""Lock during unpickling of a plan, so that the threads of a worker share one plan and its compiled code."""

RUN_COMPLETED, RUN_FAILED = 1, 2
"""Status of a run; 0 stands for a run that has not been executed."""

Parameters = Mapping[str, Array]
"""Values (runs,) of each varied parameter, by the name of the parameter."""


class Chunk(NamedTuple):
    """Results of consecutive runs.

    Attributes:
        values: arrays (runs, ...) by name of a parameter or kept output.
        errors: (runs,) reasons of failed runs; empty texts for other runs.
    """

    values: dict[str, Array]
    errors: Array


@dataclass(frozen=True, eq=False)
class SweepPlan:
    """Everything that the runs of a sweep depend on. A plan can be pickled for other processes.

    Attributes:
        scene: the scene with nominal values of the parameters.
        samples: values of the varied parameters for each run.
        keep: texts of kept outputs, [NAME=]REDUCTION, for example "peak:reaction_force".
        control: integrator and its options, as of `newton_euler.simulate`.
        chunk: number of runs that are stored together.
        needed: `conditions` of the process that pickled the plan; empty in that process.
    """

    scene: Scene
    samples: SweepSamples
    keep: tuple[str, ...]
    control: Mapping[str, Any]
    chunk: int
    needed: Mapping[str, str] = field(default_factory=dict)

    @property
    def integrator(self) -> str:
        """Name of the integrator."""
        return str(self.control.get("integrator", Options.integrator))

    @property
    def kept(self) -> tuple[Reduction, ...]:
        """Reductions that compute the kept outputs of a run."""
        return _kept(self.scene, self.keep, self.integrator)[0]

    @property
    def pruned_scene(self) -> Scene:
        """The scene with only those outputs (such as velocities or reactions) that the reductions need."""
        return _kept(self.scene, self.keep, self.integrator)[1]

    def parameters(self, first: int, last: int) -> Parameters:
        """Return the parameters of runs `first` to `last` - 1."""
        values = self.samples.values(first, last)
        return {name: values[:, k].copy() for k, name in enumerate(self.samples.names)}

    def batch(self, parameters: Parameters, scene: Scene, threads: int | None = 1) -> Batch:
        """Simulate runs with given parameters on a number of threads; on all processors if None."""
        return make_batch(scene, parameters=parameters, threads=threads, **self.control)

    def runs_per_batch(self, scene: Scene) -> int:
        """Return the number of runs to simulate together, so that their outputs fit into `MAX_OUTPUT_BYTES`.

        The number is at least that of the runs that compiled code simulates side by side.
        """
        labels_along = labels(self.scene)
        numbers_per_time = sum(
            prod(len(labels_along[dimension]) for dimension in DIMENSIONS[name])
            for name, quantity in QUANTITIES.items()
            if quantity.output is None or quantity.output in scene.outputs
        )
        return max(lane_count(), MAX_OUTPUT_BYTES // (8 * numbers_per_time * len(scene.times)))

    def mechanism_of(self, run: int) -> Mechanism:
        """Return the mechanism of one run; its joint coordinates are zero at the initial pose of the plan's
        scene."""
        values = self.parameters(run, run + 1)
        initial = initial_numbers(self.scene, values)  # initial coordinates do not change the mechanism
        numbers = {name: float(value[0]) for name, value in values.items() if name not in initial}
        return with_values(self.scene, numbers).mechanism

    def scene_of(self, run: int) -> Scene:
        """Return the scene of one run, from its own closed initial pose, for any engine.

        Raises:
            NewtonEulerError: for values that a scene cannot have.
        """
        values = self.parameters(run, run + 1)
        return with_parameters(self.scene, {name: float(value[0]) for name, value in values.items()})

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the plan as bytes that a process unpickles once for all its tasks."""
        return _unpickle_plan, (self._content,)

    @cached_property
    def _content(self) -> bytes:
        """The pickled plan."""
        needed = self.needed or self.conditions
        return pickle.dumps(
            (_without_meshes(self.scene), self.samples, self.keep, dict(self.control), self.chunk, needed)
        )

    @cached_property
    def conditions(self) -> dict[str, str]:
        """Conditions of this process, besides the plan, on which the last bits of results depend: hash of
        newton_euler's source, version of crosscheck, kind of processor, and hash of the samples."""
        return {
            "solver": SOURCE.hex(),
            "crosscheck": version(DISTRIBUTION),
            "processor": processor(),
            "samples": self.samples.digest(self.samples.runs),
        }

    def check_conditions(self) -> None:
        """Raise `CrosscheckError` if this process and the one that pickled the plan differ in conditions."""
        for name, needed in self.needed.items():
            if self.conditions[name] != needed:
                what = CONDITION_DIFFERENCES[name]
                raise CrosscheckError(
                    f"a worker on {platform.node()} has {what} than this process; needed: the same"
                )

    def record(self) -> dict[str, str | int | float]:
        """Describe the plan by texts and numbers, types that netCDF allows, for the stored sweep.

        Different plans have different records.

        Raises:
            CrosscheckError: for a scene with objects of unknown classes, which have no fingerprint.
        """
        known = fingerprint(self.scene, neutral=SCENE_FIELDS_WITHOUT_EFFECT)
        if known is None:
            problem = "contains objects of unknown classes, so that a stored sweep cannot be recognized"
            raise CrosscheckError(f"scene {self.scene.name!r} {problem}; omit the folder (output)")
        return {
            "scene": self.scene.name,
            "fingerprint": known,
            "numbers": json.dumps(_numbers(self.scene)),
            # the distribution of each parameter, or of a group of correlated parameters
            **{f"vary {', '.join(names)}": str(each) for names, each in self.samples.groups},
            "vary": ", ".join(self.samples.names),
            "sampling": self.samples.sampling,
            "runs": self.samples.runs,
            "seed": self.samples.seed,
            "keep": ", ".join(self.keep),
            **self.control,
            "chunk": self.chunk,
            "versions": json.dumps({name: version(name) for name in RECORDED_PACKAGES}),
            **self.conditions,
        }


def processor() -> str:
    """Return the processor's architecture and whether it has FMA (fused multiply-add) instructions.

    Both affect the last bits of results.
    """
    fused = llvm_binding().get_host_cpu_features().get("fma", False)
    return f"{platform.machine()} {'with' if fused else 'without'} FMA"


@lru_cache(maxsize=CACHED_PLANS)
def _kept(scene: Scene, keep: tuple[str, ...], integrator: str) -> tuple[tuple[Reduction, ...], Scene]:
    """Return the reductions of a plan, and the scene with only those outputs that they need."""
    kept = reductions(keep, scene)
    return kept, pruned(scene, kept, integrator)


def _numbers(scene: Scene) -> dict[str, str]:
    """Return the parameters of a scene as texts by name, to show what differs between two scenes."""
    values = parameter_values(scene)
    values |= {name: np.array(getattr(scene, name)) for name in ("duration", "output_period")}
    return {name: " ".join(f"{number:.12g}" for number in value.flat) for name, value in values.items()}


def _without_meshes(scene: Scene) -> Scene:
    """Return the scene without meshes, which can be large."""
    mechanism = scene.mechanism
    if not any(body.meshes for body in mechanism.bodies):
        return scene
    bodies = tuple(replace(body, meshes=()) for body in mechanism.bodies)
    return replace(scene, mechanism=Mechanism(bodies, mechanism.joints, mechanism.couplings))


def _unpickle_plan(content: bytes) -> SweepPlan:
    """Unpickle a plan; all tasks of a process share one plan of the same content."""
    with UNPICKLING_LOCK:
        return _cached_plan(content)


@lru_cache(maxsize=CACHED_PLANS)
def _cached_plan(content: bytes) -> SweepPlan:
    """Unpickle a plan and prepare its reductions; a plan that was unpickled before is returned again."""
    plan = SweepPlan(*pickle.loads(content))
    _kept(plan.scene, plan.keep, plan.integrator)
    return plan


def make_runs(plan: SweepPlan, runs: tuple[int, int]) -> Chunk:
    """Execute a range of runs, with results that do not depend on process, thread and order.

    Args:
        plan: the plan.
        runs: index of the first run, and one more than the index of the last run.

    Raises:
        CrosscheckError: for a scene that cannot be simulated.
    """
    plan.check_conditions()
    try:
        return run_all(plan, plan.parameters(*runs))
    except NewtonEulerError as error:  # a NewtonEulerError cannot be pickled
        raise CrosscheckError(str(error)) from error


def run_all(plan: SweepPlan, parameters: Parameters) -> Chunk:
    """Execute runs with given parameters and compute their kept outputs."""
    parts = list(_parts(plan, parameters))
    values = {name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values}
    return Chunk(values, np.concatenate([part.errors for part in parts]))


def _parts(plan: SweepPlan, parameters: Parameters) -> Iterator[Chunk]:
    """Yield the results of groups of runs, as many per group as memory allows."""
    count = len(next(iter(parameters.values())))
    # groups of equal size, a multiple of the number of runs that compiled code simulates side by side
    groups = -(-count // plan.runs_per_batch(plan.pruned_scene))  # -(-a // b) is a / b rounded up
    size = -(-count // (groups * lane_count())) * lane_count()
    for start in range(0, count, size):
        group = {name: values[start : start + size] for name, values in parameters.items()}
        batch = plan.batch(group, plan.pruned_scene)
        outputs = Outputs.of_batch(plan.scene, batch)
        values = group | {each.name: each.of(outputs) for each in plan.kept}
        # error messages begin with the number of the run within the batch, which is removed
        errors = [str(batch.errors.get(k, "")).removeprefix(f"run {k}: ") for k in range(len(batch))]
        for run in batch.errors:
            for each in plan.kept:
                values[each.name][run] = np.nan
        yield Chunk(values, np.array(errors, dtype=object))
