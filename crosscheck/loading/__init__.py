"""Models and scene files loaded with the options of commands."""
