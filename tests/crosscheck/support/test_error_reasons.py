"""Reasons of errors in one line."""

from __future__ import annotations

from crosscheck.support.errors import reason_of


def test_causes_that_form_a_circle_have_an_end():
    """Libraries in C can make each of two errors the cause of the other."""
    first, second = ValueError("bad"), KeyError("worse")
    first.__cause__, second.__cause__ = second, first
    assert reason_of(first) == "internal error: ValueError: bad"


def test_a_lack_of_memory_is_found_in_a_cause():
    error = ValueError("bad")
    error.__cause__ = MemoryError()
    assert reason_of(error) == "not enough memory: bad"
