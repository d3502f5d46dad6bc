"""Prints the Makefile's targets with their descriptions (the text after `##`)."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

MAKEFILE = Path(__file__).resolve().parents[2] / "Makefile"


def described(text: str) -> Iterator[tuple[str, str]]:
    """Name and description of every target of a Makefile that has one."""
    for line in text.splitlines():
        if match := re.match(r"([a-z-]+):.*?## (.*)", line):
            yield match[1], match[2]


def main() -> int:
    """Prints the list; the exit status."""
    try:
        for target, words in described(MAKEFILE.read_text(encoding="utf-8")):
            print(f"  make {target:<11} {words}")
        sys.stdout.flush()
    except BrokenPipeError:  # whoever reads has seen enough
        sys.stderr.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
