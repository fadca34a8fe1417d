"""The plan of a sweep: all that its runs depend on, and the results of any of them."""

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

from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.expressions import DIMENSIONS, Outputs, labels
from crosscheck.sweeps.reductions import Reduction, pruned, reductions
from crosscheck.sweeps.sampling import Samples
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

ROOM = 48_000_000
"""Bytes of the outputs of runs that are in memory together."""

UNSEEN = frozenset({"description", "shapes", "meshes"})
"""Fields of scenes that no run depends on."""

RECORDED = ("numpy", "scipy", "xarray", "zarr")
"""Packages whose versions are recorded."""

CONDITIONS = {
    "solver": "another version of newton_euler",
    "crosscheck": "another version of crosscheck",
    "processor": "another kind of processor",
    "samples": "other samples by the same seed, of other versions of packages,",
}
"""Conditions that results depend on beside the plan, where they differ."""

PLANS = 4
"""Of which a process makes runs by turns."""

RESTORING = Lock()
"""Held while a plan that was sent is restored: threads of a worker have the same one, and its code."""

DONE, STOPPED = 1, 2
"""Status of a run that came to its end, and of one that could not; 0 of one that has not been made."""

Parameters = Mapping[str, Array]
"""Values (runs,) by the name of a parameter."""


class Chunk(NamedTuple):
    """Results of consecutive runs.

    Attributes:
        values: arrays (runs, ...) by the name of a parameter or of what is kept.
        errors: (runs,) why a run could not go on, empty for others.
    """

    values: dict[str, Array]
    errors: Array


