"""XML that somebody else wrote, looked at once before any parser builds or expands anything of it."""

from __future__ import annotations

from collections.abc import Callable
from xml.parsers import expat

from newton_euler.limits import exceeded, limit
from newton_euler.model.source_file import SourceError

MAXIMUM_DEPTH = 400  # of nested elements; recursive parsers run out of stack somewhere above
LARGEST = 1e15  # of any number of a model, so that squares and triple products stay finite and keep digits
NOT_FINITE = ("nan", "inf", "infinity")

Begin = Callable[[str, dict[str, str], int], None]
"""What is called for an element's tag, its attributes and its line."""


def scan(path: str, text: str, root: str | None, begin: Begin, error: type[SourceError]) -> None:
    """Call `begin` for every element of an XML text.

    Args:
        path: of the file, for errors.
        text: of the file.
        root: tag of the outermost element; any if None.
        begin: called in the order of the text.
        error: class of what is raised.

    Raises:
        SourceError: for text that is not well-formed, that has another root, a document type (entities
            unfold to gigabytes or to other files) or too many elements.
    """
    parser = expat.ParserCreate()
    depth = count = 0
    most = limit("elements")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        line = parser.CurrentLineNumber
        if count == 0 and root not in (None, tag):
            raise error(path, f"line {line}: root element is <{tag:.100}>, not <{root}>")
        depth, count = depth + 1, count + 1
        if depth > MAXIMUM_DEPTH:
            raise error(path, f"line {line}: more than {MAXIMUM_DEPTH} nested elements")
        if count > most:
            raise error(path, f"line {line}: {exceeded('elements', text.count('<'))}")
        begin(tag, attributes, line)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*_: object) -> None:
        raise error(path, f"line {parser.CurrentLineNumber}: a document type declaration, refused")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as failure:
        problem = expat.errors.messages[failure.code]
        raise error(path, f"not XML: line {failure.lineno}: {problem}") from failure
