"""Runs of scenes: starts, simulation, sampled controllers, batches, variation."""
