"""Colors of engines: each has its own, also for people without one kind of cones."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np

from crosscheck.engines.palette import LOOKS, line_of, palette
from crosscheck.engines.registry import ENGINES, OPTIONAL
from crosscheck.support.colors import OTHER_COLORS, RESERVE_COLORS, rgb

SEEN_BY = {
    "all cones": np.eye(3),
    "without long": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "without medium": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "without short": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
"""Linear RGB as people see it (Machado, Oliveira and Fernandes 2009, severity 1)."""

TO_CONES = np.array(
    [
        [0.4122214708, 0.5363325363, 0.0514459929],
        [0.2119034982, 0.6806995451, 0.1073969566],
        [0.0883024619, 0.2817188376, 0.6299787005],
    ]
)
TO_LAB = np.array(
    [
        [0.2104542553, 0.7936177850, -0.0040720468],
        [1.9779984951, -2.4285922050, 0.4505937099],
        [0.0259040371, 0.7827717662, -0.8086757660],
    ]
)
"""Linear RGB to OKLab (B. Ottosson 2020), in which equal distances look equally large."""


def distance(one: str, other: str) -> float:
    """The smallest distance of two colors in OKLab as any group sees them; black and white are 100 apart."""

    def seen(color: str, matrix: np.ndarray) -> np.ndarray:
        c = np.array(rgb(color)) / 255.0
        linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
        return 100.0 * TO_LAB @ np.cbrt(TO_CONES @ np.clip(np.asarray(matrix) @ linear, 0.0, 1.0))

    return min(float(np.linalg.norm(seen(one, m) - seen(other, m))) for m in SEEN_BY.values())


def test_the_measure_of_distance():
    assert distance("#000000", "#ffffff") > 99.9
    assert distance("#ff0000", "#00ff00") > distance("#bb5500", "#558800")
    assert distance("#bb5500", "#558800") < 8.0  # an orange and a green that some people confuse


def test_each_engine_has_a_color_and_a_line_of_its_own():
    assert set(LOOKS) == {*ENGINES, *OPTIONAL}
    assert palette(list(LOOKS)) == {name: look.color for name, look in LOOKS.items()}
    assert len({line_of(name) for name in LOOKS}) == len(LOOKS)
    # 8: blue and green without the short cones; all others are 11 or more apart
    for one, other in combinations(LOOKS.values(), 2):
        assert distance(one.color, other.color) > 8.0


def test_engines_of_other_packages_have_other_colors():
    colors = [look.color for look in LOOKS.values()]
    for reserve, color in product(RESERVE_COLORS, [*colors, OTHER_COLORS[0]]):
        assert distance(reserve, color) > 11.0
    for one, other in combinations(RESERVE_COLORS, 2):
        assert distance(one, other) > 11.0
