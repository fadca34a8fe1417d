"""Faults planted in one engine's model, and what the comparison makes of them."""
