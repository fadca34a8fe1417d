"""Parser for YAML files from untrusted sources, such as scene files and sweep files.

The result consists of dictionaries, lists and strings. Scalars stay strings until the reader of a field
converts them, so YAML's own rules for dates, octal numbers and truth values do not apply. Three features are
refused: aliases, because a few lines of them expand to gigabytes; tags, because no reader would evaluate
them; and repeated keys, because one of the two values would be lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from typing import Any

import yaml

from newton_euler.model.source_file import SourceError

MAX_YAML_DEPTH = 100
"""Largest number of mappings and sequences inside of each other. `_value` calls itself once for each, and
Python allows about 1000 nested calls."""

LOADER = yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader
"""PyYAML's loader that keeps scalars as strings: the one in C if available, 20 times faster."""


def parse_yaml(path: str, text: str) -> Any:
    """Parse a YAML text with one document into dictionaries, lists and strings; None for an empty text.

    Args:
        path: path of the file, for error messages.
        text: content of the file.

    Raises:
        SourceError: naming the line of invalid YAML, a second document, an alias, a tag or a repeated key.
    """
    document = None
    try:
        events = iter(yaml.parse(text, LOADER))
        for event in events:
            if isinstance(event, yaml.NodeEvent):
                document = _value(event, events, 0)
            elif isinstance(event, yaml.DocumentStartEvent) and document is not None:
                raise _refusal("a second document", event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        raise SourceError(path, f"not YAML: {where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise SourceError(path, f"not YAML: {' '.join(str(error).split())}") from error
    return document


def _value(event: Any, events: Iterator[Any], depth: int) -> Any:
    """Build the value of one YAML node: a string, a list or a dictionary.

    Args:
        event: the parser event with which the node begins.
        events: the parser events after `event`; those of the node are consumed.
        depth: number of mappings and sequences around the node.
    """
    if isinstance(event, yaml.AliasEvent):
        raise _refusal("aliases are not allowed here", event)
    if event.tag is not None:
        raise _refusal("tags are not allowed here", event)
    if isinstance(event, yaml.ScalarEvent):
        return event.value
    if depth == MAX_YAML_DEPTH:
        raise _refusal("nested too deeply", event)
    nodes = takewhile(lambda each: not isinstance(each, yaml.CollectionEndEvent), events)
    if isinstance(event, yaml.SequenceStartEvent):
        return [_value(each, events, depth + 1) for each in nodes]
    mapping = {}
    for each in nodes:
        key = _value(each, events, depth + 1)
        if not isinstance(key, str):
            raise _refusal("a key is not a text", each)
        if key in mapping:
            raise _refusal(f"key {key!r:.100} is given twice in one mapping", each)
        mapping[key] = _value(next(events), events, depth + 1)
    return mapping


def _refusal(problem: str, event: Any) -> yaml.MarkedYAMLError:
    """Return an error with a problem and with the line of the parser event where the problem is."""
    return yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
