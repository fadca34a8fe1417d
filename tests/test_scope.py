"""The tables of supported elements are what the readers report."""

from __future__ import annotations

import re

import pytest
from scope import BEGIN, END, PAGE, TABLES, probes, table


def table_of_page(name: str) -> str:
    """Return a table of the page."""
    return PAGE.read_text().partition(BEGIN.format(name))[2].partition(END.format(name))[0]


@pytest.mark.parametrize("name", TABLES)
def test_the_page_has_all_elements(name):
    elements = re.findall(r"^\| (.*?) \| ", table_of_page(name), re.MULTILINE)
    assert elements[1:] == [probe.element for probe in probes(name)]


@pytest.mark.slow  # reads 70 files
@pytest.mark.parametrize("name", TABLES)
def test_the_page_is_what_readers_report(name):
    assert table_of_page(name) == table(name), "python tests/support/scope.py writes the page"
