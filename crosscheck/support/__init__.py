"""Errors, files, time limits, processes and colors that all rooms share."""
