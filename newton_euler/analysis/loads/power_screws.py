"""Power screws: torque to raise and to lower a load, efficiencies, buckling and critical speed.

A power screw (lead screw) turns a rotation into the motion of a nut along the screw. "Raise" means that the
nut moves against the force of the load; "lower" means that it moves with the force. Equations are those of
R. G. Budynas, J. K. Nisbett, Shigley's Mechanical Engineering Design, 10th edition, McGraw-Hill 2015.
"""

from __future__ import annotations

import math
from typing import NamedTuple

STEEL_MODULUS, STEEL_DENSITY = 206e9, 7850.0
"""Young's modulus, N/m^2, and density, kg/m^3, of steel screws."""


class Thread(NamedTuple):
    """Geometry and friction of a power screw with sliding friction.

    Attributes:
        lead: axial motion per turn, m.
        pitch_diameter: mean diameter of the thread, m.
        friction: coefficient of friction between screw and nut.
        flank_angle: angle of the flank against the normal of the axis, rad, half of the thread angle: 0 for
            square threads, 15 degrees for metric trapezoidal threads, 14.5 degrees for Acme threads.
        collar_diameter: mean diameter of the collar that carries the thrust, m; 0 for a roller bearing.
        collar_friction: coefficient of friction of the collar.
    """

    lead: float
    pitch_diameter: float
    friction: float
    flank_angle: float = 0.0
    collar_diameter: float = 0.0
    collar_friction: float = 0.0

    @property
    def can_turn(self) -> bool:
        """True if a torque can raise the load: the denominator of `raising_torque` is positive."""
        wedging = self.friction * self.lead / math.cos(self.flank_angle)
        return math.pi * self.pitch_diameter > wedging

    def raising_torque(self, force: float) -> float:
        """Return the torque, N m, that raises a load, N: equations (8-5) and (8-6) of Shigley."""
        friction = self.friction / math.cos(self.flank_angle)
        numerator = self.lead + math.pi * friction * self.pitch_diameter
        denominator = math.pi * self.pitch_diameter - friction * self.lead
        return 0.5 * force * self.pitch_diameter * numerator / denominator + self._collar_torque(force)

    def lowering_torque(self, force: float) -> float:
        """Return the torque, N m, that lowers a load, N; negative if the load must be braked.

        This is equation (8-2) of Shigley with the friction of inclined flanks as in (8-5), and (8-6).
        """
        friction = self.friction / math.cos(self.flank_angle)
        numerator = math.pi * friction * self.pitch_diameter - self.lead
        denominator = math.pi * self.pitch_diameter + friction * self.lead
        return 0.5 * force * self.pitch_diameter * numerator / denominator + self._collar_torque(force)

    def _collar_torque(self, force: float) -> float:
        """Return the friction torque of the collar, N m: equation (8-6) of Shigley."""
        return 0.5 * force * self.collar_friction * self.collar_diameter

    @property
    def efficiency(self) -> float:
        """Work on the load per work at the screw while the screw raises the load: equation (8-4)."""
        return self.lead / (2.0 * math.pi * self.raising_torque(1.0))

    @property
    def back_efficiency(self) -> float:
        """Work at the screw per work of the load while the load is lowered.

        At 0 or below, the screw is self-locking, equation (8-3): the load cannot turn the screw, and a
        negative value is work that the motor does to lower the load.
        """
        return -2.0 * math.pi * self.lowering_torque(1.0) / self.lead


def usual_back_efficiency(efficiency: float) -> float:
    """Return the efficiency of a stage that its load drives, from the efficiency of the driven stage.

    With the same power P at the output, the stage loses P (1 / efficiency - 1). If the loss is the same when
    the load drives, P (2 - 1 / efficiency) remains. At an efficiency of 1/2 or below, the stage is
    self-locking.
    """
    return 2.0 - 1.0 / efficiency


class Ends(NamedTuple):
    """Supports of a shaft at its two ends.

    Attributes:
        buckling: end-condition constant C of Euler's formula, table 4-2 of Shigley, theoretical values.
        bending: square of the first root of the frequency equation of a uniform beam.
    """

    buckling: float
    bending: float


ENDS = {
    "fixed-free": Ends(0.25, 3.5160),
    "supported": Ends(1.0, math.pi**2),
    "fixed-supported": Ends(2.0, 15.4182),
    "fixed": Ends(4.0, 22.3733),
}
"""Supports of screws by name. The roots are those of R. D. Blevins, Formulas for Natural Frequency and Mode
Shape, 1979, table 8-1."""


def buckling_force(diameter: float, length: float, ends: Ends) -> float:
    """Return the critical axial force of a slender steel screw, N: Euler's formula, (4-43) of Shigley.

    Args:
        diameter: root diameter of the thread, m.
        length: unsupported length, m.
        ends: supports.
    """
    stiffness = STEEL_MODULUS * math.pi * diameter**4 / 64.0
    return ends.buckling * math.pi**2 * stiffness / length**2


def critical_speed(diameter: float, length: float, ends: Ends) -> float:
    """Return the speed, rad/s, of the first bending resonance of a steel screw; (7-22) of Shigley for
    supported ends.

    Args:
        diameter: root diameter of the thread, m.
        length: unsupported length, m.
        ends: supports.
    """
    return ends.bending / length**2 * 0.25 * diameter * math.sqrt(STEEL_MODULUS / STEEL_DENSITY)
