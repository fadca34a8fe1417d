"""Linear models: `linearize` about a state, their modes, and `lqr` for optimal feedback."""
