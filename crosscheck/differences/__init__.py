"""Comparison of two model files of one robot: what differs, by how much, and what it does to the motion."""
