"""Study of public models: run `crosscheck run` on listed MJCF and URDF files, and write a table.

    python -m crosscheck.studies.models docs/results/models.yaml FOLDER --write docs/results/models.md
    python -m crosscheck.studies.models docs/results/own_runs.yaml FOLDER --table own-runs \\
        --write docs/results/own_runs.md

The first table has the verdicts of all engines. The second one has the errors of the runs that the files make
with their own settings.

`crosscheck run` simulates a file in the default engines and compares them; its verdict is for example AGREE.
The YAML file lists model files by repository, and FOLDER contains clones of the repositories as OWNER/NAME.
Each file runs in a separate process with a limit of CPU time. Results are stored in the file models.json of
the output folder. With `--only TEXT`, only files whose path contains TEXT are run again. If a verdict is not
AGREE, a person finds out the reason and writes it into the list of models.
"""

from __future__ import annotations

import json
import resource
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import click
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from crosscheck.compare.activity import what_acted
from crosscheck.compare.outcome import ExitStatus, Outcome
from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.library.model_files import is_urdf_file
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Rows, Table, text_columns
from crosscheck.studies.own_run_table import OwnRunResult, own_run_result, own_run_table
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from crosscheck.support.name_lists import first_names
from newton_euler.folders import make_folder
from newton_euler.reading.import_report import ALWAYS_ACTING, FATES, ImportedElement, ImportReport

MAX_CPU_TIME = 600
"""Default of the largest CPU time of one model, s. Other programs on the machine do not affect CPU time."""

MAX_WALL_TIME = 3600.0
"""Largest wall time of one model, s."""

OWN_RUN_ENGINES = ",".join(
    name for name, engine in ENGINES.items() if engine is SOLVER or engine.soft_constraints
)
"""Engines of runs for the table of own runs: newton_euler, whose run is the reference, and the engine of MJCF
files, which has soft constraints."""

REPEATING_SCRIPT = Path("own_runs", "engine_alone.py")
"""Script that repeats files' own runs with MuJoCo alone; the path is relative to the folder of the list."""

TABLE_BEGIN, TABLE_END = "<!-- models: begin -->", "<!-- models: end -->"
"""Lines of the Markdown file before and after the generated text."""

REFUSED = "refused"
"""Verdict of a model whose file was rejected."""

TOO_LONG = "too long"
"""Verdict of a model whose run reached a time limit."""

VERDICTS = (*(outcome.value for outcome in Outcome), REFUSED, TOO_LONG)
"""Verdicts of a model, in the order of the counts in the table."""

STATUS_WITH_SUMMARY = (ExitStatus.AGREE, ExitStatus.DISAGREE, ExitStatus.UNFINISHED, ExitStatus.REDUCED)
"""Exit statuses of runs that write a summary."""

UNSPECIFIC_NAMES = ("robot", "model", "robots", "urdf", "xml", "mjcf", "assets")
"""Names of files and folders, in small letters, that do not name a robot."""

MAX_REASON_LENGTH = 240
"""Largest number of characters of a reason in the table."""


class ListedModel(BaseModel):
    """A model file of the list.

    Attributes:
        file: path of the file in its repository.
        options: options of the file, as given to `crosscheck run` by `--set`.
        why: reason why the verdict is not AGREE, written by a person.
        ours: True if that reason is a fault or a limitation of crosscheck, not of the file.
    """

    model_config = ConfigDict(extra="forbid")

    file: str
    options: dict[str, Any] = Field(default_factory=dict)
    why: str = ""
    ours: bool = False


class Repository(BaseModel):
    """Model files of one repository.

    Attributes:
        repository: name of the repository as OWNER/NAME.
        commit: commit of the files; "" if it is not stated.
        folder: folder of the files, relative to the list; "" for FOLDER/OWNER/NAME.
        options: options that all files share.
        files: the model files.
    """

    model_config = ConfigDict(extra="forbid")

    repository: str
    commit: str = ""
    folder: str = ""
    options: dict[str, Any] = Field(default_factory=dict)
    files: list[ListedModel]


