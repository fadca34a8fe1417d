"""Parts of the MJCF reader, which `mjcf.reader` calls in order.

`source` checks and compiles a file. `start` closes its loops. `bodies`, `joints`, `loops`, `forces` and
`actuators` turn elements of the compiled model into elements of a scene. `force_limits` and `leftovers`
report elements that are not simulated, `plausibility` reports likely mistakes. `laws` excites actuators.
"""
