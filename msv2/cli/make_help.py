"""Print the Makefile's targets with their one-line descriptions (the text after `##`)."""

import re
from pathlib import Path

for line in (Path(__file__).resolve().parents[2] / "Makefile").read_text().splitlines():
    if match := re.match(r"([a-z-]+):.*?## (.*)", line):
        print(f"  make {match[1]:<11} {match[2]}")
