"""Engines: newton_euler, MuJoCo and Pinocchio behind one interface.

In: a scene. Out: trajectories, and the rigid equations of motion of each engine. An `Engine` (`engine.py`)
bundles the functions that simulate a scene with its expected errors; `ENGINES` is the registry.
`stiffness.py` chooses integrator and step, `engine_runs.py` runs all engines and collects failures. Start
reading at `Engine` in `engine.py`.
"""
