"""docs/stages.md: every stage, unit and module of the table."""

from __future__ import annotations

from msv2.document import stages as document
from spec.paths import DOCS
from spec.stages import EVERY_STAGE


def test_the_page_is_not_stale_and_names_everything():
    page = document.page()
    assert (DOCS / "stages.md").read_text(encoding="utf-8") == page, "run `python -m msv2.document`"
    for stage in EVERY_STAGE:
        assert page.count(f"\n| `{stage.name}` |") == 2 and stage.does in page
        assert all(f"`{name}`" in page for name in (*stage.golden, *stage.rtl, *stage.units, *stage.suites, *stage.counters))
