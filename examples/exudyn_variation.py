# /// script
# requires-python = ">=3.11"
# dependencies = ["crosscheck", "exudyn==1.13.6"]
# ///
"""Measure Exudyn's parameter variation on four scenes; prints the table of docs/results/speed_batches.md.

    pip install exudyn==1.13.6
    python examples/exudyn_variation.py

A scene is translated once, into whichever kind of element is cheaper in Exudyn; each run of
`exudyn.processing.ParameterVariation` sets initial coordinates and solves. No Python is called in a step, and
Exudyn's own checks of ranges are off. newton_euler makes the same runs on one thread at its cheapest setting.

J. Gerstmayr, Exudyn - a C++-based Python package for flexible multibody systems, Multibody System Dynamics
60, 2024.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from crosscheck.engines.benchmarks import poses_only
from crosscheck.engines.newton_euler.benchmark import Lanes
from crosscheck.library import load
from crosscheck.studies.benchmark.batch_settings import fastest_setting
from crosscheck.studies.benchmark.reference import batch_references, pose_errors
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.relative import Relative
from newton_euler.model.joint import Pose, perpendicular_pair
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.scalars import Array

vars(sys)["exudynFast"] = True  # without range checks, if set before the import
import exudyn  # noqa: E402
from exudyn import itemInterface as items  # noqa: E402
from exudyn.processing import ParameterVariation  # noqa: E402

ERROR = 1e-6
"""m or rad, of the worst run."""

OUTPUTS = 20
"""Number of equally spaced outputs after the start; errors are the largest over all bodies and outputs."""

WORLD = Pose(np.zeros(3), np.eye(3))

ROWS = {
    "revolute": (1, 1, 1, 1, 1, 0),
    "translational": (1, 1, 0, 1, 1, 1),
    "cylindrical": (1, 1, 0, 1, 1, 0),
    "universal": (1, 1, 1, 0, 0, 1),
}
"""Constrained translations and rotations of the generic joint in the axes of `axes_of`, by joint kind."""

Mark = Callable[[int, Array, Array], Any]
"""Adds a marker on a body, by its number, at a point and with axes in columns, world at the initial pose."""


def rigid_bodies(mbs: Any, scene: Scene) -> Formulation:
    """Translate into rigid bodies with Euler parameters, joints, and springs along sliding joints."""
    mechanism, objects = scene.mechanism, [mbs.AddObject(items.ObjectGround())]
    for body in mechanism.bodies[1:]:
        pose = [*body.center_of_mass, *body.quaternion]
        node = mbs.AddNode(items.NodeRigidBodyEP(referenceCoordinates=pose))
        inertia = body.inertia[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
        objects.append(mbs.AddObject(items.ObjectRigidBody(mass=body.mass, inertia=inertia, nodeNumber=node)))
        if np.any(scene.gravity):
            center = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=objects[-1]))
            mbs.AddLoad(items.LoadMassProportional(markerNumber=center, loadVector=scene.gravity))
        keep(mbs, node)

    def mark(body: int, point: Array, axes: Array) -> Any:
        frame = mechanism.bodies[body].pose if body else WORLD
        return mbs.AddMarker(
            items.MarkerBodyRigid(bodyNumber=objects[body], localHT=place(frame, point, axes))
        )

    for joint in mechanism.joints:
        ends = ends_of(scene, joint, axes_of(joint), mark)
        if joint.kind == "spherical":  # the generic one keeps multipliers of rotations, too
            mbs.AddObject(items.ObjectJointSpherical(markerNumbers=ends))
        else:
            mbs.AddObject(items.ObjectJointGeneric(markerNumbers=ends, constrainedAxes=ROWS[joint.kind]))
    for force in scene.joint_forces:
        joint = mechanism.joint(force.joint)
        rest = force.target if force in scene.control else force.rest
        spring = items.ObjectConnectorLinearSpringDamper(
            markerNumbers=ends_of(scene, joint, axes_of(joint), mark),
            stiffness=force.stiffness,
            damping=force.damping,
            axisMarker0=[0.0, 0.0, 1.0],
            offset=rest + joint.axis @ joint.span,
        )
        mbs.AddObject(spring)
    return Cartesian(scene)


def kinematic_tree(mbs: Any, scene: Scene) -> Formulation:
    """Translate into a tree of hinges, whose flat loops balls close, by two rows each."""
    system, bodies = Relative(scene), scene.mechanism.bodies
    links, columns = {0: (-1, WORLD)}, []
    for number, joint in enumerate(system.tree.joints):
        parent, before = links[joint.parent]
        body, frame = bodies[joint.child], Pose(joint.points[0], axes_about(joint.motions[0].axis))
        turn, joined = frame.rotation.T @ body.pose.rotation, place(before, *frame)
        inertia = turn @ body.inertia @ turn.T
        center = frame.point_to_body(body.center_of_mass)
        columns.append((parent, joined[:3, :3], joined[:3, 3], inertia, center, body.mass))
        links[joint.child] = number, frame
    parents, turns, offsets, inertias, centers, masses = map(list, zip(*columns, strict=True))
    zeros = [0.0] * system.nv
    node = mbs.AddNode(items.NodeGenericODE2("", zeros, zeros, zeros, system.nv))
    tree = items.ObjectKinematicTree(
        nodeNumber=node,
        gravity=scene.gravity,
        jointTypes=[exudyn.JointType.RevoluteZ] * system.nv,
        linkParents=parents,
        jointTransformations=exudyn.Matrix3DList(turns),
        jointOffsets=exudyn.Vector3DList(offsets),
        linkInertiasCOM=exudyn.Matrix3DList(inertias),
        linkCOMs=exudyn.Vector3DList(centers),
        linkMasses=masses,
    )
    made = mbs.AddObject(tree)
    keep(mbs, node)

    def mark(body: int, point: Array, axes: Array) -> Any:
        link, frame = links[body]
        local = place(frame, point, axes)
        return mbs.AddMarker(
            items.MarkerKinematicTreeRigid(objectNumber=made, linkNumber=link, localHT=local)
        )

    for ball in (scene.mechanism.joints[k] for k in system.tree.cuts):
        ends = ends_of(scene, ball, np.eye(3), mark)
        mbs.AddObject(items.ObjectJointSpherical(markerNumbers=ends, constrainedAxes=[1, 1, 0]))
    return system


def axes_about(axis: Array) -> Array:
    """Complete an axis (3,) to columns (3, 3), the last."""
    return np.column_stack([*perpendicular_pair(axis), axis])


def axes_of(joint: Any) -> Array:
    """Compute the axes of a joint, columns (3, 3) in the world at the initial pose."""
    if joint.kind == "universal":
        first, second = joint.axis_on_first, joint.axis_on_second
        return np.column_stack([first, second, np.cross(first, second)])
    return axes_about(joint.axis) if joint.axis_names else np.eye(3)


def ends_of(scene: Scene, joint: Any, axes: Array, mark: Mark) -> list[Any]:
    """Add markers at both ends of a joint."""
    ends = (joint.first, joint.point), (joint.second, joint.point_on_second)
    return [mark(scene.mechanism.body_index(name), point, axes) for name, point in ends]


def place(frame: Pose, point: Array, axes: Array) -> Array:
    """Compute the homogeneous transformation (4, 4) of a point with axes in a frame."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = frame.rotation.T @ axes, frame.point_to_body(point)
    return found


