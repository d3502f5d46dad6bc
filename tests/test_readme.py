"""The README is short, its tables and those of docs/ are what reports/ give, and its commands and links exist."""

import re
import shutil

import pytest

from msv2.studies.page import marked_tables
from msv2.studies.results.headline import HEADLINE_TABLES
from msv2.studies.results.tables import PAGES, TABLES, fill
from spec.errors import InputError
from spec.paths import REPORTS, ROOT

README = ROOT / "README.md"
MOST_BYTES, MOST_ROWS = 12 * 1024, {"headline": 12, "tradeoff": 6, "stability": 6, "effects": 6}


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_tables_are_current(path):
    assert fill(path, REPORTS, check=True) == 0, "run: make results ONLY=tables"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_a_changed_number_is_noticed(path, tmp_path):
    """The last digit of each table."""
    text, page = path.read_text(), tmp_path / path.name
    for name in marked_tables(text):
        table = re.search(rf"<!-- table:{name} -->\n(.*?)<!-- end -->", text, flags=re.S)
        at = table.start(1) + max(found.start() for found in re.finditer(r"\d", table[1]))
        page.write_text(text[:at] + str((int(text[at]) + 1) % 10) + text[at + 1 :])
        assert fill(page, REPORTS, check=True) == 1, name
    assert fill(page, REPORTS) == 0 and page.read_text() == text


def test_a_number_of_the_readme_is_in_a_report():
    """Every table with a number is generated, so that --check holds it to the reports."""
    text = re.sub(r"<!-- table:\w+ -->\n.*?<!-- end -->", "", README.read_text(), flags=re.S)
    by_hand = [line for line in text.splitlines() if line.startswith("|")]
    assert by_hand and not [line for line in by_hand if re.search(r"\d", re.sub(r"\]\([^)]*\)", "", line))]


def test_the_readme_is_short():
    text = README.read_text()
    assert len(text.encode()) <= MOST_BYTES
    for name, most in MOST_ROWS.items():
        table = re.search(rf"<!-- table:{name} -->\n(.*?)<!-- end -->", text, flags=re.S)[1]
        assert 2 < len(table.splitlines()) <= most + 2, name


def test_an_unknown_table_is_refused(tmp_path):
    (tmp_path / "page.md").write_text("<!-- table:presents -->\n<!-- end -->\n")
    with pytest.raises(InputError, match="table 'presents' is not known"):
        fill(tmp_path / "page.md", REPORTS)


def test_tables_stay_where_there_is_no_report(tmp_path):
    text = "<!-- table:training_ablation -->\n| kept |\n<!-- end -->\n<!-- table:order -->\n| gone |\n<!-- end -->\n"
    (tmp_path / "page.md").write_text(text)
    assert fill(tmp_path / "page.md", tmp_path) == 0
    filled = (tmp_path / "page.md").read_text()
    assert "| kept |" in filled and "| gone |" not in filled


def test_the_headline_stays_where_a_report_is_missing(tmp_path):
    shutil.copy(REPORTS / "frames.json", tmp_path)
    assert all(table({}) is None for table in HEADLINE_TABLES.values())


def test_every_table_is_shown_once():
    shown = [name for path in PAGES for name in marked_tables(path.read_text())]
    assert sorted(shown) == sorted(TABLES)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)
def test_every_target_and_every_link_exists(path):
    text, makefile = path.read_text(), (ROOT / "Makefile").read_text()
    targets = re.findall(r"^ +(?:[A-Z0-9_]+=\S+ )*make ([a-z-]+)", text, flags=re.M) + re.findall(r"`make ([a-z-]+)", text)
    for target in targets:
        assert re.search(rf"^{target}:", makefile, flags=re.M), target
    for link in re.findall(r"\]\(([^)#]+)\)", text):
        assert link.startswith("http") or (path.parent / link).exists(), link
