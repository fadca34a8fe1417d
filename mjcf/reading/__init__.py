"""Modules that import an MJCF file as a scene; `mjcf.reader` calls them in this order.

`source` checks and compiles a file. `start` closes its loops. `bodies`, `joints`, `loops`, `forces` and
`actuators` convert elements of the compiled model to elements of a scene. `laws` builds control laws and
excites actuators. `force_limits` and `leftovers` report elements that scenes do not simulate. `plausibility`
reports likely mistakes in the file. `softness` lists equalities whose softness `<default>` does not set.
"""
