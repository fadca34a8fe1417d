"""Hostile values in every field of a file, driven by the pydantic schema that reads it.

A schema says which fields an entry has; content that is whole says which kinds of entries to look into.
"""

from __future__ import annotations

import copy
import json
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import yaml
from command_line import NoAliases

from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError

Path = tuple[str | int, ...]

LONGEST = 1200
"""Characters of a message: at most 1000 on the file, and its path."""

SLOWEST = 3.0
"""s of processor time for one file of some kilobytes."""

PLACE = "PLACE-OF-A-VALUE"

BOTH = (
    "-1", "0", "1e308", "-1e308", "1e101", "1e-320", "1e400", "0.5", "7", "9" * 4301, "null", "true", "[]",
    "{}", "[1, 2]", "[[1, 2, 3], [4, 5, 6]]", '{"a": 1}', '{"kind": "none"}', '{"kind": {}}', '""', '" "',
    '"ground"', '"1_0"', '"2024-01-01"', '"\u0661"', '"a\\u001b[31m"', '"a\\u202eb"', '"a\\nb"', '"a\\u0000"',
    f'"{"x" * 5000}"', "[" * 50 + "]" * 50,
)  # fmt: skip
"""Texts of values that JSON and YAML have in common."""

OF_JSON = ("NaN", "Infinity", "-Infinity", '"\\ud800"', '{"a": 1, "a": 2}', "[" * 5000 + "]" * 5000)

OF_YAML = (
    ".nan", "nan", ".inf", "-inf", "2024-01-01", "2024-01-01T00:00:00Z", "1:30", "0x10", "012", "1_000", "~",
    "yes", "&a 1", "*a", "{<<: {a: 1}}", "{a: 1, a: 2}", "{? [a] : 1}", "!!python/object/apply:os.getcwd []",
    "!!binary aGk=", "!!float 1", "!!set {a, b}", "[" * 200 + "]" * 200, "{a: " * 200 + "1" + "}" * 200,
    '"\\ud800"', "'\x07'", "@", "`", "%a", "- 1", "\t1",
)  # fmt: skip

VALUES: dict[str, tuple[str, ...]] = {"json": BOTH + OF_JSON, "yaml": BOTH + OF_YAML}
"""Texts of values, by the format of the file."""


def resolved(schema: Mapping[str, Any], root: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a schema in place of a reference to it."""
    while "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    return schema


def alternatives(schema: Mapping[str, Any], root: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the schemas of a union, or the schema itself."""
    schema = resolved(schema, root)
    parts = schema.get("oneOf", schema.get("anyOf"))
    if parts is None:
        yield schema
    for part in parts or ():
        yield from alternatives(part, root)


def chosen(schema: Mapping[str, Any], root: Mapping[str, Any], content: Any) -> Mapping[str, Any]:
    """Return the schema of a union that fits content: that of its kind, or of its keys, or of its type."""
    found = list(alternatives(schema, root))
    if isinstance(content, dict):
        of_kind = [
            each
            for each in found
            if content.get("kind", "") == each.get("properties", {}).get("kind", {}).get("const", "")
        ]
        return next(iter(of_kind or [each for each in found if "properties" in each] or found))
    kind = "array" if isinstance(content, list) else "string"
    return next((each for each in found if each.get("type") == kind), found[0])


def places(
    schema: Mapping[str, Any], root: Mapping[str, Any], content: Any, path: Path = (), name: str = ""
) -> Iterator[tuple[str, Path]]:
    """Yield a name by the schema and the path of every field of content, also of those that are left out.

    Of a list the first entry of each kind is looked into, of a mapping with any keys the first value.
    """
    own = chosen(schema, root, content)
    if isinstance(content, dict):
        for field, inner in own.get("properties", {}).items():
            here = f"{own.get('title', name)}.{field}"
            yield here, (*path, field)
            if field in content:
                yield from places(inner, root, content[field], (*path, field), here)
        if isinstance(more := own.get("additionalProperties"), dict):
            for key in list(content)[:1]:
                yield f"{name}.*", (*path, key)
                yield from places(more, root, content[key], (*path, key), f"{name}.*")
    elif isinstance(content, list) and content:
        items = own.get("items") or (own.get("prefixItems") or [{}])[0]
        kinds = dict[Any, int]()
        for number, entry in enumerate(content):
            kinds.setdefault(entry.get("kind") if isinstance(entry, dict) else None, number)
        for number in kinds.values():
            yield f"{name}[]", (*path, number)
            yield from places(items, root, content[number], (*path, number), f"{name}[]")


def template(content: Any, path: Path, language: str) -> str:
    """Return the text of a file with `PLACE` at a path of its content."""
    changed = copy.deepcopy(content)
    at = changed
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = PLACE
    if language == "json":
        return json.dumps(changed).replace(f'"{PLACE}"', PLACE)
    # numbers in one line, for what is nested has to stand in one
    return yaml.dump(changed, Dumper=NoAliases, width=10**6, default_flow_style=None)


def fields_with_values(
    schema: Mapping[str, Any], contents: Mapping[str, Any], language: str, step: int = 1
) -> Iterator[tuple[str, str]]:
    """Yield a name and the text of a file for every value in every field, one in `step` of them."""
    number = 0
    for field, (name, path) in distinct(schema, contents).items():
        text = template(contents[name], path, language)
        for value in VALUES[language]:
            number += 1
            if number % step == 0:
                yield f"{field} = {value:.40}", text.replace(PLACE, value)


def distinct(schema: Mapping[str, Any], contents: Mapping[str, Any]) -> dict[str, tuple[str, Path]]:
    """Return for each field of a schema the first of these contents, by name, that has a place for it."""
    found: dict[str, tuple[str, Path]] = {}
    for name, content in contents.items():
        for field, path in places(schema, schema, content):
            found.setdefault(field, (name, path))
    return found


def fields(schema: Mapping[str, Any]) -> set[str]:
    """Return the names of all fields of all entries of a schema, as `places` names them."""
    entries = [schema, *schema.get("$defs", {}).values()]
    return {f"{entry['title']}.{field}" for entry in entries for field in entry.get("properties", {})}


def attempt(read: Callable[[], object]) -> object | None:
    """Return what is read from a hostile file, None if it is refused in one printable line and in time."""
    start = time.process_time()
    try:
        found = read()
    except (CrosscheckError, NewtonEulerError) as error:
        line = str(error)
        assert line.isprintable(), line
        assert len(line) < LONGEST
        assert "internal error" not in line
        found = None
    assert time.process_time() - start < SLOWEST
    return found
