"""Studies of crosscheck and the engines themselves: benchmarks, stress tests, fault injection, public models.

The input is a scene or a list of model files; the output is a report, a table or a plot. Except for the
commands that start a study, no other package imports this one. Start reading at the package of a study:
`benchmark/` (run times), `stress/` (limits of the engines), `faults/` (fault injection), `conformance/` (does
an engine follow the conventions of comparisons). `models.py` runs public model files, `paper_figures.py`
plots the figures of a paper, `random_scenes.py` generates mechanisms.
"""
