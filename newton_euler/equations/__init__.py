"""Equations of motion of a scene, in joint coordinates and in Cartesian coordinates of all bodies.

`relative` and `cartesian` are the two forms; `formulation` has what they share. `couplings` adds gears and
prescribed motions. `redundancy` decides which constraints are redundant, `sparse` and `dense` solve the
linear equations, `parameters` names the numbers of a scene that may vary. Start reading with `system`.
"""
