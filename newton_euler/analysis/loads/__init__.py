"""Equilibrium, inverse dynamics and load envelopes."""
