"""Words and tables of generated documents: docstrings as they stand in the source, and Markdown."""

from __future__ import annotations

import ast
import inspect
import itertools
import re
from collections.abc import Iterable


def attribute_docs(source: str) -> dict[str, str]:
    """Docstrings under assignments, anywhere in `source`, by the assigned name; each is joined into one line."""
    docs = {}
    for node in ast.walk(ast.parse(source)):
        body = getattr(node, "body", None)
        for item, below in itertools.pairwise(body) if isinstance(body, list) else ():
            match item, below:
                case (
                    ast.Assign(targets=[ast.Name(id=name)]) | ast.AnnAssign(target=ast.Name(id=name)),
                    ast.Expr(value=ast.Constant(value=str(text))),
                ):
                    docs[name] = one_line(text)
    return docs


def listed_docs(docstring: str) -> dict[str, str]:
    """The entries of the "Attributes:" section of a docstring, by name; attributes listed together share their text."""
    _, _, listed = docstring.partition("Attributes:\n")
    items = re.findall(r"^    (\w+(?:, \w+)*): (.*(?:\n {8}.*)*)", listed, re.MULTILINE)
    return {name: one_line(text) for names, text in items for name in names.split(", ")}


def doc_of(thing: object) -> str:
    """The docstring of a class, function, property or module, without its indentation."""
    return inspect.getdoc(thing) or ""


def one_line(text: str) -> str:
    """`text` without line breaks, safe in a table's cell."""
    return " ".join(text.split()).replace("|", "\\|")


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a Markdown table and an empty line after it."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(str(cell) for cell in line) + " |" for line in lines] + [""]


def number(x: float) -> str:
    """A number as text: integers in full, others with ten digits."""
    return str(int(x)) if float(x).is_integer() and abs(x) < 1e9 else f"{x:.10g}"
