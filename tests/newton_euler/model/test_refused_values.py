"""Values that constructors refuse with the package's own error."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler import PD, Body, Digital, Mesh
from newton_euler.errors import MechanismError

CORNERS = np.eye(3)
FACE = [[0, 1, 2]]
LAW = PD("hinge", 1.0, 0.1, 0.0)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Mesh("corners", FACE),
        lambda: Mesh(CORNERS, "face"),
        lambda: Mesh(CORNERS, [[0.5, 1, 2]]),
        lambda: Mesh(CORNERS, FACE, color=1),
        lambda: Mesh(CORNERS, FACE, color=(0.1, 0.2, 0.3)),
        lambda: Body("rod", 1.0, np.zeros(3), np.eye(3), shapes=1),
        lambda: Body("rod", 1.0, np.zeros(3), np.eye(3), meshes=["mesh"]),
        lambda: Digital(LAW, 0.01, force_limit=np.ones(2)),
    ],
)
def test_values_of_another_kind_are_refused(make):
    with pytest.raises(MechanismError) as caught:
        make()
    assert "\n" not in str(caught.value)
