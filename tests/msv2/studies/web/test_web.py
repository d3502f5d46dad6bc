"""Pages of HTML: what they open with, what folds, what a check finds, and how they behave in a browser."""

from __future__ import annotations

import pytest
from PIL import Image

from msv2.studies.web import browser, look, maker
from msv2.studies.web.check import markdown_problems, problems
from msv2.studies.web.maker import Chapter
from msv2.studies.web.markdown import body
from spec.errors import InputError

TEXT = """\
# Left out

Words before the first section.

## Speeds

| frame | cycles | why |
| --- | --- | --- |
| b | 1,200 | x |
| a | 90 | y |
| c | - | z |
| d | -3.5 | w |

## A [link](there.md) and `code`

- one **bold** word
- two

    indented code, `**not bold**`
"""

needs_chromium = pytest.mark.skipif(browser.find_chromium() is None, reason=f"needs Chromium: {browser.HINT}")


def whole_page(summary: str = "<p>summary</p>") -> str:
    return maker.page("A & B", summary, [Chapter("Numbers", TEXT)])


@pytest.fixture
def page(tmp_path):
    (tmp_path / "there.md").write_text("# There\n")
    Image.new("RGB", (40, 30), "red").save(tmp_path / "p.png")
    path = tmp_path / "page.html"
    maker.write_html(path, whole_page(f'<div class="crops">{maker.picture("p.png", "a **red** picture")}</div>'))
    return path


def test_a_page_opens_with_its_summary_and_everything_else_folds(page):
    text = page.read_text()
    assert "<title>A &amp; B</title>" in text and "Left out" not in text
    assert text.index("red</b> picture") < text.index("<section>") and text.count("<details") == 3
    assert '<details id="numbers-speeds">' in text and '<details id="numbers-about">' in text
    assert "open>" not in text and '<th class="number">cycles</th>' in text and "<pre>indented code" in text
    assert problems(page) == []


def test_markdown_that_is_left_is_found(tmp_path):
    (tmp_path / "page.html").write_text(
        "<p>so **bold** it is</p><td>|---|</td><p>a `word`</p><p>[x](y)</p><pre>**fine** `here`</pre>")
    found = "\n".join(problems(tmp_path / "page.html"))
    for what in ("(bold)", "(rule of a table)", "(code)", "(link)"):
        assert what in found
    assert found.count("raw Markdown") == 6 and "fine" not in found  # both stars, the rule, both ticks, the link


def test_links_and_pictures_that_lead_nowhere_are_found(page):
    page.write_text(page.read_text() + '<a href="#numbers-speeds">x</a><a href="#nowhere">x</a><a href="gone.md#a">x</a>'
                    '<img src="gone.png" alt="y"><img src="p.png"><script src="https://example.org/x.js"></script>')
    assert problems(page) == [
        "a link to #nowhere, which is not on the page", "gone.md#a does not exist", "gone.png does not exist",
        "a picture without a description: p.png", "needs the network: https://example.org/x.js"]
    (page.parent / "page.md").write_text("# A b\n\n[x](#a-b) [y](gone.md) ![z](p.png)\n")
    assert markdown_problems(page.parent / "page.md") == ["gone.md does not exist"]


def test_a_page_that_is_too_large_is_not_written_and_pictures_do_not_count(page):
    tmp_path = page.parent
    picture = maker.data_uri(b"x" * maker.MOST_BYTES * 2, ".png")
    maker.write_html(tmp_path / "small.html", whole_page(f'<img src="{picture}" alt="large">'))
    assert problems(tmp_path / "small.html") == []
    with pytest.raises(ValueError, match="without pictures"):
        maker.write_html(tmp_path / "large.html", whole_page("x" * maker.MOST_BYTES))
    (tmp_path / "large.html").write_text("x" * (maker.MOST_BYTES + 1))
    assert "without pictures" in problems(tmp_path / "large.html")[0]


def test_pictures_are_put_into_a_page(page):
    maker.write_html(page, whole_page(maker.picture("p.png", "red")), [page.parent / "p.png"])
    text = page.read_text()
    assert 'src="data:image/png;base64,' in text and 'src="p.png"' not in text and problems(page) == []


def test_columns_are_told_by_their_cells():
    made = body("| name | value | why |\n| --- | ---: | --- |\n| a | 1.5 % | " + "long " * 20 + "|\n| b | - | no |")
    assert '<td class="short">a</td><td class="number">1.5 %</td><td class="words">long' in made


@needs_chromium
def test_tables_sort_and_links_unfold(page):
    with browser.browser() as window:
        window.open(page.as_uri(), 1280, 800)
        column = "[...document.querySelectorAll('tbody tr')].map(row => row.cells[{}].textContent)"

        def click(number: int) -> list[str]:
            window.run(f"document.querySelectorAll('thead th')[{number}].click()")
            return window.run(column.format(number))

        assert click(1) == ["-3.5", "90", "1,200", "-"]
        assert click(1) == ["-", "1,200", "90", "-3.5"]
        assert click(0) == ["a", "b", "c", "d"]
        assert window.run("document.querySelectorAll('details[open]').length") == 0
        window.run("location.hash = '#numbers-speeds'; new Promise(done => setTimeout(done, 100))")
        assert window.run("[...document.querySelectorAll('details[open]')].map(e => e.id)") == ["numbers-speeds"]
        window.run("document.querySelector('button.fold').click()")
        assert window.run("document.querySelectorAll('details:not([open])').length") == 0
        assert window.complaints() == []


@needs_chromium
def test_screenshots_are_as_wide_as_windows_and_faults_are_named(page, capsys):
    folder = page.parent
    made, found = look.look(page, folder)
    assert found == [] and [Image.open(path).width for path in made] == [1280, 1280, 400, 400]
    wide = maker.page("wide", '<div style="width:900px;height:900px">x</div><img src="gone.png" alt="gone">'
                      "<script>console.error('seen')</script>", [])
    page.write_text(wide)
    _, found = look.look(page, folder)
    told = "\n".join(found)
    for part in ("at 400 pixels: 9", "the picture 'gone' does not load", "more than 800", "console: seen"):
        assert part in told, told
    assert not look.take_screenshots(page, folder) and "LOOK: " in capsys.readouterr().out


def test_without_chromium_its_package_is_named(monkeypatch, tmp_path, capsys):
    for module in (browser, look):
        monkeypatch.setattr(module, "find_chromium", lambda: None)
    assert look.take_screenshots(tmp_path / "page.html", tmp_path)
    assert "apt-get install chromium" in capsys.readouterr().out
    with pytest.raises(InputError, match="apt-get install chromium"):
        look.look(tmp_path / "page.html", tmp_path)


