"""Equations of motion in both formulations, and the linear algebra and rank decisions they need."""
