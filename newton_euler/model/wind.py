"""Wind loads on flat plates such as solar panels, and wind speeds with gusts and turbulence as functions of
time.

`WindLoad` is a force element of a scene. Its wind speed is a number or a function of time, for example from
`wind_gust` or `wind_turbulence`.
"""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from newton_euler.arguments import Range, checked
from newton_euler.errors import MechanismError, check_texts, quoted
from newton_euler.model.balls import SQUARE_FLOOR
from newton_euler.model.description import ArrayField, description
from newton_euler.model.elements import OnPoint, PointLoad, PoseChange, Surroundings
from newton_euler.model.fields import NumberField
from newton_euler.model.mechanism import check_name
from newton_euler.model.motions import Sum, TimeFunction
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.scalars import Array, Scalar, arctan2, cross, exp, sqrt

NORMAL_COEFFICIENT = 1.98
"""Normal force coefficient C_N of a plate of infinite span perpendicular to the wind (sources in
`WindLoad`)."""

HOERNER_CONSTANT = 0.56
"""Constant term of the denominator in Hoerner's formula C_N = 1.98 sin a / (0.56 + 0.44 sin a) for infinite
span."""

HOERNER_SLOPE = 0.44
"""Factor of sin a in the denominator of Hoerner's formula."""

END_LOSS = 0.41
"""Factor of Lindenburg's term 0.41 (1 - exp(-17 / R)) for a plate of aspect ratio R."""

END_RATE = 17.0
"""Factor of 1 / R in the exponent of Lindenburg's term."""

PRESSURE_LEAD = 0.175
"""Distance of the center of pressure ahead of the plate's center for wind along the plate, in plate lengths
(source in `WindLoad`)."""

CALM_SPEED = 1e-2
"""Speed, m/s, whose square is added to the squares of the wind speeds normal to and along the plate. The load
is then smooth at zero wind, and the error is 1e-6 of the load at 10 m/s."""

MAX_VECTOR_LENGTH = 1e100
"""Largest length of any vector of a wind load, so that squared lengths and the plate's area stay finite."""

PERPENDICULAR_TOLERANCE = 1e-9
"""Largest cosine of the angle between the two sides of a plate."""

MAX_SINES = 1000
"""Largest number of sines in a turbulent wind speed; the equations of motion are compiled with one term for
each sine."""

STANDARD_AIR = 1.225
"""Density of air, kg/m^3, of the ISO 2533 Standard Atmosphere at sea level and 15 degrees Celsius."""


