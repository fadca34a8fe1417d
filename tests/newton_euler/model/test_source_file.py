"""Rows of CSV files."""

from __future__ import annotations

import pytest

from newton_euler.model.source_file import Row, csv_rows


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_comments_are_left_out_whatever_they_say_and_however_lines_end(end: str) -> None:
    lines = ["# a; b; 'c", "time,force", "  # 1;2", "0,1.5", "#", "1,2.5"]
    assert csv_rows("motion.csv", end.join(lines) + end, comments=True) == [
        Row(2, ["time", "force"]),
        Row(4, ["0", "1.5"]),
        Row(6, ["1", "2.5"]),
    ]