class ModelResult(BaseModel):
    """Result of a model file.

    Attributes:
        verdict: one of `VERDICTS`.
        line: verdict line of `crosscheck run`, or the error.
        reason: part of the verdict line that explains why the verdict is not AGREE.
        first: kind of the first element that would have acted in the run and was not simulated, such as
            "limits".
        fates: number of elements of the file by the result of their import, one of `FATES`: "exactly",
            "inactive" (not simulated, but would not have acted), "approximated" or "left out". For an element
            with several results, the worst one counts.
        covered: number of elements of the scene that the motion tests, as "3 of 4".
        lacks: description of the parts of the file that were not simulated.
        processor_time: CPU time of all processes of the command, s.
        own_run: judgement of the file's own run; None if the run was not judged.
    """

    verdict: str
    line: str
    reason: str = ""
    first: str = ""
    fates: dict[str, int] = Field(default_factory=dict)
    covered: str = ""
    lacks: str = ""
    processor_time: float
    own_run: OwnRunResult | None = None


Entry = TypeVar("Entry", bound=BaseModel)


def read_list(path: Path, name: str, entry: type[Entry]) -> list[Entry]:
    """Read a list of public files from a YAML file.

    Args:
        path: path of the file.
        name: name of the list in the file, such as "models".
        entry: type of its entries.

    Raises:
        CrosscheckError: for a file without such a list.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        return [entry.model_validate(each) for each in content[name]]
    except (OSError, yaml.YAMLError, ValidationError, TypeError, KeyError) as error:
        raise CrosscheckError(f"{path} is no list of {name}: {error}") from error


def run_model(
    home: Path,
    repository: Repository,
    entry: ListedModel,
    output: Path,
    limit: int = MAX_CPU_TIME,
    script: Path | None = None,
) -> ModelResult:
    """Run `crosscheck run` on one model file.

    Args:
        home: folder of the repository.
        repository: repository of the file.
        entry: the file.
        output: folder for the results of `crosscheck run`; existing results are deleted.
        limit: largest CPU time, s.
        script: script that repeats the file's own run; None if the judgement of that run is not wanted.
    """
    # The command, with options of the repository and of the file. An MJCF file may refer to files below its
    # `root`; `loops` is the file that closes loops of a URDF model
    path = home / entry.file
    options = repository.options | entry.options
    if not is_urdf_file(entry.file):
        options = {"root": str(home)} | options
    if "loops" in options:
        options["loops"] = str(path.parent / str(options["loops"]))
    settings = [part for name, value in options.items() for part in ("--set", f"{name}={value}")]
    # Run it with limits of time; `-P` hides modules in the current folder from Python
    shutil.rmtree(output, ignore_errors=True)
    command = [sys.executable, "-P", "-m", "crosscheck", "run", str(path), *settings, "--output", str(output)]
    if script is not None:
        command += ["--engines", OWN_RUN_ENGINES]
    before = _processor_time()
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=MAX_WALL_TIME,
            check=False,
            preexec_fn=partial(_limit_processor_time, limit),
        )
    except subprocess.TimeoutExpired:
        line = f"more than {MAX_WALL_TIME:g} s"
        return ModelResult(verdict=TOO_LONG, line=line, processor_time=_processor_time() - before)
    used = _processor_time() - before
    if done.returncode == -signal.SIGXCPU:
        line = f"more than {limit} s of processor time"
        return ModelResult(verdict=TOO_LONG, line=line, processor_time=used)
    # If the file was rejected, the result is the last line of the error output, else it is the summary
    summary = output / "summary.json"
    if done.returncode not in STATUS_WITH_SUMMARY or not summary.exists():
        lines = [line for line in done.stderr.splitlines() if line.strip()] or [f"status {done.returncode}"]
        line = lines[-1].removeprefix("crosscheck: error: ").replace(f"{home}/", "")
        return ModelResult(verdict=REFUSED, line=line, reason=line, processor_time=used)
    # `mapping` lists how each element of the file was imported
    content = json.loads(summary.read_text(encoding="utf-8"))
    report = ImportReport()
    report.entries = [ImportedElement(**each) for each in content["mapping"] or []]
    motionless = "nothing moves" if "nothing moves" in content["verdict"] else ""
    tested = [covered["tested"] for covered in content["coverage"] or []]
    return ModelResult(
        verdict=content["outcome"],
        line=content["verdict"],
        reason=_reason(content),
        first=_first_kind(content),
        fates=_fates(report),
        covered=f"{sum(tested)} of {len(tested)}" if tested else "",
        lacks="; ".join(filter(None, [motionless, report.counts()])),
        processor_time=used,
        own_run=None if script is None else own_run_result(path, summary, script),
    )


def _limit_processor_time(limit: int) -> None:
    """Limit the CPU time, s, of a new process, and of each process that it starts."""
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 1))


def _processor_time() -> float:
    """Return the total CPU time, s, of all child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _reason(content: dict[str, Any]) -> str:
    """Return the reason why a verdict is not AGREE; empty if it is AGREE.

    The reason consists of the elements that were not simulated, or of the rest of the verdict line.

    Args:
        content: summary of the run.
    """
    if content["outcome"] == Outcome.AGREE:
        return ""
    if content["outcome"] != Outcome.AGREE_ON_A_REDUCED_MODEL:
        return str(content["verdict"]).partition(": ")[2]
    acting = [ImportedElement(**each) for each in content["not_simulated"]]
    names = first_names([what_acted(each) for each in acting], most=1)
    return f"without {names}, which act from {acting[0].since:.3g} s on"


