"""Parts of the URDF reader.

`source` and `vocabulary` check a file, `extensions` reads elements that tools add to URDF, `given` takes
models in memory, `start` closes loops, and `bodies`, `forces` and `visuals` turn elements into elements of a
scene. `urdf.reader` calls them in order.
"""
