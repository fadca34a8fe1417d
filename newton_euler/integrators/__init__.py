"""Integrators, projection onto the constraints, and passing singular configurations."""
