"""Judge the simulation that a user makes: a model file in its own engine, with the settings of the file.

The room takes a file's run (`newton_euler.reading.file_run`), or the log of another simulator, and a
reference solution with a known error. It measures the error of the run (`errors`), finds the setting that
causes the error (`causes`), and tries settings that reduce it (`remedies`). Start reading in `judge`.
`tune` finds the cheapest settings for a given error.
"""
