"""Text of the judgement of the "own run": its error, the causes, and settings that reduce the error.

The own run is the run of a model file (such as an MJCF) in the file's engine, with the time step, integrator
and solver settings of the file. It is compared with a reference solution of higher accuracy. In: a
`Judgement`. Out: lines of text.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from crosscheck.own_run.allowed import AllowedError, elements_text, found_text, in_unit, length
from crosscheck.own_run.errors import (
    MAX_ANGLE_SCALE,
    NO_MOTION,
    Band,
    LoopError,
    MechanismMotion,
    MotionScale,
    RunError,
)
from crosscheck.own_run.horizon import MAX_ERROR_GROWTH
from crosscheck.own_run.judge import Judgement, is_plural
from crosscheck.own_run.remedies import MeasuredRemedy
from crosscheck.own_run.stability import ModelChange, Stability
from crosscheck.report.line_name import LineName
from crosscheck.report.table import Cell, Lines, Rows
from crosscheck.support.name_lists import first_names
from crosscheck.support.units import SECONDS_AND_MS, quantity_text, significant
from newton_euler.reading.file_run import OF_UNSTABLE_MODES, Event, LoopNeed
from newton_euler.reading.import_report import LIMITS
from newton_euler.reading.small_motions import MovingBody

OF_APPROXIMATIONS = "unexplained, or that of friction and limits, which are soft constraints in your run"
"""Cause of most of an error, if the reference has dry friction or limits of the file as forces."""

APPROXIMATION_REMAINS = "these settings do not change friction and limits, soft constraints in your run"
"""Reason why an error remains if the reference has dry friction or limits of the file as forces."""

OWN_MOTION = "without that: --set excitation=off"
"""Option that judges the motion without the inputs and initial velocities that crosscheck adds."""

MIN_CAUSE = 0.01
"""Smallest error by a cause that is listed, divided by the error of the largest cause."""

MAX_ELEMENTS = 3
"""Largest number of elements that a line names."""

FAST_MODE = 0.5
"""Smallest product of the time step, s, and the rate, 1/s, of a stable mode that is reported: a time constant
of two steps."""

HEAVY_NEIGHBOR = 100.0
"""Smallest ratio of the mass of a neighbor and the mass of a body that is reported."""

ROUND_OFF = 1e-12
"""Relative error that counts as round-off. Errors of a time step are far above it."""

SAME_RUN_TIME = 1.25
"""Largest ratio of two run times that count as the same."""


def own_run_lines(
    judgement: Judgement,
    excitation: str = "",
    allowed: Sequence[AllowedError] = (),
    start_changes: Sequence[str] = (),
) -> list[Lines]:
    """Format a judgement, the result first, then that of the run without what the reference does not have.

    Args:
        judgement: the judgement.
        excitation: line of the import report on inputs and velocities that the file does not have.
        allowed: largest errors that the user allows.
        start_changes: changes of the file's start that satisfy the constraints.
    """
    lines = list(_lines(judgement, excitation, allowed, start_changes))
    found = [Lines(title="", lines=lines, verdict=judgement.band.verdict)]
    if reduced := judgement.without:
        lines = [f"{without_text(judgement)}  {headline(reduced)}"]
        if reduced.is_judged and not judgement.is_judged:  # else the first block has the extent of the motion
            lines.append(LineName.RUN.line(_extent(reduced)))
        lines += _measured_lines(reduced)
        found.append(Lines(title="", lines=lines, verdict=reduced.band.verdict))
    return found


def without_text(judgement: Judgement) -> str:
    """Name the elements without which the second run is judged."""
    return f"{LineName.WITHOUT} {elements_text(judgement.events)}"


def _lines(
    judgement: Judgement, excitation: str, allowed: Sequence[AllowedError], start_changes: Sequence[str]
) -> Iterator[str]:
    """Yield the lines of a judgement: a headline, then indented lines that begin with a keyword."""
    # a file without settings of a run, such as a URDF, is judged with usual settings, which are assumed
    name = LineName.USUAL_SETTINGS if judgement.are_assumed else LineName.YOUR_SETTINGS
    yield f"{name}  {headline(judgement)}"
    extent = f"; {_extent(judgement)}" if judgement.is_judged or judgement.rests else ""
    yield LineName.RUN.line(f"{judgement.settings} ({judgement.engine}){extent}")
    motion = (
        f"{excitation}; {OWN_MOTION}" if excitation else "the start and the constant controls of the file"
    )
    yield LineName.MOTION.line("; ".join([motion, *start_changes]))
    yield from allowed_lines(judgement, allowed)
    if judgement.events and judgement.is_judged:
        text = unsimulated_text(judgement.events)
        # a run that is compared to the end, although something acts, does not have these elements either
        is_ended = judgement.until is not None
        yield LineName.NOTE.line(
            f"compared until then: {text}" if is_ended else f"{text}, nor does your loop"
        )
    if judgement.only_in_run:
        yield LineName.NOTE.line(_only_in_run_text(judgement.only_in_run))
    if judgement.approximated:
        yield LineName.NOTE.line(_approximated_text(judgement.approximated))
    yield from map(LineName.NOTE.line, needs_texts(judgement.needs))
    if judgement.unjudged_from is not None:
        yield LineName.NOTE.line(
            f"judged until {judgement.unjudged_from:.3g} s, as the run has too many time steps"
        )
    if judgement.extended_to is not None:
        reason = "as the duration of the scene is too few time steps"
        yield LineName.NOTE.line(f"judged until {judgement.extended_to:.3g} s, {reason}")
    yield from _measured_lines(judgement)


def needs_texts(needs: Sequence[LoopNeed]) -> Iterator[str]:
    """Yield what a user's own loop lacks unless the user adds it, with the remedies."""
    for need in needs:
        yield f"needed in your loop, too: {first_names(need.elements, most=MAX_ELEMENTS)}; {need.remedy}"


