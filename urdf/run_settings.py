"""Settings of the loop in which a user of Pinocchio simulates a model, and the YAML that contains them.

A URDF and a Pinocchio model have no time step and no integrator: users write the program loop that simulates
them. crosscheck judges the accuracy of this loop. Its settings are a mapping in YAML, for example in a file
`own_run.yaml`:

    timestep: 0.001
    integrator: semi-implicit Euler
    kp: 10
    kd: 6.3

Missing keys have the values of the examples of Pinocchio, see `EXAMPLE_CLOSED` and `EXAMPLE_OPEN`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from newton_euler.errors import choices, plain_number, quoted
from newton_euler.model.source_file import SourceError, path_text, read_text
from newton_euler.model.yaml_source import parse_yaml

SEMI_IMPLICIT, EXPLICIT, RK4 = "semi-implicit Euler", "explicit Euler", "RK4"

INTEGRATORS = (SEMI_IMPLICIT, EXPLICIT, RK4)
"""Integrators of a loop.

Semi-implicit Euler advances the configuration with the new velocities, explicit Euler with the old ones. RK4
is the Runge-Kutta method of order 4."""

EXPLICIT_DAMPING, IMPLICIT_DAMPING = "explicit", "implicit"

DAMPINGS = (EXPLICIT_DAMPING, IMPLICIT_DAMPING)
"""Velocities at which a loop evaluates joint dampers: those before the step, or those after the step.

For implicit damping, a loop adds `timestep * damping` to `model.armature` once. Let h be the step and D the
damping. With the new velocities v + h a, M a = f - D (v + h a) becomes (M + h D) a = f - D v."""

OwnRun = str | os.PathLike[str] | Mapping[str, object]
"""Settings of the user's own run: path of a YAML file, YAML text of a mapping in braces, or a mapping."""

MAX_TIMESTEP = 1.0
"""Largest accepted time step, s."""

MAX_ITERATIONS = 10_000
"""Largest accepted number of proximal iterations."""


@dataclass(frozen=True)
class PinocchioSettings:
    """Settings of a simulation loop with Pinocchio. Each step calls `pinocchio.constraintDynamics`.

    Attributes:
        timestep: s.
        integrator: one of `INTEGRATORS`.
        kp: Baumgarte's gain of constraint errors in all loop closures, 1/s^2; None for the gains that the
            constraint models of a `pinocchio.Model` (given as an object, not as a file) have.
        kd: Baumgarte's gain of constraint velocities in all loop closures, 1/s; None as for `kp`.
        accuracy: accuracy of `pinocchio.ProximalSettings`, at which the proximal iterations end.
        mu: regularization of `pinocchio.ProximalSettings`.
        iterations: largest number of proximal iterations, which remove the effect of `mu`.
        damping: one of `DAMPINGS`.
    """

    timestep: float
    integrator: str = SEMI_IMPLICIT
    kp: float | None = None
    kd: float | None = None
    accuracy: float = 1e-8
    mu: float = 1e-10
    iterations: int = 10
    damping: str = EXPLICIT_DAMPING


EXAMPLE_CLOSED = PinocchioSettings(timestep=5e-3, kp=10.0, kd=2.0 * math.sqrt(10.0))
"""Settings of Pinocchio's examples/simulation-closed-kinematic-chains.py."""

EXAMPLE_OPEN = PinocchioSettings(timestep=1e-2)
"""Settings of Pinocchio's examples/simulation-pendulum.py, whose model has no loop closures."""

CHOICES = {"integrator": INTEGRATORS, "damping": DAMPINGS}
"""Allowed values of the keys whose value is a name; all other values are numbers."""

KEYS = tuple(field.name for field in fields(PinocchioSettings))
"""Keys of the YAML mapping: the attributes of `PinocchioSettings`."""


def read_settings(given: OwnRun | None) -> dict[str, Any]:
    """Read the settings of a user's loop.

    Args:
        given: settings of the user, some or all; None for no settings.

    Returns:
        Values of the given attributes of `PinocchioSettings`, by name.

    Raises:
        SourceError: for a file that cannot be read, an unknown key, or an invalid value.

    Examples:
        >>> read_settings("{timestep: 0.002, integrator: RK4}")
        {'timestep': 0.002, 'integrator': 'RK4'}
    """
    if given is None:
        return {}
    where, document = _document(given)
    if not isinstance(document, Mapping):
        raise SourceError(where, f"{quoted(document)} is no mapping; needed: {', '.join(KEYS)} with values")
    found = {str(key): _value(where, str(key), value) for key, value in document.items()}
    if found.get("integrator") == RK4 and found.get("damping") == IMPLICIT_DAMPING:
        raise SourceError(where, f"damping of integrator {RK4} is {IMPLICIT_DAMPING}; needed: explicit")
    return found


def _document(given: OwnRun) -> tuple[str, Any]:
    """Return a name of given settings for messages, the path or "own_run", and their parsed content."""
    if isinstance(given, Mapping):
        return "own_run", given
    where = path_text(given, SourceError)
    if where.lstrip().startswith("{"):
        return "own_run", parse_yaml("own_run", where)
    # "scene_size" is the name of the limit of the file's size
    return where, parse_yaml(where, read_text(where, "scene_size", SourceError))


def _value(where: str, key: str, value: object) -> float | int | str:
    """Convert the value of a key; raises `SourceError` for an unknown key and an invalid value."""
    if key not in KEYS:
        raise SourceError(where, f"unknown key {quoted(key)}; {choices(key, KEYS)}")
    if key in CHOICES:
        if value not in CHOICES[key]:
            raise SourceError(where, f"unknown {key} {quoted(value)}; {choices(value, CHOICES[key])}")
        return str(value)
    try:
        number = plain_number(str(value))
    except ValueError:
        number = float("nan")
    is_valid, needed = {
        "timestep": (0.0 < number <= MAX_TIMESTEP, f"a number of seconds above 0, at most {MAX_TIMESTEP:g}"),
        "iterations": (
            1.0 <= number <= MAX_ITERATIONS and number == int(number),
            f"a whole number from 1 to {MAX_ITERATIONS}",
        ),
    }.get(key, (number >= 0.0, "a number, 0 or more"))
    if not is_valid:
        raise SourceError(where, f"{key} is {quoted(value)}; needed: {needed}")
    return int(number) if key == "iterations" else number
