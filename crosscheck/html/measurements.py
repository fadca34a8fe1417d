"""The sections of a page about a folder of `crosscheck bench` or `crosscheck stress`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from crosscheck.errors import CrosscheckError
from crosscheck.html import page
from crosscheck.html.page import Markup
from crosscheck.html.summary import read_json

TITLES = {
    "bench.json": "Run time against error",
    "rhs.json": "One right-hand side",
    "batch.json": "Many runs",
    "scaling.json": "Right-hand sides over size",
    "stress.json": "What each engine survives",
}
"""Of the files that hold measurements."""

WORDS = ("answer", "words")
"""Entries that say in words what was found."""


def files(folder: Path) -> list[Path]:
    """The files with measurements in a folder."""
    return [folder / name for name in TITLES if (folder / name).is_file()]


def sections(folder: Path) -> Iterator[Markup]:
    """What was found in words, pictures, and all figures as tables."""
    contents: dict[str, dict[str, Any]] = {}
    for path in files(folder):
        content = read_json(path)
        if not isinstance(content, dict):
            raise CrosscheckError(f"{path} is not what crosscheck writes; needed: an object")
        contents[path.name] = content
    for name, content in contents.items():
        yield page.heading(TITLES[name], 3)
        for words in WORDS:
            if words in content:
                lines = content[words] if isinstance(content[words], list) else [content[words]]
                yield page.listing(str(line) for line in lines)
    for picture in sorted(folder.glob("*.png")):
        try:
            yield page.picture(picture.read_bytes(), picture.stem.replace("_", " "))
        except OSError as error:
            raise CrosscheckError(f"cannot read {picture}: {error.strerror}") from error
    for name, content in contents.items():
        rest = {key: value for key, value in content.items() if key not in WORDS}
        yield page.details(f"all of {name}", [page.values(rest)])
