"""Benchmarks: run time of every engine at its best settings, against the error of its motion.

In: a scene. Out: a table, JSON and a plot. Four benchmarks share the clock (`timing.py`), the settings of
each engine (`ladders.py`) and the motion from which errors are measured (`reference.py`): whole runs
(`work_precision.py`), one right-hand side (`rhs.py`), batches (`batch.py`) and parameter sensitivities
(`sensitivities.py`). Start reading at `run.py`, whose table `KINDS` names them.
"""
