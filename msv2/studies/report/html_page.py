"""Converts the Markdown of the reports to one HTML page: headings, paragraphs, tables, lists, code, links and pictures."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator

STYLE = """\
body { font: 15px/1.45 system-ui, sans-serif; max-width: 75em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; margin: 1em 0; font-size: 13px; display: block; overflow-x: auto; }
th, td { border: 1px solid #ccc; padding: 2px 8px; text-align: left; }
td.number, th.number { text-align: right; font-variant-numeric: tabular-nums; }
img { max-width: 100%; } pre, code { background: #f3f3f3; } nav a { margin-right: 1em; }
"""

_INLINE = (
    (re.compile(r"!\[([^]]*)\]\(([^)\s]+)\)"), r'<img alt="\1" src="\2">'),
    (re.compile(r"\[([^]]*)\]\(([^)\s]+)\)"), r'<a href="\2">\1</a>'),
    (re.compile(r"\*\*([^*]+)\*\*"), r"<b>\1</b>"),
)


def inline(text: str) -> str:
    """The HTML of a line of text, with code, pictures, links and bold words."""
    parts = text.split("`")
    for i, part in enumerate(parts):
        parts[i] = html.escape(part, quote=False)
        if i % 2:
            parts[i] = f"<code>{parts[i]}</code>"
            continue
        for pattern, made in _INLINE:
            parts[i] = pattern.sub(made, parts[i])
    return "".join(parts)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split(" | ")]


def _table(lines: list[str]) -> Iterator[str]:
    rule = [cell.strip("| ") for cell in lines[1].strip().strip("|").split("|")]
    kinds = [' class="number"' if cell.endswith(":") else "" for cell in rule]
    yield "<table>"
    for i, line in enumerate([lines[0], *lines[2:]]):
        tag = "td" if i else "th"
        cells = _cells(line)
        kinds += [""] * (len(cells) - len(kinds))
        yield "<tr>" + "".join(
            f"<{tag}{kind}>{inline(cell)}</{tag}>" for cell, kind in zip(cells, kinds, strict=False)) + "</tr>"
    yield "</table>"


def _blocks(text: str) -> Iterator[list[str]]:
    """The blocks of lines between blank lines. A code block stays whole, and a heading is a block of its own."""
    block, code = [], False
    for line in text.splitlines():
        fence = line.startswith("```")
        if not code and (not line.strip() or line.startswith("#") or fence) and block:
            yield block
            block = []
        if line.strip() or code:
            block.append(line)
        if (fence and code) or (line.startswith("#") and not code):
            yield block
            block = []
        code ^= fence
    if block:
        yield block


def body(text: str) -> str:
    """The HTML of the page's body."""
    out = []
    for block in _blocks(text):
        first = block[0]
        if first.startswith("```"):
            out.append("<pre>" + html.escape("\n".join(block[1:-1])) + "</pre>")
        elif first.startswith("#"):
            level, title = len(first) - len(first.lstrip("#")), first.lstrip("# ")
            out.append(f'<h{level} id="{anchor(title)}">{inline(title)}</h{level}>')
        elif first.startswith("|") and len(block) > 1:
            out += _table(block)
        elif first.startswith("- "):
            items = "\n".join(block)[2:].split("\n- ")
            out.append("<ul>" + "".join(f"<li>{inline(item)}</li>" for item in items) + "</ul>")
        else:
            out.append(f"<p>{inline(' '.join(block))}</p>")
    return "\n".join(out)


def anchor(title: str) -> str:
    """The name of a heading in links."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def page(title: str, text: str) -> str:
    """The whole page, with links to its chapters."""
    chapters = [line[2:] for line in text.splitlines() if line.startswith("# ")]
    links = "".join(f'<a href="#{anchor(c)}">{inline(c)}</a>' for c in chapters)
    return (f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
            f"<style>{STYLE}</style></head><body><nav>{links}</nav>\n{body(text)}\n</body></html>\n")
