"""What the site is made of: pages, pictures, and the reports that pages show."""

from __future__ import annotations

import re

from msv2.document.site import SECTIONS, gather
from spec.paths import DOCS


def test_every_picture_and_file_that_a_page_shows_is_in_the_site(tmp_path):
    gather(tmp_path / "source")
    shown = 0
    for page in (tmp_path / "source").glob("*.md"):
        for link in re.findall(r"\]\((?!https?:|#)([^)#\s]+)", page.read_text(encoding="utf-8")):
            if link.endswith((".png", ".jpg", ".webp", ".html")):
                assert (page.parent / link).is_file(), (page.name, link)
                shown += 1
    assert shown > 15


def test_the_sections_name_pages_that_are_there():
    named = [name for names in SECTIONS.values() for name in names]
    assert len(named) == len(set(named)) and all((DOCS / f"{name}.md").is_file() for name in named)
