"""Moves of a tracker's actuators from set-point to set-point, with limits of speed and acceleration.

A set-point has a position of each actuator. In a move all actuators start and arrive together, and their
positions change in proportion: the mechanism goes straight from one set-point to the next in its joint
coordinates. The speed profile is a trapezoid, see `newton_euler.Moves`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from newton_euler.model.splines import Moves
from newton_euler.scalars import Array

MIN_MOVE = 1e-9
"""Smallest change of a set-point, m or rad, for which the actuators move."""

SAMPLES = 14
"""Number of output times in each part of a move: acceleration, constant speed, deceleration, and a time as
long as the move in which the mechanism settles. They are densest at the begin of a part, where the
acceleration of the set-points jumps, so that forces and works of the transient are seen."""

REST_SAMPLES = 10
"""Number of output times of a rest. They halve the time since its begin again and again."""

MAX_SAMPLES = 60_000
"""Number of output times of a day above which each part of a move and each rest has fewer."""


class Plan(NamedTuple):
    """The m moves of a day with n set-points.

    Attributes:
        target: (m,) index of the set-point at which each move ends.
        begin, end: (m,) s, times of each move.
        ramp: (m,) s, duration of the acceleration, and of the deceleration, of each move.
    """

    target: Array
    begin: Array
    end: Array
    ramp: Array

    def function(self, values: Array) -> Moves:
        """Return the function of time that has the values (n,) of the set-points at rest.

        Positions of an actuator give its target; forces that hold the set-points give its feedforward.
        """
        times, points, ramps = [0.0], [values[0]], list[float]()
        for target, begin, end, ramp in zip(*self, strict=True):
            if begin > times[-1]:  # a rest
                ramps.append(0.5 * (begin - times[-1]))
                times.append(begin)
                points.append(points[-1])
            times.append(end)
            points.append(values[target])
            ramps.append(ramp)
        if len(times) < 2:
            times, points, ramps = [0.0, 1.0], [values[0], values[0]], [0.5]
        return Moves(times, points, ramps)

    def is_moving(self, times: Array) -> Array:
        """Return an array (k,) that is True for the times (k,), s, inside of a move."""
        last = np.searchsorted(self.begin, times, side="left") - 1
        return np.asarray((last >= 0) & (times < np.append(self.end, -np.inf)[last]))

    def heading(self, times: Array) -> Array:
        """Return the index (k,) of the set-point of the last move that began before each time (k,), s."""
        return np.concatenate([[0], self.target])[np.searchsorted(self.begin, times, side="left")]

    def samples(self, times: Array) -> Array:
        """Return output times, s: those of the set-points (n,), and others in and after each move."""
        settled = 2.0 * self.end - self.begin
        corners = (self.begin, self.begin + self.ramp, self.end - self.ramp, self.end, settled)
        events = np.unique(np.concatenate([times, *corners]))
        events = events[events <= times[-1]]
        begins, spans = events[:-1], np.diff(events)
        # a span is of a move if its middle is before the time at which the last move has settled
        middles = begins + 0.5 * spans
        last = np.searchsorted(self.begin, middles) - 1
        in_move = (last >= 0) & (middles < np.append(settled, -np.inf)[last])
        wanted = SAMPLES * np.sum(in_move) + REST_SAMPLES * np.sum(~in_move)
        fewer = min(1.0, MAX_SAMPLES / wanted)
        in_parts = np.linspace(0.0, 1.0, max(1, int(SAMPLES * fewer)), endpoint=False) ** 3
        in_rests = np.append(0.0, 0.5 ** np.arange(1, int(REST_SAMPLES * fewer)))
        samples = [
            (begins[which] + spans[which] * fractions[:, None]).ravel()
            for which, fractions in ((in_move, in_parts), (~in_move, in_rests))
        ]
        return np.unique(np.concatenate([*samples, times[-1:]]))


def plan_moves(times: Array, set_points: Array, speed: float, acceleration: float) -> Plan:
    """Plan the moves between set-points.

    A move begins at the time of its set-point, or when the move before it ends. Set-points that are replaced
    by later ones in the meantime are left out.

    Args:
        times: (n,) s, times of the set-points, ascending from 0.
        set_points: (n, a) m or rad, positions of the actuators.
        speed: largest speed, m/s or rad/s.
        acceleration: largest acceleration, m/s^2 or rad/s^2.
    """
    moves: list[tuple[int, float, float, float]] = []
    free_at, position = times[0], set_points[0]
    for k in range(1, len(times)):
        is_replaced = k + 1 < len(times) and times[k + 1] <= free_at
        begin = max(times[k], free_at)
        distance = float(np.max(np.abs(set_points[k] - position)))
        if is_replaced or begin >= times[-1] or distance < MIN_MOVE:
            continue
        # the actuator with the longest way has a trapezoid, or a triangle if its largest speed is not reached
        if acceleration * distance > speed * speed:
            ramp = speed / acceleration
            duration = distance / speed + ramp
        else:
            ramp = math.sqrt(distance / acceleration)
            duration = 2.0 * ramp
        free_at, position = begin + duration, set_points[k]
        moves.append((k, begin, free_at, ramp))
    target, begins, ends, ramps = np.array(moves).reshape(-1, 4).T
    return Plan(target.astype(int), begins, ends, ramps)
