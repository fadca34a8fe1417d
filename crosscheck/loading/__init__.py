"""Loading of models: scenes of the library, scene files (YAML, JSON) and model files (MJCF, URDF).

In: a name, a path or a model in memory, and options as texts. Out: a `Scene` and, for a model file, an
`ImportReport` with the fate of every element of the file. `model_files.py` reads model files, `convert.py`
writes them, and `size.py` limits the size of scenes. Start reading at `load_scene` in `load.py`.
"""
