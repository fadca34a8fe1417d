"""A sweep as a Rerun recording: its nominal run, its extreme ones as ghosts, and envelopes of many over time.

Entities:
    /ground                 shapes of the fixed body
    /mechanism/RUN/BODY     shapes, and the body's pose over time, of the nominal run and of each extreme one
    /plots/K/LINE           envelope K: `least`, `5 %`, `median`, `95 %` and `most` of a sample, and each run
    /sweep                  the tables, as text
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.recording.blueprint import laid_out, scene_view, send_layout
from crosscheck.recording.log import PLAIN_COLOR, log_bodies, log_ground, log_text, send_columns
from crosscheck.recording.shapes import Style
from crosscheck.support.palette import palette, rgb
from crosscheck.sweeps.analysis import QUANTILE_LEVELS
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

THIN, THICK = 1.0, 2.0
"""Widths of lines, points: of envelopes, and of runs."""


@dataclass(frozen=True, eq=False)
class Envelope:
    """A number of many runs over time.

    Attributes:
        title: the number and its unit.
        times: (n,) s.
        sample: (runs, n) of a sample of runs; not a number where a run could not go on.
        lines: (n,) of some runs by name.
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
    """Log all there is to see of a sweep, and how the viewer lays it out.

    Args:
        scene: with its nominal values, by which bodies are drawn.
        runs: by name, the nominal one first.
        envelopes: drawn beside them.
        text: Markdown.
        title: of the recording.
    """
    mechanism = scene.mechanism
    log_text(recording, "/sweep", text)
    first, colors = next(iter(runs.values())), palette(list(runs))
    log_ground(recording, mechanism, first)
    for name, run in runs.items():
        style = Style(rgb(colors[name]), THICK, ghost=run is not first)
        log_bodies(recording, ["mechanism", name], mechanism, run, style)
    for number, envelope in enumerate(envelopes):
        _log_envelope(recording, f"{number}", envelope, colors)
    heading = f"{title}: {next(iter(runs))} solid, extreme runs as ghosts"
    view = scene_view(mechanism, first, heading, ["+ /ground/**", "+ /mechanism/**"])
    plots = [
        rrb.TimeSeriesView(origin=f"/plots/{number}", name=envelope.title)
        for number, envelope in enumerate(envelopes)
    ]
    told = rrb.TextDocumentView(origin="/sweep", name="Sweep")
    left = rrb.Vertical(view, told, row_shares=[1.6, 1.0])
    whole = rrb.Horizontal(left, rrb.Vertical(*plots)) if plots else left
    send_layout(recording, laid_out(whole, float(first.time[-1])))
    recording.send_recording_name(title)


def _log_envelope(
    recording: rr.RecordingStream, number: str, envelope: Envelope, colors: Mapping[str, str]
) -> None:
    known = envelope.sample[np.isfinite(envelope.sample).all(axis=1)]
    lines: dict[str, tuple[Array, rr.SeriesLines]] = {}
    for name, level in QUANTILE_LEVELS.items():
        if len(known):
            look = rr.SeriesLines(colors=PLAIN_COLOR, names=name, widths=THIN)
            lines[name] = np.quantile(known, level, axis=0), look
    for name, values in envelope.lines.items():
        lines[name] = values, rr.SeriesLines(colors=rgb(colors[name]), names=name, widths=THICK)
    for name, (values, look) in lines.items():
        path = rr.new_entity_path(["plots", number, name])
        recording.log(path, look, static=True)
        send_columns(recording, path, envelope.times[: len(values)], rr.Scalars.columns, scalars=values)
