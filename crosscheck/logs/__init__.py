"""Judge logs of other simulators and of test benches against the reference solution of a scene.

In: a scene and a table with a row per time. The room finds the quantity of each column (`names`, `columns`).
It computes poses of bodies (`poses`) and the state of the first row (`start`), from which it simulates the
reference with the inputs of the log (`inputs`, `reading`). Out: a `LogJudgement` with the error of the logged
bodies, and with readings of the columns that fit far better (`mistakes`). Start reading in `judge`.
"""
