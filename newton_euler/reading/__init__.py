"""Pieces that every reader of model files shares.

A reader (`mjcf`, `urdf`) turns a model file into a `Scene` and fills an `ImportReport` with the fate of every
element. `verify` then compares the scene with a `ReferenceModel`, the same file as an independent parser
compiles it. `activity` finds limits and contacts that would have acted in a run, `excitation` adds start
velocities and sines, `plausibility` reports likely mistakes. Start reading at `import_report` and `verify`.
"""
