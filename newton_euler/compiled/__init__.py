"""Compiled scenes: equations of motion of a scene as native code, and integration of that code over time.

`equations` traces the equations of a scene: Python evaluates them once over symbolic scalars, and the
recorded operations are compiled. `run` binds the compiled equations to an integrator, which turns an initial
state into a table of states. `lanes` integrates several runs side by side, one in each lane of a vector
register. `outputs` computes the arrays that the scene asks for. `failures` explains runs that stop early.
`evaluated` integrates equations that Python evaluates, such as Pinocchio's. Start reading with `run`.
"""
