"""Parts of the URDF reader, which `urdf.reader` calls in order.

`source` and `vocabulary` check a file. `extensions` reads elements that tools add to URDF. `given` takes
models in memory. `start` closes loops. `bodies`, `loops`, `forces` and `visuals` turn elements into elements
of a scene.
"""
