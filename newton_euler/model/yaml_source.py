"""YAML that somebody else wrote, as plain mappings, sequences and texts.

Scalars stay texts until a field says what they are to be, so that none of YAML's own ideas of dates, octal
numbers or truth values has a say. Aliases are refused because a few lines of them unfold to gigabytes,
tags because nothing here would heed them, and a key that comes twice because one of its values would be lost.
"""

from __future__ import annotations

from typing import Any

import yaml

from newton_euler.model.source_file import SourceError

MAXIMUM_DEPTH = 100
"""Of nested mappings and sequences."""

LOADER = yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader
"""What makes events; the one in Python takes twenty times as long."""


def parse_yaml(path: str, text: str) -> Any:
    """The document of a YAML text: dictionaries, lists and texts; None if it is empty.

    Raises:
        SourceError: naming the line at fault.
    """
    found: list[Any] = []
    open_nodes: list[_Node] = [_Node(found)]
    try:
        for event in yaml.parse(text, LOADER):
            if isinstance(event, yaml.NodeEvent):
                _add(event, open_nodes)
            elif isinstance(event, yaml.CollectionEndEvent):
                open_nodes.pop()
            elif isinstance(event, yaml.DocumentStartEvent) and found:
                raise _refusal("a second document", event)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        raise SourceError(path, f"not YAML: {where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise SourceError(path, f"not YAML: {' '.join(str(error).split())}") from error
    return found[0] if found else None


class _Node:
    """A mapping or sequence that is being filled."""

    def __init__(self, content: dict[str, Any] | list[Any]) -> None:
        self._content = content
        self._key: str | None = None

    def add(self, value: Any, event: yaml.Event) -> None:
        if isinstance(self._content, list):
            self._content.append(value)
        elif self._key is not None:
            self._content[self._key], self._key = value, None
        elif not isinstance(value, str):
            raise _refusal("a key is not a text", event)
        elif value in self._content:
            raise _refusal(f"key {value!r:.100} is given twice in one mapping", event)
        else:
            self._key = value


def _add(event: Any, open_nodes: list[_Node]) -> None:
    """Put what begins with an event in the innermost open node."""
    if isinstance(event, yaml.AliasEvent):
        raise _refusal("aliases are not allowed here", event)
    if event.tag is not None:
        raise _refusal("tags are not allowed here", event)
    if isinstance(event, yaml.ScalarEvent):
        open_nodes[-1].add(event.value, event)
        return
    content: dict[str, Any] | list[Any] = {} if isinstance(event, yaml.MappingStartEvent) else []
    open_nodes[-1].add(content, event)
    if len(open_nodes) > MAXIMUM_DEPTH:
        raise _refusal("nested too deeply", event)
    open_nodes.append(_Node(content))


def _refusal(problem: str, event: Any) -> yaml.MarkedYAMLError:
    """The error that names the line of an event."""
    return yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
