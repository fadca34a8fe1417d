"""Numbers for designers of a mechanism: loads, workspace, controllers, identified parameters.

In: a scene with the options of a command. Out: a `Report` and files (CSV, JSON, PNG, Rerun recording).
The numerics live in `newton_euler.analysis`; the modules here run them over the cases that a user names,
and lay out the results. Start reading at `loads.py`: `loads` runs load cases and writes their tables.
"""
