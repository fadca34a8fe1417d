"""Does an engine follow the contract of `crosscheck.engines.engine.Engine`? The answer, point by point.

Each point runs the engine on small scenes (`scenes.py`, `element_scenes.py`) and compares one convention,
such as the order of quaternions or the body that a reaction acts on, with a closed form (`closed_forms.py`)
or with newton_euler's run at tight tolerances. The points are in `conventions.py` (what the numbers of a run
mean), `elements.py` (joints, loops and control), `applied.py` (forces, prescribed motions and rotors) and
`runs.py` (settings, refined runs, errors and runs that stop). A `Candidate` (`candidate.py`) keeps the runs
of the engine. Start reading at `check.py`, which lists all points, checks them and makes the report.
"""
