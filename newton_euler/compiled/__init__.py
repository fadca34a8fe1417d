"""Compiled scenes: traced equations, their outputs, and runs one by one or in lanes.

`equations` traces the equations of a scene and compiles them. `run` binds them to an integrator and runs from
a state to a table of states, `lanes` does so for several runs at once, and `outputs` computes the arrays that
the scene asks for. `failures` explains runs that stop early. `evaluated` integrates equations that Python
evaluates, as Pinocchio's are. Start reading with `run`.
"""