def _first_kind(content: dict[str, Any]) -> str:
    """Return the kind of the first element that would have acted and was not simulated, such as "limits".

    Empty if there is no such element. `content` is the summary of the run.
    """
    if not content["not_simulated"]:
        return ""
    entry = ImportedElement(**content["not_simulated"][0])
    tag = entry.element.split()[0]  # an element is described by its tag and name, such as "joint 'knee'"
    plurals = dict(ALWAYS_ACTING)  # pairs of tag and plural, such as "tendon" and "tendons"
    return entry.topic or plurals.get(tag, tag)


def _fates(report: ImportReport) -> dict[str, int]:
    """Count the elements of the file by the result of their import; the worst result of an element counts.

    Elements that are left out and cannot move anything are not counted.
    """
    worst: dict[str, int] = {}  # index into `FATES` by element; the last fate is the worst
    for entry in report.entries:
        if not (entry.moves_nothing and entry.fate == "left out"):
            worst[entry.element] = max(worst.get(entry.element, 0), FATES.index(entry.fate))
    counts = Counter(worst.values())
    return {fate: counts[k] for k, fate in enumerate(FATES)}


def table(repositories: Sequence[Repository], found: dict[str, ModelResult]) -> Iterator[str]:
    """Yield the lines of Markdown: counts of verdicts, and a table of all models, sorted by robot.

    Args:
        repositories: the list of models.
        found: results by path OWNER/NAME/FILE.
    """
    # Counts of verdicts, and of elements by the result of their import
    known = [
        (repository, entry, found[name])
        for repository in repositories
        for entry in repository.files
        if (name := f"{repository.repository}/{entry.file}") in found
    ]
    counts = Counter(result.verdict for _, _, result in known)
    verdicts = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])
    ours = sum(entry.ours for _, entry, result in known if result.verdict != Outcome.AGREE)
    total = Counter[str]()
    for _, _, result in known:
        total.update(result.fates)
    yield f"{len(known)} models of {len(repositories)} repositories: {verdicts}. A fault or a limitation of"
    yield f"crosscheck is the reason in {ours} of them. {total['exactly']} elements of the files are imported"
    yield f"exactly, {total['inactive']} are inactive, and {total['left out']} are left out."
    yield ""
    # Kinds of elements that act first in models that are only partly simulated (reduced)
    reduced = [result.first for _, _, result in known if result.verdict == Outcome.AGREE_ON_A_REDUCED_MODEL]
    if reduced:
        kinds: Rows = [[kind, str(count)] for kind, count in Counter(reduced).most_common()]
        yield from markdown_table(Table("", text_columns("kind of element", "models"), kinds))
        yield "\nTable: first element that acts and is not simulated, in reduced models that agree.\n"
    rows: Rows = []
    for repository, entry, result in sorted(known, key=lambda each: _robot(each[1].file).lower()):
        options = ", ".join(f"{k}={v}" for k, v in (repository.options | entry.options).items())
        reason, time = _shortened(entry.why or result.reason), f"{result.processor_time:.0f}"
        file = f"{repository.repository}: {entry.file}"
        rows.append(
            [_robot(entry.file), result.verdict, reason, result.covered, result.lacks, time, options, file]
        )
    heads = ("robot", "verdict", "reason", "covered", "not simulated", "time, s", "options", "file")
    yield from markdown_table(Table("", text_columns(*heads), rows))
    yield "\nTable: verdicts of public models, sorted by robot."


