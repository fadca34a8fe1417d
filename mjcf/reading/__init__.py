"""Parts of the MJCF reader.

`source` checks and compiles a file, `start` closes its loops, and `bodies`, `joints`, `loops`, `forces` and
`actuators` turn elements of the compiled model into elements of a scene. `leftovers` reports everything that
is not simulated, `plausibility` likely mistakes, `laws` excites actuators. `mjcf.reader` calls them in order.
"""
