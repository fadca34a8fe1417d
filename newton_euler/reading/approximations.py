"""Dry friction and limits of a model file as forces: regularized friction and stops with compliance.

In a model file, dry friction and limits are ideal (URDF) or constraints of a solver (MJCF). A scene has
forces instead: `JointFriction` is viscous below a transition speed, and `JointStop` is a spring with damping
beyond the limit. The numbers that these forces need in addition to those of the file follow from the inertia
m, kg or kg m^2, that the joint coordinate has at the start, and from a `Softness`:

- transition speed of friction F: `stick_time` * F / m, the speed that the friction takes from m in that time;
- stiffness of a stop: `stop_rate` * m, so that m oscillates on the stop with the angular frequency
  sqrt(stop_rate);
- dissipation of a stop: `stop_dissipation`, see `JointStop`.

The import report lists each friction and each limit as approximated, with these numbers.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from newton_euler.equations.parameters import measuring
from newton_euler.equations.relative import Relative
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction, JointStop
from newton_euler.reading.activity import Bounds
from newton_euler.reading.free_motions import free_motions
from newton_euler.reading.import_report import FRICTION, LIMITS, ImportReport
from newton_euler.runs.assemble import initial_state

NO_LIMIT = 1e9
"""Magnitude, m or rad, from which on a limit of a coordinate is none: files must have both limits, and
`mjcf.write` writes this number for a missing one."""


DAMPED_DEPTH = 1e-3
"""Depth, m or rad, at which the damping of a stop is that of MuJoCo's limit."""

HELD_MOTION = 1e-9
"""Part of a joint's motion that constraints leave, as a fraction of the motion without constraints, that is
round-off: the constraints hold the joint."""


IMMOVABLE = "the joint does not move, or moves no mass"
"""Reason to leave out friction and limits of a joint."""


class Softness(NamedTuple):
    """Numbers that turn ideal friction and ideal limits into forces, for a coordinate with the inertia 1.

    Attributes:
        stick_time: time, s, in which friction takes the transition speed from a coordinate.
        stop_rate: stiffness of a stop per inertia, 1/s^2.
        stop_dissipation: s/m or s/rad.
    """

    stick_time: float
    stop_rate: float
    stop_dissipation: float


DEFAULT_SOFTNESS = Softness(stick_time=1e-3, stop_rate=5e4, stop_dissipation=40.0)
"""Softness for files without softness of their own, that of MuJoCo's default `solref` and `solimp`.

A mass that rests on such a stop oscillates at 36 Hz, and its weight presses the stop in by 0.2 mm."""


class JointInFile(NamedTuple):
    """A hinge or slide with dry friction or limits.

    Attributes:
        element: name of the joint in the report.
        key: joint coordinate of the scene.
        unit: unit of the coordinate, "m" or "rad".
        inertia: inertia that the coordinate has at the start, kg or kg m^2.
        softness: numbers of the approximations.
    """

    element: str
    key: Key
    unit: str
    inertia: float
    softness: Softness

    @property
    def is_movable(self) -> bool:
        """False for a coordinate that constraints hold, or whose motion moves no mass."""
        return math.isfinite(self.inertia) and self.inertia > 0.0


def regularized(joint: JointInFile, friction: float, report: ImportReport) -> Iterator[JointFriction]:
    """Yield the regularized force of dry friction, and report it; report immovable joints as left out.

    Args:
        joint: the joint.
        friction: friction in the file, N or N m.
        report: report that receives an entry.
    """
    words = f"its dry friction {friction:g}"
    if not joint.is_movable:
        report.left_out(joint.element, f"{words}: {IMMOVABLE}", topic=FRICTION, moves_nothing=True)
        return
    if friction < 0.0:
        report.left_out(joint.element, f"{words}: needed: 0 or more", topic=FRICTION)
        return
    speed = joint.softness.stick_time * friction / joint.inertia
    name, coordinate = joint.key
    yield JointFriction(name, friction, transition_speed=speed, coordinate=coordinate)
    how = f"{words} as a force that is viscous below {speed:.3g} {joint.unit}/s"
    report.approximated(joint.element, how, FRICTION)


def compliant(joint: JointInFile, bounds: Bounds, words: str, report: ImportReport) -> Iterator[JointStop]:
    """Yield the stops of the limits of a joint, and report them; report immovable joints as left out.

    Args:
        joint: the joint.
        bounds: limits of the joint coordinate, with the coordinate of the file at the start as constant.
        words: description of the limits in the report.
        report: report that receives an entry.
    """
    if not joint.is_movable:
        report.left_out(joint.element, f"{words}: {IMMOVABLE}", topic=LIMITS, moves_nothing=True)
        return
    if bounds.low >= bounds.high:  # exporters write such ranges for unknown limits
        report.left_out(joint.element, f"{words}: no range", topic=LIMITS, watches=[bounds])
        return
    softness, (name, coordinate) = joint.softness, joint.key
    stiffness = softness.stop_rate * joint.inertia
    assert isinstance(bounds.constant, float)  # limits of coordinates do not depend on time
    if bounds.low > -NO_LIMIT:
        low = bounds.low - bounds.constant
        yield JointStop(name, "low", low, stiffness, softness.stop_dissipation, coordinate)
    if bounds.high < NO_LIMIT:
        high = bounds.high - bounds.constant
        yield JointStop(name, "high", high, stiffness, softness.stop_dissipation, coordinate)
    unit = "N/m" if joint.unit == "m" else "N m/rad"
    how = f"{words} as stops of stiffness {stiffness:.3g} {unit} and dissipation "
    how += f"{softness.stop_dissipation:.3g} s/{joint.unit}"
    report.approximated(joint.element, how, LIMITS, [bounds])


def effective_inertias(scene: Scene, keys: Collection[Key]) -> dict[Key, float]:
    """Compute the inertia that a force on each joint coordinate has to accelerate at the start.

    All other joints move freely, as far as constraints allow. A coordinate that the constraints hold has an
    infinite inertia, and a coordinate whose motion moves no mass the inertia 0.

    Args:
        scene: scene without dry friction, at its initial state.
        keys: joint coordinates.

    Returns:
        kg of slides and kg m^2 of hinges, by joint coordinate.
    """
    system = Relative(measuring(scene, keys))
    q, v = system.coordinates(initial_state(scene))
    measured = system.measured(q, v)
    free, inertia = free_motions(system, q, v)
    found = {}
    for key in keys:
        row = np.zeros(system.nv)
        for k, derivative in measured[key].jacobian.items():
            row[k] = derivative
        along = free.T @ row
        if np.linalg.norm(along) <= HELD_MOTION * np.linalg.norm(system.velocity_units * row):
            found[key] = math.inf
            continue
        try:
            mobility = float(along @ np.linalg.solve(inertia, along))  # acceleration per force
        except np.linalg.LinAlgError:  # a free motion moves no mass
            mobility = math.inf
        found[key] = 1.0 / mobility
    return found
