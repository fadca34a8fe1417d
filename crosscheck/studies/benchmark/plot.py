"""Work-precision diagrams of a benchmark, as a picture and as a Rerun recording.

Both show run time over error, each engine's settings as points and those that none of its others beats
as a line. Rerun has no logarithmic axes, so its coordinates are decades.
"""

from __future__ import annotations

import io
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.figures import STYLES
from crosscheck.studies.benchmark.engines import ENGINES, Benchmark
from crosscheck.studies.benchmark.report import as_json, frontier, markdown
from crosscheck.studies.benchmark.work_precision import Measurement
from newton_euler.model.trajectory import atomic_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DECADE = np.array([100.0, 200.0])
"""Length of a decade of error and of time in Rerun's view."""

SMALLEST = 1e-16
"""Errors are drawn no smaller than this, m or rad: zero has no logarithm."""


def figure(result: Benchmark) -> Figure:
    """Run time (s) over error (m and rad), both logarithmic."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(7.5, 5.0), layout="constrained")
    ax = drawn.add_subplot()
    for engine in ENGINES:
        color = STYLES[engine][0]
        points = [m for m in result.measured.measurements if m.engine == engine]
        best = frontier(points, engine)
        ax.plot(*_columns(points), ".", color=color, markersize=4, alpha=0.3)
        ax.plot(*_columns(best), ".-", color=color, markersize=7, label=engine)
    ax.axvline(result.reference.uncertainty, color="0.5", linestyle=":", label="uncertainty of the reference")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.invert_xaxis()
    ax.set_xlabel("largest error of all bodies and output times, m and rad")
    ax.set_ylabel("run time, s")
    ax.set_title(f"{result.title}: {result.scene.duration:g} s, {len(result.scene.times)} outputs")
    ax.grid(which="major", alpha=0.3)
    ax.legend()
    return drawn


def _columns(points: list[Measurement]) -> tuple[list[float], list[float]]:
    return [max(m.error, SMALLEST) for m in points], [m.median for m in points]


def recording(result: Benchmark, error: float) -> bytes:
    """The diagram and the tables as an .rrd."""
    import rerun as rr
    import rerun.blueprint as rrb

    rr.set_strict_mode(True)
    stream = rr.RecordingStream("crosscheck_bench", recording_id=uuid.uuid4())
    # in memory first: the writer's own thread would wait for ever on a disk that is full
    memory = stream.memory_recording()
    diagram = rrb.Spatial2DView(
        origin="/work_precision", name=f"{result.title}: run time (s) over error (m, rad)"
    )
    text = rrb.TextDocumentView(origin="/tables", name="Tables")
    stream.send_blueprint(
        rrb.Blueprint(rrb.Horizontal(diagram, text), collapse_panels=True), make_active=False
    )
    stream.send_recording_name(f"bench {result.title}")
    document = rr.TextDocument(markdown(result, error), media_type=rr.MediaType.MARKDOWN)
    stream.log("/tables", document, static=True)
    for engine in ENGINES:
        points = [m for m in result.measured.measurements if m.engine == engine]
        if not points:
            continue
        color = tuple(int(STYLES[engine][0][k : k + 2], 16) for k in (1, 3, 5))
        best = frontier(points, engine)
        path = rr.new_entity_path(["work_precision", engine])
        labels = [f"{engine}: {m.name}, {m.error:.1e} in {m.median * 1e3:.3g} ms" for m in points]
        dots = rr.Points2D(_places(points), colors=color, radii=1.5, labels=labels, show_labels=False)
        stream.log(f"{path}/settings", dots, static=True)
        line = rr.LineStrips2D([_places(best)], colors=color, radii=0.8, labels=[engine])
        stream.log(f"{path}/best", line, static=True)
    _log_axes(stream, result.measured.measurements)
    return bytes(memory.drain_as_bytes())


def _places(points: list[Measurement]) -> np.ndarray:
    """(n, 2): smaller errors to the right, longer times up, which is Rerun's minus y."""
    errors, times = _columns(points)
    return -DECADE * np.log10(np.stack([errors, times], axis=1))


def _log_axes(stream: object, points: tuple[Measurement, ...]) -> None:
    """A labelled tick for each decade of error and time."""
    import rerun as rr

    places = _places(list(points)) / DECADE
    low, high = np.floor(places.min(axis=0)), np.ceil(places.max(axis=0))
    errors = np.arange(low[0], high[0] + 1.0)
    times = np.arange(low[1], high[1] + 1.0)
    ticks = [[x, high[1] + 0.3] for x in errors] + [[low[0], y] for y in times]
    labels = [f"1e{int(-x)}" for x in errors] + [f"1e{int(-y)} s" for y in times]
    axes = rr.Points2D(DECADE * np.array(ticks), colors=(128, 128, 128), radii=1.0, labels=labels)
    stream.log("/work_precision/axes", axes, static=True)  # type: ignore[attr-defined]


def write(result: Benchmark, folder: Path, error: float) -> list[Path]:
    """Write `FILES` into a folder.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    written = []
    for name, content in FILES.items():
        path = folder / name
        made = content(result, error)
        try:
            with atomic_file(path) as temporary:
                temporary.write_bytes(made)
        except OSError as failed:
            raise CrosscheckError(f"cannot write {path}: {failed.strerror}") from failed
        written.append(path)
    return written


def _json(result: Benchmark, error: float) -> bytes:
    return as_json(result, error).encode()


def _png(result: Benchmark, error: float) -> bytes:
    picture = io.BytesIO()
    figure(result).savefig(picture, dpi=130, format="png")
    return picture.getvalue()


FILES: dict[str, Callable[[Benchmark, float], bytes]] = {
    "bench.json": _json,
    "work_precision.png": _png,
    "bench.rrd": recording,
}
"""What is written, by name."""
