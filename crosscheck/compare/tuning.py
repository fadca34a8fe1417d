"""Search the cheapest settings of a model's engine, on the motion of the scene that was imported.

In: the import report of a model, which has the model in its own engine. Out: a `SettingsSearch`, for the
command `crosscheck tune` and for `crosscheck.tune`.
"""

from __future__ import annotations

from collections.abc import Callable

from crosscheck.compare.activity import acting_events, watched_in_new_run
from crosscheck.own_run.allowed import AllowedError, ErrorKind
from crosscheck.own_run.tune import SettingsSearch, search_settings
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import limited
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportReport


def with_engine(source: str, import_report: ImportReport | None) -> ImportReport:
    """Return the import report of a model that has an engine of its own, or raise `CrosscheckError`.

    Args:
        source: name or file of the model.
        import_report: import report; None for a scene of crosscheck's own.
    """
    if import_report is None or import_report.simulation is None:
        raise CrosscheckError(f"{source} has no settings of an engine; needed: an MJCF or URDF model")
    return import_report


def target_of(error: float | str, name: str) -> AllowedError:
    """Read an error to reach: a fraction of the motion below 1, or a text such as "position=1mm".

    Args:
        error: the number or text.
        name: name of the option or argument, for messages.

    Raises:
        CrosscheckError: for an unknown error, unit or number.
    """
    target = AllowedError.parse(str(error), name)
    if target.kind is ErrorKind.RELATIVE and target.largest >= 1.0:
        raise CrosscheckError(
            f"{name} {error}: needed: a fraction of the motion below 1, such as 1e-3 or 0.1%"
        )
    return target


def tune_model(
    scene: Scene, import_report: ImportReport, target: AllowedError, progress: Callable[[str], None]
) -> SettingsSearch:
    """Search the cheapest settings that reach an error.

    Args:
        scene: scene that was imported from the model.
        import_report: import report of the model, which has an engine of its own.
        target: error to reach.
        progress: shows a message to the user before each run.

    Raises:
        NewtonEulerError: if the scene has no reference solution.
        TooLongError: if the search exceeds the limit of processor time.
    """
    assert import_report.simulation is not None
    # added to the error message if the search exceeds its limit of processor time
    advice = "a larger error or a shorter duration may end"
    with limited("tuning", advice, progress):
        # elements that the reference does not simulate although they act, such as dry friction
        acting = acting_events(watched_in_new_run(scene, import_report))
        return search_settings(import_report.simulation, target, acting, progress)
