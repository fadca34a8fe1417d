"""Comparison of engines: checks by level, from the model to whole runs, and the conclusions from them.

In: a scene (and the import report of a model file) and the engines. Out: a `Crosscheck` (`result.py`) with
all checks (`check.py`), the outlier (`diagnosis.py`), the elements that the motion tests (`coverage.py`) and
advice. Start reading at `crosscheck` in `crosscheck.py`, then `levels.py` and `runs.py`.
"""
