"""Runs of scenes, from the initial state to a trajectory.

`simulate` runs a scene once, `batch` many times, and `assemble` finds consistent states. A run is divided
into `intervals` between knots and samples of `controllers`. For batches, `variation` checks values of
parameters, and `starts` closes the mechanism with them. Start reading with `simulate`.
"""
