"""Loads: `inverse_dynamics`, `statics`, `equilibrium`, and `load_envelope` over runs and load cases."""
