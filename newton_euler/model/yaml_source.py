"""YAML that somebody else wrote, as plain mappings, sequences and texts.

Scalars stay texts until a field says what they are to be, so that none of YAML's own ideas of dates, octal
numbers or truth values has a say. Aliases are refused because a few lines of them unfold to gigabytes,
tags because nothing here would heed them, and a key that comes twice because one of its values would be lost.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import takewhile
from typing import Any

import yaml

from newton_euler.model.source_file import SourceError

MAXIMUM_DEPTH = 100  # of nested mappings and sequences

LOADER = yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader
"""YAML loader; the one in Python takes twenty times as long as the one in C."""


def parse_yaml(path: str, text: str) -> Any:
    """The document of a YAML text: dictionaries, lists and texts; None if it is empty.

    Raises:
        SourceError: naming the line at fault.
    """
    found = None
    try:
        events = iter(yaml.parse(text, LOADER))
        for event in events:
            if isinstance(event, yaml.NodeEvent):
                found = _value(event, events, 0)
            elif isinstance(event, yaml.DocumentStartEvent) and found is not None:
                raise _refusal("a second document", event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        raise SourceError(path, f"not YAML: {where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise SourceError(path, f"not YAML: {' '.join(str(error).split())}") from error
    return found


def _value(event: Any, events: Iterator[Any], depth: int) -> Any:
    """The node that begins with an event, with the events that follow."""
    if isinstance(event, yaml.AliasEvent):
        raise _refusal("aliases are not allowed here", event)
    if event.tag is not None:
        raise _refusal("tags are not allowed here", event)
    if isinstance(event, yaml.ScalarEvent):
        return event.value
    if depth == MAXIMUM_DEPTH:
        raise _refusal("nested too deeply", event)
    nodes = takewhile(lambda each: not isinstance(each, yaml.CollectionEndEvent), events)
    if isinstance(event, yaml.SequenceStartEvent):
        return [_value(each, events, depth + 1) for each in nodes]
    found = {}
    for each in nodes:
        key = _value(each, events, depth + 1)
        if not isinstance(key, str):
            raise _refusal("a key is not a text", each)
        if key in found:
            raise _refusal(f"key {key!r:.100} is given twice in one mapping", each)
        found[key] = _value(next(events), events, depth + 1)
    return found


def _refusal(problem: str, event: Any) -> yaml.MarkedYAMLError:
    """The error that names the line of an event."""
    return yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
