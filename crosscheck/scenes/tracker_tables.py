"""Appendix C of the paper: its tables as printed, and what has to be corrected in them.

S. Srang, S. Ath, M. Yamakita, "Newton-Euler Based Dynamic Modeling and Control Simulation for
Dual-Axis Parallel Mechanism Solar Tracker", Advances in Science, Technology and Engineering Systems
Journal 5(5), 709-716, 2020, doi:10.25046/aj050587. Body k of the paper is element k - 1 here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from newton_euler.scalars import Array

BODY_NAMES = ("base", "slider_2", "slider_3", "column_4", "leg_5", "leg_6", "panel_7")

MASS = 1e-3 * np.array([475.09, 189.7, 189.7, 104.45, 53.25, 54.4, 890.5])
"""Table 1, kg."""

CENTER_OF_MASS = 1e-3 * np.array(
    [
        [-63.93, 63.93, 30.41],
        [-123.99, 15.0, 24.6],
        [-15.0, 123.99, 24.6],
        [-11.50, 18.37, 99.21],
        [-12.99, 98.33, 68.84],
        [-92.31, 15.0, 66.27],
        [-34.28, 42.89, 136.56],
    ]
)
"""Table 2, m: centers of mass in the world at the initial position."""

EULER_PARAMETERS = np.array([[1.0, 0.0, 0.0, 0.0]] * 6 + [[0.89043, -0.19791, -0.10481, 0.39619]])
"""Table 3: orientations at the initial position."""

INERTIA_SCALE = np.array([1e-4, 1e-4, 1.0, 1.0, 1e-4, 1e-4, 1e-4])
"""Factors in front of the matrices of Table 4; two are missing in print."""

INERTIA = np.array(
    [
        [[20.0, 8.0, -1.0], [8.0, 20.0, 1.0], [1.0, 1.0, 26.0]],
        [[0.2774, 0.0, -0.00102], [0.0, 0.2015, 0.0], [-0.0102, 0.0, 0.1987]],
        [[0.2015, 0.0, 0.0], [0.0, 0.2774, 0.0102], [0.0, 0.0102, 0.1987]],
        [[0.1217, 0.0, 0.0], [0.0, 0.1248, 0.0], [0.0, 0.0, 0.0054]],
        [[0.5827, 0.0, -0.0824], [0.0, 0.5940, 0.0], [-0.0824, 0.0, 0.0172]],
        [[0.6242, 0.0, 0.0], [0.0, 0.6231, 0.0], [0.0, 0.0, 0.0058]],
        [[12.0, 0.0, 1.0], [0.0, 12.0, 0.0], [1.0, 0.0, 24.0]],
    ]
)
"""Table 4 as printed, to be multiplied by `INERTIA_SCALE`, kg m^2. Of two renderings of the article
one prints J2 (1,3) as -0.00102, the other as -0.0102; the first is kept here, where it can be seen."""


@dataclass
class Tables:
    """The four tables, for errata to work on."""

    mass: Array
    center_of_mass: Array
    euler_parameters: Array
    inertia: Array
    inertia_scale: Array

    @classmethod
    def as_printed(cls) -> Tables:
        return cls(
            MASS.copy(), CENTER_OF_MASS.copy(), EULER_PARAMETERS.copy(), INERTIA.copy(), INERTIA_SCALE.copy()
        )

    @property
    def scaled_inertia(self) -> Array:
        """(7, 3, 3) kg m^2."""
        return self.inertia * self.inertia_scale[:, None, None]


@dataclass(frozen=True)
class Erratum:
    """An error of the paper.

    Attributes:
        number: as it is cited everywhere in this project.
        where: place in the paper.
        printed, needed: what stands there, and what has to.
        remedy: how the project deals with it.
        correct: changes the tables; None where the error is not in a table.
    """

    number: int
    where: str
    printed: str
    needed: str
    remedy: str
    correct: Callable[[Tables], None] | None = None


def _symmetric_j1(tables: Tables) -> None:
    tables.inertia[0, 2, 0] = -1.0


def _mirrored_j2(tables: Tables) -> None:
    tables.inertia[1, 0, 2] = tables.inertia[1, 2, 0] = -0.0102


def _lost_scales(tables: Tables) -> None:
    tables.inertia_scale[2], tables.inertia_scale[3] = 1e-4, 1e-3


def realisable_j7(tables: Tables) -> None:
    """Erratum 8: the nearest round numbers that a rigid body can have, same product of inertia."""
    tables.inertia[6] = [[12.09, 0.0, 1.0], [0.0, 12.09, 0.0], [1.0, 0.0, 23.9]]


def _unit_p7(tables: Tables) -> None:
    tables.euler_parameters[6] /= np.linalg.norm(tables.euler_parameters[6])


ERRATA = (
    Erratum(
        1,
        "eq. (6)",
        "K_P on the velocity term, K_D on the position term",
        "swapped, as in eqs (8), (9) and (30)",
        "Baumgarte terms are K_D (Phi_q qdot) + K_P Phi",
    ),
    Erratum(
        2,
        "eq. (23)",
        "u = K_p e + K_d de/dt with e = z - z_d, a positive feedback",
        "u = -(K_p e + K_d de/dt)",
        "newton_euler.model.control.PD",
    ),
    Erratum(3, "section 4", "z_2d twice", "the second is z_3d", "both targets are 0.046 m"),
    Erratum(
        4,
        "eqs (4) to (22)",
        "7 bodies, 49 coordinates, 34 + 7 constraints: 8 degrees of freedom",
        "body 1 fixed: 42 coordinates, 34 + 6 constraints, 2 degrees of freedom",
        "body 1 is the ground and has no coordinates",
    ),
    Erratum(
        5,
        "Table 4, J1",
        "(1,3) = -1 and (3,1) = +1",
        "symmetric; the mirror plane of the mechanism asks for (1,3) = -1, (2,3) = +1",
        "applied",
        _symmetric_j1,
    ),
    Erratum(
        6,
        "Table 4, J2",
        "-0.00102 in one rendering",
        "-0.0102, the mirror image of J3",
        "applied",
        _mirrored_j2,
    ),
    Erratum(7, "Table 4, J3 and J4", "no scale factor", "1e-4 for J3, 1e-3 for J4", "applied", _lost_scales),
    Erratum(
        8,
        "Table 4, J7",
        "diag(12, 12, 24) with product 1: principal moments break A + B >= C",
        "12.09, 12.09, 23.9 with the same product, within the rounding of the print",
        "applied by default; panel_inertia=literal runs the printed values",
        realisable_j7,
    ),
    Erratum(9, "Table 3, p7", "norm 0.9999928", "a unit quaternion", "applied", _unit_p7),
    Erratum(
        10,
        "Table 4, J4 to J6",
        "rods along the local zeta axis, while p = (1,0,0,0) and the legs lean 30 and 37 deg",
        "tensors turned with the legs",
        "as printed by default, comparable with the paper; the scene tracker_aligned turns them",
    ),
    Erratum(
        11,
        "eq. (22)",
        "Baumgarte terms on Phi only",
        "on p^T p - 1 as well",
        "the Cartesian formulation stabilizes both",
    ),
    Erratum(
        12,
        "section 5",
        "remaining components in g zero",
        "no gravity acts in the paper's simulation",
        "scene tracker has no gravity",
    ),
)


def errata_table() -> str:
    """The errata as a markdown table, which docs/errata.md shows."""
    lines = ["| # | where | printed | needed | here |", "|---|---|---|---|---|"]
    lines += [f"| {e.number} | {e.where} | {e.printed} | {e.needed} | {e.remedy} |" for e in ERRATA]
    return "\n".join(lines) + "\n"


def corrected_tables(*, literal_panel: bool = False) -> Tables:
    """The tables with the errata applied; `literal_panel` leaves J7 as printed (erratum 8)."""
    tables = Tables.as_printed()
    for erratum in ERRATA:
        if erratum.correct is not None and not (erratum.number == 8 and literal_panel):
            erratum.correct(tables)
    return tables
