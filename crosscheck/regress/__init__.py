"""Regression tests of scenes and model files: measured quantities are compared with a stored baseline."""
