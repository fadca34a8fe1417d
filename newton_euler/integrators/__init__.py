"""Integrators of the equations of motion, projection onto the constraints, and singular configurations.

Each integrator takes two records of `stepper`: the compiled equations of a scene and a table of runs. It
writes the states at the output times and ends each run with a `Status`. `dop853` and `radau` choose their
steps; `fixed_step` has RK4 and Euler. `projection` keeps closed loops closed. `singular` describes how steps
pass configurations where the constraints become dependent. Start reading with `stepper`.
"""
