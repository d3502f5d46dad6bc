"""Checks of a finished page: no raw Markdown in its text, its size, and that its links and pictures lead somewhere."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from msv2.studies.web.maker import MOST_BYTES, bytes_without_pictures
from msv2.studies.web.markdown import anchor

RAW = {"bold": re.compile(r"\*\*"), "rule of a table": re.compile(r"\|\s*:?-{2,}:?\s*\|"), "code": re.compile(r"`"),
       "link": re.compile(r"\]\([^)\s]+\)"), "heading": re.compile(r"(?m)^#{1,4} ")}
"""Markdown that must not be left in a page's text, by what it is."""

_LINK = re.compile(r"\]\(([^)\s]+)\)")


class _Reader(HTMLParser):
    """The text of a page outside of code, scripts and styles, its links, its pictures and its anchors."""

    CLOSED = ("script", "style", "pre", "code")

    def __init__(self) -> None:
        super().__init__()
        self.text: list[str] = []
        self.links: list[str] = []
        self.pictures: list[tuple[str, str]] = []
        self.names: set[str] = set()
        self._inside: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        if tag in self.CLOSED:
            self._inside.append(tag)
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag == "img":
            self.pictures.append((given.get("src", ""), given.get("alt", "")))
        if "id" in given:
            self.names.add(given["id"])

    def handle_endtag(self, tag: str) -> None:
        if self._inside and self._inside[-1] == tag:
            self._inside.pop()

    def handle_data(self, data: str) -> None:
        if not self._inside:
            self.text.append(data)


def problems(path: Path) -> list[str]:
    """What is wrong with an HTML page, in words; empty for a page that is as it should be."""
    source = path.read_text(encoding="utf-8")
    reader = _Reader()
    reader.feed(source)
    text, found = "".join(reader.text), []
    for what, pattern in RAW.items():
        for match in pattern.finditer(text):
            found.append(f"raw Markdown ({what}): ...{text[max(0, match.start() - 30) : match.end() + 30]!r}")
    size = bytes_without_pictures(source)
    if size > MOST_BYTES:
        found.append(f"{size:,} bytes without pictures, more than {MOST_BYTES:,}")
    for link in reader.links:
        found += _unresolved(path, link, reader.names)
    for picture, alt in reader.pictures:
        found += [] if picture.startswith("data:image/") else _unresolved(path, picture, set())
        found += [] if alt else [f"a picture without a description: {picture[:60]}"]
    for tag in re.findall(r"<(?:script|link|img|iframe)[^>]*(?:src|href)=\"(https?:[^\"]*)", source):
        found.append(f"needs the network: {tag}")
    return found


def markdown_problems(path: Path) -> list[str]:
    """The links and pictures of a page of Markdown that lead nowhere."""
    text = path.read_text(encoding="utf-8")
    names = {anchor(title) for title in re.findall(r"(?m)^#+ (.+)$", text)}
    targets = [*_LINK.findall(text), *re.findall(r'(?:src|href)="([^"]+)"', text)]
    return [found for link in targets for found in _unresolved(path, link, names)]


def _unresolved(page: Path, link: str, names: set[str]) -> list[str]:
    parts = urlsplit(link)
    if parts.scheme in ("http", "https"):
        return []
    if not parts.path:
        return [] if unquote(parts.fragment) in names else [f"a link to #{parts.fragment}, which is not on the page"]
    return [] if (page.parent / unquote(parts.path)).exists() else [f"{link} does not exist"]
