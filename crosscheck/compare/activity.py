"""Elements of a model file that are not simulated: whether they would act in a run, and from which time on.

crosscheck simulates rigid bodies, joints and forces. Contacts, joint limits and dry friction of a file are
not simulated. An element that would have acted makes the simulated model a *reduced model* of the file.

In: the import report of a file (how each element was imported) and a run. The report has tests of elements in
a run, its *watches*. Out: the report with the time from which each element that is not simulated would have
acted, and sentences about these elements for the verdict.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from crosscheck.engines.adaptive import newton_euler_options
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.reading.activity import SampledMotion
from newton_euler.reading.file_run import Event
from newton_euler.reading.import_report import CONTACTS, ImportedElement, ImportReport
from newton_euler.runs.simulate import simulate

CLOSER_OUTPUTS = (8, 64)
"""Factors on the number of outputs in repeated runs, if elements may act between the outputs of the first
run.

The motion is interpolated between outputs. Errors of the interpolation are of order 4 in the output period: a
factor of 8 divides them by 4096."""

MAX_NAMED = 2
"""Largest number of elements that a verdict names."""


def watched(scene: Scene, report: ImportReport, run: Trajectory) -> ImportReport:
    """Watch a run: return an import report that shows whether elements not simulated would act in the run.

    If the outputs of the run are too far apart to decide, newton_euler repeats the run with closer outputs.

    Args:
        scene: scene that was imported from the file.
        report: import report: how each element of the file was imported.
        run: run of the scene in any engine, with velocities.
    """
    report = report.after(SampledMotion(scene, run))  # judged for the motion of the run
    for factor in CLOSER_OUTPUTS:
        if not report.unsettled:  # elements for which the outputs are too far apart
            break
        closer = replace(scene, output_period=scene.output_period / factor, outputs=frozenset({"velocities"}))
        try:
            repeated = simulate(closer, **newton_euler_options(closer))
        except StoppedError as error:
            # a shorter run does not show whether elements act after its end
            end = run.time[-1] - 0.5 * closer.output_period
            if error.partial is None or error.partial.time[-1] < end:
                break
            repeated = error.partial
        except NewtonEulerError:
            break
        report = report.after(SampledMotion(closer, repeated))
    return report


def watched_in_new_run(scene: Scene, report: ImportReport) -> ImportReport:
    """Simulate a scene in newton_euler and return the import report of `watched` for the new run.

    Without a run, all elements that can act count as acting from the start.
    """
    try:
        run = simulate(scene, **newton_euler_options(scene))
    except StoppedError as error:
        if error.partial is None:
            return report.unwatched()
        run = error.partial
    except NewtonEulerError:
        return report.unwatched()
    return watched(scene, report, run)


def acted(entry: ImportedElement) -> str:
    """Format an element that would have acted: its name, and from which time on."""
    # the observation of a limit has the time: "passed from 0.3 s on, by up to 0.1 rad"
    when = f" {entry.seen}" if entry.seen.startswith("passed") else f" from {entry.since:.4g} s on"
    return f"{what_acted(entry)}{when}"


def reduced_model_text(acting: Sequence[ImportedElement]) -> str:
    """State which elements would have acted, and from when on the run is of the file without them.

    Args:
        acting: elements that are not simulated and would have acted, in order of time; at least one.
    """
    more = f"; and {len(acting) - MAX_NAMED} more" if len(acting) > MAX_NAMED else ""
    named = f"not simulated: {'; '.join(map(acted, acting[:MAX_NAMED]))}{more}"
    if not (until := acting[0].since):  # 0: the first element acts from the start
        return f"{named}. The whole run is of the file without these"
    return f"{named}. The run is of the file until {until:.4g} s, then of the file without these"


def acting_events(report: ImportReport) -> list[Event]:
    """Return the first action of each element that acts and is not simulated, in the order of time."""
    return [Event(each.since, what_acted(each)) for each in report.acting if each.since is not None]


def what_acted(entry: ImportedElement) -> str:
    """Return the name of an element for sentences, such as "limits of joint 'pivot'"."""
    if entry.topic == CONTACTS:
        return CONTACTS
    # "option density" already contains its topic "density"; a topic may also be empty
    named = entry.element.endswith(entry.topic)
    return entry.element if named else f"{entry.topic} of {entry.element}"
