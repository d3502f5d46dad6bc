"""Checks the variables of a `make` command line against those that its targets use, as the Makefile itself says.

Standard library only: it runs before anything is installed. A variable that no target uses is most likely misspelt, and make
would ignore it without a word.
"""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Collection, Sequence
from pathlib import Path

MAKEFILE = Path(__file__).resolve().parents[2] / "Makefile"

ALWAYS = ("PYTHON", "RUN", "MSV2", "TESTS", "MSV2_CACHE", "MSV2_DATA", "MSV2_PDK")
"""Accepted with every target: how things are started, and what commands read from the environment."""

_NAME = r"[A-Z][A-Z0-9_]*"


def targets(text: str) -> dict[str, tuple[list[str], set[str]]]:
    """Prerequisites and used variables of every target of a Makefile; definitions that a recipe uses are followed."""
    text = text.replace("\\\n", " ")
    definitions = dict(re.findall(r"^([A-Za-z_0-9]+)\s*:?=\s*(.*)$", text, re.MULTILINE))

    def used(line: str) -> set[str]:
        names: set[str] = set()
        for name in re.findall(r"\$\((\w+)\)", line) + re.findall(rf"\$\(call (?:option|switch),({_NAME})", line):
            names |= used(definitions[name]) if name in definitions else {name} if name.isupper() else set()
        return names

    found: dict[str, tuple[list[str], set[str]]] = {}
    current = None
    for line in text.splitlines():
        rule = re.match(r"([a-z][a-z-]*):(?!=)([^#]*)", line)
        if rule:
            current = found[rule[1]] = (rule[2].split(), set())
        elif line.startswith("\t") and current:
            current[1].update(used(line))
        elif line.strip():
            current = None
    return found


def accepted(text: str, goals: Sequence[str]) -> list[str]:
    """Variables that any of the goals uses, or what comes before it."""
    rules, names, todo = targets(text), set(), list(goals)
    while todo:
        before, used = rules.get(todo.pop(), ([], set()))
        names |= used
        todo += before
    return sorted(names - set(ALWAYS))


def complaint(text: str, goals: Sequence[str], given: Collection[str]) -> str:
    """What is wrong with the given variables; empty where nothing is."""
    known = accepted(text, goals)
    wrong = [name for name in given if name not in (*known, *ALWAYS)]
    if not wrong:
        return ""
    near = difflib.get_close_matches(wrong[0], [*known, *ALWAYS], n=1)
    hint = f"; did you mean {near[0]}?" if near else "."
    return (f"variable {wrong[0]} is not accepted by make {' '.join(goals)}{hint} "
            f"It takes {', '.join(known) or 'no variables of its own'}")


def main(argv: Sequence[str] | None = None) -> int:
    """Prints what is wrong with `GOAL ... -- VARIABLE ...`; nothing where all is well."""
    words = list(sys.argv[1:] if argv is None else argv)
    cut = words.index("--")
    text = complaint(MAKEFILE.read_text(encoding="utf-8"), words[:cut] or ["help"], words[cut + 1 :])
    if text:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
