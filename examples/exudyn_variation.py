# /// script
# requires-python = ">=3.11"
# dependencies = ["crosscheck", "exudyn==1.13.6"]
# ///
"""Measure Exudyn's parameter variation on four scenes; prints the table of docs/results/speed.md.

    pip install exudyn==1.13.6
    python examples/exudyn_variation.py

A scene is translated once, into whichever kind of element is cheaper in Exudyn; each run of
`exudyn.processing.ParameterVariation` sets initial coordinates and solves. No Python is called in a step, and
Exudyn's own checks of ranges are off.

J. Gerstmayr, Exudyn - a C++-based Python package for flexible multibody systems, Multibody System Dynamics
60, 2024.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from crosscheck.scenes import load
from crosscheck.studies.benchmark.ladders import Poses, poses_only
from crosscheck.studies.benchmark.reference import batch_references, pose_errors
from newton_euler.equations.relative import Relative
from newton_euler.exercise import random_states
from newton_euler.model.euler_parameters import matrix_l, rotation
from newton_euler.model.joint import Pose, perpendicular_pair
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

vars(sys)["exudynFast"] = True  # without range checks, if set before the import
import exudyn  # noqa: E402
from exudyn import itemInterface as items  # noqa: E402
from exudyn.processing import ParameterVariation  # noqa: E402

OUTPUTS = 20
"""After the start, equally far apart; errors are the largest of all bodies at these."""

WORLD = Pose(np.zeros(3), np.eye(3))

ROWS = {
    "revolute": (1, 1, 1, 1, 1, 0),
    "translational": (1, 1, 0, 1, 1, 1),
    "cylindrical": (1, 1, 0, 1, 1, 0),
    "universal": (1, 1, 1, 0, 0, 1),
}
"""Constrained translations and rotations of the generic joint in the axes of `axes_of`, by joint kind."""


class Model(NamedTuple):
    """A scene in Exudyn.

    Attributes:
        coordinates: those of a state, and their rates, (n,).
        poses: those of the rows (m, n) that a run keeps.
    """

    coordinates: Callable[[State], tuple[Array, Array]]
    poses: Callable[[Array], Poses]


def rigid_bodies(mbs: Any, scene: Scene) -> Model:
    """Translate into rigid bodies with Euler parameters, joints, and springs along sliding joints."""
    bodies = scene.mechanism.bodies
    objects = [mbs.AddObject(items.ObjectGround())]
    for body in bodies[1:]:
        pose = [*body.center_of_mass, *body.quaternion]
        node = mbs.AddNode(items.NodeRigidBodyEP(referenceCoordinates=pose))
        inertia = body.inertia[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]
        objects.append(mbs.AddObject(items.ObjectRigidBody(mass=body.mass, inertia=inertia, nodeNumber=node)))
        if np.any(scene.gravity):
            mass = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=objects[-1]))
            mbs.AddLoad(items.LoadMassProportional(markerNumber=mass, loadVector=scene.gravity))
        keep(mbs, node, exudyn.OutputVariableType.CoordinatesTotal)

    def ends(joint: Any) -> list[Any]:
        found = []
        for name, point in ((joint.first, joint.point), (joint.second, joint.reaction_point)):
            k = scene.mechanism.body_index(name)
            make = partial(items.MarkerBodyRigid, bodyNumber=objects[k])
            found.append(marker(mbs, make, bodies[k].pose if k else WORLD, axes_of(joint), point))
        return found

    for joint in scene.mechanism.joints:
        if joint.kind == "spherical":  # the generic one keeps multipliers of rotations, too
            mbs.AddObject(items.ObjectJointSpherical(markerNumbers=ends(joint)))
        else:
            rows = ROWS[joint.kind]
            mbs.AddObject(items.ObjectJointGeneric(markerNumbers=ends(joint), constrainedAxes=rows))
    for force in scene.joint_forces:
        joint = scene.mechanism.joint(force.joint)
        rest = force.target if force in scene.control else force.rest
        spring = items.ObjectConnectorLinearSpringDamper(
            markerNumbers=ends(joint),
            stiffness=force.stiffness,
            damping=force.damping,
            axisMarker0=[0.0, 0.0, 1.0],
            offset=rest + joint.axis @ joint.span,
        )
        mbs.AddObject(spring)

    def coordinates(state: State) -> tuple[Array, Array]:
        q, v = [], []
        for k, body in enumerate(bodies[1:], 1):
            p = state.quaternion[k] * np.sign(state.quaternion[k] @ body.quaternion)
            omega = rotation(p).T @ state.angular_velocity[k]
            q += [state.position[k] - body.center_of_mass, p - body.quaternion]
            v += [state.linear_velocity[k], 0.5 * (matrix_l(p).T @ omega)]
        return np.concatenate(q), np.concatenate(v)

    def poses(rows: Array) -> Poses:
        ground = np.tile([*bodies[0].center_of_mass, *bodies[0].quaternion], (len(rows), 1, 1))
        every = np.concatenate([ground, rows.reshape(len(rows), -1, 7)], axis=1)
        return every[..., :3], every[..., 3:] / np.linalg.norm(every[..., 3:], axis=-1, keepdims=True)

    return Model(coordinates, poses)


def kinematic_tree(mbs: Any, scene: Scene) -> Model:
    """Translate into a tree of hinges, whose flat loops balls close, by two rows each."""
    system = Relative(scene)
    links: dict[int, tuple[int, Pose]] = {0: (-1, WORLD)}
    parents, turns, offsets, masses, centers, inertias = [], [], [], [], [], []
    for number, joint in enumerate(system.tree.joints):
        parent, frame = links[joint.parent]
        along = axes_about(joint.motions[0].axis)
        parents.append(parent)
        turns.append(frame.rotation.T @ along)
        offsets.append(frame.point_to_body(joint.points[0]))
        frame, body = Pose(joint.points[0], along), scene.mechanism.bodies[joint.child]
        turn = frame.rotation.T @ body.pose.rotation
        masses.append(body.mass)
        centers.append(frame.point_to_body(body.center_of_mass))
        inertias.append(turn @ body.inertia @ turn.T)
        links[joint.child] = number, frame
    zeros = [0.0] * system.nv
    node = mbs.AddNode(items.NodeGenericODE2("", zeros, zeros, zeros, system.nv))
    matrices, vectors = exudyn.Matrix3DList, exudyn.Vector3DList
    tree = items.ObjectKinematicTree(
        nodeNumber=node,
        gravity=scene.gravity,
        jointTypes=[exudyn.JointType.RevoluteZ] * system.nv,
        linkParents=parents,
        jointTransformations=matrices(turns),
        jointOffsets=vectors(offsets),
        linkInertiasCOM=matrices(inertias),
        linkCOMs=vectors(centers),
        linkMasses=masses,
    )
    number = mbs.AddObject(tree)
    keep(mbs, node, exudyn.OutputVariableType.Coordinates)
    for ball in (scene.mechanism.joints[k] for k in system.tree.cuts):
        ends = []
        for name, point in ((ball.first, ball.point), (ball.second, ball.reaction_point)):
            link, frame = links[scene.mechanism.body_index(name)]
            make = partial(items.MarkerKinematicTreeRigid, objectNumber=number, linkNumber=link)
            ends.append(marker(mbs, make, frame, np.eye(3), point))
        mbs.AddObject(items.ObjectJointSpherical(markerNumbers=ends, constrainedAxes=[1, 1, 0]))

    def poses(rows: Array) -> Poses:
        states = [system.state(q, np.zeros(system.nv)) for q in rows]
        return np.array([s.position for s in states]), np.array([s.quaternion for s in states])

    return Model(system.coordinates, poses)


def axes_about(axis: Array) -> Array:
    """Complete an axis (3,) to columns (3, 3), the last."""
    return np.column_stack([*perpendicular_pair(axis), axis])


def axes_of(joint: Any) -> Array:
    """Compute the axes of a joint, columns (3, 3) in the world at the initial pose."""
    if joint.kind == "universal":
        first, second = joint.axis_on_first, joint.axis_on_second
        return np.column_stack([first, second, np.cross(first, second)])
    return axes_about(joint.axis) if joint.axis_names else np.eye(3)


def marker(mbs: Any, make: Callable[..., Any], frame: Pose, axes: Array, point: Array) -> Any:
    """Add a marker with these axes at a point, world at the initial pose, of what moves with a frame."""
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = frame.rotation.T @ axes, frame.point_to_body(point)
    return mbs.AddMarker(make(localHT=place))


def keep(mbs: Any, node: Any, variable: Any) -> None:
    """Have coordinates of a node kept at outputs."""
    mbs.AddSensor(
        items.SensorNode(nodeNumber=node, outputVariableType=variable, storeInternal=True, writeToFile=False)
    )


class Case(NamedTuple):
    """A scene and its cheapest setting for an error of 1e-6 m or rad.

    Attributes:
        scene, options: from the library.
        elements: translates it.
        solver: by Exudyn's name.
        steps: from one output to the next.
        runs: how many, from random states.
    """

    scene: str
    options: Mapping[str, Any]
    elements: Callable[[Any, Scene], Model]
    solver: str
    steps: int
    runs: int


CASES = (
    Case("tracker", {}, rigid_bodies, "GeneralizedAlpha", 290, 20),
    Case("four_bar", {}, kinematic_tree, "GeneralizedAlpha", 3300, 4),
    Case("stewart", {}, rigid_bodies, "GeneralizedAlpha", 2300, 3),
    Case("chain", {"N": 20}, kinematic_tree, "RK67", 25, 20),
)
"""Of Exudyn's solvers generalized-alpha of index 3 is the only one for closed loops that is no dearer; the
explicit ones run open trees only. On the tracker radii of 0.95 and 1 and `TrapezoidalIndex2` are no cheaper,
nodes of Lie groups take 1.2 times as long, and the solver for redundant constraints is slower."""


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


def measure(case: Case) -> Sequence[str]:
    """Run a case; return its row of the table."""
    scene = poses_only(load(case.scene, **case.options))
    scene = replace(scene, output_period=scene.duration / OUTPUTS)
    states = random_states(scene, case.runs)
    exact, _ = batch_references(scene, states, lambda message: None)
    container = exudyn.SystemContainer()
    mbs = container.AddSystem()
    model = case.elements(mbs, scene)
    mbs.Assemble()
    starts = [model.coordinates(state) for state in states]
    settings, solver = settings_of(scene, case), getattr(exudyn.DynamicSolverType, case.solver)
    initial = exudyn.ConfigurationType.Initial

    def run(parameters: Mapping[str, Any]) -> Array:
        q, v = starts[parameters["run"]]
        mbs.systemData.SetODE2Coordinates(q, configuration=initial)
        mbs.systemData.SetODE2Coordinates_t(v, configuration=initial)
        mbs.SolveDynamic(settings, solverType=solver)
        sensors = range(mbs.systemData.NumberOfSensors())
        return np.column_stack([mbs.GetSensorStoredData(k)[:, 1:] for k in sensors])

    begun = time.process_time()
    _, runs = ParameterVariation(run, {"run": list(range(case.runs))}, showProgress=False)
    seconds = time.process_time() - begun
    worst = max(max(pose_errors(model.poses(runs[k]), poses)) for k, poses in exact.items())
    step = 1e3 * scene.output_period / case.steps
    words = f"{case.scene}, {scene.duration:g} s", case.elements.__name__.replace("_", " ")
    return (
        *words,
        f"{case.solver}, {step:.2g} ms",
        f"{case.runs}",
        f"{worst:.1e}",
        f"{1e3 * seconds / case.runs:.3g}",
    )


def main() -> None:
    """Print the table, a row after each case."""
    exudyn.config.printToConsole = False
    heads = "scene", "elements", "solver, step", "runs", "worst error", "ms per run"
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for case in CASES:
        print(f"| {' | '.join(measure(case))} |", flush=True)


if __name__ == "__main__":
    main()
