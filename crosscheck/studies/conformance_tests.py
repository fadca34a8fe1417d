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
from crosscheck.studies.conformance.candidate import Candidate
from crosscheck.studies.conformance.check import POINTS, REQUIRED, Result, check_point


class EngineConformance:
    """Base class of tests: a subclass gives the engine.

    A point that the engine refuses is skipped, unless it is one of `REQUIRED`, which every engine can show.
    """

    engine: ClassVar[Engine]
    candidate: ClassVar[Candidate]

    def __init_subclass__(cls) -> None:
        """Let the points of an engine share its runs."""
        super().__init_subclass__()
        cls.candidate = Candidate(cls.engine)

    @pytest.mark.parametrize("point", POINTS)
    def test_point(self, point: str) -> None:
        """Check one point."""
        found = check_point(self.candidate, point)
        if found.result is Result.REFUSED and point not in REQUIRED:
            pytest.skip(found.why)
        assert found.result is Result.HOLDS, str(found)
