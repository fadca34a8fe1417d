"""Judgements of own runs: of a model file with its own settings in its own engine."""

from __future__ import annotations

from collections.abc import Sequence

from crosscheck.compare.activity import acting_events, watched_in_new_run
from crosscheck.own_run.judge import Judgement, judge
from newton_euler.model.scene import Scene
from newton_euler.reading.file_run import Event
from newton_euler.reading.import_report import ImportReport


def acting_in(scene: Scene, report: ImportReport) -> Sequence[Event]:
    """Return the elements that act in the motion of a scene and that it does not have."""
    return acting_events(watched_in_new_run(scene, report))


def judged_run(scene: Scene, report: ImportReport | None) -> Judgement:
    """Judge the own run of a file, as crosschecks do."""
    assert report is not None
    assert report.simulation is not None
    return judge(report.simulation, acting_in(scene, report))
