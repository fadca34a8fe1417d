"""Helpers that all of crosscheck shares: errors, result files, time limits, worker processes, colors."""
