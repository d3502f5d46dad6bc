"""Makes the HTML pages of the studies: a summary of one screen, and below it sections that fold.

A page is one file. It uses no font, script or style of another host.
"""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from golden.scenes.files import atomic_output
from msv2.studies.web.markdown import anchor, blocks, body, inline
from msv2.studies.web.style import SCRIPT, STYLE

MOST_BYTES = 300 * 1024
"""The largest size of a page without the pictures in it."""

MEDIA = {".png": "image/png", ".jpg": "image/jpeg", ".svg": "image/svg+xml"}


@dataclass(frozen=True)
class Chapter:
    """A part of a page below the summary.

    Attributes:
        title: the heading.
        text: Markdown. Every heading of level 2 begins a section that folds; what stands before the first one is a section
            named `about`. A heading of level 1 is left out, because the chapter has a title.
        about: the title of the section of what stands before the first heading.
    """

    title: str
    text: str
    about: str = "About these numbers"


def cards(numbers: Iterable[tuple[str, str]]) -> str:
    """Numbers with their meaning, as boxes beside each other: pairs of a number and the words below it."""
    return '<div class="cards">' + "".join(
        f'<div class="card"><b>{inline(number)}</b><span>{inline(words)}</span></div>' for number, words in numbers) + "</div>"


def picture(path: str, caption: str, alt: str | None = None) -> str:
    """A figure with a caption of Markdown; `alt` is the text for readers who do not see it (default: the caption)."""
    words = re.sub(r"[*`]|\[|\]\([^)]*\)", "", caption if alt is None else alt)
    return (f'<figure><img src="{html.escape(path)}" alt="{html.escape(words)}">'
            f"<figcaption>{inline(caption)}</figcaption></figure>")


def fold(title: str, content: str, name: str | None = None, unfolded: bool = False) -> str:
    """A section that folds; `content` is HTML, and `name` is what links call the section."""
    return (f'<details id="{name or anchor(title)}"{" open" if unfolded else ""}><summary>{inline(title)}</summary>\n'
            f"{content}\n</details>")


def sections(text: str) -> list[tuple[str, str]]:
    """The parts of a text of Markdown by its headings of level 2, with their titles; "" for what stands before the first."""
    out: list[tuple[str, list[str]]] = [("", [])]
    for block in blocks(text):
        if block[0].startswith("## "):
            out.append((block[0][3:], []))
        elif not block[0].startswith("# "):
            out[-1][1].append("\n".join(block))
    return [(title, "\n\n".join(parts)) for title, parts in out if title or parts]


def _chapter(chapter: Chapter) -> str:
    name = anchor(chapter.title)
    parts = [fold(title or chapter.about, body(text), f"{name}-{anchor(title or 'about')}")
             for title, text in sections(chapter.text)]
    return f'<section><h2 id="{name}">{inline(chapter.title)}</h2>\n' + "\n".join(parts) + "</section>"


def page(title: str, summary: str, chapters: Sequence[Chapter]) -> str:
    """The HTML of a page.

    Args:
        title: its title in plain words.
        summary: HTML that stands on the first screen, below the title.
        chapters: what folds.
    """
    links = "".join(f'<a href="#{anchor(c.title)}">{inline(c.title)}</a>' for c in chapters)
    button = '<button class="fold" type="button">unfold all sections</button>' if chapters else ""
    return ('<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
            '<meta name="viewport" content="width=device-width, initial-scale=1">'
            f"<title>{html.escape(title)}</title><link rel=\"icon\" href=\"data:,\"><style>\n{STYLE}</style></head><body>\n"
            f'<div id="summary"><h1>{html.escape(title)}</h1>\n{summary}\n<nav>{links}{button}</nav></div>\n'
            + "\n".join(map(_chapter, chapters)) + f"\n<script>\n{SCRIPT}</script></body></html>\n")


def data_uri(data: bytes, suffix: str) -> str:
    """A picture as an address that contains it; `suffix` is one of MEDIA."""
    return f"data:{MEDIA[suffix]};base64,{base64.b64encode(data).decode()}"


_INSIDE = re.compile(r"data:[\w/+.-]+;base64,[A-Za-z0-9+/=]+")


def bytes_without_pictures(text: str) -> int:
    """The size of a page without the pictures in it."""
    return len(_INSIDE.sub("", text).encode())


def write_html(path: Path, text: str, inside: Iterable[Path] = ()) -> None:
    """Writes a page as UTF-8. It is written completely or not at all.

    Args:
        path: the path of the page.
        text: what `page` made.
        inside: pictures that the page shows by their file names, and that become part of it.

    Raises:
        InputError: the folder does not exist or is not writable.
        ValueError: the page is larger than MOST_BYTES without the pictures in it.
    """
    size = bytes_without_pictures(text)
    if size > MOST_BYTES:
        raise ValueError(f"{path.name}: {size:,} bytes without pictures, more than {MOST_BYTES:,}")
    for file in inside:
        text = text.replace(f'src="{file.name}"', f'src="{data_uri(file.read_bytes(), file.suffix)}"')
    with atomic_output(path) as out:
        out.write(text.encode())
