"""The errors of the harness."""

from __future__ import annotations


class CrosscheckError(Exception):
    """Base of every error that `crosscheck` raises on purpose; reads as one line."""
