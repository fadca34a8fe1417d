"""Solar tracking: positions of the sun, set-points that face the sun, and the energy of days and years.

In: a tracker scene, a place, a date and rules of tracking. Out: a `Day` with set-points, motion, pointing
error, loads and energy, or a `Year` with irradiation by month, and the reports on them. The package needs the
optional dependencies `sun` (pvlib and pandas). Start reading at `day.py`: `tracker_day` computes the
set-points and simulates the day; `tracker_year` in `year.py` sums the light over the weather of a year.
"""
