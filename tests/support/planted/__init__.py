"""Study of planted differences: change public model files in known ways, and judge what `diff` reports."""
