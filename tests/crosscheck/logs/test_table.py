"""Files of logs: comments before the header, and headers that are comments."""

from __future__ import annotations

import numpy as np
import pytest

from crosscheck.logs.table import read_table
from newton_euler.model.source_file import SourceError

ROWS = "0,1,2\n0.1,1.5,\n0.2,1.75,2.5\n"


@pytest.mark.parametrize(
    ("head", "line"),
    [
        ("t,q1,q2\n", 2),
        ("# t, q1, q2\n", 2),
        ("#t,q1,q2\r\n", 2),
        ('# robot, arm\n\n  # made by "me\nt,q1,q2\n', 5),
        ("# robot\n# t,q1,q2\n", 3),
        ("# 5 Hz, 3 columns, of 2 joints, no inputs\nt,q1,q2\n", 3),
    ],
)
def test_comments_before_the_header_and_headers_that_are_comments(tmp_path, head, line):
    (tmp_path / "log.csv").write_text(head + ROWS, newline="")
    table = read_table(tmp_path / "log.csv")
    assert list(table.columns) == ["t", "q1", "q2"]
    np.testing.assert_array_equal(table.columns["q2"], [2.0, np.nan, 2.5])
    assert (table.lines, table.texts) == ((line, line + 1, line + 2), {})


def test_a_file_of_numpy(tmp_path):
    numbers = np.arange(8.0).reshape(4, 2)
    np.savetxt(tmp_path / "log.csv", numbers, delimiter=",", header="my run\nt, crank")
    columns = read_table(tmp_path / "log.csv").columns
    np.testing.assert_array_equal(np.column_stack([columns["t"], columns["crank"]]), numbers)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# robot\n# arm\n" + ROWS, "line 3: has numbers after comments that name no columns"),
        ("# robot\nt,t,q2\n" + ROWS, "line 2: column 't' is there twice"),
        ("# t,q1,q1\n" + ROWS, "line 1: column 'q1' is there twice"),
        ("# robot\nt;q1;q2\n" + ROWS, "line 2: columns are separated by ';'"),
        ("# robot\nt,q1\n" + ROWS, "line 3: has 3 cells; needed: 2"),
        ("# robot\n", "has 0 rows"),
    ],
)
def test_faults_beside_comments_get_one_line(tmp_path, text, words):
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(SourceError) as error:
        read_table(tmp_path / "log.csv")
    assert words in str(error.value)
    assert "\n" not in str(error.value)
