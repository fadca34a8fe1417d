"""Scene files that are refused: fields, names, numbers, nesting."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import partial

import yaml
from command_line import NoAliases, short_example
from hostile_files import ALIASES, Case

Keys = tuple[str | int, ...]

HUGE = list(range(100_000))


def nested(depth: int) -> dict[str, object]:
    """A sum of a sum of a sum of nothing that is known."""
    return {"kind": "sum", "terms": [nested(depth - 1)]} if depth else {"kind": "none"}


SCENE_EDITS: dict[str, tuple[Keys, object, str]] = {
    "a thousand digits": (("duration",), 10**1000, "duration: Input should be a"),
    "hexadecimal": (("duration",), "0x10", "duration: Input should be a valid number"),
    "zero inertia": (("bodies", 1, "inertia"), [[0.0] * 3] * 3, "a positive definite inertia"),
    "inertia of two rows": (("bodies", 1, "inertia"), [[1.0] * 3] * 2, "bodies.1.inertia"),
    "bodies that are one": (("bodies",), {"name": "a"}, "bodies: Input should be a valid list"),
    "bodies that are text": (("bodies",), "abc", "bodies: Input should be a valid list"),
    "bodies that are numbers": (("bodies",), HUGE, "bodies.0: Input should be a valid dictionary"),
    "a body that is a list": (("bodies", 0), [], "bodies.0: Input should be a valid dictionary"),
    "a name that is a list": (("bodies", 0, "name"), ["a"], "bodies.0.name: Input should be a valid string"),
    "an escape in a name": (("bodies", 0, "name"), "a\x1b[31m", "body 'a\\x1b[31m': has an unusable name"),
    "a turned name": (("bodies", 0, "name"), "a\u202eb", "body 'a\\u202eb': has an unusable name"),
    "a long name": (("bodies", 0, "name"), "x" * 100_000, "needed: one of frame and 3 others"),
    "a long unknown key": (("k" * 100_000,), 1, "unknown key"),
    "no joints": (("joints",), [], "body 'crank': no joint leads to it"),
    "no bodies": (("bodies",), [], "mechanism"),
    "sums in sums": (("motions",), [{"joint": "motor", "function": nested(40)}], "motions"),
}


def written(file: str, content: object) -> bytes:
    text = json.dumps(content) if file == "scene.json" else yaml.dump(content, Dumper=NoAliases)
    return text.encode()


def scene_cases() -> Iterator[Case]:
    for name, (keys, value, message) in SCENE_EDITS.items():
        content = short_example()
        at = content
        for key in keys[:-1]:
            at = at[key]
        at[keys[-1]] = value
        for file in ("scene.yaml", "scene.json"):
            slow = isinstance(value, list | str) and len(value) > 50_000
            yield Case(f"{file}: {name}", file, partial(written, file, content), message, slow=slow)
    for name, text, message in (
        ("aliases that unfold", ALIASES, "line 2: aliases are not allowed here"),
        ("deep nesting", "[" * 100_000, "line 1: nested too deeply"),
        ("deep mappings", "{a: " * 100_000, "line 1: nested too deeply"),
        ("many empty lists", "[" + "[]," * 320_000 + "]", "not a mapping from keys to values"),
        ("many keys", "".join(f"k{k}: 1\n" for k in range(90_000)), "name: missing"),
    ):
        yield Case(f"scene.yaml: {name}", "scene.yaml", text.encode(), message, slow=len(text) > 500_000)
    for name, text, message in (
        ("deep nesting", "[" * 100_000, "nested too deeply"),
        ("deep mappings", '{"a":' * 100_000, "nested too deeply"),
        ("many digits", '{"name": ' + "9" * 100_000 + "}", "not JSON: Exceeds the limit"),
        ("a key twice", '{"name": "a", "name": "b"}', "key 'name' is given twice in one object"),
        ("many lists", "[" + "[]," * 300_000 + "0]", "not a mapping from keys to values"),
        ("nothing but NaN", '{"duration": NaN}', "name: missing"),
        (
            "sums without end",
            json.dumps(short_example())[:-1]
            + ', "motions": [{"joint": "motor", "function": '
            + '{"kind": "sum", "terms": [' * 400
            + "]}" * 400
            + "}]}",
            "motions.0.function.sum.terms",
        ),
    ):
        yield Case(f"scene.json: {name}", "scene.json", text.encode(), message)
