"""Fault injection: inject single faults into a model, and measure which faults the comparison detects and
locates.

In: a scene, or a model file. Out: the detection rate, the location rate, and every missed fault with its
reason. `catalog.py` and `misreadings.py` list the faults, `injection.py` makes a scene with one, `find.py`
searches for it and `report.py` tabulates the results. Start reading at `find_faults` in `find.py`.
"""

INJECTED_ENGINES = ("newton_euler", "mujoco", "pinocchio")
"""Engines into whose models faults are injected."""
