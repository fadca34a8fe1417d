"""Pages (HTML) taken apart, with the checks that hold for each of them."""

from __future__ import annotations

import base64
from html.parser import HTMLParser
from pathlib import Path

VOID = {"meta", "br", "img"}
"""Elements without an end."""

ORDER = ("answer", "pictures", "next", "details")
"""Classes of the parts of a result, in their order: verdict, pictures, what to do, and what is folded."""


class Page(HTMLParser):
    """A page, taken apart.

    Creation fails if elements are not nested, if the browser would fetch something, if a picture has no text,
    or if the parts of a result are in another order.

    Attributes:
        seen: names of the elements.
        text: texts, without the style.
        images: pictures by their texts.
        anchors, links: places of the page, and those that it refers to.
        parts: classes of the parts of each result, in their order.
        open_details: number of details that are not folded.
        uncovered_tables: number of tables that neither scroll nor belong to a chart.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.classes: list[str] = []
        self.seen: set[str] = set()
        self.text: list[str] = []
        self.images: dict[str, bytes] = {}
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.parts: list[list[str]] = []
        self.open_details = self.uncovered_tables = 0
        self.feed(path.read_text(encoding="utf-8"))
        self.close()
        assert self.tags == []
        for parts in self.parts:
            assert parts == [name for name in ORDER if name in parts], parts
            assert {"answer", "details"} <= set(parts)
        assert (self.open_details, self.uncovered_tables) == (0, 0)

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        classes = (attributes.get("class") or "").split()
        self.seen.add(tag)
        if tag == "article":
            self.parts.append([])
        if self.parts and "article" in self.tags:
            self.parts[-1] += [name for name in ORDER if name in classes]
        self.open_details += tag == "details" and "open" in attributes
        around = set(" ".join(self.classes).split())
        self.uncovered_tables += tag == "table" and not {"scroll", "bars"} & around
        if tag not in VOID:
            self.tags.append(tag)
            self.classes.append(" ".join(classes))
        if "id" in attributes:
            self.anchors.add(attributes["id"])
        assert not {"srcset", "background", "action", "data"} & attributes.keys()
        if tag == "svg":
            assert attributes["aria-label"]
        if "src" in attributes:
            kind, _, content = attributes["src"].partition("base64,")
            assert (tag, kind) == ("img", "data:image/png;")
            assert attributes["alt"]
            self.images[attributes["alt"]] = base64.b64decode(content, validate=True)
        if "href" in attributes:
            assert tag == "a"
            assert attributes["href"].startswith("#")
            self.links.add(attributes["href"][1:])

    def handle_endtag(self, tag):
        assert self.tags.pop() == tag
        self.classes.pop()

    def handle_data(self, data):
        if self.tags and self.tags[-1] != "style":
            self.text.append(data)

    @property
    def words(self) -> str:
        """All texts, a line each."""
        return "\n".join(self.text)
