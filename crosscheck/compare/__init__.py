"""Comparison of engines: levels, energy, reactions, reference values."""
