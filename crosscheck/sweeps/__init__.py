"""Sweeps: many runs of one scene, their inputs drawn from distributions, their outputs reduced and stored."""
