"""Broken and hostile files of every format, with what is to be said of each.

Byte-level mutations of small models may leave something that is a model; everything else may not.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator

from hostile_files import LAUGHS, SEED, TEXTS, Case
from hostile_mjcf import mjcf_cases
from hostile_scenes import scene_cases
from hostile_urdf import loop_cases, urdf_cases

PRINTABLE = tuple(b"0123456789.-eab/<>\"'{}[]:&* \n")

NUMBER = r"(?<![\w.])-?\d+(\.\d+)?([eE][-+]?\d+)?(?![\w.])"

WORD = r"\b[a-z_]{3,}\b"

NUMBERS = (
    "nan", "-inf", "1e400", "1e308", "-1e308", "1e100", "1e15", "-1e9", "1e-320", "0", "-0.0", "-1", "0x1F",
    "1_0", "1,5", "", "--1", "1e", "9" * 400, "0." + "3" * 400, "\u0663", "true", "[1]", "null",
)  # fmt: skip


def exchanged(text: str, place: re.Match[str], new: str) -> bytes:
    return (text[: place.start()] + new + text[place.end() :]).encode()


def byte_cases() -> Iterator[Case]:
    """Truncated, damaged, with a number or a word exchanged, and wrongly encoded."""
    for file, text in TEXTS.items():
        dice, content = random.Random(f"{SEED} {file}"), text.encode()
        for k in range(8):
            yield Case(f"{file} truncated {k}", file, content[: dice.randrange(len(content))])
        for k in range(8):
            damaged = bytearray(content)
            for _ in range(dice.randint(1, 4)):
                damaged[dice.randrange(len(damaged))] = dice.choice((dice.randrange(256), *PRINTABLE))
            yield Case(f"{file} damaged {k}", file, bytes(damaged))
        for k in range(6):
            first = dice.randrange(len(content))
            cut = content[:first] + content[first + dice.randint(1, 40) :]
            yield Case(f"{file} cut {k}", file, cut)
        for k in range(4):
            first, last = sorted(dice.sample(range(len(content)), 2))
            yield Case(f"{file} doubled {k}", file, content[:last] + content[first:])
        numbers, words = (list(re.finditer(pattern, text)) for pattern in (NUMBER, WORD))
        for k in range(12 if numbers else 0):
            number, other = dice.choice(numbers), dice.choice(NUMBERS)
            yield Case(f"{file} with number {k}", file, exchanged(text, number, other))
        for k in range(6):
            word, another = dice.choice(words), dice.choice(words)
            yield Case(f"{file} with word {k}", file, exchanged(text, word, another.group()))
        yield Case(f"{file} with a byte order mark", file, b"\xef\xbb\xbf" + content)
        utf8 = "not a UTF-8 text file"
        yield Case(f"{file} in UTF-16", file, text.encode("utf-16"), utf8)
        yield Case(f"{file} in Latin 1", file, content.replace(b"motor", b"mot\xf6r"), utf8)
        yield Case(f"{file} with a null", file, content.replace(b"motor", b"mot\0r"))
        yield Case(f"{file} of noise", file, dice.randbytes(1000))
        yield Case(f"{file} empty", file, b"", "")
        yield Case(f"{file} of blanks", file, b" \n\t\n" * 100, "")
        yield Case(f"{file} without line breaks", file, content.replace(b"\n", b" "))


PASSWORDS = '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]>'

REFUSED_TYPE = "line 1: a document type declaration, refused"

XML_EDITS: dict[str, tuple[str, str, str]] = {
    "entities that unfold": ("<{root}", LAUGHS + "<{root}", REFUSED_TYPE),
    "one long entity": ("<{root}", f"<!DOCTYPE x [<!ENTITY a '{'a' * 100_000}'>]><{{root}}", REFUSED_TYPE),
    "an entity of another file": ("<{root}", PASSWORDS + "<{root}", REFUSED_TYPE),
    "a document type of another file": ("<{root}", '<!DOCTYPE x SYSTEM "x.dtd"><{root}', REFUSED_TYPE),
    "parameter entities": ("<{root}", '<!DOCTYPE x [<!ENTITY % p "x"> %p;]><{root}', REFUSED_TYPE),
    "an unknown entity": ('"linkage"', '"&who;"', "undefined entity"),
    "a tag left open": ("</{root}>", "", "not XML: line"),
    "tags crossed": ("</{root}>", "<a><b></a></b></{root}>", "mismatched tag"),
    "two roots": ("</{root}>", "</{root}><{root}/>", "junk after document element"),
    "an attribute twice": ('name="crank"', 'name="crank" name="crank"', "duplicate attribute"),
    "another root": ("<{root}", "<other><{root}", "root element is <other>, not <{root}>"),
    "deep nesting": ("</{root}>", "<a>" * 100_000, "more than 400 nested elements"),
    "many elements": (
        "</{root}>",
        "<a/>" * 300_000 + "</{root}>",
        "elements, at most 200000; to allow it: --set elements=",
    ),
    "an escape": ('"linkage"', '"a\x1b[31m"', "not XML: line 1: not well-formed"),
    "too long": ("</{root}>", "<!--" + "x" * 10_000_000, "MB, at most 10; to allow it: --set file_size=11"),
}
"""Of every XML format: what is replaced, by what, and the message."""


def xml_cases() -> Iterator[Case]:
    for file, root in (("model.xml", "mujoco"), ("robot.urdf", "robot")):
        for name, (old, new, message) in XML_EDITS.items():
            old, new = old.replace("{root}", root), new.replace("{root}", root)
            content = TEXTS[file].replace(old, new, 1).encode()
            yield Case(f"{file}: {name}", file, content, message.replace("{root}", root))


def cases() -> list[Case]:
    """All of them, in the same order and with the same bytes every time."""
    makers = (byte_cases, xml_cases, mjcf_cases, urdf_cases, loop_cases, scene_cases)
    return [case for maker in makers for case in maker()]
