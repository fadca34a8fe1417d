"""Verification of what was read from a model file, see `newton_euler.reading.verify`."""
