"""Fault injection: inject single faults into a model, and measure which ones crosscheck detects and locates.

The input is a scene or a model file. The output is the detection rate, the location rate, and every missed
fault with its reason. `catalog.py` and `misreadings.py` list the faults, `injection.py` makes scenes with one
fault, `velocity_terms.py` makes faulty equations, `find.py` searches for the faults, and `report.py`
tabulates the results. Start reading at `find_faults` in `find.py`.
"""
