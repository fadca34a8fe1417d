"""Points of the contract of an engine as tests of pytest, for packages that register an engine.

Example of a test file:

    from crosscheck.studies.conformance_tests import EngineConformance
    from my_package import ENGINE

    class TestMyEngine(EngineConformance):
        engine = ENGINE
"""

from __future__ import annotations

from typing import ClassVar

import pytest

from crosscheck.engines.engine import Engine
from crosscheck.studies.conformance import POINTS, Result, check_point


class EngineConformance:
    """Base class of tests: a subclass gives the engine. A point that the engine refuses is skipped."""

    engine: ClassVar[Engine]

    @pytest.mark.parametrize("point", POINTS)
    def test_point(self, point: str) -> None:
        """Check one point."""
        found = check_point(self.engine, point)
        if found.result is Result.REFUSED:
            pytest.skip(found.why)
        assert found.result is Result.HOLDS, found.why
