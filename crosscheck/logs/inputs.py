"""Put the inputs of a log (controls, joint forces) into a scene, and let a scene begin at a later time."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import replace
from math import comb
from typing import Any

import numpy as np

from crosscheck.logs.columns import LogData
from newton_euler.model.control import PD, DeclaredLaw
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import Sum, TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.source_file import SourceError
from newton_euler.model.splines import Piecewise, Steps
from newton_euler.reading.activity import Bounds
from newton_euler.reading.file_names import FileNames
from newton_euler.reading.import_report import ImportReport
from newton_euler.scalars import Array

ELEMENTS = ("motions", "control", "forces")
"""Fields of a scene whose elements may have functions of time."""


def is_time_dependent(scene: Scene) -> bool:
    """True if an element of a scene is a function of time."""
    return bool(scene.functions)


def started_at(scene: Scene, time: float) -> Scene:
    """Return a scene that begins at a later time, s, of the given scene.

    Its functions of time are shifted, and its initial state, which belongs to time 0, is removed. A scene
    without functions of time is returned unchanged, because it may begin in its initial state at any time.
    """
    if not time or not is_time_dependent(scene):
        return scene
    changed: dict[str, list[Any]] = {name: list(getattr(scene, name)) for name in ELEMENTS}
    # places of the functions in the scene; an attribute is a function, or a mapping to functions and numbers
    for field, index, attribute in scene.functions:
        element = changed[field][index]
        given = getattr(element, attribute)
        if isinstance(given, Mapping):
            later: Any = {k: _later(f, time) if isinstance(f, TimeFunction) else f for k, f in given.items()}
        else:
            later = _later(given, time)
        changed[field][index] = replace(element, **{attribute: later})
    elements: dict[str, Any] = {name: tuple(each) for name, each in changed.items()}
    return replace(scene, initial_state=None, **elements)


def _later(function: TimeFunction, time: float) -> TimeFunction:
    """Return the function t -> f(t + time) of a function of time f."""
    if isinstance(function, Sum):
        return Sum(tuple(_later(term, time) for term in function.terms))
    if isinstance(function, Sine):
        phase = function.phase + function.angular_frequency * time
        return replace(function, phase=float(np.remainder(phase, 2.0 * np.pi)))
    if isinstance(function, Piecewise):
        return replace(function, times=function.times - time)
    # binomial theorem: coefficients of sum_k c_k (t + time)^k
    c = function.coefficients
    shifted = [sum(c[k] * comb(k, j) * time ** (k - j) for k in range(j, len(c))) for j in range(len(c))]
    return Polynomial(tuple(shifted))


def with_inputs(scene: Scene, data: LogData, names: FileNames | None) -> Scene:
    """Return a scene with the inputs of a log; each value holds until the next row.

    Joint forces replace the control laws of their joints. Controls of actuators change the feedforward of the
    laws that these actuators became.

    Args:
        scene: the scene, which begins at the first row of the log, see `started_at`.
        data: the log.
        names: names in the model file, with the gains of its actuators (force per unit of the control, by
            joint coordinate); None for a scene without a file, whose logs have no controls.
    """
    if not (data.forces or data.inputs):
        return scene
    times = data.time - data.time[0]
    control = list(scene.control)
    # forces on joint coordinates; those of passive joints are often logged as zeros
    driven = {law.key for law in control}
    forces = {key: each.values for key, each in data.forces.items() if key in driven or np.any(each.values)}
    control = [law for law in control if law.key not in forces]
    control += [_force_law(key, times, values) for key, values in forces.items()]
    # controls of actuators: the scene's laws have the forces of the controls that the file sets for its start
    # (`start`; 0 if there is no law). Added are the sums of the differences from them, by joint coordinate
    added: dict[Key, Array] = {}
    for name in data.inputs:
        assert names is not None
        changes = _control_changes(data, names, name)
        for key, gain in names.inputs[name].gains.items():
            if key not in forces:
                added[key] = added.get(key, 0.0) + gain * changes
    for key, values in added.items():
        control = [_with_feedforward(data.where, law, key, times, values) for law in control]
        if key not in {law.key for law in control}:
            control.append(_force_law(key, times, values))
    joints = {law.joint for law in control}
    mechanism = scene.mechanism
    if any(not joint.actuated for joint in mechanism.joints if joint.name in joints):
        actuated = [replace(j, actuated=True) if j.name in joints else j for j in mechanism.joints]
        mechanism = Mechanism(mechanism.bodies, actuated, mechanism.couplings)
    return replace(scene, mechanism=mechanism, control=tuple(control))


def held_inputs(data: LogData, names: FileNames | None) -> tuple[str, ...]:
    """Name the actuators of a model file whose input the log does not have, or that cannot follow it.

    The reference holds their controls at their start. Logged joint forces replace the actuators of a joint.
    """
    if names is None:
        return ()
    without = [
        name
        for name, each in names.inputs.items()
        if name not in data.inputs and not all(key in data.forces for key in each.gains)
    ]
    activated = [f"{name} (its force depends on earlier controls)" for name in names.activated]
    return (*without, *activated)


def with_logged_forces(report: ImportReport, data: LogData) -> ImportReport:
    """Return an import report whose tests of limits of actuator forces have the inputs of a log.

    Logged forces on joints are those within the limits of the actuators, so that no test remains.

    Args:
        report: import report of a file, with tests for the controls of the file.
        data: the log.
    """
    names, found = report.names, copy(report)
    found.watches = dict(report.watches)
    # elements that may have limits of forces: coordinates on which the force acts, and the force per unit of
    # the control of each actuator that adds to it
    limited: dict[str, tuple[set[Key], dict[str, float]]] = {}
    for name, actuator in names.inputs.items():
        limited[f"actuator {name!r}"] = set(actuator.gains), {name: actuator.gain}
    for joint, (key, _) in names.coordinates.items():
        gains = {name: actuator.gains.get(key, 0.0) for name, actuator in names.inputs.items()}
        limited[f"joint {joint!r}"] = {key}, gains
    for number, watches in report.watches.items():
        keys, gains = limited.get(report.entries[number].element, (set(), {}))
        forces = [watch for watch in watches if isinstance(watch, Bounds) and watch.is_of_force]
        if not (keys and forces):
            continue
        if keys <= data.forces.keys():
            found.watches[number] = ()
            continue
        change = np.zeros(len(data.time))
        for name in gains.keys() & data.inputs.keys():
            change += gains[name] * _control_changes(data, names, name)
        times = data.time - data.time[0]
        found.watches[number] = [
            replace(each, constant=_with_steps(each.constant, times, change)) for each in forces
        ]
    return found


def _control_changes(data: LogData, names: FileNames, name: str) -> Array:
    """Return the controls (n,) of an actuator in a log minus that at the start, clipped as by the engine."""
    actuator = names.inputs[name]
    return np.asarray(np.clip(data.inputs[name].values, *actuator.limits) - actuator.start)


def _force_law(key: Key, times: Array, values: Array) -> PD:
    """Return a control law without feedback that applies forces (n,) at times (n,) to a joint coordinate."""
    joint, coordinate = key
    steps = _steps(times, values)
    return PD(joint, stiffness=0.0, damping=0.0, target=0.0, coordinate=coordinate, feedforward=steps)


def _with_feedforward(where: str, law: Any, key: Key, times: Array, values: Array) -> Any:
    """Return a control law with forces (n,) at times (n,) added if it drives a joint coordinate."""
    if law.key != key:
        return law
    if not isinstance(law, DeclaredLaw):
        raise SourceError(where, f"has inputs of {law.element}, a controller in Python; leave them out")
    return replace(law, feedforward=_with_steps(law.feedforward, times, values))  # type: ignore[type-var]


def _with_steps(given: Any, times: Array, values: Array) -> TimeFunction:
    """Add values (n,) that hold from times (n,) on to a number or a function of time."""
    if isinstance(given, TimeFunction):
        return Sum((given, _steps(times, values)))
    return _steps(times, given + values)


def _steps(times: Array, values: Array) -> Steps:
    """Return a piecewise constant function; equal values in a row count once."""
    kept = np.append(True, np.diff(values) != 0.0)
    return Steps(times[kept], values[kept])
