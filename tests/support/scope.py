"""Write the tables of supported elements in `docs/how_to/scope.md`: what the readers report of small files.

`python tests/support/scope.py` writes the page. Each row has a small file with one element. The row has those
entries of the reader's import report that the file without the element does not cause. A test compares the
page with what the readers report today.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import yaml

import mjcf
import urdf
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Cell, Table, text_columns
from newton_euler.errors import NewtonEulerError

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "scope.md"

BEGIN, END = "<!-- {}: begin -->\n", "<!-- {}: end -->"
"""Lines around a table of the page."""


class Probe(NamedTuple):
    """An element, and the places of a file that have it.

    Attributes:
        element: name in the table.
        places: text by place of the small file.
        options: options of the reader.
        about: regular expression of the reported entries that are about the element; all if empty.
    """

    element: str
    places: dict[str, str]
    options: Mapping[str, str] = MappingProxyType({})
    about: str = ""


MJCF = """<mujoco><option timestep="0.002" {option}>{flag}</option>
<default><geom size=".1" mass="1" contype="0" conaffinity="0"/></default>
<worldbody>{world}<body name="a"><joint name="j" axis="0 1 0" {joint}/>{joints}<geom name="g"/>
<site name="s" pos=".1 0 0"/>{inside}
<body name="b" pos=".5 0 0" {body}><joint name="k" axis="0 1 0"/><geom/><site name="t" pos=".1 0 0"/></body>
</body></worldbody>{bottom}</mujoco>"""

URDF = """<robot name="r" xmlns:drake="http://drake.mit.edu"><link name="world"/>
<link name="a"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>{link}</link>
<link name="b"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j" type="{type}"><parent link="world"/><child link="a"/><axis xyz="0 1 0"/>{limit}{joint}</joint>
<joint name="k" type="continuous"><parent link="a"/><child link="b"/><origin xyz="1 0 0"/>
<axis xyz="0 1 0"/>{second}</joint>{bottom}</robot>"""

PROBES = yaml.safe_load(Path(__file__).with_name("scope_probes.yaml").read_text())
"""Elements by name of the table."""

TABLES: dict[str, tuple[str, str, Callable[..., Any], dict[str, str]]] = {
    "mjcf": ("xml", MJCF, mjcf.read, {}),
    "urdf": ("urdf", URDF, urdf.read, {"type": "continuous"}),
    "dialects": ("urdf", URDF, urdf.read, {"type": "continuous"}),
}
"""Suffix, file, reader, and usual content of the file's places, by name of the table."""


def probes(name: str) -> list[Probe]:
    """Return the elements of a table."""
    return [Probe(**entry) for entry in PROBES[name]]


def table(name: str) -> str:
    """Return a table of the page, in Markdown."""
    suffix, text, read, usual = TABLES[name]
    places = dict.fromkeys(re.findall(r"{(\w+)}", text), "") | usual

    def entries(probe: Probe, folder: Path) -> dict[str, Any]:
        path = folder / f"probe.{suffix}"
        path.write_text(text.format(**places | probe.places))
        return {str(entry): entry for entry in read(path, **probe.options).report.entries}

    def rows() -> Iterator[list[str | Cell]]:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            without = entries(Probe("", {}), folder)
            for probe in probes(name):
                try:
                    found = entries(probe, folder)
                except NewtonEulerError as error:
                    yield [probe.element, "refused", shown(re.sub(r"^.*?: line \d+: ", "", str(error)))]
                    continue
                new = [entry for key, entry in found.items() if key not in without]
                new = [entry for entry in new if re.search(probe.about, entry.how)]
                result = fate(new)
                # what the element needs, such as the limits beside a speed, tells nothing about the element
                about = [entry for entry in new if fate([entry]) == result]
                told = [entry for entry in about if not re.match("part of|its known parts", entry.how)]
                yield [
                    probe.element,
                    result,
                    shown("; ".join(dict.fromkeys(entry.how for entry in told or about))),
                ]

    columns = text_columns("element", "simulated", "the reader reports")
    return "\n".join(markdown_table(Table("", columns, [*rows()]))) + "\n"


def fate(entries: list[Any]) -> str | Cell:
    """Return the worst result of some entries."""
    if any(entry.is_unsimulated for entry in entries):
        return Cell("no", "fails")
    if any(entry.fate == "approximated" for entry in entries):
        return "approximated"
    if any(entry.is_soft_in_file for entry in entries):
        return "rigid"
    if any(entry.fate == "exactly" for entry in entries):
        return "yes"
    return "not needed"


def shown(how: str) -> str:
    """Return what a reader reports in one line."""
    return re.sub(r"\s+", " ", how)


def with_tables(page: str) -> str:
    """Return a page with the tables of today."""
    for name in TABLES:
        begin, end = BEGIN.format(name), END.format(name)
        before, _, rest = page.partition(begin)
        page = before + begin + table(name) + end + rest.partition(end)[2]
    return page


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text()))