def _measured_lines(judgement: Judgement) -> Iterator[str]:
    """Yield the lines with the errors of a run, their causes, and settings with smaller errors."""
    error = judgement.error
    if judgement.stopped:
        yield LineName.STOPPED.line(judgement.stopped)
    elif error.position or error.rotation:
        yield LineName.ERRORS.line("; ".join(error_texts(error, judgement.loop_error)))
    if chaos := chaos_text(judgement.scale):
        yield LineName.NOTE.line(f"{chaos}, and no run with other steps can match")
    if causes := _causes(judgement):
        yield LineName.CAUSE.line("; ".join(causes))
        if judgement.has_separated:
            yield LineName.continued(
                "the error is about as large as the motion, so causes do not add up: judge a shorter duration"
            )
        if judgement.errors_cancel:
            cancelling = "these errors partly cancel: the removal of one alone can make the run worse"
            yield LineName.continued(cancelling)
    if judgement.stability is not None:
        for k, line in enumerate(_stability(judgement.stability)):
            yield LineName.MODE.line(line) if k == 0 else LineName.continued(line)
    for k, fix in enumerate(fix_texts(judgement)):
        yield LineName.FIX.line(fix) if k == 0 else LineName.continued(fix)
    if (best := judgement.smallest) is not None:
        smallest = f"the smallest error is {_sizes_as(judgement, best)} ({percent(best.relative)})"
        forces = f"; {APPROXIMATION_REMAINS}" if judgement.approximated else ""
        stiffer = f"; {stiffer_limits_text(judgement.stiffer_limits)}" if judgement.stiffer_limits else ""
        yield LineName.FIX.line(
            f"none: no settings that were tried halve the error; {smallest}{forces}{stiffer}"
        )


def fix_texts(judgement: Judgement) -> list[str]:
    """Format settings with a smaller error, and changes of the model with which the time step is stable."""
    settings = [_remedy(remedy, judgement) for remedy in judgement.remedies]
    return settings + [_model_change(change) for change in judgement.changes]


def allowed_lines(judgement: Judgement, allowed: Sequence[AllowedError]) -> Iterator[str]:
    """Yield a line with the allowed errors that a judged run does not exceed, if there are any."""
    if judgement.judged and (met := [each for each in allowed if not each.is_exceeded_by(judgement)]):
        limits = ", ".join(f"{each.kind} {in_unit(each.largest, each.kind)}" for each in met)
        yield LineName.ALLOWED.line(f"{limits}: met")


def own_run_cases(judgement: Judgement | None, allowed: Sequence[AllowedError]) -> Rows:
    """Make the rows of test cases: each allowed error, or else the judgement, which no limit makes fail.

    Args:
        judgement: the judgement; None if the run could not be judged.
        allowed: largest errors that the user allows.
    """
    if judgement is None or (allowed and not (judgement.judged or judgement.stopped)):
        return [[_limit(each), Cell("not judged", "doubtful")] for each in allowed]
    if not allowed:
        text = headline(judgement)
        if judgement.without:
            text += f"; {without_text(judgement)}: {headline(judgement.without)}"
        return [["accuracy", Cell(f"{text}; no --max-error limits it", "doubtful")]]
    rows: Rows = []
    for each in allowed:
        found, causes = found_text(judgement, each.kind), "; ".join(_causes(judgement.analyzed))
        if each.is_exceeded_by(judgement):
            cell = Cell("; cause ".join(filter(None, [found, causes])), "fails")
        else:
            cell = Cell(found, "holds")
        rows.append([_limit(each), cell])
    return rows


