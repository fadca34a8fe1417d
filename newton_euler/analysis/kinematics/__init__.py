"""Poses, assembly branches, singular poses and workspace of a mechanism."""
