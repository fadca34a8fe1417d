"""Compares engines on closed-loop mechanisms: scenes, comparison, recordings, figures."""
