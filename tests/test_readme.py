"""The README's tables are what reports/ give, and its commands exist."""

import re
import sys

from spec.paths import ROOT

sys.path.insert(0, str(ROOT))

from msv2.studies.results.tables import TABLES, fill_readme


def test_tables_are_current():
    assert fill_readme(ROOT / "README.md", ROOT / "reports", check=True) == 0, "run: make results ONLY=tables"


def test_a_changed_number_is_noticed(tmp_path):
    text = (ROOT / "README.md").read_text()
    stale = re.sub(r"(\d+) um²", lambda m: f"{int(m[1]) + 1} um²", text, count=1)
    assert stale != text
    (tmp_path / "README.md").write_text(stale)
    assert fill_readme(tmp_path / "README.md", ROOT / "reports", check=True) == 1
    assert fill_readme(tmp_path / "README.md", ROOT / "reports") == 0
    assert (tmp_path / "README.md").read_text() == text


def test_tables_of_training_stay_where_there_is_no_report(tmp_path):
    text = "<!-- table:training_ablation -->\n| kept |\n<!-- end -->\n<!-- table:order -->\n| gone |\n<!-- end -->\n"
    (tmp_path / "README.md").write_text(text)
    assert fill_readme(tmp_path / "README.md", tmp_path) == 0
    filled = (tmp_path / "README.md").read_text()
    assert "| kept |" in filled and "| gone |" not in filled


def test_every_table_is_shown_and_every_target_exists():
    text, makefile = (ROOT / "README.md").read_text(), (ROOT / "Makefile").read_text()
    assert set(re.findall(r"<!-- table:(\w+) -->", text)) == set(TABLES)
    for target in re.findall(r"^ +(?:[A-Z0-9_]+=\S+ )*make ([a-z-]+)", text, flags=re.M):
        assert re.search(rf"^{target}:", makefile, flags=re.M), target
    for page in re.findall(r"\]\((docs/[^)#]+)\)", text):
        assert (ROOT / page).exists(), page
