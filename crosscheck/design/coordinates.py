"""Names of joint coordinates on the command line."""

from __future__ import annotations

from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism


def coordinate_of(mechanism: Mechanism, text: str) -> str | Key:
    """Return the joint coordinate that a text names: JOINT or JOINT.K.

    JOINT.K is coordinate K of a joint with several.

    A text that is the name of a joint stands for the joint, also with a point and digits at its end.
    """
    joint, _, number = text.rpartition(".")
    is_key = text not in mechanism.joint_names and number.isdecimal()
    return (joint, int(number)) if is_key else text
