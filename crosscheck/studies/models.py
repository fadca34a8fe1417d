"""Runs public model files one by one and writes the table of docs/results/models.md.

    python -m crosscheck.studies.models docs/results/models.yaml FOLDER --write docs/results/models.md

FOLDER holds the repositories as OWNER/NAME. Each file is run by `crosscheck run` in a process of its own,
which has a limit of processor time. The findings are kept in a JSON file beside the results; with
`--only TEXT`, files whose path holds no such text keep the findings of before. Who is right where models do
not agree, and why, is for people to find out, and for the list to say.
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
from pathlib import Path
from typing import Any

import click
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from crosscheck.compare.activity import what_acted
from crosscheck.loading.model_files import is_urdf
from crosscheck.report.outcome import ExitStatus, Outcome
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Rows, Table, texts
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from newton_euler.folders import make_folder
from newton_euler.reading.import_report import ACTING, FATES, ImportedElement, ImportReport

MAX_PROCESSOR_TIME = 600
"""s for one model; processor time, so that other work on the machine changes no verdict."""

MAX_WALL_TIME = 3600.0
"""s for one model that waits for something."""

BEGIN, END = "<!-- models: begin -->", "<!-- models: end -->"
"""Between them stands what is written."""

REFUSED, TOO_LONG = "refused", "too long"
"""Verdicts of models that no outcome is known of: a file is refused, a run lasts too long."""

VERDICTS = (*(outcome.value for outcome in Outcome), REFUSED, TOO_LONG)
"""Verdicts of a model, in the order in which they are counted."""

JUDGED = (ExitStatus.AGREE, ExitStatus.DISAGREE, ExitStatus.UNFINISHED, ExitStatus.REDUCED)
"""Exit statuses of runs that leave a summary."""

MAX_REASON = 240
"""Characters of a reason in the table."""


class Entry(BaseModel):
    """A file of the list.

    Attributes:
        file: path in its repository.
        options: of `crosscheck run`, see `crosscheck list`.
        why: who is right and why, for a model that does not agree.
        ours: whether that is a fault or a lack of crosscheck.
    """

    model_config = ConfigDict(extra="forbid")

    file: str
    options: dict[str, Any] = Field(default_factory=dict)
    why: str = ""
    ours: bool = False


class Repository(BaseModel):
    """Files of one repository, OWNER/NAME."""

    model_config = ConfigDict(extra="forbid")

    repository: str
    options: dict[str, Any] = Field(default_factory=dict)
    """Of all its files."""
    files: list[Entry]


class Found(BaseModel):
    """Result of a run.

    Attributes:
        verdict: one of `VERDICTS`.
        line: the verdict as `crosscheck run` has it, or the error.
        reason: the part of the line that tells why the verdict is not AGREE.
        first: kind of the first element that acted and was not simulated, such as "limits".
        fates: how many elements became what, each as the worst that became of it.
        covered: how many of the scene's elements the motion covers, and of how many.
        lacks: what of the file the run lacks, in words.
        processor_time: s, of all processes of the command.
    """

    verdict: str
    line: str
    reason: str = ""
    first: str = ""
    fates: dict[str, int] = Field(default_factory=dict)
    covered: str = ""
    lacks: str = ""
    processor_time: float


def read_list(path: Path) -> list[Repository]:
    """The list of a YAML file.

    Raises:
        CrosscheckError: for a file that is no such list.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        return [Repository.model_validate(each) for each in content["models"]]
    except (OSError, yaml.YAMLError, ValidationError, TypeError, KeyError) as error:
        raise CrosscheckError(f"{path} is no list of models: {error}") from error


def run_model(folder: Path, repository: Repository, entry: Entry, output: Path) -> Found:
    """Run one file of a repository that is in `folder`, results to `output`."""
    home = folder / repository.repository
    path = home / entry.file
    options = repository.options | entry.options
    if not is_urdf(entry.file):
        options = {"root": str(home)} | options
    if "loops" in options:
        options["loops"] = str(path.parent / str(options["loops"]))
    settings = [part for name, value in options.items() for part in ("--set", f"{name}={value}")]
    shutil.rmtree(output, ignore_errors=True)
    command = [sys.executable, "-P", "-m", "crosscheck", "run", str(path), *settings, "--output", str(output)]
    before = _processor_time()
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=MAX_WALL_TIME,
            check=False,
            preexec_fn=_limit_processor_time,
        )
    except subprocess.TimeoutExpired:
        line = f"more than {MAX_WALL_TIME:g} s"
        return Found(verdict=TOO_LONG, line=line, processor_time=_processor_time() - before)
    used = _processor_time() - before
    if done.returncode == -signal.SIGXCPU:
        line = f"more than {MAX_PROCESSOR_TIME} s of processor time"
        return Found(verdict=TOO_LONG, line=line, processor_time=used)
    summary = output / "summary.json"
    if done.returncode not in JUDGED or not summary.exists():
        lines = [line for line in done.stderr.splitlines() if line.strip()] or [f"status {done.returncode}"]
        line = lines[-1].removeprefix("crosscheck: error: ").replace(f"{home}/", "")
        return Found(verdict=REFUSED, line=line, reason=line, processor_time=used)
    content = json.loads(summary.read_text(encoding="utf-8"))
    report = ImportReport()
    report.entries = [ImportedElement(**each) for each in content["mapping"] or []]
    still = "nothing moves" if "nothing moves" in content["verdict"] else ""
    tested = [covered["tested"] for covered in content["coverage"] or []]
    return Found(
        verdict=content["outcome"],
        line=content["verdict"],
        reason=_reason(content),
        first=_first_kind(content),
        fates=_fates(report),
        covered=f"{sum(tested)} of {len(tested)}" if tested else "",
        lacks="; ".join(filter(None, [still, report.counts()])),
        processor_time=used,
    )


