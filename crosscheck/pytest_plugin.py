"""The pytest fixture `crosscheck`, by which a test suite verifies the dynamics of a model.

The fixture simulates a model in all engines. A test can require that the engines agree. A test can require a
small error of the run that the file's own engine makes with the time step and integrator of the file. A test
can also require the results of a baseline file, which `pytest --crosscheck-update REASON` writes:

    def test_arm(crosscheck):
        arm = crosscheck("arm.xml")
        arm.assert_agrees()
        arm.assert_accurate(1e-3)
        arm.assert_unchanged()
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

UPDATE_OPTION = "--crosscheck-update"
"""Command line option of pytest that stores baselines instead of comparing with them."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option `--crosscheck-update` to pytest; pytest calls this hook when it loads the plugin."""
    group = parser.getgroup("crosscheck")
    group.addoption(
        UPDATE_OPTION, metavar="REASON", help="Store new baselines for assert_unchanged(), with this reason."
    )


@contextmanager
def _errors_as_failures() -> Iterator[None]:
    """Fail the test with a one-line message if the block raises an error, such as for a missing file."""
    from crosscheck.support.errors import CrosscheckError
    from newton_euler.errors import NewtonEulerError

    __tracebackhide__ = True
    problem = ""
    try:
        yield
    except (CrosscheckError, NewtonEulerError) as error:
        problem = str(error)
    if problem:  # outside of the `except` block, whose error pytest would report as well
        pytest.fail(problem, pytrace=False)


class CheckedModel:
    """A model that the fixture has simulated in all engines, with assertions for a test.

    Attributes:
        verdict: result of the comparison of the engines.
        folder: folder that gets the trajectories, the checks and the 3-D recording if the test fails.
        reason: reason to store new baselines; None to compare with the stored ones.
        test_folder: folder of the test file, which has the baselines of models in memory.
    """

    def __init__(self, verdict: Verdict, folder: Path, reason: str | None, test_folder: Path) -> None:
        self.verdict, self.folder, self.reason, self.test_folder = verdict, folder, reason, test_folder

    def assert_agrees(self, allow_reduced: bool = False) -> None:
        """Fail the test unless all engines agree; the message names the engine that differs, and where.

        Args:
            allow_reduced: whether to pass if elements of the file act that crosscheck does not simulate, such
                as contacts.
        """
        __tracebackhide__ = True
        if not self.verdict.outcome.passes(allow_reduced):
            *_, recording = self.verdict.save(self.folder)
            pytest.fail(f"{self.verdict}\nlook: crosscheck view {recording}", pytrace=False)

    def assert_accurate(self, max_error: float | None = 1e-3, **limits: Any) -> None:
        """Fail the test if the run of the file's own engine and settings has a larger error than allowed.

        The message has the errors, the causes, and settings with a smaller error.

        Args:
            max_error: largest relative error, a fraction of the motion; None for no limit.
            limits: further arguments of `crosscheck.Verdict.assert_accurate`, such as `position=1e-3`, m.
        """
        __tracebackhide__ = True
        problem = ""
        with _errors_as_failures():
            try:
                self.verdict.assert_accurate(max_error, **limits)
            except AssertionError as error:
                problem = str(error)
        if problem:
            *_, recording = self.verdict.save(self.folder)
            pytest.fail(f"{problem}\nlook: crosscheck view {recording}", pytrace=False)

    def assert_unchanged(self, allow_reduced: bool = False) -> None:
        """Fail the test if results differ from the stored baseline; the message lists them.

        The test passes and fails as `crosscheck regress` does. It also fails if an engine of the baseline is
        not installed, and if elements of the file act that are not simulated.

        `pytest --crosscheck-update "REASON"` writes the baselines of all tests that it runs, instead of
        comparing with them. To write the baseline of one test, select the test: `pytest -k test_arm
        --crosscheck-update "lighter gripper"`.

        A new baseline has the default engines and those that the test names. The baseline of a model file is
        next to the file. That of a model in memory is next to the test, in SCENE.baseline.json.

        Args:
            allow_reduced: whether to pass if elements of the file act that crosscheck does not simulate, such
                as contacts.
        """
        from crosscheck.compare.outcome import Outcome
        from crosscheck.regress.report import tables
        from crosscheck.regress.run import (
            GuardedScene,
            check_baselines,
            engines_of,
            guard_scene,
            update_baselines,
        )
        from crosscheck.report.render import terminal

        __tracebackhide__ = True
        found = self.verdict.crosscheck
        # the scene with its baseline, which guards the scene against changes
        if found.source:
            with _errors_as_failures():
                guarded = guard_scene(found.source, dict(found.options))
        else:
            scene, path = found.scene, self.test_folder / f"{found.scene.name}.baseline.json"
            guarded = GuardedScene(
                source=scene.name,
                options=dict(found.options),
                scene=scene,
                path=path,
                import_report=found.mapping,
            )
        if self.reason is not None:
            # the baseline keeps its engines, and gets those of the test
            with _errors_as_failures():
                tested = [*(engine.name for engine in found.engines), *found.left_out]
                engines = list(dict.fromkeys([*engines_of(guarded), *tested]))
                update_baselines([guarded], self.reason, _no_progress, engines)
        elif not guarded.path.exists():
            pytest.fail(f"no baseline {guarded.path}; pytest {UPDATE_OPTION} REASON stores it", pytrace=False)
        else:
            with _errors_as_failures():
                (comparison,), recordings, _ = check_baselines(
                    [guarded], self.folder, _no_progress, left_out={}, allow_reduced=allow_reduced
                )
            if not comparison.outcome.passes(allow_reduced):
                lines = [f"{terminal(tables([comparison]))}{comparison.verdict}"]
                if comparison.outcome is Outcome.QUIET_ON_A_REDUCED_MODEL:
                    lines.append(f"{comparison.outcome}; to accept: assert_unchanged(allow_reduced=True)")
                if comparison.moved:
                    lines.append(f"to accept the change: pytest -k TEST {UPDATE_OPTION} REASON")
                lines += [f"look: crosscheck view {path}" for path in recordings.values()]
                lines.append(f"results: {self.folder}")
                pytest.fail("\n".join(lines), pytrace=False)


def _no_progress(_: str) -> None:
    """Ignore the name of a stage of the work, which commands show as progress."""


@pytest.fixture
def crosscheck(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., CheckedModel]:
    """Return a function that simulates a model in all engines: `crosscheck("arm.xml", key="home")`.

    Its arguments are those of `crosscheck.check`. The path of a model file is relative to the folder of the
    test, or else to the current folder.
    """
    from crosscheck.verdict import check

    reason = request.config.getoption(UPDATE_OPTION)

    def checked(model: Any, *engines: Any, **options: Any) -> CheckedModel:
        __tracebackhide__ = True
        if isinstance(model, str | os.PathLike) and (next_to_test := request.path.parent / model).is_file():
            model = next_to_test
        with _errors_as_failures():
            verdict = check(model, *engines, **options)
        return CheckedModel(verdict, tmp_path / "crosscheck", reason, request.path.parent)

    return checked
