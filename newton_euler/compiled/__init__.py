"""Compiled scenes: traced equations, their outputs, and runs one by one or in lanes."""