def _limit(allowed: AllowedError) -> str:
    """Format an allowed error, such as "position error at most 1 mm"."""
    return f"{allowed.kind} error at most {in_unit(allowed.largest, allowed.kind)}"


def _extent(judgement: Judgement) -> str:
    """Format how far the mechanisms of the largest errors move in the reference."""
    error, scale = judgement.error, judgement.scale
    by_position, by_rotation = (scale.by_body[body] for body, _ in (error.position_at, error.rotation_at))
    stated = dict.fromkeys(_motion(by_position if each else by_rotation, scale) for each in _stated(error))
    return "; ".join(stated)


def _motion(motion: MechanismMotion, scale: MotionScale) -> str:
    """Format how far a mechanism moves in the reference."""
    capped = ">" if motion.angle >= MAX_ANGLE_SCALE else ""
    extents = [length(motion.length)] if motion.length > NO_MOTION else []
    extents += [f"{capped}{angle(min(motion.angle, MAX_ANGLE_SCALE))}"] if motion.angle > NO_MOTION else []
    if len(scale.mechanisms) == 1:
        return f"bodies move {', '.join(extents)}" if extents else "nothing moves"
    moves = f"moves {', '.join(extents)}" if extents else "does not move"
    return f"the mechanism of {motion.bodies[0]} {moves}"


def unsimulated_text(events: Sequence[Event]) -> str:
    """Name the first of the elements that act and that the reference does not simulate, and their number."""
    first, *others = events
    acts, it = ("they act", "them") if others or is_plural(first) else ("it acts", "it")
    return (
        f"{elements_text(events)}: {acts} from {first.time:.3g} s on and the reference does not simulate {it}"
    )


def _only_in_run_text(events: Sequence[Event]) -> str:
    """State which elements act in the judged run although they do not act in the accurate motion."""
    first, *others = events
    act = "act" if others or is_plural(first) else "acts"
    what = f"{elements_text(events)} {act} from {first.time:.3g} s on in this run only"
    return f"{what}, because of its error; in the reference's motion nothing of this acts"


def _approximated_text(approximated: Sequence[str]) -> str:
    """State that the reference has some elements of the file as forces; name the first one."""
    kinds = "forces" if len(approximated) > 1 or approximated[0].startswith(LIMITS) else "a force"
    names = first_names(approximated, most=1)
    return f"{names}: {kinds} in the reference, and the difference is a part of the error"


def stiffer_limits_text(stiffer_limits: str) -> str:
    """State which change of the file makes limits stiffer that give way more than those of the reference."""
    return f"the file's limits are soft and give way; a remedy to try: {stiffer_limits}"


def chaos_text(scale: MotionScale) -> str:
    """Tell until when chaotic mechanisms are compared with the reference; "" without one."""
    growth = f"from then on the motion multiplies any error by more than {MAX_ERROR_GROWTH:g}"
    chaotic = [(each.until, each.bodies[0]) for each in scale.mechanisms if each.until is not None]
    if not chaotic:
        return ""
    (first, body), *others = sorted(chaotic)
    if len(scale.mechanisms) == 1:
        return f"compared until {first:.3g} s: {growth}"
    named = [f"the mechanism of {body} is compared until {first:.3g} s"]
    named += [f"that of {body} until {until:.3g} s" for until, body in others[: MAX_ELEMENTS - 1]]
    more = f" and {len(chaotic) - len(named)} more" if len(chaotic) > len(named) else ""
    return f"{', '.join(named)}{more}: {growth}"


def _sizes_as(judgement: Judgement, error: RunError) -> str:
    """Format an error as lengths, angles or both, like the error of the judged run.

    If that run diverged, an error is given like the headline of its own run would be.
    """
    stated = _stated(error if judgement.stopped else judgement.error)
    return " and ".join(size(error, by_position) for by_position in stated)


