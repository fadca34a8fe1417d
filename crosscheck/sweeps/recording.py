"""Record a sweep for the Rerun viewer: the nominal run, extreme runs as ghosts, and envelopes of many runs
over time.

A sweep simulates a scene many times with varied parameters. Each run has results, such as the peak of an
actuator force. The nominal run has the parameters of the scene. An extreme run has the largest or smallest
value of a result. A ghost is a transparent copy of the bodies. An envelope shows quantiles, over many runs,
of the time series that a result is computed from.

Entities (paths of logged data in the recording):
    /ground                 shapes of the fixed body
    /mechanism/RUN/BODY     shapes and poses over time, of the nominal run and of each extreme run
    /plots/K/LINE           envelope K: the quantiles `min`, `5 %`, `median`, `95 %`, `max`; single runs
    /sweep                  the tables, as text
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.engines.palette import palette
from crosscheck.recording.blueprint import make_layout, scene_view, send_layout
from crosscheck.recording.entities import PLAIN_COLOR, log_bodies, log_ground
from crosscheck.recording.shapes import Style
from crosscheck.recording.stream import log_text, send_columns
from crosscheck.support.colors import rgb
from crosscheck.sweeps.kept_numbers import QUANTILE_LEVELS
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

ENVELOPE_WIDTH, RUN_WIDTH = 1.0, 2.0
"""Widths of the lines of envelopes and of runs, points."""


@dataclass(frozen=True, eq=False)
class Envelope:
    """A time series of many runs, such as an actuator force over time.

    Attributes:
        title: name and unit of the result that is computed from the time series.
        times: (n,) s, output times.
        sample: (runs, n) values in a random sample of the runs; NaN after the time at which a run failed.
        lines: (n,) values in the nominal run and in each extreme run, by name of the run.
    """

    title: str
    times: Array
    sample: Array
    lines: Mapping[str, Array]


def log_sweep(
    recording: rr.RecordingStream,
    scene: Scene,
    runs: Mapping[str, Trajectory],
    envelopes: Sequence[Envelope],
    text: str,
    title: str,
) -> None:
    """Log the runs and envelopes of a sweep, and the layout of the viewer.

    Args:
        recording: the recording to log to.
        scene: scene with nominal values, whose bodies are drawn.
        runs: runs by name. The first one (the nominal run, unless it failed) is drawn solid, others as
            ghosts.
        envelopes: envelopes, drawn next to the mechanism.
        text: report of the sweep in Markdown.
        title: title of the recording.
    """
    mechanism = scene.mechanism
    log_text(recording, "/sweep", text)
    first, colors = next(iter(runs.values())), palette(list(runs))
    log_ground(recording, mechanism, first)  # its pose is the same in all runs
    for name, run in runs.items():
        style = Style(rgb(colors[name]), RUN_WIDTH, ghost=run is not first)
        log_bodies(recording, ["mechanism", name], mechanism, run, style)
    for number, envelope in enumerate(envelopes):
        _log_envelope(recording, f"{number}", envelope, colors)
    # Layout of the viewer: the mechanism above the report, plots on the right
    heading = f"{title}: {next(iter(runs))} solid, extreme runs as ghosts"
    view = scene_view(mechanism, first, heading, ["+ /ground/**", "+ /mechanism/**"])
    plots = [
        rrb.TimeSeriesView(origin=f"/plots/{number}", name=envelope.title)
        for number, envelope in enumerate(envelopes)
    ]
    report_view = rrb.TextDocumentView(origin="/sweep", name="Sweep")
    left = rrb.Vertical(view, report_view, row_shares=[1.6, 1.0])
    whole = rrb.Horizontal(left, rrb.Vertical(*plots)) if plots else left
    send_layout(recording, make_layout(whole, duration=float(first.time[-1])))
    recording.send_recording_name(title)


def _log_envelope(
    recording: rr.RecordingStream, number: str, envelope: Envelope, colors: Mapping[str, str]
) -> None:
    """Log the quantiles of an envelope and the lines of its single runs.

    Args:
        recording: the recording to log to.
        number: number of the envelope, a part of the path of its entities.
        envelope: the envelope.
        colors: color of each single run, by name.
    """
    known = envelope.sample[np.isfinite(envelope.sample).all(axis=1)]
    lines: dict[str, tuple[Array, rr.SeriesLines]] = {}
    for name, level in QUANTILE_LEVELS.items():
        if len(known):
            look = rr.SeriesLines(colors=PLAIN_COLOR, names=name, widths=ENVELOPE_WIDTH)
            lines[name] = np.quantile(known, level, axis=0), look
    for name, values in envelope.lines.items():
        lines[name] = values, rr.SeriesLines(colors=rgb(colors[name]), names=name, widths=RUN_WIDTH)
    for name, (values, look) in lines.items():
        path = rr.new_entity_path(["plots", number, name])
        recording.log(path, look, static=True)
        send_columns(recording, path, envelope.times, rr.Scalars.columns, scalars=values)
