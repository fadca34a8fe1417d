"""Engines: simulators behind one interface, newton_euler, MuJoCo and Pinocchio by default.

In: a scene. Out: trajectories, and the rigid equations of motion of each engine. An `Engine` (`engine.py`)
bundles the functions of a simulator with its expected errors; a package of this folder makes it for each
default engine. `registry.py` has the engines by name, and finds those of other packages. `adaptive.py`
chooses integrator and tolerances of runs, by `stiffness.py`. `benchmarks.py` and `stress.py` are the parts of
the interface for studies. `engine_runs.py` runs all engines and collects failures. Start reading at `Engine`
in `engine.py`.
"""
