"""Analyses of a mechanism that need no run."""
