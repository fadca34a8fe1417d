"""Forces of a steady flow on a flat rectangular plate, at any angle of attack on both faces.

The equations accept floats and generic scalars such as expressions of the code generator. All functions are
smooth. Sources and validity are in docs/reference/python/wind.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from newton_euler.model.balls import SQUARE_FLOOR
from newton_euler.scalars import Array, Scalar, arctan2, exp, sqrt

VORTEX_FACTOR = math.pi
"""Normal force coefficient K_v of the vortices above the side edges, for attached flow (Khan and Nahon)."""

POTENTIAL_LEAD, VORTEX_LEAD = 0.25, 0.08
"""Distances of the centers of pressure of potential flow and of the vortices ahead of the plate's center, in
plate lengths: 0.25 and 0.42 lengths behind the leading edge (Khan and Nahon)."""

NORMAL_COEFFICIENT = 1.98
"""Normal force coefficient C_N of a plate of infinite span perpendicular to the wind (Khan and Nahon)."""

HOERNER_CONSTANT, HOERNER_SLOPE = 0.56, 0.44
"""Denominator of Hoerner's formula for infinite span: C_N = 1.98 sin a / (0.56 + 0.44 sin a)."""

END_LOSS = 0.41
"""Factor of Lindenburg's term 0.41 (1 - exp(-17 / R)) for a plate of aspect ratio R."""

END_RATE = 17.0
"""Factor of 1 / R in the exponent of Lindenburg's term."""

SEPARATED_LEAD = 0.175
"""Distance of the center of pressure ahead of the plate's center for separated flow along the plate, in plate
lengths (Khan and Nahon). It decreases linearly to 0 for flow perpendicular to the plate."""

STALL_LEAST, STALL_LOW, STALL_HIGH = (math.radians(angle) for angle in (7.6, 19.5, 14.9))
"""Terms of the angle of attack at which flow separates, rad, see `_stall_angle`."""

STALL_RATIO_LOW, STALL_RATIO_HIGH = 1.09, 3.18
"""Aspect ratios span / chord around which this angle falls, see `_stall_angle`."""

STALL_WIDTH = math.radians(2.4)
"""Width of the transition from attached to separated flow, rad."""

CALM_SPEED = 1e-2
"""Speed, m/s, whose square is added to the squares of the wind speeds normal to and along the plate. The load
is then smooth at zero wind, and the error is 1e-6 of the load at 10 m/s."""


class PlateLoad(NamedTuple):
    """Load of a flow on a plate, divided by 1/2 rho A.

    Attributes:
        normal: C_N |w|^2 with the sign of the normal component of w, m^2/s^2.
        first_moment, second_moment: product of `normal` and the displacement of the center of pressure from
            the plate's center along each side, m^3/s^2.
    """

    normal: Scalar
    first_moment: Scalar
    second_moment: Scalar


def plate_load(w: Array, lengths: Array) -> PlateLoad:
    """Compute the load of a flow on a plate.

    Args:
        w: (3,) velocity of the flow relative to the plate, m/s, along both sides and the normal.
        lengths: (2,) lengths of the sides, m.
    """
    floor = CALM_SPEED * CALM_SPEED
    length, width = lengths.tolist()
    # Squares of the speeds along both sides, speeds along and normal to the plate, and the angle of attack
    first_square, second_square = w[0] * w[0] + 0.5 * floor, w[1] * w[1] + 0.5 * floor
    along, across = sqrt(first_square + second_square), sqrt(w[2] * w[2] + floor)
    speed, attack = sqrt(along * along + across * across), arctan2(across, along)
    # Aspect ratio R = span / chord; the chord is along the flow
    span_square = length * length * second_square + width * width * first_square
    chord_square = length * length * first_square + width * width * second_square
    ratio_square = span_square / chord_square
    ratio = sqrt(ratio_square)
    separated_part = 1.0 / (1.0 + exp((_stall_angle(ratio_square) - attack) / STALL_WIDTH))
    attached_part = 1.0 - separated_part
    # C_N |w| / sin a of attached flow, in terms of potential flow and vortices, and of separated flow
    potential, vortex = lift_slope(ratio) * along, VORTEX_FACTOR * across
    hoerner = speed / (HOERNER_CONSTANT * speed + HOERNER_SLOPE * across)
    separated = NORMAL_COEFFICIENT * (hoerner - end_loss(lengths)) * speed
    normal = w[2] * (attached_part * (potential + vortex) + separated_part * separated)
    # The center of pressure is ahead of the plate's center, against the flow. `lead` is its distance times
    # the normal load, per plate length along the flow and per speed along the plate
    attached_lead = POTENTIAL_LEAD * potential + VORTEX_LEAD * vortex
    separated_lead = SEPARATED_LEAD * (1.0 - attack * (2.0 / math.pi)) * separated
    lead = w[2] * (attached_part * attached_lead + separated_part * separated_lead) / along
    return PlateLoad(normal, -length * w[0] * lead, -width * w[1] * lead)


def lift_slope(ratio: Scalar) -> Scalar:
    """Compute McCormick's lift slope, 1/rad, of a thin wing with an aspect ratio R = span / chord:
    2 pi R / (R + 2 (R + 4) / (R + 2))."""
    return (2.0 * math.pi) * ratio * (ratio + 2.0) / (ratio * ratio + 4.0 * ratio + 8.0)


def _stall_angle(ratio_square: Scalar) -> Scalar:
    """Compute the angle of attack, rad, at which the flow has separated by half, from (span / chord)^2.

    A fit of this program: with it, the coefficients follow those of the source, which are interpolated
    linearly between two angles of a table, with a root mean square deviation of 0.03.
    """
    low = ratio_square / (STALL_RATIO_LOW * STALL_RATIO_LOW)
    high = ratio_square / (STALL_RATIO_HIGH * STALL_RATIO_HIGH)
    return STALL_LEAST + STALL_LOW / (1.0 + low * low * low * low) + STALL_HIGH / (1.0 + high)


def end_loss(lengths: Array) -> Scalar:
    """Compute the reduction of the separated flow's coefficient by the ends of a plate with sides of these
    lengths (2,): 0.41 (1 - exp(-17 / R)), R the longer side divided by the shorter one."""
    length, width = lengths.tolist()
    # When code is generated, lengths are symbols, which have no min and max: use |length - width|
    if isinstance(length, float) and isinstance(width, float):
        shorter, longer = min(length, width), max(length, width)
    else:
        difference = sqrt((length - width) * (length - width) + SQUARE_FLOOR)
        shorter, longer = 0.5 * (length + width - difference), 0.5 * (length + width + difference)
    return END_LOSS * (1.0 - exp(-END_RATE * shorter / longer))
