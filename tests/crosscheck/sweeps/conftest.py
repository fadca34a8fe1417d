"""A small sweep that several tests compare with, and chunks that make several tasks of it."""

from __future__ import annotations

import pytest
from small_sweep import ARGUMENTS

import crosscheck.sweeps.results
from crosscheck import sweep


@pytest.fixture
def short_tasks(monkeypatch):
    """Tasks of few runs."""
    monkeypatch.setattr(crosscheck.sweeps.results, "_task_size", lambda plan, at, progress: 7)


@pytest.fixture(scope="session")
def reference():
    """The small sweep in one task."""
    return sweep(*ARGUMENTS, threads=1)
