"""Check the points of the contract of an engine, and report which hold."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

from crosscheck.compare.outcome import ExitStatus, Verdict
from crosscheck.engines.engine import Engine
from crosscheck.engines.limits import CannotExpressError
from crosscheck.engines.registry import SOLVER
from crosscheck.report.chart import Measure, linear_chart
from crosscheck.report.table import Cell, Part, Report, Rows, Table, text_columns
from crosscheck.studies.conformance import applied, conventions, elements, runs
from crosscheck.studies.conformance.candidate import Candidate, NotOfferedError
from crosscheck.support.errors import reason_of

POINTS: dict[str, Callable[[Candidate], str]] = {
    each.__name__: each
    for each in (
        *(conventions.start, conventions.quaternion_order, conventions.outputs, conventions.motion),
        *(conventions.reaction_sign, conventions.reaction_frame, conventions.reaction_point),
        *(conventions.drive_force, conventions.energy, conventions.work),
        *(elements.slides, elements.balls, elements.free_bodies, elements.ground_second),
        *(elements.chain, elements.loops, elements.universals, elements.screws, elements.rods),
        *(elements.couplings, elements.jumps, elements.sampled_control),
        *(applied.joint_springs, applied.ball_springs, applied.point_springs, applied.wrenches),
        *(applied.winds, applied.frictions, applied.stops, applied.elastic_gears),
        *(applied.prescribed_motions, applied.rotors, applied.ball_rotors),
        *(runs.refinement, runs.errors, runs.fixed_steps, runs.stop),
        *(runs.equations, runs.limits, runs.settings),
    )
}
"""Points of the contract by name: functions that return what is wrong with an engine, or ""."""

REQUIRED = ("start", "quaternion_order", "outputs", "settings")
"""Points that every engine can show, on any scene of one body that it can express. An engine that refuses one
of them has shown nothing."""


class Result(StrEnum):
    """Result of a point."""

    HOLDS = "HOLDS"
    FAILS = "FAILS"
    REFUSED = "REFUSED"
    """The engine cannot express the scene of the point, or lacks an optional part that the point is about."""


VERDICTS: dict[Result, Verdict] = {Result.HOLDS: "holds", Result.FAILS: "fails", Result.REFUSED: "doubtful"}
"""Color of each result."""


class Explanation(NamedTuple):
    """Explanation of a point, from the paragraphs of its docstring.

    Attributes:
        asked: what the point asks.
        why: why comparisons need that.
        failure: what a failure means.
    """

    asked: str
    why: str
    failure: str


@dataclass(frozen=True)
class Finding:
    """Result of one point.

    Attributes:
        point: name of the point, a key of `POINTS`.
        result: whether the engine follows the contract there.
        why: what is wrong, or the reason of the refusal; "" if the point holds.
        scene: name of the scene where the point fails or is refused; "" if the point holds, or lacks a part
            of the engine.
        place: file and line of the engine's code where an error was raised; "" without an error.
    """

    point: str
    result: Result
    why: str = ""
    scene: str = ""
    place: str = ""

    def __str__(self) -> str:
        """Return what is wrong in one line, with scene and place; "" if the point holds."""
        scene = f"scene {self.scene}: " if self.scene else ""
        return f"{scene}{self.why} ({self.place})" if self.place else f"{scene}{self.why}"


def explained(point: str) -> Explanation:
    """Return the explanation of a point, a key of `POINTS`."""
    paragraphs = (inspect.getdoc(POINTS[point]) or "").split("\n\n")
    return Explanation(*(" ".join(paragraph.split()) for paragraph in paragraphs))


def explanations() -> Table:
    """Make the table that explains all points; the documentation has it, too."""
    rows: Rows = [[point, *explained(point)] for point in POINTS]
    columns = text_columns("point", "what is asked", "why", "what a failure means")
    return Table("points of the contract", columns, rows, folded=True)


def check_point(candidate: Candidate, point: str) -> Finding:
    """Check one point, a key of `POINTS`; an error that is no refusal is a failure."""
    try:
        why = POINTS[point](candidate)
    except NotOfferedError as error:
        return Finding(point, Result.REFUSED, str(error))
    except CannotExpressError as error:
        return Finding(point, Result.REFUSED, str(error), candidate.scene)
    except Exception as error:  # code of another package
        reason = reason_of(error).removeprefix("internal error: ")  # the error is not one of crosscheck
        return Finding(point, Result.FAILS, reason, candidate.scene, candidate.place_of(error))
    return Finding(point, Result.FAILS, why, candidate.scene) if why else Finding(point, Result.HOLDS)


def check_engine(engine: Engine, progress: Callable[[str], None]) -> Sequence[Finding]:
    """Check all points of an engine; `progress` is called with the name of each."""
    candidate, found = Candidate(engine, progress), []
    for point in POINTS:
        progress(f"{engine.name}: {point}")
        found.append(check_point(candidate, point))
    return found


def exit_status(findings: Sequence[Finding]) -> ExitStatus:
    """Return the exit status: DISAGREE if a point fails, UNFINISHED if a required point is refused."""
    if _names(findings, Result.FAILS):
        return ExitStatus.DISAGREE
    refused = _names(findings, Result.REFUSED)
    return ExitStatus.UNFINISHED if any(point in refused for point in REQUIRED) else ExitStatus.AGREE


def report(engine: Engine, findings: Sequence[Finding]) -> Report:
    """Make the report of the points of an engine."""
    failed, refused = _names(findings, Result.FAILS), _names(findings, Result.REFUSED)
    held = f"{len(findings) - len(failed) - len(refused)} of {len(findings)} points hold"
    others = f"{held}{_listed('refused', refused)}"
    match exit_status(findings):
        case ExitStatus.DISAGREE:
            judged = Cell("DOES NOT CONFORM", "fails")
            others = f"{held}{_listed('failed', failed)}{_listed('refused', refused)}"
        case ExitStatus.UNFINISHED:
            judged = Cell("NOT SHOWN", "doubtful")
            others += f"; an engine conforms if at least {', '.join(REQUIRED)} hold"
        case _:
            judged = Cell("CONFORMS", "holds")
    rows: Rows = [[each.point, Cell(each.result, VERDICTS[each.result]), str(each)] for each in findings]
    table = Table("", text_columns("point", "result", "why"), rows)
    title = f"contract of the engine {engine.name}"
    parts: list[Part] = [explanations()]
    counts = {result: len(_names(findings, result)) for result in Result}
    results = [
        Measure(name, count, str(count), verdict=VERDICTS[name] if count else "")
        for name, count in counts.items()
    ]
    steps = [f"Correct the point {point}; the table has what is wrong." for point in failed]
    return Report(
        title,
        f"{judged.text}: {engine.name}: {others}",
        judged,
        parts,
        summary=[table],
        charts=linear_chart("Points", "Number of points of the contract by result", results),
        next_steps=steps or [f"Compare the engine: `crosscheck run --engines {SOLVER.name},{engine.name}`."],
    )


def _names(findings: Sequence[Finding], result: Result) -> list[str]:
    """Return the names of the points with a result."""
    return [each.point for each in findings if each.result is result]


def _listed(what: str, points: Sequence[str]) -> str:
    """Return "; ", what points are, and their names; "" if there are none."""
    return f"; {what}: {', '.join(points)}" if points else ""
