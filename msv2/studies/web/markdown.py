"""Converts the Markdown of the reports to HTML: headings, paragraphs, tables, lists, code, links and pictures."""

from __future__ import annotations

import html
import re
from collections.abc import Iterator

_INLINE = (
    (re.compile(r"!\[([^]]*)\]\(([^)\s]+)\)"), r'<img alt="\1" src="\2" loading="lazy">'),
    (re.compile(r"\[([^]]*)\]\(([^)\s]+)\)"), r'<a href="\2">\1</a>'),
    (re.compile(r"\*\*([^*]+)\*\*"), r"<b>\1</b>"),
)

_PICTURE = re.compile(r"!\[[^]]*\]\([^)\s]+\)")
"""A block that is nothing but a picture."""

_NUMBER = re.compile(r"[-+−~]?\d[\d,]*(\.\d+)?")
"""The beginning of a cell that counts as a number; a unit or a remark may follow."""


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


def _kind(cells: list[str]) -> str:
    """The class of a column: one of numbers, if most of its filled cells begin with one, of short names, or of long words."""
    filled = [cell.strip("*` ") for cell in cells if cell.strip("*-` ")]
    longest = max(map(len, filled), default=0)
    if longest < 24:
        numbers = sum(bool(_NUMBER.match(cell)) for cell in filled) * 2 > len(filled)
        return ' class="number"' if numbers else ' class="short"'
    return ' class="words"' if longest > 40 else ""


def _table(lines: list[str]) -> Iterator[str]:
    """A table that scrolls sideways in a box of its own. The page's script sorts it by the column that is clicked."""
    head, rows = _cells(lines[0]), [_cells(line) for line in lines[2:]]
    columns = [[row[i] for row in rows if i < len(row)] for i in range(len(head))]
    kinds = list(map(_kind, columns))
    yield '<div class="table"><table><thead><tr>' + "".join(
        f"<th{kind}>{inline(cell)}</th>" for cell, kind in zip(head, kinds, strict=True)) + "</tr></thead><tbody>"
    for row in rows:
        yield "<tr>" + "".join(
            f"<td{kind}>{inline(cell)}</td>" for cell, kind in zip(row, [*kinds, *[""] * len(row)], strict=False)) + "</tr>"
    yield "</tbody></table></div>"


def blocks(text: str) -> Iterator[list[str]]:
    """The blocks of lines between blank lines. A code block stays whole, and a heading is a block of its own."""
    block: list[str] = []
    code = False
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
    """The HTML of a text of Markdown. Comments, which mark generated tables, are left out."""
    out = []
    for block in blocks(re.sub(r"<!--.*?-->\n?", "", text, flags=re.DOTALL)):
        first = block[0]
        if first.startswith("```"):
            out.append("<pre>" + html.escape("\n".join(block[1:-1])) + "</pre>")
        elif all(line.startswith("    ") for line in block):
            out.append("<pre>" + html.escape("\n".join(line[4:] for line in block)) + "</pre>")
        elif first.startswith("#"):
            level, title = len(first) - len(first.lstrip("#")), first.lstrip("# ")
            out.append(f'<h{level} id="{anchor(title)}">{inline(title)}</h{level}>')
        elif first.startswith("|") and len(block) > 1:
            out += _table(block)
        elif first.startswith("- "):
            items = re.split(r"\n- ", "\n".join(block)[2:])
            out.append("<ul>" + "".join(f"<li>{inline(item)}</li>" for item in items) + "</ul>")
        elif _PICTURE.fullmatch(" ".join(block)):
            out.append(f'<div class="plot">{inline(" ".join(block))}</div>')
        else:
            out.append(f"<p>{inline(' '.join(block))}</p>")
    return "\n".join(out)


def anchor(title: str) -> str:
    """The name of a heading in links."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
