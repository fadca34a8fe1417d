"""Studies: benchmarks, stress tests, fault injection, public models, and the paper's figures.

In: a scene or a list of files. Out: reports, tables and plots about crosscheck and the engines themselves,
not about one model. No other room imports a study. Start reading at the package of a study: `benchmark/`,
`stress/`, `faults/`; `models.py` runs public model files, `random_scenes.py` generates random mechanisms.
"""
