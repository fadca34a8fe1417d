"""Elements of a model file that are not simulated: whether they act in a run, and since when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from crosscheck.engines.engine import native_method
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.reading.activity import SampledMotion
from newton_euler.reading.import_report import CONTACTS, ImportedElement, ImportReport
from newton_euler.runs.simulate import simulate

CLOSER_OUTPUTS = (8, 64)
"""Factors by which outputs are closer in further runs, made while elements may act between outputs.

Their errors are of fourth order in the output period: a factor of 8 divides them by 4096."""

MOST_ACTING = 2
"""Elements that a verdict names of those that act and are not simulated."""


def watched(scene: Scene, mapping: ImportReport, run: Trajectory) -> ImportReport:
    """Return an import report with what a run of the scene shows of elements that are not simulated.

    If the outputs of the run are too far apart to tell, newton_euler repeats the run with closer ones.

    Args:
        scene: as it was read from the file.
        mapping: what became of the elements of the file.
        run: of the scene, with velocities.
    """
    found = mapping.after(SampledMotion(scene, run))
    for factor in CLOSER_OUTPUTS:
        if not found.unsettled:
            break
        closer = replace(scene, output_period=scene.output_period / factor, outputs=frozenset({"velocities"}))
        try:
            finer = simulate(closer, **native_method(closer, refined=False))
        except StoppedError as error:
            if error.partial is None or len(error.partial.time) < len(run.time):
                break
            finer = error.partial
        except NewtonEulerError:
            break
        found = found.after(SampledMotion(closer, finer))
    return found


def watched_in_own_run(scene: Scene, mapping: ImportReport) -> ImportReport:
    """Return an import report with what newton_euler's run of the scene shows of it."""
    try:
        run = simulate(scene, **native_method(scene, refined=False))
    except StoppedError as error:
        if error.partial is None:
            return mapping.unwatched()
        run = error.partial
    except NewtonEulerError:
        return mapping.unwatched()
    return watched(scene, mapping, run)


def acted(entry: ImportedElement) -> str:
    """Word an element that acted in a run: which, since when, and by how much a limit was passed."""
    passed = f" {entry.seen}" if entry.seen.startswith("passed") else f" from {entry.since:.4g} s on"
    return f"{what_acted(entry)}{passed}"


def reduction(acting: Sequence[ImportedElement]) -> str:
    """Word the elements that acted and were not simulated, and which part of the run is the file's.

    Args:
        acting: at least one element, in order of time.
    """
    more = f"; and {len(acting) - MOST_ACTING} more" if len(acting) > MOST_ACTING else ""
    named = f"not simulated: {'; '.join(map(acted, acting[:MOST_ACTING]))}{more}"
    if not (until := acting[0].since):
        return f"{named}. The whole run is of the file without these"
    return f"{named}. The run is of the file until {until:.4g} s, then of the file without these"


def what_acted(entry: ImportedElement) -> str:
    """Word which element acted."""
    if entry.topic == CONTACTS:
        return CONTACTS
    named = entry.element.endswith(entry.topic)  # as "option density" of topic "density", and without a topic
    return entry.element if named else f"{entry.topic} of {entry.element}"
