"""Loading of models: scenes of the library, scene files (YAML, JSON) and model files (MJCF, URDF).

In: a name, a path or a model in memory, and options as texts. Out: a `Scene` and, for a model file, an
`ImportReport`, which lists how every element of the file was imported. `load.py` loads, with the readers of
`crosscheck.library`, and `convert.py` writes files. Start reading at `load_scene` in `load.py`.
"""
