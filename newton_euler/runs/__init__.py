"""Runs of scenes, from the initial state to a trajectory.

`simulate` runs a scene once, `batch` runs a scene many times, and `assemble` finds consistent initial states.
A run restarts at the knots of functions of time and at the sampling instants of `controllers`; `intervals`
divides the run there. For batches, `variation` checks values of parameters, and `starts` closes the loops of
the mechanism with them. Start reading with `simulate`.
"""