def keep(mbs: Any, node: Any) -> None:
    """Have the coordinates of a node kept at outputs."""
    variable = exudyn.OutputVariableType.Coordinates
    sensor = partial(items.SensorNode, storeInternal=True, writeToFile=False)
    mbs.AddSensor(sensor(nodeNumber=node, outputVariableType=variable))


class Case(NamedTuple):
    """A scene of the library, and its cheapest setting in Exudyn for an error of 1e-6 m or rad.

    Attributes:
        elements: translates it.
        solver: by Exudyn's name.
        steps: from one output to the next.
        runs: how many, from random states.
    """

    scene: Scene
    elements: Callable[[Any, Scene], Formulation]
    solver: str
    steps: int
    runs: int


CASES = (
    Case(load("tracker"), rigid_bodies, "GeneralizedAlpha", 290, 20),
    Case(load("four_bar"), kinematic_tree, "GeneralizedAlpha", 3800, 4),
    Case(load("stewart"), rigid_bodies, "GeneralizedAlpha", 2300, 3),
    Case(load("chain", N=20), kinematic_tree, "RK67", 15, 20),
)
"""Generalized-alpha is of index 3; on the tracker spectral radii of 0.95 and 1 and `TrapezoidalIndex2` are no
cheaper, nodes of Lie groups take 1.2 times as long. Explicit solvers run open trees only."""