def _causes(judgement: Judgement) -> list[str]:
    """Format the causes; for a run that diverged, the settings without which it completes."""
    if judgement.stopped:
        names = [each.name for each in judgement.causes if each.brings_back]
        which = "one of these" if names[1:] else "it"
        return [f"{', '.join(names)} (the run completes if {which} is changed)"] if names else []
    by_position = judgement.error.stated_by_position
    # causes are sorted, the largest first; `part` is the error of positions or of rotations,
    # relative to the motion
    errors = {each.name: each.error.relative_by(by_position) for each in judgement.causes}
    largest = max(errors.values(), default=0.0)
    listed = [each for each in judgement.causes if 0.0 < errors[each.name] >= MIN_CAUSE * largest]
    large = {each.name for each in listed}
    small = [name for name in errors if name not in large] + [*judgement.harmless]
    words = [f"{each.name}: {_sizes_as(judgement, each.error)}" for each in listed]
    # integrator and time step, if they are the two largest causes: the change of one of them is enough
    if judgement.have_one_error and {each.name for each in listed[:2]} == {*OF_UNSTABLE_MODES}:
        words[:2] = [", or ".join(words[:2])]
    if (listed or small) and not judgement.is_explained:
        words.append(f"the rest is {OF_APPROXIMATIONS if judgement.approximated else 'unexplained'}")
    return words + ([f"little or nothing: {', '.join(small)}"] if small else [])


def _stability(mode: Stability) -> Iterator[str]:
    """Format the fastest mode, the elements that make it, and the stability limit of the time step.

    Args:
        mode: the fastest mode of the linearized motion, and the limit of stable time steps.
    """
    limit, step = quantity_text(mode.limit, SECONDS_AND_MS, digits=2), f"{1e3 * mode.timestep:g} ms"
    if mode.is_stable:
        if mode.timestep * mode.rate >= FAST_MODE:
            by = f", made by {_elements(mode)}," if mode.elements else ""
            until = f"; small motions are stable up to steps of {limit}" if mode.limit < math.inf else ""
            constant = quantity_text(1.0 / mode.rate, SECONDS_AND_MS, digits=2)
            steps = f"{significant(1.0 / (mode.rate * mode.timestep), 2)} of the file's steps"
            yield f"the fastest mode{by} has a time constant of {constant}: only {steps}{until}"
            yield _body(mode.body)
            if mode.elements and all(each.is_constraint for each in mode.elements):
                yield "stiff constraints are fast on purpose: leave them if soft constraints cause little"
        return
    if mode.elements:
        makes = "makes" if len(mode.elements) == 1 else "make"
        yield f"{_elements(mode)} {makes} a mode of {mode.rate:.2g} 1/s"
    else:
        yield f"a mode has {mode.rate:.2g} 1/s"
    stable_steps = f"steps are stable below {limit}" if mode.limit else "no smaller step is stable"
    yield f"{stable_steps}, the file steps {step}: each step multiplies the mode by {mode.growth:.3g}"
    yield _body(mode.body)


def _elements(mode: Stability) -> str:
    """Name the elements (such as actuators or dampers) that make a mode, with their values if known."""
    named = [
        each.name if math.isnan(each.value) else f"{each.name} ({each.value:g})" for each in mode.elements
    ]
    if len(named) > MAX_ELEMENTS:
        named = [*named[: MAX_ELEMENTS - 1], f"{len(named) - MAX_ELEMENTS + 1} more"]
    return " and ".join([", ".join(named[:-1]), named[-1]] if named[1:] else named)


def _body(body: MovingBody) -> str:
    """Format which body moves in a mode, and a much heavier neighbor."""
    words = f"mostly {body.name!r} moves, {_mass(body.mass)}"
    if body.neighbor_mass > HEAVY_NEIGHBOR * body.mass:
        words += f"; its neighbor {body.neighbor!r} has {_mass(body.neighbor_mass)}"
    return words


def _model_change(change: ModelChange) -> str:
    """Format a change of the model and what it does to the motion."""
    error = change.error
    return f"{change.change}: completes, {size(error, error.stated_by_position)} from the motion of the file"


