"""Contract of an engine: what comparisons need of a simulator, and how accurate its runs are expected to be.

An `Engine` bundles the functions of one simulator. `crosscheck.engines.registry` has the engines by name, and
one module for each of them makes its `Engine`. A scene is a mechanism with its forces, inputs, initial state,
duration and outputs.

A refined run has half the step or tighter tolerances than the default run. Its difference from the default
run measures the integration error.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, Protocol

from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.limits import Limit, no_limits
from crosscheck.engines.stress import StressSettings
from crosscheck.library import REFERENCE_QUANTITIES
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.system import Evaluation, System
from newton_euler.errors import DISTRIBUTION, is_finite_number
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.robot import RobotFile
from newton_euler.scalars import Array

MAX_RELATIVE_ERROR = 1e-2
"""Largest error of a run that comparisons accept, relative to the mechanism's reach (its size or its largest
coordinate), 1 rad or the energy. A run with a larger error has too coarse steps to test a model."""

LineStyle = tuple[str | tuple[float, tuple[float, ...]], float]
"""Dash pattern of matplotlib and width, points, of a curve."""

OTHER_LINE: LineStyle = ((0, (8, 2)), 1.6)
"""Long dashes: the line of curves of engines of other packages that have none of their own."""

FORCE_OUTPUTS = frozenset({"reactions", "actuation"})
"""Outputs that comparisons need of runs, but not of refined runs."""


Settings = Mapping[str, Any]
"""Options of a run by name, such as the integrator and its step, as `Trajectory.settings` has them."""

NO_SETTINGS: Settings = MappingProxyType({})
"""No options: the engine chooses all of them for the scene."""


class Simulate(Protocol):
    """Function that simulates a scene."""

    def __call__(self, scene: Scene, settings: Settings = NO_SETTINGS, /) -> Trajectory:
        """Simulate a scene with settings; the engine chooses those that are not given.

        Raises:
            NewtonEulerError: for a scene that the engine cannot simulate, and for a run that stops.
            TypeError, ValueError: for unknown or wrong settings; a NewtonEulerError is better.
        """


class FixedSteps(NamedTuple):
    """Runs at a fixed step, which repeat to round-off; `crosscheck regress` stores the end of a short one.

    Attributes:
        integrator: name of the integrator.
        settings: returns the settings of runs at a step, s.
        steps: number of steps of a short run, which takes about a second or less.
    """

    integrator: str
    settings: Callable[[float], Settings]
    steps: int


class Integrators(NamedTuple):
    """Integrators of default runs of an engine that chooses them for each scene.

    Attributes:
        explicit: for scenes that are not stiff.
        implicit: for stiff scenes.
    """

    explicit: Literal["DOP853", "RK4"]
    implicit: str


class ImporterLimit(NamedTuple):
    """Documented gap of an importer: the elements of files of a format that it does not read.

    Attributes:
        kinds: kinds of elements and names of quantities, such as "loop" and "stiffness".
        words: the limit in words.
    """

    kinds: frozenset[str]
    words: str


class Importer(NamedTuple):
    """An engine's own reader of MJCF and URDF files.

    Attributes:
        describe: describes the robot that the engine reads in a file.
        limits: documented limits by format, "MJCF" or "URDF".
    """

    describe: Callable[[str], RobotFile]
    limits: Mapping[str, ImporterLimit]


class SoftConstraints(NamedTuple):
    """Constraints that yield like springs with damping.

    Attributes:
        evaluate: evaluates the initial state of a scene with these constraints.
        solver_tolerance: relative improvement below which the iteration for their forces ends.
        force_error: expected error of reaction forces of runs, relative to the largest force.
        smallest_resisted: smallest singular value of a nearly redundant constraint that affects a run. It is
            dimensionless, of the scaled constraint Jacobian: about the distance of the constraint's row from
            the span of the other rows.
    """

    evaluate: Callable[[Scene], Evaluation]
    solver_tolerance: float
    force_error: float
    smallest_resisted: float


def no_systems(scene: Scene) -> tuple[System, ...]:
    """Return no equations: an engine without them is compared by its runs only."""
    return ()


@dataclass(frozen=True)
class Engine:
    """A simulator, with the functions that comparisons need and its expected errors.

    Attributes:
        name: name in files and options; required.
        simulate: simulates a scene with given settings, or with those that the engine chooses for the scene;
            required.
        refined: simulates a scene with half the step or tighter tolerances; required.
        systems: returns the engine's equations of motion with rigid constraints, one per formulation (choice
            of coordinates); an empty tuple if it cannot, so that it is compared by its runs only.
        limits: lists what the engine cannot express of a scene; `simulate` and `systems` refuse such a scene
            by a `CannotExpressError`, and comparisons leave the engine out with this reason.
        trajectory_error: expected error of poses, relative to the mechanism's reach (positions) or in rad;
            like `drift`, `energy_error` and `SoftConstraints.force_error`, it is above 0 and at most
            `MAX_RELATIVE_ERROR`.
        drift: expected constraint violation, relative to the mechanism's reach (lengths) or in rad.
        energy_error: expected energy balance error, relative to the largest energy.
        package: distribution of the engine, as pip names it, whose version is recorded; that of the entry
            point unless it is given.
        label: name in texts of importers and references, such as "MuJoCo".
        min_version: oldest version of the package that can be used.
        color: color #rrggbb of an engine of another package; one that follows from its name if it is empty.
        line: line of its curves.
        integrators: explicit and implicit integrator of default runs; None if the engine has one for all
            scenes.
        exact: settings of the most accurate runs, for reference values; `refined` is used if None.
        soft_constraints: the engine's soft constraints; None if its constraints are rigid.
        refined_in_full: as `refined`, but always with reactions and actuator forces; `refined` is used if
            None.
        fixed_steps: runs at a fixed step; None if the engine has none, or none that repeats to round-off.
        at_tolerance: returns settings of DOP853 at a relative tolerance, with rigid constraints, for the
            reference of benchmarks, which default engines compute. None if the engine has no such runs, or
            equations that are not independent of newton_euler's.
        with_moved_anchor: returns the equations of a scene with the point of one joint in its second body
            moved by a vector (3,), m, as an injected fault; None if the engine takes both points from the
            scene. crosscheck chooses the joint: one that closes a loop, and no rod. Only the studies of
            injected faults call this function.
        importer: the engine's own reader of model files; None if it reads neither MJCF nor URDF.
        stress_settings: imports the settings of stress tests; the default runs alone if None.
        benchmarks: imports the benchmarks of the engine.

    Raises:
        CrosscheckError: for an expected error that is not allowed.
    """

    name: str
    simulate: Simulate
    refined: Callable[[Scene], Trajectory]
    systems: Callable[[Scene], tuple[System, ...]] = no_systems
    limits: Callable[[Scene], Sequence[Limit]] = no_limits
    trajectory_error: float = 1e-9
    drift: float = 1e-9
    energy_error: float = 1e-8
    package: str = DISTRIBUTION
    label: str = ""
    min_version: str = "0"
    color: str = ""
    line: LineStyle = OTHER_LINE
    integrators: Integrators | None = None
    exact: Settings | None = None
    soft_constraints: SoftConstraints | None = None
    refined_in_full: Callable[[Scene], Trajectory] | None = None
    fixed_steps: FixedSteps | None = None
    at_tolerance: Callable[[float], Settings] | None = None
    with_moved_anchor: Callable[[Scene, str, Array], System] | None = None
    importer: Importer | None = None
    stress_settings: Callable[[], StressSettings] | None = None
    benchmarks: Callable[[], Benchmarks] = Benchmarks

    def __post_init__(self) -> None:
        errors = {name: getattr(self, name) for name in ("trajectory_error", "drift", "energy_error")}
        if self.soft_constraints is not None:
            errors["force_error of soft_constraints"] = self.soft_constraints.force_error
        for name, value in errors.items():
            if not (is_finite_number(value) and 0.0 < value <= MAX_RELATIVE_ERROR):
                needed = f"a number above 0, at most {MAX_RELATIVE_ERROR:g}"
                raise CrosscheckError(f"engine {self.name!r}: {name} is {value!r:.100}; needed: {needed}")

    def stress(self) -> StressSettings:
        """Return the settings of stress tests."""
        return self.stress_settings() if self.stress_settings else StressSettings()


def without_forces(scene: Scene) -> Scene:
    """Return the scene without the outputs of reactions and actuator forces.

    Comparisons do not need these outputs in refined runs, except for scenes of the library with reference
    values, which are returned unchanged.
    """
    if scene.name in REFERENCE_QUANTITIES:
        return scene
    return replace(scene, outputs=scene.outputs - FORCE_OUTPUTS)