def _limit_processor_time() -> None:
    """Give a process that begins, and each that it starts, `MAX_PROCESSOR_TIME`."""
    resource.setrlimit(resource.RLIMIT_CPU, (MAX_PROCESSOR_TIME, MAX_PROCESSOR_TIME + 1))


def _processor_time() -> float:
    """Sum the s of processor time of all processes that this one has started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _reason(content: dict[str, Any]) -> str:
    """Word why a summary does not say AGREE: what acted and was not simulated, or the rest of the verdict."""
    if content["outcome"] == Outcome.AGREE:
        return ""
    if content["outcome"] != Outcome.AGREE_ON_A_REDUCED_MODEL:
        return str(content["verdict"]).partition(": ")[2]
    first, *others = (ImportedElement(**each) for each in content["not_simulated"])
    more = f" and {len(others)} more" if others else ""
    return f"without {what_acted(first)}{more}, which act from {first.since:.3g} s on"


def _first_kind(content: dict[str, Any]) -> str:
    """Return the kind of the first element that acted: its topic, such as "limits", or "actuators"."""
    if not content["not_simulated"]:
        return ""
    entry = ImportedElement(**content["not_simulated"][0])
    word = entry.element.split()[0]
    return entry.topic or dict(ACTING).get(word, word)


def _fates(report: ImportReport) -> dict[str, int]:
    worst: dict[str, int] = {}
    for entry in report.entries:
        if not (entry.inert and entry.fate == "left out"):
            worst[entry.element] = max(worst.get(entry.element, 0), FATES.index(entry.fate))
    counts = Counter(worst.values())
    return {fate: counts[k] for k, fate in enumerate(FATES)}


def table(repositories: Sequence[Repository], found: dict[str, Found]) -> Iterator[str]:
    """The counts and the table in Markdown, models in the order of the list."""
    pairs = [(entry, found.get(f"{r.repository}/{entry.file}")) for r in repositories for entry in r.files]
    known = [(entry, each) for entry, each in pairs if each is not None]
    counts = Counter(each.verdict for _, each in known)
    verdicts = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS if counts[verdict])
    ours = sum(entry.ours for entry, each in known if each.verdict != Outcome.AGREE)
    total = Counter[str]()
    for _, each in known:
        total.update(each.fates)
    yield f"{len(known)} models of {len(repositories)} repositories: {verdicts}; {ours} of these for a reason"
    yield f"that is crosscheck's own. Of their elements {total['exactly']} are carried over exactly,"
    yield f"{total['inactive']} left out and inactive in the run,"
    yield f"{total['left out']} left out and active or not watched."
    yield ""
    reduced = [each.first for _, each in known if each.verdict == Outcome.AGREE_ON_A_REDUCED_MODEL]
    if reduced:
        yield "What acts first in models that are reduced:"
        yield ""
        kinds: Rows = [[kind, str(count)] for kind, count in Counter(reduced).most_common()]
        yield from markdown_table(Table("", texts("kind of element", "models"), kinds))
        yield ""
    rows: Rows = []
    for repository in repositories:
        rows.append(repository.repository)
        for entry in repository.files:
            model = found.get(f"{repository.repository}/{entry.file}")
            if model is None:
                continue
            options = ", ".join(f"{k}={v}" for k, v in (repository.options | entry.options).items())
            verdict = model.verdict
            if reason := _shortened(entry.why or model.reason):
                verdict += f": {reason}"
            time = f"{model.processor_time:.0f}"
            rows.append([entry.file, options, verdict, model.covered, model.lacks, time])
    heads = texts("model", "options", "verdict", "covered", "of the file", "processor time, s")
    yield from markdown_table(Table("", heads, rows))


def _shortened(reason: str) -> str:
    return reason if len(reason) <= MAX_REASON else f"{reason[: MAX_REASON - 4].rstrip()} ..."


def write(path: Path, lines: Sequence[str]) -> None:
    """Put lines between the marks of a Markdown file.

    Raises:
        CrosscheckError: for a file without them.
    """
    text = path.read_text(encoding="utf-8")
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise CrosscheckError(f"{path} has no lines {BEGIN} and {END}")
    write_files({path: "\n".join([before + begin, *lines, end + after]).encode()})


@click.command()
@click.argument("models", type=click.Path(path_type=Path))
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option("--only", default="", help="Run files whose path holds this text; the others stay as found.")
@click.option("--write", "target", type=click.Path(path_type=Path), help="Markdown file to write into.")
@click.option("--output", type=click.Path(path_type=Path), default="output/models", help="Folder.")
def main(models: Path, folder: Path, only: str, target: Path | None, output: Path) -> None:
    """Run the files of the list MODELS, whose repositories are in FOLDER as OWNER/NAME."""
    try:
        repositories = read_list(models)
        store = output / "models.json"
        found: dict[str, Found] = {}
        if store.exists():
            content = json.loads(store.read_text(encoding="utf-8"))
            found = {name: Found.model_validate(each) for name, each in content.items()}
        make_folder(output)
        for repository in repositories:
            for entry in repository.files:
                name = f"{repository.repository}/{entry.file}"
                if only not in name:
                    continue
                found[name] = run_model(folder, repository, entry, output / "run")
                click.echo(f"{name}: {found[name].processor_time:.0f} s: {found[name].line}")
                kept = {key: each.model_dump() for key, each in found.items()}
                write_files({store: (json.dumps(kept, indent=1) + "\n").encode()})
        if target is not None:
            write(target, list(table(repositories, found)))
            click.echo(f"wrote {target}")
    except CrosscheckError as error:
        raise click.ClickException(str(error)) from error


if __name__ == "__main__":
    main()
