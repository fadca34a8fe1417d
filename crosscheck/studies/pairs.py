"""Study of public pairs of model files: run `crosscheck diff` on listed pairs, and write a table.

    python -m crosscheck.studies.pairs docs/results/pairs.yaml FOLDER --write docs/results/pairs.md

The YAML file lists pairs of files of one robot. FOLDER contains clones of the repositories as OWNER/NAME, or
as OWNER/NAME@COMMIT for an older commit. For each pair, the list has a number that does not come from
crosscheck: the relative difference of joint accelerations that MuJoCo or Pinocchio computes.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
from pydantic import BaseModel, ConfigDict

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.motion import Likeness
from crosscheck.differences.result import FileComparison, compare_models
from crosscheck.own_run.allowed import length
from crosscheck.report.diff import no_run_text, sentence
from crosscheck.report.own_run import percent
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Rows, Table, text_columns
from crosscheck.studies.models import REFUSED, read_list, write
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError

SHORT_COMMIT = 7
"""Number of characters of a commit in the name of a folder."""

MAX_SENTENCES = 3
"""Largest number of differences of a pair that the table tells."""


class ListedFile(BaseModel):
    """A model file of a pair.

    Attributes:
        repository: name of the repository as OWNER/NAME.
        commit: commit of the file.
        file: path of the file in its repository.
    """

    model_config = ConfigDict(extra="forbid")

    repository: str
    commit: str
    file: str

    @property
    def source(self) -> str:
        """Repository and commit."""
        return f"{self.repository} {self.commit[:SHORT_COMMIT]}"

    def path(self, folder: Path) -> Path:
        """Return the path of the file; an older commit has a folder of its own."""
        older = folder / f"{self.repository}@{self.commit[:SHORT_COMMIT]}" / self.file
        return older if older.exists() else folder / self.repository / self.file


class ListedPair(BaseModel):
    """Two files of one robot.

    Attributes:
        name: name of the pair.
        first, second: the files.
        independent: relative difference of the joint accelerations of both files under gravity, by MuJoCo or
            Pinocchio alone: without drives, springs, dampers and armature. None if it is not known.
        why: what a person found out.
    """

    model_config = ConfigDict(extra="forbid")

    name: str
    first: ListedFile
    second: ListedFile
    independent: float | None = None
    why: str = ""

    @property
    def places(self) -> str:
        """Both files with repository and commit, which stand once if they are the same."""
        first, second = self.first, self.second
        place = f"{first.source}: {first.file} and "
        return place + (second.file if first.source == second.source else f"{second.source}: {second.file}")


class PairResult(BaseModel):
    """Result of a pair.

    Attributes:
        verdict: `SAME`, `SAME TO ROUNDING`, `DIFFERENT`, or `REFUSED` for a file that cannot be read.
        differences: the largest differences with their causes, or the error.
        others: number of further differences.
        motion: difference of the motions.
        run: largest distance of a body from its counterpart in a run from the same start.
        processor_time: of reading and comparing, s.
    """

    verdict: str
    differences: list[str]
    others: int = 0
    motion: str
    run: str
    processor_time: float


def compare_pair(folder: Path, pair: ListedPair) -> PairResult:
    """Compare the files of a pair.

    Args:
        folder: folder of the repositories.
        pair: the pair.
    """
    start = time.process_time()
    try:
        paths = pair.first.path(folder), pair.second.path(folder)
        comparison = compare_models(paths, ({}, {}), {}, None, lambda stage: None)
    except (CrosscheckError, NewtonEulerError) as error:
        text = str(error).replace(f"{folder}/", "")
        return PairResult(
            verdict=REFUSED, differences=[text], motion="", run="", processor_time=time.process_time() - start
        )
    rows = comparison.differences
    return PairResult(
        verdict=comparison.outcome.value,
        differences=[sentence(row) for row in rows[:MAX_SENTENCES]],
        others=max(0, len(rows) - MAX_SENTENCES),
        motion=_motion(comparison),
        run=_run(comparison),
        processor_time=time.process_time() - start,
    )


def _motion(comparison: FileComparison) -> str:
    """Format the difference of the motions of a pair."""
    match comparison.motion.likeness:
        case Likeness.EQUAL:
            return "equal"
        case Likeness.ROUNDING:
            return "rounding"
        case Likeness.UNDECIDED:
            return "not compared"
        case Likeness.DIFFERENT:
            return percent(comparison.motion.change)


def _run(comparison: FileComparison) -> str:
    """Format the distance of a run, or why there is none."""
    run = comparison.run
    if run is None:
        is_compared = comparison.motion.likeness is not Likeness.UNDECIDED
        return no_run_text(comparison.motion) if is_compared else "not compared"
    return length(run.distance) if run.distance > run.uncertainty else "rounding"


def table(pairs: Sequence[ListedPair], found: dict[str, PairResult]) -> Iterator[str]:
    """Yield the lines of Markdown: counts of verdicts, and a table of all pairs in the order of the list.

    Args:
        pairs: the list.
        found: results by the name of the pair.
    """
    counts = Counter(result.verdict for result in found.values())
    outcomes = Outcome.SAME, Outcome.SAME_TO_ROUNDING, Outcome.UNFINISHED, Outcome.DIFFERENT
    order = (*(outcome.value for outcome in outcomes), REFUSED)
    slowest = max((result.processor_time for result in found.values()), default=math.nan)
    yield f"{len(found)} pairs: {', '.join(f'{counts[each]} {each}' for each in order if counts[each])}."
    yield f"The slowest comparison took {slowest:.1f} s of processor time."
    yield ""
    rows: Rows = []
    for pair in pairs:
        result = found.get(pair.name)
        if result is None:
            continue
        independent = "" if pair.independent is None else f"{pair.independent:.1e}"
        rows.append(
            [
                f"{pair.name}: {pair.places}",
                result.verdict,
                result.motion,
                result.run,
                independent,
                _differences(result),
                pair.why,
            ]
        )
    heads = (
        "pair: first and second file",
        "verdict",
        "accelerations",
        "run",
        "engine alone",
        "differences",
        "note",
    )
    yield from markdown_table(Table("", text_columns(*heads), rows))
    yield "\nTable: the pairs, their verdicts and their largest differences."


def _differences(result: PairResult) -> str:
    """Number the differences of a pair, and join them for one cell; an error has no number."""
    if result.verdict == REFUSED:
        return "; ".join(result.differences)
    texts = [f"({number}) {text}" for number, text in enumerate(result.differences, 1)]
    return "; ".join([*texts, f"{result.others} more"] if result.others else texts)


@click.command()
@click.argument("pairs", type=click.Path(path_type=Path))
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option("--only", default="", help="Compare only pairs whose name contains this text.")
@click.option("--write", "target", type=click.Path(path_type=Path), help="Markdown file to write into.")
def main(pairs: Path, folder: Path, only: str, target: Path | None) -> None:
    """Compare the pairs of the list PAIRS, whose repositories are in FOLDER as OWNER/NAME."""
    try:
        listed = [pair for pair in read_list(pairs, "pairs", ListedPair) if only in pair.name]
        found = {}
        for pair in listed:
            found[pair.name] = result = compare_pair(folder, pair)
            click.echo(f"{pair.name}: {result.processor_time:.1f} s: {result.verdict} {result.motion}")
        if target is not None:
            write(target, list(table(listed, found)))
            click.echo(f"wrote {target}")
    except CrosscheckError as error:
        raise click.ClickException(str(error)) from error


if __name__ == "__main__":
    main()
