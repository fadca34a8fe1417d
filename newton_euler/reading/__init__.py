"""Parts that the readers of model files share: import report, verification, excitation, plausibility.

A reader (package `mjcf` or `urdf`) turns a model file into a `Scene` and fills an `ImportReport`, which lists
how each element of the file was imported. `verify` then compares the scene with a `ReferenceModel`, the same
file as an independent parser compiles it. `activity` finds limits and contacts that would have acted in a
run, `excitation` adds start velocities and sines, `plausibility` reports likely mistakes in the file. Start
reading at `import_report` and `verify`.
"""