def headline(judgement: Judgement) -> str:
    """Format the accuracy and the error of a judged run in a few words, such as "OFF BY 2 mm"."""
    error = judgement.error
    if judgement.stopped:
        return "DIVERGED"
    if not judgement.is_judged:
        return f"{Band.NOT_JUDGED}: {judgement.why_not_judged}"
    # a comparison that ends with the first element that acts and that the reference does not have
    until = "" if judgement.until is None else f" until {judgement.until:.3g} s"
    if error.relative < ROUND_OFF:
        return f"ACCURATE{until}, the same as the reference to round-off"
    word = {Band.ACCURATE: "ACCURATE TO", Band.OFF: "OFF BY", Band.WRONG: "WRONG BY"}[judgement.band]
    # the mechanism of each stated error, whose motion the error is a part of
    names: list[str] = []
    if len(judgement.scale.mechanisms) > 1:
        for by_position in _stated(error):
            body, _ = error.position_at if by_position else error.rotation_at
            names.append(f" of the mechanism of {judgement.scale.by_body[body].bodies[0]}")
    shares = [percent(error.relative_by(by_position)) for by_position in _stated(error)]
    if len({*names}) < 2:
        share = " and ".join(dict.fromkeys(shares))
        return f"{word} {sizes(error)}, {share} of the motion{''.join({*names})}{until}"
    parts = [
        f"{size(error, by_position)}, {share} of the motion{name}"
        for by_position, share, name in zip(_stated(error), shares, names, strict=True)
    ]
    return f"{word} {' and '.join(parts)}{until}"


def sizes(error: RunError) -> str:
    """Format the error of positions, of rotations, or both, see `_stated`."""
    return " and ".join(size(error, by_position) for by_position in _stated(error))


def _stated(error: RunError) -> list[bool]:
    """Return True for the error of positions, False for that of rotations, or both.

    The smaller one, relative to the motion, is left out if it is less than a tenth of the larger one.
    """
    return [each for each in (True, False) if error.relative_by(each) >= 0.1 * error.relative]


def size(error: RunError, by_position: bool) -> str:
    """Format the error of positions, or of rotations."""
    return length(error.position) if by_position else angle(error.rotation)


def angle(value: float) -> str:
    """Format an angle, rad, in degrees with two or three digits."""
    degrees = math.degrees(value)
    if degrees < 1e-9:
        return "below 1e-9 deg" if degrees else "0 deg"
    return f"{degrees:.0f} deg" if degrees >= 10.0 else f"{degrees:.2g} deg"


def error_texts(error: RunError, loops: LoopError, has_energy: bool = True) -> Iterator[str]:
    """Yield texts on all errors of a run, with body and time.

    Args:
        error: errors of the run.
        loops: largest violations of the loop constraints.
        has_energy: False if the run does not determine the error of the energy.
    """
    for name, value, text, (place, time) in (
        ("position", error.position, _with_largest(error, True), error.position_at),
        ("rotation", error.rotation, _with_largest(error, False), error.rotation_at),
        ("loop opening", loops.opening, length(loops.opening), loops.opening_at),
        ("loop angle", loops.angle, angle(loops.angle), loops.angle_at),
    ):
        if value:
            yield f"{name} {text} at {place}, {time:.3g} s"
    if has_energy:
        yield f"energy {percent(error.energy)}"


def _with_largest(error: RunError, by_position: bool) -> str:
    """Format the error of positions or rotations, and the largest one if another mechanism has it."""
    text = size(error, by_position)
    largest = length(error.largest_position) if by_position else angle(error.largest_rotation)
    return text if largest == text else f"{text} (largest of all mechanisms {largest})"


def _remedy(remedy: MeasuredRemedy, judgement: Judgement) -> str:
    """Format other settings, their error and their run time relative to the settings of the file."""
    error = f"{_sizes_as(judgement, remedy.error)} ({percent(remedy.error.relative)})"
    if remedy.error.relative < ROUND_OFF:
        error = "the same as the reference to round-off"
    return f"{remedy.text}: {error}, {cost_text(remedy)}"


def cost_text(remedy: MeasuredRemedy) -> str:
    """Format the run time of settings relative to that of the file's settings.

    Settings with no more evaluations of the equations of motion than the file's have "same run time".
    """
    if remedy.run_time <= SAME_RUN_TIME or remedy.evaluations <= 1.0:
        return "same run time"
    return f"{remedy.run_time:.1f} times the run time"


def percent(value: float) -> str:
    """Format a ratio in percent."""
    number = 100.0 * value
    if number >= 10.0:
        return f"{number:.0f} %"
    if number < 1e-9:
        return "below 1e-9 %" if number else "0 %"
    return f"{number:.2g} %" if number >= 1e-3 else f"{number:.0e} %"


def _mass(value: float) -> str:
    """Format a mass in kg or g."""
    is_light = float(f"{value:.2g}") < 0.1  # after rounding: 99.6 g are 0.1 kg
    return f"{significant(1e3 * value, 2)} g" if is_light else f"{significant(value)} kg"
