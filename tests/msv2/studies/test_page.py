"""Tables and pages: alignment, what stands where nothing was measured, what is filled in."""

from __future__ import annotations

import pytest

from msv2.studies import page
from spec.errors import InputError

TEXT = "# Page\n\n<!-- table:one -->\nold\n<!-- end -->\n\nwords\n\n<!-- table:two -->\n<!-- end -->\n"


def test_columns_are_aligned():
    assert page.table(["a", "b"], [["x", 1]]) == "| a | b |\n| --- | --- |\n| x | 1 |"
    shown = page.table(["a", "b", "why"], [["x", 1, "y"]], left=1, words=["why"])
    assert shown.splitlines()[1] == "| --- | ---: | --- |"


def test_no_row_is_told():
    assert page.table(["a"], []) == page.ABSENT and page.table(["a"], [], empty="none") == "none"


def test_a_row_that_does_not_fit_is_an_error():
    with pytest.raises(ValueError, match="a row of 1 cells does not fit a head of 2"):
        page.table(["a", "b"], [["x"]])


def test_tables_are_filled_between_their_markers(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(TEXT)
    tables = {"one": lambda: "| new |\n", "two": lambda: None}
    assert page.fill(path, tables, check=True) == 1 and path.read_text() == TEXT
    assert page.fill(path, tables) == 0 and path.read_text() == TEXT.replace("old", "| new |")
    assert page.fill(path, tables, check=True) == 0
    assert page.marked_tables(TEXT) == ["one", "two"]


def test_a_page_without_a_table_is_refused_where_all_are_wanted(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(TEXT)
    tables = {name: lambda: None for name in ("one", "two", "three")}
    assert page.fill(path, tables) == 0
    with pytest.raises(InputError, match="no place for the table 'three'"):
        page.fill(path, tables, complete=True)
    with pytest.raises(InputError, match="table 'two' is not known: one are"):
        page.fill(path, {"one": lambda: None})


def test_a_page_is_whole_and_ends_with_one_line_break(tmp_path):
    page.write_page(tmp_path / "page.md", "text\n\n")
    assert (tmp_path / "page.md").read_bytes() == b"text\n" and len(list(tmp_path.iterdir())) == 1
