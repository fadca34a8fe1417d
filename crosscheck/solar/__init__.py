"""Solar tracking: positions of the sun, set-points that face the sun, and the motion of a tracker over a day.

In: a tracker scene, a place, a date and rules of tracking. Out: a `Day` with set-points, motion, pointing
error, loads and energy, and the report on it. The package needs the optional dependencies `sun` (pvlib and
pandas). Start reading at `day.py`: `tracker_day` computes the set-points and simulates the day.
"""
