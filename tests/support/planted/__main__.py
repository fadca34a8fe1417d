"""Study of planted differences: change public model files in known ways, and judge what `diff` reports.

    python -m tests.support.planted docs/results/planted.yaml FOLDER --write docs/results/planted.md

The YAML file lists model files. FOLDER contains clones of their repositories, see `crosscheck.studies.pairs`.
Each file is changed in every way that it allows, one, two and three ways at once. The change of the motion
comes from MuJoCo or Pinocchio alone.
"""

from __future__ import annotations

import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from inspect import getdoc
from pathlib import Path

import click
import numpy as np
from pydantic import BaseModel, ConfigDict

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.result import compare_models
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Cell, Rows, Table, number_columns, text_columns
from crosscheck.studies.models import read_list, write
from crosscheck.studies.pairs import SHORT_COMMIT, ListedFile
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError
from tests.support.planted.changes import COMMON
from tests.support.planted.format_changes import OF_MJCF, OF_URDF, changes, rounded
from tests.support.planted.mjcf_text import MjcfText
from tests.support.planted.model_text import ModelText
from tests.support.planted.plant import NotApplicable, Plant, mistakes
from tests.support.planted.truth import change_of_motion
from tests.support.planted.urdf_text import UrdfText

DIGITS = (6, 7, 8)
"""Significant digits to which all numbers of a file are rounded."""

MIN_CHANGE = 1e-6
"""Smallest relative change of the motion that a comparison must not miss."""

COMBINED = 8
"""Number of pairs of changes of each file, and of triples."""


class ListedModel(BaseModel):
    """A model file in which differences are planted, and its name in the table."""

    model_config = ConfigDict(extra="forbid")

    name: str
    file: ListedFile


@dataclass(frozen=True)
class Case:
    """A changed file and what the comparison says about it.

    Attributes:
        model: name of the model.
        kinds: kinds of the changes.
        mistakes: what the comparison says wrong, in words.
        change: relative change of the motion by an engine alone; None if it is not known.
        is_missed: whether the motion changes and the comparison says that the files are the same.
    """

    model: str
    kinds: tuple[str, ...]
    mistakes: tuple[str, ...]
    change: float | None
    is_missed: bool


class PlantedModel:
    """A model file, and cases of its changes."""

    def __init__(self, name: str, path: Path, folder: Path) -> None:
        """Read the file.

        Args:
            name: name of the model.
            path: of the file.
            folder: for changed files.
        """
        self.name, self.path = name, path
        self._target = folder / path.name
        self._source = path.read_text(encoding="utf-8")
        self._kinds = changes(self._file())

    def _file(self) -> ModelText:
        """Return the file as it is."""
        return UrdfText(self._source) if self.path.suffix == ".urdf" else MjcfText(self._source)

    def cases(self) -> Iterator[Case]:
        """Yield the cases of single changes, of fewer digits, and of two and three changes."""
        alone: dict[str, Plant] = {}
        for kind in self._kinds:
            try:
                alone[kind] = self._planted([kind])[1][0]
            except NotApplicable:
                continue
            yield self._case((kind,))
        for digits in DIGITS:
            yield self._rounded(digits)
        single = [kind for kind, plant in alone.items() if plant.touched]
        random = np.random.default_rng(0)
        for count in (2, 3):
            found = 0
            while found < COMBINED and len(single) > count:
                kinds = tuple(random.choice(single, count, replace=False).tolist())
                try:
                    plants = self._planted(kinds)[1]
                except NotApplicable:
                    continue
                quantities = [row.quantity for plant in plants for row in plant.rows]
                touched = [name for plant in plants for name in plant.touched]
                found += 1
                if len({*touched}) == len(touched) and len({*quantities}) == len(quantities):
                    yield self._case(kinds)

    def _planted(self, kinds: Sequence[str]) -> tuple[ModelText, list[Plant]]:
        """Return the file with changes of some kinds, and the changes."""
        file, plants = self._file(), []
        for kind in kinds:
            seed = [ord(letter) for letter in self.name + kind + "".join(kinds)]
            plants.append(self._kinds[kind](file, np.random.default_rng(seed)))
        if isinstance(file, MjcfText):
            _ = file.model  # MuJoCo may refuse an inertia
        return file, plants

    def _case(self, kinds: tuple[str, ...]) -> Case:
        """Return the case of some changes at once."""
        file, plants = self._planted(kinds)
        change = None
        if all(plant.has_truth for plant in plants):
            coordinates = {name: each for plant in plants for name, each in plant.coordinates.items()}
            change = change_of_motion(self._file(), file, coordinates)
        return self._judged(kinds, file.text(), plants, change)

    def _rounded(self, digits: int) -> Case:
        """Return the case of numbers with fewer digits."""
        return self._judged((f"rounded to {digits} digits",), rounded(self._source, digits), [Plant()], None)

    def _judged(self, kinds: tuple[str, ...], text: str, plants: list[Plant], change: float | None) -> Case:
        """Compare a changed file with the file."""
        self._target.write_text(text, encoding="utf-8")
        try:
            comparison = compare_models((self.path, self._target), ({}, {}), {}, None, lambda stage: None)
        except (CrosscheckError, NewtonEulerError) as error:
            return Case(self.name, kinds, (f"refused: {error}",), change, is_missed=False)
        is_missed = change is not None and change > MIN_CHANGE and comparison.outcome is not Outcome.DIFFERENT
        return Case(self.name, kinds, tuple(mistakes(comparison, plants)), change, is_missed)