@description
class WindLoad(OnPoint):
    """The load of wind on a flat rectangular plate that is a part of a body.

    Let w be the velocity of the wind relative to the plate's center, and w_n the component of w along the
    plate's normal n. The angle of attack a between w and the plate has sin a = |w_n| / |w|. A is the area of
    the plate, rho the density of air, and R the ratio of the plate's longer side to the shorter side. The
    force is

        F = 1/2 rho A |w|^2 C_N sign(w_n) n,
        C_N = 1.98 sin a (1 / (0.56 + 0.44 sin a) - 0.41 (1 - exp(-17 / R))).

    The force acts ahead of the plate's center, towards the edge that the wind meets first. The distance is
    0.175 (1 - 2 a / pi) times the length of the plate along the wind. A square plate perpendicular to the
    wind has C_N = 1.17.

    Sources. Infinite span: S. F. Hoerner, Fluid-Dynamic Lift, 2nd edition, 1985, chapter XXI, eq. (2). Term
    with R: C. Lindenburg, Stall Coefficients, ECN-RX--01-004, 2001. Coefficient 1.98 and center of pressure:
    W. Khan and M. Nahon, Real-time modeling of agile fixed-wing UAV aerodynamics, ICUAS 2015, pp. 1188-1195,
    doi:10.1109/ICUAS.2015.7152411. The originals were not available: the formulas were checked against other
    programs that cite these works.

    Validity. The formula holds for thin plates in free, steady, separated flow: angles of attack from about
    20 to 90 degrees, low Mach number, Reynolds number above 1000. Below 20 degrees it continues smoothly to
    zero force at 0. Further assumptions of this class are:

    - R does not depend on the direction of the wind along the plate;
    - wind along a diagonal moves the center of pressure along each side in proportion to its component there;
    - the flow follows w without delay, and the plate's rotation affects the load through w only;
    - there is no friction along the plate, and neither the ground nor an obstacle upwind is near.

    In the turbulence near the ground, mean and peak loads of heliostats are larger. Coefficients for that
    case are in J. A. Peterka and R. G. Derickson, Wind Load Design Methods for Ground-Based Heliostats and
    Parabolic Dish Collectors, SAND92-7009, 1992. In this class gusts are a part of `speed`.

    Attributes:
        name: unique among the forces of a scene; letters, digits, `_`, `.` and `-`.
        body: name of the body of which the plate is a part; not the ground.
        point: (3,) center of the plate, m, world at the initial pose.
        first_side, second_side: (3,) m, the two sides of the plate with their lengths, perpendicular to each
            other, world at the initial pose.
        direction: (3,) direction towards which the wind blows, world frame, of any length.
        speed: wind speed along `direction`, m/s, a number or a function of time.
        air_density: rho in kg/m^3, 0 or more.

    Raises:
        MechanismError: naming the wind load and the invalid value.

    Examples:
        >>> center, x, y = [0.0, 0.0, 3.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]
        >>> wind = WindLoad("wind", "panel", center, first_side=x, second_side=y, direction=x, speed=20.0)
        >>> wind.area
        2.0
    """

    name: str
    body: str
    point: ArrayField
    first_side: ArrayField = field(kw_only=True)
    second_side: ArrayField = field(kw_only=True)
    direction: ArrayField = field(kw_only=True)
    speed: float | TimeFunction = field(kw_only=True)
    air_density: float = field(default=STANDARD_AIR, kw_only=True)

    noun = "wind load"
    kind = "wind_load"
    # Attributes that may vary from run to run. `allowed` is the rule for new values: a vector of any nonzero
    # length, or what the constructor accepts. `strength` names the effect that is proportional to the number
    number_fields: ClassVar = OnPoint.number_fields | {
        "direction": NumberField(shape=(3,), allowed="direction"),
        "speed": NumberField("m/s", may_be_function=True),
        "air_density": NumberField("kg/m^3", least=0.0, strength="wind"),
        "first_side": NumberField("m", shape=(3,), allowed="constructor"),
        "second_side": NumberField("m", shape=(3,), allowed="constructor"),
    }

    @np.errstate(all="ignore")  # squares that overflow are refused
    def __post_init__(self) -> None:
        check_name(self.noun, self.name)
        check_texts(self.element, self, "body")
        self.set_numbers(self.element)
        for vector in ("first_side", "second_side", "direction"):
            given = getattr(self, vector)
            if not 0.0 < given @ given < MAX_VECTOR_LENGTH * MAX_VECTOR_LENGTH:
                problem = f"{vector} is {given.tolist()}"
                needed = f"a vector not of length 0, nor above {MAX_VECTOR_LENGTH:g}"
                raise MechanismError(self.element, problem, needed)
        cosine = float(self.first_side @ self.second_side) / self.area
        if abs(cosine) > PERPENDICULAR_TOLERANCE:
            problem = f"its sides have a cosine of {cosine:.3g}"
            needed = f"perpendicular sides, |cosine| at most {PERPENDICULAR_TOLERANCE:g}"
            raise MechanismError(self.element, problem, needed)

    def described_after(self, change: PoseChange) -> Self:
        """Return the same load for the scene as it is described at another initial pose."""
        move = change.move(self.body)
        sides = move.vector(self.first_side), move.vector(self.second_side)
        return replace(self, point=move.point(self.point), first_side=sides[0], second_side=sides[1])

    @property
    def lengths(self) -> Array:
        """Lengths (2,) of the sides, m."""
        return np.array([sqrt(np.sum(side * side)) for side in (self.first_side, self.second_side)])

    @property
    def area(self) -> Scalar:
        """Area of the plate, m^2."""
        length, width = self.lengths.tolist()
        return length * width

    @property
    def axes(self) -> Array:
        """(3, 3) matrix whose columns are unit vectors along both sides and the normal, world at the initial
        pose."""
        length, width = self.lengths
        first, second = self.first_side / length, self.second_side / width
        return np.column_stack([first, second, cross(first, second)])

    @property
    def end_loss(self) -> Scalar:
        """Reduction of the force coefficient by the ends of the plate: 0.41 (1 - exp(-17 / R)), R the aspect
        ratio."""
        length, width = self.lengths.tolist()
        # When code is generated, lengths are symbols, which have no min and max: use |length - width|
        if isinstance(length, float) and isinstance(width, float):
            shorter, longer = min(length, width), max(length, width)
        else:
            difference = sqrt((length - width) * (length - width) + SQUARE_FLOOR)
            shorter, longer = 0.5 * (length + width - difference), 0.5 * (length + width + difference)
        return END_LOSS * (1.0 - exp(-END_RATE * shorter / longer))

    def velocity(self, time: float) -> Array:
        """Compute the velocity of the wind (3,), m/s, world frame, at a time in s."""
        speed = self.speed.value(time) if isinstance(self.speed, TimeFunction) else self.speed
        return np.asarray(speed / sqrt(self.direction @ self.direction) * self.direction)

    def load(self, at: Surroundings) -> PointLoad:
        """Compute the wind's force at the plate's center and its torque about the center, at a state."""
        # `pose`: the body frame at the initial pose; `frame`: its present pose and velocity
        k = at.mechanism.body_index(self.body)
        pose, frame = at.poses[k], at.frames[k]
        arm = frame.rotation @ pose.point_to_body(self.point)

        # Relative wind w in the frame of the plate; its speeds normal to the plate and along it
        axes = frame.rotation @ (pose.rotation.T @ self.axes)
        w = (self.velocity(at.time) - frame.velocity - cross(frame.angular_velocity, arm)) @ axes
        floor = CALM_SPEED * CALM_SPEED
        normal_speed, tangential_speed = sqrt(w[2] * w[2] + floor), sqrt(w[0] * w[0] + w[1] * w[1] + floor)
        speed = sqrt(normal_speed * normal_speed + tangential_speed * tangential_speed)

        # Normal force, with coefficient = C_N / sin a and sin a = normal_speed / speed
        hoerner = speed / (HOERNER_CONSTANT * speed + HOERNER_SLOPE * normal_speed)
        coefficient = NORMAL_COEFFICIENT * (hoerner - self.end_loss)
        normal_force = 0.5 * self.area * self.air_density * coefficient * speed * w[2]
        force = axes[:, 2] * normal_force

        # Center of pressure, from the plate's center against the wind. With arctan2(tangential, normal) =
        # pi / 2 - a, `lead` is 0.175 (1 - 2 a / pi) / tangential_speed
        length, width = self.lengths
        lead = (PRESSURE_LEAD * 2.0 / math.pi) * arctan2(tangential_speed, normal_speed) / tangential_speed
        center = axes[:, 0] * (-(length * lead * w[0])) + axes[:, 1] * (-(width * lead * w[1]))
        return PointLoad(k, force, cross(center, force), arm)


