"""Comparison of engines: levels, energy, reactions, known figures."""
