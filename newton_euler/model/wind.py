"""Wind loads on flat plates such as solar panels; gusts and turbulence as functions of time."""

from __future__ import annotations

import math
from dataclasses import field, replace
from typing import Annotated, ClassVar, Self

import numpy as np

from newton_euler.arguments import Range, checked
from newton_euler.errors import MechanismError, check_texts, quoted
from newton_euler.model.balls import SQUARE_FLOOR
from newton_euler.model.description import ArrayField, description
from newton_euler.model.elements import OnPoint, PoseChange, Surroundings
from newton_euler.model.fields import NumberField
from newton_euler.model.mechanism import check_name
from newton_euler.model.motions import Sum, TimeFunction
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.scalars import Array, Scalar, arctan2, cross, exp, sqrt

FACE_ON = 1.98  # normal force coefficient of a plate of infinite span across the wind
ATTACHED, SEPARATED = 0.56, 0.44  # of C_N: FACE_ON sin(a) / (ATTACHED + SEPARATED sin(a))
END_LOSS, END_RATE = 0.41, 17.0  # of finite plates: END_LOSS (1 - exp(-END_RATE / aspect ratio))
LEAD = 0.175  # center of pressure ahead of the plate's center along the wind, in chords
CALM = 1e-2  # m/s, below which a speed counts as this one, smoothly: round-off of any wind that loads
LONG = 1e100  # of any vector, so that its square is finite, and so is the plate's area
SQUARE = 1e-9  # cosine of the angle between the sides of a plate that are perpendicular
MOST_SINES = 1000  # of turbulence, as code is made of each
STANDARD_AIR = 1.225  # kg/m^3, ISO 2533 Standard Atmosphere at sea level, 15 degrees Celsius


@description
class WindLoad(OnPoint):
    """The load of wind on a flat rectangular plate that is a part of a body.

    With the wind's velocity w relative to the plate's center, its component w_n along the plate's normal n,
    and the angle of attack a between w and the plate, sin a = |w_n| / |w|, the force is

        F = 1/2 rho A |w|^2 C_N sign(w_n) n,
        C_N = 1.98 sin a (1 / (0.56 + 0.44 sin a) - 0.41 (1 - exp(-17 / R))),

    and acts ahead of the center, towards the edge that the wind meets first, by 0.175 (1 - 2 a / pi) of the
    plate's length along the wind. R is the ratio of its longer side to the shorter one. A square plate across
    the wind has C_N = 1.17.

    Sources: for infinite span S. F. Hoerner, Fluid-Dynamic Lift, 2nd edition, 1985, chapter XXI, eq. (2);
    with the term in R C. Lindenburg, Stall Coefficients, ECN-RX--01-004, 2001; with 1.98 and the center of
    pressure W. Khan and M. Nahon, Real-time modeling of agile fixed-wing UAV aerodynamics, ICUAS 2015, pp.
    1188-1195, doi:10.1109/ICUAS.2015.7152411. The originals were not at hand: the formulas were checked
    against other programs that cite these works for them.

    Range: thin plates in free and steady flow of low Mach number, at Reynolds numbers above 1000, that is
    separated, at some 20 to 90 degrees; below, the same formula goes on smoothly to no force at 0.
    Assumptions beside the sources: R is that ratio for wind along either side; wind across a corner moves the
    center of pressure along each side by its component there; the flow follows w without delay, and the
    plate's rotation changes nothing but w; there is no friction along the plate, and neither the ground nor
    anything upwind is near. In the turbulence near the ground mean and peak loads of heliostats are larger
    than in such flow; their coefficients are in J. A. Peterka and R. G. Derickson, Wind Load Design Methods
    for Ground-Based Heliostats and Parabolic Dish Collectors, SAND92-7009, 1992. Here gusts are in `speed`.

    Attributes:
        name: unique among the forces of a scene; letters, digits, `_`, `.` and `-`.
        body: name of the body that the plate is a part of; not the ground.
        point: (3,) center of the plate in the world at the initial pose, m.
        first_side, second_side: (3,) m along the plate's sides, as long as these, perpendicular, in the world
            at the initial pose.
        direction: (3,) that the wind blows to, world frame, of any length.
        speed: m/s along `direction`, a number or a function of time.
        air_density: rho in kg/m^3, 0 or more.

    Raises:
        MechanismError: naming the wind load and the value at fault.

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
    number_fields: ClassVar = OnPoint.number_fields | {
        "direction": NumberField(shape=(3,), allowed="direction"),
        "speed": NumberField("m/s", may_be_function=True),
        "air_density": NumberField("kg/m^3", least=0.0, strength="wind"),
        "first_side": NumberField("m", shape=(3,), allowed="joint"),
        "second_side": NumberField("m", shape=(3,), allowed="joint"),
    }

    @np.errstate(all="ignore")  # squares overflow, and are refused
    def __post_init__(self) -> None:
        check_name(self.noun, self.name)
        check_texts(self.element, self, "body")
        self.set_numbers(self.element)
        for vector in ("first_side", "second_side", "direction"):
            given = getattr(self, vector)
            if not 0.0 < given @ given < LONG * LONG:
                problem = f"{vector} is {given.tolist()}"
                raise MechanismError(self.element, problem, f"a vector not of length 0, nor above {LONG:g}")
        cosine = float(self.first_side @ self.second_side) / self.area
        if abs(cosine) > SQUARE:
            problem = f"its sides have a cosine of {cosine:.3g}"
            raise MechanismError(self.element, problem, f"perpendicular sides, |cosine| at most {SQUARE:g}")

    def described_after(self, change: PoseChange) -> Self:
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
        """Unit vectors along the sides and the normal, columns (3, 3), in the world at the initial pose."""
        length, width = self.lengths
        first, second = self.first_side / length, self.second_side / width
        return np.column_stack([first, second, cross(first, second)])

    @property
    def end_loss(self) -> Scalar:
        """Loss of the normal force at the ends of the plate: 0.41 (1 - exp(-17 / R))."""
        length, width = self.lengths.tolist()
        if isinstance(length, float) and isinstance(width, float):
            shorter, longer = min(length, width), max(length, width)
        else:
            apart = sqrt((length - width) * (length - width) + SQUARE_FLOOR)
            shorter, longer = 0.5 * (length + width - apart), 0.5 * (length + width + apart)
        return END_LOSS * (1.0 - exp(-END_RATE * shorter / longer))

    def velocity(self, time: float) -> Array:
        """Compute the wind's velocity (3,), m/s, world frame, at a time in s."""
        speed = self.speed.value(time) if isinstance(self.speed, TimeFunction) else self.speed
        return np.asarray(speed / sqrt(self.direction @ self.direction) * self.direction)

    def parts(self, at: Surroundings) -> tuple[int, Array, Array, Array]:
        k = at.mechanism.body_index(self.body)
        pose, frame = at.poses[k], at.frames[k]
        arm = frame.rotation @ pose.point_to_body(self.point)
        axes = frame.rotation @ (pose.rotation.T @ self.axes)
        w = (self.velocity(at.time) - frame.velocity - cross(frame.angular_velocity, arm)) @ axes
        calm = CALM * CALM
        across, along = sqrt(w[2] * w[2] + calm), sqrt(w[0] * w[0] + w[1] * w[1] + calm)
        total = sqrt(across * across + along * along)
        slope = FACE_ON * (total / (ATTACHED * total + SEPARATED * across) - self.end_loss)
        push = 0.5 * self.area * self.air_density * slope * total * w[2]
        length, width = self.lengths
        lead = (LEAD * 2.0 / math.pi) * arctan2(along, across) / along
        force = axes[:, 2] * push
        center = axes[:, 0] * (-(length * lead * w[0])) + axes[:, 1] * (-(width * lead * w[1]))
        return k, force, cross(center, force), arm