def settings_of(scene: Scene, case: Case) -> Any:
    """Return the settings of a run whose steps end at outputs."""
    settings, bodies = exudyn.SimulationSettings(), case.elements is rigid_bodies
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = scene.output_period
    settings.cleanUpMemory = False
    linear = exudyn.LinearSolverType
    settings.linearSolver.solverType = linear.EigenSparse if bodies else linear.EigenDense
    integration = settings.timeIntegration
    integration.verboseMode = 0
    integration.endTime = scene.duration
    integration.numberOfSteps = case.steps * OUTPUTS
    integration.adaptiveStep = integration.automaticStepSize = False
    integration.newton.useModifiedNewton = bodies  # on the tracker full iterations take 1.6 times as long
    integration.newton.relativeTolerance = 1e-7 if bodies else 1e-8  # the loosest that add no error
    return settings


def measure(case: Case) -> Iterable[str]:
    """Run a case; return its row of the table."""
    scene = replace(poses_only(case.scene), output_period=case.scene.duration / OUTPUTS)
    states = random_states(scene, case.runs)
    exact, _ = batch_references(scene, states, ERROR, lambda message: None)
    # Build the scene in Exudyn, and convert the random states to its coordinates
    container = exudyn.SystemContainer()
    mbs = container.AddSystem()
    system = case.elements(mbs, scene)
    mbs.Assemble()
    origin, _ = system.own_coordinates(State.initial(scene.mechanism))
    starts = [system.own_coordinates(state) for state in states]
    settings, solver = settings_of(scene, case), getattr(exudyn.DynamicSolverType, case.solver)
    initial = exudyn.ConfigurationType.Initial

    def run(parameters: Mapping[str, Any]) -> Array:
        q, v = starts[parameters["run"]]
        mbs.systemData.SetODE2Coordinates(q - origin, configuration=initial)
        mbs.systemData.SetODE2Coordinates_t(v, configuration=initial)
        mbs.SolveDynamic(settings, solverType=solver)
        sensors = range(mbs.systemData.NumberOfSensors())
        return origin + np.column_stack([mbs.GetSensorStoredData(k)[:, 1:] for k in sensors])

    # Exudyn's time and error
    begun = time.process_time()
    _, runs = ParameterVariation(run, {"run": list(range(case.runs))}, showProgress=False)
    seconds = (time.process_time() - begun) / case.runs
    worst = 0.0
    for k, poses in exact.items():
        found = [system.state(q, np.zeros(system.nv)) for q in runs[k]]
        poses_found = np.array([s.position for s in found]), np.array([s.quaternion for s in found])
        worst = max(worst, *pose_errors(poses_found, poses))
    # newton_euler's time at the same error
    known = [states[k] for k in exact]
    own = Lanes(scene)
    setting = fastest_setting(own, known, list(exact.values()), ERROR, lambda message: None).options
    own_seconds = min(own.run(setting, known, threads=1).seconds for _ in range(5)) / len(known)
    step = 1e3 * scene.output_period / case.steps
    return (
        f"{scene.name}, {len(scene.mechanism.bodies) - 1} bodies, {scene.duration:g} s",
        case.elements.__name__.replace("_", " "),
        f"{case.solver}, {step:.2g} ms",
        str(case.runs),
        f"{worst:.1e}",
        f"{1e3 * seconds:,.0f}",
        f"{1e3 * own_seconds:.2g}",
    )


def main() -> None:
    """Print the table, a row after each case."""
    exudyn.config.printToConsole = False
    heads = "scene", "elements", "solver, step", "runs", "worst error", "ms per run", "newton_euler, ms"
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for case in CASES:
        print(f"| {' | '.join(measure(case))} |", flush=True)


if __name__ == "__main__":
    main()
