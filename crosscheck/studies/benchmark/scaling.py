"""One right-hand side of each engine over the size of a scene: how time and memory grow."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from crosscheck.errors import CrosscheckError
from crosscheck.figures import STYLES
from crosscheck.scenes import SCENES
from crosscheck.scenes.options import options_of
from crosscheck.studies.benchmark.engines import JUDGED
from crosscheck.studies.benchmark.rhs import WAYS, Timing, Way, fastest_other, time_right_hand_sides
from crosscheck.studies.benchmark.work_precision import Progress, machine

SIZES = (1, 10, 100, 1000)
"""What the scene's option `OPTION` is set to in turn."""

OPTION = "N"

LIMIT = 180.0
"""s that loading a right-hand side may take in a fresh process. What fails is not tried at larger sizes."""


@dataclass(frozen=True)
class Scaling:
    """What was found: the timings of each size; `options` are the scene's others."""

    source: str
    options: Mapping[str, str]
    machine: dict[str, Any]
    timings: Mapping[int, tuple[Timing, ...]]

    def of(self, way: Way) -> dict[int, Timing]:
        """The timings of one way at the sizes at which it ran."""
        return {
            size: t
            for size, timings in self.timings.items()
            for t in timings
            if (t.engine, t.way) == way and t.times
        }

    def growth(self, way: Way) -> Iterator[tuple[int, int, float]]:
        """Exponent p of time ~ N^p between each size and the next."""
        for (small, first), (large, second) in pairwise(self.of(way).items()):
            yield small, large, math.log(second.median / first.median) / math.log(large / small)


def check_sizable(source: str, options: Mapping[str, str]) -> None:
    """Raise `CrosscheckError` for a scene without the option, or with it set already."""
    if source not in SCENES or OPTION not in options_of(SCENES[source]):
        sizable = [name for name, scene in SCENES.items() if OPTION in options_of(scene)]
        raise CrosscheckError(f"scene {source!r} has no option {OPTION}; choose from: {', '.join(sizable)}")
    if OPTION in options:
        raise CrosscheckError(f"--scaling sets {OPTION} itself")


def measure_sizes(source: str, options: Mapping[str, str], progress: Progress) -> Scaling:
    """Time every right-hand side at each of `SIZES`; `progress` is told each stage.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked.
    """
    where = machine()
    ways = list(WAYS)
    timings = {}
    for size in SIZES:
        found = time_right_hand_sides(
            source,
            {**options, OPTION: str(size)},
            lambda message, size=size: progress(f"{OPTION} = {size}: {message}"),  # type: ignore[misc]
            ways,
            LIMIT,
        )
        timings[size] = tuple(found)
        ways = [(t.engine, t.way) for t in found if not t.reason]
    return Scaling(source, options, where, timings)


# Report


def scaling_table(result: Scaling) -> Table:
    """A line for each way to call an engine: time, peak memory and growth by size."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("engine")
    table.add_column("right-hand side")
    for size in result.timings:
        table.add_column(f"us, {OPTION} = {size}", justify="right")
    table.add_column("growth", justify="right")
    for size in result.timings:
        table.add_column(f"MB, {OPTION} = {size}", justify="right")
    for way in WAYS:
        ran = result.of(way)
        if not ran:
            continue
        table.add_row(
            *way,
            *(f"{ran[size].median * 1e6:.4g}" if size in ran else "-" for size in result.timings),
            ", ".join(f"{power:.2f}" for _, _, power in result.growth(way)),
            *(f"{ran[size].memory / 1e6:.0f}" if size in ran else "-" for size in result.timings),
        )
    return table


def scaling_words(result: Scaling) -> list[str]:
    """How newton_euler's time grows, what it is in units of the fastest other's, and what could not run."""
    where = result.machine
    lines = [
        f"machine: {where['processor']}, {where['cores']} cores, load {where['load']}; growth: exponents "
        f"between sizes; MB: peak of a fresh process, loading in at most {LIMIT:g} s"
    ]
    for way in WAYS:
        if way[0] == JUDGED:
            parts = [f"{p:.2f} from {a} to {b}" for a, b, p in result.growth(way)]
            lines.append(f"{JUDGED} ({way[1]}) grows with exponents {', '.join(parts) or '-'}")
    for size, timings in result.timings.items():
        best = fastest_other(timings)
        for t in timings:
            if t.reason:
                lines.append(f"{OPTION} = {size}: {t.engine} ({t.way}) cannot run: {t.reason}")
            elif t.engine == JUDGED and best is not None:
                ratio = t.median / best.median
                lines.append(
                    f"{OPTION} = {size}: {t.engine} ({t.way}) takes {ratio:.3g} times as long as "
                    f"{best.engine} ({best.way})"
                )
    return lines


def scaling_json(result: Scaling) -> bytes:
    """Everything measured, as JSON text."""
    content = {
        "source": result.source,
        "options": dict(result.options),
        "machine": result.machine,
        "sizes": {size: [asdict(t) for t in timings] for size, timings in result.timings.items()},
        "growth": {", ".join(way): list(result.growth(way)) for way in WAYS},
        "words": scaling_words(result),
    }
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def scaling_picture(result: Scaling) -> bytes:
    """Time (s) and peak memory (MB) over size, all logarithmic, as a PNG."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(10.0, 4.5), layout="constrained")
    times, memory = drawn.subplots(1, 2)
    dashes = {way: ("-", "--")[k % 2] for k, way in enumerate(WAYS)}  # each engine has two ways
    for way in WAYS:
        ran = result.of(way)
        style = {"color": STYLES[way[0]][0], "linestyle": dashes[way], "marker": "."}
        times.plot(list(ran), [t.median for t in ran.values()], label=" ".join(way), **style)
        memory.plot(list(ran), [t.memory / 1e6 for t in ran.values()], **style)
    for ax, label in ((times, "one right-hand side, s"), (memory, "peak memory, MB")):
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlabel(f"{OPTION} of {result.source}")
        ax.set_ylabel(label)
        ax.grid(which="major", alpha=0.3)
    times.legend(fontsize="small")
    picture = io.BytesIO()
    drawn.savefig(picture, dpi=130, format="png")
    return picture.getvalue()
