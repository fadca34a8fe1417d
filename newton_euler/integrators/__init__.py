"""Integrators, projection onto the constraints, and passing singular configurations.

All methods take a state and the records of `stepper`: the native functions of a scene and a table of runs.
They write states at the output times and return a `Status`. `dop853` and `radau` choose their steps,
`fixed_step` has RK4 and Euler. `projection` keeps states on the constraints, `singular` explains what is done
near singular configurations. The functions are in the native subset of `codegen`. Start with `stepper`.
"""