def change_texts() -> dict[str, str]:
    """Return what each kind of change does and by how much, by its name: first lines of the docstrings."""
    functions = {**COMMON, **OF_MJCF, **OF_URDF}
    texts = {kind: (getdoc(change) or "").partition("\n")[0] for kind, change in functions.items()}
    for digits in DIGITS:
        texts[f"rounded to {digits} digits"] = (
            f"Round all numbers with decimals to {digits} significant digits."
        )
    for count in (2, 3):
        texts[f"{count} changes at once"] = f"Make {count} of the other changes in one file."
    return {kind: text.rstrip(".") for kind, text in texts.items()}


def change_text(value: float) -> str:
    """Format a relative change of accelerations with two digits."""
    return f"{value:.2g}" if value < 100.0 else f"{float(f'{value:.2g}'):.0f}"


def table(models: Sequence[ListedModel], cases: Sequence[Case]) -> Iterator[str]:
    """Yield the lines of Markdown: counts, the models, and a table of all kinds."""
    right = sum(not case.mistakes for case in cases)
    kinds = {kind for case in cases for kind in case.kinds}
    missed = sum(case.is_missed for case in cases)
    yield (
        f"{len(cases)} changed files of {len(models)} models, {len(kinds)} kinds of changes, alone or "
        f"two and three at once: {right} are identified ({100.0 * right / max(len(cases), 1):.1f} %), "
        f"{missed} changes of the motion are missed."
    )
    yield ""
    by_kind: dict[str, list[Case]] = defaultdict(list)
    for case in cases:
        by_kind[case.kinds[0] if len(case.kinds) == 1 else f"{len(case.kinds)} changes at once"].append(case)
    texts = change_texts()
    rows: Rows = []
    wrong: Rows = []
    for kind, those in by_kind.items():
        wrong += [[kind, case.model, "; ".join(case.mistakes)] for case in those if case.mistakes]
        changed = [case.change for case in those if case.change is not None]
        motion = change_text(max(changed)) if changed else "not computed"
        identified = Counter(not case.mistakes for case in those)[True]
        rows.append([kind, texts[kind], str(len(those)), str(identified), motion])
    if wrong:
        yield from markdown_table(Table("", text_columns("change", "model", "wrong in the output"), wrong))
        yield "\nTable: changes that are not identified.\n"
    heads = (
        *text_columns("change", "what is changed, by how much"),
        *number_columns("files", "identified", "largest change of accelerations"),
    )
    yield from markdown_table(Table("", heads, rows))
    yield "\nTable: kinds of changes, files with them, and the largest relative change of accelerations.\n"
    yield from markdown_table(Table("", text_columns("model", "file"), [_model_row(each) for each in models]))
    yield "\nTable: the models, at the commits of the list."


def _model_row(model: ListedModel) -> list[str | Cell]:
    """Return the name of a model, and its repository, commit and file."""
    return [model.name, f"{model.file.repository} {model.file.commit[:SHORT_COMMIT]}: {model.file.file}"]


@click.command()
@click.argument("models", type=click.Path(path_type=Path))
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option("--only", default="", help="Change only models whose name contains this text.")
@click.option("--write", "target", type=click.Path(path_type=Path), help="Markdown file to write into.")
def main(models: Path, folder: Path, only: str, target: Path | None) -> None:
    """Plant differences in the models of the list MODELS, whose repositories are in FOLDER as OWNER/NAME."""
    cases = []
    try:
        listed = [model for model in read_list(models, "models", ListedModel) if only in model.name]
        with tempfile.TemporaryDirectory() as changed:
            for model in listed:
                for case in PlantedModel(model.name, model.file.path(folder), Path(changed)).cases():
                    cases.append(case)
                    verdict = "; ".join(case.mistakes) or "right"
                    missed = " MISSED" if case.is_missed else ""
                    click.echo(f"{case.model}: {', '.join(case.kinds)}: {verdict}{missed} ({case.change})")
        if target is not None:
            write(target, list(table(listed, cases)))
            click.echo(f"wrote {target}")
    except CrosscheckError as error:
        raise click.ClickException(str(error)) from error


if __name__ == "__main__":
    main()
