"""Names of initial joint coordinates and their rates, as parameters that vary from run to run.

The names are `start.JOINT`, m or rad from the initial pose, and `start.JOINT.rate`, m/s or rad/s. The second
coordinate of a joint has the names `start.JOINT.1` and `start.JOINT.1.rate`.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from newton_euler.errors import MechanismError
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state, measured_coordinate

START_PREFIX, RATE_SUFFIX = "start.", ".rate"
"""Beginning of the names of initial coordinates and rates, and end of the names of rates."""


class Initial(NamedTuple):
    """An initial joint coordinate or its rate.

    Attributes:
        key: the joint coordinate: name of the joint, number of the coordinate.
        order: 0 for the coordinate, 1 for its rate.
    """

    key: Key
    order: int


def initial_numbers(scene: Scene, names: Iterable[str]) -> dict[str, Initial]:
    """Find the initial coordinates and rates among names of parameters; other names are ignored.

    Raises:
        UnknownNameError: for an unknown joint.
        MechanismError: naming the joint: it has no such coordinate, follows a prescribed motion, or has two
            names for one number.
    """
    numbers: dict[str, Initial] = {}
    for name in names:
        if not isinstance(name, str) or not name.startswith(START_PREFIX):
            continue
        # the text between prefix and suffix is JOINT or JOINT.NUMBER
        joint_text = name.removeprefix(START_PREFIX).removesuffix(RATE_SUFFIX)
        joint, _, index = joint_text.rpartition(".")
        mechanism, key = scene.mechanism, (joint_text, 0)
        if joint_text not in mechanism.joint_names and joint and index.isdecimal():
            key = joint, int(index)
        if key[0] not in mechanism.joint_names and _is_element(scene, name):
            continue  # a parameter of an element called `start`
        key = mechanism.coordinate(key)  # checks that the joint has the coordinate
        # the coordinate must be free, and named once
        if key in {motion.key for motion in scene.motions}:
            where = f"joint {key[0]!r}"
            raise MechanismError(where, "follows a prescribed motion", needed="a joint that none prescribes")
        number = Initial(key, int(name.endswith(RATE_SUFFIX)))
        if twin := next((other for other, known in numbers.items() if known == number), None):
            problem = f"{twin!r} and {name!r} are one number of the start"
            raise MechanismError(f"joint {key[0]!r}", problem, needed="one of the two")
        numbers[name] = number
    return numbers


def initial_names(scene: Scene) -> list[str]:
    """Return the names of all initial coordinates and rates that no motion prescribes."""
    prescribed = {motion.key for motion in scene.motions}
    free = [name for key, name in scene.mechanism.coordinate_labels.items() if key not in prescribed]
    return list(
        initial_numbers(scene, [f"{START_PREFIX}{name}{end}" for name in free for end in ("", RATE_SUFFIX)])
    )


def _is_element(scene: Scene, name: str) -> bool:
    """Return True if a name begins with the name of an element, such as a body that is called `start`."""
    mechanism = scene.mechanism
    named = (*mechanism.body_names, *mechanism.joint_names, *(force.prefix for force in scene.forces))
    return any(name.startswith(f"{element}.") for element in named)


def own_initial(scene: Scene, number: Initial) -> float:
    """Return an initial coordinate or rate of the scene's own initial state, m or rad, or per s."""
    return measured_coordinate(scene, initial_state(scene), number.key)[number.order]
