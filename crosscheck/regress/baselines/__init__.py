"""Baselines of the library scenes, one JSON file per scene, which `crosscheck regress` reads."""
