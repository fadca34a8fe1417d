"""Recordings for the Rerun viewer, and pictures of them."""
