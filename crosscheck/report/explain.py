"""Explanations of the names that commands print: levels, checks, verdicts, causes, findings.

The texts are the files of `explanations`, in Markdown: a heading for each name, then what the name means.
Paragraphs with labels state how the tolerance of a check follows, what a failure usually means and what to
do. `crosscheck explain` prints the texts, and the site has a page of them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cache
from pathlib import Path

from crosscheck.compare.outcome import Outcome
from crosscheck.compare.result import EngineComparison
from crosscheck.support.errors import CrosscheckError

FOLDER = Path(__file__).parent / "explanations"

TOPICS = (
    "levels",
    "checks",
    "reading_checks",
    "faults",
    "verdicts",
    "statuses",
    "notes",
    "lines",
    "accuracy",
    "own_run_causes",
    "errors",
    "fates",
    "findings",
    "standings",
    "differences",
    "importers",
    "baselines",
    "conformance",
)
"""Names of the files, in the order of the output."""

LABELS = ("Tolerance", "Failure", "Likely cause", "Next")
"""Labels of paragraphs of an explanation, in their order."""

TOPICS_WITH_HEADINGS = (
    "levels",
    "checks",
    "reading_checks",
    "faults",
    "verdicts",
    "notes",
    "lines",
    "findings",
)
"""Topics with a heading for each name on the site; the names of other topics are rows of tables."""

MAX_SIMILAR = 3
"""Largest number of similar names in the message on an unknown name."""


@dataclass(frozen=True)
class Explanation:
    """Explanation of one name.

    Attributes:
        name: the name as commands print it, without a unit.
        also: other spellings, such as "OFF BY" for the accuracy OFF.
        meaning: what was compared, or what the name means.
        labeled: further paragraphs by label, one of `LABELS`.
        group: heading of the names on the site that begin with this name; "" to continue the group.
        group_text: what all names of the group have in common.
    """

    name: str
    also: tuple[str, ...]
    meaning: str
    labeled: dict[str, str]
    group: str = ""
    group_text: str = ""


@dataclass(frozen=True)
class Topic:
    """Explanations of names of one kind.

    Attributes:
        title: the kind, such as "Verdicts".
        text: what all names of the kind have in common.
        explanations: the explanations.
    """

    title: str
    text: str
    explanations: tuple[Explanation, ...]


@cache
def topics() -> tuple[Topic, ...]:
    """Read all explanations, in the order of `TOPICS`; the files are a part of this package."""
    return tuple(map(read_topic, TOPICS))


def read_topic(name: str) -> Topic:
    """Read the explanations of one topic, see `TOPICS`."""
    head, *sections = (FOLDER / f"{name}.md").read_text().split("\n## ")
    title, *texts = _paragraphs(head.removeprefix("# "))
    explanations: list[Explanation] = []
    for section in sections:
        each = _explanation(section)
        if explanations and not each.group:
            each = replace(each, group_text=explanations[-1].group_text)
        explanations.append(each)
    return Topic(title, " ".join(texts), tuple(explanations))


def _explanation(section: str) -> Explanation:
    """Read one explanation: its name, and paragraphs with or without a label."""
    name, *paragraphs = _paragraphs(section)
    also: tuple[str, ...] = ()
    meaning, labeled, group, group_text = [], dict[str, str](), "", ""
    for paragraph in paragraphs:
        label, colon, text = paragraph.partition(": ")
        if colon and label == "Also":
            also = tuple(text.split("; "))
        elif colon and label == "Group":
            group, _, group_text = text.partition(": ")
        elif colon and label in LABELS:
            labeled[label] = text
        else:
            meaning.append(paragraph)
    return Explanation(name, also, " ".join(meaning), labeled, group, group_text)


def _paragraphs(text: str) -> list[str]:
    """Return the paragraphs of a text, each in one line."""
    return [" ".join(paragraph.split()) for paragraph in text.split("\n\n") if paragraph.strip()]


def explain(name: str) -> list[tuple[Topic, Explanation]]:
    """Return the explanations of a name, each with its topic; a check and a difference may share a name.

    Args:
        name: the name, in capitals or not, with or without a unit ("positions, m").

    Raises:
        CrosscheckError: for an unknown name, with the most similar ones.
    """
    known = [(topic, each) for topic in topics() for each in topic.explanations]
    whole = _normalized(name)
    wanted = {whole, whole.rpartition(", ")[0]}  # without the unit
    found = [
        (topic, each) for topic, each in known if wanted & set(map(_normalized, (each.name, *each.also)))
    ]
    if not found:
        spellings = {_normalized(text): text for _, each in known for text in (each.name, *each.also)}
        similar = [spellings[text] for text in get_close_matches(whole, spellings, MAX_SIMILAR)]
        near = f"did you mean {' or '.join(map(repr, similar))}? " if similar else ""
        raise CrosscheckError(f"no explanation of {name!r:.60}; {near}`crosscheck explain` lists all names")
    return found


def _normalized(name: str) -> str:
    """Return a name in lower case, with spaces for hyphens and without the end of a comparison in time."""
    words = re.sub(r" until \S+ s\b", "", name.lower())
    return " ".join(re.sub(r"[-_]", " ", words).split())


def names_to_explain(result: EngineComparison) -> tuple[str, ...]:
    """Return the names that explain the verdict of a crosscheck; none if the engines agree."""
    if result.outcome is Outcome.AGREE:
        return ()
    first = next(iter(result.diagnosis), None)
    if first is None:
        return (result.outcome.value.lower(),)
    # without the second part of "accelerations and reactions", as in the table of levels
    return tuple(dict.fromkeys(filter(None, [first.level.partition(" and ")[0], first.fault])))


def explanation_lines(topic: Topic, explanation: Explanation) -> Iterator[str]:
    """Yield the lines of an explanation for the terminal."""
    yield f"{explanation.name} ({topic.title})"
    yield f"  {' '.join(filter(None, [explanation.meaning, explanation.group_text]))}"
    for label in LABELS:
        if label in explanation.labeled:
            yield f"  {label}: {explanation.labeled[label]}"


def explanation_markdown(name: str) -> Iterator[str]:
    """Yield the lines of the explanations of one topic for a page of the site.

    Each name has a heading (see `TOPICS_WITH_HEADINGS`) or a row of a table with an anchor. Each group of
    names has a heading and, in topics with tables, a table.

    Args:
        name: the topic, one of `TOPICS`.
    """
    topic = read_topic(name)
    yield f"## {topic.title}\n\n{topic.text}\n"
    groups: list[list[Explanation]] = []
    for each in topic.explanations:
        if each.group or not groups:
            groups.append([])
        groups[-1].append(each)
    for group in groups:
        first = group[0]
        if first.group:
            yield f"### {first.group}\n"
        if first.group_text:
            yield f"{first.group_text}\n"
        if name in TOPICS_WITH_HEADINGS:
            yield from _with_headings(group, "####" if first.group else "###")
        else:
            yield from _table(name, group)
            title = first.group or topic.title
            yield f"\nTable: {title[0].lower()}{title[1:]}.\n"


def _with_headings(group: list[Explanation], mark: str) -> Iterator[str]:
    """Yield explanations with a heading for each name.

    Args:
        group: the explanations.
        mark: number signs of a heading.
    """
    for each in group:
        yield f"{mark} {each.name}\n\n{each.meaning}{_also(each)}\n"
        for label in LABELS:
            if label in each.labeled:
                yield f"- **{label}**: {each.labeled[label]}"
        yield ""


def _table(topic: str, group: list[Explanation]) -> Iterator[str]:
    """Yield a table with a row for each name, whose anchor has the topic and the name.

    Args:
        topic: the topic, one of `TOPICS`.
        group: the explanations.
    """
    has_next = any(each.labeled for each in group)
    yield "| name | meaning | what you do |\n|---|---|---|" if has_next else "| name | meaning |\n|---|---|"
    for each in group:
        anchor = f"{topic}-{re.sub('[^a-z0-9]+', '-', each.name.lower())}"
        last = f" {each.labeled.get('Next', 'nothing')} |" if has_next else ""
        yield f"| [{each.name}](#{anchor}){{ #{anchor} }} | {each.meaning}{_also(each)} |{last}"


def _also(explanation: Explanation) -> str:
    """Return a sentence with the words of the terminal for a name; empty if the page has them anyway."""
    known = f"{explanation.name} {explanation.meaning}"
    words = [f"`{text}`" for text in explanation.also if text not in known]
    return f" On the terminal: {', '.join(words)}." if words else ""
