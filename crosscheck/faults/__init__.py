"""Faults planted in one engine's model, and what the comparison makes of them."""

PLANTED_IN = ("mujoco", "pinocchio")
"""Engines that faults are planted in; newton_euler is what they are compared with."""
