"""Wind loads on flat plates such as solar panels, and wind speeds with gusts and turbulence as functions of
time.

`WindLoad` is a force element of a scene. Its wind speeds are numbers or functions of time, for example from
`wind_gust`, `wind_turbulence` and `vertical_turbulence`.
"""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from newton_euler.arguments import Range, checked
from newton_euler.errors import MechanismError, check_texts, quoted
from newton_euler.model.description import ArrayField, description
from newton_euler.model.elements import OnPoint, PointLoad, PoseChange, Surroundings
from newton_euler.model.fields import NumberField
from newton_euler.model.mechanism import check_name
from newton_euler.model.motions import Sum, TimeFunction
from newton_euler.model.plate_flow import plate_load
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.scalars import Array, Scalar, cross, sqrt

MAX_VECTOR_LENGTH = 1e100
"""Largest length of any vector of a wind load, so that squared lengths and the plate's area stay finite."""

PERPENDICULAR_TOLERANCE = 1e-9
"""Largest cosine of the angle between the two sides of a plate."""

MAX_SINES = 1000
"""Largest number of sines in a turbulent wind speed; the equations of motion are compiled with one term for
each sine."""

VERTICAL_DEVIATION, VERTICAL_LENGTH = 0.5, 0.66 / 8.1
"""Standard deviation and length scale of vertical turbulence, as fractions of those along the mean wind."""

VERTICAL_STREAM = 3
"""Number that is combined with a seed, so that vertical turbulence has phases of its own."""

STANDARD_AIR = 1.225
"""Density of air, kg/m^3, of the ISO 2533 Standard Atmosphere at sea level and 15 degrees Celsius."""


