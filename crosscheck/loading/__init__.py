"""Loading: scenes of the library, scene files and model files (MJCF, URDF), with the options of a command.

In: a name, a path or a model in memory, and options as texts. Out: a `Scene` and, for a model file, an
`ImportReport`. `model_files.py` reads model files, `convert.py` writes them, `size.py` limits the size of
scenes. Start reading at `load_scene` in `load.py`.
"""