@checked
def wind_gust(mean: float, gust: float, period: float = 10.5) -> Sum:
    """Return the wind speed of an extreme operating gust: a dip, a rise by 0.74 of `gust`, and a second dip.

    For t from 0 to the period T, the speed is mean - 0.37 gust sin(3 pi t / T) (1 - cos(2 pi t / T)). This is
    the extreme operating gust of the standard IEC 61400-1 (2005) for wind turbines. The function is a sum of
    sines. After T the gust follows with the opposite sign, so that runs should end at T. The standard was not
    available; the formula and T were checked against programs for wind turbines. The gust of the standard is
    that at the hub of a turbine, less than 3.3 standard deviations of the turbulence. For structures near the
    ground the formula is an assumption.

    Args:
        mean: wind speed before and after the gust, m/s.
        gust: size of the gust, m/s.
        period: duration T of the gust, s.

    Raises:
        ArgumentError: for a value that is not a finite number.
        MechanismError: for a period that is not positive.

    Examples:
        >>> wind = wind_gust(mean=10.0, gust=5.0)
        >>> [round(float(wind.value(t)), 2) for t in (0.0, 2.0, 5.25)]
        [10.0, 8.86, 13.7]
    """
    _check_positive("wind gust", period=period)
    w, amplitude = math.pi / period, 0.37 * gust
    sines = (Sine(-amplitude, 3.0 * w), Sine(0.5 * amplitude, 5.0 * w), Sine(0.5 * amplitude, w))
    return Sum((Polynomial((mean,)), *sines))