@description
class WindLoad(OnPoint):
    """The load of wind on a flat rectangular plate that is a part of a body, at any angle of attack.

    The force acts along the plate's normal: 1/2 rho A |w|^2 C_N, where w is the velocity of the wind relative
    to the plate's center, A the area, and C_N a coefficient of the angle of attack and of the plate's aspect
    ratio. A square plate perpendicular to the wind has C_N = 1.17; its coefficient is largest near 30
    degrees, 1.35. The documentation has the formula of C_N, its validity and its sources.

    Attributes:
        name: unique among the forces of a scene; letters, digits, `_`, `.` and `-`.
        body: name of the body of which the plate is a part; not the ground.
        point: (3,) center of the plate, m, world at the initial pose.
        first_side, second_side: (3,) m, the two sides of the plate with their lengths, perpendicular to each
            other, world at the initial pose.
        direction: (3,) direction towards which the wind blows, world frame, of any length.
        speed: wind speed along `direction`, m/s, a number or a function of time.
        air_density: rho in kg/m^3, 0 or more.
        vertical_speed: wind speed along the world's z axis, in addition, m/s, a number or a function of time.

    Raises:
        MechanismError: naming the wind load and the invalid value.

    Examples:
        >>> center, x, y = [0.0, 0.0, 3.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]
        >>> down, v = [0.0, 0.0, -1.0], 20.0
        >>> wind = WindLoad("wind", "panel", center, first_side=x, second_side=y, direction=down, speed=v)
        >>> print(f"area {wind.area:.0f} m^2, dynamic pressure {0.5 * wind.air_density * v**2:.0f} Pa")
        area 2 m^2, dynamic pressure 245 Pa
    """

    name: str
    body: str
    point: ArrayField
    first_side: ArrayField = field(kw_only=True)
    second_side: ArrayField = field(kw_only=True)
    direction: ArrayField = field(kw_only=True)
    speed: float | TimeFunction = field(kw_only=True)
    air_density: float = field(default=STANDARD_AIR, kw_only=True)
    vertical_speed: float | TimeFunction = field(default=0.0, kw_only=True)

    noun = "wind load"
    kind = "wind_load"
    # Attributes that may vary from run to run. `allowed` is the rule for new values: a vector of any nonzero
    # length, or what the constructor accepts. `strength` names the effect that is proportional to the number
    number_fields: ClassVar = OnPoint.number_fields | {
        "direction": NumberField(shape=(3,), allowed="direction"),
        "speed": NumberField("m/s", may_be_function=True),
        "vertical_speed": NumberField("m/s", may_be_function=True),
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

    def velocity(self, time: float) -> Array:
        """Compute the velocity of the wind (3,), m/s, world frame, at a time in s."""
        along, upward = (
            speed.value(time) if isinstance(speed, TimeFunction) else speed
            for speed in (self.speed, self.vertical_speed)
        )
        horizontal = along / sqrt(self.direction @ self.direction) * self.direction
        return np.asarray(horizontal + np.array([0.0, 0.0, upward]))

    def load(self, at: Surroundings) -> PointLoad:
        """Compute the wind's force at the plate's center and its torque about the center, at a state."""
        # `pose`: the body frame at the initial pose; `frame`: its present pose and velocity
        k = at.mechanism.body_index(self.body)
        pose, frame = at.poses[k], at.frames[k]
        arm = frame.rotation @ pose.point_to_body(self.point)
        # Relative wind in the frame of the plate
        axes = frame.rotation @ (pose.rotation.T @ self.axes)
        w = (self.velocity(at.time) - frame.velocity - cross(frame.angular_velocity, arm)) @ axes
        found, factor = plate_load(w, self.lengths), 0.5 * self.air_density * self.area
        force = axes[:, 2] * (factor * found.normal)
        # Product of the normal force and the position of the center of pressure; the normal is axes[:, 2]
        moment = axes[:, 0] * (factor * found.first_moment) + axes[:, 1] * (factor * found.second_moment)
        return PointLoad(k, force, cross(moment, axes[:, 2]), arm)


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
        count: number of sines, 1 to 1000.

    Raises:
        ArgumentError: for a value of another type, and an impossible seed or count.
        MechanismError: for a value that is not positive, and an empty band.

    Examples:
        >>> wind = wind_turbulence(mean=10.0, deviation=1.5, length=11.0, seed=1)
        >>> [round(float(wind.value(t)), 1) for t in (0.0, 1.0, 2.0)]  # m/s
        [7.3, 9.5, 10.4]
    """
    sines = _turbulent_sines("wind turbulence", mean, deviation, length, seed, lowest, highest, count)
    return Sum((Polynomial((float(mean),)), *sines))


@checked
@np.errstate(all="ignore")  # the constructor of `Sine` refuses numbers that overflow
def vertical_turbulence(
    mean: float,
    deviation: float,
    length: float,
    seed: Annotated[int, Range(0)],
    lowest: float = 0.01,
    highest: float = 10.0,
    count: Annotated[int, Range(1, MAX_SINES)] = 40,
) -> Sum:
    """Return a random vertical wind speed of mean 0, for `WindLoad.vertical_speed`.

    The spectrum has the form of that of `wind_turbulence`, with the vertical component's standard deviation
    0.5 `deviation` and length scale 0.66 / 8.1 `length`, as in IEC 61400-1. The phases are independent of
    those of `wind_turbulence` with the same seed. The standard was not available; the factors were checked
    against a program for wind spectra.

    Args:
        mean: mean wind speed V, m/s.
        deviation: standard deviation of the wind speed along the mean wind, m/s, as in `wind_turbulence`.
        length: length scale of the turbulence along the mean wind, m, as in `wind_turbulence`.
        seed, lowest, highest, count: as in `wind_turbulence`.

    Raises:
        ArgumentError, MechanismError: as `wind_turbulence`.

    Examples:
        >>> wind = vertical_turbulence(mean=10.0, deviation=1.5, length=11.0, seed=1)
        >>> [round(float(wind.value(t)), 1) for t in (0.0, 1.0, 2.0)]  # m/s
        [-0.4, -0.4, 1.4]
    """
    where, stream = "vertical turbulence", (int(seed), VERTICAL_STREAM)
    own_deviation, own_length = VERTICAL_DEVIATION * deviation, VERTICAL_LENGTH * length
    return Sum(_turbulent_sines(where, mean, own_deviation, own_length, stream, lowest, highest, count))


def _turbulent_sines(
    where: str,
    mean: float,
    deviation: float,
    length: float,
    seed: int | tuple[int, int],
    lowest: float,
    highest: float,
    count: int,
) -> tuple[Sine, ...]:
    """Return the sines of a turbulent wind speed, see `wind_turbulence`; `where` names the caller."""
    _check_positive(where, mean=mean, length=length, deviation=deviation)
    _check_positive(where, lowest=lowest, highest=highest)
    if not highest > lowest:
        raise MechanismError(where, f"highest is {highest:g} Hz", f"more than lowest, {lowest:g} Hz")
    mean, deviation, length, lowest, highest = map(float, (mean, deviation, length, lowest, highest))
    rng = np.random.default_rng(seed)
    edges = np.geomspace(lowest, highest, count + 1)
    # fraction of the variance below each edge: the integral of S from 0, divided by s^2
    variance_below = 1.0 - (1.0 + 6.0 * edges * length / mean) ** (-2.0 / 3.0)
    amplitudes = deviation * np.sqrt(2.0 * np.diff(variance_below))
    frequencies = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.random(count)
    phases = 2.0 * np.pi * rng.random(count)
    sines = zip(amplitudes.tolist(), (2.0 * np.pi * frequencies).tolist(), phases.tolist(), strict=True)
    return tuple(Sine(*numbers) for numbers in sines)


def _check_positive(where: str, **values: float) -> None:
    """Raise `MechanismError`, naming `where` and the argument, for a value that is not positive."""
    for name, value in values.items():
        if not value > 0.0:
            raise MechanismError(where, f"{name} is {quoted(value)}", "a positive number")
