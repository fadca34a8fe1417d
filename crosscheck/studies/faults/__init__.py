"""Faults planted in one engine's model, and what the comparison makes of them."""

PLANTED_IN = ("newton_euler", "mujoco", "pinocchio")
"""Engines that faults are planted in."""
