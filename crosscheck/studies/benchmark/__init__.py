"""Benchmarks: run time of every engine at its best settings, against the error of its motion.

The input is a scene, the output a table, JSON and (for whole runs) a plot. There are four benchmarks: whole
runs (`work_precision.py`), one evaluation of the equations of motion (`rhs.py`), batches of runs
(`batch.py`), and parameter sensitivities (`sensitivities.py`). They share the timing of calls (`timing.py`),
the benchmarks of each engine (`crosscheck.engines.benchmarks`) and the reference motion (`reference.py`).
Start reading at `run.py`, whose table `KINDS` lists the benchmarks.
"""