@dataclass(frozen=True, eq=False)
class Plan:
    """All that the runs of a sweep depend on; it may be sent to other processes.

    Attributes:
        scene: with its nominal values.
        samples: values of its parameters for each run.
        keep: texts of what is kept of each run, NAME=REDUCTION.
        control: of the integrator's steps, as of `newton_euler.simulate`.
        chunk: runs that are stored together.
        needed: conditions of the process that sent the plan; empty in that.
    """

    scene: Scene
    samples: Samples
    keep: tuple[str, ...]
    control: Mapping[str, Any]
    chunk: int
    needed: Mapping[str, str] = field(default_factory=dict)

    @property
    def integrator(self) -> str:
        """The method."""
        return str(self.control.get("integrator", Options.integrator))

    @property
    def kept(self) -> tuple[Reduction, ...]:
        """The reductions of each run."""
        return _kept(self.scene, self.keep, self.integrator)[0]

    @property
    def lean(self) -> Scene:
        """The scene with those outputs alone that are needed: one for plans that keep the same."""
        return _kept(self.scene, self.keep, self.integrator)[1]

    def parameters(self, first: int, last: int) -> Parameters:
        """Return the parameters of the runs from `first` to before `last`."""
        values = self.samples.values(first, last)
        return {name: values[:, k].copy() for k, name in enumerate(self.samples.names)}

    def batch(self, parameters: Parameters, scene: Scene, threads: int | None = 1) -> Batch:
        """Make runs on some threads, on all processors if None; `sweep` warns once for all of them."""
        return make_batch(scene, parameters=parameters, threads=threads, **self.control)

    def together(self, scene: Scene) -> int:
        """Return the number of runs whose outputs are in memory at a time, of a scene as `lean`."""
        names = labels(self.scene)
        numbers = sum(
            prod(len(names[dimension]) for dimension in DIMENSIONS[name])
            for name, quantity in QUANTITIES.items()
            if quantity.output is None or quantity.output in scene.outputs
        )
        return max(lane_count(), ROOM // (8 * numbers * len(scene.times)))

    def mechanism_of(self, run: int) -> Mechanism:
        """Return the mechanism of one run as the sweep counts its joint coordinates."""
        values = self.parameters(run, run + 1)
        initial = initial_numbers(self.scene, values)
        numbers = {name: float(value[0]) for name, value in values.items() if name not in initial}
        return with_values(self.scene, numbers).mechanism

    def scene_of(self, run: int) -> Scene:
        """Return the scene of one run, for any engine.

        Raises:
            NewtonEulerError: for values that a scene cannot have.
        """
        values = self.parameters(run, run + 1)
        return with_parameters(self.scene, {name: float(value[0]) for name, value in values.items()})

    def __reduce__(self) -> tuple[Any, ...]:
        """Send all that makes a plan, as bytes that a process reads once for all its tasks."""
        return _restored, (self._content,)

    @cached_property
    def _content(self) -> bytes:
        needed = self.needed or self.conditions
        return pickle.dumps(
            (_unseen(self.scene), self.samples, self.keep, dict(self.control), self.chunk, needed)
        )

    @cached_property
    def conditions(self) -> dict[str, str]:
        """Conditions of this process on which results depend beside the plan."""
        return {
            "solver": SOURCE.hex(),
            "crosscheck": version(DISTRIBUTION),
            "processor": processor(),
            "samples": self.samples.digest(self.samples.runs),
        }

    def check_conditions(self) -> None:
        """Raise `CrosscheckError` in a process that would make other runs than the one that sent the plan."""
        for name, needed in self.needed.items():
            if self.conditions[name] != needed:
                what = CONDITIONS[name]
                raise CrosscheckError(
                    f"a worker on {platform.node()} has {what} than this process; needed: the same"
                )

    def record(self) -> dict[str, str | int | float]:
        """Describe the plan for a file of results: another plan has another record.

        Of texts and numbers, as netCDF has them.

        Raises:
            CrosscheckError: for a scene with functions whose meaning is not in their numbers.
        """
        known = fingerprint(self.scene, neutral=UNSEEN)
        if known is None:
            problem = "has parts of classes that this package does not know, by which it is not known again"
            raise CrosscheckError(f"scene {self.scene.name!r} {problem}; leave out the folder (output)")
        return {
            "scene": self.scene.name,
            "fingerprint": known,
            "numbers": json.dumps(_numbers(self.scene)),
            **{f"vary {', '.join(names)}": str(each) for names, each in self.samples.groups},
            "vary": ", ".join(self.samples.names),
            "sampling": self.samples.sampling,
            "runs": self.samples.runs,
            "seed": self.samples.seed,
            "keep": ", ".join(self.keep),
            **self.control,
            "chunk": self.chunk,
            "versions": json.dumps({name: version(name) for name in RECORDED}),
            **self.conditions,
        }


def processor() -> str:
    """Word what results depend on to the last bit: native code adds products in one operation if it can."""
    fused = llvm_binding().get_host_cpu_features().get("fma", False)
    return f"{platform.machine()} {'with' if fused else 'without'} FMA"


@lru_cache(maxsize=PLANS)
def _kept(scene: Scene, keep: tuple[str, ...], integrator: str) -> tuple[tuple[Reduction, ...], Scene]:
    kept = reductions(keep, scene)
    return kept, pruned(scene, kept, integrator)


def _numbers(scene: Scene) -> dict[str, str]:
    """Return the numbers of a scene by their names, by which it can be told what another one has changed."""
    own = parameter_values(scene)
    own |= {name: np.array(getattr(scene, name)) for name in ("duration", "output_period")}
    return {name: " ".join(f"{number:.12g}" for number in value.flat) for name, value in own.items()}


def _unseen(scene: Scene) -> Scene:
    """Return a scene without meshes, which may be large."""
    mechanism = scene.mechanism
    if not any(body.meshes for body in mechanism.bodies):
        return scene
    bodies = tuple(replace(body, meshes=()) for body in mechanism.bodies)
    return replace(scene, mechanism=Mechanism(bodies, mechanism.joints, mechanism.couplings))


def _restored(content: bytes) -> Plan:
    with RESTORING:
        return _plan(content)


@lru_cache(maxsize=PLANS)
def _plan(content: bytes) -> Plan:
    plan = Plan(*pickle.loads(content))
    _kept(plan.scene, plan.keep, plan.integrator)
    return plan


def make_runs(plan: Plan, runs: tuple[int, int]) -> Chunk:
    """Make the runs from the first to before the second number: the same in any process, thread and order.

    Raises:
        CrosscheckError: for a scene that cannot be run.
    """
    plan.check_conditions()
    try:
        return run_all(plan, plan.parameters(*runs))
    except NewtonEulerError as error:  # which could not be sent to another process
        raise CrosscheckError(str(error)) from error


def run_all(plan: Plan, parameters: Parameters) -> Chunk:
    """Make runs with some parameters and reduce them."""
    parts = list(_parts(plan, parameters))
    values = {name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values}
    return Chunk(values, np.concatenate([part.errors for part in parts]))


def _parts(plan: Plan, parameters: Parameters) -> Iterator[Chunk]:
    """Make and reduce as many runs at a time as there is room for."""
    count = len(next(iter(parameters.values())))
    parts = -(-count // plan.together(plan.lean))
    size = -(-count // (parts * lane_count())) * lane_count()
    for start in range(0, count, size):
        own = {name: values[start : start + size] for name, values in parameters.items()}
        batch = plan.batch(own, plan.lean)
        outputs = Outputs.of_batch(plan.scene, batch)
        values = dict(own) | {each.name: each.of(outputs) for each in plan.kept}
        # which are numbered within the batch
        errors = [str(batch.errors.get(k, "")).removeprefix(f"run {k}: ") for k in range(len(batch))]
        for run in batch.errors:
            for each in plan.kept:
                values[each.name][run] = np.nan
        yield Chunk(values, np.array(errors, dtype=object))
