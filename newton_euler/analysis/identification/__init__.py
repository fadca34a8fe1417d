"""Parameters of a scene fitted to measured motion."""