def _robot(file: str) -> str:
    """Return the name of the robot of a file: of the file, or of its folder for names such as robot.xml."""
    parts = [part for part in Path(file).with_suffix("").parts if part.lower() not in UNSPECIFIC_NAMES]
    return parts[-1] if parts else Path(file).stem


def own_runs(repositories: Sequence[Repository], found: dict[str, ModelResult]) -> Iterator[str]:
    """Yield the lines of Markdown on the files' own runs, in the order of the list.

    Args:
        repositories: the list of models.
        found: results by path OWNER/NAME/FILE.
    """
    rows: list[tuple[str, str, OwnRunResult | str]] = []
    for repository in repositories:
        heading = f"{repository.repository} {repository.commit[:7]}".rstrip()
        for entry in repository.files:
            model = found.get(f"{repository.repository}/{entry.file}")
            if model is not None:
                reason = _shortened(f"{model.verdict}: {entry.why or model.reason or model.line}")
                rows.append((heading, entry.file, model.own_run or reason))
    yield from own_run_table(rows)


TABLES = {"verdicts": table, "own-runs": own_runs}
"""Functions that make the lines of a table, by the name for `--table`."""


def _shortened(reason: str) -> str:
    """Cut a reason at `MAX_REASON_LENGTH` characters."""
    return reason if len(reason) <= MAX_REASON_LENGTH else f"{reason[: MAX_REASON_LENGTH - 4].rstrip()} ..."


def write(path: Path, lines: Sequence[str]) -> None:
    """Replace the text between the lines `TABLE_BEGIN` and `TABLE_END` of a Markdown file.

    Raises:
        CrosscheckError: for a file without these lines.
    """
    text = path.read_text(encoding="utf-8")
    before, begin, rest = text.partition(TABLE_BEGIN)
    _, end, after = rest.partition(TABLE_END)
    if not begin or not end:
        raise CrosscheckError(f"{path} has no lines {TABLE_BEGIN} and {TABLE_END}")
    write_files({path: "\n".join([before + begin, *lines, end + after]).encode()})


@click.command()
@click.argument("models", type=click.Path(path_type=Path))
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option("--only", default="", help="Run only files whose path contains this text.")
@click.option("--write", "target", type=click.Path(path_type=Path), help="Markdown file to write into.")
@click.option("--table", "kind", type=click.Choice(list(TABLES)), default="verdicts", help="Table to write.")
@click.option("--limit", type=int, default=MAX_CPU_TIME, help="Largest CPU time of one model, s.")
@click.option("--output", type=click.Path(path_type=Path), default="output/models", help="Folder.")
def main(
    models: Path, folder: Path, only: str, target: Path | None, kind: str, limit: int, output: Path
) -> None:
    """Run the files of the list MODELS, whose repositories are in FOLDER as OWNER/NAME."""
    try:
        # Results of earlier runs, which `--only` keeps
        repositories = read_list(models, "models", Repository)
        store = output / "models.json"
        found: dict[str, ModelResult] = {}
        if store.exists():
            content = json.loads(store.read_text(encoding="utf-8"))
            found = {name: ModelResult.model_validate(each) for name, each in content.items()}
        # Run the files; results are stored after each of them
        make_folder(output)
        script = models.parent / REPEATING_SCRIPT if kind == "own-runs" else None
        for repository in repositories:
            for entry in repository.files:
                name = f"{repository.repository}/{entry.file}"
                if only not in name:
                    continue
                home = (
                    models.parent / repository.folder if repository.folder else folder / repository.repository
                )
                found[name] = run_model(home, repository, entry, output / "run", limit, script)
                click.echo(f"{name}: {found[name].processor_time:.0f} s: {found[name].line}")
                kept = {key: each.model_dump() for key, each in found.items()}
                write_files({store: (json.dumps(kept, indent=1) + "\n").encode()})
        # Write the table
        if target is not None:
            write(target, list(TABLES[kind](repositories, found)))
            click.echo(f"wrote {target}")
    except CrosscheckError as error:
        raise click.ClickException(str(error)) from error


if __name__ == "__main__":
    main()
