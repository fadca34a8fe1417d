"""Linearization, modes and optimal feedback."""
