"""Comparison of two models of one mechanism, such as the MJCF and the URDF of one robot.

In: two models. Out: a `TwoModelComparison` with checks, notes and the verdict SAME or DIFFERENT. `align.py`
pairs bodies and joints by name, `levels.py` makes the checks of the equations, `unsimulated.py` compares
elements that are not simulated, and `compare.py` puts the parts together. Start reading at `compare_models`
in `compare.py`.
"""
