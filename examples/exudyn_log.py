# /// script
# requires-python = ">=3.11"
# dependencies = ["crosscheck", "exudyn==1.13.6"]
# ///
"""Simulate a scene of the library in Exudyn, and write its motion to a CSV file.

    pip install exudyn==1.13.6
    python examples/exudyn_log.py four_bar four_bar.csv
    crosscheck run four_bar --log four_bar.csv

The file is a log as other simulators write it. The tracker is a system of rigid bodies: the log has the time,
and position and quaternion of each body. Other scenes are trees of hinges: the log has joint angles and their
rates. `crosscheck run` compares the log with the reference solution from its first row.
"""

from __future__ import annotations

import argparse
import csv

import exudyn
import numpy as np
from exudyn import itemInterface as items
from exudyn_variation import kinematic_tree, rigid_bodies

from crosscheck.library import load
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array


def simulate_in_exudyn(scene: Scene, steps: int, rows: int) -> tuple[list[str], Array]:
    """Simulate a scene by the generalized-alpha method.

    Args:
        scene: scene of rigid bodies, or of hinges whose loops balls close.
        steps: number of time steps.
        rows: number of outputs after the start.

    Returns:
        Names of the columns, and the numbers (rows + 1, columns).
    """
    container = exudyn.SystemContainer()
    mbs = container.AddSystem()
    is_tree = {joint.kind for joint in scene.mechanism.joints} <= {"revolute", "spherical"}
    system = kinematic_tree(mbs, scene) if is_tree else rigid_bodies(mbs, scene)
    if is_tree:
        joints = [scene.mechanism.joints[each.joint].name for each in system.tree.joints]
        names = [*joints, *(f"{joint}.velocity" for joint in joints)]
        velocities = exudyn.OutputVariableType.Coordinates_t
        sensor = items.SensorNode(
            nodeNumber=0, outputVariableType=velocities, storeInternal=True, writeToFile=False
        )
        mbs.AddSensor(sensor)
    else:
        names = [
            f"{body}.{name}"
            for body in scene.mechanism.body_names[1:]
            for name in (*(f"position.{c}" for c in "xyz"), *(f"quaternion.{c}" for c in "wxyz"))
        ]
    mbs.Assemble()
    # coordinates in Exudyn count from the initial pose
    origin, _ = system.own_coordinates(State.initial(scene.mechanism))
    q, v = system.own_coordinates(initial_state(scene))
    initial = exudyn.ConfigurationType.Initial
    mbs.systemData.SetODE2Coordinates(q - origin, configuration=initial)
    mbs.systemData.SetODE2Coordinates_t(v, configuration=initial)
    settings = exudyn.SimulationSettings()
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = scene.duration / rows
    settings.timeIntegration.verboseMode = 0
    settings.timeIntegration.endTime = scene.duration
    settings.timeIntegration.numberOfSteps = steps
    mbs.SolveDynamic(settings, solverType=exudyn.DynamicSolverType.GeneralizedAlpha)
    sensors = [mbs.GetSensorStoredData(k) for k in range(mbs.systemData.NumberOfSensors())]
    numbers = np.column_stack([sensor[:, 1:] for sensor in sensors])
    numbers[:, : len(origin)] += origin
    return ["time", *names], np.column_stack([sensors[0][:, 0], numbers])


def main() -> None:
    """Parse the command line, simulate, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", help="name of a scene of the library")
    parser.add_argument("path", help="CSV file to write")
    parser.add_argument("--steps", type=int, default=2000, help="number of time steps")
    parser.add_argument("--rows", type=int, default=200, help="number of rows after the start")
    options = parser.parse_args()
    scene = load(options.scene)
    names, table = simulate_in_exudyn(scene, options.steps, options.rows)
    with open(options.path, "w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(names)
        writer.writerows(np.round(table, 12).tolist())


if __name__ == "__main__":
    main()
