"""Sweeps: Monte Carlo and design-of-experiments studies of a scene.

In: a scene, distributions of parameters (`--vary`), and outputs to keep of each run (`--keep`). Out: a Zarr
store with all runs, their distributions, sensitivities (rank correlation, Sobol indices), plots, and
crosschecks of some runs. A `SweepPlan` (`plan.py`) defines all runs; `execute.py` runs them, `store.py`
stores them, `analysis.py` and `report.py` evaluate them. Start reading at `sweep` in `sweep.py`.
"""
