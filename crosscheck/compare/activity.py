"""Elements of a model file that are not simulated: whether they would act in a run, and from which time on.

crosscheck simulates rigid bodies, joints and forces. Contacts, joint limits and dry friction of a file are
not simulated. In: the import report of a file (how each element was imported) and a run. Out: the report with
the time from which each element that is not simulated would have acted, and sentences about these elements
for the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from crosscheck.engines.engine import native_options
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.reading.activity import SampledMotion
from newton_euler.reading.import_report import CONTACTS, ImportedElement, ImportReport
from newton_euler.runs.simulate import simulate

CLOSER_OUTPUTS = (8, 64)
"""Factors on the number of outputs in repeated runs, if elements may act between the outputs of the first
run.

The motion is interpolated between outputs. Errors of the interpolation are of order 4 in the output period: a
factor of 8 divides them by 4096."""

MAX_NAMED = 2
"""Largest number of elements that a verdict names."""


def watched(scene: Scene, mapping: ImportReport, run: Trajectory) -> ImportReport:
    """Return an import report that shows whether elements that are not simulated would act in a run.

    If the outputs of the run are too far apart to decide, newton_euler repeats the run with closer outputs.

    Args:
        scene: scene that was imported from the file.
        mapping: import report: how each element of the file was imported.
        run: run of the scene, with velocities.
    """
    report = mapping.after(SampledMotion(scene, run))  # judged for the motion of the run
    for factor in CLOSER_OUTPUTS:
        if not report.unsettled:  # elements for which the outputs are too far apart
            break
        closer = replace(scene, output_period=scene.output_period / factor, outputs=frozenset({"velocities"}))
        try:
            finer = simulate(closer, **native_options(closer, refined=False))
        except StoppedError as error:
            if error.partial is None or len(error.partial.time) < len(run.time):
                break
            finer = error.partial
        except NewtonEulerError:
            break
        report = report.after(SampledMotion(closer, finer))
    return report


def watched_in_new_run(scene: Scene, mapping: ImportReport) -> ImportReport:
    """Simulate a scene in newton_euler and return the import report of `watched` for the new run.

    Without a run, all elements that can act count as acting from the start.
    """
    try:
        run = simulate(scene, **native_options(scene, refined=False))
    except StoppedError as error:
        if error.partial is None:
            return mapping.unwatched()
        run = error.partial
    except NewtonEulerError:
        return mapping.unwatched()
    return watched(scene, mapping, run)


def acted(entry: ImportedElement) -> str:
    """Format an element that would have acted: its name, and the time or by how much a limit was passed."""
    when = f" {entry.seen}" if entry.seen.startswith("passed") else f" from {entry.since:.4g} s on"
    return f"{what_acted(entry)}{when}"


def reduction(acting: Sequence[ImportedElement]) -> str:
    """Format the elements that would have acted, and the part of the run before that.

    Args:
        acting: elements that are not simulated and would have acted, in order of time; at least one.
    """
    more = f"; and {len(acting) - MAX_NAMED} more" if len(acting) > MAX_NAMED else ""
    named = f"not simulated: {'; '.join(map(acted, acting[:MAX_NAMED]))}{more}"
    if not (until := acting[0].since):
        return f"{named}. The whole run is of the file without these"
    return f"{named}. The run is of the file until {until:.4g} s, then of the file without these"


def what_acted(entry: ImportedElement) -> str:
    """Return the name of an element for sentences, such as "limits of joint 'pivot'"."""
    if entry.topic == CONTACTS:
        return CONTACTS
    # "option density" already contains its topic "density"; a topic may also be empty
    named = entry.element.endswith(entry.topic)
    return entry.element if named else f"{entry.topic} of {entry.element}"