@checked
@np.errstate(all="ignore")  # the constructor of `Sine` refuses numbers that overflow
def wind_turbulence(
    mean: float,
    deviation: float,
    length: float,
    seed: Annotated[int, Range(0)],
    lowest: float = 0.01,
    highest: float = 10.0,
    count: Annotated[int, Range(1, MAX_SINES)] = 40,
) -> Sum:
    """Return a random wind speed with Kaimal's turbulence spectrum; the seed selects the realization.

    The spectrum of the component along the mean wind is S(f) = 4 s^2 (L / V) / (1 + 6 f L / V)^(5/3). The
    formula is in an annex of IEC 61400-1. Its integral over all frequencies f is the variance s^2. The
    realization is a sum of sines with random phases (M. Shinozuka and G. Deodatis, Simulation of stochastic
    processes by spectral representation, Applied Mechanics Reviews 44(4), 1991, pp. 191-204). The band of
    frequencies is divided into parts of equal width on a logarithmic scale. Each part has one sine, with the
    variance of the part and a random frequency in it. This division is a choice of this function: the wind
    does not repeat, and few sines cover a wide band. Turbulence outside of the band is omitted.

    The standard was not available; spectrum, L and s were checked against programs for wind turbines. The
    values are for hubs tens of meters above the ground. Near the ground, as at 2 m, L proportional to the
    height is an assumption, and turbulence is often stronger.

    Args:
        mean: mean wind speed V, m/s.
        deviation: standard deviation s of the wind speed, m/s. The standard's value is I (0.75 V + 5.6 m/s),
            with I = 0.16, 0.14, 0.12 for turbulence classes A, B, C.
        length: length scale L of the turbulence, m. The standard's value is 8.1 * 0.7 = 5.67 times the height
            above ground, up to a height of 60 m.
        seed: 0 or more; the same seed gives the same wind.
        lowest: lower end of the band of frequencies, Hz.
        highest: upper end of the band of frequencies, Hz.
        count: number of sines, 1 to `MAX_SINES`.

    Raises:
        ArgumentError: for a value of another type, and an impossible seed or count.
        MechanismError: for a value that is not positive, and an empty band.

    Examples:
        >>> wind = wind_turbulence(mean=10.0, deviation=1.5, length=11.0, seed=1)
        >>> len(wind.terms), wind == wind_turbulence(mean=10.0, deviation=1.5, length=11.0, seed=1)
        (41, True)
    """
    where = "wind turbulence"
    _check_positive(where, mean=mean, length=length, deviation=deviation)
    _check_positive(where, lowest=lowest, highest=highest)
    if not highest > lowest:
        raise MechanismError(where, f"highest is {highest:g} Hz", f"more than lowest, {lowest:g} Hz")
    mean, deviation, length, lowest, highest = map(float, (mean, deviation, length, lowest, highest))
    rng = np.random.default_rng(int(seed))
    edges = np.geomspace(lowest, highest, count + 1)
    # fraction of the variance below each edge: the integral of S from 0, divided by s^2
    variance_below = 1.0 - (1.0 + 6.0 * edges * length / mean) ** (-2.0 / 3.0)
    amplitudes = deviation * np.sqrt(2.0 * np.diff(variance_below))
    frequencies = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.random(count)
    phases = 2.0 * np.pi * rng.random(count)
    sines = zip(amplitudes.tolist(), (2.0 * np.pi * frequencies).tolist(), phases.tolist(), strict=True)
    return Sum((Polynomial((mean,)), *(Sine(*numbers) for numbers in sines)))


def _check_positive(where: str, **values: float) -> None:
    """Raise `MechanismError`, naming `where` and the argument, for a value that is not positive."""
    for name, value in values.items():
        if not value > 0.0:
            raise MechanismError(where, f"{name} is {quoted(value)}", "a positive number")