@checked
def wind_gust(mean: float, gust: float, period: float = 10.5) -> Sum:
    """Make the speed of an extreme operating gust: a dip, a rise by 0.74 of `gust`, and a dip again.

    mean - 0.37 gust sin(3 pi t / T) (1 - cos(2 pi t / T)) for t from 0 to T, the standard IEC 61400-1 (2005)
    of wind turbines, as a sum of sines, which goes on after T: end runs there. The standard was not at hand;
    formula and T were checked against programs for wind turbines. Its gust is that at the hub, below 3.3
    standard deviations of the turbulence; for structures near the ground it is an assumption.

    Args:
        mean: m/s before and after.
        gust: m/s.
        period: T in s.

    Raises:
        ArgumentError: for a value that is no finite number.
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
@np.errstate(all="ignore")  # sines refuse what overflows
def wind_turbulence(
    mean: float,
    deviation: float,
    length: float,
    seed: Annotated[int, Range(0)],
    lowest: float = 0.01,
    highest: float = 10.0,
    count: Annotated[int, Range(1, MOST_SINES)] = 40,
) -> Sum:
    """Make the speed of turbulent wind of Kaimal's spectrum, one of many as chosen by a seed.

    S(f) = 4 s^2 (L / V) / (1 + 6 f L / V)^(5/3), of the component along the mean wind, as in an annex of
    IEC 61400-1, whose integral over all frequencies f is s^2. It becomes a sum of sines of random phases
    (M. Shinozuka and G. Deodatis, Simulation of stochastic processes by spectral representation, Applied
    Mechanics Reviews 44(4), 1991, pp. 191-204): of each part of the band one, of the part's variance. That
    parts are equal on a logarithmic scale, and frequencies random in them, is a choice made here: so the wind
    does not repeat, and few sines span a wide band. Wind beyond the band is left out.

    The standard was not at hand; spectrum, L and s were checked against programs for wind turbines. They are
    of hubs tens of meters above the ground: near the ground, as at 2 m, L proportional to the height is an
    assumption, and turbulence is often stronger.

    Args:
        mean: V in m/s.
        deviation: s in m/s; the standard's is I (0.75 V + 5.6 m/s), I = 0.16, 0.14, 0.12 for classes A, B, C.
        length: L in m; the standard's is 8.1 * 0.7 = 5.67 times the height above ground up to 60 m.
        seed: 0 or more; the same seed gives the same wind.
        lowest: Hz, of the band.
        highest: Hz.
        count: number of sines, 1 to `MOST_SINES`.

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
    below = 1.0 - (1.0 + 6.0 * edges * length / mean) ** (-2.0 / 3.0)
    amplitudes = deviation * np.sqrt(2.0 * np.diff(below))
    frequencies = edges[:-1] * (edges[1:] / edges[:-1]) ** rng.random(count)
    phases = 2.0 * np.pi * rng.random(count)
    waves = zip(amplitudes.tolist(), (2.0 * np.pi * frequencies).tolist(), phases.tolist(), strict=True)
    return Sum((Polynomial((mean,)), *(Sine(*wave) for wave in waves)))


def _check_positive(where: str, **values: float) -> None:
    for name, value in values.items():
        if not value > 0.0:
            raise MechanismError(where, f"{name} is {quoted(value)}", "a positive number")
