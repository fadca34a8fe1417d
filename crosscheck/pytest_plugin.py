"""A pytest fixture that crosschecks models in anybody's test suite.

def test_arm(crosscheck):
    arm = crosscheck("arm.xml")
    arm.assert_agrees()  # all engines
    arm.assert_unchanged()  # the baseline that `pytest --crosscheck-update REASON` stored beside it
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from crosscheck.verdict import Verdict

UPDATE = "--crosscheck-update"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that stores baselines."""
    group = parser.getgroup("crosscheck")
    group.addoption(UPDATE, metavar="REASON", help="Store the baselines of assert_unchanged() anew, and why.")


@contextmanager
def _failing() -> Iterator[None]:
    """Fail a test with the error of a block, as of a missing file or an unknown engine, in one line."""
    from crosscheck.support.errors import CrosscheckError
    from newton_euler.errors import NewtonEulerError

    __tracebackhide__ = True
    problem = ""
    try:
        yield
    except (CrosscheckError, NewtonEulerError) as error:
        problem = str(error)
    if problem:  # out of the block above, whose error would be reported as well
        pytest.fail(problem, pytrace=False)


class Checked:
    """A crosscheck of a model within a test.

    Attributes:
        verdict: what was found.
        folder: where trajectories, figures and the recording are kept if the test fails.
        reason: why baselines are stored anew; None to compare with them.
        home: the folder of the test, where baselines of models in memory are.
    """

    def __init__(self, verdict: Verdict, folder: Path, reason: str | None, home: Path) -> None:
        self.verdict, self.folder, self.reason, self.home = verdict, folder, reason, home

    def assert_agrees(self, allow_reduced: bool = False) -> None:
        """Fail, naming level, body and the engine that differs, unless all engines agree.

        Args:
            allow_reduced: whether elements of the file may act that are not simulated.
        """
        __tracebackhide__ = True
        if not self.verdict.outcome.passes(allow_reduced):
            *_, recording = self.verdict.save(self.folder)
            pytest.fail(f"{self.verdict}\nlook: crosscheck view {recording}", pytrace=False)

    def assert_unchanged(self) -> None:
        """Fail, naming what moved, unless the figures of newton_euler are those of the stored baseline.

        It is beside a model file, and beside the test for a model in memory, by the name of its scene.
        """
        from crosscheck.regress.compare import compare
        from crosscheck.regress.report import tables
        from crosscheck.regress.run import Guarded, guard, update
        from crosscheck.report.render import terminal

        __tracebackhide__ = True
        found = self.verdict.crosscheck
        if found.source:
            with _failing():
                guarded = guard(found.source, dict(found.options))
        else:
            scene, path = found.scene, self.home / f"{found.scene.name}.baseline.json"
            guarded = Guarded(scene.name, dict(found.options), scene, path, found.mapping)
        if self.reason is not None:
            update([guarded], self.reason, lambda stage: None)
        elif not guarded.path.exists():
            pytest.fail(f"no baseline {guarded.path}; pytest {UPDATE} REASON stores it", pytrace=False)
        else:
            with _failing():
                comparison = compare(guarded.scene, guarded.baseline(), lambda stage: None, guarded.mapping)
            if comparison.moved:
                pytest.fail(f"{terminal(tables([comparison]))}{comparison.verdict}", pytrace=False)


@pytest.fixture
def crosscheck(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., Checked]:
    """Crosscheck a model: `crosscheck("arm.xml", key="home")`, arguments as of `crosscheck.check`.

    A file is looked for beside the test first.
    """
    from crosscheck.verdict import check

    reason = request.config.getoption(UPDATE)

    def checked(model: Any, *engines: Any, **options: Any) -> Checked:
        __tracebackhide__ = True
        if isinstance(model, str | os.PathLike) and (beside := request.path.parent / model).is_file():
            model = beside
        with _failing():
            verdict = check(model, *engines, **options)
        return Checked(verdict, tmp_path / "crosscheck", reason, request.path.parent)

    return checked
